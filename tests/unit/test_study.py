"""Studies: points, a user's own file, resuming, failures, and a page that needs nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from gelsim.cli import main as cli
from gelsim.errors import GelsimError, SceneError, SolveError
from gelsim.scene.layers import build_scene
from gelsim.study import STUDIES, report, runner
from gelsim.study.definition import Study, load_study
from gelsim.study.discrimination import combine
from gelsim.study.metrics import METRICS, Metric
from gelsim.study.photometric import integrate
from gelsim.study.trial import Trial
from gelsim.tables import write_csv
from gelsim.work.ledger import Ledger

OWN = """
question = "Does a stiffer gel need more force?"
metrics = ["letters"]
x = "gel.shore_00"
[fields]
"gel.shore_00" = [10, 17, 30]
"object.radius_mm" = [5, 8]
[scene.object]
shape = "hemisphere"
"""


@pytest.fixture
def letters(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A metric without mechanics, `letters`; the hardnesses it was measured at. It fails at 30 with a radius of 8 the first time."""
    done: list[float] = []

    def measure(trial: Trial) -> float:
        shore, radius = trial.scene.gel.shore_00, trial.scene.object.radius_mm
        assert shore is not None
        done.append(shore)
        if (shore, radius) == (30, 8) and done.count(30) < 3:
            raise SolveError("step 3 did not converge")
        return shore * radius

    monkeypatch.setitem(METRICS, "letters", Metric("letters [1]", measure))
    return done


@pytest.mark.parametrize("quick", [True, False])
@pytest.mark.parametrize("name", STUDIES)
def test_ready_made_studies_are_scenes(name: str, quick: bool) -> None:
    study = load_study(name)
    study = study.small() if quick else study
    points = study.points()
    assert len({str(point) for point in points}) == len(points) <= (6 if quick else 42)
    for point in points:
        build_scene(study.base, study.layer(point))
    assert all(metric in METRICS for metric in study.metrics)
    assert study.x in study.axes and study.colour in study.axes
    assert study.answer([], study)


def test_a_latin_hypercube_meets_every_slice_once_at_each_point_of_the_grid() -> None:
    axes = {"gel.thickness_mm": {"uniform": [1, 5]}, "object.radius_mm": {"log_uniform": [1, 16]}, "fidelity": ["fast", "balanced"]}
    study = Study("latin", "?", axes, ("force_n",), "gel.thickness_mm", cases=8)
    points = study.points()
    assert len(points) == 16 and points == study.points()
    for fidelity in axes["fidelity"]:
        mine = [point for point in points if point["fidelity"] == fidelity]
        assert sorted(int((point["gel.thickness_mm"] - 1) / 4 * 8) for point in mine) == list(range(8))
        assert sorted(int(np.log2(point["object.radius_mm"]) / 4 * 8) for point in mine) == list(range(8))
    other = Study("latin", "?", axes, ("force_n",), "gel.thickness_mm", cases=8, seed=1)
    assert other.points() != points


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("question", "qestion"), "unknown key 'qestion'; did you mean 'question'"),
        (("question", 'fidelity = "fast"\nquestion'), "unknown key 'fidelity'; fidelity of a scene stands in [scene]"),
        (('"letters"', '"force"'), "'force' is none; did you mean 'force_n'"),
        (('"gel.shore_00" = [10', '"gel.shore" = [10'), "fields.'gel.shore'"),
        (("[10, 17, 30]", "{uniform = [10, 30]}"), "cases = None: expected how many points"),
        (("[10, 17, 30]", "{uniform = [10, 30], high = 3}"), "a range"),
        (('"object.radius_mm" = [5, 8]', '"press.frames" = {uniform = [2, 5]}'), "fields.'press.frames': takes no fractions"),
        (("[5, 8]", "[5, 80]"), "allowed for object.radius_mm is 0.5 … 50 mm"),
        (('x = "gel.shore_00"', 'x = "gel.shore_a"'), "allowed are the fields gel.shore_00, object.radius_mm"),
        (('x = "gel.shore_00"', "cases = 3"), "cases = 3: it is for ranges"),
    ],
)
def test_a_wrong_file_says_what_is_wrong(tmp_path: Path, letters: list[float], change: tuple[str, str], said: str) -> None:
    path = tmp_path / "own.toml"
    assert change[0] in OWN
    path.write_text(OWN.replace(*change))
    with pytest.raises(SceneError, match=re.escape(said)):
        runner.run(load_study(str(path)), tmp_path / "out")
    assert not (tmp_path / "out").exists() and letters == []


def test_unknown_studies_name_the_known() -> None:
    with pytest.raises(SceneError, match="did you mean 'gel-hardness'"):
        load_study("gel-hardnes")
    with pytest.raises(SceneError, match="cannot be read"):
        load_study("nowhere.toml")


def test_a_study_without_a_small_form_says_so(tmp_path: Path, letters: list[float]) -> None:
    path = tmp_path / "own.toml"
    path.write_text(OWN)
    with pytest.raises(SceneError, match="--quick: study own has no small form"):
        load_study(str(path)).small()
    assert not (tmp_path / "out").exists() and letters == []


def test_failures_are_listed_and_resume_measures_only_them(
    tmp_path: Path, letters: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "own.toml", tmp_path / "out"
    path.write_text(OWN)
    assert cli.main(["study", str(path), "--out", str(out), "--json"]) == 4
    told = json.loads(capsys.readouterr().out)
    assert len(letters) == 6 and told["cases"] == 6
    assert [item["message"] for item in told["failed"]] == ["step 3 did not converge"]
    assert "object.radius_mm = 8" in told["failed"][0]["case"] and "gel.shore_00 = 30" in told["failed"][0]["case"]
    assert "did not converge" in (out / "index.html").read_text() and "did not converge" in (out / "study.md").read_text()
    assert cli.main(["study", str(path), "--out", str(out)]) == 2 and "--resume" in capsys.readouterr().err
    assert cli.main(["study", str(path), "--out", str(out), "--resume"]) == 0 and len(letters) == 7
    assert "least, 50 at gel.shore_00 10, object.radius_mm 5; most, 240" in capsys.readouterr().out
    # Another scene under the same name is not gone on with.
    path.write_text(OWN + "height_mm = 20\n")
    assert cli.main(["study", str(path), "--out", str(out), "--resume"]) == 0 and len(letters) == 13


def test_a_plain_answer_names_the_axes_that_matter() -> None:
    study = Study("own", "?", {"gel.thickness_mm": [1, 2], "markers.pitch_mm": [1, 2]}, ("force_n",), "gel.thickness_mm")
    rows = [{"gel.thickness_mm": t, "markers.pitch_mm": p, "force_n": 2.0 / t + 1e-5 * p} for t in (1, 2) for p in (1, 2)]
    assert study.answer(rows, study) == "normal force [N]: least, 1 at gel.thickness_mm 2; most, 2 at gel.thickness_mm 1."
    assert study.answer(rows[:2], study) == "normal force [N]: 2 in all cases."
    assert (
        study.answer(rows[:1], study)
        == "normal force [N]: least, 2 at gel.thickness_mm 1, markers.pitch_mm 1; most, 2 at gel.thickness_mm 1, markers.pitch_mm 1."
    )


def test_the_page_holds_all_and_needs_nothing(tmp_path: Path, letters: list[float]) -> None:
    path, out = tmp_path / "own.toml", tmp_path / "out"
    path.write_text(OWN.replace("stiffer gel", "<b>stiffer</b> gel"))
    runner.run(load_study(str(path)), out, command="gelsim study own.toml")
    page = (out / "index.html").read_text()
    assert "&lt;b&gt;stiffer&lt;/b&gt;" in page and "gelsim study own.toml" in page and "hemisphere" in page
    assert re.findall(r'(?:src|href)="([^,"]*)', page) == ["data:image/png;base64"]
    assert "](study.png)" in (out / "study.md").read_text()
    assert (out / "study.png").stat().st_size < 150_000
    assert (out / "study.csv").read_text().splitlines()[0] == "gel.shore_00,object.radius_mm,status,message,letters,seconds,load"
    assert len((out / "study.csv").read_text().splitlines()) == 7


@pytest.mark.slow
def test_workers_give_the_rows_and_what_failed(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    # Without a force there is nothing to compare at: said by the metric, in the worker, before anything is solved.
    path.write_text(OWN.replace("letters", "slope_change") + '[scene.press]\nforce_n = "none"\n')
    told = runner.run(load_study(str(path)), tmp_path / "out", workers=2)
    assert len(told["failed"]) == told["cases"] == 6
    assert {item["message"] for item in told["failed"]} == {"press.force_n is none: what is asked for is at equal force"}


def test_a_ledger_drops_a_line_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "out" / "results.jsonl"
    ledger = Ledger(path)
    for key in "ab":
        ledger.add({"key": key, "n": 1})
    path.write_text(path.read_text() + '{"key": "c", "n"')
    again = Ledger(path, resume=True)
    assert list(again.rows) == ["a", "b"]
    again.add({"key": "c", "n": 2})
    assert list(Ledger(path, resume=True).rows) == ["a", "b", "c"]
    with pytest.raises(SceneError, match="--resume"):
        Ledger(path)
    assert Ledger(path, force=True).rows == {}
    path.write_text("no ledger\n")
    with pytest.raises(GelsimError, match="--force"):
        Ledger(path, resume=True)


def test_tables_have_the_columns_of_all_rows(tmp_path: Path) -> None:
    write_csv(tmp_path / "table.csv", [{"key": 1, "a": 2}, {"key": 2, "b": 3}], without=("key",))
    assert (tmp_path / "table.csv").read_text().splitlines() == ["a,b", "2,", ",3"]


def test_what_is_not_known_costs_sensitivity(rng: np.random.Generator) -> None:
    x, y, z = np.eye(3)
    seen = combine(3 * x + 4 * y + 12 * z, 2 * y, 10 * (y + z), -1.0)
    # By hand: |(3, 4, 12)| = 13; at equal force (3, 4 - 2, 12); without y (3, 0, 12). Only y is touched.
    assert np.allclose([seen.equal_depth, seen.equal_force], [13, np.sqrt(9 + 4 + 144)], rtol=1e-12)
    assert np.allclose([seen.unknown_press, seen.change], [np.sqrt(153), 2], rtol=1e-12)
    # A radius known to 0.1 changes z by 10 × 0.1 = 1, as much as its noise: of 12 there, 12/√2 are left.
    assert seen.unknown_radius == pytest.approx(np.sqrt(9 + 144 / 2), rel=1e-12)
    for _ in range(20):
        by_hardness, by_depth, by_radius = rng.standard_normal((3, 12, 9, 2))
        seen = combine(by_hardness, by_depth, by_radius, rng.standard_normal(), weight=4.0)
        assert seen.unknown_radius <= seen.unknown_press <= min(seen.equal_depth, seen.equal_force)


def test_slopes_integrate_to_their_height() -> None:
    spacing = 0.1e-3
    y, x = np.mgrid[-30:31, -40:41] * spacing
    height = 1e-3 * np.exp(-(x**2 + 1.5 * y**2) / (2 * 0.8e-3**2))
    down, along = np.gradient(height, spacing)
    # Central differences averaged once more smooth by (1 + cos k)/2: second order, h²/4 of the bell's curvatures 1/s² and 1.5/s² of it.
    bound = 1e-3 * (spacing / 0.8e-3) ** 2 / 4 * 2.5 * 1.5
    found = integrate(along, down, spacing)
    assert np.abs(found - height).max() < bound
    assert np.abs(integrate(along, -down, spacing) - height).max() > 10 * bound


def test_paths_of_a_study_are_taken_from_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").mkdir()
    sensor = '[gel]\nprofile = "flat"\n[[lights.lights]]\nname = "red"\nposition_mm = [14, 0, -6]\ndirection = [-14, 0, 6]\n'
    for name in ("pad.toml", "low.toml"):
        (tmp_path / "there" / name).write_text(sensor)
    head = 'question = "?"\nmetrics = ["force_n"]\n[fields]\n'
    (tmp_path / "there" / "one.toml").write_text(head + '"gel.shore_00" = [10]\n[scene.sensor]\npreset = "pad.toml"\n')
    (tmp_path / "there" / "two.toml").write_text(head + '"sensor.preset" = ["pad.toml", "../there/low.toml", "digit"]\n')
    monkeypatch.chdir(tmp_path)
    # No machine's folders in what a study writes: the paths stay relative where the study's was.
    assert load_study("there/one.toml").base["sensor"]["preset"] == "there/pad.toml"
    study = load_study("there/two.toml")
    assert study.axes["sensor.preset"] == ["there/pad.toml", "there/low.toml", "digit"]
    assert [build_scene(study.base, study.layer(point)).gel.profile for point in study.points()] == ["flat", "flat", "dome"]


def test_a_case_is_another_one_where_its_mesh_file_has_changed(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    scene = build_scene({"object": {"shape": "mesh", "mesh": str(path)}})
    path.write_text("one")
    first = report.fingerprint(scene, ("force_n",))
    assert report.fingerprint(scene, ("force_n",)) == first
    path.write_text("two")
    assert report.fingerprint(scene, ("force_n",)) != first
