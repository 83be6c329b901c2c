"""How real things are ranked by the networks of docs/studies/reader_ablation.sh: means and standard deviations over their seeds.

    python docs/studies/reader_ablation.py RUNS FOLDER --mm-per-px 0.058 --sensor gelsight_mini

RUNS/WAY-SEED/model.pt are the networks, FOLDER is as docs/studies/hand_presses.py takes it, which reads and scores them. Each is told its
gel, and the scale too where it was trained on pictures in millimetres (all ways but `whole_pictures`).
"""

import argparse
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

UNSCALED = "whole_pictures"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mm-per-px", required=True)
    parser.add_argument("--sensor", required=True)
    options = parser.parse_args()
    found = sorted(options.runs.glob("*-*/model.pt"))
    asked = [part for model in [*map(str, found), "paper2017"] for part in ("--model", model)]
    reader = Path(__file__).with_name("hand_presses.py")
    told = ["--mm-per-px", options.mm_per_px, "--sensor", options.sensor]
    said = subprocess.run([sys.executable, reader, options.folder, *told, *asked], check=True, capture_output=True, text=True).stdout
    by_way: dict[tuple[str, str], list[list[float]]] = defaultdict(list)
    for line in said.splitlines()[2:]:
        name, words, half, *numbers = (cell.strip() for cell in line.strip("|").split("|"))
        way = Path(name).parent.name.rpartition("-")[0] or name
        if words == ("gel" if way == UNSCALED else "gel, scale"):
            by_way[way, half].append([float(re.sub(" %", "", number)) for number in numbers])
    print("| trained on | half of the things | seeds | Spearman by object | hard, soft | hard, moderate | moderate, soft |")
    print("|---|---|---|---|---|---|---|")
    for (way, half), rows in sorted(by_way.items()):
        cells = [f"{mean:.2f} ± {sd:.2f}" for mean, sd in zip(np.mean(rows, axis=0), np.std(rows, axis=0), strict=True)]
        print(f"| {way} | {half} | {len(rows)} | " + " | ".join(cells[:4]) + " |")


if __name__ == "__main__":
    main()
