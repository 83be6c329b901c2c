"""The README's Shore figure, in its quick form: softer means less force at equal approach, and more approach and area at equal force."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest


@pytest.mark.slow
def test_softer_objects_flatten(repository: Path) -> None:
    series = runpy.run_path(str(repository / "docs" / "examples" / "shore_series.py"))["main"](quick=True)
    approach, force = series["equal approach"], series["equal force"]
    # Shore 00-10 is 44 kPa, 00-70 is 650 kPa, the gel 60 kPa: by the springs in series 1/(1/E + 1/E_gel) the forces are as 25 to 55; nearer
    # than that they cannot come, as the thin bonded gel is stiffer than its modulus says.
    assert approach[10]["force_n"] < 25 / 55 * approach[70]["force_n"]
    assert approach[10]["contact_area_mm2"] < approach[70]["contact_area_mm2"]
    # The press ends where the force is reached to within the secant rule's tolerance.
    assert force[10]["force_n"] == pytest.approx(force[70]["force_n"], rel=0.01)
    assert force[10]["approach_mm"] > 1.5 * force[70]["approach_mm"]
    assert force[10]["contact_area_mm2"] > 1.1 * force[70]["contact_area_mm2"]
