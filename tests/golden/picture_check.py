"""Whether pictures are still what they were, by statistics: a renderer of random paths never gives the same picture twice.

Reference: of `count` pictures of other seeds the mean m and variance s² of each pixel, of each tile of 16 x 16 pixels, of each of 60 x 60
(a light that turns by 2 degrees within the window's plane changes 0.1 levels at most, but everywhere), and the centroid of each marker. A
few new pictures of mean x (n of them) differ from it by

    t = (x - m) / √(s² (1/n + 1/count) + q),   q = 1/12 level²,

which is Student's t of count - 1 degrees of freedom where noise is normal. q is the variance of rounding to whole levels: without noise all
seeds round alike, and another machine's last bit may turn a level over. A tile's q is that over its pixels; its variance is that of the
means themselves, for noise of light that is gathered at the membrane's vertices is shared by neighbouring pixels. A path counts for its own
pixel only (box filter). A picture has moved where one value is less likely than `FALSE_ALARM` over the number of values, or a marker's
centroid has gone farther than `CENTROID_PX`, or a marker is not there. A share of bad pixels would not do: a marker is one in a thousand.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import stats

TILES = (16, 60)
"""Pixels along their sides."""
ROUNDING = 1 / 12
"""Variance of rounding [level²]."""
FALSE_ALARM = 1e-4
"""Of all pixels, and of all tiles of a size, of one picture."""
CENTROID_PX = 0.05
WINDOW_PX = 7.0
"""Radius about a marker's place within which its darkness is weighed; a ring of `RING_PX` around that is the coat beside it."""
RING_PX = 2.0
DARK = 0.25
"""Share of the coat's level by which a pixel must be darker to belong to a marker: shading about it is less."""
MEAN_STEP, DEVIATION_STEP = 1 / 128, 1 / 128
"""[levels] in which means and standard deviations are stored."""


@dataclass(frozen=True, eq=False)
class Reference:
    """What pictures of one scene were."""

    count: int
    mean: NDArray[np.float64]
    """[levels], shape (H, W, 3)."""
    deviation: NDArray[np.float64]
    """From picture to picture [levels], shape (H, W, 3)."""
    tile_deviation: tuple[NDArray[np.float64], ...]
    """Of tiles' means [levels], by size of `TILES`, each of shape (rows, columns, 3)."""
    markers: NDArray[np.float64]
    """Centroids (column, row) and darkness [levels] of the markers that are wholly seen, shape (K, 3)."""

    @classmethod
    def of(cls, pictures: NDArray[np.uint8], places: NDArray[np.float64]) -> Reference:
        """Of pictures (N, H, W, 3), with markers about `places` (column, row), shape (K, 2)."""
        values = pictures.astype(float)
        mean = values.mean(axis=0)
        height, width = mean.shape[:2]
        margin = WINDOW_PX + RING_PX
        whole = ((places > margin) & (places < np.array([width, height]) - margin)).all(axis=1)
        of_tiles = tuple(tiles(values, side).std(axis=0, ddof=1) for side in TILES)
        return cls(len(values), mean, values.std(axis=0, ddof=1), of_tiles, weighed(mean, places[whole]))

    def save(self, path: Path) -> None:
        """Whole numbers of the steps above, compressed."""
        np.savez_compressed(
            path,
            count=self.count,
            mean=np.rint(self.mean / MEAN_STEP).astype(np.uint16),
            deviation=np.rint(self.deviation / DEVIATION_STEP).astype(np.uint16),
            markers=self.markers,
            **{f"tile_{side}": values.astype(np.float32) for side, values in zip(TILES, self.tile_deviation, strict=True)},
        )

    @classmethod
    def load(cls, path: Path) -> Reference:
        """As it was saved."""
        with np.load(path, allow_pickle=False) as stored:
            return cls(
                int(stored["count"]), stored["mean"] * MEAN_STEP, stored["deviation"] * DEVIATION_STEP,
                tuple(stored[f"tile_{side}"].astype(float) for side in TILES), stored["markers"],
            )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Comparison:
    """New pictures beside a reference."""

    mean: NDArray[np.float64]
    pixel_p: NDArray[np.float64]
    """Probability of a deviation as large, by pixel and colour, shape (H, W, 3)."""
    tile_p: tuple[NDArray[np.float64], ...]
    """The same of tiles, by size of `TILES`."""
    centroid_error: NDArray[np.float64]
    """[px], shape (K,); infinite where the marker is missing."""

    @property
    def faults(self) -> list[str]:
        """What has moved, in words."""
        told = []
        names = ("pixels", *(f"tiles of {side} pixels" for side in TILES))
        for name, p in zip(names, (self.pixel_p, *self.tile_p), strict=True):
            if p.min() < FALSE_ALARM / p.size:
                row, column, colour = np.unravel_index(p.argmin(), p.shape)
                count = int((p < FALSE_ALARM / p.size).sum())
                told.append(f"{name}: {count} of {p.size} moved, most at column {column}, row {row}, {'RGB'[colour]} (p = {p.min():.1e})")
        missing = np.isinf(self.centroid_error)
        if missing.any():
            told.append(f"markers: {missing.sum()} of {len(missing)} missing, the first is number {np.flatnonzero(missing)[0]}")
        off = self.centroid_error[~missing]
        if off.max(initial=0.0) > CENTROID_PX:
            told.append(f"markers: {(off > CENTROID_PX).sum()} moved by more than {CENTROID_PX} px, the farthest by {off.max():.3f} px")
        return told


def compare(reference: Reference, pictures: NDArray[np.uint8]) -> Comparison:
    """New pictures (n, H, W, 3) with a reference of the same scene."""
    mean = pictures.astype(float).mean(axis=0)
    share = 1 / len(pictures) + 1 / reference.count

    def likely(difference: NDArray[np.float64], deviation: NDArray[np.float64], rounding: float) -> NDArray[np.float64]:
        return 2 * stats.t.sf(np.abs(difference) / np.sqrt(share * deviation**2 + rounding), reference.count - 1)

    found = weighed(mean, reference.markers[:, :2])
    error = np.hypot(*(found - reference.markers)[:, :2].T)
    error[found[:, 2] < 0.5 * reference.markers[:, 2]] = np.inf
    return Comparison(
        mean,
        likely(mean - reference.mean, reference.deviation, ROUNDING),
        tuple(
            likely(tiles(mean - reference.mean, side), deviation, ROUNDING / side**2)
            for side, deviation in zip(TILES, reference.tile_deviation, strict=True)
        ),
        error,
    )


def tiles(values: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Means of tiles of (..., H, W, 3); rows that fill no tile belong to none."""
    *rest, height, width, _ = values.shape
    rows, columns = height // side, width // side
    cut = values[..., : rows * side, : columns * side, :]
    return cut.reshape(*rest, rows, side, columns, side, 3).mean(axis=(-4, -2))


def weighed(picture: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centroids (column, row) and summed darkness [levels] of what is dark about places (column, row); shape (K, 3)."""
    level = picture.mean(axis=2)
    rows, columns = np.mgrid[: level.shape[0], : level.shape[1]] + 0.5
    found = []
    for column, row in places:
        distance = np.hypot(columns - column, rows - row)
        near, ring = distance < WINDOW_PX, (distance >= WINDOW_PX) & (distance < WINDOW_PX + RING_PX)
        weight = np.clip((1 - DARK) * np.median(level[ring]) - level[near], 0, None)
        total = max(weight.sum(), 1e-9)
        found.append([weight @ columns[near] / total, weight @ rows[near] / total, weight.sum()])
    return np.array(found).reshape(-1, 3)


def write_failure(folder: Path, reference: Reference, found: Comparison) -> None:
    """Image, reference, difference (grey is none, 16 levels for one) and maps of the p-values (white 1, black 1e-12 or less)."""
    folder.mkdir(parents=True, exist_ok=True)
    shown = {"image": found.mean, "reference": reference.mean, "difference": 128 + 16 * (found.mean - reference.mean)}
    maps = {1: found.pixel_p, **dict(zip(TILES, found.tile_p, strict=True))}
    for side, p in maps.items():
        grey = 255 * (1 + np.log10(np.clip(p, 1e-12, 1)) / 12)
        shown[f"p_value_{side}"] = grey.repeat(side, axis=0).repeat(side, axis=1)
    for name, values in shown.items():
        Image.fromarray(np.clip(np.rint(values), 0, 255).astype(np.uint8)).save(folder / f"{name}.png")
    (folder / "faults.json").write_text(json.dumps(found.faults, indent=1), encoding="utf-8")
