"""How good estimates are: errors with intervals, honesty of the spread, order. Plain NumPy.

    R² = 1 − Σ(y − ŷ)² / Σ(y − ȳ)²,  ȳ the mean of the row itself;   RMSE = √ mean (y − ŷ)²
    coverage(p) = share of presses with |y − ŷ| ≤ z_p s;   Spearman = correlation of the ranks, ties share their mean rank

Intervals: the bootstrap over objects, 95 %, percentiles: presses of one object are not independent, so whole objects are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

BOOTSTRAPS = 2000
LEVELS = (0.5, 0.8, 0.9, 0.95)
"""Central intervals whose coverage is reported."""
PAIR_GAP = 10.0
"""Two presses count as a pair to be told apart when their hardness differs by this at least [Shore 00] …"""
PAIR_BANDS = ((0.0, 40.0), (40.0, 70.0), (70.0, 100.0))
"""… and both lie in one of these bands: the paper says that a gel of 17 does not tell well above 70."""
Array = NDArray[np.float64]


def rmse(true: Array, estimate: Array) -> float:
    return float(np.sqrt(((true - estimate) ** 2).mean()))


def r_squared(true: Array, estimate: Array) -> float:
    """NaN where all presses have one hardness."""
    total = ((true - true.mean()) ** 2).sum()
    return float(1 - ((true - estimate) ** 2).sum() / total) if np.ptp(true) else float("nan")


def bootstrap(true: Array, estimate: Array, objects: Sequence[str], seed: int = 0) -> dict[str, list[float]]:
    """95 % intervals of RMSE and R², whole objects drawn with replacement; NaN with fewer than two objects.

    Both measures are functions of sums over presses, so a draw of objects is a weighting of each object's sums.
    """
    names, owner = np.unique(np.asarray(objects), return_inverse=True)
    if len(names) < 2:
        return {"rmse": [float("nan")] * 2, "r2": [float("nan")] * 2}
    parts = (np.ones_like(true), true, true**2, (true - estimate) ** 2)
    sums = np.stack([np.bincount(owner, weights=part, minlength=len(names)) for part in parts])
    weights = np.random.default_rng(seed).multinomial(len(names), np.full(len(names), 1 / len(names)), size=BOOTSTRAPS)
    count, first, second, error = sums @ weights.T
    total = second - first**2 / count
    with np.errstate(divide="ignore", invalid="ignore"):
        # A draw in which all presses have one hardness has no R².
        draws = {"rmse": np.sqrt(error / count), "r2": np.where(total > 1e-9 * second, 1 - error / total, np.nan)}
    return {
        name: list(map(float, np.nanpercentile(values, [2.5, 97.5]))) if np.isfinite(values).any() else [float("nan")] * 2
        for name, values in draws.items()
    }


def errors(true: Array, estimate: Array, objects: Sequence[str]) -> dict[str, Any]:
    """Count, R² and RMSE with their intervals, and the mean error."""
    interval = bootstrap(true, estimate, objects)
    return {
        "presses": len(true), "objects": len(set(objects)), "r2": r_squared(true, estimate), "r2_interval": interval["r2"],
        "rmse": rmse(true, estimate), "rmse_interval": interval["rmse"], "bias": float((estimate - true).mean()),
    }  # fmt: skip


def error_by(true: Array, estimate: Array, keys: Sequence[str]) -> dict[str, dict[str, float]]:
    """Count, RMSE and bias of the presses of each key."""
    names = np.asarray(keys)
    return {
        str(key): {
            "presses": int((names == key).sum()),
            "rmse": rmse(true[names == key], estimate[names == key]),
            "bias": float((estimate - true)[names == key].mean()),
        }
        for key in dict.fromkeys(keys)
    }


def calibration(true: Array, estimate: Array, spread: Array) -> dict[str, Any]:
    """Coverage of central intervals, and the root mean square of error over spread, which is 1 for an honest spread."""
    z = np.abs(true - estimate) / spread
    return {
        "coverage": {f"{level:.0%}": float((z <= NormalDist().inv_cdf(0.5 + level / 2)).mean()) for level in LEVELS},
        "rms_of_error_over_spread": float(np.sqrt((z**2).mean())),
        "mean_spread": float(spread.mean()),
    }


def told_apart(true: Array, estimate: Array) -> dict[str, dict[str, float]]:
    """For each band of hardness: pairs of presses that differ by PAIR_GAP or more, and the share whose estimates are in the right order."""
    found = {}
    for low, high in PAIR_BANDS:
        inside = np.flatnonzero((true >= low) & (true < high))
        gap = true[inside][:, None] - true[inside]
        pairs = gap >= PAIR_GAP
        order = (estimate[inside][:, None] - estimate[inside])[pairs]
        if pairs.any():
            share = float(((order > 0) + 0.5 * (order == 0)).mean())
            found[f"{low:g}–{high:g}"] = {"pairs": int(pairs.sum()), "right_order": share}
    return found


def spearman(a: ArrayLike, b: ArrayLike) -> float:
    """Rank correlation; NaN where one of them is constant."""
    ranks = [_ranks(np.asarray(values, float)) for values in (a, b)]
    if min(np.ptp(rank) for rank in ranks) == 0:
        return float("nan")
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def _ranks(values: Array) -> Array:
    _, position, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[position]


def ranking(rows: Sequence[Mapping[str, Any]], estimate: Array) -> dict[str, dict[str, Any]]:
    """Spearman over the objects of each shape, an object's estimate being the mean over its presses.

    The truth is the hardness of an object's body, which objects of several materials have too.
    """
    found = {}
    for shape in dict.fromkeys(row["shape"] for row in rows):
        mine = [number for number, row in enumerate(rows) if row["shape"] == shape]
        # Recordings of real objects have one hardness, simulated ones also that of what lies under a skin.
        hardness = {rows[number]["object"]: rows[number].get("body_shore_00", rows[number]["shore_00"]) for number in mine}
        body = {name: value for name, value in hardness.items() if value is not None}
        if len(body) < 2:
            continue
        said = {name: [estimate[number] for number in mine if rows[number]["object"] == name] for name in body}
        means = [np.mean(values) for values in said.values()]
        presses = sum(map(len, said.values()))
        found[shape] = {"objects": len(body), "presses": presses, "spearman": spearman(list(body.values()), means)}
    return found
