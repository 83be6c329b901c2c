"""What is pressed and what it is pressed into: exact shapes of objects and of the gel, their surfaces, symmetry and placement.

An object is described in its own frame: the contact apex (its lowest point) at the origin, +z up to the base plane at z = height, which is
fixed to the platen. A parametric shape is a solid of smooth patches (`gelsim.shape.solids`), made as its row in `gelsim.scene.shape_table`
says: a profile turned about z or drawn along y, with planes for its ends and its base; planes alone; or a block with a sum of cosines for
an underside. The lines, arcs and waves themselves are in `gelsim.shape.outlines`. A shape of a file keeps its
own flat facets. What lies inside an object, skin and grains, is in `gelsim.mesh.inclusions`. An object that is turned
(`gelsim.shape.orientation`) is described as its shape says, turned, and moved to where its lowest point is the origin (`own_frame`).

Left out: fillets on the sharp rims (a real cast has 0.1 mm or so).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from gelsim.errors import SceneError
from gelsim.geometry import AXES, FACE_EDGES, QuadraticSurface, TriMesh, edges_of, face_shape_functions, quadratic_faces
from gelsim.scene.definition import Body, Gel, Scene
from gelsim.scene.motion import motion, widest
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.mesh_file import cut_flat, file_stamp, read_part
from gelsim.shape.orientation import is_reoriented, orientation, turned
from gelsim.shape.outlines import PLANES, Profile, bore, profile, rounded_planes, sides, underside
from gelsim.shape.pad import pad_height
from gelsim.shape.solids import (
    HULL_STEP,
    Array,
    Patch,
    Plane,
    Segment,
    Sizes,
    Solid,
    Sweep,
    membership,
    mirrored,
    polyhedron,
    project_polyhedron,
    snap,
    solid_surface,
    swept,
    zero_cuts,
)
from gelsim.units import DEG, MM

_FINE = 0.25e-3
"""Edge length of a rigid surface in the contact [m]: its six-node faces lie within 20 nm of a ball of 5 mm (test_shapes.py)."""
STEEP = 45.0
"""Tilt [degrees] from which on a rigid object's base may touch, and its apex is not what the gel meets."""
LARGE, NEAR = 100.0 * MM, 10.0 * MM
"""Extent [m] of a rigid object of a file from which on only faces over the gel are kept, and how near these are to it."""


# ---------------------------------------------------------------------------------------------------------------- solids
def of_file(body: Body) -> bool:
    """Whether it is the facets of a mesh file, and no solid of smooth patches."""
    return SHAPES[body.shape].made == "file"


def shape_symmetry(body: Body) -> frozenset[str]:
    """Mirror planes of the object in its own frame: "x" is the plane x = 0."""
    none = (body.grains.count and not body.rigid) or is_reoriented(body)
    return frozenset() if none else frozenset(SHAPES[body.shape].mirror)


def press_symmetry(scene: Scene) -> frozenset[str]:
    """Mirror planes that object, gel and motion share, so that half or a quarter of both bodies is enough.

    press.symmetry = "none" forbids it, as a pad from a file does. Tilt about x, offset, shear and friction along y keep the plane x = 0; a
    twist keeps none. Markers do not count: they carry no forces.
    """
    press, way = scene.press, widest(scene)
    if press.symmetry == "none" or way.turns[2] or scene.gel.profile == "mesh":
        return frozenset()
    keeps = {"x": not (way.turns[1] or press.offset_mm[0] or way.sideways[0])}
    keeps["y"] = not (way.turns[0] or press.offset_mm[1] or way.sideways[1])
    return frozenset(axis for axis in shape_symmetry(scene.object) if keeps[axis])


@lru_cache(maxsize=64)
def solid(body: Body, symmetry: frozenset[str] = frozenset(), step: float = HULL_STEP) -> Solid:
    """The exact shape, cut at the planes of `symmetry`, of which its positive side stays; `step` [rad] between a turned hull's corners."""
    row = SHAPES[body.shape]
    assert row.made != "file" and symmetry <= shape_symmetry(body)
    if row.relief:
        return _relief(body, symmetry)
    patches: list[Patch] = []
    hull = faces = None
    if row.made == "planes":
        patches += PLANES[body.shape](body, symmetry)
        if not body.rigid and body.edge_radius_mm:  # what is rigid is rounded by its field
            planes, _ = closed(patches, body, symmetry)
            rounded_three, hull = rounded_planes([plane for plane in planes if isinstance(plane, Plane)], body.edge_radius_mm * MM)
            patches[:3] = [rounded_three]
    else:
        segments, hollow = profile(body), bore(body)
        patches += runs(segments, row.turned)
        if row.convex:
            hull = hull_points(segments, body, symmetry, step)
        else:
            patches += runs(hollow, row.turned) if hollow else []
            hull, faces = coarse_surface(segments, hollow, body, symmetry, step)
        if row.drawn:
            half = sides(body)[1]
            patches += [Plane((0.0, y, 0.0), half) for y in (1.0, *(() if "y" in symmetry else (-1.0,)))]
    whole, roles = closed(patches, body, symmetry)
    return Solid(whole, roles, polyhedron(whole) if hull is None else hull, faces)


def closed(contact: list[Patch], body: Body, symmetry: frozenset[str]) -> tuple[tuple[Patch, ...], tuple[str, ...]]:
    """Patches that may touch, the base and the planes of `symmetry`; and the role of each."""
    cuts = [Plane((-1.0, 0.0, 0.0) if axis == "x" else (0.0, -1.0, 0.0), 0.0) for axis in sorted(symmetry)]
    roles = (*["contact"] * len(contact), "base", *sorted(symmetry))
    return (*contact, Plane((0.0, 0.0, 1.0), body.height_mm * MM), *cuts), roles


def coarse_surface(segments: Profile, hollow: Profile, body: Body, symmetry: frozenset[str], step: float) -> tuple[Array, np.ndarray]:
    """Vertices and faces of a shape that is not convex, from its profile and that of its hollow."""
    line = _polyline(segments)
    if hollow:
        within = _polyline(hollow)
        top = [[0.0, line[-1, 1]]] if within[0, 1] < line[-1, 1] else []
        outline = np.vstack([line, *top, within])
    else:
        outline = np.vstack([line, [0.0, line[-1, 1]]])
    vertices, faces = swept(outline, SHAPES[body.shape].turned, sides(body)[1], step)
    for axis in sorted({"x", "y"} - symmetry):
        vertices, faces = mirrored(vertices, faces, axis)
    return vertices, faces


def _polyline(segments: Profile) -> Array:
    return np.vstack([segments[0].samples()] + [s.samples()[1:] for s in segments[1:]])


def _relief(body: Body, symmetry: frozenset[str]) -> Solid:
    """A block with an uneven underside, its lowest point at z = 0."""
    high = np.array(sides(body))
    low = np.where([axis in symmetry for axis in "xy"], 0.0, -high)
    field = underside(body)
    counts = np.maximum(4, np.ceil((high - low) / (body.wavelength_mm * MM / 8)).astype(int))
    x, y = (np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True))
    flat = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(len(flat)).reshape(len(x), len(y))
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])  # counter-clockwise from above
    top = len(flat) + np.arange(len(rim))
    following, above = np.roll(rim, -1), np.roll(top, -1)
    centre = np.full(len(rim), len(flat) + len(rim))
    h = body.height_mm * MM
    vertices = np.vstack([
        np.column_stack([flat, field.heights(flat)[0]]), np.insert(flat[rim], 2, h, axis=1), [[*(low + high) / 2, h]],
    ])  # fmt: skip
    faces = [(a, c, b), (a, d, c), (rim, following, above), (rim, above, top), (centre, top, above)]
    planes = [Plane((1.0, 0.0, 0.0), high[0]), Plane((0.0, 1.0, 0.0), high[1])]
    planes += [Plane((-1.0, 0.0, 0.0), -low[0]), Plane((0.0, -1.0, 0.0), -low[1]), Plane((0.0, 0.0, 1.0), h)]
    roles = ("contact", "contact", "contact", *(axis if axis in symmetry else "contact" for axis in "xy"), "base")
    return Solid((field, *planes), roles, vertices, np.vstack([np.stack(three, axis=1) for three in faces]).astype(np.int32))


def runs(segments: Profile, turned: bool) -> list[Sweep]:
    """Cuts a profile at its creases."""
    runs = [[segments[0]]]
    for before, after in zip(segments[:-1], segments[1:], strict=True):
        if before.tangents()[1] @ after.tangents()[0] > 1 - 1e-9:
            runs[-1].append(after)
        else:
            runs.append([after])
    return [Sweep(tuple(run), turned) for run in runs]


def hull_points(segments: Profile, body: Body, symmetry: frozenset[str], step: float) -> Array:
    """Corners of a coarse polyhedron; no three on a line, so that the hull keeps each of them."""
    line = _polyline(segments)
    low, h = line[0, 1], line[-1, 1]
    pointed = line[1, 1] > low
    if not SHAPES[body.shape].turned:
        right = line if pointed or "x" in symmetry else line[1:]
        left = np.array([[0.0, h]]) if "x" in symmetry else (line[1:] * [-1.0, 1.0])
        flat = np.vstack([right, left])
        half = sides(body)[1]
        ends = [0.0 if "y" in symmetry else -half, half]
        return np.vstack([np.insert(flat, 1, y, axis=1) for y in ends])
    begin = {0: -np.pi, 1: -np.pi / 2 if "x" in symmetry else 0.0, 2: 0.0}[len(symmetry)]
    end = {0: np.pi, 1: np.pi / 2 if "x" in symmetry else np.pi, 2: np.pi / 2}[len(symmetry)]
    azimuth = np.linspace(begin, end, 1 + round((end - begin) / step))
    azimuth = azimuth[:-1] if not symmetry else azimuth
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    circle[np.abs(circle) < 1e-12] = 0.0
    rings = [np.hstack([r * circle, np.full((len(circle), 1), z)]) for r, z in line[1:]]
    axis = [[0.0, 0.0, low]] if pointed or len(symmetry) == 2 else []
    axis += [[0.0, 0.0, h]] if len(symmetry) == 2 else []
    return np.vstack([*rings, np.array(axis).reshape(-1, 3)])


# ---------------------------------------------------------------------------------------------------------------- surfaces
def load_mesh(body: Body) -> TriMesh:
    """The surface of shape = "mesh", lowest point at the origin [m]; raises SceneError for a file that bounds no body."""
    return read_part(body).surface


@lru_cache(maxsize=16)
def own_frame(body: Body) -> tuple[Array, Array]:
    """From the frame of a shape to how it stands, its lowest point at the origin: R (3, 3), t (3,) [m] of p' = R p + t."""
    turn = orientation(body)
    if not is_reoriented(body):
        return turn, np.zeros(3)
    upright = _upright(body)
    surface = object_surface(upright, edge_length=np.inf)
    for _ in range(2):  # the second time with edges of 20 µm around what was found
        heights = surface.vertices @ turn[2]
        lowest = surface.vertices[heights <= heights.min() + 1e-7]
        around = lowest[0]
        surface = object_surface(upright, edge_length=lambda points, p=around: 2e-5 + 0.3 * np.linalg.norm(points - p, axis=1))
    heights = surface.vertices @ turn[2]
    tip = surface.vertices[heights <= heights.min() + 1e-7] @ turn.T
    return turn, -np.array([*(tip.min(axis=0) + tip.max(axis=0))[:2] / 2, heights.min()])


def _upright(body: Body) -> Body:
    return replace(body, press_side="bottom", rotation_deg=(0.0, 0.0, 0.0))


def object_surface(body: Body, *, edge_length: Sizes | float, chord: float = 1e-5, symmetry: frozenset[str] = frozenset()) -> TriMesh:
    """A watertight, outward surface of the object in its own frame, as it stands.

    Args:
        edge_length: Longest edge allowed [m], a number or a function of points (N, 3) of its shape. A `mesh` shape keeps its facets.
        chord: Largest distance allowed between an edge and the exact shape [m].
        symmetry: Mirror planes of the shape; only the positive side is returned, closed by the planes.
    Raises:
        SceneError: The shape fields make no solid, or the mesh file is no watertight solid.
    """
    if of_file(body):
        assert not symmetry
        return load_mesh(body)
    vertices, faces, _ = solid_surface(solid(_upright(body), symmetry), edge_length, chord)
    if is_reoriented(body):
        turn, shift = own_frame(body)
        vertices = vertices @ turn.T + shift
        if not body.rigid:  # held as a file's part is
            vertices, faces = cut_flat(vertices, faces.astype(np.int64), f"object.shape = {body.shape!r}")
    return TriMesh(vertices, faces.astype(np.int32))


def sharp_edges(body: Body, least_deg: float = 30.0) -> Array:
    """Sharp convex edges of the object as straight pieces, (K, 2, 3) [m], within 10 µm of a curved one; those at its top are left out.

    An edge is sharp where the surface turns by more than `least_deg`, or where four faces or more share it.
    """
    return _sharp_edges(body, least_deg, file_stamp(body))


@lru_cache(maxsize=4)
def _sharp_edges(body: Body, least_deg: float, stamp: tuple[int, ...]) -> Array:
    surface = object_surface(body, edge_length=np.inf, chord=np.inf if of_file(body) else 1e-5)
    edges, index = edges_of(surface.faces, FACE_EDGES)
    corners = surface.vertices[surface.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    order = np.argsort(index.ravel(), kind="stable")
    uses = np.bincount(index.ravel(), minlength=len(edges))
    owners = np.arange(len(surface.faces)).repeat(3)[order]
    first = np.cumsum(uses) - uses
    one, two = owners[first], owners[first + np.minimum(uses, 2) - 1]  # a closed surface: two faces an edge, or an even number
    sharp = (normal[one] * normal[two]).sum(axis=1) < np.cos(least_deg * DEG)
    convex = ((corners[two].mean(axis=1) - corners[one].mean(axis=1)) * normal[one]).sum(axis=1) < 0.0
    top = surface.vertices[:, 2].max() * (1 - 1e-6)
    low = (surface.vertices[edges][:, :, 2] < top).any(axis=1)
    return surface.vertices[edges[((sharp & convex) | (uses > 2)) & low]]


def rigid_surface(scene: Scene, symmetry: frozenset[str]) -> QuadraticSurface:
    """Six-node faces of a rigid object in its own frame, mid-side nodes on the exact shape; the base and the cut planes are left out.

    Edges are 0.25 mm up to 1.5 times the depth of the press, and grow by half a millimetre per millimetre above that and by a tenth beyond
    4 mm from the axis. Of one that is turned, or tilted by more than STEEP, the base is there too, and edges are short about what is lowest
    then. A `mesh` shape keeps its facets; of a larger one than LARGE only those near the gel are there.
    """
    body = scene.object
    if not of_file(body):
        steep = max(map(abs, scene.press.tilt_deg)) > STEEP
        return _exact_surface(body, press_depth(scene), symmetry, scene.press.tilt_deg if steep else None)
    surface = load_mesh(body)
    if np.ptp(surface.vertices, axis=0).max() > LARGE:
        surface = near_gel(scene, surface)
    return quadratic_faces(surface.vertices, surface.faces)


def near_gel(scene: Scene, surface: TriMesh) -> TriMesh:
    """Those of an object's faces that may come within NEAR of the gel."""
    turn, shift = placement(scene, quadratic_faces(surface.vertices, surface.faces))
    corners = (surface.vertices @ turn.T + shift)[surface.faces]
    way = widest(scene)
    half = np.array([*scene.gel.size_mm, 0.0]) * MM / 2 + np.array([*way.sideways, 0.0]) * MM
    if way.turns[2] or way.rolls:
        half[:2] = np.hypot(*(half[:2] + np.abs(shift[:2])))
    high = half + [0.0, 0.0, furthest_approach(scene)] + NEAR
    if way.rolls:  # what lies as far beside the apex comes down by as much at most
        high[2] += half[0] * np.sin(np.ptp(way.turn[:, :2], axis=0).max() * DEG)
    kept = (corners.min(axis=1) <= high).all(axis=1) & (corners.max(axis=1) >= -half - NEAR)[:, :2].all(axis=1)
    used, faces = np.unique(surface.faces[kept], return_inverse=True)
    return TriMesh(surface.vertices[used], faces.reshape(-1, 3).astype(np.int32))


@lru_cache(maxsize=2)
def _exact_surface(body: Body, depth: float, symmetry: frozenset[str], tilt_deg: tuple[float, float] | None) -> QuadraticSurface:
    """`rigid_surface` of other shapes, for a press of a depth [m]: a press needs it for both meshes. `tilt_deg` None: no steep one."""
    shape = solid(_upright(body), symmetry)
    turn, moved = own_frame(body)
    whole = tilt_deg is not None or is_reoriented(body)
    lowered, apex = np.eye(3), np.zeros(3)
    if whole:
        lowered = turned((*(tilt_deg or (0.0, 0.0)), 0.0)) @ turn
        ends = object_surface(_upright(body), edge_length=np.inf).vertices
        apex = ends[(ends @ lowered[2]).argmin()]

    def sizes(points: Array) -> Array:
        from_apex = (points - apex) @ lowered.T
        above, aside = from_apex[:, 2] - 1.5 * depth, np.hypot(from_apex[:, 0], from_apex[:, 1]) - 4.0 * MM
        return _FINE + 0.5 * np.maximum(above, 0.0) + 0.1 * np.maximum(aside, 0.0)

    vertices, faces, patch = solid_surface(shape, sizes, np.inf)
    contact = np.array([role == "contact" or (whole and role == "base") for role in shape.roles])[patch]
    faces, patch = faces[contact], patch[contact]
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    vertices = vertices[used]
    surface = quadratic_faces(vertices, faces.astype(np.int32))
    member = membership(surface.faces[:, 3:], patch, len(surface.nodes), len(shape.patches))[len(vertices) :]
    # Edges on a cut plane lie on it too: their two ends do.
    ends, _ = edges_of(faces.astype(np.int32), FACE_EDGES)
    for column, role in enumerate(shape.roles):
        if role in AXES:
            member[:, column] = (vertices[ends][:, :, AXES[role]] == 0.0).all(axis=1)
    middle = snap(shape.patches, surface.nodes[len(vertices) :], member)
    zero_cuts(shape, middle, member)
    nodes = np.vstack([vertices, middle])
    return QuadraticSurface(nodes @ turn.T + moved if is_reoriented(body) else nodes, surface.faces)


def project(body: Body, points: Array) -> Array:
    """Closest points (N, 3) on the exact surface of the object; a `mesh` shape returns the points as they are."""
    if of_file(body):
        return points.copy()
    row = SHAPES[body.shape]
    assert not bore(body) and not row.relief and not is_reoriented(body), "of these only the patches are known"
    if row.made == "planes":
        assert body.rigid or not body.edge_radius_mm, "of a rounded one too"
        return project_polyhedron(solid(body).patches, points)
    boundary = Sweep(_closed_outline(body), row.turned)
    if row.turned:
        return boundary.project(points)
    half = sides(body)[1]
    side = boundary.project(points)
    side[:, 1] = np.clip(side[:, 1], -half, half)
    across, flat, normal = boundary._closest(points)
    inside = ((np.stack([across, points[:, 2]], 1) - flat) * normal).sum(axis=1) <= 0.0
    end = np.where(inside[:, None], points, side)
    end[:, 1] = np.where(points[:, 1] < 0.0, -half, half)
    nearer = ((end - points) ** 2).sum(axis=1) < ((side - points) ** 2).sum(axis=1)
    return np.where(nearer[:, None], end, side)


def _closed_outline(body: Body) -> Profile:
    """The profile and the base, from the axis back to it."""
    segments = profile(body)
    return *segments, Segment(segments[-1].end, (0.0, body.height_mm * MM))


def _hollow_outline(body: Body) -> Profile:
    """The same with its hollow, whose mouth, if it has one, is cut out of the base."""
    *outer, base = _closed_outline(body)
    hollow = bore(body)
    if hollow and hollow[0].start[1] == base.end[1]:
        base = Segment(base.start, hollow[0].start)
    return *outer, base, *hollow


def has_profile(body: Body) -> bool:
    """Whether the object is a profile that is turned or drawn, whose distance is known in closed form (`signed_distance`)."""
    return SHAPES[body.shape].turned or SHAPES[body.shape].drawn


def signed_distance(body: Body, points: Array) -> tuple[Array, Array]:
    """Distance (N,) [m] of points (N, 3) [m] from a turned or drawn object, negative inside, and its gradient (N, 3).

    A hollow counts as filled, unless the object is turned: only then can the gel reach it, and a thin wall pushes what is deep in it on.
    """
    segments = _closed_outline(body)
    if is_reoriented(body):
        turn, shift = own_frame(body)
        points = (points - shift) @ turn
        segments = _hollow_outline(body)
    row = SHAPES[body.shape]
    across = np.hypot(points[:, 0], points[:, 1]) if row.turned else np.abs(points[:, 0])
    flat = np.stack([across, points[:, 2]], axis=1)
    found = [segment.project(flat) for segment in segments]
    away = np.array([np.linalg.norm(near - flat, axis=1) for near, _ in found])
    nearest, every = away.argmin(axis=0), np.arange(len(points))
    inside = sum(segment.crossings(flat) for segment in segments) % 2 == 1
    distance = np.where(inside, -1.0, 1.0) * away[nearest, every]
    near, normal = (np.array(part)[nearest, every] for part in zip(*found, strict=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        way = np.where(np.abs(distance)[:, None] > 1e-12, (flat - near) / distance[:, None], normal)
        outward = np.where(across[:, None] > 0.0, points[:, :2] / across[:, None], [1.0, 0.0])
    if row.turned:
        slope = np.column_stack([way[:, :1] * outward, way[:, 1]])
    else:
        slope = np.column_stack([way[:, 0] * np.where(points[:, 0] < 0.0, -1.0, 1.0), np.zeros(len(points)), way[:, 1]])
        end = np.abs(points[:, 1]) - sides(body)[1]
        along = np.where(points[:, 1] < 0.0, -1.0, 1.0)[:, None] * np.array([0.0, 1.0, 0.0])
        outside = np.hypot(np.maximum(distance, 0.0), np.maximum(end, 0.0))
        corner, beyond = (distance > 0.0) & (end > 0.0), end > distance
        oblique = (slope * distance[:, None] + along * end[:, None]) / np.maximum(outside, 1e-300)[:, None]
        slope = np.where(corner[:, None], oblique, np.where(beyond[:, None], along, slope))
        distance = np.where(corner, outside, np.maximum(distance, end))
    return distance, slope @ turn.T if is_reoriented(body) else slope


# ---------------------------------------------------------------------------------------------------------------- gel and placement
def press_depth(scene: Scene) -> float:
    """The approach that meshes are made for [m]: the press depth, of a path its deepest, or 1 mm when only a force is given."""
    return (widest(scene).deepest or 1.0) * MM


def furthest_approach(scene: Scene) -> float:
    """How far a press may go [m]: its depth, or where a force says how far half of the gel plus a third of a soft object's height."""
    way = motion(scene.press)
    if scene.press.depth_mm is not None:
        return scene.press.depth_mm * MM
    if way is not None and not way.by_force.any():
        return way.deepest * MM
    return (0.5 * scene.gel.thickness_mm + (0.0 if scene.object.rigid else scene.object.height_mm / 3)) * MM


def gel_height(gel: Gel, xy: Array) -> Array:
    """z [m] of the undeformed outer face at points (N, 2) [m].

    Flat: 0. Dome and sphere: a spherical cap with its top at the origin that leaves `edge_mm` at the middle of each side of a square gel
    (of a rectangle: of its short sides, which are farther from the centre). The corners of a square lie deeper on the sphere than the
    middles of its sides, for the default dome even below the window: there the gel keeps a land of half the edge thickness. Cylinder:
    likewise across its axis. Mesh: `pad_height`.
    """
    if gel.profile == "mesh":
        return pad_height(gel, xy)
    if gel.edge_mm == gel.thickness_mm:
        return np.zeros(len(xy))
    half, drop = gel.half_width_mm * MM, (gel.thickness_mm - gel.edge_mm) * MM
    radius = (half**2 + drop**2) / (2 * drop)
    across = xy[:, 0] ** 2 if gel.profile == "cylinder" else (xy**2).sum(axis=1)
    cap = np.sqrt(np.maximum(radius**2 - across, 0.0)) - radius
    return np.maximum(cap, (0.5 * gel.edge_mm - gel.thickness_mm) * MM)


def rotation(scene: Scene) -> Array:
    """How the object is turned at first touch, (3, 3): tilted about x, then about y; a measured path may begin turned about z too."""
    return turned(widest(scene).turn[0])


@lru_cache(maxsize=4)
def _first_touch(scene: Scene, stamp: tuple[int, ...]) -> tuple[QuadraticSurface, Array, Array]:
    surface = rigid_surface(scene, frozenset())
    return surface, *placement(scene, surface)


def first_touch(scene: Scene) -> tuple[QuadraticSurface, Array, Array]:
    """The object's surface, as if it were rigid, and its `placement` on the gel."""
    return _first_touch(scene, file_stamp(scene.object) + file_stamp(scene.gel))


def placement(scene: Scene, surface: QuadraticSurface) -> tuple[Array, Array]:
    """Where the object just touches the undeformed gel: positions = R p + t, R (3, 3), t (3,) [m].

    R is the tilt about the apex, t the offset and the height at which the smallest gap between the object's six-node faces and the gel's
    outer face is 0 (to 0.01 µm; sought between the nodes too). Only what lies over the gel counts. The offset is the apex's, or with
    press.touch_at = "centre" that of the middle of what touches first.

    Raises:
        SceneError: No part of the object lies over the gel.
    """
    turn, shift = rotation(scene), np.array([*scene.press.offset_mm, 0.0]) * MM
    if scene.press.touch_at == "apex":
        return turn, _lowered(scene, surface.nodes @ turn.T, surface.faces, shift)[0]
    # A dome may touch elsewhere once the object is moved: a few looks find where both agree.
    free = np.array([axis not in press_symmetry(scene) for axis in "xy"])
    wanted, nodes = shift[:2].copy(), surface.nodes @ turn.T
    lowest = nodes[nodes[:, 2] <= nodes[:, 2].min() + 1e-6]
    shift[:2] -= np.where(free, (lowest.min(axis=0) + lowest.max(axis=0))[:2] / 2, 0.0)
    for _ in range(8):
        shift, touched = _lowered(scene, nodes, surface.faces, shift)
        away = np.where(free, touched - wanted, 0.0)
        if np.linalg.norm(away) < 0.01 * MM:
            break
        shift[:2] -= away
    return turn, _lowered(scene, nodes, surface.faces, shift)[0]


def _lowered(scene: Scene, turned: Array, numbers: np.ndarray, shift: Array) -> tuple[Array, Array]:
    """The shift with the height at which nodes (N, 3) of six-node faces just touch the gel, and the middle of what touches, (2,) [m]."""
    shift = np.array([*shift[:2], 0.0])
    nodes = turned + shift
    half = np.array(scene.gel.size_mm) * MM / 2 * (1 + 1e-9)

    def gap(points: Array) -> Array:
        over = (np.abs(points[..., :2]) <= half).all(axis=-1)
        flat = points.reshape(-1, 3)
        return np.where(over, (flat[:, 2] - gel_height(scene.gel, flat[:, :2])).reshape(over.shape), np.inf)

    heights = gap(nodes)
    at_nodes = heights[numbers]
    low = at_nodes.min(axis=1)
    best = low.min()
    if not np.isfinite(best):
        raise SceneError(
            f"press.offset_mm = [{scene.press.offset_mm[0]:g}, {scene.press.offset_mm[1]:g}] mm puts the object beside the gel; "
            f"allowed: some of it over the {scene.gel.size_mm[0]:g} x {scene.gel.size_mm[1]:g} mm gel"
        )
    # Between its nodes a quadratic face can dip below the lowest of them by at most the spread of its nodes; look where it could matter.
    over = np.isfinite(low)
    at_nodes, low, faces = at_nodes[over], low[over], numbers[over]
    spread = np.where(np.isfinite(at_nodes), at_nodes, low[:, None]).max(axis=1) - low
    near = np.flatnonzero(low - spread <= best)
    faces = faces[near[np.argsort(low[near])[:2000]]]
    width, centre = 1.0, np.full((len(faces), 2), 1.0 / 3.0)
    steps = np.linspace(-1.0, 1.0, 7)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    for _ in range(12):  # each pass halves the window around the best point: it ends 2^-12 of a face away, where the gap is flat
        trial = np.clip(centre[:, None, :] + width * offsets, 0.0, 1.0)
        total = trial.sum(axis=-1, keepdims=True)
        trial = np.where(total > 1.0, trial / np.maximum(total, 1e-300), trial)
        weights = face_shape_functions(np.concatenate([1.0 - trial.sum(-1, keepdims=True), trial], axis=-1).reshape(-1, 3))
        points = np.einsum("fqn,fni->fqi", weights.reshape(len(faces), -1, 6), nodes[faces])
        found = gap(points)
        at = found.argmin(axis=1)
        centre = trial[np.arange(len(faces)), at]
        width *= 0.5
        lowest = found.min(axis=1)
        best = min(best, float(lowest.min()))
        stay = lowest <= best + 1e-6  # a face a micrometre above the best after a look on a 7 x 7 grid is not the one
        if stay.any() and not stay.all():
            faces, centre = faces[stay], centre[stay]
    shift[2] = -best
    touched = nodes[heights <= heights.min() + 1e-6, :2]
    return shift, (touched.min(axis=0) + touched.max(axis=0)) / 2
