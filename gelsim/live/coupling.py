"""A gel in the step of a robot's simulator: what `gelsim.live.mujoco` and `gelsim.live.newton` share.

A sensor is asked at the pose that a step starts from: in each step, or with a `period` when its last answer is so old, or the cells' forces
have changed by CHANGE of the normal force since.

A gel is stiff: 10 g on 3 N/mm swing faster than steps of 2 ms can follow. So the force is the one that the gel will have at the step's end,
F = F₀ + K h v⁺, with F₀ and K of `gelsim.live.patch` and v⁺ = v* + R (F - F*). v* and R are the simulator's own: trial steps with the last
force F*, and with F* changed by a little in each of its six numbers, show what velocity follows; R is as of the last answer. So joints,
actuators and other contacts are in R, and where nothing moves F is F₀ exactly. A step that leads into the gel from the air, or to twice the
forces, takes F₀ and K of its end instead (`Gel.ahead`).

Left out: what pads on one gel or objects on one pad do to each other; deformable bodies; contact of a pad with anything but its object is
the simulator's own, with the box at rest. The implicit step takes energy out of fast motion, as an elastic gel would not.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from gelsim.errors import SceneError
from gelsim.live.patch import Patch
from gelsim.live.sensor import LiveFrame, LiveSensor
from gelsim.scene.definition import Body, Scene
from gelsim.shape.shapes import load_mesh
from gelsim.units import MM, MM_PER_M

Array = NDArray[np.float64]

GEL_DENSITY = 1e3
"""Of silicone [kg/m³]."""
GEL_COLOUR = 0.75, 0.75, 0.8
CHANGE = 0.1
"""Of the cells' forces, over the normal force, up to which an answer of the gel goes on by its stiffness."""
CORRECTIONS = 4
"""Of the place where a step into the gel ends, at most: with 0, 1, 2, 3 and 8 a ball of 0.1 g is thrown out with 6.8, 6.3, 1.2, 0.3 and 0.3
of its speed, one of 5 g with 0.6 with any."""
ROUND = 4
"""Subdivisions of an icosahedron for a ball: its facets lie R/900 deeper at most."""
ROUNDED = 0.0125
"""Edge radius that an object without an edge is sampled for, over its narrowest extent."""
AWAY = 1.0
"""From which on it does not matter how far the object is [m]."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Of a gel, and how it goes on: motions (6,) of the object from where the gel was asked."""

    patch: Patch
    gone: Array
    """To where the step begins."""
    about: Array
    """To where its force is linearised."""

    def wrench(self) -> Array:
        """At the step's begin by the line, (6,)."""
        return self.patch.wrench(self.about) + self.patch.stiffness @ (self.gone - self.about)


class Gel:
    """A sensor and the body that touches it. Poses are those of the object in the gel's frame, as the sensor takes them, (7,)."""

    def __init__(self, scene: Scene, name: str, solids: Sequence[trimesh.Trimesh], smooth: bool) -> None:
        """Makes the live sensor: seconds.

        Args:
            scene: Its gel, contact, camera, lights, coating and markers count; its object and its press do not.
            name: Of the body, for an error.
            solids: The surfaces that together are its shape, in its frame [m].
            smooth: They have no edge.
        Raises:
            SceneError: There are no solids.
        """
        if not solids:
            raise SceneError(f'body = "{name}": it has no geom that bounds a solid: sphere, ellipsoid, box, capsule, mesh, cylinder')
        whole: trimesh.Trimesh = trimesh.util.concatenate(list(solids))  # type: ignore[assignment]
        whole.apply_scale(MM_PER_M)
        # What has no edge is sampled as its radius asks, not as a rim would: a fifth of the time for an egg.
        radius = max(0.1, ROUNDED * float(np.ptp(whole.vertices, axis=0).min())) if smooth else None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "object.stl"
            whole.export(path)
            shape = Body(shape="mesh", mesh=str(path), rigid=True, edge_radius_mm=radius)
            vertices = load_mesh(shape).vertices
            self.sensor = LiveSensor(scene.replace(object=shape), image=False)
        self._origin = whole.vertices.min(axis=0) * MM - vertices.min(axis=0)  # of gelsim's object in the body's frame [m]
        self._size = float(np.linalg.norm(np.ptp(vertices, axis=0)))  # its diagonal [m]
        self.frame: LiveFrame | None = None
        """The gel's last answer; its image is None, see `image`."""
        self.patch: Patch | None = None
        """How its force goes on from there."""
        self._asked, self._place = 0.0, np.zeros(7)
        self.wrench = np.zeros(6)
        """Force [N] and torque [N m] about the gel's origin on the gel by the object in the last step, in the gel's frame."""

    def image(self) -> NDArray[np.uint8]:
        """The picture of the gel's last answer, 8-bit sRGB, shape (H, W, 3). The first of a sensor measures its light: seconds."""
        return self.sensor.image()

    def reset(self) -> None:
        """Forgets slip and force: call it where the simulation is reset."""
        self.sensor.reset()
        self.frame, self.patch, self.wrench = None, None, np.zeros(6)

    @property
    def state(self) -> tuple[Any, ...]:
        """What gel and object are at, to return to: whole, and never changed."""
        return self.sensor.state, self.frame, self.patch, self.wrench, self._asked, self._place

    @state.setter
    def state(self, kept: tuple[Any, ...]) -> None:
        self.sensor.state, self.frame, self.patch, self.wrench, self._asked, self._place = kept

    def look(self, pose: Array, time: float, period: float) -> Answer:
        """Asks the gel, if its answer does not hold any more.

        It holds where the object touches, for a period [s] and while the cells' forces have changed by less than CHANGE.
        """
        if self.patch is not None and len(self.patch.points) and time - self._asked < period - 1e-9:
            w, x, y, z = self._place[3:].tolist()
            turn = _product(pose[3:].tolist(), (w, -x, -y, -z))
            motion = np.concatenate([pose[:3] - _turned(self._place[:3].tolist(), turn), _rotation(turn)])
            if self.patch.changed(motion) < CHANGE:
                return Answer(self.patch, motion, motion)
        self.frame, self.patch = self.sensor.step(pose, max(time - self._asked, 1e-9)), self.sensor.patch()
        self._asked, self._place = time, pose
        return Answer(self.patch, motion := np.zeros(6), motion)

    def ahead(self, pose: Array, answer: Answer, motion: Array) -> Answer:
        """The answer at the end of a motion (6,) that leads into the gel from the air, or to twice the forces known; else the one given.

        What nothing brakes on its way in would be thrown out faster than it came, if it is light.
        """
        if len(answer.patch.points):
            if answer.patch.changed(answer.gone + motion) < (1.0 if answer.about is answer.gone else CHANGE):
                return answer
        elif self.sensor.clearance > np.linalg.norm(motion[:3]) + np.linalg.norm(motion[3:]) * (np.linalg.norm(pose[:3]) + self._size):
            return answer
        turn = _quaternion(motion[3:].tolist())
        end = np.clip(_turned(pose[:3].tolist(), turn) + motion[:3], -AWAY, AWAY)
        patch = self.sensor.ahead(np.concatenate([end, _product(turn, pose[3:].tolist())]))
        return Answer(patch, -motion, np.zeros(6)) if len(patch.points) else answer


class Coupling:
    """Gels in one simulation: what wrenches a step exerts on them."""

    probe = 1e-3, 1e-5
    """Change of a force [N] and of a torque [N m] whose effect a trial step shows."""

    def __init__(self, pads: Iterable[Gel], period: float) -> None:
        """Takes the pads.

        Args:
            period: Time [s] between answers of a gel that touches, in which its force goes on by its stiffness; 0 asks it each step.
        """
        self._gels, self.period = list(pads), period
        self._response: Array = np.zeros(0)

    def reset(self) -> None:
        """After a reset of the simulation, or a new state: no pad remembers anything."""
        for gel in self._gels:
            gel.reset()

    def _settle(self, poses: Sequence[Array], time: float, trial: Callable[[Array], Array]) -> Array:
        """Wrenches on the gels over the step that begins at a time [s], (6 pads,), which are the pads' `wrench` from now on.

        Args:
            poses: Of the objects where it begins.
            trial: From such wrenches to how the objects move in their gels' frames over the step, (6 pads,); it is undone.
        Raises:
            SceneError: An object is deeper in a gel than it answers for.
        """
        asked = [gel.patch for gel in self._gels]
        answers = [gel.look(pose, time, self.period) for gel, pose in zip(self._gels, poses, strict=True)]
        same = all(answer.patch is patch for answer, patch in zip(answers, asked, strict=True))
        motion = self._motion(trial, answers, known=same)
        for _ in range(CORRECTIONS):
            last = answers
            answers = [gel.ahead(pose, known, way) for gel, pose, known, way in zip(self._gels, poses, last, motion, strict=True)]
            if all(now is before for now, before in zip(answers, last, strict=True)):
                break
            motion = self._motion(trial, answers, known=False)
        for gel, answer, way in zip(self._gels, answers, motion, strict=True):
            gel.wrench = answer.patch.wrench(answer.gone + way)
        return np.concatenate([gel.wrench for gel in self._gels])

    def _motion(self, trial: Callable[[Array], Array], answers: list[Answer], known: bool) -> Array:
        """Of the objects in their gels' frames over the step, (pads, 6); `known`: they move by a wrench as they did in the last step."""
        touching = np.repeat([len(answer.patch.points) > 0 for answer in answers], 6)
        last = np.concatenate([gel.wrench for gel in self._gels]) * touching
        motion = trial(last)
        if touching.any():
            if not known:
                self._response = np.zeros((len(last), len(last)))  # of the motion to the wrenches
                for column in np.flatnonzero(touching):
                    probe = self.probe[column % 6 // 3] * (np.arange(len(last)) == column)
                    self._response[:, column] = (trial(last + probe) - motion) / probe[column]
            stiff: Array = np.asarray(block_diag(*(answer.patch.stiffness for answer in answers)))
            now = np.concatenate([answer.wrench() for answer in answers])
            # wrench = now + stiff motion and motion = that of the last wrench + response (wrench - last), solved for both
            motion += self._response @ np.linalg.solve(np.eye(len(last)) - stiff @ self._response, now + stiff @ motion - last)
        return motion.reshape(-1, 6)


def gel_box(scene: Scene) -> Array:
    """Half the gel's extents [m], (3,): the box that stands for it where the simulator itself sees it."""
    width, length = scene.gel.size_mm
    return np.array([width, length, scene.gel.thickness_mm]) * MM / 2


def lever(turn: Array, arm: Array) -> Array:
    """From a wrench in a frame turned by (3, 3) to the world's axes, about a point from which its origin is an arm (3,) away: (6, 6).

    Transposed it takes the point's velocities to those of the frame's origin.
    """
    x, y, z = arm
    found = np.zeros((6, 6))
    found[:3, :3] = found[3:, 3:] = turn
    found[3:, :3] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    return found


def unknown(kind: str, name: str, names: Iterable[str | None]) -> SceneError:
    """That a model has no site, body or shape of a name."""
    return SceneError(f'{kind} = "{name}": the model has no such {kind}; it has {", ".join(filter(None, names)) or "none with a name"}')


def solid(kind: str, size: ArrayLike) -> trimesh.Trimesh:
    """The surface of a primitive about its middle [m].

    Args:
        kind: "ball" | "ellipsoid" | "box" | "cylinder" | "capsule"; the axis is z.
        size: Radius; half the axes; half the extents; radius and half the length, without the caps.
    """
    size = np.asarray(size, float)
    if kind in ("ball", "ellipsoid"):
        made = trimesh.creation.icosphere(ROUND)
        made.apply_scale(size if kind == "ellipsoid" else size[0])
        return made
    if kind == "box":
        return trimesh.creation.box(2 * size)
    if kind == "cylinder":
        return trimesh.creation.cylinder(size[0], 2 * size[1], sections=2**ROUND * 10)
    return trimesh.creation.capsule(2 * size[1], size[0], count=[2**ROUND * 5] * 2)


def placed(made: trimesh.Trimesh, shift: ArrayLike, turn: ArrayLike) -> trimesh.Trimesh:
    """That surface, in its body's frame: turned by a quaternion x, y, z, w, and shifted [m]."""
    place = np.eye(4)
    place[:3, :3] = Rotation.from_quat(turn).as_matrix()
    place[:3, 3] = shift
    made.apply_transform(place)
    return made


# Of quaternions w, x, y, z; in plain numbers, as arrays of four take ten times as long.


def _product(one: Sequence[float], other: Sequence[float]) -> tuple[float, ...]:
    """One turn after the other."""
    a, b, c, d = one
    w, x, y, z = other
    return (
        (a * w - b * x) + (-c * y - d * z),
        (a * x + b * w) + (c * z - d * y),
        (a * y - b * z) + (c * w + d * x),
        (a * z + b * y) + (-c * x + d * w),
    )


def _turned(vector: Sequence[float], turn: Sequence[float]) -> Array:
    """A vector, (3,)."""
    (a, b, c), (w, x, y, z) = vector, turn
    p, q, r = w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a
    return np.array([a + 2 * (y * r - z * q), b + 2 * (z * p - x * r), c + 2 * (x * q - y * p)])


def _rotation(turn: Sequence[float]) -> Array:
    """Its vector [rad], (3,), up to half a turn."""
    w, x, y, z = turn
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2 * math.atan2(sine, w)
    angle = angle - 2 * math.pi if angle > math.pi else angle
    return np.array([angle * (part * (1 / sine)) for part in (x, y, z)]) if sine else np.zeros(3)


def _quaternion(vector: Sequence[float]) -> tuple[float, ...]:
    """Of a vector [rad]."""
    angle = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    if not angle:
        return 1.0, 0.0, 0.0, 0.0
    sine = math.sin(angle * 0.5)
    return math.cos(angle * 0.5), *(part * (1 / angle) * sine for part in vector)
