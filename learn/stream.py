"""An endless stream of randomised presses, batch by batch, made on the device that trains.

What a step sees is a function of (seed, step) alone, whatever the number of devices, so a training that goes on after an interruption sees
what it would have seen. Noise alone differs between a CPU and a GPU, whose generators are others. Nothing here waits for the GPU, which
is still at the step before while the next batch is drawn. Recordings lie in its memory where they take less than MOST_MEMORY of what is
free; else, and on a CPU, they are read where they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from gelsim.errors import DatasetError
from learn.augment import LOOK, choose_randomly, draw_look, randomise
from learn.config import Config, LearnError
from learn.data import Batch, Gel, Press, collate, gel_of, label_of
from learn.frames import FIXED_POINT, equal_steps, loading
from learn.framing import shown_mm, signal_to_scale
from learn.recordings import Archive

MOST_MEMORY = 0.5
"""Share of a GPU's free memory that recordings may take; the rest is the network's."""


class Stream:
    """Presses by position: each is a function of the seed and its position alone.

    Real presses (the second archive) come at their ratio, evenly; within an archive every press comes once before any comes again.
    """

    def __init__(self, archives: Sequence[Archive], config: Config, device: torch.device | str = "cpu") -> None:
        self._config, self._repeat = config, config.model.model == "paper"
        self._archives = archives
        self._touching = [[number for number in range(len(part)) if self._shows_contact(part, number)] for part in archives]
        if not all(self._touching):
            raise DatasetError("no press to train on shows any contact")
        self.presses = sum(map(len, self._touching))
        self.without_contact = sum(map(len, archives)) - self.presses
        self._orders: dict[int, tuple[int, NDArray]] = {}
        self._pictures = Pictures(archives, torch.device(device))

    def batch(self, positions: Sequence[int]) -> Batch:
        """The presses at these positions, each padded to the pictures that the network takes of one."""
        config, inputs = self._config, self._config.input
        looks = np.zeros(len(positions), LOOK)
        chosen = np.zeros((len(positions), 1 + inputs.frames), np.int64)
        members, lengths, labels, gels = [], [], [], []
        for slot, position in enumerate(positions):
            pool, number = self.member(position)
            part, rng = self._archives[pool], np.random.default_rng([config.train.seed, 2, position])
            row, signal, empty = part.rows[number], part.signals[number], 0
            field = row.get("field_mm")
            looks[slot] = draw_look(rng, config.augment, None if field is None else shown_mm(field, inputs.picture))
            if looks[slot]["scaled"]:
                signal = signal_to_scale(signal, field, inputs)
            if config.augment.augment:
                frames, empty = choose_randomly(signal, rng, inputs, config.augment, self._repeat)
            else:
                frames = equal_steps(signal, loading(signal, inputs), inputs.frames, self._repeat)
            members.append((pool, number))
            # The last one again where there are fewer: the contact is sought in the last.
            chosen[slot] = np.pad(1 + frames, (1, inputs.frames - len(frames)), mode="edge")
            chosen[slot, 0] = empty
            lengths.append(len(frames))
            labels.append(label_of(row))
            gels.append(gel_of(row.get("gel")))
        with torch.no_grad():
            noises = [(noise.flat, noise.shot) for noise in (self._archives[pool].noises[number] for pool, number in members)]
            stack = randomise(self._pictures.take(members, chosen), looks, noises, config.augment, inputs.deadband_levels)
            told = _hidden(torch.tensor(gels), looks), torch.from_numpy(looks["scaled"].copy())
            targets, bounds, ranks = zip(*labels, strict=True)
            known = torch.tensor(targets, dtype=torch.float32), torch.tensor(bounds, dtype=torch.float32), torch.tensor(ranks)
            return _batch(stack, torch.tensor(lengths), *known, *told, inputs.deadband_levels)

    def _shows_contact(self, part: Archive, number: int) -> bool:
        """Whether a press does, at the network's scale and seen whole."""
        inputs, signal = self._config.input, part.signals[number]
        scaled = signal_to_scale(signal, part.rows[number].get("field_mm"), inputs)
        return all(len(loading(seen, inputs)) > 0 for seen in (signal, scaled))

    def gels(self) -> list[Gel]:
        """The gel of each press, hidden from the network or not."""
        return [
            gel_of(part.rows[number].get("gel")) for part, members in zip(self._archives, self._touching, strict=True) for number in members
        ]

    def sensors(self, positions: Sequence[int]) -> list[str]:
        """Which sensor saw the press at each position."""
        return [self._archives[pool].rows[number]["sensor"] for pool, number in map(self.member, positions)]

    def member(self, position: int) -> tuple[int, int]:
        """Archive, and number in it, of the press at a position."""
        ratio = self._config.train.real_ratio if len(self._archives) == 2 else 0.0
        before, until = int(position * ratio), int((position + 1) * ratio)
        pool, count = (1, before) if until > before else (0, position - before)
        members = self._touching[pool]
        epoch, slot = divmod(count, len(members))
        if self._orders.get(pool, (-1,))[0] != epoch:
            self._orders[pool] = (epoch, np.random.default_rng([self._config.train.seed, 1, pool, epoch]).permutation(len(members)))
        return pool, members[int(self._orders[pool][1][slot])]


class Pictures:
    """The recordings of archives, on a device or on the way there."""

    def __init__(self, archives: Sequence[Archive], device: torch.device) -> None:
        self._archives, self._device = archives, device
        self._resident: torch.Tensor | None = None
        if device.type == "cuda":
            size = sum(part.stored(number).nbytes for part in archives for number in range(len(part)))
            if size < MOST_MEMORY * torch.cuda.mem_get_info(device)[0]:
                self._resident = self._moved()

    def _moved(self) -> torch.Tensor:
        counts = [[len(part.stored(number)) for number in range(len(part))] for part in self._archives]
        self._begins = [np.cumsum([sum(map(sum, counts[:pool]))] + row)[:-1] for pool, row in enumerate(counts)]
        shape = (sum(map(sum, counts)), *self._archives[0].pictures.shape[1:])
        resident = torch.empty(shape, dtype=torch.int16, device=self._device)
        for part, begins in zip(self._archives, self._begins, strict=True):
            for number, begin in enumerate(begins):
                some = np.array(part.stored(number)).view(np.int16)
                resident[begin : begin + len(some)] = torch.from_numpy(some).to(self._device)
        return resident

    def take(self, members: Sequence[tuple[int, int]], chosen: NDArray[np.int64]) -> torch.Tensor:
        """Pictures of presses [levels].

        Args:
            members: Archive and number of each. chosen: Which of its pictures, 0 the no-contact frame, shape (B, T).
        Returns:
            Shape (B, T, 3, h, w), float32.
        """
        if self._resident is None:
            some = np.stack([self._archives[pool].stored(number)[rows] for (pool, number), rows in zip(members, chosen, strict=True)])
            taken = torch.from_numpy(some.view(np.int16)).to(self._device, non_blocking=True)
        else:
            begins = np.array([self._begins[pool][number] for pool, number in members])
            taken = self._resident[torch.from_numpy(begins[:, None] + chosen).to(self._device, non_blocking=True)]
        # torch knows little of unsigned 16 bit numbers.
        return (taken.to(torch.int32) & 0xFFFF).to(torch.float32).movedim(-1, 2) / FIXED_POINT


def varied(presses: Sequence[Press], seeds: Sequence[int], config: Config, device: torch.device) -> list[Batch]:
    """Presses as other sensors might have seen them, to the same end, a batch at a time."""
    batches = []
    for first in range(0, len(presses), config.train.batch):
        part = collate(presses[first : first + config.train.batch], config.input.frames).to(device)
        looks = np.stack([draw_look(np.random.default_rng([*seeds, first + number]), config.augment) for number in range(len(part.target))])
        stack = torch.cat([part.background[:, None], part.pictures], dim=1)
        stack = randomise(stack, looks, [(0.0, 0.0)] * len(looks), config.augment)
        told = _hidden(part.gel, looks), part.scaled
        batches.append(_batch(stack, part.lengths, part.target, part.bounds, part.rank, *told, config.input.deadband_levels))
    return batches


def share(step: int, batch: int, rank: int = 0, world: int = 1) -> range:
    """The positions in the stream of a step: this device's share of them.

    Raises:
        LearnError: The batch cannot be shared evenly.
    """
    if batch % world:
        raise LearnError(f"batch = {batch}: must be a multiple of the {world} devices")
    start, count = step * batch + rank * (batch // world), batch // world
    return range(start, start + count)


def _hidden(gel: torch.Tensor, looks: NDArray) -> torch.Tensor:
    """Gels of presses (B, 3), NaN where their look hides them."""
    return gel.masked_fill(torch.from_numpy(looks["hide_gel"][:, None].copy()).to(gel.device), torch.nan)


def _batch(
    stack: torch.Tensor,
    lengths: torch.Tensor,
    target: torch.Tensor,
    bounds: torch.Tensor,
    rank: torch.Tensor,
    gel: torch.Tensor,
    scaled: torch.Tensor,
    deadband: float,
) -> Batch:
    """From no-contact frames and pictures, shape (B, 1 + T, 3, h, w)."""
    device = stack.device
    background, pictures, lengths = stack[:, 0].contiguous(), stack[:, 1:], lengths.to(device, non_blocking=True)
    there = torch.arange(pictures.shape[1], device=device) < lengths[:, None]
    signal = ((pictures - background[:, None]).abs() - deadband).clamp_min(0).mean(dim=(2, 3, 4))
    pictures = torch.where(there[:, :, None, None, None], pictures, torch.zeros_like(pictures))
    signal = torch.where(there, signal, torch.zeros_like(signal))
    return Batch(pictures, background, signal, lengths, target, bounds, rank, gel, scaled).to(device)
