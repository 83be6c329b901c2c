"""`gelsim dataset --light-of DIR [--sensor NAME]`: the presses of a dataset seen by another sensor; no finite elements are solved.

Every episode keeps its mechanics (`gelsim.data.motion`): gel, motion, force and time stay, light, coat, camera and markers are the new
sensor's, with what the plan draws by episode drawn anew. A light field is measured for each shape of gel in the dataset, once.

Without a sensor the pictures are those of the plan's own, which a dataset made with `--no-light` lacks: the same files, byte for byte, as
if they had been drawn at once.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.data.episodes import Dataset, load_dataset, unpacked, write_episode
from gelsim.errors import GelsimError, SceneError
from gelsim.generate import recording
from gelsim.generate.done import Done
from gelsim.generate.light import Studio, scene_of
from gelsim.generate.plan import EPISODE, Catalogue, generator, load_plan
from gelsim.generate.run import HERE, Book, Hands, Progress, features, kept_plan, measure_lights, report_of, sensors_of, sums_of
from gelsim.scene.definition import Scene
from gelsim.scene.distributions import draw_fields
from gelsim.scene.layers import build_scene, scene_table
from gelsim.work.workers import Handful, WorkError, work_through

SEEN = ("camera", "lights", "coating", "markers")
"""What the new sensor brings."""


def relight(
    source: Path,
    sensor: str | None,
    out: Path,
    *,
    plan: str | None = None,
    seed: int = 0,
    hands: Hands = HERE,
    resume: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Makes a dataset of another sensor's pictures; returns what the command reports.

    Args:
        source: A simulated dataset.
        sensor: A preset, or the path of a sensor file; None: those of the source's plan.
        plan: Draws what an episode may change; that of the source by default.
    Raises:
        SceneError, DatasetError: as `gelsim.generate.run.generate`.
    """
    crew = hands.crew(solves=False)
    data = load_dataset(source)
    if data.info.get("domain") != "sim":
        raise SceneError(f"--light-of {source}: its domain is {data.info.get('domain')!r}; only simulated episodes keep their mechanics")
    name = plan or plan_of(data)
    if sensor is None:
        catalogue = own_catalogue(data, name)
        width, height = catalogue.plan.resolution
        seen = sensors_of(catalogue, dict.fromkeys(int(row["mechanics"]) for row in data.rows))
        scenes = [catalogue.sensor_scene(number) for number in seen]
        seed = catalogue.seed
    else:
        load_plan(name)
        of_gel = {scene.gel: scene for scene in (sensor_scene(data, position, sensor) for position in range(len(data)))}
        scenes = list(of_gel.values())
        width, height = scenes[0].render.resolution if scenes else (0, 0)
    light = {"light_of": {"seed": data.info.get("seed"), "plan_sha256": data.info.get("plan_sha256")}, "sensor": sensor}
    drawn = {"resolution": [width, height], "features": features(width, height), "seed": seed}
    book = Book(out, data.info | light | drawn, resume)
    start = time.perf_counter()
    todo = [position for position, row in enumerate(data.rows) if row["index"] not in book.known]
    before = len(data) - len(todo)
    book.write()
    if todo:
        measure_lights([scene for scene in scenes if scene.render.mode == "baked"], hands.device, progress)

        def lost(handful: Handful, status: str, message: str) -> Done:
            return Done(handful, failures=[
                {"index": data.rows[p]["index"], "indices": [data.rows[p]["index"]], "seed": seed, "press": int(data.rows[p]["mechanics"]),
                 "status": status, "message": message} for p in handful
            ])  # fmt: skip

        # Episodes of a press together: they share the preparation of its surface.
        of_press: dict[str, list[int]] = {}
        for position in todo:
            of_press.setdefault(data.rows[position]["mechanics"], []).append(position)
        handfuls = [tuple(positions) for positions in of_press.values()]
        arguments = (source, sensor, name, seed, out, hands.device)
        try:
            for done in work_through(handfuls, crew, make_relighter, arguments, lost, still=hands.device == "cuda"):
                book.add(done)
                if done.error:
                    raise WorkError(done.error)
                if progress:
                    progress("episodes", len(book.known), len(data))
        except BaseException:
            book.write(quietly=True)
            raise
        book.write()
    return report_of(book, out, {row["index"] for row in data.rows}, before, crew.count, time.perf_counter() - start)


def plan_of(data: Dataset) -> str:
    """What `load_plan` finds a dataset's plan by: the file that it keeps, else (an older one) the name of a plan that comes along."""
    kept = kept_plan(data.folder)
    return str(kept) if kept.is_file() else str(data.info.get("plan"))


def own_catalogue(data: Dataset, plan: str) -> Catalogue:
    """The plan that a dataset was made from, as it was then. Raises SceneError."""
    if data.info.get("light_of") is not None:
        raise SceneError(f"--light-of {data.folder}: is drawn from another dataset already; give --sensor NAME, or that dataset")
    catalogue = Catalogue(load_plan(plan), int(data.info.get("seed", 0)))
    if catalogue.plan.digest != data.info.get("plan_sha256"):
        raise SceneError(f"--light-of {data.folder}: the plan {plan} is not what it was made from; give that by --plan, or --sensor NAME")
    return catalogue


def sensor_scene(data: Dataset, position: int, sensor: str) -> Scene:
    """An episode's scene with another sensor's eye."""
    scene = scene_of(data.member(position, "scene.toml"))
    other = build_scene({"sensor": {"preset": sensor}})
    seen = {name: getattr(other, name) for name in SEEN}
    # The camera has to stand behind window and gel whichever gel that is.
    return scene.replace(sensor=dataclasses.replace(scene.sensor, preset=sensor), **seen)


def make_relighter(source: Path, sensor: str | None, plan: str, seed: int, out: Path, device: str) -> Callable[[Handful], Done]:
    """What a worker process does with episodes: light, files."""
    data, catalogue, studio = load_dataset(source), Catalogue(load_plan(plan), seed), Studio(device)

    def work(handful: Handful) -> Done:
        done = Done(handful)
        try:
            for position in handful:
                start = time.perf_counter()
                made = relit_episode(data, position, sensor, catalogue, studio)
                path = write_episode(out, made.episode, made.members)
                done.rows.append((made.episode.row, sums_of(path)))
                done.seconds.append({"episode": made.episode.row["index"], "light": round(time.perf_counter() - start, 3)})
        except GelsimError as error:
            done.error = str(error)
        return done

    return work


def relit_episode(
    data: Dataset, position: int, sensor: str | None, catalogue: Catalogue, studio: Studio, resolution: tuple[int, int] | None = None
) -> recording.Made:
    """One episode, drawn again; `resolution` in place of its scene's."""
    row = data.rows[position]
    kept = {key: value for key, value in row.items() if key not in recording.FOLLOWS}
    if sensor is None:
        base = catalogue.press(int(row["mechanics"])).scene
        scene = scene_of(data.member(position, "scene.toml"))
    else:
        base = sensor_scene(data, position, sensor)
        rng = generator(catalogue.seed, EPISODE, row["index"], 1)
        scene = build_scene(scene_table(base), draw_fields(catalogue.plan.episode_fields, rng, row["index"], base))
        kept["sensor"] = sensor
    if resolution is not None:
        scene = scene.replace(render=dataclasses.replace(scene.render, resolution=resolution))
    approach = np.array(unpacked(data.member(position, "labels.npz"))["approach"])
    return recording.pictured(scene, base, data.member(position, "mechanics.npz"), approach, kept, studio)
