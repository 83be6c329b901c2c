"""The ball presses of Taxim as a folder of photographs for `gelsim calibrate`: every other press to fit, the others to predict.

    python docs/studies/taxim_photos.py --data DIR --out out/taxim_photos
    gelsim calibrate --photos out/taxim_photos --sensor taxim --out out/taxim/sensor.toml

DIR holds taxim/ball_presses.npz (README.md there: 49 presses of a steel ball of 2.00 mm, MIT licence, Si & Yuan), whose pictures are BGR.
They were scaled down by four, so a pixel is 4 × 0.0295 mm, Taxim's own scale (its published sensor parameters). Nothing else is handed on:
neither the marked middles of the dents nor which light stands where.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from pathlib import Path

import numpy as np

MM_PER_PX = 4 * 0.0295
BALL_RADIUS_MM = 2.0
ARCHIVE = "ball_presses.npz"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--few", action="store_true", help="every fourth to fit, every eighth, from the second on, to predict")
    parser.add_argument("--scale-unknown", action="store_true", help="leave mm_per_px to the fit")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(options.data / "taxim" / ARCHIVE, options.out / ARCHIVE)
    with np.load(options.out / ARCHIVE, allow_pickle=False) as data:
        count = len(data["imgs"])
    with (options.out / "presses.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["file", "split"])
        some = [index for index in range(count) if not options.few or index % 4 == 0 or index % 8 == 1]
        table.writerows([f"{ARCHIVE}:imgs:{index}", "test" if index % 2 else "train"] for index in some)
    lines = [f"ball_radius_mm = {BALL_RADIUS_MM}", f'no_contact = "{ARCHIVE}:f0"', 'order = "bgr"']
    if not options.scale_unknown:
        lines.append(f"mm_per_px = {MM_PER_PX}")
    (options.out / "photos.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{options.out}: {len(some)} presses")


if __name__ == "__main__":
    main()
