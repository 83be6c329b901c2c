"""Smooth soft objects that hardly any friction holds, pressed with contact's points on the gel and with twelve a face on the object.

    python docs/studies/slippery.py [--friction 0] [--draws 1] [SCENE ...]

Each scene is solved by either try alone (`fem.strategy.PLAIN`, `SLIDING`), in a process that is ended after --limit seconds. With --draws N
each is meshed N times anew: fTetWild draws an object's mesh by lot, and which of them a tip slides on is the question.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from typing import Any

Layer = dict[str, Any]
SCENES: dict[str, tuple[Layer, Layer, Layer]] = {  # object, press, the rest
    "whole body": (
        {"shape": "hemisphere", "youngs_modulus_kpa": 200.0, "poissons_ratio": 0.499},
        {"frames": 11, "symmetry": "none"},
        {"gel": {"profile": "flat", "youngs_modulus_kpa": 50.0, "poissons_ratio": 0.499}, "fidelity": "balanced"},
    ),
    "50 kPa, tilted": ({"shape": "hemisphere", "youngs_modulus_kpa": 50.0}, {"tilt_deg": [10.0, 5.0]}, {}),
    "beside the middle": ({"shape": "hemisphere", "shore_00": 40.0}, {"offset_mm": [3.0, 2.0]}, {}),
    "R 2.5, deep": ({"shape": "hemisphere", "radius_mm": 2.5, "shore_00": 20.0}, {"depth_mm": 1.5, "tilt_deg": [5.0, 3.0]}, {}),
    "R 12": ({"shape": "hemisphere", "radius_mm": 12.0, "shore_00": 50.0}, {"tilt_deg": [8.0, 4.0]}, {}),
    "torus": ({"shape": "torus", "shore_00": 30.0}, {"tilt_deg": [6.0, 4.0]}, {}),
    "tomato": ({"shape": "tomato", "shore_00": 30.0}, {"tilt_deg": [6.0, 4.0]}, {}),
    "shell": ({"shape": "shell", "shore_00": 45.0}, {"tilt_deg": [6.0, 4.0]}, {}),
    "00-08, deep": ({"shape": "hemisphere", "shore_00": 8.0}, {"depth_mm": 3.0, "tilt_deg": [5.0, 0.0]}, {}),
    "sheared": ({"shape": "hemisphere", "shore_00": 30.0}, {"shear_mm": [1.0, 0.5]}, {}),
    "flat gel": ({"shape": "hemisphere", "shore_00": 30.0}, {"tilt_deg": [5.0, 3.0]}, {"gel": {"profile": "flat"}}),
}


def solve(name: str, way: str, friction: float) -> str:
    """A row's cells: how far, force, area, iterations, factorisations, seconds of the solve."""
    from gelsim.fem import strategy
    from gelsim.pipeline import stages
    from gelsim.scene.layers import build_scene

    body, press, rest = SCENES[name]
    strategy.ways = lambda *_: [strategy.SLIDING if way == "object" else strategy.PLAIN]
    layer = {"object": body, "press": {"depth_mm": 1.0, "force_n": "none", "frames": 6} | press, "fidelity": "fast"}
    scene = build_scene(layer | {"contact": {"friction_coefficient": friction}, "gel": {"youngs_modulus_kpa": 50.0}} | rest)
    stages.bodies(scene)
    start = time.perf_counter()
    done = stages.press(scene, device="cpu", throw=False)
    wanted = scene.press.depth_mm or 0.0
    reached = "end" if not done.lost else f"{1e3 * done.approach[-1]:.2f} of {wanted:g} mm"
    numbers = (
        f"{-done.force[-1, 2]:.4f} | {1e6 * done.contact_area[-1]:.2f} | {done.newton_iterations.sum()}, {done.info['factorisations']}"
    )
    return f"{reached} | {numbers} | {time.perf_counter() - start:.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="of: " + "; ".join(SCENES))
    parser.add_argument("--friction", type=float, default=0.0)
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--limit", type=float, default=90.0, help="seconds of one press")
    parser.add_argument("--way", choices=("gel", "object"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        print(solve(options.scenes[0], options.way, options.friction))
        return
    print(
        "| scene | points on | reached | force [N] | contact [mm²] | iterations, factorisations | seconds |\n|---|---|---|---|---|---|---|"
    )
    for name in options.scenes or SCENES:
        for _ in range(options.draws):
            with tempfile.TemporaryDirectory() as cache:
                for way in ("gel", "object"):
                    again = [sys.executable, __file__, name, "--friction", str(options.friction), "--way", way]
                    environment = os.environ | ({"GELSIM_CACHE": cache} if options.draws > 1 else {})
                    try:
                        done = subprocess.run(again, capture_output=True, text=True, timeout=options.limit, env=environment, check=True)
                        cells = done.stdout.strip().splitlines()[-1]
                    except subprocess.TimeoutExpired:
                        cells = f"not within {options.limit:g} s | – | – | – | –"
                    print(f"| {name} | {way} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
