"""An object that is turned or tilted far is pressed as the same body described otherwise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gelsim
from gelsim.results import Deformation
from gelsim.scene.layers import build_scene

SAME = 0.044
"""Of a force: solids at `fast` are within 3.1 % (docs/validation.md, Accuracy), and meshes differ where contact may come: √2 of that."""


def pressed(body: dict[str, Any], **press: Any) -> Deformation:
    layer = {
        "gel": {"profile": "flat", "size_mm": [14.0, 14.0]},
        "object": {"rigid": True} | body,
        "press": {"depth_mm": 0.3, "frames": 2, "symmetry": "none"} | press,
        "fidelity": "fast",
    }
    return gelsim.press(build_scene(layer), device="cpu")


@pytest.mark.parametrize(
    ("turned", "upright"),
    [
        (
            {"shape": "box", "width_mm": 4.0, "length_mm": 5.0, "height_mm": 6.0, "press_side": "left"},
            {"shape": "box", "width_mm": 6.0, "length_mm": 5.0, "height_mm": 4.0},
        ),
        (
            {"shape": "cylinder", "radius_mm": 4.0, "length_mm": 6.0, "height_mm": 8.0, "rotation_deg": [0.0, 0.0, 180.0]},
            {"shape": "cylinder", "radius_mm": 4.0, "length_mm": 6.0, "height_mm": 8.0},
        ),
    ],
)
def test_a_turned_shape_is_the_shape_that_it_becomes(turned: dict[str, Any], upright: dict[str, Any]) -> None:
    one, other = pressed(turned), pressed(upright)
    assert one.force[-1, 2] == pytest.approx(other.force[-1, 2], rel=SAME) and one.force[-1, 2] < -0.02
    assert one.contact_area[-1] == pytest.approx(other.contact_area[-1], rel=0.05)  # of some hundred faces


@pytest.mark.parametrize("degrees", [60.0, 90.0])
def test_a_steep_tilt_is_the_turn_of_the_object(degrees: float) -> None:
    box = {"shape": "box", "width_mm": 4.0, "length_mm": 3.0, "height_mm": 5.0}
    tilted = pressed(box, tilt_deg=[0.0, degrees], touch_at="centre")
    turned = pressed(box | {"rotation_deg": [0.0, degrees, 0.0]}, touch_at="centre")
    assert tilted.force[-1, 2] == pytest.approx(turned.force[-1, 2], rel=SAME) and tilted.force[-1, 2] < -0.02
    # each grid rounds the edge of 0.1 mm by a little of its own: as far as first touch is lower than the sharp edge's
    low = [press.object.rest[:, 2].min() for press in (tilted, turned)]
    assert np.ptp(low) < 0.05 * 0.1e-3
