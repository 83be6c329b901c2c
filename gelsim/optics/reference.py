"""The picture worked out by hand where that is possible: a Lambertian surface under Lambertian rectangles, no inter-reflection. NumPy
float64.

    L_o(x) = ρ/π Σ_lights ∫_A L cos θ cos θ' / r² dA,

θ at the surface and θ' at the light, both clipped at 90°. The integral is a midpoint sum: its error falls with the square of the cells'
size over the distance. The rays come from `optics.camera`. Written apart from the renderer, as its test;
shadows are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.camera import pixel_rays
from gelsim.optics.spectra import light_colour
from gelsim.scene.definition import Light, Scene


def plane_points(scene: Scene) -> NDArray[np.float64]:
    """Where the ray through each pixel's centre meets the plane z = 0 [m], shape (H, W, 3)."""
    origin, direction = pixel_rays(scene)
    return origin - direction * (origin[..., 2:] / direction[..., 2:])


def irradiance(light: Light, points: NDArray[np.float64], normals: NDArray[np.float64], cells: int = 8) -> NDArray[np.float64]:
    """Light that falls on each point [mW/mm²], shape (..., 3).

    Args:
        points: [m], shape (..., 3).
        normals: Unit, toward the light's side, shape (..., 3) or (3,).
        cells: The rectangle is cut into cells x cells.
    """
    facing = np.array(light.direction) / np.linalg.norm(light.direction)
    along = np.array([-facing[1], facing[0], 0.0])
    # Facing straight up leaves the turn about z open; x then.
    along = along / np.linalg.norm(along) if along.any() else np.array([1.0, 0.0, 0.0])
    up = np.cross(facing, along)
    steps = (np.arange(cells) + 0.5) / cells - 0.5
    # Of intensity L A cos^m over the hemisphere: Φ = 2 π L A / (m + 1); m = 1 is a Lambertian face.
    radiance = light.power * light_colour(light) * (light.lobe + 1) / (2 * np.pi * light.size_mm[0] * light.size_mm[1])
    cell_area = light.size_mm[0] * light.size_mm[1] / cells**2
    total = np.zeros((*points.shape[:-1], 3))
    for s in steps:
        for t in steps:
            source = np.array(light.position_mm) + s * light.size_mm[0] * along + t * light.size_mm[1] * up
            path = source - points * 1e3
            squared = (path**2).sum(axis=-1)
            at_surface = np.clip((path * normals).sum(axis=-1), 0, None)
            at_light = np.clip(-(path * facing).sum(axis=-1), 0, None)
            lobe = (at_light / np.sqrt(squared)) ** (light.lobe - 1)
            total += (at_surface * at_light * lobe / squared**2)[..., None] * radiance * cell_area
    return total


def lambert_plane(scene: Scene, cells: int = 8) -> NDArray[np.float64]:
    """Radiance of a flat, unmarked, purely diffuse gel in each pixel's centre, shape (H, W, 3); `cells` as for `irradiance`."""
    points = plane_points(scene)
    inward = np.array([0.0, 0.0, -1.0])
    return sum(irradiance(light, points, inward, cells) for light in scene.lights.lights) * np.array(scene.coating.albedo) / np.pi
