"""Is a press like those that the network was trained on? A Mahalanobis distance, its threshold taken from held-out presses.

    d² = (f − μ)ᵀ Σ⁻¹ (f − μ) / F,     Σ = (1 − λ) S + λ diag(S)

f are F numbers of a press: the network's own features at its last picture, and plain statistics of the pictures (colour and contrast of the
no-contact frame and of the change, length), because features may forget what the pictures never varied in. μ and S are of training draws; λ
keeps Σ regular when presses are few. d is about 1 for a press like those. A press is called unlike them when d exceeds what 99 % of the
validation presses stay below. After Lee et al. (NeurIPS 2018), with one class. It says nothing about presses that look alike and are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from learn.config import LearnError
from learn.data import Batch
from learn.model import last_of

SHRINKAGE = 0.1
QUANTILE = 0.99


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
    """Distance beyond which a press is unlike them."""

    def distance(self, statistics: torch.Tensor) -> torch.Tensor:
        """d of presses (B, F), shape (B,)."""
        return ((statistics - self.mean) @ self.whitening.T).norm(dim=1)

    def to_plain(self) -> dict[str, Any]:
        return {"mean": self.mean, "whitening": self.whitening, "threshold": self.threshold}


def fit_novelty(trained: torch.Tensor, held: torch.Tensor) -> Novelty:
    """From statistics of training draws (N, F) and of held-out presses (M, F); without any of these the threshold is 2."""
    centred = trained - trained.mean(dim=0)
    covariance = centred.T @ centred / max(len(trained) - 1, 1)
    diagonal = torch.diag(covariance.diagonal())
    shrunk = (1 - SHRINKAGE) * covariance + SHRINKAGE * diagonal
    # What never varied (a length, a dead feature) would be infinitely surprising: a thousandth of the mean variance is its floor.
    shrunk = shrunk + torch.diag(1e-3 * covariance.diagonal().mean().clamp_min(1e-12) * torch.ones(len(covariance), dtype=covariance.dtype))
    factor = torch.linalg.cholesky(shrunk)
    identity = torch.eye(len(factor), dtype=factor.dtype)
    whitening = torch.linalg.solve_triangular(factor, identity, upper=False) / len(factor) ** 0.5
    fitted = Novelty(trained.mean(dim=0), whitening, 2.0)
    if len(held) == 0:
        return fitted
    return Novelty(fitted.mean, whitening, float(torch.quantile(fitted.distance(held), QUANTILE)))


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
