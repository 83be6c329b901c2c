"""Recordings of a real sensor: names, labels, the press in a video; bad ones are listed or refused."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from gelsim.data.episodes import load_dataset
from gelsim.errors import SceneError
from gelsim.generate.real import convert, find_press, labels_of_name
from gelsim.scene import materials


def frames_of_a_press(begin: int = 10, peak: int = 30, count: int = 40, noise: float = 1.5) -> np.ndarray:
    """A spot that grows from frame `begin` to `peak`, then fades, under the noise of a camera."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:60, :80]
    strength = np.interp(np.arange(count), [begin, peak, count + 5], [0, 60, 0])
    spot = np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / 200)
    clean = 110 + strength[:, None, None, None] * spot[..., None] * np.array([1.0, -0.5, 0.3])
    return np.clip(clean + noise * rng.standard_normal(clean.shape), 0, 255).astype(np.uint8)


def write_video(path: Path, frames: np.ndarray) -> None:
    import imageio_ffmpeg

    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = frames.shape[1:3]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", "30"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, "-i", "-", "-c:v", "ffv1", str(path)]
    subprocess.run(command, input=frames.tobytes(), check=True)


@pytest.mark.parametrize(
    ("name", "shape", "radius", "shore", "group"),
    [
        ("cylinder10_35_01", "cylinder", 10.0, 35.0, 1),
        ("Hemisphere2.5_08_3", "hemisphere", 2.5, 8.0, 1),
        ("flat_87_12", "flat", None, 87.0, 1),
        ("shellA_45_2", "shella", None, 45.0, 4),
        ("tomato3_hand_1", "tomato", 3.0, None, 5),
    ],
)
def test_names_carry_labels(name: str, shape: str, radius: float | None, shore: float | None, group: int):
    labels = labels_of_name(name)
    assert (labels["shape"], labels["radius_mm"], labels["shore_00"], labels["group"]) == (shape, radius, shore, group)


def test_the_press_is_found_between_calm_and_peak():
    first, last, quiet = find_press(frames_of_a_press())
    # The spot has a twentieth of its strength one frame after it begins, three with the noise; two frames of lead.
    assert 8 <= first <= 11 and 29 <= last <= 31 and quiet < 10
    assert find_press(frames_of_a_press(), no_contact=5, first=12, last=20) == (12, 20, 5)


def test_videos_become_episodes(tmp_path: Path):
    write_video(tmp_path / "in/hand/cylinder10_35_01.avi", frames_of_a_press())
    write_video(tmp_path / "in/robotData/cylinder10_35_02.avi", frames_of_a_press(begin=5))
    write_video(tmp_path / "in/hand/flat_20_01.avi", np.full((20, 60, 80, 3), 90, np.uint8))
    (tmp_path / "in/hand/flat_20_02.avi").write_text("no video")
    report = convert(tmp_path / "in", tmp_path / "out", resolution=(40, 30))
    assert report["episodes"] == 2 and report["failed"] == 2 and report["exit_code"] == 4
    data = load_dataset(tmp_path / "out")
    assert [row["motion"] for row in data.rows] == ["human", "robot"] and data.info["domain"] == "real"
    assert data.rows[0]["object"] == data.rows[1]["object"] == "cylinder10-35" and data.splits["robot"] == [data.rows[1]["index"]]
    assert [failure["message"].split(":")[0] for failure in data.failures] == ["hand/flat_20_01.avi", "hand/flat_20_02.avi"]
    episode = data.read(0)
    assert episode.frames.shape[1:] == (30, 40, 3) and np.isnan(episode.force).all() and episode.marker_pixels.shape[1] == 0
    # Lossless video, averaged over 2 x 2 pixels: the no-contact frame is the grey it was made of, cut to whole levels.
    assert abs(episode.background.mean() - 109.5) < 0.2
    assert np.abs(episode.frames[-1].astype(float) - episode.background).mean() > 3


def test_folders_of_pictures_with_labels(tmp_path: Path):
    from PIL import Image

    folder = tmp_path / "in/press one"
    folder.mkdir(parents=True)
    for number, frame in enumerate(frames_of_a_press()):
        Image.fromarray(frame).save(folder / f"{number:03d}.png")
    labels = tmp_path / "in/labels.csv"
    labels.write_text("file,object,group,shape,shore_00,motion,no_contact,split\npress one,cup 1,3,frustum,33.5,robot,2,vessels\n")
    convert(tmp_path / "in", tmp_path / "out")
    row = load_dataset(tmp_path / "out").rows[0]
    assert row["sensor"] == "real" and "gel" not in row
    assert (row["object"], row["group"], row["shape"], row["shore_00"], row["motion"], row["split"]) == (
        "cup 1", 3, "frustum", 33.5, "robot", "vessels",
    )  # fmt: skip
    for text, said in (
        ("file,hardness\npress one,3\n", "column 'hardness'"),
        ("object\nx\n", "column file is missing"),
        ("file\n../../etc\n", "no such recording"),
        ("file,group\npress one,9\n", "line 2: group = 9"),
        ("file,shore_00\npress one,soft\n", "line 2"),
        ("file,motion\npress one,foot\n", "motion = 'foot'"),
    ):
        labels.write_text(text)
        with pytest.raises(SceneError, match=said):
            convert(tmp_path / "in", tmp_path / "out2")


@pytest.mark.parametrize(
    ("cells", "kept"),
    [
        ({"shore_a": "30"}, {"shore_a": 30.0}),
        ({"modulus_kpa": "100"}, {"modulus_kpa": 100.0}),
        ({"shore_00_low": "80"}, {"shore_00": None, "shore_00_range": [80.0, None]}),
        ({"shore_00_low": "20", "shore_00_high": "40"}, {"shore_00": None, "shore_00_range": [20.0, 40.0]}),
        ({"hardness_class": "2", "force_n": "3.5"}, {"shore_00": None, "hardness_class": 2, "peak_force_n": 3.5}),
        ({"modulus_kpa": "500000"}, {"shore_00": None, "shore_00_range": [99.0, None]}),
    ],
)
def test_hardness_is_told_in_many_ways(tmp_path: Path, cells: dict[str, str], kept: dict[str, object]):
    write_video(tmp_path / "in/a.avi", frames_of_a_press())
    (tmp_path / "in/labels.csv").write_text(",".join(["file", *cells]) + "\n" + ",".join(["a.avi", *cells.values()]) + "\n")
    convert(tmp_path / "in", tmp_path / "out", resolution=(80, 60))
    (row,) = load_dataset(tmp_path / "out").rows
    assert kept == {name: row[name] for name in kept}
    if "shore_a" in cells or cells.get("modulus_kpa") == "100":
        modulus = materials.modulus_from_shore_a(30.0) if "shore_a" in cells else 100e3
        assert materials.modulus_from_shore_00(row["shore_00"]) == pytest.approx(modulus)


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ({"shore_a": "30", "hardness_class": "1"}, "give one of them"),
        ({"shore_00": "30", "shore_00_low": "20"}, "give one of them"),
        ({"shore_00_low": "50", "shore_00_high": "40"}, "must be below shore_00_high = 40"),
        ({"hardness_class": "1.5"}, "hardness_class = 1.5: allowed are whole numbers"),
        ({"shore_a": "95"}, "Shore A"),
    ],
)
def test_hardness_that_says_nothing_is_refused(tmp_path: Path, cells: dict[str, str], said: str):
    write_video(tmp_path / "in/a.avi", frames_of_a_press())
    (tmp_path / "in/labels.csv").write_text(",".join(["file", *cells]) + "\n" + ",".join(["a.avi", *cells.values()]) + "\n")
    with pytest.raises(SceneError, match=said) as caught:
        convert(tmp_path / "in", tmp_path / "out", resolution=(80, 60))
    assert "line 2" in str(caught.value)


def test_a_lab_that_knows_its_gel_says_so(tmp_path: Path):
    write_video(tmp_path / "in/flat_20_01.avi", frames_of_a_press())
    (tmp_path / "ours.toml").write_text("[gel]\nthickness_mm = 3.0\nedge_thickness_mm = 1.5\nshore_00 = 20.0\n")
    for sensor, name, gel in (
        (str(tmp_path / "ours.toml"), "ours", (3.0, 1.5, 20.0)),  # its name, not where it lies
        ("fingertip2017", "fingertip2017", (2.4, 1.0, 17.0)),
    ):
        convert(tmp_path / "in", tmp_path / name, sensor=sensor)
        row = load_dataset(tmp_path / name).rows[0]
        assert row["sensor"] == name and tuple(row["gel"].values()) == gel
    with pytest.raises(SceneError, match="'fingertip2018'"):
        convert(tmp_path / "in", tmp_path / "out", sensor="fingertip2018")


def test_nothing_to_convert(tmp_path: Path):
    with pytest.raises(SceneError, match="is no folder"):
        convert(tmp_path / "nowhere", tmp_path / "out")
    (tmp_path / "in").mkdir()
    with pytest.raises(SceneError, match="holds no videos"):
        convert(tmp_path / "in", tmp_path / "out")
