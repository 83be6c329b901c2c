"""A measured trajectory of the object's apex, `press.path_csv`: time, place and turn, row by row.

Columns t_s, x_mm, y_mm, z_mm, rx_deg, ry_deg, rz_deg: the apex in the project's frame (z = 0 is the gel's outer face at its centre), and
the turn from how the object stands ([object]) about x, then y, then z. Columns of turns may be left out.
"""

from __future__ import annotations

import csv
import math
from functools import lru_cache
from pathlib import Path

from gelsim.errors import SceneError
from gelsim.scene.fields import nearest

COLUMNS = ("t_s", "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
NEEDED = COLUMNS[:4]


def measured_path(path: str) -> tuple[tuple[float, ...], ...]:
    """The rows of a trajectory's file, numbers in the order of COLUMNS; it is read again when it has changed.

    Raises:
        SceneError: It cannot be read, has other columns, fewer than two rows, a cell that is no number, or times that do not grow.
    """
    try:
        status = Path(path).stat()
    except OSError as error:
        raise SceneError(f"press.path_csv = {path!r}: cannot be read ({error.strerror})") from None
    return _read(path, (status.st_mtime_ns, status.st_size))


@lru_cache(maxsize=4)
def _read(path: str, stamp: tuple[int, int]) -> tuple[tuple[float, ...], ...]:
    name = f"press.path_csv = {path!r}"
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, skipinitialspace=True)
            lines, header = list(table), list(table.fieldnames or [])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"{name}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    for column in header:
        if column not in COLUMNS:
            raise SceneError(f"{name}: unknown column {column!r}{nearest(column, COLUMNS) or '; known are ' + ', '.join(COLUMNS)}")
    if missing := [column for column in NEEDED if column not in header]:
        raise SceneError(f"{name}: the column {missing[0]} is missing; needed are {', '.join(NEEDED)}")
    rows: list[tuple[float, ...]] = []
    for number, line in enumerate(lines, start=2):
        try:
            row = tuple(float(line[column]) if column in header else 0.0 for column in COLUMNS)
        except (TypeError, ValueError):
            raise SceneError(f"{name}: line {number} holds a cell that is no number") from None
        if not all(map(math.isfinite, row)):
            raise SceneError(f"{name}: line {number} is not finite")
        if rows and row[0] <= rows[-1][0]:
            raise SceneError(f"{name}: line {number} has t_s = {row[0]:g} s, the line before {rows[-1][0]:g} s; times must grow")
        rows.append(row)
    if len(rows) < 2:
        raise SceneError(f"{name}: holds {len(rows)} rows; a motion needs two or more")
    return tuple(rows)
