"""The pinned packages install on every Python that the project allows."""

from __future__ import annotations

import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[2]


def test_pins_install_on_the_oldest_python() -> None:
    """A package may ask for a later patch of Python 3.11 than a stable distribution has."""
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"]
    oldest = wanted.removeprefix(">=") + ".0"
    assert SpecifierSet(wanted).contains(oldest)
    pins = [line.split("#")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines()]
    asked = {}
    for name, _, version in (pin.partition("==") for pin in pins if pin):
        try:
            found = metadata(name)
        except PackageNotFoundError:  # of another platform
            continue
        if found["Version"] == version.partition(";")[0].strip():
            asked[name] = found["Requires-Python"] or ""
    assert len(asked) > 50
    assert [name for name, asks in asked.items() if not SpecifierSet(asks).contains(oldest)] == []
