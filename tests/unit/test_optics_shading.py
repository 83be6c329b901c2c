"""The camera's shading and gamma against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gelsim.errors import SceneError
from gelsim.optics.isp import develop
from gelsim.optics.shading import shading_basis, shading_gain
from gelsim.optics.srgb import srgb_tone
from gelsim.scene.definition import Camera, Render, Scene


def test_terms_stand_in_the_documented_order():
    basis = shading_basis(np.array([2.0]), np.array([3.0]), 3)[0]
    assert basis.tolist() == [2, 3, 4, 6, 9, 8, 12, 18, 27]
    assert shading_basis(np.zeros(5), np.zeros(5), 0).shape == (5, 0)


def test_gain_of_a_slope_and_of_none():
    # Degree 1: red doubles from the left edge to the right one, green halves from top to bottom, blue stays.
    half = np.log(2) / 2
    scene = Scene(camera=Camera(shading=(half, 0, 0, 0, -half, 0)), render=Render(resolution=(64, 32)))
    gain = shading_gain(scene)
    assert gain.shape == (32, 64, 3) and np.all(gain[..., 2] == 1)
    assert gain[0, -1, 0] / gain[0, 0, 0] == pytest.approx(2 ** (63 / 64)) and np.ptp(gain[:, 5, 0]) == 0
    assert gain[-1, 0, 1] / gain[0, 0, 1] == pytest.approx(2 ** -(31 / 32))
    assert shading_gain(Scene()).shape == (1, 1, 3)


def test_shading_and_gamma_reach_the_picture():
    scene = Scene(camera=Camera(gamma=1.5, shading=(0.0, 0, 0, 0, np.log(2), 0)), render=Render(resolution=(32, 32)))
    picture = develop(scene, np.full((32, 32, 3), 0.2, np.float32))
    expected = 255 * srgb_tone(0.2 * 2 ** np.array([-31 / 32, 31 / 32])) ** 1.5
    # Rounded to whole levels.
    assert picture[[0, -1], 0, 1] == pytest.approx(expected, abs=0.51)
    assert picture[..., 0] == pytest.approx(255 * srgb_tone(np.array(0.2)) ** 1.5, abs=0.51)


def test_numbers_that_make_no_polynomial_are_refused():
    with pytest.raises(SceneError, match="camera.shading has 9 numbers.*6, 15, 27"):
        Scene(camera=Camera(shading=(0.0,) * 9))
