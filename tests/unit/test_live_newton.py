"""Live sensors inside Newton: balance, rest, a finger on a joint, impacts, and Newton's own contact left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("newton")
import newton
import warp as wp

from gelsim.errors import SceneError
from gelsim.live import layer as gel_layer
from gelsim.live import newton as live_newton
from gelsim.live.newton import Pad, Touch, add_pad
from gelsim.live.patch import Patch
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene

RADIUS = 0.004
GRAVITY = 9.81
STEP = 0.002
SOLVERS = ["SolverXPBD", "SolverSemiImplicit", "SolverFeatherstone"]
Shape = newton.ModelBuilder.ShapeConfig


def scene(friction: float = 0.5) -> Scene:
    return build_scene(
        {
            "gel": {"profile": "flat", "youngs_modulus_kpa": 60.0, "size_mm": [16.0, 16.0]},
            "camera": {"field_mm": [12.0, 9.0]},
            "object": {"shape": "hemisphere", "rigid": True},
            "contact": {"friction_coefficient": friction},
        }
    )


class World:
    """A ball over a gel that looks up, and what steps them; gravity only if the gel is fixed."""

    def __init__(self, solver: str, *, mass: float = 0.005, height: float = 0.0, free_pad: bool = False, weight: bool = True) -> None:
        fixed = weight and not free_pad
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY if fixed else 0.0))
        ball = builder.add_body(xform=wp.transform((0.0, 0.0, RADIUS + height), wp.quat_identity()), label="ball")
        builder.add_shape_sphere(ball, radius=RADIUS, cfg=Shape(density=mass / (4 / 3 * np.pi * RADIUS**3)))
        holder = -1
        if free_pad:
            holder = builder.add_body(label="holder")
            far = wp.transform((0.0, 0.0, -0.02), wp.quat_identity())
            builder.add_shape_sphere(holder, xform=far, radius=RADIUS, cfg=Shape(density=2 * mass / (4 / 3 * np.pi * RADIUS**3)))
        add_pad(builder, holder, "pad", scene(), against=ball)
        self.model = builder.finalize(device="cpu")
        self.touch = Touch(getattr(newton.solvers, solver)(self.model), [Pad(self.model, "pad", "ball", scene())])
        self.pad = self.touch.pads[0]
        self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        self.state, self._after = self.model.state(), self.model.state()

    def fling(self, *velocity: float) -> None:
        """The ball [m/s, rad/s]."""
        speeds = self.state.body_qd.numpy().copy()
        speeds[0] = velocity
        self.state.body_qd.assign(speeds)
        joints = self.state.joint_qd.numpy().copy()
        joints[:6] = velocity
        self.state.joint_qd.assign(joints)

    def step(self) -> None:
        self.state.clear_forces()
        self.pipeline.collide(self.state, self.contacts)
        self.touch.step(self.state, self._after, None, self.contacts, STEP)
        self.state, self._after = self._after, self.state

    @property
    def height(self) -> float:
        """Of the ball's lowest point [m]."""
        return float(self.state.body_q.numpy()[0, 2]) - RADIUS

    @property
    def velocity(self) -> np.ndarray:
        return self.state.body_qd.numpy()[0].astype(float)


SLOWEST = 1e-4
"""Speed [m/s] below which XPBD stops a body: it takes momentum as a force of m SLOWEST / STEP would."""
SETTLED = 2e-3
"""Of the gel's force: two answers of its solver, each within `gelsim.live.layer.SETTLED` of its pressure."""


def rests(world: World) -> None:
    """A ball that fell lies still, on a force that is its weight, and was never as high again."""
    heights = [world.height]
    for _ in range(300):
        world.step()
        heights.append(world.height)
    forces = []
    for _ in range(50):
        world.step()
        forces.append(world.pad.frame.force[2])  # type: ignore[union-attr]
    weight = float(world.model.body_mass.numpy()[0]) * GRAVITY
    off = np.array(forces) / -weight - 1
    assert np.abs(off).max() < SETTLED + SLOWEST / STEP / GRAVITY  # 0.7 %; 0.1 % is found
    assert max(heights[int(np.argmin(heights)) :]) < 0 < heights[0] and np.ptp(heights[250:]) < 1e-6


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_ball_comes_to_rest_at_its_weight(solver: str) -> None:
    """In steps of 2 ms."""
    rests(World(solver, height=3e-4))


def test_an_explicit_force_would_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """5 g on 3 N/mm swing by 0.77 rad/ms, and a step of 2 ms turns that by 1.5: near the 2 at which an explicit one gains energy."""
    wrench = Patch.wrench
    monkeypatch.setattr(Patch, "wrench", lambda self, motion: wrench(self, 0 * motion))
    monkeypatch.setattr(Patch, "stiffness", np.zeros((6, 6)))
    with pytest.raises((AssertionError, SceneError)):
        rests(World("SolverXPBD", height=3e-4))


def test_newtons_own_contact_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two that push carry the ball together: the gel's share is far from the weight."""
    monkeypatch.setattr(newton.ModelBuilder, "add_shape_collision_filter_pair", lambda *_: None)  # planted
    with pytest.raises(SceneError, match=r'^body = "ball": Newton\'s own contact with "pad" must be filtered; add_pad does it$'):
        World("SolverXPBD")
    monkeypatch.setattr(live_newton, "_check_filtered", lambda *_: None)
    with pytest.raises(AssertionError):
        rests(World("SolverXPBD", height=3e-4))


@pytest.mark.parametrize("solver", SOLVERS)
def test_forces_are_equal_and_opposite(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball flung at a free gel: the momentum of both stays, within single precision and what XPBD stops."""

    def exchange() -> tuple[float, float]:
        """By how much all momentum changes over 30 steps, and the ball's."""
        world = World(solver, free_pad=True, height=1e-4)
        world.fling(0.02, 0.01, -0.08, 0, 5, 0)
        masses = world.model.body_mass.numpy().astype(float)
        found = []
        for _ in range(30):
            world.step()
            found.append(masses[:, None] * world.state.body_qd.numpy()[:, :3].astype(float))
        change = found[-1] - found[0]
        return float(np.linalg.norm(change.sum(axis=0))), float(np.linalg.norm(change[0]))

    left, exchanged = exchange()
    assert exchanged > 2e-4  # kg m/s: the ball has met the gel
    assert left < 1e-4 * exchanged  # 30 steps of two speeds, each rounded to 6e-8 of it
    held = Pad.levers
    monkeypatch.setattr(Pad, "levers", lambda self, bodies: (held(self, bodies)[0], (self.object, 0.5 * held(self, bodies)[1][1])))
    left, exchanged = exchange()
    assert left > 0.1 * exchanged  # planted


@pytest.mark.parametrize("mass", [1e-4, 2e-3, 5e-2])
def test_a_ball_shot_at_a_gel_comes_back_no_faster(mass: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """However much of a step it flies: no touch gains energy."""

    def fastest() -> float:
        """Speed after over speed before."""
        found = []
        speed = min(0.3, 0.002 / mass)
        for share in (0.02, 0.5, 0.98):
            world = World("SolverSemiImplicit", mass=mass, height=share * speed * STEP, weight=False)
            world.fling(0, 0, -speed, 0, 0, 0)
            for _ in range(200):
                world.step()
                if world.velocity[2] > 0 and world.height > 1e-4:
                    break
            found.append(world.velocity[2] / speed)
        return max(found)

    assert 0 < fastest() < 0.9
    if mass < 1e-3:
        monkeypatch.setattr("gelsim.live.coupling.CORRECTIONS", 0)  # planted: nothing brakes it in the step in which it comes
        assert fastest() > 1


@pytest.mark.parametrize("solver", ["SolverXPBD", "SolverFeatherstone"])  # the third's joints are springs too stiff for the step
def test_a_finger_on_a_joint_presses_as_it_is_pushed(solver: str) -> None:
    """20 g pushed down by 0.3 N on a slide, the gel below them, on a ball that is held: it feels their weight too."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    ball = builder.add_body(label="ball", is_kinematic=True)
    builder.add_shape_sphere(ball, radius=RADIUS)
    finger = builder.add_link(xform=wp.transform((0.0, 0.0, RADIUS + 1e-5), wp.quat_identity()), label="finger")
    builder.add_shape_box(
        finger, xform=wp.transform((0.0, 0.0, 0.02), wp.quat_identity()), hx=0.01, hy=0.01, hz=0.01, cfg=Shape(density=2.5e3)
    )
    add_pad(builder, finger, "pad", scene(), against=ball, xform=(0, 0, 0, 1, 0, 0, 0))  # z, out of the gel, points down
    slide = builder.add_joint_prismatic(
        -1, finger, axis=(0, 0, 1), parent_xform=wp.transform((0.0, 0.0, RADIUS + 1e-5), wp.quat_identity())
    )
    builder.add_articulation([slide])
    model = builder.finalize(device="cpu")
    touch = Touch(getattr(newton.solvers, solver)(model), [Pad(model, "pad", "ball", scene())])
    state, after, control = model.state(), model.state(), model.control()
    force = np.zeros(model.joint_dof_count, np.float32)
    force[-1] = -0.3
    control.joint_f.assign(force)
    for _ in range(250):
        state.clear_forces()
        touch.step(state, after, control, None, STEP)
        state, after = after, state
    pushed = 0.3 + float(model.body_mass.numpy()[finger]) * GRAVITY
    assert touch.pads[0].wrench[2] == pytest.approx(-pushed, rel=SETTLED + SLOWEST / STEP / GRAVITY)
    assert np.abs(touch.pads[0].wrench[:2]).max() < 0.01 * pushed
    assert np.abs(state.body_qd.numpy()[finger]).max() < 1e-3


def gripped(solver: str, push: float, steps: int) -> tuple[Touch, newton.State]:
    """5 g between two gels of 20 g on slides, pushed together."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    ball = builder.add_body(label="ball")
    builder.add_shape_sphere(ball, radius=RADIUS, cfg=Shape(density=0.005 / (4 / 3 * np.pi * RADIUS**3)))
    names = ("left", -1.0), ("right", 1.0)
    for name, side in names:
        start = wp.transform((side * RADIUS, 0.0, 0.0), wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), -side * np.pi / 2))
        finger = builder.add_link(xform=start, mass=0.02, inertia=wp.mat33(np.eye(3) * 1e-6), label=name)
        add_pad(builder, finger, name, scene(), against=ball)
        builder.add_articulation([builder.add_joint_prismatic(-1, finger, axis=(0, 0, 1), parent_xform=start)])
    model = builder.finalize(device="cpu")
    touch = Touch(getattr(newton.solvers, solver)(model), [Pad(model, name, "ball", scene()) for name, _ in names])
    state, after, control = model.state(), model.state(), model.control()
    force = np.zeros(model.joint_dof_count, np.float32)
    force[-2:] = push
    control.joint_f.assign(force)
    for _ in range(steps):
        state.clear_forces()
        touch.step(state, after, control, None, STEP)
        state, after = after, state
    return touch, state


@pytest.mark.parametrize("solver", ["SolverXPBD", "SolverFeatherstone"])
def test_a_ball_is_held_between_two_fingers(solver: str) -> None:
    """By their shear, which is its weight; with less friction than that it falls."""
    push, weight = 0.3, 0.005 * GRAVITY
    touch, state = gripped(solver, push, 200)
    bodies = state.body_q.numpy().astype(float)
    for pad in touch.pads:
        assert pad.wrench[2] == pytest.approx(-push, abs=SETTLED * push + 0.02 * SLOWEST / STEP)
    held = np.sum([pad.levers(bodies)[1][1] @ pad.wrench for pad in touch.pads], axis=0)
    off = 2 * gel_layer.SLIP_TOLERANCE * 0.5 * push + 0.005 * SLOWEST / STEP  # of the bounds of both; 0.8 mN
    assert np.abs(held[:3] - [0, 0, weight]).max() < off
    assert -0.3e-3 < bodies[0, 2] < 0 and np.abs(state.body_qd.numpy()[0, :3]).max() < 1e-3  # it sank before it was gripped
    _, state = gripped(solver, 0.6 * weight, 25)
    # by 0.4 of g, in 50 ms
    assert state.body_q.numpy()[0, 2] < -0.5 * 0.4 * GRAVITY * (25 * STEP) ** 2 * 0.9


def test_the_answer_of_a_heavy_ball_is_found_in_single_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    """h²/m of 50 g on a gel, by XPBD; forces too small to see make it nothing, or all."""

    def answer() -> np.ndarray:
        world = World("SolverXPBD", mass=0.05)
        for _ in range(150):
            world.step()
        found = []
        for _ in range(30):
            world.step()
            found.append(world.touch._response[2, 2] * -0.05 / STEP**2)
        return np.array(found)

    # of what it moves by in a step, 0.8 mm/s, XPBD stops up to 0.1 mm/s
    assert np.abs(answer() - 1).max() < 0.15
    monkeypatch.setattr(Touch, "probe", (1e-3, 1e-5))
    assert np.abs(answer() - 1).max() > 0.5  # planted


def test_a_bodys_shapes_are_its_shape() -> None:
    """Each kind, turned and moved, on a gel that is turned: the height of the underside is what the shape says."""
    import trimesh

    builder = newton.ModelBuilder()
    upright = wp.quat_identity()
    along = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), np.pi / 2)
    parts = builder.add_body(label="parts")
    heavy = Shape(density=1e6)  # Newton gives more inertia to what has too little
    builder.add_shape_box(parts, xform=wp.transform((0.0, 0.0, 0.001), upright), hx=0.002, hy=0.002, hz=0.001, cfg=heavy)
    builder.add_shape_capsule(parts, xform=wp.transform((0.0, 0.0, 0.0005), along), radius=0.001, half_height=0.002)
    builder.add_site(parts, xform=wp.transform((0.0, 0.0, -0.01), upright))
    nut = trimesh.load_mesh(Path(__file__).parents[2] / "assets" / "meshes" / "hex_nut.stl")
    body = builder.add_body(label="nut")
    mesh = newton.Mesh(nut.vertices, nut.faces.ravel())
    builder.add_shape_mesh(body, xform=wp.transform((0.0, 0.0, 0.01), upright), mesh=mesh, scale=(4e-4,) * 3, cfg=Shape(density=0))
    builder.add_body(label="bare")
    hand = builder.add_body(label="hand", mass=0.1, inertia=wp.mat33(np.eye(3) * 1e-4))
    add_pad(builder, hand, "pad", scene(), against=body, xform=(0, 0, 0.001, 0, 0, np.sqrt(0.5), np.sqrt(0.5)))
    add_pad(builder, -1, "table", scene(), against=parts)
    builder.add_site(body, label="table")
    model = builder.finalize(device="cpu")
    bodies = model.state().body_q.numpy().astype(float)
    table = model.shape_label.index("table")
    pose = Pad(model, table, "parts", scene()).pose(bodies)
    assert pose[:3] == pytest.approx([0, 0, -0.0005], abs=1e-5)  # the capsule's lowest line, R/400 off
    pose = Pad(model, "pad", "nut", scene()).pose(bodies)
    assert pose[2] == pytest.approx(0.01 - 0.001 + 4e-4 * nut.vertices[:, 2].min(), abs=1e-6)
    assert pose[3:] * np.sign(pose[3]) == pytest.approx([np.sqrt(0.5), 0, 0, -np.sqrt(0.5)], abs=1e-6)
    for shape, thing, words in (
        ("paw", "nut", r'^shape = "paw": the model has no such shape; it has '),
        ("table", "parts", r'^shape = "table": 2 of the model have this label; give the index of one$'),
        ("pad", "bell", r'^body = "bell": the model has no such body; it has parts, nut, bare, hand$'),
        ("pad", 7, r'^body = "7": the model has no such body; it has 0, 1, 2, 3$'),
        ("pad", "bare", r'^body = "bare": it has no geom that bounds a solid'),
    ):
        with pytest.raises(SceneError, match=words):
            Pad(model, shape, thing, scene())


def test_what_is_too_deep_is_refused_and_nothing_moves() -> None:
    world = World("SolverXPBD", height=-2e-3)
    world._after.body_q.fill_(7.0)
    with pytest.raises(SceneError, match=r"overlaps the gel by 1\.99 mm|overlaps the gel by 2\.00 mm"):
        world.touch.step(world.state, world._after, None, None, STEP)
    assert (world._after.body_q.numpy() == 7).all() and world.touch.time == 0
