"""From the finite-element surface of the gel to the coated surface that is drawn: fine, with smooth normals.

Finite elements give a surface that is continuous but kinked at element edges; under grazing light every facet would show. So the
displacement u(x, y), known at the nodes as a function of the rest place, is interpolated with continuous first derivatives (Clough-Tocher
cubics on a Delaunay triangulation, the gradients at the nodes chosen to minimise curvature: Nielson 1983, as in scipy) on a regular
material grid, and added to the gel's analytic rest height h(x, y):

    X(x, y) = (x, y, h(x, y)) + u(x, y),    normal = ∂X/∂x × ∂X/∂y, normalised (central differences on the grid).

Left out: what the finite elements know of u between their nodes beyond the nodal values (they are quadratic there, so the difference is of
third order in the node spacing; a test measures it), the coat's own thickness, and folds sharper than the grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gelsim.markers import marker_layout
from gelsim.results import Deformation, Membrane
from gelsim.scene import Scene
from gelsim.shapes import gel_height

GRID_SPACING = 0.08e-3
"""Of the material grid [m]: two default pixels, and below the finest node spacing (0.1 mm), so that the grid hides nothing."""


def rest_membrane(scene: Scene) -> Membrane:
    """The undeformed coated surface: what the camera sees without contact."""
    grid, faces, columns = _material_grid(scene)
    centres = marker_layout(scene).centres
    displacement = np.zeros((len(grid) + len(centres), 3))
    return _assemble(scene, grid, faces, columns, centres, displacement)


def moved_membrane(scene: Scene, displacement: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Membrane:
    """The coated surface under a displacement field known by other means than a press.

    Args:
        displacement: Takes rest places x, y [m] (M, 2) to displacements [m] (M, 3).
    """
    grid, faces, columns = _material_grid(scene)
    centres = marker_layout(scene).centres
    return _assemble(scene, grid, faces, columns, centres, displacement(np.concatenate([grid, centres])))


def membrane_states(scene: Scene, deformation: Deformation) -> list[Membrane]:
    """The coated surface at every recorded state of a press.

    Args:
        scene: Its gel and markers are used; the gel must be the one that was solved.
        deformation: N states of the gel's outer surface.
    Returns:
        N membranes on the same material grid; where nothing moves they equal `rest_membrane(scene)` exactly.
    """
    return surface_states(scene, deformation.gel.rest[:, :2], deformation.gel.displacement)


def surface_states(scene: Scene, nodes: NDArray[np.float64], displacement: NDArray[np.float64]) -> list[Membrane]:
    """As `membrane_states`, from the rest places x, y of the surface's nodes (G, 2) [m] and their displacements (N, G, 3) [m]."""
    from scipy.interpolate import CloughTocher2DInterpolator
    from scipy.spatial import Delaunay, KDTree
    from threadpoolctl import threadpool_limits

    grid, faces, columns = _material_grid(scene)
    centres = marker_layout(scene).centres
    places = np.concatenate([grid, centres])
    states, node_count = displacement.shape[:2]
    values = np.ascontiguousarray(displacement.transpose(1, 0, 2).reshape(node_count, -1))
    # Gradients of columns that do not move at all need no iteration; a tolerance below a nanometre over a node spacing changes no pixel.
    # One thread: Qhull's transforms are thousands of LAPACK calls on 2 x 2 matrices, for each of which OpenBLAS would wake all cores, and
    # wait for them while others use them (1000 points on two busy cores: 15.6 s of processor time, and 3 ms so).
    with threadpool_limits(1):
        interpolant = CloughTocher2DInterpolator(Delaunay(nodes), values, tol=1e-6)
        moved = interpolant(places)
    # The grid's rim may lie outside the triangulation by a rounding error: there the nearest node's displacement holds.
    outside = np.flatnonzero(np.isnan(moved[:, 0]))
    if len(outside):
        _, nearest = KDTree(nodes).query(places[outside])
        moved[outside] = values[nearest]
    moved = moved.reshape(len(places), states, 3)
    return [_assemble(scene, grid, faces, columns, centres, moved[:, n]) for n in range(states)]


def _material_grid(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.int32], int]:
    """Rest x, y of the grid's vertices [m] (row by row, M x 2), its triangles (F x 3, normals +z), and the vertices in a row."""
    width, height = np.array(scene.gel.size_mm) * 1e-3
    columns, rows = (int(np.ceil(side / GRID_SPACING)) + 1 for side in (width, height))
    along_x, along_y = np.linspace(-width / 2, width / 2, columns), np.linspace(-height / 2, height / 2, rows)
    grid = np.stack([np.tile(along_x, rows), np.repeat(along_y, columns)], axis=1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, down, across = corner + 1, corner + columns, corner + columns + 1
    faces = np.concatenate([np.stack([corner, right, across], 1), np.stack([corner, across, down], 1)])
    return grid, faces.astype(np.int32), columns


def _assemble(
    scene: Scene,
    grid: NDArray[np.float64],
    faces: NDArray[np.int32],
    columns: int,
    centres: NDArray[np.float64],
    displacement: NDArray[np.float64],
) -> Membrane:
    """The membrane whose grid vertices, then marker centres, move by `displacement` (M + K, 3) [m]."""
    places = np.concatenate([grid, centres])
    moved = np.column_stack([places, gel_height(scene.gel, places)]) + displacement
    positions = moved[: len(grid)]
    surface = positions.reshape(-1, columns, 3)
    # Derivatives by grid index: their cross product has the normal's direction whatever the spacing.
    along_row = np.gradient(surface, axis=1, edge_order=2)
    along_column = np.gradient(surface, axis=0, edge_order=2)
    normals = np.cross(along_row, along_column).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uv = grid / (np.array(scene.gel.size_mm) * 1e-3) + 0.5
    return Membrane(positions, normals, uv, faces, moved[len(grid) :])
