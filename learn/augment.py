"""Image-time randomisation: what another sensor of the same kind, another camera or another hand would have changed.

What is drawn for a press (`Looks`) is drawn in NumPy from a generator of its own, and applied in torch to a batch at once, on any device;
noise is drawn for each picture, by a generator of the press. Pictures are in levels of 255. A press whose scale is told is seen as
`learn.framing.to_scale` shows it, another as whole as it comes. Left out, because they are drawn where the dataset is made: where lamps
stand, coating, markers, gel, tilt, shear.
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
from learn.framing import FIELD_MM

SCALE_ERROR, CENTRE_ERROR = 0.03, 0.1
"""How well scale [relative] and contact's place [standard deviation, half widths] are known of pictures at the network's scale."""
WIDEST = 0.5
"""Of a border [half picture widths]."""
ROUND = 1 / 3
"""Of borders that have rounded corners, and of those that leave a disc."""
SMEARS, MOST_SPECKS, SPECK_PX = (3, 8), 30, (0.7, 3.0)
"""Of dirt: cells of smears across a picture, specks at most, and their radii [px of the network's pictures]."""
MOST_RELIEF, GRAINS, REACH, CHANGE = 40.0, (2, 8), 6, 20.0
"""Of textures: the largest standard deviation of what slopes do [levels], their finest and coarsest grain [px], and over how many pixels a
change of how many levels brings them out whole."""
BLOCKS = (3, 4, 5, 8)
"""Of codecs, 8 or 16 pixels of a camera's picture of which the network sees one in two or three."""
LATEST = 1 / 3
"""Of a press's frames, the last that may stand for the one without contact."""

LOOK = np.dtype([
    ("scaled", np.bool_),        # it shows FIELD_MM around the contact, beside which `centre` counts
    ("centre", np.float32, 2),   # of what is cut out, x and y [half picture widths and heights]
    ("size", np.float32, 2),     # of it [picture widths and heights]; below 0: mirrored
    ("turn", np.float32),        # of it [rad]
    ("colours", np.float32, (3, 3)),  # what each becomes of all three
    ("shade", np.float32, (3, 5)),    # exponents of each colour's gain for u, v, u^2, u v, v^2, -1 to 1 over what is seen
    ("border", np.float32, 4),   # of one colour, beyond these x and y, from left, top, right, bottom [half picture widths and heights]
    ("round", np.float32),       # radius of its corners [the shorter half of what it leaves]
    ("painted", np.float32, 3),  # that colour [levels]
    ("dirt", np.float32),        # contrast of what lies on lens or coat [share of the light]
    ("exponent", np.float32),    # of the tone curve
    ("gain", np.float32, 3),
    ("drift", np.float32),       # gain of the press against the no-contact frame
    ("blur", np.float32),        # standard deviation [px]
    ("noise", np.float32),       # of noise on top of the camera's [levels]
    ("relief", np.float32, (3, 2)),   # of a texture where it touches: what its slopes in x and y do to each colour [levels]
    ("grain", np.int64),         # of the texture [px]
    ("codec", np.float32),       # step of a codec [levels]
    ("block", np.int64),         # side of its blocks [px]
    ("seed", np.int64),          # of noise and texture
    ("hide_gel", np.bool_),      # the network is not told the gel
])  # fmt: skip
"""What is drawn once for a press."""


def choose_randomly(
    signal: NDArray[np.floating], rng: np.random.Generator, inputs: InputConfig, config: AugmentConfig, repeat: bool
) -> tuple[NDArray, int]:
    """Frames of a press with a random end point, thinned and with frames lost, empty when nothing touches; and which picture stands for the
    one without contact: 0 that itself, n the n-th frame."""
    among = loading(signal, inputs, float(rng.uniform(config.end_share, 1.0)))
    if len(among) == 0:
        return among, 0
    empty = 0
    if config.late and rng.random() < config.late:
        first = int(rng.uniform(0, LATEST) * len(among))
        empty, among = int(1 + among[first]), among[min(first + 1, len(among) - 1) :]
    stride = int(rng.integers(1, config.thin + 1))
    among = among[int(rng.integers(0, min(stride, len(among)))) :: stride]
    kept = rng.random(len(among)) >= config.drop
    kept[-1] = True  # a press without any frame is none
    return equal_steps(signal, among[kept], inputs.frames, repeat), empty


def draw_look(rng: np.random.Generator, config: AugmentConfig, shown_mm: float | None = None) -> NDArray:
    """A LOOK; without `config.augment` one that changes nothing but draws the camera's noise. Shape ().

    Args:
        shown_mm: Width of what the pictures show, where it is known and they are to be seen at the network's scale; None: whole.
    """
    look = np.zeros((), LOOK)
    look["size"], look["colours"], look["exponent"], look["gain"], look["drift"] = 1, np.eye(3), 1, 1, 1
    look["border"] = (-np.inf, -np.inf, np.inf, np.inf)
    hidden = config.augment and config.hide_scale > 0 and rng.random() < config.hide_scale
    if shown_mm is not None and not hidden:
        look["scaled"], look["size"] = True, FIELD_MM[0] / shown_mm
    if config.augment:
        bordered = config.border > 0 and rng.random() < config.border
        share = 1 - rng.uniform(0, config.crop)
        look["centre"] = rng.uniform(-1, 1, 2) * (1 - share)
        if look["scaled"]:
            # Where the contact is, and how large a pixel, nobody knows exactly.
            share = look["size"][0] * rng.uniform(1 - SCALE_ERROR, 1 + SCALE_ERROR)
            look["centre"] = rng.normal(0, CENTRE_ERROR, 2) * share
        elif bordered:
            share *= rng.uniform(1, 1 + WIDEST)
        look["size"] = share * (rng.choice([-1, 1], 2) if config.mirror else 1)
        look["turn"] = np.radians(rng.uniform(-config.turn_deg, config.turn_deg))
        if bordered:
            inner = 1 - rng.uniform(-WIDEST, WIDEST / 2, 4)
            look["border"], look["painted"] = inner * (-1, -1, 1, 1), rng.choice([0.0, 1.0]) * rng.uniform(0, 255, 3)
            kind = rng.random() / ROUND
            if kind < 1:
                look["round"] = rng.uniform(0.2, 1)
            elif kind < 2:
                half = rng.uniform(1 - WIDEST / 2, 1 + WIDEST / 2)
                look["border"], look["round"] = np.outer((-half, half), (FIELD_MM[1] / FIELD_MM[0], 1)).ravel(), 1
        look["colours"] = np.eye(3)[rng.permutation(3) if config.swap_colours else range(3)]
        if config.mix:
            look["colours"] += rng.uniform(0, config.mix) * (rng.dirichlet(np.ones(3), 3) - look["colours"])
        look["shade"] = rng.uniform(-config.shade, config.shade, (3, 5)) * (0.5, 0.5, 1, 0.5, 1)
        look["exponent"] = 1 + rng.uniform(-config.gamma, config.gamma)
        look["gain"] = 1 + rng.uniform(-config.gain, config.gain, size=3)
        look["drift"] = 1 + rng.uniform(-config.drift, config.drift)
        look["blur"] = rng.uniform(0, config.blur_px)
        look["noise"] = rng.uniform(0, config.noise_levels)
        if rng.random() < config.texture:
            look["relief"] = rng.normal(0, rng.uniform(0, MOST_RELIEF), (3, 2))
        look["grain"] = rng.integers(GRAINS[0], GRAINS[1] + 1)
        if config.dirt:
            look["dirt"] = rng.uniform(0, config.dirt)
        look["codec"], look["block"] = rng.uniform(0, config.codec_levels), rng.choice(BLOCKS)
    look["seed"] = rng.integers(2**62)
    look["hide_gel"] = config.augment and rng.random() < config.hide_gel
    return look


def randomise(
    stack: torch.Tensor, looks: NDArray, noises: Sequence[tuple[float, float]], config: AugmentConfig, deadband: float = 0.0
) -> torch.Tensor:
    """Presses as other sensors would have seen them.

    Args:
        stack: No-contact frame and pictures of each press [levels], shape (B, 1 + T, 3, h, w).
        looks: LOOK of each, shape (B,). noises: Of the cameras that took them, flat and shot of `recordings.Noise`.
        deadband: Changes below it do not say where the contact is [levels].
    Returns:
        Of the same shape.
    """
    count, length = stack.shape[:2]

    def per_press(values: NDArray) -> torch.Tensor:
        tensor = torch.from_numpy(np.array(values, np.float32, order="C")).to(stack.device, non_blocking=True)
        return tensor.reshape(count, 1, *([1] if tensor.ndim == 1 else [tensor.shape[1]]), 1, 1)

    outside = None
    if looks["scaled"].any() or (config.augment and (config.crop > 0 or config.mirror or config.turn_deg > 0)):
        stack, outside = _cut(stack, looks, deadband)
    if config.augment:
        if config.texture > 0:
            stack = _textured(stack, looks)
        if config.dirt > 0:
            stack = stack * _dirt(looks, stack)
        if config.swap_colours or config.mix > 0:
            colours = torch.from_numpy(looks["colours"].copy()).to(stack.device, non_blocking=True)
            stack = torch.einsum("bij,btjhw->btihw", colours, stack)
        gain = per_press(looks["gain"]).repeat(1, length, 1, 1, 1)
        gain[:, 1:] *= per_press(looks["drift"])
        if config.shade > 0:
            gain = gain * _shading(looks["shade"], stack)
        stack = 255 * gain * (stack.clamp(0, 255) / 255) ** per_press(looks["exponent"])
        if config.blur_px > 0:
            stack = _blurred(stack, per_press(looks["blur"]), math.ceil(3 * config.blur_px))
        if outside is not None and config.border > 0:
            stack = torch.where(outside[:, None, None], per_press(looks["painted"]), stack)
    flat, shot = np.array(noises, np.float32).reshape(count, 2).T
    if flat.any() or shot.any() or looks["noise"].any():
        drawn = torch.empty_like(stack, memory_format=torch.contiguous_format)
        generator = torch.Generator(stack.device)
        for number, seed in enumerate(looks["seed"]):
            drawn[number].normal_(generator=generator.manual_seed(int(seed)))
        variance = per_press(flat**2 + looks["noise"] ** 2) + per_press(shot) * stack.clamp_min(0)
        stack = stack + drawn * variance.sqrt()
    if config.augment and config.codec_levels > 0:
        for block in np.unique(looks["block"][looks["codec"] > 0]):
            mine = torch.from_numpy(np.flatnonzero(looks["block"] == block)).to(stack.device, non_blocking=True)
            stack = stack.index_copy(0, mine, _coded(stack[mine], per_press(looks["codec"])[mine], int(block)))
    # A camera clips; averaging has happened before, so this is the clipping of the mean only.
    return stack.clamp(0, 255) if config.augment else stack


def _cut(stack: torch.Tensor, looks: NDArray, deadband: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Cut out, turned, mirrored, and enlarged to the picture's size again, linear between pixels; and where its border is, (B, h, w)."""
    count, length, colours, rows, columns = stack.shape
    aspect = rows / columns
    (across, down), turn = looks["size"].T, looks["turn"]
    affine = np.zeros((count, 2, 3), np.float32)
    affine[:, 0, 0], affine[:, 0, 1] = across * np.cos(turn), -down * np.sin(turn) * aspect
    affine[:, 1, 0], affine[:, 1, 1] = across * np.sin(turn) / aspect, down * np.cos(turn)
    affine[:, :, 2] = looks["centre"]
    boxes = torch.from_numpy(affine).to(stack.device, non_blocking=True)
    if looks["scaled"].any():
        scaled = torch.from_numpy(looks["scaled"].copy()).to(stack.device, non_blocking=True)
        size = torch.from_numpy(np.abs(looks["size"])).to(stack.device, non_blocking=True)
        # As `learn.framing.at_scale`: within the picture where that is the larger, the picture in the middle where it is the smaller.
        slack = (1 - size).clamp_min(0)
        about = (boxes[:, :, 2] + _contact(stack, deadband)).clamp(-slack, slack)
        boxes[:, :, 2] = torch.where(scaled[:, None], about, boxes[:, :, 2])
    grid = functional.affine_grid(boxes, [count, 1, rows, columns], align_corners=False)
    flat = functional.grid_sample(
        stack.reshape(count, length * colours, rows, columns), grid, mode="bilinear", padding_mode="border", align_corners=False
    )
    # Half pictures to pixels; what is infinite is far away.
    pixels = torch.tensor([columns, rows], device=stack.device) / 2
    border, corner = (torch.from_numpy(looks[name].copy()).to(stack.device, non_blocking=True) for name in ("border", "round"))
    low, high = (border.clamp(-9, 9).view(count, 1, 1, 2, 2) * pixels).unbind(dim=-2)
    radius = corner[:, None, None, None] * (high - low).amin(dim=-1, keepdim=True) / 2
    beyond = ((grid * pixels - (low + high) / 2).abs() - (high - low) / 2 + radius).clamp_min(0)
    return flat.view(stack.shape), beyond.norm(dim=-1) > radius[..., 0]


def _dirt(looks: NDArray, stack: torch.Tensor) -> torch.Tensor:
    """The share of the light that smears and specks of each press let through, the same in all its pictures, (B, 1, 1, h, w)."""
    rows, columns = stack.shape[-2:]
    down, across = (torch.arange(size, device=stack.device) + 0.5 for size in (rows, columns))
    generator, passed = torch.Generator(stack.device), []
    for contrast, seed in looks[["dirt", "seed"]]:
        generator.manual_seed(int(seed) ^ 2)

        def uniform(count: int, low: float, high: float, generator: torch.Generator = generator) -> torch.Tensor:
            return low + (high - low) * torch.rand(count, generator=generator, device=stack.device)

        cells = int(uniform(1, *SMEARS))
        coarse = torch.empty((1, 1, cells, cells), device=stack.device).normal_(generator=generator)
        smear = functional.interpolate(coarse, (rows, columns), mode="bicubic")[0, 0].sigmoid()
        count = int(uniform(1, 0, MOST_SPECKS + 1))
        x, y, radius = uniform(count, 0, columns), uniform(count, 0, rows), uniform(count, *SPECK_PX)
        specks = torch.einsum("ky,kx->yx", *(
            torch.exp(-0.5 * ((along - place[:, None]) / radius[:, None]) ** 2) for along, place in ((down, y), (across, x))
        )).clamp(0, 1)  # fmt: skip
        passed.append((1 - float(contrast) * smear) * (1 - 2 * float(contrast) * specks).clamp_min(0))
    return torch.stack(passed)[:, None, None]


def _textured(stack: torch.Tensor, looks: NDArray) -> torch.Tensor:
    """With a relief, shaded by its slopes, as strong as what is below it has changed."""
    rows, columns = stack.shape[-2:]
    relief = torch.from_numpy(looks["relief"].copy()).to(stack.device, non_blocking=True)
    generator = torch.Generator(stack.device)
    heights = []
    for grain, seed in looks[["grain", "seed"]]:
        coarse = torch.empty((1, 1, *(max(side // int(grain), 2) for side in (rows, columns))), device=stack.device)
        coarse.normal_(generator=generator.manual_seed(int(seed) ^ 1))
        heights.append(functional.interpolate(coarse, (rows, columns), mode="bicubic")[0, 0])
    slopes = torch.stack(torch.gradient(torch.stack(heights), dim=(-1, -2)), dim=1)
    change = (stack - stack[:, :1]).abs().mean(dim=2)
    touched = functional.avg_pool2d(change, 2 * REACH + 1, 1, REACH, count_include_pad=False).div(CHANGE).clamp(0, 1)
    return stack + torch.einsum("bcs,bshw->bchw", relief, slopes)[:, None] * touched[:, :, None]


def _coded(stack: torch.Tensor, step: torch.Tensor, block: int) -> torch.Tensor:
    """Pictures (B, T, 3, h, w) whose blocks' cosine waves are whole multiples of a step, as JPEG and the codecs of videos leave them; finer
    waves of larger ones: twice the step at a wave of half the block's pixels."""
    rows, columns = stack.shape[-2:]
    wave = torch.arange(block, device=stack.device)
    cosines = torch.cos(math.pi / block * (wave[:, None] * (wave + 0.5))) * math.sqrt(2 / block)
    cosines[0] /= math.sqrt(2)
    padded = functional.pad(stack.flatten(1, 2), (0, -columns % block, 0, -rows % block), mode="replicate")
    tiles = padded.unfold(-2, block, block).unfold(-2, block, block)
    waves = cosines @ tiles @ cosines.T
    steps = step[..., None] * (1 + (wave[:, None] + wave) / block)
    waves = torch.where(steps > 1e-3, (waves / steps.clamp_min(1e-3)).round() * steps, waves)
    flat = (cosines.T @ waves @ cosines).movedim(-2, -3).reshape(padded.shape)
    return flat[..., :rows, :columns].reshape(stack.shape)


def _contact(stack: torch.Tensor, deadband: float) -> torch.Tensor:
    """Where the last pictures have changed most, x and y [half picture widths and heights] (B, 2), as `learn.framing.contact_centre`."""
    change = ((stack[:, -1] - stack[:, 0]).abs() - deadband).clamp_min(0).sum(dim=1)
    whole = change.sum(dim=(1, 2)).clamp_min(1e-6)
    places = (torch.linspace(-1 + 1 / size, 1 - 1 / size, size, device=stack.device) for size in change.shape[:0:-1])
    return torch.stack([(change.sum(dim=axis) * place).sum(dim=1) / whole for axis, place in zip((1, 2), places, strict=True)], dim=1)


def _shading(exponents: NDArray, stack: torch.Tensor) -> torch.Tensor:
    """A smooth gain over pictures (B, T, 3, h, w): exp of a polynomial of each press and colour, shape (B, 1, 3, h, w)."""
    v, u = (torch.linspace(-1, 1, size, device=stack.device) for size in stack.shape[-2:])
    v, u = torch.meshgrid(v, u, indexing="ij")
    terms = torch.stack([u, v, u * u, u * v, v * v])
    exponents_of = torch.from_numpy(exponents.copy()).to(stack.device, non_blocking=True)
    return torch.einsum("bck,khw->bchw", exponents_of, terms).exp()[:, None]


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
