"""What a training is made of, as frozen dataclasses: saved with every run and every checkpoint, each field a flag of `gelsim-learn train`.

Fields and limits are checked as those of a scene are. No NumPy, no torch: the command line names every field at once.
"""

from __future__ import annotations

import dataclasses
import typing
from dataclasses import dataclass, field
from typing import Any

from gelsim.errors import GelsimError, SceneError
from gelsim.scene.fields import convert, field_types, nearest
from gelsim.scene.limits import check_limits

MODELS = ("press", "paper")
PRECISIONS = ("auto", "float32", "bfloat16")


class LearnError(GelsimError, ValueError):
    """A setting, a checkpoint or a video that cannot be used; one line says why and what is allowed."""


@dataclass(frozen=True)
class InputConfig:
    """How a press becomes the network's input."""

    picture: tuple[int, int] = (96, 128)
    """rows and columns of the pictures that the network sees"""
    frames: int = 8
    """pictures chosen of a press, equally spaced in intensity change"""
    deadband_levels: float = 3.0
    """intensity changes below this count as none [levels of 255]"""
    contact_levels: float = 0.05
    """mean intensity change above the deadband at which contact begins [levels]"""


@dataclass(frozen=True)
class ModelConfig:
    """The network."""

    model: str = "press"
    """press: ours; paper: VGG16 and LSTM of Yuan et al. 2017"""
    widths: tuple[int, ...] = (24, 48, 96, 160)
    """channels of the stages, each at half the resolution of the one before"""
    hidden: int = 128
    """units of the LSTM"""
    show_background: bool = True
    """ours: the no-contact frame is shown too (for an ablation)"""
    show_signal: bool = True
    """ours: each picture comes with its intensity change (for an ablation)"""
    show_shape: bool = True
    """ours: and with the area, size and slope of what changed (for an ablation)"""
    show_gel: bool = True
    """ours: it is told thickness, dome and hardness of the gel where they are known (for an ablation)"""
    show_scale: bool = True
    """ours: it is told whether it sees 18.4 mm around the contact, or a picture of unknown scale (for an ablation)"""
    classes: int = 0
    """ours: classes of hardness whose cuts it learns, 2 or more; 0: as many as the presses to train on tell of"""
    every_step: bool = False
    """ours: each picture of a press is trained as if it were the last, and not the last alone (for an ablation)"""
    spread: bool = True
    """ours: predicts a spread, trained by likelihood; off: Huber loss (for an ablation)"""


@dataclass(frozen=True)
class AugmentConfig:
    """Image-time randomisation, drawn anew each time a press is used."""

    augment: bool = True
    """off: presses are seen as they are, but for the noise of their camera"""
    end_share: float = 0.3
    """the earliest end point of a press, as a share of its largest intensity change; 1: always to the peak"""
    thin: int = 3
    """at most every how many-th frame of a recording is kept: speed and frame rate"""
    drop: float = 0.15
    """share of frames that are lost"""
    noise_levels: float = 1.5
    """largest standard deviation of noise on top of the camera's own, after averaging to the network's pictures [levels]"""
    gain: float = 0.25
    """largest relative change of each colour's gain"""
    gamma: float = 0.2
    """largest relative change of the tone curve's exponent"""
    drift: float = 0.01
    """largest relative change of exposure between the no-contact frame and the press"""
    blur_px: float = 0.7
    """largest standard deviation of blur [px of the network's pictures]"""
    crop: float = 0.15
    """largest share of the picture's width and height cut off"""
    mirror: bool = True
    """mirrors the sensor, its lights with it"""
    swap_colours: bool = True
    """gives the lights each other's colours"""
    hide_gel: float = 0.2
    """share of presses whose gel is not told: it is not always known"""
    hide_scale: float = 0.0
    """share of presses whose scale is not told: they are seen whole, not 18.4 mm around the contact"""
    turn_deg: float = 0.0
    """largest angle by which the sensor is turned"""
    mix: float = 0.0
    """largest share of each colour that is a random mixture of all three: lights of other colours, up to white"""
    shade: float = 0.0
    """largest exponent of a smooth gain over the picture at its sides: vignettes, lamps that glow"""
    border: float = 0.0
    """share of presses seen in a border of one colour, up to a quarter of the picture on each side, or in a round or rounded window"""
    dirt: float = 0.0
    """largest share of the light that smears on lens or coat take; specks take twice as much"""
    texture: float = 0.0
    """share of presses with a fine relief where they touch, as fabrics, skins and bristles have, whatever their hardness"""
    codec_levels: float = 0.0
    """largest step to which a video's codec rounds the waves of its blocks [levels]"""
    late: float = 0.0
    """share of presses whose first picture is not without contact, but up to a third of the way in"""


@dataclass(frozen=True)
class TrainConfig:
    """The optimisation."""

    steps: int = 10_000
    batch: int = 32
    """presses a step, over all devices"""
    rate: float = 1e-3
    """learning rate at its highest"""
    warmup: int = 200
    """ours: steps to the highest rate, from which it falls as a half cosine"""
    weight_decay: float = 0.02
    step_size: int = 1000
    """paper: steps after which the rate falls"""
    step_factor: float = 0.1
    """paper: the factor by which it falls (not given there; the usual one of its time)"""
    momentum: float = 0.9
    """paper: of SGD (not given there)"""
    clip: float = 1.0
    """largest norm of a gradient; 0: none"""
    seed: int = 0
    precision: str = "auto"
    """of the convolutions: auto is bfloat16 on CUDA, float32 on a CPU"""
    compile: bool = False
    """compiles the convolutions first (torch.compile: some 20 s, and a compiler): long trainings on a GPU are shorter by it"""
    average: float = 0.999
    """share of its past that the weights' running average keeps each step; 0: no average"""
    presses: int = 0
    """how many presses of --data to train on; 0: all"""
    workers: int = 0
    """processes that read presses; 0: this one alone"""
    validate_every: int = 500
    """steps between validations; a checkpoint is saved at each"""
    real_ratio: float = 0.5
    """share of real presses in a batch when --real is given"""
    real_presses: int = 0
    """how many real presses to train on; 0: all"""


@dataclass(frozen=True)
class Config:
    """Everything that decides what a run computes, but for the data."""

    input: InputConfig = field(default_factory=InputConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        _check(self)


# Fields that came later, and what a config that lacks them meant.
_ADDED: dict[str, dict[str, Any]] = {
    "model": {"show_gel": False, "show_scale": False, "classes": 0},
    "augment": {
        "hide_gel": 0.0,
        "hide_scale": 0.0,
        "turn_deg": 0.0,
        "mix": 0.0,
        "shade": 0.0,
        "border": 0.0,
        "dirt": 0.0,
        "texture": 0.0,
        "codec_levels": 0.0,
        "late": 0.0,
    },
    "train": {"compile": False},
}

# What a preset changes; flags beat it.
PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "mini": {
        "picture": (48, 64), "frames": 6, "widths": (16, 32, 64), "hidden": 64, "steps": 500, "batch": 16, "warmup": 30,
        "rate": 2e-3, "validate_every": 100,
    },
    "families": {
        "picture": (144, 192), "widths": (48, 96, 192, 320), "batch": 64, "rate": 1.5e-3, "warmup": 150, "end_share": 0.5, "drop": 0.1,
        "gamma": 0.25, "hide_gel": 0.4, "hide_scale": 0.4, "turn_deg": 15.0, "mix": 0.6, "shade": 0.5, "border": 0.3,
        "dirt": 0.2, "texture": 0.4, "codec_levels": 12.0, "late": 0.1,
        "show_background": False,
    },
    "paper": {
        "model": "paper", "picture": (224, 224), "frames": 5, "hidden": 256, "batch": 16, "average": 0.0,
        "weight_decay": 5e-4, "warmup": 0, "clip": 10.0, "thin": 1, "drop": 0.0, "noise_levels": 0.0, "gain": 0.0, "gamma": 0.0,
        "drift": 0.0, "blur_px": 0.0, "crop": 0.0, "mirror": False, "swap_colours": False,
    },
}  # fmt: skip


def sections() -> dict[str, type]:
    """Name of each section -> its dataclass."""
    hints = typing.get_type_hints(Config)
    return {item.name: hints[item.name] for item in dataclasses.fields(Config)}


def configure(preset: str = "default", **changes: Any) -> Config:
    """A preset with some fields changed; field names are unique over all sections.

    Raises:
        LearnError: An unknown preset or field, or a value out of range.
    """
    if preset not in PRESETS:
        raise LearnError(f"preset = {preset!r}: allowed are {', '.join(PRESETS)}")
    homes = {item.name: name for name, kind in sections().items() for item in dataclasses.fields(kind)}
    parts: dict[str, dict[str, Any]] = {name: {} for name in sections()}
    for key, value in (PRESETS[preset] | changes).items():
        if key not in homes:
            raise LearnError(f"unknown setting {key!r}{nearest(key, homes)}")
        parts[homes[key]][key] = value
    return Config(**{name: kind(**parts[name]) for name, kind in sections().items()})


def to_plain(config: Config) -> dict[str, Any]:
    """Nested dictionaries of numbers, text and lists."""
    return {
        name: {key: list(value) if isinstance(value, tuple) else value for key, value in part.items()}
        for name, part in dataclasses.asdict(config).items()
    }


def from_plain(plain: object) -> Config:
    """The inverse of `to_plain`; what it gets may come from a stranger's file.

    Raises:
        LearnError: Unknown or missing fields, wrong types, values out of range.
    """
    if not isinstance(plain, dict) or set(plain) != set(sections()):
        raise LearnError(f"config: expected the sections {', '.join(sections())}")
    parts = {}
    for name, kind in sections().items():
        known = {item.name for item in dataclasses.fields(kind)}
        stored = _ADDED.get(name, {}) | plain[name] if isinstance(plain[name], dict) else {}
        if set(stored) != known:
            raise LearnError(f"config: section {name!r} should hold {', '.join(sorted(known))}")
        parts[name] = kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in stored.items()})
    return Config(**parts)


_RANGES: dict[str, tuple[float, float]] = {
    "picture": (16, 1024), "frames": (2, 64), "deadband_levels": (0, 64), "contact_levels": (1e-3, 64), "widths": (4, 2048),
    "hidden": (4, 4096), "end_share": (0.05, 1), "thin": (1, 20), "drop": (0, 0.9), "noise_levels": (0, 64), "gain": (0, 0.9),
    "gamma": (0, 0.9), "drift": (0, 0.5), "blur_px": (0, 20), "hide_gel": (0, 1), "hide_scale": (0, 1),
    "turn_deg": (0, 180), "mix": (0, 1), "shade": (0, 3), "border": (0, 1), "dirt": (0, 0.5), "texture": (0, 1),
    "codec_levels": (0, 255), "late": (0, 1),
    "classes": (0, 20), "crop": (0, 0.8), "steps": (1, 10**8), "batch": (1, 10**5), "rate": (0, 10),
    "warmup": (0, 10**7), "weight_decay": (0, 10), "step_size": (1, 10**8), "step_factor": (0, 1), "momentum": (0, 0.9999),
    "clip": (0, 1e6), "seed": (0, 2**31), "workers": (0, 256), "validate_every": (1, 10**8), "real_ratio": (0, 1),
    "presses": (0, 10**8), "average": (0, 0.99999), "real_presses": (0, 10**8),
}  # fmt: skip
_CHOICES = {"model": MODELS, "precision": PRECISIONS}


def _check(config: Config) -> None:
    try:
        for part in (config.input, config.model, config.augment, config.train):
            for name, hint in field_types(type(part)).items():
                object.__setattr__(part, name, convert(getattr(part, name), hint, name))
            check_limits(part, choices=_CHOICES, limits=_RANGES)
    except SceneError as error:
        raise LearnError(str(error)) from None
    if config.model.classes == 1:
        raise LearnError("classes = 1: allowed are 0 and 2 or more")
    if not 1 <= len(config.model.widths) <= 8:
        raise LearnError(f"widths = {config.model.widths}: allowed are 1 … 8 of them")
    if config.model.model == "paper" and (config.input.picture != (224, 224) or config.input.frames < 3):
        raise LearnError(f"model = 'paper' takes pictures of 224 × 224 and three frames at least, not {config.input.picture}")
    shortest, stages = min(config.input.picture), len(config.model.widths)
    if shortest < 2 ** (stages + 1):
        raise LearnError(f"picture = {config.input.picture}: {stages} widths need {2 ** (stages + 1)} pixels at least")
