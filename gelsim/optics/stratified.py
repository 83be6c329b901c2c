"""Places in the pixel and on the lights for the paths of a pixel: correlated multi-jittered sets (Kensler 2013). Plain NumPy.

A set of N = C x R points holds one in each cell of a C x R grid, and one in each of N columns and N rows. Some hundred sets are made once;
a pixel takes one by lot. Paths stand in the order of `groups` of theirs, and each group is spread evenly over both squares: cells are
dealt out along diagonals.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

POINTS = 2**18
"""In all sets together, at most that many sets: 4 MB."""
SETS = 4096


def grid_of(count: int) -> tuple[int, int]:
    """Columns and rows of the smallest nearly square grid of `count` cells or more."""
    rows = max(math.isqrt(count), 1)
    return -(-count // rows), rows


def path_groups(count: int, groups: int) -> NDArray[np.int64]:
    """How many of `count` paths each group has, shape (groups,): they differ by the grid's ends."""
    columns, rows = grid_of(count)
    return np.bincount(_group_of_cells(columns, rows, groups), minlength=groups)


def path_sets(count: int, groups: int, seed: int) -> NDArray[np.float32]:
    """Points (pixel x, pixel y, light x, light y) in the unit square, shape (sets, N, 4); a set's paths stand group by group."""
    columns, rows = grid_of(count)
    sets = max(min(SETS, POINTS // (columns * rows)), 64)
    rng = np.random.default_rng([seed, count, groups])
    return np.concatenate([_ordered(rng, sets, columns, rows, groups) for _ in range(2)], axis=-1)


def _ordered(rng: np.random.Generator, sets: int, columns: int, rows: int, groups: int) -> NDArray[np.float32]:
    """One square's points, by group, within a group in an order of its own."""
    x, y = np.tile(np.arange(columns), rows), np.repeat(np.arange(rows), columns)
    down = np.argsort(rng.random((sets, rows)), axis=1)[:, y]
    right = np.argsort(rng.random((sets, columns)), axis=1)[:, x]
    first, second = rng.random((2, sets, columns * rows))
    points = np.stack([(x + (down + first) / rows) / columns, (y + (right + second) / columns) / rows], axis=-1)
    # Each cell is as likely as any other in each group: the diagonals are shifted by set.
    shift = rng.integers(columns, size=(sets, 1)), rng.integers(rows, size=(sets, 1))
    group = _group_of_cells(columns, rows, groups)[(x + shift[0]) % columns + (y + shift[1]) % rows * columns]
    order = np.argsort(group + rng.random((sets, columns * rows)), axis=1)
    return np.take_along_axis(points, order[..., None], axis=1).astype(np.float32)


def _group_of_cells(columns: int, rows: int, groups: int) -> NDArray[np.int64]:
    """Along diagonals; shape (columns · rows,), x fastest."""
    return (np.tile(np.arange(columns), rows) + np.repeat(np.arange(rows), columns)) % groups
