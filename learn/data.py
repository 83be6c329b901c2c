"""Presses as a training sees them: recordings averaged once to the network's size, then drawn, randomised and padded, step by step.

What a step sees is a function of (seed, step) alone, whatever the number of processes and devices, so a training that goes on after an
interruption sees what it would have seen. Simulated and real presses lie in one schema (`gelsim.dataset`) and differ here in nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gelsim.dataset import Dataset
from gelsim.errors import DatasetError
from gelsim.results import Episode
from learn.augment import Noise, choose_randomly, randomise
from learn.config import Config, InputConfig, LearnError
from learn.features import NAMES, press_features
from learn.frames import FIXED_POINT, averaged_pixels, change_signal, equal_steps, fit_picture, levels_of, loading
from learn.splits import TRAIN, VALIDATION, check_splits, split_by_object

HARDEST = 87.0
"""The hardest silicone of the paper [Shore 00]. Of a rigid object it is only known to be harder."""
VALIDATION_SHARE = 0.15
"""Of the objects, where a dataset brings no validation split."""
_CACHE_VERSION = 1
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Recording:
    """A press at the network's size."""

    background: NDArray[np.float32]
    """The no-contact frame [levels], shape (h, w, 3)."""
    pictures: NDArray[np.float32]
    """[levels], shape (N, h, w, 3)."""
    signal: NDArray[np.float64]
    """Intensity change [levels], shape (N,)."""
    noise: Noise = Noise()
    """Of the camera, where the pictures were stored without."""


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
    rigid: bool = False
    """The target is not known, but it is over HARDEST."""


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
    rigid: torch.Tensor
    """bool, shape (B,)."""

    def to(self, device: torch.device) -> Batch:
        return Batch(*(getattr(self, name).to(device, non_blocking=True) for name in self.__dataclass_fields__))


def record(
    frames: Sequence[NDArray[np.uint8]], background: NDArray[np.uint8], inputs: InputConfig, noise: Noise | None = None
) -> Recording:
    """A recording from 8-bit images, each (H, W, 3); the background may be of another size."""
    pictures = levels_of(np.stack([fit_picture(frame, inputs.picture) for frame in frames]))
    empty = levels_of(fit_picture(background, inputs.picture))
    return Recording(empty, pictures, change_signal(pictures, empty, inputs.deadband_levels), noise or Noise())


def record_episode(episode: Episode, inputs: InputConfig) -> Recording:
    """A recording from an episode; its camera's noise, if it was left out, comes along to be drawn later."""
    return record(list(episode.frames), episode.background, inputs, camera_noise(episode, inputs.picture))


def camera_noise(episode: Episode, picture: tuple[int, int]) -> Noise:
    """What is left of a camera's noise in the averaged pictures.

    Photons give a variance in proportion to the linear radiance; here in proportion to the level, exact at half of it (a slope of the sRGB
    curve of about 1.2). Noise of neighbouring pixels is taken as independent, so a camera that interpolates colours has somewhat more.
    """
    after, well, before = (float(np.mean(part)) for part in episode.noise)
    pixels = averaged_pixels(episode.background.shape, picture)
    middle, slope = 0.214, 1.2 * 255  # linear radiance of level 127.5, levels per unit of it
    shot = (slope**2 * middle / well / 127.5) if well > 0 else 0.0
    return Noise(float(np.sqrt((after**2 + (slope * before) ** 2) / pixels)), shot / pixels)


def choose(recording: Recording, inputs: InputConfig, repeat: bool, end_share: float = 1.0) -> Press | None:
    """The pictures of a recording from first contact to the end of loading; None when nothing touches."""
    among = loading(recording.signal, inputs, end_share)
    if len(among) == 0:
        return None
    chosen = equal_steps(recording.signal, among, inputs.frames, repeat)
    return Press(recording.background, recording.pictures[chosen], recording.signal[chosen].astype(np.float32))


def with_noise(recording: Recording, seed: Sequence[int], inputs: InputConfig) -> Recording:
    """A recording with its camera's noise drawn: what a test sees."""
    if recording.noise == Noise():
        return recording
    rng = np.random.default_rng(seed)
    background, pictures = recording.noise.draw(recording.background, rng), recording.noise.draw(recording.pictures, rng)
    return Recording(background, pictures, change_signal(pictures, background, inputs.deadband_levels))


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
        torch.tensor([press.rigid for press in presses]),
    )


class Archive:
    """Recordings of one dataset at the network's size, in memory or mapped from a file; whole episodes are read once."""

    def __init__(self, rows: list[dict[str, Any]], arrays: dict[str, NDArray[Any]], pictures: NDArray[np.uint16]) -> None:
        self.rows, self._arrays, self._pictures = rows, arrays, pictures

    def __len__(self) -> int:
        return len(self.rows)

    def recording(self, number: int) -> Recording:
        first, last = self._arrays["first"][number : number + 2]
        # The no-contact frame lies before the frames.
        levels = levels_of(np.asarray(self._pictures[first + number : last + number + 1]))
        return Recording(levels[0], levels[1:], self._arrays["signal"][first:last], Noise(*map(float, self._arrays["noise"][number])))

    def signal(self, number: int) -> NDArray[np.float64]:
        return self._arrays["signal"][slice(*self._arrays["first"][number : number + 2])]

    def features(self, number: int) -> NDArray[np.float32]:
        """Hand-made features of every frame, shape (N, F)."""
        return self._arrays["features"][slice(*self._arrays["first"][number : number + 2])]


def archive(
    dataset: Dataset, indices: Sequence[int], inputs: InputConfig, cache: Path | None = None, progress: Progress | None = None
) -> Archive:
    """Reads episodes and averages their pictures, or maps what an earlier call left in `cache`.

    Args:
        indices: Values of `index` in the dataset's rows.
        cache: A folder that is made beside others of its kind; None: everything stays in memory.
    Raises:
        DatasetError: An episode is damaged.
    """
    rows = [dataset.rows[dataset.positions[index]] for index in indices]
    arrays: dict[str, NDArray[Any]]
    home = None
    if cache is not None:
        sizes = [(dataset.folder / row["file"]).stat().st_size for row in rows if (dataset.folder / row["file"]).is_file()]
        identity = json.dumps([_CACHE_VERSION, rows, sizes, inputs.picture, inputs.deadband_levels, NAMES], sort_keys=True)
        home = cache / hashlib.sha256(identity.encode()).hexdigest()[:16]
        if (home / "pictures.npy").is_file():
            try:
                with np.load(home / "arrays.npz", allow_pickle=False) as file:
                    arrays = {name: file[name] for name in file.files}
                return Archive(rows, arrays, np.load(home / "pictures.npy", mmap_mode="r", allow_pickle=False))
            except (OSError, ValueError, zipfile.BadZipFile):
                shutil.rmtree(home)
    counts = [row["frames"] for row in rows]
    shape = (sum(counts) + len(rows), *inputs.picture, 3)
    partial = None
    if home is None:
        pictures = np.empty(shape, np.uint16)
    else:
        partial = home.with_name(f"{home.name}-{os.getpid()}.partial")
        partial.mkdir(parents=True, exist_ok=True)
        pictures = np.lib.format.open_memmap(partial / "pictures.npy", mode="w+", dtype=np.uint16, shape=shape)
    arrays = {
        "first": np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        "signal": np.zeros(sum(counts)),
        "features": np.zeros((sum(counts), len(NAMES)), np.float32),
        "noise": np.zeros((len(rows), 2)),
    }
    for number, row in enumerate(rows):
        episode = dataset.read(dataset.positions[row["index"]])
        if len(episode.frames) != row["frames"]:
            raise DatasetError(f"{dataset.folder / row['file']}: holds {len(episode.frames)} frames, its row says {row['frames']}")
        recording = record_episode(episode, inputs)
        first, last = arrays["first"][number : number + 2]
        pictures[first + number] = np.rint(recording.background * FIXED_POINT)
        pictures[first + number + 1 : last + number + 1] = np.rint(recording.pictures * FIXED_POINT)
        arrays["signal"][first:last] = recording.signal
        markers = episode.marker_pixels / episode.background.shape[1]
        arrays["features"][first:last] = press_features(recording.pictures, recording.background, recording.signal, markers)
        arrays["noise"][number] = recording.noise.flat, recording.noise.shot
        if progress:
            progress("reading presses", number + 1, len(rows))
    if partial is not None and home is not None:
        np.savez(partial / "arrays.npz", allow_pickle=False, **arrays)
        assert isinstance(pictures, np.memmap)
        pictures.flush()
        if not home.exists():
            partial.rename(home)
        pictures = np.load(home / "pictures.npy", mmap_mode="r", allow_pickle=False)
    return Archive(rows, arrays, pictures)


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
    usable = {row["index"] for row in dataset.rows if row["rigid"] or row["shore_00"] is not None}
    train, validation = [index for index in train if index in usable], [index for index in validation if index in usable]
    if not train:
        raise DatasetError(f"{dataset.folder}: no press of known hardness to train on")
    return train, validation


class Stream(torch.utils.data.Dataset):
    """An endless stream of randomised presses: item p is a function of the seed and p alone.

    Real presses (the second archive) come at their ratio, evenly; within an archive every press comes once before any comes again.
    """

    def __init__(self, archives: Sequence[Archive], config: Config, repeat: bool) -> None:
        self._config, self._repeat = config, repeat
        self._archives = archives
        self._touching = [
            [number for number in range(len(part)) if len(loading(part.signal(number), config.input)) > 0] for part in archives
        ]
        if not all(self._touching):
            raise DatasetError("no press to train on shows any contact")
        self.presses = sum(map(len, self._touching))
        self.without_contact = sum(len(part) for part in archives) - self.presses

    def __getitem__(self, position: int) -> Press:
        seed, ratio = self._config.train.seed, self._config.train.real_ratio if len(self._archives) == 2 else 0.0
        before, until = int(position * ratio), int((position + 1) * ratio)
        pool, count = (1, before) if until > before else (0, position - before)
        members = self._touching[pool]
        epoch, slot = divmod(count, len(members))
        number = members[int(np.random.default_rng([seed, 1, pool, epoch]).permutation(len(members))[slot])]
        return self.draw(pool, number, np.random.default_rng([seed, 2, position]))

    def draw(self, pool: int, number: int, rng: np.random.Generator) -> Press:
        """One press as it may be seen."""
        row, recording = self._archives[pool].rows[number], self._archives[pool].recording(number)
        inputs, augment = self._config.input, self._config.augment
        if augment.augment:
            chosen = choose_randomly(recording.signal, rng, inputs, augment, self._repeat)
            background, pictures = randomise(recording.background, recording.pictures[chosen], rng, augment, recording.noise)
        else:
            press = choose(recording, inputs, self._repeat)
            assert press is not None
            background, pictures = recording.noise.draw(press.background, rng), recording.noise.draw(press.pictures, rng)
        signal = change_signal(pictures, background, inputs.deadband_levels).astype(np.float32)
        return Press(background, pictures, signal, np.nan if row["shore_00"] is None else float(row["shore_00"]), bool(row["rigid"]))


def varied_press(press: Press, rng: np.random.Generator, config: Config) -> Press:
    """A press as another sensor might have seen it, to the same end."""
    background, pictures = randomise(press.background, press.pictures, rng, config.augment, Noise())
    signal = change_signal(pictures, background, config.input.deadband_levels).astype(np.float32)
    return Press(background, pictures, signal, press.target, press.rigid)


class Steps(torch.utils.data.Sampler[list[int]]):
    """The positions in the stream of each step from `first` on, this device's share of them."""

    def __init__(self, first: int, last: int, batch: int, rank: int = 0, world: int = 1) -> None:
        if batch % world:
            raise LearnError(f"batch = {batch}: must be a multiple of the {world} devices")
        self._first, self._last, self._batch, self._rank, self._share = first, last, batch, rank, batch // world

    def __len__(self) -> int:
        return self._last - self._first

    def __iter__(self) -> Iterator[list[int]]:
        for step in range(self._first, self._last):
            start = step * self._batch + self._rank * self._share
            yield list(range(start, start + self._share))


def held_presses(part: Archive, inputs: InputConfig, repeat: bool, seed: int) -> list[Press | None]:
    """The presses of an archive as a test sees them: to their peak, with their camera's noise; None: no contact."""
    found: list[Press | None] = []
    for number, row in enumerate(part.rows):
        press = choose(with_noise(part.recording(number), [seed, 3, row["index"]], inputs), inputs, repeat)
        target = np.nan if row["shore_00"] is None else float(row["shore_00"])
        found.append(None if press is None else Press(press.background, press.pictures, press.signal, target, bool(row["rigid"])))
    return found
