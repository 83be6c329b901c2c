"""The image pipeline where the light is drawn: its noise, its bytes, and that every backend makes the same picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_baked import VARIANTS, dragged, flat_scene, ridge
from test_lightfield import linear_field

from gelsim.membrane.surface import rest_membrane
from gelsim.optics import render_frames
from gelsim.optics.arrays import choose_arrays
from gelsim.optics.baked import BakedRenderer
from gelsim.optics.isp import Developer, as_picture, develop, packed_bytes
from gelsim.optics.render import Renderer
from gelsim.scene.definition import Camera, Render, Scene

NOISY = {"noise_sd": (2.0, 1.4, 2.5), "full_well": (9000.0, 7000.0, 8000.0), "read_noise": (0.002, 0.001, 0.003)}
needs_llvm = pytest.mark.skipif(len(VARIANTS) == 1, reason="no vectorised variant here")


def test_noise_is_normal_and_without_pattern():
    side = 400
    scene = Scene(camera=Camera(noise_sd=(8.0, 8.0, 8.0), read_noise=(0.03, 0.03, 0.03), tone="linear"))
    grey = np.full((side, side, 3), 0.5, np.float32)
    frames = np.stack([develop(scene.replace(seed=seed), grey, index) for seed, index in ((1, 0), (1, 1), (2, 0))]) - 127.5
    count = side**2
    # Both noises and rounding; a variance is known to √(2/N), four of these for nine of them.
    variance = 8.0**2 + (255 * 0.03) ** 2 + 1 / 12
    assert frames.var(axis=(1, 2)) == pytest.approx(variance, rel=4 * np.sqrt(2 / count))
    normal = frames / np.sqrt(variance)
    # Third and fourth moments of a normal number are known to √(15/N) and √(96/N).
    assert np.abs((normal**3).mean(axis=(1, 2))).max() < 4 * np.sqrt(15 / count)
    assert np.abs((normal**4).mean(axis=(1, 2)) - 3).max() < 4 * np.sqrt(96 / count)
    # Channels, frames, seeds, neighbours: a correlation of independent numbers is known to 1/√N; 36 + 18 of them.
    flat = normal.transpose(0, 3, 1, 2).reshape(9, -1)
    assert np.abs(np.triu(flat @ flat.T / count, 1)).max() < 5 / np.sqrt(count)
    for apart in (1, side):
        assert np.abs((flat[:, apart:] * flat[:, :-apart]).mean(axis=1)).max() < 5 / np.sqrt(count)


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 1003])
def test_bytes_are_packed_in_order(variant, count):
    arrays = choose_arrays(variant)
    wanted = np.random.default_rng(1).integers(256, size=(count, 3)).astype(np.uint8)
    words = wanted.astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)
    assert np.array_equal(as_picture(arrays.numpy(packed_bytes(arrays, arrays.words(words))), (count,)), wanted)


@needs_llvm
@pytest.mark.parametrize("more", [{}, {"shading": (0.1, -0.1, 0.2, 0.05, 0.0, -0.1), "fresnel": True, "gamma": 1.2}, {"tone": "linear"}])
def test_backends_develop_the_same(more):
    scene = Scene(camera=Camera(**NOISY, **more), render=Render("path", 16, (101, 77)), seed=5)
    radiance = np.random.default_rng(2).uniform(-0.1, 1.2, (77, 101, 3)).astype(np.float32)
    arrays = choose_arrays(VARIANTS[1])
    wanted = develop(scene, radiance, 3)
    found = as_picture(arrays.numpy(Developer(scene, arrays)(arrays.floats(radiance), 3)), (77, 101))
    # Functions of float32 differ by some ulp, 1e-6 of 255 levels: that often a value rounds the other way.
    apart = np.abs(wanted.astype(int) - found)
    assert apart.max() <= 1 and (apart > 0).mean() < 1e-3 and wanted.std() > 50
    # Planted: another frame's noise.
    assert (wanted != develop(scene, radiance, 4)).mean() > 0.5


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_one_developer_takes_pictures_of_any_size(variant):
    """Planted: one recording for all lengths makes as many bytes as the first picture has."""
    scene, arrays = Scene(camera=Camera(**NOISY), seed=5), choose_arrays(variant)
    developer = Developer(scene, arrays)
    for shape in ((20, 30), (40, 31), (20, 30), (10, 9)):
        radiance = np.random.default_rng(2).uniform(0.1, 1.0, (*shape, 3)).astype(np.float32)
        found = as_picture(arrays.numpy(developer(arrays.floats(radiance), 3)), shape)
        assert np.abs(develop(scene, radiance, 3).astype(int) - found).max() <= 1


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_baked_pictures_are_developed_in_their_kernel(variant):
    scene = flat_scene(camera=Camera(field_mm=(6.0, 4.5), exposure=0.02, **NOISY))
    renderer = BakedRenderer(scene, linear_field(), variant)
    membranes = [dragged(scene), ridge(scene)]
    for index, (radiance, image, height) in enumerate(renderer.frames(membranes, 4)):
        wanted = develop(scene, radiance, 4 + index)
        apart = np.abs(wanted.astype(int) - image)
        assert image.shape == radiance.shape and height.shape == image.shape[:2] and image.std() > 2
        assert apart.max() <= 1 and (apart > 0).mean() < 1e-3
        # A frame by itself is the same frame.
        alone = renderer.fetch(renderer.enqueue(membranes[index], 4 + index))
        assert all(np.array_equal(one, other) for one, other in zip(alone, (radiance, image, height), strict=True))


@pytest.mark.parametrize("mode", ["path", "baked"])
@pytest.mark.parametrize("variant", VARIANTS[-1:], ids=lambda v: v.name)
def test_frames_in_flight_are_the_frames(variant, mode):
    """A frame is prepared while the one before is drawn: each is what it is alone."""
    scene = flat_scene(render=Render(mode, 4, (48, 36)))
    scene = scene.replace(camera=replace(scene.camera, exposure=0.02 if mode == "baked" else 400.0, noise_sd=(1.0, 1.0, 1.0)))
    membranes = [dragged(scene), ridge(scene), rest_membrane(scene)]
    field = linear_field()
    frames = list(render_frames(scene, membranes, variant=variant, light_field=field))
    assert len(frames) == 3 and list(render_frames(scene, [], variant=variant, light_field=field)) == []
    for index, (membrane, frame) in enumerate(zip(membranes, frames, strict=True)):
        renderer = BakedRenderer(scene, field, variant) if mode == "baked" else Renderer(scene, variant)
        alone = renderer.fetch(renderer.enqueue(membrane, index))
        assert all(np.array_equal(one, other) for one, other in zip(alone, (frame.radiance, frame.image, frame.height), strict=True))
    assert np.abs(frames[0].image.astype(int) - frames[1].image).max() > 20
