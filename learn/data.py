"""Presses as a network sees them: which are trained on, which frames are chosen of a recording, and how they are padded to a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gelsim.data.episodes import Dataset
from gelsim.errors import DatasetError
from learn.config import InputConfig
from learn.frames import equal_steps, loading
from learn.framing import to_scale
from learn.recordings import Archive, Recording, with_noise
from learn.splits import TRAIN, VALIDATION, check_splits, split_by_object

HARDEST = 87.0
"""The hardest silicone of the paper [Shore 00]. Of a rigid object it is only known to be harder."""
VALIDATION_SHARE = 0.15
"""Of the objects, where a dataset brings no validation split."""

Bounds = tuple[float, float]
"""Least and greatest Shore 00."""
UNBOUND: Bounds = (-np.inf, np.inf)
Gel = tuple[float, float, float]
"""Thickness at the centre [mm], at the edge [mm], and hardness [Shore 00] of a sensor's gel; a NaN among them: it is not known."""
UNKNOWN_GEL: Gel = (np.nan, np.nan, np.nan)


@dataclass(frozen=True, eq=False)
class Press:
    """The pictures that were chosen of a recording, ready for the network."""

    background: NDArray[np.float32]
    """[levels], shape (h, w, 3)."""
    pictures: NDArray[np.float32]
    """[levels], shape (T, h, w, 3)."""
    signal: NDArray[np.float32]
    """Intensity change [levels], shape (T,)."""
    target: float = np.nan
    """Shore 00; NaN: unknown."""
    bounds: Bounds = UNBOUND
    """Where the target is not known, what it is known to be between."""
    rank: int = -1
    """Class of hardness, 0 the softest, where that is all that is known; -1: it is not."""
    gel: Gel = UNKNOWN_GEL
    scaled: bool = False
    """The pictures show `framing.FIELD_MM` around the contact; else their scale is not known."""
    sensor: str = ""
    """Its name in a dataset."""


@dataclass(frozen=True, eq=False)
class Batch:
    """B presses, padded with zeros to the T pictures of the longest."""

    pictures: torch.Tensor
    """[levels], shape (B, T, 3, h, w)."""
    background: torch.Tensor
    """[levels], shape (B, 3, h, w)."""
    signal: torch.Tensor
    """[levels], shape (B, T)."""
    lengths: torch.Tensor
    """Pictures that are none of the padding, shape (B,), int64."""
    target: torch.Tensor
    """Shore 00; NaN: unknown. Shape (B,)."""
    bounds: torch.Tensor
    """Shore 00, shape (B, 2)."""
    rank: torch.Tensor
    """int64, shape (B,)."""
    gel: torch.Tensor
    """A `Gel` each, shape (B, 3)."""
    scaled: torch.Tensor
    """As of a `Press`; bool, shape (B,)."""

    def to(self, device: torch.device) -> Batch:
        return Batch(*(getattr(self, name).to(device, non_blocking=True) for name in self.__dataclass_fields__))


def gel_of(facts: Mapping[str, float | None] | None) -> Gel:
    """The gel that a dataset's row tells (`gelsim.data.episodes.gel_facts`); None: it tells none."""
    if facts is None:
        return UNKNOWN_GEL
    thickness, edge, shore = (facts[name] for name in ("thickness_mm", "edge_thickness_mm", "shore_00"))
    return UNKNOWN_GEL if thickness is None or edge is None or shore is None else (thickness, edge, shore)


def label_of(row: Mapping[str, Any]) -> tuple[float, Bounds, int]:
    """What a dataset's row knows of a hardness, as in a `Press`: Shore 00, else bounds of it, else a class (`gelsim.data.episodes`)."""
    if row["shore_00"] is not None:
        return float(row["shore_00"]), UNBOUND, -1
    if row["rigid"]:
        return np.nan, (HARDEST, np.inf), -1
    low, high = row.get("shore_00_range") or (None, None)
    if (low, high) != (None, None):
        return np.nan, (-np.inf if low is None else low, np.inf if high is None else high), -1
    return np.nan, UNBOUND, row.get("hardness_class", -1)


def _labelled(row: Mapping[str, Any]) -> bool:
    target, bounds, rank = label_of(row)
    return np.isfinite(target) or bounds != UNBOUND or rank >= 0


def choose(recording: Recording, inputs: InputConfig, repeat: bool, end_share: float = 1.0) -> Press | None:
    """The pictures of a recording from first contact to the end of loading; None when nothing touches."""
    among = loading(recording.signal, inputs, end_share)
    if len(among) == 0:
        return None
    chosen = equal_steps(recording.signal, among, inputs.frames, repeat)
    return Press(recording.background, recording.pictures[chosen], recording.signal[chosen].astype(np.float32), scaled=recording.scaled)


def collate(presses: Sequence[Press], at_least: int = 0) -> Batch:
    """Pads presses to one length, `at_least` if they are shorter."""
    longest = max(at_least, *(len(press.pictures) for press in presses))
    rows, columns = presses[0].background.shape[:2]
    pictures = np.zeros((len(presses), longest, rows, columns, 3), np.float32)
    signal = np.zeros((len(presses), longest), np.float32)
    for number, press in enumerate(presses):
        pictures[number, : len(press.pictures)] = press.pictures
        signal[number, : len(press.signal)] = press.signal
    return Batch(
        torch.from_numpy(np.ascontiguousarray(pictures.transpose(0, 1, 4, 2, 3))),
        torch.from_numpy(np.ascontiguousarray(np.stack([press.background for press in presses]).transpose(0, 3, 1, 2))),
        torch.from_numpy(signal),
        torch.tensor([len(press.pictures) for press in presses]),
        torch.tensor([press.target for press in presses], dtype=torch.float32),
        torch.tensor([press.bounds for press in presses], dtype=torch.float32),
        torch.tensor([press.rank for press in presses]),
        torch.tensor([press.gel for press in presses], dtype=torch.float32),
        torch.tensor([press.scaled for press in presses]),
    )


def sides(dataset: Dataset, seed: int) -> tuple[list[int], list[int]]:
    """The indices to train on and to validate on, checked; whole objects are set aside where the dataset brings no validation split.

    Raises:
        DatasetError: Something leaks, or there is nothing to train on.
    """
    check_splits(dataset.rows, dataset.splits)
    train = list(dataset.splits.get(TRAIN, [] if dataset.splits else [row["index"] for row in dataset.rows]))
    validation = list(dataset.splits.get(VALIDATION, []))
    if not validation:
        rows = [dataset.rows[dataset.positions[index]] for index in train]
        train, validation = split_by_object(rows, VALIDATION_SHARE, seed) if rows else ([], [])
    usable = {row["index"] for row in dataset.rows if _labelled(row)}
    train, validation = [index for index in train if index in usable], [index for index in validation if index in usable]
    if not train:
        raise DatasetError(f"{dataset.folder}: no press of known hardness to train on")
    return train, validation


def held_presses(part: Archive, inputs: InputConfig, repeat: bool, seed: int) -> list[Press | None]:
    """The presses of an archive as a test sees them: to their peak, with noise, at the network's scale where theirs is known; None: no
    contact."""
    found: list[Press | None] = []
    for number, row in enumerate(part.rows):
        recording = with_noise(part.recording(number), [seed, 3, row["index"]], inputs)
        press = choose(to_scale(recording, row.get("field_mm"), inputs), inputs, repeat)
        target, bounds, rank = label_of(row)
        known = {"target": target, "bounds": bounds, "rank": rank, "gel": gel_of(row.get("gel")), "sensor": row["sensor"]}
        found.append(None if press is None else replace(press, **known))
    return found
