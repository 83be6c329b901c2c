"""Pictures of an evaluation, drawn without a display."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from statistics import NormalDist

import numpy as np
from matplotlib.figure import Figure

from learn.scores import Array

SCALE = (0, 100)


def against_truth(path: Path, title: str, true: Array, estimate: Array, spread: Array) -> None:
    """Estimate against truth, each press a point with its spread."""
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(SCALE, SCALE, color="0.7", linewidth=1)
    bars = spread if np.isfinite(spread).all() else None
    axes.errorbar(true, estimate, yerr=bars, fmt="o", markersize=3, elinewidth=0.5, alpha=0.5)
    axes.set(title=title, xlabel="true hardness [Shore 00]", ylabel="estimate [Shore 00]", xlim=SCALE, ylim=(-10, 120), aspect="equal")
    figure.savefig(path, dpi=120)


def spread_honesty(path: Path, true: Array, estimate: Array, spread: Array) -> None:
    """Left: share of presses inside central intervals against what the spread promises. Right: error against spread, by hardness."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    levels = np.linspace(0.02, 0.98, 49)
    z = np.abs(true - estimate) / spread
    left.plot((0, 1), (0, 1), color="0.7", linewidth=1)
    left.plot(levels, [(z <= NormalDist().inv_cdf(0.5 + level / 2)).mean() for level in levels])
    left.set(title="calibration", xlabel="promised", ylabel="found", aspect="equal")
    marks = right.scatter(spread, np.abs(true - estimate), c=true, s=8, vmin=0, vmax=100)
    right.set(title="error against spread", xlabel="spread [Shore 00]", ylabel="|error| [Shore 00]")
    figure.colorbar(marks, label="true hardness [Shore 00]")
    figure.savefig(path, dpi=120)


def errors_by(path: Path, groups: Mapping[str, Mapping[str, Mapping[str, float]]]) -> None:
    """RMSE and bias of the presses of each key, a panel a group."""
    figure = Figure(figsize=(4 * len(groups), 4), layout="constrained")
    for (name, values), axes in zip(groups.items(), figure.subplots(1, len(groups), squeeze=False)[0], strict=True):
        keys = sorted(values, key=lambda key: (float("".join(c for c in key.split("–")[0] if c in "0123456789.") or "inf"), key))
        at = np.arange(len(keys))
        axes.bar(at, [values[key]["rmse"] for key in keys], color="C0", label="RMSE")
        axes.plot(at, [values[key]["bias"] for key in keys], "o", color="C1", label="bias")
        axes.set_xticks(at, [f"{key} ({values[key]['presses']})" for key in keys], rotation=60, ha="right", fontsize=7)
        axes.axhline(0, color="0.5", linewidth=0.5)
        axes.set(title=name, ylabel="[Shore 00]")
        axes.legend(fontsize=7)
    figure.savefig(path, dpi=120)
