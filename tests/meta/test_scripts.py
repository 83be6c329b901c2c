"""Scripts of the docs that no other test runs still find what they import."""

from __future__ import annotations

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "docs").glob("*/*.py"))


def imported(script: str) -> list[tuple[str, str]]:
    """Modules of the project that a script names, and what it takes from each ("" for the module itself)."""
    found = []
    for node in ast.walk(ast.parse(script)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in ("gelsim", "learn"):
            found += [(node.module, alias.name) for alias in node.names]
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names if alias.name.split(".")[0] in ("gelsim", "learn")]
    return found


def missing(names: list[tuple[str, str]]) -> list[str]:
    """Those that are not there: neither in the module nor a module of their own."""
    gone = []
    for module, name in names:
        held = importlib.import_module(module)
        package = hasattr(held, "__path__")
        if name and not hasattr(held, name) and not (package and importlib.util.find_spec(f"{module}.{name}")):
            gone.append(f"{module}.{name}")
    return gone


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_what_a_script_imports_is_there(script: Path) -> None:
    assert missing(imported(script.read_text())) == []


def test_a_name_that_is_gone_is_seen() -> None:
    script = "from gelsim.fem.strategy import HELD, CONTACT_POINTS\nfrom gelsim import pipeline\nfrom gelsim.units import MM, FATHOM"
    assert missing(imported(script)) == ["gelsim.fem.strategy.CONTACT_POINTS", "gelsim.units.FATHOM"]
