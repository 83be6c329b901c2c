"""How much of the gel's outer face touches the object: from two readings, each with errors of its own, the second counting twice.

A quadratic face that contact ends on cannot follow the true pressure and gap; which of its quadrature points are loaded is known to about
half their distance. Area is read

1. from the points that are loaded: the sum of their shares of the face;
2. from the gap beyond: at the end of a smooth contact it opens like (distance)^(3/2), so φ = gap^(2/3) is smooth and begins at zero there
   (Johnson 1985, §5.1 and App. 1). The area A(φ < t) of some levels t beyond the partly loaded faces is fitted by a parabola in t and read
   at t = 0. Of a round contact, whose φ grows with r, and of a long one, A is such a parabola (Steiner's formula for parallel curves).

The second is kept within an eighth of the partly loaded faces' area from the first: where such faces are large its levels lie far from the
contact, where A is no parabola any more. Where pressure rises toward the end, as at a sharp rim, the gap does not open so, and points are
counted. How far either is off on solved presses: docs/mechanics.md §4.

Left out: contact that ends on a face without loaded points, beside one that has some; places of ends, as all that is
told is one area of the body. The pressure within, which vanishes like √distance, tells the area too, but scatters more than either.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.contact import LOOKED_MM
from gelsim.fem.elements import tri6_gradient, tri6_shape, triangle_quadrature
from gelsim.geometry import split_faces

Array = NDArray[np.float64]

_PARTS = split_faces(np.arange(6, dtype=np.int32)[None, :])
"""The four triangles (4, 3) between a face's six nodes."""
_NODES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
_UNIT = 2 / 3
"""Quantile over the partly loaded faces of their largest φ, the unit of its levels: contact ends a part of an edge before."""
GAPS = np.linspace(0.7, 5.0, 16)
"""Levels of φ in that unit."""
_CUT = 0.7
"""Levels are used up to this share of what φ is at LOOKED_MM, where gaps are cut off: below, few faces have points that are."""
_WIDEST = 5.0
"""Levels of the gap are used as far as their area is so many times that of the loaded points: far away nothing is a parabola."""
_FARTHEST = 0.125
"""Share of the partly loaded faces' area by which the second reading may differ from the first."""
_FEWEST = 4
"""Levels of a fit of three numbers."""


def touching_area(places: Array, faces: NDArray[np.int32], gap: Array, pressure: Array) -> float:
    """Area in contact, projected on the plane z = 0.

    Args:
        places: Where the nodes (N, 3) are now.
        faces: (F, 6) of them, corners first.
        gap: Of the faces' quadrature points (F, Q) [mm]; large where there is no object within LOOKED_MM.
        pressure: There; 0 where they do not touch.
    Returns:
        [mm²] if `places` are in mm.
    """
    loaded: NDArray[np.bool_] = np.asarray(pressure > 0.0)
    touched, full = np.asarray(loaded.any(axis=1)), np.asarray(loaded.all(axis=1))
    if not touched.any():
        return 0.0
    nodes = places[faces]
    bary, rule = triangle_quadrature(gap.shape[1])
    tangents = np.einsum("fni,qnj->fqij", nodes, tri6_gradient(bary))
    seen = np.abs(np.cross(tangents[..., 0], tangents[..., 1])[..., 2]) * rule
    counted = float(seen[loaded].sum())
    part = touched & ~full
    if not part.any() or _rises(faces, full, pressure):
        return counted
    beyond = _by_gap(nodes, bary, gap, loaded, counted)
    if beyond is None:
        return counted
    away = _FARTHEST * float(seen[part].sum())
    return (counted + 2.0 * float(np.clip(beyond, counted - away, counted + away))) / 3.0


def _rises(faces: NDArray[np.int32], full: NDArray[np.bool_], pressure: Array) -> bool:
    """Whether wholly loaded faces beside others carry as much as those that are surrounded by their like."""
    inner = full & ~np.isin(faces[:, :3], faces[~full, :3]).any(axis=1)
    outer = full & ~inner
    return bool(inner.any() and outer.any() and pressure[outer].mean() >= pressure[inner].mean())


def _by_gap(nodes: Array, bary: Array, gap: Array, loaded: NDArray[np.bool_], counted: float) -> float | None:
    """The second reading; None where no levels lie around the contact."""
    phi: Array = np.where(loaded, 0.0, np.cbrt(np.clip(gap, 0.0, LOOKED_MM)) ** 2)
    touched = np.asarray(loaded.any(axis=1))
    unit = float(np.quantile(phi[touched & ~loaded.all(axis=1)].max(axis=1), _UNIT))
    if unit <= 0.0:
        return None
    near = phi.min(axis=1) < 1.5 * GAPS[-1] * unit
    phi, touched = phi[near], touched[near]
    smooth = phi @ np.linalg.pinv(tri6_shape(bary)).T
    smooth[touched] = phi[touched] @ np.linalg.pinv(bary).T @ _NODES.T  # pressure leaves a kink there
    areas = areas_below(nodes[near], smooth, GAPS * unit)
    used = (areas < _WIDEST * counted) & (GAPS * unit < _CUT * LOOKED_MM ** (2 / 3))
    return float(np.polyval(np.polyfit(GAPS[used], areas[used], 2), 0.0)) if used.sum() >= _FEWEST else None


def areas_below(nodes: Array, values: Array, levels: Array) -> Array:
    """Area (L,), seen along z, of where a field of nodal values (F, 6), linear on each of a face's four triangles, is below levels (L,)."""
    corners = nodes[:, _PARTS, :2].reshape(-1, 3, 2)
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    a, b, c = np.sort(values[:, _PARTS].reshape(-1, 3), axis=1).T
    t = np.asarray(levels)[:, None]
    tiny = np.finfo(float).tiny
    with np.errstate(over="ignore"):  # where two of the values are one; t is not between them then
        lower = (t - a) ** 2 / np.maximum((b - a) * (c - a), tiny)
        upper = 1.0 - (c - t) ** 2 / np.maximum((c - a) * (c - b), tiny)
    share = np.where(t <= a, 0.0, np.where(t >= c, 1.0, np.where(t <= b, lower, upper)))
    return share @ area
