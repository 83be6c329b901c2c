"""The mechanics written slowly: energies, and contact's forces, in clear float64 NumPy, as the specification of the Warp kernels.

For tests and for doubt only. Only the potential of the bodies is written out,

    Π(u, p) = ∫ Ŵ + p (J - 1) - p²/(2κ) + H:(C - 1)/2 dV   (assembly.py, hyperelastic.py; H only in viscoelastic.py)

with J = det F, and the forces of contact and of Coulomb's friction (contact.py), which have none. The rest is their derivatives by the
complex step, Im f(x + ih)/h with h = 1e-30: exact to rounding, as nothing is subtracted (Squire and Trapp 1998). So no derivative formula
of the kernels is repeated here, and an error in one cannot hide in both. Every function takes complex arguments for that reason: a norm is
the root of the sum of squares, and branches look at real parts.

Left out: search for the face that a point belongs to (the caller says), and speed. Units are the solver's (mm, kPa, mN).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.contact import ContactLaw
from gelsim.fem.elements import TetQuadrature, tri6_gradient, tri6_shape

Array = NDArray[np.float64]
_STEP = 1e-30


def derivative(function: Callable[[Array], Array], x: Array) -> Array:
    """∂f/∂x by the complex step: shape of f(x), then shape of x."""
    columns = []
    for index in np.ndindex(x.shape):
        moved = x.astype(complex)
        moved[index] += 1j * _STEP
        columns.append(np.asarray(function(moved)).imag / _STEP)
    columns = np.array(columns)
    return np.moveaxis(columns.reshape(*x.shape, *columns.shape[1:]), range(x.ndim), range(-x.ndim, 0))


# ---------------------------------------------------------------------------------------------------------------- elements
def power(c: Array, exponent: float) -> Array:
    """C^γ of a symmetric positive matrix (3, 3) by four square roots (Denman and Beavers 1976), the binomial series, and four squarings.

    Without eigenvalues, on purpose: the kernels have them, and complex steps do not pass through those of equal stretches.
    """
    for _ in range(4):
        root, inverse = c, np.eye(3, dtype=c.dtype)
        for _ in range(10):  # converges quadratically
            root, inverse = (root + np.linalg.inv(inverse)) / 2, (inverse + np.linalg.inv(root)) / 2
        c = root
    excess = c - np.eye(3)
    result = term = np.eye(3, dtype=c.dtype)
    for k in range(1, 18):  # |excess| is under 0.15 for stretches of 0.3 to 3
        term = term @ excess * ((exponent - k + 1) / k)
        result = result + term
    for _ in range(4):
        result = result @ result
    return result


def isochoric_energy(f: Array, law: Array) -> Array:
    """Ŵ [kPa] of a deformation gradient (3, 3): Σ_k c_k (Ī₁ - 3)^k of three constants, Ogden's of six, (μ₁, α₁, μ₂, α₂, μ₃, α₃)."""
    j = np.linalg.det(f)
    if len(law) == 6:
        terms = [2 * mu / a**2 * (j ** (-a / 3) * np.trace(power(f.T @ f, a / 2)) - 3) for mu, a in law.reshape(3, 2) if mu]
        return np.sum(terms)
    excess = j ** (-2 / 3) * (f * f).sum() - 3
    return law[0] * excess + law[1] * excess**2 + law[2] * excess**3


def volume_change(h: Array) -> Array:
    """J - 1 of a displacement gradient (3, 3), in its own precision: det(1 + H) - 1 would round at 1."""
    trace = np.trace(h)
    return trace + (trace * trace - np.trace(h @ h)) / h.dtype.type(2) + np.linalg.det(h)


def element_energy(u: Array, p: Array, gradients: Array, weights: Array, shape: Array, law: Array, kappa: float) -> complex:
    """Π of one tet [µJ].

    Args:
        u: Displacements (10, 3) [mm]. p: pressures at the vertices (4,) [kPa].
        gradients, weights, shape: (Q, 10, 3), (Q,) and (Q, 4) of `elements.TetQuadrature`.
    """
    total = 0j
    for g, w, n in zip(gradients, weights, shape, strict=True):
        f = np.eye(3) + u.T @ g
        pressure = n @ p
        total = total + w * (isochoric_energy(f, law) + pressure * (np.linalg.det(f) - 1) - pressure**2 / (2 * kappa))
    return total


def first_piola(f: Array, law: Array, pressure: Array) -> Array:
    """∂/∂F of Ŵ + p (J - 1) [kPa], (3, 3): the one derivative written out, so that forces can be differentiated once more."""
    j = np.linalg.det(f)
    inverse_transpose = np.linalg.inv(f).T
    volumetric = pressure * j * inverse_transpose
    if len(law) == 6:
        c = f.T @ f
        terms = [(mu, a, power(c, a / 2 - 1)) for mu, a in law.reshape(3, 2) if mu]
        return volumetric + sum(
            2 * mu / a * j ** (-a / 3) * (f @ below - np.trace(below @ c) / 3 * inverse_transpose) for mu, a, below in terms
        )
    i1 = (f * f).sum()
    excess = j ** (-2 / 3) * i1 - 3
    slope = law[0] + 2 * law[1] * excess + 3 * law[2] * excess**2
    return 2 * slope * j ** (-2 / 3) * (f - i1 / 3 * inverse_transpose) + volumetric


def element_residual(unknowns: Array, gradients: Array, weights: Array, shape: Array, law: Array, kappa: float,
                     history: Array | None = None) -> Array:  # fmt: skip
    """∂Π/∂(u, p) of one tet, (34,): 10 nodal forces [mN] and 4 volumes [mm³] one after the other; `unknowns` (34,) likewise.

    history: H (Q, 3, 3) [kPa].
    """
    u, p = unknowns[:30].reshape(10, 3), unknowns[30:]
    force, volume = np.zeros((10, 3), unknowns.dtype), np.zeros(4, unknowns.dtype)
    for g, w, n, h in zip(gradients, weights, shape, np.zeros((len(shape), 3, 3)) if history is None else history, strict=True):
        f = np.eye(3) + u.T @ g
        pressure = n @ p
        force = force + w * g @ (first_piola(f, law, pressure) + f @ h).T
        volume = volume + w * n * (np.linalg.det(f) - 1 - pressure / kappa)
    return np.concatenate([force.ravel(), volume])


def element_tangent(unknowns: Array, gradients: Array, weights: Array, shape: Array, law: Array, kappa: float,
                    history: Array | None = None) -> Array:  # fmt: skip
    """∂²Π/∂(u, p)² of one tet, (34, 34)."""
    return derivative(lambda v: element_residual(v, gradients, weights, shape, law, kappa, history), unknowns)


def assemble(u: Array, p: Array, tets: NDArray[np.int32], quadrature: TetQuadrature, law: Array, kappa: Array,
             pressures: NDArray[np.int32] | None = None, history: Array | None = None) -> tuple[float, Array, Array]:  # fmt: skip
    """Energy (without H), residual (N, 4) and dense tangent (N, 4, N, 4) of a mesh; component 3 of a node is its pressure.

    pressures: The nodes that carry each tet's pressure (T, 4), its vertices unless given. history: H (T, Q, 3, 3).
    """
    count = len(u)
    energy, residual, tangent = 0.0, np.zeros(4 * count), np.zeros((4 * count, 4 * count))
    for t, tet in enumerate(tets):
        carrier = tet[:4] if pressures is None else pressures[t]
        place = np.concatenate([(4 * tet[:, None] + np.arange(3)).ravel(), 4 * carrier + 3])
        unknowns = np.concatenate([u[tet].ravel(), p[carrier]])
        data = (quadrature.gradients[t], quadrature.weights[t], quadrature.pressure_shape, law[t], float(kappa[t]))
        stress = None if history is None else history[t]
        energy += element_energy(u[tet], p[carrier], *data).real
        residual[place] += element_residual(unknowns, *data, stress)
        tangent[np.ix_(place, place)] += element_tangent(unknowns, *data, stress)
    return energy, residual.reshape(count, 4), tangent.reshape(count, 4, count, 4)


def isochoric_second_piola(f: Array, law: Array) -> Array:
    """Ŝ = F⁻¹ ∂Ŵ/∂F [kPa] (3, 3), from the energy."""
    return np.asarray(np.linalg.solve(f, derivative(lambda x: np.asarray(isochoric_energy(x, law)), f)), np.float64)


def overstress(times: Array, stresses: Array, share: float, tau: float) -> Array:
    """Q(t) = g ∫ e^(-(t-s)/τ) dŜ/ds ds at the last of `times` (K,) [s], of stresses (K, ...) joined by straight lines: no recursion."""
    total = np.zeros(stresses.shape[1:])
    for begin, end, before, after in zip(times[:-1], times[1:], stresses[:-1], stresses[1:], strict=True):
        kernel = tau * (np.exp((end - times[-1]) / tau) - np.exp((begin - times[-1]) / tau))
        total = total + share * kernel * (after - before) / (end - begin)
    return total


# ---------------------------------------------------------------------------------------------------------------- contact
def penalty_potential(s: Array, k: float, eps: float) -> Array:
    """φ [kPa·mm]: 0 for s ≤ 0, k s³/(6ε) to ε, k (s²/2 - εs/2 + ε²/6) beyond; twice continuously differentiable."""
    return np.where(s.real <= 0, 0.0, np.where(s.real < eps, k * s**3 / (6 * eps), k * (s**2 / 2 - eps * s / 2 + eps**2 / 6)))


def penalty_pressure(s: Array, k: float, eps: float) -> Array:
    """p = φ' [kPa]."""
    return np.where(s.real <= 0, 0.0, np.where(s.real < eps, k * s**2 / (2 * eps), k * (s - eps / 2)))


def _shape(xi: Array) -> Array:
    return tri6_shape(np.array([1 - xi[0] - xi[1], xi[0], xi[1]]))


def face_point(nodes: Array, xi: Array) -> Array:
    """y(ξ) (3,) on a six-node face (6, 3)."""
    return _shape(xi) @ nodes


def face_normal(nodes: Array, xi: Array) -> Array:
    """Unit normal (3,) of a six-node face at ξ, outward for outward faces."""
    tangents = tri6_gradient(np.array([1 - xi[0] - xi[1], xi[0], xi[1]])).T @ nodes
    normal = np.cross(tangents[0], tangents[1])
    return normal / np.sqrt((normal * normal).sum())


def meeting(nodes: Array, at: Array, xi: Array) -> tuple[Array, Array, Array]:
    """Gap g [mm], normal n (3,) and ξ (2,) where the line of a point of the gel meets a face of the object.

    The line runs from the place `at` (2,) on the gel's face along that face's outward normal -n, and is followed by Newton on
    x - g n = y(ξ), three equations for ξ and g, onto the (extended) face of the object.

    Args:
        nodes: Positions (12 or more, 3) [mm]: the gel's six-node face, then the object's. xi: where to seek from.
    """
    x, normal = face_point(nodes[:6], at), -face_normal(nodes[:6], at)
    gap = normal @ (x - face_point(nodes[6:12], xi))
    for _ in range(8):  # quadratic convergence: five from a start on the right face, and one more for the complex part
        tangents = tri6_gradient(np.array([1 - xi[0] - xi[1], xi[0], xi[1]])).T @ nodes[6:12]
        step = np.linalg.solve(np.column_stack([*tangents, normal]), x - gap * normal - face_point(nodes[6:12], xi))
        xi, gap = xi + step[:2], gap + step[2]
    return gap, normal, xi


def contact_force(nodes: Array, at: Array, xi: Array, multiplier: float, law: ContactLaw) -> Array:
    """Forces p n on the gel at a point and -p n on the object where its line meets it, as ∂φ/∂u would have them (12, 3) [kPa].

    Times the area that the point stands for. Arguments as of `meeting`, and multiplier λ [kPa].

    Args:
        law: Of the point: its stiffnesses are k and k_t [kPa/mm], those of the contact divided by the size of the gel's face.
    """
    gap, normal, there = meeting(nodes, at, xi)
    pressure = penalty_pressure(multiplier / law.stiffness - gap, law.stiffness, law.smoothing)
    return np.outer(np.concatenate([-_shape(at), _shape(there)]), pressure * normal)


def friction_force(nodes: Array, at: Array, xi: Array, multiplier: float, law: ContactLaw, anchor: Array, shift: Array) -> Array:
    """Forces of friction, likewise (18, 3) [kPa].

    Args:
        nodes: Of the gel's face, of the object's that its line meets, and of the object's that it touched when the load step began.
        anchor: Where on that one (2,). Others as of `contact_force` and `friction_traction`.
    """
    gap, normal, _ = meeting(nodes, at, xi)
    slip = face_point(nodes[:6], at) - face_point(nodes[12:], anchor)
    pressure = penalty_pressure(multiplier / law.stiffness - gap, law.stiffness, law.smoothing)
    traction = friction_traction(slip, normal, shift, law, pressure)
    return np.outer(np.concatenate([_shape(at), np.zeros(6), -_shape(anchor)]), traction)


def friction_traction(slip: Array, normal: Array, shift: Array, law: ContactLaw, pressure: Array) -> Array:
    """Traction [kPa] (3,) that the gel exerts on the object: λ_t + k_t e in the tangent plane, cut back to μp (μ < 0: never).

    Args:
        slip: e, what the point has moved against the place on the object that it touched when the load step began (3,) [mm].
        shift: λ_t (3,).
    """
    trial = shift + law.stick_stiffness * slip
    trial = trial - normal * (normal @ trial)
    size = np.sqrt((trial * trial).sum())
    if law.friction >= 0 and size.real > law.friction * pressure.real:
        trial = trial * (law.friction * pressure / size)
    return trial
