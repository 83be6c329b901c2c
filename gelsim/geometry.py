"""Surfaces and solids as arrays, and measures of their quality. Plain NumPy, SI units.

`TriMesh` is a flat-faced surface. `QuadraticSurface` has six nodes a face, so that it can be curved; contact works on it. `TetMesh` is
made of ten-node tetrahedra whose mid-side nodes may lie on a curved boundary (isoparametric). Node order of a ten-node tet: vertices 0-3,
then the middles of the edges 01, 12, 02, 03, 13, 23 (VTK_QUADRATIC_TETRA); of a six-node face: vertices 0-2, then the middles of 01, 12,
20.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

TET_EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
# Faces of a positively oriented tet, outward; as local indices of the six-node face.
TET_FACES = np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [2, 0, 3, 6, 7, 9]])
FACE_EDGES = np.array([[0, 1], [1, 2], [2, 0]])


@dataclass(frozen=True, eq=False)
class TriMesh:
    """A surface of flat triangles, counter-clockwise seen from outside."""

    vertices: NDArray[np.float64]
    """Positions [m], shape (V, 3)."""
    faces: NDArray[np.int32]
    """Vertex indices, shape (F, 3)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", np.ascontiguousarray(self.vertices, np.float64))
        object.__setattr__(self, "faces", np.ascontiguousarray(self.faces, np.int32))
        assert self.vertices.ndim == 2 and self.vertices.shape[1] == 3
        assert self.faces.ndim == 2 and self.faces.shape[1] == 3


@dataclass(frozen=True, eq=False)
class QuadraticSurface:
    """A surface of six-node triangles, counter-clockwise seen from outside."""

    nodes: NDArray[np.float64]
    """Positions [m], shape (N, 3)."""
    faces: NDArray[np.int32]
    """Node indices, shape (F, 6)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", np.ascontiguousarray(self.nodes, np.float64))
        object.__setattr__(self, "faces", np.ascontiguousarray(self.faces, np.int32))
        assert self.nodes.ndim == 2 and self.nodes.shape[1] == 3
        assert self.faces.ndim == 2 and self.faces.shape[1] == 6


@dataclass(frozen=True, eq=False)
class TetMesh:
    """A solid of ten-node tetrahedra.

    `symmetry` names the mirror planes of which the mesh is only the positive side: "x" is the plane x = 0. Nodes on such a plane have
    exactly 0 in that coordinate.
    """

    rest_positions: NDArray[np.float64]
    """Node positions [m], shape (N, 3)."""
    tets: NDArray[np.int32]
    """Node indices, shape (T, 10), positively oriented."""
    groups: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Named sets of boundary faces, each (F, 6). Gel: "bonded", "coated", "side". Object: "base", "contact"."""
    symmetry: frozenset[str] = frozenset()
    regions: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    """Which material each tet is of, shape (T,): an index into the object's parts (`materials.parts`). Left out: all of the first."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "rest_positions", np.ascontiguousarray(self.rest_positions, np.float64))
        object.__setattr__(self, "tets", np.ascontiguousarray(self.tets, np.int32))
        regions = self.regions if len(self.regions) else np.zeros(len(self.tets))
        object.__setattr__(self, "regions", np.ascontiguousarray(regions, np.int32))
        assert self.regions.shape == (len(self.tets),)
        assert self.rest_positions.ndim == 2 and self.rest_positions.shape[1] == 3
        assert self.tets.ndim == 2 and self.tets.shape[1] == 10

    def surface(self, group: str) -> QuadraticSurface:
        """The faces of one group with a node numbering of their own (in order of first index)."""
        faces = self.groups[group]
        used, local = np.unique(faces, return_inverse=True)
        return QuadraticSurface(self.rest_positions[used], local.reshape(faces.shape).astype(np.int32))


@dataclass(frozen=True, eq=False)
class PlanarMesh:
    """A profile of six-node triangles: the half x ≥ 0 of a cross-section, turned about z or drawn along y."""

    nodes: NDArray[np.float64]
    """(r, z) or (x, z) [m], shape (N, 2); on the axis exactly 0."""
    triangles: NDArray[np.int32]
    """Node indices, shape (T, 6), counter-clockwise with x to the right and z up; none for a rigid object."""
    groups: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Named sets of boundary edges (start, end, middle), each (E, 3), the solid on the left; as of `TetMesh`."""
    regions: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    """Of which material each triangle is, shape (T,): 0 unless given."""

    def __post_init__(self) -> None:
        regions = self.regions if len(self.regions) else np.zeros(len(self.triangles))
        object.__setattr__(self, "regions", np.ascontiguousarray(regions, np.int32))
        assert self.regions.shape == (len(self.triangles),)


def tet_volumes(vertices: NDArray[np.float64], tets: NDArray[np.int32]) -> NDArray[np.float64]:
    """Signed volumes [m³] of straight tets, shape (T,), from the first four nodes of each."""
    a, b, c, d = (vertices[tets[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0


def tet_quality(vertices: NDArray[np.float64], tets: NDArray[np.int32]) -> NDArray[np.float64]:
    """Mean-ratio quality of straight tets, shape (T,): 1 for a regular tet, 0 flat, negative inside out.

    q = 12 (3 V)^(2/3) / Σ_edges l² (Liu and Joe 1994).
    """
    volume = tet_volumes(vertices, tets)
    edges = vertices[tets[:, TET_EDGES[:, 0]]] - vertices[tets[:, TET_EDGES[:, 1]]]
    return 12.0 * np.cbrt(9.0 * volume**2) * np.sign(volume) / np.einsum("tij,tij->t", edges, edges)


def outer_faces(tets: NDArray[np.int32]) -> NDArray[np.int32]:
    """The six-node boundary faces of ten-node tets, outward, shape (F, 6)."""
    faces = tets[:, TET_FACES].reshape(-1, 6)
    key = np.sort(faces[:, :3], axis=1)
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


# Mid-side nodes follow their vertices when vertices 0 and 1 trade places, which turns a mirrored tet or face right side out again.
_TET_FLIP = np.array([1, 0, 2, 3, 4, 6, 5, 8, 7, 9])
_FACE_FLIP = np.array([1, 0, 2, 3, 5, 4])
AXES = {"x": 0, "y": 1}


def split_faces(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Each six-node face (F, 6) as four flat triangles over the same nodes, (4F, 3): three corners, then the middle one."""
    corners = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return np.ascontiguousarray(faces[:, corners].reshape(-1, 3), dtype=np.int32)


def edges_of(cells: NDArray[np.int32], local: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Unique edges (E, 2), lower index first, and for each cell the edge of each of its local edges (C, L)."""
    pairs = np.sort(cells[:, local].reshape(-1, 2).astype(np.int64), axis=1)
    span = int(pairs.max()) + 1 if len(pairs) else 1
    keys, inverse = np.unique(pairs[:, 0] * span + pairs[:, 1], return_inverse=True)
    return np.stack([keys // span, keys % span], axis=1), inverse.reshape(len(cells), len(local))


def quadratic_tets(vertices: NDArray[np.float64], tets: NDArray[np.int32]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Straight ten-node tets from four-node ones: nodes (V + E, 3), vertices first, and tets (T, 10)."""
    edges, index = edges_of(tets, TET_EDGES)
    return np.vstack([vertices, vertices[edges].mean(axis=1)]), np.hstack([tets, len(vertices) + index]).astype(np.int32)


def quadratic_faces(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> QuadraticSurface:
    """Straight six-node faces from flat triangles: the middles of the edges come after the vertices."""
    edges, index = edges_of(faces, FACE_EDGES)
    return QuadraticSurface(np.vstack([vertices, vertices[edges].mean(axis=1)]), np.hstack([faces, len(vertices) + index]).astype(np.int32))


def face_shape_functions(barycentric: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (Q, 6) of the six-node face's shape functions at barycentric points (Q, 3)."""
    a, b, c = barycentric.T
    return np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1)


def jacobian_determinants(nodes: NDArray[np.float64], tets: NDArray[np.int32]) -> NDArray[np.float64]:
    """det ∂x/∂ξ [m³] of isoparametric ten-node tets, shape (T, 8): at the four vertices and at the four Gauss points.

    For a straight tet each value is six times its volume; a curved one must keep all of them positive.
    """
    s = (5.0 - np.sqrt(5.0)) / 20.0  # four-point rule of degree 2 (Keast 1986)
    points = np.vstack([np.eye(4), np.full((4, 4), s) + (1.0 - 4.0 * s) * np.eye(4)])
    gradient = np.zeros((8, 10, 4))  # with respect to the four barycentric coordinates
    for vertex in range(4):
        gradient[:, vertex, vertex] = 4.0 * points[:, vertex] - 1.0
    for middle, (i, j) in enumerate(TET_EDGES):
        gradient[:, 4 + middle, i] = 4.0 * points[:, j]
        gradient[:, 4 + middle, j] = 4.0 * points[:, i]
    gradient = gradient[:, :, 1:] - gradient[:, :, :1]
    return np.linalg.det(np.einsum("tni,qnj->tqij", nodes[tets], gradient))


def volume(mesh: TetMesh) -> float:
    """Volume [m³] of a mesh of curved tets. The four-point rule is exact to degree 2; det ∂x/∂ξ has degree 3, so it is exact to O(h⁴)."""
    return float(jacobian_determinants(mesh.rest_positions, mesh.tets)[:, 4:].sum() / 24.0)


def mirror(mesh: TetMesh, axis: str) -> TetMesh:
    """The mesh together with its mirror image in the plane `axis` = 0, which `mesh.symmetry` must name. Nodes on the plane are shared."""
    assert axis in mesh.symmetry, f"mesh is not cut at {axis} = 0"
    nodes, groups, tets = mesh.rest_positions, mesh.groups, mesh.tets
    copy, image = _image(nodes, axis)
    both = {name: np.vstack([faces, image[faces][:, _FACE_FLIP]]).astype(np.int32) for name, faces in groups.items()}
    tets = np.vstack([tets, image[tets][:, _TET_FLIP]]).astype(np.int32)
    return TetMesh(np.vstack([nodes, copy]), tets, both, mesh.symmetry - {axis}, np.tile(mesh.regions, 2))


def flip(mesh: TetMesh, axis: str) -> TetMesh:
    """The mirror image of a whole mesh in the plane `axis` = 0."""
    nodes = mesh.rest_positions.copy()
    nodes[:, AXES[axis]] *= -1.0
    groups = {name: faces[:, _FACE_FLIP] for name, faces in mesh.groups.items()}
    return TetMesh(nodes, mesh.tets[:, _TET_FLIP], groups, mesh.symmetry, mesh.regions)


def mirror_surface(surface: QuadraticSurface, axis: str) -> QuadraticSurface:
    """A surface together with its mirror image in the plane `axis` = 0; nodes exactly on the plane are shared."""
    copy, image = _image(surface.nodes, axis)
    faces = np.vstack([surface.faces, image[surface.faces][:, _FACE_FLIP]]).astype(np.int32)
    return QuadraticSurface(np.vstack([surface.nodes, copy]), faces)


def _image(nodes: NDArray[np.float64], axis: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Mirrored copies of the nodes off the plane, and for every node the index of its image."""
    off = nodes[:, AXES[axis]] != 0.0
    image = np.arange(len(nodes))
    image[off] = len(nodes) + np.arange(int(off.sum()))
    copy = nodes[off].copy()
    copy[:, AXES[axis]] *= -1.0
    return copy, image


def is_closed(faces: NDArray[np.int32]) -> bool:
    """Whether every edge is walked exactly once in each direction."""
    forward = faces[:, FACE_EDGES].reshape(-1, 2).astype(np.int64)
    span = int(faces.max()) + 1
    there, back = forward[:, 0] * span + forward[:, 1], forward[:, 1] * span + forward[:, 0]
    return len(np.unique(there)) == len(there) and np.array_equal(np.sort(there), np.sort(back))


def winding_numbers(points: NDArray[np.float64], surface: TriMesh) -> NDArray[np.float64]:
    """How often a closed surface of flat faces winds around each point, (N,): 1 inside, 0 outside; its solid angle over 4π.

    Solid angles of triangles by Van Oosterom and Strackee (1983).
    """
    corners = surface.vertices[surface.faces]
    total = np.empty(len(points))
    for start in range(0, len(points), 256):  # some 10 MB at a time
        a, b, c = (corners[None, :, i] - points[start : start + 256, None] for i in range(3))
        la, lb, lc = (np.sqrt(np.einsum("nfi,nfi->nf", v, v)) for v in (a, b, c))
        top = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("nfi,nfi->nf", v, w) for v, w in ((a, b), (b, c), (c, a)))
        total[start : start + 256] = np.arctan2(top, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1)
    return total / (2 * np.pi)


def region_volumes(mesh: TetMesh) -> NDArray[np.float64]:
    """Volume [m³] of each region, (highest region + 1,), by the rule of `volume`."""
    each = jacobian_determinants(mesh.rest_positions, mesh.tets)[:, 4:].sum(axis=1) / 24.0
    return np.asarray(np.bincount(mesh.regions, each), np.float64)


def interface_faces(tets: NDArray[np.int32], inside: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The six-node faces between the tets (T, 10) marked in `inside` (T,) and the others, outward of the former, (F, 6)."""
    outside = {tuple(face) for face in np.sort(outer_faces(tets)[:, :3], axis=1).tolist()}
    faces = outer_faces(tets[inside]) if inside.any() else np.zeros((0, 6), np.int32)
    return faces[[tuple(sorted(face)) not in outside for face in faces[:, :3].tolist()]].reshape(-1, 6)


def enclosed_volume(surface: TriMesh) -> float:
    """Volume [m³] inside a closed surface of flat faces (divergence theorem)."""
    points = np.vstack([surface.vertices, surface.vertices.mean(axis=0)])
    cells = np.hstack([np.full((len(surface.faces), 1), len(surface.vertices)), surface.faces])
    return float(tet_volumes(points, cells.astype(np.int32)).sum())


def mirrored(mesh: TetMesh, symmetry: frozenset[str]) -> TetMesh:
    """The mesh with its mirror images in all planes but those of `symmetry`."""
    for axis in sorted(mesh.symmetry - symmetry):
        mesh = mirror(mesh, axis)
    return mesh


def unfolded(curved: NDArray[np.float64], tets: NDArray[np.int32], most: float) -> NDArray[np.float64]:
    """Nodes whose middles are straight where they lay more than `most` edge lengths off, and bent less where they would fold a tet.

    A tet with two faces on a curved surface folds along the edge between them; it takes back a tenth of the bend at a time, as one tenth is
    nearly always enough, and a middle that stays on its chord is off by all of it.
    """
    ends = np.zeros((len(curved), 2), np.int64)
    ends[tets[:, 4:]] = tets[:, TET_EDGES]
    straight = curved[ends].mean(axis=1)
    vertex = np.setdiff1d(np.arange(len(curved)), tets[:, 4:])
    straight[vertex] = curved[vertex]
    length = np.linalg.norm(curved[ends[:, 1]] - curved[ends[:, 0]], axis=1)
    # Straight middles as they come would differ by rounding from a node that is already on its plane.
    bent = np.linalg.norm(curved - straight, axis=1)
    share = np.where(bent > most * length, 0.0, 1.0)
    out = np.where(share[:, None] > 0.0, curved, straight)
    reference = 6.0 * tet_volumes(curved, tets)[:, None]
    while True:
        folded = (jacobian_determinants(out, tets) < 0.1 * reference).any(axis=1)
        back = np.unique(tets[folded, 4:])
        back = back[(bent[back] > 1e-12) & (share[back] > 0.0)]
        if not len(back):
            return out
        share[back] = np.maximum(share[back] - 0.1, 0.0)
        share[share < 0.05] = 0.0
        out[back] = straight[back] + share[back, None] * (curved[back] - straight[back])
