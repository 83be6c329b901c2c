"""Where contact ends, of fields that are known: Hertz's pressure and gap of a ball on a half space."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gelsim.fem.planar.elements import edge_quadrature
from gelsim.fem.planar.touching import touching_intervals

Array = NDArray[np.float64]

EDGE, RADIUS = 0.08, 5.0
"""[mm] of the profiles of `balanced`, and of the ball."""


def hertz(place: Array, a: float) -> tuple[Array, Array]:
    """Gap [mm] and pressure (over the greatest) at distances from the axis, contact of radius a (Johnson 1985, §3.4 and 4.2)."""
    far = np.maximum(place, a)
    gap = ((far**2 - 2 * a**2) * np.arccos(a / far) + a * np.sqrt(far**2 - a**2)) / (np.pi * RADIUS)
    return gap, np.sqrt(np.maximum(1 - (place / a) ** 2, 0.0))


def profile(a: float) -> tuple[Array, Array, Array, Array]:
    """Ends and points of edges that begin at the axis, gap and pressure there."""
    start = EDGE * np.arange(25.0)
    ends = np.stack([start, start + EDGE], axis=1)
    points = start[:, None] + EDGE * edge_quadrature(4)[0]
    return ends, points, *hertz(points, a)


def counted(ends: Array, points: Array, gap: Array, pressure: Array) -> float:
    """The same by loaded points: the root of Σ r dr over them."""
    weight = EDGE * edge_quadrature(4)[1]
    return float(np.sqrt(2 * (points * weight)[pressure > 0].sum()))


@pytest.mark.parametrize("a", [0.7, 1.2])
def test_the_end_is_known_to_a_small_part_of_an_edge(a: float) -> None:
    """φ/c = d (1 - 0.033 d/a + 0.079 d²/a² …), by the series of the gap: the parabola misses the cubic term.

    On [0, L], L = 4 edges, x³ less its best parabola is L³/20 P₃*(x/L), P₃* Legendre's; contact ends up to one edge before the points
    begin, where |P₃*(-1/4)| = 6.2. Loaded points tell the end to half their distance, 0.17 edges.
    """
    bound = 0.079 / a**2 * (4 * EDGE) ** 3 / 20 * 6.2
    errors, of_counting = [], []
    for shift in np.linspace(0.0, 1.0, 21):  # contact ends anywhere on an edge
        true = a + shift * EDGE
        fields = profile(true)
        ((start, end),) = touching_intervals(*fields)
        assert start == 0.0
        errors.append(abs(end - true))
        of_counting.append(abs(counted(*fields) - true))
    assert max(errors) < bound < 0.025 * EDGE
    assert max(of_counting) > 5 * bound  # the planted fault, counting, is seen


def test_noise_within_contact_is_contact() -> None:
    """A point that happens to carry nothing, deep inside, opens no hole."""
    fields = profile(0.75)
    fields[3][4, 2] = 0.0
    whole = touching_intervals(*profile(0.75))
    assert np.array_equal(touching_intervals(*fields), whole)


def test_a_sharp_rim_is_counted() -> None:
    """Where pressure rises toward the end, (a² - r²)^(-1/2), the loaded edges are in contact and no parabola is drawn."""
    a = 10 * EDGE
    ends, points, _, _ = profile(a)
    inside = points < a
    pressure = np.where(inside, 1 / np.sqrt(np.maximum(a**2 - points**2, 1e-12)), 0.0)
    gap = np.where(inside, 0.0, 0.02 * np.sqrt(np.maximum(points - a, 0.0)))
    ((_, end),) = touching_intervals(ends, points, gap, pressure)
    assert end == pytest.approx(a, abs=1e-12)


def test_two_contacts_and_the_ends_of_the_gel() -> None:
    """Edges in any order; contact up to the last edge ends with it; one loaded edge between open ones is counted."""
    ends, points, _, _ = profile(0.7)
    pressure = np.where((points < 3 * EDGE) | (points > 23 * EDGE), 1.0, 0.0)
    order = np.random.default_rng(0).permutation(len(ends))
    found = touching_intervals(ends[order], points[order], np.full_like(points, 1e9)[order], pressure[order])
    assert found == pytest.approx(np.array([[0.0, 3 * EDGE], [23 * EDGE, 25 * EDGE]]))
    assert len(touching_intervals(ends, points, np.ones_like(points), np.zeros_like(points))) == 0
