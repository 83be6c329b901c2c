"""Presses along a path: beside theory (the numbers of `gelsim bench --only motion`), and each way of saying one against another."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gelsim
from gelsim.bench import closed_forms, motion
from gelsim.bench.section import Known
from gelsim.errors import PressEnd, SceneError, SolveStatus
from gelsim.fem import quasistatic
from gelsim.fem.contact import ContactLaw
from gelsim.fem.quasistatic import FORCE_TOLERANCE
from gelsim.results import Deformation
from gelsim.scene.layers import build_scene, dump_scene, load_scene

STOPS = 2e-3
"""Of a force at `fast`: Newton stops at 1e-3, and a step that was cut elsewhere leaves another overlap, of 1 µm in 0.4 mm at most."""


def pressed(press: dict[str, Any], friction: float = 0.0, **sections: dict[str, Any]) -> Deformation:
    layer: dict[str, Any] = {
        "gel": {"profile": "flat", "size_mm": [16.0, 16.0], "youngs_modulus_kpa": 50.0},
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 10.0, "rigid": True},
        "contact": {"friction_coefficient": friction},
        "press": press,
        "fidelity": "fast",
    }
    return gelsim.press(build_scene(layer | {name: layer.get(name, {}) | given for name, given in sections.items()}), device="cpu")


@pytest.mark.parametrize("known", list(motion.known()), ids=lambda known: known.name)
def test_motion_is_as_theory_says(known: Known) -> None:
    assert closed_forms.measured(known)["verdict"] == "met"


def test_another_bound_of_friction_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: points slide at a tenth more than μ p."""
    monkeypatch.setattr(ContactLaw, "coefficient", staticmethod(lambda contact: 1.1 * contact.friction_coefficient))
    share, found, theory = motion.partial_slip(motion.slid.__wrapped__())
    ratio = np.abs(found / theory - 1)
    assert (ratio[share < 1.0] > 0.05).any() and (ratio[share > motion.FULL_SLIP] > 0.01).all()


def test_one_waypoint_is_the_short_form() -> None:
    short = pressed({"depth_mm": 0.4, "shear_mm": [0.2, 0.0], "frames": 3, "speed_mm_s": 2.0}, 0.3)
    path = pressed({"path": [{"depth_mm": 0.4, "shear_mm": [0.2, 0.0], "duration_s": 0.2}], "frames": 3}, 0.3)
    assert path.time == pytest.approx(short.time) and path.approach == pytest.approx(short.approach)
    assert path.force == pytest.approx(short.force, abs=STOPS * np.abs(short.force).max())
    assert path.report.ended_by == PressEnd.PATH


def test_several_forces_are_states_of_one_press() -> None:
    press = pressed({"force_n": [0.05, 0.1, 0.3], "frames": 4})
    assert -press.force[1:, 2] == pytest.approx([0.05, 0.1, 0.3], rel=FORCE_TOLERANCE)
    alone = pressed({"depth_mm": None, "force_n": 0.3, "frames": 3})
    # twice the tolerance in force, which goes as the approach to the power of 1.5
    assert press.approach[-1] == pytest.approx(alone.approach[-1], rel=2 * (FORCE_TOLERANCE + STOPS) / 1.5)


def test_a_force_is_held_while_the_object_slides_and_is_let_go() -> None:
    way = [{"force_n": 0.1}, {"shear_mm": [0.6, 0.0]}, {"force_n": 0.05}, {"depth_mm": -0.1}]
    press = pressed({"path": way, "frames": 9}, 0.3)
    wanted = np.interp(press.time, [0.0, 1.0, 2.0, 3.0], [0.0, 0.1, 0.1, 0.05])
    there = press.time < 3.1
    assert -press.force[there, 2] == pytest.approx(wanted[there], rel=FORCE_TOLERANCE)
    assert not press.force[-1].any()


def test_a_force_is_found_again_from_above_the_gel() -> None:
    press = pressed({"path": [{"force_n": 0.1}, {"depth_mm": -1.0}, {"force_n": 0.05}], "frames": 4})
    assert not press.force[2].any() and press.approach[2] == -1e-3
    assert -press.force[[1, 3], 2] == pytest.approx([0.1, 0.05], rel=FORCE_TOLERANCE)


def test_a_held_approach_relaxes_and_a_held_force_creeps() -> None:
    viscous = {"prony_g": [0.3], "prony_tau_s": [0.3]}
    held = pressed({"path": [{"depth_mm": 0.4, "duration_s": 0.05}, {"duration_s": 2.0}], "frames": 5}, gel=viscous)
    short = pressed({"depth_mm": 0.4, "speed_mm_s": 8.0, "frames": 2, "hold_s": 2.0}, gel=viscous)
    # both end where all has relaxed but e^(-2/0.3) = 0.1 % of 30 %, whatever steps led there
    assert held.force[-1] == pytest.approx(short.force[-1], abs=STOPS * np.abs(short.force).max())
    fast, end = -held.force[1, 2], -held.force[-1, 2]
    assert end / fast < 0.75 and (np.diff(-held.force[1:, 2]) < 0.0).all()
    creep = pressed({"path": [{"force_n": 0.1, "duration_s": 0.05}, {"duration_s": 2.0}], "frames": 5}, gel=viscous)
    assert -creep.force[1:, 2] == pytest.approx(0.1, rel=FORCE_TOLERANCE) and (np.diff(creep.approach) > 0.0).all()


def test_a_measured_path_is_the_waypoints_that_it_goes_through(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("t_s,x_mm,y_mm,z_mm,ry_deg\n7,1,0,0.1,0\n7.5,1,0,-0.3,0\n8.5,1.4,0,-0.3,4\n")
    (tmp_path / "scene.toml").write_text(
        '[gel]\nprofile = "flat"\nsize_mm = [16.0, 16.0]\nyoungs_modulus_kpa = 50.0\n[object]\nshape = "hemisphere"\nheight_mm = 10.0\n'
        'rigid = true\n[press]\npath_csv = "path.csv"\nframes = 7\n'
    )
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.press.offset_mm == (1.0, 0.0) and build_scene(tomllib.loads(dump_scene(scene))) == scene
    measured = gelsim.press(scene.replace(fidelity="fast"), device="cpu")
    way = [{"depth_mm": -0.1, "duration_s": 0.01}, {"depth_mm": 0.3, "duration_s": 0.5}, {"shear_mm": [0.4, 0.0], "tilt_deg": [0.0, 4.0]}]
    said = pressed({"path": way, "frames": 8, "offset_mm": [1.0, 0.0]}, 0.8)
    assert measured.time == pytest.approx(np.linspace(0.0, 1.5, 7)) and measured.approach[0] == pytest.approx(-1e-4, abs=1e-8)
    assert measured.force[-1] == pytest.approx(said.force[-1], abs=2 * STOPS * np.abs(said.force).max())


def test_a_measured_path_that_begins_in_the_gel_is_refused(tmp_path: Path) -> None:
    (tmp_path / "deep.csv").write_text("t_s,x_mm,y_mm,z_mm\n0,0,0,-0.1\n1,0,0,-0.2\n")
    with pytest.raises(SceneError, match="path_csv begins 0.1 mm below first touch"):
        pressed({"path_csv": str(tmp_path / "deep.csv")})


def test_a_path_that_is_lost_goes_on_by_another_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first try finds nothing beyond half of its slide, under a force; the one that goes on from there ends where the first would."""
    way = [{"force_n": 0.1}, {"shear_mm": [0.2, 0.0]}, {"depth_mm": 0.1}]
    expected = pressed({"path": way, "frames": 7}, 0.8)
    attempt = quasistatic._March._attempt  # pyright: ignore[reportPrivateUsage]

    def ends(march, here, new, approach, **again):  # type: ignore[no-untyped-def]
        if not march.problem.held and new > 1.5 + 1e-9:
            march.status = SolveStatus.MAX_ITERATIONS
            return False
        return (yield from attempt(march, here, new, approach, **again))

    monkeypatch.setattr(quasistatic._March, "_attempt", ends)  # pyright: ignore[reportPrivateUsage]
    press = pressed({"path": way, "frames": 7}, 0.8)
    assert press.report.ended_by == PressEnd.PATH and press.report.tried == 2 and len(press.time) == 7
    assert press.time == pytest.approx(expected.time)
    assert press.report.went_on_from_mm == (pytest.approx(1e3 * press.approach[3], abs=1e-3),)
    # volume that is held makes a mesh at `fast` up to 2 % stiffer (docs/mechanics.md): less deep by 2/3 of that at the same force
    assert press.approach[:5] == pytest.approx(expected.approach[:5], rel=0.015, abs=1e-6)
    assert press.force[:5, 0] == pytest.approx(expected.force[:5, 0], abs=0.02 * 0.1)
