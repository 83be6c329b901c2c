"""Works through a study's cases, in processes, and keeps what each gave as soon as it is known: a run that was stopped goes on.

With several workers a case that kills its process is listed as failed, and the others go on; with one it is computed in this process. Rows
do not depend on how many workers there are, nor on the order in which they finish.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelsim.errors import GelsimError, SceneError, SolveStatus
from gelsim.scene.layers import Layer, build_scene
from gelsim.study import report
from gelsim.study.definition import Point, Study, case_name
from gelsim.study.metrics import METRICS
from gelsim.work.ledger import Ledger, Row
from gelsim.work.workers import Handful, LocalCrew, check_count, load_average, work_through

RESULTS = "results.jsonl"
DONE = SolveStatus.CONVERGED.name


@dataclass(frozen=True)
class Case:
    """What a process needs to know."""

    key: str
    point: Point
    layers: tuple[Layer, ...]
    metrics: tuple[str, ...]
    device: str = "auto"


def run(study: Study, out: Path, *, resume: bool = False, force: bool = False, workers: int = 1, device: str = "auto", command: str = "",
        progress: Callable[[str, int, int], None] | None = None) -> dict[str, Any]:  # fmt: skip
    """Measures the cases and writes results.jsonl, study.csv, a plot for each metric and index.html into `out`.

    Args:
        workers: Processes; 1 computes in this one.
        command: What the page says it was made by.
    Returns:
        What the page says, as plain values; `failed` lists the cases that gave no number, with their messages.
    Raises:
        SceneError: A case makes no scene (nothing was computed), or `out` holds a study and neither `resume` nor `force` was given, or was
            begun with another scene.
    """
    check_count(workers)
    cases = [case_of(study, point, device) for point in study.points()]
    ledger = Ledger(out / RESULTS, resume=resume, force=force)
    todo = [case for case in cases if ledger.rows.get(case.key, {}).get("status") != DONE]
    done = len(cases) - len(todo)
    for row in measured(todo, workers):
        ledger.add(row)
        done += 1
        if progress:
            progress(f"study {study.name}", done, len(cases))
    rows = [ledger.rows[case.key] for case in cases]
    failed = [{"case": row["key"], "message": row["message"]} for row in rows if row["status"] != DONE]
    facts = {
        "out": str(out),
        "study": study.name,
        "question": study.question,
        "answer": study.answer([row for row in rows if row["status"] == DONE], study),
        "cases": len(rows),
        "failed": failed,
        "case_seconds": round(sum(row["seconds"] for row in rows), 1),
        "command": command,
    }
    report.write(out, study, rows, facts)
    return facts


def case_of(study: Study, point: Point, device: str) -> Case:
    """What is to be measured at a point.

    Raises:
        SceneError: It makes no scene.
    """
    layers = (study.base, study.layer(point))
    try:
        scene = build_scene(*layers)
    except GelsimError as error:
        raise SceneError(f"study {study.name}, {case_name(point)}: {error}") from None
    # The key holds all that decides the rows, so that a study that was changed does not go on with numbers of another one.
    return Case(f"{case_name(point)} [{report.fingerprint(scene, study.metrics)}]", point, layers, study.metrics, device)


def measure(case: Case) -> Row:
    """A row of plain numbers, also where the case fails."""
    from gelsim.study.trial import Trial

    start = time.perf_counter()
    row: Row = {"key": case.key, **case.point, "status": DONE, "message": ""}
    try:
        trial = Trial(case.layers, case.device)
        for name in case.metrics:
            value = METRICS[name].measure(trial)
            if not math.isfinite(value):
                raise SceneError(f"{name} = {value}: the case gives no number")
            row[name] = float(f"{value:.6g}")
    except GelsimError as error:  # one case that cannot be is no reason to leave the others
        row |= {"status": type(error).__name__, "message": str(error)}
    except (ArithmeticError, ValueError, MemoryError, IndexError) as error:
        row |= {"status": type(error).__name__, "message": f"internal error: {error}"}
    return row | {"seconds": round(time.perf_counter() - start, 2), "load": load_average()}


def measured(cases: Sequence[Case], workers: int) -> Iterator[Row]:
    """A row of each case, as they finish."""
    if workers == 1:
        yield from map(measure, cases)
        return

    def lost(handful: Handful, status: str, message: str) -> list[Row]:
        return [
            {"key": cases[n].key, **cases[n].point, "status": status, "message": message, "seconds": 0.0, "load": load_average()}
            for n in handful
        ]

    threads = max(1, (os.cpu_count() or 1) // workers)
    for rows in work_through([(number,) for number in range(len(cases))], LocalCrew(workers, threads), _worker, (tuple(cases),), lost):
        yield from rows


def _worker(cases: tuple[Case, ...]) -> Callable[[Handful], list[Row]]:
    return lambda handful: [measure(cases[number]) for number in handful]
