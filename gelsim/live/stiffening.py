"""By how much more than the flat linear layer a gel answers: what the layer's forces are multiplied by, learnt.

    1 + s N(x),    s the gel's share of what gives way, 1 under a rigid object

x are roots of seven numbers that have no unit, means over the pressure p: indentation over thickness h, p / G, area (Σp)² / Σp² over h²,
edges h Σ|∇p| / Σp, shear |q| / p, the face's slope squared, and the share of the layer's work that a thinner layer would not do. By
similarity one law serves all gels. They change as evenly as the pressure does, so that no cell which joins makes a step, and count no
further than they were seen. Where p is, and what friction remembers, stays as it was.

Trained by docs/studies/live_residual.py on presses that are no part of any table; numbers in assets/models/live_stiffening.npz.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from gelsim.live.layer import TINY
from gelsim.scene.layers import assets_folder

NUMBERS = "models/live_stiffening.npz"
"""Among the assets."""
SUMS = -2, -1
"""Rows and columns."""


@dataclass(frozen=True)
class Law:
    """N, by weights of NumPy or PyTorch."""

    low: Any
    """Least x that was seen, (7,)."""
    high: Any
    least: Any
    """N that was found there."""
    most: Any
    layers: tuple[tuple[Any, Any], ...]
    """(out, in) and (out,)."""

    def __call__(self, x: Any) -> Any:
        """Of (..., 7), (...)."""
        *hidden, (weights, bias) = self.layers
        values = x.clip(self.low, self.high)
        for to, beside in hidden:
            values = values @ to.T + beside
            values = values / (1.0 + abs(values))
        return (values @ weights.T + bias)[..., 0].clip(self.least, self.most)

    def on(self, take: Callable[[Any], Any]) -> Law:
        """The same where `take` puts its numbers."""
        layers = tuple((take(weights), take(bias)) for weights, bias in self.layers)
        return Law(take(self.low), take(self.high), take(self.least), take(self.most), layers)


@lru_cache(maxsize=1)
def law() -> Law:
    """That which was learnt."""
    with np.load(assets_folder() / NUMBERS) as kept:
        count = len(kept.files) // 2 - 2
        layers = tuple((kept[f"weights{i}"], kept[f"bias{i}"]) for i in range(count))
        return Law(kept["low"], kept["high"], kept["least"], kept["most"], layers)


@dataclass(frozen=True)
class Scale:
    """What x are measured by."""

    thickness: Any
    """[mm], one or (n,)."""
    less: Any
    """By how much less work is done of a thinner layer [per mm], likewise."""
    shear_kpa: float
    cell: float
    """Area [mm²]."""


def measures(scale: Scale, pressure: Any, shear: Any, steep: Any, moved: Any, slope: Any) -> list[Any]:
    """x, one or (n,) each, of fields (rows, columns) of NumPy or (n, rows, columns) of PyTorch [kPa, mm].

    Args:
        shear: Its length.
        steep, slope: Of the pressure, and of the face's height, along x and along y.
        moved: Along z.
    """
    total, squares = pressure.sum(SUMS) + TINY, (pressure**2).sum(SUMS) + TINY
    found = [
        -(pressure * moved).sum(SUMS) / total / scale.thickness,
        squares / (total * scale.shear_kpa),
        total**2 / squares * scale.cell / scale.thickness**2,
        ((steep[0] ** 2 + steep[1] ** 2) ** 0.5).sum(SUMS) / total * scale.thickness,
        shear.sum(SUMS) / total,
        (pressure * (slope[0] ** 2 + slope[1] ** 2)).sum(SUMS) / total,
        scale.less * scale.thickness,
    ]
    return [value.clip(0.0) ** 0.5 for value in found]


def share(pressure: Any, moved: Any, met: Any) -> Any:
    """s, by the way of the gel's face and that of gel and object together, along z: fields as of `measures`."""
    return ((pressure * moved).sum(SUMS) / ((pressure * met).sum(SUMS) - TINY)).clip(0.0, 1.0)
