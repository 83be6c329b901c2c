"""A pad of one's own: how high the coated side of the closed mesh in `gel.mesh` stands over its bonded side.

The file is turned until `gel.bonded_side` is at the bottom, where it has to be flat; the middle of that face's bounding box is the gel's.
The pad is what stands over `gel.size_mm`; the rest is cut off. But for the bonded face nothing of it may face down, so every line along z
leaves it once.

A file's triangles are taken for those of a smooth surface where they meet at less than `CREASE`, as facets would show in pictures: a vertex
has the mean gradient g of its faces, and over a triangle of corners h_i the height is quadratic,

    h = Σ λ_i h_i + ½ Σ_{i<j} λ_i λ_j (g_i − g_j)·(x_j − x_i),    λ barycentric,

exact where the surface is quadratic. It is tabulated in steps of `STEP`, bicubic between.

Left out: what of a pad is beyond the rectangle.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.geometry import TriMesh, enclosed_volume
from gelsim.scene.definition import Gel
from gelsim.scene.limits import LIMITS
from gelsim.shape.mesh_file import file_stamp, open_edges, welded
from gelsim.shape.orientation import side_down
from gelsim.units import MESH_UNITS, MM

Array = NDArray[np.float64]
Height = Callable[[Array], Array]

STEP = 0.1e-3
"""Of the table [m]: a coated surface's finest nodes are as far apart."""
FLAT = 10e-6
"""What the bonded face may be uneven [m]."""
CREASE = 20.0
"""Between two faces' normals [degrees]: programs write curved surfaces in facets that turn by less, and what turns by more is an edge."""
DOWN = 0.02
"""z of a unit normal, negative, from which on a face looks down: upright sides of a file lean by rounding."""
_EDGE = 1e-6
"""Beside a triangle what still counts as in it [m]: rounding must not open gaps, nor take the border away."""
_SIDES = ((0, 1), (1, 2), (2, 0))
MISSING = 5e-4
"""Share of the rectangle that may lack by rounding."""
_ABOUT = 0.01
"""What gel.thickness_mm may differ from the file's [mm]: the file counts."""


def pad_height(gel: Gel, xy: Array) -> Array:
    """z [m] of the pad's coated side at points (N, 2) [m]; beyond its border that of the border.

    Raises:
        SceneError: The file cannot be read, is not closed, has no flat bonded side or an overhang, or is not of the gel's size.
    """
    plain = Gel(
        profile="mesh", mesh=gel.mesh, mesh_unit=gel.mesh_unit, mesh_scale=gel.mesh_scale, bonded_side=gel.bonded_side,
        size_mm=gel.size_mm, thickness_mm=gel.thickness_mm,
    )  # fmt: skip
    return _height(plain, file_stamp(gel))(xy)


@lru_cache(maxsize=4)
def _height(gel: Gel, stamp: tuple[int, ...]) -> Height:
    from scipy.interpolate import RectBivariateSpline

    named = f'gel.mesh = "{gel.mesh}"'
    vertices, faces = _standing(gel, stamp, named)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    steepness = normals[:, 2] / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    size = np.array(gel.size_mm) * MM
    bonded = corners[..., 2].max(axis=1) <= FLAT
    covered = -0.5 * normals[bonded & (steepness < 0), 2].sum()
    if covered < (1 - MISSING) * size.prod():
        raise SceneError(
            f"{named}: its flat {gel.bonded_side} face lacks {100 * (1 - covered / size.prod()):.3g} % of gel.size_mm = {gel.size_mm[0]:g} "
            f"{gel.size_mm[1]:g} mm; allowed: a rectangle that it fills (gel.bonded_side names another side)"
        )
    hanging = ~bonded & (steepness < -DOWN)
    if (area := -0.5 * normals[hanging, 2].sum()) > MISSING * size.prod():
        x, y, z = corners[hanging].mean(axis=(0, 1)) / MM
        raise SceneError(
            f"{named}: {area / MM**2:.3g} mm² of it hang over, at about {x:.3g} {y:.3g} mm and {z:.3g} mm above the bonded face; "
            "allowed: a pad that every line from its bonded face leaves once"
        )
    above = (steepness > DOWN) & ~bonded
    upper = vertices[np.unique(faces[above])]
    order = np.lexsort(np.round(upper[:, :2] / 1e-7).T)
    beside = np.diff(upper[order], axis=0)
    if (steps := (np.abs(beside[:, :2]) < 2e-7).all(axis=1) & (np.abs(beside[:, 2]) > FLAT)).any():
        x, y, _ = upper[order][:-1][steps][0] / MM
        raise SceneError(f"{named}: its coated side has an upright step at {x:.3g} {y:.3g} mm; allowed: a surface without steps")
    x, y = (np.linspace(-side / 2, side / 2, int(np.ceil(side / STEP)) + 1) for side in size)
    table = _heights(x, y, corners[above], normals[above], _gradients(faces[above], corners[above], normals[above]))
    if np.isnan(table).any():
        raise SceneError(
            f"{named}: nothing of it is above {100 * np.isnan(table).mean():.3g} % of its bonded face; allowed: a pad without holes"
        )
    thickness = float(table.max() / MM)
    if abs(thickness - gel.thickness_mm) > _ABOUT:
        raise SceneError(
            f"gel.thickness_mm = {gel.thickness_mm:g} mm, but {named} is {thickness:.5g} mm thick; allowed: what the file says "
            "(gel.mesh_unit, gel.mesh_scale)"
        )
    least = LIMITS["gel.edge_thickness_mm"][0]
    if table.min() < least * MM:
        raise SceneError(
            f"{named} thins out to {table.min() / MM:.3g} mm within gel.size_mm = {gel.size_mm[0]:g} "
            f"{gel.size_mm[1]:g} mm; allowed: {least:g} mm or more, or a smaller gel.size_mm"
        )
    spline = RectBivariateSpline(x, y, table - gel.thickness_mm * MM)
    return lambda xy: spline.ev(xy[:, 0], xy[:, 1])


def _gradients(faces: NDArray[np.int64], corners: Array, normals: Array) -> Array:
    """Of the smooth surface at the corners (F, 3, 3) of its triangles, (F, 3, 2): means over the faces that meet there without a crease."""
    from scipy.sparse import coo_array

    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * back).sum(axis=-1) / (np.linalg.norm(ahead, axis=-1) * np.linalg.norm(back, axis=-1))
    angle = np.arccos(np.clip(cosine, -1, 1)).ravel()
    at = coo_array((np.ones(faces.size), (np.arange(faces.size), faces.ravel())), (faces.size, faces.max() + 1)).tocsr()
    one, other = (at @ at.T).nonzero()
    alike = (normals[one // 3] * normals[other // 3]).sum(axis=1) > np.cos(np.radians(CREASE))
    one, other = one[alike], other[alike]
    slope = -normals[other // 3, :2] / normals[other // 3, 2:]
    sums = [np.bincount(one, angle[other] * value, faces.size) for value in (slope[:, 0], slope[:, 1], 1.0)]
    return np.stack([sums[0] / sums[2], sums[1] / sums[2]], axis=-1).reshape(*faces.shape, 2)


def _heights(x: Array, y: Array, corners: Array, normals: Array, gradients: Array) -> Array:
    """z at the nodes of a grid, (X, Y), of triangles (F, 3, 3) with gradients (F, 3, 2) at their corners; NaN where there is none."""
    table = np.full((len(x), len(y)), np.nan)
    turned = normals[:, 2]
    low, high = corners[..., :2].min(axis=1) - _EDGE, corners[..., :2].max(axis=1) + _EDGE
    first = np.stack([np.searchsorted(x, low[:, 0]), np.searchsorted(y, low[:, 1])], axis=1)
    last = np.stack([np.searchsorted(x, high[:, 0]), np.searchsorted(y, high[:, 1])], axis=1)
    # Half the rise of a side's middle over its chord, times four.
    rise = [0.5 * ((gradients[:, i] - gradients[:, j]) * (corners[:, j, :2] - corners[:, i, :2])).sum(axis=1) for i, j in _SIDES]
    for face in np.flatnonzero((last > first).all(axis=1)):
        columns, rows = (slice(first[face, axis], last[face, axis]) for axis in (0, 1))
        a, b, c = corners[face]
        across, up = x[columns, None] - c[0], y[None, rows] - c[1]
        one = ((b[1] - c[1]) * across - (b[0] - c[0]) * up) / turned[face]
        two = ((c[1] - a[1]) * across - (c[0] - a[0]) * up) / turned[face]
        share = one, two, 1 - one - two
        z = sum(part * corner[2] for part, corner in zip(share, (a, b, c), strict=True))
        z = z + sum(share[i] * share[j] * rise[side][face] for side, (i, j) in enumerate(_SIDES))
        within = np.minimum(np.minimum(one, two), share[2]) >= -_EDGE / np.sqrt(abs(turned[face]))
        table[columns, rows] = np.where(within, z, table[columns, rows])
    return table


def _standing(gel: Gel, stamp: tuple[int, ...], named: str) -> tuple[Array, NDArray[np.int64]]:
    """Vertices [m] and outward faces of the pad over the gel's rectangle, its bonded side at z = 0 and in the middle."""
    import manifold3d

    vertices, faces, _ = welded(str(gel.mesh), stamp, "gel.mesh")
    if (edges := open_edges(vertices, faces)) or not len(faces):
        raise SceneError(f"{named} is not closed ({edges} open edges); allowed for a pad is a closed surface")
    vertices = vertices @ side_down(gel.bonded_side).T * (MESH_UNITS[gel.mesh_unit] * gel.mesh_scale)
    if enclosed_volume(TriMesh(vertices, faces.astype(np.int32))) < 0:
        faces = faces[:, ::-1]
    vertices = vertices - [0, 0, vertices[:, 2].min()]
    low = vertices[np.unique(faces[vertices[faces][..., 2].max(axis=1) <= FLAT])]
    if not len(low):
        raise SceneError(
            f"{named} has no flat {gel.bonded_side} face to be bonded at; allowed: a plane (gel.bonded_side names another side)"
        )
    vertices = vertices - [*(low[:, :2].min(axis=0) + low[:, :2].max(axis=0)) / 2, 0]
    half, extent = np.array(gel.size_mm) * MM / 2, np.ptp(low[:, :2], axis=0)
    if (extent < 2 * half * (1 - MISSING)).any():
        raise SceneError(
            f"gel.size_mm = {gel.size_mm[0]:g} {gel.size_mm[1]:g} mm, but the {gel.bonded_side} face of {named} is {extent[0] / MM:.5g} x "
            f"{extent[1] / MM:.5g} mm, read in {gel.mesh_unit}; allowed: up to that (gel.mesh_unit, gel.mesh_scale)"
        )
    if (np.abs(vertices[:, :2]) <= half * (1 + MISSING)).all():
        return vertices, faces
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    if solid.status() != manifold3d.Error.NoError:
        raise SceneError(f"{named} cannot be cut to gel.size_mm ({solid.status().name}); allowed: a closed surface that is a manifold")
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            solid = solid.trim_by_plane(tuple(sign * np.eye(3)[axis]), -float(half[axis]))
    cut = solid.to_mesh64()
    return np.asarray(cut.vert_properties)[:, :3], np.asarray(cut.tri_verts).astype(np.int64)
