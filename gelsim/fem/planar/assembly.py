"""Residual and tangent of solids of revolution or in plane strain, in the mixed form of `gelsim.fem.assembly`, by Warp kernels.

The potential Π(u, p) and the laws are those of the three-dimensional solids; F has the five components that a plane leaves (elements.py),

    F = [F_xx 0 F_xz; 0 F_yy 0; F_zx 0 F_zz],   written as the vector (xx, xz, zx, zz, yy).

At a point the tangent of P + p ∂J/∂F is a 5 x 5 matrix A, and the matrix of a triangle Σ w Bᵀ A B. With a = F⁻ᵀ, i = I₁/3, c = 2Ŵ' J^(-2/3)
and d = 4Ŵ'' J^(-4/3) the cubic laws have

    A = c 1 - (2/3) c (a fᵀ + f aᵀ) + ((2/3) c i + pJ) a aᵀ + (c i - pJ) T + d (f - i a)(f - i a)ᵀ,   T_(jk)(li) = a_ji a_lk

and Ogden's the second variation in principal axes that hyperelastic.py gives, turned back: A = Qᵀ M Q, of which the direction e_y always is
one axis.
"""

# no postponed annotations here: those of kernels name a local type
from functools import lru_cache
from typing import Any

import warp as wp

from gelsim.fem.assembly import Solids
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
from gelsim.fem.pattern import PairPattern, add_entry, pair_offset

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

vec5d = wp.types.vector(length=5, dtype=wp.float64)
mat55d = wp.types.matrix(shape=(5, 5), dtype=wp.float64)


@wp.func
def gradient_of(triangles: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), gradients: wp.array3d(dtype=wp.vec3d),
                t: wp.int32, q: wp.int32) -> wp.mat33d:  # fmt: skip
    """Displacement gradient H at point q of triangle t."""
    h = wp.mat33d()
    for a in range(6):
        u = displacement[triangles[t, a]]
        g = gradients[t, q, a]
        h += wp.outer(u, wp.vec3d(g[0], wp.float64(0.0), g[2]))
        h[1, 1] += u[0] * g[1]
    return h


@wp.func
def five(m: wp.mat33d) -> vec5d:
    return vec5d(m[0, 0], m[0, 2], m[2, 0], m[2, 2], m[1, 1])


@wp.func
def cubic_energy(c: wp.vec3d, h: wp.mat33d, j: wp.float64) -> wp.float64:
    return law_energy(c, isochoric_excess(h, j))


@wp.func
def ogden_density(c: OgdenConstants, h: wp.mat33d, j: wp.float64) -> wp.float64:
    excess, _v = principal_axes(h + wp.transpose(h) + wp.transpose(h) * h)
    return ogden_energy(c, isochoric_part(log_stretches(excess)))


@wp.func
def cubic_stress(c: wp.vec3d, h: wp.mat33d, j: wp.float64) -> wp.mat33d:
    """Isochoric Piola stress."""
    f = wp.identity(n=3, dtype=wp.float64) + h
    slope = wp.float64(2.0) * law_slope(c, isochoric_excess(h, j)) * wp.pow(j, wp.float64(-2.0) / wp.float64(3.0))
    return slope * (f - (wp.ddot(f, f) / (wp.float64(3.0) * j)) * cofactor(f))


@wp.func
def ogden_piola(c: OgdenConstants, h: wp.mat33d, j: wp.float64) -> wp.mat33d:
    excess, v = principal_axes(h + wp.transpose(h) + wp.transpose(h) * h)
    beta = ogden_stress(c, isochoric_part(log_stretches(excess)))
    one = wp.float64(1.0)
    second = wp.diag(wp.vec3d(beta[0] / (one + excess[0]), beta[1] / (one + excess[1]), beta[2] / (one + excess[2])))
    return (wp.identity(n=3, dtype=wp.float64) + h) * (v * second * wp.transpose(v))


@wp.func
def cubic_moduli(c: wp.vec3d, h: wp.mat33d, j: wp.float64, p: wp.float64) -> mat55d:
    """∂(P + p ∂J/∂F)/∂F of a cubic law."""
    third = wp.float64(1.0) / wp.float64(3.0)
    two = wp.float64(2.0)
    full = wp.identity(n=3, dtype=wp.float64) + h
    inverse = cofactor(full) / j
    f = five(full)
    a = five(inverse)
    scale = wp.pow(j, -two * third)
    excess = isochoric_excess(h, j)
    slope = two * law_slope(c, excess) * scale
    curvature = wp.float64(4.0) * law_curvature(c, excess) * scale * scale
    mean = wp.ddot(full, full) * third
    bent = f - mean * a
    pj = p * j
    result = (two * third * slope * mean + pj) * wp.outer(a, a) - (two * third * slope) * (wp.outer(a, f) + wp.outer(f, a))
    result += curvature * wp.outer(bent, bent)
    twist = slope * mean - pj
    for k in range(5):
        result[k, k] += slope
    # T_(jk)(li) = a_ji a_lk over the plane's components x, z, which `five` orders as 2 j + k
    for jj in range(2):
        for kk in range(2):
            for ll in range(2):
                for ii in range(2):
                    result[2 * jj + kk, 2 * ll + ii] += twist * inverse[2 * jj, 2 * ii] * inverse[2 * ll, 2 * kk]
    result[4, 4] += twist * inverse[1, 1] * inverse[1, 1]
    return result


@wp.func
def ogden_moduli(c: OgdenConstants, h: wp.mat33d, j: wp.float64, p: wp.float64) -> mat55d:
    """The same of Ogden's, by principal axes 0 and 2 in the plane, 1 across it."""
    half = wp.float64(0.5)
    excess, v = principal_axes(h + wp.transpose(h) + wp.transpose(h) * h)
    logs = log_stretches(excess)
    iso = isochoric_part(logs)
    stretch = wp.vec3d(wp.exp(logs[0]), wp.exp(logs[1]), wp.exp(logs[2]))
    beta = ogden_stress(c, iso)
    slope = ogden_stretch_tangent(c, iso)
    f = wp.identity(n=3, dtype=wp.float64) + h
    # rows (00, 02, 20, 22, 11) of n_A · dF N_B
    turn = mat55d()
    inner = mat55d()
    for row in range(4):
        m = 2 * (row // 2)
        n = 2 * (row % 2)
        axis = f * wp.vec3d(v[0, m], v[1, m], v[2, m]) / stretch[m]
        for i in range(2):
            for k in range(2):
                turn[row, 2 * i + k] = axis[2 * i] * v[2 * k, n]
    turn[4, 4] = wp.float64(1.0)
    for one in range(3):
        # place of the component AA among the five
        k = one
        if one == 0:
            k = 0
        elif one == 1:
            k = 4
        else:
            k = 3
        inner[k, k] = (slope[one, one] - beta[one]) / (stretch[one] * stretch[one])
        for other in range(one + 1, 3):
            k2 = int(3)
            if other == 1:
                k2 = 4
            value = (slope[one, other] + p * j) / (stretch[one] * stretch[other])
            inner[k, k2] = value
            inner[k2, k] = value
    product = stretch[0] * stretch[2]
    quotient = ogden_quotient(c, iso[0], iso[2]) / wp.sqrt(product)
    s = half * ((wp.float64(1.0) / stretch[0] + wp.float64(1.0) / stretch[2]) * quotient - (beta[0] + beta[2]) / product)
    total = (beta[0] / stretch[0] + beta[2] / stretch[2]) / (stretch[0] + stretch[2])
    inner[1, 1] = half * (s + total)
    inner[2, 2] = half * (s + total)
    inner[1, 2] = half * (s - total) - p * j / product
    inner[2, 1] = half * (s - total) - p * j / product
    return wp.transpose(turn) * inner * turn


LAWS = {
    "cubic": (wp.vec3d, cubic_energy, cubic_stress, cubic_moduli),
    "ogden": (OgdenConstants, ogden_density, ogden_piola, ogden_moduli),
}
"""By family: type of the constants, energy, isochoric Piola stress, moduli."""


@lru_cache(maxsize=4)
def triangle_kernels(points: int, family: str):
    """The residual and the tangent kernel for a rule of so many points and a family of laws, "cubic" or "ogden"."""
    constants, energy_of, stress_of, moduli_of = LAWS[family]
    strains = wp.types.matrix(shape=(12 * points, 5), dtype=wp.float64)
    volumes = wp.types.matrix(shape=(points, 12), dtype=wp.float64)
    Q = wp.constant(points)

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def planar_residual(
        triangles: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
        gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
        law: wp.array(dtype=constants), kappa: wp.array(dtype=wp.float64),
        force: wp.array(dtype=wp.vec3d), volume: wp.array(dtype=wp.float64), energy: wp.array(dtype=wp.float64),
        min_jacobian: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        t = wp.tid()
        smallest = wp.float64(1.0e30)
        stored = wp.float64(0.0)
        for q in range(Q):
            h = gradient_of(triangles, displacement, gradients, t, q)
            dv = volume_change(h)
            j = wp.float64(1.0) + dv
            smallest = wp.min(smallest, j)
            p = wp.float64(0.0)
            for b in range(3):
                p += shape[q, b] * pressure[triangles[t, b]]
            if j > wp.float64(0.0):
                w = weights[t, q]
                stress = stress_of(law[t], h, j) + p * cofactor(wp.identity(n=3, dtype=wp.float64) + h)
                stored += w * (energy_of(law[t], h, j) + p * p / (wp.float64(2.0) * kappa[t]))
                for a in range(6):
                    g = gradients[t, q, a]
                    inner = stress * wp.vec3d(g[0], wp.float64(0.0), g[2])
                    wp.atomic_add(force, triangles[t, a], w * wp.vec3d(inner[0] + stress[1, 1] * g[1], wp.float64(0.0), inner[2]))
                for b in range(3):
                    wp.atomic_add(volume, triangles[t, b], w * shape[q, b] * (dv - p / kappa[t]))
        energy[t] = stored
        min_jacobian[t] = smallest

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def planar_tangent(
        triangles: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
        gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
        law: wp.array(dtype=constants), kappa: wp.array(dtype=wp.float64), pattern: PairPattern, values: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        t = wp.tid()
        # rows 12 q + 2 a + i: w A B of u_i at node a; and w J F⁻ᵀ : B of the same
        stiff = strains()
        change = volumes()
        for q in range(Q):
            h = gradient_of(triangles, displacement, gradients, t, q)
            j = wp.float64(1.0) + volume_change(h)
            p = wp.float64(0.0)
            for b in range(3):
                p += shape[q, b] * pressure[triangles[t, b]]
            w = weights[t, q]
            moduli = w * moduli_of(law[t], h, j, p)
            cof = w * five(cofactor(wp.identity(n=3, dtype=wp.float64) + h))
            for a in range(6):
                g = gradients[t, q, a]
                for k in range(5):
                    stiff[12 * q + 2 * a, k] = moduli[k, 0] * g[0] + moduli[k, 1] * g[2] + moduli[k, 4] * g[1]
                    stiff[12 * q + 2 * a + 1, k] = moduli[k, 2] * g[0] + moduli[k, 3] * g[2]
                change[q, 2 * a] = cof[0] * g[0] + cof[1] * g[2] + cof[4] * g[1]
                change[q, 2 * a + 1] = cof[2] * g[0] + cof[3] * g[2]
        for a in range(6):
            na = triangles[t, a]
            for b in range(a, 6):
                nb = triangles[t, b]
                offset = pair_offset(pattern, na, nb)
                for k in range(2):
                    xx = wp.float64(0.0)
                    zx = wp.float64(0.0)
                    ab = wp.float64(0.0)  # u_a with p_b
                    ba = wp.float64(0.0)  # p_a with u_b
                    for q in range(Q):
                        g = gradients[t, q, a]
                        row = 12 * q + 2 * b + k
                        xx += g[0] * stiff[row, 0] + g[2] * stiff[row, 1] + g[1] * stiff[row, 4]
                        zx += g[0] * stiff[row, 2] + g[2] * stiff[row, 3]
                        if b < 3:
                            ab += shape[q, b] * change[q, 2 * a + k]
                        if a < 3:
                            ba += shape[q, a] * change[q, 2 * b + k]
                    add_entry(pattern, values, na, 0, nb, 2 * k, offset, xx)
                    add_entry(pattern, values, na, 2, nb, 2 * k, offset, zx)
                    if b < 3:
                        add_entry(pattern, values, na, 2 * k, nb, 3, offset, ab)
                    if a < 3 and a != b:
                        add_entry(pattern, values, na, 3, nb, 2 * k, offset, ba)
                if b < 3:
                    pp = wp.float64(0.0)
                    for q in range(Q):
                        pp -= weights[t, q] * shape[q, a] * shape[q, b] / kappa[t]
                    add_entry(pattern, values, na, 3, nb, 3, offset, pp)

    return planar_residual, planar_tangent


class PlanarSolids(Solids):
    """`Solids` of triangles (T, 6) in the plane y = 0, `fixed` there: forces are per radian or per millimetre of depth."""

    kernels = staticmethod(triangle_kernels)

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._held = []  # volume is kept through the pressure only

    def entries(self, pairs: PairPattern) -> PairPattern:
        """The kernel of these few elements searches the pattern itself."""
        return pairs
