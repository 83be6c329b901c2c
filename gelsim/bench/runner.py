"""Runs the cases of sections and keeps what each gave: a run that was stopped goes on where it was.

One after the other, as seconds ask for; or with `workers` processes, each on one thread, where only the answers count.
"""

from __future__ import annotations

import importlib
import os
import platform
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from gelsim import fem
from gelsim.bench import SECTIONS, report
from gelsim.bench.section import KEPT_FOLDER, Case, Options, Row, Section
from gelsim.errors import GelsimError, SolveStatus
from gelsim.pipeline import stages
from gelsim.tables import write_csv
from gelsim.work.ledger import Ledger
from gelsim.work.workers import Handful, LocalCrew, Work, check_count, load_average, work_through

RESULTS = "results.jsonl"


def load(name: str) -> Section:
    return importlib.import_module(SECTIONS[name]).SECTION


def run(out: Path, options: Options | None = None, *, resume: bool = False, force: bool = False, limit: int | None = None,
        page: Path | None = None, workers: int = 1, progress: Callable[[str, int, int], None] | None = None) -> dict[str, Any]:  # fmt: skip
    """Measures the cases and writes results.jsonl, one CSV a section, bench.md and plots into `out`.

    Args:
        limit: Stop after so many cases that were not known before.
        page: A Markdown page whose tables of these sections are replaced.
        workers: Processes that share the cases, each on one thread.
    Raises:
        SceneError: `workers` is out of range, `out` holds results and neither `resume` nor `force` was given, or `page` has no
            place for a section.
    """
    options = replace(options or Options(), kept=out / KEPT_FOLDER)
    check_count(workers)
    held = report.places(page) if page is not None else []
    asked = set(options.sections or held or SECTIONS)
    wanted = [name for name in SECTIONS if name in asked]
    if page is not None:
        report.check_page(page, wanted)
    ledger = Ledger(out / RESULTS, resume=resume, force=force)
    known = ledger.rows
    todo: list[tuple[str, Case]] = [(name, case) for name in wanted for case in load(name).cases(options)]
    new = [(name, case) for name, case in todo if f"{name}/{case.name}" not in known][:limit]
    if progress:
        progress("bench", len(todo) - len(new), len(todo))
    made_by = _made_by() if new else {}
    for number, row in enumerate(_measured(new, options, workers), start=1):
        if progress:
            progress("bench", len(todo) - len(new) + number, len(todo))
        ledger.add(row | {"load": load_average(), "cores": os.cpu_count(), "workers": workers, "made_by": made_by})
    written = [_written(out, name, [f"{s}/{case.name}" for s, case in todo if s == name], known, options.quick) for name in wanted]
    (out / "bench.md").write_text("\n".join(f"### {load(table.section).title}\n\n{table.markdown}" for table in written))
    if page is not None:
        report.write_page(page, written)
    rows = [row for table in written for row in table.rows]
    return {
        "out": str(out),
        "cases": len(rows),
        "missing": len(todo) - len(rows),
        "failed": [row["key"] for row in rows if row.get("status") != SolveStatus.CONVERGED.name],
    }


def _made_by() -> dict[str, str | None]:
    """Code and machine of a row: a run that goes on with --resume may have another one of each.

    `commit` is None where the package is not run from its repository, and ends in "-dirty" where that has changes.
    """
    root = Path(__file__).parents[2]
    commit = None
    if (root / ".git").exists():
        try:
            said = subprocess.run(["git", "-C", str(root), "describe", "--always", "--dirty"], capture_output=True, text=True, timeout=60)
            commit = said.stdout.strip() or None
        except (OSError, subprocess.TimeoutExpired):  # no git here
            pass
    processor = platform.processor() or platform.machine()
    facts = Path("/proc/cpuinfo")  # on Linux `platform` does not know the name
    names = [line for line in facts.read_text().splitlines() if line.startswith("model name")] if facts.is_file() else []
    if names:
        processor = names[0].partition(":")[2].strip()
    return {"commit": commit, "python": platform.python_version()} | stages.versions() | {"processor": processor}


def _measured(cases: list[tuple[str, Case]], options: Options, workers: int) -> Iterator[Row]:
    """The row of each case, as it is known."""
    if workers == 1:
        yield from (_measure(name, case) for name, case in cases)
        return

    def lost(handful: Handful, status: str, message: str) -> list[Row]:
        said = {"status": status, "message": message}
        return [{"key": f"{name}/{case.name}", "section": name, "name": case.name} | said for name, case in (cases[i] for i in handful)]

    names = [(name, case.name) for name, case in cases]
    together = groupby(range(len(cases)), lambda number: (cases[number][0], cases[number][1].same or number))
    handfuls = [tuple(numbers) for _, numbers in together]
    for rows in work_through(handfuls, LocalCrew(workers), _make_measurer, (names, options), lost):
        yield from rows


def _measure(name: str, case: Case) -> Row:
    row: Row = {"key": f"{name}/{case.name}", "section": name, "name": case.name}
    fem.quiet_warp()
    try:
        return row | case.measure()
    except GelsimError as error:  # one case that cannot be is no reason to leave the others
        return row | {"status": type(error).__name__, "message": str(error)}


def _make_measurer(names: list[tuple[str, str]], options: Options) -> Work[list[Row]]:
    """What a worker does: finds the cases of some numbers by their names, and measures them."""
    found = {(name, case.name): case for name in {name for name, _ in names} for case in load(name).cases(options)}
    return lambda handful: [_measure(names[number][0], found[names[number]]) for number in handful]


def _written(out: Path, name: str, keys: list[str], known: dict[str, Row], quick: bool) -> report.Table:
    section = load(name)
    rows = section.judge([known[key] for key in keys if key in known])
    write_csv(out / f"{name}.csv", rows, without=("key", "section", "made_by"))
    if section.draw is not None and rows:
        section.draw(rows, out)
    return report.Table(name, rows, report.describe(name, section, rows, len(keys), quick))
