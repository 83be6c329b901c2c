"""Many presses of one scene: tables of poses, what is kept from one to the next, folders that go on."""

from __future__ import annotations

import json
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gelsim
from gelsim.cli.main import main
from gelsim.errors import SceneError
from gelsim.fem import field
from gelsim.pipeline.poses import read_poses, run_many
from gelsim.scene.layers import build_scene

BALL: dict[str, Any] = {
    "gel": {"profile": "flat", "size_mm": [12.0, 12.0], "youngs_modulus_kpa": 50.0},
    "object": {"shape": "hemisphere", "radius_mm": 4.0, "height_mm": 8.0, "rigid": True},
    "press": {"depth_mm": 0.3, "frames": 2},
    "fidelity": "fast",
}


def table(folder: Path, text: str) -> Path:
    (folder / "poses.csv").write_text(text)
    return folder / "poses.csv"


def test_a_table_of_poses_is_scenes(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("t_s,x_mm,y_mm,z_mm\n0,0,0,0\n1,0,0,-0.1\n")
    path = table(tmp_path, "name,offset_mm,press.tilt_deg,gel.thickness_mm,depth_mm\nleft,-2 0,,,0.2\n,1 1,0 3,3,\n")
    left, second = read_poses(path, build_scene(BALL))
    assert (left.name, second.name) == ("left", "0001")
    assert left.scene.press.offset_mm == (-2.0, 0.0) and left.scene.press.tilt_deg == (0.0, 0.0) and left.scene.press.depth_mm == 0.2
    assert second.scene.press.tilt_deg == (0.0, 3.0) and second.scene.gel.thickness_mm == 3.0 and second.scene.press.depth_mm == 0.3
    assert left.scene.object == second.scene.object == build_scene(BALL).object
    (measured,) = read_poses(table(tmp_path, "path_csv,depth_mm,force_n\npath.csv,none,none\n"), build_scene(BALL))
    assert measured.scene.press.path_csv == str(tmp_path / "path.csv")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("ofset_mm\n1 1\n", "column 'ofset_mm': unknown field; did you mean 'offset_mm'?"),
        ("gel.thicknes_mm\n1\n", "column 'gel.thicknes_mm': unknown field; did you mean 'thickness_mm'?"),
        ("depth_mm\n0.2\n5\n", "line 3: press.depth_mm = 5 mm"),
        ("depth_mm\n", "holds no poses"),
        ("name,depth_mm\na,0.1\na,0.2\n", "two poses are called 'a'"),
        ("name,depth_mm\n../a,0.1\n", "line 2: name = '../a': allowed is the name of a folder"),
    ],
)
def test_a_wrong_table_is_one_clear_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(SceneError) as caught:
        read_poses(table(tmp_path, text), build_scene(BALL))
    assert said in str(caught.value)


def test_many_presses_are_the_presses_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """And poses that differ by parts of a step share one distance field."""
    scene, made = build_scene(BALL), []
    sampled = field.sampled
    monkeypatch.setattr(field, "sampled", lambda *each: (made.append(each), sampled(*each))[1])
    field.kept_field.cache_clear()
    poses = [{"offset_mm": [0.1, 0.05]}, {"press.offset_mm": [0.2, 0.1], "depth_mm": 0.2}]
    several = gelsim.press_many(scene, poses, device="cpu")
    assert len(made) == 1
    alone = gelsim.press(build_scene({**BALL, "press": BALL["press"] | {"offset_mm": [0.2, 0.1], "depth_mm": 0.2}}), device="cpu")
    assert several[1].approach == pytest.approx(alone.approach)
    assert several[1].force == pytest.approx(alone.force, rel=1e-9, abs=1e-12)
    assert np.abs(several[0].force[-1]).max() > np.abs(several[1].force[-1]).max()
    with pytest.raises(SceneError, match=r"pose 1 of 1: .*unknown field; did you mean 'offset_mm'"):
        gelsim.press_many(scene, [{"ofset_mm": [0.0, 0.0]}])


def test_poses_go_on_where_they_were_stopped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path, "name,offset_mm\na,0 0\nb,0.5 0\nbeside,6 0\n")
    scene = ["--gel.profile", "flat", "--gel.size-mm", "12 12", "--shape", "hemisphere", "--rigid", "--radius-mm", "1", "--height-mm", "3"]
    command = ["press", *scene, "--tilt-deg", "0 0", "--depth-mm", "0.2", "--frames", "2", "--fidelity", "fast", "--poses", str(path)]
    out = tmp_path / "out"
    assert main([*command, "--out", str(out), "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert (first["poses"], first["made"], first["failed"]) == (3, 3, [])
    stamps = {name: (out / name / "press.npz").stat().st_mtime_ns for name in ("a", "b", "beside")}
    assert (out / "poses.csv").read_text().startswith("name,approach_mm,normal_force_n")
    (out / "b" / "report.json").unlink()
    assert main([*command, "--out", str(out), "--json"]) == 2 and "not empty" in capsys.readouterr().err
    assert main([*command, "--out", str(out), "--json", "--resume"]) == 0
    assert json.loads(capsys.readouterr().out)["made"] == 1
    assert {name: (out / name / "press.npz").stat().st_mtime_ns for name in stamps} == stamps  # b's press was there, its report was not


def test_a_pose_that_cannot_be_does_not_stop_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path, "name,offset_mm,shape,mesh\nlost,,mesh,nowhere.stl\nfine,0 0,,\n")
    scene = ["--gel.profile", "flat", "--shape", "hemisphere", "--rigid", "--depth-mm", "0.2", "--frames", "2", "--fidelity", "fast"]
    assert main(["press", *scene, "--poses", str(path), "--out", str(tmp_path / "out"), "--json"]) == 4
    told = json.loads(capsys.readouterr().out)
    assert [item["pose"] for item in told["failed"]] == ["lost"] and "nowhere.stl" in told["failed"][0]["message"]
    assert (tmp_path / "out" / "fine" / "press.npz").exists()


def test_workers_give_what_one_process_gives() -> None:
    poses: list[dict[str, Any]] = [{"depth_mm": 0.3}, {"depth_mm": 0.1}, {"depth_mm": 0.2}]
    alone, shared = (gelsim.press_many(build_scene(BALL), poses, device="cpu", workers=workers) for workers in (1, 2))
    assert [press.approach[-1] for press in shared] == pytest.approx([3e-4, 1e-4, 2e-4])
    for one, other in zip(alone, shared, strict=True):
        assert other.force == pytest.approx(one.force, rel=1e-6, abs=1e-9)
    with pytest.raises(SceneError, match=r"nowhere\.stl"):
        gelsim.press_many(build_scene(BALL), [*poses, {"shape": "mesh", "mesh": "nowhere.stl"}], device="cpu", workers=2)


def made_up(here: int, deadly: str, scene: Any, out: Path) -> dict[str, Any]:
    """A report that takes no time; the pose named `deadly` ends its worker, but not the process `here`."""
    if out.name == deadly and os.getpid() != here:
        os._exit(1)
    out.mkdir(parents=True)
    final = {"approach_mm": scene.press.depth_mm, "normal_force_n": 1.0 * (os.getpid() == here), "contact_area_mm2": 0.0}
    return {"final": final, "status": "converged", "seconds": {"total": 0.0}, "warnings": []}


def test_a_pose_that_ends_its_worker_is_named_and_the_table_keeps_its_order(tmp_path: Path) -> None:
    """Pictures: the first is made here, as it measures the light for all."""
    poses = read_poses(table(tmp_path, "name,depth_mm\na,0.1\nb,0.2\nc,0.3\nd,0.4\n"), build_scene(BALL))
    told = run_many(poses, tmp_path / "out", partial(made_up, os.getpid(), "c"), drawn=True, workers=2)
    assert [item["pose"] for item in told["failed"]] == ["c"] and told["failed"][0]["message"].startswith("DIED") and told["made"] == 3
    rows = [line.split(",") for line in (tmp_path / "out" / "poses.csv").read_text().splitlines()]
    assert [row[0] for row in rows] == ["name", "a", "b", "c", "d"]
    assert [row[2] for row in rows[1:]] == ["1.0", "0.0", "", "0.0"]


def test_workers_without_poses_are_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["press", "--workers", "2"]) == 2 and "--workers: they share the poses of --poses" in capsys.readouterr().err
