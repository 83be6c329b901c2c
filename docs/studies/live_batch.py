"""How many frames a second do many live sensors give at once (`gelsim.LiveBatch`), and how much of the memory's bandwidth is that?

    python docs/studies/live_batch.py [--device cuda] [--sensors 64 256 1024] [--soft] [--profile PROFILE.txt]

Balls of R 7 mm, rigid or of Shore 00-30, are pressed by steps of 20 µm, each at its own place, then drawn along, with friction 0.5 on gels
of 128 × 128 cells; rates are of the second half of both, after a first walk. Least bytes: what the layer's products alone read and write if
each field passes once (forward FFT, product, FFT back), over the time; beside it a large copy's.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch

from gelsim.bench.report import table
from gelsim.bench.section import Row
from gelsim.fem.batch import copy_bandwidth
from gelsim.live.batch import LiveBatch
from gelsim.live.batch_layer import Layers, Ways
from gelsim.scene.layers import build_scene

WALK = 20
REALS = {"sunk": 6.5, "dragged": 13.5, "moved": 21.0, "lifted": 10.0}
"""Fields of the grid that each product reads and writes at least; half of the waves are as much as all cells."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--sensors", type=int, nargs="+", default=[64, 256, 1024])
    parser.add_argument("--no-pictures", dest="pictures", action="store_false")
    parser.add_argument("--soft", action="store_true")
    parser.add_argument("--profile", help="file for PyTorch's profile of a step of the most sensors")
    args = parser.parse_args()
    moved = {"bytes": 0.0}

    def counted(name: str) -> None:
        real = getattr(Layers, name)

        def product(self: Layers, ways: Ways, *tractions: torch.Tensor) -> torch.Tensor:
            moved["bytes"] += REALS[name] * 4 * len(ways.answers) * self.shape[0] * self.shape[1]
            return real(self, ways, *tractions)

        setattr(Layers, name, product)

    for name in REALS:
        counted(name)
    rows = []
    for sensors in args.sensors:
        for pictures in (False, True)[: 1 + args.pictures]:
            rows.append(measured(sensors, pictures, args.device, args.soft, moved))
            print(rows[-1], flush=True)
    kind = "cpu" if rows[0]["device"] == "cpu" else torch.cuda.get_device_name()
    print("\n".join(table(tuple((name, name) for name in rows[0] if name != "device"), rows)))
    print(f"{kind}; a copy: {copy_bandwidth(rows[0]['device']) / 1e9:.0f} GB/s")
    if args.profile:
        batch, walk = made(args.sensors[-1], False, args.device, args.soft)
        for poses in walk[:10]:
            batch.step(poses, 0.01)
        with torch.profiler.profile() as profile:
            batch.step(walk[10], 0.01)
            wait(batch)
        by = "self_cuda_time_total" if batch.device != "cpu" else "self_cpu_time_total"
        with open(args.profile, "w", encoding="utf-8") as file:
            file.write(profile.key_averages().table(sort_by=by, row_limit=40))


def made(sensors: int, pictures: bool, device: str, soft: bool) -> tuple[LiveBatch, list[torch.Tensor]]:
    """A batch, and poses (sensors, 1, 7) step by step, on its device."""
    scene = build_scene({
        "gel": {"profile": "flat", "thickness_mm": 2.4, "size_mm": [25.6, 25.6]},
        "object": {"shape": "hemisphere", "radius_mm": 7.0, "height_mm": 10.0} | ({"shore_00": 30.0} if soft else {"rigid": True}),
        "contact": {"friction_coefficient": 0.5},
        "render": {"resolution": [160, 120]},
    })  # fmt: skip
    batch = LiveBatch(scene, sensors, image=pictures, device=device)
    rng, walk = np.random.default_rng(0), []
    first, way = rng.uniform(-5e-3, 5e-3, (sensors, 2)), rng.uniform(0, 2 * np.pi, sensors)
    for step in range(2 * WALK):
        down, aside = min(step + 1, WALK) * 20e-6, max(step + 1 - WALK, 0) * 20e-6
        poses = np.zeros((sensors, 1, 7))
        poses[:, 0, :2] = first + aside * np.stack([np.cos(way), np.sin(way)], 1)
        poses[:, 0, 2], poses[:, 0, 3] = -down, 1.0
        walk.append(torch.as_tensor(poses, device=batch.device))
    return batch, walk


def wait(batch: LiveBatch) -> None:
    if batch.device != "cpu":
        torch.cuda.synchronize()


def measured(sensors: int, pictures: bool, device: str, soft: bool, moved: dict[str, float]) -> Row:
    batch, walk = made(sensors, pictures, device, soft)
    seconds, counted = 0.0, 0.0
    for turn in range(2):
        batch.reset()
        for step, poses in enumerate(walk):
            wait(batch)
            began, moved["bytes"] = time.perf_counter(), 0.0
            frame = batch.step(poses, 0.02)
            if pictures:
                _ = frame.image, frame.marker_pixels
            wait(batch)
            if turn and step % WALK >= WALK // 2:
                seconds += time.perf_counter() - began
                counted += moved["bytes"]
    return {
        "device": batch.device,
        "sensors": sensors,
        "pictures": "160 × 120, markers" if pictures else "none",
        "frames a second": round(WALK * sensors / seconds),
        "ms a step": round(1e3 * seconds / WALK, 1),
        "least GB/s": round(counted / seconds / 1e9, 1),
    }


if __name__ == "__main__":
    main()
