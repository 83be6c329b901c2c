"""The presets of the GelSight Mini from a fitted one, and beside real photographs.

    python docs/studies/real_photos.py --data ../shared/real --set mini_markers --scale 0.058 --out out/mini_photos
    gelsim calibrate --photos out/mini_photos --sensor gelsight_mini --out out/mini/mini.toml
    python docs/studies/mini_preset.py --sensor out/mini/mini.toml --write assets/sensors
    python docs/studies/mini_preset.py --data ../shared/real --out out/mini_preset

`--write`: lamps, coat, camera and dots are those of the fitted sensor; its photograph becomes 30 numbers, least squares of the logarithm
of its even part (`optics.rest`), so nothing of the picture is handed on. `--data`: the presets' pictures without contact beside the real
one, and of the first test presses, whose place and depth are found from their photographs; mean squared errors, also of the real picture's
mean colour. The photographs carry no licence: what is drawn stays in `--out`.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelsim import optics
from gelsim.calibrate import comparison, pictures
from gelsim.calibrate.photos import read_photos
from gelsim.calibrate.preset import write_preset
from gelsim.membrane.surface import rest_membrane
from gelsim.optics.rest import rest_pictures, smooth_basis
from gelsim.scene.definition import Markers, Scene
from gelsim.scene.layers import build_scene

PRESETS = ("gelsight_mini", "gelsight_mini_markers")
SHOWN = 5
"""Presses."""
DEGREE = 3
GEL = 275.0
"""Young's modulus [kPa]: quoted for this gel from 140 to 840; that of XP-565 at Shore 00-60 (Burgess et al. 2024)."""
NOISE = (2.0, 1.4, 2.5)
"""Standard deviations of a Mini's camera [levels], measured."""
HEAD = """{name}: GelSight Mini {kind}, gel by the maker's data sheet. Lamps, coat, camera and rest are those of
one Mini, fitted to 15 photographs of a pressed ball (by the commands of docs/studies/mini_preset.py); what is not
determined by them is near its start, and lamps are those that explain dents, not the sensor's own (docs/calibrate.md).
The gel's modulus is quoted from 140 to 840 kPa. The noise is measured. The scale, 0.058 mm a pixel of 320, is the data sheet's field."""


def smooth_rest(fitted: Scene, turns: int = 0) -> tuple[float, ...]:
    """`camera.rest_smooth` of a fitted sensor's photograph, turned by so many right angles, counterclockwise."""
    size = fitted.camera.resolution
    _, even = rest_pictures(fitted.replace(render=replace(fitted.render, resolution=size)))
    even = np.rot90(even, turns)
    logs = np.log(np.maximum(even, 1.0) / 255).reshape(-1, 3)
    numbers = np.linalg.lstsq(smooth_basis((even.shape[1], even.shape[0]), DEGREE), logs, rcond=None)[0]
    return tuple(float(f"{x:.4g}") for x in numbers.ravel())


def presets_of(fitted: Scene) -> dict[str, Scene]:
    """Both presets, without a photograph."""
    camera = replace(fitted.camera, rest=None, rest_smooth=smooth_rest(fitted), fps=25.0, noise_sd=NOISE)
    scene = fitted.replace(camera=camera, gel=replace(fitted.gel, shore_00=None, youngs_modulus_kpa=GEL))
    return dict(zip(PRESETS, (scene.replace(markers=Markers(layout="none")), scene), strict=True))


def show(data: Path, photos_folder: Path, out: Path) -> None:
    photos = read_photos(photos_folder)
    flat = np.broadcast_to(photos.no_contact.mean(axis=(0, 1)), photos.no_contact.shape)
    columns, captions = [("photograph", [photos.no_contact])], ["without contact"]
    for name in PRESETS:
        scene = build_scene(
            {"sensor": {"preset": name}, "render": {"resolution": list(photos.size), "spp": 64}, "camera": {"noise_sd": [0, 0, 0]}}
        )
        (frame,) = optics.render_frames(scene, [rest_membrane(scene)])
        columns.append((name, [frame.image.astype(float)]))
        print(f"{name} against the real rest: MSE {((frame.image - photos.no_contact) ** 2).mean():.0f}")
    print(f"its mean colour: MSE {((flat - photos.no_contact) ** 2).mean():.0f}")
    out.mkdir(parents=True, exist_ok=True)
    pictures.draw_comparison(out / "rest.png", [*columns, ("mean colour", [flat])], captions)
    for name in PRESETS:
        report = comparison.compare(photos_folder, out / name, comparison.Drawing(name), force=True)
        print(f"{name}, {len(report['presses'])} presses:", comparison.summary(report), sep="\n")


def few_photos(data: Path, out: Path) -> Path:
    """A folder of the first test presses."""
    import shutil

    source, folder = data / "mini_markers", out / "photos"
    folder.mkdir(parents=True, exist_ok=True)
    with (source / "contacts.csv").open(encoding="utf-8") as file:
        names = [row["file"] for row in csv.DictReader(file) if row["half"] == "test"][:SHOWN]
    for name in ("no_contact.png", *names):
        shutil.copyfile(source / name, folder / name)
    (folder / "photos.toml").write_text('ball_radius_mm = 2.5\nno_contact = "no_contact.png"\n', encoding="utf-8")
    (folder / "presses.csv").write_text("file\n" + "\n".join(names) + "\n", encoding="utf-8")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensor", type=Path, metavar="SENSOR.toml")
    parser.add_argument("--write", type=Path, metavar="DIR")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.write:
        for name, scene in presets_of(build_scene({"sensor": {"preset": str(options.sensor)}})).items():
            kind = "with printed markers" if scene.markers.layout == "grid" else "without markers"
            write_preset(options.write / f"{name}.toml", scene, HEAD.format(name=name, kind=kind).splitlines())
    else:
        show(options.data, few_photos(options.data, options.out), options.out)


if __name__ == "__main__":
    main()
