"""The [expect] table of a scene file: what a solver and a renderer found for it before, and how far another draw of its meshes may differ.

    [expect]
    force_n = { value = 0.4703, spread = 0.0012, margin = 0.015 }

Nothing is computed from it, and no result carries it: `gelsim.scene.layers` takes it off a scene file, and tests/golden/ compares
(there too: how spread and margin are found). The numbers are those of the last recorded state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from gelsim.errors import SceneError
from gelsim.scene.fields import known_key


@dataclass(frozen=True)
class Expected:
    """One number of a scene's last state."""

    value: float
    """The mean over draws of the object's mesh."""
    spread: float
    """Standard deviation from draw to draw; 0 where no mesh is drawn by lot."""
    margin: float
    """A number farther from the value than this has moved."""

    def __post_init__(self) -> None:
        for name in ("value", "spread", "margin"):
            number = getattr(self, name)
            if isinstance(number, bool) or not isinstance(number, (int, float)) or not math.isfinite(number):
                raise SceneError(f"{name} = {number!r}: expected a finite number")
        if self.spread < 0 or self.margin <= 0:
            raise SceneError(f"spread = {self.spread:g}, margin = {self.margin:g}: allowed is a spread of 0 or more and a margin above 0")


@dataclass(frozen=True)
class Expectation:
    """What [expect] may hold; None: not said."""

    force_n: Expected | None = None
    """Normal force [N]."""
    shear_force_n: Expected | None = None
    """Tangential force on the gel along x, the way it is dragged counting as positive [N]."""
    contact_area_mm2: Expected | None = None
    """Projected on the window [mm²]."""
    indentation_mm: Expected | None = None
    """Of the membrane, where it goes deepest below its place at rest [mm]."""
    marker_shift_mm: Expected | None = None
    """Mean distance by which the markers go sideways [mm]."""
    picture_mean: Expected | None = None
    """Of the 8-bit picture, over pixels and colours [levels of 255]."""
    picture_change: Expected | None = None
    """Mean absolute difference of picture and background [levels of 255]."""

    def numbers(self) -> dict[str, Expected]:
        """Those that are said, by name."""
        return {name: number for name, number in vars(self).items() if number is not None}


def read_expectation(table: Any) -> Expectation:
    """From the table of a scene file.

    Raises:
        SceneError: An unknown name, or what is no value with spread and margin.
    """
    if not isinstance(table, dict):
        raise SceneError(f"expect = {table!r}: expected a table, [expect]")
    found = {}
    for name, given in table.items():
        known_key(name, Expectation, "expect")
        if not isinstance(given, dict) or set(given) != {"value", "spread", "margin"}:
            raise SceneError(f"expect.{name} = {given!r}: expected {{ value = …, spread = …, margin = … }}")
        try:
            found[name] = Expected(**given)
        except SceneError as error:
            raise SceneError(f"expect.{name}.{error}") from None
    return Expectation(**found)
