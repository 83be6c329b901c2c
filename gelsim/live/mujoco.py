"""Live sensors inside a MuJoCo model: the gel's force in place of MuJoCo's own contact.

    pad = add_pad(spec, spec.body("finger"), "pad", scene, against="egg")     # a body, a geom, a site; before spec.compile()
    touch = Touch(model, data, [Pad(model, "pad", "egg", scene)])
    touch.step()                                                              # instead of mujoco.mj_step(model, data)

A pad's gel is a site: z along the outward normal, the origin on the outer face. The object is a body, all of whose geoms together are its
shape. Each step applies equal and opposite wrenches at the bodies' centres of mass. A sensor is asked at the pose that a step starts from:
in each step, or with a `period` when its last answer is so old, or the cells' forces have changed by CHANGE of the normal force since.

A gel is stiff: 10 g on 3 N/mm swing faster than steps of 2 ms can follow. So the force is the one that the gel will have at the step's end,
F = F₀ + K h v⁺, with F₀ and K of `gelsim.live.patch` and v⁺ = v* + R (F - F*). v* and R are MuJoCo's own: trial steps with the last force
F*, and with F* changed by a little in each of its six numbers, show what velocity follows; R is as of the last answer. So joints, actuators
and other contacts are in R, and where nothing moves F is F₀ exactly. A step that leads into the gel from the air, or to twice the forces,
takes F₀ and K of its end instead (`Pad.ahead`). Callbacks of the model see the trial steps too.

Left out: what pads on one gel or objects on one pad do to each other; deformable bodies; contact of a pad with anything but its object is
MuJoCo's own, with the box at rest. The implicit step takes energy out of fast motion, as an elastic gel would not.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from compiled modules, whose types pyright does not know.

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
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
Pair = tuple[tuple[int, Array], tuple[int, Array]]

GEL_DENSITY = 1e3
"""Of silicone [kg/m³]."""
PROBE = 1e-3
"""Change of a force [N], and over a centimetre of a torque, whose effect a trial step shows."""
ARM = 1e-2
CHANGE = 0.1
"""Of the cells' forces, over the normal force, up to which an answer of the gel goes on by its stiffness."""
CORRECTIONS = 4
"""Of the place where a step into the gel ends, at most: with 0, 1, 2, 3 and 8 a ball of 0.1 g is thrown out with 6.8, 6.3, 1.2, 0.3 and 0.3
of its speed, one of 5 g with 0.6 with any."""
ROUND = 4
"""Subdivisions of an icosahedron for a ball: its facets lie R/900 deeper at most."""
SMOOTH = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID
ROUNDED = 0.0125
"""Edge radius that such an object is sampled for, over its narrowest extent."""
FAR = 1.0
"""From which on it does not matter how far the object is [m]."""
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def add_pad(
    spec: mujoco.MjSpec,
    parent: mujoco.MjsBody,
    name: str,
    scene: Scene,
    *,
    against: str,
    pos: ArrayLike = (0, 0, 0),
    quat: ArrayLike = (1, 0, 0, 0),
) -> mujoco.MjsBody:
    """Fixes a gel to a body of a model that is not compiled yet, and takes MuJoCo's contact with the object out.

    Args:
        parent: The body that carries it.
        name: Of the new body, its geom and its site.
        against: Name of the body that is the object.
        pos, quat: Of the middle of the gel's outer face in the parent's frame [m; w, x, y, z]; z points out of the gel.
    Returns:
        The body. As MJCF it is `<body><geom type="box"/><site/></body>` and an `<exclude>`: `spec.to_xml()` shows it.
    """
    width, length = scene.gel.size_mm
    half = np.array([width, length, scene.gel.thickness_mm]) * MM / 2
    pad = parent.add_body(name=name, pos=np.asarray(pos, float), quat=np.asarray(quat, float))
    box = mujoco.mjtGeom.mjGEOM_BOX
    pad.add_geom(name=name, type=box, size=half, pos=[0, 0, -half[2]], density=GEL_DENSITY, rgba=[0.75, 0.75, 0.8, 1])
    pad.add_site(name=name, size=[MM, MM, MM])
    spec.add_exclude(bodyname1=name, bodyname2=against)
    return pad


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


class Pad:
    """A gel on a site, and the body that it touches."""

    def __init__(self, model: mujoco.MjModel, site: str, body: str, scene: Scene) -> None:
        """Makes the live sensor: seconds.

        Args:
            site: z is the gel's outward normal, the origin the middle of its outer face at rest.
            body: The object, rigid: all of its geoms.
            scene: Its gel, contact, camera, lights, coating and markers count; its object and its press do not.
        Raises:
            SceneError: The model has no such site or body, MuJoCo's own contact of the two is not excluded, or no geom of the body
                bounds a solid.
        """
        self.site, self.object = (_index(model, kind, name) for kind, name in (("site", site), ("body", body)))
        self.body = int(model.site_bodyid[self.site])
        _check_excluded(model, self.body, self.object)
        with tempfile.TemporaryDirectory() as folder:
            shape, self._origin, self._size = _shape(model, self.object, Path(folder) / f"{body}.stl")
            self.sensor = LiveSensor(scene.replace(object=shape), image=False)
        self.frame: LiveFrame | None = None
        """The gel's last answer; its image is None, see `image`."""
        self.patch: Patch | None = None
        """How its force goes on from there."""
        self._asked, self._place = 0.0, np.zeros(7)
        self.wrench = np.zeros(6)
        """Force [N] and torque [N m] about the gel's origin on the gel by the object in the last step, in the gel's frame."""

    def image(self) -> NDArray[np.uint8]:
        """The picture of the gel's last answer, 8-bit sRGB, shape (H, W, 3). The first of a sensor measures its light: a minute or two."""
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

    def look(self, data: mujoco.MjData, period: float) -> Answer:
        """Asks the gel, if its answer does not hold any more.

        It holds where the object touches, for a period [s] and while the cells' forces have changed by less than CHANGE.
        """
        pose, motion = self.pose(data), np.zeros(6)
        if self.patch is not None and len(self.patch.points) and data.time - self._asked < period - 1e-9:
            turn, shift = np.empty(4), np.empty(3)
            mujoco.mju_negQuat(turn, self._place[3:])
            mujoco.mju_mulQuat(turn, pose[3:], turn.copy())
            mujoco.mju_rotVecQuat(shift, self._place[:3], turn)
            motion[:3] = pose[:3] - shift
            mujoco.mju_quat2Vel(motion[3:], turn, 1.0)
            if self.patch.changed(motion) < CHANGE:
                return Answer(self.patch, motion, motion)
        self.frame, self.patch = self.sensor.step(pose, max(data.time - self._asked, 1e-9)), self.sensor.patch()
        self._asked, self._place = data.time, pose
        return Answer(self.patch, motion := np.zeros(6), motion)

    def ahead(self, data: mujoco.MjData, answer: Answer, motion: Array) -> Answer:
        """The answer at the end of a motion (6,) that leads into the gel from the air, or to twice the forces known; else the one given.

        What nothing brakes on its way in would be thrown out faster than it came, if it is light.
        """
        pose = self.pose(data)
        if len(answer.patch.points):
            if answer.patch.changed(answer.gone + motion) < (1.0 if answer.about is answer.gone else CHANGE):
                return answer
        elif self.sensor.clearance > np.linalg.norm(motion[:3]) + np.linalg.norm(motion[3:]) * (np.linalg.norm(pose[:3]) + self._size):
            return answer
        turn, end = np.array([1.0, 0, 0, 0]), np.empty(7)
        mujoco.mju_quatIntegrate(turn, motion[3:], 1.0)
        mujoco.mju_rotVecQuat(end[:3], pose[:3], turn)
        end[:3] += motion[:3]
        mujoco.mju_mulQuat(end[3:], turn, pose[3:])
        patch = self.sensor.ahead(end)
        return Answer(patch, -motion, np.zeros(6)) if len(patch.points) else answer

    def pose(self, data: mujoco.MjData) -> Array:
        """Of the object in the gel's frame, as the sensor takes it: x, y, z [m], at most FAR, quaternion w, x, y, z; (7,)."""
        gel, at = data.site_xmat[self.site].reshape(3, 3), data.site_xpos[self.site]
        turn = data.xmat[self.object].reshape(3, 3)
        pose = np.empty(7)
        pose[:3] = np.clip(gel.T @ (data.xpos[self.object] + turn @ self._origin - at), -FAR, FAR)
        mujoco.mju_mat2Quat(pose[3:], (gel.T @ turn).ravel())
        return pose

    def levers(self, data: mujoco.MjData) -> Pair:
        """Of gel and object: the body, and the matrix (6, 6) from a wrench on the gel, in its frame, to the body's `xfrc_applied`."""
        at, turn = data.site_xpos[self.site], data.site_xmat[self.site].reshape(3, 3)
        found = []
        for body, sign in ((self.body, 1.0), (self.object, -1.0)):
            x, y, z = at - data.xipos[body]
            lever = np.zeros((6, 6))
            lever[:3, :3] = lever[3:, 3:] = turn
            lever[3:, :3] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
            found.append((body, sign * lever))
        return found[0], found[1]


class Touch:
    """A model whose pads feel. What the user puts into `data.xfrc_applied` stays and acts too."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, pads: Iterable[Pad], period: float = 0.0) -> None:
        """Takes the pads.

        Args:
            period: Time [s] between answers of a gel that touches, in which its force goes on by its stiffness; 0 asks it each step.
        """
        self.model, self.data, self.pads, self.period = model, data, list(pads), period
        self._state = np.zeros(mujoco.mj_stateSize(model, STATE))
        self._response: Array = np.zeros(0)

    def reset(self) -> None:
        """After `mujoco.mj_resetData`, or a new state: no pad remembers anything."""
        for pad in self.pads:
            pad.reset()

    @property
    def state(self) -> tuple[Any, ...]:
        """Of the model and of its pads, to return to; what the user changed in the model itself is not in it."""
        kept = np.zeros_like(self._state)
        mujoco.mj_getState(self.model, self.data, kept, STATE)
        return kept, self._response, *(pad.state for pad in self.pads)

    @state.setter
    def state(self, kept: tuple[Any, ...]) -> None:
        mujoco.mj_setState(self.model, self.data, kept[0], STATE)
        mujoco.mj_forward(self.model, self.data)
        self._response = kept[1]
        for pad, state in zip(self.pads, kept[2:], strict=True):
            pad.state = state

    def step(self) -> None:
        """One step of `model.opt.timestep`, in place of `mujoco.mj_step(model, data)`.

        That is called up to 6 times per pad, and twice; a few times as often in a step that leads into a gel.

        Raises:
            SceneError: An object is deeper in a gel than it answers for; the state is that before the step.
        """
        model, data, step = self.model, self.data, self.model.opt.timestep
        mujoco.mj_getState(model, data, self._state, STATE)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        asked = [pad.patch for pad in self.pads]
        answers = [pad.look(data, self.period) for pad in self.pads]
        levers = [pad.levers(data) for pad in self.pads]
        approach = step * np.concatenate([_approach(model, data, pair) for pair in levers])
        known = all(answer.patch is patch for answer, patch in zip(answers, asked, strict=True))
        motion = self._motion(levers, approach, answers, known)
        for _ in range(CORRECTIONS):
            last = answers
            answers = [pad.ahead(data, answer, way) for pad, answer, way in zip(self.pads, last, motion, strict=True)]
            if all(now is before for now, before in zip(answers, last, strict=True)):
                break
            motion = self._motion(levers, approach, answers, known=False)
        for pad, answer, way in zip(self.pads, answers, motion, strict=True):
            pad.wrench = answer.patch.wrench(answer.gone + way)
        self._push(levers, np.concatenate([pad.wrench for pad in self.pads]))

    def _motion(self, levers: list[Pair], approach: Array, answers: list[Answer], known: bool) -> Array:
        """Of the objects in their gels' frames over the step, (pads, 6); `known`: they move by a wrench as they did in the last step."""
        touching = np.repeat([len(answer.patch.points) > 0 for answer in answers], 6)
        last = np.concatenate([pad.wrench for pad in self.pads]) * touching
        motion = approach @ self._trial(levers, last)
        if touching.any():
            if not known:
                self._response = np.zeros((len(last), len(last)))  # of the motion to the wrenches
                for column in np.flatnonzero(touching):
                    probe = PROBE * (1.0 if column % 6 < 3 else ARM) * (np.arange(len(last)) == column)
                    self._response[:, column] = (approach @ self._trial(levers, last + probe) - motion) / probe[column]
            stiff: Array = np.asarray(block_diag(*(answer.patch.stiffness for answer in answers)))
            now = np.concatenate([answer.wrench() for answer in answers])
            # wrench = now + stiff motion and motion = that of the last wrench + response (wrench - last), solved for both
            motion += self._response @ np.linalg.solve(np.eye(len(last)) - stiff @ self._response, now + stiff @ motion - last)
        return motion.reshape(-1, 6)

    def _trial(self, levers: list[Pair], wrenches: Array) -> Array:
        """Joint velocities after a step with wrenches on the gels, (nv,), which is then undone."""
        self._push(levers, wrenches)
        ahead = self.data.qvel.copy()
        mujoco.mj_setState(self.model, self.data, self._state, STATE)
        return ahead

    def _push(self, levers: list[Pair], wrenches: Array) -> None:
        """Steps with wrenches on the gels."""
        own = self.data.xfrc_applied.copy()
        for pair, wrench in zip(levers, wrenches.reshape(-1, 6), strict=True):
            for body, lever in pair:
                self.data.xfrc_applied[body] += lever @ wrench
        mujoco.mj_step(self.model, self.data)
        self.data.xfrc_applied[:] = own


def _approach(model: mujoco.MjModel, data: mujoco.MjData, levers: Pair) -> Array:
    """From joint velocities to the object's motion in the gel's frame, at the gel's origin, linear before angular: (6, nv).

    By the power of a wrench: what takes it to both bodies takes their velocities to its own.
    """
    found = np.zeros((6, model.nv))
    for body, lever in levers:
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jacBodyCom(model, data, jacobian[:3], jacobian[3:], body)
        found -= lever.T @ jacobian
    return found


def _index(model: mujoco.MjModel, kind: str, name: str) -> int:
    among = {"site": mujoco.mjtObj.mjOBJ_SITE, "body": mujoco.mjtObj.mjOBJ_BODY}[kind]
    count = {"site": model.nsite, "body": model.nbody}[kind]
    if (found := mujoco.mj_name2id(model, among, name)) < 0:
        names = [mujoco.mj_id2name(model, among, index) for index in range(count)]
        raise SceneError(f'{kind} = "{name}": the model has no such {kind}; it has {", ".join(filter(None, names)) or "none with a name"}')
    return found


def _check_excluded(model: mujoco.MjModel, gel: int, thing: int) -> None:
    """MuJoCo's own contact of the two would push as well."""
    if (min(gel, thing) << 16) + max(gel, thing) in model.exclude_signature:
        return
    one, other = (np.flatnonzero(model.geom_bodyid == body) for body in (gel, thing))
    kind, meets = model.geom_contype, model.geom_conaffinity
    if ((kind[one][:, None] & meets[other]) | (kind[other] & meets[one][:, None])).any():
        raise SceneError(
            f'body = "{model.body(thing).name}": MuJoCo\'s own contact with "{model.body(gel).name}" must be excluded; add_pad does it'
        )


def _shape(model: mujoco.MjModel, body: int, path: Path) -> tuple[Body, Array, float]:
    """A body's geoms as gelsim's object, where its origin is in the body's frame [m], and its diagonal [m]."""
    solids = [solid for geom in np.flatnonzero(model.geom_bodyid == body) if (solid := _solid(model, int(geom))) is not None]
    if not solids:
        raise SceneError(
            f'body = "{model.body(body).name}": it has no geom that bounds a solid: sphere, ellipsoid, box, capsule, mesh, cylinder'
        )
    whole: trimesh.Trimesh = trimesh.util.concatenate(solids)  # type: ignore[assignment]
    whole.apply_scale(MM_PER_M)
    whole.export(path)
    kinds = model.geom_type[model.geom_bodyid == body]
    # What has no edge is sampled as its radius asks, not as a rim would: a fifth of the time for an egg.
    smooth = max(0.1, ROUNDED * float(np.ptp(whole.vertices, axis=0).min())) if np.isin(kinds, SMOOTH).all() else None
    shape = Body(shape="mesh", mesh=str(path), rigid=True, edge_radius_mm=smooth)
    vertices = load_mesh(shape).vertices
    return shape, whole.vertices.min(axis=0) * MM - vertices.min(axis=0), float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _solid(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """A geom's surface in its body's frame [m]; None of a plane, a height field, a distance field."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        made = trimesh.creation.icosphere(ROUND)
        made.apply_scale(size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        made = trimesh.creation.box(2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        made = trimesh.creation.cylinder(size[0], 2 * size[1], sections=2**ROUND * 10)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        made = trimesh.creation.capsule(2 * size[1], size[0], count=[2**ROUND * 5] * 2)
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        points, faces = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        made = trimesh.Trimesh(
            model.mesh_vert[points : points + model.mesh_vertnum[mesh]], model.mesh_face[faces : faces + model.mesh_facenum[mesh]]
        )
    else:
        return None
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_quat(np.roll(model.geom_quat[geom], -1)).as_matrix()
    turn[:3, 3] = model.geom_pos[geom]
    made.apply_transform(turn)
    return made
