"""What a section of the benchmark is: cases, how each is measured, and how the rows read as a table."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gelsim.work.ledger import Row  # `status` is CONVERGED where the case was solved

Layer = dict[str, Any]
"""Part of a scene, as a scene file has it."""

DATA_VARIABLE = "GELSIM_DATA"
KEPT_FOLDER = "kept"
"""Folder in a run's results, of what sections keep."""


@dataclass(frozen=True)
class Options:
    """What the command was asked for."""

    sections: tuple[str, ...] | None = None
    """Their names; None: all, or those that a page has places for."""
    quick: bool = False
    data: Path | None = field(default_factory=lambda: Path(os.environ[DATA_VARIABLE]) if DATA_VARIABLE in os.environ else None)
    """Folder of measured data of others, which the project does not hold."""
    kept: Path = Path("out/bench") / KEPT_FOLDER
    """Folder where a section keeps what took long, to measure anew; a run's lies in its results."""


@dataclass(frozen=True)
class Case:
    """One row of a table."""

    name: str
    measure: Callable[[], Row]
    scene: Layer | None = None
    """The scene that `measure` solves, where it is one."""
    same: str = ""
    """What it has in common with cases beside it, such as a press that all look at: one worker measures them."""


@dataclass(frozen=True)
class Known:
    """A number that theory or another code knows."""

    name: str
    compute: Callable[[], tuple[float, float, float]]
    """Ours, the expected one, and what their difference is compared with: the expected one, or a scale where that is zero."""
    bound: float
    """Of the difference over that scale."""
    source: str
    unit: str = ""
    control: bool = False
    """A faulty element: the bound must be broken."""
    quick: bool = True
    """Solved in seconds."""


def _unchanged(rows: list[Row]) -> list[Row]:
    return rows


@dataclass(frozen=True)
class Section:
    """A question and its table."""

    title: str
    columns: tuple[tuple[str, str], ...]
    """Header and field of each column of the table for people."""
    cases: Callable[[Options], Iterable[Case]]
    needs: str = ""
    """What to give the command where the section has no cases without it."""
    judge: Callable[[list[Row]], list[Row]] = _unchanged
    """Rows as measured to rows as written: verdicts, and what takes two rows to say."""
    listed: Callable[[list[Row]], list[Row]] = _unchanged
    """The rows that the table for people holds; the CSV holds all."""
    remarks: Callable[[list[Row]], str] = lambda rows: ""
    """What the table says as a whole, Markdown below it."""
    draw: Callable[[list[Row], Path], None] | None = None
    """Writes a plot into a folder."""
