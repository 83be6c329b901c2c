"""How results show themselves in a notebook."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gelsim.data.episodes import load_dataset
from gelsim.results import Deformation, Frame


def test_a_press_is_a_sentence_and_a_curve(deformation: Deformation) -> None:
    shown = ET.fromstring(deformation._repr_html_())
    text = " ".join(shown.itertext())
    assert "3 states, every state converged; state 2: 1 mm, 1 N, 20 mm²" in text and "against approach [mm] 0 to 1" in text
    (line,) = shown.iter("polyline")
    places = np.array([point.split(",") for point in line.attrib["points"].split()], float)
    assert places == pytest.approx(np.array([[4, 76], [120, 40], [236, 4]]))
    released = replace(deformation, approach=deformation.approach[[0, 2, 0]], force=deformation.force[[0, 2, 0]])
    text = " ".join(ET.fromstring(released._repr_html_()).itertext())
    assert "state 1: 1 mm, 1 N" in text and "against time [s] 0 to 0.2" in text


def test_a_frame_is_its_picture() -> None:
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    frame = Frame(image.astype(np.float32), image, np.zeros((4, 4), np.float32), np.zeros((0, 2)))
    assert (np.asarray(Image.open(io.BytesIO(frame._repr_png_()))) == image).all()


def test_a_dataset_is_a_table_of_what_was_pressed(repository: Path) -> None:
    data = load_dataset(repository / "assets" / "mini")
    shown = ET.fromstring(data._repr_html_())
    rows = [[cell.text for cell in line] for line in shown.iter("tr")]
    shapes = {row["shape"] for row in data.rows}
    assert {row[0] for row in rows[1:]} == shapes and sum(int(row[1] or 0) for row in rows[1:]) == len(data)
    hardness = [row["shore_00"] for row in data.rows if row["shape"] == rows[1][0]]
    assert rows[1][2] == f"{min(hardness):.3g} to {max(hardness):.3g}"
    assert f"{len(data)} presses" in (shown.text or "") and f"train {len(data.splits['train'])}" in (shown.text or "")
    data.folder, data.rows[0] = Path("a<b"), data.rows[0] | {"shape": "<i>", "shore_00": None, "peak_force_n": None}
    assert "unknown" in " ".join(ET.fromstring(data._repr_html_()).itertext())
