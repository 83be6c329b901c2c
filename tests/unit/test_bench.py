"""The benchmark: its scenes are scenes, a run that was stopped goes on, errors are what they say, a page keeps its words."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gelsim.bench import SECTIONS, accuracy, blocks, bounded, closed_forms, optics, random_scenes, runner, stability, target
from gelsim.bench.section import Case, Known, Options, Section
from gelsim.cli.main import main
from gelsim.errors import PressEnd, SceneError
from gelsim.scene.layers import build_scene
from gelsim.work.workers import Handful, LocalCrew, work_through


@pytest.mark.parametrize("name", SECTIONS)
@pytest.mark.parametrize("quick", [True, False])
def test_every_case_has_a_name_of_its_own_and_a_scene_that_is_one(name: str, quick: bool) -> None:
    cases = list(runner.load(name).cases(Options(quick=quick, data=None)))
    assert len({case.name for case in cases}) == len(cases)
    for case in cases:
        if case.scene is not None:
            build_scene(case.scene)


def test_taxim_is_measured_where_it_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {case.name for case in optics.SECTION.cases(Options(quick=True, data=None))}
    # Without the package there are no such rows; with it (JAX is what it runs on) a picture from a height map in mm, 0 at the apex.
    (tmp_path / "jax.py").write_text("")
    (tmp_path / "taxim.py").write_text(
        "asked = []\n"
        "class Taxim:\n"
        "    width, height = 640, 480\n"
        "    def __init__(self, backend): assert backend == 'jax'\n"
        "    def render(self, height, with_shadow, press_depth): asked.append((height, with_shadow, press_depth)); return height\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(optics, "seconds_a_call", lambda work: (work(), 0.25)[1])
    both = {
        case.name: case
        for case in optics.SECTION.cases(Options(quick=True, data=None))
        if case.name not in names - {"Taxim", "Taxim, shadows"}
    }
    assert list(both) == ["Taxim", "Taxim, shadows"]
    try:
        rows = [case.measure() for case in both.values()]
        asked = sys.modules["taxim"].asked
    finally:
        sys.modules.pop("taxim", None)
    assert [row["ms"] for row in rows] == [250.0, 250.0] and [shadow for _, shadow, _ in asked] == [False, True]
    height = asked[0][0]
    # The apex in the middle; 1 mm up a ball of 4 mm is √(16 - 9) mm wide to each side.
    assert height.shape == (480, 640) and height[240, 320] == 0.0 == height.min()
    assert (height[240] < 1.0).sum() * 0.0295 / 2 == pytest.approx(7**0.5, abs=0.0295)
    judged = optics.SECTION.judge([row | {"name": name} for row, name in zip(rows, both, strict=True)])
    assert [row["ms"] for row in judged] == [250.0, 250.0]


def test_a_quick_run_leaves_out_what_takes_long() -> None:
    whole, quick = ({case.name for case in stability.SECTION.cases(Options(quick=quick, data=None))} for quick in (False, True))
    assert whole - quick == set(stability.LONG) and quick < whole


@pytest.mark.parametrize("name", ["ball_force.csv", "hemisphere_force.csv"])
def test_references_have_the_rows_that_are_asked_for(name: str) -> None:
    rows = accuracy.reference_table(name)
    for nu in (0.49, 0.499):
        for modulus in (50.0, 200.0) if "hemisphere" in name else (None,):
            found = [row for row in rows if row["nu"] == nu and row.get("object_modulus_kPa") == modulus]
            assert len(found) >= 9 and all("approach_mm" in row for row in found)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Replaces the sections by one, `letters`, of cases a, b, c; their names as they are measured."""
    done: list[str] = []

    def case(letter: str) -> Case:
        def measure() -> dict[str, object]:
            if letter == "b" and not done.count("stopped"):
                done.append("stopped")
                raise KeyboardInterrupt
            done.append(letter)
            return {"status": "CONVERGED", "number": ord(letter)}

        return Case(letter, measure)

    section = Section(
        title="Letters",
        columns=(("case", "name"), ("number", "number"), ("first", "first")),
        cases=lambda options: [case(letter) for letter in "abc"],
        judge=lambda rows: [row | {"first": row["number"] == rows[0]["number"]} for row in rows],
        remarks=lambda rows: f"{len(rows)} letters.",
    )
    monkeypatch.setattr(runner, "SECTIONS", {"letters": "nowhere"})
    monkeypatch.setattr(runner, "load", lambda name: section)
    return done


def test_resume_measures_only_what_is_missing(tmp_path: Path, measured: list[str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        runner.run(tmp_path)
    with pytest.raises(SceneError, match="--resume"):
        runner.run(tmp_path)
    result = runner.run(tmp_path, resume=True, limit=1)
    assert (result["cases"], result["missing"]) == (2, 1)
    assert "2 of 3 cases so far" in (tmp_path / "bench.md").read_text()
    result = runner.run(tmp_path, resume=True)
    assert (result["cases"], result["missing"]) == (3, 0)
    assert measured == ["a", "stopped", "b", "c"]
    assert (tmp_path / "letters.csv").read_text().count("\n") == 4


def test_a_row_says_what_made_it_and_one_that_is_kept_still_does(tmp_path: Path, measured: list[str]) -> None:
    measured.append("stopped")
    runner.run(tmp_path, limit=1)
    path = tmp_path / runner.RESULTS
    first = _rows(tmp_path)[0]
    made_by = first["made_by"]
    assert isinstance(made_by, dict)
    assert made_by["python"] == platform.python_version() and made_by["processor"]
    assert made_by["numpy"] == np.__version__ and made_by["warp-lang"] and made_by["mitsuba"]
    # As of another machine; and a row of a run before rows said it.
    old = {key: value for key, value in first.items() if key != "made_by"} | {"key": "letters/b", "name": "b"}
    kept = [first | {"made_by": made_by | {"processor": "another"}}, old]
    path.write_text("".join(json.dumps(row) + "\n" for row in kept))
    assert runner.run(tmp_path, resume=True)["missing"] == 0
    rows = _rows(tmp_path)
    assert rows[:2] == kept and rows[2]["made_by"] == made_by
    assert "made_by" not in (tmp_path / "letters.csv").read_text()


def test_a_page_keeps_its_words_and_gets_its_table(tmp_path: Path, measured: list[str]) -> None:
    measured.append("stopped")
    page = tmp_path / "page.md"
    page.write_text("Before.\n<!-- bench letters -->\n<!-- /bench -->\nAfter.\n<!-- bench others -->\nold\n<!-- /bench -->\n")
    for _ in range(2):  # without --only: the sections that the page has places for
        assert main(["bench", "--out", str(tmp_path / "out"), "--resume", "--page", str(page)]) == 0
        text = page.read_text()
        assert text.startswith("Before.\n<!-- bench letters -->\n\n`gelsim bench --only letters`")
        assert "| a | 97 | True |\n| b | 98 | False |\n| c | 99 | False |\n\n3 letters.\n\n<!-- /bench -->\nAfter." in text
        assert text.endswith("<!-- bench others -->\nold\n<!-- /bench -->\n")
    page.write_text("Nothing.")
    with pytest.raises(SceneError, match="no place for section 'letters'"):
        runner.run(tmp_path / "out", resume=True, page=page)


def test_measured_sections_without_their_data_say_what_they_need(tmp_path: Path) -> None:
    out = runner.run(tmp_path, Options(("measured-ball", "measured-silicones"), data=None))
    assert out["cases"] == 0
    assert (tmp_path / "bench.md").read_text().count("Skipped: --data DIR or $GELSIM_DATA") == 2


def test_random_scenes_depend_on_their_number_alone() -> None:
    first = [random_scenes.draw(index) for index in range(20)]
    assert [random_scenes.draw(index) for index in reversed(range(20))] == first[::-1]
    assert len({str(scene) for scene in first}) == 20


def test_a_random_scene_that_lost_its_equilibrium_before_its_force_has_not_converged() -> None:
    """Its status says so of the states that it has; one that is squashed as far as presses to a force go, or
    gives way, is no failure, and is counted."""
    numbers: dict[str, object] = dict.fromkeys(("steps_halved", "penetration_um", "min_jacobian", "drift_percent", "seconds"), 0.0)
    rows: list[dict[str, object]] = [
        {"name": end.name, "shape": "edge", "status": "CONVERGED", "ended_by": end, "states": 6, "message": ""} | numbers
        for end in PressEnd
        if end is not PressEnd.PATH  # there are none among them
    ]
    rows.append({"name": "none", "shape": "edge", "status": "MAX_ITERATIONS", "states": 1, "message": "stopped", "ended_by": PressEnd.LOST})
    rows.append({"name": "no scene", "shape": "edge", "status": "SceneError", "message": "refused"})
    section = random_scenes.SECTION
    assert [row["name"] for row in section.listed(rows)] == ["SLOW", "LOST", "none", "no scene"]
    said = section.remarks(rows)
    assert "5 of 9 converge" in said and "To a force that they do not carry: LIMIT, GAVE_WAY, BEYOND." in said
    assert "Without these: 22.22 %." in said


def _misbehaves(how: str) -> dict[str, object]:
    if how == "hangs":
        time.sleep(60)
    elif how == "grows":
        bytearray(4 * bounded.GIGABYTE)
    elif how == "dies":
        os._exit(7)
    return {"status": "CONVERGED", "process": os.getpid()}


@pytest.mark.skipif(sys.platform != "linux", reason="the bound of memory is Linux's")
def test_a_bounded_case_cannot_take_the_others_with_it() -> None:
    call = bounded.Bounded(_misbehaves, seconds=5.0, memory=2 * bounded.GIGABYTE)
    try:
        found = [call(how) for how in ("", "grows", "", "dies", "hangs", "")]
    finally:
        call.close()
    assert [row["status"] for row in found] == ["CONVERGED", "MEMORY", "CONVERGED", "DIED", "TIMEOUT", "CONVERGED"]
    assert found[0]["process"] == found[2]["process"] != found[5]["process"]
    assert "code 7" in found[3]["message"] and "5 s" in found[4]["message"]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_bounded_case_ends_with_its_parent(tmp_path: Path) -> None:
    """Killed while its child is at a case of minutes: without a word to the child, which goes on until the case is done."""
    (tmp_path / "sleeper.py").write_text(
        "import os, sys, time\nfrom pathlib import Path\nfrom gelsim.bench.bounded import Bounded\n"
        "def sleep():\n    Path(sys.argv[-1]).write_text(str(os.getpid()))\n    time.sleep(120)\n    return {}\n"
        "if __name__ == '__main__':\n    Bounded(sleep, 100.0, 8 << 30)()\n"
    )
    told = tmp_path / "pid"
    parent = subprocess.Popen([sys.executable, str(tmp_path / "sleeper.py"), str(told)])
    try:
        child = int(_soon(lambda: told.exists() and told.read_text(), 60.0))
        assert Path(f"/proc/{child}").exists()
    finally:
        parent.kill()
        parent.wait()
    assert _soon(lambda: not Path(f"/proc/{child}").exists(), 10.0)


def _soon(what: Callable[[], object], seconds: float) -> Any:
    """What is true within a time, or the last answer."""
    end = time.monotonic() + seconds
    while not (answer := what()) and time.monotonic() < end:
        time.sleep(0.1)
    return answer


def test_verdicts_name_what_is_wrong_and_how_far_pairs_are_apart() -> None:
    good = {"status": "CONVERGED", "min_jacobian": 0.5, "penetration_um": 4.0, "drift_percent": 0.2, "states": 6, "states_wanted": 6}
    good |= {"ended_by": PressEnd.DEPTH, "approach_mm": 9.5}
    rows = [
        good | {"name": "mirrored: offset and tilt +", "force_n": [0.1, 0.0, -1.0]},
        good | {"name": "mirrored: offset and tilt -", "force_n": [-0.1, 0.0, -1.001]},
        good | {"name": "50 load steps", "force_n": [0.0, 0.0, -1.0]},
        good | {"name": "one load step", "force_n": [0.0, 0.0, -1.1]},
        good | {"name": "deep", "force_n": [0.0, 0.0, -1.0], "penetration_um": 80.0, "drift_percent": -9.0},
        {"name": "failed", "status": "MAX_ITERATIONS", "message": "at 0.3 mm"},
        good | {"name": "to a force", "force_n": [0.0, 0.0, -1.0], "ended_by": PressEnd.LIMIT},
    ]
    verdicts = [row["verdict"] for row in stability._judged(rows)]
    assert verdicts[0] == "well" and "0.1 % from" in verdicts[1] and verdicts[2] == "well"
    assert verdicts[3].startswith("NOT WELL: 10 % from")
    assert "overlap 80" in verdicts[4] and "drift -9 %" in verdicts[4] and verdicts[5] == "NOT WELL: at 0.3 mm"
    assert verdicts[6] == "NOT WELL: ended at 9.5 mm"


@pytest.mark.parametrize(
    ("field", "value", "verdict"),
    [
        ("force_error_percent", 2.1, "NOT MET"),
        ("radius_finer_percent", 3.1, "NOT MET"),
        ("profile_rms_um", 5.1, "NOT MET"),
        ("seconds", 9, "met"),
    ],
)
def test_accuracy_is_held_against_its_bounds(field: str, value: float, verdict: str) -> None:
    row = {"fidelity": "balanced", "force_error_percent": 1.0, "radius_finer_percent": 2.9, "profile_rms_um": 4.0, "seconds": 1.0}
    said = accuracy.SECTION.remarks([row, row | {field: value}])
    assert said.endswith(f": {verdict}.") and "`reference`" not in said
    assert accuracy.SECTION.remarks([row, {"fidelity": "balanced"}]).endswith("NOT MET.")
    assert "off the table's own 8.1 %)" in accuracy.SECTION.remarks([row | {"radius_error_percent": 8.1}])


def test_a_target_is_judged_by_the_true_error_and_the_cheapest_that_meets_it() -> None:
    def row(asked: str, told: float, true: float, seconds: float) -> dict[str, Any]:
        return {"object": "ball", "asked": asked, "estimate_percent": told, "judged_percent": true, "seconds": seconds}

    solved = [row("fast", 3.0, 1.5, 1.0), row("balanced", 1.5, 0.8, 4.0), row("reference", 0.6, 0.3, 16.0)]
    asked = [row("2%", 1.5, 0.8, 4.0), row("1%", 0.6, 1.2, 20.0), row("0.5%", 0.6, 0.3, 20.0), row("0.2%", 0.6, 0.3, 20.0)]
    failed = {"object": "ball", "asked": "5%", "status": "FAILED"}
    judged = target.SECTION.judge([*solved, *asked, failed])
    assert judged[:3] == solved and judged[-1] == failed
    verdicts = [(one["says"], one["true"], one["cheapest"], one["cheapest_seconds"]) for one in judged[3:7]]
    assert verdicts == [
        ("met", "met", "fast", 1.0),
        ("met", "not met", "balanced", 4.0),
        ("not met", "met", "reference", 16.0),
        ("not met", "not met", None, None),
    ]
    assert "1 of 4 targets said to be met are not met in truth; 1 are met and said not to be" in target.SECTION.remarks(judged)
    assert len(target.SECTION.listed(judged)) == 5


def test_closed_forms_are_judged_by_their_bounds_and_the_control_the_other_way() -> None:
    known = Known("number", lambda: (1.01, 1.0, 1.0), 0.02, "somewhere")
    assert closed_forms.measured(known)["verdict"] == "met"
    assert closed_forms.measured(replace(known, bound=0.005))["verdict"] == "NOT MET"
    assert closed_forms.measured(replace(known, control=True))["verdict"] == "FAULT NOT SEEN"


@pytest.mark.parametrize("known", [known for known in blocks.known() if "32 cells" not in known.name], ids=lambda known: known.name)
def test_blocks_meet_their_bounds(known: Known) -> None:
    assert closed_forms.measured(known)["verdict"] in ("met", "seen, as it must be")


def test_the_page_has_a_place_for_every_section(repository: Path) -> None:
    from gelsim.bench import report

    pages = [report.places(repository / "docs" / name) for name in ("validation.md", "tables.markdown")]
    assert sorted(sum(pages, [])) == sorted(SECTIONS)


def test_a_status_is_written_small_and_a_unit_as_it_is() -> None:
    from gelsim.bench import report

    rows = [{"ended": "MAX_ITERATIONS", "found": "1.2372 N", "symbol": "μ|", "none": None}]
    columns = (("a", "ended"), ("b", "found"), ("c", "symbol"), ("d", "none"))
    assert report.table(columns, rows)[-1] == "| max_iterations | 1.2372 N | μ\\| | – |"


def test_workers_share_the_cases(tmp_path: Path) -> None:
    """Two processes give the rows that one gives, and a run that was stopped goes on."""
    asked = Options(("closed-forms",), quick=True, data=None)
    runner.run(tmp_path / "one", asked, limit=2)
    first = runner.run(tmp_path / "two", asked, limit=2, workers=2)
    again = runner.run(tmp_path / "two", asked, limit=0, workers=2, resume=True)
    assert first["missing"] == again["missing"] == again["cases"] + first["missing"] - 2
    kept, shared = (
        [{key: value for key, value in row.items() if key not in ("load", "seconds", "workers")} for row in _rows(tmp_path / folder)]
        for folder in ("one", "two")
    )
    assert len(kept) == 2 and sorted(shared, key=str) == sorted(kept, key=str)
    with pytest.raises(SceneError, match="--workers 0"):
        runner.run(tmp_path / "three", asked, workers=0)


def _rows(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / runner.RESULTS).read_text().splitlines()]


def test_a_worker_bounds_what_it_measures() -> None:
    """A worker may have no children of its own: the random scenes are measured in it, and a failure is a row."""
    found = list(work_through([(0,), (-1,)], LocalCrew(1), _make_drawer, (), lambda handful, status, message: {"status": status}))
    assert [row["status"] for row in found] == ["CONVERGED", "ValueError"]


def _make_drawer() -> Callable[[Handful], dict[str, object]]:
    case = bounded.Bounded(_number, 10.0, 8 * bounded.GIGABYTE)
    return lambda handful: case(handful[0])


def _number(number: int) -> dict[str, object]:
    if number < 0:
        raise ValueError("less than nothing")
    return {"status": "CONVERGED"}
