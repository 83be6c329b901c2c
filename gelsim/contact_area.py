"""Where a press will touch, told from the undeformed bodies, and the edge lengths that both meshes have there.

Left out: contact that comes by deformation alone.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gelsim.geometry import QuadraticSurface
from gelsim.scene import Scene
from gelsim.shapes import DRAWN, TURNED, fine_feature, gel_height, placement, press_depth, rigid_surface, sharp_edges
from gelsim.sizing import SIZES, Footprint, MeshSizes, SizeField, class_above, class_below, contact_edge
from gelsim.solids import Array
from gelsim.units import MM

_ALONG = 5.0
"""Twist [degrees] up to which a drawn object still lies along the long sides of tets: turned by it, 3 : 1 becomes 2.9 : 1.1."""


@lru_cache(maxsize=4)
def _at_first_touch(scene: Scene) -> tuple[QuadraticSurface, Array, Array]:
    """The object's surface, as if it were rigid, and its placement on the gel."""
    surface = rigid_surface(scene, frozenset())
    return surface, *placement(scene, surface)


def footprint(scene: Scene) -> Footprint:
    """The undeformed overlap at full depth with a margin for drape and tangential travel, in classes."""
    surface, turn, shift = _at_first_touch(scene)
    points = surface.nodes @ turn.T + shift
    half = np.array(scene.gel.size_mm) * MM / 2
    over = (np.abs(points[:, :2]) <= half).all(axis=1)
    touched = points[over & (points[:, 2] - gel_height(scene.gel, points[:, :2]) < press_depth(scene))][:, :2]
    if not len(touched):
        touched = shift[None, :2]
    margin = 0.1 * MM + np.abs(scene.press.shear_mm) * MM
    low, high = touched.min(axis=0) - margin, touched.max(axis=0) + margin
    inner = np.maximum(0.0, np.maximum(low, -high))
    outer = np.maximum(-low, high)
    high_class = np.minimum([class_above(v) for v in outer], half)
    low_class = [class_below(v) for v in inner]
    width = high_class - low_class
    drawn = scene.object.shape in DRAWN and abs(scene.press.twist_deg) <= _ALONG
    stretch = float(np.clip(np.floor(width[1] / width[0]), 1.0, 3.0)) if drawn else 1.0
    round_area = scene.object.shape in TURNED and not any(low_class)
    side_x, side_y = (int(np.sign(h)) if each else 0 for each, h in zip(low_class, low + high, strict=True))
    corners = (float(low_class[0]), float(low_class[1])), (float(high_class[0]), float(high_class[1]))
    return Footprint(*corners, stretch, round_area, (side_x, side_y))


def edge_in_contact(scene: Scene, area: Footprint) -> float:
    """Edge length in contact [m], short enough for the waves of an uneven object."""
    sizes = SIZES[scene.fidelity]
    return min(contact_edge(area, sizes), fine_feature(scene.object) / sizes.divisions)


def contact_field(area: Footprint, bottom: float, top: float, edge: float, sizes: MeshSizes, far: float, rims: Array,
           seams: tuple[Array, float] = (np.zeros((0, 3)), np.inf)) -> SizeField:  # fmt: skip
    """The size field of a body whose contact reaches from `bottom` to `top` [m], as fine as `sizes` say along `rims` and at `seams`."""
    rounding = min(area.high) if area.round else 0.0
    rim = min(edge, sizes.rim if len(rims) or not len(seams[0]) else np.inf, seams[1])
    points = np.vstack([cut_pieces(rims, rim).reshape(-1, 3), seams[0]])
    folded = area.folded(points)
    _, first = np.unique(np.round(folded / (0.1 * rim)), axis=0, return_index=True)
    corners = (*area.low, bottom), (*area.high, top)
    mirrored = (not area.side[0], not area.side[1])
    return SizeField(*corners, edge, sizes.growth, far, rounding, rim, sizes.rim_growth, folded[np.sort(first)], mirrored)


def cut_pieces(pieces: Array, longest: float) -> Array:
    """Straight pieces (K, 2, 3) cut into ones no longer than `longest`."""
    steps = np.maximum(1, np.ceil(np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1) / longest * (1 - 1e-9)).astype(int))
    lines = [a + np.linspace(0.0, 1.0, n + 1)[:, None] * (b - a) for (a, b), n in zip(pieces, steps, strict=True)]
    return np.vstack([np.zeros((0, 2, 3)), *(np.stack([line[:-1], line[1:]], axis=1) for line in lines)])


def rims_on_gel(scene: Scene) -> Array:
    """Where sharp edges of the object, in pieces (K, 2, 3), meet the gel's flat block when pressed into it, not over its border."""
    _, turn, shift = _at_first_touch(scene)
    placed = cut_pieces(sharp_edges(scene.object), 0.5 * MM) @ turn.T + shift
    inside = (np.abs(placed[..., :2]) < np.array(scene.gel.size_mm) * MM / 2 * (1 - 1e-3)).all(axis=(1, 2))
    placed = placed[inside]
    gap = placed[..., 2] - gel_height(scene.gel, placed[..., :2].reshape(-1, 2)).reshape(-1, 2)
    placed = placed[(gap < press_depth(scene)).all(axis=1)]
    placed[..., 2] = 0.0
    return placed
