"""Episodes without pictures, drawn where they are read: for a learner that needs small pictures and no files.

The picture is the plan's, at fewer pixels of the same proportions: the same field, coat and markers, whose texture is averaged over the
larger pixels (`optics.baked`). Nothing is written. Averaged to the same network picture, it differs from one of the plan's own size by what
a sample a pixel misses of light that varies within it (docs/learner.md, *On a GPU*, has it in levels).
"""

from __future__ import annotations

import math
from pathlib import Path

from gelsim.data.episodes import Dataset, load_dataset
from gelsim.errors import SceneError
from gelsim.generate.light import Studio
from gelsim.generate.plan import Catalogue
from gelsim.generate.relight import own_catalogue, plan_of, relit_episode
from gelsim.generate.run import Progress, kept_plan, measure_lights, sensors_of
from gelsim.results import Episode

FINER = 2
"""Drawn pixels along a side of a pixel that is wanted: whole, so that averaging cuts none."""
SPACING = 0.12e-3
"""Of the material grid [m], 0.08 mm in other pictures: half the vertices. Averaged to 128 × 96 pixels, 18 episodes differ by 0.76
levels rms from what pictures of 320 × 240 at 0.08 mm give; with 0.08 mm by 0.75, with 0.16 by 0.82."""


def prepare(data: Dataset, plan: str | None, device: str, progress: Progress | None) -> str:
    """Before workers draw: finds the plan and measures the light fields that are missing, all cores at it.

    Args:
        plan: Of a dataset that does not keep its own (an older one).
        device: Where fields are measured: "auto" takes CUDA where it works; "cpu" never.
    Returns:
        What the plan is found by.
    Raises:
        SceneError: The plan cannot be found, or is not the one that the dataset was made from.
    """
    name = plan if plan and not kept_plan(data.folder).is_file() else plan_of(data)
    catalogue = own_catalogue(data, name)
    if catalogue.plan.mode != "baked":
        raise SceneError(f"{data.folder}: its plan traces pictures (mode {catalogue.plan.mode!r}); gelsim dataset --light-of draws those")
    seen = sensors_of(catalogue, dict.fromkeys(int(row["mechanics"]) for row in data.rows))
    measure_lights([catalogue.sensor_scene(number) for number in seen], device, progress)
    return name


class Darkroom:
    """Draws episodes of a dataset that has none of their pictures."""

    def __init__(self, folder: Path, plan: str, picture: tuple[int, int]) -> None:
        """With what `prepare` gave; `picture`: rows and columns that will be made of the pictures."""
        self._data = load_dataset(folder)
        self._catalogue: Catalogue = own_catalogue(self._data, plan)
        self._studio = Studio("cpu", SPACING)
        self._drawn = small(self._catalogue.plan.resolution, picture)

    @property
    def taken(self) -> tuple[int, int]:
        """Rows and columns that the camera takes: its noise is of these."""
        columns, rows = self._catalogue.plan.resolution
        return rows, columns

    def episode(self, position: int) -> Episode:
        """The episode of `rows[position]` with small pictures; its markers' places are in their pixels."""
        return relit_episode(self._data, position, None, self._catalogue, self._studio, self._drawn).episode


def small(resolution: tuple[int, int], picture: tuple[int, int]) -> tuple[int, int]:
    """Width and height of the smallest picture of a resolution's proportions with FINER pixels for each that is wanted; never more."""
    width, height = resolution
    common = math.gcd(width, height)
    share = max(FINER * picture[1] / width, FINER * picture[0] / height)
    times = min(max(math.ceil(share * common - 1e-9), 1), common)
    return width // common * times, height // common * times
