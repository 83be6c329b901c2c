"""Hyperelastic laws as Warp functions: isochoric energy, first Piola stress, and the pieces of its tangent.

    W = Ŵ(Ī₁) + (κ/2)(J - 1)²,   Ī₁ = J^(-2/3) I₁,   Ŵ = c₁(Ī₁ - 3) + c₂(Ī₁ - 3)² + c₃(Ī₁ - 3)³

c₂ = c₃ = 0, c₁ = μ/2 is the neo-Hookean law of the scene file; otherwise Yeoh (1993). The volumetric part enters through a pressure field p (see
assembly.py). With P̂ = J^(-2/3)(F - (I₁/3) F⁻ᵀ) the isochoric Piola stress is P = 2Ŵ' P̂.

Everything is float64: κ/μ is 500 at ν = 0.499 and 5,000 at 0.4999, so float32 would leave three digits of pressure. J - 1 is formed from the
displacement gradient H, never as det F minus one, so that small strains keep all their digits.
"""

from __future__ import annotations

import warp as wp


@wp.func
def volume_change(h: wp.mat33d) -> wp.float64:
    """J - 1 = tr H + (tr² H - tr H²)/2 + det H."""
    t = wp.trace(h)
    return t + wp.float64(0.5) * (t * t - wp.trace(h * h)) + wp.determinant(h)


@wp.func
def cofactor(f: wp.mat33d) -> wp.mat33d:
    """J F⁻ᵀ, also where J is zero."""
    a = wp.vec3d(f[0, 0], f[1, 0], f[2, 0])
    b = wp.vec3d(f[0, 1], f[1, 1], f[2, 1])
    c = wp.vec3d(f[0, 2], f[1, 2], f[2, 2])
    return wp.matrix_from_cols(wp.cross(b, c), wp.cross(c, a), wp.cross(a, b))


@wp.func
def law_slope(c: wp.vec3d, s: wp.float64) -> wp.float64:
    """Ŵ' at s = Ī₁ - 3."""
    return c[0] + s * (wp.float64(2.0) * c[1] + wp.float64(3.0) * s * c[2])


@wp.func
def law_curvature(c: wp.vec3d, s: wp.float64) -> wp.float64:
    """Ŵ'' at s = Ī₁ - 3."""
    return wp.float64(2.0) * c[1] + wp.float64(6.0) * s * c[2]


@wp.func
def law_energy(c: wp.vec3d, s: wp.float64) -> wp.float64:
    return s * (c[0] + s * (c[1] + s * c[2]))


@wp.func
def isochoric_excess(h: wp.mat33d, j: wp.float64) -> wp.float64:
    """Ī₁ - 3 without cancellation at small strain: I₁ - 3 = 2 tr H + H:H."""
    excess = wp.float64(2.0) * wp.trace(h) + wp.ddot(h, h)
    scale = wp.pow(j, wp.float64(-2.0) / wp.float64(3.0))
    # J^(-2/3) - 1 = expm1(-2/3 log J)
    drop = wp.float64(-2.0) / wp.float64(3.0) * wp.log(j)
    expm1 = drop * (wp.float64(1.0) + drop / wp.float64(2.0) * (wp.float64(1.0) + drop / wp.float64(3.0)))
    if wp.abs(drop) > wp.float64(1.0e-4):
        expm1 = scale - wp.float64(1.0)
    return excess * scale + wp.float64(3.0) * expm1
