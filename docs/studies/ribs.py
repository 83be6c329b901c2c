"""Ribs of a real part beside those of a drawn one: a screw on the sensor of `dots427`, a thread of its pitch by the fitted sensor.

    python docs/studies/ribs.py --data ../shared/real --sensor out/dots/dots.toml --out out/ribs

Nobody says which screw `other_2` shows. Drawn is one of 24 turns an inch, 4.8 mm thick; place, turn and depth are read from the photograph
by eye. OUT/ribs.png shows both; printed is the distance of the ribs in each, the strongest wave along the screw. The photographs
carry no licence: nothing made from them stays in this repository.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import gelsim
from gelsim.bench.mesh_parts import mesh_file
from gelsim.calibrate.photos import read_photos
from gelsim.calibrate.pictures import draw_comparison
from gelsim.optics.camera import seen_places
from gelsim.scene.layers import build_scene
from gelsim.units import MM

THREAD = f"thread 2.4 {25.4 / 24:.4f}"
TURN_DEG, DEPTH_MM = -16.0, 0.8
MIDDLE, ENDS = (226, 158), ((120.0, 190.0), (330.0, 128.0))
"""Of the screw in the photograph: where it touches, and the line along it (column, row) [px]."""
BESIDE = (-8, -4, 0, 4, 8)
"""Lines beside that one, whose distances are averaged [px]."""


def spacing(change: NDArray[np.float64], ends: NDArray[np.float64]) -> float:
    """Distance of the ribs [px] in a picture's change from rest, (H, W, 3), along a line (2, 2) (column, row)."""
    (x0, y0), (x1, y1) = ends
    length = float(np.hypot(x1 - x0, y1 - y0))
    along = np.arange(0.0, length, 0.5)
    found = []
    for beside in BESIDE:
        x = x0 + (x1 - x0) * along / length - beside * (y1 - y0) / length
        y = y0 + (y1 - y0) * along / length + beside * (x1 - x0) / length
        red, green, _ = (ndimage.map_coordinates(change[..., colour], [y, x], order=1) for colour in range(3))
        wave = red - green - ndimage.gaussian_filter1d(red - green, 30)
        power, pitch = np.abs(np.fft.rfft(wave * np.hanning(len(wave)), 2**14)), 1 / np.maximum(np.fft.rfftfreq(2**14, 0.5), 1e-6)
        within = (pitch > 8) & (pitch < 40)
        found.append(pitch[within][power[within].argmax()])
    return float(np.mean(found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--sensor", required=True, metavar="FILE.toml", help="fitted to dots427 by `gelsim calibrate`")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    body = {
        "shape": "mesh",
        "mesh": str(mesh_file(THREAD, options.out)),
        "mesh_unit": "mm",
        "rigid": True,
        "rotation_deg": [0.0, 0.0, TURN_DEG],
    }
    for name in ("no_contact.jpg", "other_2.jpg"):
        shutil.copyfile(options.data / "dots427" / name, options.out / name)
    (options.out / "photos.toml").write_text('no_contact = "no_contact.jpg"\nmarkers = true\n', encoding="utf-8")
    (options.out / "presses.csv").write_text("file,radius_mm\nother_2.jpg,1\n", encoding="utf-8")
    read = read_photos(options.out)  # as the sensor was fitted: without the lens's distortion
    photos, size = [read.no_contact, read.pictures[0]], read.size
    assert read.lens is not None
    middle, *ends = read.lens.straight(np.array([MIDDLE, *ENDS], float))
    layers = {"sensor": {"preset": options.sensor}, "object": body}, {"render": {"mode": "path", "spp": 64, "resolution": list(size)}}
    place = (seen_places(build_scene(*layers), middle[None])[0] / MM).tolist()
    press = {"depth_mm": DEPTH_MM, "force_n": "none", "frames": 2, "offset_mm": place}
    _, frames = gelsim.simulate(build_scene(*layers, {"press": press}))
    drawn = [frame.image.astype(float) for frame in (frames[0], frames[-1])]
    for name, (rest, pressed) in (("the photograph", photos), ("the thread, drawn", drawn)):
        print(f"ribs of {name}: every {spacing(pressed - rest, np.array(ends)):.1f} px")
    draw_comparison(
        options.out / "ribs.png", (("photograph", photos), ("drawn", drawn)), ("without contact", "a screw; a thread of 24 turns an inch")
    )


if __name__ == "__main__":
    main()
