"""A picture worked out directly from the parameters, fast enough to be fitted: no inter-reflection, everything else as the renderer has it.

    x_c = m_c(q) [B_c + e (L_c − L⁰_c)],
    L_c(x) = Σ_l L_lc v_l ∫_A f_c(n, ω_l, ω_o) (n·ω_l)(n_l·−ω_l) / r² dA,      f_c = (1 − s) ρ_c/π + s F_c D G / (4 n·ω_l n·ω_o),

with D and G of GGX (Walter et al. 2007, as in Mitsuba), the rectangles' integrals by Gauss' rule, and v_l the visible share of the light:
the elevation of the dent's profile toward the light against the light's own height. L⁰ is L without the press, B and m are the even part of
the photographed rest and its paint, which moves with the membrane, as in `optics.rest`. Level = 255 · sRGB(x)^γ, e the exposure.

Colours enter linearly, so that derivatives by colour cost nothing. Left out: inter-reflection, grain, the window's own reflections;
`calibrate.run` corrects for what the renderer adds. Lengths in mm throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate.dent import DentFamily, effective_radius
from gelsim.calibrate.drag import carried
from gelsim.optics.camera import solve_slope
from gelsim.optics.rest import DARKEST
from gelsim.optics.srgb import SRGB_FOOT, srgb_linear, srgb_tone

Array = NDArray[np.float64]

ALONG, ACROSS = np.polynomial.legendre.leggauss(3), np.polynomial.legendre.leggauss(2)
STEPS = np.array([0.12, 0.25, 0.45, 0.7, 1.0, 1.4, 1.9, 2.5, 3.3, 4.3])
"""Distances of the march toward a light, in contact radii √(R' d)."""
LEAST_SHARE = 0.02
"""Of a light, that the surface at rest leaves visible: where it leaves less, a dent hides it in that proportion only."""
LEAST_AIR_MM = 0.5
"""Between camera and window."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """Places in the pictures that are compared."""

    place: Array
    """From the picture's middle [px], x and y, shape (N, 2)."""
    press: NDArray[np.int64]
    """Which press each belongs to, −1 for the rest frame."""


@dataclass(frozen=True, eq=False)
class Surface:
    """What the pixels see."""

    point: Array
    """[mm], shape (N, 3)."""
    normal: Array
    """Unit, into the gel."""
    view: Array
    """Unit, toward the camera."""
    centre: Array
    """First touch of the pixel's press, shape (N, 2)."""
    depth: Array
    """Of the pixel's press, 0 in the rest frame."""
    radius: Array
    """R' of the pixel's press [mm]."""
    drag: Array
    """Of the pixel's press [mm], shape (N, 2)."""


@dataclass(frozen=True, eq=False)
class Rest:
    """The picture without contact, and its even part, which stays where it is."""

    levels: Array
    """0 … 255, shape (H, W, 3)."""
    even: Array
    """Likewise."""

    def at(self, place: Array, came: Array, gamma: float) -> tuple[Array, Array]:
        """Even light where a pixel is, and paint where its piece of coat came from, linear, each of shape (N, 3).

        Args:
            place, came: From the picture's middle [px], shape (N, 2).
        """
        even, painted, behind = self._at(self.even, place), self._at(self.levels, came), self._at(self.even, came)
        return untone(even, gamma), untone(painted, gamma) / np.maximum(untone(behind, gamma), DARKEST)

    def _at(self, levels: Array, place: Array) -> Array:
        height, width = levels.shape[:2]
        column = np.clip(place[:, 0] + width / 2 - 0.5, 0, width - 1)
        row = np.clip(place[:, 1] + height / 2 - 0.5, 0, height - 1)
        i, j = np.minimum(column.astype(int), width - 2), np.minimum(row.astype(int), height - 2)
        s, t = (column - i)[:, None], (row - j)[:, None]
        upper = levels[j, i] * (1 - s) + levels[j, i + 1] * s
        return upper * (1 - t) + (levels[j + 1, i] * (1 - s) + levels[j + 1, i + 1] * s) * t


@dataclass(frozen=True)
class Shape:
    """Camera and gel: what decides where a pixel looks."""

    mm_per_px: float
    distance_mm: float
    """Of the pinhole from the plane z = 0."""
    layers: tuple[tuple[float, float], ...]
    """(thickness [mm], index) of window and gel."""
    half_width_px: float
    """Of the picture: where its field is exact."""
    curvature: float
    """Of the dome [1/mm]."""
    ball_mm: Array
    """Of each press, shape (P,)."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """Of the camera about x and y [rad]; its foot is where the picture's middle shows the gel's."""


def rays(shape: Shape, place: Array) -> tuple[Array, Array]:
    """Where rays of places in the picture meet z = 0 [mm], and their slopes in the gel, each of shape (N, 2), as in `optics.camera`."""
    air = max(shape.distance_mm - sum(thickness for thickness, _ in shape.layers), LEAST_AIR_MM)
    focal = shape.half_width_px / solve_slope(shape.half_width_px * shape.mm_per_px, air, shape.layers)
    start, slope = _through(shape, air, place / focal)
    return start + foot(shape), slope


def foot(shape: Shape) -> Array:
    """x and y of the pinhole [mm]."""
    air = max(shape.distance_mm - sum(thickness for thickness, _ in shape.layers), LEAST_AIR_MM)
    return -_through(shape, air, np.zeros((1, 2)))[0][0]


def _through(shape: Shape, air: float, ideal: Array) -> tuple[Array, Array]:
    """Of rays by their slopes in the camera's own directions: how far sideways they reach z = 0, and their slopes in the gel."""
    (cx, sx), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in shape.tilt)
    x, y, z = (a * ideal[:, 0] + b * ideal[:, 1] + c for a, b, c in ((cy, sy * sx, sy * cx), (0.0, cx, -sx), (-sy, cy * sx, cy * cx)))
    in_air = np.stack([x / z, y / z], axis=1)
    squared = (in_air**2).sum(axis=1)
    reach, bent = np.full(len(ideal), air), np.ones(len(ideal))
    for thickness, index in shape.layers:
        bent = 1 / np.sqrt(index**2 + (index**2 - 1) * squared)
        reach = reach + thickness * bent
    return in_air * reach[:, None], in_air * bent[:, None]


def surface(shape: Shape, dents: DentFamily, presses: Array, pixels: Pixels) -> Surface:
    """Where each pixel's ray meets the dented dome.

    Args:
        presses: Of `parameters.PRESS`, shape (P, 5).
    """
    start, slope = rays(shape, pixels.place)
    touched = pixels.press >= 0
    centre, depth, radius, drag = np.zeros_like(start), np.zeros(len(start)), np.ones(len(start)), np.zeros_like(start)
    if len(presses):
        which = pixels.press[touched]
        # First touch of a ball on a dome: nearer to the dome's top than the ball's apex.
        centre[touched] = presses[which, :2] / (1 + shape.ball_mm[which, None] * shape.curvature)
        radius[touched] = effective_radius(shape.ball_mm[which], shape.curvature)
        depth[touched] = dents.clipped(presses[which, 2], radius[touched])
        drag[touched] = presses[which, 3:]
    at = start.copy()
    z, gradient = np.zeros(len(start)), np.zeros_like(start)
    for _ in range(4):
        z, gradient = _height(shape, dents, at, centre, depth, touched, radius)
        at = start + slope * z[:, None]
    point = np.column_stack([at, z])
    normal = np.column_stack([gradient, -np.ones(len(z))])
    normal /= np.sqrt((normal**2).sum(axis=1))[:, None]
    view = np.column_stack([-slope, -np.ones(len(z))])
    view /= np.sqrt((view**2).sum(axis=1))[:, None]
    return Surface(point, normal, view, centre, depth, radius, drag)


def rest_place(shape: Shape, dents: DentFamily, pixels: Pixels, seen: Surface) -> Array:
    """Where at rest the piece of coat appeared that a pixel sees now: from the picture's middle [px], shape (N, 2)."""
    place = pixels.place.copy()
    some = np.flatnonzero(seen.depth > 0)
    if len(some) == 0:
        return place
    away = seen.point[some, :2] - seen.centre[some]
    distance = np.sqrt((away**2).sum(axis=1)) + 1e-12
    before, radius = distance.copy(), seen.radius[some]
    for _ in range(6):
        before = np.maximum(distance - dents.pulled(before, seen.depth[some], radius), 0.0)
    away = away * (before / distance)[:, None]
    contact = np.sqrt(radius * seen.depth[some])
    at = seen.centre[some] + away - carried(away, contact, shape.layers[-1][0], seen.drag[some])
    height = dome(shape.curvature, at)[0]
    here = place[some]
    for _ in range(3):
        start, slope = rays(shape, here)
        here = here + (at - start - slope * height[:, None]) / shape.mm_per_px
    place[some] = here
    return place


def dome(curvature: float, at: Array) -> tuple[Array, Array]:
    """Height and gradient of the dome; the root is that of a sphere, 1 − κ²ρ² kept positive."""
    root = np.sqrt(np.maximum(1 - curvature**2 * (at**2).sum(axis=-1), 0.05))
    return -curvature * (at**2).sum(axis=-1) / (1 + root), -curvature * at / root[..., None]


def _height(shape: Shape, dents: DentFamily, at: Array, centre: Array, depth: Array, touched: NDArray, radius: Array):
    z, gradient = dome(shape.curvature, at)
    away = at[touched] - centre[touched]
    distance = np.sqrt((away**2).sum(axis=1)) + 1e-12
    dent, slope = dents.surface(distance, depth[touched], radius[touched])
    z[touched] += dent
    gradient[touched] += away * (slope / distance)[:, None]
    return z, gradient


def visible(shape: Shape, dents: DentFamily, seen: Surface, light: Array) -> Array:
    """Share of a light that the dent leaves visible from each point, of each of its places ALONG, shape (A, N).

    Attached shadows are the cosine's affair. A long light's shadow is as soft across its length as it is long: with one share for all of it
    a fitted light was 20 to 60 % too tall. Of a light that the surface at rest hides in part, it is the share of what is left: so a dent
    changes nothing far from it, however low the light stands.
    """
    share = np.ones((len(ALONG[0]), len(seen.point)))
    some = np.flatnonzero(seen.depth > 0)
    if len(some) == 0 or np.hypot(light[0], light[1]) < -light[2]:
        return share
    depth, radius = seen.depth[some], seen.radius[some]
    unit = np.sqrt(radius * depth)
    x, y, z = np.ascontiguousarray(seen.point[some].T)
    centre_x, centre_y = np.ascontiguousarray(seen.centre[some].T)
    tilted = np.sqrt(max(1 - facing(light)[2] ** 2, 0.01))
    along = _axes(light)[0]
    above, at_rest, half = (np.empty((len(share), len(some))) for _ in range(3))
    for k, s in enumerate(ALONG[0]):
        across, down = light[0] + 0.5 * s * light[5] * along[0] - x, light[1] + 0.5 * s * light[5] * along[1] - y
        far = np.sqrt(across**2 + down**2)
        across, down = across / far, down / far
        highest, unmoved = np.full(len(some), -np.inf), np.full(len(some), -np.inf)
        for step in STEPS:
            reach = step * unit
            at_x, at_y = x + across * reach, y + down * reach
            squared = at_x**2 + at_y**2
            dome = -shape.curvature * squared / (1 + np.sqrt(np.maximum(1 - shape.curvature**2 * squared, 0.05)))
            dent = dents.height_at(np.sqrt((at_x - centre_x) ** 2 + (at_y - centre_y) ** 2), depth, radius)
            np.maximum(highest, (z - dome - dent) / reach, out=highest)
            np.maximum(unmoved, (z - dome) / reach, out=unmoved)
        above[k], at_rest[k] = (z - light[2]) / far - highest, (z - light[2]) / far - unmoved
        # Half of the light's height as seen from here, in slope.
        half[k] = np.maximum(0.5 * light[6] * tilted / far, 0.02)
    # Each place stands for a part of the length, over which the shadow's edge rises or falls.
    left, of = (
        np.clip(over / (2 * np.hypot(half, np.abs(np.gradient(over, ALONG[0], axis=0)) * (0.5 * ALONG[1][:, None]))) + 0.5, 0, 1)
        for over in (above, at_rest)
    )
    share[:, some] = np.minimum(left / np.maximum(of, LEAST_SHARE), 1)
    return share


def facing(light: Array) -> Array:
    """Unit normal of a light's face."""
    return np.array([np.cos(light[3]) * np.cos(light[4]), np.sin(light[3]) * np.cos(light[4]), np.sin(light[4])])


def _axes(light: Array) -> tuple[Array, Array]:
    """Unit vectors along and across a light's face."""
    front = facing(light)
    along = np.cross([0.0, 0.0, 1.0], front)
    along = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return along, np.cross(front, along)


def light_maps(seen: Surface, light: Array, roughness: float, share: Array) -> tuple[Array, Array]:
    """Diffuse and glossy radiance under one light of radiance 1, for an albedo and a flake share of 1, each shape (N,).

    Args:
        light: x, y, z [mm], azimuth and elevation of its face [rad], size along and across [mm].
        share: Visible share of each of its places ALONG, shape (A, N).
    """
    front = facing(light)
    along, up = _axes(light)
    diffuse, glossy = np.zeros(share.shape[1]), np.zeros(share.shape[1])
    px, py, pz = np.ascontiguousarray(seen.point.T)
    nx, ny, nz = np.ascontiguousarray(seen.normal.T)
    vx, vy, vz = np.ascontiguousarray(seen.view.T)
    out = np.maximum(nx * vx + ny * vy + nz * vz, 1e-3)
    alpha2 = roughness**2
    mask_out = _masking(out, alpha2)
    for s, weight_s, shown in zip(*ALONG, share, strict=True):
        for t, weight_t in zip(*ACROSS, strict=True):
            source = light[:3] + 0.5 * s * light[5] * along + 0.5 * t * light[6] * up
            x, y, z = source[0] - px, source[1] - py, source[2] - pz
            inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
            x, y, z = x * inverse, y * inverse, z * inverse
            into = np.maximum(x * nx + y * ny + z * nz, 0.0)
            leaving = np.maximum(-(x * front[0] + y * front[1] + z * front[2]), 0.0)
            weight = (weight_s * weight_t / 4 * light[5] * light[6]) * leaving * inverse**2 * shown
            diffuse += weight * into
            hx, hy, hz = x + vx, y + vy, z + vz
            tilt = (hx * nx + hy * ny + hz * nz) ** 2 / (hx * hx + hy * hy + hz * hz)
            spread = alpha2 / (np.pi * (tilt * (alpha2 - 1) + 1) ** 2)
            glossy += weight * (into > 0) * spread * _masking(np.maximum(into, 1e-3), alpha2) * mask_out / (4 * out)
    return diffuse / np.pi, glossy


def _masking(cosine: Array, alpha2: float) -> Array:
    """Smith's G1 of GGX."""
    return 2 / (1 + np.sqrt(1 + alpha2 * (1 / cosine**2 - 1)))


def tone(linear: Array, gamma: float) -> tuple[Array, Array]:
    """Level (0 … 255, clipped) of a linear value, and its derivative."""
    inside = (linear > 0) & (linear < 1)
    value = np.clip(linear, 1e-9, 1.0)
    srgb = srgb_tone(value)
    steep = np.where(value <= SRGB_FOOT, 12.92, 1.055 / 2.4 * value ** (1 / 2.4 - 1))
    level = 255.0 * srgb**gamma
    return level, np.where(inside, level * gamma / srgb * steep, 0.0)


def untone(level: Array, gamma: float) -> Array:
    """Linear value of a level, the inverse of `tone`."""
    return srgb_linear(np.clip(level / 255.0, 0, 1) ** (1 / gamma))
