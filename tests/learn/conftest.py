"""Made-up presses by closed forms, so that the learner is tested without mechanics or light: wrong in size, right in kind.

A ball of radius R on a gel: the softer the ball, the flatter the dent (its radius grows as 1 + E_gel/E) and the larger the share of the
approach that the ball takes. Lambert light from three sides; dark markers that move outward.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gelsim.data.episodes import episode_file, survey, write_episode, write_meta
from gelsim.results import Episode
from learn.config import configure
from learn.train import train

ROWS, COLUMNS, WIDTH_MM = 36, 48, 18.4
GEL = 17.0
GELS = (
    {"thickness_mm": 2.1, "edge_thickness_mm": 0.8, "shore_00": 13.0},
    {"thickness_mm": 2.7, "edge_thickness_mm": 1.4, "shore_00": 19.0},
)
"""Said of the presses in turn; they all look as if seen through one."""
COLOURED = np.array([[1.0, 0.2, 0.1], [0.1, 0.9, 0.3], [0.2, 0.2, 1.0]])


def fake_press(
    shore: float | None, radius_mm: float, depth_mm: float, frames: int, rng: np.random.Generator, row: dict[str, Any]
) -> Episode:
    """A press whose pictures depend on the hardness in the way that a real one does; None: rigid."""
    ratio = 0.0 if shore is None else 10 ** ((GEL - shore) / 35)  # E_gel / E
    x, y = np.meshgrid(*(np.linspace(-0.5, 0.5, n) * WIDTH_MM * n / COLUMNS for n in (COLUMNS, ROWS)))
    centre = rng.uniform(-1.5, 1.5, 2)
    markers = np.stack(np.meshgrid(np.arange(-8, 9, 4.0), np.arange(-6, 7, 3.0)), -1).reshape(-1, 2) + rng.uniform(-0.5, 0.5, 2)
    angle = rng.uniform(0, 2 * np.pi)
    lights = [(np.cos(angle + k), np.sin(angle + k)) for k in (0.0, 2.1, 4.2)]
    colours = COLOURED * rng.uniform(0.9, 1.1, (3, 3))
    pictures, places = [], []
    for approach in np.concatenate([[0.0], np.linspace(0, depth_mm, frames)]):
        dent, flat = approach / (1 + ratio), radius_mm * (1 + ratio)
        r2 = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
        height = -np.log1p(np.exp(np.clip(8 * (dent - r2 / (2 * flat)), -30, 30))) / 8 if dent > 0 else np.zeros_like(x)
        down, across = np.gradient(height, WIDTH_MM / COLUMNS)
        away = markers - centre
        moved = markers + 0.4 * dent * away / (1 + (away**2).sum(axis=1, keepdims=True) / (2 * flat))
        dark = np.exp(-((x[..., None] - moved[:, 0]) ** 2 + (y[..., None] - moved[:, 1]) ** 2) / 0.3**2).sum(axis=-1)
        shade = sum(
            0.33 * (1 + 1.2 * (lx * across + ly * down))[..., None] * colour for (lx, ly), colour in zip(lights, colours, strict=True)
        )
        picture = 130 * np.asarray(shade) * (1 - 0.8 * np.clip(dark, 0, 1))[..., None] / np.sqrt(1 + across**2 + down**2)[..., None]
        pictures.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
        places.append(moved / WIDTH_MM * COLUMNS + [COLUMNS / 2, ROWS / 2])
    approaches = np.linspace(0, depth_mm, frames) * 1e-3
    force = np.zeros((frames, 3))
    force[:, 2] = -3e3 * approaches / (1 + ratio)
    noise = np.zeros((3, 3))
    noise[0] = 1.0
    row = row | {"shore_00": shore, "rigid": shore is None, "radius_mm": radius_mm, "frames": frames, "peak_force_n": -float(force[-1, 2])}
    return Episode(np.stack(pictures[1:]), pictures[0], np.arange(frames) / 30, approaches, force, np.stack(places[1:]), row, noise)


def fake_row(
    index: int, thing: str, domain: str = "sim", motion: str = "human", shape: str = "hemisphere", mechanics: str | None = None
) -> dict:
    return {
        "index": index, "object": thing, "group": 1, "shape": shape, "motion": motion, "domain": domain,
        "mechanics": mechanics or f"run-{index}", "sensor": "fake", "file": episode_file(index), "gel": GELS[index % len(GELS)],
    }  # fmt: skip


def fake_dataset(folder: Path, presses: int = 1, seed: int = 0, domain: str = "sim", rigid: bool = True) -> Path:
    """Objects of several radii and hardnesses, `presses` of each, in the splits that the paper has."""
    rng = np.random.default_rng(seed)
    splits: dict[str, list[int]] = {name: [] for name in ("train", "validation", "novel_hardness", "novel_shape", "robot", "natural")}
    index = 0

    def add(split: str, shore: float | None, radius: float, motion: str = "human", shape: str = "hemisphere", count: int = presses) -> None:
        nonlocal index
        for _ in range(count):
            row = fake_row(index, f"{shape}-{radius:g}-{shore}", domain, motion, shape)
            write_episode(folder, fake_press(shore, radius, rng.uniform(0.6, 1.6), int(rng.integers(6, 10)), rng, row))
            splits[split].append(index)
            index += 1

    for radius in (4.0, 9.0):
        for shore in (8.0, 20.0, 32.0, 44.0, 56.0, 68.0, 80.0):
            add("train", shore, radius)
        for shore in (14.0, 26.0, 38.0, 50.0, 62.0, 74.0):
            add("validation" if shore % 24 else "novel_hardness", shore, radius)
        for shore in (23.0, 47.0, 71.0):
            add("novel_hardness", shore, radius, count=1)
        add("robot", 20.0, radius, "robot")
    for shore in (20.0, 50.0, 80.0):
        add("novel_shape", shore, 6.0)
        add("natural", shore + 1, 7.0, shape="tomato")
    if rigid:
        add("train", None, 4.0)
    info = {"domain": domain, "fps": 30, "resolution": [COLUMNS, ROWS], "plan": "fake", "seed": seed, "noise": "none"}
    write_meta(folder, info, survey(folder), [], splits)
    return folder


TINY = {"picture": (24, 32), "frames": 4, "widths": (8, 16), "hidden": 16, "batch": 8, "warmup": 2, "validate_every": 3}
"""Settings of a network that trains in no time."""


@pytest.fixture(scope="session")
def fake_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fake_dataset(tmp_path_factory.mktemp("fake") / "data")


@pytest.fixture(scope="session")
def tiny_run(fake_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a few steps: a whole checkpoint, which knows little."""
    out = tmp_path_factory.mktemp("run") / "run"
    train(fake_data, out, configure(**TINY, steps=6))
    return out
