"""The press as a sequence of equilibria: the object's base follows its motion in time (scene/motion.py), leg by leg, step by step.

Each step starts from the linear extrapolation of the last two states of its leg, which leaves Newton only the curvature of the path; then
the contact multipliers take the pressure over (contact.py) and Newton answers once more; where they do so again, for less overlap, and
Newton has no answer, the one before stands. What sticks and has none is tied first (contact.py). A step that does not converge, or that
begins by turning an element inside out, is halved, from where it began (in a press's later tries after it was tried from the last state
alone, its object moved along); after two easy steps it doubles again, to LONGEST_STEP at most. A leg that ends at a force has at each
step's end the approach at which the normal force is its share of it, found by the secant rule.

Of the short form, recorded states are equally spaced in approach. `force_n` ends it where the normal force reaches it, looked for on the
power law through the two states around or before it; without `depth_mm` a search finds how far that is, and each recorded state is one step
from its way, begun between two states of it; with shear or twist, whose share of the way is not known before, a second march records.
Before, it ends where the object bears less and less, or has failed for some time and is far from bearing it: beyond a largest force lies
another branch for every try. What ended a press its report says (`errors.PressEnd`).

A march that finds no equilibrium further on may be gone on with by another: the same bodies with other contact points, or with volume held
(strategy.py). That takes over the last equilibrium, finds it once more as its own discretisation has it, and goes on; what was recorded
stays. Solids that remember begin at rest instead.

The march is a generator that asks for equilibria: who drives it solves them, one press at a time (`run_press`) or many at once (batch.py).

Solids that remember (viscoelastic.py) are told how long each step takes; where nothing moves they relax in steps that grow.

Left out: inertia, gravity (0.1 kPa per 10 mm of silicone).
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import PressEnd, SceneError, SolveError, SolveStatus
from gelsim.fem.contact import LOOKED_MM, ContactState
from gelsim.fem.energy import EnergyBalance
from gelsim.fem.linear import single_threaded_blas
from gelsim.fem.newton import NewtonReport
from gelsim.fem.problem import PressProblem
from gelsim.fem.recording import Recorder
from gelsim.results import Deformation
from gelsim.scene.motion import Motion, motion, straight
from gelsim.shape.orientation import turned
from gelsim.shape.shapes import furthest_approach
from gelsim.units import MM_PER_M

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
Record = Callable[[PressProblem], Recorder]

MAX_AUGMENTATIONS = 6  # a step; one is usual, as the multipliers start from the last two steps' extrapolation
ROUGH_TOLERANCE = 0.1  # of the first solve of a step, before the multipliers move, which puts it as far out of balance again
OVERLAP_MM = 15e-3  # overlap at points above which another augmentation is tried; the steps that follow lessen it too …
SOFT_OVERLAP_MM = 8e-3  # … of soft objects, whose points are close: of rigid ones at `fast` more lies between them, which this lessens not
CUT_MM = 0.1  # overlap of a step that had failed before, above which it has no answer; sharp rims into `fast` meshes keep up to that
SMALLEST_STEP = 1 / 64  # of the spacing of recorded states
FOLDED = 0.5  # smallest det F of a state over that before it, under which the step that led there is tried again in two …
FOLDED_STEP = 1 / 8  # … unless it is no longer than this share of the spacing: a body that is crushed does get there.
FORCE_TOLERANCE = 2e-3  # of force_n
REACHED = 5e-3  # of force_n: nearer than that it counts as reached where no nearer state is found
GAVE_WAY = 0.9  # of the largest normal force so far: what is pressed to a force alone and bears less has given way …
OUT_OF_REACH = 2.0  # … or, once SOON, where not even so many times the force to which it grows by a power law would be enough
PACE = 100  # Newton iterations by which the pace of a press is judged: about a step that is halved to the smallest
SOON = 30  # Newton iterations of solves that failed, some two of them, after which a press is tried otherwise
JUMPED = 0.03  # share of a step's work that went nowhere, above which it has left its branch of equilibria
FIRST_STEP = 0.25e-3  # [m] a flat block's whole rim touches at once: begun with longer ones it keeps ten times the overlap
LONGEST_STEP = 1e-3  # [m]
FIRST_HOLD_STEP, HOLD_STEP_GROWTH = 0.2, 1.5  # of a hold: first step over the shortest relaxation time, and each over the last
FIRST_LOOK = 0.2  # of FIRST_STEP: how far a leg to a force looks first, where nothing says yet how stiff the contact is
MOST_LOOKS = 12  # for the approach of a force, in one step
MOST_STEPS_NEARER = 4  # to that force, where a search ended: one is usual


@dataclass(frozen=True)
class Request:
    """What a march asks for: the equilibrium from the solids' present state, or with `solve` False forces for its pairs."""

    reach: float
    """[mm] Bounds the search for contact."""
    tolerance: float | None = None
    solve: bool = True
    whole: bool = False
    """Whether the first Newton step must be possible as a whole, or the solve ends."""
    brief: bool = False
    """Whether a shorter step is to be had (`NewtonOptions.brief`)."""


Marching = Generator[Request, NewtonReport, None]


@dataclass
class Course:
    """What a try of a press leaves for those after it."""

    followed: bool = False
    """Whether the next one goes on from it."""
    before: _March | None = None
    """The lost march of the try before, to go on from; None begins at rest."""
    found: tuple[float, PressEnd, str] | None = None
    """Approach [m] at which the press ends, what it ends at there, and why no further: once a try has found it and not recorded the way."""
    searched: bool = False
    """Whether that was found by going on from another search, so that all are to begin again."""
    bore: float = 0.0
    """Largest normal force [N] of the tries so far."""
    lost_at: float = np.inf
    """Approach [m] at which that other was lost: the first that records hands over there, as the next found the rest of the way."""


def run_press(
    problem: PressProblem, *, course: Course | None = None, record: Record = Recorder, progress: Progress | None = None, throw: bool = True
) -> Deformation:
    """Solves a press. `progress(done, total)` is called after each recorded state, and on the search for the approach of a force.

    Args:
        course: Of a press with several tries: what this one goes on from, and what it leaves.
        record: Makes what keeps the problem's states.

    Raises:
        SolveError: (with `throw`) Newton failed at the smallest step; carries what was solved.
    """
    marching = march_press(problem, course or Course(), record, progress)
    with single_threaded_blas():
        try:
            request = next(marching)
            while True:
                request = marching.send(problem.newton.solve(**vars(request)))
        except StopIteration as end:
            deformation: Deformation = end.value
    if throw and deformation.status is not SolveStatus.CONVERGED:
        raise SolveError(deformation.message, deformation)
    return deformation


def march_press(
    problem: PressProblem, course: Course, record: Record = Recorder, progress: Progress | None = None
) -> Generator[Request, NewtonReport, Deformation]:
    """A whole press as a generator of requests; returns what was solved, with the status and what to try where that is not all.

    A search for a force that is lost is all there is where another try goes on from it, or it from another; where such a one was not, the
    states are left to be recorded from rest.
    """
    press = problem.scene.press
    before, march = course.before, None
    way = motion(press)
    if way is not None:
        march = _March(problem, way.from_touch(problem.pivot[2]), record)
        yield from march.run(progress, before)
        found = march.approach, PressEnd.PATH, ""
    else:
        found = course.found if press.depth_mm is None else (press.depth_mm / MM_PER_M, PressEnd.DEPTH, "")
    if found is None:
        search = _Search(problem, record)
        search.bore = course.bore

        def share(*_: int) -> None:
            """The part of the force that is reached, in states; recording then counts them anew."""
            if progress is not None and press.force_n is not None:
                progress(round(float(np.clip(search.normal_force / press.force_n, 0.0, 1.0)) * (press.frames - 1)), press.frames)

        yield from search.run(share, before)
        found, course.bore = search.found(), max(course.bore, search.most[0])
        if found[1] is PressEnd.LOST and (course.followed or before is not None):
            course.before = search if problem.memory is None else None
            course.lost_at = search.approach
            return search.deformation(PressEnd.LOST, "")
        course.before = None
        if before is not None:
            course.found, course.searched = found, True
            return search.deformation(found[1], "")
        plain = not any(press.shear_mm) and not press.twist_deg and not press.hold_s
        if plain and problem.memory is None and (yield from search.record_way(found[0], press.frames, progress)):
            march = search
    depth, end, beyond = found
    if march is None:
        march = _March(problem, straight(press, depth * MM_PER_M), record, press.force_n)
        march.until = course.lost_at if course.followed and before is None else np.inf
        march.meets = press.depth_mm is None and end is PressEnd.FORCE
        yield from march.run(progress, before)
    # where the search got to its force straight down, and this is sheared or twisted, it may bear less
    early = march.gave_way or (PressEnd.GAVE_WAY if end is PressEnd.FORCE else end)
    message, end = "", PressEnd.FORCE if march.stopped else early
    if march.status is not SolveStatus.CONVERGED:
        if end is not PressEnd.LOST and problem.memory is None:  # else the next one has to search itself
            course.found, course.before = found, march
        ways = ["a shorter motion"] if end is PressEnd.PATH else ["more frames", "a smaller depth_mm"]
        if problem.scene.fidelity != "fast":
            ways.append("--fidelity fast to see where it goes")
        end = PressEnd.LOST
        message = (
            f"press stopped {march.message}: {march.status.value}; {len(march.recorder.approach) - 1} of {press.frames - 1} steps were "
            f"solved and kept. Try {' or '.join(filter(None, (', '.join(ways[:-1]), ways[-1])))}"
        )
    deformation = march.deformation(end, message)
    missing, jumped_at = march.energy.jump
    if missing > JUMPED:
        deformation = deformation.warned(
            f"the step to {jumped_at * MM_PER_M:.4g} mm lost {missing:.0%} of its work: it jumped to another branch of equilibria (a "
            "sharp rim that the gel slides over, a body that buckles); with more frames the press may take another, and its force differ"
        )
    if press.depth_mm is None and press.force_n is not None and not march.stopped and march.status is SolveStatus.CONVERGED:
        why = beyond or march.beyond or f" with {march.normal_force:.3g} N"
        if end is PressEnd.GAVE_WAY and not (beyond or march.beyond):
            why = f": {march.most[0]:.3g} N is the most that the object bears before it buckles, folds or slides off"
        deformation = deformation.warned(
            f"press.force_n = {press.force_n:g} N was not reached: the press ended at {march.approach * MM_PER_M:.3g} mm{why}"
        )
    if march.stopped and press.force_n is not None and march.normal_force > (1 + FORCE_TOLERANCE) * press.force_n:
        deformation = deformation.warned(
            f"press.force_n = {press.force_n:g} N was passed: the press ended at {march.normal_force:.3g} N; try more frames"
        )
    return deformation


@dataclass(frozen=True)
class _State:
    """A converged state to go on from."""

    time: float
    """[s]"""
    approach: float
    """[m]"""
    fields: tuple[Array, Array]
    """Displacement and pressure of the solids."""
    contact: ContactState
    seconds: float
    """Of the step that led here from the state that the solids remember; 0 where they remember this one."""
    min_jacobian: float
    """Smallest det F."""


class _March:
    """One press, state after state; with `stop_n` the first leg of its way ends where the normal force reaches that."""

    def __init__(self, problem: PressProblem, way: Motion, record: Record, stop_n: float | None = None) -> None:
        self.problem, self.way, self.record, self.stop_n = problem, way, record, stop_n
        self.recorder, self.energy = record(problem), EnergyBalance(problem)
        self.status, self.message, self.halved = SolveStatus.CONVERGED, "", 0
        self.time, self.approach, self.normal_force, self.stopped = 0.0, 0.0, 0.0, False
        self.here: _State
        """The last equilibrium."""
        self._previous: _State | None = None
        self._leg, self._spacing, self._smallest = 1, np.inf, 1.0
        self._stiffness = self._approach = 0.0
        self._before = 0.0, 0.0
        """Approach [m] and normal force [N] of the equilibrium before the last."""
        self._snapped = False
        self._iterations = self._factorisations = self._wasted = 0
        self._spent = 0
        self.most, self.beyond = (0.0, 0.0), ""
        """Largest normal force [N] so far, and the approach [m] there; what is said of a force that is out of reach."""
        self.gave_way: PressEnd | None = None
        """As what it ended before its force: GAVE_WAY or BEYOND."""
        self.bore = 0.0
        """Largest normal force [N] of the tries before: what bears less is no judge of what is out of reach."""
        self.until = np.inf
        """Approach [m] of the first leg at which it is known to be lost."""
        self.meets = False
        """Whether a search found the force that ends it where the first leg ends."""

    def run(self, progress: Progress | None, before: _March | None = None) -> Marching:
        """Marches to the end of the way, the force, or a step that cannot be made any smaller; records at the times that the way says.

        Begins at rest, or where `before` stands.
        """
        problem = self.problem
        if before is None:
            problem.reset()
            self._lift(float(self.way.approach[0]))
            yield Request(1.0, solve=False)  # first touch
            self._settle()
            self._arrive(self._state(0.0, self.way.approach[0] / MM_PER_M), 0.0)
            self.way = self.way.reached(0, self.way.approach[0], 0.0)
            self._keep(progress)
        elif not (yield from self._go_on(before)):
            return
        for leg in range(self.way.leg_after(self.time), len(self.way.time)):
            if not (yield from self._follow(leg, progress)):
                return
            self.way = self.way.reached(leg, self.approach * MM_PER_M, self.normal_force)

    def _lift(self, approach: float) -> None:
        """Takes the object to where a measured path begins: above the gel by so much [mm], or where it touches."""
        if approach > 0.0:
            raise SceneError(f"press.path_csv begins {approach:.3g} mm below first touch; let it begin there or above")
        if approach < 0.0:
            displacement, pressure = (field.copy() for field in self.problem.solids.state())
            displacement[self.problem.object_nodes, 2] -= approach
            self.problem.solids.set_state((displacement, pressure))

    def _follow(self, leg: int, progress: Progress | None) -> Generator[Request, NewtonReport, bool]:
        """Marches along a leg from where it stands; whether it got to the leg's end."""
        problem, way, here = self.problem, self.way, self.here
        begin, end = way.time[leg - 1], way.time[leg]
        self._leg, self._previous = leg, None
        self.energy.begin_leg()
        inside = way.recorded[(way.recorded > begin * (1 + 1e-12)) & (way.recorded <= end * (1 + 1e-12))]
        spacing = (inside[0] if len(inside) else end) - begin
        speed = self._speed(leg)
        longest, first = (min(spacing, length / speed) if speed else spacing for length in (LONGEST_STEP, FIRST_STEP))
        step, easy, growth = first, 0, 0.0
        if speed == 0.0 and problem.memory is not None:
            memory = problem.memory
            spacing = FIRST_HOLD_STEP * float(memory.times[memory.shares > 0.0].min())
            step, longest, growth = min(spacing, end - begin), np.inf, HOLD_STEP_GROWTH
        self._spacing = spacing
        until = end * self.until * MM_PER_M / way.approach[leg] if leg == 1 and np.isfinite(self.until) else np.inf
        while self.time < end * (1 - 1e-12):
            if self.time >= until * (1 - 1e-9):
                self.status, self.message = SolveStatus.MAX_ITERATIONS, f"at approach {self.approach * MM_PER_M:.4g} mm, as the search was"
                return False
            number = len(self.recorder.approach)
            recorded = way.recorded[number] if number < len(way.recorded) else np.inf
            target = float(recorded if recorded <= end * (1 + 1e-12) else end)
            new = target if target - (here.time + step) < 1e-6 * spacing else here.time + step
            new = min(new, self._at_force(), until)
            if not (yield from self._attempt_step(here, new)):
                if self._gives_way(self.normal_force, 1 - FORCE_TOLERANCE) or self._out_of_reach():
                    return self._end_here(progress)
                if self._too_slow():
                    return False
                step, easy, self.halved = min((new - here.time) / 2, longest), 0, self.halved + 1
                if step < SMALLEST_STEP * spacing * (1 - 1e-9) or self._wasted > problem.most_wasted:
                    return False
                continue
            self.status, self.message = SolveStatus.CONVERGED, ""
            force = -problem.contact_force()[2]
            if self.stop_n is not None and leg == 1 and force >= (1 - FORCE_TOLERANCE) * self.stop_n:
                found = yield from self._stop_at_force(here, new, force)
                if found is None:
                    step, easy, self.halved = (new - here.time) / 2, 0, self.halved + 1
                    continue
                new, force = found
                self.stopped = True
                self.way = way = way.stays_from(leg, new)
                target = recorded = end = new
            approach = self._approach if way.by_force[leg] else way.at(leg, new)[0] / MM_PER_M
            moved = False
            if self.meets and not self.stopped and leg == 1 and new >= end * (1 - 1e-12):
                met = yield from self._nearer(here, new, (approach, force), self._rate)
                if met is None:  # as far as that is there is one
                    step, easy, self.halved, self.meets = (new - here.time) / 2, 0, self.halved + 1, False
                    continue
                (approach, force), moved = met, True
            self.energy.step(new, approach, apart=moved)
            self._settle()
            # a way that jumped says nothing of how it goes on
            self._previous, here = None if self._snapped else here, self._state(new, approach)
            self._arrive(here, force)
            easy += 1
            if growth:
                step *= growth
            elif easy >= 2 and step < longest:
                step, easy = min(2 * step, longest), 0
            if self._gives_way(force, GAVE_WAY):
                return self._end_here(progress)
            if abs(new - target) < 1e-9 * spacing and target == recorded:
                self._keep(progress)
        return True

    @property
    def _to_force_alone(self) -> bool:
        return self.stop_n is not None and not self.stopped and self.problem.scene.press.depth_mm is None and self._leg == 1

    def _gives_way(self, force: float, share: float) -> bool:
        """Whether what is pressed to a force alone bears [N] less than a share of what it did: no load of more can stand on it."""
        return self._to_force_alone and force < share * self.most[0]

    def _out_of_reach(self) -> bool:
        """Whether what is pressed to a force alone, and has failed for some time, is far from bearing it as deep as such a press goes.

        Factors of 1 to 2.8 for OUT_OF_REACH end the same of five random scenes (seed:index 3001:269, 3002:257, 3002:276 end; 3003:119 and
        3003:326 go on), one of 4 lets two more go on.
        """
        if not self._to_force_alone or self._wasted <= SOON or self.normal_force <= 0.0 or self.normal_force < self.bore:
            return False
        assert self.stop_n is not None
        order = self._rate * self.approach / self.normal_force
        deepest = furthest_approach(self.problem.scene)
        expected = self.normal_force * (deepest / self.approach) ** order
        if OUT_OF_REACH * expected >= self.stop_n:
            return False
        self.beyond = (
            f" with {self.normal_force:.3g} N: no equilibrium was found further on, and as its force grows it would bear {expected:.2g} N "
            f"at {deepest * MM_PER_M:.3g} mm, where such presses end"
        )
        return True

    def _too_slow(self) -> bool:
        """Whether a search has to be given up (`_Search`): where it found the force, the way is recorded however long that takes."""
        return False

    def _end_here(self, progress: Progress | None) -> bool:
        """Ends the leg in its last equilibrium, which is recorded."""
        self.gave_way = PressEnd.BEYOND if self.beyond else PressEnd.GAVE_WAY
        self.status, self.message = SolveStatus.CONVERGED, ""
        self.way = self.way.stays_from(self._leg, self.time)
        if len(self.recorder.approach) < np.searchsorted(self.way.recorded, self.time * (1 + 1e-12)):
            self._keep(progress)
        return True

    def _speed(self, leg: int) -> float:
        """How fast the object moves on a leg [m/s]: down (as far as that is known), sideways, or half a gel from where it turns."""
        way, gel = self.way, self.problem.scene.gel
        down = 0.0 if way.by_force[leg] else abs(way.approach[leg] - way.approach[leg - 1])
        sideways = float(np.linalg.norm(way.shear[leg] - way.shear[leg - 1]))
        round_it = np.deg2rad(np.abs(way.turn[leg] - way.turn[leg - 1]).max()) * min(gel.size_mm) / 2
        return max(down, sideways, round_it) / MM_PER_M / (way.time[leg] - way.time[leg - 1])

    def _go_on(self, before: _March) -> Generator[Request, NewtonReport, bool]:
        """Finds the last equilibrium of a march by another discretisation as this one has it, and whether it did."""
        problem, here = self.problem, before.here
        self.recorder, self.energy, self.halved = before.recorder, before.energy, before.halved
        self.way, self._leg, self.stopped = before.way, before._leg, before.stopped
        self._smallest, self.most = here.min_jacobian, before.most
        problem.solids.set_state(here.fields)
        problem.contact.inherit(before.problem.contact, problem.solids.positions(), LOOKED_MM)
        start = self._state(here.time, here.approach)
        self._arrive(start, before.normal_force)
        if not (yield from self._attempt(start, here.time, here.approach)):
            return False
        force = -problem.contact_force()[2]
        if self.stop_n is not None and not self.stopped and self._leg == 1 and force >= self.stop_n:
            # it bears more by this discretisation: the press ends before here, on the way from rest
            self.status, self.message = SolveStatus.MAX_ITERATIONS, f"at approach {here.approach * MM_PER_M:.4g} mm, beyond its force"
            return False
        self._settle()
        self.recorder.problem = problem
        self.energy.go_on(problem)
        self._arrive(self._state(here.time, here.approach), force)
        return True

    def _arrive(self, state: _State, force: float) -> None:
        """Takes an equilibrium, settled, and its normal force [N] as where the march stands."""
        self._before = self.approach, self.normal_force
        self.most = max(self.most, (force, state.approach))
        self.here, self.time, self.approach, self.normal_force = state, state.time, state.approach, force
        self._stiffness = self._rate or self._stiffness

    @property
    def _rate(self) -> float:
        """Of the normal force by the approach in the last step down [N/m]; 0 where that was none."""
        approach, force = self._before
        travel = self.approach - approach
        return (self.normal_force - force) / travel if travel > 0.0 else 0.0

    def deformation(self, end: PressEnd, message: str) -> Deformation:
        """What was recorded, and what of it is known beside the states."""
        return self.recorder.deformation(self.status, message, self.halved).reporting(energy=self.energy.report(), ended_by=end)

    def _settle(self) -> None:
        """Makes the present state the past: of contact, and of what the solids remember."""
        self.problem.contact.settle()
        if self.problem.memory is not None:
            self.problem.memory.keep(self.problem.solids.state()[0])

    def _keep(self, progress: Progress | None) -> None:
        self.recorder.keep(self.time, self.approach, self._iterations, self._factorisations)
        self._iterations = self._factorisations = 0
        if progress is not None:
            progress(len(self.recorder.approach), len(self.way.recorded))

    def _attempt_step(self, here: _State, new: float) -> Generator[Request, NewtonReport, bool]:
        """`_attempt` at a time [s] of the leg that it stands on, driven as that is."""
        approach, force, _, _ = self.way.at(self._leg, new)
        if self.way.by_force[self._leg]:
            return (yield from self._meet_force(here, new, force))
        return (yield from self._attempt(here, new, approach / MM_PER_M))

    def _meet_force(self, here: _State, new: float, wanted: float) -> Generator[Request, NewtonReport, bool]:
        """Solves at a time [s] with the approach at which the normal force is `wanted`, FIRST_STEP away from `here` at most.

        Above the gel, where nothing is remembered, it may go on from look to look. Where that approach is not found everything is put back,
        and the step is too long.
        """
        begin, looked = here.approach, [(here.approach, self.normal_force)]
        ahead = (wanted - self.normal_force) / self._stiffness if self._stiffness > 0.0 else FIRST_LOOK * FIRST_STEP
        low, high = -np.inf, np.inf
        approach = here.approach + float(np.clip(ahead, -FIRST_STEP, FIRST_STEP))
        for _ in range(MOST_LOOKS):
            if not (yield from self._attempt(here, new, approach)):
                return False
            force = -self.problem.contact_force()[2]
            if abs(force - wanted) <= FORCE_TOLERANCE * wanted:
                self._approach = approach
                return True
            low, high = (max(low, approach), high) if force < wanted else (low, min(high, approach))
            looked.append((approach, force))
            (one, before), (other, after) = looked[-2:]
            slope = (after - before) / (other - one) if other != one else 0.0
            following = other + (wanted - after) / slope if slope > 0.0 else (other + FIRST_LOOK * FIRST_STEP * np.sign(wanted - after))
            if self.normal_force <= 0.0 and after <= 0.0:
                begin, following = approach, approach + FIRST_STEP
            if not low < following < high:
                following = 0.5 * (low + high)
            if not abs(following - begin) <= FIRST_STEP * (1 + 1e-9):
                following = begin + FIRST_STEP * np.sign(wanted - after)
                if following == approach:
                    break
            approach = float(following)
        self.message = f"at approach {approach * MM_PER_M:.4g} mm, looking for {wanted:.3g} N"
        self.status = SolveStatus.MAX_ITERATIONS
        yield from self._return_to(here, LOOKED_MM + 2 * FIRST_STEP * MM_PER_M)
        return False

    def _attempt(self, here: _State, new: float, approach: float, *, again: bool = False) -> Generator[Request, NewtonReport, bool]:
        """Solves at a time `new` [s] and an approach [m], from `here`; where that fails everything is put back.

        In a press's later tries a failure is tried `again` without the state before `here`: where a point at a soft tip has just changed
        face, extrapolating its motion throws it onto the next one. What that finds with one body through the other (CUT_MM) is no answer.
        """
        problem, self._snapped = self.problem, False
        contact = problem.contact
        extrapolated = not again and self._previous is not None
        travel = self._predict(here, new, approach, extrapolated)
        if problem.memory is not None:
            problem.memory.begin(new - here.time)
        reach = LOOKED_MM + 2 * travel
        halvable = new - here.time > FOLDED_STEP * self._spacing
        # gone on with by a part of that step, a coin took 128 iterations, not 68 (23 other parts together 474, not 536), and a leaf's force
        # was 0.6 % further from that of many steps
        report = yield Request(reach, ROUGH_TOLERANCE, whole=halvable and not again, brief=halvable)
        self._count(report)
        overlap, allowed = np.inf, OVERLAP_MM if problem.scene.object.rigid else SOFT_OVERLAP_MM
        for number in range(MAX_AUGMENTATIONS):
            if report.status is not SolveStatus.CONVERGED:
                break
            before = (problem.solids.state(), contact.save(), report) if number > 0 or contact.can_tie else None
            contact.augment()
            report = yield Request(reach, brief=halvable)
            self._count(report)
            if before is not None and contact.can_tie and report.status is not SolveStatus.CONVERGED:
                # once more, without what parts letting go at once
                self._wasted += report.iterations
                problem.solids.set_state(before[0])
                contact.restore(before[1])
                yield Request(reach, solve=False)
                contact.augment(tie_at=problem.solids.positions())
                report = yield Request(reach, brief=halvable)
                self._count(report)
            lost, deepest = report.status is not SolveStatus.CONVERGED, -float(contact.gap.numpy().min())
            if before is not None and number > 0 and (lost or deepest > overlap):
                # what was to have less overlap is lost or has more, the equilibrium before it is not
                if lost:
                    self._wasted += report.iterations
                else:
                    overlap = deepest  # CUT_MM is for what it leads to
                fields, pairs, report = before
                problem.solids.set_state(fields)
                contact.restore(pairs)
                yield Request(reach, solve=False)
                break
            overlap = deepest
            if overlap <= allowed:
                break
        folds = report.min_jacobian < FOLDED * here.min_jacobian and halvable
        through = again and overlap > CUT_MM
        # a long step may end on the other side of an edge: what gives way does so in a short one too
        drops = halvable and self._gives_way(-problem.contact_force()[2], GAVE_WAY)
        if report.status is SolveStatus.CONVERGED and not folds and not through and not drops:
            self._smallest = report.min_jacobian
            return True
        self.status = report.status
        if report.status is SolveStatus.CONVERGED:
            self.status = SolveStatus.INVERTED_ELEMENT if folds else SolveStatus.MAX_ITERATIONS
        self._wasted += report.iterations
        self.message = f"at approach {approach * MM_PER_M:.4g} mm after {report.iterations} iterations, residual {report.residual:.2g}"
        yield from self._return_to(here, reach)
        if extrapolated and problem.held and report.status is not SolveStatus.CONVERGED:
            return (yield from self._attempt(here, new, approach, again=True))
        return False

    def _state(self, time: float, approach: float, seconds: float = 0.0) -> _State:
        """The present one, to return to."""
        return _State(time, approach, self.problem.solids.state(), self.problem.contact.save(), seconds, self._smallest)

    def _return_to(self, state: _State, reach: float) -> Marching:
        self.problem.solids.set_state(state.fields)
        self.problem.contact.restore(state.contact)
        if self.problem.memory is not None:
            self.problem.memory.begin(state.seconds)
        yield Request(reach, solve=False)

    def _count(self, report: NewtonReport) -> None:
        self._iterations += report.iterations
        self._spent += report.iterations
        self._factorisations += report.factorisations
        self._snapped |= report.snapped

    def _predict(self, here: _State, new: float, approach: float, extrapolated: bool) -> float:
        """Extrapolates the solids and the multipliers, or moves the object along; the driven nodes go exactly where they must.

        How far they go at most [mm] is returned.
        """
        problem = self.problem
        displacement, pressure = here.fields[0].copy(), here.fields[1].copy()
        driven = self._motion(problem.driven, new, approach)
        travel = float(np.linalg.norm(driven - displacement[problem.driven], axis=1).max())
        if extrapolated:
            assert self._previous is not None
            ratio = (new - here.time) / (here.time - self._previous.time)
            displacement += ratio * (here.fields[0] - self._previous.fields[0])
            pressure += ratio * (here.fields[1] - self._previous.fields[1])
            problem.contact.go_on_from(here.contact, self._previous.contact, ratio)
        else:
            problem.contact.go_on_from(here.contact)
            nodes = problem.object_nodes
            displacement[nodes] += self._motion(nodes, new, approach) - self._motion(nodes, here.time, here.approach)
        displacement[problem.driven] = driven
        problem.solids.set_state((displacement, pressure))
        problem.contact.begin_step(displacement - here.fields[0])
        return travel

    def _motion(self, nodes: NDArray[np.integer], time: float, approach: float) -> Array:
        """Displacement [mm] of nodes that move with the object's base, at a time [s] of the present leg and an approach [m]."""
        problem, way = self.problem, self.way
        _, _, shear, turn = way.at(self._leg, time)
        relative = problem.solids.rest[nodes] - problem.pivot
        moved = relative @ (turned(turn) @ turned(way.turn[0]).T).T
        return moved - relative + [*shear, -approach * MM_PER_M]

    def _at_force(self) -> float:
        """Where the force that stops it is to be expected [s]."""
        if self.stop_n is None or self._rate <= 0.0 or self._leg > 1:
            return np.inf
        ahead = _approach_of(self.stop_n, self._before, (self.approach, self.normal_force)) - self.approach
        return self.time + max(ahead / self._speed(self._leg), SMALLEST_STEP * self._spacing if self.halved else 0.0)

    def _stop_at_force(self, here: _State, new: float, force: float) -> Generator[Request, NewtonReport, tuple[float, float] | None]:
        """The time [s] between `here` and `new` where the normal force is what stops it, and the force; the solids are left at it.

        None where no equilibrium was found in between: then from `here` on a shorter step is to be made, as long as there is one.
        """
        wanted, way, leg = self.stop_n, self.way, self._leg
        assert wanted is not None

        def approach(time: float) -> float:
            return way.at(leg, time)[0] / MM_PER_M

        low, high = (here.time, self.normal_force), (new, force)
        beyond = self._state(new, approach(new), new - here.time)
        while abs(force - wanted) > FORCE_TOLERANCE * wanted and approach(high[0]) - approach(low[0]) > 1e-9:
            ends = approach(low[0]), approach(high[0])
            fraction = (_approach_of(wanted, (ends[0], low[1]), (ends[1], high[1])) - ends[0]) / (ends[1] - ends[0])
            new = low[0] + float(np.clip(fraction, 0.02, 0.98)) * (high[0] - low[0])
            self._previous = None if self._snapped else beyond
            if not (yield from self._attempt(here, new, approach(new))):
                if high[0] - here.time >= 2 * SMALLEST_STEP * self._spacing and self._wasted <= self.problem.most_wasted:
                    return None
                break  # a longer step converged: keep to that, a little beyond the force
            force = -self.problem.contact_force()[2]
            if force > wanted:
                high, beyond = (new, force), self._state(new, approach(new), new - here.time)
            else:
                low = new, force
        else:
            return new, force
        yield from self._return_to(beyond, LOOKED_MM + 2 * (approach(high[0]) - here.approach) * MM_PER_M)
        self.status, self.message = SolveStatus.CONVERGED, ""
        return high

    def _nearer(
        self, here: _State, new: float, solved: tuple[float, float], rate: float
    ) -> Generator[Request, NewtonReport, tuple[float, float] | None]:
        """From what was solved (approach [m], normal force [N]) at a time [s], the end of a way that a search found, nearer to the force
        that ends it: the way's steps leave another overlap than the search's, and shear takes some of the force.

        `rate`: of the force by the approach [N/m]. None where no equilibrium was found. Says whether the force is `stopped` at.
        """
        wanted, (approach, force) = self.stop_n, solved
        assert wanted is not None
        for _ in range(MOST_STEPS_NEARER):
            if abs(force - wanted) <= FORCE_TOLERANCE * wanted or rate <= 0.0:
                break
            last, before = approach, force
            approach += (wanted - force) / rate
            if not (yield from self._attempt(here, new, approach)):
                return None
            force = -self.problem.contact_force()[2]
            found = (force - before) / (approach - last)
            rate = found if found > 0.0 else rate
        self.stopped = abs(force - wanted) <= REACHED * wanted
        return approach, force


def _approach_of(force: float, one: tuple[float, float], other: tuple[float, float]) -> float:
    """The approach [m] of a normal force [N] on the power law through two states (approach, force); on a line where one bears none."""
    (near, less), (far, more) = one, other
    if min(near, less, far, more) <= 0.0 or (more - less) * (far - near) <= 0.0:
        return near + (far - near) * (force - less) / (more - less)
    return far * (force / more) ** (np.log(far / near) / np.log(more / less))


class _Search(_March):
    """Looks for the approach at which the force that ends a press is reached, straight down, and remembers the way there."""

    def __init__(self, problem: PressProblem, record: Record) -> None:
        press = replace(problem.scene.press, shear_mm=(0.0, 0.0), twist_deg=0.0)
        self.depth = furthest_approach(problem.scene)
        """The farthest that it looks [m]."""
        way = straight(press, self.depth * MM_PER_M, hold=False)
        places = np.append(np.arange(0.0, self.depth, LONGEST_STEP), self.depth)
        super().__init__(problem, replace(way, recorded=places * MM_PER_M / press.speed_mm_s), record, press.force_n)
        self.trail: list[_State] = []
        self.passed: list[int] = []
        """Newton iterations until each of them."""

    def _arrive(self, state: _State, force: float) -> None:
        super()._arrive(state, force)
        self.trail.append(state)
        self.passed.append(self._spent)

    def _too_slow(self) -> bool:
        """Whether a press to a force alone, which has failed for some time in its last try, would need more iterations than one may waste.

        Its pace is that of the last PACE iterations, over a step at least; how far the force is, its growth by a power law.
        """
        last = self.problem.held and self.problem.most_wasted > SOON
        if not last or not self._to_force_alone or self._wasted <= SOON or self._rate <= 0.0 or self.normal_force <= 0.0:
            return False
        assert self.stop_n is not None
        behind = zip(reversed(self.trail), reversed(self.passed), strict=True)
        ago = ((self.approach - state.approach, self._spent - spent) for state, spent in behind)
        travel, spent = next((one for one in ago if one[0] > 0.0 and one[1] >= PACE), (self.approach, self._spent))
        left = _approach_of(self.stop_n, self._before, (self.approach, self.normal_force)) - self.approach
        if spent * left / travel <= self.problem.most_wasted:
            return False
        self.beyond = (
            f" with {self.normal_force:.3g} N: the last {travel * MM_PER_M:.2g} mm took {spent} Newton iterations, and "
            f"{left * MM_PER_M:.2g} more would be needed"
        )
        return True

    def found(self) -> tuple[float, PressEnd, str]:
        """Approach [m] at which the press ends, what it ends at there, and why no further.

        Where the force is not reached that is where it bears most (`gave_way`), as far as an equilibrium was found (LOST), or the limit.
        """
        if self.stopped:
            return self.approach, PressEnd.FORCE, ""
        if self.gave_way:
            return self.most[1], self.gave_way, self.beyond
        # a soft edge or corner is crushed before it carries the force: what it did carry is a press worth having
        if self.status is not SolveStatus.CONVERGED and self.approach > 0.0:
            if self.beyond:
                return self.approach, PressEnd.SLOW, self.beyond
            return self.approach, PressEnd.LOST, f" with {self.normal_force:.3g} N; further on {self.status.value}"
        return self.depth, PressEnd.LIMIT, ""

    def record_way(self, depth: float, states: int, progress: Progress | None) -> Generator[Request, NewtonReport, bool]:
        """Records equally spaced states to `depth` [m], each a step from the one before it on the way; whether all were found."""
        self.recorder, rate = self.record(self.problem), self._rate
        places = np.array([state.approach for state in self.trail])
        speed = self.problem.scene.press.speed_mm_s / MM_PER_M
        self.way = straight(self.problem.scene.press, depth * MM_PER_M)
        for number in range(states):
            target = depth * number / (states - 1)
            time = target / speed
            before = max(int(np.searchsorted(places, target * (1 - 1e-9))) - 1, 0)
            here = self.trail[before]
            self._previous = self.trail[before + 1] if before + 1 < len(self.trail) else None
            yield from self._return_to(here, LOOKED_MM)
            if number > 0 and not (yield from self._attempt(here, time, target)):
                return False
            if number == states - 1 and self.stopped:
                met = yield from self._nearer(here, time, (target, -self.problem.contact_force()[2]), rate)
                if met is None:
                    return False
                target = met[0]
            self.time, self.approach = time, target
            self._keep(progress)
        self.status, self.message = SolveStatus.CONVERGED, ""
        return True
