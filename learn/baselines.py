"""What a network must beat: the training mean, and ridge regression on hand-made features. Plain NumPy.

    w = (XᵀX + λI)⁻¹ Xᵀ (y − ȳ),  X standardised over the training presses; λ by leave-one-out, in closed form from the hat matrix H:
    e_i = (y_i − ŷ_i) / (1 − H_ii)

"last frame" sees the features (`learn.features`) at the end of loading alone; "over time" sees them at STEPS equal steps of the intensity
change; "kernel" is the same with K = exp(−|x − x'|² / 2ℓ²) in place of XXᵀ, ℓ² = the number of features, and can follow curves as a boosted
ensemble of trees would, without another dependency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from learn.config import InputConfig
from learn.frames import equal_steps, loading

STEPS = 5
RIDGES = 10.0 ** np.arange(-4, 5)
"""λ as a share of the mean eigenvalue."""
NAMES = ("training mean", "features, last frame", "features over time, ridge", "features over time, kernel")
Curve = tuple[NDArray[np.floating], NDArray[np.floating]]
"""Signal (N,) and features (N, F) of a press."""


@dataclass(frozen=True, eq=False)
class Baselines:
    """The presses that were learnt from."""

    curves: list[NDArray[np.float64]]
    """Features over time of each, shape (STEPS * F,)."""
    target: NDArray[np.float64]
    """Shore 00, shape (B,)."""
    count: int
    """F."""
    _known: dict[str, _Fitted] = field(default_factory=dict)

    def predict(self, name: str, asked: Sequence[NDArray[np.float64] | None]) -> NDArray[np.float64]:
        """Shore 00 of presses; None, a press without contact, gets the training mean."""
        answer = np.full(len(asked), self.target.mean())
        seen = [number for number, curve in enumerate(asked) if curve is not None]
        if name == NAMES[0] or not seen:
            return answer
        fitted = self._fitted(name)
        test = np.stack([curve for curve in asked if curve is not None])[:, fitted.columns]
        answer[seen] += fitted.against((test - fitted.middle) / fitted.scale) @ fitted.weights
        return answer

    def _fitted(self, name: str) -> _Fitted:
        if name not in self._known:
            columns = slice(-self.count, None) if name == NAMES[1] else slice(None)
            train = np.stack(self.curves)[:, columns]
            middle, scale = train.mean(axis=0), train.std(axis=0)
            scale[scale < 1e-12] = 1.0
            train = (train - middle) / scale
            fitted = _Fitted(columns, middle, scale, train, name == NAMES[3], np.empty(0))
            weights = ridge_weights(fitted.against(train), self.target - self.target.mean())
            self._known[name] = replace(fitted, weights=weights)
        return self._known[name]


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A regression that was solved once, for however many presses are asked of it."""

    columns: slice
    middle: NDArray[np.float64]
    scale: NDArray[np.float64]
    train: NDArray[np.float64]
    curved: bool
    weights: NDArray[np.float64]

    def against(self, test: NDArray[np.float64]) -> NDArray[np.float64]:
        """The kernel between standardised presses (A, F) and those learnt from, shape (A, B)."""
        return _kernel(test, self.train) if self.curved else test @ self.train.T


def over_time(curve: Curve, inputs: InputConfig) -> NDArray[np.float64] | None:
    """Features of a press at equal steps of its signal, the last ones those of the end; None without contact."""
    signal, features = curve
    among = loading(signal, inputs)
    if len(among) == 0:
        return None
    return features[equal_steps(signal, among, STEPS, repeat=True)].astype(np.float64).ravel()


def fit_baselines(curves: Sequence[Curve], target: NDArray[np.floating], inputs: InputConfig) -> Baselines:
    """From presses of known hardness."""
    found = [over_time(curve, inputs) for curve in curves]
    usable = [number for number, curve in enumerate(found) if curve is not None]
    return Baselines([curve for curve in found if curve is not None], np.asarray(target, float)[usable], curves[0][1].shape[1])


def _kernel(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    squared = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.exp(-np.maximum(squared, 0) / (2 * a.shape[1]))


def ridge_weights(gram: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """α of ŷ = K α with the λ that leaves the smallest leave-one-out error."""
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0)
    projected, best, chosen = vectors.T @ y, np.inf, np.zeros_like(y)
    for ridge in RIDGES * values.mean():
        alpha = vectors @ (projected / (values + ridge))
        hat = (vectors**2 * (values / (values + ridge))).sum(axis=1)
        error = float((((y - gram @ alpha) / np.maximum(1 - hat, 1e-9)) ** 2).mean())
        if error < best:
            best, chosen = error, alpha
    return chosen
