"""CSV files as lists of rows: read with one clear error, written with the columns of all rows."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gelsim.errors import SceneError
from gelsim.scene.fields import nearest


def read_csv(path: Path, name: str = "", known: Sequence[str] = ()) -> tuple[list[str], list[dict[str, Any]]]:
    """Column names, and a row for each further line.

    Args:
        name: Names the file in errors; its path, when left out.
        known: Columns that there may be, the first of which there must be; any, when left out.
    Raises:
        SceneError: It cannot be read, or has other columns.
    """
    name = name or str(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, skipinitialspace=True)
            rows, header = list(table), list(table.fieldnames or [])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"{name}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    for column in header if known else ():
        if column not in known:
            raise SceneError(f"{name}: unknown column {column!r}{nearest(column, known) or '; known are ' + ', '.join(known)}")
    if known and known[0] not in header:
        raise SceneError(f"{name}: the column {known[0]} is missing; known are {', '.join(known)}")
    return header, rows


def write_csv(path: Path, rows: Iterable[Mapping[str, Any]], without: Sequence[str] = ()) -> None:
    """Writes rows as a table with the columns of all of them but `without`; nothing where there are no rows."""
    rows = list(rows)
    if rows:
        columns = list(dict.fromkeys(key for row in rows for key in row if key not in without))
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
