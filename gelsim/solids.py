"""Convex solids bounded by smooth patches, and triangles on them that lie exactly where they should.

A patch is a plane, or a profile of lines and circular arcs turned about z or drawn along y. Every patch knows the closest point on itself,
so that vertices and mid-side nodes can be put where they belong; a point on a crease lies on both patches at once and is found by
alternating projections (von Neumann 1950: they converge linearly, with the squared cosine of the angle between the patches).

Triangles come from the convex hull of a few points of the solid, refined by longest-edge bisection (Rivara 1984) until every edge is as
short as asked and every chord as close to the solid as asked; new vertices go onto the patches of the faces that meet there.

Left out: solids that are not convex, fillets.
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
        angle = np.linspace(low, high, 1 + max(2, int(np.ceil((high - low) / HULL_STEP))))
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


def solid_surface(shape: Solid, edge_length: Sizes | float, chord: Sizes | float) -> tuple[Array, NDArray[np.int32], NDArray[np.int64]]:
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
        while True:
            more = split[index].any(axis=1) & ~split[longest]
            if not more.any():
                break
            split[longest[more]] = True
        number = np.full(len(edges), -1)
        number[split] = len(vertices) + np.arange(int(split.sum()))
        vertices = np.vstack([vertices, middle[split]])
        faces, patch = bisected(faces, patch, index, longest, number)
        if len(faces) > 2_000_000:
            raise SceneError(f"the surface needs more than 2 million faces at edges of {np.min(sizes(vertices)) / MM:g} mm")
    return vertices, faces, patch


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


def project_polyhedron(shape: Solid, points: Array) -> Array:
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
        while True:
            more = split[index].any(axis=1) & ~split[longest]
            if not more.any():
                break
            split[longest[more]] = True
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
