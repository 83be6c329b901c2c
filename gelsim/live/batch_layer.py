"""The baked gel of `gelsim.live.layer` for many sensors at once, in PyTorch: the same equations, each sensor with a thickness of its own.

All is on the whole grid, where waves are exponentials and an FFT's product is exact, as the layer is periodic with the gel's size. Pressure
and shear are found as there. Each sensor stops where it is good enough, so what it answers hangs on no other one.

What soft objects facing the gels do comes in by `Ways`: faces that look at each other add their answers, and springs beside them know of
tractions nine sums alone, of each part that itself, times x and times y.

Shapes: n sensors, (n, rows, columns), vectors (n, 2 or 3, rows, columns). Units as there: mm, kPa, single precision.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
import warp as wp
from scipy import fft
from torch import Tensor

from gelsim.live import layer as single
from gelsim.live import residual
from gelsim.live.batch_kernels import bent, bent_stress, carried_along, dragged_waves, lifted_waves, moved_waves, press_on, shear_on
from gelsim.live.layer import TINY, Layer
from gelsim.live.residual import Kernel, Residual
from gelsim.live.soft import modes

CHECKED = 4
"""Steps of a gradient method between looks whether all sensors are done: to look is to wait for the GPU."""
BLOCK = 256
"""Threads that share a sensor's sums."""


def inner(one: Tensor, other: Tensor) -> Tensor:
    """Sum of products over all but the first axis, (n, 1, 1)."""
    return torch.bmm(one.flatten(1)[:, None], other.flatten(1)[:, :, None])


def launch(kernel: Any, size: tuple[int, ...], *inputs: Any, block: int = 0) -> None:
    """A kernel on PyTorch's stream, of tensors (complex ones as pairs) and numbers; with a block of threads for each of a size."""
    given = []
    for field in inputs:
        if isinstance(field, Tensor):
            whole = torch.view_as_real(field) if field.is_complex() else field
            kind = wp.vec2f if field.is_complex() else wp.float32
            device = field.device
            given.append(wp.from_torch(whole, dtype=kind, requires_grad=False, return_ctype=True))
        else:
            given.append(field)
    on = {"device": str(device), "stream": stream(device)}
    if block:
        wp.launch_tiled(kernel, dim=list(size), inputs=given, block_dim=block, **on)
    else:
        wp.launch(kernel, size, given, **on)


def stream(device: torch.device) -> wp.Stream | None:
    """PyTorch's stream of the moment, for Warp."""
    return _stream(str(device), torch.cuda.current_stream(device).cuda_stream) if device.type == "cuda" else None


@lru_cache(maxsize=8)
def _stream(device: str, handle: int) -> wp.Stream:
    """Made once: each time anew a step of 64 sensors took 125 ms for 45."""
    return wp.Stream(device, cuda_stream=handle)


def norm(values: Tensor) -> Tensor:
    return inner(values, values).sqrt()


ALL, ALONG, UP = slice(0, 9), slice(0, 6), slice(6, 9)
"""Of the nine sums of three parts."""


class Answers:
    """Of layers of one material to waves over a grid; between the nodes of thickness straight."""

    def __init__(self, layer: Layer, thinnest: float, thickest: float, device: str, facing: tuple[int, int] | None = None) -> None:
        """For thicknesses [mm] in between.

        Args:
            facing: Rows and columns of a gel that they look at from above; without, they are of gels.
        """
        first, last = (math.log(limit) / math.log1p(single.NODES) for limit in (thinnest, thickest))
        self._first, last = math.floor(first), math.floor(last) + 1
        nodes = [layer.spectrum(node) for node in range(self._first, last + 1)]
        if facing is not None:
            nodes = [single.within(fft.irfft2(node, layer.shape), facing) for node in nodes]  # type: ignore[arg-type]
        real = [np.concatenate([node[:4].real, -node[4:].imag]) for node in nodes]
        self._nodes = torch.as_tensor(np.stack(real), device=device)
        if facing is not None:
            self._nodes[:, 4:] *= -1

    def at(self, thickness: Tensor) -> Tensor:
        """Of thicknesses (n,) [mm], (n, 6, rows, columns / 2 + 1): u_z by p, u_x by q_x, u_y by q_y, u_x by q_y; and of u_x and u_y by p
        the imaginary part, which is also that of u_z by q_x and q_y."""
        place = thickness.log() / math.log1p(single.NODES) - self._first
        node = place.floor().clamp(0, len(self._nodes) - 2)
        share = (place - node)[:, None, None, None].float()
        return torch.lerp(self._nodes[node.long()], self._nodes[node.long() + 1], share)


@dataclass(frozen=True, eq=False)
class Ways:
    """What tractions do to the faces of layers; or how far they move these from those of soft objects."""

    answers: Tensor
    """As of `Answers.at`."""
    springs: Tensor | None = None
    """What the nine sums of q_x, q_y and p make of u_x, u_y and u_z, which are 1, x and y as often, (n, 9, 9)."""


class Layers:
    """What tractions do to the faces of many layers of one size and material."""

    def __init__(self, layer: Layer, thinnest: float, thickest: float, device: str) -> None:
        """For thicknesses [mm] in between."""
        self._answers = Answers(layer, thinnest, thickest, device)
        self.layer, self.shape, self.device = layer, layer.shape, device
        self.x, self.y = (torch.as_tensor(way, dtype=torch.float32, device=device) for way in np.meshgrid(layer.x, layer.y))
        self.arms = torch.stack([torch.ones_like(self.x), self.x, self.y]).flatten(1).T
        """1, x and y of the cells (cells, 3)."""
        self.modulus = layer.material.shear_kpa
        self._cell = wp.vec2f(*layer.cell)
        by_y, by_x = np.fft.fftfreq(layer.shape[0], layer.cell[1])[:, None], np.fft.rfftfreq(layer.shape[1], layer.cell[0])
        self._squared = torch.as_tensor((2 * np.pi) ** 2 * (by_x**2 + by_y**2), dtype=torch.float32, device=device)

    def ways(self, thickness: Tensor) -> Ways:
        """Of layers so thick (n,) [mm]."""
        return Ways(self._answers.at(thickness))

    def stiffness(self, thickness: Tensor) -> Tensor:
        """Of the softest wave, along the face [kPa/mm], (n, 1, 1)."""
        return (self.modulus / thickness)[:, None, None].float()

    def moved(self, ways: Ways, pressure: Tensor, shear: Tensor) -> Tensor:
        """Displacement u of all tractions together [mm], (n, 3, rows, columns)."""
        return self._product(moved_waves, ways, torch.cat([shear, pressure[:, None]], dim=1), ALL, ALL)

    def sunk(self, ways: Ways, pressure: Tensor) -> Tensor:
        """How deep a pressure alone presses the face [mm]."""
        found = torch.fft.irfft2(ways.answers[:, 0] * torch.fft.rfft2(pressure), s=self.shape)
        return found if ways.springs is None else found - self._sprung(ways.springs[:, UP, UP], pressure[:, None])[:, 0]

    def dragged(self, ways: Ways, shear: Tensor) -> Tensor:
        """How far tangential tractions alone move the face along itself [mm]."""
        return self._product(dragged_waves, ways, shear, ALONG, ALONG)

    def lifted(self, ways: Ways, shear: Tensor) -> Tensor:
        """u_z of tangential tractions [mm]."""
        return self._product(lifted_waves, ways, shear, ALONG, UP)[:, 0]

    def _product(self, kernel: Any, ways: Ways, tractions: Tensor, of: slice, to: slice) -> Tensor:
        """Of tractions, parts of the three, to parts of the displacement."""
        waves = torch.fft.rfft2(tractions)
        found = torch.empty((len(waves), len(range(9)[to]) // 3, *waves.shape[2:]), dtype=waves.dtype, device=waves.device)
        each = [field.flatten(2) for field in (ways.answers, waves, found)]
        launch(kernel, each[-1].shape[::2], *each)
        moved = torch.fft.irfft2(found, s=self.shape)
        return moved if ways.springs is None else moved + self._sprung(ways.springs[:, to, of], tractions)

    def swung(self, springs: Tensor, tractions: Tensor) -> Tensor:
        """What springs make of tractions (n, parts, rows, columns): a displacement as 1, x and y of each part, (n, parts, 3)."""
        sums = tractions.flatten(2) @ self.arms
        return (springs @ sums.flatten(1)[:, :, None]).view(len(springs), -1, 3)

    def _sprung(self, springs: Tensor, tractions: Tensor) -> Tensor:
        """The same over the grid [mm]."""
        return (self.swung(springs, tractions) @ self.arms.T).unflatten(2, self.shape)

    def springs(self, compliance: Tensor, apex: Tensor) -> Tensor:
        """`Ways.springs` of soft objects' compliances as of `layer.SoftBody`, (n, 6, 6), about places (n, 2) [mm]."""
        none, one = np.zeros(()), np.ones(())
        still = modes(none, none)
        by = np.stack([still, modes(one, none) - still, modes(none, one) - still], axis=-1)  # of 1, x and y
        ways = torch.as_tensor(by, device=self.device).expand(len(apex), -1, -1, -1).clone()
        ways[..., 0] -= (ways[..., 1:] @ apex[:, None, :, None])[..., 0]  # x and y are beside the apex
        ways = ways.flatten(2)
        found = float(np.prod(self.layer.cell)) * (ways.transpose(1, 2) @ compliance @ ways)
        found[:, :, UP] *= -1  # pressure is down
        return found.float()

    def slope(self, values: Tensor) -> Tensor:
        """Of values (..., rows, columns) along x and y, (2, ..., rows, columns); at the rim half of it."""
        found = torch.zeros((2, *values.shape), dtype=values.dtype, device=values.device)
        for change, axis, cell in zip(found, (-1, -2), self.layer.cell, strict=True):
            to, before, last = change.transpose(axis, -1), values.transpose(axis, -1), values.shape[axis] - 1
            torch.sub(before[..., 2:], before[..., :-2], out=to[..., 1:-1])
            to[..., 0], to[..., last] = before[..., 1] - before[..., 0], before[..., last] - before[..., last - 1]
            change *= 0.5 / cell
        return found

    def bending(self, pressure: Tensor, moved: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
        """As `layer.Window.bending`: tractions and motion of second order, (n, 2, rows, columns) each."""
        height = self.height(pressure, moved, rest)
        blur = torch.exp(-0.5 * self._squared * (-moved[:, 2].amin(dim=(1, 2), keepdim=True)).clamp(min=0.0) ** 2)
        blurred = torch.fft.irfft2(blur[:, None] * torch.fft.rfft2(moved[:, :2]), s=self.shape)
        stress, along, carried = (torch.empty((len(moved), parts, *self.shape), device=moved.device) for parts in (3, 2, 2))
        each, over = (len(moved), *self.shape), (pressure[:, None], height[:, None])
        launch(bent_stress, each, self._cell, self.modulus, blurred, *over, stress)
        launch(bent, each, self._cell, single.BENT, stress, *over, moved, along, carried)
        return along, carried

    def led(self, pressure: Tensor, moved: Tensor, rest: Tensor) -> Tensor:
        """As `layer.Window.led`, (n, rows, columns)."""
        total = pressure.sum(dim=(1, 2), keepdim=True).clamp(min=TINY)
        x, y = (way - (pressure * way).sum(dim=(1, 2), keepdim=True) / total for way in (self.x, self.y))
        apart = moved[:, :2] - (pressure[:, None] * moved[:, :2]).sum(dim=(2, 3), keepdim=True) / total[:, None]
        inertia = (pressure * (x**2 + y**2)).sum(dim=(1, 2), keepdim=True).clamp(min=1e-9)
        turned = (pressure * (x * apart[:, 1] - y * apart[:, 0])).sum(dim=(1, 2), keepdim=True) / inertia
        apart = apart + torch.stack([turned * y, -turned * x], 1)
        still = self.slope(rest.expand_as(pressure)).transpose(0, 1)
        return -single.LED * (apart * self.slope(moved[:, 2]).transpose(0, 1) + moved[:, :2] * still).sum(dim=1)

    def height(self, pressure: Tensor, moved: Tensor, rest: Tensor) -> Tensor:
        """Of the face over where the pressure's centre was at rest [mm]."""
        total = pressure.sum(dim=(1, 2), keepdim=True).clamp(min=TINY)
        return moved[:, 2] + (rest - (pressure * rest).sum(dim=(1, 2), keepdim=True) / total)

    def work_and_less(self, thickness: Tensor, pressure: Tensor) -> tuple[Tensor, Tensor]:
        """As `layer.work_and_less`, (n, 1, 1) each."""
        work, thinner = (inner(pressure, self.sunk(self.ways(h), pressure)) for h in (thickness, (1 - single.THINNER) * thickness))
        return work, (work - thinner) / (single.THINNER * thickness[:, None, None].float())

    def held_back(self, pressure: Tensor, spread: Tensor, dragged: Tensor) -> Tensor:
        """As `layer.held_back`, (n, 1, 1)."""
        total = pressure.sum(dim=(1, 2), keepdim=True).clamp(min=TINY)
        arms = torch.stack([pressure * (way - (pressure * way).sum(dim=(1, 2), keepdim=True) / total) for way in (self.x, self.y)], 1)
        out, back = inner(arms, spread), inner(arms, dragged)
        return torch.where(out > 0, (-back / out.clamp(min=TINY)).clamp(0.0, 1.0), 0.0)

    def carried_along(self, values: Tensor, drift: Tensor) -> Tensor:
        """As `layer.carried_along`, (n, 2, rows, columns)."""
        found = torch.empty_like(drift)
        launch(carried_along, (len(values), *self.shape), self._cell, values, drift, found)
        return found

    def pressed(self, ways: Ways, gap: Tensor, start: Tensor, softest: Tensor, deepest: Tensor) -> tuple[Tensor, Tensor]:
        """As `layer.pressure`: p ≥ 0 [kPa] with gap ≥ 0 and p gap = 0; and that gap.

        Args:
            gap: Under the first guess [mm].
            start: A first guess.
            deepest: Overlap (n, 1, 1) [mm].
        """
        p, gap = start.clone(memory_format=torch.contiguous_format), gap.contiguous()
        known = torch.cat([single.GAP_TOLERANCE * deepest, softest, softest.new_zeros((len(p), 1, 3))], dim=-1)
        self._descend(press_on, [], [p, gap, torch.zeros_like(p), known], torch.ones_like(softest), lambda move: self.sunk(ways, move))
        return p, gap

    def sheared(self, ways: Ways, slip: Tensor, bound: Tensor, start: Tensor, away: Tensor, softest: Tensor) -> tuple[Tensor, Tensor]:
        """As `layer.shear`: tangential tractions q, |q| ≤ bound [kPa], and the slip that is left [mm], (n, 2, rows, columns) each."""
        q, left = start.clone(memory_format=torch.contiguous_format), slip.clone(memory_format=torch.contiguous_format)
        allowed = single.SLIP_TOLERANCE * torch.minimum(softest * away, norm(bound))
        limits = torch.cat([allowed, softest], dim=-1)
        self._descend(shear_on, [limits, bound], [q, left], softest, lambda move: self.dragged(ways, move))
        return q, left

    @staticmethod
    def _descend(kernel: Any, given: list[Tensor], found: list[Tensor], step: Tensor, answer: Callable[[Tensor], Tensor]) -> None:
        """A place and the gradient there, to the least of what is allowed of a quadratic function.

        Args:
            kernel: A step of a gradient method, `batch_kernels.press_on` or `shear_on`.
            given: Its first fields.
            found: Place and gradient and what it remembers, whose memory has no gaps; moved on.
            step: Its last field, 0 of those that are done, (n, 1, 1).
            answer: What a change of place adds to the gradient.
        """
        step = step.clone()
        move = change = torch.empty_like(found[0])
        for turn in range(single.STEPS + 1):
            fields = [field.flatten(-2) for field in (*given, change, move, *found, step)]
            launch(kernel, step.shape[:1], turn, *fields, block=BLOCK)
            if turn % CHECKED == 0 and not bool(step.any()):
                break
            change = answer(move)

    def punch(self, ways: Ways, cells: Tensor, motion: Tensor) -> Tensor:
        """As `layer.punch` of a motion down (n, rows, columns) [mm]: a pressure on some cells [kPa]."""
        left = motion * cells
        traction, way, size = torch.zeros_like(left), left, inner(left, left)
        allowed = single.PUNCH_TOLERANCE**2 * size
        for turn in range(single.STEPS):
            going = size > allowed
            if turn % CHECKED == 0 and not bool(going.any()):
                break
            moved = self.sunk(ways, way) * cells
            step = going * size / inner(way, moved).clamp(min=TINY)
            traction, left = traction + step * way, left - step * moved
            before, size = size, inner(left, left)
            way = torch.where(going, left + size / before.clamp(min=TINY) * way, way)
        return traction


def bounded(q: Tensor, bound: Tensor) -> Tensor:
    """Tangential tractions (n, 2, rows, columns), cut to a length (n, 1, rows, columns)."""
    length = torch.hypot(q[:, 0], q[:, 1])[:, None]
    return q * (bound / length.clamp(min=TINY)).clamp(max=1.0)


class Residuals:
    """`gelsim.live.residual` of many gels of a kind."""

    def __init__(self, known: Residual, device: str) -> None:
        def there(values: Any) -> Any:
            return values if values is None else torch.as_tensor(values, device=device)

        self._known, self._ways = known, [tuple(map(there, ways)) for ways in (known.to, known.back)]
        self._kernels = [Kernel(there(kernel.weights), there(kernel.bias)) for kernel in residual.kernels()]
        self._cells = [torch.arange(count, device=device) for count in known.shape]

    def __call__(self, displacement: Tensor, pressure: Tensor, shear: Tensor) -> Tensor:
        """What the layers' displacements lack [mm], (n, 3, rows, columns)."""
        known, (to, back) = self._known, self._ways
        seen = torch.stack(residual.inputs(displacement.unbind(1), pressure, shear.unbind(1), known.thickness, known.shear_kpa), 1)
        seen = residual.resampled(seen, to)
        share: Any = 1.0
        for axis, cells in zip((2, 1), self._cells, strict=True):
            touched = (seen[:, 3] != 0).any(dim=axis).to(torch.uint8)
            first, last = touched.argmax(dim=1), len(cells) - 1 - touched.flip(1).argmax(dim=1)
            share = share * residual.fade(cells, first[:, None], last[:, None]).unsqueeze(axis)
        found = share[:, None] * residual.answer(seen, self._kernels, partial(torch.nn.functional.conv2d, padding=1))
        return residual.resampled(found, back) * known.thickness


def read(values: Tensor, layer: Layer, at: Tensor) -> Tensor:
    """Values of the grid (n, ..., rows, columns) at places (n, k, 2) [mm], (n, ..., k): as `layer.smooth_between`."""
    rows, columns = layer.shape
    shares, places = [], []
    for axis, (way, count) in enumerate(((layer.x, columns), (layer.y, rows))):
        place = ((at[..., axis] - float(way[0])) / layer.cell[axis]).clamp(0.0, count - 1.0)
        before = place.floor().clamp(max=count - 2.0)
        shares.append(single.keys(place - before))
        places.append([(before.long() + i).clamp(0, count - 1) for i in range(-1, 3)])
    flat = values.reshape(len(values), -1, rows * columns)
    found = torch.zeros((*flat.shape[:2], at.shape[1]), dtype=values.dtype, device=values.device)
    for row, down in zip(places[1], shares[1], strict=True):
        for column, right in zip(places[0], shares[0], strict=True):
            value = flat.gather(2, (row * columns + column)[:, None].expand(-1, flat.shape[1], -1))
            found += value * (down * right)[:, None].to(values.dtype)
    return found.reshape(*values.shape[:-2], at.shape[1])
