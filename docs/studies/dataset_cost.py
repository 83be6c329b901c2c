"""What an episode of a plan costs, in seconds of processor time by stage: presses solved and drawn one after the other in this process.

    python docs/studies/dataset_cost.py --plan paper2017 --presses 0 1 2

Processor time, that of the mesher's child processes included, not wall time; on one thread, as a worker computes. A busy machine shares its
caches and its memory: expect up to half more there. Light fields must be in the cache; meshes that are there cost nothing ($GELSIM_CACHE is
the folder). What a process spends on its first episode alone, kernels to compile above all, is told apart. With --undrawn the kernels are
launched once and their pictures given for all: what is left to the core where a GPU draws.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.data.episodes import write_episode
from gelsim.generate import recording
from gelsim.generate.light import Studio
from gelsim.generate.plan import Catalogue, load_plan
from gelsim.optics.baked import BakedRenderer
from gelsim.work.workers import settings


def spent() -> float:
    """Processor seconds of this process and of its children that ended."""
    return sum(os.times()[:4])


def leave_undrawn() -> None:
    """Every launch gives what the first gave."""
    launch, kept = BakedRenderer.launch, []

    def launched(self: BakedRenderer, uploaded: Any, keys: Any = None) -> Any:
        if not kept:
            kept.append(launch(self, uploaded, keys))
        return kept[0]

    BakedRenderer.launch = launched


def main(plan: str = "paper2017", seed: int = 0, presses: tuple[int, ...] = (0,)) -> list[dict[str, float | str]]:
    """Rows: shape, states, processor seconds of mechanics, of light and of writing an episode, and its size."""
    catalogue, studio = Catalogue(load_plan(plan), seed), Studio("cpu")
    ends, rows = range(len(catalogue.plan.end_points)), []
    for number in presses:
        press, clock = catalogue.press(number), spent()
        row: dict[str, float | str] = {"press": number, "shape": press.scene.object.shape}
        try:
            solved = recording.solve(press)
        except recording.PressFailed as failed:
            rows.append(row | {"status": failed.status})
            continue
        mechanics, light, write, sizes, frames = spent() - clock, 0.0, 0.0, [], []
        if not rows:
            clock = spent()
            recording.record(catalogue, press, 0, solved.motion, studio)
            print(f"a process's first episode: {spent() - clock:.1f} s of light")
        row["mechanics"] = round(mechanics / len(ends), 1)
        for end in ends:
            clock = spent()
            made = recording.record(catalogue, press, end, solved.motion, studio)
            light, clock = light + spent() - clock, spent()
            with tempfile.TemporaryDirectory() as folder:
                sizes.append(write_episode(Path(folder), made.episode, made.members).stat().st_size)
            write += spent() - clock
            frames.append(len(made.episode.frames))
        rows.append(row | {
            "states": len(solved.motion.approach), "light": round(light / len(ends), 2), "write": round(write / len(ends), 2),
            "frames": float(np.mean(frames)), "kilobytes": round(float(np.mean(sizes)) / 1e3),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plan", default="paper2017")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--presses", type=int, nargs="+", default=[0])
    parser.add_argument("--undrawn", action="store_true")
    options = parser.parse_args()
    if options.undrawn:
        leave_undrawn()
    if os.environ.get("OMP_NUM_THREADS") != "1":
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | settings(1))
    main(options.plan, options.seed, tuple(options.presses))
