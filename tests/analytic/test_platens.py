"""Cylinders between platens: the curves that measured silicones are read with, and the reading of a test made from a known law."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gelsim.bench import measured_silicones, runner
from gelsim.bench.measured_silicones import HEIGHT_MM, RADIUS_MM, STRAINS, platen_curve, smooth_curve
from gelsim.bench.section import Options
from gelsim.errors import SolveError


def test_a_platen_that_sticks_stiffens_a_short_cylinder() -> None:
    strain, force = platen_curve("stick", 0.0)
    radius, half = RADIUS_MM, HEIGHT_MM / 2
    small = force[1] / np.interp(strain[1], *smooth_curve(0.0))
    # Planes that stay planes, u_z = f(z): of all such fields the least energy, that of f' = A (1 - cosh kz / cosh kh), k² = 24/R², is
    # a bound from above for an incompressible body at small strains; 2 % strain and one part in 500 of compressibility are within 1 %
    k = np.sqrt(24) / radius
    assert 1.0 < small < 1.01 / (1 - np.tanh(k * half) / (k * half))
    # Gent and Lindley 1959, E (1 + 2 S²) with S = R/2H, leave out that a bulge is not a parabola: a few per cent at S = 0.4
    assert small == pytest.approx(1 + 2 * (radius / (4 * half)) ** 2, rel=0.05)


def test_a_rim_that_rolls_onto_a_platen_is_followed_to_the_end_of_the_fit() -> None:
    """With friction below what holds the rim its tets are crushed; curves for fits that end before the tests do are of no use."""
    smooth, stick = smooth_curve(0.3), platen_curve("stick", 0.3)
    strain, force = platen_curve(0.3, 0.3)
    assert strain[-1] >= STRAINS[1]
    at = np.linspace(*STRAINS, 5)
    low, high = np.interp(at, *smooth), np.interp(at, *stick)
    between = np.interp(at, strain, force)
    assert (between > low).all() and (between < high).all()
    assert (np.diff(force, 2)[1:] > 0).all(), "a curve that bends down has jumped"


@pytest.fixture
def silicone(tmp_path: Path) -> Path:
    """A folder of measured data with one silicone of E = 40 kPa without friction, whose platen touches fully 0.3 mm late."""
    folder = tmp_path / "data" / "silicone_phantoms"
    (folder / "EF10_0T").mkdir(parents=True)
    compression = np.linspace(0, 8.0, 200)
    force = 40.0 * np.interp((compression - 0.3) / (HEIGHT_MM - 0.3), *smooth_curve(0.0))
    lines = [f"{0.1 * i:f},{u:f},{f:f}" for i, (u, f) in enumerate(zip(compression, force, strict=True))]
    (folder / "EF10_0T" / "a.csv").write_text("\n".join(["a test", "Time (s),Compression (mm),Load (N)", *lines]))
    published = {"engineering": {"EF10_0T": {"Yeoh_o2": {"parameters": [6.0, 0.6]}}}}
    (folder / "hyperelastic_parameters.json").write_text(json.dumps(published))
    return tmp_path / "data"


def test_the_modulus_that_a_test_was_made_with_is_found(silicone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stiffer(friction: float | str, ratio: float) -> tuple[np.ndarray, np.ndarray]:
        strain, force = smooth_curve(ratio)
        return strain, (1.25 if friction == "stick" else 1.1) * force

    monkeypatch.setattr(measured_silicones, "platen_curve", stiffer)
    runner.run(tmp_path / "out", Options(("measured-silicones",), data=silicone))
    (row,) = (json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines())
    # its forces have six digits; c₂/c₁ is on a grid that has 0, the lost height on one that has 0.3
    assert row["smooth_kpa"] == pytest.approx(40.0, abs=0.1) and row["smooth_ratio"] == 0.0 and row["smooth_lost_mm"] == 0.3
    assert row["stick_kpa"] == pytest.approx(32.0, abs=0.1) and row["slide_kpa"] == pytest.approx(40.0 / 1.1, abs=0.1)
    assert row["published_kpa"] == 36.0 and row["published_ratio"] == 0.1
    assert "25 % too stiff" in (tmp_path / "out" / "bench.md").read_text()
    assert (tmp_path / "out" / "measured-silicones.png").stat().st_size > 1000


def test_a_silicone_whose_curve_ends_too_early_is_reported(silicone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def ends(friction: float | str, ratio: float) -> tuple[np.ndarray, np.ndarray]:
        if friction == 0.3:
            raise SolveError("stopped at 3.83 mm")
        return smooth_curve(ratio)

    monkeypatch.setattr(measured_silicones, "platen_curve", ends)
    runner.run(tmp_path / "out", Options(("measured-silicones",), data=silicone))
    (row,) = (json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines())
    assert row["status"] == "SolveError" and "3.83" in row["message"]
