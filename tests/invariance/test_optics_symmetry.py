"""What must not matter to the light: that nothing moved, and how the scene is turned about the camera's axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.membrane.surface import membrane_states, rest_membrane
from gelsim.optics import render_frames
from gelsim.optics.render import Renderer
from gelsim.optics.variant import SCALAR
from gelsim.results import Deformation, SurfaceMotion
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Markers, Render, Scene

SEEDS = 6


def square_scene() -> Scene:
    lights = (
        Light("red", (20.0, 0.0, -9.0), (-20.0, 0.0, 9.0), (10.0, 2.0), (1.0, 0.2, 0.1), 100.0),
        Light("blue", (-14.0, -14.0, -9.0), (14.0, 14.0, 9.0), (8.0, 2.0), (0.1, 0.3, 1.0), 100.0),
    )
    return Scene(
        gel=Gel(profile="flat", size_mm=(10.0, 10.0)),
        camera=Camera(field_mm=(8.0, 8.0), exposure=60.0),
        lights=Lights(lights),
        coating=Coating(specular=0.2),
        markers=Markers(pitch_mm=1.3, radius_mm=0.2),
        render=Render("path", 16, (64, 64)),
    )


def dented(scene: Scene, centre_mm: tuple[float, float], states: int = 1) -> Deformation:
    """A smooth off-centre dent of 0.3 mm and 1 mm width, on nodes 0.5 mm apart; with states = 2 an unmoved state comes first."""
    side = np.linspace(-5e-3, 5e-3, 21)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    rest = np.column_stack([x, y, np.zeros(x.size)])
    displacement = np.zeros((states, x.size, 3))
    displacement[-1, :, 2] = -0.3e-3 * np.exp(-((x - centre_mm[0] * 1e-3) ** 2 + (y - centre_mm[1] * 1e-3) ** 2) / (2 * (1e-3) ** 2))
    none, whole = np.zeros(states), np.zeros(states, np.int32)
    motion = SurfaceMotion(rest, np.zeros((0, 3), np.int32), displacement, np.zeros((0, 6), np.int32))
    return Deformation(
        approach=none,
        time=none,
        force=np.zeros((states, 3)),
        contact_area=none,
        contact_pressure=np.zeros((states, x.size)),
        gel=motion,
        object=motion,
        min_jacobian=none,
        penetration=none,
        newton_iterations=whole,
        linear_iterations=whole,
        seconds=none,
        converged=np.ones(states, bool),
    )


def test_no_displacement_gives_the_background_exactly():
    scene = square_scene()
    first, pressed = membrane_states(scene, dented(scene, (1.0, 0.5), states=2))
    frames = list(render_frames(scene, [rest_membrane(scene), pressed, first], variant=SCALAR))
    # The same random numbers on the same mesh: identity, not a tolerance; also after another frame was drawn in between.
    assert np.array_equal(frames[0].radiance, frames[2].radiance)
    assert np.array_equal(frames[0].image, frames[2].image)
    assert not np.array_equal(frames[0].image, frames[1].image)


@pytest.mark.parametrize("quarter_turns", [1, 2])
def test_turning_the_scene_turns_the_picture(quarter_turns):
    scene = square_scene()
    cosine, sine = {1: (0.0, 1.0), 2: (-1.0, 0.0)}[quarter_turns]

    def turn(vector):
        return (cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1], *vector[2:])

    def pictures(scene, centre):
        (membrane,) = membrane_states(scene, dented(scene, centre))
        renderer = Renderer(scene, SCALAR)
        return np.array([renderer.radiance(membrane, seed) for seed in range(SEEDS)], float)

    def turned_light(light):
        return replace(light, position_mm=turn(light.position_mm), direction=turn(light.direction))

    turned_lights = tuple(turned_light(light) for light in scene.lights.lights)
    turned_scene = scene.replace(lights=replace(scene.lights, lights=turned_lights))
    # x runs right and y down, so a turn from x to y is clockwise in the picture: np.rot90 with a negative count.
    straight = np.rot90(pictures(scene, (1.0, 0.5)), -quarter_turns, axes=(1, 2))
    turned = pictures(turned_scene, turn((1.0, 0.5)))

    def tiles(image):
        return image.reshape(SEEDS, 8, 8, 8, 8, 3).mean(axis=(2, 4))

    a, b = tiles(straight), tiles(turned)
    relative = ((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / (a.mean(axis=0) + b.mean(axis=0)) ** 2 * 4).mean() / SEEDS
    scores = (a.mean(axis=0) - b.mean(axis=0)) / (np.sqrt(relative) * a.mean(axis=0))
    # 192 tile means whose noise differs by a factor of about 2 from the pooled one: 5 pooled standard deviations for most, 8 for all.
    assert np.mean(np.abs(scores) < 5) > 0.98 and np.abs(scores).max() < 8
    # The checker can tell: unturned, the pictures are far apart.
    wrong = (tiles(pictures(scene, (1.0, 0.5))).mean(axis=0) - b.mean(axis=0)) / (np.sqrt(relative) * a.mean(axis=0))
    assert np.abs(wrong).max() > 20
