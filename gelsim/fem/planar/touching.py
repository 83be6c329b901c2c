"""Where the gel's profile touches the object, to a small part of an edge.

Loaded quadrature points tell the contact's end to their distance, a quarter of an edge. The gap beyond it tells more: at the end of a
smooth contact pressure vanishes like √(distance inside) and the gap opens like (distance outside)^(3/2) (Johnson 1985, §5.1 and App. 1), so

    φ = gap^(2/3)

is smooth, and begins at zero where contact ends. φ of the points of wholly open edges, up to `REACH` edges away, is fitted by a parabola,
whose zero is the end. Points nearer than that are left out: an edge on which contact ends cannot follow the gap's opening.

Left out: contact that ends at a sharp rim. Pressure does not fall toward it there, and loaded points are counted; likewise where too few
open edges lie between two contacts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REACH = 4.0
"""Edges beyond the contact whose gaps are fitted: a wider fit forgets more of the mesh, a narrower one needs no higher powers."""
_FEWEST = 6
"""Points of a fit of three numbers."""
_NO_PARTNER = 1e6
"""[mm] A point that found nothing to touch has a larger gap."""


def touching_intervals(ends: Array, points: Array, gap: Array, pressure: Array) -> Array:
    """Intervals (K, 2) of the gel's profile that are in contact, in the places' unit.

    Args:
        ends: Places (S, 2) of the edges' ends, the smaller first; any order of edges, each beginning where another ends.
        points: Places (S, Q) of their quadrature points; gap (S, Q) less what overlap the penalty leaves, and pressure (S, Q), there.
    """
    order = np.argsort(ends[:, 0])
    ends, points, gap, pressure = ends[order], points[order], gap[order], pressure[order]
    touched: NDArray[np.bool_] = np.asarray((pressure > 0).any(axis=1), bool)
    steps = np.diff(np.concatenate([[False], touched, [False]]).astype(int))
    found = []
    for first, last in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1) - 1, strict=True):
        outer = [_end(ends, points, gap, pressure, touched, int(at), side) for at, side in ((first, -1), (last, 1))]
        found.append(outer)
    return np.array(found).reshape(-1, 2)


def _end(ends: Array, points: Array, gap: Array, pressure: Array, touched: NDArray[np.bool_], at: int, side: int) -> float:
    """Where contact ends toward `side` of the touched edge `at`."""
    column = (side + 1) // 2
    border = float(ends[at, column])
    if not 0 <= at + side < len(ends):
        return border
    length = ends[at, 1] - ends[at, 0]
    counted = border - side * float(np.mean(pressure[at] <= 0)) * length
    if 0 <= at - side < len(ends) and pressure[at].mean() >= pressure[at - side].mean():
        return counted
    beyond = [at + side]
    while 0 <= beyond[-1] + side < len(ends) and not touched[beyond[-1] + side]:
        beyond.append(beyond[-1] + side)
    if 0 <= beyond[-1] + side < len(ends):  # another contact begins: the half that is nearer
        beyond = beyond[: len(beyond) // 2]
    away, opening = side * (points[beyond] - border).ravel() / length, gap[beyond].ravel()
    near = (away < REACH) & (opening < _NO_PARTNER)
    if near.sum() < _FEWEST:
        return counted
    away, phi = away[near], np.cbrt(np.maximum(opening[near], 0.0)) ** 2
    zeros = np.roots(np.polyfit(away, phi, 2, w=1 - (away / REACH) ** 2))
    zeros = zeros[np.abs(zeros.imag) < 1e-9].real
    if len(zeros) == 0:
        return counted
    # contact ends on the touched edge, or on the next where no point happens to be loaded
    following = ends[at + side, 1] - ends[at + side, 0]
    zero = float(np.clip(zeros[np.abs(zeros).argmin()], -1.0, following / length))
    return border + side * zero * length
