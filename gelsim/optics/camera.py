"""The sensor's camera: which ray a pixel sees along, and which pixel sees a point. NumPy, or any arrays that know + − × ÷.

A pinhole in air looks through the flat window and the gel. A direction of slope s = tan θ in air (angles from the window's normal) has,
in a medium of index n, the slope s / √(n²(1 + s²) − s²) (Snell). So from the pinhole to the height z a ray travels sideways by

    r(s, z) = A s + Σ_k t_k s / √(n_k²(1 + s²) − s²),    k: window of thickness t_w, gel of thickness h + z,

with A the air between pinhole and window. Pixel to ray is in closed form. Point to pixel solves r(s, z) = r for s by Newton's method: r is
increasing and concave in s, so from s = 0 the iterates rise to the root without overshoot. Picture plane: the camera's own direction
(u, v, 1) shows at the pixel q with (u, v) = g (1 + k₁ρ² + k₂ρ⁴), g = (q − centre)/f, ρ the distance from the picture's centre in half
diagonals; f is such that the field is exact at the middle of the tighter pair of edges while the camera stands upright on its axis. The
camera may stand off the axis and be tilted. Rays of a pixel are chief rays: depth of field is left out (docs/optics.md says what it
would be).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelsim.optics.fresnel import reflectance
from gelsim.results import Membrane
from gelsim.scene.definition import Scene

NEWTON_STEPS = 8
"""From s = 0, for slopes up to 3 in air and indices up to 1.6, four steps leave 1e-3 and six less than rounding."""


@dataclass(frozen=True)
class Lens:
    """The camera in numbers. Lengths in one unit of choice; each number may be an array of a differentiable kind."""

    focal: Any
    """[px] at the picture's centre."""
    centre: tuple[float, float]
    """(column, row) of the picture's centre."""
    distortion: tuple[Any, Any]
    half_diagonal: float
    """Of the picture [px]."""
    axes: tuple[tuple[Any, Any, Any], ...]
    """Rotation matrix from the camera's directions to the scene's."""
    foot: tuple[Any, Any]
    """(x, y) of the pinhole."""
    height: Any
    """-z of the pinhole."""
    air: Any
    layers: tuple[tuple[Any, Any], ...]
    """(thickness, index) of window and gel, in the order of the light from the pinhole."""


def make_lens(scene: Scene, unit: float = 1e-3, distance_mm: Any = None, offset_mm: Any = None, sqrt: Callable = np.sqrt) -> Lens:
    """The scene's camera.

    Args:
        scene: Its camera, lights, gel and render resolution.
        unit: In which lengths are given, in metres times 1e3: 1e-3 gives metres, 1 millimetres.
        distance_mm: In place of the scene's, for derivatives; likewise offset_mm.
        sqrt: Of the numbers' kind.
    """
    camera, lights, gel = scene.camera, scene.lights, scene.gel
    distance_mm = camera.distance_mm if distance_mm is None else distance_mm
    offset_mm = camera.offset_mm if offset_mm is None else offset_mm
    width, height = scene.render.resolution
    layers = ((lights.window_thickness_mm * unit, lights.window_ior), (gel.thickness_mm * unit, lights.gel_ior))
    air = (distance_mm - lights.window_thickness_mm - gel.thickness_mm) * unit
    half_diagonal = float(np.hypot(width, height) / 2)
    # The tighter pair of edges, left and right where they are equal; along the other one the picture shows a little more than the field.
    tight = int(camera.field_mm[1] / height > 1.000001 * camera.field_mm[0] / width)
    edge = scene.render.resolution[tight] / 2
    slope = solve_slope(camera.field_mm[tight] / 2 * unit, air, layers, sqrt)
    focal = edge * _bend((edge / half_diagonal) ** 2, camera.distortion) / slope
    # Plain floats: NumPy's own would swallow arrays of other kinds.
    (cx, sx), (cy, sy) = ((math.cos(math.radians(angle)), math.sin(math.radians(angle))) for angle in camera.tilt_deg)
    axes = ((cy, sy * sx, sy * cx), (0.0, cx, -sx), (-sy, cy * sx, cy * cx))
    foot = (offset_mm[0] * unit, offset_mm[1] * unit)
    return Lens(focal, (width / 2, height / 2), camera.distortion, half_diagonal, axes, foot, distance_mm * unit, air, layers)


def _bend(rho_squared: Any, distortion: tuple[Any, Any]) -> Any:
    return 1 + rho_squared * (distortion[0] + rho_squared * distortion[1])


def sideways(slope: Any, air: Any, layers: tuple, sqrt: Callable) -> tuple[Any, Any]:
    """How far a ray of this slope in air travels sideways through air and layers, and the derivative by the slope."""
    reach, rate = air * slope, air
    for thickness, index in layers:
        root = sqrt(index**2 + (index**2 - 1) * slope**2)
        reach, rate = reach + thickness * slope / root, rate + thickness * index**2 / (root * root * root)
    return reach, rate


def solve_slope(reach: Any, air: Any, layers: tuple, sqrt: Callable = np.sqrt) -> Any:
    """Slope in air of the ray that travels sideways by `reach` through air and layers."""
    slope = 0.0 * reach
    for _ in range(NEWTON_STEPS):
        value, rate = sideways(slope, air, layers, sqrt)
        slope = slope + (reach - value) / rate
    return slope


def gel_ray(lens: Lens, column: Any, row: Any, sqrt: Callable = np.sqrt) -> tuple[tuple[Any, Any, Any], tuple[Any, Any, Any], Any]:
    """The ray of a picture's point, in the gel.

    Args:
        column, row: [px], (0, 0) the corner of the picture.
    Returns:
        Where it enters the gel, its unit direction there (components apart), and the cosine of its angle with the window's normal in air.
    """
    across, down = column - lens.centre[0], row - lens.centre[1]
    bend = _bend((across**2 + down**2) / lens.half_diagonal**2, lens.distortion) / lens.focal
    u, v = across * bend, down * bend
    x, y, z = (axis[0] * u + axis[1] * v + axis[2] for axis in lens.axes)
    slope_x, slope_y = x / z, y / z
    squared = slope_x**2 + slope_y**2
    (window, window_index), (gel, gel_index) = lens.layers
    # Slope in a medium over the slope in air.
    in_window = 1 / sqrt(window_index**2 + (window_index**2 - 1) * squared)
    in_gel = 1 / sqrt(gel_index**2 + (gel_index**2 - 1) * squared)
    across_face = lens.air + window * in_window
    origin = (lens.foot[0] + across_face * slope_x, lens.foot[1] + across_face * slope_y, -gel)
    length = sqrt(1 + in_gel**2 * squared)
    direction = (in_gel * slope_x / length, in_gel * slope_y / length, 1 / length)
    return origin, direction, 1 / sqrt(1 + squared)


def pixel_rays(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays of all pixels' centres in the gel: origins on its inner face [m] and unit directions, each of shape (H, W, 3)."""
    width, height = scene.render.resolution
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    origin, direction, _ = gel_ray(make_lens(scene), column, row)
    return np.stack(np.broadcast_arrays(*origin), axis=-1), np.stack(direction, axis=-1)


def seen_places(scene: Scene, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the rays of pixels (column, row), shape (K, 2), meet the plane z = 0 [m], shape (K, 2)."""
    origin, direction, _ = gel_ray(make_lens(scene), pixels[:, 0], pixels[:, 1])
    return np.stack([o - origin[2] / direction[2] * d for o, d in zip(origin[:2], direction[:2], strict=True)], axis=-1)


def project(scene: Scene, points: ArrayLike) -> NDArray[np.float64]:
    """Where points appear in the picture.

    Args:
        points: Positions in the gel [m], shape (K, 3).
    Returns:
        (column, row) [px], shape (K, 2); (0, 0) is the top left corner of the top left pixel, whose centre is (0.5, 0.5). Not cropped.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    lens = make_lens(scene)
    x, y = points[:, 0] - lens.foot[0], points[:, 1] - lens.foot[1]
    reach = np.hypot(x, y)
    window, (gel, gel_index) = lens.layers
    slope = solve_slope(reach, lens.air, (window, (gel + points[:, 2], gel_index)))
    # On the axis the direction is the normal itself.
    scale = np.divide(slope, reach, out=np.zeros_like(reach), where=reach > 0)
    ray = np.stack([x * scale, y * scale, np.ones_like(x)], axis=-1) @ np.array(lens.axes)
    # What a ray from beside or behind the camera would show: nothing.
    ahead = np.where(ray[:, 2] > 0, ray[:, 2], np.nan)
    ideal = ray[:, :2] / ahead[:, None] * lens.focal
    return _distorted(lens, ideal) + np.array(lens.centre)


def direction_to_eye(scene: Scene, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Unit directions in the gel from points [mm] toward the pinhole, both (P, 3)."""
    lens = make_lens(scene, 1.0)
    sideways_by = points[:, :2] - np.array(lens.foot)
    reach = np.linalg.norm(sideways_by, axis=1)
    window, (gel, gel_index) = lens.layers
    slope = solve_slope(reach, lens.air, (window, (gel + points[:, 2], gel_index)))
    in_gel = slope / np.sqrt(gel_index**2 + (gel_index**2 - 1) * slope**2)
    scale = np.divide(in_gel, reach, out=np.zeros_like(reach), where=reach > 0)
    way = np.column_stack([-sideways_by * scale[:, None], -np.ones(len(points))])
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def _distorted(lens: Lens, ideal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels from the centre, of the ideal ones: solves g (1 + k₁ρ² + k₂ρ⁴) = ideal by Newton's method along the radius."""
    if lens.distortion == (0.0, 0.0):
        return ideal
    wanted = np.linalg.norm(ideal, axis=1) / lens.half_diagonal
    first, second = lens.distortion
    rho = wanted.copy()
    for _ in range(12):
        squared = rho**2
        rho -= (rho * _bend(squared, lens.distortion) - wanted) / (1 + 3 * first * squared + 5 * second * squared**2)
    return ideal * np.divide(rho, wanted, out=np.ones_like(rho), where=wanted > 0)[:, None]


def apparent_distance(scene: Scene) -> float:
    """From the pinhole, as it appears from within the gel along the normal, to the plane z = 0 [m]."""
    lens = make_lens(scene)
    (window, window_index), (gel, gel_index) = lens.layers
    return float((lens.air + window / window_index) * gel_index + gel)


def pixel_size(scene: Scene) -> float:
    """Mean width and height of a pixel on the plane z = 0 [m]: the smallest square that fits the whole field into the picture."""
    size, resolution = np.array(scene.camera.field_mm) * 1e-3, np.array(scene.render.resolution)
    return float(np.max(size / resolution))


def apparent_positions(scene: Scene, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points [m] moved sideways to where a plain pinhole at the apparent distance on the axis must see them, shape (K, 3).

    For renderers that know no other camera. The points keep their height; docs/optics.md says how far they move.
    """
    scale = (apparent_distance(scene) + points[:, 2:]) / apparent_distance(scene) * pixel_size(scene)
    return np.column_stack([(project(scene, points) - np.array(scene.render.resolution) / 2) * scale, points[:, 2]])


def window_transmission(scene: Scene) -> NDArray[np.float64]:
    """What the window passes to each pixel, relative to the picture's centre (Fresnel), shape (H, W)."""
    width, height = scene.render.resolution
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    lens = make_lens(scene)
    return _transmission(scene, lens, column, row) / _transmission(scene, lens, *lens.centre)


def _transmission(scene: Scene, lens: Lens, column: Any, row: Any) -> Any:
    """Of a camera ray through the window's two faces."""
    cosine = gel_ray(lens, column, row)[2]
    window_index, gel_index = scene.lights.window_ior, scene.lights.gel_ior
    inside = np.sqrt(1 - (1 - cosine**2) / window_index**2)
    return (1 - reflectance(cosine, 1.0, window_index)) * (1 - reflectance(inside, window_index, gel_index))


def marker_pixels(scene: Scene, membrane: Membrane) -> NDArray[np.float64]:
    """(column, row) of the marker centres [px], shape (K, 2); NaN where a centre lies outside the picture."""
    pixels = project(scene, membrane.marker_centres)
    inside = np.all((pixels >= 0) & (pixels < np.array(scene.render.resolution)), axis=1)
    return np.where(inside[:, None], pixels, np.nan)


def height_map(scene: Scene, membrane: Membrane) -> NDArray[np.float32]:
    """z of the membrane at the centre of each pixel.

    Every triangle is projected, and each pixel centre inside it gets z by perspective-correct interpolation (with the apparent distance:
    over a triangle of 0.08 mm the exact rays differ by less than a nanometre); where the membrane folds over itself the part nearest to
    the camera is seen.

    Returns:
        z [m], shape (H, W); NaN where the camera sees no gel.
    """
    width, height = scene.render.resolution
    corners = project(scene, membrane.positions)[membrane.faces]
    inverse_depth = 1.0 / (apparent_distance(scene) + membrane.positions[:, 2])[membrane.faces]
    seen = np.isfinite(corners).all(axis=(1, 2))
    corners, inverse_depth = corners[seen], inverse_depth[seen]
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
