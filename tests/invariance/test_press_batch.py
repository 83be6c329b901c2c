"""A press gives the same in a batch as by itself, whatever its neighbours do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import warp as wp

from gelsim.errors import PressEnd, SolveStatus
from gelsim.fem import solve_batch
from gelsim.fem.batch import Costs, _Batch, run_batch
from gelsim.fem.contact import LEFT_MM
from gelsim.fem.krylov import BatchedGmres
from gelsim.fem.linear import SHIFTS, BatchedSystem, SymmetricSystem, find_mkl
from gelsim.fem.newton import NewtonOptions, Residual
from gelsim.fem.problem import MOST_WASTED, Numerics, PressProblem
from gelsim.fem.quasistatic import PACE, SOON, Course, Request
from gelsim.fem.strategy import WAYS
from gelsim.pipeline import stages
from gelsim.results import Deformation, SolveReport
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene
from gelsim.scene.materials import press_materials

# A press by itself is solved on factors of its own, in a batch on older ones: the multipliers take over from another rough solve, so that
# the two end elsewhere, as a step may leave LEFT_MM either way. Found: 0.5 µm at a node and less.
SAME_SURFACE = LEFT_MM * 1e-3
# All presses of a batch get new factors where the pattern that they share grows, by a neighbour's contact too, and rough steps on other
# factors lead elsewhere within Newton's tolerance: up to 0.11 µm root mean square and 1.2 µm at a node where the five stand in the opposite
# order. Where patterns grow alike nothing is moved by more than 1e-12 µm.
UNMOVED = 0.5e-6


def scene(modulus: float, friction: float | str = 0.0, **press: object) -> Scene:
    return build_scene(
        {
            "fidelity": "fast",
            "gel": {"profile": "flat", "youngs_modulus_kpa": 50.0},
            "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": modulus},
            "contact": {"friction_coefficient": friction},
            "press": {"depth_mm": 0.6, "force_n": "none", "frames": 4, "symmetry": "mirror"} | press,
        }
    )


def alone(one: Scene) -> Deformation:
    return stages.press(one, device="cpu", throw=False)


def same_force(one: Deformation, other: Deformation) -> bool:
    """Within what LEFT_MM of approach changes, and 1e-3 that Newton leaves unbalanced at `fast`, twice."""
    stiffness = np.abs(np.diff(one.force, axis=0) / np.diff(one.approach)[:, None]).max()
    scale = np.abs(one.force).max()
    allowed = SAME_SURFACE * stiffness + 2e-3 * scale
    assert allowed < 0.015 * scale  # or it would say nothing
    return bool(np.abs(one.force - other.force).max() < allowed)


SCENES = [scene(30.0), scene(600.0), scene(200.0, 0.5), scene(100.0, "stick"), scene(200.0, force_n=0.05)]
"""Soft and hard, with and without friction, one that stops at a force."""


@pytest.fixture(scope="module")
def together() -> list[Deformation]:
    return stages.press_batch(SCENES, device="cpu")


def test_neighbours_do_not_matter(together: list[Deformation]) -> None:
    others = [scene(45.0), scene(300.0), scene(120.0, 0.3), scene(70.0, "stick"), scene(250.0, 0.2)]
    for kept in ((0, 2, 4), (1, 3)):
        again = stages.press_batch([SCENES[i] if i in kept else others[i] for i in range(5)], device="cpu")
        for i, (one, press) in enumerate(zip(together, again, strict=True)):
            assert one.status is SolveStatus.CONVERGED
            if i not in kept:  # planted: another press is seen
                assert np.abs(press.force[-1] - one.force[-1]).max() > 0.01 * np.abs(one.force).max()
                apart = np.linalg.norm(one.gel.displacement[-1] - press.gel.displacement[-1], axis=1)
                assert np.sqrt(np.mean(apart**2)) > 2 * UNMOVED
                continue
            # a force is sought to FORCE_TOLERANCE, 2e-3, and balanced to 1e-3 at `fast`
            assert press.approach == pytest.approx(one.approach, rel=2e-3)
            apart = np.linalg.norm(one.gel.displacement - press.gel.displacement, axis=2)
            assert np.sqrt(np.mean(apart**2, axis=1)).max() < UNMOVED
            assert press.force == pytest.approx(one.force, rel=0, abs=3e-3 * np.abs(one.force).max())


def test_a_batch_gives_what_presses_by_themselves_give(together: list[Deformation]) -> None:
    for one, press in zip(SCENES, together, strict=True):
        single = alone(one)
        assert np.abs(single.force).max() > 1e-3
        assert press.approach == pytest.approx(single.approach, rel=5e-3)  # a force is met within FORCE_TOLERANCE, 2e-3
        if one.press.force_n is None:
            assert same_force(single, press)
            assert np.linalg.norm(press.gel.displacement[-1] - single.gel.displacement[-1], axis=1).max() < SAME_SURFACE
    assert together[4].force[-1, 2] == pytest.approx(-0.05, rel=4e-3)
    # planted: the presses do differ from each other by far more
    other = np.linalg.norm(together[0].gel.displacement[-1] - together[3].gel.displacement[-1], axis=1)
    assert np.sqrt(np.mean(other**2)) > 3 * SAME_SURFACE
    assert np.abs(together[0].force - together[1].force).max() > 0.1 * np.abs(together[1].force).max()


def test_a_press_that_fails_leaves_the_others_alone() -> None:
    good = scene(200.0)
    problems = [PressProblem(good, *stages.bodies(good), press_materials(good), "cpu") for _ in range(2)]
    problems[0].options = NewtonOptions(tolerance=1e-30, max_iterations=3)  # never there
    lost, kept = run_batch(problems)
    single = alone(good)
    assert lost.status is SolveStatus.MAX_ITERATIONS and "press stopped at approach" in lost.message
    assert len(lost.approach) == 1
    assert kept.status is SolveStatus.CONVERGED
    assert same_force(single, kept)


def test_what_fails_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `solve_press` does: those that failed, and one to a force that found no equilibrium on its way. The other is left as it is."""
    asked: list[list[tuple[int, float, float]]] = []
    patience: list[list[tuple[int, bool]]] = []

    def run(problems: list[PressProblem], *, courses: list[Course], progress: Callable[[int, int], None], costs: None) -> list[Deformation]:
        asked.append([(p.contact.points, p.law.stiffness, p.law.friction) for p in problems])
        patience.append([(p.most_wasted, p.options.patient) for p in problems])
        progress(len(problems), len(problems))
        lost, done = (SolveStatus.CONVERGED, PressEnd.LOST), (SolveStatus.CONVERGED, PressEnd.DEPTH)
        stopped = (SolveStatus.MAX_ITERATIONS, PressEnd.LOST)
        first = [(SolveStatus.CONVERGED, PressEnd.LIMIT), stopped, lost, lost]
        ends = [first, [done, lost, lost], [done, lost]][len(asked) - 1]
        farther = len(asked) * solved.approach
        for course, (_, end) in zip(courses, ends, strict=True):
            if end is PressEnd.LOST:
                course.before = cast(Any, SimpleNamespace(approach=0.5e-3))
        return [replace(solved, status=status, approach=farther, report=SolveReport(ended_by=end)) for status, end in ends]

    scenes = [scene(100.0), scene(45.0, friction="stick"), scene(400.0, friction=0.3), scene(45.0, friction=0.1)]
    told: list[tuple[int, int]] = []
    solved = alone(scenes[0])
    monkeypatch.setattr("gelsim.fem.batch.run_batch", run)
    bodies = [(one, *stages.bodies(one)) for one in scenes]
    presses = solve_batch(bodies, device="cpu", progress=lambda done, count: told.append((done, count)))
    # the next goes on with volume held, those after it begin at rest
    assert [[one[0] for one in tries] for tries in asked] == [[48] * 4, [48] * 3, [48] * 2]
    # what another follows gives up sooner
    assert patience == [[(SOON, False)] * 4, [(SOON, False)] * 3, [(MOST_WASTED, True)] * 2]
    assert asked[1][0][1] == asked[0][1][1] != asked[0][0][1]  # the second one's, by the softer body
    assert [press.report.tried for press in presses] == [1, 2, 3, 3]
    assert [press.report.contact_points for press in presses] == [48, 48, 48, 48]
    assert [press.report.went_on_from_mm for press in presses] == [(), (0.5,), (), ()]
    # with the friction that was asked for
    assert [[one[2] for one in tries] for tries in asked] == [[0.0, -1.0, 0.3, 0.1], [-1.0, 0.3, 0.1], [0.3, 0.1]]
    said = ["\n".join(press.report.warnings) for press in presses]
    assert ["from 0.5 mm on" in one for one in said] == [False, True, False, False]
    assert told[-1] == (4, 4)


def test_who_goes_on_and_how_long_each_may_fail() -> None:
    """The last has all its patience; a rigid body's first more than a soft one's."""
    for kind, first in (("soft", SOON), ("rigid", PACE)):
        assert [(way.goes_on, way.most_wasted) for way in WAYS[kind]] == [(False, first), (True, SOON), (False, MOST_WASTED)]


@pytest.mark.skipif(find_mkl() is None, reason="SuperLU does not count negative eigenvalues")
def test_a_saddle_is_made_stiffer() -> None:
    """A scene whose matrix has a negative eigenvalue too many gets stiffer displacements until it has none; its neighbours do not."""
    one = scene(200.0)
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for _ in range(2)]
    batch = _Batch(problems, None)
    batch.residual()
    batch._assemble(np.ones(2, bool))
    both = np.ones(2, bool)
    batch._factorise(both)
    batch._convexify(both, wp.clone(batch.values), both)
    assert (batch.factorisations == 1).all(), "at rest a body is at a minimum"

    rows = batch.values.numpy().reshape(2, -1)
    stiff = batch._stiff.numpy()
    assert (rows[0, stiff] > 0).all() and len(stiff) == batch._single.free[:, :3].sum()
    turned = rows.copy()
    turned[1, stiff[7]] = -1e-2 * rows[1, stiff].max()  # a shift takes its share of the size, so no shift of up to a half turns this
    batch.values.assign(turned.ravel())
    batch._factorise(both)
    batch._convexify(both, wp.clone(batch.values), both)
    after = batch.values.numpy().reshape(2, -1)
    assert (after[0] == turned[0]).all()
    assert after[1, stiff] == pytest.approx(turned[1, stiff] + SHIFTS[-1] * np.abs(turned[1, stiff]))
    others = np.setdiff1d(np.arange(after.shape[1]), stiff)
    assert (after[1, others] == turned[1, others]).all()
    assert batch.factorisations.tolist() == [2, 2 + len(SHIFTS)]
    batch.values.assign(turned.ravel())
    batch._factorise(both)
    batch._convexify(both, wp.clone(batch.values), both)
    assert batch.factorisations.tolist() == [3, 2 + len(SHIFTS) + 1 + 2], "it begins below the one that was needed last"


@pytest.mark.skipif(find_mkl() is None, reason="SuperLU does not count negative eigenvalues")
def test_a_saddle_keeps_its_shift_while_a_neighbour_needs_a_larger_one() -> None:
    one = scene(200.0)
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for _ in range(2)]
    batch, both = _Batch(problems, None), np.ones(2, bool)
    batch.residual()
    batch._assemble(both)
    rows, stiff = batch.values.numpy().reshape(2, -1).copy(), batch._stiff.numpy()
    batch.values.assign(rows.ravel())
    batch._factorise(both)
    saddles = iter([both.copy(), np.array([False, True]), np.array([False, False])])
    batch._at_saddle = lambda: next(saddles)
    batch._convexify(both, wp.clone(batch.values), both)
    after = batch.values.numpy().reshape(2, -1)
    for mine, share, before in zip(after, SHIFTS, rows, strict=False):
        assert mine[stiff] == pytest.approx(before[stiff] + share * np.abs(before[stiff]))
    assert batch.stiffened.tolist() == [0, 1]


@pytest.mark.skipif(find_mkl() is None, reason="SuperLU does not count negative eigenvalues")
def test_a_step_beyond_its_reach_is_made_shorter_alone_and_in_a_batch() -> None:
    """To where shifts can bring it; a neighbour that is not wanted keeps its own. `far` is what they differ by without."""
    one = scene(200.0)
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for _ in range(3)]
    alone, pair = problems[0], problems[1:]
    batch, both, first = _Batch(pair, None), np.ones(2, bool), np.array([True, False])
    for problem in problems:
        displacement, pressure = (field.copy() for field in problem.solids.state())
        displacement[problem.object_nodes, 2] -= 0.05
        problem.solids.set_state((displacement, pressure))
    newton = alone.newton
    residual = newton.residual(1.0)
    newton.system.update(newton.tangent(False))
    far = newton.system.step(-residual.equations, None, exact=True)
    moves = newton.displacement_unknown > 0.0
    reach = 0.9 * np.abs(far[moves]).max()
    newton.system.update(newton.tangent(False))
    short = newton.system.step(-residual.equations, None, exact=True, reach=reach)
    assert newton.system.downhill and np.abs(short[moves]).max() <= reach

    batch.residual()
    batch.iteration[:] = batch.exact_after
    batch._assemble(np.zeros(2, bool))
    values = wp.clone(batch.values)
    batch._factorise(both)
    batch._convexify(both, values, np.zeros(2, bool))
    batch._solve(both)
    batch.contact.turns_within = reach
    batch._shorten(first, values, np.zeros(2, bool))
    steps = -batch.step.numpy().reshape(2, -1)
    scale = np.abs(far).max()
    assert batch.downhill.tolist() == [True, False]
    assert np.abs(far - short).max() > 0.02 * scale
    assert np.abs(steps[0] - short).max() <= 2e-3 * scale and np.abs(steps[1] - far).max() <= 2e-3 * scale


@pytest.mark.skipif(find_mkl() is None, reason="SuperLU does not count negative eigenvalues")
def test_a_saddle_by_itself_begins_below_its_last_shift() -> None:
    """The twin of the batch's: a diagonal of which one displacement pulls, by 0.03 of what is added at the third shift."""
    system = SymmetricSystem(np.array([True, True, False]))
    system.analyse(np.arange(4, dtype=np.int32), np.arange(3, dtype=np.int32))
    counts = []
    for _ in range(2):
        before = system.factorisations
        system.update(np.array([1.0, -1.0, -1.0]))
        system.step(np.array([1.0, 1.0, 1.0]), None, exact=True)
        counts.append(system.factorisations - before)
    assert counts == [1 + len(SHIFTS), 2]


def test_a_way_down_from_a_saddle_is_lengthened_alone_and_in_a_batch() -> None:
    """A 32nd of Newton's step is doubled until an eighth of the slope is gone and more, at 8 of them; where no saddle was it is left."""
    one = scene(200.0)
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for _ in range(3)]
    alone, pair = problems[0], problems[1:]
    batch, both = _Batch(pair, None), np.ones(2, bool)
    for problem in problems:
        displacement, pressure = (field.copy() for field in problem.solids.state())
        displacement[problem.object_nodes, 2] -= 0.05
        problem.solids.set_state((displacement, pressure))
    starts = [problem.solids.state()[0] for problem in problems]

    newton = alone.newton
    residual = newton.residual(1.0)
    newton.system.update(newton.tangent(False))
    step = newton.system.step(-residual.equations, None, exact=False) / 32
    for downhill, fraction in ((False, 1.0), (True, 8.0)):
        alone.solids.set_state((starts[0], np.zeros(alone.solids.node_count)))
        assert newton._line_search(step, residual, 1.0, exact=True, whole=False, downhill=downhill)[1] == fraction

    before = batch.residual()
    batch._assemble(np.zeros(2, bool))
    batch._factorise(both)
    batch._solve(both)
    batch.step.assign(batch.step.numpy() / 32)
    batch.downhill[:] = False, True
    batch._line_search(both, before)
    short, long = (problem.solids.state()[0] - start for problem, start in zip(pair, starts[1:], strict=True))
    assert np.abs(short).max() > 0.0
    assert long == pytest.approx(8.0 * short, rel=1e-6, abs=1e-12)


def test_patience_is_the_same_alone_and_in_a_batch() -> None:
    """A residual that stays: a patient solve takes all iterations there are, another, or a brief one, ends where exact steps do nothing."""
    one = scene(200.0)
    for patient, brief in ((True, False), (True, True), (False, False)):
        problem = PressProblem(one, *stages.bodies(one), press_materials(one), "cpu", Numerics(patient=patient))

        def stays(*given: Any, residual: Callable[..., Residual] = problem.newton.residual, **named: Any) -> Residual:
            return replace(residual(*given, **named), imbalance=1.0)

        problem.newton.residual = stays
        wanted = 30 if patient and not brief else 14
        assert problem.newton.solve(1.0, brief=brief).iterations == wanted
        ended: list[int] = []
        batch = _Batch([problem], None)
        batch._take(0, Request(1.0, brief=brief))
        for number in range(40):
            batch.iteration[0] = number
            residual = batch.residual()
            residual.imbalance[0] = residual.volume_error[0] = 1.0
            if (report := batch._ended(0, residual)) is not None:
                ended.append(report.iterations)
                break
        assert ended == [wanted]


class NoGood:
    """Factors on a GPU that are of no use for the second system: their answers are `wrong` times the right ones."""

    name, factor_entries = "no good", 0

    def __init__(self, wrong: float) -> None:
        self.negative = np.full(2, -1)
        self.right, self.wrong, self.factorised = BatchedSystem(2, "cpu"), wrong, np.zeros(2, int)

    def analyse(self, indptr: np.ndarray, indices: np.ndarray) -> None:
        self.right.analyse(indptr, indices)

    def factorise(self, values: wp.array, which: np.ndarray) -> None:
        self.right.factorise(values, which)
        self.factorised += which

    def solve(self, b: wp.array, x: wp.array, which: np.ndarray) -> None:
        self.right.solve(b, x, which)
        if which[1]:
            both = x.numpy().reshape(2, -1).copy()
            both[1] *= self.wrong
            x.assign(both.ravel())


@pytest.mark.parametrize("wrong", [0.0, np.nan])
def test_factors_of_no_use_are_replaced(wrong: float, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [scene(30.0, frames=3), scene(200.0, 0.5, frames=3)]
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for one in scenes]
    batch, no_good = _Batch(problems, None), NoGood(wrong)
    monkeypatch.setattr(batch.system, "_cudss", no_good)
    monkeypatch.setattr(batch.system, "_direct", [None, None])
    grow, patterns = batch._grow, 0

    def counted() -> None:
        nonlocal patterns
        patterns += 1
        grow()

    monkeypatch.setattr(batch, "_grow", counted)
    for press, one in zip(batch.run(None, None), scenes, strict=True):
        assert press.status is SolveStatus.CONVERGED
        assert same_force(alone(one), press)
        assert any("of no use" in told for told in press.report.warnings) == (one is scenes[1])
    assert batch.moved.tolist() == [False, True] and batch.system._direct[0] is None
    assert no_good.factorised[1] == 2 * patterns  # of each pattern once, and once more to be sure
    # planted: without the replacement it stops
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for one in scenes]
    batch = _Batch(problems, None)
    monkeypatch.setattr(batch.system, "_cudss", NoGood(wrong))
    monkeypatch.setattr(batch.system, "_direct", [None, None])
    monkeypatch.setattr(batch.system, "distrust", np.zeros_like)
    kept, stopped = batch.run(None, None)
    assert kept.status is SolveStatus.CONVERGED and stopped.status is not SolveStatus.CONVERGED


def test_what_is_recorded_once_holds_from_then_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on CUDA: launches are kept with the arrays and numbers of their second time, and run on these. Nothing else may be among them."""
    kept: list[Callable[[], object]] | None = None

    def keeping(function: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **named: object) -> object:
            if kept is None:
                return function(*arguments, **named)
            return kept.append(partial(function, *(list(a) if isinstance(a, list) else a for a in arguments), **named))

        return call

    def refused(function: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **named: object) -> object:
            assert kept is None, f"{function.__name__} has no place in a graph"
            return function(*arguments, **named)

        return call

    def record(launches: Callable[[], None], device: str) -> Callable[[], None]:
        nonlocal kept
        kept = graph = []
        launches()
        kept = None
        return lambda: [run() for run in graph] and None

    monkeypatch.setattr("gelsim.fem.batch.REACH_MM", 0.1)  # so that the pattern grows under way
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # a GPU's tangent is one launch
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for one in SCENES[:3]]
    plain = run_batch(problems)
    for wrapper, names in ((keeping, ((wp, "launch"), (wp, "copy"), (wp.array, "zero_"), (wp.Mesh, "refit"))),
                           (refused, ((wp, "zeros"), (wp, "clone"), (wp.array, "numpy"), (wp.array, "assign")))):  # fmt: skip
        for owner, name in names:
            monkeypatch.setattr(owner, name, wrapper(getattr(owner, name)))
    problems = [PressProblem(one, *stages.bodies(one), press_materials(one), "cpu") for one in SCENES[:3]]
    batch, grown = _Batch(problems, None), []
    batch._record = record
    monkeypatch.setattr(batch.system, "analyse", lambda *pattern: grown.append(BatchedSystem.analyse(batch.system, *pattern)))
    for one, other in zip(plain, batch.run(None, None), strict=True):
        assert np.array_equal(one.gel.displacement, other.gel.displacement) and np.array_equal(one.force, other.force)
    assert len(grown) > 1
    # all that a Newton iteration consists of but GMRES, whose few launches are not worth a graph a step
    assert {name for name, graph in batch._graphs.items() if graph} == {"residual", "tangent", "trial"}


def test_scenes_of_other_meshes_are_told_apart() -> None:
    coarse = stages.bodies(scene(200.0))
    other = stages.bodies(build_scene({"fidelity": "fast", "object": {"shape": "cone"}}))
    with pytest.raises(ValueError, match="same meshes"):
        solve_batch([(scene(200.0), *coarse), (scene(200.0), *other)], device="cpu")


def test_costs_say_where_the_time_went() -> None:
    costs = Costs()
    solve_batch([(scene(200.0), *stages.bodies(scene(200.0)))], device="cpu", costs=costs)
    assert costs.unknowns > 1000 and costs.systems["factorise"] >= 1 and costs.systems["solve"] > costs.calls["residual"] / 4
    assert set(costs.seconds) >= {"residual", "tangent", "factorise", "solve", "pattern", "march", "prepare"}


def test_gmres_against_numpy() -> None:
    """Unsymmetric systems of different difficulty, side by side; one is left out, one has nothing to solve."""
    rng = np.random.default_rng(1)
    count, n = 4, 30
    matrices = rng.normal(size=(count, n, n)) * np.array([0.02, 0.1, 0.05, 0.05])[:, None, None] + np.eye(n)
    right = rng.normal(size=(count, n))
    right[3] = 0.0

    def product(v: wp.array, out: wp.array) -> None:
        out.assign(np.einsum("sij,sj->si", matrices, v.numpy().reshape(count, n)).ravel())

    def nothing(v: wp.array, out: wp.array, which: object) -> None:
        out.assign(v)

    which = np.array([True, True, False, True])
    x = wp.array(np.full(count * n, 7.0), dtype=wp.float64)
    b = wp.array(right.ravel(), dtype=wp.float64)
    used, left = BatchedGmres(count, n, "cpu").solve(product, nothing, b, x, which, 1e-3)
    found = x.numpy().reshape(count, n)
    for one in (0, 1):
        rest = np.linalg.norm(right[one] - matrices[one] @ found[one]) / np.linalg.norm(right[one])
        assert rest == pytest.approx(left[one], rel=1e-6)  # what it says of itself is true: Givens' residual is the residual
    assert left[0] <= 1e-3 and 0 < used[0] < used[1]
    assert (found[2] == 7.0).all() and used[2] == 0
    assert (found[3] == 0.0).all()


def test_what_reduces_to_a_profile_is_not_batched() -> None:
    reduced, solid = stages.press_batch([scene(200.0, symmetry="auto"), scene(200.0)], device="cpu")
    assert reduced.report.unknowns < solid.report.unknowns
    assert reduced.force[-1, 2] == pytest.approx(solid.force[-1, 2], rel=0.05)  # `fast`: within 5 % each


@pytest.mark.gpu
def test_cuda_gives_the_same() -> None:
    scenes = [scene(30.0), scene(600.0), scene(200.0, 0.5)]
    for press, single in zip(stages.press_batch(scenes, device="cuda"), map(alone, scenes), strict=True):
        assert same_force(single, press)
