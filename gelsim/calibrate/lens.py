"""A lens's distortion, seen by a grid of markers (by edges: `calibrate.edges`) and taken out of photographs.

A point at u from the picture's middle, in half diagonals, as a pinhole would show it, is seen at u (1 + k |u|²) (Brown 1971, first radial
term): k > 0 is a pincushion, k < 0 a barrel. The grid's dots lie where a homography and k take them, by least squares; k is believed from
`SURE` standard deviations on. Photographs are drawn anew as the pinhole would have seen them, as large as all their pixels allow. Left out:
further terms, a centre of its own (beside k it moved a real lens's dots by 0.02 px), the refraction of window and gel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST = 20
"""Dots of the grid."""
SURE = 4.0
RANGE = (-0.14, 1.0)
"""Of k: from -4/27 on a picture's corners show nothing that a pinhole would."""
NEAR = 0.35
"""How far off a neighbour may lie, of the step to it."""


@dataclass(frozen=True)
class Lens:
    """Distortion of pictures of one size."""

    k: float
    size: tuple[int, int]
    """Width and height [px]."""
    sd: float = 0.0
    """Standard deviation of k; 0 of one that was given."""
    by: str = "photos.toml"
    """What told of it."""

    @cached_property
    def scale(self) -> float:
        """Pixels of the photograph in one that is straight, at the middle: the largest picture of this size in which all was seen."""
        width, height = self.size
        column, row = np.linspace(0, width, 65), np.linspace(0, height, 65)
        rim = np.concatenate([np.stack([column, 0 * column], 1), np.stack([0 * row, row], 1)])
        low, high = 0.2, 5.0
        for _ in range(50):
            middle = (low + high) / 2
            seen = self._seen(rim, middle)
            low, high = (middle, high) if (seen.min(axis=0) >= -1e-9).all() else (low, middle)
        return low

    def seen(self, straight: Array) -> Array:
        """Where the photograph shows places (..., 2) (column, row) [px] of the straight picture."""
        return self._seen(straight, self.scale)

    def straight(self, seen: Array) -> Array:
        """The other way about, by Newton's method along the radius."""
        return self._middle + unbent((seen - self._middle) / self._half, self.k) * self._half / self.scale

    def straightened(self, levels: Array) -> Array:
        """A photograph (H, W, 3) as a pinhole would have seen it."""
        from scipy.ndimage import map_coordinates

        row, column = np.mgrid[: self.size[1], : self.size[0]] + 0.5
        at = np.moveaxis(self.seen(np.stack([column, row], axis=-1))[..., ::-1] - 0.5, -1, 0)
        drawn = [map_coordinates(levels[..., colour], at, order=3, mode="nearest") for colour in range(3)]
        return np.clip(np.stack(drawn, axis=-1), 0, 255)

    @property
    def _middle(self) -> Array:
        return np.array(self.size) / 2

    @property
    def _half(self) -> float:
        return float(np.hypot(*self._middle))

    def _seen(self, straight: Array, scale: float) -> Array:
        away = (straight - self._middle) / self._half * scale
        return self._middle + away * (1 + self.k * (away**2).sum(axis=-1, keepdims=True)) * self._half


def unbent(seen: Array, k: float) -> Array:
    """Places (..., 2) from the middle [half diagonals] as a pinhole would show what is seen at `seen`."""
    size = np.linalg.norm(seen, axis=-1, keepdims=True)
    found = size.copy()
    for _ in range(20):
        found = found - (found * (1 + k * found**2) - size) / (1 + 3 * k * found**2)
    return seen * np.where(size > 0, found / np.where(size > 0, size, 1), 1)


def fitted_lens(dots: Array, size: tuple[int, int]) -> Lens | None:
    """Of the dots (K, 2) (column, row) [px] of a grid; None where they do not tell."""
    from scipy.optimize import least_squares

    places, numbers = numbered(dots, np.array(size) / 2)
    if len(places) < FEWEST:
        return None
    middle, half = np.array(size) / 2, float(np.hypot(*size)) / 2
    seen, grid = (places - middle) / half, np.column_stack([numbers, np.ones(len(numbers))])

    def residuals(unknowns: Array) -> Array:
        moved = grid @ np.append(unknowns[:8], 1.0).reshape(3, 3).T
        away = moved[:, :2] / moved[:, 2:]
        return (away * (1 + unknowns[8] * (away**2).sum(axis=1, keepdims=True)) - seen).ravel()

    plain = np.linalg.lstsq(grid, seen, rcond=None)[0].T
    fit = least_squares(residuals, np.concatenate([plain.ravel(), np.zeros(3)]), x_scale="jac")
    freedom = len(fit.fun) - len(fit.x)
    spread = np.sqrt(np.linalg.inv(fit.jac.T @ fit.jac)[8, 8] * (fit.fun**2).sum() / freedom)
    k = float(fit.x[8])
    return Lens(k, size, float(spread), "markers") if abs(k) > SURE * spread and RANGE[0] <= k <= RANGE[1] else None


def numbered(dots: Array, middle: Array) -> tuple[Array, Array]:
    """The dots that are reached from the one in the middle, neighbour by neighbour, (N, 2), and their numbers along the grid, (N, 2)."""
    from scipy.spatial import KDTree

    if len(dots) < FEWEST:
        return dots[:0], dots[:0]
    tree = KDTree(dots)
    pitch = float(np.median(tree.query(dots, k=2)[0][:, 1]))
    first = int(tree.query(middle)[1])
    around = dots[np.asarray(tree.query(dots[first], k=9)[1])[1:]] - dots[first]
    steps = tuple(around[np.linalg.norm(around - way, axis=1).argmin()] for way in pitch * np.eye(2))
    number, step, todo = {first: (0, 0)}, {first: steps}, [first]
    while todo:
        here = todo.pop(0)
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            way = sign * step[here][axis]
            off, there = tree.query(dots[here] + way)
            there = int(there)
            if there in number or off > NEAR * np.linalg.norm(way):
                continue
            new = list(step[here])
            new[axis] = 0.6 * new[axis] + 0.4 * sign * (dots[there] - dots[here])  # steps change slowly over the picture
            at = list(number[here])
            at[axis] += sign
            number[there], step[there] = (at[0], at[1]), (new[0], new[1])
            todo.append(there)
    reached = list(number)
    return dots[reached], np.array([number[index] for index in reached], float)
