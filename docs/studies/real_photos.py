"""Real photographs of other people's sensors as folders for `gelsim calibrate`, and how far off the dots of the fitted sensor are.

    python docs/studies/real_photos.py --data ../shared/real --set mini_markers --out out/mini_photos
    gelsim calibrate --photos out/mini_photos --sensor mini --out out/mini/mini.toml
    python docs/studies/real_photos.py --photos out/mini_photos --dots out/mini/mini.toml
    python docs/studies/real_photos.py --photos out/mini_photos --dots symmetric

Sets: `mini_markers` (a GelSight Mini, ball of 5.0 mm diameter, its gel by the data sheet; the half that its owner named is for testing)
and `dots427` (a laboratory's own sensor, ball radius 2.38 mm; every third press by number is for testing). Nothing else is handed on: no
place, no depth, and no scale but with `--scale`. The photographs carry no licence: they are read, and nothing made from them stays in this
repository.

Dots: dark blobs of the picture without contact, found again within half the distance of neighbours in a test press's photograph and
in the fitted sensor's picture of it. Of those that moved 2 px or more in the photograph: median of the distance between the two, and of the
motion, once for the picture of the press's place and depth, once with the drag that was found beside them. `--dots symmetric` asks what any
picture without drag could reach, and draws none: to the dots of each test photograph itself a motion is fitted (least absolute values) that
is symmetric about the contact, FREE numbers of its own for each press, whatever the gel; then as many more for how far heights look shifted
from the picture's middle, as a camera near the gel sees them; then a drag, two numbers.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from gelsim.calibrate import drawing, start
from gelsim.calibrate.dent import effective_radius, solve_dents
from gelsim.calibrate.dots import dark_pixels
from gelsim.calibrate.parameters import curvature_of
from gelsim.calibrate.photos import read_photos
from gelsim.calibrate.run import FIT_WIDTH
from gelsim.scene.layers import build_scene

MOVED_PX = 2.0
FREE = 4
"""Of a symmetric motion: its size at so many equally spaced distances up to where a dent is felt; between them linear, beyond none."""
MINI = """ball_radius_mm = 2.5
no_contact = "no_contact.png"
markers = true

[gel]
profile = "flat"
size_mm = [25.25, 20.75]
thickness_mm = 4.25
"""
OWN = 'ball_radius_mm = 2.38\nno_contact = "no_contact.jpg"\nmarkers = true\n'


def write_folder(data: Path, name: str, out: Path, scale: float | None = None, few: int | None = None) -> None:
    out.mkdir(parents=True, exist_ok=True)
    if name == "mini_markers":
        with (data / name / "contacts.csv").open(encoding="utf-8") as file:
            rows = [(row["file"], row["half"]) for row in csv.DictReader(file)]
    else:
        files = sorted((data / name).glob("press_*.jpg"), key=lambda path: int(re.findall(r"\d+", path.stem)[0]))
        rows = [(path.name, "test" if index % 3 == 2 else "train") for index, path in enumerate(files)]
    fitted = [row for row in rows if row[1] == "train"]
    if few is not None:
        kept = {fitted[place] for place in np.linspace(0, len(fitted) - 1, few).round().astype(int)}
        rows = [row for row in rows if row in kept or row not in fitted]
    settings = ("" if scale is None else f"mm_per_px = {scale}\n") + (MINI if name == "mini_markers" else OWN)
    (out / "photos.toml").write_text(settings, encoding="utf-8")
    with (out / "presses.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["file", "split"])
        table.writerows(rows)
    for file in [*(file for file, _ in rows), settings.split('"')[1]]:
        shutil.copyfile(data / name / file, out / file)


def dots_of(picture: np.ndarray) -> np.ndarray:
    """Middles of the dark blobs (column, row) [px], shape (K, 2)."""
    labels, count = ndimage.label(dark_pixels(picture[None].astype(float))[0])  # type: ignore[misc]
    numbers = np.arange(1, count + 1)
    areas = np.asarray(ndimage.sum(labels > 0, labels, numbers), float)
    weight = 255.0 - picture.mean(axis=2)
    middles = np.array(ndimage.center_of_mass(weight, labels, numbers))[:, ::-1]
    return middles[(areas > 0.4 * np.median(areas)) & (areas < 2.5 * np.median(areas))]


def dot_errors(photos_folder: Path, sensor: Path, dragged: bool) -> tuple[np.ndarray, np.ndarray]:
    """Error and motion [px] of each dot that moved, over all test presses; `dragged`: with the drag that was found, too."""
    photos = read_photos(photos_folder)
    report = json.loads((sensor.parent / "report.json").read_text(encoding="utf-8"))
    scene = build_scene({"sensor": {"preset": str(sensor.resolve())}})
    scene = scene.replace(render=type(scene.render)("path", 16, photos.size))
    dents = solve_dents(scene.gel, effective_radius(photos.balls_mm, curvature_of(scene.gel)), True)
    test = [index for index, row in enumerate(report["presses"]) if row["split"] == "test"]
    rows = [report["presses"][index]["dragged"] if dragged else report["presses"][index] for index in test]
    presses = [np.array([*row["offset_mm"], row["depth_mm"], *row["drag_mm"]]) for row in rows]
    slip = report["parameters"]["contact.slip"]["value"]
    rest, drawn = drawing.draw(scene, dents.at(scene.gel.thickness_mm, slip), photos.balls_mm[test], presses)
    before = dots_of(rest)
    apart = KDTree(before).query(before, k=2)[0][:, 1]
    errors, moves = [], []
    for index, picture in zip(test, drawn, strict=True):
        found = [dots_of(each) for each in (photos.pictures[index], picture)]
        near = [KDTree(middles).query(before) for middles in found]
        kept = (near[0][0] < 0.5 * np.median(apart)) & (near[1][0] < 0.5 * np.median(apart)) & (near[0][0] >= MOVED_PX)
        errors.append(np.hypot(*(found[0][near[0][1]] - found[1][near[1][1]])[kept].T))
        moves.append(near[0][0][kept])
    return np.concatenate(errors), np.concatenate(moves)


def symmetric_errors(photos_folder: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Likewise of the best motions symmetric about the contact that a test photograph's own dots allow, by what is free."""
    photos = read_photos(photos_folder)
    factor = int(np.ceil(photos.size[0] / FIT_WIDTH))
    reduced = start.reduce(np.concatenate([photos.no_contact[None], photos.pictures]), factor)
    contacts, _ = start.find_contacts(reduced[0], reduced[1:], np.ones(reduced.shape[1:3], bool))
    before, middle = dots_of(photos.no_contact), np.array(photos.size) / 2
    apart = np.median(np.asarray(KDTree(before).query(before, k=2)[0])[:, 1])
    errors: dict[str, list[np.ndarray]] = {"symmetric": [], "symmetric, heights shifted": [], "symmetric, heights shifted, drag": []}
    moves = []
    for index in np.flatnonzero(photos.test):
        after = dots_of(photos.pictures[index])
        distance, nearest = KDTree(after).query(before)
        place, reach = factor * contacts[index, :2], start.FELT * factor * contacts[index, 2]
        felt = (distance < 0.5 * apart) & (np.hypot(*(before - place).T) < reach)
        motion, away = (after[nearest] - before)[felt], (before - place)[felt]
        moved = np.hypot(*motion.T) >= MOVED_PX
        if not moved.any():
            continue
        far = np.hypot(*away.T) * (FREE / reach)
        sizes = np.clip(1 - np.abs(far[:, None] - np.arange(1, FREE + 1)), 0, 1)[:, :, None]
        radial = sizes * (away / np.maximum(np.hypot(*away.T), 1e-9)[:, None])[:, None]
        shifted = sizes * ((before[felt] - middle) / middle[0])[:, None]
        dragged = (1 - far / FREE)[:, None, None] * np.eye(2)
        for name, columns in zip(errors, ([radial], [radial, shifted], [radial, shifted, dragged]), strict=True):
            errors[name].append(_least_absolute(np.concatenate(columns, axis=1), motion)[moved])
        moves.append(np.hypot(*motion.T)[moved])
    return {name: np.concatenate(parts) for name, parts in errors.items()}, np.concatenate(moves)


def _least_absolute(columns: np.ndarray, motion: np.ndarray, turns: int = 30) -> np.ndarray:
    """What the columns (N, K, 2) leave of motions (N, 2), shape (N,), their sum least: by least squares weighted anew."""
    flat, left = columns.transpose(0, 2, 1).reshape(-1, columns.shape[1]), np.ones(len(motion))
    for _ in range(turns):
        weight = np.repeat(1 / np.sqrt(np.maximum(left, 0.05)), 2)
        found = np.linalg.lstsq(flat * weight[:, None], motion.ravel() * weight, rcond=None)[0]
        left = np.hypot(*(motion - (flat @ found).reshape(-1, 2)).T)
    return left


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--set", choices=["mini_markers", "dots427"])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--scale", type=float, metavar="MM_PER_PX", help="handed on (default: left to the fit)")
    parser.add_argument("--few", type=int, metavar="N", help="so many to fit, spread over all of these (default: all)")
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--dots", metavar="SENSOR.toml|symmetric")
    options = parser.parse_args()
    if options.dots == "symmetric":
        every, moves = symmetric_errors(options.photos)
        print(f"{len(moves)} dots near a contact moved {MOVED_PX:g} px or more, median {np.median(moves):.2f} px; of that is left:")
        for name, errors in every.items():
            print(f"{name}: {np.median(errors):.2f} px")
    elif options.dots:
        for name, dragged in (("place and depth", False), ("place, depth and drag", True)):
            errors, moves = dot_errors(options.photos, Path(options.dots), dragged)
            said = f"median error {np.median(errors):.2f} px of {np.median(moves):.2f} px of motion"
            print(f"{name} found: {len(errors)} dots moved {MOVED_PX:g} px or more: {said}")
    else:
        write_folder(options.data, options.set, options.out, options.scale, options.few)


if __name__ == "__main__":
    main()
