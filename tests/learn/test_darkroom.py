"""Episodes without pictures: drawn by the learner, they are what reading their pictures would have given. Dents are made up."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_fixtures import TINY, formula_field, put_fields
from PIL import Image

from gelsim.calibrate.preset import write_preset
from gelsim.data.episodes import gel_facts, load_dataset, survey, write_episode, write_meta
from gelsim.data.lightfield import write_field
from gelsim.data.motion import Motion
from gelsim.errors import DatasetError, SceneError
from gelsim.generate import recording
from gelsim.generate.darkroom import small
from gelsim.generate.light import Studio
from gelsim.generate.plan import Catalogue, Press, load_plan
from gelsim.generate.relight import own_catalogue, plan_of, relit_episode
from gelsim.generate.run import keep_plan, kept_plan
from gelsim.optics import bake
from gelsim.scene.layers import build_scene
from learn import recordings
from learn.config import configure
from learn.recordings import Archive, Reading, archive, camera_noise
from learn.stream import Stream

INPUTS = configure(picture=(24, 32), widths=(8, 16)).input
PLAN = f"""base = {json.dumps(TINY)}
name = "own"
resolution = [160, 120]
[sensors]
"gel.thickness_mm" = 2.2
"gel.shore_00" = 14.0
[episode]
"camera.noise_sd" = [{{ uniform = [1.0, 2.0] }}, {{ uniform = [1.0, 2.0] }}, {{ uniform = [2.0, 3.0] }}]
"camera.exposure" = {{ log_uniform = [0.9, 1.1], relative = "times" }}
"markers.seed" = {{ integers = [0, 99] }}
"""
PRESSES = 2


def dent(press: Press) -> Motion:
    """A round dent of half a millimetre that draws the surface inward, in three states."""
    side = np.array(press.scene.gel.size_mm) * 1e-3 / 2
    x, y = (part.ravel() for part in np.meshgrid(*(np.linspace(-half, half, 33) for half in side)))
    places = np.stack([x, y], axis=1)
    bump = np.exp(-((x - 1e-3) ** 2 + y**2) / (2 * 1.5e-3**2))[:, None]
    move = bump * np.column_stack([-0.05 * x, -0.05 * y, np.full(len(x), -0.5e-3)])
    share = np.array([0.0, 0.5, 1.0])
    force = np.column_stack([0 * share, 0 * share, -2.0 * share])
    return Motion(share * 0.5e-3, force, share * 1e-5, places, share[:, None, None] * move)


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Path]]:
    """The same episodes without pictures, and with those of their plan."""
    home = tmp_path_factory.mktemp("darkroom")
    patch = pytest.MonkeyPatch()
    patch.setenv("GELSIM_CACHE", str(home / "cache"))
    plan = home / "own.toml"
    plan.write_text(PLAN, encoding="utf-8")
    put_fields(str(plan), 5)
    catalogue, studio = Catalogue(load_plan(str(plan)), 5), Studio("cpu")
    for name, drawn in (("dark", None), ("lit", studio)):
        rows = []
        for press in map(catalogue.press, range(PRESSES)):
            for end in (0, 1):
                made = recording.record(catalogue, press, end, dent(press), drawn)
                write_episode(home / name, made.episode, made.members)
                rows.append(made.episode.row["index"])
        info: dict[str, Any] = {"domain": "sim", "fps": 30, "plan": "own", "plan_sha256": catalogue.plan.digest, "seed": 5}
        write_meta(home / name, info, survey(home / name), [], {"train": rows})
        keep_plan(catalogue, home / name)
    yield home / "dark", home / "lit"
    patch.undo()


def read(folder: Path, cache: Path | None = None, **more: Any) -> Archive:
    data = load_dataset(folder)
    return archive(data, [row["index"] for row in data.rows], INPUTS, Reading(cache, device="cpu", **more))


@pytest.fixture(scope="module")
def drawn(datasets: tuple[Path, Path]) -> Archive:
    return read(datasets[0])


def rms(a: Any) -> float:
    return float(np.sqrt(np.mean(np.square(a))))


def test_drawn_is_what_reading_its_pictures_gives(datasets: tuple[Path, Path], drawn: Archive) -> None:
    seen = read(datasets[1])
    assert len(drawn) == len(seen) == 2 * PRESSES and [row.get("pictures") for row in drawn.rows] == [False] * len(drawn)
    for number in range(len(drawn)):
        one, other = drawn.recording(number), seen.recording(number)
        # Rounding to 8 bits: 0.29 levels a pixel, 4 of them against 25: √(0.144² + 0.058²) = 0.16. Markers' edges: over a pixel that an
        # edge blurs from 49 to 130 levels the tone curve's mean is 7 above the ends', and drawn pixels are 0.5 wide where the others are
        # 0.2 (of the network's): 0.3 × 7 = 2.1 levels along an edge, which a fifth of the pixels have (1.25 mm of it by 9 mm²): 0.9.
        assert 0.1 < rms(one.pictures - other.pictures) < 1.0 and rms(one.background - other.background) < 1.0
        assert abs(one.signal - other.signal).max() < 0.05 < 0.3 < other.signal.max()
        assert one.noise == other.noise and one.noise.flat > 0.1
        np.testing.assert_allclose(drawn.features[number][:, 4:], seen.features[number][:, 4:], atol=2e-6)  # markers, float32 in the file
    # Not that near to another episode, whose exposure and markers are others.
    assert rms(drawn.recording(0).background - seen.recording(1).background) > 3.0


def test_rows_tell_the_gel_of_the_mechanics_whichever_sensor_sees_it(datasets: tuple[Path, Path], drawn: Archive) -> None:
    data = load_dataset(datasets[0])
    catalogue = own_catalogue(data, plan_of(data))
    gels = [gel_facts(catalogue.press(number).scene.gel) for number in range(PRESSES)]
    for rows in (drawn.rows, load_dataset(datasets[1]).rows):
        assert [row["gel"] for row in rows] == [gels[int(row["mechanics"])] for row in rows]
    assert Stream([drawn], configure(picture=(24, 32), widths=(8, 16), hide_gel=0.0)).batch([0]).gel.tolist()[0] == pytest.approx(
        list(gels[0].values())  # float32 in the batch
    )
    assert gels[0]["shore_00"] == 14.0 and gels[0] != gel_facts(build_scene({"sensor": {"preset": "gelsight_mini"}}).gel)
    dark: Any = None
    relit = relit_episode(data, 0, "gelsight_mini", catalogue, dark)
    assert relit.episode.row["gel"] == gels[0] and relit.episode.row["sensor"] == "gelsight_mini"
    assert list(relit.episode.row) == list(data.rows[0])  # byte for byte, so in one order


def test_noise_is_that_of_the_pixels_the_camera_has(datasets: tuple[Path, Path], drawn: Archive) -> None:
    episode = load_dataset(datasets[1]).read(0)
    assert drawn.noises[0] == camera_noise(episode, INPUTS.picture)
    # 25 pixels of 160 × 120 are averaged; of the 64 × 48 that are drawn it would be 4.
    assert camera_noise(episode, INPUTS.picture).flat == pytest.approx(camera_noise(episode, INPUTS.picture, (48, 64)).flat * 2 / 5)


def test_processes_draw_what_one_draws_and_a_full_cache_draws_nothing(
    datasets: tuple[Path, Path], drawn: Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[str, int, int]] = []
    monkeypatch.setattr(recordings, "_AT_ONCE", 2)  # a press for each
    shared = read(datasets[0], tmp_path, workers=2, progress=lambda *what: told.append(what))
    assert told == [("drawing presses", 2, 4), ("drawing presses", 4, 4)]
    for number in range(len(drawn)):
        np.testing.assert_array_equal(drawn.stored(number), shared.stored(number))
        np.testing.assert_array_equal(drawn.features[number], shared.features[number])
    monkeypatch.setattr(recordings, "_drawn_by", None)  # no plan is read, nothing is drawn
    np.testing.assert_array_equal(read(datasets[0], tmp_path).stored(0), drawn.stored(0))
    assert len([path for path in tmp_path.iterdir() if path.is_dir()]) == 1


def test_what_a_process_cannot_read_is_told(datasets: tuple[Path, Path], tmp_path: Path) -> None:
    for folder, workers in zip(datasets, (0, 2), strict=True):
        broken = shutil.copytree(folder, tmp_path / folder.name)
        (broken / load_dataset(broken).rows[2]["file"]).write_bytes(b"no tar")
        with pytest.raises(DatasetError, match="000002.tar"):
            read(broken, tmp_path / "cache", workers=workers)


def test_the_plan_is_kept_or_given(datasets: tuple[Path, Path], drawn: Archive, tmp_path: Path) -> None:
    data = load_dataset(datasets[0])
    assert load_plan(plan_of(data)).digest == data.info["plan_sha256"] and own_catalogue(data, plan_of(data)).seed == 5
    shutil.copytree(datasets[0], tmp_path / "older")
    kept_plan(tmp_path / "older").unlink()
    with pytest.raises(SceneError, match="--plan 'own'"):
        read(tmp_path / "older")
    with pytest.raises(SceneError, match="not what it was made from"):
        read(tmp_path / "older", plan=TINY)
    given = read(tmp_path / "older", plan=str(datasets[0].parent / "own.toml"))
    np.testing.assert_array_equal(given.stored(0), drawn.stored(0))
    kept_plan(tmp_path / "older").write_text("[1]", encoding="utf-8")
    with pytest.raises(SceneError, match="holds no table"):
        read(tmp_path / "older")


@pytest.mark.parametrize(
    ("resolution", "picture", "drawn"),
    [
        ((320, 240), (96, 128), (256, 192)),
        ((320, 240), (48, 64), (128, 96)),
        ((320, 240), (224, 224), (320, 240)),  # the paper's, squeezed: never more than the plan's
        ((320, 240), (50, 100), (200, 150)),
        ((640, 480), (96, 128), (256, 192)),
        ((160, 90), (20, 32), (80, 45)),
    ],
)
def test_the_smallest_picture_with_two_pixels_for_each(
    resolution: tuple[int, int], picture: tuple[int, int], drawn: tuple[int, int]
) -> None:
    assert small(resolution, picture) == drawn


def test_a_dataset_is_relit_with_a_sensor_that_carries_its_photograph(datasets: tuple[Path, Path], tmp_path: Path) -> None:
    row, column = np.mgrid[:120, :160]
    photo = np.stack([60 + column / 2, 90 + row / 2, 150 - column / 4], axis=-1)
    photo[40:44, 30:34] = 40.0  # a speck
    photo = np.rint(photo)
    Image.fromarray(photo.astype(np.uint8)).save(tmp_path / "rest.png")
    scene = build_scene({"sensor": {"preset": "gelsight_mini"}})
    camera = dataclasses.replace(scene.camera, rest="rest.png", rest_smooth=(), resolution=(160, 120), noise_sd=(0.0, 0.0, 0.0))
    sensor = tmp_path / "mine.toml"
    write_preset(sensor, scene.replace(camera=camera), ["mine"])
    data = load_dataset(datasets[0])
    plain = tmp_path / "plain.toml"
    plain.write_text(f'base = {json.dumps(TINY)}\nname = "plain"\n[episode]\n', encoding="utf-8")
    catalogue = Catalogue(load_plan(str(plain)), 5)
    drawn = build_scene({"sensor": {"preset": str(sensor)}, "render": {"resolution": [160, 120]}})
    write_field(bake.field_path(drawn), formula_field(drawn))
    relit = relit_episode(data, 0, str(sensor), catalogue, Studio("cpu"), (160, 120))
    off = np.abs(relit.episode.frames.astype(float) - photo).max(axis=-1)
    # Without contact the photograph itself, to rounding; the press, a bell of 1.5 mm about (1, 0) mm, changes what is beneath it alone:
    # 6 mm away it has e^-8 of its slope there.
    assert off[0].max() <= 1 and off[-1].max() > 10 and off[-1][:, :25].max() <= 1
    # Planted: the photograph a pixel aside.
    assert np.abs(relit.episode.frames[0] - np.roll(photo, 1, axis=1)).max() > 1
