"""A rigid object as a signed distance: how far a point is from its surface, which way that is, and how the surface bends there.

The distance φ [mm] to the shape with its convex edges rounded, negative inside, is sampled on a grid in the object's own frame and read by
cubic B-splines. So φ has two continuous derivatives everywhere, and what contact asks for,

    g = φ/|∇φ|,   n = ∇φ/|∇φ|,   ∇n = P ∇∇φ P/|∇φ|,  P = I - n nᵀ,

depends on where a gel point is and on nothing that jumps: there are no faces, no pairs, and no wrong side of an acute corner.

Edges are rounded by a ball of the rim's radius that rolls inside the shape, within all level sets at once (`opened`): an edge is an arc, a
corner a ball, and no kink is left near them, as there is in the distance of the rounded shape itself a radius below its edge.

The spline's coefficients are the samples, less what it would shrink, spacing² Δφ/6. That is taken back where the curvature is one of the
shape's, and stays where it is a concave edge's, at which a spline through the samples would ring. A rim of fewer spacings than LARGE keeps
some of it too: it is blunter than it is said to be, and gentler to the gel's faces.

The shape: profiles of lines and arcs are known in closed form (gelsim.shape.shapes); others by the closest point of their triangles, with
the sign of the winding number (Barill et al. 2018, by Warp), which holds at acute corners and for several bodies. Open scans are closed
before (gelsim.shape.mesh_file): inside a bare sheet the winding number has the wrong sign.

Left out: what lies farther from the surface than BAND, where φ is known to a coarse grid's accuracy only. Concave edges are blurred. Of
a stair of layers thinner than the radius up to 0.4 of it too much is taken off, where planes cut off too much (`opened`).
"""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.files import cache_folder, whole_file
from gelsim.scene.definition import Body, Scene
from gelsim.scene.motion import widest
from gelsim.shape import outlines, shapes
from gelsim.shape.mesh_file import file_stamp
from gelsim.shape.orientation import turned
from gelsim.units import MM_PER_M

Array = NDArray[np.float64]
Distance = Callable[[Array], tuple[Array, Array]]
"""Of points (N, 3) [mm] in an object's frame: φ (N,) [mm] and its gradient (N, 3)."""

ROUNDING = 0.75
"""Spacings in a rim's radius at least. More cost presses iterations, and teeth (docs/decisions/0004-rigid-objects-are-fields.md)."""
LARGE = 3.0
"""Spacings in a radius that is large enough for more than ROUNDING."""
EVERY_MM = 0.1 / ROUNDING
"""Spacing that every part can have: that of the radius that is the default."""
COARSE = 4
"""Spacings of the grid that tells where the surface is."""
BAND = 3.0
"""Spacings beyond the support of a spline within which samples are exact."""
KINKED = 0.1
"""Δφ · spacing above which there may be an edge near a sample."""
LEAST = 0.1
"""Fall of φ over the way down it, below which an edge is a thin wall, whose radius is what it has room for: of 11 degrees."""
CUTS, CUT_MM = 8, 1e-4
"""Planes that are tried for the lowest place in a ball, and how near to it is enough [mm]."""
ON_FACE_MM = 1e-3
"""Distance that single precision tells to a thousandth [mm]."""
SHARPEST_MM = 0.04
"""Rim radius of an object that is to have none: a finer grid of a whole part does not pay."""
CUBES_MM = 0.4, 0.1
"""Points in one such cube are asked together which side of a surface of triangles they are on."""
PER_RADIUS = 8
"""Spacings in the radius R of what is round by its shape: what is not taken back of a ball's shrinking, spacing²/3R · (2 spacing/R)², is
then 0.03 % of R."""


@wp.struct
class FieldGrid:
    """Samples of the distance [mm] and where they lie, in the object's frame."""

    samples: wp.array3d(dtype=wp.float32)
    origin: wp.vec3d
    spacing: wp.float64


@dataclass(frozen=True)
class DistanceField:
    """The signed distance on a grid."""

    samples: NDArray[np.float32]
    """(A, B, C) [mm]."""
    origin: tuple[float, float, float]
    """Of the first sample, in the object's frame [mm]."""
    spacing: float
    """[mm]"""
    rim: float
    """Radius of its edges [mm]."""

    def grid(self, device: str) -> FieldGrid:
        """For kernels."""
        grid = FieldGrid()
        grid.samples = wp.array(self.samples, dtype=wp.float32, device=device)
        grid.origin, grid.spacing = wp.vec3d(*self.origin), self.spacing
        return grid

    def __call__(self, points: Array, order: int = 3) -> Array:
        """φ [mm] at points (N, 3) [mm] of the object's frame; beyond the grid that of its nearest place, and the way there.

        `order` 1 reads the spline's coefficients as if they were values, which is faster and off by their curvature.
        """
        from scipy.ndimage import map_coordinates

        place = (points - self.origin) / self.spacing
        inside = np.clip(place, 1.0, np.array(self.samples.shape) - 2.0)
        found = map_coordinates(self.samples, inside.T, output=np.float64, order=order, mode="nearest", prefilter=False)
        return found + self.spacing * np.linalg.norm(place - inside, axis=1)


# ---------------------------------------------------------------------------------------------------------------- kernels
@wp.func
def spline(t: wp.float64) -> wp.vec4d:
    """The four cubic B-splines over a cell, at t of it."""
    one = wp.float64(1.0)
    s = one - t
    sixth = one / wp.float64(6.0)  # a literal quotient would be single precision
    return sixth * wp.vec4d(
        s * s * s,
        wp.float64(4.0) - wp.float64(6.0) * t * t + wp.float64(3.0) * t * t * t,
        wp.float64(4.0) - wp.float64(6.0) * s * s + wp.float64(3.0) * s * s * s,
        t * t * t,
    )


@wp.func
def spline_slope(t: wp.float64) -> wp.vec4d:
    s = wp.float64(1.0) - t
    half = wp.float64(0.5)
    return wp.vec4d(
        -half * s * s,
        wp.float64(1.5) * t * t - wp.float64(2.0) * t,
        wp.float64(2.0) * s - wp.float64(1.5) * s * s,
        half * t * t,
    )


@wp.func
def spline_bend(t: wp.float64) -> wp.vec4d:
    s = wp.float64(1.0) - t
    return wp.vec4d(s, wp.float64(3.0) * t - wp.float64(2.0), wp.float64(3.0) * s - wp.float64(2.0), t)


@wp.struct
class Reading:
    """Of a field at a point: its value [mm], gradient, second derivatives [1/mm], and whether the point is on the grid."""

    value: wp.float64
    slope: wp.vec3d
    bend: wp.mat33d
    inside: wp.bool


@wp.func
def read_field(field: FieldGrid, point: wp.vec3d) -> Reading:
    """The field at a point of the object's frame."""
    found = Reading()
    place = (point - field.origin) / field.spacing
    i = int(wp.floor(place[0]))
    j = int(wp.floor(place[1]))
    k = int(wp.floor(place[2]))
    shape = wp.vec3i(field.samples.shape[0], field.samples.shape[1], field.samples.shape[2])
    found.inside = i >= 1 and j >= 1 and k >= 1 and i < shape[0] - 2 and j < shape[1] - 2 and k < shape[2] - 2
    if not found.inside:
        return found
    tx = place[0] - wp.float64(i)
    ty = place[1] - wp.float64(j)
    tz = place[2] - wp.float64(k)
    x0 = spline(tx)
    x1 = spline_slope(tx)
    x2 = spline_bend(tx)
    y0 = spline(ty)
    y1 = spline_slope(ty)
    y2 = spline_bend(ty)
    z0 = spline(tz)
    z1 = spline_slope(tz)
    z2 = spline_bend(tz)
    value = wp.float64(0.0)
    slope = wp.vec3d()
    xx = wp.float64(0.0)
    yy = wp.float64(0.0)
    zz = wp.float64(0.0)
    xy = wp.float64(0.0)
    xz = wp.float64(0.0)
    yz = wp.float64(0.0)
    for a in range(4):
        for b in range(4):
            c0 = wp.float64(0.0)
            c1 = wp.float64(0.0)
            c2 = wp.float64(0.0)
            for c in range(4):
                sample = wp.float64(field.samples[i - 1 + a, j - 1 + b, k - 1 + c])
                c0 += z0[c] * sample
                c1 += z1[c] * sample
                c2 += z2[c] * sample
            value += x0[a] * y0[b] * c0
            slope += wp.vec3d(x1[a] * y0[b] * c0, x0[a] * y1[b] * c0, x0[a] * y0[b] * c1)
            xx += x2[a] * y0[b] * c0
            yy += x0[a] * y2[b] * c0
            zz += x0[a] * y0[b] * c2
            xy += x1[a] * y1[b] * c0
            xz += x1[a] * y0[b] * c1
            yz += x0[a] * y1[b] * c1
    found.value = value
    found.slope = slope / field.spacing
    found.bend = wp.mat33d(xx, xy, xz, xy, yy, yz, xz, yz, zz) / (field.spacing * field.spacing)
    return found


@wp.kernel(enable_backward=False)
def signed_distances(mesh: wp.uint64, points: wp.array(dtype=wp.vec3d), centre: wp.vec3d, reach: float, found: wp.array(dtype=wp.float64)):
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, wp.vec3f(points[i] - centre), reach)
    near = wp.vec3d(wp.mesh_eval_position(mesh, query.face, query.u, query.v)) + centre
    found[i] = wp.float64(query.sign) * wp.length(points[i] - near)


@wp.kernel(enable_backward=False)
def ways(mesh: wp.uint64, points: wp.array(dtype=wp.vec3d), centre: wp.vec3d, reach: float, away: wp.array(dtype=wp.float64),
         way: wp.array(dtype=wp.vec3d)):  # fmt: skip
    """Distances, and unit vectors from the closest points; of points that single precision sees on a face by its normal."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, wp.vec3f(points[i] - centre), reach)
    near = wp.vec3d(wp.mesh_eval_position(mesh, query.face, query.u, query.v)) + centre
    away[i] = wp.length(points[i] - near)
    way[i] = (points[i] - near) / wp.max(away[i], wp.float64(1e-12))
    if away[i] < wp.float64(wp.static(ON_FACE_MM)):
        normal = wp.vec3d(wp.mesh_eval_face_normal(mesh, query.face))
        way[i] = normal * wp.sign(wp.dot(way[i], normal))


Planes = wp.types.matrix(shape=(4, 3), dtype=wp.float64)


@wp.kernel(enable_backward=False)
def lowest(value: wp.array(dtype=wp.vec4d), slope: wp.array(dtype=Planes), count: wp.array(dtype=wp.int32), radius: wp.float64,
           least: wp.float64, place: wp.array(dtype=wp.vec3d), low: wp.array(dtype=wp.float64)):  # fmt: skip
    """Where in a ball the highest of up to four planes, plus `least` times the way there, is lowest, and how low.

    That is on one of them, where two meet, or where three do: there as far down as the ball lets, or as falling by `least` pays.
    """
    i = wp.tid()
    low[i] = wp.float64(1e9)
    for a in range(count[i]):
        for b in range(a, count[i]):
            for c in range(b, count[i]):
                p = slope[i][b] - slope[i][a]
                q = slope[i][c] - slope[i][a]
                along = slope[i][a]
                foot = wp.vec3d()
                if b > a:
                    foot = p * (value[i][a] - value[i][b]) / wp.dot(p, p)
                    along -= p * wp.dot(p, along) / wp.dot(p, p)
                if c > b:
                    q -= p * wp.dot(p, q) / wp.dot(p, p)
                    rest = wp.max(wp.dot(q, q), wp.float64(1e-12))
                    foot += q * (value[i][a] - value[i][c] - wp.dot(slope[i][c] - slope[i][a], foot)) / rest
                    along -= q * wp.dot(q, along) / rest
                room = radius * radius - wp.dot(foot, foot)
                steep = wp.length(along)
                if room >= wp.float64(0.0) and (c == b or b > a):
                    down = wp.sqrt(room)
                    if steep < least:
                        down = wp.min(down, wp.length(foot) * steep / wp.sqrt(least * least - steep * steep))
                    there = foot - along * (down / wp.max(steep, wp.float64(1e-12)))
                    high = wp.float64(-1e9)
                    for k in range(count[i]):
                        high = wp.max(high, value[i][k] + wp.dot(slope[i][k], there))
                    high += least * wp.length(there)
                    if high < low[i]:
                        low[i] = high
                        place[i] = there


# ---------------------------------------------------------------------------------------------------------------- shapes
def exact_distance(body: Body) -> Distance:
    """The signed distance to an object's exact surface."""
    if shapes.has_profile(body):

        def closed_form(points: Array) -> tuple[Array, Array]:
            value, slope = shapes.signed_distance(body, points / MM_PER_M)
            return MM_PER_M * value, slope

        return closed_form
    surface = shapes.object_surface(body, edge_length=np.inf, chord=0.2e-6)
    vertices = surface.vertices * MM_PER_M
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    triangles = wp.Mesh(
        points=wp.array((vertices - centre).astype(np.float32), dtype=wp.vec3f, device="cpu"),
        indices=wp.array(surface.faces.ravel(), dtype=wp.int32, device="cpu"),
        support_winding_number=True,
    )
    reach = float(np.linalg.norm(np.ptp(vertices, axis=0))) * 2.0

    def found(kernel: wp.Kernel, points: Array, *values: wp.array) -> None:
        places = wp.array(points, dtype=wp.vec3d, device="cpu")
        wp.launch(kernel, len(points), [triangles.id, places, wp.vec3d(*centre), reach, *values], device="cpu")

    def sides(points: Array) -> Array:
        values = wp.zeros(len(points), dtype=wp.float64, device="cpu")
        found(signed_distances, points, values)
        return np.sign(values.numpy())

    def distance(points: Array) -> tuple[Array, Array]:
        away, way = wp.zeros(len(points), dtype=wp.float64, device="cpu"), wp.zeros(len(points), dtype=wp.vec3d, device="cpu")
        found(ways, points, away, way)
        sign = _signs(points, away.numpy(), sides)
        return sign * away.numpy(), sign[:, None] * way.numpy()

    return distance


def _signs(points: Array, away: Array, asked: Callable[[Array], Array]) -> Array:
    """The sign at points that are so far `away` from a surface, asked of few of them: a winding number costs as much as seven distances.

    Two points that are nearer to each other than the sum of their distances have no surface between them.
    """
    signs, left = np.zeros(len(points)), np.argsort(-away)  # the farthest first, so that it speaks for its cube
    low = points.min(axis=0)
    for edge in CUBES_MM:
        place = ((points[left] - low) / edge).astype(np.int64)
        cubes = np.ravel_multi_index(place.T, (np.ptp(points, axis=0) / edge).astype(np.int64) + 1)
        _, first, cube = np.unique(cubes, return_index=True, return_inverse=True)
        far = left[first]
        sign = asked(points[far])
        apart = np.linalg.norm(points[left] - points[far[cube]], axis=1)
        alike = apart < 0.999 * (away[left] + away[far[cube]])
        signs[left[alike]] = sign[cube[alike]]
        left = left[~alike]
    signs[left] = asked(points[left])
    return signs


def opened(distance: Distance, points: Array, radius: float) -> Array:
    """The distance [mm] (N,), all its level sets rounded by a ball of a radius [mm] that rolls inside them (their opening).

    f(x) = φ(c) + |c - x|, where c is the lowest place of φ + LEAST |c - x| within a radius of x. It is found by planes that touch φ (Kelley
    1960); where φ is not convex one may cut off too much: if it lies above φ at a place asked later it goes.
    """
    value, slope = distance(points)
    found, best = value.copy(), value.copy()
    heights, slopes = np.zeros((len(points), 4)), np.zeros((len(points), 4, 3))
    heights[:, 0], slopes[:, 0], count = value, slope, np.ones(len(points), np.int32)
    left = np.arange(len(points))
    for _ in range(CUTS):
        places, low = wp.zeros(len(left), dtype=wp.vec3d, device="cpu"), wp.zeros(len(left), dtype=wp.float64, device="cpu")
        planes = [wp.array(heights, dtype=wp.vec4d, device="cpu"), wp.array(slopes, dtype=Planes, device="cpu")]
        wp.launch(lowest, len(left), [*planes, wp.array(count, device="cpu"), radius, LEAST, places, low], device="cpu")
        step, far = places.numpy(), np.linalg.norm(places.numpy(), axis=1)
        value, slope = distance(points[left] + step)
        better = value + LEAST * far < best[left]
        found[left[better]] = (value + far)[better]
        best[left[better]] = (value + LEAST * far)[better]
        open_ = best[left] - low.numpy() > CUT_MM
        left, step, value, slope = left[open_], step[open_], value[open_], slope[open_]
        if not len(left):
            break
        heights, slopes, count = heights[open_], slopes[open_], count[open_]
        there = heights + np.einsum("nki,ni->nk", slopes, step)
        there[(np.arange(4) >= count[:, None]) | (there > value[:, None] + CUT_MM)] = -np.inf
        order = np.argsort(-there, axis=1)[:, :3]
        count = np.minimum((there > -np.inf).sum(axis=1), 3).astype(np.int32) + 1
        rows = np.arange(len(left))
        heights[:, 1:], slopes[:, 1:] = np.take_along_axis(heights, order, 1), slopes[rows[:, None], order]
        heights[:, 0], slopes[:, 0] = value - (slope * step).sum(axis=1), slope
    return found


def sampled(distance: Distance, low: Array, high: Array, spacing: float, radius: float) -> DistanceField:
    """A distance [mm] on a grid over a box (its corners [mm]), its edges rounded by a radius [mm]."""
    from scipy.ndimage import binary_dilation

    counts = np.ceil((high - low) / spacing / COARSE).astype(int) * COARSE + 1
    samples, exact = _near_surface(distance, low, counts, spacing)
    edges = exact & (_laplacian(samples) > KINKED * spacing)
    near = binary_dilation(edges, np.ones((3, 3, 3)), int(np.ceil(radius / spacing)))
    beside = np.argwhere(near & exact & (samples < radius) & (samples > -(BAND + 2.0) * spacing))
    if len(beside):
        samples[tuple(beside.T)] = opened(distance, low + spacing * beside, radius)
    bent = np.where(exact, _laplacian(samples), 0.0)
    shape = spacing * np.where(bent > 0.0, (radius / (ROUNDING * spacing)) ** 2, 1.0)
    samples -= bent / 6.0 / (1.0 + (bent / shape) ** 2)
    return DistanceField(samples.astype(np.float32), (float(low[0]), float(low[1]), float(low[2])), spacing, radius)


def _laplacian(samples: Array) -> Array:
    """Second differences summed, times spacing² Δ; 0 on the border."""
    found = np.zeros_like(samples)
    middle = (slice(1, -1),) * 3
    for axis in range(3):
        before, after = list(middle), list(middle)
        before[axis], after[axis] = slice(None, -2), slice(2, None)
        found[middle] += samples[tuple(before)] + samples[tuple(after)] - 2.0 * samples[middle]
    return found


def _near_surface(distance: Distance, low: Array, counts: NDArray[np.integer], spacing: float) -> tuple[Array, NDArray[np.bool_]]:
    """Samples that are exact near the surface, and between coarse ones far from it; which are which."""
    from scipy.ndimage import zoom

    coarse_counts = (counts - 1) // COARSE + 1

    coarse_index = np.stack(np.meshgrid(*[np.arange(n) for n in coarse_counts], indexing="ij"), axis=-1).reshape(-1, 3)
    coarse = distance(low + COARSE * spacing * coarse_index)[0].reshape(coarse_counts)
    samples = zoom(coarse, counts / coarse_counts, order=1)
    reach = (BAND + 2.0 + np.sqrt(3.0) * COARSE / 2.0) * spacing
    close = np.abs(coarse) < reach + np.sqrt(3.0) * COARSE * spacing / 2.0
    exact = np.asarray(zoom(close.astype(np.float32), counts / coarse_counts, order=1) > 0.0)
    samples[exact] = distance(low + spacing * np.argwhere(exact))[0]
    return samples, exact


# ---------------------------------------------------------------------------------------------------------------- of a press
STEP_MM = 0.5
"""Of the corners of the grid's box."""
_SCHEMA = 3
"""Of kept fields: raised where the same shape is sampled differently."""
MARGIN_MM = 0.6
"""Of the grid around the part of the object that the gel may come to."""


def distance_field(scene: Scene) -> DistanceField:
    """The field of a scene's rigid object, over what of it may come to touch the gel."""
    gel, way = scene.gel, widest(scene)
    travel = shapes.furthest_approach(scene) * MM_PER_M
    half = np.array(gel.size_mm) / 2 + way.sideways + MARGIN_MM
    shift = shapes.first_touch(scene)[2] * MM_PER_M
    if way.turns[2] or way.rolls:  # a pivot beside the apex makes that go sideways
        half += np.abs(shift[:2] - scene.press.offset_mm)
    drop = -float(shapes.gel_height(gel, np.array([gel.size_mm]) / 2 / MM_PER_M).min()) * MM_PER_M  # of a dome, at its corners
    low = np.array([*(-half - shift[:2]), -MARGIN_MM - drop - shift[2]])
    high = np.array([*(half - shift[:2]), 1.25 * travel + MARGIN_MM - shift[2]])
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    corners = np.vstack([corners @ turned(turn) for turn in way.turns_on_way()])  # of the object's frame
    stamp = file_stamp(scene.object)
    first, last = _extent(scene.object, stamp)
    # in whole steps, so that poses that differ a little share a grid
    begin = np.maximum(np.floor(corners.min(axis=0) / STEP_MM) * STEP_MM, first - MARGIN_MM)
    end = np.minimum(np.ceil(corners.max(axis=0) / STEP_MM) * STEP_MM, last + MARGIN_MM)
    step = spacing(scene.object, scene.fidelity)
    return kept_field(scene.object, stamp, tuple(begin), tuple(end), step, rim_radius(scene.object, step, scene.fidelity))


@lru_cache(maxsize=16)
def _extent(body: Body, stamp: tuple[int, ...]) -> tuple[Array, Array]:
    """Opposite corners of the box of an object [mm], in its frame."""
    vertices = shapes.object_surface(body, edge_length=np.inf, chord=1e-5).vertices * MM_PER_M
    return vertices.min(axis=0), vertices.max(axis=0)


@lru_cache(maxsize=16)
def kept_field(
    body: Body, stamp: tuple[int, ...], begin: tuple[float, ...], end: tuple[float, ...], step: float, rim: float
) -> DistanceField:
    """The field of an object over a box (its corners) in steps, its edges rounded by `rim` (all in mm); of a file it is kept between runs.
    `stamp`: its `file_stamp`."""
    low, high = np.array(begin), np.array(end)
    if not shapes.of_file(body):
        return sampled(exact_distance(body), low, high, step, rim)
    surface = shapes.object_surface(body, edge_length=np.inf, chord=1e-5)
    digest = hashlib.sha256(np.array([_SCHEMA, *begin, *end, step, rim]).tobytes())
    digest.update(surface.vertices.tobytes() + surface.faces.tobytes())
    path = cache_folder("fields") / f"{digest.hexdigest()[:32]}.npz"
    try:
        with np.load(path, allow_pickle=False) as kept:
            return DistanceField(kept["samples"], tuple(kept["origin"].tolist()), float(kept["spacing"]), rim)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        field = sampled(exact_distance(body), low, high, step, rim)
    with contextlib.suppress(OSError), whole_file(path) as partial, partial.open("wb") as file:  # a cache that is full costs a second
        np.savez(file, samples=field.samples, origin=field.origin, spacing=field.spacing)
    return field


def rim_radius(body: Body, step: float, fidelity: str = "balanced") -> float:
    """Of its edges [mm], no sharper than a grid of a spacing [mm] resolves."""
    return max(outlines.edge_radius(body, fidelity) * MM_PER_M, ROUNDING * step)


def spacing(body: Body, fidelity: str = "balanced") -> float:
    """Of the grid that gives edges their radius and follows what is round [mm]."""
    radius = max(outlines.edge_radius(body, fidelity) * MM_PER_M, SHARPEST_MM)
    finest = min(radius / ROUNDING, max(radius / LARGE, EVERY_MM))
    round_parts = [outlines.fine_feature(body) * MM_PER_M / 2]
    if shapes.has_profile(body):
        round_parts += [abs(segment.radius) * MM_PER_M for segment in outlines.profile(body) if segment.radius]
    return min(finest, *(part / PER_RADIUS for part in round_parts))


TOUCH_MM = 1e-5
"""Gap at which a rigid object touches."""


def placement(scene: Scene) -> tuple[Array, Array]:
    """Where a rigid object, its edges rounded, just touches the undeformed gel: positions = R p + t, R (3, 3), t (3,) [m].

    From where its sharp surface touches it is lowered by the smallest distance to a grid of points on the gel, until that is TOUCH_MM at
    most; then once more with finer points around the nearest, by which it may rise.
    """
    surface, turn, shift = shapes.first_touch(scene)
    field = distance_field(scene)
    low = shift * MM_PER_M
    step, half = 0.1, np.array(scene.gel.size_mm) / 2
    lines = [np.linspace(-h, h, 1 + 2 * int(np.ceil(h / step))) for h in half]
    under = (surface.nodes @ turn.T)[:, :2] * MM_PER_M + low[:2]
    ends = zip(lines, under.min(axis=0) - step, under.max(axis=0) + step, strict=True)
    lines = [line[(line >= first) & (line <= last)] for line, first, last in ends]
    places = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    for _ in range(4):
        points = np.column_stack([places, shapes.gel_height(scene.gel, places / MM_PER_M) * MM_PER_M])
        near = np.arange(len(points))
        while True:
            away = field((points[near] - low) @ turn)
            if abs(away.min()) <= TOUCH_MM:
                break
            low = low - [0.0, 0.0, away.min()]
            near = near[away < away.min() + 1.0] if len(near) > 1000 else near
        nearest = near[np.argsort(away)[:500]]
        step /= 5.0
        fine = step * np.stack(np.meshgrid(*[np.arange(-2, 3)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)  # nearer to it than to the next
        places = np.clip((places[nearest, None] + fine).reshape(-1, 2), -half, half)
    return turn, low / MM_PER_M
