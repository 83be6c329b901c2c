"""Many live sensors at once, beside each alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_baked import flat_scene
from test_lightfield import linear_field

import gelsim
from gelsim.errors import RenderError, SceneError
from gelsim.live import layer
from gelsim.live.sensor import STILL_MM, LiveFrame, LiveSensor
from gelsim.live.soft import Spring
from gelsim.live.underside import Underside
from gelsim.optics import bake
from gelsim.scene.definition import Body, Gel, Markers, Scene

torch = pytest.importorskip("torch")
from gelsim.live import batch, batch_layer  # noqa: E402
from gelsim.live.batch import BatchFrame, LiveBatch  # noqa: E402
from gelsim.live.batch_kernels import undersides  # noqa: E402
from gelsim.live.batch_layer import Answers, Layers  # noqa: E402

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
WALK = ((0.0, 0.0, -0.2), (0.0, 0.0, -0.5), (0.15, 0.1, -0.5), (0.5, 0.1, -0.55), (0.2, 0.1, -0.4), (0.2, 0.1, 0.3), (0.2, 0.0, -0.3))
"""Places of an object [mm]: pressed, sheared, slid, back, lifted, pressed again."""
FORCE = 0.005
"""Of the force, between two solvers. Each leaves gaps of 1e-3 of the overlap, in which a ball's force goes with the power 1.5 to 2.5, and
thickness and pressure settled to 5e-4; undersides are a map there, whose bilinear heights are 0.1² / 8R mm off, 5e-4 of the overlap."""
HELD = 0.007
"""Of the force, beside that, with friction: what it holds back of the face's spreading hangs on how all slipped before. Between the two
that share differs by 0.1 where a ball has slid, of 0.35 of the mean indentation, a fifth of the thickness; a force goes with that h^-1 at
least: 0.1 · 0.35 · 0.2."""
SHEAR = 0.02
"""Of the force: twice the slip that is left over the motion, 2e-3, of each of some ten increments."""


def ball_scene(friction: float | str = 0.5, **gel: object) -> Scene:
    ball = Body(shape="hemisphere", radius_mm=4.0, height_mm=6.0, rigid=True)
    made = flat_scene(gel=Gel(**({"size_mm": (12.8, 10.0), "thickness_mm": 2.4, "profile": "flat"} | gel)), object=ball, markers=Markers())
    return made.replace(contact=replace(made.contact, friction_coefficient=friction))


SOFT = {
    "ball": {"shape": "hemisphere", "radius_mm": 4.0, "height_mm": 6.0},
    "cylinder": {"shape": "cylinder", "radius_mm": 3.0, "length_mm": 5.0, "height_mm": 5.0},
    "punch": {"shape": "punch", "radius_mm": 2.5, "height_mm": 2.0},
    "box": {"shape": "box", "width_mm": 3.0, "length_mm": 4.0, "height_mm": 2.5},
}
DOME = {"profile": "dome", "edge_thickness_mm": 1.6}


def soft_scene(kind: str, friction: float | str = 0.5, **gel: object) -> Scene:
    return ball_scene(friction, **gel).replace(object=Body(**SOFT[kind], shore_00=30.0))


def about(axis: int, degrees: float) -> tuple[float, ...]:
    half = np.radians(degrees) / 2
    return (float(np.cos(half)), *(float(np.sin(half)) * (i == axis) for i in range(3)))


def pose(x: float, y: float, z: float, turn: tuple[float, ...] = UPRIGHT) -> tuple[float, ...]:
    """Of a place in mm."""
    return (x * 1e-3, y * 1e-3, z * 1e-3, *turn)


def forces(scene: Scene, alone: Scene | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Of two sensors on mirrored walks, of which the second turns, (steps, 2, 3) [N]: at once, and each alone."""
    many, one = LiveBatch(scene, 2, image=False, device="cpu"), [LiveSensor(alone or scene, image=False) for _ in range(2)]
    found, known = [], []
    for x, y, z in WALK:
        poses = [pose(x, y, z), pose(-x, y, z, about(2, 20.0 * x))]
        found.append(many.step(np.array(poses), 0.01).force[:, 0].numpy())
        known.append([sensor.step(where, 0.01).force for sensor, where in zip(one, poses, strict=True)])
    return np.array(found), np.array(known)


def as_the_batch(self: Underside, turn: np.ndarray, shift: np.ndarray, x: np.ndarray, y: np.ndarray) -> NDArray[np.float32]:
    """`Underside.heights` traced, not of a map, which shifts rims by up to half a cell: of a punch that is 3 % of the force."""
    found = wp.zeros((1, len(y), len(x)), float, device="cpu")
    placed = wp.array(turn[None], wp.mat33d, device="cpu"), wp.array(shift[None], wp.vec3d, device="cpu")
    across = [wp.array(way, float, device="cpu") for way in (x, y, np.full((len(y), len(x)), 1.0))]
    wp.launch(undersides, found.shape, [self._field.grid("cpu"), *placed, *across, found], device="cpu")
    return found.numpy()[0]


def off(found: np.ndarray, known: np.ndarray) -> tuple[float, float]:
    """Largest difference over the largest force of a walk, along z and along the gel."""
    apart = np.abs(found - known).max(axis=(0, 1)) / np.abs(known[..., 2]).max()
    return float(apart[2]), float(apart[:2].max())


@pytest.mark.parametrize("friction", [0.0, 0.5, "stick"])
@pytest.mark.parametrize("gel", [{"profile": "flat"}, {"profile": "dome", "edge_thickness_mm": 1.6}], ids=["flat", "dome"])
def test_forces_are_those_of_each_alone(friction: float | str, gel: dict) -> None:
    found, known = forces(ball_scene(friction, **gel))
    assert np.less(off(found, known), (FORCE + HELD * (friction != 0.0), SHEAR)).all()
    assert (found[5] == 0).all() and (found[-1, :, 2] < 0).all()
    if friction == 0.5:
        assert np.greater(off(*forces(ball_scene(0.6, **gel), ball_scene(0.5, **gel))), (0.0, SHEAR)).all()  # planted: another law


def soft_poses(x: float, y: float, z: float) -> list[tuple[float, ...]]:
    """Of two sensors; the second object leans, and turns with the way. Were it by 5°, cells of a punch's rim would join and leave at once:
    there the apex of a sensor alone jumps by 14 µm if its pose is moved by 0.2 µm."""
    lean, turn = Rotation.from_euler("x", 3.0, degrees=True), Rotation.from_euler("z", 60.0 + 20.0 * x, degrees=True)
    return [pose(x, y, z), pose(-x, y, z, tuple(np.roll((turn * lean).as_quat(), 1)))]


def soft_alone(scene: Scene, walk: tuple) -> list[list[tuple[LiveFrame, np.ndarray]]]:
    """What two sensors answer, and where their objects' apices have gone [mm]; on the undersides that a batch sees."""
    with pytest.MonkeyPatch.context() as traced:
        traced.setattr(Underside, "heights", as_the_batch)
        one = [LiveSensor(scene, image=False) for _ in range(2)]
        return [[(s.step(at, 0.01), s.state[0].bent) for s, at in zip(one, soft_poses(*place), strict=True)] for place in walk]


def soft_apart(scene: Scene, walk: tuple, known: list) -> tuple[float, ...]:
    """Of a batch from those, the largest: force along z and along the gel, over the largest; apex [mm]; height [m, RMS]; and of the cells
    that touch, a share."""
    many, found = LiveBatch(scene, 2, image=False, device="cpu"), []
    most = max(abs(alone.force[2]) for each in known for alone, _ in each)
    for place, each in zip(walk, known, strict=True):
        frame, aside = many.step(np.array(soft_poses(*place)), 0.01), many._state.aside.numpy()
        for mine, (alone, bent) in enumerate(each):
            x, y, z = np.abs(frame.force[mine, 0].numpy() - alone.force) / most
            other = (frame.contact[mine].numpy() >= 0) != alone.contact
            height = np.sqrt(((frame.height[mine].numpy() - alone.height) ** 2).mean())
            touched = other.sum() / max(alone.contact.sum(), 1)
            found.append((z, max(x, y), np.linalg.norm(aside[mine] - bent), height, touched))
    return tuple(np.max(found, axis=0))


BOUNDS = (FORCE + HELD, SHEAR, 2 * STILL_MM, 1e-6, 0.05)
"""Of `soft_apart`: as of rigid ones, and of the apex twice the motion at which both stop to look. What a soft one adds is less: thickness,
mean height and squash settle to 5e-4 of its height, and its layer's answer, about half of all, goes with the first power of each."""


@pytest.mark.parametrize(
    ("kind", "friction", "gel"),
    [("ball", "stick", {}), ("ball", 0.0, DOME), ("cylinder", 0.5, DOME), ("punch", 0.5, {}), ("box", 0.0, {})],
)
def test_soft_ones_give_way_as_each_alone(kind: str, friction: float | str, gel: dict) -> None:
    """Pressed, sheared, twisted, lifted and pressed again. A friction that holds nothing back leaves the less."""
    scene = soft_scene(kind, friction, **gel)
    known = soft_alone(scene, WALK)
    assert np.less(soft_apart(scene, WALK, known), (BOUNDS[0] - HELD * (friction == 0.0), *BOUNDS[1:])).all()
    assert all(alone.force[2] == 0 for alone, _ in known[5]) and all(alone.force[2] < 0 for alone, _ in known[6])
    assert friction == 0.0 or max(np.linalg.norm(bent) for each in known for _, bent in each) > 5 * BOUNDS[2]  # it does bend


def test_a_soft_batch_with_a_fault_is_told_from_each_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = soft_scene("box", 0.5, **DOME)
    known = soft_alone(scene, WALK[:3])
    assert np.less(soft_apart(scene, WALK[:3], known), BOUNDS).all()
    springs, placed, made = Layers.springs, Spring.compliance, Answers.__init__

    def alike(self: Answers, *of: Any, facing: tuple[int, int] | None = None) -> None:
        made(self, *of, facing=facing)
        self._nodes[:, 4:] *= 1 if facing is None else -1

    faults = (
        (Layers, "springs", lambda self, compliance, apex: 0 * springs(self, compliance, apex)),  # no springs
        (Layers, "springs", lambda self, compliance, apex: springs(self, compliance, 0 * apex)),  # about the middle of the gel
        (Spring, "compliance", lambda self, turn, load, low, squash: placed(self, turn, load, low, 0 * squash)),  # it keeps its height
        (Spring, "compliance", lambda self, turn, load, low, squash: placed(self, turn, 0 * load, low, squash)),  # a load does not bend it
        (Spring, "compliance", lambda self, turn, *of: placed(self, torch.eye(3).double().expand_as(turn), *of)),  # its springs do not turn
        (batch, "BENDINGS", 0),  # it touches where its base is
        (Answers, "__init__", alike),  # a face that looks the same way
    )
    for where, name, fault in faults:
        with monkeypatch.context() as planted:
            planted.setattr(where, name, fault)
            assert np.greater(soft_apart(scene, WALK[:3], known), BOUNDS).any(), name


def test_a_soft_one_that_is_refused_leaves_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "FLATTEST", 0.95)
    many, still = LiveBatch(soft_scene("ball"), 2, image=False, device="cpu"), pose(0.0, 0.0, -0.1)
    before = many.step(np.array([still, still]), 0.01)
    for at, said in (
        (pose(0.0, 0.0, -0.3, about(0, 30.0)), r"poses\[1\]: the object leans by (2[0-9]|30)°; .* allowed are 20°"),
        (pose(0.0, 0.0, -1.3), r"poses\[1\]: the soft object, 6 mm high, is pressed flat"),
    ):
        with pytest.raises(SceneError, match=said):
            many.step(np.array([still, at]), 0.01)
        assert torch.allclose(many.step(np.array([still, still]), 0.01).force, before.force, rtol=FORCE, atol=1e-6)


def test_a_block_of_threads_shares_a_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a GPU does it; a CPU alone has one thread a block. Sums are of another order then, in double precision: alike to single's."""

    def walked() -> np.ndarray:
        batch = LiveBatch(ball_scene(), 2, image=False, device="cpu")
        return np.array([batch.step(np.array([pose(x, y, z), pose(-x, y, z)]), 0.01).force.numpy() for x, y, z in WALK[:3]])

    alone = walked()
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    assert walked() == pytest.approx(alone, rel=1e-5, abs=1e-5 * np.abs(alone).max())
    monkeypatch.setattr(batch_layer, "BLOCK", 64)
    assert walked() == pytest.approx(alone, rel=1e-5, abs=1e-5 * np.abs(alone).max())


def test_heights_markers_torque_and_contact_are_those_of_each_alone() -> None:
    scene = ball_scene()
    many, one = LiveBatch(scene, 1, image=False, device="cpu"), LiveSensor(scene, image=False)
    for x, y, z in WALK[:4]:
        frame, known = many.step(np.array([pose(x, y, z, about(0, 8.0))]), 0.01), one.step(pose(x, y, z, about(0, 8.0)), 0.01)
        touching = frame.contact[0].numpy() >= 0
        assert (touching != known.contact).sum() <= 0.05 * known.contact.sum()  # cells of the rim
        apart = (frame.height[0].numpy() - known.height)[touching == known.contact]  # what touches is held where it is read
        assert np.sqrt((apart**2).mean()) < 1e-6  # a gap of 1e-3 of 0.55 mm, the map's 0.3 µm
        apart = frame.marker_pixels[0].numpy() - known.marker_pixels
        assert np.nanmax(np.abs(apart)) < 0.2 and (np.isnan(apart) == np.isnan(known.marker_pixels)).all()  # of 25 pixels a millimetre
        moment = np.abs(known.torque).max() + 1e-3 * abs(known.force[2])
        assert np.abs(frame.torque[0, 0].numpy() - known.torque).max() < 2 * SHEAR * moment
    lower = many.step(np.array([pose(x, y, z - 0.005, about(0, 8.0))]), 0.01).height[0].numpy()
    assert np.sqrt(((lower - known.height) ** 2).mean()) > 1e-6  # planted: 5 µm


def test_a_picture_is_that_of_a_sensor_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bake, "light_field", lambda *_: linear_field())
    ball = Body(shape="hemisphere", radius_mm=2.0, height_mm=4.0, rigid=True)
    scene = flat_scene(gel=Gel(size_mm=(8.0, 8.0), profile="flat"), object=ball)
    many, one = LiveBatch(scene, 2, device="cpu"), LiveSensor(scene)
    frame = many.step(np.array([pose(0.5, 0.0, -0.4), pose(0.0, 0.0, 0.5)]), 0.01)
    known = one.step(pose(0.5, 0.0, -0.4), 0.01).image
    assert frame.image is not None and known is not None and frame.image.dtype == torch.uint8
    apart = np.abs(frame.image[0].numpy().astype(int) - known.astype(int))
    assert apart.mean() < 0.1  # of 255; the key of the noise is the same
    assert np.abs(frame.image[1].numpy().astype(int) - known.astype(int)).mean() > 0.5  # planted: the gel at rest


@pytest.mark.parametrize("scene", [ball_scene(), ball_scene(0.0, **DOME), soft_scene("box")], ids=["rigid", "frictionless", "soft"])
def test_a_sensor_answers_as_if_the_others_were_not_there(scene: Scene) -> None:
    """What stops one is its own; sums are rounded differently, which may stop it a step later: 1e-3 of the overlap. Without friction, on a
    dome, they settle in different rounds."""
    batch, alone = LiveBatch(scene, 3, image=False, device="cpu"), LiveBatch(scene, 1, image=False, device="cpu")
    for x, y, z in WALK[:4]:
        poses = np.array([pose(x, y, z), pose(-x, 2 * y, 0.5 * z), pose(0.0, 0.0, 1.0)])
        frame, known = batch.step(poses, 0.01), alone.step(poses[:1], 0.01)
        assert torch.allclose(frame.force[0], known.force[0], rtol=FORCE, atol=FORCE * 1e-2)
        assert torch.allclose(frame.height[0], known.height[0], atol=1e-6)
        assert not frame.force[2].any() and not (frame.contact[2] >= 0).any()


def test_sensors_that_are_done_do_not_move_while_others_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """They did: rounding showed their slipping cells a way of negative length, and searches ran to their last step, 200."""
    taken = []
    real = Layers.dragged
    monkeypatch.setattr(Layers, "dragged", lambda self, ways, shear: (taken.append(len(shear)), real(self, ways, shear))[1])
    rng, many = np.random.default_rng(0), LiveBatch(ball_scene(), 8, image=False, device="cpu")
    at, way = rng.uniform(-1.5, 1.5, (8, 2)), rng.uniform(0, 2 * np.pi, 8)
    for step in range(12):
        aside = 0.02 * max(step - 7, 0)
        places = at + aside * np.stack([np.cos(way), np.sin(way)], 1)
        taken.clear()
        many.step(np.array([pose(x, y, -0.04 * min(step + 1, 8)) for x, y in places]), 0.01)
        assert len(taken) < layer.STEPS / 2  # of all searches of a step together: some 30


@pytest.mark.parametrize("scene", [ball_scene(), soft_scene("ball")], ids=["rigid", "soft"])
def test_resets_forget_what_was_and_nothing_else(scene: Scene) -> None:
    batch = LiveBatch(scene, 2, image=False, device="cpu")

    def walked() -> list[BatchFrame]:
        return [batch.step(np.array([pose(x, y, z), pose(y, x, z)]), 0.01) for x, y, z in WALK[:4]]

    first = walked()
    batch.reset()
    assert all(torch.equal(a.force, b.force) and torch.equal(a.height, b.height) for a, b in zip(first, walked(), strict=True))
    batch.reset([1])
    still = batch.step(np.array([pose(*WALK[3]), pose(*WALK[3])]), 0.01)
    assert torch.allclose(still.force[0], first[-1].force[0], rtol=FORCE, atol=1e-6)
    assert abs(float(still.force[1, 0, 0])) < 0.02 * abs(float(still.force[1, 0, 2]))  # pressed straight down


def test_of_several_objects_each_tells_its_own_force() -> None:
    """A ball and a box, 6 mm apart on a gel of 2.4 mm: what one does to the other falls by e^(-k x), k h = 2.3 at least, so to
    exp(-2.3 · 3 / 2.4) = 5.6 % between their edges, of which what forces are multiplied by sees at most 0.28 more; and one that hangs above
    changes nothing."""
    scene = ball_scene(0.4)
    box = Body(shape="box", width_mm=2.0, length_mm=3.0, height_mm=3.0, rigid=True)
    pair = LiveBatch(scene, 1, (scene.object, box), image=False, device="cpu")
    ball_alone, box_alone = (LiveBatch(scene, 1, (body,), image=False, device="cpu") for body in (scene.object, box))
    for x, z in ((0.0, -0.2), (0.0, -0.3), (0.05, -0.3)):
        ball, brick = pose(-3.0 + x, 0.0, z), pose(3.0, x, 0.5 * z)
        both = pair.step(np.array([[ball, brick]]), 0.01)
        for number, (alone, where) in enumerate(((ball_alone, ball), (box_alone, brick))):
            known = alone.step(np.array([where]), 0.01)
            assert torch.allclose(both.force[0, number], known.force[0, 0], atol=0.071 * float(-known.force[0, 0, 2]))
        assert set(both.contact.unique().tolist()) == {-1, 0, 1}
    pair.reset()
    ball_alone.reset()
    above = pair.step(np.array([[pose(-3.0, 0.0, -0.3), pose(3.0, 0.0, 1.0)]]), 0.01)
    known = ball_alone.step(np.array([pose(-3.0, 0.0, -0.3)]), 0.01)
    assert torch.allclose(above.force[0, 0], known.force[0, 0], rtol=1e-5) and not above.force[0, 1].any()


def test_bad_input_is_named_and_leaves_the_gels_as_they_were() -> None:
    scene = ball_scene()
    batch = LiveBatch(scene, 2, image=False, device="cpu")
    before = batch.step(np.array([pose(0.0, 0.0, -0.3)] * 2), 0.01)
    sound = np.array([pose(0.0, 0.0, -0.3)] * 2)
    for poses, named in (
        (sound[:1], r"shape \(1, 1, 7\).*\(2, 1, 7\)"),
        (sound * np.nan, r"poses\[0, 0\]"),
        (np.array([pose(0.0, 0.0, -0.3), pose(0.0, 0.0, -2.0)]), r"poses\[1\].*1\.44 mm"),
        (np.array([pose(0.0, 0.0, -0.3), pose(0.0, 0.0, -0.3, (2.0, 0.0, 0.0, 0.0))]), r"poses\[1, 0\].*length 1"),
        ("there", "shape"),
    ):
        with pytest.raises(SceneError, match=named):
            batch.step(poses, 0.01)
    with pytest.raises(SceneError, match="dt = 0"):
        batch.step(sound, 0)
    assert torch.equal(batch.step(sound, 0.01).contact, before.contact)
    with pytest.raises(SceneError, match="sensors = 0"):
        LiveBatch(scene, 0)
    with pytest.raises(SceneError, match="objects"):
        LiveBatch(scene, 1, ())
    with pytest.raises(SceneError, match="several with rigid = true, or a single soft one"):
        LiveBatch(scene, 1, (scene.object, soft_scene("ball").object), image=False)
    if not torch.cuda.is_available():
        with pytest.raises(RenderError, match="no GPU"):
            gelsim.LiveBatch(scene, 1, device="cuda")


@pytest.mark.gpu
def test_a_gpu_answers_as_the_processor() -> None:
    scene = ball_scene()
    one, other = (LiveBatch(scene, 4, image=False, device=device) for device in ("cpu", "cuda"))
    for x, y, z in WALK[:4]:
        poses = np.array([pose(x + 0.1 * i, y, z) for i in range(4)])
        known, frame = one.step(poses, 0.01), other.step(torch.as_tensor(poses, device="cuda"), 0.01)
        assert frame.force.is_cuda and frame.height.is_cuda and frame.marker_pixels.is_cuda
        assert torch.allclose(frame.force.cpu(), known.force, atol=FORCE * float(known.force.abs().max()))
        assert torch.allclose(frame.height.cpu(), known.height, atol=2e-6)
