"""A negative control: the ten-node tet without a pressure field of its own, p = κ(J - 1) at every quadrature point. It locks as ν → ½.

Kernels of the signatures that `gelsim.fem.assembly.Solids` launches, neo-Hookean only, to be put in the place of the real ones. No press
uses them: tests and the benchmark show by them what the checks would say of an element that locks.
"""

from __future__ import annotations

import warp as wp

from gelsim.fem.assembly import Solids, scatter, scatter_block
from gelsim.fem.hyperelastic import cofactor, volume_change

wp.set_module_options({"max_unroll": 1, "enable_backward": False})


@wp.kernel(enable_backward=False)
def locked_residual(
    tets: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
    gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
    law: wp.array(dtype=wp.vec3d), kappa: wp.array(dtype=wp.float64), _held: wp.array(dtype=wp.float64),
    force: wp.array(dtype=wp.vec3d), volume: wp.array(dtype=wp.float64), energy: wp.array(dtype=wp.float64),
    min_jacobian: wp.array(dtype=wp.float64),
):  # fmt: skip
    t = wp.tid()
    smallest = wp.float64(1.0e30)
    for q in range(weights.shape[1]):
        h = wp.mat33d()
        for a in range(10):
            h += wp.outer(displacement[tets[t, a]], gradients[t, q, a])
        f = wp.identity(n=3, dtype=wp.float64) + h
        dv = volume_change(h)
        j = wp.float64(1.0) + dv
        smallest = wp.min(smallest, j)
        if j > wp.float64(0.0):
            cof = cofactor(f)
            slope = wp.float64(2.0) * law[t][0] * wp.pow(j, wp.float64(-2.0) / wp.float64(3.0))
            stress = slope * (f - (wp.ddot(f, f) / (wp.float64(3.0) * j)) * cof) + (kappa[t] * dv) * cof
            for a in range(10):
                wp.atomic_add(force, tets[t, a], weights[t, q] * (stress * gradients[t, q, a]))
            for b in range(4):  # keeps the pressure unknowns at zero
                wp.atomic_add(volume, tets[t, b], -weights[t, q] * shape[q, b] * pressure[tets[t, b]] / kappa[t])
    energy[t] = wp.float64(0.0)
    min_jacobian[t] = smallest


@wp.kernel(enable_backward=False)
def locked_tangent(
    tets: wp.array2d(dtype=wp.int32), displacement: wp.array(dtype=wp.vec3d), pressure: wp.array(dtype=wp.float64),
    gradients: wp.array3d(dtype=wp.vec3d), weights: wp.array2d(dtype=wp.float64), shape: wp.array2d(dtype=wp.float64),
    law: wp.array(dtype=wp.vec3d), kappa: wp.array(dtype=wp.float64), _held: wp.array(dtype=wp.float64),
    entries: wp.array2d(dtype=wp.int32), values: wp.array(dtype=wp.float64),
):  # fmt: skip
    t = wp.tid()
    third = wp.float64(1.0) / wp.float64(3.0)
    two = wp.float64(2.0) * third
    for q in range(weights.shape[1]):
        h = wp.mat33d()
        for a in range(10):
            h += wp.outer(displacement[tets[t, a]], gradients[t, q, a])
        f = wp.identity(n=3, dtype=wp.float64) + h
        dv = volume_change(h)
        j = wp.float64(1.0) + dv
        inverse_transpose = cofactor(f) / j
        w = weights[t, q]
        slope = w * wp.float64(2.0) * law[t][0] * wp.pow(j, -two)
        i1 = wp.ddot(f, f) * third
        pj = w * kappa[t] * dv * j
        at = int(0)
        for a in range(10):
            ga = gradients[t, q, a]
            fa = f * ga
            aa = inverse_transpose * ga
            for b in range(a, 10):
                gb = gradients[t, q, b]
                fb = f * gb
                ab = inverse_transpose * gb
                d = slope * wp.dot(ga, gb)
                outer_ab = wp.outer(aa, ab)
                block = wp.diag(wp.vec3d(d, d, d)) + wp.outer((-two * slope) * aa, fb) + wp.outer((-two * slope) * fa, ab)
                block += (two * i1 * slope + pj + w * kappa[t] * j * j) * outer_ab + (slope * i1 - pj) * wp.transpose(outer_ab)
                scatter_block(entries, values, t, at, block)
                at += 9
        for a in range(4):
            at += 30
            for b in range(a, 4):
                scatter(values, entries[t, at], -w * shape[q, a] * shape[q, b] / kappa[t])
                at += 1


def lock(solids: Solids) -> None:
    """Puts the faulty element in the place of the real one, in place."""
    solids._residual, solids._tangent = locked_residual, locked_tangent
