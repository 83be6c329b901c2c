"""Newton's method on the mixed equations of `Solids` with contact: residual, matrix, step, and why it stopped.

One iteration finds the contact of the current positions, assembles and steps; factors of earlier matrices serve until they no longer pay
(linear.py). Contact that opens and closes makes full steps cycle: a line search on the work of the unbalanced forces along the step cuts
them where they overshoot. Where that is not enough, steps are exact, may not make the residual grow, and lead to a minimum of the energy,
not to a saddle: where a body folds, slips off an edge, or sticks and slips at one, that is the way down (`SymmetricSystem`), by no more at
once than contact's normal holds for. On it the residual grows before it shrinks, and steps are too short as the matrix is too stiff: they
are lengthened for as long as they lead down, and what the residual was before does not count (rims of rigid bodies:
docs/decisions/0008-ways-of-trying.md). Converged means: forces balance to `tolerance` of the contact force, the volume equations hold to
`tolerance`, both in the largest entry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.errors import SolveStatus
from gelsim.fem.assembly import Solids
from gelsim.fem.contact import SurfaceContact
from gelsim.fem.linear import SymmetricSystem
from gelsim.fem.pattern import SymmetricPattern, build_pattern, pair_keys

# A step with the last matrix saves its assembly. It is taken below this residual while the steps shrink it by so much.
CHORD_BELOW = 0.05
CHORD_DROP = 0.3
MAX_LINE_SEARCH = 8
LINE_SEARCH_DROP = 0.8  # the slope along the step must shrink to this share
SMALLEST_JACOBIAN = 0.05
# Exact steps of which one at least must bring the residual below this share of the least before them: else a shorter load step costs less.
STALLED_AFTER, STALLED = 6, 0.5
LARGEST_GROWTH = 3.0  # of the residual by an exact step: a nearly singular matrix leads out of sight
GEOMETRIC_BELOW = 0.5  # imbalance under which contact pressures are near enough to trust their geometric stiffness
Array = NDArray[np.float64]


@dataclass(frozen=True)
class NewtonOptions:
    tolerance: float = 1e-4
    max_iterations: int = 30
    """Not counted are up to `max_downhill` that lead down from a saddle; with 0 these are steps like others."""
    max_downhill: int = 70
    exact_after: int = 8
    """Iterations with rough steps (`SymmetricSystem.step`); where that was not enough, steps are exact."""
    patient: bool = True
    """Whether a solve goes on to the last iteration where exact steps lead nowhere (`stalls`): where there is no other try after this."""
    folds: bool = False
    """Whether tets may be crushed and fold: soft bodies."""

    @property
    def brief(self) -> NewtonOptions:
        """Where a shorter step, or another try, is to be had: it costs less than the way down from the saddle of what folds."""
        return replace(self, patient=False, max_downhill=0) if self.folds else self


def spent(iterations: int, downhill: int, options: NewtonOptions) -> bool:
    """Whether a solve has had all its iterations, of which some led down from a saddle."""
    return iterations - min(downhill, options.max_downhill) >= options.max_iterations


def stalls(sizes: Sequence[float], options: NewtonOptions) -> bool:
    """Whether exact steps lead nowhere, by the residuals of a solve so far, and that is to end it."""
    if options.patient or len(sizes) <= options.exact_after + STALLED_AFTER:
        return False
    return min(sizes[-STALLED_AFTER:]) > STALLED * min(sizes[:-STALLED_AFTER])


def forgotten(sizes: Sequence[float], options: NewtonOptions) -> list[float]:
    """The residuals of a solve so far, after a step down from a saddle, on the way from which they grow before they shrink."""
    return [np.inf] * len(sizes) if options.max_downhill > 0 else list(sizes)


@dataclass
class Residual:
    """The equations at one state, in solver units."""

    equations: Array
    """One number an unknown."""
    imbalance: float
    """Largest nodal force out of balance over the largest nodal contact force."""
    volume_error: float
    """Largest error of a vertex's volume equation, as a strain."""
    min_jacobian: float

    @property
    def size(self) -> float:
        return max(self.imbalance, self.volume_error)

    @property
    def possible(self) -> bool:
        return bool(self.min_jacobian > SMALLEST_JACOBIAN and np.isfinite(self.equations).all())


@dataclass
class NewtonReport:
    status: SolveStatus
    iterations: int
    residual: float
    min_jacobian: float
    factorisations: int = 0
    snapped: bool = False
    """Whether it went down from a saddle, to an equilibrium that does not continue those before."""


class Newton:
    """Holds the matrix pattern and the factorisation between solves."""

    def __init__(self, solids: Solids, contact: SurfaceContact, options: NewtonOptions) -> None:
        self.solids, self.contact, self.options = solids, contact, options
        self.pattern: SymmetricPattern | None = None
        self._equation = wp.array(solids.equation, dtype=wp.int32, device=solids.device)
        self._values: wp.array  # of the pattern: fresh memory costs more than its clearing
        self._of_solids: wp.array
        self.displacement_unknown = np.zeros(solids.unknowns)
        self.displacement_unknown[solids.equation[:, :3][solids.free[:, :3]]] = 1.0
        self.system = SymmetricSystem(self.displacement_unknown > 0.0)

    def residual(self, reach: float) -> Residual:
        """Equations at the solids' present displacement and pressure."""
        solids = self.solids
        x = solids.positions()
        self.contact.update(x, reach)
        contact_force = wp.zeros(solids.node_count, dtype=wp.vec3d, device=solids.device)
        self.contact.add_force(x, contact_force)
        internal, volume, min_jacobian = solids.internal_force()
        external = contact_force.numpy()
        unbalanced = np.where(solids.free[:, :3], internal + external, 0.0)
        external = np.where(solids.free[:, :3], external, 0.0)  # few nodes carry all of what a rigid object bears
        volume = np.where(solids.free[:, 3], volume, 0.0)
        # before contact any force is compared with the internal ones
        scale = max(np.abs(external).max(), np.abs(internal).max() * 1e-3, 1e-9)
        equations = np.zeros(solids.unknowns)
        equations[solids.equation[solids.free]] = np.concatenate([unbalanced, volume[:, None]], axis=1)[solids.free]
        self.x = x
        return Residual(
            equations, float(np.abs(unbalanced).max() / scale), float(np.abs(volume / solids.vertex_volume).max()), min_jacobian
        )

    def tangent(self, geometric: bool, kept: bool = False) -> Array:
        """The tangent's values at the last `residual`, good until the next; extends the pattern where contact has moved beyond it.

        `kept`: with the solids' part as it was assembled last.
        """
        solids = self.solids
        for _ in range(2):
            if self.pattern is not None:
                if not kept:
                    self._of_solids.zero_()
                    solids.add_tangent(self.pattern.pairs, self._of_solids)
                wp.copy(self._values, self._of_solids)
                if self.contact.add_tangent(self.x, self.pattern.pairs, self._values, geometric):
                    return self._values.numpy()  # type: ignore[return-value]
            slave, master = self.contact.node_pairs(margin=0.4)
            keys = np.union1d(solids.keys, pair_keys(slave, master, solids.node_count))
            self.pattern, kept = build_pattern(solids.free, keys, solids.device), False
            self._values, self._of_solids = (wp.zeros(len(self.pattern.indices), dtype=wp.float64, device=solids.device) for _ in range(2))
            self.system.analyse(self.pattern.indptr, self.pattern.indices)
        raise AssertionError("the pattern made from the present contact does not hold it")

    def _line_search(
        self, step: Array, residual: Residual, reach: float, exact: bool, whole: bool, downhill: bool = False
    ) -> tuple[Residual | None, float]:
        """Moves the solids along `step` to where the work of the unbalanced forces on it has shrunk: the end, or a root by regula falsi.

        The slope is that of the Lagrangian in the displacements alone, R_u·d_u: where it does not begin negative (the volume equations are
        far from met) the full step is taken. Steps that turn an element inside out are halved first; None where that does not end. So are
        `exact` ones that make the residual grow, but not those `downhill` from a saddle, which are doubled instead while they lead further
        down and turn nothing inside out. Each trial begins with the pairs that the start has: what a longer one lost is no loss.
        """
        start, pairing = self.solids.state(), self.contact.pairing()
        bounded, lengthens = exact and not downhill, downhill
        moving = step * self.displacement_unknown
        slope = float(residual.equations @ moving)
        low, low_slope, high, high_slope = 0.0, slope, None, 0.0
        fraction = 1.0
        for _ in range(MAX_LINE_SEARCH):
            self.solids.move(start, step, fraction)
            self.contact.set_pairing(pairing)
            trial = self.residual(reach)
            if whole and not trial.possible:
                break
            if not trial.possible or (bounded and trial.size > LARGEST_GROWTH * residual.size):
                high, high_slope, fraction, lengthens = None, 0.0, low + 0.5 * (fraction - low), False
                continue
            now = float(trial.equations @ moving)
            if slope >= 0 or abs(now) <= LINE_SEARCH_DROP * abs(slope) or (now < 0 and fraction == 1.0 and not lengthens):
                return trial, fraction
            if now < 0:
                low, low_slope = fraction, now
                high_slope *= 0.5  # Illinois: an end that stays loses weight
            else:
                high, high_slope = fraction, now
                low_slope *= 0.5 if low > 0 else 1.0
            if high is None and lengthens:
                fraction *= 2.0
                continue
            if high is None:
                return trial, fraction
            fraction = low + (high - low) * min(max(low_slope / (low_slope - high_slope), 0.05), 0.95)
        if not trial.possible:
            self.solids.set_state(start)
            self.contact.set_pairing(pairing)
            return None, 0.0
        return trial, fraction

    def solve(
        self, reach: float, tolerance: float | None = None, solve: bool = True, whole: bool = False, brief: bool = False
    ) -> NewtonReport:
        """Iterates from the solids' present state, in place, to `tolerance` (default: the options').

        `reach` [mm] bounds the search for contact. Without `solve` only forces of the present state are found, and pairs of the points that
        have none. `whole`: it ends where its first step, taken whole, would turn an element inside out. `brief`: by the options' `brief`.
        """
        before, options = self.system.factorisations, self.options.brief if brief else self.options
        if tolerance is not None:
            options = replace(options, tolerance=tolerance)
        status, iterations, residual, snapped = self._iterate(reach, options, solve, whole)
        size = residual.size
        return NewtonReport(status, iterations, size, residual.min_jacobian, self.system.factorisations - before, snapped)

    def _iterate(self, reach: float, options: NewtonOptions, solve: bool, whole: bool) -> tuple[SolveStatus, int, Residual, bool]:
        """Newton's iterations; why they ended, how many there were, where, and whether some led down from a saddle."""
        solids, contact = self.solids, self.contact
        residual = self.residual(reach)
        before, iteration, down = np.inf, 0, 0
        sizes: list[float] = []
        while True:
            size = residual.size
            sizes.append(size)
            if not np.isfinite(residual.equations).all():
                return SolveStatus.NONFINITE, iteration, residual, down > 0
            if iteration > 0 and size <= options.tolerance:
                return SolveStatus.CONVERGED, iteration, residual, down > 0
            if not solve or spent(iteration, down, options) or stalls(sizes, options):
                return SolveStatus.MAX_ITERATIONS, iteration, residual, down > 0
            near = residual.imbalance < GEOMETRIC_BELOW
            chord = self.system.factored and size < CHORD_BELOW and size < CHORD_DROP * before
            if not chord or not self.system.fresh:
                self.system.update(self.tangent(near, chord))
            before = size
            coupling = contact.remainder(self.x, self._equation, solids.unknowns) if near else None
            exact = iteration >= options.exact_after
            step = self.system.step(-residual.equations, coupling, exact, contact.turns_within if near else np.inf)
            if not np.isfinite(step).all():
                return SolveStatus.NONFINITE, iteration, residual, down > 0
            downhill = self.system.downhill and near
            if downhill:
                down += 1
                sizes = forgotten(sizes, options)
            trial, _ = self._line_search(step, residual, reach, exact, whole and iteration == 0, downhill)
            if trial is None:
                return SolveStatus.INVERTED_ELEMENT, iteration + 1, residual, down > 0
            residual, iteration = trial, iteration + 1
