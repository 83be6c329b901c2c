"""Live sensors inside a Newton model: the gel's force in place of Newton's own contact.

    add_pad(builder, finger, "pad", scene, against=egg)          # bodies of the builder; a box, its contact with the egg's shapes filtered
    model = builder.finalize()
    touch = Touch(newton.solvers.SolverXPBD(model), [Pad(model, "pad", "egg", scene)])
    touch.step(state, after, control, contacts, dt)              # in place of solver.step

A pad's gel is a box shape: z along the outward normal, the origin the middle of its upper face. The object is a body, all of whose shapes
but sites together are its shape. Each step applies equal and opposite wrenches at the bodies' centres of mass by `State.body_f`;
`gelsim.live.coupling` says which. The solver takes the trial steps: any will do that a step leaves as it was, as XPBD, semi-implicit and
Featherstone; one that starts from its last solution, as MuJoCo's, sees the trial steps' too.

A live sensor computes on the host. So of a model on a GPU poses come to the host once a step, and velocities once a trial step; wrenches
go back; and a step is no part of a CUDA graph.
"""

# pyright: reportOptionalMemberAccess=false
# The arrays of a model that is finalized are there, but typed as if not.

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import newton
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gelsim.errors import SceneError
from gelsim.live.coupling import AWAY, GEL_COLOUR, GEL_DENSITY, Coupling, Gel, gel_box, lever, placed, solid, unknown
from gelsim.scene.definition import Scene

Array = NDArray[np.float64]
Pair = tuple[tuple[int, Array], tuple[int, Array]]

KINDS = {
    newton.GeoType.SPHERE: "ball",
    newton.GeoType.ELLIPSOID: "ellipsoid",
    newton.GeoType.BOX: "box",
    newton.GeoType.CYLINDER: "cylinder",
    newton.GeoType.CAPSULE: "capsule",
}
SMOOTH = newton.GeoType.SPHERE, newton.GeoType.ELLIPSOID
MESHES = newton.GeoType.MESH, newton.GeoType.CONVEX_MESH
WORLD = -1
"""Body of what does not move."""
HERE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def add_pad(builder: newton.ModelBuilder, body: int, label: str, scene: Scene, *, against: int, xform: ArrayLike = HERE) -> int:
    """Fixes a gel to a body of a model that is not finalized yet, and takes Newton's contact with the object out.

    Args:
        body: The body that carries it; -1 is the world.
        label: Of the new shape.
        against: The body that is the object; it has its shapes already.
        xform: Of the middle of the gel's outer face in the body's frame [m; quaternion x, y, z, w], (7,), as of a `warp.transform`; z
            points out of the gel. On a site it is `builder.shape_transform[site]`.
    Returns:
        The shape, a box.
    """
    half, place = gel_box(scene), np.asarray(xform, float)
    middle = place[:3] - Rotation.from_quat(place[3:]).apply([0, 0, half[2]])
    cfg = newton.ModelBuilder.ShapeConfig(density=GEL_DENSITY)
    gel = builder.add_shape_box(
        body, xform=(tuple(middle), tuple(place[3:])), hx=half[0], hy=half[1], hz=half[2], cfg=cfg, color=GEL_COLOUR, label=label
    )
    for shape in builder.body_shapes[against]:
        builder.add_shape_collision_filter_pair(gel, shape)
    return gel


class Pad(Gel):
    """A gel that is a box of the model, and the body that it touches."""

    def __init__(self, model: newton.Model, shape: str | int, body: str | int, scene: Scene) -> None:
        """Makes the live sensor: seconds.

        Args:
            shape: Label or index of the box, whose upper face is the gel's outer face at rest.
            body: The object, rigid, by label or index: all of its shapes but sites.
            scene: Its gel, contact, camera, lights, coating and markers count; its object and its press do not.
        Raises:
            SceneError: The model has no such shape or body, or several of its label; Newton's own contact of the two is not filtered; or no
                shape of the body bounds a solid.
        """
        gel, self.object = _index("shape", shape, model.shape_label), _index("body", body, model.body_label)
        self.body = int(model.shape_body.numpy()[gel])
        place = model.shape_transform.numpy()[gel].astype(float)
        self._turn = Rotation.from_quat(place[3:]).as_matrix()
        self._at = place[:3] + self._turn[:, 2] * float(model.shape_scale.numpy()[gel][2])
        self._middles = {one: model.body_com.numpy()[one].astype(float) for one in (self.body, self.object) if one != WORLD}
        label = model.body_label[self.object]
        flags = model.shape_flags.numpy()
        shapes = [one for one in model.body_shapes[self.object] if not flags[one] & newton.ShapeFlags.SITE]
        _check_filtered(model, gel, shapes, label)
        solids = [found for one in shapes if (found := _solid(model, one)) is not None]
        super().__init__(scene, label, solids, smooth=bool(np.isin(model.shape_type.numpy()[shapes], SMOOTH).all()))

    def pose(self, bodies: Array) -> Array:
        """Of the object in the gel's frame, as the sensor takes it: x, y, z [m], at most AWAY, quaternion w, x, y, z; (7,).

        Args:
            bodies: `State.body_q` on the host, (bodies, 7).
        """
        (gel, at), (thing, shift) = self._frame(bodies), _place(bodies, self.object)
        x, y, z, w = Rotation.from_matrix(gel.T @ thing).as_quat()
        return np.array([*np.clip(gel.T @ (shift + thing @ self._origin - at), -AWAY, AWAY), w, x, y, z])

    def levers(self, bodies: Array) -> Pair:
        """Of gel and object: the body, and the matrix (6, 6) from a wrench on the gel, in its frame, to the body's `body_f`."""
        turn, at = self._frame(bodies)
        found = []
        for body, sign in ((self.body, 1.0), (self.object, -1.0)):
            own, shift = _place(bodies, body)
            found.append((body, sign * lever(turn, at - shift - own @ self._middles.get(body, np.zeros(3)))))
        return found[0], found[1]

    def _frame(self, bodies: Array) -> tuple[Array, Array]:
        turn, shift = _place(bodies, self.body)
        return turn @ self._turn, shift + turn @ self._at


class Touch(Coupling):
    """A solver whose pads feel. What the user puts into `body_f` of the state acts too."""

    probe = 2e-2, 1e-5
    """A force that single precision sees: XPBD stops what is slower than 0.1 mm/s. With 1, 5, 20 and 100 mN it finds how 50 g answer within
    100, 15, 4 and 0.6 %; at rest and thrown about all feel the same (`tests/unit/test_live_newton.py`)."""

    def __init__(self, solver: newton.solvers.SolverBase, pads: Iterable[Pad], period: float = 0.0) -> None:
        """Takes the pads.

        Args:
            period: Time [s] between answers of a gel that touches, in which its force goes on by its stiffness; 0 asks it each step.
        """
        self.solver, self.pads, self.time = solver, list(pads), 0.0
        super().__init__(self.pads, period)
        self._before, self._after = solver.model.state(), solver.model.state()

    def step(self, state_in: newton.State, state_out: newton.State, control: Any, contacts: Any, dt: float) -> None:
        """In place of `solver.step(state_in, state_out, control, contacts, dt)`; `state_in` stays as it is.

        That is called up to 6 times per pad, and twice; a few times as often in a step that leads into a gel.

        Raises:
            SceneError: An object is deeper in a gel than it answers for; `state_out` is as it was.
        """
        bodies = state_in.body_q.numpy().astype(float)
        levers = [pad.levers(bodies) for pad in self.pads]

        def push(wrenches: Array, after: newton.State) -> None:
            forces = state_in.body_f.numpy().copy()
            for pair, wrench in zip(levers, wrenches.reshape(-1, 6), strict=True):
                for body, carry in pair:
                    if body != WORLD:
                        forces[body] += carry @ wrench
            self._before.assign(state_in)  # as some solvers add to the forces that they are given
            self._before.body_f.assign(forces)
            self.solver.step(self._before, after, control, contacts, dt)

        def trial(wrenches: Array) -> Array:
            push(wrenches, self._after)
            speeds = self._after.body_qd.numpy().astype(float)
            # by the power of a wrench: what takes it to both bodies takes their velocities to its own
            return np.concatenate([-dt * sum(carry.T @ speeds[body] for body, carry in pair if body != WORLD) for pair in levers])

        push(self._settle([pad.pose(bodies) for pad in self.pads], self.time, trial), state_out)
        self.time += dt


def _place(bodies: Array, body: int) -> tuple[Array, Array]:
    """Turn (3, 3) and place (3,) of a body's frame [m]."""
    if body == WORLD:
        return np.eye(3), np.zeros(3)
    return Rotation.from_quat(bodies[body, 3:]).as_matrix(), bodies[body, :3]


def _index(kind: str, which: str | int, labels: list[str]) -> int:
    if isinstance(which, int):
        which, labels = str(which), [str(index) for index in range(len(labels))]
    if (count := labels.count(which)) > 1:
        raise SceneError(f'{kind} = "{which}": {count} of the model have this label; give the index of one')
    if not count:
        raise unknown(kind, which, labels)
    return labels.index(which)


def _check_filtered(model: newton.Model, gel: int, shapes: list[int], label: str) -> None:
    """Newton's own contact of the two would push as well."""
    collides = model.shape_flags.numpy() & newton.ShapeFlags.COLLIDE_SHAPES
    if collides[gel] and any(collides[one] and not model.shape_collision_filter_contains(gel, one) for one in shapes):
        raise SceneError(f'body = "{label}": Newton\'s own contact with "{model.shape_label[gel]}" must be filtered; add_pad does it')


def _solid(model: newton.Model, shape: int) -> trimesh.Trimesh | None:
    """A shape's surface in its body's frame [m]; None of a plane, a height field, a cone."""
    kind, size = newton.GeoType(model.shape_type.numpy()[shape]), model.shape_scale.numpy()[shape].astype(float)
    if kind in KINDS:
        made = solid(KINDS[kind], size)
    elif kind in MESHES:
        source: Any = model.shape_source[shape]
        made = trimesh.Trimesh(source.vertices * size, np.asarray(source.indices).reshape(-1, 3))
    else:
        return None
    place = model.shape_transform.numpy()[shape].astype(float)
    return placed(made, place[:3], place[3:])
