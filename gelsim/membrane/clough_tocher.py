"""Clough-Tocher interpolation as linear operators: made once for nodes and places, then applied to the values of many states.

A triangle with values f and gradients g at its corners is cut in three at its centroid, on each third a cubic, together once continuously
differentiable. In Bernstein-Bezier form, numbers by exponent of (corner 1, corner 2, corner 3, centroid), e_ij = V_j - V_i:

    c3000 = f₁,   c2100 = f₁ + g₁·e₁₂/3,   c2001 = (c3000 + c2100 + c2010)/3,   … and so on by symmetry,
    c1101 = (w (c3000 - 3 c2100 + 3 c1200 - c0300) - c3000 + 2 c2100 - c1200 + c2001 + c0201)/2 … so that the derivative across the edge,
            taken along the line to the centroid of the triangle behind it, is linear along the edge (Alfeld 1984); w is where that line
            meets the edge, -½ at the rim,
    c1002 = (c2001 + c1101 + c1011)/3,     c0003 = (c1002 + c0102 + c0012)/3.

The gradients are those of least curvature along the edges (Nielson 1983): for every node i, over its neighbours j,

    Σ_j e_ij (4 g_i·e_ij + 2 g_j·e_ij + 6 (f_i - f_j)) / |e_ij|³ = 0,

a sparse, symmetric, positive definite system, factorised once. The result is that of scipy.interpolate.CloughTocher2DInterpolator, which
solves the same system by iteration and evaluates state by state (a test compares them).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay, KDTree
from threadpoolctl import threadpool_limits


class Interpolation:
    """Between nodes of the plane."""

    def __init__(self, nodes: NDArray[np.float64]) -> None:
        """From the nodes' places, shape (G, 2), not all on one line."""
        # One thread: Qhull's transforms are thousands of LAPACK calls on 2 x 2 matrices, for each of which OpenBLAS would wake all cores,
        # and wait for them while others use them (1000 points on two busy cores: 15.6 s of processor time, and 3 ms so).
        with threadpool_limits(1):
            self._triangles = Delaunay(nodes)
            _ = self._triangles.transform
        self._nodes = nodes
        self._system, self._right = _least_curvature(nodes, self._triangles)
        self._factors = splu(self._system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0.0)

    def with_gradients(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values at the nodes (G, C), below them their gradients' x and then y components: shape (3 G, C)."""
        gradients = self._factors.solve(self._right @ values)
        return np.concatenate([values, gradients[0::2], gradients[1::2]])

    def operator(self, places: NDArray[np.float64]) -> sparse.csr_array:
        """What `with_gradients` is multiplied by to have the values at places (P, 2): sparse, (P, 3 G).

        Beyond the rim, where a place lies by a rounding error, the nearest node's value holds.
        """
        count = len(self._nodes)
        with threadpool_limits(1):
            triangle = self._triangles.find_simplex(places)
        inside = triangle >= 0
        transform = self._triangles.transform[triangle]
        first = np.einsum("pij,pj->pi", transform[:, :2], places - transform[:, 2])
        share = np.column_stack([first, 1 - first.sum(axis=1)])
        corner = self._triangles.simplices[triangle]
        cut = _cut(self._triangles)[triangle]
        # Corners turned so that the place lies in the third between corners 1, 2 and the centroid.
        turn = (np.argmin(share, axis=1)[:, None] + np.array([1, 2, 0])) % 3
        share, cut = (np.take_along_axis(of, turn, axis=1) for of in (share, cut))
        corner = np.take_along_axis(corner, turn, axis=1)
        weight = _weights(share, cut)
        at = self._nodes[corner]
        columns, entries = [corner], [weight[:, :3]]
        # From derivatives along the two edges that leave a corner to its gradient.
        edges = [[at[:, (i + step) % 3] - at[:, i] for step in (1, 2)] for i in range(3)]
        for axis in (0, 1):
            columns.append(corner + (1 + axis) * count)
            slopes = [weight[:, 3 + 2 * i] * edges[i][0][:, axis] + weight[:, 4 + 2 * i] * edges[i][1][:, axis] for i in range(3)]
            entries.append(np.stack(slopes, axis=1))
        column, entry = np.concatenate(columns, axis=1), np.concatenate(entries, axis=1)
        if not inside.all():
            entry[~inside] = 0.0
            _, column[~inside, 0] = KDTree(self._nodes).query(places[~inside])
            entry[~inside, 0] = 1.0
        starts = np.arange(0, 9 * len(places) + 1, 9, dtype=np.int32)
        parts = entry.ravel(), column.ravel().astype(np.int32), starts
        return sparse.csr_array(parts, shape=(len(places), 3 * count))


def _least_curvature(nodes: NDArray[np.float64], triangles: Delaunay) -> tuple[sparse.csc_array, sparse.csr_array]:
    """Matrix of the gradients (x, y of node 0, of node 1, …), and that which makes its right side of the values."""
    starts, other = triangles.vertex_neighbor_vertices
    one, count = np.repeat(np.arange(len(nodes)), np.diff(starts)), len(nodes)
    edge = nodes[other] - nodes[one]
    length = np.linalg.norm(edge, axis=1) ** 3
    row, column, entry = [], [], []
    for i in (0, 1):
        for j in (0, 1):
            product = edge[:, i] * edge[:, j] / length
            row += [2 * one + i, 2 * one + i]
            column += [2 * one + j, 2 * other + j]
            entry += [4 * product, 2 * product]
    matrix = sparse.csc_array((np.concatenate(entry), (np.concatenate(row), np.concatenate(column))), shape=(2 * count, 2 * count))
    row = np.concatenate([2 * one + i for i in (0, 1) for _ in (0, 1)])
    column = np.concatenate([which for _ in (0, 1) for which in (other, one)])
    entry = np.concatenate([sign * 6 * edge[:, i] / length for i in (0, 1) for sign in (1, -1)])
    return matrix, sparse.csr_array((entry, (row, column)), shape=(2 * count, count))


def _cut(triangles: Delaunay) -> NDArray[np.float64]:
    """w of the edge opposite to each corner, that runs from the next corner to the one after; shape (T, 3)."""
    behind = triangles.neighbors
    centres = triangles.points[triangles.simplices].mean(axis=1)
    transform = triangles.transform
    cut = np.full(behind.shape, -0.5)
    for k in range(3):
        inner = behind[:, k] >= 0
        first = np.einsum("tij,tj->ti", transform[inner, :2], centres[behind[inner, k]] - transform[inner, 2])
        share = np.column_stack([first, 1 - first.sum(axis=1)])
        near, far = share[:, (k + 1) % 3], share[:, (k + 2) % 3]
        cut[inner, k] = (2 * far + near - 1) / (2 - 3 * far - 3 * near)
    return cut


def _weights(share: NDArray[np.float64], cut: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of f₁, f₂, f₃ and of g_i·e_i,i+1, g_i·e_i,i+2 for i = 1, 2, 3 in the value at a place whose third share is its smallest; (P, 9).

    Args:
        share: Barycentric coordinates, (P, 3). cut: w of the edges opposite to the corners, (P, 3).
    """
    third = share[:, 2]
    a, b, m = share[:, 0] - third, share[:, 1] - third, 3 * third
    # The cubic's Bernstein polynomials, by control point; each control point is a row of weights of the nine.
    basis = {
        "3000": a**3, "2100": 3 * a**2 * b, "1200": 3 * a * b**2, "0300": b**3, "2001": 3 * a**2 * m, "1101": 6 * a * b * m,
        "0201": 3 * b**2 * m, "1002": 3 * a * m**2, "0102": 3 * b * m**2, "0003": m**3,
    }  # fmt: skip
    one = np.eye(9)
    corner = [one[i] for i in range(3)]
    toward = {(i, (i + step) % 3): corner[i] + one[3 + 2 * i + step - 1] / 3 for i in range(3) for step in (1, 2)}
    inner = [(corner[i] + toward[i, (i + 1) % 3] + toward[i, (i + 2) % 3]) / 3 for i in range(3)]
    # Middle of each third, on the edge opposite to corner k: a constant part, and one that is multiplied by w.
    middle = []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        level = (-corner[i] + 2 * toward[i, j] - toward[j, i] + inner[i] + inner[j]) / 2
        middle.append((level, (-corner[i] + 3 * toward[i, j] - 3 * toward[j, i] + corner[j]) / 2))
    # Toward the centroid they are means of neighbours, so each middle counts with these weights.
    for_middle = [np.zeros(len(share)) for _ in range(3)]
    for_middle[2] += basis["1101"]
    for_inner = [basis["2001"].copy(), basis["0201"].copy(), np.zeros(len(share))]
    for point, values in ((0, basis["1002"]), (1, basis["0102"])):
        _spread(for_inner, for_middle, point, values / 3)
    for point in range(3):
        _spread(for_inner, for_middle, point, basis["0003"] / 9)
    known = np.stack([
        basis["3000"], basis["0300"], basis["2100"], basis["1200"], *for_inner, *for_middle, *(cut[:, k] * for_middle[k] for k in range(3))
    ], axis=1)  # fmt: skip
    rows = [corner[0], corner[1], toward[0, 1], toward[1, 0], *inner, *(level for level, _ in middle), *(slope for _, slope in middle)]
    return known @ np.array(rows)


def _spread(for_inner: list[NDArray[np.float64]], for_middle: list[NDArray[np.float64]], point: int, values: NDArray[np.float64]) -> None:
    """The control point between corner and centroid: mean of the one nearer to the corner and of the middles of the two thirds there."""
    for_inner[point] += values
    for k in range(3):
        if k != point:
            for_middle[k] += values
