"""How an object stands before it is pressed: the side that faces the gel (`object.press_side`), then turns about x, y and z.

The tilt of a press is about the apex of what stands so (`gelsim.shape.shapes.rotation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gelsim.scene.definition import Body
from gelsim.units import DEG

Array = NDArray[np.float64]
_SIDES = {"bottom": (0, 0.0), "top": (0, 180.0), "left": (1, -90.0), "right": (1, 90.0), "front": (0, 90.0), "back": (0, -90.0)}
"""Axis and angle [degrees] of the turn that brings a side to the bottom."""


def about(axis: int, degrees: float) -> Array:
    """The turn about x, y or z (0, 1, 2), (3, 3); right angles are exact."""
    cos, sin = (round(value, 15) + 0.0 for value in (np.cos(degrees * DEG), np.sin(degrees * DEG)))
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[[i, i, j, j], [i, j, i, j]] = cos, -sin, sin, cos
    return turn


def turned(degrees: Sequence[float] | Array) -> Array:
    """The turn about x, then y, then z, of three angles, (3, 3)."""
    x, y, z = degrees
    return about(2, z) @ about(1, y) @ about(0, x)


def side_down(side: str) -> Array:
    """The turn that brings a side of a file to the bottom, (3, 3)."""
    return about(*_SIDES[side])


def orientation(body: Body) -> Array:
    """From the frame of the shape or of the file to how it stands, (3, 3)."""
    return turned(body.rotation_deg) @ side_down(body.press_side)


@lru_cache(maxsize=64)
def is_reoriented(body: Body) -> bool:
    """Whether it stands otherwise than its shape is described."""
    return not np.array_equal(orientation(body), np.eye(3))
