"""Many presses of one scene: a table of poses, each a few fields of the scene, solved by processes that keep what poses share.

Kept from pose to pose: the file of a mesh, the object's surface and its distance field, compiled kernels. A gel's mesh is made for where a
pose touches, so that it and its factors are each pose's own. Workers do not share what they keep.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from gelsim.errors import GelsimError, SceneError, within
from gelsim.pipeline import outputs, stages
from gelsim.results import Deformation
from gelsim.scene.definition import Body, Press, Scene
from gelsim.scene.distributions import field_kind
from gelsim.scene.fields import field_types, nearest, parse_text
from gelsim.scene.layers import anchored, build_scene, nested, scene_table
from gelsim.tables import read_csv, write_csv
from gelsim.work.workers import Handful, LocalCrew, WorkError, check_count, work_through

NAME = "name"
"""Column that names a pose's folder; without it they are counted."""
TABLE = "poses.csv"
"""What each pose gave, in the folder of them all."""
OWN_NAME = {name: f"{section}.{name}" for section, kind in (("object", Body), ("press", Press)) for name in field_types(kind)}
"""Fields of [object] and [press] by their own name."""


@dataclass(frozen=True)
class Pose:
    """One row of a table."""

    name: str
    scene: Scene


def read_poses(path: Path, scene: Scene) -> list[Pose]:
    """The poses of a CSV file: columns are fields of the scene, cells as a flag has them ("1 2": two numbers); an empty one says nothing.

    Raises:
        SceneError: It cannot be read, names an unknown field or a name twice, or a row makes no scene; the message names the line.
    """
    header, rows = read_csv(path, f"--poses {path}")
    if not rows:
        raise SceneError(f"--poses {path}: holds no poses")
    names = {column: _full_name(column, f"--poses {path}: column {column!r}") for column in header if column != NAME}
    kinds = {name: field_kind(name, name) for name in names.values()}
    poses: list[Pose] = []
    for number, row in enumerate(rows):
        said = {names[column]: text for column, text in row.items() if column in names and text}
        with within(f"--poses {path}, line {number + 2}"):
            layer = nested({name: parse_text(text, kinds[name], name) for name, text in said.items()})
            name = row.get(NAME) or f"{number:04d}"
            if Path(name).name != name or name in (".", "..", TABLE):
                raise SceneError(f"{NAME} = {name!r}: allowed is the name of a folder")
            poses.append(Pose(name, posed(scene, anchored(layer, path.resolve().parent))))
    if twice := [pose.name for pose in poses if [other.name for other in poses].count(pose.name) > 1]:
        raise SceneError(f"--poses {path}: two poses are called {twice[0]!r}")
    return poses


def posed(scene: Scene, layer: Mapping[str, Any]) -> Scene:
    """A scene with some fields of its own, a nested table as a scene file has it."""
    return build_scene(scene_table(scene), dict(layer))


def press_many(
    scene: Scene,
    poses: Sequence[Mapping[str, Any]],
    *,
    device: str = "auto",
    workers: int = 1,
    progress: stages.Progress | None = None,
) -> list[Deformation]:
    """Solves a scene in many poses: on a CUDA device side by side where meshes are the same, else one after the other.

    A press that fails says so in its `status`.

    Args:
        poses: Of each the fields that differ, by full name ("press.offset_mm"); those of [object] and [press] by their own name too.
        workers: Processes that share the poses on the CPU, each on one thread; a script of several calls it under
            `if __name__ == "__main__"`.
    Raises:
        SceneError: A pose names an unknown field or makes no scene. SceneError, MeshingError: as `press`. WorkError: a worker died.
    """
    check_count(workers)
    scenes = []
    for number, pose in enumerate(poses):
        with within(f"pose {number + 1} of {len(poses)}"):
            scenes.append(posed(scene, nested({_full_name(name, repr(name)): value for name, value in pose.items()})))
    from gelsim.fem import batch_device, quiet_warp

    quiet_warp()
    if batch_device(device) != "cpu":
        return stages.press_batch(scenes, device=device, progress=progress)
    found: dict[int, Deformation] = {}
    for number, press in _spread(range(len(scenes)), workers, partial(_press_one, scenes)):
        if isinstance(press, GelsimError):
            raise press
        found[number] = press
        if progress is not None:
            progress("poses", len(found), len(scenes))
    return [found[number] for number in range(len(scenes))]


def run_many(
    poses: Sequence[Pose],
    out: Path,
    run: Callable[[Scene, Path], dict[str, Any]],
    *,
    drawn: bool = False,
    force: bool = False,
    resume: bool = False,
    workers: int = 1,
    progress: stages.Progress | None = None,
) -> dict[str, Any]:
    """Runs poses, each into a folder of `out` with its name, and writes a table of what they gave.

    Args:
        run: Computes a scene into a folder and returns its report, as `stages.run`; for several workers it can be pickled.
        drawn: Whether it draws pictures.
        force: Replaces results of poses. resume: Leaves out poses that were done, as their reports say.
        workers: Processes that share the poses, each on one thread.
    Raises:
        SceneError: `out` holds results and neither was given.
    """
    check_count(workers)
    if out.exists() and any(out.iterdir()) and not (force or resume):
        raise SceneError(f"--out {out}: the folder is not empty; give --force to replace results in it, --resume to go on, or another name")
    start, rows, failed = time.perf_counter(), {}, {}

    def add(number: int, report: dict[str, Any] | GelsimError) -> None:
        row: dict[str, Any] = {NAME: poses[number].name}
        if isinstance(report, GelsimError):  # one pose that cannot be is no reason to leave the others
            row["status"] = failed[number] = str(report)
        else:
            final = report["final"]
            row |= {name: final[name] for name in ("approach_mm", "normal_force_n", "contact_area_mm2")}
            row |= {"status": report["status"], "seconds": report["seconds"]["total"], "warnings": len(report["warnings"])}
        rows[number] = row
        if out.is_dir():
            write_csv(out / TABLE, [rows[done] for done in sorted(rows)])
        if progress is not None:
            progress("poses", len(rows), len(poses))

    for number, pose in enumerate(poses if resume else ()):
        if (report := _earlier(pose, out, drawn)) is not None:
            add(number, report)
    left = [number for number in range(len(poses)) if number not in rows]
    ahead = 1 if drawn else 0  # here, alone: it measures the sensor's light, which the others find
    for some, several in ((left[:ahead], 1), (left[ahead:], workers)):
        for number, report in _spread(some, several, partial(_run_one, poses, out, run)):
            add(number, report)
    seconds, made = time.perf_counter() - start, len(left) - len(failed)
    return {
        "out": str(out),
        "poses": len(poses),
        "failed": [{"pose": poses[number].name, "message": failed[number]} for number in sorted(failed)],
        "seconds": round(seconds, 3),
        "made": made,
        "seconds_a_pose": round(seconds / made, 3) if made else None,
    }


T = TypeVar("T")


def _spread(numbers: Sequence[int], workers: int, work: Callable[[int], T]) -> Iterator[tuple[int, T | GelsimError]]:
    """Does numbered pieces, in this process or in several; yields each as it is done, with its number, or what was wrong with it."""
    pieces = [(number,) for number in numbers]
    if min(workers, len(pieces)) < 2:
        yield from map(_make_worker(work), pieces)
        return

    def lost(handful: Handful, status: str, message: str) -> tuple[int, T | GelsimError]:
        return handful[0], WorkError(f"{status}: {message}")

    yield from work_through(pieces, LocalCrew(workers), _make_worker, (work,), lost)


def _make_worker(work: Callable[[int], T]) -> Callable[[Handful], tuple[int, T | GelsimError]]:
    def one(handful: Handful) -> tuple[int, T | GelsimError]:
        try:
            return handful[0], work(handful[0])
        except GelsimError as error:
            return handful[0], error

    return one


def _press_one(scenes: Sequence[Scene], number: int) -> Deformation:
    return stages.press(scenes[number], device="cpu", throw=False)


def _run_one(poses: Sequence[Pose], out: Path, run: Callable[[Scene, Path], dict[str, Any]], number: int) -> dict[str, Any]:
    return run(poses[number].scene, out / poses[number].name)


def _earlier(pose: Pose, out: Path, drawn: bool) -> dict[str, Any] | None:
    """The report of a pose that was done before, with pictures where they are `drawn`; None where it is to be done."""
    try:
        report = json.loads((out / pose.name / "report.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    same = report.get("scene") == outputs.plain_json(scene_table(pose.scene)) and "error" not in report
    return report if same and (not drawn or "video" in report) else None


def _full_name(name: str, where: str) -> str:
    full = name if "." in name else OWN_NAME.get(name, name)
    if full not in OWN_NAME.values():
        if "." not in full and full not in field_types(Scene):
            raise SceneError(f"{where}: unknown field{nearest(name, [*OWN_NAME, *field_types(Scene)])}")
        field_kind(full, where)
    return full
