"""Gels with a curved outer face: a sphere is the dome of its radius; a plate on a cylinder is a cylinder on a plate."""

from __future__ import annotations

import numpy as np
import pytest

from gelsim.errors import SceneError
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene

MODULUS_KPA, RADIUS_MM, LENGTH_MM = 100.0, 20.0, 20.0
PLATE = Body(shape="box", rigid=True, width_mm=14.0, length_mm=24.0, height_mm=5.0)


def pressed(gel: Gel, body: Body, depth_mm: float = 0.1) -> Deformation:
    return stages.press(Scene(gel=gel, object=body, press=Press(depth_mm=depth_mm, frames=3), contact=Contact(friction_coefficient=0.0)))


def pad(profile: str, radius_mm: float | None = None) -> Gel:
    """As thick as it is wide: a narrow contact does not see the window much."""
    return Gel(profile=profile, radius_mm=radius_mm, size_mm=(12.0, LENGTH_MM), thickness_mm=8.0, youngs_modulus_kpa=MODULUS_KPA)


def test_a_sphere_is_the_dome_of_its_radius() -> None:
    half, drop = 12.5, 1.4
    ball = Body(shape="hemisphere", rigid=True, radius_mm=5.0)
    dome, sphere = (
        pressed(Gel(edge_thickness_mm=1.0), ball),
        pressed(Gel(profile="sphere", radius_mm=(half**2 + drop**2) / (2 * drop)), ball),
    )
    assert sphere.force[-1, 2] == pytest.approx(dome.force[-1, 2], rel=1e-6)


def test_a_plate_on_a_cylinder_is_a_cylinder_on_a_plate() -> None:
    """Their gap is the same function of x, so to first order in the slopes (here 0.3 at most, at the border) is all that follows."""
    plate = pressed(pad("cylinder", RADIUS_MM), PLATE)
    rod = pressed(pad("flat"), Body(shape="cylinder", rigid=True, radius_mm=RADIUS_MM, length_mm=24.0))
    # the cylinder's gel thins by 0.9 of 8 mm to its sides, beside the contact of 1.2 mm half width. Measured: 0.5 and 0.1 %
    assert plate.force[-1, 2] == pytest.approx(rod.force[-1, 2], rel=0.01)
    assert plate.contact_area[-1] == pytest.approx(rod.contact_area[-1], rel=0.01)
    # Hertz's half width at that force on a half-space; by 8 mm of thickness, 7 half widths, off by some (b/T)^2 = 2 %. Measured: 2.2 %
    per_length = -plate.force[-1, 2] / (LENGTH_MM * 1e-3)
    hertz = np.sqrt(4 * per_length * RADIUS_MM * 1e-3 / (np.pi * MODULUS_KPA * 1e3 / (1 - 0.499**2)))
    half_width = plate.contact_area[-1] / (2 * LENGTH_MM * 1e-3)
    assert half_width == pytest.approx(hertz, rel=0.04)
    # planted: of a radius a tenth larger the width would be 5 % off
    assert abs(half_width / (hertz * np.sqrt(1.1)) - 1) > 0.02 and abs(half_width / (hertz / np.sqrt(1.1)) - 1) > 0.04


@pytest.mark.parametrize(
    ("gel", "message"),
    [
        ({"profile": "cylinder"}, "gel.radius_mm is missing"),
        ({"profile": "flat", "radius_mm": 20.0}, 'gel.radius_mm = 20 mm is for gel.profile = "sphere" or "cylinder"'),
        ({"profile": "sphere", "radius_mm": 20.0}, "allowed: 34.42 mm or more"),
        ({"profile": "cylinder", "radius_mm": 5.0, "size_mm": (12.0, 20.0), "thickness_mm": 8.0}, "allowed: 6 mm or more"),
    ],
)
def test_a_radius_that_is_none(gel: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Scene(gel=Gel(**gel))
