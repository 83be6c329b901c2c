"""The kernels of `gelsim.live.batch_layer` and `batch`: products of waves, a step along the slip, and the undersides of rigid objects.

Undersides, over the cells of many gels, at poses of their own: one thread a cell walks up along z as far as the object's signed distance
(`gelsim.fem.field`) allows (sphere tracing), then by Newton's steps. `underside.py` keeps a map of heights for one sensor instead. Left
out, as there: undercuts; and what is higher than a cell's ceiling, which the gel does not reach.

Waves are complex, as pairs; answers as of `batch_layer.Layers.ways`. Each field passes the memory once, where PyTorch would take it through
some ten operations (docs/live.md, *Rate*).
"""

from __future__ import annotations

import warp as wp

from gelsim.fem.field import FieldGrid, read_field

CLOSE_MM = 0.02
"""Of the surface, where Newton's steps begin."""
MARCH, CORRECTIONS = 64, 3
FAR_MM = wp.constant(1e3)
"""Height where there is no object."""


@wp.func
def times(answer: float, wave: wp.vec2f) -> wp.vec2f:
    return answer * wave


@wp.func
def turned(answer: float, wave: wp.vec2f) -> wp.vec2f:
    """Times i."""
    return wp.vec2f(-answer * wave[1], answer * wave[0])


@wp.kernel(enable_backward=False)
def moved_waves(ways: wp.array3d(dtype=float), tractions: wp.array3d(dtype=wp.vec2f), found: wp.array3d(dtype=wp.vec2f)):
    """Displacements of tangential tractions and pressure, (sensor, x y z, wave)."""
    n, k = wp.tid()
    x = tractions[n, 0, k]
    y = tractions[n, 1, k]
    p = tractions[n, 2, k]
    found[n, 0, k] = times(ways[n, 1, k], x) + times(ways[n, 3, k], y) + turned(ways[n, 4, k], p)
    found[n, 1, k] = times(ways[n, 3, k], x) + times(ways[n, 2, k], y) + turned(ways[n, 5, k], p)
    found[n, 2, k] = turned(ways[n, 4, k], x) + turned(ways[n, 5, k], y) - times(ways[n, 0, k], p)


@wp.kernel(enable_backward=False)
def dragged_waves(ways: wp.array3d(dtype=float), tractions: wp.array3d(dtype=wp.vec2f), found: wp.array3d(dtype=wp.vec2f)):
    """Motion along the face of tangential tractions alone."""
    n, k = wp.tid()
    x = tractions[n, 0, k]
    y = tractions[n, 1, k]
    found[n, 0, k] = times(ways[n, 1, k], x) + times(ways[n, 3, k], y)
    found[n, 1, k] = times(ways[n, 3, k], x) + times(ways[n, 2, k], y)


@wp.kernel(enable_backward=False)
def lifted_waves(ways: wp.array3d(dtype=float), tractions: wp.array3d(dtype=wp.vec2f), found: wp.array3d(dtype=wp.vec2f)):
    """Height of tangential tractions alone."""
    n, k = wp.tid()
    found[n, 0, k] = turned(ways[n, 4, k], tractions[n, 0, k]) + turned(ways[n, 5, k], tractions[n, 1, k])


@wp.kernel(enable_backward=False)
def against_slip(
    q: wp.array3d(dtype=float), slip: wp.array3d(dtype=float), bound: wp.array2d(dtype=float), step: wp.array(dtype=float),
    way: wp.array3d(dtype=float),
):  # fmt: skip
    """What a step against the slip changes of tangential tractions (sensor, x y, cell) that keep to their bound."""
    n, k = wp.tid()
    x = q[n, 0, k] - step[n] * slip[n, 0, k]
    y = q[n, 1, k] - step[n] * slip[n, 1, k]
    share = wp.min(1.0, bound[n, k] / wp.max(wp.sqrt(x * x + y * y), 1.0e-30))
    way[n, 0, k] = share * x - q[n, 0, k]
    way[n, 1, k] = share * y - q[n, 1, k]


@wp.kernel(enable_backward=False)
def undersides(
    field: FieldGrid,
    turns: wp.array(dtype=wp.mat33d),
    shifts: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.float32),
    y: wp.array(dtype=wp.float32),
    ceiling: wp.array2d(dtype=wp.float32),
    found: wp.array3d(dtype=wp.float32),
):
    """Heights [mm] over (sensor, row, column).

    Args:
        field: Of the object.
        turns, shifts: The poses, p -> turn p + shift [mm].
        ceiling: Heights up to which cells are looked at [mm].
    """
    sensor, row, column = wp.tid()
    found[sensor, row, column] = FAR_MM
    turn = wp.transpose(turns[sensor])
    foot = turn * (wp.vec3d(wp.float64(x[column]), wp.float64(y[row]), wp.float64(0.0)) - shifts[sensor])
    way = turn * wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
    # Where the line is within the grid, a support of the splines from its rim.
    rim = wp.float64(1.01)
    begin = wp.float64(-1.0e3)
    end = wp.float64(ceiling[row, column])
    for axis in range(3):
        low = field.origin[axis] + rim * field.spacing
        high = field.origin[axis] + (wp.float64(field.samples.shape[axis] - 1) - rim) * field.spacing
        if wp.abs(way[axis]) > wp.float64(1.0e-9):
            a = (low - foot[axis]) / way[axis]
            b = (high - foot[axis]) / way[axis]
            begin = wp.max(begin, wp.min(a, b))
            end = wp.min(end, wp.max(a, b))
        elif foot[axis] < low or foot[axis] > high:
            end = begin
    z = begin
    near = wp.float64(CLOSE_MM)
    met = bool(False)
    for _ in range(MARCH):
        if not met and z < end:
            away = read_field(field, foot + z * way).value
            if away <= near:
                met = bool(True)
            else:
                z += wp.max(away - near / wp.float64(2.0), near / wp.float64(2.0))
    if not met or z >= end:
        return
    for _ in range(CORRECTIONS):
        here = read_field(field, foot + z * way)
        slope = wp.min(wp.dot(here.slope, way), wp.float64(-0.1))
        z -= wp.clamp(here.value / slope, wp.float64(-0.1), wp.float64(0.1))
    if z < end:
        found[sensor, row, column] = wp.float32(z)
