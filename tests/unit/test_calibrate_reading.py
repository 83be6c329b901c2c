"""Photographs as people have them: archives, videos, BGR, crops, corners, masks, several balls; what is wrong with them, one line each."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gelsim.calibrate import run
from gelsim.calibrate.photos import read_photos
from gelsim.calibrate.reading import Reader
from gelsim.cli.main import main
from gelsim.errors import SceneError
from gelsim.scene.definition import Gel
from gelsim.scene.layers import build_scene

GOOD = 'ball_radius_mm = 2.0\nno_contact = "rest.png"\n'
ROW, COLUMN = np.mgrid[:96, :128] + 0.5
SLOPE = np.stack([60 + COLUMN, 60 + ROW, 0 * ROW + 90], axis=-1)
"""A picture whose red says the column and whose green the row."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "photos"
    path.mkdir()
    for name in ("rest.png", "a.png"):
        save(path / name, SLOPE)
    (path / "photos.toml").write_text(GOOD)
    return path


def save(path: Path, levels: np.ndarray) -> None:
    Image.fromarray(np.rint(levels).astype(np.uint8)).save(path)


def write_video(path: Path, frames: np.ndarray) -> None:
    import imageio_ffmpeg

    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{frames.shape[2]}x{frames.shape[1]}", "-r", "30"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, "-i", "-", "-c:v", "ffv1", "-pix_fmt", "bgr0", str(path)]
    subprocess.run(command, input=frames.tobytes(), check=True)


def test_archives_and_videos_are_read_as_pictures_are(folder):
    stack = np.rint(np.stack([SLOPE, SLOPE + 8])).astype(np.uint8)
    np.savez(folder / "all.npz", f0=stack[0, ..., ::-1], imgs=stack[..., ::-1])
    (folder / "photos.toml").write_text('ball_radius_mm = 2.0\nno_contact = "all.npz:f0"\norder = "bgr"\n')
    (folder / "presses.csv").write_text("file\nall.npz:imgs:1\n")
    photos = read_photos(folder)
    assert np.array_equal(photos.no_contact, stack[0]) and np.array_equal(photos.pictures[0], stack[1])
    for path in folder.glob("*.png"):
        path.unlink()
    (folder / "presses.csv").unlink()
    assert read_photos(folder).files == ["all.npz:imgs:0", "all.npz:imgs:1"]
    write_video(folder / "press.avi", stack)
    # A lossless codec, read without scaling.
    assert np.array_equal(Reader(folder).levels("press.avi:1"), stack[1])


def test_a_crop_moves_places_with_it(folder):
    (folder / "photos.toml").write_text(GOOD + "crop_px = [20, 10, 64, 48]\n")
    (folder / "presses.csv").write_text("file,col_px,row_px,contact_radius_px\na.png,52,34,6\n")
    photos = read_photos(folder)
    assert photos.size == (64, 48) and photos.hints[0, :2].tolist() == [32, 24] and photos.radii[0] == 6
    assert np.array_equal(photos.no_contact, np.rint(SLOPE[10:58, 20:84]))


def test_four_corners_are_set_upright(folder):
    corners = [[20, 14], [106, 20], [112, 80], [16, 76]]
    (folder / "photos.toml").write_text(GOOD + f"corners_px = {corners}\ncorners_mm = [15.0, 10.0]\n")
    (folder / "presses.csv").write_text("file,col_px,row_px\na.png,112,80\n")
    photos = read_photos(folder)
    wide, high = photos.size
    assert photos.mm_per_px is not None and wide / high == pytest.approx(1.5, rel=0.01) and photos.mm_per_px == pytest.approx(15 / wide)
    # A marked corner is the corner, and what is seen there lay there: red and green say the place, to half a pixel.
    assert photos.hints[0, :2] == pytest.approx([wide, high], abs=1e-6)
    for (column, row), (x, y) in zip(corners, [(0, 0), (wide - 1, 0), (wide - 1, high - 1), (0, high - 1)], strict=True):
        assert photos.no_contact[y, x, :2] == pytest.approx([60 + column, 60 + row], abs=1.1)
    # Planted: corners in another order.
    with pytest.raises(SceneError, match="cross"):
        (folder / "photos.toml").write_text(GOOD + f"corners_px = {[corners[0], corners[2], corners[1], corners[3]]}\n")
        read_photos(folder)


def test_a_mask_hides_what_is_not_gel(folder):
    mask = np.zeros((96, 128, 3))
    mask[:, 40:] = 255
    save(folder / "mask.png", mask)
    (folder / "photos.toml").write_text(GOOD + 'mask = "mask.png"\n')
    photos = read_photos(folder)
    assert photos.files == ["a.png"] and photos.counted[:, 40:].all() and not photos.counted[:, :40].any()


def test_a_gel_smaller_than_the_picture_is_masked_and_said(folder):
    (folder / "photos.toml").write_text(GOOD + "mm_per_px = 0.1\n")
    said: list[str] = []
    counted = run._within_gel(read_photos(folder), Gel(size_mm=(6.4, 9.6)), said)
    assert counted[:, 32:96].all() and counted.mean() == 0.5 and "50 % of it is neither fitted nor scored" in said[0]


def test_balls_of_several_radii_and_other_objects(folder):
    for name in ("b.png", "c.png"):
        save(folder / name, SLOPE)
    (folder / "presses.csv").write_text(
        "file,split,radius_mm,shape,width_mm,length_mm,rotation_deg\na.png,,,,,,\nb.png,,3.5,,,,\nc.png,test,,box,4,6,0 0 30\n"
    )
    photos = read_photos(folder)
    assert photos.balls_mm[:2].tolist() == [2.0, 3.5] and np.isnan(photos.balls_mm[2])
    assert photos.bodies[2].rigid and photos.bodies[2].rotation_deg == (0.0, 0.0, 30.0)
    balls, said = run._balls_of(folder)
    assert balls.files == ["a.png", "b.png"] and "gelsim compare" in said[0]
    (folder / "presses.csv").write_text("file,shape\nc.png,box\n")
    with pytest.raises(SceneError, match=r"c.png: shape = 'box': a sensor is fitted to rigid balls; with split = test"):
        run._balls_of(folder)


def test_two_balls_have_each_their_own_dent():
    from gelsim.calibrate.dent import solve_dents

    gel, radii = Gel(profile="flat", thickness_mm=3.0), np.array([2.0, 4.0])
    both = solve_dents(gel, radii, True).at(3.0)
    alone = solve_dents(gel, 4.0, True).at(3.0)
    rho, depth, four = np.linspace(0, 5, 60), np.full(60, 0.8), np.full(60, 4.0)
    # The row of the table is counted through the balls: rounding.
    assert both.surface(rho, depth, four)[0] == pytest.approx(alone.surface(rho, depth, four)[0], abs=1e-9)
    # Planted: the smaller ball's tables, scaled.
    small = solve_dents(gel, 2.0, True).at(3.0)
    assert np.abs(small.surface(rho, depth, four)[0] - alone.surface(rho, depth, four)[0]).max() > 5e-3


@pytest.mark.parametrize(
    ("settings", "presses", "message"),
    [
        ('order = "rbg"\n', "", "order = 'rbg': allowed are"),
        ("crop_px = [100, 0, 64, 48]\n", "", "crop_px = 100 0 64 48 (left, top, width, height) reaches beyond rest.png"),
        ("crop_px = [0, 0, 0, 48]\n", "", "width and height more than 0 px"),
        ("crop_px = [0, 0, 20, 48]\n", "", "is 20 x 48 px; allowed are 32 … 4096 px a side"),
        ("corners_px = [[0, 0], [90, 90], [90, 0], [0, 90]]\n", "", "these corners cross, or enclose no convex area; give top left"),
        ("corners_px = [[0, 0], [0, 90], [90, 90], [90, 0]]\n", "", "these corners run the other way round; give top left"),
        ("corners_px = [[0, 0], [90, 0], [90, 90]]\n", "", "corners_px has 3 corners; give four"),
        ("corners_px = [[0, 0], [190, 0], [190, 90], [0, 90]]\n", "", "corners_px: 190 0 lies outside rest.png, which is 128 x 96 px"),
        ("corners_mm = [10.0, 8.0]\n", "", "corners_mm is the size of corners_px's rectangle"),
        ('mask = "black.png"\n', "", "mask = 'black.png' hides 100 % of the picture"),
        ('mask = "small.png"\n', "", "mask = 'small.png' is 64 x 48 px where the pictures are 128 x 96 px"),
        ('no_contact = ["rest.png", "other.png"]\n', "", "rest.png and other.png differ by 60 levels on the mean"),
        ("", "file,radius_mm\na.png,0.1\n", "line 2: object.radius_mm = 0.1 mm: allowed is 0.5 … 50 mm"),
        ("", "file,shape\na.png,bal\n", "line 2: object.shape = 'bal'"),
        ("", "file\nno.npz:imgs:1\n", "no.npz: is not an .npz file that can be read"),
        ("", "file\nall.npz:imgs:7\n", "'7' is no number of a picture there; allowed is 0 … 0"),
        ("", "file\nall.npz:img:0\n", "holds no array 'img'; known are imgs"),
        ("", "file\nno.mp4:3\n", "no.mp4: cannot be read as a video"),
    ],
)
def test_bad_photographs_are_refused_in_one_line(folder, settings, presses, message):
    save(folder / "black.png", np.zeros((96, 128, 3)))
    save(folder / "small.png", np.full((48, 64, 3), 255))
    save(folder / "other.png", SLOPE + 60)
    np.savez(folder / "all.npz", imgs=np.zeros((1, 96, 128, 3), np.uint8))
    (folder / "photos.toml").write_text((GOOD if "no_contact" not in settings else "ball_radius_mm = 2.0\n") + settings)
    if presses:
        (folder / "presses.csv").write_text(presses)
    else:
        (folder / "presses.csv").write_text("file\na.png\n")
    with pytest.raises(SceneError) as caught:
        read_photos(folder)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_ball_larger_than_the_gel_is_refused(folder, tmp_path, capsys):
    (folder / "photos.toml").write_text('ball_radius_mm = 10.0\nno_contact = "rest.png"\n[gel]\nsize_mm = [18.0, 14.0]\n')
    assert main(["calibrate", "--photos", str(folder), "--out", str(tmp_path / "out" / "sensor.toml")]) == 2
    assert "a.png: a ball of 10 mm radius is larger than the gel, 18 mm at its longer side" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_no_contact_photograph_alone_makes_a_preset_look_right_at_rest(folder, tmp_path, capsys):
    (folder / "a.png").unlink()
    (folder / "photos.toml").write_text('no_contact = "rest.png"\n')
    out = tmp_path / "out" / "mine.toml"
    assert main(["calibrate", "--photos", str(folder), "--out", str(out)]) == 2
    assert "a no-contact photograph alone needs a preset to start from" in capsys.readouterr().err
    assert main(["calibrate", "--photos", str(folder), "--sensor", "gelsight_mini", "--out", str(out)]) == 0
    scene = build_scene({"sensor": {"preset": str(out)}})
    preset = build_scene({"sensor": {"preset": "gelsight_mini"}})
    assert scene.camera.resolution == (128, 96) and scene.lights == preset.lights and not scene.camera.rest_smooth
    # Rounding to 8 bits, twice.
    assert "MSE 0." in capsys.readouterr().out
    assert json.loads((out.parent / "report.json").read_text())["choices"]["lens_k"] == 0
