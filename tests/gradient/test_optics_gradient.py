"""Derivatives of pictures against central differences of whole renderings, as vectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.errors import RenderError, SceneError
from gelsim.membrane.surface import moved_membrane
from gelsim.optics import choose_variant
from gelsim.optics.gradient import picture_gradient
from gelsim.optics.render import Renderer
from gelsim.optics.variant import SCALAR
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Markers, Render, Scene


@pytest.fixture
def variant():
    choice = choose_variant()
    if "_ad_" not in choice.name:
        pytest.skip("this machine has neither CUDA nor a working LLVM")
    return choice


def scene() -> Scene:
    lights = (
        Light("red", (9.0, 2.0, -4.0), (-9.0, 0.0, 3.0), (6.0, 2.0), (1.0, 0.3, 0.2), 100.0),
        Light("blue", (-3.0, -10.0, -5.0), (0.0, 10.0, 2.0), (5.0, 3.0), (0.2, 0.3, 1.0), 80.0),
    )
    return Scene(
        gel=Gel(profile="flat", size_mm=(10.0, 10.0), thickness_mm=2.0),
        camera=Camera(field_mm=(8.0, 6.0)),
        lights=Lights(lights, window_reflection=True),
        coating=Coating(albedo=(0.6, 0.5, 0.4), specular=0.3, roughness=0.4),
        markers=Markers(layout="none"),
        render=Render("path", 16, (32, 24)),
    )


def dent(places):
    bell = 0.4e-3 * np.exp(-((places[:, 0] - 0.5e-3) ** 2 + places[:, 1] ** 2) / 2e-6)
    return np.stack([0 * bell, 0 * bell, -bell], axis=1)


def changed(scene: Scene, name: str, index: int, step: float) -> Scene:
    section, _, rest = name.partition(".")

    def moved(part, field):
        value = getattr(part, field)
        if not isinstance(value, tuple):
            return replace(part, **{field: value + step})
        return replace(part, **{field: tuple(v + step * (i == index) for i, v in enumerate(value))})

    if section != "lights":
        return scene.replace(**{section: moved(getattr(scene, section), rest)})
    number, field = rest.split(".")
    lights = [moved(light, field) if i == int(number) else light for i, light in enumerate(scene.lights.lights)]
    return scene.replace(lights=replace(scene.lights, lights=tuple(lights)))


# Name -> step. Steps: rounding of the weighted sum of 2304 float32 numbers, 1e-6 relative, over a step of about 1 % of the field.
FIELDS = {
    "lights.0.position_mm": 0.05,
    "lights.1.direction": 0.05,
    "lights.0.rgb": 0.05,
    "lights.1.power": 2.0,
    "coating.albedo": 0.02,
    "coating.specular": 0.02,
    "coating.roughness": 0.01,
    "camera.distance_mm": 0.5,
    "camera.offset_mm": 0.05,
}


def test_gradient_is_that_of_central_differences(variant):
    base, membrane = scene(), moved_membrane(scene(), dent)
    rng = np.random.default_rng(5)
    # Smooth weights with a direction: sums that do not cancel by symmetry.
    rows, columns = np.mgrid[-1:1:24j, -1:1:32j]
    weights = np.stack([1 + columns, 0.5 - rows, 0.3 + columns * rows], axis=-1) + 0.1 * rng.standard_normal((24, 32, 3))
    picture, slopes = picture_gradient(base, membrane, list(FIELDS), weights, variant)
    assert np.array_equal(picture, Renderer(base, variant).radiance(membrane, 0))
    for name, step in FIELDS.items():
        expected = []
        for index in range(len(slopes[name])):
            sums = [(weights * Renderer(changed(base, name, index, s), variant).radiance(membrane, 0)).sum() for s in (step, -step)]
            expected.append((sums[0] - sums[1]) / (2 * step))
        expected = np.array(expected)
        # Not zero: a relative change of the picture per step that is far above rounding.
        assert np.linalg.norm(expected) * step > 1e-3 * np.abs(weights * picture).sum() * 0.1, name
        relative = np.linalg.norm(slopes[name] - expected) / np.linalg.norm(expected)
        cosine = slopes[name] @ expected / np.linalg.norm(slopes[name]) / np.linalg.norm(expected)
        # Second order of the step 1e-3; what derivatives leave out is a share of the indirect light, about a tenth of the picture.
        assert relative < 0.03 and cosine > 0.999, (name, slopes[name], expected)
        # Planted: a sign in one component.
        wrong = expected * np.where(np.arange(len(expected)) == np.argmax(np.abs(expected)), -1, 1)
        assert np.linalg.norm(slopes[name] - wrong) / np.linalg.norm(wrong) > 0.5


def test_what_cannot_be_differentiated_is_refused(variant):
    base = scene()
    membrane = moved_membrane(base, dent)
    with pytest.raises(RenderError, match="scalar_rgb does not differentiate"):
        picture_gradient(base, membrane, ["lights.0.power"], np.ones((24, 32, 3)), SCALAR)
    with pytest.raises(SceneError, match="lights.7.power"):
        picture_gradient(base, membrane, ["lights.7.power"], np.ones((24, 32, 3)), variant)
    with pytest.raises(SceneError, match="weights have the shape"):
        picture_gradient(base, membrane, ["lights.0.power"], np.ones((4, 4, 3)), variant)
