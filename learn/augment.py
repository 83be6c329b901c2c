"""Image-time randomisation of one press: what another sensor of the same kind, another camera or another hand would have changed. NumPy.

Everything is drawn from one generator and applied to the whole press alike, but for noise, which is drawn for each picture. Pictures are in
levels of 255. Left out, because they are drawn where the dataset is made: lights, coating, markers, gel, tilt, shear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learn.config import AugmentConfig, InputConfig
from learn.frames import equal_steps, loading

Levels = NDArray[np.float32]


@dataclass(frozen=True)
class Noise:
    """Of a camera, already averaged to the network's pictures."""

    flat: float = 0.0
    """Standard deviation at every level [levels]."""
    shot: float = 0.0
    """Variance per level, of photons [levels]."""

    def draw(self, pictures: Levels, rng: np.random.Generator, more: float = 0.0) -> Levels:
        """Pictures with noise, and `more` [levels] of it."""
        variance = self.flat**2 + more**2 + self.shot * np.maximum(pictures, 0)
        if not np.any(variance):
            return pictures
        return pictures + np.sqrt(variance, dtype=np.float32) * rng.standard_normal(pictures.shape, dtype=np.float32)


def choose_randomly(
    signal: NDArray[np.floating], rng: np.random.Generator, inputs: InputConfig, config: AugmentConfig, repeat: bool
) -> NDArray:
    """Frames of a press with a random end point, thinned and with frames lost; empty when nothing touches."""
    among = loading(signal, inputs, float(rng.uniform(config.end_share, 1.0)))
    if len(among) == 0:
        return among
    stride = int(rng.integers(1, config.thin + 1))
    among = among[int(rng.integers(0, min(stride, len(among)))) :: stride]
    kept = rng.random(len(among)) >= config.drop
    kept[-1] = True  # a press without any frame is none
    return equal_steps(signal, among[kept], inputs.frames, repeat)


def randomise(background: Levels, pictures: Levels, rng: np.random.Generator, config: AugmentConfig, noise: Noise) -> tuple[Levels, Levels]:
    """A press as another sensor would have seen it.

    Args:
        background: (h, w, 3) levels. pictures: (T, h, w, 3) levels. noise: Of the sensor that took them.
    Returns:
        Background and pictures, of the same shapes.
    """
    stack = np.concatenate([background[None], pictures])
    if config.crop > 0:
        stack = _cropped(stack, rng, config.crop)
    if config.mirror:
        for axis in (1, 2):
            if rng.random() < 0.5:
                stack = np.flip(stack, axis)
    if config.swap_colours:
        stack = stack[..., rng.permutation(3)]
    exponent = 1 + rng.uniform(-config.gamma, config.gamma)
    gain = 1 + rng.uniform(-config.gain, config.gain, size=3)
    stack = 255 * gain.astype(np.float32) * np.power(np.clip(stack, 0, 255) / 255, np.float32(exponent))
    stack[1:] *= np.float32(1 + rng.uniform(-config.drift, config.drift))
    if config.blur_px > 0:
        stack = _blurred(stack, float(rng.uniform(0, config.blur_px)))
    stack = noise.draw(np.ascontiguousarray(stack, np.float32), rng, float(rng.uniform(0, config.noise_levels)))
    # A camera clips; averaging has happened before, so this is the clipping of the mean only.
    stack = np.clip(stack, 0, 255)
    return stack[0], stack[1:]


def _cropped(stack: Levels, rng: np.random.Generator, largest: float) -> Levels:
    rows, columns = stack.shape[1:3]
    share = 1 - rng.uniform(0, largest)
    tall, wide = max(2, round(rows * share)), max(2, round(columns * share))
    top, left = int(rng.integers(0, rows - tall + 1)), int(rng.integers(0, columns - wide + 1))
    for axis, first, size, count in ((1, top, tall, rows), (2, left, wide, columns)):
        # Linear between pixels: the picture is enlarged by little.
        place = first + np.clip((np.arange(count) + 0.5) * size / count - 0.5, 0, size - 1)
        low = np.minimum(place.astype(int), first + size - 2)
        share = (place - low).astype(np.float32).reshape([-1 if number == axis else 1 for number in range(4)])
        below, above = np.take(stack, low, axis), np.take(stack, low + 1, axis)
        stack = below + share * (above - below)
    return stack


def _blurred(stack: Levels, sd: float) -> Levels:
    reach = int(np.ceil(3 * sd))
    if reach == 0 or sd < 0.2:  # narrower than the pixels themselves
        return stack
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sd) ** 2)
    weights = (weights / weights.sum()).astype(np.float32)
    for axis in (1, 2):
        widths = [(0, 0)] * 4
        widths[axis] = (reach, reach)
        padded = np.pad(stack, widths, mode="edge")
        size = stack.shape[axis]
        parts = [weight * np.take(padded, range(shift, shift + size), axis=axis) for shift, weight in enumerate(weights)]
        stack = np.asarray(sum(parts), np.float32)
    return stack
