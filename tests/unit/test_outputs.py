"""The result folder: what is written reads back, and nothing half-written stays."""

from __future__ import annotations

import csv
import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gelsim.errors import PressEnd, SceneError
from gelsim.pipeline import outputs, sheet
from gelsim.results import Deformation, EnergyReport, ErrorEstimate, Frame, SolveReport, SurfaceMotion
from gelsim.scene.definition import Scene


def test_press_reads_back_as_written(tmp_path: Path, deformation: Deformation) -> None:
    outputs.write_press(tmp_path / "press.npz", Scene(), deformation)
    again = outputs.read_press(tmp_path / "press.npz")
    expected, found = outputs.press_arrays(Scene(), deformation), outputs.press_arrays(Scene(), again)
    assert expected.keys() == found.keys()
    for name in expected:
        np.testing.assert_array_equal(expected[name], found[name])  # lossless
    assert again.status is deformation.status


def test_press_has_the_arrays_of_the_contract(tmp_path: Path, deformation: Deformation) -> None:
    outputs.write_press(tmp_path / "press.npz", Scene(), deformation)
    count, gel = deformation.gel.displacement.shape[:2]
    shapes = {
        "approach": (count,), "force": (count, 3), "contact_area": (count,), "contact_pressure": (count, gel), "gel_rest": (gel, 3),
        "gel_displacement": (count, gel, 3), "min_jacobian": (count,), "penetration": (count,), "newton_iterations": (count,),
        "linear_iterations": (count,), "seconds": (count,), "converged": (count,),
    }  # fmt: skip
    with np.load(tmp_path / "press.npz") as data:
        assert {"gel_faces", "object_rest", "object_faces", "object_displacement"} <= set(data.files)
        assert {name: data[name].shape for name in shapes} == shapes


def test_other_files_are_not_taken_for_a_press(tmp_path: Path) -> None:
    (tmp_path / "press.npz").write_bytes(b"no zip")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("press.npz", "other.npz", "missing.npz"):
        with pytest.raises(SceneError, match="is not a press.npz"):
            outputs.read_press(tmp_path / name)


def test_an_account_is_read_as_one_or_not_at_all(tmp_path: Path, deformation: Deformation) -> None:
    path = tmp_path / "press.npz"
    told = {"meshes": {"gel": {"tets": 7}}, "choices": {"drift": np.float64(0.5)}, "warnings": ["thin"], "info": {}}
    outputs.write_press(path, Scene(), deformation, told)
    assert outputs.read_account(path) == told
    outputs.write_press(path, Scene(), deformation)
    assert outputs.read_account(path) == {}
    for damaged in ({"meshes": [1]}, {"warnings": "thin"}, {"info": None}, {"info": {"energy": [1]}}, {"mesh_sha256": 3}):
        outputs.write_press(path, Scene(), deformation, damaged)
        with pytest.raises(SceneError, match="is not a press.npz"):
            outputs.read_account(path)


def test_a_solve_report_is_the_same_after_it_was_written(tmp_path: Path, deformation: Deformation) -> None:
    """What is not known, and warnings that there are none, are left out; an empty symmetry is known."""
    whole = SolveReport(
        ended_by=PressEnd.LOST, tried=2, went_on_from_mm=(0.5,), symmetry=("x", "y"), rigid_object=False,
        unknowns=7, energy=EnergyReport(work_j=1e-3, drift=0.01), error_estimate=ErrorEstimate(0.02, 3.0), warnings=("thin",),
    )  # fmt: skip
    for report in (whole, SolveReport(symmetry=()), SolveReport(symmetry="axisymmetric", steps_halved=0)):
        outputs.write_press(tmp_path / "press.npz", Scene(), deformation, {"info": report.table()})
        assert outputs.solve_report(outputs.read_account(tmp_path / "press.npz")) == report
    assert SolveReport(symmetry=()).table() == {"symmetry": []} and whole.table()["energy"]["work_j"] == 1e-3
    assert SolveReport.from_table({"tried": 2, "of_another_version": 1}) == SolveReport(tried=2)


def test_sampling_is_exact_at_nodes_and_for_quadratic_fields(sheet_motion: SurfaceMotion, rng: np.random.Generator) -> None:
    nodes = rng.choice(len(sheet_motion.rest), 20, replace=False)
    _, u = outputs.sample_surface(sheet_motion, sheet_motion.rest[nodes, :2])
    scale = np.abs(sheet_motion.displacement).max()
    # An identity in float64: 6 terms and a 2 x 2 solve, far below 1e-12 of the largest displacement.
    assert np.abs(u - sheet_motion.displacement[:, nodes]).max() <= 1e-12 * scale
    points = rng.uniform([-5e-3, -3e-3], [5e-3, 3e-3], (200, 2))
    _, u = outputs.sample_surface(sheet_motion, points)
    px, py = points[:, 0] / 1e-3, points[:, 1] / 1e-3
    field = np.stack([1e-5 * px * py, -2e-5 * px, -1e-4 * (1.0 - 0.01 * px**2 - 0.02 * py**2)], axis=1)
    assert np.abs(u[-1] - field).max() <= 1e-12 * scale


def test_sampling_follows_shifted_mid_side_nodes(sheet_motion: SurfaceMotion, rng: np.random.Generator) -> None:
    # A linear field is reproduced by isoparametric faces however their mid-side nodes lie; straight-face sampling would miss it.
    rest = sheet_motion.rest.copy()
    middles = np.setdiff1d(sheet_motion.faces6[:, 3:], sheet_motion.faces6[:, :3])
    inside = middles[(np.abs(rest[middles, 0]) < 4.9e-3) & (np.abs(rest[middles, 1]) < 2.9e-3)]
    rest[inside, :2] += rng.uniform(-1.5e-4, 1.5e-4, (len(inside), 2))
    linear = np.array([[0.01, 0.02, -0.03], [-0.02, 0.01, 0.04], [0, 0, 0]])
    motion = SurfaceMotion(rest, sheet_motion.faces, (rest @ linear)[None], sheet_motion.faces6)
    points = rng.uniform([-4e-3, -2e-3], [4e-3, 2e-3], (100, 2))
    _, u = outputs.sample_surface(motion, points)
    expected = np.column_stack([points, np.zeros(100)]) @ linear
    assert np.abs(u[0] - expected).max() <= 1e-12 * np.abs(expected).max()


def test_probe_file(tmp_path: Path, deformation: Deformation) -> None:
    (tmp_path / "points.csv").write_text("x_mm, y_mm\n0,0\n1.25, -1\n", encoding="utf-8")
    points = outputs.read_probe_points(tmp_path / "points.csv")
    outputs.write_probe(tmp_path / "probe.csv", deformation, points)
    with (tmp_path / "probe.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["frame", "x_mm", "y_mm", "ux_mm", "uy_mm", "uz_mm", "z_mm"]
    assert len(rows) == 2 * len(deformation.approach)
    last = {name: float(text) for name, text in rows[-1].items()}
    # Nine digits are written: half of the ninth, relative to values up to 2.
    assert math.isclose(last["uz_mm"], -0.1 * (1.0 - 0.01 * 1.25**2 - 0.02), abs_tol=1e-9)
    assert math.isclose(last["x_mm"], 1.25, abs_tol=1e-8) and last["frame"] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [("a,b\n1,2\n", "columns"), ("x_mm,y_mm\n1,z\n", "line 2"), ("x_mm,y_mm\n", "no points"), ("x_mm,y_mm\n1\n", "line 2")],
)
def test_bad_probe_file(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "points.csv").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=message):
        outputs.read_probe_points(tmp_path / "points.csv")


def test_probe_point_beside_the_gel() -> None:
    with pytest.raises(SceneError, match=r"point 2 at x = 13 mm"):
        outputs.check_probe_points(np.array([[0.0, 0.0], [13e-3, 0.0]]), Scene())


def test_pictures_are_lossless_and_the_video_plays(tmp_path: Path, frames: list[Frame]) -> None:
    import imageio_ffmpeg

    outputs.write_frames(tmp_path / "frames", frames)
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal(np.array(Image.open(tmp_path / f"frames/{index:04d}.png")), frame.image)
    outputs.write_video(tmp_path / "video.mp4", frames)
    found = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(tmp_path / "video.mp4")], capture_output=True, text=True).stderr
    # What browsers need: H.264, 4:2:0, even sizes (41 x 31 grew by one), the index before the pictures.
    assert "h264" in found and "yuv420p" in found and "42x32" in found
    data = (tmp_path / "video.mp4").read_bytes()
    assert 0 < data.find(b"moov") < data.find(b"mdat")


def test_markers_and_heights(tmp_path: Path, frames: list[Frame]) -> None:
    outputs.write_markers(tmp_path / "markers.csv", frames)
    rows = list(csv.reader((tmp_path / "markers.csv").read_text().splitlines()))
    assert rows[0] == ["frame", "id", "col", "row"]
    assert rows[2] == ["0", "1", "10.0000", "20.0000"] and [row[1] for row in rows[1:4]] == ["0", "1", "3"]  # 2 is outside
    outputs.write_heights(tmp_path / "height.npz", frames)
    with np.load(tmp_path / "height.npz") as data:
        np.testing.assert_array_equal(data["height"], np.stack([frame.height for frame in frames]))


def test_radiance_is_linear_float(tmp_path: Path, frames: list[Frame]) -> None:
    import OpenEXR

    outputs.write_radiance(tmp_path / "a.exr", frames[0].radiance)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, frames[0].radiance)


def test_folder_refuses_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    (tmp_path / "full" / "press.npz").write_text("old")
    with pytest.raises(SceneError, match="not empty; give --force"):
        outputs.ResultFolder(tmp_path / "full")
    folder = outputs.ResultFolder(tmp_path / "full", force=True)
    folder.remove()
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["mine.txt"]  # only what gelsim writes goes
    with pytest.raises(SceneError, match="is a file"):
        outputs.ResultFolder(tmp_path / "full" / "mine.txt")
    with pytest.raises(SceneError, match="cannot be written to"):
        outputs.ResultFolder(tmp_path / "full" / "mine.txt" / "below")


def test_a_check_takes_no_folder_from_another_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that the check made would be removed by it, perhaps while another worker makes its own below."""
    with monkeypatch.context() as patched:
        patched.setattr(Path, "mkdir", lambda *_, **__: pytest.fail("a check made a folder"))
        outputs.ResultFolder(tmp_path / "out" / "a")


def test_folder_comes_with_its_first_whole_file(tmp_path: Path) -> None:
    folder = outputs.ResultFolder(tmp_path / "new" / "deep")
    assert not (tmp_path / "new").exists()

    def fail(path: Path) -> None:
        path.write_text("half")
        raise RuntimeError

    with pytest.raises(RuntimeError):
        folder.write("report.json", fail)
    assert list((tmp_path / "new" / "deep").iterdir()) == []
    folder.write("report.json", lambda path: outputs.write_report(path, {"a": 1}))
    assert json.loads((tmp_path / "new/deep/report.json").read_text()) == {"a": 1}


def test_plain_json_knows_numpy_and_no_nan() -> None:
    value = outputs.plain_json({"a": np.float32(0.5), "b": [np.nan, np.int64(3)], "c": frozenset("yx"), "d": np.array([True])})
    assert value == {"a": 0.5, "b": [None, 3], "c": ["x", "y"], "d": [True]}
    json.dumps(value, allow_nan=False)


def test_section_cuts_the_plane_in_the_middle(sheet_motion: SurfaceMotion) -> None:
    segments = sheet.section_segments(sheet_motion, -1)
    loops = sheet.closed_loops(segments)
    assert len(loops) == 1  # one unbroken line across the sheet
    # At the ends x = ±5 mm the cut y + u_y = 1 µm with u_y = -0.02 mm x is at rest y = ±0.1 mm + 1 µm, where u_x = 0.01 mm x y. All is
    # linear along those edges: an identity in float64.
    ends = np.array([-5.0 + 0.01 * -5.0 * -0.099, 5.0 + 0.01 * 5.0 * 0.101]) * 1e-3
    assert np.abs(np.sort(loops[0][[0, -1], 0]) - ends).max() <= 1e-12 * 5e-3


def test_sheet_is_drawn(tmp_path: Path, deformation: Deformation, frames: list[Frame]) -> None:
    sheet.draw_sheet(tmp_path / "sheet.png", Scene(), deformation, frames)
    picture = np.array(Image.open(tmp_path / "sheet.png"))
    assert picture.shape[1] > 1500 and picture.std() > 10  # something is on it
