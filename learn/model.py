"""The two networks: from the pictures of a press to Shore 00. Everything about them is in this file.

PressNet (ours): each picture less the no-contact frame, and that frame itself -> residual CNN -> with what is known of the gel, LSTM -> at
every picture a mean m and a spread s. The estimate is that of the last picture, and the loss is taken there
(`every_step`: at every picture).
    L = -log N(y; m, s) s^(2β), the last factor held constant (Seitzer et al., ICLR 2022: "β-NLL", β = ½): the likelihood, but a press that
    is thought uncertain still teaches its mean. Where it is only known that a < y < b (of rigid ones
    y > HARDEST), L = -log P(a < y < b). Where only a class is known, a and b are cuts between classes, learnt too (McCullagh 1980).
PaperNet (Yuan et al., ICRA 2017): each picture less the first -> VGG16 up to fc7 (Simonyan and Zisserman 2015) -> LSTM -> affine, at every
picture; the estimate is the mean over the last three. Huber loss on each of these. It knows no spread.

Pictures come in levels of 255. Normalisation is by group, never over a batch: what a press gives does not depend on its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional

from learn.config import Config, LearnError, ModelConfig
from learn.data import Batch
from learn.features import AREA_LEVELS

CHANGE_LEVELS = 32.0
"""A strong intensity change [levels]: brings the network's input to about 1."""
FAINT_LEVELS = 0.05
"""A faint mean intensity change [levels]; presses of 0.05 to 9 N change it from this to a few levels."""
SPREADS = (0.5, 60.0)
"""Spreads that the network can say [Shore 00]: a durometer's own resolution, and twice that of knowing nothing (8 … 87 evenly: 23)."""
BETA = 0.5
BEYOND, LEAST = 1e4, 1e-6
"""Standard deviations that stand for infinitely many; and the least width of an interval in logarithms of its tails."""
HUBER_DELTA = 1.0
"""Where the Huber loss turns from square to straight [Shore 00]; the paper does not give it."""
SOFTPLUS_1 = 0.541325
"""What softplus takes to 1."""
SHAPES = 3
"""Numbers of `shape_of`."""
GEL, GEL_UNITS = (2.4, 1.0, 17.0), (0.2, 0.5, 5.0)
"""The gel from which `gel_input` counts (a `learn.data.Gel`), and what is 1 there [-, mm, Shore 00]."""
GELS = 4
"""Numbers of `gel_input`."""
PAPER_OUTPUTS = 3
"""The outputs that the paper averages."""


@dataclass(frozen=True, eq=False)
class Output:
    """What a network says at every picture; what stands at padded ones means nothing."""

    mean: torch.Tensor
    """Shore 00, shape (B, T)."""
    spread: torch.Tensor | None
    """Standard deviation [Shore 00], shape (B, T); None: the network knows none."""
    features: torch.Tensor
    """Of the last picture of each press, shape (B, F), the gel not told but in training: where novelty is measured."""


class Residual(nn.Module):
    """Two 3 × 3 convolutions around a shortcut, at half the resolution."""

    def __init__(self, inside: int, outside: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(inside, outside, 3, stride=2, padding=1, bias=False)
        self.first_norm = nn.GroupNorm(4, outside)
        self.second = nn.Conv2d(outside, outside, 3, padding=1, bias=False)
        self.second_norm = nn.GroupNorm(4, outside)
        self.shortcut = nn.Conv2d(inside, outside, 1, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = functional.silu(self.first_norm(self.first(x)))
        y = self.second_norm(self.second(y))
        return functional.silu(y + self.shortcut(functional.avg_pool2d(x, 2, ceil_mode=True)))


class PressNet(nn.Module):
    """See the head of the file."""

    centre: torch.Tensor
    scale: torch.Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        channels = 6 if config.show_background else 3
        self.stem = nn.Conv2d(channels, config.widths[0], 3, stride=2, padding=1, bias=False)
        self.stem_norm = nn.GroupNorm(4, config.widths[0])
        pairs = zip(config.widths, config.widths[1:], strict=False)
        self.stages = nn.Sequential(*(Residual(inside, outside) for inside, outside in pairs))
        extra = int(config.show_signal) + SHAPES * int(config.show_shape) + GELS * int(config.show_gel) + int(config.show_scale)
        self.embed = nn.Linear(2 * config.widths[-1] + extra, config.hidden)
        self.lstm = nn.LSTM(config.hidden, config.hidden, batch_first=True)
        self.head = nn.Linear(config.hidden, 2)
        # Mean and standard deviation of the hardness trained on; train.py sets them once.
        self.register_buffer("centre", torch.tensor(50.0))
        self.register_buffer("scale", torch.tensor(25.0))
        # The first cut, and how much further each next one is (through softplus), in units of `scale` from `centre`.
        self.cuts = nn.Parameter(torch.zeros(config.classes - 1)) if config.classes else None

    def class_bounds(self) -> torch.Tensor:
        """Between which Shore 00 each class lies, shape (classes, 2)."""
        assert self.cuts is not None
        first = self.cuts[:1] - (self.config.classes - 2) / 2
        inner = torch.cat([first, functional.softplus(self.cuts[1:] + SOFTPLUS_1)]).cumsum(0)
        ends = torch.full((1,), torch.inf, device=inner.device)
        cuts = torch.cat([-ends, self.centre + self.scale * inner, ends])
        return torch.stack([cuts[:-1], cuts[1:]], dim=1)

    def _bounds(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
        bounds = batch.bounds
        if self.cuts is not None:
            bounds = torch.where(batch.rank[:, None] >= 0, self.class_bounds()[batch.rank.clamp_min(0)], bounds)
        return bounds[:, 0], bounds[:, 1]

    def forward(self, batch: Batch) -> Output:
        count, steps = batch.signal.shape
        change = (batch.pictures - batch.background[:, None]) / CHANGE_LEVELS
        if self.config.show_background:
            empty = (batch.background[:, None].expand_as(change) - 128) / 64
            change = torch.cat([change, empty], dim=2)
        x = functional.silu(self.stem_norm(self.stem(change.flatten(0, 1))))
        x = self.stages(x).float()
        x = torch.cat([x.mean(dim=(2, 3)), x.amax(dim=(2, 3))], dim=1).view(count, steps, -1)
        if self.config.show_signal:
            x = torch.cat([x, torch.log1p(batch.signal / FAINT_LEVELS)[..., None]], dim=-1)
        if self.config.show_shape:
            x = torch.cat([x, shape_of(batch.pictures - batch.background[:, None])], dim=-1)
        hidden = self._remembered(x, batch.gel, batch.scaled)
        with torch.autocast(x.device.type, enabled=False):
            said = self.head(hidden)
            mean = self.centre + self.scale * said[..., 0]
            spread = (self.scale * functional.softplus(said[..., 1])).clamp(*SPREADS) if self.config.spread else None
        same = self.training or not self.config.show_gel
        blind = hidden if same else self._remembered(x, torch.full_like(batch.gel, torch.nan), batch.scaled)
        return Output(mean, spread, last_of(blind, batch.lengths))

    def _remembered(self, x: torch.Tensor, gel: torch.Tensor, scaled: torch.Tensor) -> torch.Tensor:
        """What the LSTM holds after each picture, shape (B, T, hidden), from x of what it sees."""
        steps = x.shape[1]
        if self.config.show_gel:
            x = torch.cat([x, gel_input(gel)[:, None].expand(-1, steps, -1)], dim=-1)
        if self.config.show_scale:
            x = torch.cat([x, scaled.to(x.dtype)[:, None, None].expand(-1, steps, 1)], dim=-1)
        with torch.autocast(x.device.type, enabled=False):
            hidden, _ = self.lstm(functional.silu(self.embed(x)))
        return hidden

    def estimate(self, output: Output, lengths: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Mean and spread of each press, shape (B,)."""
        spread = None if output.spread is None else last_of(output.spread, lengths)
        return last_of(output.mean, lengths), spread

    def loss(self, output: Output, batch: Batch) -> torch.Tensor:
        """Mean over presses of the mean over their pictures."""
        target = batch.target[:, None].expand_as(output.mean)
        known = ~torch.isnan(target)
        aim = torch.where(known, target, output.mean.detach())
        low, high = (bound[:, None].expand_as(output.mean) for bound in self._bounds(batch))
        spread = output.spread if output.spread is not None else self.scale.expand_as(output.mean)
        between = -log_between(low, high, output.mean, spread)
        if output.spread is None:
            each = functional.huber_loss(output.mean, aim, reduction="none", delta=HUBER_DELTA)
        else:
            each = 0.5 * ((aim - output.mean) / output.spread) ** 2 + torch.log(output.spread)
        each = torch.where(known, each, between)
        if output.spread is not None:
            each = each * output.spread.detach() ** (2 * BETA) / self.scale ** (2 * BETA)
        steps = torch.arange(each.shape[1], device=each.device)
        counted = steps < batch.lengths[:, None]
        if not self.config.every_step:
            counted = steps == batch.lengths[:, None] - 1
        return (torch.where(counted, each, torch.zeros_like(each)).sum(dim=1) / counted.sum(dim=1)).mean()


# Convolutions of VGG16 by block; a maximum over 2 × 2 follows each block.
VGG16_BLOCKS = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
VGG_SD = (0.229, 0.224, 0.225)
"""Standard deviation of ImageNet's colours by which torchvision's weights expect to be divided; the mean falls out of a difference."""


class PaperNet(nn.Module):
    """See the head of the file. Layers bear torchvision's names, so that its file of VGG16 weights fits."""

    centre: torch.Tensor
    scale: torch.Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        inside = 3
        for block in VGG16_BLOCKS:
            for outside in block:
                layers += [nn.Conv2d(inside, outside, 3, padding=1), nn.ReLU(inplace=True)]
                inside = outside
            layers.append(nn.MaxPool2d(2))
        self.features = nn.Sequential(*layers)
        dense = [
            nn.Linear(512 * 7 * 7, 4096),
            nn.ReLU(inplace=True),
            nn.Dropout(),
            nn.Linear(4096, 4096),
            nn.ReLU(inplace=True),
            nn.Dropout(),
        ]
        self.classifier = nn.Sequential(*dense)
        self.lstm = nn.LSTM(4096, config.hidden, batch_first=True)
        self.affine = nn.Linear(config.hidden, 1)
        # Without normalisation, torch's own initial weights shrink a picture by a factor of two or more a layer: after thirteen the
        # pictures of a press are all the same. He et al. 2015 (variance 2 / inputs) keeps its size, until ImageNet's weights are loaded.
        for layer in (*self.features, *self.classifier):
            if isinstance(layer, (nn.Conv2d, nn.Linear)):
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
                assert layer.bias is not None
                nn.init.zeros_(layer.bias)
        self.register_buffer("centre", torch.tensor(50.0))
        self.register_buffer("scale", torch.tensor(25.0))

    def forward(self, batch: Batch) -> Output:
        count, steps = batch.signal.shape
        sd = torch.tensor(VGG_SD, device=batch.pictures.device).view(3, 1, 1)
        change = (batch.pictures - batch.pictures[:, :1]) / (255 * sd)
        x = self.classifier(self.features(change.flatten(0, 1)).flatten(1)).float().view(count, steps, -1)
        with torch.autocast(x.device.type, enabled=False):
            hidden, _ = self.lstm(x)
            mean = self.centre + self.affine(hidden)[..., 0]
        return Output(mean, None, last_of(hidden, batch.lengths))

    def estimate(self, output: Output, lengths: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Mean of each press, shape (B,), and no spread."""
        counted = self._last(output.mean, lengths)
        return (output.mean * counted).sum(dim=1) / counted.sum(dim=1), None

    def loss(self, output: Output, batch: Batch) -> torch.Tensor:
        """Huber loss of the last three outputs; presses of unknown hardness (rigid ones) count nothing."""
        known = ~torch.isnan(batch.target)
        aim = torch.where(known, batch.target, torch.zeros_like(batch.target))[:, None].expand_as(output.mean)
        each = functional.huber_loss(output.mean, aim, reduction="none", delta=HUBER_DELTA)
        counted = self._last(output.mean, batch.lengths)
        return (torch.where(known, (each * counted).sum(dim=1) / counted.sum(dim=1), torch.zeros_like(batch.target))).mean()

    @staticmethod
    def _last(values: torch.Tensor, lengths: torch.Tensor) -> torch.Tensor:
        steps = torch.arange(values.shape[1], device=values.device)
        return ((steps < lengths[:, None]) & (steps >= lengths[:, None] - PAPER_OUTPUTS)).to(values.dtype)


Network = PressNet | PaperNet


def log_between(low: torch.Tensor, high: torch.Tensor, mean: torch.Tensor, spread: torch.Tensor) -> torch.Tensor:
    """log P(low < y < high) of normal y; 0 where neither bounds."""

    def ends(bound: torch.Tensor, beyond: float) -> torch.Tensor:
        finite = torch.isfinite(bound)
        return torch.where(finite, (torch.where(finite, bound, mean.detach()) - mean) / spread, torch.full_like(mean, beyond))

    below, above = ends(low, -BEYOND), ends(high, BEYOND)
    right = below > 0  # there the tails are taken from the other side, where they are small numbers
    one, other = torch.where(right, -above, below), torch.where(right, -below, above)
    larger = torch.special.log_ndtr(other)
    return larger + torch.log(-torch.expm1((torch.special.log_ndtr(one) - larger).clamp_max(-LEAST)))


def shape_of(change: torch.Tensor) -> torch.Tensor:
    """What `learn.features` says of the change of a picture, without markers: area, size and slope, each brought to about 1.

    Args:
        change: From the no-contact frame [levels], shape (B, T, 3, h, w).
    Returns:
        Shape (B, T, SHAPES).
    """
    most = change.abs().amax(dim=2)
    rows, columns = most.shape[-2:]
    touched = (most > AREA_LEVELS).to(most.dtype)
    count = touched.sum(dim=(-2, -1))
    x, y = (torch.arange(size, device=most.device) / columns for size in (columns, rows))
    weight = most * touched
    weight = weight / weight.sum(dim=(-2, -1), keepdim=True).clamp_min(1e-6)
    across, down = weight.sum(dim=-2), weight.sum(dim=-1)
    square = (across * x**2).sum(-1) - (across * x).sum(-1) ** 2 + (down * y**2).sum(-1) - (down * y).sum(-1) ** 2
    slopes = torch.stack(torch.gradient(most, dim=(-2, -1))).norm(dim=0)
    slope = (slopes * touched).sum(dim=(-2, -1)) / count.clamp_min(1)
    return torch.stack([(count / (rows * columns)).sqrt(), 4 * square.clamp_min(0).sqrt(), torch.log1p(slope) / 2], dim=-1)


def gel_input(gel: torch.Tensor) -> torch.Tensor:
    """What decides how far a gel gives way, each brought to about 1: log of its thickness, height of its dome, hardness (by 10 to 25 points
    the log of its modulus grows evenly to 8 %); and 1. All four are 0 of a gel that is not known.

    Args:
        gel: `learn.data.Gel` of each press, shape (B, 3).
    Returns:
        Shape (B, GELS).
    """
    known = torch.isfinite(gel).all(dim=-1, keepdim=True)
    thickness, edge, shore = gel.unbind(dim=-1)
    from_usual = (torch.log(thickness / GEL[0]), (thickness - edge) - (GEL[0] - GEL[1]), shore - GEL[2])
    told = torch.stack([number / unit for number, unit in zip(from_usual, GEL_UNITS, strict=True)], dim=-1)
    return torch.cat([torch.where(known, told, torch.zeros_like(told)), known.to(gel.dtype)], dim=-1)


def last_of(values: torch.Tensor, lengths: torch.Tensor) -> torch.Tensor:
    """values (B, T, …) at the last picture of each press, shape (B, …)."""
    return values[torch.arange(len(lengths), device=values.device), lengths - 1]


def build(config: Config) -> Network:
    """A network with random weights, drawn from torch's global generator."""
    return PaperNet(config.model) if config.model.model == "paper" else PressNet(config.model)


def compile_convolutions(network: Network) -> None:
    """In place: weights keep their names, and copies made before stay as they were."""
    (network.features if isinstance(network, PaperNet) else network.stages).compile()


def parameter_count(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


LARGEST_WEIGHTS = 2 * 2**30
"""Bytes of the largest file of weights that is read: VGG16 has 528 MiB."""


def load_vgg(network: PaperNet, path: Path) -> None:
    """Takes the convolutions and the first two dense layers from a file in torchvision's layout (its `vgg16-….pth`).

    Raises:
        LearnError: No such file, not of tensors alone, a layer missing or of another size.
    """
    weights = read_tensors(path, LARGEST_WEIGHTS)
    wanted = {name: tensor for name, tensor in network.state_dict().items() if name.startswith(("features.", "classifier."))}
    for name, tensor in wanted.items():
        found = weights.get(name)
        if not isinstance(found, torch.Tensor) or found.shape != tensor.shape:
            shape = tuple(found.shape) if isinstance(found, torch.Tensor) else "nothing"
            raise LearnError(f"--vgg-weights {path}: {name} should have shape {tuple(tensor.shape)}, the file has {shape}")
    network.load_state_dict({name: weights[name] for name in wanted}, strict=False)


def read_tensors(path: Path, largest: int) -> dict:
    """A file of tensors and plain types, by torch; nothing in it is run.

    Raises:
        LearnError: No such file, too large, or it holds anything else.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise LearnError(f"{path}: cannot be read ({error.strerror or error})") from None
    if size > largest:
        raise LearnError(f"{path}: has {size / 2**20:.0f} MiB; allowed are {largest / 2**20:.0f}")
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:  # a stranger's file: whatever its reader says, the answer is the same
        raise LearnError(f"{path}: is damaged, or holds more than tensors and plain values, and was not loaded") from None
    if not isinstance(found, dict):
        raise LearnError(f"{path}: expected a table of tensors, found {type(found).__name__}")
    return found
