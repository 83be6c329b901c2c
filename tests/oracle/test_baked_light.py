"""A whole bake of a small sensor against the path tracer, and what the comparison says of a wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.optics import bake, choose_variant
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Markers, Render, Scene

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(choose_variant("cpu").name == "scalar_rgb", reason="the scalar variant takes many minutes"),
]

PSNR_DB, DELTA_E = 40.0, 1.0
"""What `baked` promises; the bake of this test is coarser than a real one."""


def small_sensor(azimuth_deg: float = 0.0, albedo: float = 0.45) -> Scene:
    """Three coloured lights about a flat gel of 12 mm, the first turned by an angle; half of the coat flakes, of another colour."""
    lights = []
    for number, colour in enumerate(((1.0, 0.1, 0.05), (0.1, 1.0, 0.1), (0.05, 0.1, 1.0))):
        angle = np.radians(120 * number + (azimuth_deg if number == 0 else 0.0))
        x, y = 22 * np.cos(angle), 22 * np.sin(angle)
        lights.append(Light(f"light {number}", (x, y, -8.0), (-x, -y, 8.0), (8.0, 2.0), colour, 100.0))
    return Scene(
        gel=Gel(profile="flat", size_mm=(12.0, 12.0)),
        camera=Camera(field_mm=(9.0, 6.75), exposure=50.0),
        lights=Lights(tuple(lights)),
        coating=Coating(albedo=(albedo, albedo, 0.9 * albedo), specular=0.4, roughness=0.4, flake_reflectance=(0.9, 0.8, 0.7), grain=0.02),
        markers=Markers(radius_mm=0.15),
        render=Render("baked", resolution=(160, 120)),
    )


def test_bake_is_near_path_and_a_wrong_one_is_not(monkeypatch):
    for name, value in {"NORMALS": 32, "PLACES": (10, 8), "PROBES": 4, "UNSEEN": 5, "UNSEEN_SPP": 100}.items():
        monkeypatch.setattr(bake, name, value)
    variant = choose_variant("cpu")
    scene = small_sensor()
    field = bake.measure(scene, variant)
    assert field.errors["psnr_worst_db"] >= PSNR_DB and field.errors["delta_e_mean"] <= DELTA_E
    assert set(field.light_of) == {-1, 0, 1, 2}  # every light has its components, and what no light's horizon shadows has too
    # Planted, each told by the same comparison: no shadows (another light's components), no inter-reflection, a light turned by 5 degrees,
    # a coat 2 % brighter.
    plain = scene.replace(markers=replace(scene.markers, layout="none"), coating=replace(scene.coating, grain=0.0))

    def error(scene: Scene, field) -> dict:
        return bake._measure_error(scene, variant, field, lambda: None)

    right = field.errors["levels_mean"]
    turned = replace(field, light_of=np.where(field.light_of >= 0, (field.light_of + 1) % 3, -1).astype(np.int32))
    assert error(plain, turned)["psnr_worst_db"] < PSNR_DB
    dark = replace(field, gains=np.zeros(3, np.float32), veil=np.zeros_like(field.veil))
    # found: 1.57 times
    assert error(plain, dark)["levels_mean"] > 1.3 * right
    # Turning one of three lights by 2 degrees was found to raise the error from 0.521 to 0.678 levels: its own share is
    # √(0.678² - 0.521²) = 0.43, as it adds like something independent. In proportion 5 degrees are 1.08, and √(1.08² + 0.521²) is 2.3 times
    # the bake's error (found: 2.06).
    other = small_sensor(azimuth_deg=5.0)
    assert error(other.replace(markers=plain.markers, coating=plain.coating), field)["levels_mean"] > 1.5 * right
    # 2 % of the light is 0.02 / 2.2 of a level of 110.
    bright = replace(field, colours=field.colours * np.float32(1.02))
    assert error(plain, bright)["levels_mean"] > right + 0.3
