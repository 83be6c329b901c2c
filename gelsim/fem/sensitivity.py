"""How the force and the membrane of a press answer to the moduli and to the approach: the linearised equations of the converged state.

A state is a displacement and pressure w and contact multipliers λ (at the vertices of the gel's faces) with

    R(w, λ, θ) = 0,        λ - Π(w, λ, θ) = 0,        Π = D M⁻¹ Bᵀ A p,

R the equations of Newton, p_i = φ'(λ_i/k_i - g_i) the pressures of the contact's quadrature points, A their areas, B their linear shape
functions, M = Bᵀ A B, D 1 where λ > 0 and else 0. A press stops its augmentations when the overlap is small; here they go on until λ stands
still, so that the state depends on θ alone and not on the way to it. Its change with θ has

    K ẇ - Nᵀ A S B λ̇ = -∂R/∂θ,        λ̇ - D M⁻¹ Bᵀ A S (B λ̇ - k G ẇ) = ∂Π/∂θ,

S = ∂p/∂(λ/k)/k, G = ∂g/∂w, and Nᵀ what makes nodal forces of the points' pressures; a soft object's G is not N, and its K = K_s + C is not
symmetric (contact.py). The symmetric K_s is factorised once a state, in float64. GMRES solves for (ẇ, λ̇) at once, after K_s⁻¹ on the first
equation, whose answer goes into the second: where multipliers carry the load, little is left but one.

θ are the moduli of the two bodies and the approach straight down. R is linear in a modulus at given w but for -p/κ. The penalty k is
k·h = 30 E of the softer body, so it follows that modulus, and its (small) effect is part of the derivative. Both moduli and the stiffness
of the coat together are only a scale of forces, at the same shape: the gel's part is the whole less the others'. The force is the platen's
reaction, F = vᵀR over the driven nodes with v their unit motion, which needs the rows of the tangent that Newton leaves out.

An object of several materials has one modulus here, that of its body, to which the others are in proportion.

Refused: friction and viscosity, whose history would have to be differentiated step by step. Left out: change of the pairing of points and
faces, which is continuous for smooth objects.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, gmres

from gelsim.errors import SceneError, SolveError, SolveStatus
from gelsim.fem.coat import Coat
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


class Linearised:
    """The linearised equations of a frictionless press at its present state, factorised once.

    Vectors of unknowns count the driven nodes' displacements too (`equation`, (N, 4)); `own` are Newton's among them.
    Attributes: `solves` with the factors so far.
    """

    def __init__(self, problem: PressProblem) -> None:
        self.problem = problem
        self.solves = 0
        newton, solids, contact = problem.newton, problem.solids, problem.contact
        newton.residual(reach=1.0)
        newton.system.update(newton.tangent(geometric=True))
        newton.system.factorise()

        free = solids.free.copy()
        free[problem.driven, :3] = True
        pairs = pair_keys(*contact.node_pairs(margin=0.2), solids.node_count)
        keys = np.unique(np.concatenate([solids.keys, pairs, element_pairs(contact.master_faces, solids.node_count)]))
        pattern = build_pattern(free, keys, solids.device)
        values = wp.zeros(len(pattern.indices), dtype=wp.float64, device=solids.device)
        assert contact.add_tangent(newton.x, pattern.pairs, values, geometric=True)
        solids.add_tangent(pattern.pairs, values)
        self.upper = sp.csr_matrix((values.numpy(), pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size))
        self.size, self.equation, self.own = pattern.size, pattern.equation, pattern.equation[solids.free]
        numbers = wp.array(pattern.equation, dtype=wp.int32, device=solids.device)
        self.rest = contact.remainder(newton.x, numbers, pattern.size)
        self.gap_changes = contact.gap_changes(newton.x, numbers)

        # only points under pressure have a say
        pressure = contact.pressure.numpy()
        self.active = active = np.flatnonzero(pressure > 0)
        self.area, self.stiffness = contact.rest_weight[active], contact.stiffness.numpy()[active // contact.points]
        multiplier = contact.multiplier.numpy()[active]
        self.slope = np.clip((multiplier / self.stiffness - contact.gap.numpy()[active]) / contact.law.smoothing, 0.0, 1.0)
        self.by_penalty = pressure[active] - self.slope * multiplier  # ∂p/∂(ln k)
        self.direction = contact.force_direction(active, pattern.equation, pattern.size)
        self.shape, self.mass = contact.projection(active)
        self.carrying = contact.multipliers[:, 0] > 0

    def pressures(self, w: Array, multipliers: Array) -> Array:
        """Change of the points' pressures."""
        return self.slope * (self.shape @ multipliers - self.stiffness * self.gap_changes(w)[self.active])

    def loads(self, pressures: Array) -> Array:
        """R of pressures at the points."""
        return -(self.direction.T @ (self.area * pressures))

    def project(self, pressures: Array) -> Array:
        """Multipliers that an augmentation makes of pressures at the points."""
        return np.where(self.carrying, self.mass.solve(self.shape.T @ (self.area * pressures)), 0.0)

    def forces(self, w: Array, multipliers: Array) -> Array:
        """Change of R."""
        change = self.upper @ w + self.upper.T @ w - self.upper.diagonal() * w + self.loads(self.slope * (self.shape @ multipliers))
        return change if self.rest is None else change + self.rest(w)

    def _spread(self, own: Array) -> Array:
        w = np.zeros(self.size)
        w[self.own] = own
        return w

    def answer(self, moved: Array, force: Array, pressures: Array) -> tuple[Array, Array]:
        """ẇ and λ̇ where driven nodes are moved, and R and the points' pressures change by themselves as given.

        Raises:
            SolveError: GMRES did not converge.
        """
        system, count = self.problem.newton.system, len(self.own)

        def solve(right: Array) -> Array:
            self.solves += 1
            return system.solve(right[self.own], None)

        def preconditioned(both: Array) -> Array:
            w, multipliers = self._spread(both[:count]), both[count:]
            rest = self.loads(self.slope * (self.shape @ multipliers))
            change = solve(rest if self.rest is None else rest + self.rest(w))
            return np.concatenate([both[:count] + change, multipliers - self.project(self.pressures(-self._spread(change), multipliers))])

        none = np.zeros(len(self.carrying))
        first = -solve(self.forces(moved, none) + force)
        right = np.concatenate([first, self.project(pressures + self.pressures(moved + self._spread(first), none))])
        operator = LinearOperator((len(right), len(right)), matvec=preconditioned, dtype=np.float64)  # type: ignore[call-arg]
        both, failed = gmres(operator, right, rtol=KRYLOV_TOLERANCE, atol=0.0, restart=KRYLOV_LIMIT, maxiter=1)
        if failed:
            raise SolveError(f"the linearised equations of a press did not converge in {KRYLOV_LIMIT} iterations")
        return moved + self._spread(both[:count]), both[count:]


def by_unknown(values: Array, equation: NDArray[np.int32], unknowns: int) -> Array:
    """What nodes have (N, 3 or 4) as a vector of unknowns."""
    numbers, found = equation[:, : values.shape[1]], np.zeros(unknowns)
    found[numbers[numbers >= 0]] = values[numbers >= 0]
    return found


def object_part(problem: PressProblem) -> Array:
    """E ∂/∂E of the elements' equations (N, 4), of the object's modulus: the isochoric forces, and +p/κ of the volumes."""
    solids = problem.solids
    displacement, pressure = solids.state()
    with_pressure = solids.internal_force()[1]
    solids.set_state((displacement, np.zeros_like(pressure)))
    force, without, _ = solids.internal_force()
    solids.set_state((displacement, pressure))
    both = np.column_stack([force, without - with_pressure])
    both[: problem.object_nodes[0]] = 0.0
    return both


def coat_part(coat: Coat, displacement: wp.array) -> Array:
    """S ∂/∂S of the equations (N, 3), of the coat's stiffness."""
    force = wp.zeros_like(displacement)
    coat.add_force(displacement, force)
    return np.asarray(force.numpy(), np.float64)


def gradients(problem: PressProblem, moduli_kpa: Sequence[float], force: float) -> tuple[Array, Array]:
    """Derivatives by PARAMETERS of the force (3,) and of the nodes' heights (N, 3) [m], at a converged state of some force [N]."""
    linearised = Linearised(problem)
    equation, size = linearised.equation, linearised.size
    motion = np.zeros(size)  # a millimetre of approach
    motion[equation[problem.driven, 2]] = -1.0

    def by(moved: Array, own_force: Array, own_pressures: Array) -> tuple[float, Array]:
        own_force = own_force + linearised.loads(own_pressures)
        w, multipliers = linearised.answer(moved, own_force, own_pressures)
        reaction = motion @ (linearised.forces(w, multipliers) + own_force)
        heights = np.where(equation[:, 2] >= 0, w[equation[:, 2]], 0.0)
        return problem.copies * MILLINEWTON * reaction, heights / MM_PER_M

    still, unpressed = np.zeros(size), np.zeros(len(linearised.active))
    of_depth = by(motion, still, unpressed)
    of_object, of_gel = (0.0, np.zeros(len(equation))), (force, np.zeros(len(equation)))
    if (coat := problem.solids.coat) is not None:
        change, shape = by(still, by_unknown(coat_part(coat, problem.solids.displacement), equation, size), unpressed)
        of_gel = of_gel[0] - change, of_gel[1] - shape
    if len(moduli_kpa) > 1:
        softer = min(moduli_kpa[1:]) < moduli_kpa[0]
        change, shape = by(still, by_unknown(object_part(problem), equation, size), linearised.by_penalty if softer else unpressed)
        of_object = change / moduli_kpa[1], shape / moduli_kpa[1]
        of_gel = of_gel[0] - change, of_gel[1] - shape
    of_gel = of_gel[0] / moduli_kpa[0], of_gel[1] / moduli_kpa[0]
    return np.array([of_gel[0], of_object[0], of_depth[0]]), np.column_stack([of_gel[1], of_object[1], of_depth[1]])


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
        contact.augment(left=np.inf)
        if np.abs(contact.multipliers[:, 0] - before).max() <= STANDSTILL * max(before.max(), 1e-12):
            problem.newton.solve(1.0, TOLERANCE)
            return
    raise SolveError(f"the contact pressures still moved after {AUGMENTATIONS} augmentations; the press cannot be differentiated there")


def press_sensitivity(
    problem: PressProblem, moduli_kpa: Sequence[float], heights: Sequence[tuple[NDArray[np.integer], Array]]
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
        by_force, by_height = gradients(problem, moduli_kpa, force[-1])
        force_gradient.append(by_force)
        height_gradient.append(np.array([shares @ by_height[nodes] for nodes, shares in heights]).reshape(len(heights), len(PARAMETERS)))

    with float64_factors():
        approach = run_press(problem, progress=differentiate).approach
    return PressSensitivity(PARAMETERS, approach, np.array(force), np.array(force_gradient), np.array(height), np.array(height_gradient))
