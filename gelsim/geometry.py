"""Surfaces and solids as arrays, and measures of their quality. Plain NumPy, SI units.

`TriMesh` is a flat-faced surface. `QuadraticSurface` has six nodes a face, so that a sphere is a sphere; contact works on it. `TetMesh` is
made of ten-node tetrahedra whose mid-side nodes may lie on a curved boundary (isoparametric). Node order of a ten-node tet: vertices 0-3, then the
middles of the edges 01, 12, 02, 03, 13, 23 (VTK_QUADRATIC_TETRA); of a six-node face: vertices 0-2, then the middles of 01, 12, 20.
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "rest_positions", np.ascontiguousarray(self.rest_positions, np.float64))
        object.__setattr__(self, "tets", np.ascontiguousarray(self.tets, np.int32))
        assert self.rest_positions.ndim == 2 and self.rest_positions.shape[1] == 3
        assert self.tets.ndim == 2 and self.tets.shape[1] == 10

    def surface(self, group: str) -> QuadraticSurface:
        """The faces of one group with a node numbering of their own (in order of first index)."""
        faces = self.groups[group]
        used, local = np.unique(faces, return_inverse=True)
        return QuadraticSurface(self.rest_positions[used], local.reshape(faces.shape).astype(np.int32))


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
