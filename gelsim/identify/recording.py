"""The pictures of one press that a modulus is fitted to: from a video, a folder of pictures or an episode.

The first picture shows the sensor untouched. Fitted are a few pictures of the loading, those whose change from the first is spread evenly
from FIRST_SHARE of the largest change to all of it: what happens after the largest change (holding, release) is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate.reading import SUFFIXES, Reader
from gelsim.data.episodes import read_episode
from gelsim.data.video import VIDEOS
from gelsim.errors import SceneError
from gelsim.optics.rest import resized
from gelsim.tables import read_csv

Array = NDArray[np.float64]

WIDTH = 120
"""Of the pictures that are compared [px]: the video's are averaged to it."""
PICTURES = 5
FIRST_SHARE = 0.35
"""Of the largest change: with less the noise has its part."""
SEEN = 0.4
"""Least change that is a press: mean over the picture [levels]."""


@dataclass(frozen=True, eq=False)
class Recording:
    """What is compared with drawn pictures, as levels 0 … 255 of `size`."""

    rest: Array
    """(H, W, 3)."""
    pictures: Array
    """(K, H, W, 3)."""
    numbers: NDArray[np.int64]
    """Of these pictures in the recording, from 0."""
    force: Array | None
    """Measured normal force at each [N]."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.rest.shape[1], self.rest.shape[0]

    @property
    def change(self) -> Array:
        """(K, H, W, 3)."""
        return self.pictures - self.rest


def read_recording(path: Path, crop: tuple[int, int, int, int] | None = None, forces: Path | None = None) -> Recording:
    """Reads what `gelsim identify` is given.

    Args:
        path: A video, a folder of pictures (or with frames/ in it), or an episode's .tar.
        crop: Left, top, width and height of what shows the gel [px].
        forces: CSV with the columns picture (from 0) and force_n.
    Raises:
        SceneError: It cannot be read, or shows no press. DatasetError: A damaged episode.
    """
    levels = _pictures(path, crop)
    change = np.abs(levels[1:] - levels[0]).mean(axis=(1, 2, 3))
    if len(change) == 0 or change.max() < SEEN:
        largest = change.max(initial=0.0)
        raise SceneError(
            f"{path}: no press can be seen in it: of {len(levels)} pictures the largest change from the first is {largest:.2g} levels "
            f"of 255 on the mean, {SEEN:g} are wanted; the first picture must show the sensor untouched"
        )
    deepest = int(change.argmax())
    wanted = np.linspace(FIRST_SHARE, 1.0, PICTURES) * change[deepest]
    chosen = np.unique([np.abs(change[: deepest + 1] - each).argmin() for each in wanted])
    chosen = chosen[change[chosen] >= 0.5 * wanted[0]] + 1
    return Recording(levels[0], levels[chosen], chosen, None if forces is None else _forces(forces, chosen))


def _pictures(path: Path, crop: tuple[int, int, int, int] | None) -> Array:
    """All pictures, averaged to WIDTH, (N, H, W, 3)."""
    if path.suffix == ".tar":
        episode = read_episode(path)
        if episode.frames.size == 0:
            raise SceneError(f"{path}: an episode without pictures; gelsim dataset --light-of draws them")
        pictures = [_small(np.asarray(picture, float)) for picture in (episode.background, *episode.frames)]
    else:
        folder = path if path.is_dir() else path.parent
        folder = folder / "frames" if path.is_dir() and (folder / "frames").is_dir() else folder
        reader = Reader(folder, crop=crop)
        if path.is_dir():
            names = sorted(file.name for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)
        elif path.suffix.lower() in VIDEOS:
            names = reader.names_within(path)
        else:
            kinds = ", ".join((*VIDEOS, ".tar"))
            raise SceneError(f"{path}: is no folder of pictures, no video and no episode ({kinds})")
        pictures = [_small(reader.levels(name)) for name in names]
    if len({picture.shape for picture in pictures}) > 1:
        raise SceneError(f"{path}: its pictures have different sizes")
    return np.stack(pictures) if pictures else np.zeros((0, 1, 1, 3))


def _small(picture: Array) -> Array:
    height, width = picture.shape[:2]
    return resized(picture, (WIDTH, max(round(WIDTH * height / width), 1))) if width > WIDTH else picture


def _forces(path: Path, chosen: NDArray[np.int64]) -> Array:
    _, rows = read_csv(path, f"--forces {path}", known=("picture", "force_n"))
    try:
        known = {int(row["picture"]): float(row["force_n"]) for row in rows}
    except (KeyError, ValueError) as error:
        raise SceneError(f"--forces {path}: each line has the number of a picture, from 0, and force_n [N] ({error})") from None
    if missing := [int(number) for number in chosen if not np.isfinite(known.get(int(number), np.nan))]:
        raise SceneError(f"--forces {path}: no force of picture {missing[0]}; pictures {', '.join(map(str, chosen))} are fitted")
    return np.array([known[int(number)] for number in chosen])
