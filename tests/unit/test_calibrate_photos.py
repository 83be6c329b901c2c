"""What `gelsim calibrate` refuses: one line each, nothing written; and what it warns of."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gelsim.calibrate import run
from gelsim.calibrate.parameters import GLOBALS, Parameters
from gelsim.calibrate.photos import read_photos
from gelsim.cli.main import main
from gelsim.errors import SceneError
from gelsim.pipeline.outputs import write_radiance

GOOD = 'ball_radius_mm = 2.0\nno_contact = "rest.png"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "photos"
    path.mkdir()
    for index, name in enumerate(("rest.png", "a.png", "b.jpg")):
        Image.fromarray(np.full((48, 64, 3), 100 + 10 * index, np.uint8)).save(path / name)
    (path / "photos.toml").write_text(GOOD)
    return path


def test_reads_pictures_with_and_without_a_table(folder):
    photos = read_photos(folder)
    assert photos.files == ["a.png", "b.jpg"] and photos.size == (64, 48) and not photos.test.any()
    assert photos.pictures[0, 0, 0].tolist() == [110, 110, 110] and np.isnan(photos.hints).all()
    (folder / "presses.csv").write_text("file,col_px,row_px,depth_mm,split\nb.jpg,,,0.4,train\na.png,3,4,,test\n")
    (folder / "photos.toml").write_text(GOOD + 'mm_per_px = 0.1\n[gel]\nprofile = "flat"\nthickness_mm = 3.0\n')
    photos = read_photos(folder)
    assert photos.files == ["b.jpg", "a.png"] and photos.test.tolist() == [False, True] and photos.mm_per_px == 0.1
    assert photos.hints[0, 2] == 0.4 and photos.hints[1, :2].tolist() == [3, 4] and photos.gel and photos.gel.thickness_mm == 3.0


def test_linear_pictures_go_on_the_srgb_scale(folder):
    for name in ("rest.exr", "c.exr"):
        write_radiance(folder / name, np.full((48, 64, 3), 0.18, np.float32))
    (folder / "photos.toml").write_text(GOOD.replace("rest.png", "rest.exr"))
    (folder / "presses.csv").write_text("file\nc.exr\n")
    # 18 % grey is 117.6 of 255 on the sRGB curve.
    assert read_photos(folder).no_contact == pytest.approx(117.6, abs=0.1)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("photos.toml", None, "photos.toml: cannot be read"),
        ("photos.toml", "ball_radius_mm = ", "is not TOML"),
        ("photos.toml", 'no_contact = "rest.png"\n', "ball_radius_mm is missing"),
        ("photos.toml", "ball_radius_mm = 2.0\n", "no_contact is missing"),
        ("photos.toml", GOOD.replace("2.0", "0.0"), "ball_radius_mm = 0 mm: allowed is 0.5 … 50 mm"),
        ("photos.toml", GOOD.replace("2.0", "nan"), "finite"),
        ("photos.toml", GOOD.replace("2.0", '"big"'), "expected a number"),
        ("photos.toml", GOOD + "mm_per_pixel = 0.1\n", "unknown key 'mm_per_pixel'; did you mean 'mm_per_px'"),
        ("photos.toml", GOOD.replace("2.0", "-2.0"), "ball_radius_mm = -2 mm: allowed is 0.5 … 50 mm"),
        ("photos.toml", GOOD + "mm_per_px = 0.0\n", "mm_per_px = 0 mm/px"),
        ("photos.toml", GOOD + "mm_per_px = nan\n", "mm_per_px = nan: expected a finite number"),
        ("photos.toml", GOOD + "[gel]\nthickness_mm = -1.0\n", "gel.thickness_mm = -1 mm"),
        ("photos.toml", GOOD.replace("rest.png", "none.png"), "none.png: is not a picture"),
        ("a.png", "not a picture", "a.png: is not a picture that can be read"),
        ("presses.csv", "file,depth\na.png,1\n", "unknown column 'depth'; did you mean 'depth_mm'"),
        ("presses.csv", "split\ntest\n", "the column file is missing"),
        ("presses.csv", "file,depth_mm\na.png,deep\n", "line 2: depth_mm = 'deep' is not a number"),
        ("presses.csv", "file,depth_mm\na.png,-0.5\n", "depth_mm = -0.5 mm: allowed is more than 0"),
        ("presses.csv", "file,col_px\na.png,inf\n", "col_px = inf is not finite"),
        ("presses.csv", "file,col_px\na.png,-5\n", "presses.csv: line 2: col_px = -5 px: allowed is 0 … 64 px"),
        ("presses.csv", "file,col_px,row_px\na.png,64,48\nb.jpg,0,48.5\n", "presses.csv: line 3: row_px = 48.5 px: allowed is 0 … 48 px"),
        ("presses.csv", "file,depth_mm\na.png,nan\n", "depth_mm = nan is not finite"),
        ("presses.csv", "file,contact_radius_px\na.png,0\n", "contact_radius_px = 0 px: allowed is more than 0, up to 32 px"),
        ("presses.csv", "file,contact_radius_px\na.png,33\n", "contact_radius_px = 33 px: allowed is more than 0, up to 32 px"),
        ("presses.csv", "file,split\na.png,maybe\n", "split = 'maybe'; allowed are train, test"),
        ("presses.csv", "file,split\na.png\n", "line 2 has not 2 cells"),
        ("presses.csv", "file\na.png\na.png\n", "'a.png' comes twice"),
        ("presses.csv", "file\na.png\nrest.png\n", "'rest.png' is no press: photos.toml names it"),
        ("presses.csv", "file\nc.png\n", "c.png: is not a picture"),
    ],
)
def test_bad_folders_are_refused_in_one_line(folder, file, text, message):
    (folder / file).unlink(missing_ok=True)
    if text is not None:
        (folder / file).write_text(text)
    with pytest.raises(SceneError) as caught:
        read_photos(folder)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_picture_that_holds_nan_is_refused(folder):
    values = np.full((48, 64, 3), 0.18, np.float32)
    write_radiance(folder / "c.exr", values)
    (folder / "presses.csv").write_text("file\nc.exr\n")
    read_photos(folder)
    values[5, 6, 1] = np.nan
    write_radiance(folder / "c.exr", values)
    with pytest.raises(SceneError, match="c.exr: holds values that are not finite"):
        read_photos(folder)


@pytest.mark.parametrize(
    ("size", "message"), [((60, 48), "is 60 x 48 px, but no_contact is 64 x 48 px"), ((8, 48), "allowed are 32 … 4096")]
)
def test_pictures_of_other_sizes_are_refused(folder, size, message):
    Image.fromarray(np.zeros((size[1], size[0], 3), np.uint8)).save(folder / "a.png")
    with pytest.raises(SceneError, match=message):
        read_photos(folder)


def test_the_command_writes_nothing_on_bad_input(folder, tmp_path, capsys):
    (folder / "photos.toml").write_text(GOOD.replace("2.0", "0.0"))
    assert main(["calibrate", "--photos", str(folder), "--out", str(tmp_path / "out" / "sensor.toml")]) == 2
    assert "ball_radius_mm = 0 mm" in capsys.readouterr().err and not (tmp_path / "out").exists()
    assert main(["calibrate", "--photos", str(folder), "--out", str(tmp_path / "sensor.png")]) == 2
    assert "ends in .toml" in capsys.readouterr().err
    (tmp_path / "report.json").write_text("{}")
    assert main(["calibrate", "--photos", str(folder), "--out", str(tmp_path / "sensor.toml")]) == 2
    assert "report.json exists; give --force" in capsys.readouterr().err


def test_photographs_without_any_contact_are_refused(folder, tmp_path, capsys):
    for name in ("a.png", "b.jpg"):
        Image.open(folder / "rest.png").save(folder / name)
    (folder / "b.jpg").unlink()
    assert main(["calibrate", "--photos", str(folder), "--out", str(tmp_path / "out" / "sensor.toml")]) == 2
    assert "no contact can be seen in a.png" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_circles_that_a_person_drew_are_believed(folder, tmp_path, monkeypatch):
    (folder / "presses.csv").write_text("file,col_px,row_px,contact_radius_px\na.png,20,30,6\nb.jpg,,,\n")
    photos = read_photos(folder)
    assert photos.radii[0] == 6 and np.isnan(photos.radii[1])
    found = np.array([[40.0, 10.0, 12.0], [32.0, 24.0, 8.0]])
    monkeypatch.setattr(run.beginning, "find_contacts", lambda *_: (found, np.array([False, True])))
    monkeypatch.setattr(run, "solve_dents", lambda *_: None)
    job, _ = run._prepare(photos, run._base(None), tmp_path, "cpu", lambda *_: None, [])
    # The drape about a contact is half as wide again. Planted: what was found is another place.
    assert job.contacts == pytest.approx(np.array([[20.0, 30.0, 9.0], [32.0, 24.0, 8.0]])) and job.contacts[0, 0] != found[0, 0]


@pytest.mark.parametrize(("off", "warned"), [(5.0, False), (15.0, True)])
def test_a_fit_worse_than_no_contact_is_warned_of(folder, off, warned):
    """The one press differs from no_contact by 10 levels everywhere, the fitted sensor's picture of it by `off`."""
    (folder / "presses.csv").write_text("file\na.png\n")
    photos = read_photos(folder)
    globals_ = np.array([0.3, 40.0, 0.0, 3.0, 0.1, 0.4, 1.0, 0.0, 0.0, 0.0])
    sensor = Parameters(globals_, np.zeros((0, 7)), np.ones((1, 3)), 12.0, 32.0, (3.0, 1.5, 1.4))
    base: Any = SimpleNamespace(sensor=SimpleNamespace(preset="none"))
    frozen, nothing = np.ones(len(GLOBALS), bool), np.zeros(0)
    none: Any = SimpleNamespace(deepest=lambda radii: np.ones(len(radii)))
    job = run._Job(photos, base, 1, photos.pictures, photos.no_contact, none, folder, nothing, photos.counted, none, frozen, "cpu",
                   lambda *_: None, [])  # fmt: skip
    fitted = run.Fitted(sensor, np.zeros((1, 3)), 0.0, 1.0, 1.0, np.eye(sensor.vector.size), 1)
    state = run._State("fit", fitted, sensor, np.zeros(1, int), None)
    places = np.zeros((1, 3))
    report = run._report(job, state, places, places, photos.no_contact, photos.pictures + off)
    assert ["worse than the no-contact picture does (MSE 225.0, not 100.0)" in text for text in report["warnings"]] == [True] * warned
    # The no-contact photograph's crop is its own: here all of it is off by 10. Depths at a bound are said.
    assert report["scores"]["no_contact_as_train"]["crop"]["mse"] == pytest.approx(100.0)
    assert any("depth at its bound" in text for text in report["warnings"]) is False
    places[0, 2] = 1.0
    report = run._report(job, state, places, places, photos.no_contact, photos.pictures + off)
    assert any("depth at its bound of 1 mm, the deepest that is solved: a.png; check ball_radius_mm" in text for text in report["warnings"])


def test_the_best_state_stays_whatever_comes_later(folder, monkeypatch):
    """Errors of 5, then 3, then 4: presses that were left out of the fit judge, and the second state is the best."""
    for index in range(8):
        Image.open(folder / "a.png").save(folder / f"p{index}.png")
    (folder / "presses.csv").write_text("file\n" + "".join(f"p{index}.png\n" for index in range(8)))
    photos = read_photos(folder)
    sensor = Parameters(np.zeros(len(GLOBALS)), np.zeros((0, 7)), np.ones((1, 3)), 12.0, 32.0, (3.0, 1.5, 1.4))
    fits, errors = [], iter([5.0, 3.0, 4.0])

    def fitted(job, begin, presses, *_):
        fits.append(len(presses))
        return run.Fitted(sensor, presses, 0.0, 1.0, 1.0, np.eye(1), 1)

    monkeypatch.setattr(run, "_seed", lambda *_: (sensor, np.zeros((8, 5))))
    monkeypatch.setattr(run, "_rough", lambda *_: np.zeros((8, 5)))
    monkeypatch.setattr(run.beginning, "choose_lights", lambda *_: sensor)
    monkeypatch.setattr(run, "_fit", fitted)
    monkeypatch.setattr(run, "_without_needless_lights", lambda job, first, rough, *_: (first, rough))
    monkeypatch.setattr(run, "_locate", lambda job, state, presses, *_: SimpleNamespace(presses=presses))
    monkeypatch.setattr(run, "_correction", lambda *_: (None, None))
    monkeypatch.setattr(run, "_dent_error", lambda job, pictures, which: next(errors))
    job: Any = SimpleNamespace(photos=photos, data=lambda *_: None, dents=None, show=lambda *_: None)
    _, _, states, judged = run._states(job, 0.1)
    assert [state.error for state in states] == [5.0, 3.0, 4.0] and min(states, key=lambda each: each.error) is states[1]
    assert judged.tolist() == [2, 6] and fits == [6, 6, 6] and not set(judged) & set(states[1].which)


def test_a_start_does_not_lend_its_rest():
    base = run._base("gelsight_mini")
    assert not base.camera.has_rest and base.camera.tilt_deg == (0.0, 0.0) and base.gel.thickness_mm == 4.25
