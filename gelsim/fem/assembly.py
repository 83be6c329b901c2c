"""Residual and tangent of one or two hyperelastic solids in mixed form, assembled by hand-written Warp kernels.

The potential of Sussman and Bathe (1987), perturbed Lagrangian in the pressure p (positive in expansion):

    Π(u, p) = ∫ Ŵ + p (J - 1) - p²/(2κ) dV

with quadratic u and continuous linear p. ∂Π/∂p = 0 gives p = κ Π_h(J - 1). Both solids share one numbering, one launch and one matrix;
contact (contact.py) is the only coupling between them.

p keeps volume in the mean around a vertex, not at every point: where coarse tets are crushed, points in them empty, and the body folds
where the solid would not (Auricchio et al. 2010). `hold_volume` gives a part κ' of κ to the points, + κ'/2 (J - 1)² and κ - κ' in the last
term: the same law, in stiffer tets.

Solver units are mm, kPa and mN (as kPa·mm²): they keep the two kinds of unknowns within a few orders of magnitude of each other.

The pressure is continuous within a material and jumps between two (`split_pressures`): a tet's row of nodes is its ten, then the four
that carry its pressure, which are its vertices but where another material holds them. The matrix is stored as pattern.py says.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.fem.coat import Coat
from gelsim.fem.elements import TetQuadrature
from gelsim.fem.hyperelastic import (
    OgdenConstants,
    cofactor,
    isochoric_excess,
    isochoric_part,
    law_curvature,
    law_energy,
    law_slope,
    log_stretches,
    ogden_energy,
    ogden_quotient,
    ogden_stress,
    ogden_stretch_tangent,
    principal_axes,
    volume_change,
)
from gelsim.fem.pattern import PairPattern, element_pairs, find_entry, pair_offset
from gelsim.fem.planar.elements import PlanarQuadrature
from gelsim.fem.viscoelastic import Memory
from gelsim.scene.materials import OGDEN_TERMS

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

Array = NDArray[np.float64]


# Numbers of a tet's upper triangle: 55 blocks of nodes, 40 columns and 10 entries of pressures.
TET_ENTRIES = 55 * 9 + 40 * 3 + 10


@wp.kernel(enable_backward=False)
def tet_entries(tets: wp.array2d(dtype=wp.int32), pattern: PairPattern, entries: wp.array2d(dtype=wp.int32)):
    """Where each number of a tet goes; -1 for none. The search takes as long as a tangent.

    Blocks of nodes a ≤ b come first; then, of each node that carries a pressure, columns of all displacements and pressures from it on.
    """
    t = wp.tid()
    at = int(0)
    for a in range(10):
        for b in range(a, 10):
            offset = pair_offset(pattern, tets[t, a], tets[t, b])
            for i in range(3):
                for j in range(3):
                    entries[t, at] = find_entry(pattern, tets[t, a], i, tets[t, b], j, offset)
                    at += 1
    for a in range(10, 14):
        for b in range(10):
            offset = pair_offset(pattern, tets[t, a], tets[t, b])
            for i in range(3):
                entries[t, at] = find_entry(pattern, tets[t, b], i, tets[t, a], 3, offset)
                at += 1
        for b in range(a, 14):
            entries[t, at] = find_entry(pattern, tets[t, a], 3, tets[t, b], 3, pair_offset(pattern, tets[t, a], tets[t, b]))
            at += 1


@wp.func
def scatter(values: wp.array(dtype=wp.float64), entry: wp.int32, value: wp.float64):
    if entry >= 0:
        wp.atomic_add(values, entry, value)


@wp.func
def scatter_block(entries: wp.array2d(dtype=wp.int32), values: wp.array(dtype=wp.float64), t: wp.int32, at: wp.int32,
                  block: wp.mat33d):  # fmt: skip
    """Adds what two nodes of a tet share, its numbers from `at` on."""
    for i in range(3):
        for j in range(3):
            scatter(values, entries[t, at + 3 * i + j], block[i, j])


@wp.func
def scatter_pressures(entries: wp.array2d(dtype=wp.int32), values: wp.array(dtype=wp.float64), t: wp.int32, at: wp.int32, points: wp.int32,
                      rows: Any, volumes: Any, weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
                      kappa: wp.float64):  # fmt: skip
    """Adds what a tet's pressures share with displacements and each other, its numbers from `at` on.

    Of each point, `rows` has F⁻ᵀ G of the nodes, `volumes` w J.
    """
    for a in range(4):
        for b in range(10):
            coupling = wp.vec3d()  # of p_a with u_b
            for q in range(points):
                ab = wp.vec3d(rows[q * 10 + b, 0], rows[q * 10 + b, 1], rows[q * 10 + b, 2])
                coupling += (volumes[q] * shape[q, a]) * ab
            for i in range(3):
                scatter(values, entries[t, at + i], coupling[i])
            at += 3
        for b in range(a, 4):
            pp = wp.float64(0.0)
            for q in range(points):
                pp -= weights[t, q] * shape[q, a] * shape[q, b] / kappa
            scatter(values, entries[t, at], pp)
            at += 1


def element_kernels(points: int, family: str):
    """The residual and the tangent kernel for a rule of so many points and a family of laws, "cubic" or "ogden" (hyperelastic.py)."""
    return {"cubic": _cubic_kernels, "ogden": _ogden_kernels}[family](points)


@lru_cache(maxsize=4)
def _cubic_kernels(points: int):
    rows = wp.types.matrix(shape=(10 * points, 3), dtype=wp.float64)
    per_point = wp.types.matrix(shape=(points, 2), dtype=wp.float64)
    number = wp.types.vector(length=points, dtype=wp.float64)
    Q = wp.constant(points)

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def residual(
        tets: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
        gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
        law: wp.array(dtype=wp.vec3d), kappa: wp.array(dtype=wp.float64), held: wp.array(dtype=wp.float64),
        force: wp.array(dtype=wp.vec3d), volume: wp.array(dtype=wp.float64), energy: wp.array(dtype=wp.float64),
        min_jacobian: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        t = wp.tid()
        half = wp.float64(0.5)
        smallest = wp.float64(1.0e30)
        stored = wp.float64(0.0)
        for q in range(Q):
            h = wp.mat33d()
            for a in range(10):
                h += wp.outer(displacement[tets[t, a]], gradients[t, q, a])
            f = wp.identity(n=3, dtype=wp.float64) + h
            dv = volume_change(h)
            j = wp.float64(1.0) + dv
            smallest = wp.min(smallest, j)
            w = weights[t, q]
            p = wp.float64(0.0)
            for b in range(4):
                p += shape[q, b] * pressure[tets[t, 10 + b]]
            if j > wp.float64(0.0):
                cof = cofactor(f)
                scale = wp.pow(j, wp.float64(-2.0) / wp.float64(3.0))
                excess = isochoric_excess(h, j)
                i1 = wp.ddot(f, f)
                stress = (wp.float64(2.0) * law_slope(law[t], excess) * scale) * (f - (i1 / (wp.float64(3.0) * j)) * cof) + (
                    p + held[t] * dv
                ) * cof
                stored += w * (law_energy(law[t], excess) + p * p / (wp.float64(2.0) * kappa[t]) + half * held[t] * dv * dv)
                for a in range(10):
                    wp.atomic_add(force, tets[t, a], w * (stress * gradients[t, q, a]))
                for b in range(4):
                    wp.atomic_add(volume, tets[t, 10 + b], w * shape[q, b] * (dv - p / kappa[t]))
        energy[t] = stored
        min_jacobian[t] = smallest

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def tangent(
        tets: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
        gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
        law: wp.array(dtype=wp.vec3d), kappa: wp.array(dtype=wp.float64), held: wp.array(dtype=wp.float64),
        entries: wp.array2d(dtype=wp.int32), values: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        t = wp.tid()
        # per point and node: f = F G, α = F⁻ᵀ G, and r, s of a block's f_a ⊗ r_b + α_a ⊗ s_b
        fg = rows()
        ag = rows()
        rg = rows()
        sg = rows()
        # per point, weights of (G_a·G_b) 1 and of α_b ⊗ α_a
        scalars = per_point()
        volumes = number()
        third = wp.float64(1.0) / wp.float64(3.0)
        for q in range(Q):
            h = wp.mat33d()
            for a in range(10):
                h += wp.outer(displacement[tets[t, a]], gradients[t, q, a])
            f = wp.identity(n=3, dtype=wp.float64) + h
            j = wp.float64(1.0) + volume_change(h)
            inverse_transpose = cofactor(f) / j
            scale = wp.pow(j, wp.float64(-2.0) * third)
            excess = isochoric_excess(h, j)
            p = wp.float64(0.0)
            for b in range(4):
                p += shape[q, b] * pressure[tets[t, 10 + b]]
            w = weights[t, q]
            slope = w * wp.float64(2.0) * law_slope(law[t], excess) * scale
            curvature = w * wp.float64(4.0) * law_curvature(law[t], excess) * scale * scale
            i1 = wp.ddot(f, f) * third
            pj = w * (p + held[t] * (j - wp.float64(1.0))) * j
            two = wp.float64(2.0) * third * slope
            outer = two * i1 + pj + w * held[t] * j * j
            scalars[q, 0] = slope
            scalars[q, 1] = slope * i1 - pj
            volumes[q] = w * j
            for a in range(10):
                fa = f * gradients[t, q, a]
                aa = inverse_transpose * gradients[t, q, a]
                bent = curvature * (fa - i1 * aa)
                ra = bent - two * aa
                sa = outer * aa - two * fa - i1 * bent
                for c in range(3):
                    fg[q * 10 + a, c] = fa[c]
                    ag[q * 10 + a, c] = aa[c]
                    rg[q * 10 + a, c] = ra[c]
                    sg[q * 10 + a, c] = sa[c]
        at = int(0)
        for a in range(10):
            for b in range(a, 10):
                block = wp.mat33d()
                for q in range(Q):
                    fa = wp.vec3d(fg[q * 10 + a, 0], fg[q * 10 + a, 1], fg[q * 10 + a, 2])
                    aa = wp.vec3d(ag[q * 10 + a, 0], ag[q * 10 + a, 1], ag[q * 10 + a, 2])
                    ab = wp.vec3d(ag[q * 10 + b, 0], ag[q * 10 + b, 1], ag[q * 10 + b, 2])
                    rb = wp.vec3d(rg[q * 10 + b, 0], rg[q * 10 + b, 1], rg[q * 10 + b, 2])
                    sb = wp.vec3d(sg[q * 10 + b, 0], sg[q * 10 + b, 1], sg[q * 10 + b, 2])
                    d = scalars[q, 0] * wp.dot(gradients[t, q, a], gradients[t, q, b])
                    block += wp.outer(fa, rb) + wp.outer(aa, sb) + wp.outer(scalars[q, 1] * ab, aa) + wp.diag(wp.vec3d(d, d, d))
                scatter_block(entries, values, t, at, block)
                at += 9
        scatter_pressures(entries, values, t, at, Q, ag, volumes, weights, shape, kappa[t])

    return residual, tangent


@lru_cache(maxsize=4)
def _ogden_kernels(points: int):
    rows = wp.types.matrix(shape=(10 * points, 3), dtype=wp.float64)
    axes = wp.types.matrix(shape=(points, 9), dtype=wp.float64)
    per_point = wp.types.matrix(shape=(points, 12), dtype=wp.float64)
    number = wp.types.vector(length=points, dtype=wp.float64)
    Q = wp.constant(points)

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def ogden_residual(
        tets: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
        gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
        law: wp.array(dtype=OgdenConstants), kappa: wp.array(dtype=wp.float64), held: wp.array(dtype=wp.float64),
        force: wp.array(dtype=wp.vec3d), volume: wp.array(dtype=wp.float64), energy: wp.array(dtype=wp.float64),
        min_jacobian: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        t = wp.tid()
        half = wp.float64(0.5)
        smallest = wp.float64(1.0e30)
        stored = wp.float64(0.0)
        for q in range(Q):
            h = wp.mat33d()
            for a in range(10):
                h += wp.outer(displacement[tets[t, a]], gradients[t, q, a])
            f = wp.identity(n=3, dtype=wp.float64) + h
            dv = volume_change(h)
            j = wp.float64(1.0) + dv
            smallest = wp.min(smallest, j)
            w = weights[t, q]
            p = wp.float64(0.0)
            for b in range(4):
                p += shape[q, b] * pressure[tets[t, 10 + b]]
            if j > wp.float64(0.0):
                excess, v = principal_axes(h + wp.transpose(h) + wp.transpose(h) * h)
                iso = isochoric_part(log_stretches(excess))
                beta = ogden_stress(law[t], iso)
                one = wp.float64(1.0)
                # Σ β/λ n ⊗ N = F Σ β/λ² N ⊗ N, as λ n = F N
                second = wp.diag(wp.vec3d(beta[0] / (one + excess[0]), beta[1] / (one + excess[1]), beta[2] / (one + excess[2])))
                stress = f * (v * second * wp.transpose(v)) + (p + held[t] * dv) * cofactor(f)
                stored += w * (ogden_energy(law[t], iso) + p * p / (wp.float64(2.0) * kappa[t]) + half * held[t] * dv * dv)
                for a in range(10):
                    wp.atomic_add(force, tets[t, a], w * (stress * gradients[t, q, a]))
                for b in range(4):
                    wp.atomic_add(volume, tets[t, 10 + b], w * shape[q, b] * (dv - p / kappa[t]))
        energy[t] = stored
        min_jacobian[t] = smallest

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def ogden_tangent(
        tets: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
        gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
        law: wp.array(dtype=OgdenConstants), kappa: wp.array(dtype=wp.float64), held: wp.array(dtype=wp.float64),
        entries: wp.array2d(dtype=wp.int32), values: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        t = wp.tid()
        half = wp.float64(0.5)
        # per point: n_A in columns, and per node N_A · G_a and F⁻ᵀ G_a
        spatial = axes()
        gn = rows()
        ag = rows()
        # 0-2: W_AA; 3-5: W_AB, 6-8: P_AB, 9-11: Q_AB of the pairs 01, 02, 12. W and Q with p J of the volume, which in
        # principal axes is ± p J/(λ_A λ_B) and no more.
        scalars = per_point()
        volumes = number()
        for q in range(Q):
            h = wp.mat33d()
            for a in range(10):
                h += wp.outer(displacement[tets[t, a]], gradients[t, q, a])
            f = wp.identity(n=3, dtype=wp.float64) + h
            j = wp.float64(1.0) + volume_change(h)
            excess, v = principal_axes(h + wp.transpose(h) + wp.transpose(h) * h)
            logs = log_stretches(excess)
            iso = isochoric_part(logs)
            stretch = wp.vec3d(wp.exp(logs[0]), wp.exp(logs[1]), wp.exp(logs[2]))
            beta = ogden_stress(law[t], iso)
            slope = ogden_stretch_tangent(law[t], iso)
            p = wp.float64(0.0)
            for b in range(4):
                p += shape[q, b] * pressure[tets[t, 10 + b]]
            p += held[t] * (j - wp.float64(1.0))
            jj = held[t] * j * j
            w = weights[t, q]
            for k in range(3):
                scalars[q, k] = w * (slope[k, k] - beta[k] + jj) / (stretch[k] * stretch[k])
                m = k // 2
                n = 1 + (k + 1) // 2
                product = stretch[m] * stretch[n]
                quotient = ogden_quotient(law[t], iso[m], iso[n]) / wp.sqrt(product)
                s = half * ((wp.float64(1.0) / stretch[m] + wp.float64(1.0) / stretch[n]) * quotient - (beta[m] + beta[n]) / product)
                total = (beta[m] / stretch[m] + beta[n] / stretch[n]) / (stretch[m] + stretch[n])
                scalars[q, 3 + k] = w * (slope[m, n] + p * j + jj) / product
                scalars[q, 6 + k] = w * half * (s + total)
                scalars[q, 9 + k] = w * (half * (s - total) - p * j / product)
            volumes[q] = w * j
            for c in range(3):
                axis = f * wp.vec3d(v[0, c], v[1, c], v[2, c]) / stretch[c]
                for i in range(3):
                    spatial[q, 3 * i + c] = axis[i]
            inverse_transpose = cofactor(f) / j
            for a in range(10):
                g = wp.transpose(v) * gradients[t, q, a]
                aa = inverse_transpose * gradients[t, q, a]
                for c in range(3):
                    gn[q * 10 + a, c] = g[c]
                    ag[q * 10 + a, c] = aa[c]
        at = int(0)
        for a in range(10):
            for b in range(a, 10):
                block = wp.mat33d()
                for q in range(Q):
                    ga = wp.vec3d(gn[q * 10 + a, 0], gn[q * 10 + a, 1], gn[q * 10 + a, 2])
                    gb = wp.vec3d(gn[q * 10 + b, 0], gn[q * 10 + b, 1], gn[q * 10 + b, 2])
                    turn = wp.mat33d(
                        spatial[q, 0], spatial[q, 1], spatial[q, 2],
                        spatial[q, 3], spatial[q, 4], spatial[q, 5],
                        spatial[q, 6], spatial[q, 7], spatial[q, 8],
                    )  # fmt: skip
                    xx = ga[0] * gb[0]
                    yy = ga[1] * gb[1]
                    zz = ga[2] * gb[2]
                    local = wp.mat33d(
                        scalars[q, 0] * xx + scalars[q, 6] * yy + scalars[q, 7] * zz,
                        scalars[q, 3] * ga[0] * gb[1] + scalars[q, 9] * ga[1] * gb[0],
                        scalars[q, 4] * ga[0] * gb[2] + scalars[q, 10] * ga[2] * gb[0],
                        scalars[q, 3] * ga[1] * gb[0] + scalars[q, 9] * ga[0] * gb[1],
                        scalars[q, 6] * xx + scalars[q, 1] * yy + scalars[q, 8] * zz,
                        scalars[q, 5] * ga[1] * gb[2] + scalars[q, 11] * ga[2] * gb[1],
                        scalars[q, 4] * ga[2] * gb[0] + scalars[q, 10] * ga[0] * gb[2],
                        scalars[q, 5] * ga[2] * gb[1] + scalars[q, 11] * ga[1] * gb[2],
                        scalars[q, 7] * xx + scalars[q, 8] * yy + scalars[q, 2] * zz,
                    )
                    block += turn * local * wp.transpose(turn)
                scatter_block(entries, values, t, at, block)
                at += 9
        scatter_pressures(entries, values, t, at, Q, ag, volumes, weights, shape, kappa[t])

    return ogden_residual, ogden_tangent


# Nodes of elements from which on a thread more pays: 600 tets, 4 ms. Each but the first has a matrix to clear and to add.
THREAD_NODES, MOST_THREADS = 6000, 4
# Where `Solids._inputs` holds what changes and what all scenes share.
_DISPLACEMENT, _PRESSURE, _SHAPE = 1, 2, 5


def join_arrays(arrays: Sequence[wp.array]) -> wp.array:
    """Arrays of equal shape, one after the other."""
    first = arrays[0]
    length = first.shape[0]
    whole = wp.empty((len(arrays) * length, *first.shape[1:]), dtype=first.dtype, device=first.device)
    for number, array in enumerate(arrays):
        wp.copy(whole[number * length : (number + 1) * length], array)
    return whole


class Solids:
    """One or two solids with a common node numbering, their state, and which of their unknowns are free. Solver units (mm, kPa).

    Args:
        rest: Positions of all nodes [mm], (N, 3); nodes of a rigid surface may be among them.
        tets: (T, 10). quadrature: of the same tets, in mm.
        law: (T, 3) constants c₁, c₂, c₃ [kPa] of the cubic law, or (T, 6) μ_k [kPa], α_k of Ogden's: one family for all tets, and
            α = 2 is neo-Hookean. kappa: (T,) bulk moduli [kPa].
        fixed: Which displacement components are prescribed, (N, 3).
        pressures: The nodes that carry each tet's pressure, (T, 4); left out, its vertices. `split_pressures` makes others.
    """

    kernels = staticmethod(element_kernels)

    def __init__(self, rest: Array, tets: NDArray[np.int32], quadrature: TetQuadrature | PlanarQuadrature, law: Array, kappa: Array,
                 fixed: NDArray[np.bool_], device: str, pressures: NDArray[np.int32] | None = None) -> None:  # fmt: skip
        self.device, self.rest, self.tets = device, rest, tets
        self.node_count = len(rest)
        in_solid = np.zeros(self.node_count, bool)
        in_solid[tets] = True
        vertex = np.zeros(self.node_count, bool)
        vertices = tets[:, : quadrature.pressure_shape.shape[1]]
        split = pressures is not None and not np.array_equal(pressures, vertices)
        pressures = pressures if split else vertices
        vertex[pressures] = True
        cells = np.hstack([tets, pressures])
        self.free = np.concatenate([~fixed & in_solid[:, None], vertex[:, None]], axis=1)
        self.unknowns = int(self.free.sum())
        self.equation = np.where(self.free, np.cumsum(self.free.ravel()).reshape(self.free.shape) - 1, -1)
        self._cells = cells if split else tets
        self.vertex_volume = np.ones(self.node_count)
        share = np.einsum("tq,qb->tb", quadrature.weights, quadrature.pressure_shape)
        summed = np.bincount(pressures.ravel(), share.ravel(), self.node_count)
        self.vertex_volume[vertex] = summed[vertex]

        def array(data: object, dtype: object) -> wp.array:
            return wp.array(data, dtype=dtype, device=device)

        ogden = law.shape[1] == 2 * OGDEN_TERMS
        self._residual, self._tangent = self.kernels(quadrature.weights.shape[1], "ogden" if ogden else "cubic")
        self._quadrature = quadrature
        self.rest_positions = array(rest, wp.vec3d)
        self.displacement = wp.zeros(self.node_count, dtype=wp.vec3d, device=device)
        self.pressure = wp.zeros(self.node_count, dtype=wp.float64, device=device)
        self._inputs = [
            array(cells, wp.int32), self.displacement, self.pressure, array(quadrature.gradients, wp.vec3d),
            array(quadrature.weights, wp.float64), array(quadrature.pressure_shape, wp.float64),
            array(law, OgdenConstants if ogden else wp.vec3d), array(kappa, wp.float64),
        ]  # fmt: skip
        self._held = [wp.zeros(len(tets), dtype=wp.float64, device=device)]
        self._memory: Memory | None = None
        self.coat: Coat | None = None
        self._entries: tuple[PairPattern, wp.array] | None = None
        self._apart: list[wp.array] = []
        """What threads add to: fresh memory would cost as much as what is added to it."""
        self._element_energy = wp.zeros(len(tets), dtype=wp.float64, device=device)
        self.element_jacobian = wp.zeros(len(tets), dtype=wp.float64, device=device)

    @staticmethod
    def join(solids: Sequence[Solids]) -> Solids:
        """The solids of many scenes with the same elements as one, nodes and unknowns of one scene after those of the other.

        The scenes' own solids go on as views of its state. Solids that remember (Prony) have no place in it.
        """
        if any(one._memory is not None for one in solids):
            raise ValueError("viscoelastic solids cannot be joined")
        first, joint = solids[0], copy.copy(solids[0])
        joint.__dict__.pop("keys", None)
        joint._entries = None
        count = len(solids)
        shift = np.arange(count, dtype=np.int32)
        joint.rest = np.concatenate([s.rest for s in solids])
        joint.tets = (first.tets + first.node_count * shift[:, None, None]).reshape(-1, 10)
        cells = first._inputs[0].numpy() + first.node_count * shift[:, None, None]
        joint.free, joint.vertex_volume = np.tile(first.free, (count, 1)), np.tile(first.vertex_volume, count)
        joint.equation = np.where(first.equation >= 0, first.equation + first.unknowns * shift[:, None, None], -1).reshape(-1, 4)
        joint.node_count, joint.unknowns = count * first.node_count, count * first.unknowns
        inputs = [join_arrays([s._inputs[i] for s in solids]) for i in range(len(first._inputs))]
        inputs[0] = wp.array(cells.reshape(-1, 14), dtype=wp.int32, device=joint.device)
        inputs[_SHAPE] = first._inputs[_SHAPE]
        joint._inputs = inputs
        joint.coat = Coat.join([s.coat for s in solids])
        joint._held = [join_arrays([s._held[0] for s in solids])]
        joint.displacement, joint.pressure = inputs[_DISPLACEMENT], inputs[_PRESSURE]
        joint.rest_positions = join_arrays([s.rest_positions for s in solids])
        joint._element_energy, joint.element_jacobian = (wp.zeros(len(joint.tets), dtype=wp.float64, device=joint.device) for _ in range(2))
        for number, one in enumerate(solids):
            part = slice(number * one.node_count, (number + 1) * one.node_count)
            one.displacement, one.pressure = joint.displacement[part], joint.pressure[part]
            one._inputs[_DISPLACEMENT], one._inputs[_PRESSURE] = one.displacement, one.pressure
        return joint

    @cached_property
    def keys(self) -> NDArray[np.int64]:
        """Node pairs that share a tet (`element_pairs`)."""
        return element_pairs(self._cells, self.node_count)

    @property
    def element_bytes(self) -> int:
        """Bytes of constant data that an assembly reads."""
        return sum(array.capacity for array in self._inputs)

    def positions(self) -> wp.array:
        return self.rest_positions + self.displacement

    def internal_force(self) -> tuple[Array, Array, float]:
        """∂Π/∂u (N, 3) [mN], ∂Π/∂p (N,) [mm³], and the smallest det F over all quadrature points."""
        force = wp.zeros(self.node_count, dtype=wp.vec3d, device=self.device)
        volume = wp.zeros(self.node_count, dtype=wp.float64, device=self.device)
        self.add_internal_force(force, volume)
        return force.numpy(), volume.numpy(), float(self.element_jacobian.numpy().min())

    def add_internal_force(self, force: wp.array, volume: wp.array) -> None:
        """Adds ∂Π/∂u and ∂Π/∂p; each element's energy and smallest det F are kept."""
        outputs = [force, volume, self._element_energy, self.element_jacobian]
        wp.launch(self._residual, len(self.tets), [*self._inputs, *self._held, *outputs], device=self.device)
        if self._memory is not None:
            self._memory.add_force(self.displacement, force)
        if self.coat is not None:
            self.coat.add_force(self.displacement, force)

    def energy(self) -> float:
        """Stored energy of the last `internal_force` [mN·mm = µJ]."""
        return float(self._element_energy.numpy().sum()) + (0.0 if self.coat is None else self.coat.energy())

    def add_tangent(self, pairs: PairPattern, values: wp.array) -> None:
        """Adds ∂²Π to the matrix."""
        entries = self.entries(pairs)
        if (threads := self._threads()) > 1:
            self._add_by_threads(threads, entries, values)
        else:
            wp.launch(self._tangent, len(self.tets), [*self._inputs, *self._held, entries, values], device=self.device)
        if self._memory is not None:
            self._memory.add_tangent(pairs, values)
        if self.coat is not None:
            self.coat.add_tangent(self.displacement, pairs, values)

    def entries(self, pairs: PairPattern) -> Any:
        """What the tangent's kernel finds entries by: where each tet's numbers go, (T, TET_ENTRIES), kept until another pattern comes."""
        if self._entries is None or self._entries[0] is not pairs:
            found = wp.empty((len(self.tets), TET_ENTRIES), dtype=wp.int32, device=self.device)
            wp.launch(tet_entries, len(self.tets), [self._inputs[0], pairs, found], device=self.device)
            self._entries = pairs, found
        return self._entries[1]

    def _threads(self) -> int:
        """How many share the assembly of a tangent: as many as the environment grants and pay."""
        if self.device != "cpu" or wp.config.mode != "release":  # Warp's checks share an address between launches
            return 1
        granted = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
        cores = int(granted) if granted.isdigit() else os.cpu_count() or 1
        return max(1, min(cores, MOST_THREADS, self.tets.size // THREAD_NODES))

    def _add_by_threads(self, threads: int, entries: Any, values: wp.array) -> None:
        """`add_tangent` with a part of the tets for each thread; all but the first add to a matrix of their own."""
        if [len(part) for part in self._apart] != [len(values)] * (threads - 1):
            self._apart = [wp.empty_like(values) for _ in range(threads - 1)]
        for part in self._apart:
            part.zero_()
        shared = _DISPLACEMENT, _PRESSURE, _SHAPE
        bounds = np.linspace(0, len(self.tets), threads + 1).astype(int)
        launches = []
        for first, last, part in zip(bounds[:-1], bounds[1:], [values, *self._apart], strict=True):
            inputs = [array if number in shared else array[first:last] for number, array in enumerate(self._inputs)]
            where = entries[first:last] if isinstance(entries, wp.array) else entries
            arguments = [*inputs, *(array[first:last] for array in self._held), where, part]
            launches.append(wp.launch(self._tangent, last - first, arguments, device=self.device, record_cmd=True))
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(wp.Launch.launch, launches))  # kernels without tiles share nothing, and no lock of Python's is held
        for part in self._apart:
            values.numpy()[:] += part.numpy()

    def hold_volume(self, held: Array) -> None:
        """Takes κ' [kPa] of each tet (T,) from its κ, and to its points. Before anything is solved."""
        kappa = self._inputs[7]
        kappa.assign(kappa.numpy() - held)
        self._held[0].assign(held)

    def remember(self, shares: Array, times: Array) -> Memory:
        """Makes the solids viscoelastic, of Prony shares and times [s] (T, K); for what steps of time do then, see `Memory`."""
        tets, law = self._inputs[0], self._inputs[6]
        self._memory = Memory(tets, self._quadrature, law.numpy().copy(), law, shares, times)
        return self._memory

    def state(self) -> tuple[Array, Array]:
        return self.displacement.numpy().copy(), self.pressure.numpy().copy()

    def set_state(self, state: tuple[Array, Array]) -> None:
        self.displacement.assign(state[0])
        self.pressure.assign(state[1])

    def move(self, start: tuple[Array, Array], step: Array, fraction: float) -> None:
        """Sets the state `start` plus `fraction` of a step of the unknowns."""
        change = np.zeros(self.free.shape)
        change[self.free] = fraction * step
        self.set_state((start[0] + change[:, :3], start[1] + change[:, 3]))
