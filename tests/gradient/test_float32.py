"""Element forces in single precision lose no digit to a bulk modulus when pressure is its own unknown, and all of them when it is not."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest


@pytest.mark.parametrize("nu", [0.49, 0.499, 0.4999, 0.49999])
def test_digits_of_element_forces(repository: Path, nu: float) -> None:
    study = runpy.run_path(str(repository / "docs" / "studies" / "float32.py"))
    ours, gradient, naive = (study["element_errors"](nu, form, 40) for form in study["FORMS"])
    bulk = 2 * (1 + nu) / (3 * (1 - 2 * nu))  # κ/μ
    rounding = study["ROUNDING"]
    # Ours: some tens of operations, none of which subtracts from 1, on displacements whose rounding is the gradient's
    assert rounding < ours < 30 * rounding
    # κ times the rounding of H, and of 1, over stresses of μ·STRAIN; between a tenth and thirty times that
    assert 0.1 * bulk * rounding < gradient < 30 * bulk * rounding
    assert 0.1 * bulk / study["STRAIN"] * rounding < naive < 30 * bulk / study["STRAIN"] * rounding
