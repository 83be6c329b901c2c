"""Graded tetrahedra in a box by bisection: the same box and sizes give the same mesh, bit for bit.

The box is cut into near cubes, each cube into the six tets along the paths between two opposite corners (Freudenthal, Kuhn), neighbouring
cubes as mirror images of each other. A tet that is too large is cut at the middle of its longest edge, together with every tet around
that edge; where one of them has a longer edge, that one is cut first (Rivara 1984). Corners are kept in whole numbers, in a space where the
cubes are cubes: there every tet has one longest edge, lengths are compared without rounding, and three cuts give a tet of half the first
one's shape (Maubach 1995). So of a cube's tets only three shapes occur, of mean-ratio quality 0.756, 0.762 and 0.8, with dihedral angles
from 45 to 120 degrees; a box whose cells are no cubes shears them.

Left out: coarsening, and anything but boxes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gelsim.geometry import TET_EDGES, edges_of

Array = NDArray[np.float64]
Lattice = NDArray[np.int64]
Tets = NDArray[np.int64]
UNIT = 1 << 20
"""Lattice steps of a cell's side: it can be halved twenty times, in sixty cuts."""


def cells_across(extent: Array) -> NDArray[np.int64]:
    """Cells along each axis (3,) of a box, nearest to cubes with one across the narrowest; a cell's sides are within √2 of that."""
    ratio = extent / extent.min()
    below = np.floor(ratio * (1 + 1e-12))
    return np.where(ratio**2 > below * (below + 1), below + 1, below).astype(np.int64)


def kuhn_box(cells: NDArray[np.int64]) -> tuple[Lattice, Tets]:
    """Corners (V, 3) and positively oriented tets (T, 4) of a box of cells, six tets each."""
    lines = [np.arange(n + 1) for n in cells]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(np.array(cells) + 1)
    low = points[(points < cells).all(axis=1)]
    # The path starts at the corner of even numbers and ends at that of odd ones: cells that share a face agree about its diagonal.
    start = low + low % 2
    step = 1 - 2 * (low % 2)
    tets = []
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        path = [start]
        for axis in order:
            path.append(path[-1] + step * (np.arange(3) == axis))
        tets.append(np.stack([number[tuple(p.T)] for p in path], axis=1))
    return points * UNIT, _upright(points, np.stack(tets, axis=1).reshape(-1, 4))


def _upright(points: Lattice, tets: Tets) -> Tets:
    a, b, c, d = (points[tets[:, i]] for i in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[turned] = tets[turned][:, [1, 0, 2, 3]]
    return tets


def refine(points: Lattice, tets: Tets, too_large: Callable[[Lattice, Tets], NDArray[np.bool_]]) -> tuple[Lattice, Tets]:
    """Cuts tets until none is too large and no face has a corner within.

    Args:
        too_large: Says which of some tets (T,) are; a tet small enough must be let through in the end.
    """
    large = too_large(points, tets)
    while large.any():
        edges, index = edges_of(tets.astype(np.int32), TET_EDGES)
        length = ((points[edges[:, 0]] - points[edges[:, 1]]) ** 2).sum(axis=1)
        longest = index[np.arange(len(tets)), length[index].argmax(axis=1)]
        cut = np.zeros(len(edges), bool)
        cut[longest[large]] = True
        while True:  # a tet around an edge to be cut has its own longest edge cut, now or before
            reached = longest[cut[index].any(axis=1)]
            if cut[reached].all():
                break
            cut[reached] = True
        final = np.ones(len(edges), bool)
        final[index.ravel()[(index != longest[:, None]).ravel()]] = False
        at = np.flatnonzero(cut & final)  # the longest edge of every tet around it: some always are
        points = np.vstack([points, points[edges[at]].sum(axis=1) // 2])
        middle = np.zeros(len(edges), np.int64)
        middle[at] = np.arange(len(points) - len(at), len(points))
        mine = middle[longest] > 0
        children = split(tets[mine], edges[longest[mine]], middle[longest[mine]])
        tets, large = np.vstack([tets[~mine], children]), np.concatenate([large[~mine], too_large(points, children)])
    return points, tets


def split(tets: Tets, edge: NDArray[np.int64], middle: NDArray[np.int64]) -> Tets:
    """Both halves (2 T, 4) of tets cut at points `middle` (T,) of one edge (T, 2) each, as they were oriented."""
    return np.vstack([np.where(tets == edge[:, [end]], middle[:, None], tets) for end in (1, 0)])
