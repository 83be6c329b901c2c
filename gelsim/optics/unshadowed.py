"""Light that comes straight from a sensor's lamps onto small pieces of its coat, with nothing in the way, at any places and normals. NumPy.

Of a lamp, with its mirror image in the window's outer face, a piece of coat at a point with normal n receives, per unit of its colour,

    E = Σ w max(n·l, 0),    F = Σ w f(n, l, v) max(n·l, 0),    w = Φ (m + 1)/(2π) cos^m θ' R / r² / count,

summed over places on the lamp, one in the middle of each of equal cells: l the direction to it, v that to the camera, f a white flake's
reflection, R = 1 for the lamp and Fresnel's reflectance for the image. The integrals that `optics.tracer` estimates by chance, in another
order: what a lamp sends to a point is the same for all normals there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.camera import direction_to_eye
from gelsim.optics.fresnel import reflectance
from gelsim.optics.lighting import light_pose, mirror_height, mirrored_light
from gelsim.scene.definition import Light, Scene

CELLS = 8
"""Along each side of a light. The nearest strip of a Mini, 23 mm long and 8 mm away, is then right to 0.2 % (RMS) of its full strength."""
MIDDLES = (np.arange(CELLS) + 0.5) * (2 / CELLS) - 1


def unshadowed_light(
    scene: Scene, light: Light, points: NDArray[np.floating], normals: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What pieces of coat receive of one light.

    Args:
        points: In the gel [mm], shape (P, 3).
        normals: Into the gel, shape (N, 3); each at every point.
    Returns:
        E and F [mW/mm²], both (P, N); F is zeros for a coat without flakes.
    """
    facing = np.asarray(normals, np.float32)
    received, flakes = np.zeros((2, len(points), len(normals)), np.float32)
    to_eye = direction_to_eye(scene, points)
    alpha, pose = scene.coating.roughness, light_pose(light)
    along, up = np.meshgrid(MIDDLES, MIDDLES)
    places = pose[:3, 3] + along.reshape(-1, 1) * pose[:3, 0] + up.reshape(-1, 1) * pose[:3, 1]
    for number, (point, eye) in enumerate(zip(points, to_eye, strict=True)):
        ways, weights = _sources(scene, light, places, point)
        cosine = np.maximum(facing @ ways.T.astype(np.float32), 0)
        weights = weights.astype(np.float32)
        received[number] = cosine @ weights
        if scene.coating.specular > 0:
            half = ways + eye
            half /= np.linalg.norm(half, axis=1, keepdims=True)
            slope = facing @ half.T.astype(np.float32)
            slope *= slope
            slope *= alpha**2 - 1
            slope += 1
            # α²/(π t²) of GGX, and G1/(2 cos) of Smith's shadowing for lamp and camera.
            escape = cosine * cosine
            escape *= 1 - alpha**2
            escape += alpha**2
            np.sqrt(escape, out=escape)
            escape += cosine
            escape *= slope
            escape *= slope
            np.divide(cosine, escape, out=escape)
            seen = np.maximum(facing @ eye, 1e-4)
            flakes[number] = (escape @ weights) * (alpha**2 / math.pi / (seen + np.sqrt(alpha**2 + (1 - alpha**2) * seen**2)))
    return received, flakes


def _sources(scene: Scene, light: Light, places: NDArray, point: NDArray[np.floating]) -> tuple[NDArray, NDArray]:
    """Directions from a point to places on a light and on its image, (S, 3), and the weights w of what comes from there, (S,)."""
    facing = np.array(light.direction) / math.hypot(*light.direction)
    ways, weights = _from(light, places - point, facing)
    if not mirrored_light(scene, light):
        return ways, weights
    face, across = mirror_height(scene), np.array([1.0, 1.0, -1.0])
    image = places * across + [0, 0, 2 * face] - point
    meets = point[:2] + image[:, :2] * ((face - point[2]) / image[:, 2:])
    on_window = (np.abs(meets) < np.array(scene.gel.size_mm) / 2).all(axis=1)
    mirrored, there = _from(light, image, facing * across)
    # As in the tracer: the window counts as gel of its apparent thickness, its face reflects as its own.
    sine_squared = (scene.lights.gel_ior / scene.lights.window_ior) ** 2 * (1 - mirrored[:, 2] ** 2)
    share = reflectance(np.sqrt(np.maximum(1 - sine_squared, 0)), scene.lights.window_ior, 1.0)
    return np.concatenate([ways, mirrored]), np.concatenate([weights, there * share * on_window])


def _from(light: Light, way: NDArray[np.floating], facing: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Unit directions and weights of places on a light that `way` leads to."""
    distance = np.linalg.norm(way, axis=1)
    direction = way / distance[:, None]
    cosine = np.maximum(-direction @ facing, 0)
    flux = light.power * (light.lobe + 1) / (2 * math.pi) / len(way)
    return direction, flux * cosine**light.lobe / distance**2
