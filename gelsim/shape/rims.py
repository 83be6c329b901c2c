"""Sharp edges of an object where they come to touch the gel, told from the undeformed bodies.

Left out: edges that come into contact by deformation or travel alone.
"""

from __future__ import annotations

import numpy as np

from gelsim.scene.definition import Scene
from gelsim.shape.shapes import first_touch, gel_height, press_depth, sharp_edges
from gelsim.shape.solids import Array
from gelsim.units import MM


def rims_on_gel(scene: Scene) -> Array:
    """Where sharp edges of the object, in pieces (K, 2, 3), meet the gel's flat block when pressed into it, not over its border."""
    _, turn, shift = first_touch(scene)
    placed = cut_pieces(sharp_edges(scene.object), 0.5 * MM) @ turn.T + shift
    inside = (np.abs(placed[..., :2]) < np.array(scene.gel.size_mm) * MM / 2 * (1 - 1e-3)).all(axis=(1, 2))
    placed = placed[inside]
    gap = placed[..., 2] - gel_height(scene.gel, placed[..., :2].reshape(-1, 2)).reshape(-1, 2)
    placed = placed[(gap < press_depth(scene)).all(axis=1)]
    placed[..., 2] = 0.0
    return placed


def cut_pieces(pieces: Array, longest: float) -> Array:
    """Straight pieces (K, 2, 3) cut into ones no longer than `longest`."""
    steps = np.maximum(1, np.ceil(np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1) / longest * (1 - 1e-9)).astype(int))
    lines = [a + np.linspace(0.0, 1.0, n + 1)[:, None] * (b - a) for (a, b), n in zip(pieces, steps, strict=True)]
    return np.vstack([np.zeros((0, 2, 3)), *(np.stack([line[:-1], line[1:]], axis=1) for line in lines)])
