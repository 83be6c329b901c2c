"""Image-time randomisation: what another sensor of the same kind, another camera or another hand would have changed.

What is drawn for a press (`Looks`) is drawn in NumPy from a generator of its own, and applied in torch to a batch at once, on any device;
noise is drawn for each picture, by a generator of the press. Pictures are in levels of 255. Left out, because they are drawn where the
dataset is made: lights, coating, markers, gel, tilt, shear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from learn.config import AugmentConfig, InputConfig
from learn.frames import equal_steps, loading

LOOK = np.dtype([
    ("centre", np.float32, 2),   # of what is cut out, x and y [half picture widths and heights]
    ("size", np.float32, 2),     # of it [picture widths and heights]; below 0: mirrored
    ("colours", np.int64, 3),    # which colour each becomes
    ("exponent", np.float32),    # of the tone curve
    ("gain", np.float32, 3),
    ("drift", np.float32),       # gain of the press against the no-contact frame
    ("blur", np.float32),        # standard deviation [px]
    ("noise", np.float32),       # of noise on top of the camera's [levels]
    ("seed", np.int64),          # of the noise
    ("hide_gel", np.bool_),      # the network is not told the gel
])  # fmt: skip
"""What is drawn once for a press."""


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


def draw_look(rng: np.random.Generator, config: AugmentConfig) -> NDArray:
    """A LOOK; without `config.augment` one that changes nothing but draws the camera's noise. Shape ()."""
    look = np.zeros((), LOOK)
    look["size"], look["colours"], look["exponent"], look["gain"], look["drift"] = 1, (0, 1, 2), 1, 1, 1
    if config.augment:
        share = 1 - rng.uniform(0, config.crop)
        look["centre"] = rng.uniform(-1, 1, 2) * (1 - share)
        look["size"] = share * (rng.choice([-1, 1], 2) if config.mirror else 1)
        look["colours"] = rng.permutation(3) if config.swap_colours else range(3)
        look["exponent"] = 1 + rng.uniform(-config.gamma, config.gamma)
        look["gain"] = 1 + rng.uniform(-config.gain, config.gain, size=3)
        look["drift"] = 1 + rng.uniform(-config.drift, config.drift)
        look["blur"] = rng.uniform(0, config.blur_px)
        look["noise"] = rng.uniform(0, config.noise_levels)
    look["seed"] = rng.integers(2**62)
    look["hide_gel"] = config.augment and rng.random() < config.hide_gel
    return look


def randomise(stack: torch.Tensor, looks: NDArray, noises: Sequence[tuple[float, float]], config: AugmentConfig) -> torch.Tensor:
    """Presses as other sensors would have seen them.

    Args:
        stack: No-contact frame and pictures of each press [levels], shape (B, 1 + T, 3, h, w).
        looks: LOOK of each, shape (B,). noises: Of the cameras that took them, flat and shot of `recordings.Noise`.
    Returns:
        Of the same shape.
    """
    count, length = stack.shape[:2]

    def per_press(values: NDArray) -> torch.Tensor:
        tensor = torch.from_numpy(np.array(values, np.float32, order="C")).to(stack.device, non_blocking=True)
        return tensor.reshape(count, 1, *([1] if tensor.ndim == 1 else [tensor.shape[1]]), 1, 1)

    if config.augment:
        if config.crop > 0 or config.mirror:
            stack = _cut(stack, looks)
        if config.swap_colours:
            which = torch.from_numpy(looks["colours"].copy()).to(stack.device, non_blocking=True)
            stack = stack.gather(2, which.view(count, 1, 3, 1, 1).expand(count, length, 3, *stack.shape[3:]))
        gain = per_press(looks["gain"]).repeat(1, length, 1, 1, 1)
        gain[:, 1:] *= per_press(looks["drift"])
        stack = 255 * gain * (stack.clamp(0, 255) / 255) ** per_press(looks["exponent"])
        if config.blur_px > 0:
            stack = _blurred(stack, per_press(looks["blur"]), math.ceil(3 * config.blur_px))
    flat, shot = np.array(noises, np.float32).reshape(count, 2).T
    if flat.any() or shot.any() or looks["noise"].any():
        drawn = torch.empty_like(stack, memory_format=torch.contiguous_format)
        generator = torch.Generator(stack.device)
        for number, seed in enumerate(looks["seed"]):
            drawn[number].normal_(generator=generator.manual_seed(int(seed)))
        variance = per_press(flat**2 + looks["noise"] ** 2) + per_press(shot) * stack.clamp_min(0)
        stack = stack + drawn * variance.sqrt()
    # A camera clips; averaging has happened before, so this is the clipping of the mean only.
    return stack.clamp(0, 255) if config.augment else stack


def _cut(stack: torch.Tensor, looks: NDArray) -> torch.Tensor:
    """Cut out, mirrored, and enlarged to the picture's size again, linear between pixels."""
    count, length, colours, rows, columns = stack.shape
    affine = np.zeros((count, 2, 3), np.float32)
    affine[:, 0, 0], affine[:, 1, 1] = looks["size"].T
    affine[:, :, 2] = looks["centre"]
    boxes = torch.from_numpy(affine).to(stack.device, non_blocking=True)
    grid = functional.affine_grid(boxes, [count, 1, rows, columns], align_corners=False)
    flat = functional.grid_sample(
        stack.reshape(count, length * colours, rows, columns), grid, mode="bilinear", padding_mode="border", align_corners=False
    )
    return flat.view(stack.shape)


def _blurred(stack: torch.Tensor, sd: torch.Tensor, reach: int) -> torch.Tensor:
    """A Gaussian of each press's own width; below a fifth of a pixel it is narrower than the pixels themselves and nothing changes."""
    steps = torch.arange(-reach, reach + 1, device=stack.device)
    weights = torch.exp(-0.5 * (steps / sd.clamp_min(0.05)) ** 2)
    weights = torch.where(sd < 0.2, (steps == 0).to(weights.dtype), weights)
    weights = weights / weights.sum(dim=-1, keepdim=True)
    shape = stack.shape
    for axis in (-2, -1):
        widths = (0, 0, reach, reach) if axis == -2 else (reach, reach, 0, 0)
        padded = functional.pad(stack.flatten(1, 2), widths, mode="replicate").view(*shape[:3], *(
            size + 2 * reach if place == axis else size for place, size in ((-2, shape[-2]), (-1, shape[-1]))
        ))  # fmt: skip
        stack = sum(
            (weights[..., tap : tap + 1] * padded.narrow(axis, tap, shape[axis]) for tap in range(2 * reach + 1)),
            start=torch.zeros_like(stack),
        )
    return stack
