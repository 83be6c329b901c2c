"""Light against what can be worked out by hand: a Lambertian plane under rectangles, a white sky, a pinhole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelsim.membrane.surface import rest_membrane
from gelsim.optics import choose_variant, unshadowed
from gelsim.optics.reference import irradiance, lambert_plane, plane_points
from gelsim.optics.render import Renderer
from gelsim.optics.spectra import light_colour
from gelsim.optics.tracer import OFFSET
from gelsim.optics.variant import SCALAR
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Markers, Render, Scene

SEEDS = 6


@pytest.fixture(params=["scalar", "best"])
def variant(request):
    """Scalar always; the machine's best where it is another one."""
    if request.param == "scalar":
        return SCALAR
    best = choose_variant()
    if best.name == SCALAR.name:
        pytest.skip("this machine has neither CUDA nor a working LLVM")
    return best


@pytest.fixture
def plane() -> Scene:
    lights = (
        Light("red", (20.0, 3.0, -9.0), (-20.0, 0.0, 9.0), (6.0, 2.0), (1.0, 0.2, 0.1), 100.0),
        Light("blue", (-4.0, -22.0, -12.0), (0.0, 22.0, 12.0), (5.0, 3.0), (0.1, 0.3, 1.0), 80.0),
    )
    return Scene(
        gel=Gel(profile="flat"),
        camera=Camera(),
        lights=Lights(lights),
        coating=Coating(albedo=(0.5, 0.4, 0.6)),
        markers=Markers(layout="none"),
        render=Render("direct", 16, (48, 36)),
    )


def estimates(scene: Scene, variant) -> np.ndarray:
    """Independent pictures of the undeformed gel, (SEEDS, H, W, 3)."""
    renderer, membrane = Renderer(scene, variant), rest_membrane(scene)
    return np.array([renderer.radiance(membrane, seed) for seed in range(SEEDS)], float)


def tile_scores(pictures: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """z of the mean picture against `expected`, by tiles of 12 x 12 pixels and colour; the variance is measured between the seeds."""

    def tiles(image):
        return image.reshape(*image.shape[:-3], 3, 12, 4, 12, 3).mean(axis=(-4, -2))

    values = tiles(pictures)
    # Pooled over tiles: six seeds alone would give a t-distribution with fat tails. The floor is float32 rounding.
    spread = np.sqrt((values.var(axis=0, ddof=1) / values.mean(axis=0) ** 2).mean() / SEEDS) * values.mean(axis=0)
    return (values.mean(axis=0) - tiles(expected)) / np.maximum(spread, 1e-6 * values.mean(axis=0))


# 36 tile means, normal: |z| > 5 happens by chance once in 50,000 runs.
LIMIT = 5.0


def test_lambert_plane(plane, variant):
    # 24 cells a side: the sum over a lamp of 6 mm at 25 mm is then good to 1e-5 (with 8 it errs by 2e-4, more than the vectorised noise).
    scores = tile_scores(estimates(plane, variant), lambert_plane(plane, 24))
    assert np.abs(scores).max() < LIMIT


def test_planted_faults_are_seen(plane):
    expected = lambert_plane(plane)
    turn = np.radians(2.0)
    red = plane.lights.lights[0]
    x, y, z = red.position_mm
    turned = replace(red, position_mm=(np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z))
    rotated = plane.replace(lights=replace(plane.lights, lights=(turned, plane.lights.lights[1])))
    brighter = plane.replace(coating=replace(plane.coating, albedo=tuple(1.02 * a for a in plane.coating.albedo)))
    for fault in (rotated, brighter):
        assert np.abs(tile_scores(estimates(fault, SCALAR), expected)).max() > LIMIT


@pytest.mark.parametrize("fault", [None, "mirror", "lobe", "flakes", "turned"])
def test_unshadowed_light_is_what_is_drawn(plane, fault, monkeypatch):
    """Tilted pieces of coat by the sums of `optics.unshadowed` and by the tracer: lamp, its image, its lobe, pigment and flakes."""
    # 24 cells a side, as above.
    monkeypatch.setattr(unshadowed, "MIDDLES", (np.arange(24) + 0.5) / 12 - 1)
    variant = choose_variant("cpu")
    if variant == SCALAR:
        pytest.skip("scalar variants draw neither images nor lobes")
    # The third is above the window's outer face, and has an image in it.
    strip = Light("strip", (0.0, -13.5, -3.0), (0.0, 13.5, 1.0), (4.0, 1.0), (1.0, 1.0, 0.2), 100.0)
    lights = (replace(plane.lights.lights[0], lobe=3.0), plane.lights.lights[1], strip)
    coating = Coating(albedo=(0.5, 0.4, 0.6), specular=0.4, roughness=0.4, flake_reflectance=(0.9, 0.8, 0.7))
    scene = plane.replace(lights=replace(plane.lights, lights=lights, window_reflection=True), coating=coating)
    rest, renderer = rest_membrane(scene), Renderer(scene, variant)
    # Out of the gel: upright, and leaning two ways by 11 degrees; all of the lamps stays above the horizon.
    normals = np.array([[0.0, 0.0, 1.0], [0.2, 0.0, np.sqrt(0.96)], [-0.12, 0.16, np.sqrt(0.96)]])
    drawn = [replace(rest, normals=np.tile(normal, (len(rest.positions), 1))) for normal in normals]
    pictures = np.array([[renderer.radiance(membrane, seed) for membrane in drawn] for seed in range(SEEDS)], float)
    spoiled = {
        "mirror": replace(scene.lights, window_reflection=False),
        "lobe": replace(scene.lights, lights=(replace(lights[0], lobe=2.8), *lights[1:])),
    }
    summed = scene.replace(lights=spoiled.get(fault, scene.lights))
    share = coating.specular * (0.95 if fault == "flakes" else 1.0)
    points = plane_points(scene).reshape(-1, 3) * 1e3
    turn = [[np.cos(0.02), np.sin(0.02), 0], [-np.sin(0.02), np.cos(0.02), 0], [0, 0, 1]]
    expected = np.zeros((len(normals), *pictures.shape[2:]))
    for number, normal in enumerate(normals @ turn if fault == "turned" else normals):
        for light in summed.lights.lights:
            # Where the tracer's rays start: light 20 mm away is stronger by 1e-4 there.
            received, flakes = unshadowed.unshadowed_light(summed, light, points - OFFSET * normal, -normal[None])
            for shown, albedo in (
                (received, 0.6 * np.array(coating.albedo) / np.pi),
                (flakes, share * np.array(coating.flake_reflectance)),
            ):
                expected[number] += (shown * albedo * light_colour(light)).reshape(expected[number].shape)
    scores = np.array([tile_scores(pictures[:, number], expected[number]) for number in range(len(normals))])
    assert (np.abs(scores).max() < LIMIT) == (fault is None)


def test_small_far_light_is_a_point():
    light = Light("far", (0.0, 0.0, -1000.0), (0.0, 0.0, 1.0), (1.0, 1.0), (1.0, 1.0, 1.0), 1.0)
    got = irradiance(light, np.zeros((1, 3)), np.array([0.0, 0.0, -1.0]))
    # Φ/(π r²) on the axis of a Lambertian source; its extent changes r² by (0.5 mm / 1 m)² < 1e-6.
    assert got[0] == pytest.approx(np.full(3, 1.0 / (np.pi * 1000.0**2)), rel=1e-6)


def ggx_albedo_at_normal(alpha: float) -> float:
    """Share that lossless GGX facets reflect once and out, seen along the normal (Walter et al. 2007).

    The slope of a visible facet has the distribution function t/(t + α²), t = tan²θ; beyond 45° it reflects into the surface, and of what
    it reflects to 2θ the share G1 = 2/(1 + sqrt(1 + α² tan² 2θ)) escapes.
    """
    share = (np.arange(200_000) + 0.5) / 200_000
    angle = np.arctan(alpha * np.sqrt(share / (1 - share)))
    out = angle < np.pi / 4
    return float(np.sum(2 / (1 + np.sqrt(1 + (alpha * np.tan(2 * angle[out])) ** 2))) / share.size)


@pytest.mark.parametrize("specular", [0.0, 0.3])
def test_white_furnace(plane, specular, monkeypatch):
    """Under a sky of radiance 1 a flat coat shows its albedo, by Mitsuba; `test_optics_tracer` has the same of the traced coats."""
    from gelsim.optics import scene_dict

    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    monkeypatch.setattr(scene_dict, "emitter_dict", lambda scene: {"sky": sky})
    scene = plane.replace(
        coating=Coating(albedo=(0.9, 0.5, 0.1), specular=specular, flake_reflectance=(1.0, 1.0, 1.0)), render=Render("path", 64, (48, 36))
    )
    pictures = estimates(scene, SCALAR)
    mean, error = pictures.mean(axis=(0, 1, 2)), pictures.mean(axis=(1, 2)).std(axis=0, ddof=1) / np.sqrt(SEEDS)
    expected = (1 - specular) * np.array([0.9, 0.5, 0.1]) + specular * ggx_albedo_at_normal(scene.coating.roughness)
    # Six seeds: t with 5 degrees of freedom, 7 standard errors leave a chance of 1e-3 for six numbers. The pixels look at the plane under
    # up to 12 degrees, where the flakes' albedo differs from the normal's by up to 0.5 % (second order in the angle); 1e-5 is float32.
    bound = 7 * error + 0.005 * specular + 1e-5
    assert np.all(np.abs(mean - expected) < bound)
    # Planted: 2 % more than there is.
    assert not np.all(np.abs(1.02 * mean - expected) < bound)
