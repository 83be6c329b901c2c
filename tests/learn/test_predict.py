"""Predictions from whatever people have: odd videos get a clear answer each, strange ones are called strange."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from conftest import COLUMNS, ROWS, fake_dataset, fake_press, fake_row
from PIL import Image

from gelsim.data.corners import Corners
from gelsim.data.episodes import load_dataset
from gelsim.scene.definition import Camera, Gel, Scene
from gelsim.scene.layers import dump_scene
from learn import cli
from learn.config import InputConfig, LearnError
from learn.frames import averaged
from learn.framing import FIELD_MM, Framing, at_scale, contact_centre
from learn.novelty import fit_novelty
from learn.predict import beside, gel_of_sensor, in_words, predict, read_identified
from learn.video import AS_IT_IS, MOST_SECONDS, sources


def film(path: Path, frames: np.ndarray, fps: float = 30) -> Path:
    """A lossless video."""
    size = f"{frames.shape[2]}x{frames.shape[1]}"
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-y", *raw, "-c:v", "ffv1", "-pix_fmt", "bgr0", str(path)]
    subprocess.run(command, input=frames.tobytes(), check=True)
    return path


@pytest.fixture(scope="module")
def press(fake_data: Path) -> np.ndarray:
    episode = load_dataset(fake_data).read(4)
    return np.concatenate([episode.background[None], episode.frames])


def ask(run: Path, *videos: Path, **options: Any) -> list[dict[str, Any]]:
    return list(predict([run / "model.pt"], videos, **options))


def test_a_video_a_folder_and_an_episode_give_one_answer(fake_data: Path, tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    video = film(tmp_path / "press.mkv", press)
    (tmp_path / "folder" / "frames").mkdir(parents=True)
    for number, frame in enumerate(press):
        Image.fromarray(frame).save(tmp_path / "folder" / "frames" / f"{number:04d}.png")
    episode = fake_data / load_dataset(fake_data).rows[4]["file"]
    answers = ask(tiny_run, video, tmp_path / "folder", episode)
    assert [answer["status"] for answer in answers] == ["ok"] * 3 and all(answer["spread"] > 0 for answer in answers)
    assert answers[0]["shore_00"] == answers[1]["shore_00"]  # ffv1 is lossless
    # The episode's own camera noise is drawn, the film's is not.
    assert answers[2]["shore_00"] == pytest.approx(answers[0]["shore_00"], abs=5) and answers[2]["true"] is not None
    assert "Shore 00" in in_words(answers[0]) and "true" in in_words(answers[2])


def test_the_gel_is_told_by_a_sensor_or_by_what_is_read(fake_data: Path, tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    folder = tmp_path / "render"
    (folder / "frames").mkdir(parents=True)
    for number, frame in enumerate(press):
        Image.fromarray(frame).save(folder / "frames" / f"{number:04d}.png")
    (untold,) = ask(tiny_run, folder)
    assert "the gel is not known" in in_words(untold)
    thick, whole = Gel(thickness_mm=3.1, edge_thickness_mm=1.2, shore_00=22.0), tmp_path / "scene.toml"
    whole.write_text(dump_scene(Scene(gel=thick)))
    sensor = tmp_path / "sensor.toml"
    sensor.write_text("[gel]\nthickness_mm = 3.1\nedge_thickness_mm = 1.2\nshore_00 = 22.0\n")
    assert gel_of_sensor(str(whole)) == gel_of_sensor(str(sensor)) == (3.1, 1.2, 22.0)
    assert gel_of_sensor("fingertip2017") == (2.4, 1.0, 17.0)
    told = [ask(tiny_run, folder, sensor=str(file))[0] for file in (whole, sensor)]
    assert told[0] == told[1] and told[0]["note"].split("; ")[-3:-1] == [
        "the gel's thickness 3.1 mm is outside what it was trained on (2.1 to 2.7 mm)",
        "the gel's hardness 22 Shore 00 is outside what it was trained on (13 to 19 Shore 00)",
    ]
    (usual,) = ask(tiny_run, folder, sensor="fingertip2017")
    assert len({answer["shore_00"] for answer in (untold, told[0], usual)}) == 3
    # What `gelsim render` wrote says it itself, and its scale; what is asked for beats it; a scene that cannot be read takes nothing away.
    field = 0.8 * FIELD_MM[0], 0.8 * FIELD_MM[1]
    (folder / "scene.toml").write_text(dump_scene(Scene(gel=thick, camera=Camera(field_mm=field))))
    scale = Framing(mm_per_px=field[0] / press.shape[2])
    assert "not known" in told[0]["note"] and "not known" not in (whole_told := ask(tiny_run, folder)[0])["note"]
    assert whole_told == ask(tiny_run, folder, sensor=str(whole), framing=scale)[0] != told[0]
    assert ask(tiny_run, folder, sensor="fingertip2017", framing=scale)[0]["shore_00"] != whole_told["shore_00"]
    (folder / "scene.toml").write_text("gel = 3")
    assert ask(tiny_run, folder)[0] == untold
    # So do the rows of a dataset and of an episode.
    index = load_dataset(fake_data).rows[4]["index"]
    for path in (fake_data, fake_data / load_dataset(fake_data).rows[4]["file"]):
        (answer,) = (a for a in ask(tiny_run, path) if a["source"].endswith((f"#{index}", ".tar")))
        assert answer["status"] == "ok" and "the gel" not in answer["note"]


def test_a_sensor_is_refused_where_it_tells_nobody(tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for model, sensor, words in (
        (str(tiny_run / "model.pt"), "fingertip2018", "'fingertip2018'"),
        (str(tiny_run / "model.pt"), str(tmp_path / "none.toml"), "cannot be read"),
        (str(old_style(tiny_run, tmp_path)), "fingertip2017", "takes no gel"),
    ):
        assert cli.main(["predict", "--model", model, "--sensor", sensor, "x.mp4"]) == 2
        told = capsys.readouterr().err
        assert words in told and told.count("\n") == 1, told


def old_style(run: Path, folder: Path) -> Path:
    """A checkpoint from before the gel was told: its config has no word of it, its network four inputs less."""
    kept = torch.load(run / "model.pt", weights_only=True)
    del kept["config"]["model"]["show_gel"], kept["config"]["augment"]["hide_gel"]
    kept["network"]["embed.weight"] = kept["network"]["embed.weight"][:, :-4].clone()
    torch.save(kept, folder / "old.pt")
    return folder / "old.pt"


def test_a_network_that_takes_no_gel_does_not_miss_it(tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    (answer,) = predict([old_style(tiny_run, tmp_path)], [film(tmp_path / "press.mkv", press)])
    assert answer["status"] == "ok" and "the gel" not in answer["note"]


def test_odd_videos_get_a_clear_answer_each(tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    still = np.repeat(press[:1], 8, axis=0)
    long = film(tmp_path / "long.mkv", np.repeat(still, 20, axis=0), fps=0.0111)
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "empty").mkdir()
    odd = {
        long: ("unreadable", "lasts 4.0 h; a press lasts seconds"),
        film(tmp_path / "one.mkv", press[:1]): ("unreadable", "1 frame; a press takes at least 2"),
        film(tmp_path / "black.mkv", np.zeros_like(press)): ("unreadable", "is black"),
        film(tmp_path / "still.mkv", still): ("no contact", "no contact in 8 frames"),
        film(tmp_path / "let_go.mkv", press[::-1]): ("unreadable", "starts in contact and is let go"),
        tmp_path / "text.mp4": ("unreadable", "is no video that can be read"),
        tmp_path / "empty": ("unreadable", "holds no pictures"),
        tmp_path / "none.mp4": ("unreadable", "no such file"),
    }
    start = time.process_time()
    answers = ask(tiny_run, *odd)
    assert time.process_time() - start < 20
    for answer, (status, words) in zip(answers, odd.values(), strict=True):
        assert answer["status"] == status and words in in_words(answer), answer
    # A part of the long one can be asked for.
    assert ask(tiny_run, long, start=0.0, seconds=MOST_SECONDS)[0]["status"] in ("no contact", "unreadable")


def test_a_film_that_begins_in_contact_is_read_as_one_from_rest(tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    whole, late = (ask(tiny_run, film(tmp_path / name, frames))[0]
                   for name, frames in (("whole.mkv", press), ("late.mkv", np.concatenate([press[:2:-1], press]))))  # fmt: skip
    assert late["shore_00"] == whole["shore_00"] and "starts in contact" in late["note"] and "several" not in whole["note"]


def test_a_render_begins_untouched_however_plain_its_contact(tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    """A flat object leaves a dome plainer than it was: of pictures alone it is one that is let go."""
    (tmp_path / "frames").mkdir()
    for number, frame in enumerate(press[::-1]):
        Image.fromarray(frame).save(tmp_path / "frames" / f"{number:04d}.png")
    (bare,) = ask(tiny_run, tmp_path)
    (tmp_path / "scene.toml").write_text(dump_scene(Scene()))
    (rendered,) = ask(tiny_run, tmp_path)
    assert bare["status"] == "unreadable" and "is let go" in in_words(bare) and rendered["status"] == "ok"


def test_one_damaged_episode_does_not_end_a_dataset(tiny_run: Path, tmp_path: Path) -> None:
    data = fake_dataset(tmp_path / "data", seed=3, rigid=False)
    dataset = load_dataset(data)
    (data / dataset.rows[1]["file"]).write_bytes(b"nothing")
    answers = ask(tiny_run, data)
    assert len(answers) == len(dataset) and [answer["status"] for answer in answers[:3]] == ["ok", "unreadable", "ok"]
    assert answers[1]["source"].endswith("#1")


def test_a_video_that_does_not_say_its_length_is_cut_off(
    tiny_run: Path, press: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("learn.video.MOST_FRAMES", 5)
    assert "more than 5 frames" in ask(tiny_run, film(tmp_path / "many.mkv", press))[0]["note"]


def test_what_is_unlike_the_training_is_called_so(tiny_run: Path, press: np.ndarray, tmp_path: Path, rng: np.random.Generator) -> None:
    like = ask(tiny_run, film(tmp_path / "like.mkv", press))[0]
    coarse = rng.integers(0, 256, (6, 6, 8, 3), dtype=np.uint8)
    strange = np.repeat(np.repeat(coarse, 6, axis=1), 6, axis=2)
    answer = ask(tiny_run, film(tmp_path / "strange.mkv", strange))[0]
    assert not like["unlike_training"] and answer["unlike_training"] and answer["novelty"] > 2 * like["novelty"]
    assert "do not trust" in in_words(answer)


def gel_file(folder: Path, thickness: float, edge: float, shore: float) -> str:
    """A sensor of such a gel."""
    path = folder / f"{thickness:g}_{edge:g}_{shore:g}.toml"
    path.write_text(f"[gel]\nthickness_mm = {thickness}\nedge_thickness_mm = {edge}\nshore_00 = {shore}\n")
    return str(path)


def test_a_gel_outside_the_trainings_is_named(tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    """Trained on 2.1 to 2.7 mm, 0.8 to 1.4 mm at the edge, 00-13 to 19. Planted: an end of the range that counts as outside."""
    video = film(tmp_path / "press.mkv", press)
    for gel, named in (
        ((2.1, 0.8, 13.0), []),
        ((2.7, 1.4, 19.0), []),
        ((2.74, 0.76, 19.4), []),  # to what is told, the same
        ((2.0, 1.0, 17.0), ["thickness 2.0 mm"]),
        ((2.4, 1.5, 17.0), ["edge thickness 1.5 mm"]),
        ((4.0, 1.0, 12.0), ["thickness 4.0 mm", "hardness 12 Shore 00"]),
    ):
        (answer,) = ask(tiny_run, video, sensor=gel_file(tmp_path, *gel), framing=Framing(mm_per_px=FIELD_MM[0] / press.shape[2]))
        assert answer["novelty"] < 1 and answer["unlike_training"] == bool(named)
        assert [note.partition(" is outside")[0] for note in answer["note"].split("; ") if note] == [f"the gel's {name}" for name in named]
    # Who does not say which gel it is hears of no range.
    (untold,) = ask(tiny_run, video)
    assert not untold["unlike_training"] and "outside" not in untold["note"]


def test_strange_pictures_and_a_strange_gel_are_both_told(tiny_run: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    strange = film(tmp_path / "strange.mkv", rng.integers(0, 256, (6, 36, 48, 3), dtype=np.uint8))
    (answer,) = ask(tiny_run, strange, sensor=gel_file(tmp_path, 4.0, 1.0, 17.0))
    assert answer["unlike_training"] and "do not trust" in answer["note"] and "thickness 4.0 mm is outside" in in_words(answer)


def test_the_range_of_gels_may_lack_and_may_not_be_damaged(tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    """A checkpoint from before it was kept reads as it did."""
    video, sensor = film(tmp_path / "press.mkv", press), gel_file(tmp_path, 4.0, 1.0, 17.0)
    kept = torch.load(tiny_run / "model.pt", weights_only=True)
    lowest, highest = kept["gels"]["lowest"], kept["gels"]["highest"]

    def answer(gels: object) -> dict[str, Any]:
        torch.save(kept | {"gels": gels}, tmp_path / "model.pt")
        return ask(tmp_path, video, sensor=sensor)[0]

    bare = {name: value for name, value in kept.items() if name != "gels"}
    torch.save(bare, tmp_path / "model.pt")
    (old,) = ask(tmp_path, video, sensor=sensor)
    assert not old["unlike_training"] and "outside" not in old["note"] and old == answer(None)
    now = answer(kept["gels"])
    assert now == old | {"unlike_training": True, "note": now["note"]} and "outside" in now["note"]
    for damaged in (
        "2.1 to 2.7",
        {"lowest": lowest},
        {"lowest": lowest.tolist(), "highest": highest.tolist()},
        {"lowest": lowest[:2], "highest": highest[:2]},
        {"lowest": highest, "highest": lowest},
        {"lowest": lowest, "highest": highest * torch.nan},
        {"lowest": lowest, "highest": highest * torch.inf},
    ):
        with pytest.raises(LearnError, match="range of gels is damaged"):
            answer(damaged)


def test_distance_is_one_for_presses_like_those(rng: np.random.Generator) -> None:
    mixing = rng.normal(size=(12, 12))
    draw = torch.from_numpy(rng.normal(size=(4000, 12)) @ mixing + 5)
    fitted = fit_novelty(draw[:2000], draw[2000:3000])
    inside = fitted.distance(draw[3000:])
    # d² is chi-square of 12 over 12: mean 1; shrinking by a tenth toward the diagonal changes it by about as much.
    assert float((inside**2).mean()) == pytest.approx(1, abs=0.25)
    # 99 % of 1,000 stay below: four standard deviations of such a share are 1.3 %.
    assert float((inside > fitted.threshold).double().mean()) <= 0.01 + 0.013
    assert float(fitted.distance(draw[:1] + 40)[0]) > fitted.threshold


def test_presses_of_another_sensor_are_not_unlike_by_that(rng: np.random.Generator) -> None:
    """Twenty sensors, each with a look of its own beside what presses vary by; twenty others."""
    looks = rng.normal(scale=3.0, size=(40, 12))
    of = rng.integers(20, size=3000)
    draw = torch.from_numpy(looks[of] + rng.normal(size=(3000, 12)))
    names = [str(number) for number in of]
    fitted = fit_novelty(draw[:2000], draw[2000:], (names[:2000], names[2000:]))
    others = fitted.distance(torch.from_numpy(looks[20 + rng.integers(20, size=1000)] + rng.normal(size=(1000, 12))))
    # The threshold is the looks' of the farthest of twenty: of twenty others one may well be as far, hardly three.
    assert float((others > fitted.threshold).double().mean()) <= 0.1
    assert float((others > fit_novelty(draw[:2000], draw[2000:]).threshold).double().mean()) > 0.2
    alone = fit_novelty(draw[:2000], draw[2000:], (["one"] * 2000, ["one"] * 1000))
    assert alone.threshold == fit_novelty(draw[:2000], draw[2000:]).threshold


# ---- the command line ----


@pytest.mark.parametrize("arguments", [["--help"], ["train", "--help"]])
def test_help_is_instant(arguments: list[str]) -> None:
    code = f"import sys; from learn.cli import main\ntry: main({arguments!r})\nexcept SystemExit: pass\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "usage: gelsim-learn" in done.stdout
    assert not {"torch", "numpy", "matplotlib", "imageio_ffmpeg"} & set(done.stdout.splitlines()[-1].split())


def test_bad_input_is_one_line_and_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in (
        (["train", "--data", "x", "--out", "y", "--stepz", "3"], "did you mean '--steps'"),
        (["train", "--data", str(tmp_path), "--out", str(tmp_path / "run")], "is no dataset"),
        (["train", "--data", "x", "--out", "y", "--batch", "many"], "batch = 'many': expected a whole number"),
        (["eval", "--model", str(tmp_path / "no.pt"), "--data", str(tmp_path)], "no"),
        (["predict", "--model", "defolt", "x.mp4"], "no shipped checkpoint"),
        (["nonsense"], "COMMAND"),
    ):
        assert cli.main(arguments) == 2
        told = capsys.readouterr().err
        assert words in told and told.count("\n") == 1, told


def test_exit_codes_of_predict(tiny_run: Path, press: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, model = film(tmp_path / "press.mkv", press), str(tiny_run / "model.pt")
    assert cli.main(["predict", "--model", model, str(good)]) == 0
    assert cli.main(["predict", "--model", model, str(good), "none.mp4"]) == 4
    assert cli.main(["predict", "--model", model, "none.mp4"]) == 2
    assert capsys.readouterr().out.count("Shore 00") == 2


def test_json_lines_are_an_object_a_press(tiny_run: Path, press: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, model = film(tmp_path / "press.mkv", press), str(tiny_run / "model.pt")
    assert cli.main(["predict", "--model", model, "--json-lines", str(good), "none.mp4", str(good)]) == 4
    first, second, third = map(json.loads, capsys.readouterr().out.splitlines())
    assert first == third and first["status"] == "ok" and second["source"] == "none.mp4" and second["status"] == "unreadable"
    assert cli.main(["predict", "--model", model, "--json", str(good)]) == 0
    assert json.loads(capsys.readouterr().out)["presses"] == [first]
    assert cli.main(["predict", "--json", "--json-lines", str(good)]) == 2


def test_the_fake_press_is_as_large_as_its_dataset(rng: np.random.Generator) -> None:
    assert fake_press(30.0, 5.0, 1.0, 3, rng, fake_row(0, "a")).frames.shape == (3, ROWS, COLUMNS, 3)


def seen(folder: Path, frames: np.ndarray, framing: Framing = AS_IT_IS) -> np.ndarray:
    """What the network gets to see of a press."""
    folder.mkdir()
    for number, frame in enumerate(frames):
        Image.fromarray(frame).save(folder / f"{number:04d}.png")
    ((_, read),) = sources(folder, InputConfig(picture=(18, 24)), framing=framing)
    return read().recording.pictures


def test_a_press_is_seen_alike_however_it_is_framed(press: np.ndarray, tmp_path: Path) -> None:
    high, wide = press.shape[1:3]
    whole = seen(tmp_path / "whole", press)
    bordered = np.pad(press, ((0, 0), (9, 21), (30, 10), (0, 0)))
    assert (seen(tmp_path / "border", bordered, Framing(crop=(30, 9, wide, high))) == whole).all()
    assert (seen(tmp_path / "found", bordered) == whole).all()  # black, so found without a word
    assert (seen(tmp_path / "grey", bordered.clip(min=40)) != whole).any()  # planted: not black
    corners = np.array([[30, 9], [30 + wide, 9], [30 + wide, 9 + high], [30, 9 + high]], float)
    assert np.abs(seen(tmp_path / "corners", bordered, Framing(corners=Corners(corners))) - whole).max() < 1.0
    # every pixel doubled is half as large: averaged to the network's size nothing is left of it
    doubled, scale = press.repeat(2, axis=1).repeat(2, axis=2), FIELD_MM[0] / wide
    assert np.abs(seen(tmp_path / "doubled", doubled, Framing(mm_per_px=scale / 2)) - whole).max() < 0.02
    # planted: corners half a pixel of the network's off, a scale that is a tenth too large
    assert np.abs(seen(tmp_path / "aside", bordered, Framing(corners=Corners(corners + [1.0, 0.0]))) - whole).max() > 3.0
    assert np.abs(seen(tmp_path / "wrong", press, Framing(mm_per_px=1.1 * scale)) - whole).max() > 3.0


def test_the_contact_is_cut_out_at_its_scale() -> None:
    """A white square of 2 mm, off the middle of a picture of 60 x 45 mm: in the network's picture it is 2 mm, and in the middle."""
    scale, picture = 0.1, (96, 128)
    empty, pressed = np.zeros((450, 600, 3), np.uint8), np.zeros((450, 600, 3), np.uint8)
    pressed[100:120, 400:420] = 255
    small = np.stack([averaged(frame, picture) for frame in (empty, pressed)]).astype(np.float32) / 256
    centre = contact_centre(small, small[0], np.array([0.0, 1.0]), 3.0)
    assert centre == pytest.approx((410 / 600, 110 / 450), abs=2e-3)
    seen = at_scale(pressed, picture, scale, centre)[..., 0] / 256
    assert seen.shape == picture and seen.sum() / 255 == pytest.approx((2.0 * picture[1] / FIELD_MM[0]) ** 2, rel=0.03)
    rows, columns = (float((np.arange(len(part)) * part).sum() / part.sum()) for part in (seen.sum(axis=1), seen.sum(axis=0)))
    assert (rows, columns) == pytest.approx((47.5, 63.5), abs=1.0)
    # a picture smaller than the network's field stands in its middle, its border around it
    assert (at_scale(np.full((60, 80, 3), 9, np.uint8), picture, scale, (0.5, 0.5)) == 9 * 256).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--crop", "0", "0", "10", "10", "--corners", *"0 0 9 0 9 9 0 9".split()], "exclude each other"),
        (["--crop", "-1", "0", "10", "10"], "--crop -1 0 10 10: left and top are 0 px or more"),
        (["--mm-per-px", "5"], "--mm-per-px 5: allowed is 0.001 … 1"),
        (["--corners-mm", "10", "8"], "--corners-mm is the size of the rectangle of --corners"),
        (["--corners", *"0 0 0 90 90 90 90 0".split()], "run the other way round"),
    ],
)
def test_a_framing_that_is_none(options: list[str], message: str, tiny_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["predict", "--model", str(tiny_run / "model.pt"), *options, "x.mp4"]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("level", [0, 90, 255])
def test_a_border_that_was_cut_off_is_said(level: int, tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    bordered = np.pad(press, ((0, 0), (9, 21), (30, 10), (0, 0)), constant_values=level)
    plain, (answer,) = ask(tiny_run, film(tmp_path / "plain.mkv", press)), ask(tiny_run, film(tmp_path / "border.mkv", bordered))
    assert answer["shore_00"] == plain[0]["shore_00"] and "a border was cut off (--crop 30 9 48 36)" in answer["note"]
    assert "border" not in plain[0]["note"].replace(str(tmp_path), "")
    dark = Framing().outlined(np.full((20, 30, 3), level, np.uint8))
    assert dark.crop is None  # nothing is left of a picture that is all border


def test_what_is_no_border_is_kept(press: np.ndarray) -> None:
    frame = press[0]
    shaded = np.tile(np.linspace(60, 160, frame.shape[1]).astype(np.uint8)[:, None], (frame.shape[0], 1, 3))
    assert Framing().outlined(shaded).crop is None  # even columns, each of another colour
    noisy = np.pad(frame, ((20, 20), (30, 30), (0, 0)), constant_values=90).astype(int)
    noisy[:, :30] += np.random.default_rng(0).integers(-20, 20, noisy[:, :30].shape)
    assert Framing().outlined(noisy.clip(0, 255).astype(np.uint8)).crop is None  # a sensor's own edge has grain
    left = np.pad(frame, ((0, 0), (20, 0), (0, 0)), constant_values=200)
    assert Framing().outlined(left).crop == (20, 0, frame.shape[1], frame.shape[0])


def test_a_framing_beyond_the_frames(tiny_run: Path, press: np.ndarray, tmp_path: Path) -> None:
    video, (high, wide) = film(tmp_path / "press.mkv", press), press.shape[1:3]
    for framing, message in (
        (Framing(crop=(10, 10, wide, high)), f"reaches beyond {video}, which is {wide} x {high} px"),
        (Framing(mm_per_px=0.001), "allowed is 4 … 200 mm a side"),
    ):
        (answer,) = ask(tiny_run, video, framing=framing)
        assert answer["status"] == "unreadable" and message in answer["note"]


def test_mechanics_beside_the_network(tmp_path: Path) -> None:
    """Two readings disagree where they are further apart than 90 % of the differences that their spreads allow: 1.645 · 5 = 8.2 here."""
    report = tmp_path / "report.json"
    report.write_text('{"shore_00": 40.0, "shore_00_sd": 3.0}')
    identified = read_identified(tmp_path)
    assert identified == read_identified(report) == (40.0, 3.0)
    answer = {"source": "a", "status": "ok", "shore_00": 48.0, "spread": 4.0, "true": None, "note": ""}
    assert beside(answer, identified)["disagree"] is False
    assert "the two disagree" in in_words(beside(answer | {"shore_00": 48.5}, identified))
    assert "disagree" not in beside(answer | {"spread": None}, identified)
    lost = {"source": "a", "status": "no contact", "note": "no contact"}
    assert beside(lost, identified) == lost
    for content in ("{}", '{"shore_00": null, "shore_00_sd": null}', "no"):
        report.write_text(content)
        with pytest.raises(LearnError, match="--identified"):
            read_identified(tmp_path)
