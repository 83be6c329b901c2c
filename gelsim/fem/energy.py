"""Where the work of a press goes: the platen's work against energy stored, lost in friction, and held by the overlap.

    W = ∫ R·du  over the driven nodes (platen, or the whole surface of a rigid object), R internal and contact forces on them
    E = Π(u, p) of both solids (assembly.py), at the present state; of solids that remember (viscoelastic.py) the work done on them, stored
        and lost: ∫ f·du of their forces by the trapezoidal rule
    D = Σ ½(t₀ + t)·e  over friction's points: e the slip of a load step, t the traction after it, t₀ that before it; of a point that slides
        t₀ is μ times the pressure before it, along t: it slid only once its traction had turned that way
    C = Σ ½(p₀ + p) Δ(overlap)  over contact's points: what the penalty and its multiplier take up, an error of the method
    X = what E grows by where a press goes on by another way (quasistatic.py): the same bodies at the same approach, in stiffer tets say

so drift = (W - (E - X) - D - C)/W is zero but for the size of the load steps and Newton's tolerance. W in the denominator is all work that
was ever done, not less what a release gave back. R·du/dt over time is integrated by monotone cubics through the load steps of each leg of
the motion (for a power law of 1.2 to 2.5 and five steps within 0.1 %), by a power law through a lone one, and on either side of where a
press goes on. With "stick", D is what friction's own penalty gives way.

A point that touches for the first time counts its slip since the step began, as the contact law does: long load steps make D too large.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.fem.problem import PressProblem
from gelsim.results import EnergyReport

Array = NDArray[np.float64]
JOULE = 1e-6  # per solver unit of energy, mN·mm
_SEEN = 1e-12
"""Work [solver units] below which there is no share of it to speak of."""
_SHORT = 0.1
"""Of the step before it: a last one that is shorter, to a force, would bend the cubic over that (a plate's drift: 28 %, not 4)."""


class EnergyBalance:
    """Follows a press, load step after load step."""

    def __init__(self, problem: PressProblem) -> None:
        self.problem = problem
        self._time = [0.0]
        self._power: list[tuple[float, float]] = []
        """R·Δu/Δt of each step with R at its beginning and at its end."""
        self._legs: list[int] = []
        """Steps before which the object began to move in another way, or the press went on by another one."""
        self.jump = 0.0, 0.0
        """What went nowhere in a step, as a share of the most work of a step so far, where that is largest, and the approach [m] that the
        step ended at; but for the first two that did work, whose work is not known so well."""
        self._works, self._most = 0, 0.0
        self._stored = self._changed = self._lost = self._overlap_work = 0.0
        self._internal = self._u = np.zeros_like(problem.solids.rest)
        nodes, points = len(problem.driven), len(problem.contact.rest_weight)
        self._moved, self._reaction = np.zeros((nodes, 3)), np.zeros((nodes, 3))
        self._traction, self._pressure, self._overlap = np.zeros((points, 3)), np.zeros(points), np.zeros(points)

    def begin_leg(self) -> None:
        """From here on the object moves in another way."""
        self._legs.append(len(self._power))
        self._moved = self.problem.solids.displacement.numpy()[self.problem.driven]

    def step(self, time: float, approach: float, *, apart: bool = False) -> None:
        """Takes in the equilibrium at a time [s] and an approach [m], before the contact settles. `apart`: the object went there faster or
        slower than before."""
        if apart:
            self._legs.append(len(self._power))
        problem, contact, before = self.problem, self.problem.contact, self._held
        internal, reaction = self._forces()
        if problem.memory is None:
            self._stored = problem.solids.energy()
        else:
            u = problem.solids.displacement.numpy().copy()
            self._stored += float((0.5 * (internal + self._internal) * (u - self._u)).sum())
            self._internal, self._u = internal, u
        moved = problem.solids.displacement.numpy()[problem.driven]
        travel, spacing = moved - self._moved, time - self._time[-1]
        begin, end = float((self._reaction * travel).sum()) / spacing, float((reaction * travel).sum()) / spacing
        self._power.append((begin, end))
        self._time.append(time)
        self._moved, self._reaction = moved, reaction

        pressure, overlap = self._overlapping()
        self._overlap_work += float((contact.rest_weight * 0.5 * (pressure + self._pressure) * (overlap - self._overlap)).sum())
        if contact.frictional:
            traction, slip = contact.traction.numpy().copy(), contact.slip(problem.solids.positions())
            earlier, size = self._traction.copy(), np.linalg.norm(traction, axis=1)
            slides = contact.law.slides(size, pressure)
            earlier[slides] = traction[slides] * (contact.law.borne(self._pressure[slides]) / size[slides])[:, None]
            self._lost -= float((contact.rest_weight[:, None] * 0.5 * (traction + earlier) * slip).sum())
            self._traction = traction
        self._pressure, self._overlap = pressure, overlap
        work = _power_law_work(time - spacing, time, begin, end)
        if work > _SEEN:
            self._works += 1
            self._most = max(self._most, work)
            if self._works > 2:
                self.jump = max(self.jump, ((work - (self._held - before)) / self._most, approach))

    @property
    def _held(self) -> float:
        """What became of the work so far."""
        return self._stored - self._changed + self._lost + self._overlap_work

    def go_on(self, problem: PressProblem) -> None:
        """Follows the same press solved another way, from its present state, whose contact has settled."""
        self.problem = problem
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

    def report(self) -> EnergyReport:
        """Energies of the whole body [J] and the relative drift."""
        from scipy.interpolate import PchipInterpolator

        if not self._power:
            return EnergyReport()
        time, (begin, end) = np.array(self._time), np.array(self._power).T
        work = done = 0.0
        for first, last in pairwise([*sorted({first for first in self._legs if first < len(begin)}), len(begin)]):
            if last > first + 1 and time[last] - time[last - 1] < _SHORT * (time[last - 1] - time[last - 2]):
                last -= 1
                leg = _power_law_work(time[last], time[last + 1], begin[last], end[last])
                work, done = work + leg, done + max(leg, 0.0)
            if last == first + 1:
                leg = _power_law_work(time[first], time[last], *self._power[first])
                work, done = work + leg, done + max(leg, 0.0)
                continue
            # between two steps the mean of what both say: the same where the platen moves straight
            between = 0.5 * (end[first : last - 1] + begin[first + 1 : last])
            power = PchipInterpolator(time[first : last + 1], [begin[first], *between, end[last - 1]])
            leg = float(power.integrate(time[first], time[last]))
            work, done = work + leg, done + max(leg, 0.0)
        drift = (work - self._held) / done if done > _SEEN else 0.0
        scale = self.problem.copies * JOULE
        names = ("work_j", "stored_j", "dissipated_j", "overlap_j", "changed_j")
        parts = (work, self._stored, self._lost, self._overlap_work, self._changed)
        return EnergyReport(drift=drift, **{name: part * scale for name, part in zip(names, parts, strict=True)})


def _power_law_work(start: float, stop: float, begin: float, end: float) -> float:
    """∫ a sⁿ ds through two values: of presses, but for their first steps, within 1 %. Where none goes through them by the trapezoid."""
    if min(start, begin, end) > 0.0 and (order := np.log(end / begin) / np.log(stop / start)) > -0.9:
        return float((stop * end - start * begin) / (order + 1.0))
    return float(0.5 * (begin + end) * (stop - start))
