"""A press that cannot be solved says why, and keeps what was solved."""

from __future__ import annotations

import numpy as np
import pytest
from fem_fixtures import MM, TOLERANCE, ball_scene, flat_gel, problem_of, rigid_body

from gelsim.errors import SolveError, SolveStatus
from gelsim.fem import quasistatic
from gelsim.fem.problem import PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.results import Deformation


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch) -> PressProblem:
    """A ball that is to be driven through a gel of 1 mm on two cells: the third of four steps ends beyond the window."""
    monkeypatch.setattr(quasistatic, "SMALLEST_STEP", 1 / 4)
    scene = ball_scene(1.2, 5, radius_mm=2.0)
    scene = scene.replace(gel=type(scene.gel)(profile="flat", thickness_mm=1.5, youngs_modulus_kpa=50.0))
    gel = flat_gel(1.0, 2.0, 2, 6.0, 1.0)
    return problem_of(scene, gel, rigid_body(scene, gel))


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
    assert press.info["steps_halved"] >= 2  # to a half, to a quarter


def test_failure_as_a_value(problem: PressProblem) -> None:
    states = []
    press = run_press(problem, throw=False, progress=lambda done, total: states.append((done, total)))
    assert press.status is not SolveStatus.CONVERGED and press.message
    assert states == [(i + 1, 5) for i in range(len(press.approach))]
    # what the bodies are left in is an equilibrium, the last recorded one or one half a step on, not where Newton gave up; its multipliers
    # are the next step's already, which puts some micrometres of overlap times the penalty out of balance: per cents
    assert problem.newton.residual(2.0).imbalance < 0.1
    assert problem.support_force()[2] >= -press.force[-1, 2] * (1 - 100 * TOLERANCE)
