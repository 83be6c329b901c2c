"""A membrane's picture from its sensor's measured light field (`gelsim.lightfield`): milliseconds in place of seconds.

    L_c = g [ Σ_k V_k a_k(x, y, z, n) C_kc + γ_c E_c / π + veil_c(x, y) ],      g = grain (1 - m) + paint(n) m,

in four steps, each over all pixels of a batch of frames at once:

1. *What a pixel sees.* Its ray is straight inside the gel, (x, y) = α + β z. The membrane's grid of material points is solved for the one
   on the ray by Newton's method on the bilinear patches: first at every other pixel, then one more step for each.
2. *Shadows*, V: the visible share of each light, a rectangle cut along its long side. About each piece's middle the heights are laid out in
   polar coordinates; the running minimum along a line, of z - z_light over the distance, is the horizon (Max 1988: horizon maps). The share
   of the piece's height above the horizon is weighed by the cosine at the receiver, and what the tangent plane cuts off is already in a_k.
3. *Inter-reflection*, E: one bounce, from the horizon's silhouettes in 8 directions at 0.2 mm (Max 1986; as Jimenez et al. 2016 use them);
   the surface reflects as a Lambertian one, and γ, fitted once a sensor, stands for the coat's reflectance and for further bounces.
4. *Coat and markers*: grain g and coverage m looked up in material coordinates, averaged over a pixel beforehand.

Left out: lobes of the coat in inter-reflection, folds that the camera sees behind one another (the pixel takes one of the layers),
change of a texture's blur by stretch, and shadows of a light right behind the membrane's own plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import RenderError
from gelsim.lightfield import PACKET, LightField
from gelsim.optics.arrays import Arrays, Values, choose_arrays
from gelsim.optics.camera import gel_ray, make_lens, pixel_size
from gelsim.optics.coating import TEXEL, grain_pattern, marker_coverage
from gelsim.optics.lighting import light_pose
from gelsim.optics.variant import VariantChoice, use_variant
from gelsim.results import Membrane
from gelsim.scene import Scene

MM = 1e3
CELL = 0.2
"""Of the grid of heights over the gel, for shadows and inter-reflection [mm]."""
PIECES = 3
"""A light's long side is cut in so many for its soft shadow."""
LINES, STEPS = 96, 112
"""Of the polar grid about a piece of a light."""
DIRECTIONS = 8
REACHES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 27, 33)
"""Of the samples along a direction of inter-reflection [cells]: near parts fill most of the view."""
FAR = 1e6
NEWTON_STEPS = 4
"""At every other pixel, from the rest position; then one at each. Quadratic: four reach 0.01 pixel from a cell's edge."""
SHADE = 3
"""Pixels along a side for one shadow value."""
TEXELS_A_PIXEL = 1.5


@dataclass(frozen=True)
class Counts:
    """Sizes that the kernels are made for."""

    width: int
    height: int
    columns: int
    """Of the membrane's grid."""
    rows: int
    cells: tuple[int, int]
    """Of the grid of heights: columns, rows."""
    samples: int
    """Pieces of lights."""
    groups: int
    """Components in fours."""
    texels: tuple[int, int]
    """Columns and rows of the coat's texture, (0, 0) without grain and markers."""
    marked: bool


class BakedRenderer:
    """A scene's light field, camera and coat, made ready once to draw many membranes."""

    def __init__(
        self, scene: Scene, light_field: LightField, variant: VariantChoice, *, shadows: bool = True, indirect: bool = True
    ) -> None:
        """Of `variant` the backend is taken; without `shadows` or `indirect` those are left out."""
        self._scene, self._field = scene, light_field
        self._shadows, self._indirect = shadows, indirect
        if not variant.name.startswith("scalar"):
            use_variant(variant)
        self._arrays: Arrays = choose_arrays(variant.name)
        self._tables: dict[str, Values] = {}
        self._counts: Counts | None = None
        self._draw: Any = None

    def radiance(self, membrane: Membrane) -> NDArray[np.float32]:
        """Linear RGB, shape (H, W, 3)."""
        return self.picture(membrane)[0]

    def picture(self, membrane: Membrane) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Linear RGB (H, W, 3), and z of the membrane at the pixels' centres [m] (H, W): NaN where the camera sees no gel."""
        return self.pictures([membrane])[0]

    def pictures(self, membranes: Sequence[Membrane]) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """`picture` of many membranes at once."""
        pixels = self._arrays.numpy(self.launch(self.upload(membranes)))
        width, height = self._scene.render.resolution
        pixels = pixels.reshape(len(membranes), height, width, 4)
        return [(np.ascontiguousarray(picture[..., :3]), (picture[..., 3] / MM).astype(np.float32)) for picture in pixels]

    def upload(self, membranes: Sequence[Membrane]) -> tuple[Values, Values]:
        """Vertices and normals of membranes on the device, for `launch`."""
        if self._counts is None:
            self._prepare(membranes[0])
        counts = self._counts
        assert counts is not None
        nodes = counts.columns * counts.rows
        places = np.zeros((len(membranes), nodes, 4), np.float32)
        normals = np.empty((len(membranes), nodes, 2), np.float32)
        for n, membrane in enumerate(membranes):
            np.multiply(membrane.positions, MM, out=places[n, :, :3], casting="unsafe")
            normals[n] = membrane.normals[:, :2]
        return self._arrays.floats(places), self._arrays.floats(normals)

    def launch(self, uploaded: tuple[Values, Values]) -> Values:
        """Red, green, blue and z [mm] of every pixel of every frame, one after the other, on the device."""
        return self._draw(self._tables, *uploaded)

    # ---- once a scene ----

    def _prepare(self, membrane: Membrane) -> None:
        scene, light_field, put = self._scene, self._field, self._arrays.floats
        columns, rows = _material_grid(membrane)
        width, height = scene.render.resolution
        size = np.array(scene.gel.size_mm)
        cells = int(np.ceil(size[0] / CELL)) + 1, int(np.ceil(size[1] / CELL)) + 1
        self._tables = {
            "field": put(_packed(light_field.table)),
            "colours": put(light_field.colours),
            "paint": put(light_field.paint),
            "gains": put(light_field.gains),
            "veil": put(light_field.veil),
        }
        for name, (across, down, step) in {"full": (width, height, 1), "coarse": (*_coarse(width, height), SHADE)}.items():
            column, row = np.meshgrid((np.arange(across) + 0.5) * step, (np.arange(down) + 0.5) * step)
            self._tables[name] = put(straight_rays(scene, column.ravel(), row.ravel()))
        along = [np.linspace(-side / 2, side / 2, count) for side, count in zip(size, cells, strict=True)]
        plumb = np.zeros((cells[1], cells[0], 4))
        plumb[..., 0], plumb[..., 1] = np.meshgrid(*along)
        self._tables["plumb"] = put(plumb)
        angles = (np.arange(DIRECTIONS) + 0.5) * 2 * np.pi / DIRECTIONS
        self._tables["directions"] = put(np.stack([np.cos(angles), np.sin(angles)], axis=1))
        texture, texels = coat_texture(scene)
        self._tables["texture"] = put(texture)
        pieces = light_pieces(scene) if self._shadows else np.zeros((0, 12))
        if len(pieces):
            self._tables["polar"] = put(_polar_places(pieces, size, cells))
            self._tables["pieces"] = put(pieces)
        groups = light_field.table.shape[5] // PACKET
        marked = scene.markers.layout != "none"
        self._counts = counts = Counts(width, height, columns, rows, cells, len(pieces), groups, texels, marked)
        arrays, indirect = self._arrays, self._indirect
        low_high = light_field.places.tolist()
        static = _Static(counts, light_field.table.shape, low_high, light_field.heights.tolist(), light_field.normals, size.tolist(),
                         light_field.light_of.tolist(), indirect)  # fmt: skip
        frames_of = 4 * columns * rows

        def draw(tables: dict[str, Values], places: Values, normals: Values) -> Values:
            return _draw(arrays, static, tables, places, normals, len(places) // frames_of)

        self._draw = arrays.compiled(draw)


def _coarse(width: int, height: int) -> tuple[int, int]:
    return -(-width // SHADE), -(-height // SHADE)


def _material_grid(membrane: Membrane) -> tuple[int, int]:
    """Columns and rows of a membrane whose vertices are a regular grid of material points, row by row."""
    u, v = membrane.uv[:, 0], membrane.uv[:, 1]
    columns = int(np.argmax(v != v[0])) or len(v)
    rows = len(v) // columns
    regular = columns * rows == len(v) and np.ptp(u.reshape(rows, columns), axis=0).max() < 1e-9
    if not regular or min(rows, columns) < 2:
        raise RenderError('render.mode = "baked" draws membranes on a regular material grid only; use "path"')
    return columns, rows


def _packed(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """The table as the kernel loads it: by node and four components, their values on the first layer and the way to the second."""
    fours = table.reshape(*table.shape[:5], -1, PACKET)
    return np.stack([fours[0], fours[1] - fours[0]], axis=-2)


def straight_rays(scene: Scene, column: NDArray[np.floating], row: NDArray[np.floating]) -> NDArray[np.float64]:
    """The camera's rays inside the gel: (x, y) = α + β z.

    Args:
        column, row: In the picture [px], shape (N,).
    Returns:
        α_x, α_y [mm], β_x, β_y, shape (N, 4).
    """
    origin, direction, _ = gel_ray(make_lens(scene), column, row)
    slope = [direction[axis] / direction[2] for axis in (0, 1)]
    foot = [(origin[axis] - slope[axis] * origin[2]) * MM for axis in (0, 1)]
    return np.stack(np.broadcast_arrays(*foot, *slope), axis=-1)


def coat_texture(scene: Scene) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Grain (1 - m) and coverage m by texel, averaged over a pixel's square: (rows, columns, 2), and (columns, rows).

    One texel, and (0, 0), where the coat is the same everywhere.
    """
    if scene.markers.layout == "none" and scene.coating.grain == 0:
        return np.array([[[1.0, 0.0]]], np.float32), (0, 0)
    from scipy.ndimage import map_coordinates

    coverage, grain = marker_coverage(scene), grain_pattern(scene)
    if grain.size > 1:
        v, u = ((np.arange(count) + 0.5) / count for count in coverage.shape)
        places = np.meshgrid(v * grain.shape[0] - 0.5, u * grain.shape[1] - 0.5, indexing="ij")
        grain = map_coordinates(grain, places, order=1, mode="nearest")
    pixel = pixel_size(scene)
    layers = []
    for layer in (grain * (1 - coverage), coverage):
        for axis in (0, 1):
            layer = _box_resampled(layer, axis, pixel / TEXEL, max(pixel / TEXEL / TEXELS_A_PIXEL, 1.0))
        layers.append(layer)
    texture = np.stack(layers, axis=-1).astype(np.float32)
    return texture, (texture.shape[1], texture.shape[0])


def _box_resampled(values: NDArray[np.floating], axis: int, box: float, step: float) -> NDArray[np.float64]:
    """Means over intervals of `box` texels about every `step`-th place, from the running integral (linear within a texel: exact)."""
    values = np.moveaxis(np.asarray(values, np.float64), axis, 0)
    count = len(values)
    integral = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    fewer = int(np.ceil(count / step))
    centres = (np.arange(fewer) + 0.5) * count / fewer
    ends = [np.clip(centres - box / 2, 0, count), np.clip(centres + box / 2, 0, count)]
    at = []
    for end in ends:
        first = np.minimum(end.astype(int), count - 1)
        share = (end - first)[:, None]
        at.append(integral[first] * (1 - share) + integral[first + 1] * share)
    return np.moveaxis((at[1] - at[0]) / (ends[1] - ends[0])[:, None], 0, axis)


def light_pieces(scene: Scene) -> NDArray[np.float64]:
    """What shadows need of the lights, PIECES rows a light.

    Columns: x, y, z of the piece's middle [mm]; half its height, as seen along the ray to the gel's centre; cosine and sine of the
    direction to there; first angle and the inverse of its step; first distance and the inverse of its step; two zeros.
    """
    half = np.array(scene.gel.size_mm) / 2
    corners = np.array([[i, j] for i in (-1, 1) for j in (-1, 1)]) * half
    rows = []
    for light in scene.lights.lights:
        pose = light_pose(light)
        # The side that lies more along the gel's sight of the light is cut; the other is the piece's height.
        for share in (np.arange(PIECES) + 0.5) / PIECES * 2 - 1:
            centre = pose[:3, 3] + share * pose[:3, 0]
            distance = max(np.hypot(*centre[:2]), 1e-6)
            toward = -centre[:2] / distance
            tall = abs(pose[2, 1] - pose[:2, 1] @ toward * (-centre[2] / distance))
            inside = np.all(np.abs(centre[:2]) < half + 1.0)
            seen = (corners - centre[:2]) @ np.array([[toward[0], -toward[1]], [toward[1], toward[0]]])
            angles = [-np.pi, np.pi] if inside else np.array([-1, 1]) * (np.abs(np.arctan2(seen[:, 1], seen[:, 0])).max() + 0.01)
            nearest = np.linalg.norm(np.maximum(np.abs(centre[:2]) - half, 0))
            reach = [max(nearest, 0.5), np.linalg.norm(seen, axis=1).max()]
            per = (LINES - 1) / (angles[1] - angles[0]), (STEPS - 1) / (reach[1] - reach[0])
            rows.append([*centre, max(tall, 0.05), *toward, angles[0], per[0], reach[0], per[1], 0, 0])
    return np.array(rows).reshape(-1, 12)


def _polar_places(pieces: NDArray[np.float64], size: NDArray[np.float64], cells: tuple[int, ...]) -> NDArray[np.float64]:
    """Column (-9 off the gel) and row in the grid of heights, light's z and 1/distance of each polar place; (STEPS, S, LINES, 4)."""
    x, y, z, _, cosine, sine, first, turn, near, step = (pieces[:, i, None, None] for i in range(10))
    angle = first + np.arange(LINES)[None, :, None] / turn
    distance = near + np.arange(STEPS)[None, None, :] / step
    forward, aside = distance * np.cos(angle), distance * np.sin(angle)
    column = ((x + forward * cosine - aside * sine) / size[0] + 0.5) * (cells[0] - 1)
    row = ((y + forward * sine + aside * cosine) / size[1] + 0.5) * (cells[1] - 1)
    outside = (column < 0) | (row < 0) | (column > cells[0] - 1) | (row > cells[1] - 1)
    distance, z = np.broadcast_to(distance, column.shape), np.broadcast_to(z, column.shape)
    return np.stack([np.where(outside, -9, column), row, z, 1 / distance], axis=-1).transpose(2, 0, 1, 3)


# ---- for each batch of frames ----


@dataclass(frozen=True)
class _Static:
    counts: Counts
    field_shape: tuple[int, ...]
    places: list[list[float]]
    heights: list[float]
    normals: float
    size: list[float]
    light_of: list[int]
    indirect: bool


@dataclass
class _Seen:
    """Of the membrane, by ray: lengths in mm."""

    column: Values
    row: Values
    """In the material grid."""
    x: Values
    y: Values
    z: Values
    nx: Values
    ny: Values
    nz: Values
    missed: Values
    """Whether the ray meets no gel."""


def _draw(ar: Arrays, st: _Static, t: dict[str, Values], places: Values, normals: Values, frames: int) -> Values:
    c = st.counts
    # Over the gel, seen along z: heights, and what light does there.
    cells = c.cells[0] * c.cells[1]
    frame, cell = _lanes(ar, frames, cells)
    plumb = ar.packet(t["plumb"], cell, 4)
    below = _meet(ar, st, places, normals, frame, plumb, None, NEWTON_STEPS)
    horizons = _horizons(ar, st, t, below.z, frames) if c.samples else None
    arriving = None
    if st.indirect:
        lit = _local(ar, st, t, below)
        if horizons is not None:
            visible = _visible(ar, st, t, horizons, frames, cells, below)
            slots = _light_slots(c.samples // PIECES) // PACKET
            spot = ar.range(frames * cells)
            lit = _shadowed(st, lit, [share for g in range(slots) for share in ar.packet(visible, spot * slots + g, PACKET)])
        arriving = _arriving(ar, st, t, below, _coloured(ar, t, lit), frames)

    # At every other pixel: the start of Newton's method, and shadows.
    across, down = _coarse(c.width, c.height)
    frame, pixel = _lanes(ar, frames, across * down)
    coarse = _meet(ar, st, places, normals, frame, ar.packet(t["coarse"], pixel, 4), None, NEWTON_STEPS)
    starts = ar.interleave([coarse.column, coarse.row])
    shades = _visible(ar, st, t, horizons, frames, across * down, coarse) if horizons is not None else None

    frame, pixel = _lanes(ar, frames, c.width * c.height)
    row = pixel // c.width
    column = pixel - row * c.width
    shift = 0.5 / SHADE - 0.5
    corners = _corners(ar, ar.real(column) * (1 / SHADE) + shift, ar.real(row) * (1 / SHADE) + shift, across, down, frame * (across * down))
    start = _mix(ar, starts, corners, 2)
    seen = _meet(ar, st, places, normals, frame, ar.packet(t["full"], pixel, 4), (start[0], start[1]), 1)
    lit = _local(ar, st, t, seen)
    if shades is not None:
        slots = _light_slots(c.samples // PIECES) // PACKET
        visible = []
        for g in range(slots):
            visible += _mix(ar, shades, [(index * slots + g, weight) for index, weight in corners], PACKET)
        lit = _shadowed(st, lit, visible)
    colour = _coloured(ar, t, lit)
    if arriving is not None:
        u = (seen.x * (1 / st.size[0]) + 0.5) * float(c.cells[0] - 1)
        v = (seen.y * (1 / st.size[1]) + 0.5) * float(c.cells[1] - 1)
        more = _mix(ar, arriving, _corners(ar, u, v, *c.cells, frame * cells), 4)
        colour = [colour[i] + more[i] for i in range(3)]
    if c.texels[0]:
        columns, rows = c.texels
        u = seen.column * (columns / (c.columns - 1)) - 0.5
        v = seen.row * (rows / (c.rows - 1)) - 0.5
        coat = _mix(ar, t["texture"], _corners(ar, u, v, columns, rows, frame * 0), 2)
        share = coat[0]
        if c.marked:
            size = st.field_shape[4]
            paint = _mix_values(ar, t["paint"], _corners(ar, *_normal_place(st, seen), size, size, frame * 0))
            share = share + coat[1] * paint
        colour = [a * share for a in colour]
    nothing = seen.missed
    colour = [ar.select(nothing, 0.0, ar.maximum(a, 0.0)) for a in colour]
    return ar.interleave([*colour, ar.select(nothing, float("nan"), seen.z)])


def _lanes(ar: Arrays, frames: int, each: int) -> tuple[Values, Values]:
    """Frame, and number within the frame, of each of frames * each lanes."""
    lane = ar.range(frames * each)
    frame = lane // each
    return frame, lane - frame * each


def _clip(ar: Arrays, a: Values, low: float, high: float) -> Values:
    return ar.minimum(ar.maximum(a, low), high)


def _corners(ar: Arrays, u: Values, v: Values, columns: int, rows: int, offset: Values) -> list[tuple[Values, Values]]:
    """Index and weight of the four nodes about place (u, v) of a grid, clamped to its rim."""
    u, v = _clip(ar, u, 0.0, columns - 1.0), _clip(ar, v, 0.0, rows - 1.0)
    i, j = ar.whole(_clip(ar, u, 0.0, columns - 2.0)), ar.whole(_clip(ar, v, 0.0, rows - 2.0))
    s, r = u - ar.real(i), v - ar.real(j)
    first = offset + j * columns + i
    return [(first, (1 - s) * (1 - r)), (first + 1, s * (1 - r)), (first + columns, (1 - s) * r), (first + (columns + 1), s * r)]


def _mix(ar: Arrays, source: Values, corners: list[tuple[Values, Values]], width: int) -> list[Values]:
    """Weighted packets."""
    packets = [(ar.packet(source, index, width), weight) for index, weight in corners]
    return [sum((p[i] * weight for p, weight in packets[1:]), packets[0][0][i] * packets[0][1]) for i in range(width)]


def _mix_values(ar: Arrays, source: Values, corners: list[tuple[Values, Values]]) -> Values:
    return sum(ar.gather(source, index) * weight for index, weight in corners)


def _meet(ar: Arrays, st: _Static, places: Values, normals: Values, frame: Values, ray: Any, start: Any, steps: int) -> _Seen:
    """Where rays meet the membrane; `start` a place in the material grid, or None for the place that lies there at rest."""
    c = st.counts
    columns, rows = c.columns, c.rows
    offset = frame * (columns * rows)
    per = (columns - 1) / st.size[0], (rows - 1) / st.size[1]
    if start is None:
        start = (ray[0] + st.size[0] / 2) * per[0], (ray[1] + st.size[1] / 2) * per[1]
    (u, v), z = start, ray[0]
    small = 0.02 / (per[0] * per[1])
    for _ in range(steps):
        i = ar.whole(_clip(ar, u, 0.0, columns - 2.0))
        j = ar.whole(_clip(ar, v, 0.0, rows - 2.0))
        s, r = u - ar.real(i), v - ar.real(j)
        first = offset + j * columns + i
        p00, p10 = ar.packet(places, first, 4), ar.packet(places, first + 1, 4)
        p01, p11 = ar.packet(places, first + columns, 4), ar.packet(places, first + (columns + 1), 4)
        point, du, dv = [], [], []
        for a in range(3):
            top, bottom = p10[a] - p00[a], p11[a] - p01[a]
            left = p00[a] + s * top
            right = p01[a] + s * bottom
            point.append(left + r * (right - left))
            du.append(top + r * (bottom - top))
            dv.append(right - left)
        fx, fy = point[0] - ray[0] - ray[2] * point[2], point[1] - ray[1] - ray[3] * point[2]
        a, b = du[0] - ray[2] * du[2], dv[0] - ray[2] * dv[2]
        e, d = du[1] - ray[3] * du[2], dv[1] - ray[3] * dv[2]
        det = a * d - b * e
        # A fold has no inverse there; a bounded step leads past it.
        inverse = 1.0 / ar.maximum(det, small)
        go = _clip(ar, (b * fy - d * fx) * inverse, -4.0, 4.0), _clip(ar, (e * fx - a * fy) * inverse, -4.0, 4.0)
        u, v = u + go[0], v + go[1]
        z = point[2] + go[0] * du[2] + go[1] * dv[2]
    # Beyond the rim the outermost patch was continued: there is no gel.
    edge = 0.5
    missed = (u < -edge) | (v < -edge) | (u > columns - 1 + edge) | (v > rows - 1 + edge)
    nx, ny = _mix(ar, normals, _corners(ar, u, v, columns, rows, offset), 2)
    flat = nx * nx + ny * ny
    # Longer than 1 only where the patch was continued beyond the rim.
    nz = ar.sqrt(ar.maximum(1.0 - flat, 1e-3))
    return _Seen(u, v, ray[0] + ray[2] * z, ray[1] + ray[3] * z, z, nx, ny, nz, missed)


def _normal_place(st: _Static, seen: _Seen) -> tuple[Values, Values]:
    scale = (st.field_shape[4] - 1) / 2
    return (seen.nx * (1 / st.normals) + 1.0) * scale, (seen.ny * (1 / st.normals) + 1.0) * scale


def _place(st: _Static, seen: _Seen) -> tuple[Values, Values]:
    """In the table's nodes of x and y."""
    _, rows, columns, _, _, _ = st.field_shape
    (x0, x1), (y0, y1) = st.places
    return (seen.x - x0) * ((columns - 1) / (x1 - x0)), (seen.y - y0) * ((rows - 1) / (y1 - y0))


def _local(ar: Arrays, st: _Static, t: dict[str, Values], seen: _Seen) -> list[Values]:
    """a_k of the table, in fours."""
    _, rows, columns, size, _, components = st.field_shape
    w = _clip(ar, (seen.z - st.heights[0]) * (1 / (st.heights[1] - st.heights[0])), -1.0, 2.0)
    groups = components // PACKET
    total: list[Any] = [0.0] * components
    # The simplex of five nodes that holds the place, not all sixteen about it: corners in the order in which the diagonal passes them.
    strides = (1, size, size * size, size * size * columns)
    at, order = 0, []
    for place, count, stride in zip((*_normal_place(st, seen), *_place(st, seen)), (size, size, columns, rows), strides, strict=True):
        place = _clip(ar, place, 0.0, count - 1.0)
        first = ar.whole(_clip(ar, place, 0.0, count - 2.0))
        at = at + first * stride
        order.append((place - ar.real(first), ar.whole(place * 0.0) + stride))
    for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)):
        (a, a_stride), (b, b_stride) = order[i], order[j]
        swap = a < b
        order[i] = ar.maximum(a, b), ar.select(swap, b_stride, a_stride)
        order[j] = ar.minimum(a, b), ar.select(swap, a_stride, b_stride)
    shares = [1.0, *(share for share, _ in order), 0.0]
    for corner in range(5):
        weight = shares[corner] - shares[corner + 1]
        rising = weight * w
        for g in range(groups):
            node = ar.packet(t["field"], at * groups + g, 2 * PACKET)
            for k in range(PACKET):
                total[PACKET * g + k] = total[PACKET * g + k] + (weight * node[k] + rising * node[PACKET + k])
        if corner < 4:
            at = at + order[corner][1]
    return total


def _shadowed(st: _Static, lit: list[Values], visible: list[Values]) -> list[Values]:
    return [a * visible[max(light, 0)] for a, light in zip(lit, st.light_of, strict=True)]


def _coloured(ar: Arrays, t: dict[str, Values], lit: list[Values]) -> list[Values]:
    zero = ar.whole(lit[0] * 0.0)
    return [sum(a * ar.gather(t["colours"], zero + (3 * k + i)) for k, a in enumerate(lit)) for i in range(3)]


def _horizons(ar: Arrays, st: _Static, t: dict[str, Values], heights: Values, frames: int) -> Values:
    """About each piece of a light: the smallest (z - z_light)/distance up to a place, and 1/distance where it is; in pairs."""
    c = st.counts
    lines = c.samples * LINES
    lane = ar.range(frames * lines * STEPS)
    step = lane // (frames * lines)
    line = lane - step * (frames * lines)
    frame = line // lines
    at = ar.packet(t["polar"], step * lines + (line - frame * lines), 4)
    z = _mix_values(ar, heights, _corners(ar, at[0], at[1], *c.cells, frame * (c.cells[0] * c.cells[1])))
    return ar.running_minimum(ar.select(at[0] < -1.0, FAR, (z - at[2]) * at[3]), at[3], frames * lines, STEPS)


def _line_corners(ar: Arrays, along: Values, line: Values, stride: int, offset: Values) -> list[tuple[Values, Values]]:
    """As `_corners`, in what `_horizons` gave: `stride` apart along a line."""
    u, v = _clip(ar, along, 0.0, STEPS - 1.0), _clip(ar, line, 0.0, LINES - 1.0)
    i, j = ar.whole(_clip(ar, u, 0.0, STEPS - 2.0)), ar.whole(_clip(ar, v, 0.0, LINES - 2.0))
    s, r = u - ar.real(i), v - ar.real(j)
    first = i * stride + j + offset
    return [(first, (1 - s) * (1 - r)), (first + stride, s * (1 - r)), (first + 1, (1 - s) * r), (first + (stride + 1), s * r)]


def _visible(ar: Arrays, st: _Static, t: dict[str, Values], horizons: Values, frames: int, each: int, seen: _Seen) -> Values:
    """The visible share of each light, of what the tangent plane leaves of it; whole packets of lights for each of frames * each places."""
    c = st.counts
    lines = c.samples * LINES
    lights = c.samples // PIECES
    places = ar.interleave([seen.x, seen.y, seen.z, seen.z])
    # dz/dx and dz/dy
    slopes = ar.interleave([-seen.nx / seen.nz, -seen.ny / seen.nz])
    slots = _light_slots(lights)
    lane = ar.range(frames * each * slots)
    spot = lane // slots
    frame = spot // each
    light = ar.minimum(lane - spot * slots, lights - 1)
    px, py, pz, _ = ar.packet(places, spot, 4)
    slope_x, slope_y = ar.packet(slopes, spot, 2)
    total = 0.0 * px
    for piece in range(PIECES):
        sample = light * PIECES + piece
        x, y, z, tall = ar.packet(t["pieces"], sample * 3, 4)
        cosine, sine, first, per_turn = ar.packet(t["pieces"], sample * 3 + 1, 4)
        near, per_step, _, _ = ar.packet(t["pieces"], sample * 3 + 2, 4)
        dx, dy = px - x, py - y
        distance = ar.sqrt(dx * dx + dy * dy)
        angle = ar.atan2(dy * cosine - dx * sine, dx * cosine + dy * sine)
        # One step back: what is nearer than that is the tangent plane's.
        along = (distance - near) * per_step - 1.0
        corners = _line_corners(ar, along, (angle - first) * per_turn, frames * lines, frame * lines + sample * LINES)
        lowest, where = _mix(ar, horizons, corners, 2)
        inverse = 1.0 / distance
        here = (pz - z) * inverse
        horizon = ar.select(lowest > 0.1 * FAR, FAR, z + (lowest - here) / ar.maximum(where - inverse, 1e-5))
        tangent = pz - (slope_x * dx + slope_y * dy)
        low = z - tall
        top = ar.minimum(ar.maximum(tangent, low), z + tall)
        cut = ar.minimum(ar.maximum(ar.minimum(horizon, top), low), top)
        whole = (top - low) * (2.0 * tangent - low - top)
        left = (cut - low) * (2.0 * tangent - low - cut)
        total = total + ar.select(whole > 1e-6, left / ar.maximum(whole, 1e-6), 1.0)
    return total * (1 / PIECES)


def _light_slots(lights: int) -> int:
    """Lights in whole packets."""
    return -(-lights // PACKET) * PACKET


def _arriving(ar: Arrays, st: _Static, t: dict[str, Values], below: _Seen, colour: list[Values], frames: int) -> Values:
    """Radiance by channel that light from other parts of the membrane adds, on the grid of heights; in fours, the fourth unused."""
    c = st.counts
    columns, rows = c.cells
    cells = columns * rows
    sources = ar.interleave([below.z, *(ar.maximum(a, 0.0) for a in colour)])
    tilts = ar.interleave([below.nx, below.ny, below.nz, below.z])
    frame, rest = _lanes(ar, frames, cells * DIRECTIONS)
    cell = rest // DIRECTIONS
    direction = rest - cell * DIRECTIONS
    turn = 2 * np.pi / DIRECTIONS
    row = cell // columns
    column = cell - row * columns
    nx, ny, nz, z = ar.packet(tilts, frame * cells + cell, 4)
    offsets = ar.packet(t["directions"], direction, 2)
    # The normal into the gel, its part along the direction and its part up (-z): the tangent plane's elevation is -forward / up.
    forward = -(nx * offsets[0] + ny * offsets[1])
    highest = -forward / nz
    covered = _view(ar, forward, nz, highest)
    totals = [0.0 * nx for _ in range(3)]
    for reach in REACHES:
        di, dj = ar.whole(offsets[0] * float(reach) + 0.5), ar.whole(offsets[1] * float(reach) + 0.5)
        i, j = column + di, row + dj
        inside = (i >= 0) & (j >= 0) & (i < columns) & (j < rows)
        at = frame * cells + ar.minimum(ar.maximum(j, 0), rows - 1) * columns + ar.minimum(ar.maximum(i, 0), columns - 1)
        other = ar.packet(sources, at, 4)
        apart_x = ar.real(di) * (st.size[0] / (columns - 1))
        apart_y = ar.real(dj) * (st.size[1] / (rows - 1))
        rise = (z - other[0]) / ar.sqrt(apart_x * apart_x + apart_y * apart_y)
        seen = inside & (rise > highest)
        highest = ar.select(seen, rise, highest)
        view = _view(ar, forward, nz, highest)
        for channel in range(3):
            totals[channel] = totals[channel] + ar.select(seen, (view - covered) * other[1 + channel], 0.0)
        covered = view
    slices = ar.interleave([*totals, totals[0] * 0.0])
    frame, cell = _lanes(ar, frames, cells)
    first = (frame * cells + cell) * DIRECTIONS
    parts = [ar.packet(slices, first + k, 4) for k in range(DIRECTIONS)]
    _, rows, columns, _, _, _ = st.field_shape
    veil = _mix(ar, t["veil"], _corners(ar, *_place(st, below), columns, rows, cell * 0), 4)
    zero = cell * 0
    scale = turn / np.pi
    added = [sum((p[i] for p in parts[1:]), parts[0][i]) * (scale * ar.gather(t["gains"], zero + i)) + veil[i] for i in range(3)]
    return ar.interleave([*added, parts[0][3]])


def _view(ar: Arrays, forward: Values, up: Values, rise: Values) -> Values:
    """∫ (forward cos α + up sin α) cos α dα up to the elevation with tangent `rise`."""
    square = 1.0 / (1.0 + rise * rise)
    return forward * 0.5 * (ar.atan(rise) + rise * square) - up * 0.5 * square
