"""Warp kernels of contact: where lines meet six-node faces, penalty and friction tractions, their tangents (equations: contact.py).

One launch serves any number of scenes with the same faces: points and nodes of one scene after those of the other (`Layout`), faces and
their numbers the scene's own.
"""

from __future__ import annotations

import warp as wp

from gelsim.fem import friction as friction_law
from gelsim.fem.field import FieldGrid, read_field
from gelsim.fem.pattern import PairPattern, add_block, pair_offset

wp.set_module_options({"max_unroll": 1, "enable_backward": False})

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
def within_face(xi: wp.vec2d) -> wp.float64:
    """How far inside its face's border a place lies (in ξ)."""
    return wp.min(wp.min(xi[0], xi[1]), wp.float64(1.0) - xi[0] - xi[1])


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


slip_bound = wp.func(friction_law.slip_bound)
slip_bound_slope = wp.func(friction_law.slip_bound_slope)


@wp.func
def borne(mu: wp.float64, p: wp.float64) -> wp.float64:
    """Traction that friction bears at a pressure; μ < 0, "stick": any."""
    if mu < wp.float64(0.0):
        return wp.float64(1.0e300)
    return slip_bound(mu, p)


# Behind a point, along its line, from where the other surface is sought [mm]: the overlaps of Newton's guesses are smaller.
BEHIND = wp.constant(wp.float64(0.3))

# Within which a point begins at the face that it met before [mm].
NEAR = wp.constant(wp.float64(0.1))

# Cosine between a line and a surface's normal below which they do not meet: beyond, the surface's outline begins.
GRAZING = wp.constant(wp.float64(0.02))

# Beyond a mirror plane, in ξ, where a face still counts: a point beside the plane may look across it.
ACROSS = wp.constant(wp.float64(0.1))


@wp.struct
class Met:
    """Where a line meets a surface: `face` -1 if it does not; ξ there; how far along the line [mm]."""

    face: wp.int32
    xi: wp.vec2d
    gap: wp.float64


@wp.func
def step_along(position: wp.vec3d, line: wp.vec3d, x: wp.array(dtype=wp.vec3d), base: wp.int32, faces: wp.array2d(dtype=wp.int32),
               f: wp.int32, xi: wp.vec2d) -> wp.vec2d:  # fmt: skip
    """One Newton step to where the line meets a face; far outside of it where the two are parallel."""
    y1 = on_face(x, base, faces, f, tri6_d1(xi))
    y2 = on_face(x, base, faces, f, tri6_d2(xi))
    r = position - on_face(x, base, faces, f, tri6(xi))
    det = wp.dot(line, wp.cross(y1, y2))
    if wp.abs(det) < wp.float64(1.0e-4) * wp.length(y1) * wp.length(y2):
        return wp.vec2d(wp.float64(9.0), wp.float64(9.0))
    step = wp.vec2d(wp.dot(line, wp.cross(r, y2)) / det, wp.dot(line, wp.cross(y1, r)) / det)  # Cramer's rule
    longest = wp.max(wp.abs(step[0]), wp.abs(step[1]))
    return xi + wp.min(wp.float64(1.0), wp.float64(0.7) / wp.max(longest, wp.float64(0.1))) * step


@wp.func
def meet(position: wp.vec3d, line: wp.vec3d, x: wp.array(dtype=wp.vec3d), base: wp.int32, faces: wp.array2d(dtype=wp.int32),
         beside: wp.array2d(dtype=wp.int32), start: wp.int32, at: wp.vec2d) -> Met:  # fmt: skip
    """Where a line meets the surface, sought from a place on it and on over the faces beside it."""
    found = Met()
    found.face = -1
    f = start
    xi = at
    for _face in range(8):
        for _step in range(8):
            before = xi
            xi = step_along(position, line, x, base, faces, f, xi)
            if wp.length_sq(xi - before) < wp.float64(1.0e-20):
                break
        if not (wp.abs(xi[0]) < wp.float64(4.0) and wp.abs(xi[1]) < wp.float64(4.0)):
            return found
        inside = within_face(xi)
        other = int(-2)
        if inside < wp.float64(-1.0e-9):
            side = int(0)
            if xi[1] > wp.float64(1.0) - xi[0] - xi[1]:
                side = 1
            if xi[0] < wp.min(xi[1], wp.float64(1.0) - xi[0] - xi[1]):
                side = 2
            other = beside[f, side]
            if other == -1 or (other == -2 and inside < -ACROSS):
                return found
        if other < 0:
            outward = wp.normalize(wp.cross(on_face(x, base, faces, f, tri6_d1(xi)), on_face(x, base, faces, f, tri6_d2(xi))))
            if wp.dot(line, outward) < -GRAZING:
                found.face = f
                found.xi = xi
                found.gap = wp.dot(line, on_face(x, base, faces, f, tri6(xi)) - position)
            return found
        f = other
        xi = wp.vec2d(wp.float64(1.0) / wp.float64(3.0), wp.float64(1.0) / wp.float64(3.0))
    return found


@wp.kernel(enable_backward=False)
def surface_gaps(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    points: wp.array(dtype=wp.vec2d), mesh: wp.uint64, master: wp.array2d(dtype=wp.int32), corners: wp.array2d(dtype=wp.vec2d),
    beside: wp.array2d(dtype=wp.int32), reach: wp.float32, face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Gaps to the other surface along the own one's normals, within `reach`; `normal` points at the own surface."""
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    own = slave_face(layout, i)
    at = points[i % layout.points]
    position = on_face(x, base, slave, own, shape[i % layout.points])
    line = wp.normalize(wp.cross(on_face(x, base, slave, own, tri6_d1(at)), on_face(x, base, slave, own, tri6_d2(at))))
    met = Met()
    met.face = -1
    if face[i] >= 0 and wp.abs(gap[i]) < NEAR:
        met = meet(position, line, x, base, master, beside, face[i], flat(place[i]))
        if wp.abs(met.gap) > NEAR:
            met.face = -1
    if met.face < 0:
        start = wp.vec3f(position - BEHIND * line) + apart(scene_of(layout, i))
        ahead = wp.vec3f(line)
        left = float(BEHIND) + reach
        for _hit in range(4):
            hit = wp.mesh_query_ray(mesh, start, ahead, left)
            if not hit.result:
                break
            if hit.sign > 0.0:
                part = hit.face % 4
                u = wp.float64(hit.u)
                v = wp.float64(hit.v)
                xi = u * corners[part, 0] + v * corners[part, 1] + (wp.float64(1.0) - u - v) * corners[part, 2]
                met = meet(position, line, x, base, master, beside, (hit.face // 4) % master.shape[0], xi)
                if met.face >= 0:
                    break
            start += (hit.t + 1.0e-4) * ahead
            left -= hit.t + 1.0e-4
    face[i] = met.face
    normal[i] = -line
    gap[i] = wp.float64(1.0e9)
    if met.face >= 0:
        place[i] = wp.vec3d(met.xi[0], met.xi[1], wp.float64(0.0))
        gap[i] = met.gap


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
    tied: wp.array(dtype=wp.int32), traction: wp.array(dtype=wp.vec3d), force: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """`traction` becomes that on the gel."""
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    traction[i] = wp.vec3d()
    if (pressure[i] <= wp.float64(0.0) and tied[i] == 0) or anchor_face[i] < 0:
        return
    m = shape[i % layout.points]
    s = shares(layout, anchor_place[i])
    position = on_face(x, base, slave, slave_face(layout, i), m)
    t = slip_trial(x, base, position, master, anchor_face[i], s, normal[i], shift[i], stick[i // layout.points])
    size = wp.length(t)
    bound = borne(friction[scene_of(layout, i)], pressure[i])
    if size > bound:
        t = (bound / size) * t
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
    core = slope * wp.outer(n, n)
    if layout.rigid:
        core -= geometric[scene_of(layout, i)] * p * bend[i]
    for a in range(12):
        na = int(0)
        ca = wp.float64(0.0)
        if a < 6:
            na = base + slave[slave_face(layout, i), a]
            ca = m[a]
        else:
            na = base + master[f, a - 6]
            ca = -s[a - 6]
        for b in range(a, 12):
            nb = int(0)
            cb = wp.float64(0.0)
            if b < 6:
                nb = base + slave[slave_face(layout, i), b]
                cb = m[b]
            else:
                nb = base + master[f, b - 6]
                cb = -s[b - 6]
            add_stencil_block(pattern, values, na, nb, (ca * cb) * core, missing)


@wp.kernel(enable_backward=False)
def friction_tangent(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    weight: wp.array(dtype=wp.float64), master: wp.array2d(dtype=wp.int32), normal: wp.array(dtype=wp.vec3d),
    pressure: wp.array(dtype=wp.float64), anchor_face: wp.array(dtype=wp.int32), anchor_place: wp.array(dtype=wp.vec3d),
    shift: wp.array(dtype=wp.vec3d), friction: wp.array(dtype=wp.float64), stick: wp.array(dtype=wp.float64),
    tied: wp.array(dtype=wp.int32), geometric: wp.array(dtype=wp.float64),
    pattern: PairPattern, values: wp.array(dtype=wp.float64), missing: wp.array(dtype=wp.int32),
):  # fmt: skip
    i = wp.tid()
    base = scene_of(layout, i) * layout.nodes
    if (pressure[i] <= wp.float64(0.0) and tied[i] == 0) or anchor_face[i] < 0:
        return
    m = shape[i % layout.points]
    s = shares(layout, anchor_place[i])
    n = normal[i]
    kt = stick[i // layout.points]
    t = slip_trial(x, base, on_face(x, base, slave, slave_face(layout, i), m), master, anchor_face[i], s, n, shift[i], kt)
    tangential = wp.identity(n=3, dtype=wp.float64) - wp.outer(n, n)
    stiffness = kt * tangential
    size = wp.length(t)
    bound = borne(friction[scene_of(layout, i)], pressure[i])
    if size > bound:
        direction = t / size
        stiffness = (kt * bound / size) * (tangential - geometric[scene_of(layout, i)] * wp.outer(direction, direction))
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


@wp.func
def in_plane(a: wp.vec3d, b: wp.vec3d, along_a: wp.float64, along_b: wp.float64) -> wp.vec2d:
    """Coefficients in a and b of the vector of their plane whose products with them are given."""
    aa = wp.dot(a, a)
    ab = wp.dot(a, b)
    bb = wp.dot(b, b)
    det = aa * bb - ab * ab
    return wp.vec2d((bb * along_a - ab * along_b) / det, (aa * along_b - ab * along_a) / det)


@wp.struct
class Change:
    """What changes at a point along a displacement: the point against the place that it meets, the normal, the gap, and ξ of the place."""

    apart: wp.vec3d
    normal: wp.vec3d
    gap: wp.float64
    xi: wp.vec2d


@wp.func
def change_along(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    points: wp.array(dtype=wp.vec2d), master: wp.array2d(dtype=wp.int32), face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64), bend: wp.array(dtype=wp.mat33d),
    equation: wp.array2d(dtype=wp.int32), v: wp.array(dtype=wp.float64), i: wp.int32,
) -> Change:  # fmt: skip
    """Along v, of point i, which meets a face. The line through it turns with its own face, and meets the other surface where that is."""
    base = scene_of(layout, i) * layout.nodes
    f = face[i]
    n = normal[i]
    own = slave_face(layout, i)
    m = shape[i % layout.points]
    s = shares(layout, place[i])
    found = Change()
    for a in range(6):
        found.apart += m[a] * free_vector(v, equation, base + slave[own, a]) - s[a] * free_vector(v, equation, base + master[f, a])
    if layout.rigid:
        found.normal = bend[i] * found.apart
        found.gap = wp.dot(n, found.apart)
        return found
    at = points[i % layout.points]
    m1 = tri6_d1(at)
    m2 = tri6_d2(at)
    dx1 = wp.vec3d()
    dx2 = wp.vec3d()
    for a in range(6):
        dx1 += m1[a] * free_vector(v, equation, base + slave[own, a])
        dx2 += m2[a] * free_vector(v, equation, base + slave[own, a])
    x1 = on_face(x, base, slave, own, m1)
    x2 = on_face(x, base, slave, own, m2)
    turn = in_plane(x1, x2, wp.dot(n, dx1), wp.dot(n, dx2))
    found.normal = -turn[0] * x1 - turn[1] * x2
    y1 = on_face(x, base, master, f, tri6_d1(flat(place[i])))
    y2 = on_face(x, base, master, f, tri6_d2(flat(place[i])))
    outward = wp.cross(y1, y2)
    away = found.apart - gap[i] * found.normal
    found.gap = wp.dot(outward, away) / wp.dot(outward, n)
    away -= found.gap * n
    found.xi = in_plane(y1, y2, wp.dot(away, y1), wp.dot(away, y2))
    return found


@wp.kernel(enable_backward=False)
def gap_changes(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    points: wp.array(dtype=wp.vec2d), master: wp.array2d(dtype=wp.int32), face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64), bend: wp.array(dtype=wp.mat33d),
    equation: wp.array2d(dtype=wp.int32), v: wp.array(dtype=wp.float64), out: wp.array(dtype=wp.float64),
):  # fmt: skip
    """The derivative of the gaps along v; 0 where a point meets nothing."""
    i = wp.tid()
    out[i] = wp.float64(0.0)
    if face[i] >= 0:
        change = change_along(slave, shape, layout, x, points, master, face, place, normal, gap, bend, equation, v, i)
        out[i] = change.gap


@wp.kernel(enable_backward=False)
def add_remainder(
    slave: wp.array2d(dtype=wp.int32), shape: wp.array(dtype=vec6d), layout: Layout, x: wp.array(dtype=wp.vec3d),
    points: wp.array(dtype=wp.vec2d), weight: wp.array(dtype=wp.float64), master: wp.array2d(dtype=wp.int32),
    face: wp.array(dtype=wp.int32), place: wp.array(dtype=wp.vec3d), normal: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64),
    multiplier: wp.array(dtype=wp.float64), stiffness: wp.array(dtype=wp.float64), eps: wp.float64, bend: wp.array(dtype=wp.mat33d),
    frictional: wp.bool, anchor_face: wp.array(dtype=wp.int32), anchor_place: wp.array(dtype=wp.vec3d), shift: wp.array(dtype=wp.vec3d),
    friction: wp.array(dtype=wp.float64), stick: wp.array(dtype=wp.float64), tied: wp.array(dtype=wp.int32),
    geometric: wp.array(dtype=wp.float64),
    equation: wp.array2d(dtype=wp.int32), v: wp.array(dtype=wp.float64), out: wp.array(dtype=wp.float64),
):  # fmt: skip
    """Adds to `out` the derivative of the contact's forces along v less what the two tangents assemble, where `geometric` is set."""
    i = wp.tid()
    scene = scene_of(layout, i)
    base = scene * layout.nodes
    f = face[i]
    k = stiffness[i // layout.points]
    s0 = multiplier[i] / k - gap[i]
    if geometric[scene] == wp.float64(0.0) or f < 0 or (s0 <= wp.float64(0.0) and tied[i] == 0):
        return
    w = weight[i]
    p = w * penalty_pressure(s0, k, eps)
    slope = w * penalty_slope(s0, k, eps)
    n = normal[i]
    own = slave_face(layout, i)
    m = shape[i % layout.points]
    s = shares(layout, place[i])
    change = change_along(slave, shape, layout, x, points, master, face, place, normal, gap, bend, equation, v, i)
    dn = change.normal
    pull = wp.vec3d()
    s1 = vec6d()
    s2 = vec6d()
    if not layout.rigid:
        s1 = tri6_d1(flat(place[i]))
        s2 = tri6_d2(flat(place[i]))
        pull = slope * (change.gap - wp.dot(n, change.apart)) * n - p * dn
    rub = wp.vec3d()
    held = vec6d()
    anchor = anchor_face[i]
    if frictional and anchor >= 0:
        held = shares(layout, anchor_place[i])
        position = on_face(x, base, slave, own, m)
        full = shift[i] + stick[i // layout.points] * (position - on_face(x, base, master, anchor, held))
        t = full - wp.dot(full, n) * n
        dt = -wp.dot(full, n) * dn - wp.dot(full, dn) * n
        size = wp.length(t)
        mu = friction[scene]
        bound = borne(mu, p / w)
        rub = w * dt
        if size > bound:
            along = wp.normalize(t)
            rub = (bound / size) * (rub - wp.dot(along, rub) * along) - (slip_bound_slope(mu, p / w) * slope * change.gap) * along
    for a in range(6):
        add_free(out, equation, base + slave[own, a], m[a] * (pull + rub))
        add_free(out, equation, base + master[f, a], p * (s1[a] * change.xi[0] + s2[a] * change.xi[1]) * n - s[a] * pull)
        if anchor >= 0:
            add_free(out, equation, base + master[anchor, a], -held[a] * rub)
