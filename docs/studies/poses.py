"""What a pose of a rigid part costs where many are pressed: in one process, where the time goes; and shared by workers.

    OMP_NUM_THREADS=1 python docs/studies/poses.py [--poses 100] [--workers 2] [--mesh assets/meshes/hex_nut.stl]

A ball of R 4 mm on the dome, or a part turned about z, at `fast`, two states to 0.4 mm; offsets of up to 3 mm and tilts of up to 5° are
drawn.
"""

from __future__ import annotations

import argparse
import os
import time
from typing import Any

import numpy as np

import gelsim
from gelsim.pipeline import poses, stages
from gelsim.scene.layers import build_scene, nested

BALL = {"shape": "hemisphere", "radius_mm": 4.0, "rigid": True}


def main(count: int, workers: int, mesh: str | None) -> None:
    """Prints means over the poses, but for one before them that compiles and samples; the workers' with their start."""
    rng = np.random.default_rng(0)
    part = {"mesh": mesh, "rigid": True} if mesh else BALL
    scene = build_scene({"object": part, "press": {"depth_mm": 0.4, "frames": 2}, "fidelity": "fast"})
    drawn: list[dict[str, Any]] = []
    for _ in range(count + 1):
        drawn.append({"press.offset_mm": rng.uniform(-3.0, 3.0, 2).tolist(), "press.tilt_deg": rng.uniform(-5.0, 5.0, 2).tolist()})
        if mesh:
            drawn[-1]["object.rotation_deg"] = [0.0, 0.0, float(rng.uniform(0.0, 360.0))]
    spent = []
    for pose in drawn:
        record, wall, processor = stages.Record(), time.perf_counter(), time.process_time()
        press = stages.press(poses.posed(scene, nested(pose)), device="cpu", record=record, throw=False)
        took = time.perf_counter() - wall, time.process_time() - processor
        spent.append((*took, record.seconds["mesh"], record.seconds["press"], press.newton_iterations.sum(), press.report.unknowns))
    names = ("seconds", "of processors", "mesh and first touch", "press", "iterations", "unknowns")
    for name, mean in zip(names, np.mean(spent[1:], axis=0), strict=True):
        print(f"{name:<22} {mean:8.2f}")
    wall, processor = time.perf_counter(), sum(os.times()[:4])
    gelsim.press_many(scene, drawn[1:], device="cpu", workers=workers)
    took = time.perf_counter() - wall, sum(os.times()[:4]) - processor
    print(f"by {workers} workers           {took[0] / count:8.2f}, of processors {took[1] / count:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--mesh")
    options = parser.parse_args()
    main(options.poses, options.workers, options.mesh)
