"""Flexible GMRES for many systems at once (Saad 1993), right-preconditioned by factorisations of earlier matrices.

Each system has its own Krylov space; products, preconditioning and inner products of all are one launch each. Vectors and the numbers that
they are scaled by stay on the device: the host reads each step's column of the Hessenberg matrices, once, and turns it by Givens rotations.
A system that has reached its tolerance is left out of the preconditioner.

Gram-Schmidt is done once, classically: the spaces are short (`LIMIT`) and the answers rough (Newton's steps).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.fem.batch_kernels import LANES

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

LIMIT = 12
"""Longest Krylov space."""
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@wp.kernel(enable_backward=False)
def multiply(
    start: wp.array(dtype=wp.int32), column: wp.array(dtype=wp.int32), values: wp.array(dtype=wp.float64), n: wp.int32,
    x: wp.array(dtype=wp.float64), y: wp.array(dtype=wp.float64),
):  # fmt: skip
    """y += K x of symmetric matrices that share a pattern, given by their upper triangles."""
    i = wp.tid()
    scene = i // n
    row = i % n
    base = scene * n
    entries = scene * start[n]
    own = x[i]
    sum = wp.float64(0.0)
    for k in range(start[row], start[row + 1]):
        v = values[entries + k]
        j = base + column[k]
        sum += v * x[j]
        if j != i:
            wp.atomic_add(y, j, v * own)
    wp.atomic_add(y, i, sum)


@wp.kernel(enable_backward=False)
def lane_products(basis: wp.array2d(dtype=wp.float64), w: wp.array(dtype=wp.float64), n: wp.int32, lanes: wp.int32,
                  total: wp.array2d(dtype=wp.float64)):  # fmt: skip
    """Of each basis vector with w, lane by lane of each system."""
    v, lane = wp.tid()
    scene = lane // lanes
    sum = wp.float64(0.0)
    k = lane % lanes
    while k < n:
        i = scene * n + k
        sum += basis[v, i] * w[i]
        k += lanes
    total[v, lane] = sum


@wp.kernel(enable_backward=False)
def add_lanes(lanes: wp.int32, of_lane: wp.array2d(dtype=wp.float64), total: wp.array2d(dtype=wp.float64)):
    v, scene = wp.tid()
    sum = wp.float64(0.0)
    for lane in range(lanes):
        sum += of_lane[v, scene * lanes + lane]
    total[v, scene] = sum


@wp.kernel(enable_backward=False)
def subtract(basis: wp.array2d(dtype=wp.float64), count: wp.int32, factor: wp.array2d(dtype=wp.float64), n: wp.int32,
             w: wp.array(dtype=wp.float64)):  # fmt: skip
    """w -= Σ factor · basis, the factors each system's own."""
    i = wp.tid()
    scene = i // n
    sum = w[i]
    for v in range(count):
        if factor[v, scene] != wp.float64(0.0):  # a vector that is not finite may lie there
            sum -= factor[v, scene] * basis[v, i]
    w[i] = sum


@wp.kernel(enable_backward=False)
def normalise(w: wp.array(dtype=wp.float64), squared: wp.array2d(dtype=wp.float64), n: wp.int32, out: wp.array(dtype=wp.float64)):
    """w over its length, system by system; 0 where that is 0 or not finite."""
    i = wp.tid()
    factor = wp.float64(0.0)
    if squared[0, i // n] > wp.float64(0.0):
        factor = wp.float64(1.0) / wp.sqrt(squared[0, i // n])
    scaled = wp.float64(0.0)
    if factor != wp.float64(0.0):
        scaled = factor * w[i]
    out[i] = scaled


@wp.kernel(enable_backward=False)
def combine(basis: wp.array2d(dtype=wp.float64), count: wp.int32, weight: wp.array2d(dtype=wp.float64), n: wp.int32,
            x: wp.array(dtype=wp.float64)):  # fmt: skip
    """x = Σ weight · basis of the systems whose last weight is 0; the others' x is left alone."""
    i = wp.tid()
    scene = i // n
    if weight[count, scene] != wp.float64(0.0):
        return
    sum = wp.float64(0.0)
    for v in range(count):
        if weight[v, scene] != wp.float64(0.0):  # a vector that is not finite may lie there
            sum += weight[v, scene] * basis[v, i]
    x[i] = sum


class BatchedGmres:
    """`count` systems of `n` unknowns, vectors of one after those of the other."""

    def __init__(self, count: int, n: int, device: str) -> None:
        self.count, self.n, self.device = count, n, device
        length = count * n

        def zeros(*shape: int) -> wp.array:
            return wp.zeros(shape, dtype=wp.float64, device=device)

        self.basis, self.preconditioned, self.w = zeros(LIMIT + 1, length), zeros(LIMIT, length), zeros(length)
        self.of_lane = zeros(LIMIT + 1, count * LANES)
        # b·b, then of the last step the products of w with the vectors before it, then w·w of what was left of w
        self.sums, self.weights = zeros(LIMIT + 2, count), zeros(LIMIT + 1, count)
        self._rows = [self.sums[k : k + 1] for k in range(LIMIT + 2)]
        self._vectors = [(self.basis[k], self.preconditioned[min(k, LIMIT - 1)]) for k in range(LIMIT + 1)]
        self._factors, self._w = self.sums[1:], self.w.reshape((1, -1))

    def solve(self, product: Callable[[wp.array, wp.array], None], precondition: Callable[[wp.array, wp.array, Mask], None], b: wp.array,
              x: wp.array, which: Mask, tolerance: float | Array) -> tuple[NDArray[np.int64], Array]:  # fmt: skip
        """Solves the systems `which` into x; the others' places are left alone.

        Args:
            product: Writes the product of all systems' matrices with its first argument into its second.
            tolerance: |b - K x|/|b| to stop at, of all or of each system.
            precondition: Writes M⁻¹ of its first argument into its second, for the systems of the mask.
        Returns:
            Products used by each system, and the residual that is left over |b|.
        """
        count = self.count
        hessenberg = np.zeros((count, LIMIT + 1, LIMIT))
        cosine, sine = np.zeros((count, LIMIT)), np.zeros((count, LIMIT))
        right, norm = np.zeros((count, LIMIT + 1)), np.ones(count)
        used, left, live = np.zeros(count, np.int64), np.zeros(count), which
        self._begin(b)
        for j in range(LIMIT):
            if not live.any():
                break
            precondition(*self._vectors[j], live)
            self._extend(product, j)
            sums = self.sums[: j + 3].numpy()
            if j == 0:
                norm = np.sqrt(sums[0])
                live = which & (norm > 0)
                right[:, 0] = np.where(live, norm, 0.0)
            column = sums[1:].T.copy()
            column[:, -1] = np.sqrt(column[:, -1])
            for k in range(j):
                upper = cosine[:, k] * column[:, k] + sine[:, k] * column[:, k + 1]
                column[:, k + 1] = -sine[:, k] * column[:, k] + cosine[:, k] * column[:, k + 1]
                column[:, k] = upper
            size = np.hypot(column[:, j], column[:, j + 1])
            safe = np.where(size > 0, size, 1.0)
            cosine[:, j], sine[:, j] = np.where(size > 0, column[:, j] / safe, 1.0), column[:, j + 1] / safe
            column[:, j], column[:, j + 1] = size, 0.0
            hessenberg[live, : j + 2, j] = column[live]
            right[live, j + 1] = (-sine[:, j] * right[:, j])[live]
            right[live, j] = (cosine[:, j] * right[:, j])[live]
            used[live] = j + 1
            left[live] = np.abs(right[live, j + 1]) / norm[live]
            live = live & (left > tolerance) & np.isfinite(left)
        weights = np.zeros((LIMIT + 1, count))
        weights[LIMIT] = ~which
        for scene in np.flatnonzero(used):
            k = used[scene]
            upper = hessenberg[scene, :k, :k]
            if np.isfinite(upper).all() and (np.diag(upper) != 0).all():
                weights[:k, scene] = np.linalg.solve(upper, right[scene, :k])
            else:
                left[scene] = np.inf
        self.weights.assign(weights)
        wp.launch(combine, count * self.n, [self.preconditioned, LIMIT, self.weights, self.n, x], device=self.device)
        return used, left

    def _begin(self, b: wp.array) -> None:
        """The first vector of each basis."""
        self._products(b.reshape((1, -1)), b, 0, 1)
        wp.launch(normalise, self.count * self.n, [b, self._rows[0], self.n, self.basis[0]], device=self.device)

    def _extend(self, product: Callable[[wp.array, wp.array], None], j: int) -> None:
        """The next vector of each basis, from the j-th preconditioned one."""
        product(self._vectors[j][1], self.w)
        self._products(self.basis, self.w, 1, j + 1)
        wp.launch(subtract, self.count * self.n, [self.basis, j + 1, self._factors, self.n, self.w], device=self.device)
        self._products(self._w, self.w, j + 2, 1)
        wp.launch(normalise, self.count * self.n, [self.w, self._rows[j + 2], self.n, self._vectors[j + 1][0]], device=self.device)

    def _products(self, basis: wp.array, w: wp.array, row: int, vectors: int) -> None:
        """Inner products of w with the first `vectors` of a basis, into `sums` from a row on."""
        wp.launch(lane_products, (vectors, self.count * LANES), [basis, w, self.n, LANES, self.of_lane], device=self.device)
        wp.launch(add_lanes, (vectors, self.count), [LANES, self.of_lane, self.sums[row:]], device=self.device)
