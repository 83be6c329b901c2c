"""How the coat follows a ball that is dragged: closed form, far field, and a press solved in three dimensions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.calibrate.drag import carried
from gelsim.pipeline import stages
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene


def test_a_thick_layer_is_the_half_space():
    """Johnson 1985, 3.7: around a contact shifted rigidly an incompressible half-space follows by 2/π [asin(a/ρ) ± a/3ρ √(1 − a²/ρ²)]."""
    rho = np.array([1.2, 1.5, 2.0])
    drag = np.tile([1.0, 0.0], (3, 1))
    along = carried(np.column_stack([rho, 0 * rho]), np.ones(3), 1e3, drag)
    across = carried(np.column_stack([0 * rho, rho]), np.ones(3), 1e3, drag)
    # The tables stop at t/a = 16, where the layer still takes 3/4 of 1/16 or so from all of the contact's neighbourhood.
    wanted = 2 / np.pi * (np.arcsin(1 / rho) + np.outer([1, -1], np.sqrt(1 - 1 / rho**2) / (3 * rho)))
    assert np.abs(np.stack([along[:, 0], across[:, 0]]) - wanted).max() < 0.05
    assert along[:, 1] == pytest.approx(0, abs=1e-12) and across[:, 1] == pytest.approx(0, abs=1e-12)
    # Planted: along and across exchanged.
    assert np.abs(np.stack([across[:, 0], along[:, 0]]) - wanted).max() > 0.05


def test_the_contact_goes_along_and_what_is_far_stays():
    drag = np.tile([0.2, -0.1], (2, 1))
    moved = carried(np.array([[0.0, 0.0], [20.0, 3.0]]), np.ones(2), 3.0, drag)
    # Its mean over the contact is the drag; in the middle of a layer three times as thick it is a little more.
    assert moved[0] == pytest.approx(drag[0], rel=0.05) and np.abs(moved[1]).max() < 1e-3


@pytest.mark.slow
def test_a_dragged_ball_solved_in_three_dimensions():
    """A ball that sticks, pressed and dragged, less the same press undragged: what the coat moved sideways."""
    scene = Scene(
        gel=Gel(profile="flat", size_mm=(14.0, 14.0), thickness_mm=4.0),
        object=Body(shape="hemisphere", rigid=True, radius_mm=2.5, height_mm=5.0),
        contact=Contact("stick"),
        press=Press(depth_mm=0.5, force_n=None, frames=5, symmetry="none"),
        fidelity="fast",
    )
    presses = [stages.press(scene.replace(press=replace(scene.press, shear_mm=(shear, 0.0)))) for shear in (0.0, 0.1)]
    moved = (presses[1].gel.displacement[-1] - presses[0].gel.displacement[-1])[:, :2] * 1e3
    place = presses[1].gel.rest[:, :2] * 1e3
    away = place + moved - [0.1, 0.0]
    near = np.hypot(*away.T) < 4.0
    wanted = carried(away[near], np.full(near.sum(), np.sqrt(2.5 * 0.5)), 4.0, np.tile([0.1, 0.0], (near.sum(), 1)))
    # Shear that grows with the contact leaves less than all of it at the contact's rim, where points touch late and are dragged by the rest
    # of the way alone: a third of the drag there. Found: 0.0345, in 17 and 49 states 0.034; steps that drag what touches late from their
    # beginning hide some of it, 0.025 in 5 states and 0.033 in 49.
    error = np.hypot(*(moved[near] - wanted).T)
    assert np.median(error) < 0.01 and np.percentile(error, 95) < 0.04
    # Planted: no drag, and the drag across.
    assert np.median(np.hypot(*moved[near].T)) > 0.02
    assert np.percentile(np.hypot(*(moved[near] - wanted[:, ::-1]).T), 95) > 0.05
