"""The benchmark: its scenes are scenes, a run that was stopped goes on, errors are what they say."""

from __future__ import annotations

from pathlib import Path

import pytest

from gelsim import bench
from gelsim.errors import SceneError
from gelsim.scene_file import build_scene


def test_every_case_is_a_scene() -> None:
    cases = bench.cases(bench.SECTIONS, quick=False)
    assert len({case.key for case in cases}) == len(cases)
    for case in cases:
        build_scene(case.scene)


def test_references_have_the_rows_that_are_asked_for() -> None:
    for case in bench.cases(("accuracy", "speed"), quick=False):
        assert case.reference is not None
        name, wanted = case.reference
        rows = [row for row in bench._table(name) if all(row[key] == value for key, value in wanted.items())]
        assert len(rows) >= 9, case.name


def test_resume_measures_only_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[str] = []

    def measure(case: bench.Case) -> dict[str, object]:
        if len(measured) == 1 and case.key not in measured and not measured[0].startswith("resumed"):
            raise KeyboardInterrupt
        measured.append(case.key)
        return {"key": case.key, "section": case.section, "name": case.name, "fidelity": "fast", "status": "CONVERGED"}

    monkeypatch.setattr(bench, "measure", measure)
    with pytest.raises(KeyboardInterrupt):
        bench.run(tmp_path, sections=("speed",))
    with pytest.raises(SceneError, match="--resume"):
        bench.run(tmp_path, sections=("speed",))
    first = measured.copy()
    measured.insert(0, "resumed")
    result = bench.run(tmp_path, sections=("speed",), resume=True)
    assert result["cases"] == len(bench.cases(("speed",), quick=False))
    assert measured.count(first[0]) == 1, "the case that was done is not measured again"
    assert (tmp_path / "speed.csv").read_text().count("\n") == result["cases"] + 1
