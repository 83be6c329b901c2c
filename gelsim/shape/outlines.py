"""The geometry of each shape by its name: profiles of lines and arcs, bores, planes, undersides. `gelsim.shape.shapes` makes solids of it.

A profile goes from the axis to the base, as (r, z) or (x, z) segments [m], the contact apex at the origin; what else is to be known of a
shape is its row in `gelsim.scene.shape_table`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.scene.definition import Body
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.solids import HeightField, Plane, Rounded, Segment, polyhedron
from gelsim.units import DEG, MM

FOOT = 0.6
"""Half width of the foot above a tube or a tomato, over its radius."""
SAMPLE_WIDTH = 25e-3
"""Width of the caps cut from large balls and rods [m] (interfaces.md §2)."""

BLUNTER = {"fast": 2.0}
"""Times a default edge radius, by fidelity: what its faces can follow. Eleven sharp mesh parts with 0.1, 0.2, 0.25 mm at `fast`: forces are
4.6, 3.5, 6.0 % RMS off those of `balanced` (0.1 mm), in 144, 62, 70 s."""

ROUND_STEPS = 6
"""Of an arc between two rounded planes, in a coarse surface; three of them for its corner's middle to be one."""


# ---------------------------------------------------------------------------------------------------------------- lengths
def sides(body: Body) -> tuple[float, float]:
    """Half of what a block or a drawn shape measures along x and y [m]."""
    row = SHAPES[body.shape]
    return (body.width_mm or row.width_mm) * MM / 2, (body.length_mm or row.length_mm) * MM / 2


def wall(body: Body) -> float:
    """Of tube and shell; the thickness of a torus' ring [m]."""
    return (body.wall_mm or SHAPES[body.shape].wall * body.radius_mm) * MM


def edge_radius(body: Body, fidelity: str = "balanced") -> float:
    """Of a rigid object's rims and edges [m]: as the scene says, else its shape's, a quarter of the smallest feature at most."""
    if body.edge_radius_mm is not None:
        return body.edge_radius_mm * MM
    row, blunter = SHAPES[body.shape], BLUNTER.get(fidelity, 1.0)
    features = [2 * side for side in sides(body)] if row.drawn or row.relief else []
    features += [wall(body)] if row.wall else []
    return min([blunter * row.edge_radius_mm * MM, fine_feature(body) / 4, *(feature / 4 for feature in features)])


def fine_feature(body: Body) -> float:
    """The shortest wave of an uneven underside, or the thickness of a torus' ring [m], which both meshes follow; infinite without one."""
    row = SHAPES[body.shape]
    if row.wall and not bore(body):
        return wall(body)
    return body.wavelength_mm * MM if row.relief and body.amplitude_mm else np.inf


def _angle_deg(body: Body) -> float:
    angle = body.angle_deg or SHAPES[body.shape].angle_deg
    assert angle is not None, f"{body.shape} has no angle"
    return angle


# ---------------------------------------------------------------------------------------------------------------- profiles
Profile = tuple[Segment, ...]


def profile(body: Body) -> Profile:
    """The profile of a turned or drawn shape, from the axis to the base, as (r, z) or (x, z) segments [m].

    Raises:
        SceneError: Its segments do not meet, an arc's ends are not on its circle, or its row calls convex what turns right.
    """
    segments = PROFILES[body.shape](body)
    fault = _fault(segments, 1e-6 * body.height_mm * MM, SHAPES[body.shape].convex)
    if fault:
        raise SceneError(f"shape {body.shape}: {fault}")
    return segments


def _fault(segments: Profile, within: float, convex: bool) -> str:
    """What is wrong with a profile, to a length [m]: such a shape would be filled for minutes, or pressed as another."""

    def told(point: tuple[float, float]) -> str:
        return "({:.4g}, {:.4g}) mm".format(*(value / MM for value in point))

    for segment in segments:
        if not segment.on_circle(within):
            return f"an arc of {abs(segment.radius) / MM:g} mm in its profile does not pass {told(segment.start)} and {told(segment.end)}"
        if convex and segment.radius < 0:
            return f"its profile is not convex at {told(segment.start)}; its row needs convex=False"
    for one, other in itertools.pairwise(segments):
        if np.abs(np.subtract(one.end, other.start)).max() > within:
            return f"a segment of its profile ends at {told(one.end)}, the next begins at {told(other.start)}"
        (x0, z0), (x1, z1) = one.way(1), other.way(0)
        if convex and x0 * z1 - z0 * x1 < -1e-6:
            return f"its profile is not convex at {told(other.start)}; its row needs convex=False"
    return ""


def rounded(segments: Profile, radius: float) -> Profile:
    """A rigid object's profile, its tip and the corners between its lines rounded by arcs; its apex at z = 0.

    Args:
        radius: [m]. No arc reaches beyond the middle of a line.
    """
    (x, z), tip = segments[0].start, segments[0]
    mirrored = Segment((-tip.end[0], tip.end[1]), (-x, z), tip.radius)
    found: list[Segment] = []
    for number, (before, after) in enumerate(itertools.pairwise([mirrored, *segments])):
        u, v = before.way(1), after.way(0)
        turn = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))
        if before.radius or after.radius or turn < 1e-6 or radius == 0.0:
            found.append(after)
            continue
        shortest = min(np.linalg.norm(np.subtract(line.end, line.start)) for line in (before, after))
        reach = min(radius * np.tan(turn / 2), shortest / 2)
        size, corner = reach / np.tan(turn / 2), np.array(after.start)
        begin, end = corner - reach * u, corner + reach * v
        middle = begin + size * np.array([-u[1], u[0]])
        if number:
            found[-1] = replace(found[-1], end=_pair(begin))
        else:  # of the tip's arc one half
            begin = middle - [0.0, size]
        found += [Segment(_pair(begin), _pair(end), size, _pair(middle)), replace(after, start=_pair(end))]
    low = found[0].start[1]
    return tuple(
        Segment((one.start[0], one.start[1] - low), (one.end[0], one.end[1] - low), one.radius,
                None if one.centre is None else (one.centre[0], one.centre[1] - low)) for one in found
    )  # fmt: skip


def _pair(point: NDArray[np.float64]) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def bore(body: Body) -> Profile:
    """The profile of its hollow, from the top down [m]; of most shapes none."""
    return BORES[body.shape](body) if body.shape in BORES else ()


def _round(body: Body) -> Profile:
    h, r = body.height_mm * MM, body.radius_mm * MM
    wide = r if r <= h else min(SAMPLE_WIDTH / 2, np.sqrt(h * (2 * r - h)), r)
    rise = r - np.sqrt(max(r**2 - wide**2, 0.0))
    if rise > h * (1 - 1e-9):
        wide, rise = np.sqrt(h * (2 * r - h)), h
    return _with_foot(Segment((0.0, 0.0), (wide, rise), r), h)


def _pointed(body: Body, half: float) -> Profile:
    h, slope = body.height_mm * MM, 1.0 / np.tan(_angle_deg(body) * DEG / 2)
    wide = min(half, h / slope)
    return _with_foot(Segment((0.0, 0.0), (wide, wide * slope)), h)


def _blunt(body: Body, half: float) -> Profile:
    return _with_foot(Segment((0.0, 0.0), (half, 0.0)), body.height_mm * MM)


def _waisted(body: Body) -> Profile:
    h, r = body.height_mm * MM, body.radius_mm * MM
    neck = (FOOT * r, r + r * np.sqrt(1.0 - FOOT**2))
    return Segment((0.0, 0.0), neck, r), Segment(neck, (neck[0], h))


def _cup(body: Body) -> Profile:
    r = body.radius_mm * MM
    return _with_foot(Segment((0.0, 0.0), (r, r), r), body.height_mm * MM)


def _ring(body: Body) -> Profile:
    h, r, ring = body.height_mm * MM, body.radius_mm * MM, wall(body) / 2
    return (
        Segment((0.0, ring), (r - ring, ring)),
        Segment((r - ring, ring), (r + ring, ring), ring, (r, ring)),
        Segment((r + ring, ring), (r + ring, h)),
    )


def _truncated(body: Body) -> Profile:
    h, r = body.height_mm * MM, body.radius_mm * MM
    top = r + h / np.tan(_angle_deg(body) * DEG)
    return Segment((0.0, 0.0), (r, 0.0)), Segment((r, 0.0), (top, h))


def _with_foot(tip: Segment, h: float) -> Profile:
    wide, rise = tip.end
    return (tip,) if rise > h * (1 - 1e-9) else (tip, Segment(tip.end, (wide, h)))


PROFILES: dict[str, Callable[[Body], Profile]] = {
    "flat": lambda body: _blunt(body, sides(body)[0]),
    "hemisphere": _round,
    "cylinder": _round,
    "edge": lambda body: _pointed(body, sides(body)[0]),
    "cone": lambda body: _pointed(body, body.radius_mm * MM),
    "box": lambda body: _blunt(body, sides(body)[0]),
    "frustum": _truncated,
    "punch": lambda body: _blunt(body, body.radius_mm * MM),
    "tube": _waisted,
    "shell": _cup,
    "torus": _ring,
    "tomato": _waisted,
    "candy": lambda body: _blunt(body, sides(body)[0]),
}
"""Of turned and drawn shapes."""


def _bore_of_tube(body: Body) -> Profile:
    r = body.radius_mm * MM
    inner = r - wall(body)
    return (Segment((0.0, r + inner), (0.0, r - inner), -inner, (0.0, r)),)


def _bore_of_shell(body: Body) -> Profile:
    h, r = body.height_mm * MM, body.radius_mm * MM
    inner = r - wall(body)
    return Segment((inner, h), (inner, r)), Segment((inner, r), (0.0, r - inner), -inner, (0.0, r))


BORES: dict[str, Callable[[Body], Profile]] = {"tube": _bore_of_tube, "shell": _bore_of_shell}


# ---------------------------------------------------------------------------------------------------------------- planes, undersides
def _corner(body: Body, symmetry: frozenset[str]) -> list[Plane]:
    """Three faces of a cube that meet at the apex, in a square prism."""
    half = sides(body)[0]
    faces = [
        Plane((np.sqrt(2 / 3) * np.cos(azimuth), np.sqrt(2 / 3) * np.sin(azimuth), -np.sqrt(1 / 3)), 0.0)
        for azimuth in np.array([90.0, 210.0, 330.0]) * DEG
    ]
    around = [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)]
    return faces + [Plane(normal, half) for normal in (around if "x" in symmetry else [(-1.0, 0.0, 0.0), *around])]


def rounded_planes(planes: Sequence[Plane], radius: float) -> tuple[Rounded, NDArray[np.float64]]:
    """Three planes that meet below the rest of the `planes`, rounded, the lowest place at z = 0; and points on the surface, within the
    rest, whose hull is a coarse one. It is symmetric about x = 0, where points are for a cut there."""
    normals, rest = (np.array([plane.normal for plane in some]) for some in (planes[:3], planes[3:]))
    offsets = np.array([plane.offset for plane in planes[3:]])
    drop = radius * (1.0 / abs(normals[0, 2]) - 1.0)
    inner = [Plane(plane.normal, -plane.normal[2] * drop - radius) for plane in planes[:3]]
    patch = Rounded((inner[0], inner[1], inner[2]), radius)
    apex, steps = np.array([0.0, 0.0, radius]), np.linspace(0.0, 1.0, ROUND_STEPS + 1)
    ways = np.array([i * normals[0] + j * normals[1] + (1 - i - j) * normals[2] for i in steps for j in steps if i + j <= 1 + 1e-9])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    points = [apex + radius * ways]
    for one, other in itertools.combinations(normals, 2):
        ridge = np.cross(one, other)
        ridge *= np.sign(ridge[2]) / np.linalg.norm(ridge)
        begin = apex + radius * ways[np.abs(ways @ ridge) < 1e-9]  # the arc between the two faces
        room = offsets - begin @ rest.T
        begin, room = begin[(room >= -1e-12).all(axis=1)], room[(room >= -1e-12).all(axis=1)]
        along = rest @ ridge
        points.append(begin + (room[:, along > 1e-9] / along[along > 1e-9]).min(axis=1)[:, None] * ridge)
    sharp = [Plane(plane.normal, plane.offset + radius) for plane in inner]
    corners = polyhedron([*sharp, *planes[3:]])
    points += [patch.project(corners), corners]
    found = np.vstack(points)
    flat = found * [0.0, 1.0, 1.0]
    for _ in range(100):
        flat = patch.project(flat) * [0.0, 1.0, 1.0]
    found = np.vstack([found, flat])
    within, outward = patch.outward(found)
    deep = ((found - within) * outward).sum(axis=1) <= radius + 1e-9
    found = found[deep & (found @ rest.T <= offsets + 1e-9).all(axis=1)]
    found[np.abs(found) < 1e-12] = 0.0
    _, first = np.unique(np.round(found, 9), axis=0, return_index=True)
    return patch, found[np.sort(first)]


PLANES: dict[str, Callable[[Body, frozenset[str]], list[Plane]]] = {"corner": _corner}
"""All but the base; without those beyond a mirror plane that cuts the body."""


@lru_cache(maxsize=16)
def underside(body: Body) -> HeightField:
    """Of a relief, its lowest point at z = 0."""
    return UNDERSIDES[body.shape](body, body.amplitude_mm * MM, 2 * np.pi / (body.wavelength_mm * MM))


def _ridges(body: Body, size: float, k: float) -> HeightField:
    """(A/2)(1 - cos kx)."""
    return HeightField(size / 2, ((k, 0.0, 0.0, -size / 2),))


def _dots(body: Body, size: float, k: float) -> HeightField:
    """A (1 - (1 + cos kx)(1 + cos ky)/4), dots in a square grid, one at the apex."""
    quarter = -size / 4
    across = ((k, 0.0, 0.0, quarter), (0.0, k, 0.0, quarter), (k, k, 0.0, quarter / 2), (k, -k, 0.0, quarter / 2))
    return HeightField(0.75 * size, across)


def _random(body: Body, size: float, k: float) -> HeightField:
    """64 waves of one size, of random direction and phase, their wave numbers spread evenly over the areas of rings between a quarter and
    the whole of k."""
    rng, count = np.random.default_rng(body.pattern_seed), 64
    numbers = k * np.sqrt((1 / 16) + (15 / 16) * (np.arange(count) + 0.5) / count)
    direction, phase = rng.uniform(0, np.pi, count), rng.uniform(0, 2 * np.pi, count)
    each = size * np.sqrt(2.0 / count)
    field = HeightField(0.0, tuple((n * np.cos(d), n * np.sin(d), p, each) for n, d, p in zip(numbers, direction, phase, strict=True)))
    lines = [np.linspace(-half, half, 1 + int(np.ceil(40 * half / (body.wavelength_mm * MM)))) for half in sides(body)]
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    # from the lowest of 20 points a wavelength straight down the slope: a few steps of 1/curvature bring a nanometre's rest to nothing
    low = grid[field.heights(grid)[0].argmin()][None]
    for _ in range(50):
        low = np.clip(
            low - field.heights(low)[1] / (4 * k**2 * max(size, 1e-9)), [-lines[0][-1], -lines[1][-1]], [lines[0][-1], lines[1][-1]]
        )
    return HeightField(-float(field.heights(low)[0][0]), field.waves)


UNDERSIDES: dict[str, Callable[[Body, float, float], HeightField]] = {"wave": _ridges, "emboss": _dots, "rough": _random}
"""Of amplitude A [m] and wave number k [1/m]."""
