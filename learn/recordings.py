"""Presses at the network's size: averaged once, kept in memory or in a cache that several runs share. NumPy alone.

A cache holds a whole dataset, so that trainings of different presses of it and their evaluations read it once; several processes fill it.
Simulated and real presses lie in one schema (`gelsim.dataset`) and differ here in nothing.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
import multiprocessing
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.dataset import Dataset, load_dataset
from gelsim.errors import DatasetError
from gelsim.results import Episode
from gelsim.workers import in_environment, settings
from learn.config import InputConfig
from learn.features import NAMES, press_features
from learn.frames import FIXED_POINT, averaged_pixels, change_signal, fit_picture, levels_of

CACHE = "cache"
"""Folder of a run where its recordings are kept."""
_CACHE_VERSION = 2
_AT_ONCE = 16
"""Episodes that a process reads before it reports."""
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Noise:
    """Of a camera, already averaged to the network's pictures."""

    flat: float = 0.0
    """Standard deviation at every level [levels]."""
    shot: float = 0.0
    """Variance per level, of photons [levels]."""

    def draw(self, pictures: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """Pictures with noise."""
        variance = self.flat**2 + self.shot * np.maximum(pictures, 0)
        if not np.any(variance):
            return pictures
        return pictures + np.sqrt(variance, dtype=np.float32) * rng.standard_normal(pictures.shape, dtype=np.float32)


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


def record(
    frames: Sequence[NDArray[np.uint8]], background: NDArray[np.uint8], inputs: InputConfig, noise: Noise | None = None
) -> Recording:
    """A recording from 8-bit images, each (H, W, 3); the background may be of another size."""
    pictures = levels_of(np.stack([fit_picture(frame, inputs.picture) for frame in frames]))
    empty = levels_of(fit_picture(background, inputs.picture))
    return Recording(empty, pictures, change_signal(pictures, empty, inputs.deadband_levels), noise or Noise())


def record_episode(episode: Episode, inputs: InputConfig) -> Recording:
    """A recording from an episode; its camera's noise, if it was left out, comes along to be drawn later."""
    if not episode.background.size:
        raise DatasetError(f"episode {episode.row['index']}: has no pictures; gelsim dataset --light-of DIR draws them")
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


def with_noise(recording: Recording, seed: Sequence[int], inputs: InputConfig) -> Recording:
    """A recording with its camera's noise drawn: what a test sees."""
    if recording.noise == Noise():
        return recording
    rng = np.random.default_rng(seed)
    background, pictures = recording.noise.draw(recording.background, rng), recording.noise.draw(recording.pictures, rng)
    return Recording(background, pictures, change_signal(pictures, background, inputs.deadband_levels))


@dataclass(frozen=True, eq=False)
class Archive:
    """Recordings of some episodes of a dataset, in memory or mapped from a file."""

    rows: list[dict[str, Any]]
    """Of the dataset."""
    begins: NDArray[np.int64]
    """Where the no-contact frame of each lies in `pictures`, its frames behind it; shape (B,)."""
    pictures: NDArray[np.uint16]
    """Levels times FIXED_POINT, shape (P, h, w, 3)."""
    signals: list[NDArray[np.float64]]
    """Intensity change of each [levels], shape (N,)."""
    features: list[NDArray[np.float32]]
    """Hand-made features of every frame of each, shape (N, F)."""
    noises: list[Noise]

    def __len__(self) -> int:
        return len(self.rows)

    def stored(self, number: int) -> NDArray[np.uint16]:
        """The no-contact frame and the frames, shape (1 + N, h, w, 3)."""
        return self.pictures[self.begins[number] : self.begins[number] + 1 + len(self.signals[number])]

    def only(self, numbers: Sequence[int]) -> Archive:
        """Some of them."""
        return Archive(
            [self.rows[number] for number in numbers],
            self.begins[np.array(numbers, int)],
            self.pictures,
            [self.signals[number] for number in numbers],
            [self.features[number] for number in numbers],
            [self.noises[number] for number in numbers],
        )

    def recording(self, number: int) -> Recording:
        levels = levels_of(np.asarray(self.stored(number)))
        return Recording(levels[0], levels[1:], self.signals[number], self.noises[number])


def archive(
    dataset: Dataset, indices: Sequence[int], inputs: InputConfig, cache: Path | None = None, progress: Progress | None = None,
    workers: int = 0,
) -> Archive:  # fmt: skip
    """Reads episodes and averages their pictures.

    Args:
        indices: Values of `index` in the dataset's rows.
        cache: A folder where the whole dataset is kept, or was by an earlier call; None: these episodes alone, in memory.
        workers: Processes that read; 0: this one.
    Raises:
        DatasetError: An episode is damaged.
    """
    wanted = [dataset.rows[dataset.positions[index]] for index in indices]
    rows = wanted if cache is None else dataset.rows
    begins = np.cumsum([0] + [1 + row["frames"] for row in rows])
    shape = (int(begins[-1]), *inputs.picture, 3)
    if cache is None:
        pictures = np.empty(shape, np.uint16)
        arrays = _join(_read(dataset, rows, begins, inputs, pictures, number) for number in range(0, len(rows), _AT_ONCE))
    else:
        pictures, arrays = _cached(dataset, begins, shape, inputs, cache, progress, workers)
    where = {row["index"]: number for number, row in enumerate(rows)}
    firsts = begins - np.arange(len(begins))  # without the no-contact frames
    parts = [slice(*pair) for pair in itertools.pairwise(firsts)]
    noises = [Noise(*map(float, noise)) for noise in arrays["noise"]]
    whole = Archive(
        rows, begins[:-1], pictures, [arrays["signal"][part] for part in parts], [arrays["features"][part] for part in parts], noises
    )
    return whole.only([where[row["index"]] for row in wanted])


def _cached(
    dataset: Dataset, begins: NDArray[np.int_], shape: tuple[int, ...], inputs: InputConfig, cache: Path, progress: Progress | None,
    workers: int,
) -> tuple[NDArray[np.uint16], dict[str, NDArray[Any]]]:  # fmt: skip
    rows = dataset.rows
    sizes = [(dataset.folder / row["file"]).stat().st_size for row in rows if (dataset.folder / row["file"]).is_file()]
    identity = json.dumps([_CACHE_VERSION, rows, sizes, inputs.picture, inputs.deadband_levels, NAMES], sort_keys=True)
    home = cache / hashlib.sha256(identity.encode()).hexdigest()[:16]
    if (home / "pictures.npy").is_file():
        try:
            with np.load(home / "arrays.npz", allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            return np.load(home / "pictures.npy", mmap_mode="r", allow_pickle=False), arrays
        except (OSError, ValueError, zipfile.BadZipFile):
            shutil.rmtree(home)
    partial = home.with_name(f"{home.name}-{os.getpid()}.partial")
    partial.mkdir(parents=True, exist_ok=True)
    target = partial / "pictures.npy"
    pictures = np.lib.format.open_memmap(target, mode="w+", dtype=np.uint16, shape=shape)
    firsts = range(0, len(rows), _AT_ONCE)

    def told(found: Iterator[dict[str, NDArray[Any]]]) -> Iterator[dict[str, NDArray[Any]]]:
        for first, part in zip(firsts, found, strict=True):
            if progress:
                progress("reading presses", min(first + _AT_ONCE, len(rows)), len(rows))
            yield part

    if workers < 2:
        arrays = _join(told(_read(dataset, rows, begins, inputs, pictures, first) for first in firsts))
    else:
        # Fresh processes: they load neither torch nor what this one has in memory.
        spawned = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(min(workers, len(firsts)), spawned, _open_worker, (dataset.folder, inputs, target))
        with in_environment(settings(1)), pool:  # they leave the other cores to each other
            arrays = _join(told(pool.map(_work, firsts)))
    np.savez(partial / "arrays.npz", allow_pickle=False, **arrays)
    assert isinstance(pictures, np.memmap)
    pictures.flush()
    try:
        partial.rename(home)
    except OSError:  # another run was faster
        shutil.rmtree(partial)
    return np.load(home / "pictures.npy", mmap_mode="r", allow_pickle=False), arrays


def _read(
    dataset: Dataset, rows: list[dict[str, Any]], begins: NDArray[np.int_], inputs: InputConfig, pictures: NDArray[np.uint16], first: int
) -> dict[str, NDArray[Any]]:
    """Reads rows[first : first + _AT_ONCE] into `pictures`, and gives what else is kept of them."""
    signals, features, noises = [], [], []
    for number in range(first, min(first + _AT_ONCE, len(rows))):
        row = rows[number]
        episode = dataset.read(dataset.positions[row["index"]])
        if len(episode.frames) != row["frames"]:
            raise DatasetError(f"{dataset.folder / row['file']}: holds {len(episode.frames)} frames, its row says {row['frames']}")
        recording = record_episode(episode, inputs)
        pictures[begins[number]] = np.rint(recording.background * FIXED_POINT)
        pictures[begins[number] + 1 : begins[number + 1]] = np.rint(recording.pictures * FIXED_POINT)
        signals.append(recording.signal)
        markers = episode.marker_pixels / episode.background.shape[1]
        features.append(press_features(recording.pictures, recording.background, recording.signal, markers))
        noises.append((recording.noise.flat, recording.noise.shot))
    return {"signal": np.concatenate(signals), "features": np.concatenate(features), "noise": np.array(noises, float)}


def _join(parts: Iterator[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    found = list(parts)
    return {name: np.concatenate([part[name] for part in found]) for name in ("signal", "features", "noise")}


# ---- in a reading process ----

_worker: Callable[[int], dict[str, NDArray[Any]]]


def _open_worker(folder: Path, inputs: InputConfig, target: Path) -> None:
    dataset = load_dataset(folder)
    begins = np.cumsum([0] + [1 + row["frames"] for row in dataset.rows])
    pictures = np.load(target, mmap_mode="r+", allow_pickle=False)
    global _worker  # noqa: PLW0603
    _worker = functools.partial(_read, dataset, dataset.rows, begins, inputs, pictures)


def _work(first: int) -> dict[str, NDArray[Any]]:
    return _worker(first)
