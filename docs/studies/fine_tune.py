"""What is simulation worth in real presses? Networks tuned on k labelled things, beside the same network trained on these alone.

    python docs/studies/fine_tune.py dataset FOLDER DATA --mm-per-px 0.058 --sensor gelsight_mini      videos with labels.csv -> a dataset
    python docs/studies/fine_tune.py study DATA OUT [--device cuda --workers 8 --seconds 1150]         trains, a line of JSON a network
    python docs/studies/fine_tune.py table OUT                                                         the table of what is there

FOLDER is as docs/studies/hand_presses.py takes it, and presses are found and scaled as `gelsim-learn predict` does. Each split draws things
until 20 objects of three classes can be trained on; the objects of all other things are the test, the same for every k, and the k objects
are among those of the next larger k. All videos of an object are trained on, told gel and scale, known by class alone.

Ways: `tuned`, all weights by `learn.train.train` from a shipped network; `mixed`, the same with as many simulated presses of the dataset
`--simulated` in every batch; `random`, the same network, data and code from random weights;
`head`, its last layer alone, by the same likelihood; `ridge`, a ridge regression of the class on the frozen network's features of each
video (or on the hand-made ones of `learn.features`). Rate and steps, or the penalty, are chosen once for all k, by the mean Spearman with 5
objects on splits of the half of things that choices may rest on (12 to test, of which 1 is hard); things of both halves are then tested.
`matched`: nothing is labelled; the features (mean and spread; covariance: Sun et al. 2016, CORAL) or the pictures (mean and contrast
of the untouched gel, contrast of the change) of all real videos are brought to those of the simulated presses, which a checkpoint keeps.

It goes on where it was stopped. --quick: one split, a few steps, on a CPU in minutes. Scores are of test objects: Spearman by object (mean
of its videos), areas under the curve by video.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import TimeoutError as OutOfTime
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gelsim.data.episodes import Dataset, episode_file, gel_facts, load_dataset, survey, write_episode, write_meta
from gelsim.errors import GelsimError
from gelsim.results import Episode
from gelsim.scene.layers import build_scene
from learn import checkpoint
from learn.baselines import over_time
from learn.config import InputConfig, LearnError, configure
from learn.data import UNBOUND, Batch, Press, held_presses
from learn.ensemble import Ensemble
from learn.estimate import Estimates, batches, estimate, pick_device
from learn.frames import equal_steps, loading
from learn.framing import FIELD_MM, Framing
from learn.model import SPREADS, Output, PressNet, build, read_tensors
from learn.predict import SHIPPED, find_model
from learn.recordings import Archive, Reading, archive
from learn.scores import spearman
from learn.train import Begin, train
from learn.video import sources

KEPT = 24
"""Frames of a press that travel, at equal steps of its signal; a network sees eight."""
UNLABELLED = "unlabelled"
FEATURES = "features.pt"
"""Of the shipped networks, by network and press, between processes."""


def to_dataset(folder: Path, out: Path, mm_per_px: float, sensor: str) -> None:
    """The presses of videos as the networks see them, in the schema of the simulated ones."""
    inputs = checkpoint.load(find_model("paper2017", "")).config.input
    gel = gel_facts(build_scene({"sensor": {"preset": sensor}}).gel)
    with (folder / "labels.csv").open(newline="") as opened:
        rows = list(csv.DictReader(opened))
    for index, of in enumerate([*rows, rows[0]]):
        ((_, read),) = sources(folder / of["file"], inputs, framing=Framing(mm_per_px=mm_per_px))
        try:
            recording = read().recording
        except LearnError as error:
            print(error, file=sys.stderr)
            continue
        among = loading(recording.signal, inputs)
        if len(among) == 0:
            print(f"{of['file']}: no contact", file=sys.stderr)
            continue
        kept = equal_steps(recording.signal, among, KEPT, repeat=False)
        frames, empty = (np.rint(part).clip(0, 255).astype(np.uint8) for part in (recording.pictures[kept], recording.background))
        label = {"object": of["object"], "thing": of["thing"], "hardness_class": int(of["hardness_rank"])}
        # A training sets labelled objects aside where nothing validates; one press without a label does, and nothing is chosen by it.
        label = label if index < len(rows) else {"object": UNLABELLED}
        row = {
            "index": index, "group": 5, "shape": "natural", "radius_mm": None, "shore_00": None, "rigid": False, "motion": "human",
            "domain": "real", "frames": len(frames), "peak_force_n": None, "mechanics": f"real-{index:06d}", "sensor": sensor, "gel": gel,
            "file": episode_file(index), "field_mm": list(FIELD_MM), "source": of["file"], **label,
        }  # fmt: skip
        unknown = np.full(len(frames), np.nan)
        write_episode(
            out, Episode(frames, empty, kept / 25.0, unknown, np.full((len(frames), 3), np.nan), np.zeros((len(frames), 0, 2)), row)
        )
    info = {"domain": "real", "fps": 25.0, "resolution": list(inputs.picture[::-1]), "noise": "own", "plan": None, "seed": None}
    write_meta(out, info, survey(out), [], {})
    print(f"{out}: {len(survey(out).rows) - 1} of {len(rows)} videos")


# ---- splits ----

CLASSES = SOFT, MODERATE, HARD = 0, 1, 2
TRAINED = "paper2017", "varied"
"""Of the shipped networks those that are trained on."""
WAYS = "head", "tuned", "mixed", "random"
COUNTS = {2: (1, 0, 1), 5: (1, 2, 2), 10: (2, 4, 4), 20: (3, 8, 9)}
"""Objects of each class among k: from 5 on nearly as many of each as there are in all (6, 16, 16)."""
CHOOSING = 0.3
"""Share of the time that choosing rate and steps takes at most."""
CHOSEN_WITH = 5
"""k by which rate and steps are chosen: the half of things for that has three hard ones."""


@dataclass(frozen=True)
class Body:
    """An object that was pressed."""

    name: str
    thing: str
    rank: int
    presses: tuple[int, ...]
    """Indices in the dataset."""


def bodies_of(rows: Sequence[dict[str, Any]]) -> list[Body]:
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        if row["object"] != UNLABELLED:
            found.setdefault(row["object"], []).append(row)
    return [Body(name, of[0]["thing"], of[0]["hardness_class"], tuple(row["index"] for row in of)) for name, of in sorted(found.items())]


def first_half(bodies: Sequence[Body]) -> list[Body]:
    """Those on which choices may rest, as in hand_presses.py."""
    things = sorted({body.thing for body in bodies})
    return [body for body in bodies if things.index(body.thing) % 2 == 0]


def split(bodies: Sequence[Body], seed: int, most: int) -> tuple[dict[int, list[Body]], list[Body]]:
    """Bodies to train on by k up to `most`, each among those of the next; and those of all other things, some of each class."""
    rng = np.random.default_rng([39, seed])
    things = sorted({body.thing for body in bodies})
    while True:  # drawn again where things of several classes leave too few of one
        wanted, drawn = list(COUNTS[most]), []
        for thing in rng.permutation(things):
            of = [body for body in bodies if body.thing == thing]
            if all(wanted[body.rank] > 0 for body in of):
                drawn += [(number, len(drawn), of[place]) for number, place in enumerate(rng.permutation(len(of)))]
                for body in of:
                    wanted[body.rank] = max(wanted[body.rank] - 1, 0)
        touched = {body.thing for _, _, body in drawn}
        test = [body for body in bodies if body.thing not in touched]
        if not any(wanted) and {body.rank for body in test} == set(CLASSES):
            break
    # From as many things as there are before a second part of one.
    ordered = [body for *_, body in sorted(drawn, key=lambda entry: entry[:2])]
    by_rank = [[body for body in ordered if body.rank == rank] for rank in CLASSES]
    trained = {
        k: [body for of, count in zip(by_rank, counts, strict=True) for body in of[:count]] for k, counts in COUNTS.items() if k <= most
    }
    return trained, test


# ---- scores ----


def area(above: NDArray, below: NDArray) -> float:
    """Of the pairs of one that should read higher and one that should read lower, the share that does; ties count half."""
    over = above[:, None] - below[None]
    return float(np.mean((over > 0) + 0.5 * (over == 0)))


def scores(readings: dict[int, float], test: Sequence[Body]) -> tuple[float, float, float]:
    """Spearman by object; areas under the curve by video, hard over soft and hard over moderate."""
    of = [np.array([readings[index] for index in body.presses]) for body in test]
    hard, moderate, soft = (
        np.concatenate([values for values, body in zip(of, test, strict=True) if body.rank == rank]) for rank in (HARD, MODERATE, SOFT)
    )
    ranked = spearman([body.rank for body in test], [values.mean() for values in of])
    return ranked, area(hard, soft), area(hard, moderate)


# ---- trainings ----


@dataclass(frozen=True)
class Job:
    """A training, and the reading of its test."""

    stage: str
    """choose: on the first half of things; test: on all."""
    split: int
    way: str
    start: str
    k: int
    rate: float
    steps: int
    batch: int

    @property
    def key(self) -> str:
        return f"{self.stage}-{self.split}-{self.way}-{self.start}-{self.k}-{self.rate:g}-{self.steps}"


@dataclass(frozen=True)
class Place:
    """Where a process of this study works."""

    data: Path
    work: Path
    device: str
    gpus: int
    simulated: Path | None


_place: Place
_presses: dict[int, Press]


def _begin(place: Place, number: Any) -> None:
    """In a process: its GPU, and the presses as a test sees them."""
    global _place, _presses
    torch.set_num_threads(1)
    with number.get_lock():
        mine, number.value = number.value, number.value + 1
    if place.gpus:
        torch.cuda.set_device(mine % place.gpus)
    _place, (_, _presses) = place, seen(load_dataset(place.data), place.work)


def seen(dataset: Dataset, work: Path) -> tuple[Archive, dict[int, Press]]:
    """The labelled presses of a dataset as they are stored, and by index as a test sees them. All show contact: `to_dataset`."""
    inputs = shipped_inputs()
    part = archive(dataset, [row["index"] for row in dataset.rows if row["object"] != UNLABELLED], inputs, Reading(work / "cache"))
    found = held_presses(part, inputs, False, 0)
    return part, {row["index"]: press for row, press in zip(part.rows, found, strict=True) if press is not None}


@cache
def shipped_inputs() -> InputConfig:
    return checkpoint.load(find_model("paper2017", "")).config.input


def stage_bodies(bodies: list[Body], stage: str) -> tuple[list[Body], int]:
    """What a stage splits, and the most that it trains on."""
    return (first_half(bodies), CHOSEN_WITH) if stage == "choose" else (bodies, max(COUNTS))


def run(job: Job) -> tuple[Job, dict[int, float] | str, float]:
    """In a process: the readings of a job's test by press, or why there are none; and its seconds."""
    began = time.perf_counter()
    dataset = load_dataset(_place.data)
    bodies, most = stage_bodies(bodies_of(dataset.rows), job.stage)
    trained, test = split(bodies, job.split, most)
    if job.way == "head":
        return job, head_tuned(job, trained[job.k], test), time.perf_counter() - began
    folder = _place.work / job.key
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "fold").mkdir(parents=True)
    shutil.copytree(_place.data / "meta", folder / "fold" / "meta")
    (folder / "fold" / "episodes").symlink_to((_place.data / "episodes").resolve())
    sides = {
        "train": [index for body in trained[job.k] for index in body.presses],
        "validation": [row["index"] for row in dataset.rows if row["object"] == UNLABELLED],
    }
    (folder / "fold" / "meta" / "splits.json").write_text(json.dumps(sides))
    init = find_model("paper2017" if job.start == "random" else job.start, "")
    begun = checkpoint.load(init)
    if job.start == "random":
        init = folder / "random.pt"
        checkpoint.save(init, random_checkpoint(begun, job.split))
    # As the shipped ones were finished: little randomisation.
    config = configure(
        batch=job.batch, rate=job.rate, steps=job.steps, warmup=0, validate_every=job.steps, seed=job.split,
        end_share=0.6, drop=0.05, gain=0.12, gamma=0.1, crop=0.08,
    )  # fmt: skip
    config = replace(config, input=begun.config.input, model=begun.config.model)
    try:
        reading = Reading(_place.work / "cache", device=_place.device)
        data, real = (_place.simulated, folder / "fold") if job.way == "mixed" else (folder / "fold", None)
        train(data, folder / "run", config, real=real, begin=Begin(init), reading=reading)
        ensemble = Ensemble([folder / "run" / "model.pt"], pick_device(_place.device))
        asked = [index for body in test for index in body.presses]
        said = ensemble.read([_presses[index] for index in asked]).mean
        readings = {index: round(float(reading), 3) for index, reading in zip(asked, said, strict=True)}
    except (GelsimError, RuntimeError) as error:  # weights that ran away, a GPU without memory: the other trainings go on
        return job, str(error), time.perf_counter() - began
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return job, readings, time.perf_counter() - began


def head_tuned(job: Job, trained: Sequence[Body], test: Sequence[Body]) -> dict[int, float]:
    """Readings of a network whose last layer alone was trained, and the cuts between classes, by `PressNet.loss`."""
    kept = checkpoint.load(find_model(job.start, ""))
    network = build(replace(kept.config, model=replace(kept.config.model, classes=len(CLASSES))))
    assert isinstance(network, PressNet) and network.cuts is not None
    network.load_state_dict(kept.network, strict=False)
    features = read_tensors(_place.work / FEATURES, 2**24)
    ranks = torch.tensor([body.rank for body in trained for _ in body.presses])
    shown = torch.stack([features[job.start][index] for body in trained for index in body.presses])
    none, count = torch.empty(0), len(ranks)
    batch = Batch(
        none, none, none, torch.ones(count, dtype=torch.int64), torch.full((count,), torch.nan), torch.tensor([UNBOUND] * count), ranks,
        none, none,
    )  # fmt: skip
    optimizer = torch.optim.Adam([*network.head.parameters(), network.cuts], lr=job.rate)
    for _ in range(job.steps):
        said = network.head(shown)[:, None]
        spread = (network.scale * torch.nn.functional.softplus(said[..., 1])).clamp(*SPREADS)
        loss = network.loss(Output(network.centre + network.scale * said[..., 0], spread, shown), batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        asked = [index for body in test for index in body.presses]
        raw = network.head(torch.stack([features[job.start][index] for index in asked]))[:, 0]
        return {index: round(float(network.centre + network.scale * value), 3) for index, value in zip(asked, raw, strict=True)}


def random_checkpoint(like: checkpoint.Checkpoint, seed: int) -> checkpoint.Checkpoint:
    """Of the same network with random weights; what stands for the middle and the width of the scale of hardness stays."""
    torch.manual_seed(seed)
    weights = build(like.config).state_dict() | {name: like.network[name] for name in ("centre", "scale")}
    return checkpoint.Checkpoint(like.config, 0, weights)


# ---- without training a network ----


def statistics(kept: checkpoint.Checkpoint, presses: Sequence[Press], device: str) -> Estimates:
    """What a network says of presses, with `learn.novelty.press_statistics`, of which its features come first."""
    place = pick_device(device)
    return estimate(kept.build().to(place), batches(presses, place))


def untrained(presses: Sequence[Press], said: dict[str, Estimates], device: str) -> dict[tuple[str, str], NDArray]:
    """Readings by what saw no label of theirs: zero-shot, and matched to the simulated presses; by way and network.

    Args:
        said: Of the shipped networks, their `statistics`.
    """
    found: dict[tuple[str, str], NDArray] = {}
    for start, of in said.items():
        kept = checkpoint.load(find_model(start, ""))
        network = kept.build()
        assert isinstance(network, PressNet) and kept.novelty is not None
        there, here, units = kept.novelty["mean"].numpy(), of.statistics.numpy(), network.config.hidden
        spread = np.linalg.inv((kept.novelty["whitening"].T @ kept.novelty["whitening"]).numpy()) / len(there)
        found["zero-shot", start] = of.mean
        for name, features in matched(here[:, :units], there[:units], spread[:units, :units]).items():
            raw = network.head(torch.from_numpy(features).float())[:, 0].detach().numpy()
            found[f"matched, {name}", start] = float(network.centre) + float(network.scale) * raw
        pictures = [repainted(press, here[:, units:].mean(axis=0), there[units:]) for press in presses]
        found["matched, pictures", start] = statistics(kept, pictures, device).mean
    both = {way: np.mean([found[way, start] for start in said], axis=0) for way, _ in found}
    return found | {(way, "default"): mean for way, mean in both.items()}


def matched(here: NDArray, mean: NDArray, covariance: NDArray) -> dict[str, NDArray]:
    """Features (N, F) brought to a mean and a covariance."""
    centred = here - here.mean(axis=0)
    wide = np.sqrt(np.diag(covariance)) / centred.std(axis=0).clip(1e-6)
    own = np.cov(centred.T)
    own = 0.9 * own + 0.1 * np.diag(np.diag(own)) + 1e-6 * np.eye(len(own))  # as learn.novelty keeps the other regular

    def power(matrix: NDArray, exponent: float) -> NDArray:
        values, vectors = np.linalg.eigh(matrix)
        return (vectors * values.clip(1e-9) ** exponent) @ vectors.T

    return {
        "mean and spread": mean + wide * centred,
        "covariance": mean + centred @ power(own, -0.5) @ power(covariance, 0.5),
    }  # fmt: skip


def repainted(press: Press, here: NDArray, there: NDArray) -> Press:
    """A press whose untouched gel has the colours and contrast, and whose change the contrast, that they have on average `there`: of
    `learn.novelty.press_statistics` what follows the features."""
    width = there[3:6] / here[3:6].clip(1e-6)
    empty = (press.background - here[:3]) * width + there[:3]
    change = (press.pictures - press.background) * (there[9:12] / here[9:12].clip(1e-6))
    pictures = (empty + change).astype(np.float32)
    empty = empty.astype(np.float32)
    signal = np.maximum(np.abs(pictures - empty) - shipped_inputs().deadband_levels, 0).mean(axis=(1, 2, 3))
    return replace(press, background=empty, pictures=pictures, signal=signal.astype(np.float32))


PENALTIES = (0.1, 1.0, 10.0, 100.0)
"""Of ridge regressions, in mean eigenvalues."""


@dataclass(frozen=True, eq=False)
class Frozen:
    """Features of presses that no label made, by what made them, each (N, F); random weights are others in each split."""

    presses: dict[int, Press]
    features: dict[str, NDArray]
    device: str

    def of(self, start: str, number: int) -> dict[int, NDArray]:
        """Standardised over all presses."""
        if start == "random":
            kept = checkpoint.load(find_model("paper2017", ""))
            said = statistics(random_checkpoint(kept, number), list(self.presses.values()), self.device)
            found = said.statistics.numpy()[:, : kept.config.model.hidden]
        else:
            found = self.features[start]
        scale = found.std(axis=0)
        return dict(zip(self.presses, (found - found.mean(axis=0)) / np.where(scale > 1e-6, scale, 1.0), strict=True))

    def ridge(self, bodies: list[Body], stage: str, number: int, penalties: dict[str, Sequence[float]]) -> Iterator[dict[str, Any]]:
        """Regressions of the class of a split, a line each."""
        part, most = stage_bodies(bodies, stage)
        trained, test = split(part, number, most)
        for start, of_start in penalties.items():
            of = self.of(start, number)
            for k, of_k in trained.items() if stage == "test" else [(CHOSEN_WITH, trained[CHOSEN_WITH])]:
                shown = np.stack([of[index] for body in of_k for index in body.presses])
                ranks = np.array([body.rank for body in of_k for _ in body.presses], float)
                centred = shown - shown.mean(axis=0)
                gram = centred @ centred.T
                for penalty in of_start:
                    damped = gram + penalty * np.trace(gram) / len(gram) * np.eye(len(gram))
                    weights = centred.T @ np.linalg.solve(damped, ranks - ranks.mean())
                    readings = {index: round(float(of[index] @ weights), 5) for body in test for index in body.presses}
                    yield line(stage, number, "ridge", start, k, readings, setting=[penalty])


def frozen(part: Archive, presses: dict[int, Press], said: dict[str, Estimates], device: str) -> Frozen:
    """`part`: the archive of the presses; `said`: the shipped networks' `statistics` of them."""
    by_hand = [over_time(curve, shipped_inputs()) for curve in zip(part.signals, part.features, strict=True)]
    units = checkpoint.load(find_model("paper2017", "")).config.model.hidden
    features = {start: of.statistics.numpy()[:, :units] for start, of in said.items()}
    features["default"] = np.hstack(list(features.values()))
    features["hand-made"] = np.stack([one for one in by_hand if one is not None])
    return Frozen(presses, features, device)


# ---- the study ----


def line(stage: str, number: int, way: str, start: str, k: int, readings: dict[int, float], **more: Any) -> dict[str, Any]:
    return {"stage": stage, "split": number, "way": way, "start": start, "k": k, **more, "readings": readings}


def lines_of(out: Path) -> list[dict[str, Any]]:
    """What is there; a last line that a stop cut off counts as not there."""
    found = []
    path = out / "results.jsonl"
    for text in path.read_text().splitlines() if path.is_file() else ():
        try:
            found.append(json.loads(text))
        except ValueError:
            continue
    for entry in found:
        entry["readings"] = {int(index): value for index, value in entry["readings"].items()}
    return found


def study(options: argparse.Namespace) -> None:
    until = time.monotonic() + options.seconds
    out, work, data = options.out, options.work or options.out / "work", load_dataset(options.data)
    bodies, device = bodies_of(data.rows), pick_device(options.device)
    gpus = (options.gpus or torch.cuda.device_count()) if device.type == "cuda" else 0
    out.mkdir(parents=True, exist_ok=True)
    (out / "bodies.json").write_text(json.dumps([vars(body) for body in bodies]))
    (part, presses), known = seen(data, work), lines_of(out)
    said = {name: statistics(checkpoint.load(find_model(name, "")), list(presses.values()), options.device) for name in SHIPPED["default"]}
    with (out / "results.jsonl").open("a") as opened:

        def write(entry: dict[str, Any]) -> None:
            known.append(entry)
            opened.write(json.dumps(entry) + "\n")
            opened.flush()

        if not any(entry["way"] == "zero-shot" for entry in known):
            for (way, start), mean in untrained(list(presses.values()), said, options.device).items():
                write(line("test", -1, way, start, 0, dict(zip(presses, mean.round(3).tolist(), strict=True))))
        still = frozen(part, presses, said, options.device)
        tensors = {start: dict(zip(presses, torch.from_numpy(still.features[start]).float(), strict=True)) for start in said}
        torch.save(tensors, work / FEATURES)
        starts = (*still.features, "random")

        def regress(stage: str, splits: int, penalties: dict[str, Sequence[float]]) -> None:
            there = {entry["split"] for entry in known if (entry["stage"], entry["way"]) == (stage, "ridge")}
            for number in set(range(splits)) - there:
                for entry in list(still.ridge(bodies, stage, number, penalties)):
                    write(entry)

        regress("choose", options.choices, dict.fromkeys(starts, PENALTIES))
        regress("test", options.splits, {start: choose(known, bodies)["ridge", start] for start in starts})
        context, place = get_context("spawn"), Place(options.data, work, options.device, gpus, options.simulated)
        del presses, part

        def work_through(jobs: list[Job], until: float) -> None:
            there, began = {entry.get("key") for entry in known}, time.monotonic()
            left = [job for job in jobs if job.key not in there]
            if not left:
                return
            with context.Pool(min(options.workers, len(left)), _begin, (place, context.Value("i", 0))) as pool:
                results = pool.imap_unordered(run, left)
                for number in range(len(left)):
                    try:
                        job, readings, seconds = results.next(timeout=max(until - time.monotonic(), 0.01))
                    except OutOfTime:
                        print(f"{number} of {len(left)} trainings when the time was over", file=sys.stderr)
                        return
                    if isinstance(readings, str):
                        print(f"{job.key}: {readings}", file=sys.stderr)
                        continue
                    more = {"key": job.key, "setting": [job.rate, job.steps], "seconds": round(seconds, 1)}
                    write(line(job.stage, job.split, job.way, job.start, job.k, readings, **more))
                    spent = time.monotonic() - began
                    print(f"{spent:.0f} s: {job.key}, {seconds:.1f} s, {number + 1} of {len(left)}", file=sys.stderr, flush=True)

        grids = {
            ("head", "paper2017"): (options.head_rates, options.head_steps),
            ("head", "varied"): (options.head_rates, options.head_steps),
            ("tuned", "paper2017"): (options.rates, options.steps),
            **({("mixed", "paper2017"): (options.rates, options.steps)} if options.simulated else {}),
            ("tuned", "random"): (options.random_rates, options.random_steps),
        }
        grids = {(way, start): of for (way, start), of in grids.items() if (start if start == "random" else way) in options.ways}
        choices = [
            Job("choose", number, way, start, CHOSEN_WITH, rate, steps, options.batch)
            for number in range(options.choices) for (way, start), (rates, counts) in grids.items() for rate in rates for steps in counts
        ]  # fmt: skip
        work_through(choices, min(time.monotonic() + CHOOSING * options.seconds, until))
        chosen = choose(known, bodies)
        print(f"chosen: {chosen}", file=sys.stderr)
        both = [way for way, start in grids if start == "paper2017" and way != "head"]
        chosen |= {(way, "varied"): chosen[way, "paper2017"] for way in both}
        tests = [
            Job("test", number, way, start, k, chosen[way, start][0], chosen[way, start][1], options.batch)
            for number in range(options.splits) for k in options.k for way, start in (*grids, *((way, "varied") for way in both))
        ]  # fmt: skip
        work_through(tests, until)
    table(out)


def choices_of(known: Sequence[dict[str, Any]], bodies: list[Body]) -> dict[tuple[str, str], dict[tuple[float, ...], list[float]]]:
    """Spearman on the first half of things by setting, of each way and what it begins from."""
    found: dict[tuple[str, str], dict[tuple[float, ...], list[float]]] = {}
    part, most = stage_bodies(bodies, "choose")
    for entry in known:
        if entry["stage"] == "choose":
            score = scores(entry["readings"], split(part, entry["split"], most)[1])[0]
            found.setdefault((entry["way"], entry["start"]), {}).setdefault(tuple(entry["setting"]), []).append(score)
    return found


def choose(known: Sequence[dict[str, Any]], bodies: list[Body]) -> dict[tuple[str, str], Any]:
    """The setting of the highest mean."""
    found = choices_of(known, bodies)
    return {way: max(settings, key=lambda setting, of=settings: float(np.mean(of[setting]))) for way, settings in found.items()}


def table(out: Path) -> None:
    """Prints the scores of what is there, mean and standard deviation over splits."""
    bodies = [Body(of["name"], of["thing"], of["rank"], tuple(of["presses"])) for of in json.loads((out / "bodies.json").read_text())]
    known = lines_of(out)
    print("| chosen on the first half of things | begun from | rate and steps, or penalty | Spearman | splits |\n|---|---|---|---|---|")
    for (way, start), settings in sorted(choices_of(known, bodies).items()):
        for setting, of in sorted(settings.items()):
            print(f"| {way} | {start} | {', '.join(f'{part:g}' for part in setting)} | {np.mean(of):.2f} ± {np.std(of):.2f} | {len(of)} |")
    by_way: dict[tuple[str, str, int], dict[int, dict[int, float]]] = {}
    for entry in known:
        if entry["stage"] == "test":
            by_way.setdefault((entry["way"], entry["start"], entry["k"]), {})[entry["split"]] = entry["readings"]
    for way in ("tuned", "mixed", "head"):
        for k in COUNTS:  # networks that read as one
            one, other = (by_way.get((way, start, k), {}) for start in TRAINED)
            both = {number: {i: (one[number][i] + other[number][i]) / 2 for i in one[number]} for number in one if number in other}
            if both:
                by_way[way, "both", k] = both
    tests = {number: split(bodies, number, max(COUNTS))[1] for number in sorted({number for of in by_way.values() for number in of} - {-1})}
    zero = {start: by_way["zero-shot", start, 0][-1] for start in (*SHIPPED["default"], "default")}
    print("\n| way | begun from | objects | Spearman by object | hard, soft | hard, moderate | beyond zero-shot `default`, in | splits |")
    print("|---|---|---|---|---|---|---|---|")
    for (way, start, k), of in sorted(by_way.items(), key=lambda item: (item[0][0], item[0][1], item[0][2])):
        readings = {number: of.get(number, of.get(-1)) for number in tests}
        found = {number: scores(said, tests[number]) for number, said in readings.items() if said is not None}
        gain = [found[number][0] - scores(zero["default"], tests[number])[0] for number in found]
        cells = [f"{np.mean(part):.2f} ± {np.std(part):.2f}" for part in zip(*found.values(), strict=True)]
        print(f"| {way} | {start} | {k} | {' | '.join(cells)} | {np.mean(gain):+.2f} ± {np.std(gain):.2f}, "
              f"{100 * np.mean(np.array(gain) > 0):.0f} % | {len(found)} |")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True)
    made = parts.add_parser("dataset")
    made.add_argument("folder", type=Path)
    made.add_argument("out", type=Path)
    made.add_argument("--mm-per-px", type=float, required=True)
    made.add_argument("--sensor", required=True)
    asked = parts.add_parser("study")
    asked.add_argument("data", type=Path)
    asked.add_argument("out", type=Path)
    asked.add_argument("--work", type=Path, help="where pictures and networks lie meanwhile, 1 GB (default: OUT/work)")
    asked.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS), help="of those that are trained")
    asked.add_argument("--simulated", type=Path, help="a dataset of simulated presses, for the way `mixed`")
    asked.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    asked.add_argument("--gpus", type=int, default=0, help="default: all")
    asked.add_argument("--workers", type=int, default=2, help="trainings at once")
    asked.add_argument("--seconds", type=float, default=1e6)
    asked.add_argument("--splits", type=int, default=40)
    asked.add_argument("--choices", type=int, default=8, help="splits of the first half by which rate and steps are chosen")
    asked.add_argument("--batch", type=int, default=32)
    asked.add_argument("--k", type=int, nargs="+", choices=tuple(COUNTS), default=list(COUNTS))
    asked.add_argument("--rates", type=float, nargs="+", default=[1e-4, 3e-4, 1e-3])
    asked.add_argument("--steps", type=int, nargs="+", default=[100, 300])
    asked.add_argument("--head-rates", type=float, nargs="+", default=[1e-3, 1e-2])
    asked.add_argument("--head-steps", type=int, nargs="+", default=[30, 100, 300])
    asked.add_argument("--random-rates", type=float, nargs="+", default=[3e-4, 1e-3, 3e-3])
    asked.add_argument("--random-steps", type=int, nargs="+", default=[300, 900])
    asked.add_argument("--quick", action="store_true", help="a trial of every part")
    told = parts.add_parser("table")
    told.add_argument("out", type=Path)
    options = parser.parse_args()
    if options.part == "dataset":
        to_dataset(options.folder, options.out, options.mm_per_px, options.sensor)
    elif options.part == "table":
        table(options.out)
    else:
        if options.quick:
            options.splits, options.choices, options.batch, options.k = 1, 1, 4, [2, 5]
            options.rates, options.steps, options.random_rates, options.random_steps = [1e-4], [2], [1e-3], [2]
            options.head_rates, options.head_steps = [1e-3], [30, 100]
        study(options)


if __name__ == "__main__":
    main()
