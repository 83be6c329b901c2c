"""A long computation as a file of lines: one JSON object for each case as soon as it is known, so that a run that was stopped goes on.

A line that was cut off when the process was killed is dropped. Left out: two processes that write the same ledger.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gelsim.errors import SceneError

Row = dict[str, Any]
"""What is known of a case: plain numbers and texts by field name."""


class Ledger:
    """The finished cases of a computation, by key."""

    def __init__(self, path: Path, *, resume: bool = False, force: bool = False) -> None:
        """Opens or begins a ledger; the file appears with its first line.

        Raises:
            SceneError: There is one already and neither `resume` (go on) nor `force` (begin again) was given, or it cannot be read.
        """
        self.path = path
        self.rows: dict[str, Row] = {}
        if path.exists() and not (resume or force):
            raise SceneError(f"--out {path.parent}: holds {path.name} already; give --resume to go on, --force to begin again")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SceneError(f"--out {path.parent}: cannot be written to ({error.strerror}); give another folder") from None
        try:
            if force:
                path.unlink(missing_ok=True)
            if path.exists():
                self._read()
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SceneError(f"{path}: is no ledger that can be gone on with ({error}); give --force to begin again") from None

    def _read(self) -> None:
        text = self.path.read_text(encoding="utf-8")
        whole = text[: text.rfind("\n") + 1]
        if whole != text:
            self.path.write_text(whole, encoding="utf-8")
        for line in whole.splitlines():
            row = json.loads(line)
            self.rows[row["key"]] = row

    def add(self, row: Row) -> None:
        """Keeps a row, which has a `key`, and writes its line."""
        self.rows[row["key"]] = row
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")
