"""Where single precision is enough for the mechanics and where it is not: digits lost by element forces, and by a rounded state.

    python docs/studies/float32.py                       # a few seconds

*Element forces.* Ten-node tets under random nearly isochoric strain of 1 %, pressure of the order of the shear stress, as at equilibrium.
Inputs (displacements, pressures) and every operation are float32; the answer is that in float64 from the same displacements before
rounding. Three forms of the pressure: as its own unknown, beside J - 1 = tr H + (tr² H - tr H²)/2 + det H (ours); p = κ(J - 1) with that
J - 1; p = κ(det F - 1). One digit is lost for every factor of ten over the rounding of float32, 6e-8. What is expected: rounding for ours;
κ/μ times it for the second, as displacements themselves are rounded; κ/μ over the strain for the third, which subtracts from 1.

*A rounded state.* A solved press (rigid ball, `fast` mesh, Newton to 1e-9) with displacements and pressures rounded to float32: the
equations, evaluated in float64, are then out of balance by this share of the largest nodal contact force. No solver whose state is float32
can go below it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.bench.presses import ball
from gelsim.fem.elements import tet10_gradient, tet_quadrature
from gelsim.fem.problem import Numerics, PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.fem.reference import volume_change
from gelsim.geometry import TET_EDGES
from gelsim.pipeline import stages
from gelsim.scene import materials
from gelsim.scene.layers import build_scene
from gelsim.scene.materials import ElasticMaterial

Array = NDArray[np.floating]
FORMS = ("pressure its own unknown", "p = κ(J - 1), J - 1 from H", "p = κ(det F - 1)")
NUS = (0.49, 0.499, 0.4999, 0.49999)
STRAIN = 0.01
ROUNDING = float(np.finfo(np.float32).eps) / 2


def forces(u: Array, pressure: Array, gradients: Array, weights: Array, shape: Array, material: ElasticMaterial, form: str) -> Array:
    """Nodal forces (10, 3) of a neo-Hookean tet in the precision of its arguments; `pressure` is used by the first form only."""
    kind = u.dtype.type
    mu, kappa, one = kind(material.mu), kind(material.kappa), np.eye(3, dtype=u.dtype)
    total = np.zeros((10, 3), u.dtype)
    for g, w, n in zip(gradients, weights, shape, strict=True):
        h = u.T @ g
        f = one + h
        j = kind(1) + volume_change(h)
        if form == FORMS[0]:
            p = n @ pressure
        else:
            p = kappa * (volume_change(h) if form == FORMS[1] else np.linalg.det(f) - kind(1))
        # F - I₁/3 F⁻ᵀ from H: the ones cancel before they are rounded
        strain = h + h.T + h @ h.T
        tau = mu * j ** kind(-2 / 3) * (strain - np.trace(strain) / kind(3) * one) + p * j * one
        total += w * g @ (np.linalg.inv(f) @ tau)
    assert total.dtype == u.dtype
    return total


def element_errors(nu: float, form: str, count: int = 200) -> float:
    """Median relative error of the forces in float32."""
    rng = np.random.default_rng(5)
    material = ElasticMaterial.from_modulus(50e3, nu)
    bary, rule = tet_quadrature(4)
    errors = []
    for _ in range(count):
        corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) + 0.2 * rng.uniform(-1, 1, (4, 3))
        x = np.concatenate([corner, corner[TET_EDGES].mean(1)])
        jacobian = np.einsum("ni,qnj->qij", x, tet10_gradient(bary))
        gradients = np.einsum("qnj,qji->qni", tet10_gradient(bary), np.linalg.inv(jacobian))
        weights = rule * np.linalg.det(jacobian)
        h = STRAIN * rng.standard_normal((3, 3))
        wanted = material.mu * STRAIN * rng.standard_normal() / material.kappa  # J - 1 of a pressure like the shear stress
        for _ in range(5):
            h -= np.eye(3) * (volume_change(h) - wanted) / 3
        u, pressure = x @ h.T, np.full(4, material.kappa * volume_change(h))
        exact = forces(u, pressure, gradients, weights, bary, material, FORMS[0])
        single = [a.astype(np.float32) for a in (u, pressure, gradients, weights, bary)]
        found = forces(single[0], single[1], single[2], single[3], single[4], material, form)
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    return float(np.median(errors))


def rounded_state(nu: float) -> tuple[float, float]:
    """Imbalance of a solved press, and of the same with its state rounded to float32."""
    scene = build_scene(ball(nu) | {"fidelity": "fast", "press": ball(nu)["press"] | {"frames": 3, "depth_mm": 0.5}})
    gel, body, placement = stages.bodies(scene)
    problem = PressProblem(scene, gel, body, placement, materials.press_materials(scene), "cpu", Numerics(tolerance=1e-9))
    run_press(problem)
    problem.newton.solve(1.0)  # the march ends by moving the multipliers
    before = problem.newton.residual(1.0).imbalance
    u, p = problem.solids.state()
    problem.solids.set_state((u.astype(np.float32).astype(float), p.astype(np.float32).astype(float)))
    return before, problem.newton.residual(1.0).imbalance


def main() -> dict[float, dict[str, float]]:
    """Prints the table; returns relative force errors by ν and form."""
    found = {}
    print("| ν | κ/μ | " + " | ".join(f"{form}: error, digits lost" for form in FORMS) + " | imbalance of a rounded state |")
    print("|---|---|---|---|---|---|")
    for nu in NUS:
        material = ElasticMaterial.from_modulus(50e3, nu)
        found[nu] = {form: element_errors(nu, form) for form in FORMS}
        cells = [f"{error:.1e}, {max(np.log10(error / ROUNDING), 0):.1f}" for error in found[nu].values()]
        print(f"| {nu} | {material.kappa / material.mu:.0f} | " + " | ".join(cells) + f" | {rounded_state(nu)[1]:.1e} |", flush=True)
    return found


if __name__ == "__main__":
    main()
