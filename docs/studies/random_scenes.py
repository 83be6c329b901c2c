"""Do scenes that nothing was tried on end, and how well? Those of `gelsim bench --only random` with other seeds, many at once.

    python docs/studies/random_scenes.py --seeds 3001 3002 3003 --scenes 1000 --workers 44 --out random.jsonl [--seconds 420]
    python docs/studies/random_scenes.py --seeds 36 --scenes 200 --parts meshes --workers 44 --out parts.jsonl
    python docs/studies/random_scenes.py --scenes 1000 --read random.jsonl

With --resume scenes that --out holds are not solved again. With --parts mesh parts are pressed in their place
(`gelsim.bench.mesh_parts`), whose files are written into that folder. One process a worker, of one thread each; a line a scene as it ends.
Times of many at once are several times those of one alone.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, TimeoutError, as_completed
from pathlib import Path

import numpy as np

from gelsim.bench import mesh_parts, presses, random_scenes
from gelsim.bench.random_scenes import as_asked
from gelsim.errors import GelsimError
from gelsim.work.ledger import Ledger, Row
from gelsim.work.workers import in_environment, settings


def named(seed: int, index: int) -> str:
    """The key of a scene's row."""
    return f"{seed}:{index}"


def measured(seed: int, index: int, parts: Path | None = None) -> Row:
    """Row of one scene, or of a mesh part whose file is kept in a folder."""
    scene, begun = (mesh_parts if parts else random_scenes).draw(index, seed), time.perf_counter()
    row: Row = {"key": named(seed, index), "seed": seed, "index": index, "scene": random_scenes.said(scene)}
    try:
        row |= presses.measure(mesh_parts.with_file(scene, parts) if parts else scene)
    except (GelsimError, AssertionError) as error:  # a fault of ours is a row, and the others go on
        row |= {"status": type(error).__name__, "message": str(error)}
    return row | {"wall_s": round(time.perf_counter() - begun, 2)}


def summary(rows: list[Row], of: int) -> str:
    """How many converged as asked, the others by name; overlaps, energy drifts, seconds."""
    solved = [row for row in rows if as_asked(row)]
    others = "; ".join(
        f"{named(row['seed'], row['index'])} {row['scene']}: {row['status']} {row['message']}" for row in rows if row not in solved
    )
    overlap, drift = (np.abs([row[name] for row in solved]) for name in ("penetration_um", "drift_percent"))
    rigid = np.array([", rigid," in row["scene"] for row in solved])
    wall = [row["wall_s"] for row in rows]
    tries = Counter(row["tried"] or "profile" for row in solved)
    return (
        f"{len(rows)} of {of} scenes ended, {len(solved)} converged as asked, by try {dict(tries.most_common())}\n"
        f"overlap at most 20 um in {100 * np.mean(overlap <= 20):.1f} %, the worst {overlap.max():.0f} um; of {rigid.sum()} rigid ones "
        f"in {np.sum(overlap[rigid] <= 20)}\n"
        f"energy drift at most 2 % in {100 * np.mean(drift <= 2):.2f} %, the worst {drift.max():.1f} %\n"
        f"seconds: median {np.median(wall):.1f}, 95 % {np.percentile(wall, 95):.1f}, longest {max(wall):.0f}\n"
        f"others: {others or 'none'}"
    )


def main() -> None:
    """Writes rows and prints their summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[random_scenes.SEED])
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seconds", type=float, help="what is not done by then is left")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--parts", type=Path, metavar="FOLDER", help="press mesh parts; FOLDER keeps their files")
    into = parser.add_mutually_exclusive_group(required=True)
    into.add_argument("--out", type=Path)
    into.add_argument("--read", type=Path, help="say what such a file holds")
    options = parser.parse_args()
    if options.read:
        print(summary([json.loads(line) for line in options.read.read_text().splitlines()], options.scenes))
        return
    keys = [(seed, index) for index in range(-(-options.scenes // len(options.seeds))) for seed in options.seeds][: options.scenes]
    ledger = Ledger(options.out, resume=options.resume, force=not options.resume)
    with in_environment(settings(1)):
        pool = ProcessPoolExecutor(options.workers, mp_context=multiprocessing.get_context("spawn"))
        tasks = [pool.submit(measured, *key, options.parts) for key in keys if named(*key) not in ledger.rows]
        try:
            for task in as_completed(tasks, options.seconds):
                ledger.add(task.result())
        except TimeoutError:
            for process in multiprocessing.active_children():
                process.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
    print(summary(list(ledger.rows.values()), len(keys)))


if __name__ == "__main__":
    main()
