"""The small dataset that comes along teaches something in a minute."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from learn import cli

MINI = Path(__file__).parents[2] / "assets" / "mini"


@pytest.mark.slow
def test_training_on_it_beats_the_mean(tmp_path: Path) -> None:
    assert cli.main(["train", "--preset", "mini", "--data", str(MINI), "--out", str(tmp_path / "run")]) == 0
    assert cli.main(["eval", "--model", str(tmp_path / "run" / "model.pt"), "--data", str(MINI), "--out", str(tmp_path / "eval")]) == 0
    rows = json.loads((tmp_path / "eval" / "report.json").read_text())["rows"]
    assert set(rows) == {"novel_hardness", "novel_shape"}
    # Found: 0.56 and 0.26 of the training mean's error on these 7 and 11 presses.
    assert all(row["rmse"] < row["baselines"]["training mean"]["rmse"] for row in rows.values())
