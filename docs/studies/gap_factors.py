"""Which difference of an unknown sensor moves the learner's readings? One field at a time, far outside of what training knew.

    python docs/studies/gap_factors.py --out out/gap_factors [--model default] [--sensor NAME]

Renders cylinders and hemispheres of Shore 00 19, 40 and 61, pressed 2 mm deep (mode "path"), with the preset as it stands and with each
change of plan `gap` for itself; has them read by a checkpoint; prints the readings of each shape, and how far they moved in the mean. What
was rendered is kept. A network that takes the gel is told each scene's own; with --sensor fingertip2017 it is told that nothing changed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

SHAPES, SHORES = ("cylinder", "hemisphere"), (19, 40, 61)
GEL = {"thick": ["--gel.thickness-mm", "3.1"], "hard": ["--gel.shore-00", "22.5"], "dome": ["--gel.edge-thickness-mm", "1.75"]}
CHANGES: dict[str, list[str]] = {
    "base": [],
    **GEL,
    "gel": [flag for flags in GEL.values() for flag in flags],
    "coat": ["--coating.specular", "0.52", "--coating.roughness", "0.28"],
    "markers": ["--markers.pitch-mm", "1.85", "--markers.radius-mm", "0.27", "--markers.albedo", "0.11"],
    "camera": ["--camera.exposure", "57", "--camera.gamma", "0.85"],
}

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--out", type=Path, required=True)
parser.add_argument("--model", default="default")
parser.add_argument("--sensor", help="whose gel a network is told (default: each scene's own)")
given = parser.parse_args()
told_gel = ["--sensor", given.sensor] if given.sensor else []


def run(*words: str) -> str:
    return subprocess.run([sys.executable, "-m", *words], check=True, capture_output=True, text=True).stdout


print("| change | " + " | ".join(f"{shape}, {'/'.join(map(str, SHORES))}" for shape in SHAPES) + " | moved |\n|---|---|---|---|")
base = np.zeros((len(SHAPES), len(SHORES)))
for name, flags in CHANGES.items():
    folders = [given.out / f"{name}_{shape}_{shore}" for shape in SHAPES for shore in SHORES]
    for folder in folders:
        if not (folder / "report.json").is_file():
            _, shape, shore = folder.name.split("_")
            run("gelsim", "render", "--shape", shape, "--shore", shore, "--depth-mm", "2", "--frames", "8", "--out", str(folder), *flags)
    told = json.loads(run("learn.cli", "predict", "--json", "--model", given.model, *told_gel, *map(str, folders)))
    readings = np.array([press["shore_00"] for press in told["presses"]]).reshape(base.shape)
    base = readings if name == "base" else base
    cells = [", ".join(f"{value:.0f}" for value in row) for row in readings]
    print(f"| {name}: {' '.join(flags)} | {' | '.join(cells)} | {(readings - base).mean():+.1f} |", flush=True)
