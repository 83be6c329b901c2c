"""What a worker process hands back of its presses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from gelsim.work.workers import Handful


@dataclass
class Done:
    """What came of a handful of presses."""

    handful: Handful
    rows: list[tuple[dict[str, Any], dict[str, Any]]] = field(default_factory=list)
    """Row and pixel sums of each episode written."""
    failures: list[dict[str, Any]] = field(default_factory=list)
    seconds: list[dict[str, Any]] = field(default_factory=list)
    """Of each press, by stage."""
    error: str | None = None
    """What ends everything."""
