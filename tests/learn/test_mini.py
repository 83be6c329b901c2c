"""The small dataset that comes along teaches something in a minute."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gelsim import load_dataset
from learn import cli

MINI = Path(__file__).parents[2] / "assets" / "mini"


def test_the_small_dataset_is_whole() -> None:
    data = load_dataset(MINI)
    assert len(data) == 60
    used = [index for rows in data.splits.values() for index in rows]
    assert sorted(used) == sorted(row["index"] for row in data.rows)
    episode = data.read(0)
    assert episode.frames.shape[1:] == (120, 160, 3) and episode.frames.std() > 0


@pytest.mark.slow
def test_training_on_it_beats_the_mean(tmp_path: Path) -> None:
    assert cli.main(["train", "--preset", "mini", "--data", str(MINI), "--out", str(tmp_path / "run")]) == 0
    assert cli.main(["eval", "--model", str(tmp_path / "run" / "model.pt"), "--data", str(MINI), "--out", str(tmp_path / "eval")]) == 0
    rows = json.loads((tmp_path / "eval" / "report.json").read_text())["rows"]
    assert set(rows) == {"novel_hardness", "novel_shape"}
    # Found: 0.71 and 0.32 of the training mean's error on these 7 and 11 presses.
    assert all(row["rmse"] < row["baselines"]["training mean"]["rmse"] for row in rows.values())
