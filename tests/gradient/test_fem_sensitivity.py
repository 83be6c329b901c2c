"""The adjoint of a press against central differences of presses solved anew, as vectors; and against what scaling demands."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from fem_fixtures import Array, ball_scene, cap_scene, flat_gel, problem_of, rigid_body, soft_cap

from gelsim.errors import SceneError
from gelsim.fem import sensitivity
from gelsim.fem.problem import PressProblem
from gelsim.fem.sensitivity import Adjoint, press_sensitivity
from gelsim.pipeline import stages
from gelsim.results import PressSensitivity
from gelsim.scene.definition import Contact

MODULI = 50.0, 100.0  # kPa, gel and object
DEPTH = 0.4  # mm
STEP = 1e-3  # relative, of the differences: the states are smooth but for points that come into contact, of second order
# Differences: STEP² of a third derivative of order one, and TOLERANCE/STEP of noise. The tangent: what it leaves out is of first order in
# the gap (contact.py), 0.1 µm here at standstill of 400 µm. Points that enter make kinks in the second derivative: STEP of a few percent.
SAME = 2e-4
PLACES = 0.0, 1.4, 4.0  # mm from the axis: under the object, at its rim, in the free surface


OWN = {"contact_points": 12, "on_object": True}
"""How the points are where a smooth object may slide (`fem.strategy.SLIDING`)."""


def problem(rigid: bool, gel_kpa: float, object_kpa: float, depth: float, own: bool) -> PressProblem:
    """`own`: contact's points are the object's."""
    if rigid:
        scene, gel = ball_scene(depth, 3, modulus_kpa=gel_kpa), flat_gel(0.5, 2.5)
        return problem_of(scene, gel, rigid_body(scene, gel))
    scene = cap_scene(object_kpa, depth, 3, gel_kpa=gel_kpa)
    return problem_of(scene, flat_gel(0.7, 2.1), soft_cap(), **(OWN if own else {}))


def solve(
    rigid: bool, gel_kpa: float = MODULI[0], object_kpa: float = MODULI[1], depth: float = DEPTH, own: bool = False
) -> PressSensitivity:
    made = problem(rigid, gel_kpa, object_kpa, depth, own)
    top = np.unique(made.gel.groups["coated"])
    away = np.hypot(*made.solids.rest[top, :2].T)
    heights = [(top[[np.argmin(np.abs(away - place))]], np.ones(1)) for place in PLACES]
    return press_sensitivity(made, [gel_kpa] if rigid else [gel_kpa, object_kpa], heights)


@lru_cache
def adjoint_of(rigid: bool, own: bool = False) -> PressSensitivity:
    return solve(rigid, own=own)


@lru_cache
def differences_of(rigid: bool, own: bool = False) -> tuple[Array, Array]:
    """Of force and heights in the last state by the three parameters, as of `PressSensitivity`."""
    at = {"gel_kpa": MODULI[0], "object_kpa": MODULI[1], "depth": DEPTH}
    force, height = [], []
    for name, value in at.items():
        there, back = (solve(rigid, **(at | {name: value * (1 + sign * STEP)}), own=own) for sign in (1, -1))
        force.append((there.force[-1] - back.force[-1]) / (2 * STEP * value))
        height.append((there.height[-1] - back.height[-1]) / (2 * STEP * value))
    return np.array(force), np.array(height).T


def assert_is_derivative(found: PressSensitivity, rigid: bool, own: bool = False) -> None:
    """Column by column: a modulus's numbers are a thousandth of the depth's."""
    force, height = differences_of(rigid, own)
    for column in (0, 2) if rigid else (0, 1, 2):
        assert force[column] > 0
        assert abs(found.force_gradient[-1, column] - force[column]) <= SAME * force[column]
        if not (rigid and column == 0):  # a gel alone keeps its shape whatever its modulus
            size = np.linalg.norm(height[:, column])
            assert size > (1e-7 if column < 2 else 1e-4)
            assert np.linalg.norm(found.height_gradient[-1, :, column] - height[:, column]) <= SAME * size


@pytest.mark.parametrize(("rigid", "own"), [(True, False), (False, False), (False, True)])
def test_adjoint_is_the_derivative_of_the_press(rigid: bool, own: bool) -> None:
    assert_is_derivative(adjoint_of(rigid, own), rigid, own)


@pytest.mark.parametrize("rigid", [True, False])
def test_moduli_are_only_a_scale(rigid: bool) -> None:
    """Force is homogeneous of degree one in both moduli, shape of degree zero: Euler's relation at every state."""
    found = adjoint_of(rigid)
    moduli = np.array([MODULI[0], 0.0 if rigid else MODULI[1]])
    force = found.force_gradient[:, :2] @ moduli
    assert np.abs(force - found.force).max() <= 1e-6 * found.force.max()  # exact but for Newton's 1e-9 and the multipliers' 1e-8
    shape = found.height_gradient[:, :, :2] * moduli
    assert np.abs(shape.sum(-1)).max() <= 1e-5 * np.abs(found.height).max()


def test_depth_of_states_along_the_way() -> None:
    """The gradient by the approach at two states, against the chord between them: by the trapezoidal rule for F ~ d^1.5."""
    found = adjoint_of(True)
    slopes = found.force_gradient[1:, 2]
    # the rule is off by h²/12 F'''/F' of the mean slope: 0.2²/12·0.75·… under 2 % for exponents between 1.3 and 2
    assert slopes.mean() == pytest.approx((found.force[2] - found.force[1]) / (DEPTH / 2), rel=0.02)


FAULTS = {
    "multipliers held": lambda a: setattr(a, "carrying", np.zeros_like(a.carrying)),
    "a modulus 0.1 % off": lambda a: setattr(a, "equations", a.equations * [[1.001], [1.0], [1.0]]),
    "the force by the multipliers": lambda a: setattr(a, "force_by_multiplier", 0.9 * a.force_by_multiplier),
    "the base's own stiffness": lambda a: setattr(a, "force_by_parameter", a.force_by_parameter * [1.0, 1.0, 0.999]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_found(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Adjoint.__init__

    def init(self: Adjoint, *arguments: object) -> None:
        whole(self, *arguments)  # type: ignore[arg-type]
        FAULTS[fault](self)

    monkeypatch.setattr(Adjoint, "__init__", init)
    with pytest.raises(AssertionError):
        assert_is_derivative(solve(True), True)


def test_one_factorisation_and_few_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    solves = []
    gradient_of = Adjoint.gradient_of

    def counted(self: Adjoint, functional: sensitivity.Functional) -> Array:
        before = self.solves, self.problem.newton.system.factorisations
        result = gradient_of(self, functional)
        solves.append(self.solves - before[0])
        assert self.problem.newton.system.factorisations == before[1]
        return result

    monkeypatch.setattr(Adjoint, "gradient_of", counted)
    solve(False)
    assert len(solves) == 2 * (1 + len(PLACES)) and max(solves) <= 20


def test_friction_is_refused() -> None:
    scene = ball_scene(0.2, 2).replace(contact=Contact(friction_coefficient=0.5))
    with pytest.raises(SceneError, match="friction_coefficient = 0.5"):
        press_sensitivity(problem_of(scene, flat_gel(), rigid_body(scene, flat_gel())), [50.0], [])
    with pytest.raises(SceneError, match="points_mm: point 2 .* off the gel"):
        stages.press_sensitivity(scene, [(0.0, 0.0), (13.0, 0.0)])
