"""What a calibration makes of made-up photographs before it fits: dents among dots, the rest away from dents, where lights may stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.calibrate import start
from gelsim.calibrate.model import Rest
from gelsim.calibrate.parameters import GEOMETRY, GLOBALS, OUT_OF_VIEW, Parameters
from gelsim.optics.rest import even_part

ROW, COLUMN = np.mgrid[:96, :128] + 0.5
RNG = np.random.default_rng(0)
PRESSES = np.column_stack([RNG.uniform(25, 103, 10), RNG.uniform(25, 71, 10), RNG.uniform(9, 13, 10)])


def photograph(press: np.ndarray | None = None, drift: float = 0.0) -> np.ndarray:
    """A vignette with dots every 12 px; a press brightens one side of a disc, another in each colour, and pushes dots 2 px outward."""
    x, y = COLUMN, ROW
    dent = np.zeros((*x.shape, 3))
    if press is not None:
        away = np.hypot(x - press[0], y - press[1]) / press[2]
        aside = np.stack([(x - press[0]) * np.cos(turn) + (y - press[1]) * np.sin(turn) for turn in np.radians([10, 130, 250])], axis=2)
        dent = aside / press[2] * np.clip(1.2 - away, 0, 1)[..., None]
        shift = 2 * away * np.exp(-(away**2))
        x, y = x - shift * (COLUMN - press[0]) / press[2], y - shift * (ROW - press[1]) / press[2]
    dots = np.hypot(x % 12 - 6, y % 12 - 6) < 2
    levels = (150 - 0.008 * ((COLUMN - 64) ** 2 + (ROW - 48) ** 2) + drift)[..., None] + 60 * dent
    return np.where(dots, 0.3, 1.0)[..., None] * levels


def test_dents_are_found_among_dots_that_move():
    photos = np.array([photograph(press) for press in PRESSES])
    found, sure = start.find_contacts(photograph(), photos, np.ones(photos.shape[1:3], bool))
    assert sure.all()
    # To a third of the dots' distance: windows of 7 px stand for dots.
    assert np.hypot(*(found[:, :2] - PRESSES[:, :2]).T).max() < 4
    # All visible radii are the same multiple of the true ones, to a tenth.
    ratio = found[:, 2] / PRESSES[:, 2]
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.1
    # Planted: the dent of another photograph.
    assert np.hypot(*(found[:, :2] - np.roll(PRESSES[:, :2], 1, axis=0)).T).max() > 4


def test_the_rest_is_that_of_the_photographs_away_from_their_dents():
    photos = np.array([photograph(press, drift=5.0) for press in PRESSES])
    rest = start.rest_picture(photograph(), photos, PRESSES, 2.2)
    drifted = photograph(drift=5.0)
    # Dots still move a tenth of a pixel at 2.2 radii: in few pixels.
    assert np.median(np.abs(rest - drifted)) < 1e-3 and (np.abs(rest - drifted) > 2).mean() < 0.01
    # Planted: the no-contact photograph, from before the drift.
    assert np.median(np.abs(photograph() - drifted)) > 1
    assert np.array_equal(start.rest_picture(photograph(), photos[:2], PRESSES[:2], 2.2), photograph())


def test_a_few_photographs_make_a_rest_of_less_noise_than_one():
    noise = np.random.default_rng(1).normal(0, 1.5, (6, *photograph().shape))
    photos = np.array([photograph(press) for press in PRESSES[:5]]) + noise[1:]
    rest = start.rest_picture(photograph() + noise[0], photos, PRESSES[:5], 2.2)
    # The median of five or six has 0.29 and 0.21 of the variance; a few pixels have fewer, and dots still move a tenth of a pixel.
    assert np.median(np.abs(rest - photograph())) < 0.56 * np.median(np.abs(noise[0]))
    # Planted: the mean of two.
    assert np.median(np.abs((noise[0] + noise[1]) / 2)) > 0.56 * np.median(np.abs(noise[0]))


def test_even_light_and_paint_make_the_photograph():
    levels = photograph()
    rest = Rest(levels, even_part(levels))
    # The dots are paint, the vignette is not.
    assert np.abs(rest.even - 150 + 0.008 * ((COLUMN - 64) ** 2 + (ROW - 48) ** 2)[..., None])[8:-8, 8:-8].max() < 12
    place = np.column_stack([COLUMN.ravel() - 64, ROW.ravel() - 48])
    even, paint = rest.at(place, place, 1.0)
    assert 0.05 < paint.min() < 0.2 and np.median(np.abs(paint - 1)) < 0.15
    srgb = 255 * np.where(even * paint <= 0.0031308, 12.92 * even * paint, 1.055 * (even * paint) ** (1 / 2.4) - 0.055)
    assert np.abs(srgb - levels.reshape(-1, 3)).max() < 1e-6
    # Planted: paint from a pixel beside.
    moved = rest.at(place, place + [1.0, 0.0], 1.0)[1]
    assert np.abs(moved - paint).max() > 0.3


@pytest.mark.parametrize("thickness", [2.4, 4.25])
def test_lights_below_the_gel_stay_below_it(thickness):
    values = np.array([0.15, 30.0, 0.0, thickness, 0.1, 0.4, 1.0, 0.0, 0.0, 0.5])
    places = start.candidates(12.0, thickness)
    below = places[:, 0] < OUT_OF_VIEW * 12.0
    assert below.any() and not below.all() and (places[below, 2] <= -thickness - 0.5).all()
    sensor = Parameters(values, places, np.ones((len(places) + 1, 3)), 12.0, 64.0, (4.0, 1.49, 1.41))
    _, low, high = sensor.prior()
    inner = GLOBALS.index("gel.thickness_mm")
    ends = high[len(GLOBALS) : len(GLOBALS) + places.size].reshape(-1, len(GEOMETRY))
    assert (ends[below, GEOMETRY.index("z_mm")] <= -high[inner]).all() and (ends[below, 0] <= 12.0).all()
    assert (low[: len(GLOBALS)] <= values).all()
    # Lights beside the picture bound nothing.
    beside = replace(sensor, geometry=places[~below], colours=np.ones(((~below).sum() + 1, 3)))
    assert beside.prior()[2][inner] > thickness + 1
