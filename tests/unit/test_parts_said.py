"""What is said to people who bring parts: of paths in plans and studies, of pairs, files given as shapes, doubt and the picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gelsim.errors import SceneError
from gelsim.generate.plan import load_plan, plan_path
from gelsim.pipeline import stages
from gelsim.scene.definition import Body, Press, Scene
from gelsim.scene.layers import build_scene
from gelsim.study.definition import load_study
from gelsim.study.optimise import parse_bounds

PLAN = """
base = "paper2017"
[[groups]]
number = 1
name = "own"
share = 1.0
motion = "robot"
split = "train"
[[groups.kinds]]
name = "part"
object = {shape = "mesh", mesh = "part.stl", rigid = true}
"""


def test_a_plan_finds_its_files_beside_it_before_the_first_episode(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(PLAN)
    with pytest.raises(SceneError, match=r"plan own.toml: groups 'own', kind 'part': object.mesh = .*part.stl\" cannot be read"):
        load_plan(str(path))
    trimesh.creation.box((4, 4, 4)).export(tmp_path / "part.stl")
    assert load_plan(str(path)).groups[0].kinds[0].fields["object.mesh"] == str(tmp_path / "part.stl")
    path.write_text(PLAN.replace('"part.stl"', '{choice = ["part.stl", "other.stl"]}'))
    with pytest.raises(SceneError, match=r"other.stl"):
        load_plan(str(path))
    assert plan_path("paper2017").is_file() and load_plan("paper2017").groups


def test_a_study_finds_its_files_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(
        'question = "q"\nmetrics = ["force_n"]\n[fields]\n"object.mesh" = ["part.stl"]\n[scene.object]\nshape = "mesh"\nrigid = true\n'
    )
    with pytest.raises(SceneError, match=r"part.stl\" cannot be read") as caught:
        load_study(str(path))
    assert "study own.toml" in str(caught.value) and str(tmp_path) in str(caught.value)
    trimesh.creation.box((4, 4, 4)).export(tmp_path / "part.stl")
    assert load_study(str(path)).axes["object.mesh"] == [str(tmp_path / "part.stl")]


def test_a_pair_has_no_range_and_is_called_one() -> None:
    with pytest.raises(SceneError, match=r"press.tilt_deg'?: is a pair of numbers, so it has no range"):
        parse_bounds("press.tilt_deg=0:5")


def test_a_file_is_a_mesh(tmp_path: Path) -> None:
    assert build_scene({"object": {"mesh": "x.stl", "rigid": True}}).object.shape == "mesh"
    with pytest.raises(SceneError, match=r"object.shape = 'part.STL'.*a file is object.mesh = 'part.STL' \(--mesh part.STL\)"):
        build_scene({"object": {"shape": "part.STL"}})
    with pytest.raises(SceneError, match="did you mean 'cylinder'"):
        build_scene({"object": {"shape": "CYLINDER"}})
    with pytest.raises(SceneError, match=r"press.tilt_deg = 95 0.*-90 … 90 °.*press_side"):
        build_scene({"press": {"tilt_deg": [95, 0]}})


def test_what_is_not_seen_and_what_is_not_sure_is_said() -> None:
    scene = Scene(
        object=Body(shape="cylinder", radius_mm=4.0, rigid=True), press=Press(tilt_deg=(30.0, 0.0), depth_mm=0.3, frames=2), fidelity="fast"
    )
    press = stages.press(scene, device="cpu")
    said = stages._beside_picture(scene.replace(camera=Scene().camera.__class__(field_mm=(8.0, 6.0))), press)
    assert len(said) == 1 and "touch_at" in said[0]
    place = press.gel.rest[press.contact_pressure[-1].argmax(), :2]
    assert np.abs(place).max() > 6e-3
    assert stages._doubt({"error_estimate": {"force": 0.4}}) == " ± 40 %" and stages._doubt({"error_estimate": None}) == ""
