"""Live sensors inside a MuJoCo model: the gel's force in place of MuJoCo's own contact.

    pad = add_pad(spec, spec.body("finger"), "pad", scene, against="egg")     # a body, a geom, a site; before spec.compile()
    touch = Touch(model, data, [Pad(model, "pad", "egg", scene)])
    touch.step()                                                              # instead of mujoco.mj_step(model, data)

A pad's gel is a site: z along the outward normal, the origin on the outer face. The object is a body, all of whose geoms together are its
shape. Each step applies equal and opposite wrenches at the bodies' centres of mass; `gelsim.live.coupling` says which. Callbacks of the
model see its trial steps too.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from compiled modules, whose types pyright does not know.

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from gelsim.errors import SceneError
from gelsim.live.coupling import AWAY, GEL_COLOUR, GEL_DENSITY, Coupling, Gel, gel_box, lever, placed, solid, unknown
from gelsim.scene.definition import Scene

Array = NDArray[np.float64]
Pair = tuple[tuple[int, Array], tuple[int, Array]]

KINDS = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "ball",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
}
SMOOTH = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID
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
    half = gel_box(scene)
    pad = parent.add_body(name=name, pos=np.asarray(pos, float), quat=np.asarray(quat, float))
    box = mujoco.mjtGeom.mjGEOM_BOX
    pad.add_geom(name=name, type=box, size=half, pos=[0, 0, -half[2]], density=GEL_DENSITY, rgba=[*GEL_COLOUR, 1])
    pad.add_site(name=name, size=[1e-3, 1e-3, 1e-3])
    spec.add_exclude(bodyname1=name, bodyname2=against)
    return pad


class Pad(Gel):
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
        geoms = np.flatnonzero(model.geom_bodyid == self.object)
        solids = [found for geom in geoms if (found := _solid(model, int(geom))) is not None]
        super().__init__(scene, body, solids, smooth=bool(np.isin(model.geom_type[geoms], SMOOTH).all()))

    def pose(self, data: mujoco.MjData) -> Array:
        """Of the object in the gel's frame, as the sensor takes it: x, y, z [m], at most AWAY, quaternion w, x, y, z; (7,)."""
        gel, at = data.site_xmat[self.site].reshape(3, 3), data.site_xpos[self.site]
        turn = data.xmat[self.object].reshape(3, 3)
        pose = np.empty(7)
        pose[:3] = np.clip(gel.T @ (data.xpos[self.object] + turn @ self._origin - at), -AWAY, AWAY)
        mujoco.mju_mat2Quat(pose[3:], (gel.T @ turn).ravel())
        return pose

    def levers(self, data: mujoco.MjData) -> Pair:
        """Of gel and object: the body, and the matrix (6, 6) from a wrench on the gel, in its frame, to the body's `xfrc_applied`."""
        at, turn = data.site_xpos[self.site], data.site_xmat[self.site].reshape(3, 3)
        gel, thing = (lever(turn, at - data.xipos[body]) for body in (self.body, self.object))
        return (self.body, gel), (self.object, -thing)


class Touch(Coupling):
    """A model whose pads feel. What the user puts into `data.xfrc_applied` stays and acts too."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, pads: Iterable[Pad], period: float = 0.0) -> None:
        """Takes the pads.

        Args:
            period: Time [s] between answers of a gel that touches, in which its force goes on by its stiffness; 0 asks it each step.
        """
        self.model, self.data, self.pads = model, data, list(pads)
        super().__init__(self.pads, period)
        self._state = np.zeros(mujoco.mj_stateSize(model, STATE))

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
        levers = [pad.levers(data) for pad in self.pads]
        approach = step * np.concatenate([_approach(model, data, pair) for pair in levers])
        poses = [pad.pose(data) for pad in self.pads]
        self._push(levers, self._settle(poses, data.time, lambda wrenches: approach @ self._trial(levers, wrenches)))

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
            for body, carry in pair:
                self.data.xfrc_applied[body] += carry @ wrench
        mujoco.mj_step(self.model, self.data)
        self.data.xfrc_applied[:] = own


def _approach(model: mujoco.MjModel, data: mujoco.MjData, levers: Pair) -> Array:
    """From joint velocities to the object's motion in the gel's frame, at the gel's origin, linear before angular: (6, nv).

    By the power of a wrench: what takes it to both bodies takes their velocities to its own.
    """
    found = np.zeros((6, model.nv))
    for body, carry in levers:
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jacBodyCom(model, data, jacobian[:3], jacobian[3:], body)
        found -= carry.T @ jacobian
    return found


def _index(model: mujoco.MjModel, kind: str, name: str) -> int:
    among = {"site": mujoco.mjtObj.mjOBJ_SITE, "body": mujoco.mjtObj.mjOBJ_BODY}[kind]
    count = {"site": model.nsite, "body": model.nbody}[kind]
    if (found := mujoco.mj_name2id(model, among, name)) < 0:
        names = [mujoco.mj_id2name(model, among, index) for index in range(count)]
        raise unknown(kind, name, names)
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


def _solid(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """A geom's surface in its body's frame [m]; None of a plane, a height field, a distance field."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind in KINDS:
        made = solid(KINDS[kind], size)
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        points, faces = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        made = trimesh.Trimesh(
            model.mesh_vert[points : points + model.mesh_vertnum[mesh]], model.mesh_face[faces : faces + model.mesh_facenum[mesh]]
        )
    else:
        return None
    return placed(made, model.geom_pos[geom], np.roll(model.geom_quat[geom], -1))
