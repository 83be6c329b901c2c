"""Can the spread be honest in every row? Corrections fitted to the predictions of some test presses, tried on others.

    python docs/studies/spread_by_row.py 51/predictions.csv 52/predictions.csv

The files are those of `gelsim-learn eval` on datasets of plan paper2017 with two seeds. A correction knows the estimate, its spread and
its novelty, never the row: it multiplies spreads s by c xᵇ, x one of these, b by the largest likelihood of errors as Student's with five
degrees of freedom, c so that 90 % of the errors lie within 1.645 s; *shift* first takes p + q log novelty off the estimate, by least
squares. Rows count alike in every fit. Each is fitted to one seed and told of the other ("other seed": the same kinds of shapes, other
objects), and fitted to both without the row of which it is told ("without the row": a kind of shape never seen). *A factor a row* knows
the row, and these very presses: the bound. Told: % of presses within 90 % (mean spread), RMSE; mean spread over today's, of presses and
of rows.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

ROWS = ("novel_hardness", "novel_shape", "robot", "vessels", "complicated")
CERTAIN, FREEDOM = 1.645, 5
REACH = 3.0
"""Standard deviations of log x from its mean beyond which a correction grows no more."""
Array = NDArray[np.float64]


class Presses:
    """What eval said of presses of known hardness in which something touches."""

    def __init__(self, files: list[Path]) -> None:
        read = [line | {"seed": str(file)} for file in files for line in csv.DictReader(file.open(newline=""))]
        kept = [line for line in read if line["split"] in ROWS and line["true"] and line["contact"] == "True"]
        self.row, self.seed = (np.array([line[name] for line in kept]) for name in ("split", "seed"))
        self.estimate, true, self.spread, self.novelty = (
            np.array([float(line[name]) for line in kept]) for name in ("estimate", "true", "spread", "novelty")
        )
        self.error = self.estimate - true

    def logarithm(self, name: str) -> Array:
        return np.log(np.maximum(getattr(self, name), 1.0 if name == "estimate" else 1e-3))


def alike(rows: NDArray[np.str_]) -> Array:
    """Weights of presses by which rows count alike; they sum to 1."""
    weight = np.array([1 / np.sum(rows == row) for row in rows])
    return weight / weight.sum()


def standard(values: Array, of: NDArray[np.bool_]) -> Array:
    """Values less the mean of some, over their standard deviation, no further than REACH."""
    return np.clip((values - values[of].mean()) / (values[of].std() + 1e-9), -REACH, REACH)


def factor(spread: Array, error: Array, x: Array | None, rows: NDArray[np.str_], of: NDArray[np.bool_]) -> Array:
    """By which every press's spread is multiplied, fitted to those `of`."""
    weight, z = alike(rows[of]), np.abs(error / spread)
    power = np.zeros_like(z)
    if x is not None:
        u = standard(x, of)

        def loss(both: Array) -> float:
            log_factor = both[0] + both[1] * u[of]
            return float(weight @ (log_factor + (FREEDOM + 1) / 2 * np.log1p((z[of] / np.exp(log_factor)) ** 2 / FREEDOM)))

        power = minimize(loss, np.zeros(2), method="BFGS").x[1] * u
    left = (z / np.exp(power))[of]
    order = np.argsort(left)
    ninety = left[order][min(int(np.searchsorted(np.cumsum(weight[order]), 0.9)), len(order) - 1)]
    return ninety / CERTAIN * np.exp(power)


def shift(error: Array, x: Array, rows: NDArray[np.str_], of: NDArray[np.bool_]) -> Array:
    """What is taken off every press's estimate, fitted to those `of`."""
    u, weight = standard(x, of), np.sqrt(alike(rows[of]))
    terms = np.column_stack([np.ones_like(u), u])
    return terms @ np.linalg.lstsq(terms[of] * weight[:, None], error[of] * weight, rcond=None)[0]


def told(name: str, presses: Presses, spread: Array, error: Array) -> None:
    """A line of the table."""
    cells, within = [], np.abs(error) <= CERTAIN * spread
    rows = [row for row in ROWS if (presses.row == row).any()]
    for row in rows:
        here = presses.row == row
        cells.append(f"{100 * within[here].mean():.0f} ({spread[here].mean():.1f}), {np.sqrt((error[here] ** 2).mean()):.1f}")
    means = [np.mean([values[presses.row == row].mean() for row in rows]) for values in (spread, presses.spread)]
    print(f"| {name} | " + " | ".join(cells) + f" | {spread.mean() / presses.spread.mean():.2f}, {means[0] / means[1]:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("predictions", nargs=2, type=Path, help="predictions.csv of one seed and of the other")
    presses = Presses(parser.parse_args().predictions)
    rows = [row for row in ROWS if (presses.row == row).any()]
    titles = " | ".join(f"{row}, {(presses.row == row).sum()}" for row in rows)
    print(f"| correction | {titles} | width |\n" + "|---" * (len(rows) + 2) + "|")
    told("today's", presses, presses.spread, presses.error)
    row_factor = np.ones_like(presses.spread)
    for row in rows:
        here = presses.row == row
        row_factor[here] = np.quantile(np.abs(presses.error / presses.spread)[here], 0.9) / CERTAIN
    told("a factor a row", presses, presses.spread * row_factor, presses.error)
    for how, groups in (("other seed", presses.seed), ("without the row", presses.row)):
        for name in (None, "novelty", "spread", "estimate", "shift"):
            spread, error = presses.spread.copy(), presses.error.copy()
            for group in np.unique(groups):
                here, moved = groups == group, presses.error
                x = None if name is None else presses.logarithm("novelty" if name == "shift" else name)
                if name == "shift" and x is not None:
                    moved = presses.error - shift(presses.error, x, presses.row, ~here)
                wider = factor(presses.spread, moved, x, presses.row, ~here)
                spread[here], error[here] = (presses.spread * wider)[here], moved[here]
            told(f"{how}: {name or 'one factor'}", presses, spread, error)


if __name__ == "__main__":
    main()
