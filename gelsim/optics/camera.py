"""The sensor's camera: which pixel sees which point. Plain NumPy.

A pinhole in air looks along +z through the window and the gel. Refraction at the two flat faces is folded into one pinhole inside the gel,
at its apparent distance: for rays near the axis (tan = sin) a path of length t in a medium of index n appears, from within a medium of
index n_g, as t n_g / n. With air A, window t_w and gel h between pinhole and the rest surface,

    D = A n_g + t_w n_g / n_w + h,      column = W/2 + x D / ((D + z) p),   row = H/2 + y D / ((D + z) p),

p the size of a pixel on the plane z = 0. Left out: what is beyond the axis' neighbourhood (a distortion below 1 % of the half field,
docs/optics.md says how much), lens distortion, vignetting and depth of field.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelsim.results import Membrane
from gelsim.scene import Scene


def apparent_distance(scene: Scene) -> float:
    """From the pinhole, as it appears inside the gel, to the plane z = 0 [m]."""
    gel, lights = scene.gel, scene.lights
    air_mm = scene.camera.distance_mm - lights.window_thickness_mm - gel.thickness_mm
    return 1e-3 * (air_mm * lights.gel_ior + lights.window_thickness_mm * lights.gel_ior / lights.window_ior + gel.thickness_mm)


def pixel_size(scene: Scene) -> float:
    """Width and height of a pixel on the plane z = 0 [m]: the smallest square that fits the whole field into the picture."""
    size, resolution = np.array(scene.camera.field_mm) * 1e-3, np.array(scene.render.resolution)
    return float(np.max(size / resolution))


def project(scene: Scene, points: ArrayLike) -> NDArray[np.float64]:
    """Where points appear in the picture.

    Args:
        points: Positions [m], shape (K, 3).
    Returns:
        (column, row) [px], shape (K, 2); (0, 0) is the top left corner of the top left pixel, whose centre is (0.5, 0.5). Not cropped.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    distance = apparent_distance(scene)
    scale = distance / ((distance + points[:, 2]) * pixel_size(scene))
    return points[:, :2] * scale[:, None] + np.array(scene.render.resolution) / 2


def marker_pixels(scene: Scene, membrane: Membrane) -> NDArray[np.float64]:
    """(column, row) of the marker centres [px], shape (K, 2); NaN where a centre lies outside the picture."""
    pixels = project(scene, membrane.marker_centres)
    inside = np.all((pixels >= 0) & (pixels < np.array(scene.render.resolution)), axis=1)
    return np.where(inside[:, None], pixels, np.nan)


def height_map(scene: Scene, membrane: Membrane) -> NDArray[np.float32]:
    """z of the membrane at the centre of each pixel.

    Every triangle is projected, and each pixel centre inside it gets z by perspective-correct interpolation; where the membrane folds over
    itself the part nearest to the camera is seen.

    Returns:
        z [m], shape (H, W); NaN where the camera sees no gel.
    """
    width, height = scene.render.resolution
    corners = project(scene, membrane.positions)[membrane.faces]
    inverse_depth = 1.0 / (apparent_distance(scene) + membrane.positions[:, 2])[membrane.faces]
    # Pixel (c, r) has its centre at (c + ½, r + ½): the first and the last centre within each triangle's box.
    first = np.ceil(corners.min(axis=1) - 0.5).astype(int)
    last = np.floor(corners.max(axis=1) - 0.5).astype(int)
    first, last = np.maximum(first, 0), np.minimum(last, [width - 1, height - 1])
    visible = np.flatnonzero(np.all(last >= first, axis=1))
    nearest = np.full((height, width), -np.inf)
    if len(visible) == 0:
        return np.full((height, width), np.nan, np.float32)
    reach = (last - first)[visible].max(axis=0)
    for row_step in range(reach[1] + 1):
        for column_step in range(reach[0] + 1):
            pixel = first[visible] + [column_step, row_step]
            chosen = visible[np.all(pixel <= last[visible], axis=1)]
            pixel = first[chosen] + [column_step, row_step]
            a, b, c = (corners[chosen, i] - (pixel + 0.5) for i in range(3))
            weights = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
            area = weights.sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                weights /= area[:, None]
            # A rounding error must not open gaps between neighbours, hence not exactly zero.
            hit = np.all(weights >= -1e-9, axis=1) & (area != 0)
            depth = np.einsum("ki,ki->k", weights[hit], inverse_depth[chosen[hit]])
            np.maximum.at(nearest, (pixel[hit, 1], pixel[hit, 0]), depth)
    with np.errstate(divide="ignore"):
        return np.where(nearest > 0, 1.0 / nearest - apparent_distance(scene), np.nan).astype(np.float32)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
