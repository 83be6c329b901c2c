"""Hand-made features of a press over time, in the manner of Yuan et al. (IROS 2016): what the baselines see. Plain NumPy.

For each frame, against the no-contact frame B, with |d| the largest change over the colours [levels of 255]:

    signal   mean change                       area     share of pixels with |d| > AREA_LEVELS
    slope    mean |∇d| over that area [levels/px of the network's picture]
    size     root mean square distance of the change from its centre [picture widths]
    markers  mean |u| and the spread Σ u·r / Σ r² of the markers' displacement u at place r from their centre [picture widths; 1]

Without tracked markers (recordings) the last two are 0. Left out: the contact force, which a video does not give.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NAMES = ("signal", "area", "slope", "size", "marker_motion", "marker_spread")
AREA_LEVELS = 8.0
"""Twice what the flanks of a marker change by when it does not move, in simulated pictures with noise of 2 levels."""


def press_features(
    pictures: NDArray[np.floating], background: NDArray[np.floating], signal: NDArray[np.floating], markers: NDArray[np.floating]
) -> NDArray[np.float32]:
    """The features of every frame.

    Args:
        pictures: (N, h, w, 3) levels. background: (h, w, 3) levels. signal: (N,) levels.
        markers: Centres in picture widths, (N, K, 2); NaN where unknown.
    Returns:
        Shape (N, len(NAMES)).
    """
    rows, columns = background.shape[:2]
    x, y = np.meshgrid(np.arange(columns) / columns, np.arange(rows) / columns)
    found = np.zeros((len(pictures), len(NAMES)), np.float32)
    found[:, 0] = signal
    for number, picture in enumerate(pictures):
        change = np.abs(picture - background).max(axis=-1)
        touched = change > AREA_LEVELS
        found[number, 1] = touched.mean()
        if touched.any():
            down, across = np.gradient(change)
            found[number, 2] = np.hypot(down, across)[touched].mean()
            weight = np.where(touched, change, 0.0)
            weight /= weight.sum()
            centre_x, centre_y = (weight * x).sum(), (weight * y).sum()
            found[number, 3] = np.sqrt((weight * ((x - centre_x) ** 2 + (y - centre_y) ** 2)).sum())
    if markers.shape[1]:
        found[:, 4:] = [_marker_motion(markers[0], now) for now in markers]
    return found


def _marker_motion(before: NDArray[np.floating], now: NDArray[np.floating]) -> tuple[float, float]:
    seen = np.isfinite(before).all(axis=1) & np.isfinite(now).all(axis=1)
    if seen.sum() < 2:
        return 0.0, 0.0
    motion = now[seen] - before[seen]
    motion = motion - motion.mean(axis=0)  # the whole pattern may slide
    place = before[seen] - before[seen].mean(axis=0)
    return float(np.hypot(*motion.T).mean()), float((motion * place).sum() / (place**2).sum())
