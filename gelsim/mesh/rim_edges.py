"""Edges of a mesh's flat top laid along lines in it, so that no face straddles them, and beside these.

A vertex close to where a line crosses one of its edges is moved onto the line, edges that a line still crosses are cut there, as in
isosurface stuffing (Labelle and Shewchuk 2007). What would leave a tet of low quality is not done: there a face straddles the line.

A pressed gel is drawn along under a rim, whose line it leaves by then, and where faces lie as the bisection left them some are long across
the rim, others short: so edges are cut along parallels of the lines too, and a strip of short faces goes along at either side.

Left out: lines closer to each other, or to the border, than the edges are long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.geometry import FACE_EDGES, TET_EDGES, TET_FACES, edges_of, tet_quality
from gelsim.mesh.bisection import Tets, split
from gelsim.shape.solids import Array

NEAR = 0.3
"""Share of an edge within which a crossing moves its end; farther from both ends it cuts the edge."""
NEAR_BESIDE = 0.15
"""The same for a parallel, where no end is moved: with 0.3 the membrane wavers by 2.6 µm along the worst oblique edge, with 0.15 by 2.1."""
LEAST = 0.2
"""Mean-ratio quality below which no tet is brought by a move or a cut."""
_CORNER = np.radians(40.0)
"""Turn of a line that is a corner, to which a vertex is moved; a circle of 0.5 mm cut within 10 µm turns by 23 degrees."""
_ROUNDS = 30
ALONGSIDE = 0.05
"""How much nearer to a line than asked its parallels may be, as a share: by 0.02 they are inside a circle that is cut as above."""


def lay_edges(vertices: Array, tets: Tets, pieces: Array, squeeze: Array, beside: float = 0.0) -> tuple[Array, Tets]:
    """The mesh with edges of its top along straight pieces (K, 2, 2) of lines in it; its hull stays.

    Args:
        vertices: (V, 3) of a box, its sides upright, its top flat.
        squeeze: Factors (3,) under which the quality of tets is seen.
        beside: Distance of the parallels, one at either side, along which there are edges too; 0 for none.
    """
    if not len(pieces):
        return vertices, tets
    vertices = _moved(vertices, tets, pieces, squeeze)
    vertices, tets = _cut_along(vertices, tets, pieces, NEAR, squeeze)
    return _cut_along(vertices, tets, _parallels(pieces, beside), NEAR_BESIDE, squeeze) if beside else (vertices, tets)


def _parallels(pieces: Array, away: float) -> Array:
    """Short pieces (L, 2, 2) at a distance from the lines, without those that are nearer to another part of them."""
    from scipy.spatial import KDTree

    along = pieces[:, 1] - pieces[:, 0]
    length = np.linalg.norm(along, axis=1)
    parts = int(np.ceil(2.0 * length.max() / away))
    points = pieces[:, :1] + np.linspace(0.0, 1.0, 2 * parts + 1)[:, None] * along[:, None]  # ends and middles of the short pieces
    ends = np.stack([points[:, :-2:2], points[:, 2::2]], axis=2).reshape(-1, 2, 2)
    across = (away / np.maximum(length, 1e-300))[:, None] * along[:, ::-1] * [-1.0, 1.0]
    across = np.repeat(across, parts, axis=0)[:, None]
    lines = np.concatenate([ends + across, ends - across])
    nearest = KDTree(points.reshape(-1, 2)).query(lines.mean(axis=1))[0]
    return lines[nearest > (1.0 - ALONGSIDE) * away]


def _cut_along(vertices: Array, tets: Tets, pieces: Array, near: float, squeeze: Array) -> tuple[Array, Tets]:
    """The mesh with the edges of its top cut where pieces cross them, but not `near` an end (a share), nor where that leaves poor tets."""
    refused: set[tuple[int, int]] = set()
    if not len(pieces):
        return vertices, tets
    for _ in range(_ROUNDS):
        edges = _top_edges(vertices, tets)
        edge, share = _crossings(vertices[edges, :2], pieces)
        inner = (share > near) & (share < 1.0 - near)
        edge, first = np.unique(edge[inner], return_index=True)
        share, ends = share[inner][first], edges[edge]
        fresh = np.array([tuple(e) not in refused for e in ends.tolist()], bool)
        ends, share = ends[fresh], share[fresh]
        if not len(ends):
            break
        vertices, tets = _cut(vertices, tets, ends, share, squeeze, refused)
    return vertices, tets


def _top_edges(vertices: Array, tets: Tets) -> NDArray[np.int64]:
    """(E, 2), of the faces in the plane of the highest vertices."""
    faces = tets[:, TET_FACES[:, :3]].reshape(-1, 3)
    faces = faces[(vertices[faces, 2] == vertices[:, 2].max()).all(axis=1)]
    return edges_of(faces.astype(np.int32), FACE_EDGES)[0]


def _crossings(edges: Array, pieces: Array) -> tuple[NDArray[np.int64], Array]:
    """Where pieces cross edges (E, 2, 2): number of the edge and the share of its length, one of each for each crossing."""
    from scipy.spatial import KDTree

    along = edges[:, 1] - edges[:, 0]
    longest = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).max()
    reach = 0.5 * (np.linalg.norm(along, axis=1) + longest) * (1 + 1e-9)
    near = KDTree(pieces.mean(axis=1)).query_ball_point(edges.mean(axis=1), reach, return_sorted=True)
    edge = np.repeat(np.arange(len(edges)), [len(found) for found in near])
    piece = pieces[np.concatenate([np.asarray(found, np.int64) for found in near])] if len(edge) else np.zeros((0, 2, 2))
    run, gap = piece[:, 1] - piece[:, 0], piece[:, 0] - edges[edge, 0]
    across = _cross(along[edge], run)
    lengths = np.linalg.norm(along[edge], axis=1) * np.linalg.norm(run, axis=1)
    slanted = np.abs(across) > 1e-9 * lengths  # one that lies along the edge does not cross it
    across[~slanted] = 1.0
    share, at = _cross(gap, run) / across, _cross(gap, along[edge]) / across
    hit = slanted & (share >= -1e-9) & (share <= 1 + 1e-9) & (at >= -1e-9) & (at <= 1 + 1e-9)
    return edge[hit], share[hit]


def _cross(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _moved(vertices: Array, tets: Tets, pieces: Array, squeeze: Array) -> Array:
    """Vertices near a line moved onto it, those next to its corners onto them; border vertices stay on their sides."""
    sides = np.stack([vertices[:, axis] == f(vertices[:, axis]) for axis in (0, 1) for f in (np.min, np.max)], axis=1)
    edges = _top_edges(vertices, tets)
    length = np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
    edge, share = _crossings(vertices[edges, :2], pieces)
    target: dict[int, tuple[float, Array]] = {}
    for end in (0, 1):
        close = (share if end == 0 else 1.0 - share) <= NEAR
        for e, s in zip(edge[close].tolist(), share[close].tolist(), strict=True):
            vertex, other = int(edges[e, end]), int(edges[e, 1 - end])
            if sides[vertex].any():
                if (sides[vertex] & ~sides[other]).any():
                    continue
                point = vertices[edges[e, 0], :2] + s * (vertices[edges[e, 1], :2] - vertices[edges[e, 0], :2])
            else:
                point = _closest(vertices[vertex, :2], pieces)
            away = float(np.linalg.norm(point - vertices[vertex, :2]))
            if vertex not in target or away < target[vertex][0]:
                target[vertex] = away, point
    top = np.unique(edges)
    around = np.zeros(len(vertices))
    np.maximum.at(around, edges.ravel(), length.repeat(2))
    for corner in _corners(pieces):
        beside = np.array([corner[axis] == f(vertices[:, axis]) for axis in (0, 1) for f in (np.min, np.max)])
        free = top[~(sides[top] & ~beside).any(axis=1)]
        away = np.linalg.norm(vertices[free, :2] - corner, axis=1)
        nearest = int(free[away.argmin()])
        if away.min() < 0.75 * around[nearest]:
            target[nearest] = -1.0, corner
    if not target:
        return vertices
    which = np.array(sorted(target))
    points = np.array([target[v][1] for v in which.tolist()])
    before = _quality(vertices, tets, squeeze)
    moved = vertices.copy()
    moved[which, :2] = points
    while True:
        poor = _quality(moved, tets, squeeze) < np.minimum(LEAST, before)
        back = np.intersect1d(np.unique(tets[poor]), which[(moved[which] != vertices[which]).any(axis=1)])
        if not len(back):
            return moved
        moved[back] = vertices[back]


def _quality(vertices: Array, tets: Tets, squeeze: Array) -> Array:
    return tet_quality(vertices * squeeze, tets.astype(np.int32))


def _closest(point: Array, pieces: Array) -> Array:
    """The nearest point of any piece."""
    along = pieces[:, 1] - pieces[:, 0]
    share = np.clip(((point - pieces[:, 0]) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-300), 0.0, 1.0)
    on = pieces[:, 0] + share[:, None] * along
    return on[((on - point) ** 2).sum(axis=1).argmin()]


def _corners(pieces: Array) -> Array:
    """Points (N, 2) where pieces meet at an angle, or more than two of them."""
    ends = np.concatenate([pieces, pieces[:, ::-1]])
    points, node = np.unique(np.round(ends[:, 0], 10), axis=0, return_inverse=True)
    node = node.ravel()
    away = ends[:, 1] - ends[:, 0]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
    count = np.bincount(node, minlength=len(points))
    total = np.stack([np.bincount(node, away[:, i], len(points)) for i in (0, 1)], axis=1)
    # two unit vectors that leave a point at an angle of 180 degrees less the turn add up to 2 sin(turn / 2)
    turned = np.linalg.norm(total, axis=1) > 2 * np.sin(_CORNER / 2)
    first = np.zeros(len(points), np.int64)
    first[node[::-1]] = np.arange(len(node))[::-1]
    return ends[first, 0][((count == 2) & turned) | (count > 2)]


def _cut(vertices: Array, tets: Tets, ends: NDArray[np.int64], share: Array, squeeze: Array,
         refused: set[tuple[int, int]]) -> tuple[Array, Tets]:  # fmt: skip
    """Edges (E, 2) cut at shares of their length, as many of them as no tet has two of; the others are left for the next round."""
    edges, index = edges_of(tets.astype(np.int32), TET_EDGES)
    key = edges[:, 0] * len(vertices) + edges[:, 1]
    number = np.searchsorted(key, ends[:, 0] * len(vertices) + ends[:, 1])
    length = np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
    rank = np.full(len(edges), -1)
    order = np.lexsort((number, length[number]))
    rank[number[order]] = np.arange(len(number))
    best = rank[index].max(axis=1)
    mine = best >= 0
    lost = np.zeros(len(number), bool)  # by rank: not the longest of those of some tet
    beaten = rank[index[mine]]
    lost[beaten[(beaten >= 0) & (beaten != best[mine, None])]] = True
    chosen = order[~lost]
    at = vertices[ends[chosen, 0]] + share[chosen, None] * (vertices[ends[chosen, 1]] - vertices[ends[chosen, 0]])
    middle = np.full(len(edges), -1)
    middle[number[chosen]] = len(vertices) + np.arange(len(chosen))
    cut = middle[index].max(axis=1) >= 0
    which = index[cut][np.arange(cut.sum()), middle[index[cut]].argmax(axis=1)]
    extended = np.vstack([vertices, at])
    children = split(tets[cut], edges[which], middle[which])
    quality = _quality(extended, children, squeeze).reshape(2, -1).min(axis=0)
    bad = np.unique(which[quality < LEAST])
    if len(bad):  # leave these edges, and try again without them
        refused.update(tuple(e) for e in edges[bad].tolist())
        stay = ~np.isin(number, bad)
        return _cut(vertices, tets, ends[stay], share[stay], squeeze, refused) if stay.any() else (vertices, tets)
    return extended, np.vstack([tets[~cut], children])
