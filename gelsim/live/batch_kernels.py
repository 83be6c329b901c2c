"""The kernels of `gelsim.live.batch_layer` and `batch`: products of waves, steps to pressure and shear, what is of second order, and the
undersides of rigid objects.

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
DONE, TRIED, GONE = wp.constant(0.0), wp.constant(1.0), wp.constant(2.0)
"""What `press_on` has to do."""


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


@wp.func
def line_search(steep: wp.float64, against: wp.float64, size: wp.float64) -> wp.vec2f:
    """Share of a move to the least of a quadratic function, at most all of it, and the next step against the gradient (Birgin, Martínez and
    Raydan 2000): of how the gradient changes, its product with the move, with itself, and of the gradient before with the move, each what a
    thread of the block has of it. Both are 0 where nothing rises along the move, which rounding made."""
    total = wp.tile_sum(wp.tile(steep))[0]
    before = wp.tile_sum(wp.tile(against))[0]
    length = wp.tile_sum(wp.tile(size))[0]
    if total <= wp.float64(0.0):
        return wp.vec2f(0.0, 0.0)
    return wp.vec2f(wp.float32(wp.clamp(-before / total, wp.float64(0.0), wp.float64(1.0))), wp.float32(total / length))


@wp.kernel(enable_backward=False)
def press_on(
    turn: int, change: wp.array2d(dtype=float), move: wp.array2d(dtype=float), pressure: wp.array2d(dtype=float),
    gap: wp.array2d(dtype=float), way: wp.array2d(dtype=float), known: wp.array2d(dtype=float), phase: wp.array2d(dtype=float),
):  # fmt: skip
    """A product's part of a step of `gelsim.live.layer.pressure` over (sensor, cell): a way is tried, and if on it contact begins or ends,
    the change of pressure too.

    One block of threads goes over the cells of a sensor, so that sums have one order.

    Args:
        turn: 0: finds the first way only.
        change: Of the gap by the move.
        move: The way that is tried, or the change of pressure.
        way: The last one, where there is pressure.
        known: Gap allowed under a pressure, root mean square [mm]; a step against the gap that is not too long [kPa/mm]; the sum of squares
            of the gap under pressure, 0 for a way anew; the step at which contact ends somewhere; and 1 where there is overlap beside the
            contact, (sensor, 5).
        phase: DONE of those that stay as they are, else what the move is, (sensor, 1).
    """
    n, lane = wp.tid()
    now = phase[n, 0]
    if now == DONE:
        return
    allowed = known[n, 0]
    size = known[n, 2]
    step = float(0.0)
    if turn > 0 and now == TRIED:
        steep = wp.float64(0.0)
        against = wp.float64(0.0)
        for k in range(lane, move.shape[1], wp.block_dim()):
            steep += wp.float64(change[n, k] * move[n, k])
            against += wp.float64(gap[n, k] * move[n, k])
        total = wp.tile_sum(wp.tile(steep))[0]
        along = wp.tile_sum(wp.tile(against))[0]
        step = known[n, 1]
        if total > wp.float64(0.0):  # else nothing touches yet, or no more than rounding is left
            step = wp.float32(along / total)
        if step > known[n, 3] or known[n, 4] > 0.0:
            for k in range(lane, move.shape[1], wp.block_dim()):
                p = pressure[n, k]
                to = wp.max(p - step * move[n, k], 0.0)
                if p <= 0.0:
                    to = -step * wp.min(gap[n, k], 0.0)
                pressure[n, k] = to
                move[n, k] = to - p
            known[n, 2] = wp.where(known[n, 4] > 0.0, 0.0, size)
            phase[n, 0] = GONE
            return
    inside = wp.float64(0.0)
    held = float(0.0)
    lowest = float(0.0)
    for k in range(lane, move.shape[1], wp.block_dim()):
        p = pressure[n, k]
        g = gap[n, k]
        if turn > 0:
            if now == TRIED:
                p = wp.max(p - step * move[n, k], 0.0)
                g -= step * change[n, k]
            else:
                g += change[n, k]
            pressure[n, k] = p
            gap[n, k] = g
        if p > 0.0:
            inside += wp.float64(g * g)
            held += 1.0
        else:
            lowest = wp.min(lowest, g)
    left = wp.tile_sum(wp.tile(inside))[0]
    most = allowed * allowed * wp.tile_sum(wp.tile(held))[0]
    worst = wp.tile_min(wp.tile(lowest))[0]
    if left <= wp.float64(most) and -worst <= 3.0 * allowed:
        phase[n, 0] = DONE
        return
    again = float(0.0)
    if size > 0.0:
        again = wp.float32(left) / size
    ends = float(FAR_MM)
    for k in range(lane, move.shape[1], wp.block_dim()):
        p = pressure[n, k]
        to = float(0.0)
        if p > 0.0:
            to = gap[n, k] + again * way[n, k]
            if p < ends * to:
                ends = p / to
        way[n, k] = to
        move[n, k] = to
    first = wp.tile_min(wp.tile(ends))[0]
    known[n, 2] = wp.float32(left)
    known[n, 3] = first
    known[n, 4] = wp.where(worst < 0.0, 1.0, 0.0)
    phase[n, 0] = TRIED


@wp.func
def against_slip(q: wp.vec2f, slip: wp.vec2f, bound: float, step: float) -> wp.vec2f:
    """What a step against the slip changes of a tangential traction that keeps to its bound."""
    to = q - step * slip
    return wp.min(1.0, bound / wp.max(wp.length(to), 1.0e-30)) * to - q


@wp.func
def at(field: wp.array3d(dtype=float), n: int, k: int) -> wp.vec2f:
    return wp.vec2f(field[n, 0, k], field[n, 1, k])


@wp.kernel(enable_backward=False)
def shear_on(
    turn: int, limits: wp.array2d(dtype=float), bound: wp.array2d(dtype=float), change: wp.array3d(dtype=float),
    move: wp.array3d(dtype=float), shear: wp.array3d(dtype=float), slip: wp.array3d(dtype=float), step: wp.array2d(dtype=float),
):  # fmt: skip
    """As `press_on`, to tangential tractions (sensor, x y, cell) within their bound, against the slip; where the bound is 0 slip counts for
    nothing.

    Args:
        limits: How long what a step of the second would change may be, over all cells [kPa], and that step [kPa/mm], (sensor, 2).
    """
    n, lane = wp.tid()
    if step[n, 0] == 0.0:
        return
    found = wp.vec2f(0.0, step[n, 0])
    if turn > 0:
        steep = wp.float64(0.0)
        against = wp.float64(0.0)
        size = wp.float64(0.0)
        for k in range(lane, move.shape[2], wp.block_dim()):
            if bound[n, k] > 0.0:
                way = at(move, n, k)
                more = at(change, n, k)
                steep += wp.float64(wp.dot(more, way))
                against += wp.float64(wp.dot(at(slip, n, k), way))
                size += wp.float64(wp.dot(more, more))
        found = line_search(steep, against, size)
    off = wp.float64(0.0)
    for k in range(lane, move.shape[2], wp.block_dim()):
        q = at(shear, n, k)
        s = at(slip, n, k)
        if turn > 0:
            q += found[0] * at(move, n, k)
            s += found[0] * at(change, n, k)
            for axis in range(2):
                shear[n, axis, k] = q[axis]
                slip[n, axis, k] = s[axis]
        way = against_slip(q, s, bound[n, k], limits[n, 1])
        off += wp.float64(wp.dot(way, way))
        way = against_slip(q, s, bound[n, k], found[1])
        for axis in range(2):
            move[n, axis, k] = way[axis]
    missed = wp.tile_sum(wp.tile(off))[0] > wp.float64(limits[n, 0] * limits[n, 0])
    step[n, 0] = wp.where(missed, found[1], 0.0)


@wp.func
def slope(field: wp.array4d(dtype=float), n: int, part: int, i: int, j: int, cell: wp.vec2f) -> wp.vec2f:
    """Of a field (sensor, part, row, column) along x and y; at the rim half of it."""
    right = field[n, part, i, wp.min(j + 1, field.shape[3] - 1)] - field[n, part, i, wp.max(j - 1, 0)]
    up = field[n, part, wp.min(i + 1, field.shape[2] - 1), j] - field[n, part, wp.max(i - 1, 0), j]
    return wp.vec2f(0.5 * right / cell[0], 0.5 * up / cell[1])


@wp.kernel(enable_backward=False)
def bent_stress(
    cell: wp.vec2f, modulus: float, blurred: wp.array4d(dtype=float), pressure: wp.array4d(dtype=float), height: wp.array4d(dtype=float),
    found: wp.array4d(dtype=float),
):  # fmt: skip
    """Height times stress along the face, xx, xy, yy (`gelsim.live.layer.Window.bending`), of motions along it."""
    n, i, j = wp.tid()
    x = slope(blurred, n, 0, i, j, cell)
    y = slope(blurred, n, 1, i, j, cell)
    mean = 2.0 * modulus * (x[0] + y[1]) - pressure[n, 0, i, j]
    h = height[n, 0, i, j]
    found[n, 0, i, j] = h * (2.0 * modulus * x[0] + mean)
    found[n, 1, i, j] = h * (modulus * (x[1] + y[0]))
    found[n, 2, i, j] = h * (2.0 * modulus * y[1] + mean)


@wp.kernel(enable_backward=False)
def bent(
    cell: wp.vec2f, share: float, stress: wp.array4d(dtype=float), pressure: wp.array4d(dtype=float), height: wp.array4d(dtype=float),
    moved: wp.array4d(dtype=float), along: wp.array4d(dtype=float), carried: wp.array4d(dtype=float),
):  # fmt: skip
    """A share of the tractions and of the motion of second order that such stresses make."""
    n, i, j = wp.tid()
    here = pressure[n, 0, i, j] * slope(height, n, 0, i, j, cell)
    skew = slope(stress, n, 1, i, j, cell)
    along[n, 0, i, j] = share * (here[0] + slope(stress, n, 0, i, j, cell)[0] + skew[1])
    along[n, 1, i, j] = share * (here[1] + skew[0] + slope(stress, n, 2, i, j, cell)[1])
    back = -share * height[n, 0, i, j] * slope(moved, n, 2, i, j, cell)
    carried[n, 0, i, j] = back[0]
    carried[n, 1, i, j] = back[1]


@wp.func
def keys(t: float) -> wp.vec4f:
    """Shares of four values in a row, as `gelsim.live.layer.keys`."""
    return 0.5 * wp.vec4f(((2.0 - t) * t - 1.0) * t, (3.0 * t - 5.0) * t * t + 2.0, ((4.0 - 3.0 * t) * t + 1.0) * t, (t - 1.0) * t * t)


@wp.kernel(enable_backward=False)
def carried_along(cell: wp.vec2f, values: wp.array4d(dtype=float), drift: wp.array4d(dtype=float), found: wp.array4d(dtype=float)):
    """Motions along the faces of what comes to each place by a drift (`gelsim.live.layer.carried_along`)."""
    n, i, j = wp.tid()
    rows = values.shape[2]
    columns = values.shape[3]
    row = wp.clamp(float(i) - drift[n, 1, i, j] / cell[1], 0.0, float(rows - 1))
    column = wp.clamp(float(j) - drift[n, 0, i, j] / cell[0], 0.0, float(columns - 1))
    up = wp.min(int(row), rows - 2)
    left = wp.min(int(column), columns - 2)
    down = keys(row - float(up))
    right = keys(column - float(left))
    x = float(0.0)
    y = float(0.0)
    for a in range(4):
        for b in range(4):
            share = down[a] * right[b]
            k = wp.clamp(up + a - 1, 0, rows - 1)
            m = wp.clamp(left + b - 1, 0, columns - 1)
            x += share * values[n, 0, k, m]
            y += share * values[n, 1, k, m]
    found[n, 0, i, j] = x + drift[n, 0, i, j]
    found[n, 1, i, j] = y + drift[n, 1, i, j]


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
