"""Membranes to measure light with, and others to judge it by: geometry alone, no mechanics.

Both are the gel at rest pushed in along z: -z' = max over bodies, made smooth at the contact's edge as a gel's surface is, by a blur of a
width drawn for each. Slopes reach 60 degrees and depths 1.2 mm. The two families share no shape: smooth bells and ridges to fit by; balls,
rods, boxes, wedges and rings to judge by. `spacing` [m] is that of the material grid.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.membrane.surface import GRID_SPACING, rest_membrane
from gelsim.results import Membrane
from gelsim.scene.definition import Scene


def pressed_membrane(rest: Membrane, depth: NDArray[np.floating]) -> Membrane:
    """A gel at rest with its surface moved by -depth [m] along z; one value a vertex. Markers move with it."""
    columns, rows = _grid(rest)
    positions = rest.positions.copy()
    positions[:, 2] -= depth
    surface = positions.reshape(rows, columns, 3)
    normals = np.cross(np.gradient(surface, axis=1, edge_order=2), np.gradient(surface, axis=0, edge_order=2)).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centres = rest.marker_centres.copy()
    if len(centres):
        from scipy.interpolate import RegularGridInterpolator

        x, y = positions[:columns, 0], surface[:, 0, 1]
        centres[:, 2] -= RegularGridInterpolator((y, x), depth.reshape(rows, columns))(centres[:, 1::-1])
    return Membrane(positions, normals, rest.uv, rest.faces, centres)


def bumpy_membrane(scene: Scene, seed: int, spacing: float = GRID_SPACING) -> Membrane:
    """Bells and ridges of many sizes all over the gel."""
    rng = np.random.default_rng([7, seed])
    rest = rest_membrane(scene, spacing)
    x, y, fade = _places(scene, rest)
    depth = np.zeros_like(x)
    for _ in range(9):
        centre = rng.uniform(-0.42, 0.42, 2) * np.array(scene.gel.size_mm)
        width = np.exp(rng.uniform(np.log(0.5), np.log(2.5)))
        stretch, turn = np.exp(rng.uniform(0, 1.2)), rng.uniform(0, np.pi)
        u = (x - centre[0]) * np.cos(turn) + (y - centre[1]) * np.sin(turn)
        v = (y - centre[1]) * np.cos(turn) - (x - centre[0]) * np.sin(turn)
        # A bell's steepest slope is height over width times 0.6: up to 58 degrees.
        height = rng.uniform(0.2, min(1.2, 2.6 * width))
        depth = np.maximum(depth, height * np.exp(-((u / stretch) ** 2 + v**2) / (2 * width**2)))
    return pressed_membrane(rest, _blurred(rest, depth * fade, 1e-4 / spacing) * 1e-3)


def dented_membrane(scene: Scene, seed: int, spacing: float = GRID_SPACING) -> Membrane:
    """One or two rigid bodies pressed in: ball, rod, box, wedge or ring."""
    rng = np.random.default_rng([11, seed])
    rest = rest_membrane(scene, spacing)
    x, y, fade = _places(scene, rest)
    total = np.zeros_like(x)
    for number in range(1 + seed % 2):
        centre = rng.uniform(-0.25, 0.25, 2) * np.array(scene.gel.size_mm)
        turn, deep = rng.uniform(0, np.pi), rng.uniform(0.3, 1.2)
        u = (x - centre[0]) * np.cos(turn) + (y - centre[1]) * np.sin(turn)
        v = (y - centre[1]) * np.cos(turn) - (x - centre[0]) * np.sin(turn)
        away, radius = np.hypot(u, v), rng.uniform(2.0, 6.0)
        kind = (seed + 3 * number) % 5
        if kind == 0:
            body = deep - (radius - np.sqrt(np.maximum(radius**2 - away**2, 0)))
        elif kind == 1:
            body = np.where(np.abs(u) < 4, deep - (radius - np.sqrt(np.maximum(radius**2 - v**2, 0))), 0)
        elif kind == 2:
            body = deep * ((np.abs(u) < 2.5) & (np.abs(v) < 1.5))
        elif kind == 3:
            body = np.where(np.abs(u) < 3, deep - np.abs(v) * rng.uniform(0.4, 1.2), 0)
        else:
            body = deep - (1.0 - np.sqrt(np.maximum(1.0 - (away - radius / 2) ** 2, 0)))
        total = np.maximum(total, np.maximum(body, 0))
    return pressed_membrane(rest, _blurred(rest, total * fade, rng.uniform(0.2e-3, 0.45e-3) / spacing) * 1e-3)


def _grid(membrane: Membrane) -> tuple[int, int]:
    columns = int(np.argmax(membrane.uv[:, 1] != membrane.uv[0, 1]))
    return columns, len(membrane.uv) // columns


def _places(scene: Scene, rest: Membrane) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """x and y of the vertices [mm], and a factor that leaves the gel's rim where it is."""
    x, y = rest.positions[:, 0] * 1e3, rest.positions[:, 1] * 1e3
    half = np.array(scene.gel.size_mm) / 2
    return x, y, np.clip((half[0] - abs(x)) / 2, 0, 1) * np.clip((half[1] - abs(y)) / 2, 0, 1)


def _blurred(rest: Membrane, depth: NDArray[np.float64], cells: float) -> NDArray[np.float64]:
    """By a Gaussian of so many cells of the grid."""
    from scipy.ndimage import gaussian_filter

    columns, rows = _grid(rest)
    return gaussian_filter(depth.reshape(rows, columns), cells, mode="nearest").ravel()
