"""One training loop: draw, step, log, validate, save. `gelsim-learn train`.

A step is a function of (weights, optimizer, seed, step number): presses, dropout and learning rate are drawn or computed from the seed and
the step, so a run that is stopped and resumed ends with the very bits of one that was not. Several devices: start it with torchrun; each
takes its share of every batch (PyTorch's DistributedDataParallel), and the first one writes.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import importlib
import json
import math
import os
import platform
import resource
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import distributed

from gelsim.data.episodes import Dataset, load_dataset
from gelsim.errors import GelsimError
from gelsim.files import whole_file
from learn import checkpoint as checkpoints
from learn.checkpoint import Checkpoint
from learn.config import Config, LearnError, TrainConfig, from_plain, to_plain
from learn.data import Batch, Press, held_presses, label_of, sides
from learn.estimate import Estimates, batches, estimate, pick_device
from learn.logs import Curves
from learn.model import Network, PaperNet, build, compile_convolutions, load_vgg, parameter_count
from learn.novelty import fit_novelty, gel_range
from learn.recordings import CACHE, PLAIN, Archive, Progress, Reading, archive
from learn.stream import Stream, share, varied

NOVELTY_DRAWS = 500
"""Most training draws from which the novelty distance is fitted; ten a press where presses are few."""
NOVELTY_VARIED = 3
"""Randomised copies of each validation press, from which, with the press itself, the threshold is taken."""
CALIBRATION_FEWEST = 8
"""With fewer validation presses the spread is left as the network says it."""
PREDICTIONS = 9
"""Of which the median time is told."""
PREDICTION_SECONDS = 5.0
"""No more of them when they have taken longer."""

Sides = tuple[list[int], list[int]]
"""Indices of a dataset's presses to train on, and to validate on."""


@dataclass(frozen=True)
class Place:
    """Which of the processes this is."""

    rank: int
    world: int
    device: torch.device

    @property
    def first(self) -> bool:
        return self.rank == 0


@dataclass(frozen=True)
class Begin:
    """What weights a run begins with; nothing: random ones."""

    init: Path | None = None
    """A checkpoint; the config must name the same network."""
    vgg_weights: Path | None = None
    """Of the paper's network: a file of VGG16's."""

    def __str__(self) -> str:
        return str(self.init.name) if self.init else f"VGG16 of {self.vgg_weights.name}" if self.vgg_weights else "random weights"


def train(
    data: Path,
    out: Path,
    config: Config,
    *,
    real: Path | None = None,
    begin: Begin = Begin(),
    resume: bool = False,
    force: bool = False,
    reading: Reading = PLAIN,
) -> dict[str, Any]:
    """Trains to `config.train.steps` and writes a run folder.

    Args:
        data: A dataset; its splits `train` and `validation` are used. real: A second one, mixed in at `config.train.real_ratio`.
        out: config.json, run.json, curves.*, tensorboard/, last.pt, model.pt, report.json, cache/.
        reading: Of recordings, and where the training is; its cache may serve several runs, without one it is the run's own; its workers
            are those of the config.
    Returns:
        What report.json holds.
    Raises:
        LearnError, DatasetError: Something in the input cannot be used.
        KeyboardInterrupt: After an interruption, when last.pt has been saved and the best network until then has its spread's factor.
    """
    began = time.perf_counter()
    with _place(reading.device) as place:
        datasets = [load_dataset(path) for path in (data, real) if path is not None]
        provenance = _provenance(datasets, begin)
        # What can be refused before presses are read is refused before anything is written: nothing stands in a corrected command's way.
        share(0, config.train.batch, place.rank, place.world)
        divided = _divide(datasets, config)
        config = _with_classes(config, datasets, divided)
        if resume and (out / "last.pt").is_file():
            begun = checkpoints.load(out / "last.pt")
        else:
            network = _network(config, begin, datasets, divided)
            begun = Checkpoint(config, 0, network.state_dict(), provenance=provenance)
        if place.first:
            _open_run(out, config, provenance, resume, force)
        shown = reading.progress if place.first else None
        reading = replace(reading, cache=reading.cache or out / CACHE, progress=shown, workers=config.train.workers)
        try:
            parts, presses = _gather(place, datasets, divided, config, reading)
            read = time.perf_counter() - began
            stream = Stream(parts, config, place.device)
        except (GelsimError, OSError):
            if place.first and not resume:
                _take_back(out)
            raise
        report = _steps(place, out, begun, stream, presses, reading.progress)
        if report:
            report |= {"seconds_reading": round(read, 1), "seconds": round(time.perf_counter() - began, 1)}
            _write_json(out / "report.json", report)
        return report


def _steps(place: Place, out: Path, begun: Checkpoint, stream: Stream, presses: list[Press], progress: Progress | None) -> dict[str, Any]:
    """From where a run stands to its last step; what the first process reports of it. `presses`: those that validate."""
    config, first, best, held = begun.config, begun.step, begun.best, batches(presses, place.device)
    network = begun.build().to(place.device)
    optimizer, averaged = _optimizer(network, config), _averaged(network, begun)
    if begun.optimizer is not None:
        optimizer.load_state_dict(begun.optimizer)
    if config.train.compile:
        compile_convolutions(network)
    model: torch.nn.Module = torch.nn.parallel.DistributedDataParallel(network) if place.world > 1 else network
    settings = config.train
    curves = Curves(out, first) if place.first else None
    autocast = _autocast(config, place.device)
    spent, since, losses = 0.0, time.perf_counter(), []

    def save(step: int) -> None:
        state = Checkpoint(config, step, network.state_dict(), optimizer.state_dict(), averaged.state_dict(), best)
        state.provenance = begun.provenance
        checkpoints.save(out / "last.pt", state)

    with _stop_signal(place) as stop:
        for step in range(first, settings.steps):
            for group in optimizer.param_groups:
                group["lr"] = rate_at(step, config)
            torch.manual_seed(int(np.random.SeedSequence([settings.seed, 4, step, place.rank]).generate_state(1)[0]))
            batch = stream.batch(share(step, settings.batch, place.rank, place.world))
            model.train()
            with autocast():
                output = model(batch)
            loss = network.loss(output, batch)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            if settings.clip:
                torch.nn.utils.clip_grad_norm_(network.parameters(), settings.clip)
            optimizer.step()
            _average(averaged, network, step, settings.average)
            losses.append(loss.detach())
            done = step + 1
            if done % settings.validate_every == 0 or done == settings.steps:
                if not all(torch.isfinite(value) for value in losses):
                    raise LearnError(f"train: the loss is not finite before step {done}; try a lower --rate than {settings.rate:g}")
                # Whoever reads a loss has waited for the device: the time is that of the steps, without validation.
                seconds = time.perf_counter() - since
                spent += seconds
                if curves is not None:
                    found = _validation(averaged, held)
                    mean = float(torch.stack(losses).mean())
                    curves.add(done, loss=mean, rate=rate_at(step, config), videos_per_s=len(losses) * settings.batch / seconds, **found)
                    if found.get("validation_loss", mean) < best:
                        best = found.get("validation_loss", mean)
                        checkpoints.save(
                            out / "model.pt", Checkpoint(config, done, averaged.state_dict(), best=best, provenance=begun.provenance)
                        )
                    save(done)
                    curves.draw()
                losses, since = [], time.perf_counter()
            if progress:
                progress("training", done, settings.steps)
            if stop:
                save(done)
                if curves is not None:
                    curves.close()
                    if (out / "model.pt").is_file():  # the best so far, as it may be all that there will be
                        _finish(out, stream, presses, place.device)
                raise KeyboardInterrupt
    if place.world > 1:
        distributed.barrier()
    if curves is None:
        return {}
    curves.close()
    report = _finish(out, stream, presses, place.device)
    report |= {
        "parameters": parameter_count(network),
        "device": _device_name(place.device),
        "devices": place.world,
        "steps_now": settings.steps - first,
        "videos_per_s": round((settings.steps - first) * settings.batch / spent, 2) if spent else None,
        "presses": stream.presses,
        "without_contact": stream.without_contact,
        "memory_mb": _memory(place.device),
        "prediction": _prediction_cost(out / "model.pt", presses),
    }
    return report


def rate_at(step: int, config: Config) -> float:
    """The learning rate of a step: the paper's stairs, or ours: a ramp and a half cosine down to a hundredth."""
    settings = config.train
    if config.model.model == "paper":
        return settings.rate * settings.step_factor ** (step // settings.step_size)
    if step < settings.warmup:
        return settings.rate * (step + 1) / settings.warmup
    share = (step - settings.warmup) / max(settings.steps - settings.warmup, 1)
    return settings.rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))


def _optimizer(network: Network, config: Config) -> torch.optim.Optimizer:
    settings: TrainConfig = config.train
    if isinstance(network, PaperNet):
        return torch.optim.SGD(network.parameters(), lr=settings.rate, momentum=settings.momentum, weight_decay=settings.weight_decay)
    # Biases and gains of normalisation are not pulled to zero.
    decayed = [parameter for parameter in network.parameters() if parameter.ndim > 1]
    free = [parameter for parameter in network.parameters() if parameter.ndim <= 1]
    groups = [{"params": decayed, "weight_decay": settings.weight_decay}, {"params": free, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=settings.rate)


def _averaged(network: Network, begun: Checkpoint) -> Network:
    """The network whose weights follow those of the trained one slowly: what is validated and kept."""
    averaged = copy.deepcopy(network).eval().requires_grad_(False)
    if begun.averaged is not None:
        averaged.load_state_dict(begun.averaged)
    return averaged


@torch.no_grad()
def _average(averaged: Network, network: Network, step: int, most: float) -> None:
    """θ̄ ← d θ̄ + (1 − d) θ, d at most `most` and smaller in the first steps, whose weights are soon worthless."""
    decay = min(most, (1 + step) / (10 + step))
    for kept, now in zip(averaged.parameters(), network.parameters(), strict=True):
        kept.lerp_(now, 1 - decay)


def _network(config: Config, begin: Begin, datasets: list[Dataset], divided: list[Sides]) -> Network:
    """What a run begins with."""
    init, vgg = begin.init, begin.vgg_weights
    if init is not None:
        begun = checkpoints.load(init)
        if (replace(begun.config.model, classes=config.model.classes), begun.config.input) != (config.model, config.input):
            raise LearnError(f"--init {init}: its network and input are others than this run's")
        if begun.config.model.classes == config.model.classes:
            return begun.build()
        network = build(config)
        network.load_state_dict({name: value for name, value in begun.network.items() if name != "cuts"}, strict=False)
        return network
    torch.manual_seed(config.train.seed)
    network = build(config)
    rows = [dataset.rows[dataset.positions[index]] for dataset, (train, _) in zip(datasets, divided, strict=True) for index in train]
    known = np.array([row["shore_00"] for row in rows if row["shore_00"] is not None], float)
    if len(known) == 0:
        raise LearnError("train: no press of known hardness to train on")
    network.centre.fill_(float(known.mean()))
    network.scale.fill_(max(float(known.std()), 1.0))
    if vgg is not None:
        if not isinstance(network, PaperNet):
            raise LearnError("--vgg-weights: only --model paper has a VGG16")
        load_vgg(network, vgg)
    return network


def _with_classes(config: Config, datasets: list[Dataset], divided: list[Sides]) -> Config:
    """With as many classes of hardness as the presses to train on tell of."""
    ranks = [
        label_of(dataset.rows[dataset.positions[index]])[2]
        for dataset, (train, _) in zip(datasets, divided, strict=True)
        for index in train
    ]
    told = 1 + max(ranks, default=-1)
    asked = config.model.classes
    if asked and told > asked:
        raise LearnError(f"classes = {asked}: the presses to train on have hardness_class up to {told - 1}; allowed is {told} or more")
    return replace(config, model=replace(config.model, classes=asked or (max(told, 2) if told else 0)))


def _divide(datasets: list[Dataset], config: Config) -> list[Sides]:
    """Of each dataset what is trained on, no more than asked for, and what is validated on."""
    divided = [sides(dataset, config.train.seed) for dataset in datasets]
    for number, most in zip(range(len(datasets)), (config.train.presses, config.train.real_presses), strict=False):
        if most:
            chosen = np.random.default_rng([config.train.seed, 5]).permutation(divided[number][0])[:most]
            divided[number] = (sorted(map(int, chosen)), divided[number][1])
    return divided


def _gather(
    place: Place, datasets: list[Dataset], divided: list[Sides], config: Config, reading: Reading
) -> tuple[list[Archive], list[Press]]:
    """The archives to train on, and the presses to validate on: real ones where there are any."""
    if not place.first:  # the first process fills the cache, the others map it
        distributed.barrier()
    parts = [archive(dataset, train, config.input, reading) for dataset, (train, _) in zip(datasets, divided, strict=True)]
    with_validation = [number for number, (_, validation) in enumerate(divided) if validation]
    held: list[Press] = []
    if place.first and with_validation:
        number = with_validation[-1]
        part = archive(datasets[number], divided[number][1], config.input, reading)
        presses = held_presses(part, config.input, config.model.model == "paper", config.train.seed)
        held = [press for press in presses if press is not None]
    if place.first and place.world > 1:
        distributed.barrier()
    return parts, held


def _validation(network: Network, held: list[Batch]) -> dict[str, float]:
    if not held:
        return {}
    found = estimate(network, held)
    target = torch.cat([part.target for part in held]).cpu().numpy()
    known = np.isfinite(target)
    if not known.any():
        return {"validation_loss": found.loss}
    return {"validation_loss": found.loss, "validation_rmse": float(np.sqrt(((found.mean - target)[known] ** 2).mean()))}


def spread_factor(found: Estimates, target: np.ndarray) -> float:
    """By which the spreads must be multiplied for errors to be as large as they say: the maximum of the likelihood of normal errors."""
    known = np.isfinite(target) & np.isfinite(found.spread)
    if known.sum() < CALIBRATION_FEWEST:
        return 1.0
    return float(np.sqrt((((found.mean - target) / found.spread)[known] ** 2).mean()))


def _finish(out: Path, stream: Stream, held: list[Press], device: torch.device) -> dict[str, Any]:
    """Fits the spread's factor and the novelty distance to the best network and writes them with it, and the range of gels."""
    best = checkpoints.load(out / "model.pt")
    config, network = best.config, best.build().to(device)
    # Beyond the last step: draws that no step saw.
    start = config.train.steps * config.train.batch
    last, batch = start + min(NOVELTY_DRAWS, 10 * stream.presses), config.train.batch
    trained = estimate(network, (stream.batch(range(at, min(at + batch, last))) for at in range(start, last, batch))).statistics
    report: dict[str, Any] = {"step": best.step, "validation_loss": best.best, "validation_presses": len(held)}
    statistics = torch.empty((0, trained.shape[1]), dtype=trained.dtype)
    if held:
        shown = batches(held, device)
        found = estimate(network, shown)
        target = np.array([press.target for press in held])
        best.spread_factor = spread_factor(found, target)
        # What randomisation may have made of a press is not unlike the training either.
        copies = NOVELTY_VARIED if config.augment.augment else 0
        changed = [part for copy_ in range(copies) for part in varied(held, [config.train.seed, 6, copy_], config, device)]
        statistics = estimate(network, [*shown, *changed]).statistics
        known = np.isfinite(target)
        if known.any():
            report["validation_rmse"] = float(np.sqrt(((found.mean - target)[known] ** 2).mean()))
            report["validation_rmse_of_mean"] = float(np.sqrt(((target[known] - float(network.centre)) ** 2).mean()))
    seen_by = stream.sensors(range(start, last)), [press.sensor for press in held] * (len(statistics) // max(len(held), 1))
    novelty, gels = fit_novelty(trained, statistics, seen_by), gel_range(stream.gels())
    best.novelty, best.gels = novelty.to_plain(), gels.to_plain() if gels else None
    checkpoints.save(out / "model.pt", best)
    return report | {"spread_factor": best.spread_factor, "novelty_threshold": novelty.threshold, "provenance": best.provenance}


def _memory(device: torch.device) -> float:
    """The most that was held [MB]: of the GPU, or of the process."""
    if device.type == "cuda":
        return round(torch.cuda.max_memory_allocated(device) / 1e6, 1)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, 1)  # kilobytes on Linux


def _prediction_cost(model: Path, presses: list[Press]) -> dict[str, Any] | None:
    """Of one press at the network's size on a CPU with two threads: median time, without reading it."""
    if not presses:
        return None
    network, cpu, threads, seconds = checkpoints.load(model).build(), torch.device("cpu"), torch.get_num_threads(), []
    torch.set_num_threads(2)
    try:
        for _ in range(PREDICTIONS):
            began = time.perf_counter()
            estimate(network, batches(presses[:1], cpu))
            seconds.append(time.perf_counter() - began)
            if sum(seconds) > PREDICTION_SECONDS:
                break
    finally:
        torch.set_num_threads(threads)
    return {"device": "CPU, 2 threads", "milliseconds": round(1e3 * float(np.median(seconds)), 2)}


def _open_run(out: Path, config: Config, provenance: dict[str, Any], resume: bool, force: bool) -> None:
    there = (out / "config.json").is_file()
    if resume:
        if not there:
            raise LearnError(f"--out {out}: no run to go on with (it has no config.json)")
        kept = read_run(out)
        if to_plain(kept) != to_plain(replace(config, train=replace(config.train, workers=kept.train.workers))):
            raise LearnError(f"--out {out}: was begun with other settings; --resume takes them from its config.json")
        before = json.loads((out / "run.json").read_text(encoding="utf-8"))
        if before.get("data") != provenance["data"]:
            raise LearnError(f"--out {out}: was begun with other data")
        return
    if out.exists() and any(path.name != CACHE for path in out.iterdir()):
        if not force:
            raise LearnError(f"--out {out}: exists; give --resume to go on with it, or --force to begin again")
        for name in ("last.pt", "model.pt", "report.json", "curves.csv", "curves.png"):
            (out / name).unlink(missing_ok=True)
        for events in (out / "tensorboard").glob("events.*"):
            events.unlink()
    out.mkdir(parents=True, exist_ok=True)
    _write_json(out / "run.json", provenance)
    _write_json(out / "config.json", to_plain(config))


def _take_back(out: Path) -> None:
    """Of a run whose presses cannot be read; those that were are kept, in the cache alone, which stands in no run's way."""
    for name in ("run.json", "config.json"):
        (out / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # not empty
        out.rmdir()


def read_run(out: Path) -> Config:
    """The config of a run. Raises LearnError."""
    try:
        return from_plain(json.loads((out / "config.json").read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise LearnError(f"{out / 'config.json'}: cannot be read ({error})") from None


def _provenance(datasets: list[Dataset], begin: Begin) -> dict[str, Any]:
    described = []
    for dataset in datasets:
        digest = hashlib.sha256(json.dumps([dataset.rows, dataset.splits], sort_keys=True).encode()).hexdigest()
        described.append(
            {"name": dataset.folder.resolve().name, "domain": dataset.info.get("domain"), "presses": len(dataset), "sha256": digest}
        )
    return {"data": described, "begun_from": str(begin), "versions": {"torch": str(torch.__version__), "python": platform.python_version()}}


def _write_json(path: Path, content: dict[str, Any]) -> None:
    with whole_file(path) as partial:
        partial.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def _autocast(config: Config, device: torch.device) -> Any:
    low = config.train.precision == "bfloat16" or (config.train.precision == "auto" and device.type == "cuda")
    return (lambda: torch.autocast(device.type, dtype=torch.bfloat16)) if low else contextlib.nullcontext


def _device_name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads"


@contextlib.contextmanager
def _place(device: str) -> Iterator[Place]:
    """This process among those that torchrun started, or alone."""
    chosen, world = pick_device(device), int(os.environ.get("WORLD_SIZE", "1"))
    # Sums in a fixed order: the same seed gives the same weights.
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = True, False
    if world == 1:
        yield Place(0, 1, chosen)
        return
    if chosen.type == "cuda":
        chosen = torch.device("cuda", int(os.environ["LOCAL_RANK"]))
        torch.cuda.set_device(chosen)
    # Imported by torch's optimisers, it keeps a process group that is there already for ever; its threads then run on while the interpreter
    # ends, which now and then aborts the process (torch 2.13, gloo).
    importlib.import_module("torch._dynamo")
    distributed.init_process_group("nccl" if chosen.type == "cuda" else "gloo")
    try:
        yield Place(distributed.get_rank(), world, chosen)
    finally:
        distributed.destroy_process_group()


@contextlib.contextmanager
def _stop_signal(place: Place) -> Iterator[list[int]]:
    """A list that is no longer empty once somebody wants the run to stop. Of several processes none listens: torchrun ends them."""
    asked: list[int] = []
    if place.world > 1:
        yield asked
        return
    before = {number: signal.signal(number, lambda number, _: asked.append(number)) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
