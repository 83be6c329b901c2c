"""How long the edges of a mesh should be, and where: fine in the expected contact, growing linearly away from it.

    h(p) = min(h_far, h_contact + growth · d(p)),    d = distance to the box in which contact is expected.

The box is the overlap of the undeformed object and gel at full depth plus a margin for drape and tangential travel; its half widths are
rounded up to a few classes, so that one gel mesh serves many presses. fTetWild takes h as the nodal values of a background mesh.

Left out: refinement along sharp rims inside a wide contact (a punch's edge gets no finer tets than its middle).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.solids import Array
from gelsim.units import MM

_CLASSES = np.array([0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 25.0, 50.0, 100.0]) * MM
"""Half widths of the contact box [m], about √2 apart."""


@dataclass(frozen=True)
class MeshSizes:
    """How fine a mesh is; lengths in metres."""

    divisions: float
    """Edges across the narrow half width of the contact box."""
    finest: float
    coarsest_contact: float
    """Bounds of the edge length in contact: the gel's thickness wants two quadratic tets at least."""
    growth: float
    """Edge length gained per length away from the contact box."""
    gel_far: float
    object_far: float


SIZES = {
    "fast": MeshSizes(3.0, 0.20 * MM, 1.2 * MM, 0.7, 4.0 * MM, 5.0 * MM),
    "balanced": MeshSizes(5.0, 0.14 * MM, 0.9 * MM, 0.6, 3.0 * MM, 4.0 * MM),
    "reference": MeshSizes(8.0, 0.09 * MM, 0.6 * MM, 0.5, 2.0 * MM, 3.0 * MM),
}


@dataclass(frozen=True)
class Footprint:
    """Where contact is expected: |x| and |y| between `low` and `high` [m], in the gel's frame."""

    low: tuple[float, float]
    high: tuple[float, float]
    stretch: float
    """How many times longer than wide tets may be along y."""


def class_above(value: float) -> float:
    """The next class of half widths [m]."""
    return float(_CLASSES[min(np.searchsorted(_CLASSES, value * (1 - 1e-9)), len(_CLASSES) - 1)])


def class_below(value: float) -> float:
    """The class before, 0 below the first [m]."""
    below = np.searchsorted(_CLASSES, value, side="right")
    return float(_CLASSES[below - 1]) if below else 0.0


def contact_edge(area: Footprint, sizes: MeshSizes) -> float:
    """Edge length in contact [m]."""
    half = [(h - lo) / (2 if lo else 1) for lo, h in zip(area.low, area.high, strict=True)]
    return float(np.clip(min(half[0], half[1]) / sizes.divisions, sizes.finest, sizes.coarsest_contact))


@dataclass(frozen=True)
class SizeField:
    """Edge lengths [m] that grow linearly away from a box |x|, |y|, z in [low, high]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    contact: float
    growth: float
    far: float

    def __call__(self, points: Array) -> Array:
        folded = np.concatenate([np.abs(points[..., :2]), points[..., 2:]], axis=-1)
        away = np.maximum(np.maximum(self.low - folded, folded - self.high), 0.0)
        return np.minimum(self.far, self.contact + self.growth * np.linalg.norm(away, axis=-1))

    def squeezed(self, stretch: float) -> SizeField:
        """The same field in the space squeezed along y."""
        low, high = list(self.low), list(self.high)
        low[1], high[1] = low[1] / stretch, high[1] / stretch
        return SizeField((low[0], low[1], low[2]), (high[0], high[1], high[2]), self.contact, self.growth, self.far)

    def background(self, lower: Array, upper: Array) -> tuple[Array, NDArray[np.int32], Array]:
        """A tetrahedral mesh over the bounding box, its points close where the field is small, and the field at the points."""
        lines = []
        for axis in range(3):
            kinks = {float(lower[axis]), float(upper[axis])}
            for k in (self.low[axis], self.high[axis]):
                kinks |= {k, -k} if axis < 2 else {k}
            stops = sorted(k for k in kinks if lower[axis] <= k <= upper[axis])
            line = [stops[0]]
            for a, b in zip(stops[:-1], stops[1:], strict=True):
                line += _graded(a, b, lambda s, axis=axis: self._along(axis, s))
            lines.append(np.array(line))
        points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
        number = np.arange(len(points)).reshape([len(line) for line in lines])
        nx, ny, nz = (len(line) - 1 for line in lines)
        corner = [number[i : nx + i, j : ny + j, k : nz + k].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        paths = [(1, 2), (1, 4), (2, 1), (2, 4), (4, 1), (4, 2)]  # Kuhn: six tets along the paths from corner 0 to corner 7
        tets = np.vstack([np.stack([corner[0], corner[a], corner[a + b], corner[7]], axis=1) for a, b in paths])
        return points, tets.astype(np.int32), self(points)

    def _along(self, axis: int, value: float) -> float:
        """The smallest field on the plane where coordinate `axis` is `value`."""
        v = abs(value) if axis < 2 else value
        return min(self.far, self.contact + self.growth * max(self.low[axis] - v, v - self.high[axis], 0.0))


def _graded(a: float, b: float, size: Callable[[float], float]) -> list[float]:
    """Points from a (left out) to b, each step at most two local edge lengths."""
    out, at = [], a
    while True:
        step = 2.0 * min(size(at), size(min(b, at + 2.0 * size(at))))
        if at + 1.3 * step >= b:
            return [*out, b]
        at += step
        out.append(at)
