"""What becomes of presses without one of the tries (`fem.strategy.WAYS`), or with a tuned constant of `fem/` halved and doubled?

    python docs/studies/ablation.py --tries --workers 44 --out tries.jsonl
    python docs/studies/ablation.py --set quasistatic.SOON=15 --set quasistatic.SOON=60 --workers 44 --out constants.jsonl
    python docs/studies/ablation.py --read tries.jsonl constants.jsonl

Tries: 300 random scenes and 150 presses each of the plans `varied` and `paper2017`; those that the first try does not solve are solved
again without each of the others. Constants (default: all of CONSTANTS): the hard presses below and 60 of the random scenes, as it is and
with each value. Processor time is of one thread, the meshes made before.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.bench import mesh_parts, presses, random_scenes, stability
from gelsim.bench.random_scenes import as_asked
from gelsim.bench.report import table
from gelsim.bench.section import Layer
from gelsim.errors import GelsimError
from gelsim.fem import strategy
from gelsim.pipeline import stages
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene
from gelsim.work.workers import LocalCrew, work_through

SEED = 36
SECONDS = 300.0
"""After which a press counts as lost."""
FEW, MANY, PLANNED = 60, 300, 150

STABILITY = (
    "sharp edge", "sharp corner", "sharp rigid corner", "rigid flat punch, stick", "2 mm shear, friction 0.5",
    "25 kPa hemisphere R 25 until 9 N", "25 kPa hemisphere R 5, 18 mm deep", "tilted block, its border inside the contact",
    "a thin-walled tube flattened by two thirds of its bore", "a rough surface",
)  # fmt: skip
SLOW = ((3001, 269), (3002, 257), (3002, 276), (3003, 119), (3003, 326))
"""Random scenes, seed and number."""
STEEP: Layer = {"fidelity": "fast", "press": {"depth_mm": 0.4, "frames": 3}}
HARD: tuple[Layer, ...] = (
    STEEP | {"object": {"shape": "mesh", "mesh": "star 5 3.5 0.43", "rigid": True}},
    STEEP | {"object": {"shape": "mesh", "mesh": "crescent 3.5 0.77 0.49", "rigid": True}},
    STEEP | {"object": {"shape": "mesh", "mesh": "star 5 3.5 0.43", "shore_00": 80.0}},
    STEEP | {"object": {"shape": "mesh", "mesh": "prism 3 4.0 0.6 standing", "rigid": True}},
    {"fidelity": "fast", "object": {"shape": "edge", "shore_00": 12.9}, "contact": {"friction_coefficient": 0.3},
     "press": {"depth_mm": "none", "force_n": 6.0, "tilt_deg": [1.9, 0.0], "offset_mm": [0.0, -2.2]}},
)  # fmt: skip
"""Acute corners, rigid and soft, and a soft edge to a force alone."""

CONSTANTS: dict[str, tuple[float, float]] = {
    "quasistatic.SOON": (15, 60),
    "quasistatic.GAVE_WAY": (0.8, 0.95),  # what is left to 1 doubled and halved, as of all that are such shares
    "quasistatic.OUT_OF_REACH": (1.0, 4.0),
    "newton.NewtonOptions.max_iterations": (15, 60),
    "problem.MOST_WASTED": (300, 1200),
    "newton.NewtonOptions.exact_after": (4, 16),
    "newton.NewtonOptions.max_downhill": (35, 140),
    "quasistatic.FOLDED": (0.25, 0.75),
    "quasistatic.OVERLAP_MM": (7.5e-3, 30e-3),
    "quasistatic.SOFT_OVERLAP_MM": (4e-3, 16e-3),
    "quasistatic.PACE": (50, 200),
    "quasistatic.CUT_MM": (0.05, 0.2),
    "contact.LEFT_MM": (1.5e-3, 6e-3),
    "newton.STALLED": (0.25, 0.75),
    "newton.LARGEST_GROWTH": (1.5, 6.0),
    "newton.GEOMETRIC_BELOW": (0.25, 1.0),
    "quasistatic.LONGEST_STEP": (0.5e-3, 2e-3),
    "quasistatic.FIRST_STEP": (0.125e-3, 0.5e-3),
    "problem.STICK_PER_MODULUS": (5.0, 20.0),
    "problem.PENALTY_PER_MODULUS": (15.0, 60.0),
    "newton.LINE_SEARCH_DROP": (0.6, 0.9),
    "newton.CHORD_BELOW": (0.025, 0.1),
    "newton.CHORD_DROP": (0.15, 0.6),
    "quasistatic.ROUGH_TOLERANCE": (0.05, 0.2),
    "newton.STALLED_AFTER": (3, 12),
    "newton.SMALLEST_JACOBIAN": (0.025, 0.1),
    "quasistatic.FOLDED_STEP": (1 / 16, 1 / 4),
}
"""Module of `gelsim.fem` and name: what to try."""
AS_IT_IS = ""


# ---- presses ----


def small_set() -> list[str]:
    """Names of the presses for constants."""
    hard = [*(f"stability:{name}" for name in STABILITY), *(f"random:{seed}:{index}" for seed, index in SLOW)]
    return [*hard, *(f"hard:{number}" for number in range(len(HARD))), *(f"random:{SEED}:{index}" for index in range(FEW))]


def large_set() -> list[str]:
    """Names of the presses for tries."""
    planned = [f"{plan}:{index}" for index in range(PLANNED) for plan in ("varied", "paper2017")]
    return [*(f"random:{SEED}:{index}" for index in range(MANY)), *planned]


def scene_of(name: str, folder: Path) -> Scene:
    """The scene of a name; mesh files are written into a folder."""
    kind, _, rest = name.partition(":")
    if kind == "stability":
        return build_scene(_hard_cases()[rest])
    if kind == "random":
        seed, index = rest.split(":")
        return build_scene(random_scenes.draw(int(index), int(seed)))
    if kind == "hard":
        return mesh_parts.built(HARD[int(rest)], folder)
    from gelsim.generate.plan import Catalogue, load_plan
    from gelsim.generate.recording import resolved

    return resolved(Catalogue(load_plan(kind), SEED).press(int(rest)).scene)


@cache
def _hard_cases() -> dict[str, Layer]:
    from gelsim.bench.section import Options

    return {case.name: case.scene for case in stability.SECTION.cases(Options()) if case.scene}


# ---- settings ----


@contextmanager
def changed(setting: str) -> Iterator[None]:
    """With "module.NAME=value" of `gelsim.fem`, wherever that was imported to, or "without try N" of 2 and 3."""
    if setting == AS_IT_IS:
        yield
        return
    undo: list[tuple[Any, str, Any]] = []

    def put(owner: Any, name: str, value: Any) -> None:
        undo.append((owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    if setting.startswith("without try "):
        left = int(setting.split()[-1])
        kept = {name: tuple(way for number, way in enumerate(ways, start=1) if number != left) for name, ways in strategy.WAYS.items()}
        put(strategy, "WAYS", kept)
    else:
        place, _, said = setting.partition("=")
        module, *owners, name = place.split(".")
        home, value = importlib.import_module(f"gelsim.fem.{module}"), float(said)
        if owners:
            kind = getattr(home, owners[0])
            defaults = {field.name: field.default for field in dataclasses.fields(kind)}
            put(kind.__init__, "__defaults__", tuple(_alike((defaults | {name: value})[key], defaults[key]) for key in defaults))
        else:
            before = getattr(home, name)
            for user in [module for key, module in sys.modules.items() if key.startswith("gelsim.fem.")]:
                if vars(user).get(name) is before:
                    put(user, name, _alike(value, before))
            if place == "problem.MOST_WASTED":
                kind = importlib.import_module("gelsim.fem.problem").Numerics
                put(kind.__init__, "__defaults__", tuple(type(old)(value) if old == before else old for old in kind.__init__.__defaults__))
    try:
        yield
    finally:
        for owner, name, value in reversed(undo):
            setattr(owner, name, value)


def _alike(value: Any, before: Any) -> Any:
    """A number as the one that it replaces is: a count, or not."""
    return int(value) if type(before) is int else value


# ---- measuring ----


def measured(name: str, setting: str, folder: Path) -> dict[str, Any]:
    """Row of one press with one setting."""
    row: dict[str, Any] = {"press": name, "setting": setting}
    try:
        scene = scene_of(name, folder)
        stages.bodies(scene)  # kept, or made, outside of the time
        begun = time.process_time()
        with changed(setting):
            press = stages.press(scene, device="cpu", throw=False)
        row |= {"cpu_s": round(time.process_time() - begun, 2), "asked": scene.contact.friction_coefficient}
        return row | presses.facts(press, scene.press.frames)
    except GelsimError as error:
        return row | {"status": type(error).__name__, "message": str(error)}


def all_tries(name: str, folder: Path) -> list[dict[str, Any]]:
    """Rows of one press: as it is, and where it has more than one try without each."""
    rows = [measured(name, AS_IT_IS, folder)]
    if not as_asked(rows[0]) or rows[0]["tried"] > 1:
        rows += [measured(name, f"without try {number}", folder) for number in (2, 3)]
    return rows


def make_measurer(jobs: list[tuple[str, ...]], folder: Path) -> Any:
    """What a worker does: jobs by number, each a press's name and a setting, or the name alone for all tries."""

    def work(handful: tuple[int, ...]) -> list[dict[str, Any]]:
        name, *setting = jobs[handful[0]]
        return [measured(name, setting[0], folder)] if setting else all_tries(name, folder)

    return work


def lost(jobs: list[tuple[str, ...]], handful: tuple[int, ...], status: str, message: str) -> list[dict[str, Any]]:
    """Row of a press that took too long, or ended its worker."""
    name, *setting = jobs[handful[0]]
    return [{"press": name, "setting": setting[0] if setting else AS_IT_IS, "status": status, "message": message}]


# ---- what it says ----


def summary(rows: list[dict[str, Any]]) -> str:
    """A line a setting, of the presses that ended with it and without."""
    known = {(row["press"], row["setting"]): row for row in rows}
    lines = []
    for setting in dict.fromkeys(row["setting"] for row in rows if row["setting"] != AS_IT_IS):
        pairs = [(known[name, AS_IT_IS], row) for (name, with_it), row in known.items() if with_it == setting and (name, AS_IT_IS) in known]
        both = [(old, new) for old, new in pairs if as_asked(old) and as_asked(new)]
        off = [_apart(old["force_n"], new["force_n"]) for old, new in both]
        lost = [new["press"] for old, new in pairs if as_asked(old) and not as_asked(new)]
        won = [new["press"] for old, new in pairs if as_asked(new) and not as_asked(old)]
        more = {key: _more(both, key) for key in ("newton_iterations", "cpu_s")} if both else {}
        lines.append({
            "setting": setting, "presses": len(pairs), "asked": f"{sum(as_asked(old) for old, _ in pairs)} → {len(both) + len(won)}",
            "lost": "; ".join(lost), "won": "; ".join(won),
            "force": f"{max(off):.2f}, {sum(one > 1.0 for one in off)}" if off else "",
            "iterations": more.get("newton_iterations", ""), "seconds": more.get("cpu_s", ""),
        })  # fmt: skip
    base = [row for row in rows if row["setting"] == AS_IT_IS]
    tries = {number: sum(as_asked(row) and row["tried"] == number for row in base) for number in range(1, 4)}
    head = f"As it is {sum(map(as_asked, base))} of {len(base)} presses are solved as asked, by try: {tries}; others: " + "; ".join(
        f"{row['press']} ({row['status']} {row.get('message', '')})" for row in base if not as_asked(row)
    )
    columns = (
        ("setting", "setting"), ("presses", "presses"), ("solved as asked", "asked"), ("lost", "lost"), ("won", "won"),
        ("force off: most [%], over 1 %", "force"), ("iterations [%]", "iterations"), ("processor time [%]", "seconds"),
    )  # fmt: skip
    return "\n".join([head, "", *table(columns, lines)])


def _more(both: list[tuple[dict[str, Any], dict[str, Any]]], key: str) -> str:
    """Of all presses that ended both ways, by how much the sum grows [%]."""
    old, new = (sum(pair[place][key] for pair in both) for place in (0, 1))
    return f"{100 * (new / old - 1):+.1f}"


def _apart(one: list[float], other: list[float]) -> float:
    """Of the last state [%]."""
    return 100 * float(np.linalg.norm(np.subtract(one, other)) / max(float(np.linalg.norm(one)), 1e-3))


def main() -> None:
    """Writes rows, a line as each ends, and prints what they say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tries", action="store_true")
    parser.add_argument("--set", action="append", metavar="MODULE.NAME=VALUE")
    parser.add_argument("--presses", nargs="+", help="names (default: as above)")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--meshes", type=Path, default=Path("out/parts"), help="keeps files of mesh parts")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--read", type=Path, nargs="+")
    options = parser.parse_args()
    if options.read:
        print(summary([json.loads(line) for path in options.read for line in path.read_text().splitlines()]))
        return
    jobs: list[tuple[str, ...]]
    if options.tries:
        jobs = [(name,) for name in options.presses or large_set()]
    else:
        settings = options.set or [f"{name}={value:g}" for name, values in CONSTANTS.items() for value in values]
        jobs = [(name, setting) for setting in (AS_IT_IS, *settings) for name in options.presses or small_set()]
    handfuls, crew, found = [(number,) for number in range(len(jobs))], LocalCrew(options.workers), []
    with options.out.open("a") as file:
        for rows in work_through(handfuls, crew, make_measurer, (jobs, options.meshes), partial(lost, jobs), seconds=SECONDS):
            found += rows
            file.writelines(json.dumps(row, default=str) + "\n" for row in rows)
            file.flush()
    print(summary(found))


if __name__ == "__main__":
    main()
