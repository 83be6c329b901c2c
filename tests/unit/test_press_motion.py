"""A press's motion as it is said, without solving it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gelsim.errors import SceneError
from gelsim.mesh.contact_area import footprint
from gelsim.mesh.reductions import choose_reduction
from gelsim.scene.definition import Press, Waypoint
from gelsim.scene.layers import build_scene
from gelsim.scene.measured_path import measured_path
from gelsim.scene.motion import motion, shared_out, straight, widest
from gelsim.shape.shapes import press_symmetry


def test_what_a_waypoint_leaves_out_stays() -> None:
    way = motion(Press(frames=6, tilt_deg=(1.0, 0.0), path=(
        Waypoint(depth_mm=0.5), Waypoint(shear_mm=(1.0, 0.0), duration_s=3.0), Waypoint(force_n=2.0, twist_deg=5.0))))  # fmt: skip
    assert way is not None
    assert way.time.tolist() == [0.0, 1.0, 4.0, 5.0] and way.by_force.tolist() == [False, False, False, True]
    assert way.shear.tolist() == [[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0]]
    assert way.turn.tolist() == [[1.0, 0.0, 0.0]] * 3 + [[1.0, 0.0, 5.0]]
    assert way.recorded == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    approach, force, shear, turn = way.reached(2, 0.5, 1.0).at(3, 4.5)
    assert np.isnan(approach) and force == 1.5 and shear.tolist() == [1.0, 0.0] and turn.tolist() == [1.0, 0.0, 2.5]


def test_states_are_shared_out_by_time_and_every_waypoint_gets_one() -> None:
    assert shared_out(9, np.array([1.0, 1.0, 1.0])) == [3, 3, 3]
    assert shared_out(10, np.array([0.01, 1.0, 2.0])) == [1, 3, 6]


def test_a_press_that_a_force_stops_stays_there() -> None:
    way = straight(Press(depth_mm=1.0, frames=5, speed_mm_s=2.0, hold_s=3.0, shear_mm=(1.0, 0.0)), 1.0).stays_from(1, 0.3)
    assert way.time == pytest.approx([0.0, 0.3, 3.3]) and way.approach == pytest.approx([0.0, 0.6, 0.6])
    assert way.shear[:, 0] == pytest.approx([0.0, 0.6, 0.6]) and way.recorded == pytest.approx([0.0, 0.125, 0.25, 0.3, 3.3])


def test_meshes_and_mirror_planes_are_those_of_the_whole_path() -> None:
    ball = {"gel": {"profile": "flat"}, "object": {"shape": "hemisphere", "rigid": True}}
    down_and_up = build_scene(ball | {"press": {"path": [{"depth_mm": 0.4}, {"depth_mm": 0.0}]}})
    assert choose_reduction(down_and_up).kind == "axisymmetric" and press_symmetry(down_and_up) == {"x", "y"}
    there_and_back = build_scene(ball | {"press": {"path": [{"depth_mm": 0.4}, {"shear_mm": [2, 0]}, {"shear_mm": [0, 0]}]}})
    assert choose_reduction(there_and_back).planes == {"y"}
    assert widest(there_and_back).sideways.tolist() == [2.0, 0.0] and widest(there_and_back).deepest == 0.4
    straight_down = footprint(down_and_up)
    assert footprint(there_and_back).high[0] >= straight_down.high[0] + 1.9e-3
    # a ball of 5 mm that is turned by 30° about its apex, which stays: sin 30° · 5 mm
    rolled = build_scene(ball | {"press": {"path": [{"depth_mm": 0.4}, {"tilt_deg": [0, 30]}]}})
    assert press_symmetry(rolled) == {"y"} and footprint(rolled).high[0] >= straight_down.high[0] + 2.4e-3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s,x_mm,y_mm\n0,0,0\n1,0,0\n", "the column z_mm is missing"),
        ("t_s,x_mm,y_mm,z_mm,rz\n0,0,0,0,0\n1,0,0,0,0\n", "unknown column 'rz'; did you mean"),
        ("t_s,x_mm,y_mm,z_mm\n0,0,0,0\n", "holds 1 rows"),
        ("t_s,x_mm,y_mm,z_mm\n0,0,0,0\n0,0,0,1\n", "line 3 has t_s = 0 s, the line before 0 s"),
        ("t_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,0,,1\n", "line 3 holds a cell that is no number"),
        ("t_s,x_mm,y_mm,z_mm\n0,0,0,nan\n1,0,0,1\n", "line 2 is not finite"),
    ],
)
def test_a_wrong_trajectory_is_one_clear_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "path.csv").write_text(text)
    with pytest.raises(SceneError, match=said):
        measured_path(str(tmp_path / "path.csv"))


def test_a_trajectory_is_read_again_when_it_has_changed(tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text("t_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,0,0,-0.1\n")
    assert measured_path(str(path))[1][3] == -0.1
    path.write_text("t_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,0,0,-0.25\n")
    assert measured_path(str(path))[1][3] == -0.25


def test_an_offset_beside_a_trajectory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("t_s,x_mm,y_mm,z_mm\n0,2,0,0\n1,2,0,-0.1\n")
    press = {"path_csv": str(tmp_path / "path.csv"), "offset_mm": [1.0, 0.0]}
    with pytest.raises(SceneError, match=r"press.offset_mm = .* press.path_csv begins at \(2.0, 0.0\)"):
        build_scene({"press": press})
