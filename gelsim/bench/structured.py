"""Structured meshes whose answers are known by hand or from another code: deterministic, made in milliseconds without fTetWild.

The sections of the benchmark and the tests of the mechanics share them.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gelsim.geometry import TetMesh, mirror, outer_faces, quadratic_tets, tet_volumes
from gelsim.units import MM

Array = NDArray[np.float64]
Names = tuple[str, str, str]
"""Of the groups of faces: bottom, top, and what is between."""


def kuhn_box(x: Array, y: Array, z: Array) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and four-node tets of a box, six tets a cell along the paths from its lowest to its highest corner."""
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(len(x), len(y), len(z))
    corner = [number[i : len(x) - 1 + i, j : len(y) - 1 + j, k : len(z) - 1 + k].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    paths = [(1, 2), (1, 4), (2, 1), (2, 4), (4, 1), (4, 2)]
    tets = np.vstack([np.stack([corner[0], corner[a], corner[a + b], corner[7]], axis=1) for a, b in paths]).astype(np.int32)
    wrong = tet_volumes(points, tets) < 0
    tets[wrong] = tets[wrong][:, [1, 0, 2, 3]]
    return points, tets


def box_mesh(x: Array, y: Array, z: Array, names: Names, symmetry: str = "", shake: float = 0.0, bend: float = 0.0) -> TetMesh:
    """A box of ten-node tets [m] with its faces grouped by name; faces on the planes of `symmetry` belong to none.

    `shake` moves inner vertices, `bend` inner mid-side nodes, at random, by up to this share of the smallest cell.
    """
    bottom, top, side = names
    rng = np.random.default_rng(7)
    vertices, tets = kuhn_box(x, y, z)
    cell = min(np.diff(line).min() for line in (x, y, z))
    low, high = vertices.min(0), vertices.max(0)

    def moved(points: Array, share: float) -> Array:
        inner = ((points > low + 1e-12) & (points < high - 1e-12)).all(axis=1)
        return points + share * cell * rng.uniform(-1, 1, points.shape) * inner[:, None]

    vertices = moved(vertices, shake)
    nodes, tets10 = quadratic_tets(vertices, tets)
    nodes[len(vertices) :] = moved(nodes[len(vertices) :], bend)
    faces = outer_faces(tets10)
    centre = nodes[faces[:, :3]].mean(axis=1)
    of_face = np.full(len(faces), side, dtype=object)
    of_face[centre[:, 2] < low[2] + 1e-12] = bottom
    of_face[centre[:, 2] > high[2] - 1e-12] = top
    for axis in symmetry:
        column = "xy".index(axis)
        nodes[np.abs(nodes[:, column]) < 1e-12, column] = 0.0
        of_face[centre[:, column] < low[column] + 1e-12] = ""
    groups = {str(name): faces[of_face == name] for name in sorted(set(of_face)) if name}
    return TetMesh(nodes, tets10, groups, frozenset(symmetry))


def graded(fine: float, reach: float, end: float, growth: float) -> Array:
    """Points on 0 … end [m]: steps of `fine` to `reach`, then each `growth` times the last."""
    points = list(np.arange(round(reach / fine) + 1) * fine)
    while points[-1] < end:
        fine *= growth
        points.append(points[-1] + fine)
    points[-1] = end
    if points[-1] - points[-2] < 0.5 * (points[-2] - points[-3]):
        points.pop(-2)
    return np.array(points)


@lru_cache
def flat_gel(fine_mm: float = 0.5, reach_mm: float = 2.5, layers: int = 2, half_mm: float = 12.5, thickness_mm: float = 2.4,
             whole: str = "") -> TetMesh:  # fmt: skip
    """A quarter of a flat gel, fine around the origin, thinner layers above; mirrored at the planes named in `whole`."""
    line = graded(fine_mm * MM, reach_mm * MM, half_mm * MM, 1.7)
    z = -thickness_mm * MM * np.linspace(1, 0, layers + 1) ** 1.4
    mesh = box_mesh(line, line, z, ("bonded", "coated", "side"), "xy")
    for axis in whole:
        mesh = mirror(mesh, axis)
    return mesh


def quarter_disc(radius_mm: float, cells: int, z_mm: Array, names: Names, cap_radius_mm: float | None = None) -> TetMesh:
    """A quarter of a round block, finer toward its rim, with its middles on the circle; with a spherical underside of `cap_radius_mm`.

    The square grid is mapped by x = u √(1 - v²/2), y = v √(1 - u²/2), which takes the unit square's edge to the unit circle.
    """
    line = np.linspace(0, 1, cells + 1)
    line = line * (1.6 - 0.6 * line) if cap_radius_mm is None else line * (0.6 + 0.4 * line)
    mesh = box_mesh(line, line, z_mm * MM, names, "xy")
    u, v, z = mesh.rest_positions.T
    x, y = radius_mm * MM * u * np.sqrt(1 - v**2 / 2), radius_mm * MM * v * np.sqrt(1 - u**2 / 2)
    if cap_radius_mm is not None:
        rise = cap_radius_mm * MM - np.sqrt((cap_radius_mm * MM) ** 2 - x**2 - y**2)
        z = z + rise * (z.max() - z) / (z.max() - z.min())
    return TetMesh(np.column_stack([x, y, z]), mesh.tets, mesh.groups, mesh.symmetry)


@lru_cache
def soft_cap() -> TetMesh:
    """A quarter of a soft object in its own frame: a ball's cap of R = 5 mm, 8 mm across, on a foot, 8 mm tall overall."""
    z = 8.0 * np.array([0.0, 0.08, 0.2, 0.45, 1.0])
    mesh = quarter_disc(4.0, 5, z, ("contact", "base", "flank"), cap_radius_mm=5.0)
    groups = {"base": mesh.groups["base"], "contact": np.vstack([mesh.groups["contact"], mesh.groups["flank"]])}
    return TetMesh(mesh.rest_positions, mesh.tets, groups, mesh.symmetry)
