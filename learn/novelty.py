"""Is a press like those that the network was trained on? A distance of its pictures, and the range of gels.

The distance is Mahalanobis's, its threshold taken from held-out presses:

    d² = (f − μ)ᵀ Σ⁻¹ (f − μ) / F,     Σ = (1 − λ) S + λ diag(S)

f are F numbers of a press: the network's own features at its last picture, the gel not told, and plain statistics of the pictures (colour
and contrast of the no-contact frame and of the change, length), because features may forget what the pictures never varied in. μ and S are
of training draws; λ keeps Σ regular when presses are few. d is about 1 for a press like those. A press is called unlike them when d exceeds
what 99 % of the validation presses stay below, each by a fit without the sensor that saw it: another sensor is not unlike by itself. After
Lee et al. (NeurIPS 2018), with one class. It says nothing about presses that look alike and are not: pictures do not show how thick a gel
is. Where the gel is known, its numbers are compared with those of the training presses, one by one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from learn.config import LearnError
from learn.data import Batch, Gel
from learn.model import last_of

SHRINKAGE = 0.1
QUANTILE = 0.99
GEL_TOLD = (("thickness", "mm", 1), ("edge thickness", "mm", 1), ("hardness", "Shore 00", 0))
"""Of a `Gel`: what each number is called, its unit, and the decimals to which it is told and compared: a lab knows its own no better."""


def press_statistics(batch: Batch, features: torch.Tensor) -> torch.Tensor:
    """f of each press: network features (B, H) and statistics of the pictures, shape (B, H + 14), float64."""
    last = last_of(batch.pictures, batch.lengths)
    change = last - batch.background
    plain = [part.flatten(2) for part in (batch.background, change)]
    parts = [moment for part in plain for moment in (part.mean(dim=2), part.std(dim=2))]
    signal = torch.log1p(last_of(batch.signal, batch.lengths))
    return torch.cat([features, *parts, signal[:, None], batch.lengths[:, None].to(features.dtype)], dim=1).double().cpu()


@dataclass(frozen=True, eq=False)
class Novelty:
    """What training presses were like."""

    mean: torch.Tensor
    """μ, shape (F,)."""
    whitening: torch.Tensor
    """W with WᵀW = Σ⁻¹ / F, shape (F, F)."""
    threshold: float
    """Distance that QUANTILE of presses of other sensors stay below."""

    def distance(self, statistics: torch.Tensor) -> torch.Tensor:
        """d of presses (B, F), shape (B,)."""
        return ((statistics - self.mean) @ self.whitening.T).norm(dim=1)

    def strangeness(self, statistics: torch.Tensor) -> torch.Tensor:
        """d over the greatest that is not called unlike, shape (B,): above 1 a press is."""
        return self.distance(statistics) / self.threshold

    def to_plain(self) -> dict[str, Any]:
        return {"mean": self.mean, "whitening": self.whitening, "threshold": self.threshold}


def fit_novelty(trained: torch.Tensor, held: torch.Tensor, seen_by: tuple[Sequence[str], Sequence[str]] = ((), ())) -> Novelty:
    """From statistics of training draws (N, F) and of held-out presses (M, F); without any of these the threshold is 2.

    Args:
        seen_by: The sensors of both; where only one saw them, or none is told, all of them are fitted at once.
    """
    fitted = _fitted(trained)
    if len(held) == 0:
        return Novelty(*fitted, 2.0)
    of_trained, of_held = map(np.array, seen_by)
    distance = Novelty(*fitted, 1.0).distance(held)
    if len(sensors := np.unique(of_trained)) > 1:
        for sensor in sensors:
            its = of_held == sensor
            distance[its] = Novelty(*_fitted(trained[of_trained != sensor]), 1.0).distance(held[its])
    return Novelty(*fitted, float(torch.quantile(distance, QUANTILE)))


def _fitted(trained: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and whitening."""
    mean = trained.mean(dim=0)
    centred = trained - mean
    covariance = centred.T @ centred / max(len(trained) - 1, 1)
    diagonal = torch.diag(covariance.diagonal())
    shrunk = (1 - SHRINKAGE) * covariance + SHRINKAGE * diagonal
    # What never varied (a length, a dead feature) would be infinitely surprising: a thousandth of the mean variance is its floor.
    shrunk = shrunk + torch.diag(1e-3 * covariance.diagonal().mean().clamp_min(1e-12) * torch.ones(len(covariance), dtype=covariance.dtype))
    factor = torch.linalg.cholesky(shrunk)
    identity = torch.eye(len(factor), dtype=factor.dtype)
    return mean, torch.linalg.solve_triangular(factor, identity, upper=False) / len(factor) ** 0.5


def novelty_from_plain(plain: object) -> Novelty | None:
    """Raises LearnError for what is no such table."""
    if plain is None:
        return None
    if isinstance(plain, dict):
        mean, whitening, threshold = (plain.get(name) for name in ("mean", "whitening", "threshold"))
        if isinstance(mean, torch.Tensor) and isinstance(whitening, torch.Tensor) and isinstance(threshold, float):
            if mean.ndim == 1 and whitening.shape == (len(mean), len(mean)):
                return Novelty(mean.double(), whitening.double(), threshold)
    raise LearnError("checkpoint: novelty is damaged")


@dataclass(frozen=True, eq=False)
class GelRange:
    """Which gels training presses had: the lowest and the highest of each number of a `Gel`."""

    lowest: torch.Tensor
    """Shape (3,)."""
    highest: torch.Tensor
    """Shape (3,)."""

    def to_plain(self) -> dict[str, Any]:
        return {"lowest": self.lowest, "highest": self.highest}


def gel_range(gels: Iterable[Gel]) -> GelRange | None:
    """Of those that are known; None: none is."""
    known = torch.tensor([gel for gel in gels if np.isfinite(gel).all()], dtype=torch.float64)
    return GelRange(known.amin(dim=0), known.amax(dim=0)) if len(known) else None


def gel_range_from_plain(plain: object) -> GelRange | None:
    """Raises LearnError for what is no such table."""
    if plain is None:
        return None
    if isinstance(plain, dict):
        lowest, highest = (plain.get(name) for name in ("lowest", "highest"))
        if isinstance(lowest, torch.Tensor) and isinstance(highest, torch.Tensor) and lowest.shape == highest.shape == (len(GEL_TOLD),):
            found = GelRange(lowest.double(), highest.double())
            if bool((found.lowest <= found.highest).all()) and bool(torch.isfinite(found.highest - found.lowest).all()):
                return found
    raise LearnError("checkpoint: its range of gels is damaged")


def strange_gel(gel: Gel, ranges: Sequence[GelRange | None]) -> list[str]:
    """Which numbers of a gel lie outside the ranges of all networks, in words; none where the gel, or the range of any, is not known."""
    known = [found for found in ranges if found is not None]
    if len(known) < len(ranges) or not np.isfinite(gel).all():
        return []
    words = []
    for number, (name, unit, decimals) in enumerate(GEL_TOLD):
        value = round(gel[number], decimals)
        bounds = [tuple(round(float(end[number]), decimals) for end in (found.lowest, found.highest)) for found in known]
        if not any(low <= value <= high for low, high in bounds):
            spans = [f"{low:.{decimals}f} to {high:.{decimals}f}" if low < high else f"{low:.{decimals}f}" for low, high in bounds]
            trained = " or ".join(dict.fromkeys(spans))
            words.append(f"the gel's {name} {value:.{decimals}f} {unit} is outside what it was trained on ({trained} {unit})")
    return words
