"""How long the edges of a mesh should be, and where: fine in the expected contact and along sharp rims in it, growing away from them.

    h(p) = min(h_far, h_contact + growth · d(p), h_i + rim_growth · r_i(p)),
    d = distance to the area in which contact is expected, a box or a disc of some depth; r_i = distance to the nearest of some points:
    of rims, of seams in an object, of where it touches first.

The area is the overlap of the undeformed object and gel at full depth plus a margin for drape and tangential travel; its half widths are
rounded up to a few classes, so that one gel mesh serves many presses. A rim is a sharp convex edge of the object that lies in the area:
there the pressure of a rigid body has its peak, and faces of the gel that straddle the edge let it through. Where a press begins at a
point, its first states touch a few faces of what resolves the whole: edges are shorter where the first of it touches. For objects fTetWild
takes h as the nodal values of a background mesh; the gel's bisection asks for it at corners.

Left out: rims that only come into contact by deformation or travel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.shape.solids import Array
from gelsim.units import MM

_CLASSES = (
    np.array([0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8, 3.4, 4.0, 4.8, 5.6, 6.7, 8.0, 9.5, 11.0, 13.0, 16.0, 25.0, 50.0]) * MM
)
"""Half widths of the contact area [m], about 2^(1/4) apart."""
LONGER = 1.3
"""Length of fTetWild's edges over what it is asked for, as we stop it: the background mesh asks for that much less (test_meshing.py)."""


OBJECT_COARSER = 1.3
"""Edge length in contact of the object over the gel's: less of it deforms, and its curved faces come out shorter than flat ones."""
OBJECT_COARSEST = 2.0
"""The same of an object that has much in contact (`MeshSizes.most_cubes`): its inside deforms less than its skin."""


@dataclass(frozen=True)
class MeshSizes:
    """How fine a mesh is; lengths in metres."""

    divisions: float
    """Edges across the narrow half width of the contact area."""
    finest: float
    coarsest_contact: float
    """Bounds of the edge length in contact: the gel's thickness wants two quadratic tets at least."""
    most_edges: float
    """Squares of the edge length over the contact area. A long or wide area would be resolved as a narrow one is: nine edges across, and as
    long ones along all of it."""
    most_cubes: float
    """Cubes of the edge length in the part of an object that is meshed finely; for more of them they are longer, up to OBJECT_COARSEST."""
    growth: float
    """Edge length gained per length away from the contact area."""
    rim: float
    """Edge length along sharp rims; the edge length in contact where that is shorter."""
    rim_growth: float
    core: float
    """Edge length where the press begins over that in contact, if it begins on a small part of the contact; 1 for no difference."""
    gel_far: float
    object_far: float
    envelope: float
    """How far fTetWild may move an object's surface before its vertices are put back, per smallest edge length. Twice as far takes a third
    less time and gives tets as good, but radii of contact that scatter more (docs/decisions/0010)."""
    deeper: bool
    """Whether the depth to which an object is fine is rounded up to a class as well: more presses of an object share its mesh."""


SIZES = {
    "fast": MeshSizes(4.5, 0.25 * MM, 1.9 * MM, 120.0, 400.0, 0.9, 0.50 * MM, 0.9, 1.0, 5.0 * MM, 8.0 * MM, 0.3, True),
    "balanced": MeshSizes(8.0, 0.18 * MM, 1.5 * MM, np.inf, np.inf, 0.8, 0.30 * MM, 0.9, 0.7, 4.5 * MM, 7.0 * MM, 0.15, False),
    "reference": MeshSizes(14.0, 0.085 * MM, 0.65 * MM, np.inf, np.inf, 0.7, 0.20 * MM, 0.9, 0.7, 3.0 * MM, 4.0 * MM, 0.15, False),
}


@dataclass(frozen=True)
class Footprint:
    """Where contact is expected: |x| and |y| between `low` and `high` [m], in the gel's frame."""

    low: tuple[float, float]
    high: tuple[float, float]
    stretch: float
    """How many times longer than wide tets may be along y."""
    round: bool = False
    """A disc (an ellipse's worth of rounded box) rather than a box."""
    side: tuple[int, int] = (0, 0)
    """Sign of the x, and of the y, at which all of it lies; 0 where it reaches over the middle."""

    def folded(self, points: Array) -> Array:
        """Points as `low` and `high` count them: on the area's side, or |x|, |y| where it has none."""
        signs = np.array(self.side)
        return np.concatenate([np.where(signs, signs * points[..., :2], np.abs(points[..., :2])), points[..., 2:]], axis=-1)


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
    squares = np.prod([(h - lo) * (1 if lo else 2) for lo, h in zip(area.low, area.high, strict=True)]) / area.stretch
    wanted = max(min(half[0], half[1]) / sizes.divisions, float(np.sqrt(squares / sizes.most_edges)))
    return float(np.clip(wanted, sizes.finest, sizes.coarsest_contact))


def object_edge(area: Footprint, depth: float, edge: float, most_cubes: float) -> float:
    """Edge length in contact [m] of an object that is fine to `depth` [m], the gel's being `edge` (`MeshSizes.most_cubes`)."""
    wide = np.prod([h if side else 2 * h for h, side in zip(area.high, area.side, strict=True)])
    wanted = round(float(np.cbrt(wide / area.stretch * depth / most_cubes)), 12)  # a mesh's key shall not hang on the last digit of a root
    return max(OBJECT_COARSER * edge, min(wanted, OBJECT_COARSEST * edge))


@dataclass(frozen=True, eq=False)
class SizeField:
    """Edge lengths [m] that grow linearly away from a box |x|, |y|, z in [low, high], its upright edges rounded, and away from some points;
    without the bars where it lies on one side."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    contact: float
    growth: float
    far: float
    rounding: float = 0.0
    """Radius of the upright edges [m]; 0 where the box does not reach to the axis."""
    near: tuple[tuple[Array, float], ...] = ()
    """Points (K, 3), |x| and |y| where it is mirrored, and the edge length at them, than which they are no farther apart."""
    near_growth: float = 0.0
    mirrored: tuple[bool, bool] = (True, True)
    """Whether it is the same at -x, and at -y."""

    def __call__(self, points: Array) -> Array:
        folded = np.concatenate([np.where(self.mirrored, np.abs(points[..., :2]), points[..., :2]), points[..., 2:]], axis=-1)
        high = np.array(self.high) - [self.rounding, self.rounding, 0.0]
        away = np.maximum(np.maximum(self.low - folded, folded - high), 0.0)
        aside = np.maximum(np.hypot(away[..., 0], away[..., 1]) - self.rounding, 0.0)
        size = np.minimum(self.far, self.contact + self.growth * np.hypot(aside, away[..., 2]))
        if self.near:
            from scipy.spatial import KDTree

            for places, edge in self.near:
                size = np.minimum(size, edge + self.near_growth * KDTree(places).query(folded)[0])
        return size

    @property
    def smallest(self) -> float:
        return min([self.contact, *(edge for _, edge in self.near)])

    def squeezed(self, stretch: float) -> SizeField:
        """The same field in the space squeezed along y; edges there may be `stretch` times longer along y when they are back."""
        squeeze = np.array([1.0, 1.0 / stretch, 1.0])
        low, high = (tuple(float(v) for v in np.array(corner) * squeeze) for corner in (self.low, self.high))
        return replace(self, low=low, high=high, near=tuple((places * squeeze, edge) for places, edge in self.near))

    def settings(self) -> tuple[object, ...]:
        """Everything it depends on, for a hash; a picometre does not matter."""
        near = [(np.round(places * 1e12).astype(np.int64).tolist(), edge) for places, edge in self.near]
        return (self.low, self.high, self.contact, self.growth, self.far, self.rounding, near, self.near_growth, self.mirrored)

    def background(self, lower: Array, upper: Array) -> tuple[Array, NDArray[np.int32], Array]:
        """A tetrahedral mesh over the bounding box, its points close where the field is small, and the field at the points."""
        lines = []
        for axis in range(3):
            kinks = {float(lower[axis]), float(upper[axis])}
            for k in (self.low[axis], self.high[axis]):
                kinks |= {k, -k} if axis < 2 and self.mirrored[axis] else {k}
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
        """The smallest field on the plane where coordinate `axis` is `value`, or a little less."""
        v = abs(value) if axis < 2 and self.mirrored[axis] else value
        size = min(self.far, self.contact + self.growth * max(self.low[axis] - v, v - self.high[axis], 0.0))
        for places, edge in self.near:
            size = min(size, edge + self.near_growth * float(np.abs(places[:, axis] - v).min()))
        return size


def _graded(a: float, b: float, size: Callable[[float], float]) -> list[float]:
    """Points from a (left out) to b, each step at most two local edge lengths."""
    out, at = [], a
    while True:
        step = 2.0 * min(size(at), size(min(b, at + 2.0 * size(at))))
        if at + 1.3 * step >= b:
            return [*out, b]
        at += step
        out.append(at)
