"""From the finite-element surface of the gel to the coated surface that is drawn: fine, with smooth normals.

Finite elements give a surface that is continuous but kinked at element edges; under grazing light every facet would show. So the
displacement u(x, y), known at the nodes as a function of the rest place, is interpolated with continuous first derivatives (Clough-Tocher
cubics on a Delaunay triangulation, the gradients at the nodes chosen to minimise curvature: `gelsim.membrane.clough_tocher`) on a regular
material grid, and added to the gel's analytic rest height h(x, y):

    X(x, y) = (x, y, h(x, y)) + u(x, y),    normal = ∂X/∂x × ∂X/∂y, normalised (central differences on the grid).

Left out: what the finite elements know of u between their nodes beyond the nodal values (they are quadratic there, so the difference is of
third order in the node spacing; a test measures it), the coat's own thickness, and folds sharper than the grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gelsim.membrane.markers import marker_layout
from gelsim.results import Deformation, Membrane
from gelsim.scene.definition import Gel, Scene
from gelsim.shape.shapes import gel_height

GRID_SPACING = 0.08e-3
"""Of the material grid [m]: two default pixels, and below the finest node spacing (0.1 mm), so that the grid hides nothing."""


STRIP = 24
"""Rows of the grid whose normals are made at once: their numbers stay in a core's own memory."""


def rest_membrane(scene: Scene, spacing: float = GRID_SPACING) -> Membrane:
    """The undeformed coated surface: what the camera sees without contact; `spacing` of the material grid [m]."""
    grid = Grid(scene.gel, spacing)
    centres = marker_layout(scene).centres
    return grid.membrane(np.zeros((len(grid.places), 3)), _at_rest(scene.gel, centres))


def unmoved(scene: Scene, membrane: Membrane) -> Membrane:
    """The membrane as it was before it moved: its own material points, at rest."""
    columns = int(np.argmax(membrane.uv[:, 1] != membrane.uv[0, 1]))
    positions = _at_rest(scene.gel, (membrane.uv - 0.5) * np.array(scene.gel.size_mm) * 1e-3)
    centres = _at_rest(scene.gel, marker_layout(scene).centres)
    return Membrane(positions, _normals(positions, columns), membrane.uv, membrane.faces, centres)


def moved_membrane(scene: Scene, displacement: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Membrane:
    """The coated surface under a displacement field known by other means than a press.

    Args:
        displacement: Takes rest places x, y [m] (M, 2) to displacements [m] (M, 3).
    """
    grid = Grid(scene.gel)
    centres = marker_layout(scene).centres
    moved = displacement(np.concatenate([grid.places, centres]))
    return grid.membrane(moved[: len(grid.places)], _at_rest(scene.gel, centres) + moved[len(grid.places) :])


def membrane_states(scene: Scene, deformation: Deformation) -> list[Membrane]:
    """The coated surface at every recorded state of a press.

    Args:
        scene: Its gel and markers are used; the gel must be the one that was solved.
        deformation: N states of the gel's outer surface.
    Returns:
        N membranes on the same material grid; where nothing moves they equal `rest_membrane(scene)` exactly.
    """
    return Surface(scene.gel, deformation.gel.rest[:, :2]).states(scene, deformation.gel.displacement)


class Surface:
    """A gel's coated surface between the nodes of its mesh: the interpolation made ready once for all states."""

    def __init__(self, gel: Gel, nodes: NDArray[np.float64], spacing: float = GRID_SPACING) -> None:
        """From the rest places x, y of the surface's nodes [m], shape (G, 2); `spacing` of the material grid [m]."""
        from gelsim.membrane.clough_tocher import Interpolation

        self.gel, self.nodes = gel, nodes
        self._interpolation = Interpolation(nodes)
        self._grid = Grid(gel, spacing)
        # Single precision: 2 mm to a tenth of a nanometre, and half the memory to go through.
        self._to_grid = self._interpolation.operator(self._grid.places).astype(np.float32)

    def states(self, scene: Scene, displacement: NDArray[np.float64]) -> list[Membrane]:
        """The surface and the scene's markers on it under displacements of the nodes [m], shape (N, G, 3)."""
        states, nodes = displacement.shape[:2]
        values = self._interpolation.with_gradients(displacement.transpose(1, 0, 2).reshape(nodes, -1))
        centres = marker_layout(scene).centres
        moved = (self._to_grid @ values.astype(np.float32)).reshape(-1, states, 3)
        dots = _at_rest(scene.gel, centres)[:, None] + (self._interpolation.operator(centres) @ values).reshape(-1, states, 3)
        return [self._grid.membrane(moved[:, n], np.ascontiguousarray(dots[:, n])) for n in range(states)]

    def slopes(self, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivatives of displacements of the nodes (N, G, 3) by x and y at the nodes, (2, N, G, 3)."""
        states, nodes = displacement.shape[:2]
        values = self._interpolation.with_gradients(displacement.transpose(1, 0, 2).reshape(nodes, -1))
        return values.reshape(3, nodes, states, 3)[1:].transpose(0, 2, 1, 3)


class Grid:
    """The regular grid of material points that is drawn, row by row."""

    def __init__(self, gel: Gel, spacing: float = GRID_SPACING) -> None:
        size = np.array(gel.size_mm) * 1e-3
        self._columns, rows = columns, rows = [int(np.ceil(side / spacing)) + 1 for side in size]
        along = [np.linspace(-side / 2, side / 2, count) for side, count in zip(size, (columns, rows), strict=True)]
        self.places = np.stack([np.tile(along[0], rows), np.repeat(along[1], columns)], axis=1)
        """Rest x, y of the vertices [m], shape (M, 2)."""
        self._rest, self._uv = _at_rest(gel, self.places), self.places / size + 0.5
        self._faces = grid_faces(rows, columns)

    def membrane(self, displacement: NDArray[np.floating], markers: NDArray[np.float64]) -> Membrane:
        """With vertices moved by `displacement` (M, 3) [m], and markers at (K, 3) [m]."""
        positions = self._rest + displacement
        return Membrane(positions, _normals(positions, self._columns), self._uv, self._faces, markers)


def grid_faces(rows: int, columns: int) -> NDArray[np.int32]:
    """Triangles (F, 3) of a grid whose vertices lie row by row, x to the right and y up; normals +z."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, up, across = corner + 1, corner + columns, corner + columns + 1
    return np.concatenate([np.stack([corner, right, across], 1), np.stack([corner, across, up], 1)]).astype(np.int32)


def _normals(positions: NDArray[np.float64], columns: int) -> NDArray[np.float64]:
    """Unit normals (M, 3): cross products of differences by grid index, which have their direction whatever the spacing."""
    surface = np.ascontiguousarray(positions.T).reshape(3, -1, columns)
    along_column = _differences(surface, 1)
    normals = np.empty_like(positions)
    for first in range(0, surface.shape[1], STRIP):
        rows = slice(first, first + STRIP)
        down, right = along_column[:, rows], _differences(surface[:, rows], 2)
        normal = np.stack([right[i] * down[j] - right[j] * down[i] for i, j in ((1, 2), (2, 0), (0, 1))])
        normal /= np.sqrt((normal**2).sum(axis=0))
        normals.reshape(-1, columns, 3)[rows] = normal.transpose(1, 2, 0)
    return normals


def _at_rest(gel: Gel, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of the undeformed surface (M, 3) above places (M, 2) [m]."""
    return np.column_stack([places, gel_height(gel, places)])


def _differences(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Twice the derivative by index along an axis: central, of second order at the ends too."""
    values = np.moveaxis(values, axis, -1)
    twice = np.empty_like(values)
    np.subtract(values[..., 2:], values[..., :-2], out=twice[..., 1:-1])
    twice[..., 0] = 4 * values[..., 1] - 3 * values[..., 0] - values[..., 2]
    twice[..., -1] = 3 * values[..., -1] - 4 * values[..., -2] + values[..., -3]
    return np.moveaxis(twice, -1, axis)
