"""Clough-Tocher operators against SciPy's interpolator, which iterates for the gradients and evaluates value by value."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CloughTocher2DInterpolator, LinearNDInterpolator
from scipy.spatial import Delaunay

from gelsim.membrane.clough_tocher import Interpolation

LINES = [np.linspace(-0.9, 0.9, count) for count in (2001, 20001)]


@pytest.fixture(scope="module")
def nodes() -> np.ndarray:
    scattered = np.random.default_rng(3).uniform(-1, 1, (300, 2))
    return np.concatenate([scattered, [[-1, -1], [1, -1], [-1, 1], [1, 1]]])


def waves(x: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(3 * x[:, 0]) * x[:, 1], np.exp(-4 * (x**2).sum(axis=1))], axis=1)


def test_equals_scipy(nodes):
    places = np.random.default_rng(4).uniform(-1, 1, (4000, 2))
    made, values = Interpolation(nodes), waves(nodes)
    theirs = CloughTocher2DInterpolator(Delaunay(nodes), values, tol=1e-13, maxiter=5000)(places)
    # Both solve the same system; theirs stops where a sweep changes gradients by 1e-13, and sweeps converge by a few per cent each.
    assert made.operator(places) @ made.with_gradients(values) == pytest.approx(theirs, abs=1e-11)
    # Planted: gradients 1e-6 too large are seen.
    wrong = made.with_gradients(values)
    wrong[len(nodes) :] *= 1 + 1e-6
    assert np.abs(made.operator(places) @ wrong - theirs).max() > 1e-9


def test_first_derivatives_are_continuous_everywhere(nodes):
    """Also across the three parts of a triangle, where SciPy is not needed to say so."""
    made = Interpolation(nodes)
    values = made.with_gradients(waves(nodes))

    def jump(along: np.ndarray, profile: np.ndarray) -> float:
        return np.abs(np.diff(profile, n=2, axis=0)).max() / (along[1] - along[0])

    ratios = []
    for interpolated in (lambda places: made.operator(places) @ values, LinearNDInterpolator(nodes, waves(nodes))):
        coarse, fine = (jump(along, interpolated(np.column_stack([along, 0.3 * along]))) for along in LINES)
        ratios.append(coarse / fine)
    # From one step to the next a slope changes by the second derivative times the step, a tenth on the finer line (8.6 is found: the
    # coarser line misses some of the largest); across a kink, as of the linear interpolant, by the same on both.
    assert ratios[0] > 7 and ratios[1] < 1.5


def test_a_place_beyond_the_rim_has_the_nearest_node_s_value(nodes):
    made, values = Interpolation(nodes), waves(nodes)
    found = made.operator(np.array([[1 + 1e-9, 1 + 1e-9], [-1.0, -1 - 1e-9]])) @ made.with_gradients(values)
    assert found == pytest.approx(values[[-1, -4]], abs=0)
