"""What the layer's answer lacks of finite elements', learnt: a small convolutional network over the displacement that the layer shows.

    δu = h N(u / h, √(p / G), q / √(p G)),       over cells of h / CELLS, thicknesses h and shear moduli G of the gel

By similarity one network serves all gels and, as tractions and displacement of its face say what an elastic gel does, all objects. Cells
are taken in fours, so that kernels of 3 × 3 reach twice as far; of nothing it makes nothing, layer by layer, whatever its biases. Forces
and what friction remembers are the layer's alone.

Trained by docs/studies/live_residual.py on presses that are no part of any table; weights in assets/models/live_residual.npz.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from gelsim.live import layer as gel_layer
from gelsim.live.layer import Layer, Values
from gelsim.scene.layers import assets_folder

CELLS = 12
"""Of the network's grid, in a thickness."""
ALIKE = 0.05
"""Relative difference of the layer's cells from these, up to which they serve."""
MARGIN, FADE = 12, 6
"""Cells around the contact for which something is found, and the outer ones of these, over which it fades."""
REACH = 14
"""Cells beyond one that change what is found there: two for each layer, and its quarter."""
WEIGHTS = "models/live_residual.npz"
"""Among the assets."""
LEAST = 1e-12
"""Of √(pG) [kPa], which nothing is divided by."""

Conv = Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Kernel:
    """Of one layer."""

    weights: Any
    """(out, in, 3, 3)."""
    bias: Any
    """(out, 1, 1)."""


def inputs(displacement: Any, pressure: Any, shear: Any, thickness: float, shear_kpa: float) -> list[Any]:
    """The six that the network sees, each (..., rows, columns): of NumPy or PyTorch; components are first.

    Of shear no more than a friction of 1 bears, the most that it was shown.
    """
    root = (pressure / shear_kpa) ** 0.5
    over = root * shear_kpa + LEAST
    return [*(part / thickness for part in displacement), root, *(part.clip(min=-pressure, max=pressure) / over for part in shear)]


def answer(seen: Any, kernels: Sequence[Kernel], conv: Conv) -> Any:
    """The network: (..., 6, rows, columns) to (..., 3, rows, columns), both even. `conv`: correlation by 3 × 3, zeros around.

    No cell that touches is lifted into the object.
    """
    first, *others, last = kernels
    x = _bent(conv(in_fours(seen), first.weights), first.bias)
    for kernel in others:
        x = x + _bent(conv(x, kernel.weights), kernel.bias)
    found = spread(conv(x, last.weights))
    kept = 1.0 * found
    kept[..., 2:, :, :] -= found[..., 2:, :, :].clip(min=0) * (seen[..., 3:4, :, :] > 0)
    return kept


def in_fours(values: Any) -> Any:
    """Fields (..., c, rows, columns) as (..., 4 c, rows / 2, columns / 2)."""
    *many, count, rows, columns = values.shape
    parts = values.reshape(*many, count, rows // 2, 2, columns // 2, 2)
    return parts.swapaxes(-2, -1).swapaxes(-4, -2).swapaxes(-5, -3).reshape(*many, 4 * count, rows // 2, columns // 2)


def spread(values: Any) -> Any:
    """Back."""
    *many, count, rows, columns = values.shape
    parts = values.reshape(*many, 2, 2, count // 4, rows, columns)
    return parts.swapaxes(-5, -3).swapaxes(-4, -2).swapaxes(-2, -1).reshape(*many, count // 4, 2 * rows, 2 * columns)


def _bent(x: Any, bias: Any) -> Any:
    """Rectified about a bias; 0 of 0."""
    return (x + bias).clip(min=0) - bias.clip(min=0)


def convolved(x: Values, weights: Values) -> Values:
    """`Conv` of NumPy, (in, rows, columns) to (out, rows, columns)."""
    around = np.pad(x, ((0, 0), (1, 1), (1, 1)))
    seen = np.lib.stride_tricks.sliding_window_view(around, (3, 3), axis=(1, 2)).transpose(0, 3, 4, 1, 2)
    return (weights.reshape(len(weights), -1) @ seen.reshape(-1, x.shape[1] * x.shape[2])).reshape(-1, *x.shape[1:])


class Residual:
    """Of a gel."""

    def __init__(self, layer: Layer, thickness: float) -> None:
        """`thickness` of the gel at its thickest [mm]."""
        self.thickness, self.shear_kpa = thickness, layer.material.shear_kpa
        same = all(abs(cell * CELLS / thickness - 1) < ALIKE for cell in layer.cell)
        counts = [
            2 * max(1, round(count * cell * CELLS / thickness / 2)) for count, cell in zip(layer.shape, layer.cell[::-1], strict=True)
        ]
        self.shape = layer.shape if same else (counts[0], counts[1])
        """Rows and columns of the network's grid: the layer's, or one over as much."""
        self.to, self.back = _between(layer.shape, self.shape), _between(self.shape, layer.shape)
        """Matrices to it and back, of rows and of columns; None where the layer has as many."""

    def seen(self, displacement: Values, pressure: Values, shear: Values) -> Values:
        """`inputs` over the network's grid, (6, rows, columns), by what is over the layer's."""
        return resampled(np.stack(inputs(displacement, pressure, shear, self.thickness, self.shear_kpa)), self.to)

    def __call__(self, displacement: Values, pressure: Values, shear: Values) -> Values:
        """What the layer's displacement lacks [mm], (3, rows, columns)."""
        with _threads().limit(limits=1):  # two on busy cores wait for each other: 200 ms in place of 9
            return self._found(self.seen(displacement, pressure, shear))

    def _found(self, seen: Values) -> Values:
        ways = [_around(np.flatnonzero(seen[3].any(axis=axis)), count) for axis, count in zip((1, 0), self.shape, strict=True)]
        (rows, fading), (columns, beside) = ways
        found = np.zeros((3, *self.shape), np.float32)
        found[:, rows, columns] = answer(seen[:, rows, columns], kernels(), convolved) * fading[:, None] * beside
        return resampled(found, self.back) * np.float32(self.thickness)


def fade(cells: Any, first: Any, last: Any) -> Any:
    """How much counts of cells of an axis, where those from a first to a last one touch."""
    away = (first - cells).clip(min=0) + (cells - last).clip(min=0)
    return ((MARGIN - away) / FADE).clip(min=0.0, max=1.0)


def resampled(values: Any, ways: tuple[Any, Any]) -> Any:
    """Fields (..., rows, columns), by matrices of rows and of columns; None leaves them."""
    for way, axis in zip(ways, (-2, -1), strict=True):
        if way is not None:
            values = way @ values if axis == -2 else values @ way.T
    return values


def _around(touched: NDArray[np.intp], count: int) -> tuple[slice, Values]:
    """Cells of an axis around those that touch, an even number of them from an even one on; and how much counts of each."""
    first, last = (int(touched[0]), int(touched[-1])) if len(touched) else (0, 0)
    place = slice(max(0, first - MARGIN - REACH) // 2 * 2, min(count, (last + MARGIN + REACH + 2) // 2 * 2))
    return place, fade(np.arange(place.start, place.stop), first, last).astype(np.float32)


def _between(shape: tuple[int, int], to: tuple[int, int]) -> tuple[Values | None, Values | None]:
    """Of `resampled`, from one grid over a gel to another."""
    return _resampled(shape[0], to[0]), _resampled(shape[1], to[1])


def _resampled(count: int, to: int) -> Values | None:
    """From so many cells to others over the same length, by cubic convolution, (to, count); None to as many."""
    if count == to:
        return None
    place = np.clip((np.arange(to) + 0.5) * count / to - 0.5, 0.0, count - 1.0)
    before = np.minimum(place.astype(np.intp), count - 2)
    found = np.zeros((to, count), np.float32)
    for step, share in enumerate(gel_layer.keys(place - before)):
        np.add.at(found, (np.arange(to), np.clip(before + step - 1, 0, count - 1)), share.astype(np.float32))
    return found


@lru_cache(maxsize=1)
def _threads() -> ThreadpoolController:
    return ThreadpoolController()


@lru_cache(maxsize=1)
def kernels() -> tuple[Kernel, ...]:
    """Those that were learnt."""
    with np.load(assets_folder() / WEIGHTS) as kept:
        count = len(kept.files) // 2
        return tuple(Kernel(*(kept[f"{part}{i}"].astype(np.float32) for part in ("weights", "bias"))) for i in range(count))
