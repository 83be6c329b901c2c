"""Whether an object's surface comes to touch itself, which the contact here does not model: a warning, no force.

Two faces of the object's outer surface face each other when the line between their middles leaves both through their outer sides and their
normals point against each other; their gap is the distance along the normal. The warning is due when a gap that was open at rest is closed,
or would close within another step like the last. Only pairs side by side are looked at: off each other's axis by no more than a face.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_AGAINST = -0.5
"""Cosine between two normals below which they point against each other."""


def closing_gap(rest: Array, faces: NDArray[np.int32], displacement: Array) -> tuple[int, float] | None:
    """The first state in which the surface touches itself or will with the next step, and the gap left there [m]; None if there is none.

    Args:
        rest: (V, 3) [m]. faces: (F, 3), outward. displacement: (N, V, 3) [m].
    """
    from scipy.spatial import KDTree

    middle, normal, size = _frames(rest, faces)
    # two faces that are farther apart than both have moved against the middle of all, twice for the step after the last, do not meet
    moved = displacement - 0.5 * (displacement.min(axis=1, keepdims=True) + displacement.max(axis=1, keepdims=True))
    reach = 4.0 * float(np.linalg.norm(moved, axis=-1).max()) + float(size.max())
    one, two = KDTree(middle).query_pairs(min(reach, float(np.ptp(rest, axis=0).max())), output_type="ndarray").T
    facing = (normal[one] * normal[two]).sum(axis=1) < _AGAINST
    one, two = one[facing], two[facing]
    across = middle[two] - middle[one]
    gap = (across * normal[one]).sum(axis=1)
    aside = np.linalg.norm(across - gap[:, None] * normal[one], axis=1)
    open_ = (gap > 0) & ((across * normal[two]).sum(axis=1) < 0) & (aside < 0.5 * (size[one] + size[two]))
    one, two, before = one[open_], two[open_], gap[open_]
    for state, shift in enumerate(displacement):
        if not len(one):
            return None
        middle, normal, _ = _frames(rest + shift, faces)
        gap = ((middle[two] - middle[one]) * normal[one]).sum(axis=1)
        if (2 * gap - before).min() <= 0.0:
            return state, float(max(gap.min(), 0.0))
        before = gap
    return None


def _frames(points: Array, faces: NDArray[np.int32]) -> tuple[Array, Array, Array]:
    """Middles (F, 3), unit normals (F, 3) and longest edges (F,) of triangles."""
    corners = points[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return corners.mean(axis=1), cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300), edges.max(axis=1)
