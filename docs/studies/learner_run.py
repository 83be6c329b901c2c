"""Everything that docs/learner.md wants to know of one dataset: trainings side by side, their evaluations, one summary.

    python docs/studies/learner_run.py --data data --gap gap --fixed fixed --out runs --gpus 4 --minutes 12

`--data` is of plan paper2017, `--gap` of plan gap, `--fixed` of plan fixed (the last two may be left out), all of one seed: the test
rows of gap then hold objects that nothing was trained on. Datasets without pictures (`gelsim dataset --no-light`) are drawn while they are
read, once for all runs; gap, whose pictures are traced, has to bring them. What is done:

    main           our network, longest
    control        the same, as long as the ablations; no-*, every-step: with one departure undone; quarter, sixteenth: on fewer presses
    paper          the paper's method, VGG16 from random weights
    fixed, equal   on as many presses of fixed and of data; fixed-plain: without --augment either
    tuned-N-S      main, fine-tuned on N presses of gap (train split), drawn by seed S

A pilot measures the rate of steps, from which the lengths follow so that all ends within `--minutes`; `--steps` sets main's instead.
Pictures are averaged once for all runs. What is done already is not done again: start it anew with the same `--out` to go on. Runs that
the time did not suffice for are listed as such. `summary/` has at most 8 small files: summary.md, results.csv, plots, model.pt,
details.tar.gz.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from gelsim.data.episodes import lit, load_dataset
from learn.config import configure
from learn.evaluate import PUBLISHED, TITLES
from learn.splits import TEST_ROWS, TRAIN

PICTURE = (144, 192)
MAIN = ("--picture", "{},{}".format(*PICTURE), "--widths", "48,96,192,320", "--batch", "64", "--rate", "0.0015")
"""Of our networks: what `default` was trained with."""
ABLATIONS = {
    "control": (),
    "no-background": ("--show-background", "false"),
    "no-signal": ("--show-signal", "false"),
    "no-shape": ("--show-shape", "false"),
    "no-gel": ("--show-gel", "false"),
    "every-step": ("--every-step", "true"),
    "no-spread": ("--spread", "false"),
    "no-augment": ("--augment", "false"),
    "no-average": ("--average", "0"),
}
TUNED, TUNED_SEEDS, TUNED_STEPS = (5, 20, 50), (0, 1, 2), 300
MAIN_SHARE, SHORT_SHARE = 0.5, 0.13
"""Of the minutes at most: main's and paper's training, and each shorter one's."""
SHORTER = 14
"""Shorter runs, all counted."""
OVERHEAD_MINUTES = 0.6
"""Of a run that is not training: starting, reading, testing."""
PILOT_STEPS = 150
PAPER_STEPS = 10_000
CORES_2_STEPS = 20
READ = """
import sys
from pathlib import Path
from gelsim.data.episodes import load_dataset
from learn.config import configure
from learn.recordings import archive
data, preset, rows, columns, cache, workers, plan = sys.argv[1:]
dataset = load_dataset(data)
inputs = configure(preset, picture=(int(rows), int(columns))).input
archive(dataset, [dataset.rows[0]["index"]], inputs, Path(cache), workers=int(workers), plan=plan or None)
"""


@dataclass
class Job:
    """A training and its evaluations, one process after the other on one GPU."""

    name: str
    data: list[str]
    """What it is trained on, as flags; a run that goes on is told this again."""
    flags: list[str]
    """Its settings."""
    steps: int
    evaluate: list[tuple[str, Path]]
    """Name and folder of each dataset that it is tested on."""
    after: str | None = None
    tuned: bool = False
    note: str = ""


@dataclass
class Study:
    """Where everything lies, and when it has to be over."""

    out: Path
    gpus: int
    cores: int
    end: float
    cache: Path
    threads: int
    plan: str = ""
    lost: dict[str, str] = field(default_factory=dict)

    def command(self, name: str, gpu: int, *arguments: str | Path, threads: int | None = None) -> None:
        """`gelsim-learn …`, its words in logs/NAME.log. Raises RuntimeError when it fails or is too late."""
        environment = os.environ | {"OMP_NUM_THREADS": str(threads or self.threads), "CUDA_VISIBLE_DEVICES": str(gpu) if self.gpus else ""}
        log = self.out / "logs" / f"{name}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("a", encoding="utf-8") as file:
            file.write(f"{' '.join(map(str, arguments))}\n")
            file.flush()
            process = subprocess.Popen(
                [sys.executable, "-m", "learn.cli", *map(str, arguments), "--debug"], env=environment, stdout=file, stderr=file
            )
            try:
                code = process.wait(max(self.end - time.monotonic(), 1.0))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGTERM)  # a training saves last.pt and can go on
                process.wait(60)
                raise RuntimeError("stopped: the time was over; start again to go on") from None
        if code:
            raise RuntimeError(f"failed with code {code}: {log.read_text(encoding='utf-8').strip().splitlines()[-1]}")

    def run(self, job: Job, gpu: int) -> None:
        """Trains and evaluates, but for what is done."""
        folder = self.out / job.name
        if not (folder / "report.json").is_file():
            begun = (folder / "last.pt").is_file()
            if folder.exists() and not begun:
                shutil.rmtree(folder)
            how = ["--resume"] if begun else [*job.flags, "--steps", str(job.steps)]
            self.command(job.name, gpu, "train", *job.data, "--out", folder, "--cache", self.cache, *how)
        for name, data in job.evaluate:
            where = folder / f"eval-{name}"
            if not (where / "report.json").is_file():
                without = [] if job.name == "main" else ["--no-baselines"]
                self.command(job.name, gpu, "eval", "--model", folder / "model.pt", "--data", data, "--out", where, "--cache", self.cache,
                             "--force", *without)  # fmt: skip


def main(
    data: Path, out: Path, gap: Path | None, fixed: Path | None, gpus: int, cores: int, minutes: float, steps: int | None, paper: bool,
    per_gpu: int, more: Sequence[str], plan: str,
) -> None:  # fmt: skip
    began = time.monotonic()
    slots = [gpu for _ in range(per_gpu) for gpu in range(max(gpus, 1))]
    out.mkdir(parents=True, exist_ok=True)
    study = Study(out, gpus, cores, began + 60 * minutes, out / "cache", max(1, cores // len(slots)), plan)
    sets = {name: path for name, path in (("data", data), ("gap", gap), ("fixed", fixed)) if path is not None}
    seconds = {"reading": read(study, sets, paper)}
    lengths, pilot = plan_lengths(study, data, minutes, steps, paper, slots, per_gpu)
    jobs = plan_jobs(out, sets, lengths, paper, more)
    work(study, jobs, slots)
    cost = two_cores(study, sets)
    seconds["all"] = time.monotonic() - began
    summarise(study, jobs, {"pilot": pilot, "two_cores": cost, "seconds": seconds, "slots": slots}, gap is not None)
    print(f"{out / 'summary'}: {seconds['all'] / 60:.1f} minutes; not done: {study.lost or 'nothing'}", flush=True)


def read(study: Study, sets: dict[str, Path], paper: bool) -> float:
    """Averages every picture of every dataset once, all cores at it; seconds."""
    start = time.monotonic()
    for name, path in sets.items():
        presets = {"default": PICTURE} | ({"paper": configure("paper").input.picture} if paper and name == "data" else {})
        for preset, picture in presets.items():
            # In a process of its own: those that read are its copies, and this one has loaded torch.
            subprocess.run(
                [sys.executable, "-c", READ, path, preset, *map(str, picture), study.cache, str(study.cores), study.plan], check=True
            )
            print(f"read {name} for {preset}: {time.monotonic() - start:.0f} s", flush=True)
    return time.monotonic() - start


def plan_lengths(
    study: Study, data: Path, minutes: float, steps: int | None, paper: bool, slots: Sequence[int], per_gpu: int
) -> tuple[dict[str, int], dict[str, float]]:
    """Steps of main, of the short ones and of paper, and what the pilots measured [videos/s]."""
    if steps is not None:
        return {"main": steps, "short": max(steps // 4, 1), "paper": min(steps, PAPER_STEPS), "tuned": min(TUNED_STEPS, steps)}, {}
    rates, lengths = {}, {"tuned": TUNED_STEPS}
    for name, flags in (("main", MAIN), ("paper", ("--model", "paper"))):
        if name == "paper" and not paper:
            continue
        study.run(Job(f"pilot-{name}", ["--data", str(data)], [*flags, "--validate-every", str(PILOT_STEPS // 3)], PILOT_STEPS, []), 0)
        with (study.out / f"pilot-{name}" / "curves.csv").open(newline="", encoding="utf-8") as file:
            # The last third: what is done once has been done.
            rates[name] = [float(row["value"]) for row in csv.DictReader(file) if row["name"] == "videos_per_s"][-1]
    # What is left of the time is shared: main and paper four parts each, every shorter run one, and each run has its start and its tests.
    left = (study.end - time.monotonic()) / 60
    short = min(max((0.85 * left * len(slots) - OVERHEAD_MINUTES * (SHORTER + 11)) / (SHORTER + 8), 0.03 * left), SHORT_SHARE * left)
    long = min(4 * short, MAIN_SHARE * left)
    # Others beside it slow a run down.
    fair = 60 * min(1.4 / per_gpu, 0.9)
    lengths |= {"main": int(np.clip(long * fair * rates["main"] / 64, 500, 60_000))}
    lengths |= {"short": int(np.clip(short * fair * rates["main"] / 64, 200, 15_000))}
    if paper:
        lengths["paper"] = int(np.clip(long * fair * rates["paper"] / 16, 100, PAPER_STEPS))
    print(f"steps: {lengths}; videos/s alone: {rates}", flush=True)
    return lengths, rates


def plan_jobs(out: Path, sets: dict[str, Path], lengths: dict[str, int], paper: bool, more: Sequence[str]) -> list[Job]:
    """In the order in which they are begun."""
    data, rest = sets["data"], {name: path for name, path in sets.items() if name != "data"}
    every, seen = [("data", data), *rest.items()], [("data", data)]
    near = seen + [("gap", sets["gap"])] if "gap" in sets else seen

    def ours(name: str, steps: int, *flags: str, on: Path = data, tests: Sequence[tuple[str, Path]] = near, note: str = "") -> Job:
        often = str(max(steps // 20, 1))
        settings = [*MAIN, "--warmup", str(steps // 50), "--validate-every", often, *more, *flags]
        return Job(name, ["--data", str(on)], settings, steps, list(tests), note=note)

    jobs = [ours("main", lengths["main"], tests=every)]
    if paper:
        tenth = str(max(lengths["paper"] // 10, 1))
        flags = ["--model", "paper", "--step-size", tenth, "--validate-every", tenth]
        jobs.append(Job("paper", ["--data", str(data)], flags, lengths["paper"], seen,
                        note="VGG16 begun from random weights, not ImageNet's: not the paper's method as published"))  # fmt: skip
    jobs.append(ours("control", lengths["short"]))
    presses = len(load_dataset(data).splits[TRAIN])
    if "fixed" in sets:
        equal = min(presses, len(load_dataset(sets["fixed"]).splits[TRAIN]))
        few = ("--presses", str(equal))
        jobs += [
            ours("fixed", lengths["short"], *few, on=sets["fixed"], tests=every, note=f"{equal} presses of one sensor that never varies"),
            ours("fixed-plain", lengths["short"], *few, "--augment", "false", on=sets["fixed"], tests=every,
                 note=f"{equal} presses of that sensor, nothing randomised while training either"),
            ours("equal", lengths["short"], *few, tests=every, note=f"{equal} presses of the randomised sensors"),
        ]  # fmt: skip
    jobs += [ours(name, lengths["short"], *flags) for name, flags in ABLATIONS.items() if name != "control"]
    for name, part in (("quarter", 4), ("sixteenth", 16)):
        jobs.append(ours(name, lengths["short"], "--presses", str(max(presses // part, 1)), note=f"{max(presses // part, 1)} presses"))
    if "gap" in sets:
        # One validation, at the end: no choice among checkpoints is made with presses of the new sensor.
        flags = ["--rate", "3e-4", "--warmup", "0", "--validate-every", str(lengths["tuned"]), "--batch", "32"]
        jobs += [
            Job(f"tuned-{count}-{seed}", ["--data", str(data), "--real", str(sets["gap"])],
                [*flags, "--real-presses", str(count), "--seed", str(seed), "--init", str(out / "main" / "model.pt")], lengths["tuned"],
                [("gap", sets["gap"])], after="main", tuned=True)
            for seed in TUNED_SEEDS for count in TUNED
        ]  # fmt: skip
    return jobs


def work(study: Study, jobs: list[Job], slots: Sequence[int]) -> None:
    """Every job in turn, as many at a time as there are slots; one that fails stops no other."""
    left, lock, done = list(jobs), threading.Condition(), set()

    def serve(gpu: int) -> None:
        while True:
            with lock:
                ready = next((job for job in left if job.after is None or job.after in done or job.after in study.lost), None)
                if ready is None:
                    if not left:
                        return
                    lock.wait(5)
                    continue
                left.remove(ready)
            start = time.monotonic()
            try:
                if ready.after in study.lost:
                    raise RuntimeError(f"not run: {ready.after} is not done")
                if start > study.end and not (study.out / ready.name / "last.pt").is_file():
                    raise RuntimeError("not run: the time was over")
                study.run(ready, gpu)
                told = "done"
            except (RuntimeError, OSError, subprocess.SubprocessError) as error:
                told = study.lost[ready.name] = str(error)
            with lock:
                done.add(ready.name)
                lock.notify_all()
            print(f"{ready.name} on {gpu}: {told}, {time.monotonic() - start:.0f} s", flush=True)

    threads = [threading.Thread(target=serve, args=(gpu,)) for gpu in slots]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def two_cores(study: Study, sets: dict[str, Path]) -> dict[str, float]:
    """What a training of our network does on two threads of a CPU [videos/s], and a prediction of one episode as typed [s].

    The episode is the first of a dataset that has pictures; without one nothing is predicted.
    """
    data, firsts = sets["data"], [(path, load_dataset(path).rows[0]) for path in sets.values()]
    found: dict[str, float] = {}
    few = [
        *MAIN,
        "--device",
        "cpu",
        "--presses",
        "64",
        "--validate-every",
        str(CORES_2_STEPS),
        "--batch",
        "16",
        "--steps",
        str(CORES_2_STEPS),
    ]
    folder = study.out / "two-cores"
    try:
        if not (folder / "report.json").is_file():
            where = ["--out", str(folder), "--cache", str(study.cache), "--force"]
            study.command("two-cores", 0, "train", "--data", str(data), *few, *where, threads=2)
        found["training_videos_per_s"] = json.loads((folder / "report.json").read_text(encoding="utf-8"))["videos_per_s"]
        for episode in [path / row["file"] for path, row in firsts if lit(row)][:1]:
            start = time.monotonic()
            study.command("predict", 0, "predict", "--model", study.out / "main" / "model.pt", "--device", "cpu", episode, threads=2)
            found["prediction_as_typed_s"] = round(time.monotonic() - start, 2)
    except (RuntimeError, OSError) as error:
        study.lost["two-cores"] = str(error)
    return found


# ---- summary ----


def summarise(study: Study, jobs: list[Job], measured: dict[str, object], with_gap: bool) -> None:
    """Tables, CSV and plots of what is there."""
    folder = study.out / "summary"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    reports = {
        (job.name, name): json.loads((study.out / job.name / f"eval-{name}" / "report.json").read_text(encoding="utf-8"))
        for job in jobs
        for name, _ in job.evaluate
        if (study.out / job.name / f"eval-{name}" / "report.json").is_file()
    }
    rows = results(study, reports)
    with (folder / "results.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["run"])
        writer.writeheader()
        writer.writerows(rows)
    (folder / "summary.md").write_text(text(study, jobs, reports, measured, with_gap), encoding="utf-8")
    main = study.out / "main"
    if (main / "model.pt").is_file():
        shutil.copy(main / "model.pt", folder / "model.pt")
    for name, where in (("rows_data", "eval-data"), ("rows_gap", "eval-gap")):
        pictures = [main / where / f"{row}.png" for row in TEST_ROWS if (main / where / f"{row}.png").is_file()]
        if pictures:
            side_by_side(pictures, folder / f"{name}.png")
    others = [path for path in (main / "eval-data" / "errors.png", main / "eval-data" / "calibration.png", main / "curves.png")]
    if any(path.is_file() for path in others):
        side_by_side([path for path in others if path.is_file()], folder / "main.png", columns=1)
    with tarfile.open(folder / "details.tar.gz", "w:gz") as tar:
        wanted = ("report.json", "run.json", "config.json", "curves.csv", "table.md", "predictions.csv")
        for path in sorted(study.out.rglob("*")):
            inside = path.relative_to(study.out)
            if inside.parts[0] not in ("cache", "summary") and (path.name in wanted or path.suffix == ".log"):
                tar.add(path, str(inside))


def results(study: Study, reports: dict[tuple[str, str], dict]) -> list[dict[str, object]]:
    """A line a run, dataset and row; the baselines of each dataset once."""
    rows: list[dict[str, object]] = []

    def line(run: str, data: str, row: str, presses: int, found: dict) -> None:
        low, high = found["rmse_interval"]
        rows.append({"run": run, "data": data, "row": row, "presses": presses, "objects": found.get("objects"), "rmse": found["rmse"],
                     "rmse_low": low, "rmse_high": high, "r2": found["r2"]})  # fmt: skip

    told = set()
    for (run, data), report in reports.items():
        for row, found in report["rows"].items():
            if found.get("rmse") is None:
                continue
            line(run, data, row, found["presses"], found)
            if (data, row) not in told:
                told.add((data, row))
                for name, other in found["baselines"].items():
                    line(f"baseline: {name}", data, row, found["presses"], other)
    return rows


def text(study: Study, jobs: list[Job], reports: dict[tuple[str, str], dict], measured: dict[str, object], with_gap: bool) -> str:
    """The summary."""
    lines = [
        "# Learner: one run of everything",
        "",
        "All simulated. RMSE in Shore 00; brackets: 95 % over objects.",
        "",
        "## The paper's rows",
        "",
    ]

    def rmse(run: str, data: str, row: str, interval: bool = True) -> str:
        found = reports.get((run, data), {}).get("rows", {}).get(row, {})
        if found.get("rmse") is None:
            return "—"
        low, high = found["rmse_interval"]
        return f"{found['rmse']:.1f}" + (f" [{low:.1f}, {high:.1f}]" if interval and low is not None and high is not None else "")

    def baselines(data: str, row: str) -> dict[str, str]:
        found = next((r["rows"][row] for (_, name), r in reports.items() if name == data and row in r["rows"]), {})
        return {name: f"{other['rmse']:.1f}" for name, other in (found.get("baselines") or {}).items() if other.get("rmse") is not None}

    names = [name for name in TEST_ROWS if any(row == name for report in reports.values() for row in report["rows"])]
    scored = [row for row in names if rmse("main", "data", row) != "—" or rmse("control", "data", row) != "—"]
    bare = list(baselines("data", scored[0])) if scored else []
    lines += ["| row | published RMSE (real) | presses, objects | ours | R² | `paper`, random weights | " + " | ".join(bare) + " |",
              "|---|---|---|---|---|---|" + "---|" * len(bare)]  # fmt: skip
    for row in scored:
        found = reports.get(("main", "data"), {}).get("rows", {}).get(row, {})
        r2 = f"{found['r2']:.2f}" if found.get("r2") is not None else "—"
        published = f"{PUBLISHED[row][2]}" if row in PUBLISHED else "—"
        there = baselines("data", row)
        count = f"{found.get('presses', '—')}, {found.get('objects', '—')}"
        cells = [TITLES[row], published, count, rmse("main", "data", row), r2, rmse("paper", "data", row)]
        lines.append("| " + " | ".join(cells + [there.get(name, "—") for name in bare]) + " |")
    for shape, order in reports.get(("main", "data"), {}).get("rows", {}).get("natural", {}).get("ranking", {}).items():
        lines.append(f"\nNatural objects, {shape}: Spearman {order['spearman']:.2f} over {order['objects']} objects.")
    lines += ["", "## Ablations", "", "All as long as `control`, one departure undone each; mean: over rows.", ""]
    lines += ["| run | steps | " + " | ".join(TITLES[row] for row in scored) + " | mean |", "|---|---|" + "---|" * (len(scored) + 1)]
    for job in jobs:
        if job.tuned or not any((job.name, "data") == key for key in reports):
            continue
        values = [reports[job.name, "data"]["rows"].get(row, {}).get("rmse") for row in scored]
        mean = f"{np.mean([value for value in values if value is not None]):.2f}" if any(value is not None for value in values) else "—"
        cells = [rmse(job.name, "data", row, interval=False) for row in scored]
        lines.append(f"| {job.name}{': ' + job.note if job.note else ''} | {job.steps} | " + " | ".join(cells) + f" | {mean} |")
    if with_gap:
        lines += gap_text(jobs, reports, names)
    lines += [
        "",
        "## Cost",
        "",
        "| run | device | steps | videos/s | seconds | memory MB | prediction, ms |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in ["pilot-main", "pilot-paper", *(job.name for job in jobs), "two-cores"]:
        path = study.out / name / "report.json"
        if path.is_file():
            found = json.loads(path.read_text(encoding="utf-8"))
            cost = (found.get("prediction") or {}).get("milliseconds", "—")
            lines.append(f"| {name} | {found['device']} | {found['steps_now']} | {found['videos_per_s']} | {found['seconds']} "
                         f"| {found['memory_mb']} | {cost} |")  # fmt: skip
    lines += ["", f"Prediction: one press, its pictures averaged already, on two threads. Measured besides: `{json.dumps(measured)}`", ""]
    lines += ["## Not done", "", *(f"- {name}: {why}" for name, why in study.lost.items())] if study.lost else ["Everything was done."]
    return "\n".join(lines) + "\n"


def gap_text(jobs: list[Job], reports: dict[tuple[str, str], dict], names: Sequence[str]) -> list[str]:
    """Test rows of the other sensors, of data, and of fixed, pooled: how much a run loses."""

    def pooled(run: str, data: str) -> tuple[float, float, int] | None:
        rows = [row for name, row in reports.get((run, data), {}).get("rows", {}).items() if name in names and row.get("rmse") is not None]
        if not rows:
            return None
        count = np.array([row["presses"] for row in rows], float)
        error = float(np.sqrt((count * [row["rmse"] ** 2 for row in rows]).sum() / count.sum()))
        return error, sum(row["unlike_training"] for row in rows) / count.sum(), int(count.sum())

    lines = [
        "",
        "## Sensors that no training has seen",
        "",
        "Pooled RMSE over all test rows, (presses); `gap`: sensors and gels outside the training's ranges. `tuned-N`: main fine-tuned on N",
        "presses of gap's train split, mean and range over draws; the spread's factor (not the RMSE) uses gap's validation presses.",
        "",
        "| run | on data | on gap | on fixed | called unlike the training, on gap |",
        "|---|---|---|---|---|",
    ]
    for job in jobs:
        found = pooled(job.name, "gap")
        if found is None or job.tuned:
            continue
        cells = [f"{part[0]:.1f} ({part[2]})" if part else "—" for part in (pooled(job.name, name) for name in ("data", "gap", "fixed"))]
        lines.append(f"| {job.name}{': ' + job.note if job.note else ''} | " + " | ".join(cells) + f" | {100 * found[1]:.0f} % |")
    for count in TUNED:
        values = [part[0] for part in (pooled(f"tuned-{count}-{seed}", "gap") for seed in TUNED_SEEDS) if part]
        if values:
            lines.append(
                f"| tuned-{count}, {len(values)} draws | — | {np.mean(values):.1f} ({min(values):.1f} to {max(values):.1f}) | — | — |"
            )
    first = next((report for (_, data), report in reports.items() if data == "gap"), None)
    if first:
        for name in next(iter(first["rows"].values()))["baselines"]:
            some = [(row["presses"], row["baselines"][name]["rmse"]) for row in first["rows"].values() if row.get("rmse") is not None]
            pool = np.sqrt(sum(n * value**2 for n, value in some) / sum(n for n, _ in some))
            lines.append(f"| baseline that learnt from gap's own train split: {name} | — | {pool:.1f} | — | — |")
    return lines


def side_by_side(pictures: Sequence[Path], out: Path, columns: int = 3) -> None:
    """Plots in one file."""
    images = [Image.open(path).convert("RGB") for path in pictures]
    wide, tall = max(image.width for image in images), max(image.height for image in images)
    lines = -(-len(images) // columns)
    sheet = Image.new("RGB", (wide * min(columns, len(images)), tall * lines), "white")
    for number, image in enumerate(images):
        sheet.paste(image, (wide * (number % columns), tall * (number // columns)))
    sheet.save(out, optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--gap", type=Path)
    parser.add_argument("--fixed", type=Path)
    parser.add_argument("--gpus", type=int, default=1, help="0: on the CPU")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=12.0, help="for reading, training and evaluation together")
    parser.add_argument("--per-gpu", type=int, default=2, help="trainings side by side on a GPU")
    parser.add_argument("--steps", type=int, help="main's, instead of a pilot")
    parser.add_argument("--more", default="", help="flags for each of our trainings; for a rehearsal: '--preset mini --batch 4'")
    parser.add_argument("--plan", default="", help="of --data without pictures that do not keep it: a file of the user's own")
    parser.add_argument("--no-paper", action="store_true", help="leaves out --model paper, which takes long on a CPU")
    given = parser.parse_args()
    main(
        given.data, given.out, given.gap, given.fixed, given.gpus, given.cores, given.minutes, given.steps, not given.no_paper,
        given.per_gpu, given.more.split(), given.plan,
    )  # fmt: skip
