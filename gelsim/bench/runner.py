"""Runs the cases of sections, one after the other, and keeps what each gave: a run that was stopped goes on where it was."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from gelsim.bench import SECTIONS, report
from gelsim.bench.section import Case, Options, Row, Section
from gelsim.errors import GelsimError, SolveStatus
from gelsim.ledger import Ledger
from gelsim.tables import write_csv

RESULTS = "results.jsonl"


def load(name: str) -> Section:
    return importlib.import_module(SECTIONS[name]).SECTION


def run(out: Path, *, sections: Iterable[str] | None = None, options: Options | None = None, resume: bool = False, force: bool = False,
        limit: int | None = None, page: Path | None = None,
        progress: Callable[[str, int, int], None] | None = None) -> dict[str, Any]:  # fmt: skip
    """Measures the cases and writes results.jsonl, one CSV a section, bench.md and plots into `out`.

    Args:
        sections: Their names; None for all.
        limit: Stop after so many cases that were not known before.
        page: A Markdown page whose tables of these sections are replaced.
    Raises:
        SceneError: `out` holds results and neither `resume` nor `force` was given, or `page` has no place for a section.
    """
    options = options or Options()
    wanted = [name for name in SECTIONS if sections is None or name in set(sections)]
    if page is not None:
        report.check_page(page, wanted)
    ledger = Ledger(out / RESULTS, resume=resume, force=force)
    known = ledger.rows
    todo: list[tuple[str, Case]] = [(name, case) for name in wanted for case in load(name).cases(options)]
    fresh = 0
    for number, (name, case) in enumerate(todo):
        if progress:
            progress("bench", number, len(todo))
        key = f"{name}/{case.name}"
        if key in known or (limit is not None and fresh >= limit):
            continue
        row: Row = {"key": key, "section": name, "name": case.name}
        try:
            row |= case.measure()
        except GelsimError as error:  # one case that cannot be is no reason to leave the others
            row |= {"status": type(error).__name__, "message": str(error)}
        fresh += 1
        row["load"] = round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None
        ledger.add(row)
    if progress:
        progress("bench", len(todo), len(todo))
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


def _written(out: Path, name: str, keys: list[str], known: dict[str, Row], quick: bool) -> report.Table:
    section = load(name)
    rows = section.judge([known[key] for key in keys if key in known])
    write_csv(out / f"{name}.csv", rows, without=("key", "section"))
    if section.draw is not None and rows:
        section.draw(rows, out)
    return report.Table(name, rows, report.describe(name, section, rows, len(keys), quick))
