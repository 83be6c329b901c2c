"""One network or several that read as one: a deep ensemble (Lakshminarayanan et al., NeurIPS 2017).

    m = mean of mᵢ,     s² = mean of sᵢ² + mean of (mᵢ − m)²,     d = least of dᵢ

mᵢ is what network i says, sᵢ its spread times its own factor, dᵢ its `Novelty.strangeness`: what one of them knows is not
strange, a gel neither.
Networks that were trained on different presses err differently, so m errs less than they do, and where they disagree s says it. Left out:
weights by spread, which on test presses gave 7.7 for 7.8 and a spread that is less honest, and a factor of the whole, which would need a
split that none trained on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from learn.checkpoint import load
from learn.config import LearnError
from learn.data import Gel, Press
from learn.estimate import batches, estimate
from learn.novelty import Novelty, gel_range_from_plain, novelty_from_plain, strange_gel


@dataclass(frozen=True, eq=False)
class Reading:
    """Of B presses."""

    mean: NDArray[np.float64]
    """Shore 00, shape (B,)."""
    spread: NDArray[np.float64]
    """Standard deviation [Shore 00], shape (B,); NaN where a network knows none."""
    novelty: NDArray[np.float64]
    """`Novelty.strangeness`, shape (B,): above 1 the press is unlike the training; NaN where none was fitted."""


class Ensemble:
    """The networks of some checkpoints, which must take the same input.

    Raises:
        LearnError: A checkpoint cannot be used, or takes another input than the first.
    """

    def __init__(self, models: Sequence[Path], device: torch.device) -> None:
        self.checkpoints = [load(path) for path in models]
        self._networks = [kept.build().to(device) for kept in self.checkpoints]
        self._novelties = [novelty_from_plain(kept.novelty) for kept in self.checkpoints]
        self._gels = [gel_range_from_plain(kept.gels) for kept in self.checkpoints]
        self._device = device
        first = self.checkpoints[0].config
        for path, kept in zip(models[1:], self.checkpoints[1:], strict=True):
            if (kept.config.input, kept.config.model.model) != (first.input, first.model.model):
                raise LearnError(f"--model {path}: takes other pictures than {models[0]}; networks that read together take the same")
        self.inputs, self.repeat = first.input, first.model.model == "paper"
        self.seed = first.train.seed
        self.asks_gel = not self.repeat and any(kept.config.model.show_gel for kept in self.checkpoints)

    def read(self, presses: Sequence[Press]) -> Reading:
        """What presses, at least one, say of their hardness."""
        parts = batches(presses, self._device)
        said = [estimate(network, parts) for network in self._networks]
        spreads = [part.spread * kept.spread_factor for part, kept in zip(said, self.checkpoints, strict=True)]
        distances = [_distance(novelty, part.statistics) for part, novelty in zip(said, self._novelties, strict=True)]
        return _mixed([part.mean for part in said], spreads, distances)

    def strange_gel(self, gel: Gel) -> list[str]:
        """What of a gel none of the networks was trained on, in words (`learn.novelty`)."""
        return strange_gel(gel, self._gels)

    def unread(self, count: int) -> Reading:
        """Of presses that show nothing: what the networks were trained on."""
        ones = np.ones(count)
        centres, scales = ([float(getattr(network, name)) * ones for network in self._networks] for name in ("centre", "scale"))
        return _mixed(centres, scales, [np.nan * ones])


def _distance(novelty: Novelty | None, statistics: torch.Tensor) -> NDArray[np.float64]:
    """dᵢ; of statistics that are not finite, infinite: nothing like them was trained on."""
    if novelty is None:
        return np.full(len(statistics), np.nan)
    return np.nan_to_num(novelty.strangeness(statistics).numpy(), nan=np.inf, posinf=np.inf)


def _mixed(means: Sequence[NDArray], spreads: Sequence[NDArray], novelties: Sequence[NDArray]) -> Reading:
    mean = np.mean(means, axis=0)
    spread = np.sqrt(np.mean(np.square(spreads), axis=0) + np.var(means, axis=0))
    return Reading(mean, spread, np.min(novelties, axis=0))
