"""Runs a network over presses: what validation, evaluation and prediction share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from learn.config import LearnError
from learn.data import Batch, Press, collate
from learn.model import Network
from learn.novelty import press_statistics


@dataclass(frozen=True, eq=False)
class Estimates:
    """Of B presses."""

    mean: NDArray[np.float64]
    """Shore 00, shape (B,)."""
    spread: NDArray[np.float64]
    """Standard deviation [Shore 00] as the network says it, shape (B,); NaN where it knows none."""
    statistics: torch.Tensor
    """For `learn.novelty`, shape (B, F)."""
    loss: float
    """Mean training loss over them; NaN without targets."""


def batches(presses: Sequence[Press], device: torch.device, batch: int = 32) -> list[Batch]:
    """Presses in batches on a device."""
    return [collate(presses[start : start + batch]).to(device) for start in range(0, len(presses), batch)]


def estimate(network: Network, parts: Iterable[Batch]) -> Estimates:
    """Estimates of presses in batches, at least one, in float32."""
    means, spreads, statistics, losses = [], [], [], []
    was_training = network.training
    network.eval()
    with torch.inference_mode():
        for part in parts:
            output = network(part)
            mean, spread = network.estimate(output, part.lengths)
            means.append(mean.double().cpu().numpy())
            spreads.append(np.full(len(mean), np.nan) if spread is None else spread.double().cpu().numpy())
            statistics.append(press_statistics(part, output.features))
            losses.append(float(network.loss(output, part)) * len(mean))
    network.train(was_training)
    mean = np.concatenate(means)
    return Estimates(mean, np.concatenate(spreads), torch.cat(statistics), sum(losses) / len(mean))


def pick_device(name: str) -> torch.device:
    """The device that `--device` names.

    Raises:
        LearnError: cuda is asked for and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise LearnError("--device cuda: torch finds no CUDA device; allowed are auto, cpu")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")
