"""The notebook of the docs runs, in small pictures, and shows what is kept in it."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest

from gelsim.results import Deformation, Frame


def test_the_notebook_runs_and_shows_what_it_keeps(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(repository / "docs")
    cells = json.loads(Path("notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    kept = [cell["outputs"][0]["data"] for cell in cells if cell["cell_type"] == "code"]
    source = json.dumps(cells)
    assert source.count("[240, 180]") == 1
    small = json.loads(source.replace("[240, 180]", "[40, 30]"))
    press, frame, figure, data = runpy.run_path("notebook.py")["run"](small)
    made = [cell["outputs"][0]["data"] for cell in small if cell["cell_type"] == "code"]
    assert [set(each) for each in made] == [set(each) for each in kept]
    assert isinstance(press, Deformation) and press.converged.all() and isinstance(frame, Frame) and frame.image.shape == (30, 40, 3)
    soft, rigid = (line.get_ydata() for line in figure.axes[0].lines)
    assert 0 < soft[-1] < rigid[-1]
    assert made[3] == kept[3] and f"{len(data)} presses" in kept[3]["text/html"]
