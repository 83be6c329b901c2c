"""What does an error cost, from the baked gel to `reference`? One sheared rigid ball and one tilted rigid cylinder at every fidelity, and
balls that go as deep as `live` takes them, 0.6 of the gel, at `live` alone.

    OMP_NUM_THREADS=1 python docs/studies/live_speed.py [--out docs/images/live_speed.png]

Errors are against `reference` at the deepest state: of the force, the length of the difference over its length; of the height, root mean
square over places within 1.5 contact radii; of the contact area. Seconds are processor time of the press, meshes included, after a
first press that loads what is loaded once.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from gelsim.bench.live import heights_over
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.layers import Layer, build_scene

FIDELITIES = ("live", "fast", "balanced", "reference")
BASE: Layer = {
    "gel": {"profile": "flat", "thickness_mm": 2.4},
    "object": {"rigid": True},
    "contact": {"friction_coefficient": 0.5},
    "press": {"depth_mm": 0.6, "frames": 5},
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


def errors(press: Deformation, truth: Deformation) -> tuple[float, float, float]:
    """Of the force [%], of the height [µm], and of the area, with its sign [%]."""
    weight = np.maximum(truth.contact_pressure[-1], 0.0)
    middle = (weight[:, None] * truth.gel.rest[:, :2]).sum(axis=0) / weight.sum()
    radius = 1.5 * np.sqrt(truth.contact_area[-1] / np.pi)
    points = middle + radius * (2 * np.random.default_rng(0).random((2000, 2)) - 1)
    points = points[np.hypot(*(points - middle).T) < radius]
    points = points[(np.abs(points) < np.abs(truth.gel.rest[:, :2]).max(axis=0)).all(axis=1)]
    apart = heights_over(press, -1, points) - heights_over(truth, -1, points)
    off = np.linalg.norm(press.force[-1] - truth.force[-1]) / np.linalg.norm(truth.force[-1])
    wider = press.contact_area[-1] / truth.contact_area[-1] - 1
    return 100 * off, 1e6 * float(np.sqrt(np.mean(apart**2))), 100 * wider


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="where a plot is drawn")
    options = parser.parse_args()
    rows = []
    for name, layer in (PRESSES | DEEP).items():
        scene, asked = build_scene(BASE, layer), FIDELITIES if name in PRESSES else ("live", "reference")
        pressed(scene, "live")
        found = {fidelity: pressed(scene, fidelity) for fidelity in asked}
        for fidelity in asked:
            press, seconds = found[fidelity]
            rows.append((name, fidelity, seconds, *errors(press, found["reference"][0])))
            print("{}, {}: {:.2f} s, force {:.2f} %, height {:.2f} um, area {:+.1f} %".format(*rows[-1]), flush=True)
    if options.out:
        import matplotlib.pyplot as plt
        from matplotlib.ticker import NullFormatter

        figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), sharex=True)
        for name in PRESSES:
            mine = [row for row in rows if row[0] == name and row[1] != "reference"]
            for axis, place, title in zip(axes, (3, 4), ("force off [%]", "height off [µm]"), strict=True):
                axis.loglog([row[2] for row in mine], [row[place] for row in mine], "o-", label=name)
                axis.set(xlabel="processor time [s]", ylabel=title)
                axis.margins(0.15)
                axis.xaxis.set_minor_formatter(NullFormatter())
                axis.yaxis.set_minor_formatter(NullFormatter())
                for row in mine:
                    axis.annotate(row[1], (row[2], row[place]), textcoords="offset points", xytext=(4, 4), fontsize=8)
        axes[0].legend(fontsize=7)
        figure.tight_layout()
        figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
