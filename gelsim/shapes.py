"""What is pressed and what it is pressed into: exact shapes of objects and of the gel, their surfaces, symmetry and placement.

An object is described in its own frame: the contact apex (its lowest point) at the origin, +z up to the base plane at z = height, which is
fixed to the platen. A parametric shape is a convex solid bounded by a few smooth *patches*: a profile of lines and circular arcs, turned
about z (hemisphere, cone, punch, frustum) or drawn along y (cylinder, edge, flat, box), and planes (ends, base, the faces of a corner).
Every patch knows the closest point on itself, so vertices and mid-side nodes can be put exactly where they belong; a node on a crease lies
on both patches at once and is found by alternating projections (von Neumann 1950; the sets are closed and the crease is their meet).

Triangles come from the convex hull of a few points of the shape, refined by longest-edge bisection (Rivara 1984) until every edge is as
short as asked and every chord is as close to the shape as asked. A `mesh` shape keeps its own flat facets.

Left out: fillets on the sharp rims (a real cast has 0.1 mm or so), and textures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.geometry import AXES, FACE_EDGES, QuadraticSurface, TriMesh, edges_of, face_shape_functions, quadratic_faces, tet_volumes
from gelsim.scene import Body, Gel, Scene

Array = NDArray[np.float64]
Sizes = Callable[[Array], Array]

MM = 1e-3
TURNED = ("hemisphere", "cone", "punch", "frustum")
DRAWN = ("cylinder", "edge", "flat", "box")
SHAPES = (*TURNED, *DRAWN, "corner", "mesh")
SAMPLE_WIDTH = 25e-3
"""Width of the caps cut from large balls and rods, and length of the cylinder [m] (interfaces.md §2)."""
_HULL_STEP = np.radians(15.0)
_UNIT_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 25.4e-3}
_MESH_BYTES = 100_000_000
_MESH_FACES = 2_000_000
_MESH_EXTENT = (0.5e-3, 100e-3)
_MESH_TOLERANCE = 5e-6
"""A user's mesh is thinned as far as its surface moves less than this [m]: a quarter of the overlap a press may show."""


# ---------------------------------------------------------------------------------------------------------------- patches
@dataclass(frozen=True)
class Plane:
    """The plane normal · p = offset, the solid below it."""

    normal: tuple[float, float, float]
    offset: float

    def project(self, points: Array) -> Array:
        n = np.array(self.normal)
        return points - (points @ n - self.offset)[:, None] * n

    def normals(self, points: Array) -> Array:
        return np.broadcast_to(np.array(self.normal), points.shape)


@dataclass(frozen=True)
class Segment:
    """A piece of a profile in the (r, z) half plane, walked with the solid on the left: a line, or an arc about (0, radius)."""

    start: tuple[float, float]
    end: tuple[float, float]
    radius: float = 0.0
    """Of an arc whose centre is (0, radius) [m]; 0 for a line."""

    def project(self, points: Array) -> tuple[Array, Array]:
        """Closest points and outward normals, both (N, 2)."""
        start, end = np.array(self.start), np.array(self.end)
        if self.radius:
            low, high = (np.arctan2(p[0], self.radius - p[1]) for p in (start, end))
            angle = np.clip(np.arctan2(points[:, 0], self.radius - points[:, 1]), low, high)
            normal = np.stack([np.sin(angle), -np.cos(angle)], axis=1)
            return np.array([0.0, self.radius]) + self.radius * normal, normal
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
        normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
        return start + share[:, None] * along, np.broadcast_to(normal, points.shape)

    def tangents(self) -> tuple[Array, Array]:
        if self.radius:
            ends = [np.array([self.radius - p[1], p[0]]) / self.radius for p in (self.start, self.end)]
            return ends[0], ends[1]
        along = np.subtract(self.end, self.start)
        along = along / np.linalg.norm(along)
        return along, along

    def samples(self) -> Array:
        """A few points from start to end, for the convex hull."""
        if not self.radius:
            return np.array([self.start, self.end])
        low, high = (np.arctan2(p[0], self.radius - p[1]) for p in (self.start, self.end))
        angle = np.linspace(low, high, 1 + max(2, int(np.ceil((high - low) / _HULL_STEP))))
        points = np.stack([self.radius * np.sin(angle), self.radius * (1.0 - np.cos(angle))], axis=1)
        points[0], points[-1] = self.start, self.end
        return points


@dataclass(frozen=True)
class Sweep:
    """A smooth run of profile segments, turned about z or drawn along y (mirrored in x = 0)."""

    segments: tuple[Segment, ...]
    turned: bool

    def _closest(self, points: Array) -> tuple[Array, Array, Array]:
        across = np.hypot(points[:, 0], points[:, 1]) if self.turned else np.abs(points[:, 0])
        flat = np.stack([across, points[:, 2]], axis=1)
        found = [segment.project(flat) for segment in self.segments]
        best = np.argmin([((p - flat) ** 2).sum(axis=1) for p, _ in found], axis=0)
        rows = np.arange(len(points))
        return across, np.stack([p for p, _ in found])[best, rows], np.stack([n for _, n in found])[best, rows]

    def _back(self, points: Array, across: Array, flat: Array) -> Array:
        out = np.empty_like(points)
        out[:, 2] = flat[:, 1]
        if self.turned:
            with np.errstate(invalid="ignore", divide="ignore"):
                direction = np.where(across[:, None] > 0.0, points[:, :2] / across[:, None], [1.0, 0.0])
            out[:, :2] = direction * flat[:, :1]
        else:
            out[:, 0] = np.where(points[:, 0] < 0.0, -1.0, 1.0) * flat[:, 0]
            out[:, 1] = points[:, 1]
        return out

    def project(self, points: Array) -> Array:
        across, flat, _ = self._closest(points)
        return self._back(points, across, flat)

    def normals(self, points: Array) -> Array:
        across, _, normal = self._closest(points)
        out = self._back(points, across, normal)
        if not self.turned:
            out[:, 1] = 0.0
        return out


Patch = Plane | Sweep


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex shape, or the part of it on the positive side of its cut planes."""

    patches: tuple[Patch, ...]
    roles: tuple[str, ...]
    """Of each patch: "contact", "base", or the cut plane "x" or "y"."""
    hull: Array
    """Corners of a coarse polyhedron inscribed in it, (P, 3)."""


# ---------------------------------------------------------------------------------------------------------------- parameters
def height(body: Body) -> float:
    """From the apex to the base [m]; of a mesh its extent in z."""
    return float(load_mesh(body)[0].vertices[:, 2].max()) if body.shape == "mesh" else body.height_mm * MM


def _profile(body: Body) -> tuple[Segment, ...]:
    """The profile from the axis to the base, as (r, z) or (x, z) segments [m]."""
    h, r = body.height_mm * MM, body.radius_mm * MM
    half = _default(body.width_mm, 10.0 if body.shape == "box" else 25.0) * MM / 2
    if body.shape in ("hemisphere", "cylinder"):
        wide = r if r <= h else min(SAMPLE_WIDTH / 2, np.sqrt(h * (2 * r - h)), r)
        rise = r - np.sqrt(max(r**2 - wide**2, 0.0))
        if rise > h * (1 - 1e-9):
            wide, rise = np.sqrt(h * (2 * r - h)), h
        return _with_foot(Segment((0.0, 0.0), (wide, rise), r), h)
    if body.shape in ("cone", "edge"):
        slope = 1.0 / np.tan(np.radians(_default(body.angle_deg, 90.0)) / 2)
        wide = min(r if body.shape == "cone" else half, h / slope)
        return _with_foot(Segment((0.0, 0.0), (wide, wide * slope)), h)
    if body.shape == "frustum":
        top = r + h / np.tan(np.radians(_default(body.angle_deg, 75.0)))
        return Segment((0.0, 0.0), (r, 0.0)), Segment((r, 0.0), (top, h))
    half = r if body.shape == "punch" else half
    return _with_foot(Segment((0.0, 0.0), (half, 0.0)), h)


def _with_foot(tip: Segment, h: float) -> tuple[Segment, ...]:
    wide, rise = tip.end
    return (tip,) if rise > h * (1 - 1e-9) else (tip, Segment(tip.end, (wide, h)))


def _length(body: Body) -> float:
    """Along y, of drawn shapes [m]."""
    return _default(body.length_mm, 15.0 if body.shape == "box" else 25.0) * MM


def _default(value: float | None, default: float) -> float:
    return default if value is None else value


def check_body(body: Body) -> None:
    """Raises SceneError where a shape field makes no solid. Called by every function here; cheap."""
    if body.shape not in SHAPES:
        raise SceneError(f'object.shape = "{body.shape}" is unknown; allowed: {", ".join(SHAPES)}')
    if body.shape == "mesh":
        if not body.mesh:
            raise SceneError('object.mesh is not set; shape = "mesh" needs the path of a watertight STL, OBJ or PLY file')
        return
    for name, value, high in (
        ("height_mm", body.height_mm, 100.0),
        ("radius_mm", body.radius_mm, 200.0),
        ("width_mm", body.width_mm, 100.0),
        ("length_mm", body.length_mm, 100.0),
    ):
        if value is not None and not 0.2 <= value <= high:
            raise SceneError(f"object.{name} = {value:g} mm; allowed: 0.2 to {high:g} mm")
    low, high = (45.0, 90.0) if body.shape == "frustum" else (10.0, 170.0)
    if body.angle_deg is not None and not low <= body.angle_deg <= high:
        raise SceneError(f"object.angle_deg = {body.angle_deg:g} degrees; allowed for {body.shape}: {low:g} to {high:g} degrees")
    if body.shape in ("punch", "frustum") and body.radius_mm > 50.0:
        raise SceneError(f"object.radius_mm = {body.radius_mm:g} mm; allowed for {body.shape}: 0.2 to 50 mm")


# ---------------------------------------------------------------------------------------------------------------- solids
def shape_symmetry(body: Body) -> frozenset[str]:
    """Mirror planes of the object in its own frame: "x" is the plane x = 0."""
    check_body(body)
    return frozenset() if body.shape == "mesh" else frozenset("x") if body.shape == "corner" else frozenset("xy")


def press_symmetry(scene: Scene) -> frozenset[str]:
    """Mirror planes that object, gel and motion share, so that half or a quarter of both bodies is enough.

    Tilt about x, offset, shear and friction along y keep the plane x = 0; a twist keeps none. Markers do not count: they carry no forces.
    """
    press = scene.press
    if press.symmetry == "none" or press.twist_deg:
        return frozenset()
    keeps = {"x": not (press.tilt_deg[1] or press.offset_mm[0] or press.shear_mm[0])}
    keeps["y"] = not (press.tilt_deg[0] or press.offset_mm[1] or press.shear_mm[1])
    return frozenset(axis for axis in shape_symmetry(scene.object) if keeps[axis])


@lru_cache(maxsize=64)
def solid(body: Body, symmetry: frozenset[str] = frozenset()) -> Solid:
    """The exact shape, cut at the planes of `symmetry`, of which its positive side stays."""
    check_body(body)
    assert body.shape != "mesh" and symmetry <= shape_symmetry(body)
    h = body.height_mm * MM
    patches: list[Patch] = []
    if body.shape == "corner":
        half = _default(body.width_mm, 25.0) * MM / 2
        for azimuth in np.radians([90.0, 210.0, 330.0]):
            patches.append(Plane((np.sqrt(2 / 3) * np.cos(azimuth), np.sqrt(2 / 3) * np.sin(azimuth), -np.sqrt(1 / 3)), 0.0))
        patches += [Plane((-1.0, 0.0, 0.0), half), Plane((1.0, 0.0, 0.0), half), Plane((0.0, -1.0, 0.0), half), Plane((0.0, 1.0, 0.0), half)]
        if "x" in symmetry:
            del patches[3]
        hull = None
    else:
        segments = _profile(body)
        patches += _runs(segments, body.shape in TURNED)
        hull = _hull_points(segments, body, symmetry)
        if body.shape in DRAWN:
            patches.append(Plane((0.0, 1.0, 0.0), _length(body) / 2))
            if "y" not in symmetry:
                patches.append(Plane((0.0, -1.0, 0.0), _length(body) / 2))
    roles = ["contact"] * len(patches)
    patches.append(Plane((0.0, 0.0, 1.0), h))
    roles.append("base")
    for axis in sorted(symmetry):
        patches.append(Plane((-1.0, 0.0, 0.0) if axis == "x" else (0.0, -1.0, 0.0), 0.0))
        roles.append(axis)
    return Solid(tuple(patches), tuple(roles), _polyhedron(patches) if hull is None else hull)


def _runs(segments: tuple[Segment, ...], turned: bool) -> list[Sweep]:
    """Cuts a profile at its creases."""
    runs = [[segments[0]]]
    for before, after in zip(segments[:-1], segments[1:], strict=True):
        if before.tangents()[1] @ after.tangents()[0] > 1 - 1e-9:
            runs[-1].append(after)
        else:
            runs.append([after])
    return [Sweep(tuple(run), turned) for run in runs]


def _hull_points(segments: tuple[Segment, ...], body: Body, symmetry: frozenset[str]) -> Array:
    """Corners of a coarse polyhedron; no three on a line, so that the hull keeps each of them."""
    line = np.vstack([segments[0].samples()] + [s.samples()[1:] for s in segments[1:]])
    h = line[-1, 1]
    if body.shape not in TURNED:
        pointed = line[1, 1] > 0.0
        right = line if pointed or "x" in symmetry else line[1:]
        left = np.array([[0.0, h]]) if "x" in symmetry else (line[1:] * [-1.0, 1.0])
        flat = np.vstack([right, left])
        ends = [0.0 if "y" in symmetry else -_length(body) / 2, _length(body) / 2]
        return np.vstack([np.insert(flat, 1, y, axis=1) for y in ends])
    low = {0: -np.pi, 1: -np.pi / 2 if "x" in symmetry else 0.0, 2: 0.0}[len(symmetry)]
    high = {0: np.pi, 1: np.pi / 2 if "x" in symmetry else np.pi, 2: np.pi / 2}[len(symmetry)]
    azimuth = np.linspace(low, high, 1 + round((high - low) / _HULL_STEP))
    azimuth = azimuth[:-1] if not symmetry else azimuth
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    circle[np.abs(circle) < 1e-12] = 0.0
    rings = [np.hstack([r * circle, np.full((len(circle), 1), z)]) for r, z in line[1:]]
    axis = [[0.0, 0.0, 0.0]] if line[1, 1] > 0.0 or len(symmetry) == 2 else []
    axis += [[0.0, 0.0, h]] if len(symmetry) == 2 else []
    return np.vstack([*rings, np.array(axis).reshape(-1, 3)])


def _polyhedron(planes: list[Patch]) -> Array:
    """Corners of the convex body below all the planes."""
    normals = np.array([p.normal for p in planes if isinstance(p, Plane)])
    offsets = np.array([p.offset for p in planes if isinstance(p, Plane)])
    corners = []
    for three in combinations(range(len(normals)), 3):
        a = normals[list(three)]
        if abs(np.linalg.det(a)) > 1e-9:
            p = np.linalg.solve(a, offsets[list(three)])
            if (normals @ p <= offsets + 1e-12).all():
                corners.append(p)
    found = np.array(corners)
    _, first = np.unique(np.round(found, 10), axis=0, return_index=True)
    return found[np.sort(first)]


def patch_distances(patches: tuple[Patch, ...], points: Array) -> Array:
    """Distance [m] of each point to each patch, (N, P)."""
    return np.stack([np.linalg.norm(patch.project(points) - points, axis=1) for patch in patches], axis=1)


def classify(patches: tuple[Patch, ...], vertices: Array, faces: NDArray[np.int32], tolerance: float) -> NDArray[np.int64]:
    """The patch of each face, (F,): among the patches that all three vertices lie on within `tolerance`, the best aligned one."""
    corners = vertices[faces[:, :3]]
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    far = patch_distances(patches, vertices)[faces[:, :3]].max(axis=1)
    near = far <= np.maximum(tolerance, far.min(axis=1, keepdims=True) * (1 + 1e-9))
    aligned = np.stack([(patch.normals(centre) * normal).sum(axis=1) for patch in patches], axis=1)
    return np.argmax(np.where(near, aligned, -np.inf), axis=1)


def snap(patches: tuple[Patch, ...], points: Array, member: NDArray[np.bool_]) -> Array:
    """Moves each point (N, 3) onto all the patches it belongs to, `member` (N, P), by alternating projections."""
    out = points.copy()
    kinds, which = np.unique(member, axis=0, return_inverse=True)
    for kind, row in enumerate(kinds):
        mine = np.flatnonzero(which.ravel() == kind)
        chosen = [patch for patch, wanted in zip(patches, row, strict=True) if wanted]
        moving = out[mine]
        for _ in range(1 if len(chosen) < 2 else 400):
            before = moving
            for patch in chosen:
                moving = patch.project(moving)
            if not len(mine) or np.abs(moving - before).max() < 1e-15:
                break
        out[mine] = moving
    return out


def zero_cuts(solid: Solid, points: Array, member: NDArray[np.bool_]) -> None:
    """Puts exactly 0 into the coordinate of every point that belongs to a cut plane, in place."""
    for column, role in enumerate(solid.roles):
        if role in AXES:
            points[member[:, column], AXES[role]] = 0.0


def membership(faces: NDArray[np.int32], face_patch: NDArray[np.int64], vertex_count: int, patch_count: int) -> NDArray[np.bool_]:
    """Which patches each vertex belongs to, (V, P): those of the faces around it."""
    member = np.zeros((vertex_count, patch_count), bool)
    for corner in range(faces.shape[1]):
        member[faces[:, corner], face_patch] = True
    return member


# ---------------------------------------------------------------------------------------------------------------- surfaces
def object_surface(body: Body, *, edge_length: Sizes | float, chord: float = 1e-5, symmetry: frozenset[str] = frozenset()) -> TriMesh:
    """A watertight, outward surface of the object in its own frame.

    Args:
        edge_length: Longest edge allowed [m], a number or a function of points (N, 3). A `mesh` shape keeps its facets.
        chord: Largest distance allowed between an edge and the exact shape [m].
        symmetry: Mirror planes of the shape; only the positive side is returned, closed by the planes.
    Raises:
        SceneError: The shape fields make no solid, or the mesh file is no watertight solid.
    """
    if body.shape == "mesh":
        assert not symmetry
        return load_mesh(body)[0]
    vertices, faces, _ = solid_surface(solid(body, symmetry), edge_length, chord)
    return TriMesh(vertices, faces)


def solid_surface(shape: Solid, edge_length: Sizes | float, chord: float) -> tuple[Array, NDArray[np.int32], NDArray[np.int64]]:
    """Vertices, outward faces and the patch of each face; edges at most `edge_length` long and `chord` from the exact shape [m]."""
    from scipy.spatial import ConvexHull

    vertices = shape.hull
    for options in ("Qt", "QJ"):  # joggled input never leaves a degenerate facet, should the triangulated one be no surface
        hull = ConvexHull(vertices, qhull_options=options)
        faces = hull.simplices.astype(np.int32)
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flip = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0
        faces[flip] = faces[flip][:, ::-1]
        if is_closed(faces):
            break
    sizes = edge_length if callable(edge_length) else lambda p: np.full(len(p), edge_length)
    patch = classify(shape.patches, vertices, faces, 1e-9)
    for _ in range(60):
        edges, index = edges_of(faces, FACE_EDGES)
        member = np.zeros((len(edges), len(shape.patches)), bool)
        for side in range(3):
            member[index[:, side], patch] = True
        ends = vertices[edges]
        straight = ends.mean(axis=1)
        middle = snap(shape.patches, straight, member)
        zero_cuts(shape, middle, member)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        split = (length > sizes(middle)) | (np.linalg.norm(middle - straight, axis=1) > chord)
        if not split.any():
            return vertices, faces, patch
        # A face may only be cut through its longest edge first; the index breaks ties the same way on both sides of an edge.
        longest = index[np.arange(len(faces)), np.lexsort((index, length[index]), axis=1)[:, -1]]
        while True:
            more = split[index].any(axis=1) & ~split[longest]
            if not more.any():
                break
            split[longest[more]] = True
        number = np.full(len(edges), -1)
        number[split] = len(vertices) + np.arange(int(split.sum()))
        vertices = np.vstack([vertices, middle[split]])
        faces, patch = _bisected(faces, patch, index, longest, number)
        if len(faces) > 2_000_000:
            raise SceneError(f"the surface needs more than 2 million faces at edges of {np.min(sizes(vertices)) / MM:g} mm")
    return vertices, faces, patch


def _bisected(faces, patch, index, longest, number):  # type: ignore[no-untyped-def]
    """Faces cut at their marked edges (number >= 0), the longest first."""
    start = np.argmax(index == longest[:, None], axis=1)
    turn = (start[:, None] + np.arange(3)) % 3
    rows = np.arange(len(faces))[:, None]
    a, b, c = faces[rows, turn].T  # ab is the longest edge
    ab, bc, ca = number[index[rows, turn]].T
    keep = ab < 0
    out, tag = [np.stack([a, b, c], 1)[keep]], [patch[keep]]
    for one, two, tip, side in ((a, ab, c, ca), (ab, b, c, bc)):  # the halves (a, ab, c) and (ab, b, c)
        whole, cut = ~keep & (side < 0), ~keep & (side >= 0)
        out.append(np.stack([one, two, tip], 1)[whole])
        if side is ca:
            out += [np.stack([a, ab, ca], 1)[cut], np.stack([ca, ab, c], 1)[cut]]
        else:
            out += [np.stack([ab, b, bc], 1)[cut], np.stack([ab, bc, c], 1)[cut]]
        tag += [patch[whole], patch[cut], patch[cut]]
    return np.vstack(out).astype(np.int32), np.concatenate(tag)


def is_closed(faces: NDArray[np.int32]) -> bool:
    """Whether every edge is walked exactly once in each direction."""
    forward = faces[:, FACE_EDGES].reshape(-1, 2).astype(np.int64)
    span = int(faces.max()) + 1
    there, back = forward[:, 0] * span + forward[:, 1], forward[:, 1] * span + forward[:, 0]
    return len(np.unique(there)) == len(there) and np.array_equal(np.sort(there), np.sort(back))


def rigid_surface(scene: Scene, symmetry: frozenset[str]) -> QuadraticSurface:
    """Six-node faces of a rigid object in its own frame, mid-side nodes on the exact shape; the base and the cut planes are left out.

    Edges are 0.25 mm from the apex up to the depth of the press, and grow by half a millimetre per millimetre from there.
    """
    body = scene.object
    depth = press_depth(scene)
    fine, growth = 0.25 * MM, 0.5

    if body.shape == "mesh":
        return quadratic_faces(load_mesh(body)[0].vertices, load_mesh(body)[0].faces)
    shape = solid(body, symmetry)

    def sizes(points: Array) -> Array:
        return fine + growth * np.maximum(points[:, 2] - 1.5 * depth, 0.0) + 0.1 * np.maximum(np.hypot(points[:, 0], points[:, 1]) - 4 * MM, 0.0)

    vertices, faces, patch = solid_surface(shape, sizes, np.inf)
    contact = np.array([role == "contact" for role in shape.roles])[patch]
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
    return QuadraticSurface(np.vstack([vertices, middle]), surface.faces)


def project(body: Body, points: Array) -> Array:
    """Closest points (N, 3) on the exact surface of the object; a `mesh` shape returns the points as they are."""
    check_body(body)
    if body.shape == "mesh":
        return points.copy()
    patches = solid(body).patches
    if body.shape == "corner":
        return _project_polyhedron(solid(body), points)
    h = body.height_mm * MM
    segments = _profile(body)
    boundary = Sweep((*segments, Segment(segments[-1].end, (0.0, h))), body.shape in TURNED)
    if body.shape in TURNED:
        return boundary.project(points)
    half = _length(body) / 2
    side = boundary.project(points)
    side[:, 1] = np.clip(side[:, 1], -half, half)
    across, flat, normal = boundary._closest(points)
    inside = ((np.stack([across, points[:, 2]], 1) - flat) * normal).sum(axis=1) <= 0.0
    end = np.where(inside[:, None], points, side)
    end[:, 1] = np.where(points[:, 1] < 0.0, -half, half)
    assert len(patches) > 2
    nearer = ((end - points) ** 2).sum(axis=1) < ((side - points) ** 2).sum(axis=1)
    return np.where(nearer[:, None], end, side)


def _project_polyhedron(shape: Solid, points: Array) -> Array:
    """Closest points on a convex polyhedron: on a plane where that point lies in the solid, else on an edge, else a corner."""
    normals = np.array([p.normal for p in shape.patches if isinstance(p, Plane)])
    offsets = np.array([p.offset for p in shape.patches if isinstance(p, Plane)])
    best, distance = points.copy(), np.full(len(points), np.inf)
    for count in (1, 2, 3):
        for some in combinations(range(len(normals)), count):
            a = normals[list(some)]
            if np.linalg.matrix_rank(a, tol=1e-9) < count:
                continue
            found = points - (points @ a.T - offsets[list(some)]) @ np.linalg.pinv(a).T
            away = np.linalg.norm(found - points, axis=1)
            better = (away < distance) & (found @ normals.T <= offsets + 1e-12).all(axis=1)
            best[better], distance[better] = found[better], away[better]
    return best


# ---------------------------------------------------------------------------------------------------------------- gel and placement
def press_depth(scene: Scene) -> float:
    """The approach that meshes are made for [m]: the press depth, or 1 mm when only a force is given."""
    return (1.0 if scene.press.depth_mm is None else scene.press.depth_mm) * MM


def check_gel(gel: Gel) -> None:
    """Raises SceneError where the gel's fields make no solid."""
    if gel.profile not in ("dome", "flat"):
        raise SceneError(f'gel.profile = "{gel.profile}" is unknown; allowed: dome, flat')
    for value in gel.size_mm:
        if not 1.0 <= value <= 200.0:
            raise SceneError(f"gel.size_mm = {value:g} mm; allowed: 1 to 200 mm")
    if not 0.1 <= gel.thickness_mm <= 50.0:
        raise SceneError(f"gel.thickness_mm = {gel.thickness_mm:g} mm; allowed: 0.1 to 50 mm")
    if gel.profile == "dome" and not 0.0 < gel.edge_thickness_mm <= gel.thickness_mm:
        raise SceneError(f"gel.edge_thickness_mm = {gel.edge_thickness_mm:g} mm; allowed: above 0 up to thickness_mm = {gel.thickness_mm:g} mm")


def gel_height(gel: Gel, xy: Array) -> Array:
    """z [m] of the undeformed outer face at points (N, 2) [m].

    Flat: 0. Dome: a spherical cap with its top at the origin that leaves `edge_thickness_mm` at the middle of the sides at x = ±size/2 (and at y
    for a square gel; on a rectangle the longer half width sets the sphere). The corners of a square lie deeper on the sphere than the
    middles of its sides, for the default dome even below the window: there the gel keeps a land of half the edge thickness.
    """
    check_gel(gel)
    if gel.profile == "flat" or gel.edge_thickness_mm == gel.thickness_mm:
        return np.zeros(len(xy))
    half = max(gel.size_mm) * MM / 2
    drop = (gel.thickness_mm - gel.edge_thickness_mm) * MM
    radius = (half**2 + drop**2) / (2 * drop)
    across = (xy**2).sum(axis=1)
    sphere = np.sqrt(np.maximum(radius**2 - across, 0.0)) - radius
    return np.maximum(sphere, (0.5 * gel.edge_thickness_mm - gel.thickness_mm) * MM)


def rotation(scene: Scene) -> Array:
    """The object's tilt, (3, 3): about x, then about y."""
    a, b = np.radians(scene.press.tilt_deg)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return about_y @ about_x


def placement(scene: Scene, surface: QuadraticSurface) -> tuple[Array, Array]:
    """Where the object just touches the undeformed gel: positions = R p + t, R (3, 3), t (3,) [m].

    R is the tilt about the apex, t the offset and the height at which the smallest gap between the object's six-node faces and the gel's outer
    face is 0 (to 0.01 µm; sought between the nodes too). Only what lies over the gel counts.

    Raises:
        SceneError: No part of the object lies over the gel.
    """
    turn = rotation(scene)
    shift = np.array([*scene.press.offset_mm, 0.0]) * MM
    nodes = surface.nodes @ turn.T + shift
    half = np.array(scene.gel.size_mm) * MM / 2 * (1 + 1e-9)

    def gap(points: Array) -> Array:
        over = (np.abs(points[..., :2]) <= half).all(axis=-1)
        flat = points.reshape(-1, 3)
        return np.where(over, (flat[:, 2] - gel_height(scene.gel, flat[:, :2])).reshape(over.shape), np.inf)

    at_nodes = gap(nodes)[surface.faces]
    low = at_nodes.min(axis=1)
    best = low.min()
    if not np.isfinite(best):
        raise SceneError(
            f"press.offset_mm = [{scene.press.offset_mm[0]:g}, {scene.press.offset_mm[1]:g}] mm puts the object beside the gel; "
            f"allowed: some of it over the {scene.gel.size_mm[0]:g} x {scene.gel.size_mm[1]:g} mm gel"
        )
    # Between its nodes a quadratic face can dip below the lowest of them by at most the spread of its nodes; look where it could matter.
    over = np.isfinite(low)
    at_nodes, low, faces = at_nodes[over], low[over], surface.faces[over]
    spread = np.where(np.isfinite(at_nodes), at_nodes, low[:, None]).max(axis=1) - low
    near = np.flatnonzero(low - spread <= best)
    faces = faces[near[np.argsort(low[near])[:2000]]]
    width, centre = 1.0, np.full((len(faces), 2), 1.0 / 3.0)
    steps = np.linspace(-1.0, 1.0, 7)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    for _ in range(12):  # each pass halves the window around the best point of each face: 2^-12 of a face is below a micrometre, the gap is flat there
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
    return turn, shift


# ---------------------------------------------------------------------------------------------------------------- meshes from files
def load_mesh(body: Body) -> tuple[TriMesh, dict[str, object]]:
    """The watertight surface of shape = "mesh", outward, lowest point at the origin, and what was done to it.

    Raises:
        SceneError: File missing, too large, not a surface, not watertight, or of a size that suggests another unit.
    """
    check_body(body)
    path = Path(str(body.mesh)).expanduser()
    try:
        stat = path.stat()
    except OSError as error:
        raise SceneError(f'object.mesh = "{path}" cannot be read ({error.strerror}); allowed: a watertight STL, OBJ or PLY file') from None
    return _load_mesh(str(path), body.mesh_unit, stat.st_size, stat.st_mtime_ns)


@lru_cache(maxsize=8)
def _load_mesh(path: str, unit: str, size: int, _modified: int) -> tuple[TriMesh, dict[str, object]]:
    import trimesh

    kind = Path(path).suffix.lower().lstrip(".")
    if kind not in ("stl", "obj", "ply"):
        raise SceneError(f'object.mesh = "{path}" is no STL, OBJ or PLY file; allowed: one of these three')
    if unit not in _UNIT_METRES:
        raise SceneError(f'object.mesh_unit = "{unit}" is unknown; allowed: {", ".join(_UNIT_METRES)}')
    if size > _MESH_BYTES:
        raise SceneError(f'object.mesh = "{path}" has {size / 1e6:.0f} MB; allowed: up to {_MESH_BYTES / 1e6:.0f} MB')
    try:
        with open(path, "rb") as file:  # a stream and no resolver: material files that an OBJ names are never opened
            read = trimesh.load_mesh(file, file_type=kind, process=False, skip_materials=True)
        vertices, faces = np.asarray(read.vertices, np.float64), np.asarray(read.faces, np.int64)
    except Exception as error:  # trimesh raises many kinds on a damaged file; each of them is the user's file
        raise SceneError(f'object.mesh = "{path}" cannot be read as {kind.upper()} ({type(error).__name__}); allowed: a triangle surface') from None
    if not len(faces) or not np.isfinite(vertices).all():
        raise SceneError(f'object.mesh = "{path}" holds {len(faces)} faces and non-finite numbers or none; allowed: a triangle surface')
    if len(faces) > _MESH_FACES:
        raise SceneError(f'object.mesh = "{path}" has {len(faces)} faces; allowed: up to {_MESH_FACES}')
    mesh = trimesh.Trimesh(vertices * _UNIT_METRES[unit], faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    extent = mesh.extents if len(mesh.faces) else np.zeros(3)
    if extent.min() < _MESH_EXTENT[0] or extent.max() > _MESH_EXTENT[1]:
        fits = [u for u, m in _UNIT_METRES.items() if (e := extent / _UNIT_METRES[unit] * m).min() >= _MESH_EXTENT[0] and e.max() <= _MESH_EXTENT[1]]
        hint = f'; with object.mesh_unit = "{fits[0]}" it would fit' if fits else ""
        text = " x ".join(f"{1e3 * e:.4g}" for e in extent)
        raise SceneError(f'object.mesh = "{path}" is {text} mm when read in {unit}; allowed: 0.5 to 100 mm in each direction{hint}')
    if not mesh.is_watertight:
        lone = len(mesh.edges_unique) - len(mesh.face_adjacency)
        raise SceneError(f'object.mesh = "{path}" is not watertight ({lone} open edges); allowed: a closed surface: close it in the program it came from')
    done: dict[str, object] = {"file_faces": len(faces)}
    if not mesh.is_winding_consistent:
        mesh.fix_normals()
        done["reoriented"] = True
    if mesh.volume < 0:
        mesh.invert()
        done["turned_inside_out"] = True
    if not mesh.is_winding_consistent or mesh.volume <= 1e-3 * _MESH_EXTENT[0] ** 3:
        raise SceneError(f'object.mesh = "{path}" encloses {mesh.volume * 1e9:.3g} mm³; allowed: a closed surface that encloses a volume')
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) > 20_000:
        vertices, faces = _thinned(vertices, faces)
        done["thinned_to_faces"] = len(faces)
    lowest = vertices[:, 2].min()
    tip = vertices[vertices[:, 2] <= lowest + 1e-7]
    vertices = vertices - np.array([*(tip.min(axis=0) + tip.max(axis=0))[:2] / 2, lowest])
    return TriMesh(vertices, faces.astype(np.int32)), done


def _thinned(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """The same surface within `_MESH_TOLERANCE` with fewer faces; as it was where manifold3d takes it for no manifold."""
    import manifold3d

    solid3 = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    if solid3.status() != manifold3d.Error.NoError:
        return vertices, faces
    thin = solid3.simplify(_MESH_TOLERANCE).to_mesh64()
    return np.asarray(thin.vert_properties)[:, :3], np.asarray(thin.tri_verts).astype(np.int64)


def enclosed_volume(surface: TriMesh) -> float:
    """Volume [m³] inside a closed surface of flat faces (divergence theorem)."""
    points = np.vstack([surface.vertices, surface.vertices.mean(axis=0)])
    cells = np.hstack([np.full((len(surface.faces), 1), len(surface.vertices)), surface.faces])
    return float(tet_volumes(points, cells.astype(np.int32)).sum())
