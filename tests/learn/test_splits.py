"""Nothing leaks between the sides of a split."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gelsim.data.episodes import load_dataset
from gelsim.errors import DatasetError
from learn.data import sides
from learn.splits import check_splits, split_by_object


def row(
    index: int, thing: str, mechanics: str | None = None, shore: float = 20.0, motion: str = "human", shape: str = "edge"
) -> dict[str, Any]:
    return {
        "index": index, "object": thing, "mechanics": mechanics or f"run-{index}", "shore_00": shore, "motion": motion, "shape": shape,
        "radius_mm": None, "rigid": False,
    }  # fmt: skip


def test_a_clean_split_passes() -> None:
    rows = [row(0, "a"), row(1, "a"), row(2, "b", shore=30.0), row(3, "a", motion="robot"), row(4, "c", shape="cone")]
    check_splits(rows, {"train": [0, 1], "novel_hardness": [2], "robot": [3], "novel_shape": [4]})


@pytest.mark.parametrize(
    ("rows", "splits", "words"),
    [
        ([row(0, "a"), row(1, "a")], {"train": [0], "validation": [1]}, "object 'a'"),
        ([row(0, "a", "run"), row(1, "b", "run")], {"train": [0], "validation": [1]}, "mechanics 'run'"),
        ([row(0, "a")], {"train": [0], "validation": [0]}, "index 0"),
        ([row(0, "a", "run"), row(1, "a", "run", motion="robot")], {"train": [0], "robot": [1]}, "mechanics 'run'"),
        ([row(0, "a"), row(1, "a")], {"train": [0], "robot": [1]}, "human pressed"),
        ([row(0, "a"), row(1, "b")], {"train": [0], "novel_hardness": [1]}, "trained on"),
        ([row(0, "a"), row(1, "b", shore=50.0)], {"train": [0], "novel_shape": [1]}, "trained on"),
    ],
)
def test_each_leak_is_named(rows: list[dict[str, Any]], splits: dict[str, list[int]], words: str) -> None:
    with pytest.raises(DatasetError, match=words):
        check_splits(rows, splits)


def test_splitting_by_object_never_parts_an_object_or_a_run(rng: np.random.Generator) -> None:
    for trial in range(100):
        rows = [row(index, f"o{rng.integers(12)}", f"m{rng.integers(20)}") for index in range(40)]
        first, second = split_by_object(rows, 0.3, trial)
        assert sorted(first + second) == list(range(40)) and first
        for key in ("object", "mechanics"):
            assert not {rows[index][key] for index in first} & {rows[index][key] for index in second}


def test_what_is_trained_on_shares_no_object_with_any_test(fake_data: Path) -> None:
    dataset = load_dataset(fake_data)
    train, validation = sides(dataset, 0)
    things = {name: {dataset.rows[dataset.positions[index]]["object"] for index in members} for name, members in dataset.splits.items()}
    things |= {
        "train": {dataset.rows[dataset.positions[index]]["object"] for index in train},
        "validation": {dataset.rows[dataset.positions[index]]["object"] for index in validation},
    }
    names = [name for name in things if name != "robot"]  # by the paper's definition trained samples
    assert all(things.values())
    assert not any(things[a] & things[b] for a in names for b in names if a != b)
    runs = [dataset.rows[dataset.positions[index]]["mechanics"] for members in dataset.splits.values() for index in members]
    assert len(set(runs)) == len(runs)
