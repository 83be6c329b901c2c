"""The ball presses of Taxim as a folder of photographs for `gelsim calibrate`: every other press to fit, the others to predict.

    python docs/studies/taxim_photos.py --data DIR --out out/taxim_photos
    gelsim calibrate --photos out/taxim_photos --sensor taxim --out out/taxim/sensor.toml

DIR holds taxim/ball_presses.npz (README.md there: 49 presses of a steel ball of 2.00 mm, MIT licence, Si & Yuan). The pictures are BGR
there and become RGB; they were scaled down by four, so a pixel is 4 × 0.0295 mm, Taxim's own scale (its published sensor parameters).
Nothing else is handed on: neither the marked middles of the dents nor which light stands where.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from PIL import Image

MM_PER_PX = 4 * 0.0295
BALL_RADIUS_MM = 2.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scale-unknown", action="store_true", help="leave mm_per_px to the fit")
    options = parser.parse_args()
    with np.load(options.data / "taxim" / "ball_presses.npz", allow_pickle=False) as data:
        no_contact, pictures = data["f0"][..., ::-1], data["imgs"][..., ::-1]
    options.out.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(no_contact)).save(options.out / "no_contact.png")
    with (options.out / "presses.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["file", "split"])
        for index, picture in enumerate(pictures):
            name = f"press_{index:02d}.png"
            Image.fromarray(np.ascontiguousarray(picture)).save(options.out / name)
            table.writerow([name, "test" if index % 2 else "train"])
    lines = [f"ball_radius_mm = {BALL_RADIUS_MM}", 'no_contact = "no_contact.png"', "markers = false"]
    if not options.scale_unknown:
        lines.append(f"mm_per_px = {MM_PER_PX}")
    (options.out / "photos.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{options.out}: {len(pictures)} presses")


if __name__ == "__main__":
    main()
