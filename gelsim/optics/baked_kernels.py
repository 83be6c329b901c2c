"""The pictures of a batch of membranes from a light field, in the operations of `optics.arrays`: what `optics.baked` says, step by step.

Arrays are flat: frame by frame, row by row, components next to each other. Lengths are mm. Everything that varies from frame to frame is in
the arguments, everything else in the tables and the layout, so that a vectorised backend traces these lines once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gelsim.data.lightfield import PACKET
from gelsim.optics.arrays import Arrays, Values, clipped, grid_corners, mixed
from gelsim.optics.isp import Pipeline, develop_pixels, packed_bytes

PIECES = 3
"""A light's long side is cut in so many for its soft shadow."""
LINES, STEPS = 128, 160
"""Of the polar grid about a piece of a light."""
CELLS_A_SHADOW = 2
"""Of inter-reflection, along a side: with one in each cell pictures are no nearer to `path`."""
DIRECTIONS = 8
REACHES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 27, 33)
"""Of the samples along a direction of inter-reflection [cells]: near parts fill most of the view."""
FAR = 1e6
"""Of a horizon that nothing makes."""
MEET_STEPS = 4
"""From the rest position, at starts; then one more at each pixel. Quadratic: four reach 0.01 pixel from a cell's edge."""


@dataclass(frozen=True)
class Layout:
    """Sizes and ranges that the kernels are made for."""

    width: int
    height: int
    shade: int
    """Pixels along a side for one shadow value, and for one start of Newton's method."""
    lit: int
    """Pixels along a side for one value of the light that is not the coat's pattern."""
    columns: int
    """Of the membrane's grid."""
    rows: int
    cells: tuple[int, int]
    """Of the grid for inter-reflection: columns, rows."""
    viewed: tuple[int, int, int, int]
    """Of that grid what the camera can see: first column and row, columns, rows."""
    fine: tuple[int, int]
    """Of the grid of heights that cast shadows."""
    size: list[float]
    """Of the gel."""
    samples: int
    """Pieces of lights; 0 without shadows."""
    indirect: bool
    texels: tuple[int, int]
    """Columns and rows of the coat's texture, (0, 0) without grain and markers."""
    marked: bool
    field_shape: tuple[int, ...]
    """Of the light field's table; then its places, heights and steepest normal, and the light of each component."""
    places: list[list[float]]
    heights: list[float]
    normals: float
    light_of: list[int]
    pipeline: Pipeline


def coarse_size(width: int, height: int, shade: int) -> tuple[int, int]:
    return -(-width // shade), -(-height // shade)


@dataclass(frozen=True)
class MaterialGrid:
    """Of a membrane: columns and rows of its vertices, and the gel's size [mm]."""

    columns: int
    rows: int
    size: list[float]


@dataclass
class Seen:
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


def draw(ar: Arrays, st: Layout, t: dict[str, Any], places: Values, normals: Values, keys: Values | None) -> tuple:
    """Red, green, blue and z [m] of every pixel; and, with `keys` of the frames' noise, the 8-bit pictures as `packed_bytes`, else None."""
    frames = len(places) // (4 * st.columns * st.rows)
    # Over the gel, seen along z: heights, and what light does there.
    horizons = arriving = None
    cells = st.cells[0] * st.cells[1]
    frame, cell = _lanes(ar, frames, cells)
    below = meet(ar, st, places, normals, frame, ar.packet(t["plumb"], cell, 4), None, MEET_STEPS)
    if st.samples:
        horizons = _horizons(ar, st, t, _fine_heights(ar, st, t, places, normals, below, frames), frames)
    if st.indirect:
        frame, cell = _lanes(ar, frames, cells)
        lit = _local(ar, st, t, below)
        if horizons is not None:
            some = coarse_size(*st.cells, CELLS_A_SHADOW)
            visible = _visible(ar, st, t, horizons, frames, some[0] * some[1], below, CELLS_A_SHADOW)
            line = cell // st.cells[0]
            u, v = (ar.real(place) * (1 / CELLS_A_SHADOW) for place in (cell - line * st.cells[0], line))
            lit = _shadowed(st, lit, _mixed_shades(ar, st, visible, grid_corners(ar, u, v, *some, frame * (some[0] * some[1]))))
        arriving = _arriving(ar, st, t, below, _coloured(ar, t, lit), frames)

    # At every few pixels: the start of Newton's method, and shadows.
    across, down = coarse_size(st.width, st.height, st.shade)
    frame, pixel = _lanes(ar, frames, across * down)
    coarse = meet(ar, st, places, normals, frame, ar.packet(t["coarse"], pixel, 4), None, MEET_STEPS)
    starts = ar.interleave([coarse.column, coarse.row])
    shades = _visible(ar, st, t, horizons, frames, across * down, coarse) if horizons is not None else None

    def met(name: str, step: int) -> tuple[Seen, list[tuple[Values, Values]], Values]:
        """By the rays of every step-th pixel: the membrane, their corners among the coarse ones, and their frames."""
        columns, rows = coarse_size(st.width, st.height, step)
        frame, lane = _lanes(ar, frames, columns * rows)
        corners = _among(ar, lane, columns, step / st.shade, (across, down), frame)
        start = mixed(ar, starts, corners, 2)
        return meet(ar, st, places, normals, frame, ar.packet(t[name], lane, 4), (start[0], start[1]), 1), corners, frame

    def light(seen: Seen, corners: list[tuple[Values, Values]], frame: Values) -> list[Values]:
        """Red, green, blue and the markers' shade."""
        lit = _local(ar, st, t, seen)
        if shades is not None:
            lit = _shadowed(st, lit, _mixed_shades(ar, st, shades, corners))
        colour = _coloured(ar, t, lit)
        if arriving is not None:
            u = (seen.x * (1 / st.size[0]) + 0.5) * float(st.cells[0] - 1)
            v = (seen.y * (1 / st.size[1]) + 0.5) * float(st.cells[1] - 1)
            first_column, first_row, columns, rows = st.viewed
            more = mixed(ar, arriving, grid_corners(ar, u - first_column, v - first_row, columns, rows, frame * (columns * rows)), 4)
            colour = [colour[i] + more[i] for i in range(3)]
        if not (st.texels[0] and st.marked):
            return [*colour, 0.0 * colour[0]]
        size = st.field_shape[4]
        return [*colour, _mix_values(ar, t["paint"], grid_corners(ar, *_normal_place(st, seen), size, size, frame * 0))]

    seen, corners, frame = met("full", 1)
    pixel = ar.range(frames * st.width * st.height) - frame * (st.width * st.height)
    row = pixel // st.width
    column = pixel - row * st.width
    if st.lit > 1:
        fewer = coarse_size(st.width, st.height, st.lit)
        *colour, paint = mixed(ar, ar.interleave(light(*met("lit", st.lit))), _among(ar, pixel, st.width, 1 / st.lit, fewer, frame), 4)
    else:
        *colour, paint = light(seen, corners, frame)
    if st.texels[0]:
        columns, rows = st.texels
        u = seen.column * (columns / (st.columns - 1)) - 0.5
        v = seen.row * (rows / (st.rows - 1)) - 0.5
        coat = mixed(ar, t["texture"], grid_corners(ar, u, v, columns, rows, frame * 0), 2)
        share = coat[0]
        if st.marked:
            share = share + coat[1] * paint
        colour = [a * share for a in colour]
    nothing = seen.missed
    colour = [ar.select(nothing, 0.0, ar.maximum(a, 0.0)) for a in colour]
    pixels = ar.interleave([*colour, ar.select(nothing, float("nan"), seen.z * 1e-3)])
    if keys is None:
        return pixels, None
    came = place_at_rest(ar, st, t["rest_nodes"], seen, column, row) if st.pipeline.rest[0] else None
    return pixels, packed_bytes(ar, develop_pixels(ar, st.pipeline, t, colour, pixel, frame, keys, came))


def _lanes(ar: Arrays, frames: int, each: int) -> tuple[Values, Values]:
    """Frame, and number within the frame, of each of frames * each lanes."""
    lane = ar.range(frames * each)
    frame = lane // each
    return frame, lane - frame * each


def _among(ar: Arrays, lane: Values, columns: int, step: float, size: tuple[int, int], frame: Values) -> list[tuple[Values, Values]]:
    """`grid_corners` of every lane of a picture, `columns` wide, in a coarser one of `size`: one of its pixels is 1/step wide there."""
    row, shift = lane // columns, 0.5 * step - 0.5
    u, v = (ar.real(place) * step + shift for place in (lane - row * columns, row))
    return grid_corners(ar, u, v, *size, frame * (size[0] * size[1]))


def _mix_values(ar: Arrays, source: Values, corners: list[tuple[Values, Values]]) -> Values:
    return sum(ar.gather(source, index) * weight for index, weight in corners)


def meet(ar: Arrays, st: Layout | MaterialGrid, places: Values, normals: Values, frame: Values, ray: Any, start: Any, steps: int) -> Seen:
    """Where rays meet the membrane; `start` a place in the material grid, or None for the place that lies there at rest."""
    columns, rows = st.columns, st.rows
    offset = frame * (columns * rows)
    per = (columns - 1) / st.size[0], (rows - 1) / st.size[1]
    if start is None:
        start = (ray[0] + st.size[0] / 2) * per[0], (ray[1] + st.size[1] / 2) * per[1]
    (u, v), z = start, ray[0]
    small = 0.02 / (per[0] * per[1])
    for _ in range(steps):
        i = ar.whole(clipped(ar, u, 0.0, columns - 2.0))
        j = ar.whole(clipped(ar, v, 0.0, rows - 2.0))
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
        go = clipped(ar, (b * fy - d * fx) * inverse, -4.0, 4.0), clipped(ar, (e * fx - a * fy) * inverse, -4.0, 4.0)
        u, v = u + go[0], v + go[1]
        z = point[2] + go[0] * du[2] + go[1] * dv[2]
    # Beyond the rim the outermost patch was continued: there is no gel.
    edge = 0.5
    missed = (u < -edge) | (v < -edge) | (u > columns - 1 + edge) | (v > rows - 1 + edge)
    nx, ny = mixed(ar, normals, grid_corners(ar, u, v, columns, rows, offset), 2)
    flat = nx * nx + ny * ny
    # Longer than 1 only where the patch was continued beyond the rim.
    nz = ar.sqrt(ar.maximum(1.0 - flat, 1e-3))
    return Seen(u, v, ray[0] + ray[2] * z, ray[1] + ray[3] * z, z, nx, ny, nz, missed)


def place_at_rest(ar: Arrays, st: Layout | MaterialGrid, nodes: Values, seen: Seen, column: Values, row: Values) -> list[Values]:
    """Where in the picture at rest [px] the coat appeared that is seen now; a pixel (column, row) that sees no gel stays where it is.

    Args:
        nodes: Where the material grid's nodes appear at rest, in pairs.
    """
    came = mixed(ar, nodes, grid_corners(ar, seen.column, seen.row, st.columns, st.rows, ar.whole(seen.column * 0.0)), 2)
    return [ar.select(seen.missed, ar.real(own) + 0.5, place) for own, place in zip((column, row), came, strict=True)]


def _normal_place(st: Layout, seen: Seen) -> tuple[Values, Values]:
    scale = (st.field_shape[4] - 1) / 2
    return (seen.nx * (1 / st.normals) + 1.0) * scale, (seen.ny * (1 / st.normals) + 1.0) * scale


def _place(st: Layout, x: Values, y: Values) -> tuple[Values, Values]:
    """In the table's nodes of x and y."""
    _, rows, columns, _, _, _ = st.field_shape
    (x0, x1), (y0, y1) = st.places
    return (x - x0) * ((columns - 1) / (x1 - x0)), (y - y0) * ((rows - 1) / (y1 - y0))


def _local(ar: Arrays, st: Layout, t: dict[str, Any], seen: Seen) -> list[Values]:
    """a_k of the table, in fours."""
    _, rows, columns, size, _, components = st.field_shape
    w = clipped(ar, (seen.z - st.heights[0]) * (1 / (st.heights[1] - st.heights[0])), -1.0, 2.0)
    groups = components // PACKET
    total: list[Any] = [0.0] * components
    # The simplex of five nodes that holds the place, not all sixteen about it: corners in the order in which the diagonal passes them.
    strides = (1, size, size * size, size * size * columns)
    at, order = 0, []
    for place, count, stride in zip(
        (*_normal_place(st, seen), *_place(st, seen.x, seen.y)), (size, size, columns, rows), strides, strict=True
    ):
        place = clipped(ar, place, 0.0, count - 1.0)
        first = ar.whole(clipped(ar, place, 0.0, count - 2.0))
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


def _mixed_shades(ar: Arrays, st: Layout, visible: Values, corners: list[tuple[Values, Values]]) -> list[Values]:
    """Of `_visible`, between its places."""
    slots = _light_slots(st.samples // PIECES) // PACKET
    groups = (mixed(ar, visible, [(index * slots + g, weight) for index, weight in corners], PACKET) for g in range(slots))
    return [share for group in groups for share in group]


def _shadowed(st: Layout, lit: list[Values], visible: list[Values]) -> list[Values]:
    return [a * visible[max(light, 0)] for a, light in zip(lit, st.light_of, strict=True)]


def _coloured(ar: Arrays, t: dict[str, Any], lit: list[Values]) -> list[Values]:
    return [sum(a * t["colours"][3 * k + i] for k, a in enumerate(lit)) for i in range(3)]


def _fine_heights(ar: Arrays, st: Layout, t: dict[str, Any], places: Values, normals: Values, below: Seen, frames: int) -> Values:
    """Heights that cast shadows, on their own grid: one step of Newton's method from what is below the coarser one (95 dB from six)."""
    across, down = st.fine
    frame, cell = _lanes(ar, frames, across * down)
    row = cell // across
    u = ar.real(cell - row * across) * ((st.cells[0] - 1) / (across - 1))
    v = ar.real(row) * ((st.cells[1] - 1) / (down - 1))
    starts = ar.interleave([below.column, below.row])
    start = mixed(ar, starts, grid_corners(ar, u, v, *st.cells, frame * (st.cells[0] * st.cells[1])), 2)
    return ar.stored(meet(ar, st, places, normals, frame, ar.packet(t["fine"], cell, 4), (start[0], start[1]), 1).z)


def _horizons(ar: Arrays, st: Layout, t: dict[str, Any], heights: Values, frames: int) -> Values:
    """About each piece of a light: the smallest (z - z_light)/distance up to a place, and 1/distance where it is; in pairs."""
    lines = st.samples * LINES
    lane = ar.range(frames * lines * STEPS)
    step = lane // (frames * lines)
    line = lane - step * (frames * lines)
    frame = line // lines
    at = ar.packet(t["polar"], step * lines + (line - frame * lines), 4)
    z = _mix_values(ar, heights, grid_corners(ar, at[0], at[1], *st.fine, frame * (st.fine[0] * st.fine[1])))
    return ar.running_minimum(ar.select(at[0] < -1.0, FAR, (z - at[2]) * at[3]), at[3], frames * lines, STEPS)


def _line_corners(ar: Arrays, along: Values, line: Values, stride: int, offset: Values) -> list[tuple[Values, Values]]:
    """As `grid_corners`, in what `_horizons` gave: `stride` apart along a line."""
    u, v = clipped(ar, along, 0.0, STEPS - 1.0), clipped(ar, line, 0.0, LINES - 1.0)
    i, j = ar.whole(clipped(ar, u, 0.0, STEPS - 2.0)), ar.whole(clipped(ar, v, 0.0, LINES - 2.0))
    s, r = u - ar.real(i), v - ar.real(j)
    first = i * stride + j + offset
    return [(first, (1 - s) * (1 - r)), (first + stride, s * (1 - r)), (first + 1, (1 - s) * r), (first + (stride + 1), s * r)]


def _visible(ar: Arrays, st: Layout, t: dict[str, Any], horizons: Values, frames: int, each: int, seen: Seen, step: int = 1) -> Values:
    """The visible share of each light, of what the tangent plane leaves of it; whole packets of lights for each of frames * each places:
    of those seen, or with a `step` of those of the cells over the gel every step-th along both sides."""
    lines = st.samples * LINES
    lights = st.samples // PIECES
    places = ar.interleave([seen.x, seen.y, seen.z, seen.z])
    # dz/dx and dz/dy
    slopes = ar.interleave([-seen.nx / seen.nz, -seen.ny / seen.nz])
    slots = _light_slots(lights)
    lane = ar.range(frames * each * slots)
    spot = lane // slots
    frame = spot // each
    light = ar.minimum(lane - spot * slots, lights - 1)
    if step > 1:
        across = coarse_size(*st.cells, step)[0]
        row = (spot - frame * each) // across
        spot = frame * (st.cells[0] * st.cells[1]) + step * (row * st.cells[0] + spot - frame * each - row * across)
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
        lowest, where = mixed(ar, horizons, corners, 2)
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


def _arriving(ar: Arrays, st: Layout, t: dict[str, Any], below: Seen, colour: list[Values], frames: int) -> Values:
    """Radiance by channel that light from other parts of the membrane adds, where the camera sees; in fours, the fourth unused."""
    columns, rows = st.cells
    first_column, first_row, across, down = st.viewed
    cells, viewed = columns * rows, across * down
    sources = ar.interleave([below.z, *(ar.maximum(a, 0.0) for a in colour)])
    tilts = ar.interleave([below.nx, below.ny, below.nz, below.z])
    frame, rest = _lanes(ar, frames, viewed * DIRECTIONS)
    spot = rest // DIRECTIONS
    direction = rest - spot * DIRECTIONS
    turn = 2 * np.pi / DIRECTIONS
    row = spot // across
    column = spot - row * across + first_column
    row = row + first_row
    nx, ny, nz, z = ar.packet(tilts, frame * cells + row * columns + column, 4)
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
    frame, spot = _lanes(ar, frames, viewed)
    first = (frame * viewed + spot) * DIRECTIONS
    parts = [ar.packet(slices, first + k, 4) for k in range(DIRECTIONS)]
    zero = spot * 0
    row = spot // across
    x = (ar.real(spot - row * across + first_column) * (1 / (columns - 1)) - 0.5) * st.size[0]
    y = (ar.real(row + first_row) * (1 / (rows - 1)) - 0.5) * st.size[1]
    _, places_down, places_across, _, _, _ = st.field_shape
    veil = mixed(ar, t["veil"], grid_corners(ar, *_place(st, x, y), places_across, places_down, zero), 4)
    scale = turn / np.pi
    added = [sum((p[i] for p in parts[1:]), parts[0][i]) * (t["gains"][i] * scale) + veil[i] for i in range(3)]
    return ar.interleave([*added, parts[0][3]])


def _view(ar: Arrays, forward: Values, up: Values, rise: Values) -> Values:
    """∫ (forward cos α + up sin α) cos α dα up to the elevation with tangent `rise`."""
    square = 1.0 / (1.0 + rise * rise)
    return forward * 0.5 * (ar.atan(rise) + rise * square) - up * 0.5 * square
