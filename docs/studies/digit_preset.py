"""The preset `digit` from photographs of one, and beside them.

    git clone https://github.com/vocdex/digit-depth
    python docs/studies/digit_preset.py --clone digit-depth --out out/digit_photos
    gelsim calibrate --photos out/digit_photos --sensor digit --out out/digit/fitted.toml
    python docs/studies/digit_preset.py --sensor out/digit/fitted.toml --write assets/sensors/digit.toml
    python docs/studies/digit_preset.py --photos out/digit_photos --preset digit     # resting picture and colours of dents, in numbers

Photographs: the 14 of a ball of 6 mm in that repository's history (Avezov et al. 2022; MIT by its setup.py), 240 x 320 px upright, as
`digit-interface` turns what the camera sees; their middles and the scale, 17.04 px/mm, are its owners'. There is none without contact: the
median of those that are fitted takes its place (one that held test presses too would hold their noise: SSIM 0.925 for 0.914). Every third
is for testing. The pad is that of the maker's CAD files (facebookresearch/digit-design:
`Digit Gel.STEP`, `Acrylic_Final.STEP`): 2.07 mm thick in the middle above 6.15 mm of acrylic; about its middle a curvature of 1/21.6 mm
across and 1/62 to 1/86 mm along, here a dome of their mean. `--write` turns the sensor back, so that x runs along the pad as in the camera,
and puts 30 numbers for the photograph (`mini_preset.smooth_rest`): none of the pictures is handed on.
"""

from __future__ import annotations

import argparse
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
from mini_preset import smooth_rest
from PIL import Image

from gelsim import optics
from gelsim.calibrate.photos import read_photos
from gelsim.calibrate.preset import write_preset
from gelsim.membrane.surface import rest_membrane
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene

COMMIT, COUNT = "2acf872", 14
NOISE = (1.0, 1.0, 2.1)
"""Standard deviations of that DIGIT's camera [levels], as `--photos` says."""
DISTANCE_MM = 22.0
"""Of the camera, as in TACTO's config_digit.yml. The photographs do not tell it (test presses: squared error 19.0 so, 18.6 as fitted)."""
SETTINGS = """ball_radius_mm = 3.0
mm_per_px = 0.0587
no_contact = "no_contact.png"

[gel]
profile = "dome"
size_mm = [18.8, 18.8]
thickness_mm = 2.07
edge_thickness_mm = 0.7
"""
HEAD = """digit: DIGIT (Lambeta et al., RA-L 2020). Lamps, coat and rest are those of one DIGIT, fitted to 10 photographs of a
ball (by the commands of docs/studies/digit_preset.py); what is not determined by them is near its start, and lamps are those that explain
dents, not the sensor's own (docs/calibrate.md), which are three RGB LEDs of 1.6 mm, 625, 530 and 470 nm, at the acrylic's edge
(facebookresearch/digit-design, flex 2021-2). Pad and window: its CAD files; about the middle it is curved by 1/21.6 mm across and 1/62 to
1/86 mm along, here a dome of the mean, as large as the picture (the pad is 25.2 x 18.4 mm). The scale is the photographer's, 17.04 px/mm.
The picture's x runs along the pad, as the camera delivers it; digit-interface turns it upright. Hardness is chosen: none is published."""


def write_folder(clone: Path, out: Path) -> None:
    def file(name: str) -> bytes:
        return subprocess.run(["git", "-C", str(clone), "show", f"{COMMIT}:{name}"], check=True, capture_output=True).stdout

    out.mkdir(parents=True, exist_ok=True)
    lines, fitted = ["file,col_px,row_px,split"], []
    for number, row in enumerate(file("csv/sphere.csv").decode().splitlines()[1:]):
        name, column, line, _ = row.split(",")
        picture, split = out / Path(name).name, "test" if number % 3 == 2 else "train"
        picture.write_bytes(file(name.lstrip("/")))
        lines.append(f"{picture.name},{column},{line},{split}")
        fitted += [picture] if split == "train" else []
    (out / "presses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    stack = [np.asarray(Image.open(path).convert("RGB"), float) for path in fitted]
    Image.fromarray(np.rint(np.median(stack, axis=0)).astype(np.uint8)).save(out / "no_contact.png")
    (out / "photos.toml").write_text(SETTINGS, encoding="utf-8")


def preset_of(fitted: Scene) -> Scene:
    """The fitted sensor turned by a right angle, clockwise as pictures are seen: x and y become -y and x."""

    def turned(pair: tuple[float, ...]) -> tuple[float, ...]:
        return (-pair[1], pair[0], *pair[2:])

    lamps = tuple(
        replace(light, position_mm=turned(light.position_mm), direction=turned(light.direction))
        for light in fitted.lights.lights
        if light.power > 0
    )
    camera = replace(
        fitted.camera,
        resolution=fitted.camera.resolution[::-1],
        field_mm=fitted.camera.field_mm[::-1],
        distance_mm=DISTANCE_MM,
        offset_mm=(0.0, 0.0),
        tilt_deg=(0.0, 0.0),
        rest=None,
        rest_smooth=smooth_rest(fitted, turns=-1),
        fps=60.0,
        noise_sd=NOISE,
    )
    gel = replace(fitted.gel, shore_00=None, shore_a=20.0)
    return fitted.replace(gel=gel, camera=camera, lights=replace(fitted.lights, lights=lamps))


def beside(folder: Path, preset: str) -> None:
    """Numbers of the preset, upright, and of the photographs."""
    photos = read_photos(folder)
    print("noise of the photographs [levels]:", np.round(noise_of(folder), 1))
    scene = build_scene({"sensor": {"preset": preset}, "render": {"spp": 64}, "camera": {"noise_sd": [0, 0, 0]}})
    (frame,) = optics.render_frames(scene, [rest_membrane(scene)])
    drawn = np.rot90(frame.image.astype(float))
    if drawn.shape != photos.no_contact.shape:
        drawn = np.asarray(Image.fromarray(drawn.astype(np.uint8)).resize(photos.size, Image.Resampling.BOX), float)
    flat = photos.no_contact.mean(axis=(0, 1))
    errors = [((picture - photos.no_contact) ** 2).mean() for picture in (drawn, flat)]
    print(f"against the real rest: MSE {errors[0]:.0f}; its mean colour: {errors[1]:.0f}")


def noise_of(folder: Path) -> np.ndarray:
    """Standard deviation of a photograph about the median of all, by neighbouring pixels far from any dent."""
    photos = read_photos(folder)
    left = photos.pictures - photos.no_contact
    return 1.4826 * np.median(np.abs(np.diff(left, axis=2)), axis=(0, 1, 2)) / np.sqrt(2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clone", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--sensor", type=Path)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--preset", default="digit")
    options = parser.parse_args()
    if options.clone:
        write_folder(options.clone, options.out)
    elif options.write:
        write_preset(options.write, preset_of(build_scene({"sensor": {"preset": str(options.sensor)}})), HEAD.splitlines())
    else:
        beside(options.photos, options.preset)


if __name__ == "__main__":
    main()
