"""A lens's distortion by the gel's edges: lines that are straight in the world must be straight once it is taken out.

The plumb-line method (Brown 1971; Devernay and Faugeras 2001) with `calibrate.lens`'s one coefficient. Along each side of the picture, or
of the four corners that were given, brightness is followed across; places where it changes most sharply within a few pixels are candidates,
and the parabola that most of them lie on is that side's edge. One straight line for each edge and one k for all of them have the least
squared distances from what was seen, in the photograph's pixels.

The standard deviation is the larger of two jackknives, over blocks along the edges, since errors of neighbours are alike, and over edges,
which tell of different k where they are not straight in the world. So two edges at least are needed, and k is believed from `SURE`
deviations on. Left out: sides that are all curved alike, by as much as some lens would do it, which no photograph tells from one.

Of the constants, halved and doubled on 28 pictures like the tests' and 32 without edges, few matter: a BLUR of 0.75 triples errors, with
all OUTLYING points kept they are eightfold, a narrower NARROW (3) finds next to no edge, and NEAR or BLUR doubled,
LEAST halved let one or two pictures without edges be believed. Believed deviations are 1.4 times too small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate.lens import RANGE, SURE, Lens, unbent

Array = NDArray[np.float64]

WIDTH = 480
"""Pictures are averaged down to at most this width; lengths in pixels, here, are those of the small picture."""
BLUR = 1.5
"""Standard deviation of the Gaussian whose derivative finds edges [px]."""
STEP = 2
"""Between the lines across an edge [px]."""
DEPTH, BAND = 0.3, 0.1
"""How far from the picture's side its edge is sought, of the picture's extent there; and from a line between two corners, of its length."""
CLEAR, NARROW, FALL = 4.0, 6, 2.0
"""A candidate's slope is so many times the median along its line, and falls to 1/FALL within NARROW pixels on both sides."""
NEAR, TRIES = 1.0, 400
"""Of an edge's points to a parabola [px]; and parabolas by three points that are tried."""
LEAST = 0.4
"""Of a side, on which its edge must be seen."""
ROUNDS, OUTLYING = 4, 4.5
"""Of the straight lines; and the points left out of the next one, in median distances of their edge: corners, which blur rounds."""
LOWEST = RANGE[0] - 0.005
BLOCKS = 8
"""Of an edge."""


def lens_of_edges(levels: Array, corners: Array | None = None) -> Lens | None:
    """Of a photograph (H, W, 3) without contact; `corners` (4, 2) [px], between which edges lie. None where they do not tell."""
    size = (levels.shape[1], levels.shape[0])
    found = straightened(gel_edges(levels, corners), size)
    if found is None:
        return None
    k, sd = found
    return Lens(k, size, sd, "edges") if abs(k) > SURE * sd and RANGE[0] <= k <= RANGE[1] else None


def gel_edges(levels: Array, corners: Array | None = None) -> list[Array]:
    """The edges that are seen, each (N, 2) (column, row) [px]."""
    from scipy.ndimage import gaussian_filter1d

    factor = -(-levels.shape[1] // WIDTH)
    height, width = (side // factor for side in levels.shape[:2])
    small = levels[: height * factor, : width * factor].reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    colours = np.moveaxis(small, -1, 0)
    slopes = np.stack([gaussian_filter1d(gaussian_filter1d(colours, BLUR, a), BLUR, b, order=1) for a, b in ((1, 2), (2, 1))], axis=-1)
    around = np.array([[0, 0], [width, 0], [width, height], [0, height]], float) if corners is None else np.asarray(corners) / factor
    found = []
    for start, end in zip(around, np.roll(around, -1, axis=0), strict=True):
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        inward = np.array([-along[1], along[0]])
        reach = (NARROW, DEPTH * float(np.abs(inward @ [width, height]))) if corners is None else (-BAND * length, BAND * length)
        edge = _edge(slopes, start, along, length, reach)
        if edge is not None:
            found.append(factor * edge)
    return found


def _edge(slopes: Array, start: Array, along: Array, length: float, reach: tuple[float, float]) -> Array | None:
    """Along one side: its edge (N, 2) [px]; None where there is none."""
    from scipy.ndimage import map_coordinates

    inward = np.array([-along[1], along[0]])
    first, last = int(np.floor(reach[0])) - NARROW, int(np.ceil(reach[1])) + NARROW
    s, o = np.arange(STEP / 2, length, STEP), np.arange(first, last + 1) + 0.5
    places = start + s[:, None, None] * along + o[None, :, None] * inward
    at = np.moveaxis(places[..., ::-1] - 0.5, -1, 0)
    height, width = slopes.shape[1:3]
    inside = np.asarray(((places > 0) & (places < [width, height])).all(axis=-1), bool)
    least, crossed = LEAST * len(s), inside.any(axis=1)
    s, at, inside = s[crossed], at[:, crossed], inside[crossed]
    parts = [
        map_coordinates(colour[..., 0], at, order=1) * inward[0] + map_coordinates(colour[..., 1], at, order=1) * inward[1]
        for colour in slopes
    ]
    steep = np.where(inside, np.sqrt(np.sum(np.square(parts), axis=0)), np.nan)
    usual = np.nanmedian(steep, axis=1, keepdims=True)
    middle = steep[:, NARROW:-NARROW]
    shifted = [steep[:, NARROW + way : steep.shape[1] - NARROW + way] for way in range(-NARROW, NARROW + 1)]
    with np.errstate(invalid="ignore"):
        before, after = np.min(shifted[:NARROW], axis=0), np.min(shifted[NARROW + 1 :], axis=0)
        peak = (middle >= shifted[NARROW - 1]) & (middle > shifted[NARROW + 1])
        peak &= (middle > CLEAR * usual) & (middle > FALL * before) & (middle > FALL * after)
    line, place = np.nonzero(peak)
    if len(line) < max(least, 3):
        return None
    low, top, high = (np.log(steep[line, place + NARROW + way] + 1e-12) for way in (-1, 0, 1))
    offset = o[place + NARROW] + 0.5 * (low - high) / np.minimum(low - 2 * top + high, -1e-9)
    t = s[line] / length
    chosen = _on_one_parabola(t, offset)
    if len(np.unique(line[chosen])) < least:
        return None
    return start + s[line[chosen], None] * along + offset[chosen, None] * inward


def _on_one_parabola(t: Array, offset: Array) -> NDArray[np.int64]:
    """Which points lie on the parabola that most of them lie on (RANSAC: Fischler and Bolles 1981); `t` is 0 to 1 along the side."""
    picks = np.random.default_rng(0).integers(len(t), size=(TRIES, 3))
    powers = np.stack([np.ones_like(t), t, t**2], axis=1)
    apart = (np.diff(np.sort(t[picks], axis=1), axis=1) > LEAST / 8).all(axis=1)
    parabolas = np.linalg.solve(powers[picks[apart]], offset[picks[apart]][..., None])[..., 0]
    off = np.abs(parabolas @ powers.T - offset)
    best = np.flatnonzero(off[(off < NEAR).sum(axis=1).argmax()] < NEAR) if len(off) else np.zeros(0, int)
    for _ in range(3 if len(best) > 3 else 0):
        fit = np.linalg.lstsq(powers[best], offset[best], rcond=None)[0]
        best = np.flatnonzero(np.abs(powers @ fit - offset) < NEAR)
    return best


def straightened(edges: list[Array], size: tuple[int, int]) -> tuple[float, float] | None:
    """The k without which edges (N, 2) [px] of a picture of width and height `size` [px] are straight, and its standard deviation; None by
    fewer than two."""
    from scipy.optimize import least_squares

    if len(edges) < 2:
        return None
    middle, half = np.array(size) / 2, float(np.hypot(*size)) / 2
    seen = np.concatenate([(edge - middle) / half for edge in edges])
    number = np.repeat(np.arange(len(edges)), [len(edge) for edge in edges])

    def residuals(unknowns: Array) -> Array:
        """Distances from the lines, as long as they are in the photograph [half diagonals]."""
        k, angle, far = unknowns[0], unknowns[1::2][number], unknowns[2::2][number]
        straight, normal = unbent(seen, k), np.stack([np.cos(angle), np.sin(angle)], axis=1)
        bow = 1 + k * (straight**2).sum(axis=1) + 2 * k * (straight * normal).sum(axis=1) ** 2
        return ((straight * normal).sum(axis=1) - far) * bow

    start = [0.0]
    for index in range(len(edges)):
        points = seen[number == index]
        normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][1]
        start += [np.arctan2(normal[1], normal[0]), normal @ points.mean(axis=0)]
    lowest, kept = np.append(LOWEST, np.full(len(start) - 1, -np.inf)), np.ones(len(seen), bool)
    for last in (False,) * (ROUNDS - 1) + (True,):
        fit = least_squares(lambda unknowns, kept=kept: residuals(unknowns)[kept], start, x_scale="jac", bounds=(lowest, np.inf))
        if not last:
            start, left = fit.x, np.abs(residuals(fit.x))
            kept = left < OUTLYING * np.array([np.median(left[number == index]) for index in range(len(edges))])[number]
    return float(fit.x[0]), _deviation(fit.jac, fit.fun, number[kept])


def _deviation(jacobian: Array, left: Array, number: NDArray[np.int64]) -> float:
    """Of the first unknown, by leaving out blocks of each edge and whole edges, in the linear fit about the best one."""
    blocks = np.concatenate([index * BLOCKS + np.arange(count) * BLOCKS // count for index, count in enumerate(np.bincount(number))])
    deviations = []
    for groups in (blocks, number):
        moved = [-np.linalg.lstsq(jacobian[groups != out], left[groups != out], rcond=None)[0][0] for out in np.unique(groups)]
        deviations.append(np.sqrt((len(moved) - 1) * np.var(moved)))
    return float(max(deviations))
