"""From a plan's press to its episodes: the mechanics once, then for each end point a trajectory in time, frames and labels.

*Press.* Solved until the force or the depth that was drawn, in states about an eighth of the expected travel apart (`expected_travel`), and
kept as a `gelsim.data.motion` archive. An end point on the way is a shorter press: the path to it is the same, tangential travel included.

*Trajectory.* Frames at the camera's rate. The robot closes at constant speed from a random phase of the frame clock, and stays where it
ends. A hand takes about the frames that were drawn; its speed is exp(σ w(t)), w smooth noise of unit variance. Between solved states the
membrane is interpolated.

Left out: release, relaxation while the object is held, hysteresis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.data import firmness
from gelsim.data.episodes import episode_file, field_seen, gel_facts
from gelsim.data.motion import Motion, pack, unpack
from gelsim.errors import MeshingError, SceneError, SolveError, SolveStatus
from gelsim.generate.light import Studio, noise_of
from gelsim.generate.plan import Catalogue, EpisodeDraw, Press
from gelsim.results import Deformation, Episode
from gelsim.scene import materials
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene, dump_scene, scene_table
from gelsim.scene.shape_table import SHAPES
from gelsim.units import MM

STATES = 8
"""Solved states of the expected travel, and at most three times as many where it is longer: what
interpolation between them is off by is in docs/datasets.md."""
LONGEST = 60
"""Frames of a slow robot's press at most."""
ENOUGH = 0.6
"""Of the wanted depth or force, whichever is nearer, at which a press that finds no equilibrium further on is kept as it is, and does not
begin again."""

FOLLOWS = ("frames", "peak_force_n", "file", "peak_approach_mm", "gel", "field_mm", "pictures")
"""What `pictured` puts into a row."""


class PressFailed(Exception):
    """A press that gave nothing; the message says why."""

    def __init__(self, status: str, message: str) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True)
class Made:
    """An episode and the files to keep with it."""

    episode: Episode
    members: dict[str, bytes]


@dataclass(frozen=True)
class Solved:
    """The mechanics of a press, and what they cost."""

    motion: Motion
    seconds: dict[str, float]
    """By stage."""
    short: str = ""
    """Why it ended before its depth and its force, where it did."""


def solve(press: Press, device: str = "cpu") -> Solved:
    """The mechanics of a press: on this process's core, or on a GPU that it shares with others.

    No two objects of a plan have the same mesh, which presses side by side in one process want; processes side by side do not.

    Args:
        device: "cpu", or "cuda", where nothing is gained without cuDSS: then it is the core too.
    Raises:
        PressFailed
    """
    from gelsim.fem import solves_on_gpu
    from gelsim.pipeline import stages

    record = stages.Record()
    where = device if solves_on_gpu() else "cpu"
    try:
        scene = resolved(press.scene)
        solved = stages.press(scene, device=where, record=record, throw=False, enough=lambda found: far_enough(found, scene))
    except (MeshingError, SolveError, SceneError) as error:
        raise PressFailed(type(error).__name__, str(error)) from error
    motion = checked(solved, press.scene)
    short = "" if solved.status is SolveStatus.CONVERGED else solved.message
    return Solved(motion, record.seconds, short)


def checked(solved: Deformation, scene: Scene) -> Motion:
    """The motion of a press that went to its end, or as far as there was an equilibrium and `ENOUGH` of the way. Raises PressFailed."""
    if solved.status is not SolveStatus.CONVERGED and not far_enough(solved, scene):
        raise PressFailed(solved.status.name, solved.message)
    motion = Motion.of_press(solved)
    if not all(np.isfinite(part).all() for part in (motion.displacement, motion.force)):
        raise PressFailed("NONFINITE", "a displacement or a force is not a finite number")
    if solved.min_jacobian.min() <= 0.0:
        raise PressFailed("INVERTED_ELEMENT", f"the smallest det F is {solved.min_jacobian.min():.3g}")
    if len(motion.approach) < 2:
        raise PressFailed("NO_MOTION", "only first touch was solved")
    return motion


def far_enough(solved: Deformation, scene: Scene) -> bool:
    """Whether the last state is `ENOUGH` of what ends the press: its depth or its force, the nearer."""
    press = scene.press
    assert press.depth_mm is not None, "a plan gives every press a depth"
    by_depth = float(solved.approach[-1]) / MM / press.depth_mm
    return by_depth >= ENOUGH or (press.force_n is not None and float(-solved.force[-1, 2]) >= ENOUGH * press.force_n)


def resolved(scene: Scene) -> Scene:
    """With as many states as the press is expected to need; tangential travel stays in proportion to approach."""
    assert scene.press.depth_mm is not None, "a plan gives every press a depth"
    travel = min(scene.press.depth_mm, expected_travel(scene) / MM)
    states = min(max(round(STATES * scene.press.depth_mm / travel), STATES), 3 * STATES)
    return scene.replace(press=replace(scene.press, frames=states + 1))


def expected_travel(scene: Scene) -> float:
    """Rough approach [m] at which the press reaches its force, to space the states by; within a factor of two.

    Gel: a parabola on a bonded incompressible layer (Dimitriadis et al. 2002). Object: Hertz, and the compression of its column. In series.
    """
    force = scene.press.force_n
    if force is None:
        return np.inf
    body, row, layer = scene.object, SHAPES[scene.object.shape], scene.gel.thickness_mm * MM
    radius = (body.radius_mm if row.tip_mm is None else row.tip_mm) * MM
    dome = 57e-3
    across = 1.0 / (1.0 / radius + 1.0 / dome)
    along = dome if row.ridge else across
    curved = np.sqrt(across * along)
    depths = np.geomspace(1e-5, 2e-2, 200)
    gel = materials.gel_material(scene).youngs_modulus
    chi = np.sqrt(curved * depths) / layer
    pressed = (16 / 9) * gel * np.sqrt(curved) * depths**1.5 * (1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4)
    travel = np.interp(force, pressed, depths)
    solids = materials.object_materials(scene)
    if "body" in solids:
        soft = solids["body"].youngs_modulus
        wide = min(2 * radius, 25e-3) if row.has_radius else (body.width_mm or row.width_mm) * MM
        travel += (force / ((16 / 9) * soft * np.sqrt(curved))) ** (2 / 3) + 0.5 * force * body.height_mm * MM / (
            soft * wide * min(wide, 25e-3)
        )
    return float(travel)


def record(catalogue: Catalogue, press: Press, end: int, motion: Motion, studio: Studio | None, short: str = "") -> Made:
    """Episode `end` of a press: its motion up to an end point, as its sensor sees it; without a studio in the dark.

    Args:
        short: Why the press ended early (`Solved.short`); noted in the row as `ended_early`.
    """
    draw = catalogue.episode(press, end)
    scene = build_scene(scene_table(press.scene), draw.layer)
    far = draw.end * float(motion.approach[-1])
    approach = trajectory(press.group.motion, far, press.scene.press.speed_mm_s * MM, scene.camera.fps, draw)
    body = press.scene.object
    duration = max(np.count_nonzero(approach > 0), 1) / scene.camera.fps
    speed = float(np.clip(far / MM / duration, 1e-3, 1000.0))
    told = scene.replace(press=replace(scene.press, depth_mm=far / MM, force_n=None, speed_mm_s=speed))
    stiffness = firmness.stiffness(body)
    row = {
        "index": draw.index, "object": press.object.name, "group": press.group.number, "shape": body.shape,
        "radius_mm": body.radius_mm if SHAPES[body.shape].has_radius else None,
        "shore_00": firmness.shore_00(body), "rigid": body.rigid,
        "stiffness_n_mm": None if stiffness is None else round(stiffness, 6),
        "motion": press.group.motion, "domain": "sim", "mechanics": f"{press.number:06d}",
        "sensor": f"{scene.sensor.preset}-{press.sensor}", "body_shore_00": None if body.rigid else body.shore_00, "split": press.split,
    } | ({"ended_early": short} if short else {})  # fmt: skip
    return pictured(told, press.scene, pack(motion.until(far)), approach, row, studio)


def pictured(
    scene: Scene, sensor: Scene, mechanics: bytes, approach: NDArray[np.float64], row: dict[str, Any], studio: Studio | None
) -> Made:
    """An episode from its mechanics archive: what is drawn comes out of the archive, so it can be drawn again.

    Args:
        sensor: The scene with the lights that a light field is measured with.
        approach: Of every frame [m], shape (N,).
        row: Without what FOLLOWS from mechanics and pictures.
        studio: None draws nothing: an episode without pictures and markers, whose light is drawn later.
    """
    motion = unpack(mechanics)
    places, where = np.unique(approach, return_inverse=True)
    displacement, force = motion.at(places)
    if studio is None:
        images, pixels = [np.zeros((0, 0, 3), np.uint8)] * len(places), np.zeros((len(places), 0, 2))
    else:
        from gelsim.optics.camera import marker_pixels

        membranes = studio.membranes(scene, motion.rest, displacement)
        images = studio.pictures(scene, sensor, membranes)
        pixels = np.stack([marker_pixels(scene, membrane) for membrane in membranes])
    row = row | {
        "frames": len(approach), "peak_force_n": round(float(-force[:, 2].min()), 6), "file": episode_file(row["index"]),
        "peak_approach_mm": round(float(places[-1]) / MM, 6), "gel": gel_facts(scene.gel), "field_mm": field_seen(scene),
        **({"pictures": False} if studio is None else {}),
    }  # fmt: skip
    assert places[0] == 0.0, "the first frame is before first touch"
    frames = np.stack([images[i] for i in where])
    seconds = np.arange(len(frames)) / scene.camera.fps
    episode = Episode(frames, images[0], seconds, approach, force[where], pixels[where], row, noise_of(scene.camera))
    return Made(episode, {"scene.toml": dump_scene(scene).encode(), "mechanics.npz": mechanics})


def trajectory(motion: str, end: float, speed: float, fps: float, draw: EpisodeDraw) -> NDArray[np.float64]:
    """Approach [m] of every frame, shape (N,): 0 before first touch.

    Args:
        speed: Of a robot [m/s].
    """
    rng, before = draw.rng, np.zeros(max(draw.lead, 1))
    if motion == "robot":
        phase = rng.random()
        count = min(int(np.ceil(end / speed * fps + phase)), LONGEST)
        moving = np.minimum((np.arange(count) + 1.0 - phase) * speed / fps, end)
    else:
        count = max(draw.frames - len(before) - draw.hold, 2)
        moving = end * _uneven(count, draw.unevenness, rng)
    after = np.full(max(draw.hold, draw.frames - len(before) - count), end)
    return np.concatenate([before, moving, after])


def _uneven(count: int, deviation: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Shares of the travel done by the end of each of `count` frames: 16 steps a frame, the speed's noise a sum of four slow waves."""
    t = (np.arange(16 * count) + 0.5) / (16 * count)
    waves = rng.standard_normal((2, 4))
    turns = 2 * np.pi * np.outer(np.arange(1, 5) * 0.75, t)
    noise = (waves[0] @ np.cos(turns) + waves[1] @ np.sin(turns)) / 2.0
    done = np.cumsum(np.exp(deviation * noise)).reshape(count, 16)[:, -1]
    return done / done[-1]
