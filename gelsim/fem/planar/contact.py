"""Contact of the gel's outer edge with the object's, in the plane: the equations of `gelsim.fem.contact` with edges for faces. NumPy.

Each Gauss point of the gel's three-node edges looks for the closest point y(ξ) on the object's three-node (curved) edges. With t = y,ξ the
outward normal is n = (t_z, -t_x)/|t|, the object lying left of t, and the Hessian of the gap

    D²g = -T Nᵀ - N Tᵀ - b T Tᵀ,   T·δ = t·(δx - δy)/|t|²,   N·δ = n·δy,ξ,   b = n·y,ξξ .

Weights are rest lengths, times r on bodies of revolution. Friction acts in the plane.

A point that is near and within its edge keeps it; the others seek the object's nearest node and project on the edges that meet there. The
numbers are small (hundreds of points): vectors in NumPy, no kernels.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from gelsim.fem.contact import NOWHERE, ContactLaw, SurfaceContact
from gelsim.fem.friction import slip_bound_slope
from gelsim.fem.pattern import PairPattern
from gelsim.fem.planar.elements import EDGE_CURVATURE, edge_gradient, edge_quadrature, edge_shape

Array = NDArray[np.float64]

NEAR, OVERHANG = 0.1, 0.1
"""Within which a point keeps its edge [mm], and how far beside it (in ξ): neighbouring edges meet at a slight kink."""
_STEPS, _CLAMPED_STEPS = 3, 6
"""Gauss-Newton steps to the closest point of an edge, from that of the last iterate and from its middle."""


class EdgeContact(SurfaceContact):
    """`SurfaceContact` of edges (S, 3) in the plane y = 0: its methods and its state. Forces are per radian or per millimetre of depth."""

    CORNERS = 2
    OBLIQUE = False

    def __init__(self, gel_edges: NDArray[np.int32], object_edges: NDArray[np.int32], rest: Array, law: ContactLaw, turned: bool,
                 points: int = 4) -> None:  # fmt: skip
        self.law, self.device, self.points = law, "cpu", points
        self.slave_faces, self.master_faces = gel_edges, object_edges
        place, rule = edge_quadrature(points)
        self.shape_values = edge_shape(place)
        corners = rest[gel_edges][..., [0, 2]]
        stretch = np.linalg.norm(np.einsum("qn,eni->eqi", edge_gradient(place), corners), axis=-1)
        weight = stretch * rule
        length = weight.sum(1)
        self.rest_weight = (weight * (corners[..., 0] @ self.shape_values.T if turned else 1.0)).ravel()
        count = len(self.rest_weight)

        def array(data: object, dtype: object) -> wp.array:
            return wp.array(data, dtype=dtype, device="cpu")

        self.weight = array(self.rest_weight, wp.float64)
        self.face = array(np.full(count, -1), wp.int32)
        self.tied = wp.zeros(count, dtype=wp.int32, device="cpu")
        self.place = wp.zeros(count, dtype=wp.vec3d, device="cpu")
        self.normal = wp.zeros(count, dtype=wp.vec3d, device="cpu")
        self.gap = array(np.full(count, 1e9), wp.float64)
        self.pressure = wp.zeros(count, dtype=wp.float64, device="cpu")
        self.traction = wp.zeros(count, dtype=wp.vec3d, device="cpu")
        self.multiplier = wp.zeros(count, dtype=wp.float64, device="cpu")
        self.shift = wp.zeros(count, dtype=wp.vec3d, device="cpu")
        self.anchor_face = array(np.full(count, -1), wp.int32)
        self.anchor_place = wp.zeros(count, dtype=wp.vec3d, device="cpu")
        self.stiffness = array(law.stiffness / length, wp.float64)
        self.stick = array(law.stick_stiffness / length, wp.float64)
        self._k = np.repeat(law.stiffness / length, points)
        self._kt = np.repeat(law.stick_stiffness / length, points)
        self._slave = np.repeat(gel_edges, points, axis=0)
        self._m = np.tile(self.shape_values, (len(gel_edges), 1))

        self.used = np.unique(object_edges)
        meets = np.full((int(object_edges.max()) + 1, 2), -1)
        for side in range(3):  # a vertex ends one edge and begins the next; a middle lies on its own
            meets[object_edges[:, side], 1 if side == 1 else 0] = np.arange(len(object_edges))
        only = meets[self.used]
        self._meets = np.where(only < 0, only[:, ::-1], only)

        self.vertices, local = np.unique(gel_edges[:, :2], return_inverse=True)
        self._corner = local.reshape(-1, 2)
        self._bary = np.column_stack([1 - place, place])
        mass = np.einsum("fq,qa,qb->fab", self.rest_weight.reshape(-1, points), self._bary, self._bary)
        rows, columns = np.repeat(self._corner, 2, axis=1).ravel(), np.tile(self._corner, (1, 2)).ravel()
        matrix = sp.csc_matrix((mass.ravel(), (rows, columns)))
        self._projections = []
        for column in (None, 0, 1, 2):  # traction along x is zero on the axis
            free = np.abs(rest[self.vertices, 0]) > 1e-9 if column == 0 else np.ones(len(self.vertices), bool)
            self._projections.append((np.flatnonzero(free), splu(matrix[free][:, free])))
        self.multipliers = np.zeros((len(self.vertices), 4))
        self.kept, self.passed, self._apart = np.zeros((count, 4)), np.zeros((count, 3)), NOWHERE
        self._slots: tuple[PairPattern, tuple[Array, ...]] | None = None

    def _seen_at(self, bary: Array) -> EdgeContact:
        """The same surfaces with points where a face's lattice has its first side."""
        place = bary[bary[:, 2] == 0.0, 1]
        seen = copy.copy(self)
        seen._m, seen._slave = np.tile(edge_shape(place), (len(self.slave_faces), 1)), np.repeat(self.slave_faces, len(place), axis=0)
        count = len(seen._m)
        seen.face, seen.gap = (wp.full(count, value, dtype=kind, device="cpu") for value, kind in ((-1, wp.int32), (1e9, wp.float64)))
        seen.place, seen.normal = (wp.zeros(count, dtype=wp.vec3d, device="cpu") for _ in range(2))
        return seen

    def _master_shape(self, xi: Array) -> Array:
        return edge_shape(xi[:, 0])

    # ------------------------------------------------------------------------------------------------------------ closest points
    def update(self, x: wp.array, reach: float) -> None:
        flat = x.numpy()[:, [0, 2]]
        place = np.einsum("pn,pni->pi", self._m, flat[self._slave])
        face, xi, gap = self.face.numpy(), self.place.numpy(), self.gap.numpy()
        edges = flat[self.master_faces]

        keep = np.flatnonzero((face >= 0) & (np.abs(gap) < NEAR))
        found, offset = _feet(place[keep], edges[face[keep]], xi[keep, 0], clamp=False)
        stays = (found > -OVERHANG) & (found < 1 + OVERHANG) & (np.linalg.norm(offset, axis=1) < NEAR)
        keep, found = keep[stays], found[stays]
        xi[keep, 0] = found

        seek = np.ones(len(place), bool)
        seek[keep] = False
        clamped = np.zeros(len(place), bool)
        far = 1e9
        gap[seek], face[seek] = far, -1
        seek &= place[:, 1] > flat[self.used, 1].min() - reach
        lost = np.flatnonzero(seek)
        if len(lost):
            away = ((place[lost, None, :] - flat[self.used]) ** 2).sum(-1)
            near = away.argmin(1)
            options = self._meets[near]
            feet = [_feet(place[lost], edges[options[:, k]], np.full(len(lost), 0.5), clamp=True) for k in (0, 1)]
            second = (feet[1][1] ** 2).sum(1) < (feet[0][1] ** 2).sum(1)
            best = np.where(second, feet[1][0], feet[0][0])
            offset = np.where(second[:, None], feet[1][1], feet[0][1])
            close = np.linalg.norm(offset, axis=1) < reach
            lost, best = lost[close], best[close]
            face[lost] = options[np.arange(len(options)), second.astype(int)][close]
            xi[lost, 0] = best
            clamped[lost] = (best <= 0) | (best >= 1)

        have = np.flatnonzero(face >= 0)
        mine, at = edges[face[have]], xi[have, 0]
        along = np.einsum("pn,pni->pi", edge_gradient(at), mine)
        normal = np.stack([along[:, 1], -along[:, 0]], 1) / np.linalg.norm(along, axis=1, keepdims=True)
        offset = place[have] - np.einsum("pn,pni->pi", edge_shape(at), mine)
        distance, g = np.linalg.norm(offset, axis=1), (offset * normal).sum(1)
        # beside a sharp edge the closest point is the edge itself: a point that lies sideways of the face is outside, not under it
        beside = clamped[have] & (g < 0) & (-g < 0.7 * distance)
        gap[have] = np.where(beside, distance, g)
        self.normal.numpy()[have] = np.column_stack([normal[:, 0], np.zeros(len(have)), normal[:, 1]])

    # ------------------------------------------------------------------------------------------------------------ forces, tangents
    def _penalty(self) -> tuple[Array, Array]:
        """Pressure and its slope at every point."""
        eps = self.law.smoothing
        s = np.where(self.face.numpy() >= 0, self.multiplier.numpy() / self._k - self.gap.numpy(), -1.0)
        soft = np.clip(s / eps, 0.0, 1.0)
        return self._k * np.where(s < eps, 0.5 * soft * soft * eps, s - 0.5 * eps) * (s > 0), self._k * soft

    def _trial(self, now: Array, held: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Trial traction λ_t + k_t e in the tangent plane, nodes (K, 6) and coefficients of the slip, at points held by friction."""
        shape = self._master_shape(self.anchor_place.numpy()[held])
        nodes = np.concatenate([self._slave[held], self.master_faces[self.anchor_face.numpy()[held]]], axis=1)
        share = np.concatenate([self._m[held], -shape], axis=1)
        trial = self.shift.numpy()[held] + self._kt[held, None] * np.einsum("pn,pni->pi", share, now[nodes])
        normal = self.normal.numpy()[held]
        return trial - (trial * normal).sum(1, keepdims=True) * normal, nodes, share

    def _held(self) -> NDArray[np.int64]:
        return np.flatnonzero(((self.pressure.numpy() > 0) | (self.tied.numpy() > 0)) & (self.anchor_face.numpy() >= 0))

    def add_force(self, x: wp.array, force: wp.array) -> None:
        total, pressure = force.numpy(), self._penalty()[0]
        self.pressure.numpy()[:] = pressure
        active = np.flatnonzero(pressure > 0)
        load = (self.rest_weight[active] * pressure[active])[:, None] * self.normal.numpy()[active]
        nodes = np.concatenate([self._slave[active], self.master_faces[self.face.numpy()[active]]], axis=1)
        share = np.concatenate([-self._m[active], self._master_shape(self.place.numpy()[active])], axis=1)
        np.add.at(total, nodes, share[:, :, None] * load[:, None, :])
        if self.frictional:
            traction = self.traction.numpy()
            traction[:] = 0.0
            held = self._held()
            trial, nodes, share = self._trial(x.numpy(), held)
            trial = trial * self._cut(trial, pressure[held])[:, None]
            traction[held] = -trial
            np.add.at(total, nodes, (self.rest_weight[held, None] * share)[:, :, None] * trial[:, None, :])

    def _cut(self, trial: Array, pressure: Array) -> Array:
        """What is left of a trial traction under friction's bound."""
        return np.minimum(1.0, self.law.borne(pressure) / np.maximum(np.linalg.norm(trial, axis=1), 1e-300))

    def add_tangent(self, x: wp.array, pattern: PairPattern, values: wp.array, geometric: bool) -> bool:
        now = x.numpy()
        pressure, slope = self._penalty()
        active = np.flatnonzero(slope > 0)
        face, xi, normal = self.face.numpy()[active], self.place.numpy()[active, 0], self.normal.numpy()[active][:, [0, 2]]
        edges = now[self.master_faces[face]][..., [0, 2]]
        along = np.einsum("pn,pni->pi", edge_gradient(xi), edges)
        bend = (np.einsum("n,pni->pi", EDGE_CURVATURE, edges) * normal).sum(1)
        share = np.concatenate([self._m[active], -edge_shape(xi)], axis=1)
        drawn = np.concatenate([np.zeros((len(active), 3)), edge_gradient(xi)], axis=1)
        contra = along / (along**2).sum(1, keepdims=True)

        def spread(coefficient: Array, vector: Array) -> Array:
            return (coefficient[:, :, None] * vector[:, None, :]).reshape(len(coefficient), 12)

        g, t, n = spread(share, normal), spread(share, contra), spread(drawn, normal)
        weight = self.rest_weight[active]
        block = (weight * slope[active])[:, None, None] * g[:, :, None] * g[:, None, :]
        if geometric:
            side = t[:, :, None] * (n + 0.5 * bend[:, None] * t)[:, None, :]
            block += (weight * pressure[active])[:, None, None] * (side + np.swapaxes(side, 1, 2))
        nodes = np.concatenate([self._slave[active], self.master_faces[face]], axis=1)
        if not self._scatter(pattern, values, nodes, block):
            return False
        if not self.frictional:
            return True
        self.pressure.numpy()[:] = pressure
        held = self._held()
        trial, nodes, share = self._trial(now, held)
        normal, flat = self.normal.numpy()[held][:, [0, 2]], trial[:, [0, 2]]
        plane = np.eye(2) - normal[:, :, None] * normal[:, None, :]
        cut = self._cut(trial, pressure[held])
        stiff = plane.copy()
        if geometric:  # a slipping point does not resist in the direction it slips, which in the plane is the only one
            size = np.maximum((flat**2).sum(1), 1e-300)
            stiff -= np.where(cut < 1, 1 / size, 0.0)[:, None, None] * flat[:, :, None] * flat[:, None, :]
        stiff *= (self.rest_weight[held] * self._kt[held] * cut)[:, None, None]
        block = np.einsum("pa,pb,pij->paibj", share, share, stiff).reshape(len(held), 12, 12)
        return self._scatter(pattern, values, nodes, block)

    def remainder(self, x: wp.array, equation: wp.array, unknowns: int) -> Callable[[Array], Array] | None:
        factors = self.slip_coupling(equation.numpy(), unknowns)
        return None if factors is None else lambda v: factors[0].T @ (factors[1] @ v)

    def slip_coupling(self, equation: NDArray[np.int32], unknowns: int) -> tuple[sp.csr_matrix, sp.csr_matrix] | None:
        """The part of the tangent by which pressure drives slipping friction, ∂(bound)/∂u, as factors (B_t, B_n) of B_tᵀ B_n.

        None where no point slips. Uses the state of the last `add_force`.
        """
        law = self.law
        if not self.frictional:
            return None
        pressure, traction = self.pressure.numpy(), self.traction.numpy()
        size = np.linalg.norm(traction, axis=1)
        slipping = np.flatnonzero((pressure > 0) & law.slides(size, pressure))
        if len(slipping) == 0:
            return None
        face, k = self.face.numpy()[slipping], self.stiffness.numpy()[slipping // self.points]
        s = self.multiplier.numpy()[slipping] / k - self.gap.numpy()[slipping]
        slope = k * np.clip(s / law.smoothing, 0.0, 1.0)
        direction = -traction[slipping] / size[slipping, None]
        normal = self.normal.numpy()[slipping]
        places = self.anchor_face.numpy()[slipping], self.anchor_place.numpy()[slipping]
        along = self._relative_motion(slipping, direction, *places, equation, unknowns)
        steeper = np.asarray(slip_bound_slope(law.friction, pressure[slipping]), float)
        weight = self.rest_weight[slipping] * steeper * slope
        closing = self._relative_motion(slipping, -normal * weight[:, None], face, self.place.numpy()[slipping], equation, unknowns)
        return along, closing

    def _scatter(self, pattern: PairPattern, values: wp.array, nodes: NDArray[np.int32], block: Array) -> bool:
        """Adds symmetric blocks (K, 12, 12) of the in-plane displacements of nodes (K, 6); False where the pattern lacks a pair."""
        if len(nodes) == 0:
            return True
        if self._slots is None or self._slots[0] is not pattern:
            local, count, base, width, row, column, offset = (
                getattr(pattern, name).numpy().astype(np.int64) for name in ("local", "count", "base", "width", "row", "column", "offset")
            )
            keys = np.repeat(np.arange(len(row) - 1), np.diff(row)) * len(local) + column
            self._slots = (pattern, (local, count, base, width, keys, offset))
        local, count, base, width, keys, offset = self._slots[1]
        a, b = (nodes[:, side].astype(np.int64) for side in np.triu_indices(6))
        low, high = np.minimum(a, b), np.maximum(a, b)
        wanted = low * len(local) + high
        pair = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        used = (count[low] > 0) & (count[high] > 0)
        if (used & (low != high) & (keys[pair] != wanted)).any():
            return False
        blocks = block.reshape(-1, 6, 2, 6, 2)[:, np.triu_indices(6)[0], :, np.triu_indices(6)[1], :]  # (21, K, 2, 2)
        blocks = np.where((a > b).T[:, :, None, None], np.swapaxes(blocks, 2, 3), blocks)
        total = values.numpy()
        for i, ci in enumerate((0, 2)):
            for k, ck in enumerate((0, 2)):
                li, lk = local[low, ci], local[high, ck]
                start = base[low] + li * (count[low] + width[low]) - li * (li - 1) // 2
                slot = np.where(low == high, start + lk - li, start + count[low] - li + offset[pair] + lk)
                use = used & (li >= 0) & (lk >= 0) & ((low != high) | (lk >= li))
                np.add.at(total, slot[use], blocks[:, :, i, k].T[use])
        return True


def _feet(place: Array, edges: Array, start: Array, clamp: bool) -> tuple[Array, Array]:
    """ξ (K,) of the closest points on edges (K, 3, 2), and the offsets from there to the places (K, 2)."""
    first, last, middle = edges[:, 0], edges[:, 1], edges[:, 2]
    away, slope, bend = place - first, 4 * middle - 3 * first - last, 2 * (first + last) - 4 * middle  # y = first + ξ slope + ξ² bend
    xi = start.copy()
    for _ in range(_CLAMPED_STEPS if clamp else _STEPS):
        at = xi[:, None]
        along = slope + 2 * at * bend
        offset = away - at * (slope + at * bend)
        xi = xi + (offset * along).sum(1) / (along * along).sum(1)
        if clamp:
            xi = np.clip(xi, 0.0, 1.0)
    at = xi[:, None]
    return xi, away - at * (slope + at * bend)
