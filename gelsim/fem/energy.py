"""Where the work of a press goes: the platen's work against energy stored, lost in friction, and held by the overlap.

    W = ∫ R·du  over the driven nodes (platen, or the whole surface of a rigid object), R internal and contact forces on them
    E = Π(u, p) of both solids (assembly.py), at the present state; of solids that remember (viscoelastic.py) the work done on them, stored
        and lost: ∫ f·du of their forces by the trapezoidal rule
    D = Σ ½(t₀ + t)·e  over friction's points: e the slip of a load step, t₀ and t the traction before and after it
    C = Σ ½(p₀ + p) Δ(overlap)  over contact's points: what the penalty and its multiplier take up, an error of the method
    X = what E grows by where a press goes on by another way (quasistatic.py): the same bodies at the same approach, in stiffer tets say

so drift = (W - (E - X) - D - C)/W is zero but for the size of the load steps and Newton's tolerance. R·du/ds over the approach s is
integrated by monotone cubics through the load steps (for a power law of 1.2 to 2.5 and five steps within 0.1 %), by a power law through a
lone one, on either side of where a press goes on. With "stick", D is what friction's own penalty gives way.

A point that touches for the first time counts its slip since the step began, as the contact law does: long load steps make D too large.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.fem.problem import PressProblem

Array = NDArray[np.float64]
JOULE = 1e-6  # per solver unit of energy, mN·mm
_SEEN = 1e-12
"""Work [solver units] below which there is no share of it to speak of."""


class EnergyBalance:
    """Follows a press, load step after load step."""

    def __init__(self, problem: PressProblem) -> None:
        self.problem = problem
        self._approach = [0.0]
        self._power: list[tuple[float, float]] = []
        """R·Δu/Δs of each step with R at its beginning and at its end."""
        self._gone_on: list[int] = []
        """Steps before which the press went on by another way, and R jumped."""
        self.jump = 0.0, 0.0
        """The largest share of a step's work that went nowhere, and the approach [m] that the step ended at; but for the first two, whose
        work is not known so well."""
        self._stored = self._changed = self._lost = self._overlap_work = 0.0
        self._internal = self._u = np.zeros_like(problem.solids.rest)
        nodes, points = len(problem.driven), len(problem.contact.rest_weight)
        self._moved, self._reaction = np.zeros((nodes, 3)), np.zeros((nodes, 3))
        self._traction, self._pressure, self._overlap = np.zeros((points, 3)), np.zeros(points), np.zeros(points)

    def step(self, approach: float) -> None:
        """Takes in the equilibrium at `approach` [m], before the contact settles."""
        problem, contact, before = self.problem, self.problem.contact, self._held
        internal, reaction = self._forces()
        if problem.memory is None:
            self._stored = problem.solids.energy()
        else:
            u = problem.solids.displacement.numpy().copy()
            self._stored += float((0.5 * (internal + self._internal) * (u - self._u)).sum())
            self._internal, self._u = internal, u
        moved = problem.solids.displacement.numpy()[problem.driven]
        travel, spacing = moved - self._moved, approach - self._approach[-1]
        begin, end = float((self._reaction * travel).sum()) / spacing, float((reaction * travel).sum()) / spacing
        self._power.append((begin, end))
        self._approach.append(approach)
        self._moved, self._reaction = moved, reaction

        pressure, overlap = self._overlapping()
        self._overlap_work += float((contact.rest_weight * 0.5 * (pressure + self._pressure) * (overlap - self._overlap)).sum())
        self._pressure, self._overlap = pressure, overlap
        if contact.frictional:
            traction, slip = contact.traction.numpy().copy(), contact.slip(problem.solids.positions())
            self._lost -= float((contact.rest_weight[:, None] * 0.5 * (traction + self._traction) * slip).sum())
            self._traction = traction
        work = _power_law_work(approach - spacing, approach, begin, end)
        if len(self._power) > 2 and work > _SEEN:
            self.jump = max(self.jump, (1.0 - (self._held - before) / work, approach))

    @property
    def _held(self) -> float:
        """What became of the work so far."""
        return self._stored - self._changed + self._lost + self._overlap_work

    def go_on(self, problem: PressProblem) -> None:
        """Follows the same press solved another way, from its present state, whose contact has settled."""
        self.problem = problem
        self._gone_on.append(len(self._power))
        self._internal, self._reaction = self._forces()
        if problem.memory is None:
            stored = problem.solids.energy()
            self._changed, self._stored = self._changed + stored - self._stored, stored
        self._pressure, self._overlap = self._overlapping()
        self._traction = problem.contact.traction.numpy().copy()

    def _forces(self) -> tuple[Array, Array]:
        """Internal forces of the present state on all nodes; with contact's, on the driven ones [mN]."""
        problem = self.problem
        external = wp.zeros(problem.solids.node_count, dtype=wp.vec3d, device=problem.solids.device)
        problem.contact.add_force(problem.solids.positions(), external)
        internal, _, _ = problem.solids.internal_force()
        return internal.copy(), (internal + external.numpy())[problem.driven]

    def _overlapping(self) -> tuple[Array, Array]:
        """Pressure of contact's points [kPa], and the overlap of those under it [mm]."""
        contact = self.problem.contact
        pressure = np.array(contact.pressure.numpy(), np.float64)
        overlap = np.maximum(-np.asarray(contact.gap.numpy(), np.float64), 0.0)
        overlap[pressure <= 0.0] = 0.0
        return pressure, overlap

    def report(self) -> dict[str, float]:
        """Energies of the whole body [J] and the relative drift."""
        from scipy.interpolate import PchipInterpolator

        if not self._power:
            return {"work_j": 0.0, "stored_j": 0.0, "dissipated_j": 0.0, "overlap_j": 0.0, "changed_j": 0.0, "drift": 0.0}
        work, approach = 0.0, np.array(self._approach)
        for first, last in pairwise(sorted({0, *self._gone_on, len(self._power)})):
            if last == first + 1:
                work += _power_law_work(approach[first], approach[last], *self._power[first])
                continue
            begin, end = np.array(self._power[first:last]).T
            # between two steps the mean of what both say: the same where the platen moves straight
            power = np.array([begin[0], *(0.5 * (end[:-1] + begin[1:])), end[-1]])
            work += float(PchipInterpolator(approach[first : last + 1], power).integrate(approach[first], approach[last]))
        parts = (work, self._stored, self._lost, self._overlap_work, self._changed)
        drift = (work - self._held) / work if abs(work) > _SEEN else 0.0
        scale = self.problem.copies * JOULE
        names = ("work_j", "stored_j", "dissipated_j", "overlap_j", "changed_j")
        return {name: part * scale for name, part in zip(names, parts, strict=True)} | {"drift": drift}


def _power_law_work(start: float, stop: float, begin: float, end: float) -> float:
    """∫ a sⁿ ds through two values: of presses, but for their first steps, within 1 %. Where none goes through them by the trapezoid."""
    if min(start, begin, end) > 0.0 and (order := np.log(end / begin) / np.log(stop / start)) > -0.9:
        return float((stop * end - start * begin) / (order + 1.0))
    return 0.5 * (begin + end) * (stop - start)
