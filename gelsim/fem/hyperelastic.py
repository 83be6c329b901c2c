"""Hyperelastic laws as Warp functions: isochoric energy, first Piola stress, and the pieces of its tangent.

    W = Ŵ + (κ/2)(J - 1)²                                                        the volumetric part enters through p (assembly.py)
    "cubic":  Ŵ = c₁(Ī₁ - 3) + c₂(Ī₁ - 3)² + c₃(Ī₁ - 3)³,   Ī₁ = J^(-2/3) I₁      Yeoh (1993); neo-Hookean for c₂ = c₃ = 0, c₁ = μ/2
    "ogden":  Ŵ = Σ_k 2μ_k/α_k² (λ̄₁^α_k + λ̄₂^α_k + λ̄₃^α_k - 3),  λ̄ = J^(-1/3) λ    Ogden (1972), at most three terms

**Cubic.** With P̂ = J^(-2/3)(F - (I₁/3) F⁻ᵀ) the isochoric Piola stress is P = 2Ŵ' P̂.

**Ogden** is evaluated in principal axes: F = Σ λ_A n_A ⊗ N_A, W_A = ∂Ŵ/∂λ_A = β_A/λ_A, P = Σ W_A n_A ⊗ N_A. With
dF_AB = n_A · dF N_B the second variation is Σ_AB W_AB dF_AA dF_BB + Σ_{A<B} [P_AB (dF_AB² + dF_BA²) + 2 Q_AB dF_AB dF_BA], where
P, Q = (S ± T)/2 (Ogden 1984, Non-linear elastic deformations, §6.1.4) and

    S = (W_A - W_B)/(λ_A - λ_B),   T = (W_A + W_B)/(λ_A + λ_B)

S is 0/0 at equal stretches and loses digits near them. Its one dangerous quotient is written with logarithms, l = (log λ_A + log λ_B)/2
and d = (log λ_A - log λ_B)/2:  (λ_A^α - λ_B^α)/(λ_A - λ_B) = e^((α-1) l) sinh(α d)/sinh(d), accurate to rounding however small d is, and
α e^((α-1) l) at d = 0. N_A are those of C - 1 = H + Hᵀ + HᵀH by Jacobi's rotations, whose axes stay orthogonal where stretches coincide
(Warp's own eig3 makes a fixed number of sweeps with approximate rotations).

Everything is float64: κ/μ is 500 at ν = 0.499 and 5,000 at 0.4999, so float32 would leave three digits of pressure. J - 1 and C - 1 are
formed from the displacement gradient H, never as a difference from one, so that small strains keep all their digits.
"""

from __future__ import annotations

import warp as wp

from gelsim.scene.materials import OGDEN_TERMS

OgdenConstants = wp.types.vector(length=2 * OGDEN_TERMS, dtype=wp.float64)
"""(μ₁, α₁, μ₂, α₂, μ₃, α₃) of a solid [kPa, 1]; terms not used have μ = 0."""
_ROUNDING = wp.constant(wp.float64(1.0e-32))
"""Square of a rounding: off-diagonal entries of this share of the whole count as zero."""


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


# ---------------------------------------------------------------------------------------------------------------- Ogden
@wp.func
def log1p(x: wp.float64) -> wp.float64:
    """log(1 + x) to rounding: the error of u = fl(1 + x) is the same in log u and in u - 1 (Kahan)."""
    u = wp.float64(1.0) + x
    if u == wp.float64(1.0):
        return x
    return wp.log(u) * x / (u - wp.float64(1.0))


@wp.func
def expm1(x: wp.float64) -> wp.float64:
    """exp(x) - 1 to rounding, the same way."""
    u = wp.exp(x)
    if u == wp.float64(1.0):
        return x
    if wp.abs(x) > wp.float64(1.0):
        return u - wp.float64(1.0)
    return (u - wp.float64(1.0)) * x / wp.log(u)


@wp.func
def principal_axes(s: wp.mat33d):
    """Eigenvalues, and eigenvectors in columns, of a symmetric matrix: cyclic Jacobi rotations (Golub and Van Loan, §8.5).

    Only the upper triangle of `a` is kept up.
    """
    a = s
    v = wp.identity(n=3, dtype=wp.float64)
    size = wp.ddot(a, a)
    for _sweep in range(12):  # converges quadratically: five or six do for any matrix
        off = a[0, 1] * a[0, 1] + a[0, 2] * a[0, 2] + a[1, 2] * a[1, 2]
        if off <= _ROUNDING * size:
            break
        for k in range(3):
            p = k // 2
            q = 1 + (k + 1) // 2
            if a[p, q] != wp.float64(0.0):
                theta = (a[q, q] - a[p, p]) / (wp.float64(2.0) * a[p, q])
                t = wp.float64(1.0) / (wp.abs(theta) + wp.sqrt(theta * theta + wp.float64(1.0)))
                if theta < wp.float64(0.0):
                    t = -t
                c = wp.float64(1.0) / wp.sqrt(t * t + wp.float64(1.0))
                sine = t * c
                r = 3 - p - q
                a[p, p] = a[p, p] - t * a[p, q]
                a[q, q] = a[q, q] + t * a[p, q]
                a[p, q] = wp.float64(0.0)
                rp = a[wp.min(r, p), wp.max(r, p)]
                rq = a[wp.min(r, q), wp.max(r, q)]
                a[wp.min(r, p), wp.max(r, p)] = c * rp - sine * rq
                a[wp.min(r, q), wp.max(r, q)] = sine * rp + c * rq
                for i in range(3):
                    vp = v[i, p]
                    vq = v[i, q]
                    v[i, p] = c * vp - sine * vq
                    v[i, q] = sine * vp + c * vq
    return wp.vec3d(a[0, 0], a[1, 1], a[2, 2]), v


@wp.func
def log_stretches(excess: wp.vec3d) -> wp.vec3d:
    """log λ from the eigenvalues λ² - 1 of C - 1."""
    half = wp.float64(0.5)
    return wp.vec3d(half * log1p(excess[0]), half * log1p(excess[1]), half * log1p(excess[2]))


@wp.func
def isochoric_part(log_stretch: wp.vec3d) -> wp.vec3d:
    """log λ̄ = log λ - (log J)/3."""
    mean = (log_stretch[0] + log_stretch[1] + log_stretch[2]) / wp.float64(3.0)
    return log_stretch - wp.vec3d(mean, mean, mean)


@wp.func
def ogden_powers(alpha: wp.float64, iso: wp.vec3d) -> wp.vec3d:
    """λ̄^α - 1."""
    return wp.vec3d(expm1(alpha * iso[0]), expm1(alpha * iso[1]), expm1(alpha * iso[2]))


@wp.func
def ogden_energy(c: OgdenConstants, iso: wp.vec3d) -> wp.float64:
    """Ŵ at log λ̄."""
    energy = wp.float64(0.0)
    for k in range(OGDEN_TERMS):
        if c[2 * k] != wp.float64(0.0):
            alpha = c[2 * k + 1]
            power = ogden_powers(alpha, iso)
            energy += wp.float64(2.0) * c[2 * k] / (alpha * alpha) * (power[0] + power[1] + power[2])
    return energy


@wp.func
def ogden_stress(c: OgdenConstants, iso: wp.vec3d) -> wp.vec3d:
    """β_A = λ_A ∂Ŵ/∂λ_A = Σ_k 2μ_k/α_k (λ̄_A^α_k - mean of the three) at log λ̄: the principal Kirchhoff stresses, of no trace."""
    beta = wp.vec3d()
    for k in range(OGDEN_TERMS):
        if c[2 * k] != wp.float64(0.0):
            alpha = c[2 * k + 1]
            power = ogden_powers(alpha, iso)
            mean = (power[0] + power[1] + power[2]) / wp.float64(3.0)
            beta += wp.float64(2.0) * c[2 * k] / alpha * (power - wp.vec3d(mean, mean, mean))
    return beta


@wp.func
def ogden_stretch_tangent(c: OgdenConstants, iso: wp.vec3d) -> wp.mat33d:
    """∂β_A/∂log λ_B = Σ_k 2μ_k (λ̄_A^α δ_AB - λ̄_A^α/3 - λ̄_B^α/3 + mean/3)."""
    third = wp.float64(1.0) / wp.float64(3.0)
    result = wp.mat33d()
    for k in range(OGDEN_TERMS):
        if c[2 * k] != wp.float64(0.0):
            power = ogden_powers(c[2 * k + 1], iso) + wp.vec3d(wp.float64(1.0), wp.float64(1.0), wp.float64(1.0))
            mean = (power[0] + power[1] + power[2]) * third
            for a in range(3):
                for b in range(3):
                    value = third * (mean - power[a] - power[b])
                    if a == b:
                        value += power[a]
                    result[a, b] += wp.float64(2.0) * c[2 * k] * value
    return result


@wp.func
def ogden_quotient(c: OgdenConstants, x: wp.float64, y: wp.float64) -> wp.float64:
    """√(λ_A λ_B) (β_A - β_B)/(λ_A - λ_B) = Σ_k 2μ_k e^(α_k l) sinh(α_k d)/(α_k sinh d) at log λ̄_A, log λ̄_B = x, y."""
    d = wp.float64(0.5) * (x - y)
    total = wp.float64(0.0)
    for k in range(OGDEN_TERMS):
        if c[2 * k] != wp.float64(0.0):
            alpha = c[2 * k + 1]
            ratio = wp.float64(1.0)
            if d != wp.float64(0.0):
                ratio = wp.sinh(alpha * d) / (alpha * wp.sinh(d))
            total += wp.float64(2.0) * c[2 * k] * wp.exp(alpha * wp.float64(0.5) * (x + y)) * ratio
    return total
