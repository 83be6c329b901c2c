"""What people read of a benchmark: tables as Markdown and CSV, and the page of the documentation that holds them.

In a page the tables of a section stand between `<!-- bench accuracy -->` and `<!-- /bench -->`; the prose around them is the author's and
is kept.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from gelsim.bench.section import Row, Section
from gelsim.errors import SceneError


@dataclass(frozen=True)
class Table:
    """A section as it is written."""

    section: str
    rows: list[Row]
    markdown: str


def describe(name: str, section: Section, rows: list[Row], cases: int, quick: bool) -> str:
    """Where the numbers come from, the table, and what it says as a whole."""
    if cases == 0:
        return f"Skipped: {section.needs}.\n"
    workers = max((row.get("workers", 1) for row in rows), default=1)
    command = f"gelsim bench --only {name}{' --quick' if quick else ''}{f' --workers {workers}' if workers > 1 else ''}"
    cores = max((row.get("cores") or 0 for row in rows), default=0) or os.cpu_count()  # of the machine that measured
    loads = [row["load"] for row in rows if row.get("load") is not None]
    busy = f", load {min(loads):g} to {max(loads):g}" if loads else ""
    seconds = " Seconds: the solve alone, kernels and meshes cached." if any(field == "seconds" for _, field in section.columns) else ""
    part = "" if len(rows) == cases else f" {len(rows)} of {cases} cases so far."
    lines = [f"`{command}`, {cores} cores ({platform.machine()}){busy}.{part}{seconds}", ""]
    listed = section.listed(rows)
    if listed:
        lines += table(section.columns, listed)
    remarks = section.remarks(rows).strip() if rows else ""
    return "\n".join(lines + ([""] * bool(listed) + [remarks] if remarks else [])) + "\n"


def table(columns: tuple[tuple[str, str], ...], rows: Iterable[Row]) -> list[str]:
    """A Markdown table, line by line."""
    lines = ["| " + " | ".join(header for header, _ in columns) + " |", "|" + "---|" * len(columns)]
    return lines + ["| " + " | ".join(_cell(row.get(field)) for _, field in columns) + " |" for row in rows]


def _cell(value: object) -> str:
    if value is None or value == "":
        return "–"
    if isinstance(value, list):
        return ", ".join(f"{v:.4g}" for v in value)
    if isinstance(value, str) and re.fullmatch("[A-Z_]+", value):  # a status
        return value.lower()
    return str(value).replace("|", "\\|")


def _place(name: str) -> re.Pattern[str]:
    return re.compile(rf"(<!-- bench {re.escape(name)} -->\n).*?(<!-- /bench -->)", re.DOTALL)


def check_page(page: Path, sections: Iterable[str]) -> None:
    """Raises SceneError where the page cannot take the tables of these sections, before minutes went into them."""
    if not page.is_file():
        raise SceneError(f"--page {page}: no such file; give a Markdown page that marks the places of the tables")
    text = page.read_text(encoding="utf-8")
    for name in sections:
        if not _place(name).search(text):
            raise SceneError(
                f"--page {page}: has no place for section {name!r}; allowed: a page with <!-- bench {name} --> and <!-- /bench -->"
            )


def places(page: Path) -> list[str]:
    """The sections that a page has a place for."""
    return re.findall(r"<!-- bench ([a-z-]+) -->", page.read_text(encoding="utf-8")) if page.is_file() else []


def write_page(page: Path, tables: Iterable[Table]) -> None:
    """Puts the tables in their places; sections without a row leave what stands there."""
    text = page.read_text(encoding="utf-8")
    for written in tables:
        if written.rows:
            text = _place(written.section).sub(lambda found, new=written.markdown: f"{found[1]}\n{new}\n{found[2]}", text)
    page.write_text(text, encoding="utf-8")
