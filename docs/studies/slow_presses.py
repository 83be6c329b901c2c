"""Presses of a plan, one after the other on one core: which try got there, how far, and how long it took.

    python docs/studies/slow_presses.py [--plan paper2017] [--seed 0] [--limit 150] PRESS ...

Meshes are made, or found in the cache, before the clock starts. Each press is solved in a process that is ended after --limit seconds.
Iterations and factorisations are those that led to the recorded states of the try that is kept; failed steps and other tries are in the
seconds alone.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time

from gelsim.work.workers import settings


def solve(plan: str, seed: int, number: int) -> None:
    """Prints the first cells once the meshes are there, and the rest of the row when the press has ended."""
    from gelsim.generate import recording
    from gelsim.generate.plan import Catalogue, load_plan
    from gelsim.pipeline import stages

    scene = recording.resolved(Catalogue(load_plan(plan), seed).press(number).scene)
    body, press = scene.object, scene.press
    gel, solid, _ = stages.bodies(scene)
    hardness = "rigid" if body.rigid else f"00-{body.shore_00:.0f}"
    meshes = f"{len(gel.tets)} and {len(getattr(solid, 'tets', ()))}"
    print(f"| {number} | {body.shape}, {hardness}, μ {scene.contact.friction_coefficient:.3g} | {meshes}", flush=True)
    start = time.perf_counter()
    done = stages.press(scene, device="cpu", throw=False)
    seconds = time.perf_counter() - start
    reached = f"{done.info['ended_by']}, {1e3 * done.approach[-1]:.2f} of {press.depth_mm:.3g} mm, {-done.force[-1, 2]:.3g} N"
    how = f"{done.info['tried']}, {done.info['contact_points']} on the {done.info['contact_points_on']}"
    print(f"| {how} | {reached} | {done.newton_iterations.sum()}, {done.info['factorisations']} | {seconds:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("presses", nargs="+", type=int, metavar="PRESS")
    parser.add_argument("--plan", default="paper2017")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=150.0, help="seconds of one press, its meshes included")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.alone:
        solve(options.plan, options.seed, options.presses[0])
        return
    print("| press | object | tets of gel and object | try, contact's points | ended by | iterations, factorisations | seconds |")
    print("|---|---|---|---|---|---|---|")
    for number in options.presses:
        again = [sys.executable, __file__, str(number), "--plan", options.plan, "--seed", str(options.seed), "--alone"]
        try:
            done = subprocess.run(again, capture_output=True, text=True, timeout=options.limit, env=os.environ | settings(1))
            cells = [line for line in done.stdout.splitlines() if line.startswith("|")] or [f"| {number}"]
            cells += [f"| – | failed: {done.stderr.strip()[-100:]} | – | – |"] if done.returncode else []
            print(" ".join(cells), flush=True)
        except subprocess.TimeoutExpired as cut:
            told = (cut.stdout or b"").decode().splitlines()
            print(" ".join([line for line in told if line.startswith("|")]), f"| – | not within {options.limit:g} s | – | – |", flush=True)


if __name__ == "__main__":
    main()
