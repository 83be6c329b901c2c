"""Is a press that goes on to turn or to slide read as the press alone? Simulated presses that nothing was trained on, read to both ends.

    python docs/studies/turned.py [--presses 12]

Each is pressed to 0.8 or 1.2 mm, then turned by 25 degrees, or slid by 0.8 mm, in its place; the sensor is that of the paper. Prints each
reading, and how far those of the whole videos lie from those of the presses alone.
"""

import argparse

import numpy as np
from framings import read

import gelsim
from gelsim.scene.layers import build_scene
from learn.framing import Framing

FRAMES = 16  # of the press, and as many of what follows
BODIES = (
    {"shape": "hemisphere", "radius_mm": 6.0},
    {"shape": "hemisphere", "radius_mm": 15.0},
    {"shape": "cylinder", "radius_mm": 8.0, "length_mm": 14.0},
    {"shape": "box", "width_mm": 7.0, "length_mm": 5.0, "height_mm": 15.0},
)
SHORES = (20.0, 45.0, 70.0)
WAYS = ({"twist_deg": 25.0}, {"shear_mm": [0.8, 0.0]})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presses", type=int, default=12)
    options = parser.parse_args()
    away = []
    for number in range(options.presses):
        body = BODIES[number % len(BODIES)] | {"shore_00": SHORES[number // len(BODIES) % len(SHORES)]}
        further, depth = WAYS[(number + number // len(BODIES)) % 2], (0.8, 1.2, 0.8)[number % 3]
        press = {"path": [{"depth_mm": depth}, {"depth_mm": depth, **further}], "frames": 2 * FRAMES + 1}
        scene = build_scene({"object": body, "press": press, "fidelity": "fast", "render": {"mode": "baked"}})
        _, frames = gelsim.simulate(scene)
        pictures = [frame.image for frame in frames]
        readings = [read(some, Framing(), "fingertip2017") for some in (pictures[: FRAMES + 1], pictures)]
        away.append(abs(readings[1] - readings[0]))
        print(f"{body['shape']} 00-{body['shore_00']:g}, {depth} mm, then {further}: {readings[0]:.1f}; {readings[1]:.1f}", flush=True)
    print(f"median {np.nanmedian(away):.1f}, 90 % {np.nanpercentile(away, 90):.1f}, no reading {int(np.isnan(away).sum())}")


if __name__ == "__main__":
    main()
