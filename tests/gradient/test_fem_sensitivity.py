"""The derivatives of a press against central differences of presses solved anew, as vectors."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from fem_fixtures import Array, ball_scene, cap_scene, flat_gel, problem_of, rigid_body, soft_cap

from gelsim.errors import SceneError
from gelsim.fem import sensitivity
from gelsim.fem.problem import PressProblem
from gelsim.fem.sensitivity import Linearised, press_sensitivity
from gelsim.pipeline import stages
from gelsim.results import PressSensitivity
from gelsim.scene.definition import Contact

GEL = 50.0  # kPa
OBJECTS = {"rigid": None, "stiff": 100.0, "soft": 30.0}  # kPa; contact's penalty follows the softer body
DEPTH = 0.4  # mm
STEP = 1e-3  # relative, of the differences: the states are smooth but for points that come into contact, of second order
# Differences: STEP² of a third derivative of order one, and TOLERANCE/STEP of noise. Points that enter make kinks in the second derivative:
# STEP of a few percent.
SAME = 5e-5
PLACES = 0.0, 1.4, 4.0  # mm from the axis: under the object, at its rim, in the free surface


def problem(gel_kpa: float, object_kpa: float | None, depth: float) -> PressProblem:
    if object_kpa is None:
        scene, gel = ball_scene(depth, 3, modulus_kpa=gel_kpa), flat_gel(0.5, 2.5)
        return problem_of(scene, gel, rigid_body(scene, gel))
    return problem_of(cap_scene(object_kpa, depth, 3, gel_kpa=gel_kpa), flat_gel(0.7, 2.1), soft_cap())


def solve(gel_kpa: float, object_kpa: float | None, depth: float) -> PressSensitivity:
    made = problem(gel_kpa, object_kpa, depth)
    top = np.unique(made.gel.groups["coated"])
    away = np.hypot(*made.solids.rest[top, :2].T)
    heights = [(top[[np.argmin(np.abs(away - place))]], np.ones(1)) for place in PLACES]
    return press_sensitivity(made, [gel_kpa] if object_kpa is None else [gel_kpa, object_kpa], heights)


@lru_cache
def press_of(which: str) -> PressSensitivity:
    return solve(GEL, OBJECTS[which], DEPTH)


@lru_cache
def differences_of(which: str) -> tuple[Array, Array]:
    """Of force and heights in the last state by the three parameters, as of `PressSensitivity`; 0 by a modulus that is not there."""
    at = [GEL, OBJECTS[which], DEPTH]
    force, height = np.zeros(3), np.zeros((len(PLACES), 3))
    for number, value in enumerate(at):
        if value is not None:
            there, back = (solve(*at[:number], value * (1 + sign * STEP), *at[number + 1 :]) for sign in (1, -1))  # type: ignore[arg-type]
            force[number] = (there.force[-1] - back.force[-1]) / (2 * STEP * value)
            height[:, number] = (there.height[-1] - back.height[-1]) / (2 * STEP * value)
    return force, height


def assert_is_derivative(found: PressSensitivity, which: str) -> None:
    """Column by column: a modulus's numbers are a thousandth of the depth's."""
    force, height = differences_of(which)
    for column in range(3):
        assert abs(found.force_gradient[-1, column] - force[column]) <= SAME * force[column]
        size = np.linalg.norm(height[:, column])
        if which == "rigid" and column < 2:  # a gel alone keeps its shape whatever its modulus
            assert not found.height_gradient[-1, :, column].any()
        else:
            assert size > (1e-7 if column < 2 else 1e-4)
            assert np.linalg.norm(found.height_gradient[-1, :, column] - height[:, column]) <= SAME * size


@pytest.mark.parametrize("which", OBJECTS)
def test_is_the_derivative_of_the_press(which: str) -> None:
    assert_is_derivative(press_of(which), which)


def test_depth_of_states_along_the_way() -> None:
    """The gradient by the approach at two states, against the chord between them: by the trapezoidal rule for F ~ d^1.5."""
    found = press_of("rigid")
    slopes = found.force_gradient[1:, 2]
    # the rule is off by h²/12 F'''/F' of the mean slope: 0.2²/12·0.75·… under 2 % for exponents between 1.3 and 2
    assert slopes.mean() == pytest.approx((found.force[2] - found.force[1]) / (DEPTH / 2), rel=0.02)


def along_forces(a: Linearised) -> None:
    """The forces' directions for the gaps' derivatives."""

    def changes(w: Array) -> Array:
        found = np.zeros(len(a.problem.contact.rest_weight))
        found[a.active] = a.direction @ w
        return found

    a.gap_changes = changes


FAULTS = {
    "multipliers held": ("rigid", lambda a: setattr(a, "carrying", np.zeros_like(a.carrying))),
    "forces a tenth too small": ("rigid", lambda a: setattr(a, "direction", 0.9 * a.direction)),
    "a matrix 0.1 % off": ("rigid", lambda a: setattr(a, "upper", 0.999 * a.upper)),
    "a symmetric matrix": ("stiff", lambda a: setattr(a, "rest", None)),
    "gaps along forces": ("stiff", along_forces),
    "the penalty held": ("soft", lambda a: setattr(a, "by_penalty", 0.0 * a.by_penalty)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_found(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, (which, spoil) = Linearised.__init__, FAULTS[fault]

    def init(self: Linearised, made: PressProblem) -> None:
        whole(self, made)
        spoil(self)

    monkeypatch.setattr(Linearised, "__init__", init)
    with pytest.raises(AssertionError):
        assert_is_derivative(solve(GEL, OBJECTS[which], DEPTH), which)


def test_a_modulus_a_thousandth_off_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = sensitivity.object_part
    monkeypatch.setattr(sensitivity, "object_part", lambda *arguments: 1.001 * whole(*arguments))
    with pytest.raises(AssertionError):
        assert_is_derivative(solve(GEL, OBJECTS["stiff"], DEPTH), "stiff")


def test_one_factorisation_and_few_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    solves = []
    answer = Linearised.answer

    def counted(self: Linearised, *given: Array) -> tuple[Array, Array]:
        before = self.solves, self.problem.newton.system.factorisations
        result = answer(self, *given)
        solves.append(self.solves - before[0])
        assert self.problem.newton.system.factorisations == before[1]
        return result

    monkeypatch.setattr(Linearised, "answer", counted)
    solve(GEL, OBJECTS["stiff"], DEPTH)
    assert len(solves) == 2 * 2 and max(solves) <= 20


def test_friction_is_refused() -> None:
    scene = ball_scene(0.2, 2).replace(contact=Contact(friction_coefficient=0.5))
    with pytest.raises(SceneError, match="friction_coefficient = 0.5"):
        press_sensitivity(problem_of(scene, flat_gel(), rigid_body(scene, flat_gel())), [50.0], [])
    with pytest.raises(SceneError, match="points_mm: point 2 .* off the gel"):
        stages.press_sensitivity(scene, [(0.0, 0.0), (13.0, 0.0)])
