"""Presses at the network's size: averaged once, kept in memory or in a cache that several runs share. NumPy alone.

A cache holds a whole dataset, so that trainings of different presses of it and their evaluations read it once; several processes fill it.
Simulated and real presses lie in one schema (`gelsim.data.episodes`) and differ here in nothing, but that episodes which were left without
pictures are drawn here, small and into no file: that alone needs the simulator.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import shutil
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from numpy.typing import NDArray

from gelsim.data.episodes import Dataset, lit, load_dataset
from gelsim.errors import DatasetError, GelsimError
from gelsim.files import whole_file
from gelsim.results import Episode
from gelsim.work.workers import Handful, LocalCrew, work_through
from learn.config import InputConfig
from learn.features import NAMES, press_features
from learn.frames import FIXED_POINT, averaged_pixels, change_signal, fit_picture, levels_of

CACHE = "cache"
"""Folder of a run where its recordings are kept."""
_CACHE_VERSION = 2
_DRAWN_VERSION = 1
"""Of the light that is drawn here."""
_AT_ONCE = 6
"""Episodes that a process reads before it reports, at least; those of a press stay together, for their surface is prepared once."""
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
    scaled: bool = False
    """The pictures show `learn.framing.FIELD_MM` around the contact."""


def record(
    frames: Sequence[NDArray[np.uint8]], background: NDArray[np.uint8], inputs: InputConfig, noise: Noise | None = None
) -> Recording:
    """A recording from 8-bit images, each (H, W, 3); the background may be of another size."""
    pictures = levels_of(np.stack([fit_picture(frame, inputs.picture) for frame in frames]))
    empty = levels_of(fit_picture(background, inputs.picture))
    return Recording(empty, pictures, change_signal(pictures, empty, inputs.deadband_levels), noise or Noise())


def record_episode(episode: Episode, inputs: InputConfig, taken: tuple[int, int] | None = None) -> Recording:
    """A recording from an episode; its camera's noise, if it was left out, comes along to be drawn later.

    Args:
        taken: Rows and columns of the camera's pictures, where the episode's were drawn smaller.
    """
    if not episode.background.size:
        raise DatasetError(f"episode {episode.row['index']}: has no pictures; gelsim dataset --light-of DIR draws them")
    return record(list(episode.frames), episode.background, inputs, camera_noise(episode, inputs.picture, taken))


def camera_noise(episode: Episode, picture: tuple[int, int], taken: tuple[int, int] | None = None) -> Noise:
    """What is left of a camera's noise in the averaged pictures; of how many of the camera's pixels, says `taken` (`record_episode`).

    Photons give a variance in proportion to the linear radiance; here in proportion to the level, exact at half of it (a slope of the sRGB
    curve of about 1.2). Noise of neighbouring pixels is taken as independent, so a camera that interpolates colours has somewhat more.
    """
    after, well, before = (float(np.mean(part)) for part in episode.noise)
    pixels = averaged_pixels(taken or episode.background.shape, picture)
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


@dataclass(frozen=True)
class Reading:
    """How recordings are read."""

    cache: Path | None = None
    """A folder where the whole dataset is kept, or was by an earlier reading; None: the episodes asked for alone, in memory."""
    progress: Progress | None = None
    workers: int = 0
    """Processes that read; 0: this one."""
    plan: str | None = None
    """Of a dataset without pictures, where that does not keep its own."""
    device: str = "auto"
    """Where missing light fields are measured: on the CPU if "cpu", else on CUDA where that works. Pictures are drawn on the CPU."""


PLAIN = Reading()


def archive(dataset: Dataset, indices: Sequence[int], inputs: InputConfig, reading: Reading = PLAIN) -> Archive:
    """Reads episodes and averages their pictures, which are drawn where they were left out.

    Args:
        indices: Values of `index` in the dataset's rows.
    Raises:
        DatasetError: An episode is damaged. SceneError, RenderError: Pictures cannot be drawn.
    """
    wanted = [dataset.rows[dataset.positions[index]] for index in indices]
    rows = wanted if reading.cache is None else dataset.rows
    begins = np.cumsum([0] + [1 + row["frames"] for row in rows])
    shape = (int(begins[-1]), *inputs.picture, 3)
    if reading.cache is None:
        pictures = np.empty(shape, np.uint16)
        arrays = _Reader(dataset, rows, begins, inputs, pictures, _drawn_by(dataset, rows, reading))(tuple(range(len(rows))))
    else:
        pictures, arrays = _cached(dataset, begins, shape, inputs, reading)
    where = {row["index"]: number for number, row in enumerate(rows)}
    firsts = begins - np.arange(len(begins))  # without the no-contact frames
    parts = [slice(*pair) for pair in itertools.pairwise(firsts)]
    noises = [Noise(*map(float, noise)) for noise in arrays["noise"]]
    whole = Archive(
        rows, begins[:-1], pictures, [arrays["signal"][part] for part in parts], [arrays["features"][part] for part in parts], noises
    )
    return whole.only([where[row["index"]] for row in wanted])


def _cached(
    dataset: Dataset, begins: NDArray[np.int_], shape: tuple[int, ...], inputs: InputConfig, reading: Reading
) -> tuple[NDArray[np.uint16], dict[str, NDArray[Any]]]:
    rows, cache = dataset.rows, reading.cache
    assert cache is not None
    dark = not all(map(lit, rows))
    drawn = [_DRAWN_VERSION, dataset.info.get("plan_sha256"), dataset.info.get("seed")] if dark else []
    sizes = [(dataset.folder / row["file"]).stat().st_size for row in rows if (dataset.folder / row["file"]).is_file()]
    identity = json.dumps([_CACHE_VERSION, rows, sizes, inputs.picture, inputs.deadband_levels, NAMES, *drawn], sort_keys=True)
    home = cache / hashlib.sha256(identity.encode()).hexdigest()[:16]
    whole = _mapped(home)
    if whole is None:
        cache.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{home}.lock"):  # of several runs that begin at once one reads, the others wait; it goes with the run that dies
            whole = _mapped(home)
            if whole is None:
                _fill(home, dataset, begins, shape, inputs, reading)
                whole = _mapped(home)
    assert whole is not None
    return whole


def _mapped(home: Path) -> tuple[NDArray[np.uint16], dict[str, NDArray[Any]]] | None:
    """Pictures and what else a cache holds; None where it is not there or damaged."""
    arrays = _load(home / "arrays.npz")
    try:
        return None if arrays is None else (np.load(home / "pictures.npy", mmap_mode="r", allow_pickle=False), arrays)
    except (OSError, ValueError):
        return None


def _fill(home: Path, dataset: Dataset, begins: NDArray[np.int_], shape: tuple[int, ...], inputs: InputConfig, reading: Reading) -> None:
    """Fills a cache, or what a run that died left of it: pictures into one file, the rest a handful a file until all are there."""
    rows = dataset.rows
    plan = _drawn_by(dataset, rows, reading)  # before there is anything to leave behind
    shutil.rmtree(home, ignore_errors=True)  # damaged
    partial = home.with_suffix(".partial")
    partial.mkdir(exist_ok=True)
    target = partial / "pictures.npy"
    if not target.is_file():
        with whole_file(target) as path:
            np.lib.format.open_memmap(path, mode="w+", dtype=np.uint16, shape=shape)
    pictures = np.lib.format.open_memmap(target, mode="r+")
    handfuls = _handfuls(rows)
    files = {handful: partial / f"{handful[0]}-{handful[-1]}.npz" for handful in handfuls}
    found = {handful: part for handful, file in files.items() if (part := _load(file)) is not None}

    def told(handful: Handful, part: dict[str, NDArray[Any]]) -> None:
        found[handful] = part
        with whole_file(files[handful]) as path, path.open("wb") as file:
            np.savez(file, allow_pickle=False, **part)
        if reading.progress:
            reading.progress("reading presses" if plan is None else "drawing presses", sum(map(len, found)), len(rows))

    left = [handful for handful in handfuls if handful not in found]
    if reading.workers < 2:
        read = _Reader(dataset, rows, begins, inputs, pictures, plan)
        for handful in left:
            told(handful, read(handful))
    else:
        # Fresh processes of one core each: they load neither torch nor what this one has in memory.
        arguments = (dataset.folder, inputs, target, plan)
        for handful, part in work_through(left, LocalCrew(reading.workers, gpus=()), _make_worker, arguments, _lost):
            if isinstance(part, str):
                raise DatasetError(part)
            told(handful, part)
    arrays = _join([found[handful] for handful in handfuls])
    pictures.flush()
    np.savez(partial / "arrays.npz", allow_pickle=False, **arrays)
    for file in files.values():
        file.unlink()
    partial.rename(home)


def _load(path: Path) -> dict[str, NDArray[Any]] | None:
    """Arrays of a file; None where it is not there or not whole."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, zipfile.BadZipFile):
        return None


def _drawn_by(dataset: Dataset, rows: list[dict[str, Any]], reading: Reading) -> str | None:
    """The plan by which pictures are drawn (`gelsim.generate.darkroom.prepare`); None where there is nothing to draw."""
    if all(map(lit, rows)):
        return None
    from gelsim.generate.darkroom import prepare

    return prepare(dataset, reading.plan, "cpu" if reading.device == "cpu" else "auto", reading.progress)


def _handfuls(rows: list[dict[str, Any]]) -> list[Handful]:
    """Numbers of rows that follow each other, whole presses, _AT_ONCE or more."""
    handfuls: list[Handful] = []
    current: list[int] = []
    for _, of_press in itertools.groupby(range(len(rows)), key=lambda number: rows[number]["mechanics"]):
        current += of_press
        if len(current) >= _AT_ONCE:
            handfuls.append(tuple(current))
            current = []
    return handfuls + ([tuple(current)] if current else [])


class _Reader:
    """Reads or draws some of `rows` into `pictures`, and gives what else is kept of them."""

    def __init__(
        self, dataset: Dataset, rows: list[dict[str, Any]], begins: NDArray[np.int_], inputs: InputConfig, pictures: NDArray[np.uint16],
        plan: str | None,
    ) -> None:  # fmt: skip
        self._dataset, self._rows, self._begins, self._inputs, self._pictures = dataset, rows, begins, inputs, pictures
        if plan is not None:
            from gelsim.generate.darkroom import Darkroom

            self._darkroom = Darkroom(dataset.folder, plan, inputs.picture)

    def __call__(self, numbers: Handful) -> dict[str, NDArray[Any]]:
        signals, features, noises = [], [], []
        for number in numbers:
            row, first, end = self._rows[number], self._begins[number], self._begins[number + 1]
            position = self._dataset.positions[row["index"]]
            taken = None if lit(row) else self._darkroom.taken
            episode = self._dataset.read(position) if lit(row) else self._darkroom.episode(position)
            if len(episode.frames) != row["frames"]:
                raise DatasetError(
                    f"{self._dataset.folder / row['file']}: holds {len(episode.frames)} frames, its row says {row['frames']}"
                )
            recording = record_episode(episode, self._inputs, taken)
            self._pictures[first] = np.rint(recording.background * FIXED_POINT)
            self._pictures[first + 1 : end] = np.rint(recording.pictures * FIXED_POINT)
            signals.append(recording.signal)
            markers = episode.marker_pixels / episode.background.shape[1]
            features.append(press_features(recording.pictures, recording.background, recording.signal, markers))
            noises.append((recording.noise.flat, recording.noise.shot))
        return {"signal": np.concatenate(signals), "features": np.concatenate(features), "noise": np.array(noises, float)}


def _join(parts: Sequence[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([part[name] for part in parts]) for name in ("signal", "features", "noise")}


# ---- in a reading process ----


def _make_worker(
    folder: Path, inputs: InputConfig, target: Path, plan: str | None
) -> Callable[[Handful], tuple[Handful, dict[str, NDArray[Any]] | str]]:
    dataset = load_dataset(folder)
    begins = np.cumsum([0] + [1 + row["frames"] for row in dataset.rows])
    read = _Reader(dataset, dataset.rows, begins, inputs, np.load(target, mmap_mode="r+", allow_pickle=False), plan)

    def work(handful: Handful) -> tuple[Handful, dict[str, NDArray[Any]] | str]:
        try:
            return handful, read(handful)
        except GelsimError as error:
            return handful, str(error)

    return work


def _lost(handful: Handful, status: str, message: str) -> tuple[Handful, str]:
    return handful, f"reading presses: a process ended ({status}, {message})"
