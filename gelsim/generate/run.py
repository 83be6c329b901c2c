"""`gelsim dataset`: the episodes of a plan, whole or not at all.

Press i and its episodes depend on plan, seed and i alone. What is done is known from the episodes on the disk; a run that was killed goes
on with what is missing. Presses that cannot be solved are listed in meta/failures.jsonl with their status, and count: above MOST_FAILED of
the episodes the command says so by its exit code. meta/seconds.jsonl, alone, differs from run to run.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelsim.data.episodes import SCHEMA, Survey, survey, write_episode, write_meta
from gelsim.errors import DatasetError, GelsimError, SceneError
from gelsim.files import whole_file
from gelsim.generate import recording
from gelsim.generate.done import Done
from gelsim.generate.light import Studio, is_measured
from gelsim.generate.plan import SPLITS, SPLITS_LEARNT, Catalogue, load_plan
from gelsim.pipeline.stages import versions
from gelsim.scene.definition import Scene
from gelsim.work.workers import Crew, Handful, LocalCrew, WorkError, check_count, work_through

Progress = Callable[[str, int, int], None]

MOST_FAILED = 0.01
"""Of the episodes asked for."""
MOST_EPISODES = 10_000_000
"""Weeks of a GPU."""
NUMERICAL = (
    "MAX_ITERATIONS",
    "LINE_SEARCH_STALLED",
    "INVERTED_ELEMENT",
    "NONFINITE",
    "NO_MOTION",
    "SceneError",
    "SolveError",
)
"""Failures that would come again; others (DIED, TIMEOUT, MeshingError, as the mesher draws other numbers) are tried again by --resume."""
DEVICES = ("cpu", "cuda")
"""That solve and draw."""
PER_CORE, PER_GPU = 2, 40
"""Processes a core that solve on GPUs, where they sleep while they wait; and at most so many a GPU, whose MPS takes 48 clients (NVIDIA's
documentation of MPS, from Volta on; 32 have made whole datasets, 48 a trial of 45 s)."""
MANIFEST_SECONDS = 20.0
VERSIONS_OF = ("gelsim", "numpy", "scipy", "mitsuba", "drjit", "warp-lang", "pytetwild")


@dataclass(frozen=True)
class Hands:
    """Who makes a dataset."""

    device: str = "cpu"
    """Where presses are solved and their light is drawn: "cpu", or "cuda", all of whose devices share the workers."""
    workers: int | None = None
    """Processes; by default one per core, two where GPUs solve."""
    ray: str | None = None
    """Address of a Ray cluster that works instead of this machine."""

    def crew(self, solves: bool = True) -> Crew:
        """Processes here, more of them where GPUs solve presses, or the cluster's. Raises SceneError."""
        check_count(1 if self.workers is None else self.workers)
        if self.device not in DEVICES:
            raise SceneError(f"--device {self.device}: allowed for a dataset are {' and '.join(DEVICES)}")
        if self.ray is not None:
            from gelsim.work.cluster import RayCrew

            return RayCrew(self.ray, self.workers, gpu=self.device == "cuda")
        gpus = gpus_of(self.device)
        count = os.cpu_count() or 1
        if gpus:
            from gelsim.fem import solves_on_gpu

            count = min(count * (PER_CORE if solves and solves_on_gpu() else 1), PER_GPU * len(gpus))
        return LocalCrew(self.workers or count, gpus=gpus)


HERE = Hands()


@dataclass(frozen=True)
class Extent:
    """How many episodes a dataset has, counted from index 0. Raises SceneError."""

    episodes: int
    test: int | None = None
    """Beyond this index no presses of test rows; None: all of them."""
    train: int | None = None
    """Beyond it none that are trained on or validated."""

    def __post_init__(self) -> None:
        if not 1 <= self.episodes <= MOST_EPISODES:
            raise SceneError(f"--episodes {self.episodes}: allowed is 1 … {MOST_EPISODES}")
        for flag, most in (("test", self.test), ("train", self.train)):
            if most is not None and most < 0:
                raise SceneError(f"--{flag}-episodes {most}: expected 0 or more")

    def presses(self, catalogue: Catalogue) -> dict[int, list[int]]:
        """Numbers of the presses that it asks for, with the ends of each that are."""
        ends = len(catalogue.plan.end_points)
        # Beyond it a press's object must be drawn to know its split.
        all_of = min(self.episodes if most is None else most for most in (self.test, self.train))

        def is_asked(number: int) -> bool:
            if number * ends < all_of:
                return True
            most = self.train if catalogue.split(number) in SPLITS_LEARNT else self.test
            return most is None or number * ends < most

        return {
            number: [end for end in range(ends) if number * ends + end < self.episodes]
            for number in range(-(-self.episodes // ends))
            if is_asked(number)
        }


def generate(
    plan: str,
    extent: Extent,
    out: Path,
    *,
    seed: int = 0,
    hands: Hands = HERE,
    light: bool = True,
    resume: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Makes a dataset; returns what the command reports.

    Args:
        plan: Name of a plan that comes along, or path of a TOML file.
        extent: With `resume` it may be more than before.
        hands: Who works; by default the cores of this machine.
        light: False leaves the pictures to `gelsim.generate.relight`: mechanics, labels and scenes only.
    Raises:
        SceneError: The plan is wrong, or the folder holds something else. DatasetError, WorkError: it cannot be written, or nobody works;
            what was done is kept.
    """
    catalogue = Catalogue(load_plan(plan), seed)
    crew = hands.crew()
    start = time.perf_counter()
    info = _info(catalogue, light)
    book = Book(out, info, resume)
    ends = len(catalogue.plan.end_points)
    wanted = extent.presses(catalogue)
    asked = {number * ends + end for number, of_press in wanted.items() for end in of_press}
    todo = {
        number: missing
        for number, of_press in wanted.items()
        if (missing := [end for end in of_press if number * ends + end not in book.known])
    }
    book.write()
    keep_plan(catalogue, out)
    before = len(asked) - sum(len(of_press) for of_press in todo.values())
    if todo:
        if light and catalogue.plan.mode == "baked":
            measure_lights([catalogue.sensor_scene(number) for number in sensors_of(catalogue, todo)], hands.device, progress)
        handfuls = [(number,) for number in todo]

        def lost(handful: Handful, status: str, message: str) -> Done:
            return Done(handful, failures=[failure(catalogue, n, todo[n], status, message) for n in handful])

        arguments = (plan, seed, out, todo, hands.device, light)
        try:
            for done in work_through(handfuls, crew, make_worker, arguments, lost, still=hands.device == "cuda"):
                book.add(done)
                if done.error:
                    raise WorkError(done.error)
                if progress:
                    progress("episodes", book.count(asked), len(asked))
        except BaseException:
            book.write(quietly=True)
            raise
        book.write()
    report = report_of(book, out, asked, before, crew.count, time.perf_counter() - start)
    return {"plan": catalogue.plan.name, "seed": seed, "left_out": extent.episodes - len(asked)} | report


def report_of(book: Book, out: Path, asked: Collection[int], before: int, workers: int, seconds: float) -> dict[str, Any]:
    """What the command reports of a run that came to its end; `before` of the episodes `asked` for were known when it began."""
    failed = [row for row in book.failures.values() if row["index"] in asked]
    early = sorted({int(row["mechanics"]) for row in book.rows.values() if "ended_early" in row and row["index"] in asked})
    return {
        "out": str(out), "episodes": book.count(asked) - len(failed), "failed": len(failed), "asked": len(asked),
        "presses_ended_early": early, "failures": failed[:20], "exit_code": 4 if len(failed) > MOST_FAILED * len(asked) else 0,
        "workers": workers,
        "seconds": round(seconds, 1), "episodes_per_hour": round(3600 * (len(asked) - before) / max(seconds, 1e-9), 1),
        "splits": {name: len(members) for name, members in book.splits().items()},
    }  # fmt: skip


def summary(report: dict[str, Any]) -> str:
    """A report in a few lines for people."""
    splits = ", ".join(f"{name} {count}" for name, count in report["splits"].items() if count)
    lines = [
        f"{report['out']}: {report['episodes']} of {report['asked']} episodes (in the folder: {splits})",
        f"{report['seconds']:.0f} s with {report['workers']} workers, {report['episodes_per_hour']:.0f} episodes/h"
        if report["episodes_per_hour"]
        else "nothing was left to be done",
    ]
    if report.get("left_out"):
        lines.append(f"{report['left_out']} left out by --test-episodes and --train-episodes")
    if early := report["presses_ended_early"]:
        lines.append(
            f"{len(early)} presses ended early, where no equilibrium was found further on (ended_early in their rows): {early[:20]}"
        )
    if report["failed"]:
        first = report["failures"][0]
        lines.append(f"{report['failed']} failed (meta/failures.jsonl), such as {first['index']}: {first['status']}, {first['message']}")
    return "\n".join(lines)


def failure(catalogue: Catalogue, number: int, ends: Sequence[int], status: str, message: str) -> dict[str, Any]:
    """The line of meta/failures.jsonl of a press's first missing episode; the others of the press follow by index."""
    index = number * len(catalogue.plan.end_points)
    return {"index": index + ends[0], "indices": [index + end for end in ends], "seed": catalogue.seed, "press": number,
            "status": status, "message": message}  # fmt: skip


# ---- in a worker ----


def make_worker(plan: str, seed: int, out: Path, todo: dict[int, list[int]], device: str, light: bool = True) -> Callable[[Handful], Done]:
    """What a worker process does with presses: mechanics, light, files."""
    catalogue, studio = Catalogue(load_plan(plan), seed), Studio(device) if light else None

    def work(handful: Handful) -> Done:
        done = Done(handful)
        try:
            for press in map(catalogue.press, handful):
                ends, start, drawing = todo[press.number], time.perf_counter(), 0.0
                try:
                    solved = recording.solve(press, device)
                except recording.PressFailed as failed:
                    done.failures.append(failure(catalogue, press.number, ends, failed.status, str(failed)))
                    continue
                mechanics, start = time.perf_counter() - start, time.perf_counter()
                for end in ends:
                    made = recording.record(catalogue, press, end, solved.motion, studio, solved.short)
                    drawing += time.perf_counter() - start
                    path = write_episode(out, made.episode, made.members)
                    done.rows.append((made.episode.row, sums_of(path)))
                    start = time.perf_counter()
                done.seconds.append({
                    "press": press.number, "shape": press.scene.object.shape, "episodes": len(ends), "states": len(solved.motion.approach),
                    "mechanics": round(mechanics, 3), "light": round(drawing, 3), "stages": solved.seconds,
                })  # fmt: skip
        except GelsimError as error:
            done.error = str(error)
        return done

    return work


def gpus_of(device: str) -> list[str]:
    """CUDA devices that this process may use, by the names that CUDA_VISIBLE_DEVICES knows; none where the system does not list them."""
    if device != "cuda":
        return []
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [name for name in visible.split(",") if name]
    return [node.name.removeprefix("nvidia") for node in sorted(Path("/dev").glob("nvidia[0-9]*"))]


def sums_of(path: Path) -> dict[str, Any]:
    from gelsim.data.episodes import read_members

    return json.loads(read_members(path, ["row.json"])["row.json"])["sums"]


def sensors_of(catalogue: Catalogue, presses: Iterable[int]) -> list[int]:
    """Those of the pool that some presses are seen by."""
    seen: set[int] = set()
    for number in presses:  # each is drawn whole, milliseconds: not more of them than there is need
        seen.add(catalogue.press(number).sensor)
        if len(seen) == catalogue.plan.sensors:
            break
    return sorted(seen)


def measure_lights(sensors: list[Scene], device: str, progress: Progress | None) -> None:
    """Light fields that are not in the cache yet: before the workers start, for each takes all cores."""
    missing = [scene for scene in sensors if not is_measured(scene)]
    for done, scene in enumerate(missing):
        if progress:
            progress("light fields", done, len(missing))
        Studio(device).field(scene)
    if missing and progress:
        progress("light fields", len(missing), len(missing))


# ---- the folder ----


class Book:
    """What is done, in memory and in meta/."""

    def __init__(self, out: Path, info: dict[str, Any], resume: bool) -> None:
        self.out, self.info = out, info
        self.rows: dict[int, dict[str, Any]] = {}
        self.sums: dict[int, dict[str, Any]] = {}
        self.failures: dict[int, dict[str, Any]] = {}
        if out.exists() and not out.is_dir():
            raise SceneError(f"--out {out}: is a file, not a folder")
        try:
            filled = out.is_dir() and any(out.iterdir())
        except OSError as error:
            raise SceneError(f"--out {out}: cannot be read ({error.strerror})") from None
        if filled:
            self._resume(resume)
        self._written = time.monotonic()

    def _resume(self, resume: bool) -> None:
        if not resume:
            raise SceneError(f"--out {self.out}: the folder is not empty; give --resume to go on, or another name")
        path = self.out / "meta" / "info.json"
        try:
            earlier = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise SceneError(f"--resume {self.out}: holds files but no dataset ({error}); give another folder") from None
        for name in ("schema", "plan", "plan_sha256", "seed", "light_of", "sensor", "resolution"):
            if earlier.get(name) != ({"schema": SCHEMA} | self.info).get(name):
                told = "the plan has changed since" if name == "plan_sha256" else f"its {name} is {earlier.get(name)!r}"
                raise SceneError(f"--resume {self.out}: {told}; give another folder")
        found = survey(self.out)
        self.rows = {row["index"]: row for row in found.rows}
        self.sums = found.sums
        try:
            lines = (self.out / "meta" / "failures.jsonl").read_text(encoding="utf-8").splitlines()
            kept = [row for row in map(json.loads, lines) if row["status"] in NUMERICAL]
        except (OSError, ValueError, KeyError) as error:
            raise SceneError(f"--resume {self.out}: meta/failures.jsonl is damaged ({error}); remove it") from None
        self.failures = {row["index"]: row for row in kept}

    @property
    def known(self) -> set[int]:
        """Episodes that need no work: done, or known to fail."""
        return set(self.rows) | set(self.failures)

    def count(self, asked: Collection[int]) -> int:
        """How many of some episodes are done or failed."""
        return sum(index in asked for index in self.known)

    def add(self, done: Done) -> None:
        for row, sums in done.rows:
            self.rows[row["index"]], self.sums[row["index"]] = row, sums
            self.failures.pop(row["index"], None)
        for item in done.failures:
            for index in item["indices"]:
                self.failures[index] = {key: value for key, value in item.items() if key != "indices"} | {"index": index}
        if done.seconds:
            self._note(done.seconds)
        if done.failures or time.monotonic() - self._written > MANIFEST_SECONDS:
            self.write()

    def splits(self) -> dict[str, list[int]]:
        return {name: [index for index, row in sorted(self.rows.items()) if row.get("split") == name] for name in SPLITS}

    def write(self, quietly: bool = False) -> None:
        """Writes meta/. `quietly`: after an error, which is the one to be told."""
        rows = [self.rows[index] for index in sorted(self.rows)]
        try:
            write_meta(self.out, self.info, Survey(rows, self.sums), self.failures.values(), self.splits())
        except DatasetError:
            if not quietly:
                raise
        self._written = time.monotonic()

    def _note(self, seconds: Iterable[dict[str, Any]]) -> None:
        try:
            with (self.out / "meta" / "seconds.jsonl").open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(row) + "\n" for row in seconds)
        except OSError as error:
            raise DatasetError(f"{self.out}/meta/seconds.jsonl: cannot be written ({error.strerror})") from None


def kept_plan(folder: Path) -> Path:
    """Where a dataset keeps the plan that it was made from: whoever draws its light later needs nothing else."""
    return folder / "meta" / "plan.json"


def keep_plan(catalogue: Catalogue, out: Path) -> None:
    """Raises DatasetError where it cannot be written."""
    path = kept_plan(out)
    try:
        with whole_file(path) as partial:
            partial.write_text(json.dumps(catalogue.plan.table, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise DatasetError(f"{path}: cannot be written ({error.strerror})") from None


def _info(catalogue: Catalogue, light: bool) -> dict[str, Any]:
    width, height = catalogue.plan.resolution if light else (0, 0)
    return {
        "domain": "sim", "fps": catalogue.sensor_scene(0).camera.fps, "resolution": [width, height], "noise": "none",
        "plan": catalogue.plan.name,
        "plan_sha256": catalogue.plan.digest, "seed": catalogue.seed,
        "versions": versions(VERSIONS_OF), "features": features(width, height),
    }  # fmt: skip


def features(width: int, height: int) -> dict[str, dict[str, Any]]:
    """What an episode holds."""
    return {
        "frames": {"dtype": "uint8", "shape": ["N", height, width, 3], "unit": "sRGB"},
        "background": {"dtype": "uint8", "shape": [height, width, 3], "unit": "sRGB"},
        "time": {"dtype": "float64", "shape": ["N"], "unit": "s"},
        "approach": {"dtype": "float64", "shape": ["N"], "unit": "m"},
        "force": {"dtype": "float64", "shape": ["N", 3], "unit": "N"},
        "marker_pixels": {"dtype": "float64", "shape": ["N", "K", 2], "unit": "px"},
        "noise": {"dtype": "float64", "shape": [3, 3], "unit": "levels of 255; electrons; share of white"},
    }
