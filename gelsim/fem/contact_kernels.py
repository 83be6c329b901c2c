"""Warp kernels of contact: closest points on six-node faces, penalty and friction tractions, their tangents (equations: contact.py).

One launch serves any number of scenes with the same faces: points and nodes of one scene after those of the other (`Layout`), faces and
their numbers the scene's own.
"""

from __future__ import annotations

import warp as wp

from gelsim.fem.field import FieldGrid, read_field
from gelsim.fem.pattern import PairPattern, add_block, pair_offset

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

# Cosine between outward normals above which surfaces do not face each other.
FACING = wp.constant(wp.float64(-0.1))

# Least slope that counts as one: where flanks face each other a distance's is 0 halfway between them.
FLATTEST = wp.constant(wp.float64(0.2))

vec6d = wp.types.vector(length=6, dtype=wp.float64)


@wp.struct
class Layout:
    """How points and nodes are numbered: `points` a face, `faces` that have points and `nodes` of both bodies a scene.

    `rigid`: the master is no surface of faces but a body that moves as a whole, "face" 0 of which are the corners of a tetrahedron
    (the last of them three times) in which places are counted.
    """

    points: wp.int32
    faces: wp.int32
    nodes: wp.int32
    rigid: wp.bool


# Scenes are queried in one tree of triangles, this far from each other [mm].
SPACING = wp.constant(200.0)

# Of a face's side: how far beside its face a point may lie before it changes to the neighbour.
OVERHANG = wp.constant(wp.float64(0.1))

# Within which a point keeps its face [mm]; where points keep it for ever, soft penalties of high pressures leave gaps of tenths.
NEAR = wp.constant(wp.float64(0.1))
FROZEN_NEAR = wp.constant(wp.float64(1.0))


@wp.func
def apart(scene: wp.int32) -> wp.vec3f:
    """Where a scene stands in that tree: on a lattice, as single precision holds micrometres within a few metres only."""
    return SPACING * wp.vec3f(float(scene % 8), float((scene // 8) % 8), float(scene // 64))


@wp.kernel(enable_backward=False)
def place_points(x: wp.array(dtype=wp.vec3d), used: wp.array(dtype=wp.int32), nodes: wp.int32, points: wp.array(dtype=wp.vec3f)):
    """The corners of the triangles that are searched, `used` of each scene's `nodes`."""
    i = wp.tid()
    scene = i // used.shape[0]
    points[i] = wp.vec3f(x[scene * nodes + used[i % used.shape[0]]]) + apart(scene)


@wp.func
def scene_of(layout: Layout, i: wp.int32) -> wp.int32:
    return i // (layout.points * layout.faces)


@wp.func
def slave_face(layout: Layout, i: wp.int32) -> wp.int32:
    """The face that point i lies on, in its scene's numbering."""
    return (i // layout.points) % layout.faces


@wp.func
def tri6(xi: wp.vec2d) -> vec6d:
    b = xi[0]
    c = xi[1]
    a = wp.float64(1.0) - b - c
    two = wp.float64(2.0)
    four = wp.float64(4.0)
    one = wp.float64(1.0)
    return vec6d(a * (two * a - one), b * (two * b - one), c * (two * c - one), four * a * b, four * b * c, four * c * a)


@wp.func
def tri6_d1(xi: wp.vec2d) -> vec6d:
    b = xi[0]
    c = xi[1]
    a = wp.float64(1.0) - b - c
    one = wp.float64(1.0)
    four = wp.float64(4.0)
    return vec6d(one - four * a, four * b - one, wp.float64(0.0), four * (a - b), four * c, -four * c)


@wp.func
def tri6_d2(xi: wp.vec2d) -> vec6d:
    b = xi[0]
    c = xi[1]
    a = wp.float64(1.0) - b - c
    one = wp.float64(1.0)
    four = wp.float64(4.0)
    return vec6d(one - four * a, wp.float64(0.0), four * c - one, -four * b, four * b, four * (a - c))


@wp.func
def flat(place: wp.vec3d) -> wp.vec2d:
    """Of a place on a face its ξ."""
    return wp.vec2d(place[0], place[1])


@wp.func
def shares(layout: Layout, place: wp.vec3d) -> vec6d:
    """How much each of the master's six nodes moves the place."""
    if layout.rigid:
        zero = wp.float64(0.0)
        return vec6d(wp.float64(1.0) - place[0] - place[1] - place[2], place[0], place[1], place[2], zero, zero)
    return tri6(flat(place))


@wp.func
def on_face(x: wp.array(dtype=wp.vec3d), base: wp.int32, faces: wp.array2d(dtype=wp.int32), f: wp.int32, n: vec6d) -> wp.vec3d:
    """The point of a face whose scene's nodes begin at `base`."""
    y = wp.vec3d()
    for a in range(6):
        y += n[a] * x[base + faces[f, a]]
    return y


@wp.func
def clamp_to_face(xi: wp.vec2d) -> wp.vec2d:
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    b = wp.max(xi[0], zero)
    c = wp.max(xi[1], zero)
    if b + c > one:
        shift = wp.float64(0.5) * (b + c - one)
        b = wp.clamp(b - shift, zero, one)
        c = one - b
        if c > one:
            c = one
    return wp.vec2d(b, c)


@wp.func
def within_face(xi: wp.vec2d) -> wp.float64:
    """How far inside its face's border a place lies (in ξ); exactly 0 where `clamp_to_face` put it on the border."""
    return wp.min(wp.min(xi[0], xi[1]), wp.float64(1.0) - xi[0] - xi[1])


@wp.func
def on_sides(xi: wp.vec2d, sides: wp.int32) -> wp.bool:
    """Whether a place that `clamp_to_face` put on the border lies on one of some sides: bits 1, 2, 4 for those from corner 0, 1, 2 on."""
    zero = wp.float64(0.0)
    first = (sides & 1) != 0 and xi[1] == zero
    second = (sides & 2) != 0 and wp.float64(1.0) - xi[0] - xi[1] == zero
    third = (sides & 4) != 0 and xi[0] == zero
    return first or second or third


@wp.func
def penalty_pressure(s: wp.float64, k: wp.float64, eps: wp.float64) -> wp.float64:
    if s <= wp.float64(0.0):
        return wp.float64(0.0)
    if s < eps:
        return k * s * s / (wp.float64(2.0) * eps)
    return k * (s - wp.float64(0.5) * eps)


@wp.func
def penalty_slope(s: wp.float64, k: wp.float64, eps: wp.float64) -> wp.float64:
    if s <= wp.float64(0.0):
        return wp.float64(0.0)
    if s < eps:
        return k * s / eps
    return k


@wp.func
def step_to_foot(position: wp.vec3d, x: wp.array(dtype=wp.vec3d), base: wp.int32, faces: wp.array2d(dtype=wp.int32), f: wp.int32,
                 xi: wp.vec2d) -> wp.vec2d:  # fmt: skip
    """One Gauss-Newton step of |x - y(ξ)|²."""
    y1 = on_face(x, base, faces, f, tri6_d1(xi))
    y2 = on_face(x, base, faces, f, tri6_d2(xi))
    r = position - on_face(x, base, faces, f, tri6(xi))
    a11 = wp.dot(y1, y1)
    a12 = wp.dot(y1, y2)
    a22 = wp.dot(y2, y2)
    g1 = wp.dot(r, y1)
    g2 = wp.dot(r, y2)
    det = a11 * a22 - a12 * a12
    return xi + wp.vec2d((a22 * g1 - a12 * g2) / det, (a11 * g2 - a12 * g1) / det)


@wp.kernel(enable_backward=False)
def closest_points(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    mesh: wp.uint64, master: wp.array2d(dtype=wp.int32), corners: wp.array2d(dtype=wp.vec2d), ends: wp.array(dtype=wp.int32),
    reach: wp.float32, points: wp.array(dtype=wp.vec2d),
    overhang: wp.array(dtype=wp.float64), face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Closest points; a point near contact keeps its face while it lies within it or no more than `overhang` (in ξ) beside it.

    Neighbouring faces meet at a slight kink: without that hysteresis a point at their common edge would change sides, and Newton cycle.
    A point whose place is on the border lies beside its face, most often beside a rim, and is not frozen to it: a curved face goes on
    beyond its rim as a parabola that may cut into the gel tenths of a millimetre deep. Beside a side in `ends` there is no surface
    any more.
    """
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    position = on_face(x, base, slave, slave_face(layout, i), shape[i % layout.points])
    f = face[i]
    xi = flat(place[i])
    kept = bool(False)
    near = NEAR
    allowed = OVERHANG
    if overhang[scene_of(layout, i)] > OVERHANG and within_face(xi) != wp.float64(0.0):
        near = FROZEN_NEAR
        allowed = overhang[scene_of(layout, i)]
    if f >= 0 and wp.abs(gap[i]) < near:
        for _ in range(6):
            xi = step_to_foot(position, x, base, master, f, xi)
        if within_face(xi) > -allowed:
            kept = wp.length(position - on_face(x, base, master, f, tri6(xi))) < near
    clamped = bool(False)
    if not kept:
        query = wp.mesh_query_point_no_sign(mesh, wp.vec3f(position) + apart(scene_of(layout, i)), reach)
        face[i] = -1
        gap[i] = wp.float64(1.0e9)
        if not query.result:
            return
        f = (query.face // 4) % master.shape[0]
        sub = query.face % 4
        u = wp.float64(query.u)
        v = wp.float64(query.v)
        xi = u * corners[sub, 0] + v * corners[sub, 1] + (wp.float64(1.0) - u - v) * corners[sub, 2]
        for _ in range(6):
            free = step_to_foot(position, x, base, master, f, xi)
            xi = clamp_to_face(free)
            clamped = wp.length_sq(free - xi) > wp.float64(1.0e-12)
        if clamped and on_sides(xi, ends[f]):
            return
    n = wp.normalize(wp.cross(on_face(x, base, master, f, tri6_d1(xi)), on_face(x, base, master, f, tri6_d2(xi))))
    r = position - on_face(x, base, master, f, tri6(xi))
    d = wp.length(r)
    g = wp.dot(r, n)
    # beside a sharp edge the closest point is the edge itself: a point that lies sideways of the face is outside, not under it; and at an
    # acute corner it is a flank's, behind which the point lies though the surfaces do not face each other
    if g < wp.float64(0.0):
        own = slave_face(layout, i)
        at = points[i % layout.points]
        facing = wp.dot(n, wp.normalize(wp.cross(on_face(x, base, slave, own, tri6_d1(at)), on_face(x, base, slave, own, tri6_d2(at)))))
        if facing > FACING or (clamped and -g < wp.float64(0.7) * d):
            g = d
    face[i] = f
    place[i] = wp.vec3d(xi[0], xi[1], wp.float64(0.0))
    normal[i] = n
    gap[i] = g


@wp.kernel(enable_backward=False)
def field_gaps(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    master: wp.array2d(dtype=wp.int32), field: FieldGrid, side: wp.float64,
    face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d), normal: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64),
    bend: wp.array(dtype=wp.mat33d),
):  # fmt: skip
    """Gaps to a rigid body, where they are found on it, and ∇n (equations: field.py); beyond its grid a point touches nothing.

    The body's frame is that of a tetrahedron whose first corner is its origin and whose other three lie `side` [mm] along its axes.
    """
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    face[i] = -1
    gap[i] = wp.float64(1.0e9)
    origin = x[base + master[0, 0]]
    turn = wp.matrix_from_cols(x[base + master[0, 1]] - origin, x[base + master[0, 2]] - origin, x[base + master[0, 3]] - origin) / side
    point = wp.transpose(turn) * (on_face(x, base, slave, slave_face(layout, i), shape[i % layout.points]) - origin)
    found = read_field(field, point)
    if not found.inside:
        return
    steep = wp.max(wp.length(found.slope), FLATTEST)
    g = found.value / steep
    n = found.slope / steep
    across = wp.identity(n=3, dtype=wp.float64) - wp.outer(n, n)
    face[i] = 0
    gap[i] = g
    place[i] = (point - g * n) / side
    normal[i] = turn * n
    bend[i] = turn * (across * found.bend * across / steep) * wp.transpose(turn)


@wp.kernel(enable_backward=False)
def contact_force(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, weight: wp.array(dtype=wp.float64),
    master: wp.array2d(dtype=wp.int32), face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d), normal: wp.array(dtype=wp.vec3d),
    gap: wp.array(dtype=wp.float64), multiplier: wp.array(dtype=wp.float64), stiffness: wp.array(dtype=wp.float64), eps: wp.float64,
    pressure: wp.array(dtype=wp.float64), force: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    p = wp.float64(0.0)
    if face[i] >= 0:
        k = stiffness[i // layout.points]
        p = penalty_pressure(multiplier[i] / k - gap[i], k, eps)
    pressure[i] = p
    if p > wp.float64(0.0):
        t = (weight[i] * p) * normal[i]
        m = shape[i % layout.points]
        n = shares(layout, place[i])
        for a in range(6):
            wp.atomic_add(force, base + slave[slave_face(layout, i), a], -m[a] * t)
            wp.atomic_add(force, base + master[face[i], a], n[a] * t)


@wp.func
def slip_trial(x: wp.array(dtype=wp.vec3d), base: wp.int32, position: wp.vec3d, master: wp.array2d(dtype=wp.int32), f: wp.int32,
               s: vec6d, n: wp.vec3d, shift: wp.vec3d, kt: wp.float64) -> wp.vec3d:  # fmt: skip
    """Trial traction λ_t + k_t e in the tangent plane of n: what the gel drags the object with."""
    t = shift + kt * (position - on_face(x, base, master, f, s))
    return t - wp.dot(t, n) * n


@wp.kernel(enable_backward=False)
def friction_force(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    weight: wp.array(dtype=wp.float64), master: wp.array2d(dtype=wp.int32), normal: wp.array(dtype=wp.vec3d),
    pressure: wp.array(dtype=wp.float64), anchor_face: wp.array(dtype=wp.int32), anchor_place: wp.array(dtype=wp.vec3d),
    shift: wp.array(dtype=wp.vec3d), friction: wp.array(dtype=wp.float64), stick: wp.array(dtype=wp.float64),
    traction: wp.array(dtype=wp.vec3d), force: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """`traction` becomes that on the gel."""
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    traction[i] = wp.vec3d()
    if pressure[i] <= wp.float64(0.0) or anchor_face[i] < 0:
        return
    m = shape[i % layout.points]
    s = shares(layout, anchor_place[i])
    position = on_face(x, base, slave, slave_face(layout, i), m)
    t = slip_trial(x, base, position, master, anchor_face[i], s, normal[i], shift[i], stick[i // layout.points])
    size = wp.length(t)
    mu = friction[scene_of(layout, i)]
    if mu >= wp.float64(0.0) and size > mu * pressure[i]:
        t = (mu * pressure[i] / size) * t
    traction[i] = -t
    for a in range(6):
        wp.atomic_add(force, base + slave[slave_face(layout, i), a], (weight[i] * m[a]) * t)
        wp.atomic_add(force, base + master[anchor_face[i], a], (-weight[i] * s[a]) * t)


@wp.func
def add_stencil_block(pattern: PairPattern, values: wp.array(dtype=wp.float64), a: wp.int32, b: wp.int32, block: wp.mat33d,
                      missing: wp.array(dtype=wp.int32)):  # fmt: skip
    if pattern.count[a] == 0 or pattern.count[b] == 0:
        return
    offset = pair_offset(pattern, a, b)
    if offset < 0:
        missing[0] = 1
        return
    add_block(pattern, values, a, b, offset, block)


@wp.kernel(enable_backward=False)
def contact_tangent(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    weight: wp.array(dtype=wp.float64), master: wp.array2d(dtype=wp.int32), face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64), multiplier: wp.array(dtype=wp.float64),
    stiffness: wp.array(dtype=wp.float64), eps: wp.float64, bend: wp.array(dtype=wp.mat33d), geometric: wp.array(dtype=wp.float64),
    pattern: PairPattern, values: wp.array(dtype=wp.float64), missing: wp.array(dtype=wp.int32),
):  # fmt: skip
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    f = face[i]
    k = stiffness[i // layout.points]
    s0 = multiplier[i] / k - gap[i]
    if f < 0 or s0 <= wp.float64(0.0):
        return
    w = weight[i]
    p = w * penalty_pressure(s0, k, eps)
    slope = w * penalty_slope(s0, k, eps)
    n = normal[i]
    m = shape[i % layout.points]
    s = shares(layout, place[i])
    s1 = vec6d()
    s2 = vec6d()
    core = slope * wp.outer(n, n)
    p = geometric[scene_of(layout, i)] * p
    side1 = wp.mat33d()
    side2 = wp.mat33d()
    if layout.rigid:
        core -= p * bend[i]
    else:
        xi = flat(place[i])
        s1 = tri6_d1(xi)
        s2 = tri6_d2(xi)
        y1 = on_face(x, base, master, f, s1)
        y2 = on_face(x, base, master, f, s2)
        a11 = wp.dot(y1, y1)
        a12 = wp.dot(y1, y2)
        a22 = wp.dot(y2, y2)
        det = a11 * a22 - a12 * a12
        c1 = (a22 * y1 - a12 * y2) / det
        c2 = (a11 * y2 - a12 * y1) / det
        # second derivatives of the six shape functions are constant
        four = wp.float64(4.0)
        eight = wp.float64(8.0)
        x0 = x[base + master[f, 0]]
        x3 = x[base + master[f, 3]]
        x5 = x[base + master[f, 5]]
        b11 = wp.dot(n, four * (x0 + x[base + master[f, 1]]) - eight * x3)
        b22 = wp.dot(n, four * (x0 + x[base + master[f, 2]]) - eight * x5)
        b12 = wp.dot(n, four * (x0 - x3 + x[base + master[f, 4]] - x5))
        core += p * (b11 * wp.outer(c1, c1) + b22 * wp.outer(c2, c2) + b12 * (wp.outer(c1, c2) + wp.outer(c2, c1)))
        side1 = p * wp.outer(c1, n)
        side2 = p * wp.outer(c2, n)
    for a in range(12):
        na = int(0)
        ca = wp.float64(0.0)
        da1 = wp.float64(0.0)
        da2 = wp.float64(0.0)
        if a < 6:
            na = base + slave[slave_face(layout, i), a]
            ca = m[a]
        else:
            na = base + master[f, a - 6]
            ca = -s[a - 6]
            da1 = s1[a - 6]
            da2 = s2[a - 6]
        for b in range(a, 12):
            nb = int(0)
            cb = wp.float64(0.0)
            db1 = wp.float64(0.0)
            db2 = wp.float64(0.0)
            if b < 6:
                nb = base + slave[slave_face(layout, i), b]
                cb = m[b]
            else:
                nb = base + master[f, b - 6]
                cb = -s[b - 6]
                db1 = s1[b - 6]
                db2 = s2[b - 6]
            block = (ca * cb) * core + (ca * db1) * side1 + (ca * db2) * side2
            block += wp.transpose((cb * da1) * side1 + (cb * da2) * side2)
            add_stencil_block(pattern, values, na, nb, block, missing)


@wp.kernel(enable_backward=False)
def friction_tangent(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    weight: wp.array(dtype=wp.float64), master: wp.array2d(dtype=wp.int32), normal: wp.array(dtype=wp.vec3d),
    pressure: wp.array(dtype=wp.float64), anchor_face: wp.array(dtype=wp.int32), anchor_place: wp.array(dtype=wp.vec3d),
    shift: wp.array(dtype=wp.vec3d), friction: wp.array(dtype=wp.float64), stick: wp.array(dtype=wp.float64),
    geometric: wp.array(dtype=wp.float64),
    pattern: PairPattern, values: wp.array(dtype=wp.float64), missing: wp.array(dtype=wp.int32),
):  # fmt: skip
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    if pressure[i] <= wp.float64(0.0) or anchor_face[i] < 0:
        return
    m = shape[i % layout.points]
    s = shares(layout, anchor_place[i])
    n = normal[i]
    kt = stick[i // layout.points]
    t = slip_trial(x, base, on_face(x, base, slave, slave_face(layout, i), m), master, anchor_face[i], s, n, shift[i], kt)
    tangential = wp.identity(n=3, dtype=wp.float64) - wp.outer(n, n)
    stiffness = kt * tangential
    size = wp.length(t)
    mu = friction[scene_of(layout, i)]
    if mu >= wp.float64(0.0) and size > mu * pressure[i]:
        direction = t / size
        stiffness = (kt * mu * pressure[i] / size) * (tangential - geometric[scene_of(layout, i)] * wp.outer(direction, direction))
    stiffness = weight[i] * stiffness
    for a in range(12):
        na = int(0)
        ca = wp.float64(0.0)
        if a < 6:
            na = base + slave[slave_face(layout, i), a]
            ca = m[a]
        else:
            na = base + master[anchor_face[i], a - 6]
            ca = -s[a - 6]
        for b in range(a, 12):
            nb = int(0)
            cb = wp.float64(0.0)
            if b < 6:
                nb = base + slave[slave_face(layout, i), b]
                cb = m[b]
            else:
                nb = base + master[anchor_face[i], b - 6]
                cb = -s[b - 6]
            add_stencil_block(pattern, values, na, nb, (ca * cb) * stiffness, missing)


@wp.func
def free_vector(v: wp.array(dtype=wp.float64), equation: wp.array2d(dtype=wp.int32), node: wp.int32) -> wp.vec3d:
    """A node's part of a vector of unknowns, 0 where it is held."""
    found = wp.vec3d()
    for c in range(3):
        if equation[node, c] >= 0:
            found[c] = v[equation[node, c]]
    return found


@wp.func
def add_free(v: wp.array(dtype=wp.float64), equation: wp.array2d(dtype=wp.int32), node: wp.int32, part: wp.vec3d):
    for c in range(3):
        if equation[node, c] >= 0:
            wp.atomic_add(v, equation[node, c], part[c])


@wp.kernel(enable_backward=False)
def slip_product(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, weight: wp.array(dtype=wp.float64),
    master: wp.array2d(dtype=wp.int32), face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d), normal: wp.array(dtype=wp.vec3d),
    gap: wp.array(dtype=wp.float64), multiplier: wp.array(dtype=wp.float64), stiffness: wp.array(dtype=wp.float64), eps: wp.float64,
    pressure: wp.array(dtype=wp.float64), traction: wp.array(dtype=wp.vec3d), anchor_face: wp.array(dtype=wp.int32),
    anchor_place: wp.array(dtype=wp.vec3d), friction: wp.array(dtype=wp.float64), geometric: wp.array(dtype=wp.float64),
    equation: wp.array2d(dtype=wp.int32), v: wp.array(dtype=wp.float64), out: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Adds to `out` the product with v of what `SurfaceContact.slip_coupling` gives as factors, in scenes whose `geometric` is set."""
    i = wp.tid()
    scene = scene_of(layout, i)
    base = scene * layout.nodes
    mu = friction[scene]
    size = wp.length(traction[i])
    if geometric[scene] == wp.float64(0.0) or mu <= wp.float64(0.0) or pressure[i] <= wp.float64(0.0):
        return
    if size <= wp.float64(0.0) or size < mu * pressure[i] * (wp.float64(1.0) - wp.float64(1.0e-9)):
        return
    k = stiffness[i // layout.points]
    s = multiplier[i] / k - gap[i]
    m = shape[i % layout.points]
    own = slave_face(layout, i)
    near = shares(layout, place[i])
    closing = wp.vec3d()
    for a in range(6):
        closing += m[a] * free_vector(v, equation, base + slave[own, a])
        closing -= near[a] * free_vector(v, equation, base + master[face[i], a])
    pull = (mu * weight[i] * penalty_slope(s, k, eps) * wp.dot(normal[i], closing) / size) * traction[i]
    held = shares(layout, anchor_place[i])
    for a in range(6):
        add_free(out, equation, base + slave[own, a], m[a] * pull)
        add_free(out, equation, base + master[anchor_face[i], a], -held[a] * pull)
