"""Taxim's package on its own sensor and ours on the same presses of the same ball, beside the photographs.

    git clone https://github.com/Robo-Touch/Taxim; pip install opencv-python-headless
    python docs/studies/beside_taxim.py --taxim Taxim --data ../shared/real --sensor out/taxim/sensor.toml --out out/beside_taxim

Photographs: Taxim's own (`taxim_photos.py`), of those that our sensor was not fitted to every fourth. Taxim's tables (`polycalib.npz` and
`shadowTable.npz` of its `calibs`) are those that it ships for this sensor, made of all its photographs, these among them. Its background
is the no-contact photograph, or, so that sensors alone are compared, ours, the median of photographs (`--background`). Of each press both
are fitted by three numbers, place and depth: ours by `gelsim compare`, Taxim's from its marked middle by a search over depth and whole
pixels. Its pictures of 640 x 480 are averaged down to the photographs' 160 x 120. All are scored by `gelsim compare --frames`; Taxim's
with its shadows, and without.
"""

from __future__ import annotations

import argparse
import os
import runpy
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gelsim.calibrate import comparison, drawing, pictures
from gelsim.calibrate.dent import effective_radius, solve_dents
from gelsim.calibrate.parameters import curvature_of
from gelsim.calibrate.photos import read_photos
from gelsim.scene.layers import build_scene

ARCHIVE = "ball_presses.npz"
EVERY = 8
"""Of the photographs; the odd ones are for testing."""
BALL_MM, TAXIM_PX_MM, FINER = 2.0, 0.0295, 4
"""Taxim's pixels, and how many of them are one of the photographs'."""


def photographs(data: Path, out: Path) -> tuple[list[str], np.ndarray]:
    """A folder for `gelsim compare`; its files, and the dents' marked middles [px]."""
    out.mkdir(parents=True, exist_ok=True)
    with np.load(data / "taxim" / ARCHIVE) as archive:
        some = range(1, len(archive["imgs"]), EVERY)
        names = [f"press_{index}.png" for index in some]
        for name, picture in zip(["no_contact.png", *names], [archive["f0"], *archive["imgs"][list(some)]], strict=True):
            Image.fromarray(picture[..., ::-1]).save(out / name)
        marked = archive["touch_center"][list(some)].astype(float)
    scale = FINER * TAXIM_PX_MM
    (out / "photos.toml").write_text(f'ball_radius_mm = {BALL_MM}\nmm_per_px = {scale}\nno_contact = "no_contact.png"\n', encoding="utf-8")
    (out / "presses.csv").write_text("file\n" + "\n".join(names) + "\n", encoding="utf-8")
    return names, marked


class Taxim:
    """Its simulator, loaded from a clone, with a ball in place of its point clouds."""

    def __init__(self, clone: Path, scratch: Path, no_contact: np.ndarray) -> None:
        scratch.mkdir(parents=True, exist_ok=True)
        for name in ("polycalib.npz", "shadowTable.npz"):
            shutil.copyfile(clone / "calibs" / name, scratch / name)
        self.gel = clone / "calibs" / "gelmap5.npy"
        finer = Image.fromarray(no_contact).resize((no_contact.shape[1] * FINER, no_contact.shape[0] * FINER), Image.Resampling.BICUBIC)
        np.savez(scratch / "dataPack.npz", f0=np.asarray(finer)[..., ::-1])
        reach = int(BALL_MM / TAXIM_PX_MM)
        x, y = (np.mgrid[-reach:reach, -reach:reach] + 0.5) * TAXIM_PX_MM
        inside = x**2 + y**2 < BALL_MM**2
        points = np.column_stack([x[inside], y[inside], BALL_MM + np.sqrt(BALL_MM**2 - x[inside] ** 2 - y[inside] ** 2)])
        head = ["ply", "format ascii 1.0", "comment ball", f"element vertex {len(points)}", *["comment"] * 6]
        lines = (" ".join(f"{value:.6f}" for value in point) for point in points)
        (scratch / "ball.ply").write_text("\n".join([*head, *lines]) + "\n", encoding="utf-8")
        here, arguments = Path.cwd(), sys.argv
        try:  # its imports are relative to its own folder, and its module reads the command line
            os.chdir(clone / "OpticalSimulation")
            sys.argv = ["simOptical.py"]
            simulator = runpy.run_path("simOptical.py")["simulator"]
        finally:
            os.chdir(here)
            sys.argv = arguments
        self.simulator = simulator(str(scratch), str(scratch), "ball.ply")

    def dent(self, depth_mm: float) -> np.ndarray:
        """How deep the gel is pressed by the ball in the picture's middle [mm], (480, 640)."""
        contact = self.simulator.deformApprox(depth_mm, *self.simulator.generateHeightMap(str(self.gel), depth_mm, 0, 0))[2]
        return contact * TAXIM_PX_MM

    def picture(self, depth_mm: float, across: int, down: int, shadow: bool) -> np.ndarray:
        """Levels (120, 160, 3), RGB; the ball's middle is so many of its pixels from the picture's."""
        height, gel, mask = self.simulator.generateHeightMap(str(self.gel), depth_mm, across, down)
        height, mask, contact = self.simulator.deformApprox(depth_mm, height, gel, mask)
        drawn = self.simulator.simulating(height, mask, contact, shadow=shadow)[shadow]
        rows, columns = (size // FINER for size in drawn.shape[:2])
        return np.clip(drawn[..., ::-1], 0, 255).reshape(rows, FINER, columns, FINER, 3).mean(axis=(1, 3))

    def found(self, photo: np.ndarray, marked: np.ndarray) -> tuple[float, int, int]:
        """Depth and place whose picture, without shadows, has the least squared error."""
        across, down = (round(FINER * (at + 0.5)) - FINER * size // 2 for at, size in zip(marked, photo.shape[1::-1], strict=True))
        known: dict[tuple[float, int, int], float] = {}

        def error(press: tuple[float, int, int]) -> float:
            if press not in known:
                known[press] = float(((self.picture(*press, shadow=False) - photo) ** 2).mean())
            return known[press]

        best = min(((depth, across, down) for depth in (0.4, 0.8, 1.2, 1.6, 2.0, 2.4)), key=error)
        for deeper, pixels in ((0.1, 4), (0.05, 2), (0.02, 1)):
            while True:
                depth, x, y = best
                tries = [best, *((round(depth + step, 3), x, y) for step in (-deeper, deeper) if depth + step > 0.05)]
                tries += [(depth, x + pixels * i, y + pixels * j) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
                next_best = min(tries, key=error)
                if next_best == best:
                    break
                best = next_best
        return best


def ours(folder: Path, sensor: str, out: Path) -> tuple[list[np.ndarray], list[float]]:
    """Our pictures of the same presses, and their depths [mm]."""
    report = comparison.compare(folder, out, comparison.Drawing(sensor), force=True)
    photos = read_photos(folder)
    scene = build_scene({"sensor": {"preset": sensor}, "render": {"resolution": list(photos.size), "spp": comparison.SPP}})
    dents = solve_dents(scene.gel, effective_radius(photos.balls_mm, curvature_of(scene.gel)), True)
    inward = 1 + BALL_MM * curvature_of(scene.gel)
    presses = [np.array([row["x_mm"] * inward, row["y_mm"] * inward, row["depth_mm"], 0.0, 0.0]) for row in report["presses"]]
    _, drawn = drawing.draw(scene, dents.at(scene.gel.thickness_mm), photos.balls_mm, presses)
    return [picture.astype(float) for picture in drawn], [row["depth_mm"] for row in report["presses"]]


def scores(folder: Path, names: list[str], drawn: list[np.ndarray], out: Path) -> dict[str, Any]:
    out.mkdir(parents=True, exist_ok=True)
    for name, picture in zip(names, drawn, strict=True):
        Image.fromarray(np.rint(picture).astype(np.uint8)).save(out / name)
    return comparison.compare(folder, out / "compare", out, force=True)["scores"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--taxim", type=Path, required=True, metavar="CLONE")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--sensor", default="taxim", help="ours (default: the shipped preset)")
    parser.add_argument("--background", type=Path, metavar="REST.png", help="of Taxim's pictures (default: the no-contact photograph)")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    folder = options.out / "photos"
    names, marked = photographs(options.data, folder)
    photos = read_photos(folder)
    background = np.asarray(Image.open(options.background or folder / "no_contact.png").convert("RGB"))
    taxim = Taxim(options.taxim, options.out / "taxim_tables", background)
    places = [taxim.found(photo, at) for photo, at in zip(photos.pictures, marked, strict=True)]
    drawn = {shadow: [taxim.picture(*place, shadow=shadow) for place in places] for shadow in (False, True)}
    mine, depths = ours(folder, options.sensor, options.out / "ours")
    rows = {
        "Taxim": scores(folder, names, drawn[False], options.out / "taxim"),
        "Taxim with shadows": scores(folder, names, drawn[True], options.out / "taxim_shadows"),
        "here": scores(folder, names, mine, options.out / "here"),
    }
    for name, score in [*((name, score["drawn"]) for name, score in rows.items()), ("no contact", rows["here"]["no_contact"])]:
        print(f"{name}: " + ", ".join(f"{key} {score[key]:.3f}" for key in comparison.SCORES))
    columns = [("photograph", photos.pictures[::2]), ("Taxim's package, with shadows", drawn[True][::2]), ("here", mine[::2])]
    captions = [f"depth {place[0]:.2f} mm (Taxim), {depth:.2f} mm (here)" for place, depth in zip(places, depths, strict=True)][::2]
    pictures.draw_comparison(options.out / "beside_taxim.png", columns, captions)


if __name__ == "__main__":
    main()
