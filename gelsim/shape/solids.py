"""Solids bounded by smooth patches, and triangles on them that lie exactly where they should.

A patch is a plane, planes rounded where they meet, a ball, a height field, or a profile of lines and circular arcs turned about z or drawn
along y. Every patch knows a
point on itself near any other (of all but a height field the closest), so that vertices and mid-side nodes can be put where they belong; a
point on a crease lies on both patches at once and is found by alternating projections (von Neumann 1950: they converge linearly, with the
squared cosine of the angle between the patches).

Triangles come from the convex hull of a few points of the solid, or where it is not convex from a coarse surface that it brings, refined by
longest-edge bisection (Rivara 1984) until every edge is as short as asked and every chord as close to the solid as asked; new vertices go
onto the patches of the faces that meet there.

Left out: other fillets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.geometry import AXES, FACE_EDGES, edges_of, is_closed
from gelsim.units import MM

Array = NDArray[np.float64]
Sizes = Callable[[Array], Array]

HULL_STEP = np.radians(15.0)
"""Angle between the points of an arc that the convex hull starts from."""


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
    """A piece of a profile in the (r, z) half plane, walked with the solid on the left: a line, or an arc."""

    start: tuple[float, float]
    end: tuple[float, float]
    radius: float = 0.0
    """Of an arc [m]: positive of a bulge, negative where the solid lies around it; 0 for a line."""
    centre: tuple[float, float] | None = None
    """Of an arc [m]; unless given on the axis, |radius| above the apex."""

    def _middle(self) -> Array:
        return np.array(self.centre or (0.0, abs(self.radius)))

    def _angles(self) -> tuple[float, float]:
        """Of start and end, from straight down."""
        away = np.subtract((self.start, self.end), self._middle())
        return float(np.arctan2(away[0, 0], -away[0, 1])), float(np.arctan2(away[1, 0], -away[1, 1]))

    def on_circle(self, within: float) -> bool:
        """Whether the ends of an arc are as far from its centre as its radius, within a length [m]."""
        away = np.linalg.norm(np.subtract((self.start, self.end), self._middle()), axis=1)
        return not self.radius or bool(np.all(np.abs(away - abs(self.radius)) <= within))

    def way(self, end: int) -> Array:
        """Unit vector (2,) in which it is walked at its start (0) or its end (1)."""
        if not self.radius:
            along = np.subtract(self.end, self.start)
            return along / np.linalg.norm(along)
        angles = self._angles()
        return np.sign(angles[1] - angles[0]) * np.array([np.cos(angles[end]), np.sin(angles[end])])

    def project(self, points: Array) -> tuple[Array, Array]:
        """Closest points and outward normals, both (N, 2)."""
        start, end = np.array(self.start), np.array(self.end)
        if self.radius:
            middle, size = self._middle(), abs(self.radius)
            away = points - middle
            low, high = sorted(self._angles())
            angle = np.clip(np.arctan2(away[:, 0], -away[:, 1]), low, high)
            outward = np.stack([np.sin(angle), -np.cos(angle)], axis=1)
            return middle + size * outward, np.sign(self.radius) * outward
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
        normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
        return start + share[:, None] * along, np.broadcast_to(normal, points.shape)

    def crossings(self, points: Array) -> NDArray[np.int_]:
        """How often the ray outward (+r) from each point (N, 2) crosses this piece: of a closed outline it is odd inside."""
        z = points[:, 1]
        if not self.radius:
            (r0, z0), (r1, z1) = self.start, self.end
            r = r0 + (z - z0) / ((z1 - z0) or 1.0) * (r1 - r0)
            return ((z >= min(z0, z1)) & (z < max(z0, z1)) & (r > points[:, 0])).astype(int)
        middle, size = self._middle(), abs(self.radius)
        low, high = sorted(self._angles())
        count = np.zeros(len(points), int)
        for side, one, two in ((-1.0, low, min(high, 0.0)), (1.0, max(low, 0.0), high)):  # z rises on both sides of straight down
            if one < two:
                bottom, top = sorted(middle[1] - size * np.cos([one, two]))
                r = middle[0] + side * np.sqrt(np.maximum(size**2 - (z - middle[1]) ** 2, 0.0))
                count += (z >= bottom) & (z < top) & (r > points[:, 0])
        return count

    def tangents(self) -> tuple[Array, Array]:
        if self.radius:
            one, two = (np.sign(self.radius) * np.array([np.cos(angle), np.sin(angle)]) for angle in self._angles())
            return one, two
        along = np.subtract(self.end, self.start)
        along = along / np.linalg.norm(along)
        return along, along

    def samples(self) -> Array:
        """A few points from start to end, for a coarse surface."""
        if not self.radius:
            return np.array([self.start, self.end])
        low, high = self._angles()
        angle = np.linspace(low, high, 1 + max(2, int(np.ceil(abs(high - low) / HULL_STEP))))
        points = self._middle() + abs(self.radius) * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
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


@dataclass(frozen=True)
class Ball:
    """A sphere, the solid inside."""

    centre: tuple[float, float, float]
    radius: float

    def project(self, points: Array) -> Array:
        return np.array(self.centre) + self.radius * self.normals(points)

    def normals(self, points: Array) -> Array:
        away = points - np.array(self.centre)
        return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)


@dataclass(frozen=True)
class Rounded:
    """The smooth surface a radius away from the convex body below three planes that meet: these, their edges and their corner rounded."""

    planes: tuple[Plane, Plane, Plane]
    """Of the body within."""
    radius: float

    def outward(self, points: Array) -> tuple[Array, Array]:
        """Closest points on the body within and unit vectors out of it there, both (N, 3)."""
        normals, offsets = (np.array([getattr(plane, name) for plane in self.planes]) for name in ("normal", "offset"))
        beyond, within = points @ normals.T - offsets, project_polyhedron(self.planes, points)
        away = np.sign(beyond.max(axis=1, keepdims=True)) * (points - within)
        size = np.linalg.norm(away, axis=1, keepdims=True)
        return within, np.where(size > 1e-12, away / np.maximum(size, 1e-300), normals[beyond.argmax(axis=1)])

    def project(self, points: Array) -> Array:
        within, outward = self.outward(points)
        return within + self.radius * outward

    def normals(self, points: Array) -> Array:
        return self.outward(points)[1]


@dataclass(frozen=True)
class HeightField:
    """z = level + Σ a cos(kx x + ky y + phase), the solid above it. Points are put on it straight up or down."""

    level: float
    waves: tuple[tuple[float, float, float, float], ...]
    """(kx, ky [1/m], phase, a [m])."""

    def heights(self, xy: Array) -> tuple[Array, Array]:
        """z (N,) and its slopes (N, 2) at points (N, 2)."""
        kx, ky, phase, size = np.array(self.waves).T
        angle = xy[:, :1] * kx + xy[:, 1:2] * ky + phase
        falling = -size * np.sin(angle)
        return self.level + np.cos(angle) @ size, np.stack([falling @ kx, falling @ ky], axis=1)

    def project(self, points: Array) -> Array:
        out = points.copy()
        out[:, 2] = self.heights(points[:, :2])[0]
        return out

    def normals(self, points: Array) -> Array:
        slopes = self.heights(points[:, :2])[1]
        down = np.column_stack([slopes, -np.ones(len(points))])
        return down / np.linalg.norm(down, axis=1, keepdims=True)


Patch = Plane | Rounded | Sweep | Ball | HeightField


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape, or the part of it on the positive side of its cut planes."""

    patches: tuple[Patch, ...]
    roles: tuple[str, ...]
    """Of each patch: "contact", "base", or the cut plane "x" or "y"."""
    hull: Array
    """Corners of a coarse polyhedron inscribed in it, (P, 3)."""
    faces: NDArray[np.int32] | None = None
    """Its outward triangles, (F, 3), for a solid that is not convex; None: their convex hull."""


def polyhedron(planes: Sequence[Patch]) -> Array:
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
    found[np.abs(found) < 1e-15] = 0.0  # so that corners on a cut plane are exactly on it
    _, first = np.unique(np.round(found, 10), axis=0, return_index=True)
    return found[np.sort(first)]


def patch_distances(patches: tuple[Patch, ...], points: Array) -> Array:
    """Distance [m] of each point to each patch, (N, P)."""
    return np.stack([np.linalg.norm(patch.project(points) - points, axis=1) for patch in patches], axis=1)


def classify(patches: tuple[Patch, ...], vertices: Array, faces: NDArray[np.int32], tolerance: Array | float) -> NDArray[np.int64]:
    """The patch of each face, (F,): among the patches that all three vertices lie on within their `tolerance`, the best aligned one."""
    corners = vertices[faces[:, :3]]
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    allowed = np.broadcast_to(tolerance, len(vertices))
    far = (patch_distances(patches, vertices) / allowed[:, None])[faces[:, :3]].max(axis=1)
    near = far <= np.maximum(1.0, far.min(axis=1, keepdims=True) * (1 + 1e-9))
    aligned = np.stack([(patch.normals(centre) * normal).sum(axis=1) for patch in patches], axis=1)
    return np.argmax(np.where(near, aligned, -np.inf), axis=1)


def snap(patches: tuple[Patch, ...], points: Array, member: NDArray[np.bool_]) -> Array:
    """Moves each point (N, 3) onto all the patches it belongs to, `member` (N, P), by alternating projections."""
    out, crease = points.copy(), member.sum(axis=1) > 1
    for patch, mine in zip(patches, (member & ~crease[:, None]).T, strict=True):
        if mine.any():
            out[mine] = patch.project(points[mine])
    # the few on creases are sorted by their patches
    creased = np.flatnonzero(crease)
    kinds, which = np.unique(member[crease], axis=0, return_inverse=True)
    for kind, row in enumerate(kinds):
        mine = creased[which.ravel() == kind]
        chosen = [patch for patch, wanted in zip(patches, row, strict=True) if wanted]
        moving = out[mine]
        for _ in range(400):
            before = moving
            for patch in chosen:
                moving = patch.project(moving)
            if np.abs(moving - before).max() < 1e-15:
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


def _split_longest_first(split: NDArray[np.bool_], index: NDArray[np.integer], longest: NDArray[np.integer]) -> None:
    """Marks also the longest edge of every face (its edges `index` (F, 3)) of which another is to be split, until no more are marked."""
    while (more := split[index].any(axis=1) & ~split[longest]).any():
        split[longest[more]] = True


def solid_surface(shape: Solid, edge_length: Sizes | float, chord: Sizes | float) -> tuple[Array, NDArray[np.int32], NDArray[np.int64]]:
    """Vertices, outward faces and the patch of each face; edges at most `edge_length` long and `chord` from the exact shape [m]."""
    vertices, faces = (shape.hull, shape.faces) if shape.faces is not None else _hull(shape.hull)
    sizes, chords = (given if callable(given) else lambda p, given=given: np.full(len(p), given) for given in (edge_length, chord))
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
        split = (length > sizes(middle)) | (np.linalg.norm(middle - straight, axis=1) > chords(middle))
        if not split.any():
            return vertices, faces, patch
        # A face may only be cut through its longest edge first; the index breaks ties the same way on both sides of an edge.
        longest = index[np.arange(len(faces)), np.lexsort((index, length[index]), axis=1)[:, -1]]
        _split_longest_first(split, index, longest)
        number = np.full(len(edges), -1)
        number[split] = len(vertices) + np.arange(int(split.sum()))
        vertices = np.vstack([vertices, middle[split]])
        faces, patch = bisected(faces, patch, index, longest, number)
        if len(faces) > 2_000_000:
            raise SceneError(f"the surface needs more than 2 million faces at edges of {np.min(sizes(vertices)) / MM:g} mm")
    return vertices, faces, patch


def _hull(vertices: Array) -> tuple[Array, NDArray[np.int32]]:
    """The convex hull's outward triangles."""
    from scipy.spatial import ConvexHull

    for options in ("Qt", "QJ"):  # joggled input never leaves a degenerate facet, should the triangulated one be no surface
        hull = ConvexHull(vertices, qhull_options=options)
        faces = hull.simplices.astype(np.int32)
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flip = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0
        faces[flip] = faces[flip][:, ::-1]
        if is_closed(faces):
            break
    return vertices, faces


def bisected(faces, patch, index, longest, number):  # type: ignore[no-untyped-def]
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


def swept(outline: Array, turned: bool, length: float, step: float) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and outward faces of the quarter x, y >= 0 of a solid whose profile need not be convex.

    Args:
        outline: (P, 2), the profile as a closed polygon in the half plane (r or x, z), solid on the left; edges on the axis among it.
        turned: About z, in steps of at most `step` [rad]; else drawn along y to `length` [m].
    """
    from manifold3d import triangulate

    count = len(outline)
    across, up = outline.T
    if turned:
        azimuth = np.linspace(0.0, np.pi / 2, 1 + int(np.ceil(np.pi / 2 / step - 1e-9)))
        circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        circle[np.abs(circle) < 1e-12] = 0.0
        rings = [np.column_stack([np.outer(across, direction), up]) for direction in circle]
    else:
        rings = [np.column_stack([across, np.full(count, y), up]) for y in (0.0, length)]
    last = count * (len(rings) - 1)
    cap = np.array(triangulate([outline]))
    begin, end = cap, cap[:, ::-1] + last
    one = np.arange(count)
    two = np.roll(one, -1)
    if turned:  # what lies on the axis sweeps nothing
        one, two = one[(across[one] > 0) | (across[two] > 0)], two[(across[one] > 0) | (across[two] > 0)]
    walls = []
    for ring in range(len(rings) - 1):
        a, b, c, d = one + ring * count, two + ring * count, two + (ring + 1) * count, one + (ring + 1) * count
        walls += [np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]
    return welded(np.vstack(rings), np.vstack([begin, end, *walls]))


def welded(vertices: Array, faces: NDArray[np.integer]) -> tuple[Array, NDArray[np.int32]]:
    """Vertices at one place (to a picometre) made one; faces that lost a corner by it are dropped."""
    _, first, index = np.unique(np.round(vertices * 1e12), axis=0, return_index=True, return_inverse=True)
    faces = index.ravel()[faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[first], faces[whole].astype(np.int32)


def mirrored(vertices: Array, faces: NDArray[np.int32], axis: str) -> tuple[Array, NDArray[np.int32]]:
    """A closed surface cut at the plane `axis` = 0 together with its image, the cut left out."""
    column = AXES[axis]
    faces = faces[~(vertices[faces][:, :, column] == 0.0).all(axis=1)]
    image = vertices.copy()
    image[:, column] = 0.0 - image[:, column]
    return welded(np.vstack([vertices, image]), np.vstack([faces, faces[:, ::-1] + len(vertices)]))


def project_polyhedron(planes: Sequence[Patch], points: Array) -> Array:
    """Closest points on the convex body below all planes: on a plane where that point lies in the body, else on an edge, else a corner."""
    normals = np.array([p.normal for p in planes if isinstance(p, Plane)])
    offsets = np.array([p.offset for p in planes if isinstance(p, Plane)])
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


def refine(vertices: Array, faces: NDArray[np.int32], sizes: Sizes, arcs: Sequence[Segment] = ()) -> tuple[Array, NDArray[np.int32]]:
    """Triangles of the plane, (V, 2) and (F, 3), bisected at their longest edges until each is as short as `sizes` says at its middle [m].

    New points of boundary edges between two points of an arc go onto it.
    """
    for _ in range(60):
        edges, index = edges_of(faces, FACE_EDGES)
        middle = edge_middles(vertices, edges, index, arcs)
        length = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
        split = length > sizes(middle)
        if not split.any():
            return vertices, faces
        # the longest edge goes first; the index breaks ties the same way on both sides
        longest = index[np.arange(len(faces)), np.lexsort((index, np.round(length[index] * 1e12)), axis=1)[:, -1]]
        _split_longest_first(split, index, longest)
        number = np.full(len(edges), -1)
        number[split] = len(vertices) + np.arange(int(split.sum()))
        vertices = np.vstack([vertices, middle[split]])
        faces, _ = bisected(faces, np.zeros(len(faces), np.int64), index, longest, number)
    raise SceneError(f"a profile needs more than {len(faces)} triangles")


def edge_middles(vertices: Array, edges: NDArray[np.int64], index: NDArray[np.int64], arcs: Sequence[Segment]) -> Array:
    """Middles (E, 2) of edges of the plane, numbered by triangle in `index` (F, 3); those of boundary edges on an arc lie on it."""
    middle = vertices[edges].mean(axis=1)
    outer = np.flatnonzero(np.bincount(index.ravel(), minlength=len(edges)) == 1)
    for arc in arcs:
        ends = vertices[edges[outer]].reshape(-1, 2)
        on = (np.linalg.norm(arc.project(ends)[0] - ends, axis=1) < 1e-9).reshape(-1, 2).all(axis=1)
        middle[outer[on]] = arc.project(middle[outer[on]])[0]
    return middle
