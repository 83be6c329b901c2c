"""Where a matrix entry lies: the upper triangle stored by node pairs, for the kernels and for the sparse solver.

Node i owns up to four unknowns (u_x, u_y, u_z, and p where it carries a pressure), numbered in a row; `local[i, c]` is the place of
component c among them or -1 where it is prescribed. A kernel finds a value's slot with one short binary search for the pair of nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

wp.set_module_options({"max_unroll": 1, "enable_backward": False})


@wp.struct
class PairPattern:
    """The upper triangle by node pairs (see `SymmetricPattern`)."""

    local: wp.array2d(dtype=wp.int32)
    count: wp.array(dtype=wp.int32)
    base: wp.array(dtype=wp.int32)
    width: wp.array(dtype=wp.int32)
    row: wp.array(dtype=wp.int32)
    column: wp.array(dtype=wp.int32)
    offset: wp.array(dtype=wp.int32)


@wp.func
def find_pair(pattern: PairPattern, i: wp.int32, j: wp.int32) -> wp.int32:
    """Where the columns of node j begin within the rows of node i, i < j; -1 where the pair is not in the pattern."""
    low = pattern.row[i]
    high = pattern.row[i + 1]
    while low < high:
        middle = (low + high) // 2
        if pattern.column[middle] < j:
            low = middle + 1
        else:
            high = middle
    if low < pattern.row[i + 1]:
        if pattern.column[low] == j:
            return pattern.offset[low]
    return -1


@wp.func
def row_start(pattern: PairPattern, i: wp.int32, li: wp.int32) -> wp.int32:
    """Where in node i's row number `li` column 0 of its own would be; those of later nodes follow after its own, `count` of them."""
    return pattern.base[i] + li * (pattern.count[i] + pattern.width[i]) - li * (li - 1) // 2 - li


@wp.func
def find_entry(pattern: PairPattern, a: wp.int32, ca: wp.int32, b: wp.int32, cb: wp.int32, offset: wp.int32) -> wp.int32:
    """Where the entry (node a component ca, node b component cb) or its mirror lies; -1 where one is prescribed, or for a = b ca > cb.

    `offset` is `find_pair` of the two nodes, unused for a = b.
    """
    i = a
    j = b
    li = pattern.local[a, ca]
    lj = pattern.local[b, cb]
    if b < a:
        i = b
        j = a
        swap = li
        li = lj
        lj = swap
    if li < 0 or lj < 0 or (i == j and lj < li):
        return -1
    start = row_start(pattern, i, li) + lj
    if i != j:
        start += pattern.count[i] + offset
    return start


@wp.func
def add_entry(pattern: PairPattern, values: wp.array(dtype=wp.float64), a: wp.int32, ca: wp.int32, b: wp.int32, cb: wp.int32,
              offset: wp.int32, value: wp.float64):  # fmt: skip
    """Adds to the entry that `find_entry` finds, if it does."""
    entry = find_entry(pattern, a, ca, b, cb, offset)
    if entry >= 0:
        wp.atomic_add(values, entry, value)


@wp.func
def pair_offset(pattern: PairPattern, a: wp.int32, b: wp.int32) -> wp.int32:
    """`find_pair` of two nodes in either order, 0 for a node with itself."""
    if a == b:
        return 0
    return find_pair(pattern, wp.min(a, b), wp.max(a, b))


@wp.func
def add_block(pattern: PairPattern, values: wp.array(dtype=wp.float64), a: wp.int32, b: wp.int32, offset: wp.int32, block: wp.mat33d):
    """Adds the displacement block of nodes (a, b), in either order; `offset` is `pair_offset` of the two."""
    i = wp.min(a, b)
    j = wp.max(a, b)
    first = offset
    if i != j:
        first += pattern.count[i]
    for c in range(3):
        li = pattern.local[i, c]
        if li >= 0:
            start = row_start(pattern, i, li) + first
            for d in range(3):
                lj = pattern.local[j, d]
                if lj >= 0 and (i != j or d >= c):
                    if a <= b:
                        wp.atomic_add(values, start + lj, block[c, d])
                    else:
                        wp.atomic_add(values, start + lj, block[d, c])


@dataclass(frozen=True, eq=False)
class SymmetricPattern:
    """The upper triangle of the matrix: CSR arrays for the solver, node-pair arrays for the kernels."""

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    pairs: PairPattern
    equation: NDArray[np.int32]
    """Unknown of (node, component), or -1: shape (N, 4)."""

    @property
    def size(self) -> int:
        return len(self.indptr) - 1


def element_pairs(tets: NDArray[np.int32], node_count: int) -> NDArray[np.int64]:
    """Sorted keys lower·N + higher of all node pairs that share a tet, without the diagonal; a node may stand twice in a row."""
    a, b = (tets[:, index].ravel() for index in np.triu_indices(tets.shape[1], 1))
    return np.unique(pair_keys(a[a != b], b[a != b], node_count))


def split_pressures(tets: NDArray[np.int32], material: NDArray[np.int32], node_count: int) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Pressure nodes (T, 4) of tets of several materials: across an interface the pressure jumps, so each side has its own.

    The first material to hold a vertex keeps it; the others get extra nodes, numbered from `node_count` on, at the vertices returned.
    """
    vertices = tets[:, :4].astype(np.int64)
    keys, index = np.unique(vertices + node_count * material[:, None].astype(np.int64), return_inverse=True)
    _, first = np.unique(keys % node_count, return_index=True)
    number = keys % node_count
    extra = np.ones(len(keys), bool)
    extra[first] = False
    copies = number[extra]
    number[extra] = node_count + np.arange(len(copies))
    return number[index].reshape(vertices.shape).astype(np.int32), copies


def pair_keys(a: NDArray[np.int32], b: NDArray[np.int32], node_count: int) -> NDArray[np.int64]:
    return np.minimum(a, b).astype(np.int64) * node_count + np.maximum(a, b)


def build_pattern(free: NDArray[np.bool_], keys: NDArray[np.int64], device: str) -> SymmetricPattern:
    """The pattern of a set of node pairs.

    Args:
        free: Which of (u_x, u_y, u_z, p) of each node are unknowns, shape (N, 4).
        keys: Sorted, unique pair keys (see `element_pairs`).
    """
    n = len(free)
    count = free.sum(1).astype(np.int64)
    local = np.where(free, np.cumsum(free, axis=1) - 1, -1).astype(np.int32)
    first = np.concatenate([[0], np.cumsum(count)])
    equation = np.where(free, first[:-1, None] + local, -1).astype(np.int32)

    lower, higher = keys // n, keys % n
    keep = (count[lower] > 0) & (count[higher] > 0)
    lower, higher = lower[keep], higher[keep]
    row = np.concatenate([[0], np.cumsum(np.bincount(lower, minlength=n))])
    running = np.concatenate([[0], np.cumsum(count[higher])])
    offset = running[:-1] - running[row[lower]]
    width = running[row[1:]] - running[row[:-1]]

    # CSR rows: node i's unknown number l holds its own later unknowns, then all of every neighbour's
    node_of = np.repeat(np.arange(n), count)
    place = np.arange(first[-1]) - first[node_of]
    length = count[node_of] - place + width[node_of]
    indptr = np.concatenate([[0], np.cumsum(length)])
    base = np.zeros(n, np.int64)
    has = count > 0
    base[has] = indptr[first[:-1][has]]
    neighbour = np.repeat(higher, count[higher])
    within = np.arange(running[-1]) - np.repeat(running[:-1], count[higher])
    tail = first[neighbour] + within  # the unknowns of all neighbours, row of nodes by row of nodes
    indices = np.empty(indptr[-1], np.int32)
    own_length = count[node_of] - place
    own = np.repeat(np.arange(first[-1]) - np.concatenate([[0], np.cumsum(own_length)[:-1]]), own_length) + np.arange(own_length.sum())
    slot_own = np.repeat(indptr[:-1] - np.concatenate([[0], np.cumsum(own_length)[:-1]]), own_length) + np.arange(own_length.sum())
    indices[slot_own] = own
    tail_length = width[node_of]
    shift = np.concatenate([[0], np.cumsum(tail_length)[:-1]])
    source = np.repeat(running[row[node_of]] - shift, tail_length) + np.arange(tail_length.sum())
    slot_tail = np.repeat(indptr[:-1] + own_length - shift, tail_length) + np.arange(tail_length.sum())
    indices[slot_tail] = tail[source]

    pairs = PairPattern()
    for name, array in dict(local=local, count=count, base=base, width=width, row=row, column=higher, offset=offset).items():
        setattr(pairs, name, wp.array(np.ascontiguousarray(array, np.int32), dtype=wp.int32, device=device))
    return SymmetricPattern(indptr.astype(np.int32), indices, pairs, equation)
