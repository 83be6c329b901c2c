"""Which presses are trained on and which are held out, and that nothing leaks between them. Standard library.

A press belongs to an object and to a mechanics run (several end points or lights of one run share it). Neither may lie on two sides, with
one exception that is the paper's own: its row "robot" presses *trained* samples with a gripper. There the runs differ, the objects do not.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from typing import Any

from gelsim.errors import DatasetError

TRAIN, VALIDATION = "train", "validation"
TEST_ROWS = ("novel_hardness", "novel_shape", "robot", "vessels", "complicated", "natural")
TRAINED_OBJECTS = "robot"
"""The row whose objects were trained on, by the paper's definition."""


def check_splits(rows: Sequence[Mapping[str, Any]], splits: Mapping[str, Sequence[int]]) -> None:
    """Proves that no press, object or mechanics run is on two sides, and that a row's name keeps its promise.

    Args:
        rows: Of the dataset. splits: name -> values of `index` in rows.
    Raises:
        DatasetError: Names the object or run, and the two splits.
    """
    by_index = {row["index"]: row for row in rows}
    for key in ("index", "mechanics", "object"):
        seen: dict[Any, str] = {}
        for name, members in splits.items():
            if key == "object" and name == TRAINED_OBJECTS:
                continue
            for index in members:
                value = by_index[index][key]
                if seen.setdefault(value, name) != name:
                    raise DatasetError(f"splits: {key} {value!r} is both in {seen[value]!r} and in {name!r}")
    trained = [by_index[index] for index in splits.get(TRAIN, ())]
    promises = {"novel_hardness": ("shore_00",), "novel_shape": ("shape", "radius_mm")}
    for name, keys in promises.items():
        known = {tuple(row[key] for key in keys) for row in trained}
        for index in splits.get(name, ()):
            value = tuple(by_index[index][key] for key in keys)
            if None not in value[:1] and value in known:
                raise DatasetError(f"splits: {name!r} holds {', '.join(map(str, value))}, which was trained on (episode {index})")
    for index in splits.get(TRAINED_OBJECTS, ()):
        if by_index[index]["motion"] != "robot":
            raise DatasetError(f"splits: {TRAINED_OBJECTS!r} holds episode {index}, which a {by_index[index]['motion']} pressed")


def split_by_object(rows: Sequence[Mapping[str, Any]], share: float, seed: int) -> tuple[list[int], list[int]]:
    """Whole objects into two parts, for a dataset that brings no validation split.

    Objects that share a mechanics run go together.

    Args:
        share: Of the objects, that go into the second part; at least one object stays in the first.
    Returns:
        Values of `index` in the first and in the second part, ordered.
    """
    parent: dict[str, str] = {}

    def root(key: str) -> str:
        parent.setdefault(key, key)
        while parent[key] != key:
            key = parent[key]
        return key

    for row in rows:
        parent[root(f"mechanics {row['mechanics']}")] = root(f"object {row['object']}")
    groups = sorted({root(f"object {row['object']}") for row in rows})
    random.Random(seed).shuffle(groups)
    held = set(groups[: min(round(share * len(groups)), len(groups) - 1)])
    first, second = [], []
    for row in rows:
        (second if root(f"object {row['object']}") in held else first).append(row["index"])
    return sorted(first), sorted(second)
