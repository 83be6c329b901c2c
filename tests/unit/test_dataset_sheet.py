"""What `gelsim inspect` says and draws of a dataset."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_dataset import make

from gelsim.cli import main as cli
from gelsim.data.episodes import load_dataset, survey, write_episode, write_meta
from gelsim.views.dataset_sheet import contact_sheet, dataset_facts, hardness_by_shape


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    labels = [
        {"shape": "flat", "shore_00": 8.0}, {"shape": "flat", "shore_00": 9.9}, {"shape": "flat", "shore_00": 10.0, "object": "x"},
        {"shape": "tomato", "shore_00": None, "group": 5}, {"shape": "edge", "shore_00": None, "rigid": True, "object": "x"},
    ]  # fmt: skip
    for index, fields in enumerate(labels):
        write_episode(tmp_path, make(index, **fields))
    failed = {"index": 9, "seed": 0, "status": "TIMEOUT", "message": "slow"}
    write_meta(tmp_path, {"domain": "sim", "resolution": [16, 12]}, survey(tmp_path), [failed], {"train": [0, 1], "natural": [3]})
    return tmp_path


def test_counts(folder: Path):
    data = load_dataset(folder)
    shapes, classes, table = hardness_by_shape(data)
    assert (shapes, classes) == (["edge", "flat", "tomato"], ["0-10", "10-20", "rigid", "unknown"])
    np.testing.assert_array_equal(table, [[0, 0, 1, 0], [2, 1, 0, 0], [0, 0, 0, 1]])
    facts = dataset_facts(data)
    assert facts["episodes"] == 5 and facts["frames"] == 15 and facts["objects"] == 4
    assert facts["groups"] == {"1": 4, "5": 1} and facts["failures"] == {"TIMEOUT": 1} and facts["splits"] == {"train": 2, "natural": 1}


def test_contact_sheet_shows_last_frames(folder: Path):
    data = load_dataset(folder)
    sheet = contact_sheet(data, 1, across=2, down=2, width=16)
    # Group 1 has four episodes of three objects: at their own size the pictures are the frames themselves, row by row.
    assert sheet.shape == (24, 32, 3)
    np.testing.assert_array_equal(sheet[:12, :16], data.read(0).frames[-1])
    np.testing.assert_array_equal(sheet[12:, 16:], data.read(4).frames[-1])


def test_inspect_draws_a_sheet(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "sheet.png"
    assert cli.main(["inspect", str(folder), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "dataset"
    assert np.array(Image.open(out).convert("L")).std() > 10
