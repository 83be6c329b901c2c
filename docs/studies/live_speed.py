"""What does an error cost, from the baked gel to `reference`? One sheared rigid ball, one tilted rigid cylinder and the ball of Taxim's
sensor on it at every fidelity, and balls that go as deep as `live` takes them, 0.6 of the gel, at `live` alone.

    git clone https://github.com/Robo-Touch/Taxim; pip install opencv-python-headless
    OMP_NUM_THREADS=1 python docs/studies/live_speed.py --taxim Taxim [--out docs/images/live_speed.png]

With `--taxim` its package presses its ball too: its own gel map and constants, the height map without the picture. It has no force.

Errors are against `reference` at the deepest state: of the force, the length of the difference over its length; of the height, root mean
square over places within 1.5 contact radii; of the contact area. Seconds are processor time of the press, meshes included, after a
first press that loads what is loaded once.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from beside_taxim import BALL_MM, TAXIM_PX_MM, Taxim
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from gelsim.bench.live import heights_over
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.layers import Layer, build_scene
from gelsim.shape.shapes import gel_height
from gelsim.units import MM

FIDELITIES = ("live", "fast", "balanced", "reference")
DEPTH_MM = 0.6
BASE: Layer = {
    "gel": {"profile": "flat", "thickness_mm": 2.4},
    "object": {"rigid": True},
    "contact": {"friction_coefficient": 0.5},
    "press": {"depth_mm": DEPTH_MM, "frames": 5},
}
PRESSES: dict[str, Layer] = {
    "ball R 5, sheared 0.3 mm": {
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 8.0},
        "press": {"shear_mm": [0.3, 0.0]},
    },
    "cylinder R 5, tilted 3 degrees": {
        "object": {"shape": "cylinder", "radius_mm": 5.0, "length_mm": 20.0, "height_mm": 8.0},
        "press": {"tilt_deg": [3.0, 0.0]},
    },
}
TAXIM = f"Taxim's ball, R {BALL_MM:g}"
ITS_BALL: Layer = {
    "sensor": {"preset": "taxim"},
    "object": {"shape": "hemisphere", "radius_mm": BALL_MM, "height_mm": BALL_MM, "rigid": True},
    "contact": {"friction_coefficient": 0.5},
    "press": {"depth_mm": DEPTH_MM, "frames": 5},
}
DEEP: dict[str, Layer] = {
    f"{name}, 1.44 mm deep": {
        "object": {"shape": "hemisphere", "radius_mm": radius, "height_mm": 12.0},
        "press": {"depth_mm": 1.44, "frames": 7, **press},
    }
    for name, radius, press in (("ball R 3", 3.0, {}), ("ball R 5 off centre", 5.0, {"offset_mm": [4.0, 3.0]}))
}


def pressed(scene: Scene, fidelity: str) -> tuple[Deformation, float]:
    """The press, and its processor seconds."""
    start = time.process_time()
    press = stages.press(scene.replace(fidelity=fidelity), device="cpu")
    return press, time.process_time() - start


def near(truth: Deformation) -> NDArray[np.float64]:
    """Places within 1.5 contact radii [m], (M, 2)."""
    weight = np.maximum(truth.contact_pressure[-1], 0.0)
    middle = (weight[:, None] * truth.gel.rest[:, :2]).sum(axis=0) / weight.sum()
    radius = 1.5 * np.sqrt(truth.contact_area[-1] / np.pi)
    points = middle + radius * (2 * np.random.default_rng(0).random((2000, 2)) - 1)
    points = points[np.hypot(*(points - middle).T) < radius]
    return points[(np.abs(points) < np.abs(truth.gel.rest[:, :2]).max(axis=0)).all(axis=1)]


def errors(press: Deformation, truth: Deformation) -> tuple[float, float, float]:
    """Of the force [%], of the height [µm], and of the area, with its sign [%]."""
    points = near(truth)
    apart = heights_over(press, -1, points) - heights_over(truth, -1, points)
    off = np.linalg.norm(press.force[-1] - truth.force[-1]) / np.linalg.norm(truth.force[-1])
    wider = press.contact_area[-1] / truth.contact_area[-1] - 1
    return 100 * off, 1e6 * float(np.sqrt(np.mean(apart**2))), 100 * wider


def taxims(clone: Path, truth: Deformation) -> tuple[float, float]:
    """Processor seconds and error of the height [µm] of Taxim's package."""
    with tempfile.TemporaryDirectory() as scratch:
        package = Taxim(clone, Path(scratch), np.zeros((120, 160, 3), np.uint8))
        package.dent(DEPTH_MM)
        start = time.process_time()
        dent = package.dent(DEPTH_MM)
        seconds = time.process_time() - start
    points = near(truth)
    column, row = (points / MM / TAXIM_PX_MM + [dent.shape[1] // 2, dent.shape[0] // 2]).T
    went = heights_over(truth, -1, points) - gel_height(build_scene(ITS_BALL).gel, points)
    apart = map_coordinates(dent, [row, column], order=1) * MM + went
    return seconds, 1e6 * float(np.sqrt(np.mean(apart**2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="where a plot is drawn")
    parser.add_argument("--taxim", type=Path, metavar="CLONE")
    options = parser.parse_args()
    rows, beside = [], None
    scenes = {name: build_scene(BASE, layer) for name, layer in (PRESSES | DEEP).items()} | {TAXIM: build_scene(ITS_BALL)}
    for name, scene in scenes.items():
        asked = ("live", "reference") if name in DEEP else FIDELITIES
        pressed(scene, "live")
        found = {fidelity: pressed(scene, fidelity) for fidelity in asked}
        for fidelity in asked:
            press, seconds = found[fidelity]
            rows.append((name, fidelity, seconds, *errors(press, found["reference"][0])))
            print("{}, {}: {:.2f} s, force {:.2f} %, height {:.2f} um, area {:+.1f} %".format(*rows[-1]), flush=True)
        if name == TAXIM and options.taxim:
            beside = taxims(options.taxim, found["reference"][0])
            print("{}, its package: {:.3f} s, height {:.2f} um".format(name, *beside))
    if options.out:
        import matplotlib.pyplot as plt
        from matplotlib.ticker import NullFormatter

        figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), sharex=True, layout="constrained")
        for name in [*PRESSES, TAXIM]:
            mine = [row for row in rows if row[0] == name and row[1] != "reference"]
            for axis, place, title in zip(axes, (3, 4), ("force off [%]", "height off [µm]"), strict=True):
                axis.loglog([row[2] for row in mine], [row[place] for row in mine], "o-", label=name)
                axis.set(xlabel="processor time [s]", ylabel=title)
                axis.margins(0.15)
                axis.xaxis.set_minor_formatter(NullFormatter())
                axis.yaxis.set_minor_formatter(NullFormatter())
                for row in mine:
                    below = (4, -10) if name == TAXIM else (4, 4)
                    axis.annotate(row[1], (row[2], row[place]), textcoords="offset points", xytext=below, fontsize=8)
        if beside:
            axes[1].plot(*beside, "xC2", markersize=8)
            axes[1].annotate("Taxim's package", beside, textcoords="offset points", xytext=(-4, 8), fontsize=8)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
        figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
