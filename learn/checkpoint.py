"""Checkpoints: tensors and plain types in one file, so that loading one runs nothing. Written under a temporary name, then renamed.

    format, config, step, network (weights), optimizer, averaged (weights), best (validation loss), spread_factor, novelty, gels, provenance

`last.pt` holds all of it and is what --resume goes on from; `model.pt` has no optimizer, weights in half precision, and is what eval and
predict read. Half precision moves a weight by at most 2⁻¹¹ of itself, a reading by some 0.01 Shore, and halves the file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from gelsim.files import whole_file
from learn.config import Config, LearnError, from_plain, to_plain
from learn.model import Network, build, read_tensors

FORMAT = "gelsim-learn 1"
LARGEST = 4 * 2**30
"""Bytes: VGG16 with the momentum of its optimizer has 1 GiB."""


@dataclass(eq=False)
class Checkpoint:
    """What one file holds."""

    config: Config
    step: int
    network: dict[str, torch.Tensor]
    optimizer: dict[str, Any] | None = None
    averaged: dict[str, torch.Tensor] | None = None
    """Weights averaged over the last steps, in last.pt; in model.pt they are the network's."""
    best: float = float("inf")
    """Lowest validation loss so far."""
    spread_factor: float = 1.0
    """By which the network's spread is multiplied, fitted on the validation split."""
    novelty: dict[str, Any] | None = None
    """`learn.novelty.Novelty` as tensors."""
    gels: dict[str, Any] | None = None
    """`learn.novelty.GelRange` as tensors; None: nobody told the gels of its presses, or it is from before this was kept."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Data, command, versions, seconds: text and numbers."""

    def build(self) -> Network:
        """The network with these weights.

        Raises:
            LearnError: They do not fit the config.
        """
        with torch.device("meta"):
            network = build(self.config)
        wanted, found = ({name: _kind(value) for name, value in state.items()} for state in (network.state_dict(), self.network))
        if wanted != found:
            wrong = next(iter(sorted(set(wanted) ^ set(found)) or [name for name in wanted if wanted[name] != found[name]]))
            raise LearnError(f"checkpoint: weights {wrong!r} are {found.get(wrong)}, the config wants {wanted.get(wrong)}")
        # Copied, because the tensors become the network's own.
        network.load_state_dict({name: tensor.clone() for name, tensor in self.network.items()}, assign=True)
        return network.eval()


def _kind(value: Any) -> str:
    """Shape and type of what should be a tensor, in words."""
    return f"{tuple(value.shape)} of {value.dtype}" if isinstance(value, torch.Tensor) else type(value).__name__


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Raises OSError."""
    content = {name: getattr(checkpoint, name) for name in checkpoint.__dataclass_fields__}
    if checkpoint.optimizer is None:  # numbers alone, as the hardness trained on, stay as they are
        content["network"] = {name: value.half() if value.ndim else value for name, value in checkpoint.network.items()}
    with whole_file(path) as partial:
        torch.save({"format": FORMAT, **content, "config": to_plain(checkpoint.config)}, partial)


def load(path: Path) -> Checkpoint:
    """Reads a checkpoint; nothing in it is run.

    Raises:
        LearnError: No such file, too large, not of tensors and plain types alone, or not a checkpoint of this format.
    """
    found = read_tensors(path, LARGEST)
    if found.get("format") != FORMAT:
        raise LearnError(f"{path}: is no checkpoint of gelsim-learn (its format is {found.get('format')!r}, wanted is {FORMAT!r})")
    kinds = {"step": int, "network": dict, "best": float, "spread_factor": float, "provenance": dict}
    for name, kind in kinds.items():
        if not isinstance(found.get(name), kind):
            raise LearnError(f"{path}: {name} is {type(found.get(name)).__name__}, wanted is {kind.__name__}")
    try:
        config = from_plain(found.get("config"))
    except LearnError as error:
        raise LearnError(f"{path}: {error}") from None
    names = [name for name in Checkpoint.__dataclass_fields__ if name != "config"]
    parts: dict[str, Any] = {name: found.get(name) for name in names}
    parts["network"] = {
        name: value.float() if getattr(value, "dtype", None) == torch.float16 else value for name, value in parts["network"].items()
    }
    return Checkpoint(config, **parts)
