"""Flexible GMRES for many systems at once (Saad 1993), right-preconditioned by factorisations of earlier matrices.

Each system has its own Krylov space; products, preconditioning and inner products of all are one launch each, what is left of a system's
Hessenberg matrix is turned by Givens rotations on the host. A system that has reached its tolerance is left out of the preconditioner.

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
def scale(w: wp.array(dtype=wp.float64), factor: wp.array(dtype=wp.float64), n: wp.int32, out: wp.array(dtype=wp.float64)):
    i = wp.tid()
    scaled = wp.float64(0.0)
    if factor[i // n] != wp.float64(0.0):  # what is left out may not be finite
        scaled = factor[i // n] * w[i]
    out[i] = scaled


class BatchedGmres:
    """`count` systems of `n` unknowns, vectors of one after those of the other."""

    def __init__(self, count: int, n: int, device: str) -> None:
        self.count, self.n, self.device = count, n, device
        length = count * n
        self.basis = wp.zeros((LIMIT + 1, length), dtype=wp.float64, device=device)
        self.preconditioned = wp.zeros((LIMIT, length), dtype=wp.float64, device=device)
        self.w = wp.zeros(length, dtype=wp.float64, device=device)
        self.of_lane = wp.zeros((LIMIT + 1, count * LANES), dtype=wp.float64, device=device)
        self.products = wp.zeros((LIMIT + 1, count), dtype=wp.float64, device=device)
        self.factor = wp.zeros((LIMIT, count), dtype=wp.float64, device=device)
        self.factor1 = wp.zeros(count, dtype=wp.float64, device=device)

    def solve(self, product: Callable[[wp.array, wp.array], None], precondition: Callable[[wp.array, wp.array, Mask], None], b: wp.array,
              x: wp.array, which: Mask, tolerance: float | Array, limit: int = LIMIT) -> tuple[NDArray[np.int64], Array]:  # fmt: skip
        """Solves the systems `which` into x; the others' places are left alone.

        Args:
            product: Writes the product of all systems' matrices with its first argument into its second.
            tolerance: |b - K x|/|b| to stop at, of all or of each system.
            precondition: Writes M⁻¹ of its first argument into its second, for the systems of the mask.
        Returns:
            Products used by each system, and the residual that is left over |b|.
        """
        count, limit = self.count, min(limit, LIMIT)
        norm = np.sqrt(self._inner(b, b))
        live = which & (norm > 0)
        self._scaled(b, np.where(live, 1.0 / np.where(norm > 0, norm, 1.0), 0.0), self.basis[0])
        hessenberg = np.zeros((count, limit + 1, limit))
        right = np.zeros((count, limit + 1))
        right[:, 0] = np.where(live, norm, 0.0)
        cosine, sine = np.zeros((count, limit)), np.zeros((count, limit))
        used = np.zeros(count, np.int64)
        left = np.where(live, 1.0, 0.0)
        for j in range(limit):
            if not live.any():
                break
            precondition(self.basis[j], self.preconditioned[j], live)
            product(self.preconditioned[j], self.w)
            h = self._projected(j + 1)
            self.factor[: j + 1].assign(h)
            wp.launch(subtract, count * self.n, [self.basis, j + 1, self.factor, self.n, self.w], device=self.device)
            length = np.sqrt(self._inner(self.w, self.w))
            self._scaled(self.w, np.where(length > 0, 1.0 / np.where(length > 0, length, 1.0), 0.0), self.basis[j + 1])
            column = np.concatenate([h.T, length[:, None]], axis=1)
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
        weights = np.zeros((limit, count))
        for scene in np.flatnonzero(used):
            k = used[scene]
            upper = hessenberg[scene, :k, :k]
            if np.isfinite(upper).all() and (np.diag(upper) != 0).all():
                weights[:k, scene] = np.linalg.solve(upper, right[scene, :k])
            else:
                left[scene] = np.inf
        self._scaled(x, np.where(which, 0.0, 1.0), x)
        self.factor[:limit].assign(-weights)
        wp.launch(subtract, count * self.n, [self.preconditioned, limit, self.factor, self.n, x], device=self.device)
        return used, left

    def _inner(self, a: wp.array, b: wp.array) -> Array:
        """a·b of each system."""
        return self._products(a.reshape((1, -1)), b, 1)[0]

    def _projected(self, vectors: int) -> Array:
        """Inner products of w with the first basis vectors, (vectors, systems)."""
        return self._products(self.basis, self.w, vectors)

    def _products(self, basis: wp.array, w: wp.array, vectors: int) -> Array:
        wp.launch(lane_products, (vectors, self.count * LANES), [basis, w, self.n, LANES, self.of_lane], device=self.device)
        wp.launch(add_lanes, (vectors, self.count), [LANES, self.of_lane, self.products], device=self.device)
        return self.products[:vectors].numpy().copy()

    def _scaled(self, w: wp.array, factor: Array, out: wp.array) -> None:
        self.factor1.assign(factor)
        wp.launch(scale, self.count * self.n, [w, self.factor1, self.n, out], device=self.device)
