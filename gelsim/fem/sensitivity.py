"""How the force and the membrane of a press answer to the moduli and to the approach: the adjoint of the converged state.

A state is a displacement and pressure w and contact multipliers λ (at the vertices of the gel's faces) with

    R(w, λ, θ) = 0,        λ - D M⁻¹ Bᵀ A p(w, λ, θ) = 0,

R the equations of Newton, p_i = φ'(λ_i/k_i - g_i) the pressures of the contact's quadrature points, A their areas, B their linear shape
functions, M = Bᵀ A B, D 1 where λ > 0 and else 0. A press stops its augmentations when the overlap is small; here they go on until λ stands
still, so that the state depends on θ alone and not on the way to it. With K = ∂R/∂w, G = ∂g/∂w, S = ∂p/∂(λ/k)/k and C = A S, a functional
J(w, λ, θ) has

    [ K          kGᵀ C B M⁻¹ D ] [a]   [∂J/∂w]
    [-Bᵀ C G   1 - Bᵀ C B M⁻¹ D ] [b] = [∂J/∂λ],        dJ/dθ = ∂J/∂θ - aᵀ ∂R/∂θ - bᵀ ∂(λ - …)/∂θ .

K is symmetric and factorised once a state, in float64. Eliminating a leaves an equation for b of the size of the contact; where multipliers
carry the load it is near one (it is what one augmentation leaves undone), and GMRES answers it in some ten back-substitutions.

θ are the moduli of the two bodies and the approach straight down. R is linear in a modulus at given w but for -p/κ. The penalty k is
k·h = 30 E of the softer body, so it follows that modulus, and its (small) effect is part of the derivative. The force is the platen's
reaction, F = vᵀR over the driven nodes with v their unit motion, which needs the rows of the tangent that Newton leaves out.

An object of several materials has one modulus here, that of its body, to which the others are in proportion.

Refused: friction and viscosity, whose history would have to be differentiated step by step. Left out: change of the pairing of points and
faces, which is continuous for smooth objects, and what the tangent leaves out (contact.py: first order in the gap).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, gmres

from gelsim.errors import SceneError, SolveError, SolveStatus
from gelsim.fem.linear import float64_factors
from gelsim.fem.pattern import build_pattern, element_pairs, pair_keys
from gelsim.fem.problem import MILLINEWTON, PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.results import PressSensitivity
from gelsim.units import MM_PER_M

Array = NDArray[np.float64]

PARAMETERS = ("gel_modulus_kpa", "object_modulus_kpa", "depth_mm")
TOLERANCE = 1e-9  # Newton's, at the states that are differentiated
STANDSTILL = 1e-8  # change of the multipliers over the largest at which augmentation ends
AUGMENTATIONS = 60
KRYLOV_TOLERANCE = 1e-10
KRYLOV_LIMIT = 200


@dataclass(frozen=True)
class Functional:
    """A linear functional of a state: the force times a factor plus weights times displacements of nodes."""

    force: float = 0.0
    """Of the normal force [N]."""
    nodes: NDArray[np.integer] | None = None
    weights: Array | None = None
    """Of the displacements [m] of `nodes`, (K, 3)."""


class Adjoint:
    """The linearised equations of a frictionless press at its present state, factorised once."""

    def __init__(self, problem: PressProblem, moduli_kpa: Sequence[float]) -> None:
        self.problem = problem
        self.solves = 0
        newton, solids, contact = problem.newton, problem.solids, problem.contact
        newton.residual(reach=1.0)
        newton.system.update(newton.tangent(geometric=True))
        newton.system.factorise()

        # the tangent with the driven nodes as unknowns, and their unit motion: a millimetre of approach
        free = solids.free.copy()
        free[problem.driven, :3] = True
        pairs = pair_keys(*contact.node_pairs(margin=0.2), solids.node_count)
        keys = np.unique(np.concatenate([solids.keys, pairs, element_pairs(contact.master_faces, solids.node_count)]))
        pattern = build_pattern(free, keys, solids.device)
        values = wp.zeros(len(pattern.indices), dtype=wp.float64, device=solids.device)
        assert contact.add_tangent(newton.x, pattern.pairs, values, geometric=True)
        solids.add_tangent(pattern.pairs, values)
        upper = sp.csr_matrix((values.numpy(), pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size))
        motion = np.zeros(pattern.size)
        motion[pattern.equation[problem.driven, 2]] = -1.0
        moved = upper @ motion + upper.T @ motion - upper.diagonal() * motion
        own = pattern.equation[solids.free]  # Newton's unknowns among these

        # contact: only points under pressure have a say
        pressure = contact.pressure.numpy()
        active = np.flatnonzero(pressure > 0)
        pressure, area = pressure[active], contact.rest_weight[active]
        self.stiffness = contact.stiffness.numpy()[active // contact.points]
        shifted = contact.multiplier.numpy()[active] / self.stiffness - contact.gap.numpy()[active]
        slope = np.clip(shifted / contact.law.smoothing, 0.0, 1.0)
        gradient = contact.gap_gradient(active, pattern.equation, pattern.size)
        self.shape, self.mass = contact.projection(active)  # B, M
        self.gradient, self.loaded = gradient[:, own], sp.diags(area * slope) @ self.shape  # G, C B
        self.carrying = contact.multipliers[:, 0] > 0

        # derivatives with respect to the logarithms of the moduli and to the approach: of R (driven nodes too), of λ - D M⁻¹ Bᵀ A p
        own_pressure = pressure - slope * contact.multiplier.numpy()[active]  # ∂p/∂(ln k)
        softer = 0 if moduli_kpa[0] <= min(moduli_kpa) else 1
        columns, projected = [], []
        for body, part in enumerate(self._element_part(pattern.equation, pattern.size)):
            change = own_pressure if body == softer else np.zeros_like(own_pressure)
            columns.append(part - gradient.T @ (area * change))
            projected.append(-self._project(self.shape.T @ (area * change)))
        columns.append(moved)
        projected.append(self._project(self.loaded.T @ (self.stiffness * (gradient @ motion))))
        self.scale = np.array([1.0 / moduli_kpa[0], 1.0 / moduli_kpa[1] if len(moduli_kpa) > 1 else 0.0, 1.0])
        self.equations = np.array(columns)[:, own]
        self.multipliers = np.array(projected)
        # the platen's force [N] = factor · motionᵀR
        unit = problem.copies * MILLINEWTON
        self.force_by_state = unit * moved[own]
        self.force_by_multiplier = -unit * (self.loaded.T @ (gradient @ motion))
        self.force_by_parameter = unit * np.array(columns) @ motion

    def _element_part(self, equation: NDArray[np.int32], size: int) -> tuple[Array, Array]:
        """E ∂/∂E of the elements' equations, of the gel's and of the object's modulus: the isochoric forces, and +p/κ of the volumes."""
        problem, solids = self.problem, self.problem.solids
        displacement, pressure = solids.state()
        with_pressure = solids.internal_force()[1]
        solids.set_state((displacement, np.zeros_like(pressure)))
        force, without, _ = solids.internal_force()
        solids.set_state((displacement, pressure))
        both = np.column_stack([force, without - with_pressure])
        parts = []
        for is_object in (False, True):
            chosen = (np.arange(solids.node_count) >= problem.object_nodes[0]) == is_object
            part = np.zeros(size)
            used = (equation >= 0) & chosen[:, None]
            part[equation[used]] = both[used]
            parts.append(part)
        return parts[0], parts[1]

    def _project(self, moment: Array) -> Array:
        """D M⁻¹."""
        return np.where(self.carrying, self.mass.solve(moment), 0.0)

    def _solve(self, right: Array) -> Array:
        self.solves += 1
        return self.problem.newton.system.solve(right, None)

    def gradient_of(self, functional: Functional) -> Array:
        """dJ/dθ of PARAMETERS, (3,): per kPa, kPa and mm."""
        solids = self.problem.solids
        by_state = functional.force * self.force_by_state
        if functional.nodes is not None:
            assert functional.weights is not None
            at = solids.equation[functional.nodes, :3]
            np.add.at(by_state, at[at >= 0], functional.weights[at >= 0] / MM_PER_M)
        by_multiplier = functional.force * self.force_by_multiplier

        def spread(b: Array) -> Array:
            """C B M⁻¹ D b."""
            return self.loaded @ self.mass.solve(np.where(self.carrying, b, 0.0))

        def remainder(b: Array) -> Array:
            along = spread(b)
            answer = self._solve(self.gradient.T @ (self.stiffness * along))
            return b - self.shape.T @ along + self.loaded.T @ (self.gradient @ answer)

        first = self._solve(by_state)
        right = by_multiplier + self.loaded.T @ (self.gradient @ first)
        size = len(right)
        operator = LinearOperator((size, size), matvec=remainder, dtype=np.float64)  # type: ignore[call-arg]
        b, info = gmres(operator, right, rtol=KRYLOV_TOLERANCE, atol=0.0, restart=KRYLOV_LIMIT, maxiter=1)
        if info != 0:
            raise SolveError(f"the adjoint of a press did not converge in {KRYLOV_LIMIT} iterations")
        a = first - self._solve(self.gradient.T @ (self.stiffness * spread(b)))
        result = functional.force * self.force_by_parameter - self.equations @ a - self.multipliers @ b
        return result * self.scale


def converge(problem: PressProblem) -> None:
    """Augments until the multipliers stand still, from the present equilibrium.

    Raises:
        SolveError: Newton or the augmentation did not get there.
    """
    contact = problem.contact
    for _ in range(AUGMENTATIONS):
        report = problem.newton.solve(1.0, TOLERANCE)
        if report.status is not SolveStatus.CONVERGED:
            raise SolveError(f"a state of the press could not be refined to be differentiated: {report.status.value}")
        before = contact.multipliers[:, 0].copy()
        contact.augment()
        if np.abs(contact.multipliers[:, 0] - before).max() <= STANDSTILL * max(before.max(), 1e-12):
            problem.newton.solve(1.0, TOLERANCE)
            return
    raise SolveError(f"the contact pressures still moved after {AUGMENTATIONS} augmentations; the press cannot be differentiated there")


def press_sensitivity(
    problem: PressProblem, moduli_kpa: Sequence[float], heights: list[tuple[NDArray[np.integer], Array]]
) -> PressSensitivity:
    """Presses, and differentiates every recorded state.

    Args:
        problem: Of a scene without friction; not solved before.
        moduli_kpa: Young's moduli of the gel, the object's body and its parts; a rigid object has none.
        heights: For each point its nodes and their shares (K,), of which the height is the sum.
    Raises:
        SceneError: The scene has friction or viscosity. SolveError: the press, or the refinement of a state, failed.
    """
    if problem.contact.frictional:
        raise SceneError(
            f"contact.friction_coefficient = {problem.scene.contact.friction_coefficient!r}: a press with friction remembers its way, "
            "and is not differentiated; allowed is 0"
        )
    if problem.memory is not None:
        raise SceneError("gel.prony_g, object.prony_g: a press with viscosity remembers its way and is not differentiated; allowed is none")
    force, height, force_gradient, height_gradient = [], [], [], []

    def differentiate(done: int, total: int) -> None:
        solids = problem.solids
        if done > 1:
            converge(problem)
        z = solids.displacement.numpy()[:, 2] / MM_PER_M
        force.append(-problem.contact_force()[2])
        height.append([shares @ z[nodes] for nodes, shares in heights])
        if done == 1:  # first touch: nothing is loaded yet
            force_gradient.append(np.zeros(len(PARAMETERS)))
            height_gradient.append(np.zeros((len(heights), len(PARAMETERS))))
            return
        adjoint = Adjoint(problem, moduli_kpa)
        force_gradient.append(adjoint.gradient_of(Functional(force=1.0)))
        functionals = [Functional(nodes=nodes, weights=shares[:, None] * [0.0, 0.0, 1.0]) for nodes, shares in heights]
        height_gradient.append(np.array([adjoint.gradient_of(f) for f in functionals]).reshape(len(heights), len(PARAMETERS)))

    with float64_factors():
        approach = run_press(problem, progress=differentiate).approach
    return PressSensitivity(PARAMETERS, approach, np.array(force), np.array(force_gradient), np.array(height), np.array(height_gradient))
