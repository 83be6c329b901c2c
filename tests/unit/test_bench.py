"""The benchmark: its scenes are scenes, a run that was stopped goes on, errors are what they say, a page keeps its words."""

from __future__ import annotations

from pathlib import Path

import pytest

from gelsim.bench import SECTIONS, accuracy, runner
from gelsim.bench.section import Case, Options, Section
from gelsim.errors import SceneError
from gelsim.scene_file import build_scene


@pytest.mark.parametrize("name", SECTIONS)
@pytest.mark.parametrize("quick", [True, False])
def test_every_case_has_a_name_of_its_own_and_a_scene_that_is_one(name: str, quick: bool) -> None:
    cases = list(runner.load(name).cases(Options(quick=quick, data=None)))
    assert len({case.name for case in cases}) == len(cases)
    for case in cases:
        if case.scene is not None:
            build_scene(case.scene)


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


def test_a_page_keeps_its_words_and_gets_its_table(tmp_path: Path, measured: list[str]) -> None:
    measured.append("stopped")
    page = tmp_path / "page.md"
    page.write_text("Before.\n<!-- bench letters -->\n<!-- /bench -->\nAfter.\n<!-- bench others -->\nold\n<!-- /bench -->\n")
    for _ in range(2):
        runner.run(tmp_path / "out", resume=True, page=page)
        text = page.read_text()
        assert text.startswith("Before.\n<!-- bench letters -->\n\n`gelsim bench --only letters`")
        assert "| a | 97 | True |\n| b | 98 | False |\n| c | 99 | False |\n\n3 letters.\n\n<!-- /bench -->\nAfter." in text
        assert text.endswith("<!-- bench others -->\nold\n<!-- /bench -->\n")
    page.write_text("Nothing.")
    with pytest.raises(SceneError, match="no place for section 'letters'"):
        runner.run(tmp_path / "out", resume=True, page=page)


def test_the_page_has_a_place_for_every_section(repository: Path) -> None:
    from gelsim.bench import report

    report.check_page(repository / "docs" / "validation.md", SECTIONS)
