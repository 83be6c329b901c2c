"""What the multipliers of contact leave of the overlap, once they stand still."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from fem_fixtures import TOLERANCE, cap_press, cap_scene, flat_gel, problem_of, rigid_body, soft_cap

from gelsim.errors import SolveStatus
from gelsim.fem.contact import LEFT_MM, ContactLaw, RigidContact, SurfaceContact
from gelsim.fem.field import exact_distance, sampled
from gelsim.fem.planar.contact import EdgeContact
from gelsim.fem.problem import PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.fem.strategy import EDGE_POINTS, SOFT_POINTS
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene

AUGMENTATIONS = 12


@pytest.fixture
def punch() -> PressProblem:
    """A rigid flat punch, its rim as sharp as can be, 0.2 mm in a flat gel."""
    scene = Scene(
        gel=Gel(profile="flat", youngs_modulus_kpa=50.0),
        object=Body(shape="punch", radius_mm=2.0, height_mm=5.0, rigid=True),
        contact=Contact(friction_coefficient=0.0),
        press=Press(depth_mm=0.2, force_n=None, frames=2),
        fidelity="fast",
    )
    gel = flat_gel(0.6, 3.0)
    problem = problem_of(scene, gel, rigid_body(scene, gel))
    assert run_press(problem).status is SolveStatus.CONVERGED
    return problem


def overlap_at_rest(problem: PressProblem, *left: float) -> float:
    """Largest overlap [mm] once the multipliers hardly move."""
    for _ in range(AUGMENTATIONS):
        problem.contact.augment(*left)
        assert problem.newton.solve(1.0, TOLERANCE).status is SolveStatus.CONVERGED
    return -float(problem.contact.gap.numpy().min())


def test_a_sharp_rim_keeps_the_overlap_that_it_is_granted(punch: PressProblem) -> None:
    """Where λ and what is kept stand still, k (s - ε/2) = λ + kept + what is left, at most k LEFT_MM: the gap is -(LEFT_MM + ε/2) at least.

    A tenth more, as twelve augmentations come that near. Linear multipliers alone leave 16 µm.
    """
    granted = LEFT_MM + punch.law.smoothing / 2
    assert overlap_at_rest(punch) < 1.1 * granted
    assert overlap_at_rest(punch, np.inf) > 4 * granted


LAW = ContactLaw(100.0, 5e-4, 0.0, 30.0)
FACE = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
"""Nodes of a face [mm]."""
ONE = np.arange(6, dtype=np.int32)[None]


def test_overlap_is_seen_between_the_points() -> None:
    """A ball's apex 0.05 mm deep in the middle of a side, a fifth of a side from the next point: all of it is told, to the grid's accuracy.

    Of a curvature 1/R the spline's samples keep (2 spacing/R)² spacing²/3R (`field.PER_RADIUS`): 0.06 µm here; 1 µm is asked for.
    """
    radius, deep, step = 1.0, 0.05, 0.05
    ball = exact_distance(Body(shape="hemisphere", rigid=True, radius_mm=radius))
    field = sampled(ball, np.array([-2.5, -2.5, -0.5]), np.array([2.5, 2.5, 1.0]), step, step)
    frame = np.vstack([np.zeros(3), RigidContact.SIDE * np.eye(3)]) + [1.0, 0.0, -deep]
    x = np.vstack([FACE, frame])
    contact = RigidContact(ONE, np.arange(6, 10), x, field, LAW, "cpu")
    positions = wp.array(x, dtype=wp.vec3d, device="cpu")
    contact.update(positions, 1.0)
    assert contact.overlap(positions) == pytest.approx(deep, abs=1e-3)
    assert -float(contact.gap.numpy().min()) < 0.6 * deep  # the planted fault: only at the points
    assert contact.points == 6 and len(contact.gap) == 6  # the contact itself is as it was


def test_overlap_of_a_soft_object_is_seen_between_the_points() -> None:
    """A bulge of a face, highest at a side's middle, where the six points see four fifths of it, and a plane at nine tenths.

    The bulge is b x y: at its top the face's normal, along which a gap is told, leans by tan⁻¹(√2 b); the overlap is the plane's distance.
    """
    bulge = 0.05
    x = np.vstack([FACE, 4 * FACE[[0, 2, 1, 5, 4, 3]] + [-2.0, -2.0, 0.9 * bulge]])
    x[4, 2] = bulge
    contact = SurfaceContact(ONE, ONE + 6, x, LAW, "cpu")
    positions = wp.array(x, dtype=wp.vec3d, device="cpu")
    contact.update(positions, 1.0)
    assert contact.overlap(positions) == pytest.approx(0.1 * bulge, rel=1e-9)
    assert float(contact.gap.numpy().min()) > 0.0  # the planted fault: only at the points


@pytest.mark.parametrize("profile", [False, True])
def test_overlap_is_the_distance_to_an_inclined_plane(profile: bool) -> None:
    """A flat face and a plane inclined by 60°, through it at x = 1.9: its end at 2 is 0.1 sin 60° inside. Planted fault: as far as its own
    normal tells, 0.1 tan 60°."""
    way = np.array([np.cos(np.radians(60)), 0.0, -np.sin(np.radians(60))])  # along the plane, down over the face
    if profile:
        x = np.vstack([np.array([[2, 0, 0], [0, 0, 0], [1, 0, 0]], float), [1.9, 0.0, 0.0] + np.outer([-4, 4, 0], way)])
        contact = EdgeContact(np.array([[1, 0, 2]], np.int32), np.array([[3, 4, 5]], np.int32), x, LAW, False)
    else:
        x = np.vstack([FACE, [1.9, 0.0, 0.0] + (4 * FACE[[0, 2, 1, 5, 4, 3], :2] - 2) @ np.array([way, [0.0, 1.0, 0.0]])])
        contact = SurfaceContact(ONE, ONE + 6, x, LAW, "cpu")
    positions = wp.array(x, dtype=wp.vec3d, device="cpu")
    contact.update(positions, 1.0)
    assert contact.overlap(positions) == pytest.approx(0.1 * np.sin(np.radians(60)), rel=1e-6)


@pytest.mark.parametrize(("points", "least", "most"), [(SOFT_POINTS, 0.0, 20e-6), (EDGE_POINTS, 50e-6, np.inf)])
def test_a_soft_object_of_shorter_faces_pokes_through_between_few_points(points: int, least: float, most: float) -> None:
    """Gel faces of 2.1 mm, the cap's of 0.8 mm: as little overlap as is asked for [m]; the planted fault: few points."""
    press = run_press(problem_of(cap_scene(30.0, 1.5, 4), flat_gel(2.1, 2.1), soft_cap(), contact_points=points))
    assert press.status is SolveStatus.CONVERGED
    assert least < press.penetration.max() < most


def test_overlap_of_a_profile_is_seen_between_the_points() -> None:
    """The same in the plane: a bulge of an edge's middle, where no Gauss point is."""
    bulge = 0.05
    x = np.array([[2, 0, 0], [0, 0, 0], [1, 0, bulge], [-1, 0, 0.95 * bulge], [3, 0, 0.95 * bulge], [1, 0, 0.95 * bulge]], float)
    contact = EdgeContact(np.array([[1, 0, 2]], np.int32), np.array([[3, 4, 5]], np.int32), x, LAW, False)
    positions = wp.array(x, dtype=wp.vec3d, device="cpu")
    contact.update(positions, 1.0)
    found = abs(contact.overlap(positions))
    assert found == pytest.approx(0.05 * bulge, rel=1e-9)
    assert -float(contact.gap.numpy().min()) < 0.5 * found


def test_the_tangent_holds_what_a_multiplier_bears_far_from_the_object() -> None:
    """A point acts where λ / k is more than its gap, however wide that is: the pattern then holds more pairs than those of near points."""
    problem, _ = cap_press(cap_scene(100.0, 0.2, 2))
    contact, newton = problem.contact, problem.newton
    newton.residual(2.0)
    gap, found = contact.gap.numpy(), contact.face.numpy() >= 0
    far = found & (gap > 0.8)
    assert far.any()
    stiffness = np.repeat(contact.stiffness.numpy(), contact.points)
    contact.multiplier.assign(np.where(far, 1.1 * gap * stiffness, contact.multiplier.numpy()))
    newton.residual(2.0)
    newton.tangent(True)
    assert int(contact.missing.numpy()[0]) == 0 and (contact.pressure.numpy()[far] > 0.0).all()


def test_a_kept_tangent_is_of_the_present_contact_and_the_solids_before() -> None:
    problem, _ = cap_press(cap_scene(100.0, 0.2, 2))
    newton, solids = problem.newton, problem.solids

    def of_solids() -> np.ndarray:
        assert newton.pattern is not None
        values = wp.zeros(len(newton.pattern.indices), dtype=wp.float64, device="cpu")
        solids.add_tangent(newton.pattern.pairs, values)
        return np.array(values.numpy())

    newton.residual(2.0)
    first, pattern = newton.tangent(True).copy(), newton.pattern
    before = of_solids()
    displacement, pressure = solids.state()
    displacement[problem.object_nodes, 2] -= 0.05
    displacement[problem.driven, 2] -= 2e-3
    solids.set_state((displacement, pressure))
    newton.residual(2.0)
    kept, whole = newton.tangent(True, kept=True).copy(), newton.tangent(True).copy()
    after = of_solids()
    assert newton.pattern is pattern
    scale = np.abs(whole).max()
    assert np.abs(kept - whole - (before - after)).max() <= 1e-13 * scale
    assert np.abs(before - after).max() > 1e-6 * scale and np.abs(kept - first).max() > 1e-6 * scale
