"""`gelsim compare`: a made-up recording of a ball and a box, drawn by the simulator itself, beside the sensor's pictures of it."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gelsim import optics
from gelsim.cli.main import main
from gelsim.membrane.surface import rest_membrane
from gelsim.pipeline import stages
from gelsim.scene.layers import build_scene

LOOK = {"sensor": {"preset": "fingertip2017"}, "render": {"resolution": [80, 60], "spp": 36}, "fidelity": "fast"}
BALL = {"shape": "hemisphere", "rigid": True, "radius_mm": 3.0, "height_mm": 6.0}
BOX = {"shape": "box", "rigid": True, "width_mm": 4.0, "length_mm": 6.0, "rotation_deg": [0, 0, 30]}


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball 0.6 mm deep at (1.5, -1.0) mm; a box at two depths of one press."""
    out = tmp_path_factory.mktemp("photos")
    scene = build_scene(LOOK)
    rest = next(iter(optics.render_frames(scene, [rest_membrane(scene)]))).image
    Image.fromarray(rest).save(out / "rest.png")
    ball = {"depth_mm": 0.6, "offset_mm": [1.5, -1.0], "touch_at": "centre", "frames": 4}
    for body, press, names in ((BALL, ball, ["ball"]), (BOX, {"depth_mm": 0.4, "frames": 3}, ["box_half", "box"])):
        _, frames = stages.simulate(build_scene(LOOK, {"object": body, "press": press}))
        for name, frame in zip(names, frames[-len(names) :], strict=True):
            Image.fromarray(frame.image).save(out / f"{name}.png")
    (out / "photos.toml").write_text('no_contact = "rest.png"\nball_radius_mm = 3.0\n')
    (out / "presses.csv").write_text(
        "file,col_px,row_px,depth_mm,shape,width_mm,length_mm,rotation_deg\n"
        "ball.png,,,,,,,\nbox_half.png,40,30,0.2,box,4,6,0 0 30\nbox.png,40,30,0.4,box,4,6,0 0 30\n"
    )
    return out


@pytest.mark.slow
def test_known_presses_are_drawn_and_a_ball_is_found(photos, tmp_path):
    out = tmp_path / "out"
    assert main(["compare", "--sensor", "fingertip2017", "--photos", str(photos), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    ball, half, box = report["presses"]
    # A pixel is 0.23 mm: a tenth of it, and 3 % of the depth, as a calibration finds its presses.
    assert [ball["x_mm"], ball["y_mm"]] == pytest.approx([1.5, -1.0], abs=0.03) and ball["depth_mm"] == pytest.approx(0.6, rel=0.03)
    assert ball["found"] and not box["found"]
    # What is left is the meshes' and the renderer's noise; planted: the no-contact picture instead.
    for row in (ball, half, box):
        assert row["drawn"]["mse"] < 0.2 * row["no_contact"]["mse"] and row["drawn"]["ssim"] > row["no_contact"]["ssim"]
    assert report["scores"]["rest"]["mse"] < 1
    with (out / "compare.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["file"] for row in rows] == ["ball.png", "box_half.png", "box.png"]
    assert float(rows[0]["mse"]) == pytest.approx(ball["drawn"]["mse"])
    with Image.open(out / "compare.png") as sheet:
        assert sheet.size[0] == 4 * 324


def test_a_folder_of_frames_is_paired_by_name(photos, tmp_path, capsys):
    frames = tmp_path / "result" / "frames"
    frames.mkdir(parents=True)
    for name in ("ball", "box_half", "box"):
        picture = np.asarray(Image.open(photos / f"{name}.png")).astype(int)
        Image.fromarray((picture + 2).clip(0, 255).astype(np.uint8)).save(frames / f"{name}.png")
    arguments = ["compare", "--frames", str(tmp_path / "result"), "--photos", str(photos), "--out", str(tmp_path / "out")]
    assert main(arguments) == 0 and "drawn                L1 2.00  MSE 4.0" in capsys.readouterr().out
    assert main(arguments) == 2 and "compare.png exists; give --force" in capsys.readouterr().err
    (frames / "box.png").unlink()
    assert main([*arguments, "--force"]) == 2
    assert "holds no picture 'box' for box.png: pictures are paired by their names" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("presses", "arguments", "message"),
    [
        ("file\nball.png\n", [], "give --sensor NAME, or --frames DIR"),
        ("file,shape\nbox.png,box\n", ["--sensor", "fingertip2017"], "box.png: col_px, row_px and depth_mm of a press that"),
        ("file\nrest2.png\n", ["--sensor", "fingertip2017"], "rest2.png: no contact can be seen in it: give col_px, row_px and depth_mm"),
        ("file\nball.png\n", ["--sensor", "nothing"], "sensor.preset = 'nothing': known are"),
    ],
)
def test_bad_input_is_refused_in_one_line(photos, tmp_path, capsys, presses, arguments, message):
    folder = tmp_path / "photos"
    folder.mkdir()
    for name, copy in (("rest", "rest"), ("rest", "rest2"), ("ball", "ball"), ("box", "box")):
        Image.open(photos / f"{name}.png").save(folder / f"{copy}.png")
    (folder / "photos.toml").write_text('no_contact = "rest.png"\nball_radius_mm = 3.0\n')
    (folder / "presses.csv").write_text(presses)
    assert main(["compare", *arguments, "--photos", str(folder), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1 and not (tmp_path / "out").exists()
