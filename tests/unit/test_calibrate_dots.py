"""Markers in a picture are found, and what is none is not."""

from __future__ import annotations

import numpy as np
import pytest

from gelsim.calibrate.dots import dark_pixels, marker_grid


def picture(pitch: float, radius: float, tilt_deg: float) -> np.ndarray:
    """Black discs on a grey slope, 160 x 120, anti-aliased over a pixel."""
    row, column = np.mgrid[:120, :160] + 0.5
    turn = np.exp(-1j * np.radians(tilt_deg))
    place = ((column - 80) + 1j * (row - 60)) * turn
    away = np.hypot(*(np.remainder([place.real, place.imag], pitch) - pitch / 2))
    cover = np.clip(radius - away + 0.5, 0, 1)
    return np.repeat(((90 + 0.3 * column) * (1 - 0.9 * cover))[..., None], 3, axis=2)


def place(pixels: np.ndarray) -> np.ndarray:
    return 0.1 * (pixels - [80, 60])


def test_a_grid_is_measured():
    grid = marker_grid(picture(13.0, 3.0, 4.0), place, 0.1)
    # Centres of such discs are good to some hundredths of a pixel; a disc's area loses its dimmest rim, up to half a pixel of radius.
    assert grid and grid.radius_mm == pytest.approx(0.3, abs=0.05)
    # About 100 discs over 12 by 9 steps: 0.05 px of each leave 0.05 / sqrt(100) / (12 / sqrt(12)) = 0.0015 px of a step of 13; the slope of
    # the light moves all of them alike. The median distance alone was 1 % off.
    assert grid.pitch_mm == pytest.approx(1.3, rel=5e-4) and grid.tilt_deg == pytest.approx(4.0, abs=0.03)


def test_a_grid_with_missing_and_odd_markers_is_measured():
    marked = picture(13.0, 3.0, -7.0)
    marked[40:70, 60:90] = 100.0  # some are not there
    marked[20:26, 100:106] = 5.0  # and one is where none should be
    grid = marker_grid(marked, place, 0.1)
    assert grid and grid.pitch_mm == pytest.approx(1.3, rel=3e-3) and grid.tilt_deg == pytest.approx(-7.0, abs=0.2)


def test_a_plain_picture_has_no_markers():
    plain = picture(13.0, 0.0, 4.0) * 0 + 100.0
    assert not dark_pixels(plain[None]).any() and marker_grid(plain, place, 0.1) is None
