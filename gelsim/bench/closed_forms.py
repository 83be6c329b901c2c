"""Section `closed-forms`: what theory or another code says in one number, beside what we get, with the bound that it must meet.

Blocks (`blocks`) are solids without contact on structured meshes; presses (`half_space`) are scenes like any user's. An element that locks
is among them as a negative control: there the verdict is that the check sees it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

from gelsim.bench.section import Case, Known, Options, Row, Section
from gelsim.errors import GelsimError, SolveStatus


def known() -> Iterator[Known]:
    from gelsim.bench import blocks, half_space

    yield from blocks.known()
    yield from half_space.known()


def _cases(options: Options) -> Iterator[Case]:
    for item in known():
        if item.quick or not options.quick:
            yield Case(item.name, partial(measured, item))


def measured(item: Known) -> Row:
    """A known number as a row: ours, the expected one, and whether they are near enough."""
    start = time.perf_counter()
    try:
        ours, expected, scale = item.compute()
    except GelsimError as error:
        return {"status": type(error).__name__, "verdict": f"not solved: {error}", "source": item.source}
    error = (ours - expected) / scale
    met = abs(error) <= item.bound
    if item.control:
        verdict = "seen, as it must be" if not met else "FAULT NOT SEEN"
    else:
        verdict = "met" if met else "NOT MET"
    return {
        "status": SolveStatus.CONVERGED.name,
        "ours": f"{ours:.5g}{' ' + item.unit if item.unit else ''}",
        "expected": f"{expected:.5g}",
        "error": _share(error),
        "bound": _share(item.bound),
        "verdict": verdict,
        "source": item.source,
        "seconds": round(time.perf_counter() - start, 2),
    }


def _share(value: float) -> str:
    """As a percentage, or as a power of ten where that is all it is."""
    return f"{100 * value:.2f} %" if abs(value) >= 5e-5 else f"{value:.0e}"


def _remarks(rows: list[Row]) -> str:
    missed = [row["name"] for row in rows if row.get("verdict") not in ("met", "seen, as it must be")]
    return f"{len(rows) - len(missed)} of {len(rows)} within their bounds." + (f" Not: {'; '.join(missed)}." if missed else "")


SECTION = Section(
    title="Closed forms",
    columns=(
        ("quantity", "name"), ("ours", "ours"), ("expected", "expected"), ("error", "error"), ("bound", "bound"),
        ("verdict", "verdict"), ("from", "source"),
    ),
    cases=_cases,
    remarks=_remarks,
)  # fmt: skip
