"""What a pose of a rigid part costs where one process presses many: seconds, and where they go.

    OMP_NUM_THREADS=2 python docs/studies/poses.py [--poses 100]

A ball of R 4 mm on the dome, at `fast`, two states to 0.4 mm; offsets of up to 3 mm and tilts of up to 5° are drawn.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from gelsim.pipeline import poses, stages
from gelsim.scene.layers import build_scene, nested

BALL = {"object": {"shape": "hemisphere", "radius_mm": 4.0, "rigid": True}, "press": {"depth_mm": 0.4, "frames": 2}, "fidelity": "fast"}


def main(count: int) -> None:
    """Prints means over the poses, but for one before them that compiles and samples."""
    rng = np.random.default_rng(0)
    scene, spent = build_scene(BALL), []
    for _ in range(count + 1):
        pose = {"press.offset_mm": rng.uniform(-3.0, 3.0, 2).tolist(), "press.tilt_deg": rng.uniform(-5.0, 5.0, 2).tolist()}
        record, wall, processor = stages.Record(), time.perf_counter(), time.process_time()
        press = stages.press(poses.posed(scene, nested(pose)), device="cpu", record=record)
        took = time.perf_counter() - wall, time.process_time() - processor
        spent.append((*took, record.seconds["mesh"], record.seconds["press"], press.newton_iterations.sum(), press.info["unknowns"]))
    names = ("seconds", "of two processors", "mesh and first touch", "press", "iterations", "unknowns")
    for name, mean in zip(names, np.mean(spent[1:], axis=0), strict=True):
        print(f"{name:<22} {mean:8.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=100)
    main(parser.parse_args().poses)
