"""From a recording to the pictures that a network sees: averaged to its size, and chosen by how much they changed. Plain NumPy.

The signal of a frame is its mean intensity change, a proxy for the force (Yuan et al., ICRA 2017, "Choosing input sequences"):

    s_t = mean over pixels and colours of max(|I_t − B| − deadband, 0)        [levels of 255]

B is the no-contact frame. Loading begins at the first frame with s over a threshold and ends at the largest s (the last such frame).
T frames are taken between at equal steps of s, so that neither speed nor frame rate matters. The paper names neither its threshold nor
a deadband: with 0 this is its rule; above, pixels that only carry noise do not count. Left out: anything that looks at where the change is.
In a video of several presses, or one that starts in contact, `find_press` finds rest and the beginning of the hardest press; where that
goes on to turn or slide, its end too: markers move on while means over cells as large as a marker's own field stand still.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from learn.config import InputConfig, LearnError

FIXED_POINT = 256
"""Averaged pictures are kept as uint16 in this fraction of a level: averaging many pixels resolves less than one level."""
PRESSED, LET_GO = 1 / 3, 0.1
"""Shares of the largest signal above which a frame is pressed, and below which it is free. Of real videos from rest the plainest frame has
0.08 or less of it in 95 %; one of 152, where light drifts and no contact shows, is taken for one that is let go."""

CELLS = (9, 12)
"""Over a picture; of 18.4 mm, 1.5 mm wide: markers that move within them change no mean."""
STEADY = 0.95
"""Share of the largest change of these means from which on a press presses no harder. That of single pixels grows at most as its square:
what was below STEADY² of its peak has grown by something else."""


@lru_cache(maxsize=32)
def _averaging(source: int, target: int) -> NDArray[np.float32]:
    """Exact area average of `source` pixels to `target` (linear between pixels where it enlarges), shape (target, source)."""
    edges = np.linspace(0, source, target + 1)
    if target > source:
        centres = np.clip((edges[:-1] + edges[1:]) / 2 - 0.5, 0, source - 1)
        weights = np.maximum(0, 1 - np.abs(centres[:, None] - np.arange(source)))
    else:
        pixel = np.arange(source)
        weights = np.clip(np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel), 0, None)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


def fit_picture(image: NDArray[np.uint8], picture: tuple[int, int]) -> NDArray[np.uint16]:
    """An image cut to the picture's proportions about its centre (an upright one turned by 90° first) and averaged to its size.

    Args:
        image: (H, W, 3), 8 bit. picture: rows and columns wanted.
    Returns:
        Levels times FIXED_POINT, shape (*picture, 3).
    """
    rows, columns = picture
    image = as_wide(image, picture)
    height, width = image.shape[:2]
    # The paper's network takes squares of pictures that are none: those are squeezed, not cut.
    if rows != columns:
        tall, wide = min(height, round(width * rows / columns)), min(width, round(height * columns / rows))
        top, left = (height - tall) // 2, (width - wide) // 2
        image = image[top : top + tall, left : left + wide]
    return averaged(image, picture)


def as_wide(image: NDArray, picture: tuple[int, int]) -> NDArray:
    """An image (H, W, 3), turned by 90° where it is upright and the picture of so many rows and columns is not."""
    rows, columns = picture
    return np.rot90(image) if (image.shape[0] > image.shape[1]) != (rows > columns) and rows != columns else image


def averaged(image: NDArray, size: tuple[int, int]) -> NDArray[np.uint16]:
    """An image (H, W, 3) averaged to so many rows and columns: levels times FIXED_POINT, shape (*size, 3)."""
    down, across = _averaging(image.shape[0], size[0]), _averaging(image.shape[1], size[1])
    first = np.tensordot(down, image.astype(np.float32), axes=(1, 0))
    return np.rint(np.einsum("cw,rwk->rck", across, first, optimize=True) * FIXED_POINT).astype(np.uint16)


def levels_of(stored: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Averaged pictures in levels of 255."""
    return (stored / np.float32(FIXED_POINT)).astype(np.float32, copy=False)


def averaged_pixels(shape: tuple[int, ...], picture: tuple[int, int]) -> float:
    """How many pixels of an image (H, W, …) go into one of the picture: independent noise falls by its root."""
    return max(1.0, shape[0] * shape[1] / (picture[0] * picture[1]))


def change_signal(pictures: NDArray[np.floating], background: NDArray[np.floating], deadband: float) -> NDArray[np.float64]:
    """s_t of pictures (N, h, w, 3) against the no-contact picture (h, w, 3), all in levels; shape (N,)."""
    return np.array([np.maximum(np.abs(picture - background) - deadband, 0).mean(dtype=np.float64) for picture in pictures])


def loading(signal: NDArray[np.floating], config: InputConfig, end_share: float = 1.0) -> NDArray[np.intp]:
    """The frames of the loading: from the first over the threshold to the first at `end_share` of the peak, at 1 the peak itself.

    Returns:
        Increasing indices; empty when nothing touches.
    """
    over = np.flatnonzero(signal > config.contact_levels)
    if len(over) == 0:
        return over
    peak = len(signal) - 1 - int(np.argmax(signal[::-1]))
    end = peak if end_share >= 1 else min(peak, int(np.argmax(signal >= end_share * signal[peak])))
    return np.arange(over[0], max(end, over[0]) + 1)


@dataclass(frozen=True, eq=False)
class Found:
    """Which of a video's frames is the gel untouched, and between which it is pressed."""

    rest: int
    begin: int
    end: int
    """The first that is no more read."""
    signal: NDArray[np.float64]
    """Of all frames, against the gel untouched."""
    note: str = ""
    """What was found other than a press from rest."""


def find_press(pictures: NDArray[np.floating], inputs: InputConfig, rest: NDArray[np.floating] | None = None) -> Found:
    """The press of a video whose frames (N, h, w, 3) [levels] may start in contact or show several presses; the hardest is taken.

    Args:
        rest: The gel untouched (h, w, 3), where it is known; else it is the first frame, or the plainest if the first is touched.
    Raises:
        LearnError: It starts in contact and is only let go.
    """
    signal, plainest, words = change_signal(pictures, pictures[0] if rest is None else rest, inputs.deadband_levels), 0, []
    if signal.max() <= inputs.contact_levels:
        return Found(0, 0, len(signal), signal)
    if rest is None:
        plain = int(np.argmin([structure(picture) for picture in pictures]))
        from_plain = change_signal(pictures, pictures[plain], inputs.deadband_levels)
        if from_plain[0] > PRESSED * from_plain.max():
            plainest, signal = plain, from_plain
            words.append(f"it starts in contact: frame {plain} was taken for the gel untouched (--background tells it)")
    free = np.flatnonzero(signal <= LET_GO * signal.max())
    first = int(free[0]) if len(free) and signal[0] > PRESSED * signal.max() else 0
    peak = len(signal) - 1 - int(np.argmax(signal[first:][::-1]))
    if signal[peak] <= LET_GO * signal.max() < signal[0]:
        raise LearnError("it starts in contact and is let go, and not pressed again; if it does not, --background names a frame untouched")
    low = np.flatnonzero(signal[:peak] <= LET_GO * signal[peak])
    before = np.flatnonzero(signal[: low[-1]] > PRESSED * signal[peak]) if len(low) else low
    begin, end = 0, len(signal)
    if len(before):
        begin = peak - 1 - int(np.argmin(signal[before[-1] : peak][::-1]))
        if not words:
            words.append(f"it shows several presses: the hardest was read, from frame {begin} on")
    dent, fine = dent_and_change(pictures[begin : peak + 1], pictures[plainest] if rest is None else rest)
    steady = int(np.argmax(dent >= STEADY * dent.max()))
    if fine[steady] < STEADY**2 * fine[-1]:
        end = begin + steady + 1
        words.append(f"from frame {end} on it is turned or slid, which was not read")
    return Found(plainest, begin, end, signal, "; ".join(words))


def dent_and_change(pictures: NDArray[np.floating], rest: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean size of what means over CELLS, and of what single pixels of pictures (N, h, w, 3) differ by from rest [levels], shape (2, N)."""
    down, across = (_averaging(size, cells) for size, cells in zip(rest.shape[:2], CELLS, strict=True))

    def both(change: NDArray[np.floating]) -> tuple[float, float]:
        coarse = np.einsum("rh,hwk,cw->rck", down, change, across, optimize=True)
        return float(np.abs(coarse).mean()), float(np.abs(change).mean())

    return np.array([both(picture - rest) for picture in pictures]).T


def structure(picture: NDArray[np.floating]) -> float:
    """How much a picture (h, w, 3) varies from pixel to pixel: the mean size of its gradient [levels a pixel]. What touches adds to it."""
    down, across = np.diff(picture, axis=0)[:, :-1], np.diff(picture, axis=1)[:-1]
    return float(np.sqrt(down**2 + across**2).mean(dtype=np.float64))


def equal_steps(signal: NDArray[np.floating], among: NDArray[np.intp], count: int, repeat: bool = False) -> NDArray[np.intp]:
    """`count` of the frames `among`, at equal steps of the signal from its first to its last, in order of time.

    Args:
        repeat: Always give `count` of them, the same frame more than once if need be; else each once.
    """
    targets = np.linspace(signal[among[0]], signal[among[-1]], count)
    # Signals may dip on the way up: the first frame that has reached a target is the one, which keeps the order.
    reached = np.maximum.accumulate(signal[among])
    after = np.clip(np.searchsorted(reached, targets), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(np.abs(reached[before] - targets) < np.abs(reached[after] - targets), before, after)
    nearer[-1] = len(among) - 1
    nearer = np.maximum.accumulate(nearer)
    return among[nearer if repeat else np.unique(nearer)]
