"""A press that cannot be solved says why, and keeps what was solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fem_fixtures import MM, TOLERANCE, Array, ball_scene, flat_gel, problem_of, rigid_body
from planar_fixtures import press_of

import gelsim.fem
from gelsim.bench import random_scenes
from gelsim.bench.presses import ball
from gelsim.errors import MeshingError, PressEnd, SolveError, SolveStatus
from gelsim.fem import quasistatic, strategy
from gelsim.fem.batch import run_batch
from gelsim.fem.energy import EnergyBalance
from gelsim.fem.newton import Newton, NewtonOptions, NewtonReport, forgotten, spent, stalls
from gelsim.fem.problem import MOST_WASTED, Numerics, PressProblem
from gelsim.fem.quasistatic import PACE, SOON, run_press
from gelsim.pipeline import stages
from gelsim.results import Deformation, ErrorEstimate, SolveReport
from gelsim.scene.definition import Body, Gel, Press, Scene
from gelsim.scene.layers import build_scene
from gelsim.scene.materials import press_materials

LEAVES_MM = 5e-3
"""Overlap that a step leaves at most on the smooth bodies here."""


def driven(depth_mm: float, frames: int, thickness_mm: float) -> PressProblem:
    """A ball on a thin gel of two cells."""
    scene = ball_scene(depth_mm, frames, radius_mm=2.0)
    scene = scene.replace(gel=type(scene.gel)(profile="flat", thickness_mm=1.5, youngs_modulus_kpa=50.0))
    gel = flat_gel(1.0, 2.0, 2, 6.0, thickness_mm)
    return problem_of(scene, gel, rigid_body(scene, gel))


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch) -> PressProblem:
    """One that is to be driven through a gel of 0.6 mm, twice as far as its window."""
    monkeypatch.setattr(quasistatic, "SMALLEST_STEP", 1 / 4)
    return driven(1.2, 5, 0.6)


def test_failure_raises_with_what_was_solved(problem: PressProblem) -> None:
    with pytest.raises(SolveError) as caught:
        run_press(problem)
    message, press = str(caught.value), caught.value.deformation
    assert isinstance(press, Deformation)
    assert press.status is not SolveStatus.CONVERGED
    solved = len(press.approach) - 1
    assert 0 < solved < 4
    for words in ("at approach", "mm", "residual", press.status.value, f"{solved} of 4 steps were solved", "smaller depth_mm"):
        assert words in message
    assert press.approach == pytest.approx(np.arange(solved + 1) * 0.3 * MM)
    assert press.converged.all() and np.isfinite(press.gel.displacement).all()
    assert press.report.steps_halved >= 2  # to a half, to a quarter


def test_failure_as_a_value(problem: PressProblem) -> None:
    states = []
    press = run_press(problem, throw=False, progress=lambda done, total: states.append((done, total)))
    assert press.status is not SolveStatus.CONVERGED and press.message
    assert states == [(i + 1, 5) for i in range(len(press.approach))]
    # what the bodies are left in is an equilibrium, the last recorded one or one half a step on, not where Newton gave up; its multipliers
    # are the next step's already, which puts some micrometres of overlap times the penalty out of balance: per cents
    assert problem.newton.residual(2.0).imbalance < 0.1
    assert problem.support_force()[2] >= -press.force[-1, 2] * (1 - 100 * TOLERANCE)


def test_a_search_for_a_force_tells_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Minutes, where a body hardly finds its way."""
    monkeypatch.setattr(quasistatic, "LONGEST_STEP", 0.25e-3)
    scene = ball_scene(0.6, 5)
    scene = scene.replace(press=replace(scene.press, depth_mm=None, force_n=0.3))
    gel, told = flat_gel(1.0, 4.0, 4, 6.0, 2.4), []
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)), progress=lambda done, total: told.append((done, total)))
    assert press.report.ended_by == PressEnd.FORCE and {total for _, total in told} == {5}
    looked, recorded = [done for done, _ in told[:-5]], [done for done, _ in told[-5:]]
    assert len(looked) > 2 and looked == sorted(looked) and looked[-1] == 4 and recorded == [1, 2, 3, 4, 5]


def test_a_step_that_folds_elements_is_made_in_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where every longer step counts as folded, those of an eighth are taken, and lead to the same states."""
    problem = driven(0.4, 3, 1.0)
    straight = run_press(problem)
    assert straight.report.steps_halved == 0
    problem.reset()
    monkeypatch.setattr(quasistatic, "SMALLEST_STEP", 1 / 16)
    monkeypatch.setattr(quasistatic, "FOLDED", 10.0)
    careful = run_press(problem)
    assert careful.report.steps_halved > 3
    # another path, whose multipliers have moved more often: some overlap less
    assert careful.force[1:, 2] == pytest.approx(straight.force[1:, 2], rel=0.01)


@pytest.mark.parametrize("finer", [1.5, 2.0])
def test_no_fold_is_left_under_a_ball(finer: float) -> None:
    """With both meshes the last step of 0.2 mm used to end in an equilibrium with a crease inside the contact, at r = 2.1 mm: the gel lay
    59 µm below the ball there, det F was 0.30 at a point, and the force 0.07 % too low."""
    scene = build_scene(ball(0.499) | {"fidelity": "reference"})
    scene = scene.replace(press=replace(scene.press, frames=6))
    _, press = press_of(scene, finer=finer, gel_end=12.5e-3)
    assert press.status is SolveStatus.CONVERGED and press.min_jacobian.min() > 0.9
    rest, moved = press.gel.rest, press.gel.rest + press.gel.displacement[-1]
    across = np.hypot(moved[:, 0], moved[:, 1])
    under = (rest[:, 2] == 0.0) & (across < 2.5e-3)  # the contact ends at 2.96 mm
    radius = scene.object.radius_mm * 1e-3
    surface = -scene.press.depth_mm * 1e-3 + radius - np.sqrt(radius**2 - across[under] ** 2)
    # overlap is below 0.5 µm at points of contact; between them, 0.1 mm apart, a parabola is off the ball by (0.05 mm)²/2R = 0.3 µm
    assert np.abs(moved[under, 2] - surface).max() < 1e-6


@pytest.mark.parametrize("fails", [False, True])
def test_steps_begin_short_and_double_while_they_are_easy(monkeypatch: pytest.MonkeyPatch, fails: bool) -> None:
    """Two states 0.6 mm apart: from 0.25 mm, and half of that where the first fails, twice as long after two steps, and what is left."""
    attempt, steps = quasistatic._March._attempt, []  # pyright: ignore[reportPrivateUsage]

    def first_fails(march, here, new, approach, **how):  # type: ignore[no-untyped-def]
        steps.append(round((approach - here.approach) / MM, 6))
        return len(steps) > fails and (yield from attempt(march, here, new, approach, **how))

    monkeypatch.setattr(quasistatic._March, "_attempt", first_fails)  # pyright: ignore[reportPrivateUsage]
    scene = ball_scene(1.2, 3, radius_mm=5.0)
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    assert press.approach / MM == pytest.approx([0.0, 0.6, 1.2])
    assert press.report.steps_halved == fails
    assert steps == ([0.25, 0.125, 0.125, 0.25, 0.1, 0.5, 0.1] if fails else [0.25, 0.25, 0.1, 0.5, 0.1])


@pytest.mark.parametrize(
    ("depth_mm", "force_n", "farthest_mm", "end"),
    [
        (0.6, None, 1.0, PressEnd.DEPTH),
        (0.6, 0.01, 1.0, PressEnd.FORCE),
        (None, 0.01, 1.0, PressEnd.FORCE),
        (None, 100.0, 1.0, PressEnd.LIMIT),
        (None, 100.0, 0.4, PressEnd.LOST),
        (None, 0.01, 0.4, PressEnd.FORCE),
    ],
)
def test_a_press_says_what_it_ended_at(
    monkeypatch: pytest.MonkeyPatch, depth_mm: float | None, force_n: float | None, farthest_mm: float, end: PressEnd
) -> None:
    """A ball to 0.01 N, to more than it ever carries, and with no equilibrium to be found beyond 0.4 mm. All "converge"."""
    attempt = quasistatic._March._attempt  # pyright: ignore[reportPrivateUsage]

    def ends(march, here, new, approach, **how):  # type: ignore[no-untyped-def]
        if approach / MM > farthest_mm + 1e-9:
            march.status = SolveStatus.MAX_ITERATIONS
            return False
        return (yield from attempt(march, here, new, approach, **how))

    monkeypatch.setattr(quasistatic._March, "_attempt", ends)  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(quasistatic, "furthest_approach", lambda scene: 0.6 * MM)
    scene = ball_scene(0.6, 3, radius_mm=5.0)
    scene = scene.replace(press=replace(scene.press, depth_mm=depth_mm, force_n=force_n))
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    assert press.status is SolveStatus.CONVERGED
    assert press.report.ended_by == end
    assert press.lost == (end is PressEnd.LOST)


@pytest.mark.parametrize(("cost", "held", "end"), [(400, 20.0, PressEnd.SLOW), (10, 20.0, PressEnd.LOST), (400, 0.0, PressEnd.LOST)])
def test_a_press_whose_force_lies_too_far_at_its_pace_ends_there(
    monkeypatch: pytest.MonkeyPatch, cost: int, held: float, end: PressEnd
) -> None:
    """Beyond 0.4 mm each step that is tried costs so many iterations, of 200 that may be wasted; the force lies 0.1 mm on. Of a try that
    others follow only those count."""
    attempt = quasistatic._March._attempt  # pyright: ignore[reportPrivateUsage]

    def slows(march, here, new, approach, **how):  # type: ignore[no-untyped-def]
        if approach / MM <= 0.4 + 1e-9:
            return (yield from attempt(march, here, new, approach, **how))
        march.status, march._wasted, march._spent = SolveStatus.MAX_ITERATIONS, march._wasted + cost, march._spent + cost
        return False

    scene = ball_scene(0.4, 2, radius_mm=5.0)
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    bears = -run_press(problem_of(scene, gel, rigid_body(scene, gel))).force[-1, 2]
    monkeypatch.setattr(quasistatic._March, "_attempt", slows)  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(quasistatic, "furthest_approach", lambda scene: 0.6 * MM)
    scene = scene.replace(press=replace(scene.press, depth_mm=None, force_n=1.5 * bears))
    problem = problem_of(scene, gel, rigid_body(scene, gel))
    problem.held, problem.most_wasted = held, 200
    press = run_press(problem)
    left = f"{0.25 * (1.5 * bears / -press.force[-1, 2] - 1):.2g}"  # on a line from where nothing is borne
    assert press.report.ended_by is end and press.status is SolveStatus.CONVERGED and press.lost == (end is PressEnd.LOST)
    assert press.approach[-1] == pytest.approx((0.25 if cost > 200 else 0.4) * MM, rel=0.03)  # steps are halved down to 1/64
    said = float(press.report.warnings[-1].partition("with ")[2].partition(" N")[0])
    assert said == pytest.approx(-press.force[-1, 2], rel=0.01)  # recorded, it is another step's
    assert (f"Newton iterations, and {left} more" in press.report.warnings[-1]) == (end is PressEnd.SLOW)


def test_the_approach_of_a_force_is_that_of_the_power_law_through_two_states() -> None:
    """Hertz' law from its own points, before, between and beyond; a line where one of them bears nothing."""
    approach_of = quasistatic._approach_of  # pyright: ignore[reportPrivateUsage]
    one, other = ((a, 3.0 * a**1.5) for a in (0.2, 0.5))
    for looked in (0.1, 0.3, 0.8):
        assert approach_of(3.0 * looked**1.5, one, other) == pytest.approx(looked, rel=1e-12)
    assert approach_of(0.5, (0.1, 0.0), (0.3, 1.0)) == pytest.approx(0.2)
    assert approach_of(0.5, (-0.1, 0.1), (0.3, 0.9)) == pytest.approx(0.1)


@pytest.mark.parametrize("depth_mm", [1.2, None])
def test_a_force_is_met_at_the_second_look(monkeypatch: pytest.MonkeyPatch, depth_mm: float | None) -> None:
    """The law through the last two states of the way says where: a third of its step farther or nearer there is one state at most."""
    attempt, looks = quasistatic._March._attempt, []  # pyright: ignore[reportPrivateUsage]

    def seen(march, here, new, approach, **how):  # type: ignore[no-untyped-def]
        looks.append(approach / MM)
        return (yield from attempt(march, here, new, approach, **how))

    monkeypatch.setattr(quasistatic._March, "_attempt", seen)  # pyright: ignore[reportPrivateUsage]
    scene = ball_scene(1.2, 2, radius_mm=5.0)
    scene = scene.replace(press=replace(scene.press, depth_mm=depth_mm, force_n=0.22))
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    end, marched = press.approach[-1] / MM, looks[: len(looks) - (depth_mm is None)]  # a search records its end once more
    assert abs(press.force[-1, 2] + 0.22) <= quasistatic.FORCE_TOLERANCE * 0.22
    near = [look for look in marched if abs(look - end) < 0.25 / 3]
    assert len(near) <= 2 and max(marched) < end + 0.25 / 3, looks


@pytest.mark.parametrize("smallest", [1 / 64, 1.0])
def test_a_force_that_was_passed_is_looked_for_in_shorter_steps(monkeypatch: pytest.MonkeyPatch, smallest: float) -> None:
    """Of the looks for the force the first fails. Where no step may be shorter the press ends beyond it, and says so."""
    attempt, passed = quasistatic._March._attempt, [0]  # pyright: ignore[reportPrivateUsage]

    def first_look_fails(march, here, new, approach, **how):  # type: ignore[no-untyped-def]
        if passed == [1]:
            passed[0] += 1
            yield from march._return_to(here, 2.0)
            return False
        found = yield from attempt(march, here, new, approach, **how)
        passed[0] += not passed[0] and -march.problem.contact_force()[2] > 0.05
        return found

    monkeypatch.setattr(quasistatic._March, "_attempt", first_look_fails)  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(quasistatic, "SMALLEST_STEP", smallest)
    scene = ball_scene(0.6, 3, radius_mm=5.0)
    scene = scene.replace(press=replace(scene.press, force_n=0.05))
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    assert press.report.ended_by is PressEnd.FORCE and passed == [2]
    assert press.report.steps_halved == (smallest < 1.0)
    off = -press.force[-1, 2] / 0.05 - 1
    if smallest < 1.0:
        assert abs(off) <= quasistatic.FORCE_TOLERANCE and not press.report.warnings
    else:
        assert off > quasistatic.FORCE_TOLERANCE and "was passed" in press.report.warnings[-1]


@pytest.mark.parametrize(("falls_to", "lost_beyond_mm"), [(0.5, 1.0), (0.99, 0.4)])
@pytest.mark.parametrize("shear", [0.0, 0.1])
def test_a_press_to_a_force_ends_where_the_object_gives_way(
    monkeypatch: pytest.MonkeyPatch, falls_to: float, lost_beyond_mm: float, shear: float
) -> None:
    """From 0.3 mm on it bears half of the most that it bore; or a little less, until no equilibrium is found."""
    attempt, force = quasistatic._March._attempt, PressProblem.contact_force  # pyright: ignore[reportPrivateUsage]
    at, most = [0.0], [0.0]

    def ends(march, here, new, approach, **how):  # type: ignore[no-untyped-def]
        at[0] = approach / MM
        return approach / MM <= lost_beyond_mm and (yield from attempt(march, here, new, approach, **how))

    def gives_way(problem: PressProblem) -> Array:
        found = force(problem)
        if at[0] > 0.3 + 1e-9:
            found[2] = -falls_to * most[0]
        most[0] = max(most[0], -float(found[2]))
        return found

    monkeypatch.setattr(quasistatic._March, "_attempt", ends)  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(PressProblem, "contact_force", gives_way)
    monkeypatch.setattr(quasistatic, "furthest_approach", lambda scene: 0.6 * MM)
    monkeypatch.setattr(quasistatic, "FIRST_STEP", 0.1e-3)
    monkeypatch.setattr(quasistatic, "LONGEST_STEP", 0.1e-3)
    scene = ball_scene(0.6, 3, radius_mm=5.0, friction=0.5, shear_mm=(shear, 0.0))
    scene = scene.replace(press=replace(scene.press, depth_mm=None, force_n=100.0))
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    assert press.report.ended_by is PressEnd.GAVE_WAY and press.status is SolveStatus.CONVERGED and not press.lost
    assert len(press.approach) == 3 and press.approach[-1] == pytest.approx(0.3 * MM) and press.approach[1] == pytest.approx(0.15 * MM)
    assert f"{-press.force[-1, 2]:.3g} N is the most that the object bears" in press.report.warnings[-1]


def halvable_steps(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Tells, as a march goes on, whether the step that it attempts can be halved."""
    attempt, halvable = quasistatic._March._attempt, [False]  # pyright: ignore[reportPrivateUsage]

    def told(march, here, new, approach, **again):  # type: ignore[no-untyped-def]
        halvable[0] = new - here.time > quasistatic.FOLDED_STEP * march._spacing
        return attempt(march, here, new, approach, **again)

    monkeypatch.setattr(quasistatic._March, "_attempt", told)  # pyright: ignore[reportPrivateUsage]
    return halvable


def test_what_gives_way_in_a_long_step_is_looked_at_in_shorter_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: beyond 0.2 N long steps end where the object bears a tenth. In short ones it bears the force."""
    bears, long = PressProblem.contact_force, halvable_steps(monkeypatch)

    def drops(problem: PressProblem) -> Array:
        found = bears(problem)
        return 0.1 * found if long[0] and -found[2] > 0.2 else found

    monkeypatch.setattr(PressProblem, "contact_force", drops)
    scene = ball_scene(0.6, 3, radius_mm=5.0)
    scene = scene.replace(press=replace(scene.press, depth_mm=None, force_n=0.4))
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    assert press.report.ended_by is PressEnd.FORCE and -press.force[-1, 2] == pytest.approx(0.4, rel=0.005)


@pytest.mark.parametrize("ends", [SolveStatus.MAX_ITERATIONS, SolveStatus.CONVERGED])
def test_an_augmentation_that_fails_costs_its_own_gain_only(ends: SolveStatus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every step's second one goes astray, or to more overlap: what is left are the states of the first ones, and no step is halved."""
    monkeypatch.setattr(quasistatic, "OVERLAP_MM", 0.0)  # always another
    scene = ball_scene(0.6, 3, radius_mm=5.0, friction=0.5, shear_mm=(0.1, 0.0))
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    with monkeypatch.context() as once:
        once.setattr(quasistatic, "MAX_AUGMENTATIONS", 1)
        expected = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    solve, exact, lost = Newton.solve, [0], [0]

    def astray(newton, **asked):  # type: ignore[no-untyped-def]
        report = solve(newton, **asked)
        reach, tolerance, solving = (asked[name] for name in ("reach", "tolerance", "solve"))
        fine = tolerance is None or tolerance < quasistatic.ROUGH_TOLERANCE
        exact[0] = exact[0] + 1 if solving and fine else exact[0] if not solving else 0
        if not solving or exact[0] < 2:
            return report
        lost[0] += 1
        displacement, pressure = newton.solids.state()
        back = np.where(newton.solids.free[:, :3], 0.5, 1.0)  # the gel's, not the object's
        newton.solids.set_state((back * displacement, pressure))
        newton.residual(reach)
        return replace(report, status=ends)

    monkeypatch.setattr(Newton, "solve", astray)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    assert lost[0] == 3 and press.report.steps_halved == 0
    assert press.force == pytest.approx(expected.force, rel=1e-9, abs=1e-9)
    assert press.gel.displacement == pytest.approx(expected.gel.displacement, rel=1e-9, abs=1e-15)


def test_a_step_that_fails_is_tried_again_from_the_last_state_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Second try; each step that starts from an extrapolation goes astray: those without it lead to the same states, none is halved."""
    scene = ball_scene(0.6, 4, radius_mm=5.0)
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    expected = run_press(problem_of(scene, gel, rigid_body(scene, gel)))
    predict, solve, starts = quasistatic._March._predict, Newton.solve, []  # pyright: ignore[reportPrivateUsage]

    def told(march, here, new, approach, extrapolated):  # type: ignore[no-untyped-def]
        starts.append(extrapolated)
        return predict(march, here, new, approach, extrapolated)

    def astray(newton, **asked):  # type: ignore[no-untyped-def]
        report = solve(newton, **asked)
        if not (asked["solve"] and starts[-1]):
            return report
        displacement, pressure = newton.solids.state()
        newton.solids.set_state((0.5 * displacement, pressure))
        return replace(report, status=SolveStatus.MAX_ITERATIONS)

    monkeypatch.setattr(quasistatic._March, "_predict", told)  # pyright: ignore[reportPrivateUsage]
    monkeypatch.setattr(Newton, "solve", astray)
    problem = problem_of(scene, gel, rigid_body(scene, gel))
    problem.held = 1.0
    press = run_press(problem)
    assert starts == [False, True, False, True, False] and press.report.steps_halved == 0
    # Multipliers that were not extrapolated leave another overlap, below LEAVES_MM of the 0.2 mm of the first state; the force goes as
    # the depth to the power of 1.5.
    assert press.force == pytest.approx(expected.force, rel=1.5 * LEAVES_MM / 0.2, abs=1e-6)
    assert press.gel.displacement == pytest.approx(expected.gel.displacement, abs=LEAVES_MM * MM)


def test_solves_are_brief_where_a_shorter_step_is_to_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that are brief fail here, so steps get as short as none is any more."""
    solve, halvable, seen = Newton.solve, halvable_steps(monkeypatch), set()

    def fails(newton, **asked):  # type: ignore[no-untyped-def]
        report = solve(newton, **asked)
        if not asked["solve"]:
            return report
        seen.add((halvable[0], asked["brief"]))
        return replace(report, status=SolveStatus.MAX_ITERATIONS) if asked["brief"] else report

    monkeypatch.setattr(Newton, "solve", fails)
    scene, gel = ball_scene(0.2, 2), flat_gel(0.7, 2.1)
    assert run_press(problem_of(scene, gel, rigid_body(scene, gel))).status is SolveStatus.CONVERGED
    assert seen == {(True, True), (False, False)}


def test_a_march_ends_when_too_many_iterations_are_wasted() -> None:
    """Steps that cannot converge are halved until more iterations have failed than its problem allows."""
    scene = ball_scene(0.3, 2, radius_mm=5.0)
    gel = flat_gel(3.0, 4.0, 2, 6.0, 3.0)
    halved = []
    for most in (7, 600):
        problem = problem_of(scene, gel, rigid_body(scene, gel))
        problem.options = problem.newton.options = NewtonOptions(tolerance=1e-30, max_iterations=3)
        problem.most_wasted = most
        press = run_press(problem, throw=False)
        assert press.status is SolveStatus.MAX_ITERATIONS
        halved.append(press.report.steps_halved)
    shortest = quasistatic.SMALLEST_STEP * 0.3e-3
    smallest = 1 + int(np.log2(quasistatic.FIRST_STEP / shortest))
    assert halved == [3, smallest], "three iterations each: the third step is one too many of seven"


@pytest.mark.parametrize(
    ("sizes", "ends"),
    [
        ([1.0] * 14, False),  # not enough exact ones yet
        ([1.0] * 15, True),
        ([1.0] * 14 + [0.4], False),
        (
            [0.01] + [1.0] * 8 + [0.02, 0.01, 0.006, 0.02, 0.01, 0.02],
            True,
        ),  # what it had reached before counts, not where it wandered since
    ],
)
def test_exact_steps_that_lead_nowhere_end_a_solve(sizes: list[float], ends: bool) -> None:
    assert stalls(sizes, NewtonOptions(patient=False)) == ends
    assert not stalls(sizes, NewtonOptions()), "where no other try follows it goes on"


def test_steps_down_from_saddles_of_soft_bodies_are_counted_where_a_try_follows() -> None:
    """They are like others there, or a shorter step, and so is what the residual was before; of rigid bodies, and in the last try, not."""
    counted, brief = [], []
    for rigid in (False, True):
        scene = build_scene({"fidelity": "fast", "object": {"rigid": rigid}})
        bodies, materials = stages.bodies(scene), press_materials(scene)
        for patient in (False, True):
            problem = PressProblem(scene, *bodies, materials, "cpu", Numerics(patient=patient))
            for options, found in ((problem.options, counted), (problem.options.brief, brief)):
                found.append((spent(30, 30, options), forgotten([0.1, 1.0], options)))
    down, like_others = (False, [np.inf, np.inf]), (True, [0.1, 1.0])
    assert counted == [like_others, down, down, down] and brief == [like_others, like_others, down, down]


@pytest.mark.parametrize(("rigid", "coat", "last"), [(False, 0.0, 0.0), (True, 0.0, 0.1), (True, 2.0, None)])
def test_under_a_rigid_body_a_bare_gel_is_given_a_coat_at_last(rigid: bool, coat: float, last: float | None) -> None:
    """As of so much [mm] of its own silicone; a soft body has volume held instead, and a gel that has a coat keeps that one."""
    gel = {"youngs_modulus_kpa": 50.0, "coat_n_per_m": coat}
    scene = build_scene({"fidelity": "fast", "gel": gel, "object": {"rigid": rigid}})
    ways = strategy.ways(scene)
    problems = [gelsim.fem._problem(way, scene, *stages.bodies(scene), "cpu") for way in ways]
    first, then = (PACE if rigid else SOON), ([] if last is None else [MOST_WASTED])
    assert [one.most_wasted for one in problems] == [first, SOON, *then]
    assert [one.scene.gel.coat_n_per_m for one in problems] == pytest.approx([coat, coat, *([] if last is None else [50.0 * last])])
    assert [one.held > 0.0 for one in problems] == [False, True, *([] if last is None else [not rigid])]


def test_a_coat_that_nobody_asked_for_is_told(deformation: Deformation) -> None:
    """And is not as asked."""
    lost = replace(deformation, status=SolveStatus.MAX_ITERATIONS, report=SolveReport(ended_by=PressEnd.LOST))
    done = replace(deformation, report=SolveReport(ended_by=PressEnd.DEPTH, coat_n_per_m=5.0, steps_halved=1))
    tries = strategy.tries(Scene(object=Body(shape="box", rigid=True)))
    next(tries)
    way, course = tries.send(lost)
    assert way.coat_mm > 0.0 and not way.goes_on and course.before is None, "nothing went on from the first: it begins again"
    with pytest.raises(StopIteration) as end:
        tries.send(done)
    assert "a coat of 5 N/m" in "".join(end.value.value.report.warnings)
    row = {"status": "CONVERGED", "ended_by": PressEnd.DEPTH}
    assert random_scenes.as_asked(row | {"coated": False}) and not random_scenes.as_asked(row | {"coated": True})


def test_of_two_tries_the_better_is_kept() -> None:
    """One that reached its end; of two that did not one that counts as converged; of two such the one that got farther."""
    scene = ball_scene(0.3, 2, radius_mm=5.0)
    gel = flat_gel(3.0, 4.0, 2, 6.0, 3.0)
    press = run_press(problem_of(scene, gel, rigid_body(scene, gel)))

    def ended(by: PressEnd, status: SolveStatus, travel: float) -> Deformation:
        return replace(press, status=status, approach=press.approach * travel, report=SolveReport(ended_by=by))

    failed = ended(PressEnd.LOST, SolveStatus.MAX_ITERATIONS, 3.0)
    near, far = (ended(PressEnd.LOST, SolveStatus.CONVERGED, travel) for travel in (1.0, 2.0))
    squashed = ended(PressEnd.LIMIT, SolveStatus.CONVERGED, 0.5)
    for worse, better in ((failed, near), (near, far), (far, squashed), (failed, squashed)):
        assert strategy.further(worse, better) is better
        assert strategy.further(better, worse) is better
    assert strategy.further(near, replace(near)) is near


STICKY = build_scene({
    "fidelity": "fast", "gel": {"profile": "flat", "youngs_modulus_kpa": 50.0}, "contact": {"friction_coefficient": 0.8},
    "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": 200.0},
    "press": {"depth_mm": 0.8, "force_n": "none", "frames": 5, "shear_mm": [1.0, 0.0], "symmetry": "none"},
})  # fmt: skip
"""A soft ball with friction, sheared."""


@pytest.mark.parametrize(
    ("shape", "rigid", "fidelity", "points"),
    [
        ("box", True, "balanced", 12), ("box", True, "reference", 12), ("box", True, "fast", 24), ("hemisphere", True, "balanced", 6),
        ("flat", True, "balanced", 6), ("hemisphere", False, "fast", 48), ("hemisphere", True, "fast", 24), ("box", False, "balanced", 6),
        ("box", False, "fast", 96), ("flat", False, "fast", 48),
    ],
)  # fmt: skip
def test_contact_points_are_more_where_faces_let_each_other_through(shape: str, rigid: bool, fidelity: str, points: int) -> None:
    """A rigid ball has no edge, a block that is wider than the gel none over it."""
    body = Body(shape=shape, rigid=rigid, **({"width_mm": 30.0, "length_mm": 30.0} if shape == "flat" else {}))
    scene = Scene(object=body, gel=Gel(profile="flat"), press=Press(depth_mm=0.3), fidelity=fidelity)
    assert strategy.contact_points(scene) == points
    asked, _ = next(strategy.tries(scene))
    assert asked.contact_points == points
    assert gelsim.fem._problem(asked, scene, *stages.bodies(scene), "cpu").contact.points == points


def made_sticky(
    contact_points: int = 12, held: float = 0.0, frames: int = 5, force_n: float | None = None, alone: bool = False
) -> PressProblem:
    numerics = Numerics(contact_points=contact_points, held=held)
    press = replace(STICKY.press, frames=frames, force_n=force_n)
    scene = STICKY.replace(press=replace(press, depth_mm=None) if alone else press)
    return PressProblem(scene, *stages.bodies(scene), press_materials(scene), "cpu", numerics)


def lost(problem: PressProblem, from_mm: float, course: quasistatic.Course) -> Deformation:
    """A press that is lost from an approach on."""
    solve = problem.newton.solve

    def astray(**asked: Any) -> NewtonReport:
        report = solve(**asked)
        gone = asked["solve"] and problem.solids.state()[0][problem.driven, 2].min() < -from_mm
        return replace(report, status=SolveStatus.MAX_ITERATIONS) if gone else report

    problem.newton.solve = astray  # type: ignore[method-assign]
    begun = run_press(problem, course=course, throw=False)
    assert begun.lost and course.before is not None
    return begun


def goes_on(first: PressProblem, second: PressProblem, lost_from_mm: float, batched: bool) -> tuple[Deformation, Deformation]:
    """A press that is lost in `first` from an approach on, and what it becomes as `second` goes on."""
    course = quasistatic.Course()
    begun = lost(first, lost_from_mm, course)
    whole = run_batch([second], courses=[course])[0] if batched else run_press(second, course=course)
    assert whole.status is SolveStatus.CONVERGED and whole.approach == pytest.approx(np.linspace(0, 0.8, second.scene.press.frames) * MM)
    return begun, whole


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("points", [6, 12])
def test_a_lost_press_goes_on_by_other_points(points: int, batched: bool) -> None:
    """A soft ball with friction, lost at a quarter of its way, is led on with twice or half the contact points, and is then what it is with
    these alone, but for what the two differ by at this coarseness."""
    begun, whole = goes_on(made_sticky(18 - points), made_sticky(points), 0.21, batched)
    assert begun.approach == pytest.approx([0.0, 0.2 * MM])
    assert whole.force[:2] == pytest.approx(begun.force), "what was recorded before stays"
    alone = run_press(made_sticky(points))
    off = np.abs(whole.force - alone.force).max(axis=1)[1:] / np.abs(alone.force[1:, 2])
    # What sticks keeps its places. Were they forgotten, the shear that was there when the points changed would be missing: 4 % of the next
    # state's normal force. What is left is what 6 and 12 points differ by, 0.1 to 0.3 % by the mesh that this machine makes.
    forgotten = alone.force[1, 0] / -alone.force[2, 2]
    assert alone.force[1, 0] > 0.2 * alone.force[-1, 0] and forgotten > 0.03
    assert off.max() < forgotten / 5
    assert whole.report.energy is not None and abs(whole.report.energy.drift) < 0.01  # found: 0.001


def test_a_press_does_not_go_on_from_beyond_its_force() -> None:
    """Held volume bears the force where the press is to go on already: it is between the states before, which only the whole way finds."""
    course, bears = quasistatic.Course(), -run_press(made_sticky()).force[1, 2]
    to_force = partial(made_sticky, force_n=1.004 * bears)  # held volume bears 0.7 % more or above
    begun = lost(to_force(), 0.2001, course)
    assert begun.force[-1, 2] == pytest.approx(-bears) and course.before is not None
    beyond = run_press(to_force(held=20.0), course=course, throw=False)
    assert beyond.lost and beyond.approach[-1] == begun.approach[-1]
    alone = run_press(to_force(held=20.0))
    assert alone.report.ended_by is PressEnd.FORCE and alone.force[-1, 2] == pytest.approx(-1.004 * bears, rel=0.005)


@pytest.mark.parametrize("batched", [False, True])
def test_energy_that_stiffer_tets_hold_is_told_apart(batched: bool) -> None:
    """Where volume comes to be held three quarters of the way down, the bodies hold more energy at the same approach: no work of the
    platen's, and no drift."""
    # In steps of 0.2 mm work and friction's loss are off by 0.002 to 0.003 themselves, by the mesh that is drawn; of 0.1 mm by 0.0004.
    _, whole = goes_on(made_sticky(frames=9), made_sticky(held=20.0, frames=9), 0.61, batched)
    energy = whole.report.energy
    assert energy is not None and energy.changed_j > 0.01 * energy.work_j  # found: 0.017
    assert abs(energy.drift) < 0.003  # found: 0.001; as part of what is stored it made it -0.017


def test_a_step_that_jumps_to_another_branch_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without friction the gel slides over a punch's rim; as the rim is round, its energy balances. A balance that does not is told."""

    def told() -> list[str]:
        scene = build_scene({
            "fidelity": "fast", "object": {"shape": "punch", "radius_mm": 3.0, "rigid": True, "edge_radius_mm": 0.2},
            "press": {"depth_mm": 0.5, "force_n": "none", "frames": 6, "symmetry": "mirror"}, "contact": {"friction_coefficient": 0.0},
        })  # fmt: skip
        press = run_press(PressProblem(scene, *stages.bodies(scene), press_materials(scene), "cpu"))
        return [text for text in press.report.warnings if "another branch" in text]

    assert not told()
    step = EnergyBalance.step

    def loses(balance: EnergyBalance, time: float, approach: float, *, apart: bool) -> None:
        step(balance, time, approach, apart=apart)
        balance.jump = max(balance.jump, (0.064, 0.5e-3))

    monkeypatch.setattr(EnergyBalance, "step", loses)
    (jumped,) = told()
    assert jumped.startswith("the step to 0.5 mm lost 6% of its work")


def test_a_search_for_a_force_records_its_own_way() -> None:
    """The states of a press to a force are those of one to the depth it found, solved anew: no second march is needed."""
    scene = ball_scene(0.6, 4, radius_mm=5.0)
    gel = flat_gel(3.0, 4.0, 4, 6.0, 3.0)
    to_force = scene.replace(press=replace(scene.press, depth_mm=None, force_n=0.02))
    found = run_press(problem_of(to_force, gel, rigid_body(to_force, gel)))
    assert found.report.ended_by == PressEnd.FORCE and len(found.approach) == 4
    assert -found.force[-1, 2] == pytest.approx(0.02, rel=quasistatic.FORCE_TOLERANCE)
    depth = found.approach[-1] / MM
    to_depth = scene.replace(press=replace(scene.press, depth_mm=depth, force_n=None))
    again = run_press(problem_of(to_depth, gel, rigid_body(to_depth, gel)))
    assert found.approach == pytest.approx(again.approach)
    # each leaves up to LEAVES_MM of overlap, in steps of another length; the force goes as the depth to the power of 1.5
    loose = 1.5 * LEAVES_MM / (depth / 3)
    assert found.force == pytest.approx(again.force, rel=loose, abs=1e-6)


def test_a_short_last_step_does_not_bend_the_work_of_the_one_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring that is pressed in one step, and a fiftieth of it further to its force. Planted: a cubic through both steps."""
    balance: Any = object.__new__(EnergyBalance)
    balance.problem = SimpleNamespace(copies=1)
    balance._time, balance._power, balance._legs = [0.0, 1.0, 1.02], [(0.0, 1.0), (1.0, 1.05)], [0]
    balance._stored, balance._changed, balance._lost, balance._overlap_work = 0.5 + 0.0205, 0.0, 0.0, 0.0
    assert abs(balance.report().drift) < 1e-3
    monkeypatch.setattr("gelsim.fem.energy._SHORT", 0.0)
    assert balance.report().drift < -0.1


@pytest.mark.parametrize("shear_mm", [0.0, 0.3])
def test_a_press_ends_at_its_force_where_its_search_ended_beside_it(shear_mm: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the search says a tenth less of the way; the force goes as the depth to the power of 1.5. These coarse faces
    lose 0.7 and 2 % of the work; were the last step taken to be as fast as those before it, the sheared press would gain 0.9 %."""
    scene = ball_scene(0.6, 4, friction=0.8, radius_mm=5.0, shear_mm=(shear_mm, 0.0))
    to_force = scene.replace(press=replace(scene.press, depth_mm=None, force_n=0.2))
    gel, found = flat_gel(1.5, 3.0, 4, 6.0, 3.0), quasistatic._Search.found

    def short(search: Any) -> tuple[float, PressEnd, str]:
        approach, *how = found(search)
        return 0.9 * approach, *how

    def off() -> float:
        press = run_press(problem_of(to_force, gel, rigid_body(to_force, gel)))
        assert press.report.energy is not None and 0.0 < press.report.energy.drift < 0.03
        off = abs(-press.force[-1, 2] / 0.2 - 1.0)
        assert (press.report.ended_by is PressEnd.FORCE) == (off < quasistatic.REACHED) == (not press.report.warnings)
        return off

    monkeypatch.setattr(quasistatic._Search, "found", short)
    assert off() < quasistatic.FORCE_TOLERANCE
    monkeypatch.setattr(quasistatic, "MOST_STEPS_NEARER", 0)  # planted: it stays there
    assert off() > 0.02


def test_recording_hands_over_where_its_search_was_lost() -> None:
    """A try that was lost on the search for a force goes no further when it records; planted: it would."""
    course, bears = quasistatic.Course(), -run_press(made_sticky()).force[3, 2]
    to_force = partial(made_sticky, force_n=bears, alone=True)
    course.followed = True
    lost(to_force(), 0.31, course)
    found_by = run_press(to_force(held=20.0), course=course, throw=False)
    assert course.searched and course.found is not None and 0.0 < course.lost_at < 0.35e-3 and not found_by.lost
    course.before, course.followed = None, True
    recorded = run_press(to_force(), course=course, throw=False)
    assert recorded.lost and recorded.approach[-1] <= course.lost_at < recorded.approach[-1] + 0.3e-3
    assert course.before is not None and course.before.approach == pytest.approx(course.lost_at)
    course.lost_at = np.inf  # planted
    assert not run_press(to_force(), course=course, throw=False).lost


@pytest.mark.parametrize(
    ("ends", "enough_mm", "kept", "meshed"),
    [
        (["lost far", "there"], None, "there", [0, 1]),
        (["there"], None, "there", [0]),
        (["lost far", "lost near"], None, "lost far", [0, 1]),
        (["lost near", "lost far"], None, "lost far", [0, 1]),
        (["lost far"], 0.7, "lost far", [0]),
        (["lost near", "there"], 0.7, "there", [0, 1]),
        (["lost far", "no mesh"], None, "lost far", [0, 1]),
    ],
)
def test_a_lost_press_gets_another_mesh(
    ends: list[str], enough_mm: float | None, kept: str, meshed: list[int], deformation: Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mesh that the report tells of is that of the press that is kept; planted: the first press is lost."""
    made = {
        "lost near": replace(deformation, approach=deformation.approach * 0.5, report=SolveReport(ended_by=PressEnd.LOST)),
        "lost far": replace(deformation, report=SolveReport(ended_by=PressEnd.LOST)),
        "there": replace(deformation, report=SolveReport(ended_by=PressEnd.DEPTH)),
    }
    asked: list[int] = []

    def bodies(scene: Scene, symmetry: frozenset[str], record: stages.Record, draw: int) -> tuple[int, int, int]:
        asked.append(draw)
        if ends[draw] == "no mesh":
            raise MeshingError("no mesh")
        record.meshes["object"] = {"elements": draw}
        return 0, 0, 0

    monkeypatch.setattr(stages, "_bodies", bodies)
    monkeypatch.setattr(gelsim.fem, "solve_press", lambda *_, **__: made[ends[len(asked) - 1]])
    record, scene = stages.Record(), build_scene({"press": {"depth_mm": 0.5, "symmetry": "mirror"}})
    enough = None if enough_mm is None else lambda found: found.approach[-1] >= enough_mm * MM
    press = stages.press(scene, record=record, enough=enough)
    assert press.approach is made[kept].approach and press.report.ended_by is made[kept].report.ended_by and asked == meshed
    assert record.meshes["object"]["elements"] == ends.index(kept)
    said = " ".join(press.report.warnings)
    assert ("drawn anew" in said) is (ends.index(kept) > 0) and ("could not be given another" in said) is ("no mesh" in ends)
    asked.clear()
    stages.press(scene.replace(object=replace(scene.object, rigid=True)))
    assert asked == [0]  # a rigid one has no tets


@pytest.mark.parametrize(("symmetry", "solid"), [("auto", True), ("axisymmetric", False)])
def test_a_lost_profile_is_pressed_as_a_solid(
    symmetry: str, solid: bool, deformation: Deformation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the scene leaves the choice; planted: the profile is lost."""
    lost = replace(deformation, report=SolveReport(ended_by=PressEnd.LOST, error_estimate=ErrorEstimate(0.01, 1.0)))
    there = replace(deformation, report=SolveReport(ended_by=PressEnd.DEPTH))
    monkeypatch.setattr(gelsim.fem, "solve_planar", lambda *_, **__: lost)
    monkeypatch.setattr(gelsim.fem, "solve_press", lambda *_, **__: there)
    monkeypatch.setattr(stages, "_bodies", lambda *_: (0, 0, 0))
    record = stages.Record()
    given = {"fidelity": "fast", "gel": {"profile": "flat"}, "object": {"shape": "hemisphere"}}
    scene = build_scene(given | {"press": {"depth_mm": 0.5, "symmetry": symmetry}})
    press = stages.press(scene, record=record)
    assert press.report.ended_by is (PressEnd.DEPTH if solid else PressEnd.LOST)
    assert record.choices["symmetry"] == (["x", "y"] if solid else "axisymmetric")


class _Asked(Exception):
    """What is asked for next is all that a test wants to know."""


@pytest.mark.parametrize("target", [{}, {"target_error": 0.05}])
def test_what_is_enough_comes_through(target: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stages, "_bodies", lambda *_: (0, 0, 0))

    def solve_press(*_: object, enough: Callable[[Deformation], bool] | None, **__: object) -> None:
        raise _Asked(enough)

    def enough(_: Deformation) -> bool:
        return True

    monkeypatch.setattr(gelsim.fem, "solve_press", solve_press)
    with pytest.raises(_Asked) as asked:
        stages.press(build_scene({"press": {"symmetry": "mirror"}} | target), enough=enough)
    assert asked.value.args == (enough,)


@pytest.mark.parametrize("enough_mm", [None, 0.3, 3.0])
def test_a_press_that_has_got_far_enough_does_not_begin_again(enough_mm: float | None, deformation: Deformation) -> None:
    """Its tries that go on it has: one, and then one from rest, if it had to."""
    lost = replace(deformation, status=SolveStatus.MAX_ITERATIONS, report=SolveReport(ended_by=PressEnd.LOST))
    enough = None if enough_mm is None else lambda found: found.approach[-1] >= enough_mm * MM
    tries, made = strategy.tries(Scene(), enough), []
    way, course = next(tries)
    with pytest.raises(StopIteration) as end:
        while True:
            made.append(way.goes_on)
            course.before = course.before or SimpleNamespace(approach=0.0)  # type: ignore[assignment]
            way, course = tries.send(lost)
    assert end.value.value.lost
    assert made == [False, True] + ([] if enough_mm == 0.3 else [False])


def test_a_force_that_was_found_is_recorded_however_far_an_earlier_try_had_got(deformation: Deformation) -> None:
    lost = replace(deformation, status=SolveStatus.MAX_ITERATIONS, report=SolveReport(ended_by=PressEnd.LOST))
    there = replace(deformation, report=SolveReport(ended_by=PressEnd.FORCE))
    tries = strategy.tries(Scene(), lambda _: True)
    _, course = next(tries)
    course.before = SimpleNamespace(approach=0.0)  # type: ignore[assignment]
    way, _ = tries.send(lost)
    assert way.goes_on
    course.searched = True
    way, _ = tries.send(there)
    assert not way.goes_on, "all begin again to record the way"
    with pytest.raises(StopIteration) as end:
        tries.send(there)
    assert end.value.value.report.ended_by is PressEnd.FORCE


@pytest.mark.parametrize(
    ("first_um", "second_um", "halved", "kept_um"), [(30, 12, 0, 12), (30, 40, 0, 30), (19, None, 0, 19), (30, None, 1, 30)]
)
def test_a_press_that_overlaps_has_twice_the_points_and_the_closer_of_both_is_kept(
    first_um: float, second_um: float | None, halved: int, kept_um: float, deformation: Deformation
) -> None:
    """One that overlaps little, or came to its end with trouble, is left as it is."""

    def press(micrometres: float, steps_halved: int = 0) -> Deformation:
        overlap = np.full_like(deformation.penetration, micrometres * 1e-6)
        return replace(deformation, penetration=overlap, report=SolveReport(ended_by=PressEnd.DEPTH, steps_halved=steps_halved))

    tries = strategy.tries(Scene(object=Body(rigid=True), fidelity="fast"))
    next(tries)
    given = [press(first_um, steps_halved=halved)]
    if second_um is not None:
        way, course = tries.send(given.pop())
        assert (way.contact_points, way.goes_on, way.held) == (48, False, 0.0)
        assert course.found is not None and course.found[0] == deformation.approach[-1]
        given = [press(second_um)]
    with pytest.raises(StopIteration) as end:
        tries.send(given.pop())
    kept = end.value.value
    assert np.isclose(kept.penetration.max(), kept_um * 1e-6)
    assert kept.report.contact_points == (48 if kept_um == second_um else 24)


def test_each_mesh_is_another_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    def mesh_object(*_: object, drawn_before: int) -> None:
        raise _Asked(drawn_before)

    monkeypatch.setattr("gelsim.mesh.body_mesh.mesh_object", mesh_object)
    with pytest.raises(_Asked, match="5"):
        stages._bodies(build_scene({}), frozenset(), stages.Record(), 5)  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize("batched", [False, True])
def test_a_step_that_begins_by_turning_elements_inside_out_is_halved_at_once(batched: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most of the gel's thickness in one step, by one press and in a batch: one iteration is lost, not a solve of a dozen."""
    monkeypatch.setattr(quasistatic, "FIRST_STEP", 0.6 * MM)
    reports: list[NewtonReport] = []
    count = quasistatic._March._count

    def counted(march: quasistatic._March, report: NewtonReport) -> None:
        reports.append(report)
        count(march, report)

    monkeypatch.setattr(quasistatic._March, "_count", counted)
    problem = driven(0.6, 2, 0.7)
    press = run_batch([problem])[0] if batched else run_press(problem)
    lost = [report.iterations for report in reports if report.status is not SolveStatus.CONVERGED]
    assert press.status is SolveStatus.CONVERGED
    assert press.report.steps_halved == len(lost) > 0 and set(lost) == {1}
