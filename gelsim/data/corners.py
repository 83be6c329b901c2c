"""Four corners in a photograph that are those of a rectangle on the gel, and the homography that sets what they enclose upright.

Corners run clockwise from the top left, (column, row) [px]. The upright picture has square pixels, as many as the longer side has in
the photograph.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError

Array = NDArray[np.float64]

SHORTEST = 32
"""Of a side [px]."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Args: `places` (4, 2) [px]; `size_mm` the rectangle's width and height, None where they are not known."""

    places: Array
    size_mm: tuple[float, float] | None = None

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height of the upright picture [px]."""
        sides = np.hypot(*(np.roll(self.places, -1, axis=0) - self.places).T)
        wide, high = (sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2
        if self.size_mm:
            per_mm = max(wide / self.size_mm[0], high / self.size_mm[1])
            wide, high = (per_mm * side for side in self.size_mm)
        return int(round(wide)), int(round(high))

    @property
    def mm_per_px(self) -> float | None:
        """Of the upright picture."""
        return self.size_mm[0] / self.size[0] if self.size_mm else None

    @cached_property
    def homography(self) -> Array:
        """From the upright picture to the photograph, (3, 3)."""
        wide, high = self.size
        rows, wanted = [], []
        for (x, y), (u, v) in zip([(0, 0), (wide, 0), (wide, high), (0, high)], self.places, strict=True):
            rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
            wanted += [u, v]
        return np.append(np.linalg.solve(np.array(rows, float), np.array(wanted)), 1.0).reshape(3, 3)


def check_corners(corners: Array, where: str) -> None:
    """Raises SceneError: these four do not enclose an area, clockwise from the top left."""
    sides = np.roll(corners, -1, axis=0) - corners
    turns = sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0]
    if (turns > 0).all() and np.hypot(*sides.T).min() >= SHORTEST:
        return
    said = " ".join(f"({column:g}, {row:g})" for column, row in corners)
    if (turns > 0).all():
        raise SceneError(f"{where} {said}: a side is shorter than {SHORTEST} px")
    problem = "run the other way round" if (turns < 0).all() else "cross, or enclose no convex area"
    raise SceneError(f"{where} {said}: these corners {problem}; give top left, top right, bottom right, bottom left")
