"""Soft objects before the live sensor: two layers in series, a rod's springs, presses of finite elements, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import gelsim
from gelsim.bench.live import heights_over, near
from gelsim.errors import SceneError
from gelsim.fem import quiet_warp
from gelsim.fem.compliance import HeldBody
from gelsim.live import layer as gel_layer
from gelsim.live import sensor as live_sensor
from gelsim.live import soft
from gelsim.live.layer import Elastic, Layer, SoftBody, against, pressure
from gelsim.live.press import expected_error
from gelsim.live.sensor import LiveSensor
from gelsim.mesh.body_mesh import mesh_object
from gelsim.scene import materials
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene

BALL = {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 12.0, "shore_00": 30.0}
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def scene(friction: float = 0.5, press: dict | None = None, fidelity: str = "live", **body: object) -> Scene:
    return build_scene(
        {
            "gel": {"profile": "flat", "thickness_mm": 2.4},
            "object": BALL | body,
            "contact": {"friction_coefficient": friction},
            "press": {"depth_mm": 0.72, "frames": 4} | (press or {}),
            "fidelity": fidelity,
        }
    )


def layers(nu: float, of_body: float, compliance: np.ndarray) -> tuple[gel_layer.Window, gel_layer.Window]:
    """A window on a layer of 2.4 mm and 20 kPa, rigid above, and against a like layer of so many kPa, on springs."""
    gel = Layer((20.0, 20.0), Elastic(20.0, nu))
    window = gel.window((60, 60), 2.4)
    body = SoftBody(gel.under(Elastic(of_body, nu), 2.4), 2.4, 0.0, compliance, np.zeros(2), gel.x[20:80], gel.y[20:80])
    return window, against(window, body)


@pytest.mark.parametrize("nu", [0.3, 0.499])
def test_two_like_layers_give_way_twice_as_much(nu: float) -> None:
    """By the mirror plane between them: they come closer, and slip, twice as far; and pressure does not shear them (Dundurs), nor shear
    part them. Up to rounding of float32, and the wider grid of the body's: by a wave of 20 mm, exp(-2π 10 / 2.4)."""
    alone, both = layers(nu, 20.0, np.zeros((6, 6)))
    x, y = np.meshgrid(np.arange(60) - 24.0, np.arange(60) - 32.0)
    p = np.exp(-(x**2 + 2 * y**2) / 200).astype(np.float32)
    q = np.stack([p * y, p]).astype(np.float32)
    scale = np.abs(alone.sunk(p)).max()
    np.testing.assert_allclose(both.sunk(p), 2 * alone.sunk(p), atol=1e-4 * scale)
    np.testing.assert_allclose(both.dragged(q), 2 * alone.dragged(q), atol=1e-4 * np.abs(alone.dragged(q)).max())
    assert np.abs(both.lifted(q)).max() < 1e-4 * np.abs(alone.dragged(q)).max()
    assert np.abs(both.moved(p, 0 * q)[:2]).max() < 1e-4 * scale
    assert np.abs(alone.moved(p, 0 * q)[:2]).max() > 0.05 * scale  # which is not nothing
    np.testing.assert_allclose(both.alone(q), [both.sunk(q[0]), both.dragged(np.stack([q[1], 0 * q[1]]))[0]], atol=1e-4 * np.abs(q).max())


@pytest.mark.parametrize("ratio", [0.5, 1.0, 4.0])
def test_their_moduli_are_in_series(ratio: float) -> None:
    """A ball between two layers of 20 and 20 ratio kPa has the pressure of a rigid one on a layer of 20 ratio / (1 + ratio), up to the gaps
    that are left: GAP_TOLERANCE of the overlap, 2 % of the force at most by test_live.py's closed form of one layer."""
    alone, both = layers(0.499, 20.0 * ratio, np.zeros((6, 6)))
    x, y = np.meshgrid(*[0.2 * (np.arange(60) - 29.5)] * 2)
    room = ((x**2 + y**2) / 10 - 0.4).astype(np.float32)
    found, known = (float(pressure(one, room, 0 * room)[0].sum()) for one in (both, alone))
    assert found == pytest.approx(known * ratio / (1 + ratio), rel=2 * gel_layer.GAP_TOLERANCE)


def test_springs_are_in_series_too() -> None:
    """Under a given pressure they add force times compliance, turned about the middle by its torque."""
    compliance = np.diag([1.0, 2.0, 3.0, 0.5, 0.4, 0.3]) * 1e-3
    compliance[0, 4] = compliance[4, 0] = 1e-4
    alone, both = layers(0.499, 1e6, compliance)
    x, y = np.meshgrid(*[0.2 * (np.arange(60) - 29.5)] * 2)
    p = np.zeros((60, 60), np.float32)
    p[35, 40] = 100.0  # kPa on 0.04 mm², 4 mN
    up = both.sunk(p) - alone.sunk(p)
    at = x[35, 40], y[35, 40]
    known = 4 * (3e-3 + 5e-4 * at[1] * y + 4e-4 * at[0] * x)
    np.testing.assert_allclose(up, known, atol=1e-3 * known.max())  # 20 kPa over 1e6, and rounding
    none = np.zeros((2, 60, 60), np.float32)
    np.testing.assert_allclose(both.moved(p, none)[0], alone.moved(p, none)[0] + 4 * 1e-4 * at[0], atol=1e-4)
    q = np.stack([2 * p, -p])
    torque = -4 * at[0] - 8 * at[1]
    known = [8 * 1e-3 - 3e-4 * torque * y, -4 * 2e-3 + 3e-4 * torque * x]
    np.testing.assert_allclose(both.dragged(q) - alone.dragged(q), known, atol=1e-3 * np.abs(known).max())


def test_a_rod_is_as_stiff_as_its_formulas() -> None:
    """Of ν = 0, pulled evenly: H / EA, exactly; bent by a force at its end: H³ / 3EI + H / κGA (Timoshenko, κ = 6/7, which is itself 1 %
    right). Its round side is drawn by six-node faces within 10 µm, 0.7 % of A at most, twice that of I."""
    quiet_warp()
    radius, height, modulus = 3.0, 24.0, 100.0
    rod = {"shape": "punch", "radius_mm": radius, "height_mm": height, "youngs_modulus_kpa": modulus, "poissons_ratio": 0.0}
    given = build_scene({"gel": {"profile": "flat"}, "object": rod, "press": {"depth_mm": 0.5}})
    material = materials.object_material(given)
    assert material is not None
    body = HeldBody(mesh_object(given.replace(fidelity="fast")), material)
    end = -body.areas * (body.points[:, 2] < 1e-6)
    forces = np.zeros((2, len(end), 3))
    forces[0, :, 2], forces[1, :, 0] = end / end.sum(), end / end.sum()
    area = np.pi * radius**2
    assert end.sum() == pytest.approx(area, rel=0.007)
    stretched, bent = np.diag(body.work(forces))
    assert stretched == pytest.approx(height / (modulus * area), rel=0.007)
    second = np.pi * radius**4 / 4
    assert bent == pytest.approx(height**3 / (3 * modulus * second) + height / (6 / 7 * modulus / 2 * area), rel=0.024)


def off(press: gelsim.Deformation, truth: gelsim.Deformation) -> tuple[float, float, float]:
    """Of the last state: relative normal and shear force, and height [µm, RMS]."""
    middle, radius = near(truth, -1)
    places = middle + radius * np.random.default_rng(1).uniform(-1, 1, (300, 2))
    places = places[np.hypot(*(places - middle).T) < radius]
    height = heights_over(press, -1, places) - heights_over(truth, -1, places)
    found, wanted = press.force[-1], truth.force[-1]
    shear = np.linalg.norm(found[:2] - wanted[:2]) / max(np.linalg.norm(wanted[:2]), 1e-3 * abs(wanted[2]))
    return abs(found[2] / wanted[2] - 1), float(shear), 1e6 * float(np.sqrt(np.mean(height**2)))


def no_springs(spring: soft.Spring) -> soft.Spring:
    return replace(spring, compliances=np.tile(1e-9 * np.eye(6), (len(spring.lows), 1, 1)))


def test_a_press_is_that_of_finite_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    given = scene(press={"depth_mm": 0.6})
    truth = gelsim.press(given.replace(fidelity="balanced"))
    force, height = expected_error(given, 0.6)
    own = truth.report.error_estimate
    assert own is not None
    normal, _, high = off(gelsim.press(given), truth)
    assert normal < force + own.force and high < min(height, 5.3) + own.membrane_um  # `height` is the worst of all: released, small ones
    made = soft.spring
    monkeypatch.setattr(soft, "spring", lambda *of: no_springs(made(*of)))  # planted: a layer, and no springs
    normal, _, high = off(gelsim.press(given), truth)
    assert normal > force + own.force and high > height + own.membrane_um


def test_a_low_wide_one_is_that_of_finite_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """R 20 mm, 4 mm high, 0.4 of the thickness deep: 5 % off. Springs of one small contact, or pressure straight up and not
    along the normals, make it over 8 %."""
    given = scene(press={"depth_mm": 0.96}, radius_mm=20.0, height_mm=4.0)
    truth = gelsim.press(given.replace(fidelity="fast"))
    force, height = expected_error(given, 0.96)
    own = truth.report.error_estimate
    assert own is not None
    normal, _, high = off(gelsim.press(given), truth)
    assert normal < 0.05 < force + own.force and high < height + own.membrane_um
    made = soft.spring

    def of_first(*of: Any) -> soft.Spring:
        spring = made(*of)
        return replace(spring, compliances=np.tile(spring.compliances[0], (len(spring.lows), 1, 1)))

    monkeypatch.setattr(soft, "spring", of_first)  # planted: the contact does not grow
    assert off(gelsim.press(given), truth)[0] > 0.08
    monkeypatch.setattr(soft, "spring", made)
    monkeypatch.setattr(soft, "HeldBody", Upright)  # planted: faces that do not lean
    assert off(gelsim.press(given), truth)[0] > 0.08


def test_a_low_punch_is_that_of_finite_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """R 4 mm, 2 mm high, 0.4 of the thickness deep: a quarter of its height is gone, 15 % of the force is missing, as is told. On springs
    that do not stiffen as it shortens it is 23 %."""
    given = scene(press={"depth_mm": 0.96}, shape="punch", radius_mm=4.0, height_mm=2.0)
    truth = gelsim.press(given.replace(fidelity="fast"))
    normal, _, _ = off(gelsim.press(given), truth)
    assert normal < 0.17 < expected_error(given, 0.96)[0]  # `balanced` is 0.3 % from it
    placed = soft.Spring.placed
    monkeypatch.setattr(soft.Spring, "placed", lambda self, *of: placed(self, *of[:-1], 0.0))  # planted: it keeps its height
    assert off(gelsim.press(given), truth)[0] > 0.2


class Upright(HeldBody):
    """Of a body whose faces are all level."""

    def __init__(self, *of: Any) -> None:
        super().__init__(*of)
        self.facing[:, :2] = 0.0


def test_a_sheared_press_is_that_of_finite_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its base goes 0.5 mm aside, its apex less; shear within 10 %, where 20 are asked."""
    given = scene(press={"depth_mm": 0.96, "shear_mm": [0.5, 0.0], "frames": 9})
    truth = gelsim.press(given.replace(fidelity="fast"))
    force, height = expected_error(given, 0.96)
    normal, shear, high = off(gelsim.press(given), truth)
    assert truth.report.error_estimate is not None
    own = truth.report.error_estimate
    assert normal < force + own.force and shear < 0.1 and high < height + own.membrane_um
    with monkeypatch.context() as planted:
        planted.setattr(soft, "BOW", 0.0)  # a load does not bend it further
        assert off(gelsim.press(given), truth)[1] > 0.1
    monkeypatch.setattr(live_sensor.State, "bent", np.zeros(2))  # planted: its apex goes with the base
    assert off(gelsim.press(given), truth)[2] > high + 2.0


def test_all_ways_are_alike() -> None:
    """A ball sheared along x, along y, and turned with its way: its mesh is not as round as it, 1.1 % of its springs along the gel."""
    sensor, found = LiveSensor(scene(), image=False), []
    for turn, way in ((0, (0.3, 0.0)), (0, (0.0, 0.3)), (30, (0.3, 0.0))):
        sensor.reset()
        half = np.radians(turn) / 2
        quaternion = (float(np.cos(half)), 0.0, 0.0, float(np.sin(half)))
        sensor.step((0.0, 0.0, -0.6e-3, *quaternion), 0.1)
        frame = sensor.step((way[0] * 1e-3, way[1] * 1e-3, -0.6e-3, *quaternion), 0.1)
        along = frame.force[:2] @ np.array(way) / 0.3
        assert abs(frame.force[0] * way[1] - frame.force[1] * way[0]) < 0.02 * 0.3 * along
        found.append([along, frame.force[2]])
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (3, 2)), rtol=0.015)
    assert np.array_equal(LiveSensor(scene(), image=False).step((0, 0, -6e-4, *UPRIGHT), 0.1).force, at_first(sensor))


def at_first(sensor: LiveSensor) -> np.ndarray:
    """Of a press after a reset, which gives the same."""
    sensor.reset()
    return sensor.step((0, 0, -6e-4, *UPRIGHT), 0.1).force


def test_its_force_goes_on_by_its_stiffness() -> None:
    """`patch` has gel and object in series: within 15 % of a difference of 20 µm, in which the contact grows; without the object it is over
    twice as stiff."""
    sensor = LiveSensor(scene(0.0), image=False)
    before = sensor.step((0, 0, -0.60e-3, *UPRIGHT), 0.1).force[2]
    stiffness = sensor.patch().stiffness[2, 2]
    slope = (sensor.step((0, 0, -0.62e-3, *UPRIGHT), 0.1).force[2] - before) / -20e-6
    assert stiffness == pytest.approx(slope, rel=0.15)
    rigid = LiveSensor(scene(0.0, rigid=True, shore_00=None), image=False)
    rigid.step((0, 0, -0.60e-3, *UPRIGHT), 0.1)
    assert abs(rigid.patch().stiffness[2, 2]) > 2 * abs(slope)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"skin": {"thickness_mm": 0.5, "shore_00": 60.0}}, r"object\.skin"),
        ({"shape": "candy", "radius_mm": 5.0}, r"object\.grains"),
        ({"prony_g": [0.2], "prony_tau_s": [1.0]}, r"object\.prony_g = \[0\.2\]"),
        ({"law": "yeoh", "law_constants": {"c2_over_c1": 0.1, "c3_over_c1": 0.0}}, r"object\.law = 'yeoh'"),
        ({"shape": "shell", "wall_mm": 0.8}, r"thinner than 1\.2 mm, 0\.5 of gel\.thickness_mm"),
    ],
)
def test_what_it_has_not_is_refused(change: dict, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        LiveSensor(scene(**change), image=False)


def test_a_rod_that_would_bend_by_itself_is_held() -> None:
    """Under twice the load of MOST_LOAD, R 2.5 mm and 25 high: no less force as it goes down, and drawn aside it drags the gel along, more
    and more. Under its own load, not MOST_LOAD's, it would go where rounding sends it, and less far the further it is drawn."""
    sensor = LiveSensor(scene(0.5, radius_mm=2.5, height_mm=25.0), image=False)
    down = np.array([sensor.step((0, 0, -depth * 1e-3, *UPRIGHT), 0.1).force for depth in np.arange(0.1, 1.4, 0.3)])
    aside = np.array([sensor.step((way * 1e-3, 0, -1.3e-3, *UPRIGHT), 0.1).force for way in np.arange(0.1, 0.5, 0.1)])
    assert (np.diff(down[:, 2]) < 0).all()
    assert np.abs(down[:, :2]).max() < 1e-3 * np.abs(down[-1, 2])
    assert (np.diff(aside[:, 0], prepend=0.0) > 0).all()
    assert np.abs(aside[:, 1]).max() < 0.1 * aside[-1, 0]


def test_one_as_wide_as_the_gel() -> None:
    """Of it only what is over the gel touches: stiffer than a rod with free sides, 625 mm² of 103 kPa and 6 mm, and not as if it were held
    beside, when like the gel it would only be compressed: 200 N."""
    flat = {"shape": "flat", "radius_mm": 5.0, "width_mm": 30.0, "length_mm": 30.0, "height_mm": 6.0}
    found = -LiveSensor(scene(0.0, **flat), image=False).step((0, 0, -0.2e-3, *UPRIGHT), 0.1).force[2]
    rod = 103e-3 * 625 * 0.2 / 6  # MPa mm²
    assert rod < found < 10 * rod


def test_a_lean_is_refused_without_a_trace() -> None:
    sensor = LiveSensor(scene(), image=False)
    before = sensor.step((0, 0, -0.3e-3, *UPRIGHT), 0.1)
    with pytest.raises(SceneError, match=r"leans by (2[0-9]|30)°; .* allowed are 20°"):
        sensor.step((0, 0, -0.3e-3, np.cos(np.pi / 12), np.sin(np.pi / 12), 0, 0), 0.1)
    _, pose, _ = sensor.state
    assert pose is not None and np.array_equal(pose[0], np.eye(3))
    np.testing.assert_array_equal(sensor._frame().force, before.force)
