"""What a calibration says of its own errors, and what it takes for the coat: few blocks, noise of the rest, shadows of long lights."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from gelsim.calibrate import fit, model, start
from gelsim.calibrate.dent import DentFamily

RNG_SEED = 5


def test_the_jackknife_is_right_where_blocks_are_few() -> None:
    # 15 blocks of 20 pixels, one press; half of their errors are their block's own; 6 + 5 parameters, without priors to speak of.
    rng = np.random.default_rng(RNG_SEED)
    blocks, size, sensor = 15, 20, 6
    count, width = blocks * size, sensor + len(fit.PRESS)
    block = np.repeat(np.arange(blocks), size)
    here = SimpleNamespace(data=SimpleNamespace(block=block, pixels=SimpleNamespace(press=np.zeros(count, int))), presses=np.zeros((1, 5)))
    weight, pull, free = np.ones((count, 3)), np.full(width, 1e-9), np.arange(width)
    said, sandwich = [], []
    for _ in range(60):
        columns = rng.standard_normal((count, 3, width)) + rng.standard_normal((blocks, 1, width))[block]
        error = rng.standard_normal((count, 3)) + rng.standard_normal((blocks, 3))[block]
        hessian, gradient = fit._normal(here, columns, error, weight)  # type: ignore[arg-type]
        moved = np.linalg.solve(hessian, gradient)
        residual = error - columns @ moved
        covariance = fit._jackknife(here, columns, residual, weight, hessian, free, pull)  # type: ignore[arg-type]
        scores = np.array([(columns[block == b] * residual[block == b][..., None]).sum(axis=(0, 1)) for b in range(blocks)])
        plain = np.linalg.inv(hessian) @ scores.T @ scores @ np.linalg.inv(hessian)
        said.append(moved**2 / np.diag(covariance))
        sandwich.append(moved**2 / np.diag(plain))
    # 60 runs of 11 parameters: 0.95 lie within two standard deviations, right to 0.01 in so many; CR3 errs to the large side.
    within = (np.array(said) < 4).mean()
    assert 0.92 < within
    # What it replaces, with 15 blocks for 11 parameters, does not reach that.
    assert (np.array(sandwich) < 4).mean() < within - 0.05


def test_the_rest_loses_noise_and_keeps_dots() -> None:
    rng = np.random.default_rng(RNG_SEED)
    rows, columns = np.mgrid[:60, :80]
    true = np.repeat((90 + 0.3 * columns + 0.2 * rows)[..., None], 3, axis=2)
    dot = np.hypot(rows % 20 - 10, columns % 20 - 10) < 2.5
    true[dot] -= 50
    photos = np.rint(true + 1.5 * rng.standard_normal((5, *true.shape)))
    contacts = np.tile([40.0, 30.0, 1.0], (4, 1))
    rest = start.rest_picture(photos[0], photos[1:], contacts, 2.2)
    # A median of five keeps π/2/(5 + π/2 - 1) = 0.28 of 1.5² + 1/12: 0.66; of a window of 25 pixels a little more than 1/25 is left, and of
    # its variance, right to a quarter, a tenth is taken for paint.
    far = np.hypot(rows % 20 - 10, columns % 20 - 10) > 6
    assert ((rest - true)[far] ** 2).mean() < 0.3 * 0.66
    assert abs((rest - true)[dot].mean()) < 0.5


def _dent(depth: float, place: np.ndarray) -> tuple[model.Shape, DentFamily, model.Surface]:
    """A flat gel, a dent with a steep flank in its middle, and what pixels at a place see of it."""
    radius = np.array([2.5])
    scaled = np.linspace(0, 14.0, 561)
    height = np.tile(-np.exp(-(scaled**2)), (1, 24, 1))
    moved = np.zeros((2, 1, 24, 561))
    dents = DentFamily(radius, np.array([1.5]), height, np.gradient(height, scaled, axis=2), moved)
    shape = model.Shape(0.1, 34.0, ((4.0, 1.49), (3.2, 1.41)), 40.0, 0.0, radius)
    presses = np.array([[0.0, 0.0, depth, 0.0, 0.0]])
    return shape, dents, model.surface(shape, dents, presses, model.Pixels(place, np.zeros(len(place), np.int64)))


def test_a_dent_that_reaches_past_a_light_changes_nothing_at_once_and_nothing_far_away() -> None:
    # A lamp within the gel's depth, a part of it above the surface: what the surface hides at rest is no dent's work. It once was, as soon
    # as the deepest of all points lay above the lamp: a press that moved by 1 um changed all pictures by levels.
    place = np.column_stack([np.linspace(-90, 90, 181), np.zeros(181)])
    light = np.array([18.0, 0.0, -0.6, np.pi, 0.0, 3.0, 1.6])

    def shares(depth: float) -> np.ndarray:
        shape, dents, seen = _dent(depth, place)
        return model.visible(shape, dents, seen, light)

    depths = np.arange(0.55, 0.65, 0.001)
    steps = np.abs(np.diff([shares(depth) for depth in depths], axis=0))
    # Slopes change by 0.001 mm over the shortest reach, 0.12 contact radii of 1.2 mm, of a light that fills twice a slope of 0.02 at least.
    assert steps.max() < 0.001 / (0.12 * 1.2) / 0.04
    assert shares(0.6)[:, place[:, 0] > 60].min() > 0.999  # between dent and lamp


def test_a_light_is_as_soft_across_its_length_as_it_is_long() -> None:
    # A wall, the dent's steep flank, half hides a light that stands behind it: the shadow's edge is as wide as the light is long.
    shape, dents, seen = _dent(1.2, np.column_stack([np.full(81, -20.0), np.linspace(-40, 40, 81)]))

    def edge(length: float) -> float:
        light = np.array([18.0, 0.0, -5.0, np.pi, 0.3, length, 0.4])
        share = np.average(model.visible(shape, dents, seen, light), axis=0, weights=model.ALONG[1])
        return float(np.abs(np.diff(share)).max())

    short, long = edge(0.5), edge(9.0)
    assert short > 0 and long < 0.6 * short
