"""Where a press will touch, told from the undeformed bodies, and the edge lengths that both meshes have there.

Left out: contact that comes by deformation alone.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from gelsim.mesh.sizing import SIZES, Footprint, MeshSizes, SizeField, class_above, class_below, contact_edge
from gelsim.scene.definition import Scene
from gelsim.scene.motion import widest
from gelsim.scene.shape_table import SHAPES
from gelsim.shape.orientation import is_reoriented, turned
from gelsim.shape.outlines import fine_feature
from gelsim.shape.rims import cut_pieces
from gelsim.shape.shapes import first_touch, gel_height, press_depth
from gelsim.shape.solids import Array
from gelsim.units import MM

_ALONG = 5.0
"""Twist [degrees] up to which a drawn object still lies along the long sides of tets: turned by it, 3 : 1 becomes 2.9 : 1.1."""
EARLY = 0.25
"""Share of the depth within which a press begins: a ball has half its radius of contact then (docs/meshing.md, *Where a press begins*)."""
SMALL = 0.6
"""Share of the length, and of the width, touched in the end within which a press begins at a point: of a ball or a cone, on a dome of a
rod or a flat too."""


def _overlapping(scene: Scene, depth: float) -> tuple[Array, Array]:
    """Points (K, 3) of the object that lie in the undeformed gel when pressed by `depth` [m]: in its own frame, and where they touch first.

    Its apex where no point of its surface is a node in there.
    """
    surface, turn, shift = first_touch(scene)
    placed = surface.nodes @ turn.T + shift
    way = widest(scene)
    if way.rolls:
        return _rolled_over(scene, depth, surface.nodes, placed, np.array([*np.array(scene.press.offset_mm) * MM, shift[2]]))
    over = (np.abs(placed[:, :2]) <= np.array(scene.gel.size_mm) * MM / 2).all(axis=1)
    inside = over & (placed[:, 2] - gel_height(scene.gel, placed[:, :2]) < depth)
    return (surface.nodes[inside], placed[inside]) if inside.any() else (np.zeros((1, 3)), shift[None])


def _rolled_over(scene: Scene, depth: float, nodes: Array, placed: Array, pivot: Array) -> tuple[Array, Array]:
    """`_overlapping` of an object that rolls about its pivot: at any of its turns."""
    way = widest(scene)
    half, found = np.array(scene.gel.size_mm) * MM / 2, []
    for turn in way.turns_on_way():
        there = (placed - pivot) @ (turned(turn) @ turned(way.turn[0]).T).T + pivot
        inside = (np.abs(there[:, :2]) <= half).all(axis=1) & (there[:, 2] - gel_height(scene.gel, there[:, :2]) < depth)
        found.append((nodes[inside], there[inside]))
    return np.vstack([one for one, _ in found]), np.vstack([there for _, there in found])


def footprint(scene: Scene) -> Footprint:
    """The undeformed overlap at full depth with a margin for drape and tangential travel, in classes."""
    touched = _overlapping(scene, press_depth(scene))[1][:, :2]
    half = np.array(scene.gel.size_mm) * MM / 2
    way = widest(scene)
    margin = 0.1 * MM + way.sideways * MM
    low, high = touched.min(axis=0) - margin, touched.max(axis=0) + margin
    inner = np.maximum(0.0, np.maximum(low, -high))
    outer = np.maximum(-low, high)
    high_class = np.minimum([class_above(v) for v in outer], half)
    low_class = [class_below(v) for v in inner]
    width = high_class - low_class
    row = SHAPES[scene.object.shape]
    stands = not is_reoriented(scene.object)
    drawn = row.drawn and stands and np.abs(way.turn[:, 2]).max() <= _ALONG
    stretch = float(np.clip(np.floor(width[1] / width[0]), 1.0, 3.0)) if drawn else 1.0
    round_area = row.turned and stands and not any(low_class)
    side_x, side_y = (int(np.sign(h)) if each else 0 for each, h in zip(low_class, low + high, strict=True))
    corners = (float(low_class[0]), float(low_class[1])), (float(high_class[0]), float(high_class[1]))
    return Footprint(*corners, stretch, round_area, (side_x, side_y))


def edge_in_contact(scene: Scene, area: Footprint) -> float:
    """Edge length in contact [m], short enough for the waves of an uneven object."""
    sizes = SIZES[scene.fidelity]
    return min(contact_edge(area, sizes), fine_feature(scene.object) / sizes.divisions)


def core(scene: Scene, edge: float, of_object: bool) -> tuple[Array, float]:
    """Points (K, 3) where the press begins, on the object in its own frame or on the gel's flat block, and the edge length [m] there.

    None where that is as long or as wide as what is touched in the end, or nearly; edges are `edge` long there.
    """
    sizes = SIZES[scene.fidelity]
    size = max(sizes.core * edge, sizes.finest)
    if size >= edge:
        return np.zeros((0, 3)), size
    early, whole = (_overlapping(scene, share * press_depth(scene))[0 if of_object else 1] for share in (EARLY, 1.0))
    low, high = early[:, :2].min(axis=0), early[:, :2].max(axis=0)
    half = np.maximum((high - low) / 2, 0.5 * size)
    if (2 * half > SMALL * np.ptp(whole[:, :2], axis=0)).any():
        return np.zeros((0, 3)), size
    lines = [np.linspace(-h, h, 1 + int(np.ceil(2 * h / (0.5 * size)))) for h in half]
    disc = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    disc = disc[((disc / half) ** 2).sum(axis=1) <= 1.0 + 1e-9] + (low + high) / 2
    if not of_object:
        return np.column_stack([disc, np.zeros(len(disc))]), size
    return np.column_stack([disc, early[KDTree(early[:, :2]).query(disc)[1], 2]]), size


def contact_field(area: Footprint, bottom: float, top: float, edge: float, sizes: MeshSizes, far: float, rims: Array,
           *near: tuple[Array, float]) -> SizeField:  # fmt: skip
    """The size field of a body whose contact reaches from `bottom` to `top` [m], as fine as `sizes` say along `rims`, and as is asked for
    `near` points (K, 3)."""
    rounding = min(area.high) if area.round else 0.0
    rim = min(edge, sizes.rim)
    corners = (*area.low, bottom), (*area.high, top)
    mirrored = (not area.side[0], not area.side[1])
    at = [(cut_pieces(rims, rim).reshape(-1, 3), rim), *near]
    folded = tuple((_apart(area.folded(points), 0.1 * size), size) for points, size in at if len(points))
    return SizeField(*corners, edge, sizes.growth, far, rounding, folded, sizes.rim_growth, mirrored)


def _apart(points: Array, distance: float) -> Array:
    """Those (K, 3) that are not as good as at the place of one before."""
    return points[np.sort(np.unique(np.round(points / distance), axis=0, return_index=True)[1])]
