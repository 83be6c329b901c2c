"""Mirrored scenes give mirrored presses, a quarter gives what the whole gives, turning the scene turns the press, and it does not matter in
which precision Newton's matrices are factorised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_fixtures import TOLERANCE, Array, ball_press, ball_scene, cap_press, cap_scene, flat_gel, problem_of, soft_cap, solved

from gelsim.fem.linear import find_mkl, float64_factors
from gelsim.results import Deformation

# Two presses that should be equal end at different points within Newton's tolerance; friction remembers it from step to step.
SAME = 100 * TOLERANCE


def mirrored(press: Deformation, axis: int) -> tuple[Array, Array]:
    """Force and gel displacement of the mirror image, nodes in the order of their mirrored rest positions."""
    sign = np.ones(3)
    sign[axis] = -1
    return press.force * sign, press.gel.displacement[:, by_place(press.gel.rest * sign)] * sign


def by_place(points: Array) -> Array:
    """An order of points that their coordinates decide."""
    return np.lexsort(np.round(points * 1e9).T)


def assert_same(press: Deformation, force: Array, displacement: Array) -> None:
    """`displacement` in the order of `by_place`."""
    assert np.abs(press.force - force).max() <= SAME * np.abs(force).max()
    found = press.gel.displacement[:, by_place(press.gel.rest)]
    assert np.abs(found - displacement).max() <= SAME * np.abs(displacement).max()


def leaning(sign: float, friction: float = 0.4) -> Deformation:
    """A ball off the middle, tilted and sheared in x; a coarse gel that is its own mirror image."""
    scene = ball_scene(0.3, 4, friction=friction, offset_mm=(sign * 0.4, 0.0), tilt_deg=(0.0, sign * 8.0), shear_mm=(sign * 0.2, 0.0))
    return ball_press(scene, 0.7, 2.1, whole="x")[1]


def test_mirrored_scene_is_mirrored() -> None:
    there, back = leaning(1.0), leaning(-1.0)
    assert abs(there.force[-1, 0]) > 0.05 * abs(there.force[-1, 2]), "a symmetrical press would prove nothing"
    force, displacement = mirrored(back, 0)
    assert_same(there, force, displacement)
    with pytest.raises(AssertionError):  # negative control: not mirrored, it is another press
        assert_same(there, back.force, back.gel.displacement[:, by_place(back.gel.rest)])


def test_quarter_and_half_agree_for_a_soft_object() -> None:
    scene = cap_scene(100.0, 0.3, 3)
    quarter, half = cap_press(scene)[1], cap_press(scene, whole="x")[1]
    assert_same(half, quarter.force, quarter.gel.displacement[:, by_place(quarter.gel.rest)])
    for name in ("contact_area", "min_jacobian"):
        assert getattr(half, name) == pytest.approx(getattr(quarter, name), rel=10 * SAME)


@pytest.mark.parametrize("friction", [0.0, 0.5, "stick"])
def test_quarter_and_whole_agree(friction: float | str) -> None:
    scene = ball_scene(0.3, 3, friction=friction)
    quarter, whole = ball_press(scene, 0.7, 2.1)[1], ball_press(scene, 0.7, 2.1, whole="xy")[1]
    assert len(quarter.gel.rest) == len(whole.gel.rest)
    assert_same(whole, quarter.force, quarter.gel.displacement[:, by_place(quarter.gel.rest)])
    assert (np.abs(whole.force[:, :2]) <= SAME * np.abs(whole.force[-1, 2])).all()


def test_turned_scene_is_turned() -> None:
    """Shear along y on a gel whose mesh is its own image under x ↔ y is shear along x turned: x ↔ y and nothing else."""
    scene = ball_scene(0.3, 4, friction=0.4, shear_mm=(0.2, 0.0))
    along_x = ball_press(scene, 0.7, 2.1, whole="x")[1]
    along_y = ball_press(replace(scene, press=replace(scene.press, shear_mm=(0.0, 0.2))), 0.7, 2.1, whole="y")[1]
    swap = [1, 0, 2]
    force = along_y.force[:, swap]
    # the gel's mesh is symmetrical; the ball's facets are 0.25 mm wide and quadratic: they differ from the sphere by nanometres
    assert np.abs(along_x.force - force).max() <= 2e-3 * np.abs(force).max()
    displacement = along_y.gel.displacement[:, by_place(along_y.gel.rest[:, swap])][..., swap]
    found = along_x.gel.displacement[:, by_place(along_x.gel.rest)]
    # ... which friction remembers; a micrometre of 0.3 mm
    assert np.abs(found - displacement).max() <= 4e-3 * np.abs(displacement).max()


@pytest.mark.skipif(find_mkl() is None, reason="no MKL here: nothing is factorised in float32")
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_float32_and_float64_factors_agree(friction: float) -> None:
    scene = cap_scene(100.0, 0.3, 4, friction=friction)
    single = cap_press(scene)[1]
    with float64_factors():
        double = solved(problem_of(scene, flat_gel(0.7, 2.1), soft_cap()))[1]
    assert "float32" in str(single.report.linear_solver) and "float32" not in str(double.report.linear_solver)
    # A step is off by under 1e-4 of itself, and the last one begins at a residual of 0.05 or less (CHORD_BELOW): the same path.
    assert 0 < np.abs(single.force - double.force).max() <= 1e-4 * 0.05 * np.abs(double.force).max()
    assert (single.newton_iterations == double.newton_iterations).all()
