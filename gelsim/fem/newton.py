"""Newton's method on the mixed equations of `Solids` with contact: residual, matrix, step, and why it stopped.

One iteration finds the contact of the current positions, assembles, factorises and steps. A step is halved while it turns an element inside out or
makes the residual explode; contact that switches makes the residual jump legitimately, so a plain growth is allowed. Converged means: forces balance
to `tolerance` of the contact force, the volume equations hold to `tolerance`, both in the largest entry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.errors import SolveStatus
from gelsim.fem.assembly import Solids, SymmetricPattern, build_pattern, pair_keys
from gelsim.fem.contact import SurfaceContact
from gelsim.fem.linear import make_solver

GEOMETRIC_BELOW = 0.5  # imbalance under which contact pressures are near enough to trust their geometric stiffness
Array = NDArray[np.float64]


@dataclass(frozen=True)
class NewtonOptions:
    tolerance: float = 1e-5
    max_iterations: int = 20
    growth: float = 1e3
    """A residual that grows by more in one step is not accepted."""


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


@dataclass
class NewtonReport:
    status: SolveStatus
    iterations: int
    residual: float
    min_jacobian: float


class Newton:
    """Holds the matrix pattern and the factorisation between solves."""

    def __init__(self, solids: Solids, contact: SurfaceContact, options: NewtonOptions) -> None:
        self.solids, self.contact, self.options = solids, contact, options
        self.solver = make_solver()
        self.pattern: SymmetricPattern | None = None
        self.factorisations = 0

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
        volume = np.where(solids.free[:, 3], volume, 0.0)
        # the load may be carried by prescribed nodes only (before contact): then any force is compared with the internal ones
        scale = max(np.abs(external).max(), np.abs(internal).max() * 1e-3, 1e-9)
        equations = np.zeros(solids.unknowns)
        equations[solids.equation[solids.free]] = np.concatenate([unbalanced, volume[:, None]], axis=1)[solids.free]
        self.x = x
        return Residual(
            equations, float(np.abs(unbalanced).max() / scale), float(np.abs(volume / solids.vertex_volume).max()), min_jacobian
        )

    def _matrix(self, geometric: bool) -> Array:
        """The tangent's values; extends the pattern where contact has moved beyond it."""
        solids = self.solids
        for _ in range(2):
            if self.pattern is not None:
                values = wp.zeros(len(self.pattern.indices), dtype=wp.float64, device=solids.device)
                if self.contact.add_tangent(self.x, self.pattern.pairs, values, geometric):
                    solids.add_tangent(self.pattern.pairs, values)
                    return values.numpy()
            gel, body = self.contact.node_pairs(margin=0.2)
            keys = np.union1d(solids.keys, pair_keys(gel, body, solids.node_count))
            self.pattern = build_pattern(solids.free, keys, solids.device)
            self.solver.analyse(self.pattern.indptr, self.pattern.indices, np.zeros(len(self.pattern.indices)))
        raise AssertionError("the pattern made from the present contact does not hold it")

    def solve(self, reach: float) -> NewtonReport:
        """Iterates from the solids' present state, in place. `reach` [mm] bounds the search for contact."""
        options, solids = self.options, self.solids
        residual = self.residual(reach)
        for iteration in range(options.max_iterations + 1):
            size = max(residual.imbalance, residual.volume_error)
            if not np.isfinite(residual.equations).all():
                return NewtonReport(SolveStatus.NONFINITE, iteration, size, residual.min_jacobian)
            if iteration > 0 and size <= options.tolerance:
                return NewtonReport(SolveStatus.CONVERGED, iteration, size, residual.min_jacobian)
            if iteration == options.max_iterations:
                break
            values = self._matrix(residual.imbalance < GEOMETRIC_BELOW)
            self.solver.factorise(values)
            self.factorisations += 1
            step = self.solver.solve(-residual.equations)
            if not np.isfinite(step).all():
                return NewtonReport(SolveStatus.NONFINITE, iteration, size, residual.min_jacobian)
            start = solids.state()
            norm = np.linalg.norm(residual.equations)
            fraction = 1.0
            while True:
                solids.move(start, step, fraction)
                trial = self.residual(reach)
                inverted = trial.min_jacobian <= 0.05
                if not inverted and np.linalg.norm(trial.equations) <= options.growth * norm:
                    break
                fraction *= 0.5
                if fraction < 1 / 64:
                    solids.set_state(start)
                    status = SolveStatus.INVERTED_ELEMENT if inverted else SolveStatus.LINE_SEARCH_STALLED
                    return NewtonReport(status, iteration + 1, size, residual.min_jacobian)
            residual = trial
        return NewtonReport(SolveStatus.MAX_ITERATIONS, options.max_iterations, size, residual.min_jacobian)
