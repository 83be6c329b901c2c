"""`camera`: how many pixels, how little noise, how sharp?"""

from __future__ import annotations

from collections.abc import Sequence

from gelsim.scene.layers import Layer
from gelsim.study.definition import Point, Study
from gelsim.study.light_layout import ring
from gelsim.work.ledger import Row

NOISE = (2.0, 1.4, 2.5)
"""Of a GelSight Mini, in red, green and blue."""


def layer(point: Point) -> Layer:
    columns = point["columns"]
    resolution = [columns, columns * 3 // 4]
    return {"camera": {"resolution": resolution, "noise_sd": [point["noise"] * sd for sd in NOISE]}}


def answer(rows: Sequence[Row], study: Study) -> str:
    """From the coarsest to the finest picture, at the noise nearest to the real one, and what focus does."""
    known = [row for row in rows if all(row.get(name) is not None for name in study.metrics)]
    if not known:
        return "No case gave a number."
    noise = min({row["noise"] for row in known}, key=lambda factor: abs(factor - 1))
    mine = sorted((row for row in known if row["noise"] == noise), key=lambda row: row["columns"])
    few, many = mine[0], mine[-1]
    larger = [100 * (row["smallest_dent_deep_um"] / row["smallest_dent_um"] - 1) for row in (few, many)]
    return (
        f"From {few['columns']} to {many['columns']} columns the smallest visible dent falls from {few['smallest_dent_um']:.2g} to "
        f"{many['smallest_dent_um']:.2g} µm, in proportion to the noise; 1.5 mm out of focus it is "
        f"{larger[0]:.2g} to {larger[1]:.2g} % larger."
    )


STUDY = Study(
    name="camera",
    question="How small a dent is visible with more pixels, less noise, or out of focus?",
    axes={"noise": [0.5, 1.0, 2.0, 4.0], "columns": [60, 120, 240, 480, 960]},
    metrics=("smallest_dent_um", "smallest_dent_deep_um"),
    x="columns",
    colour="noise",
    base={
        "gel": {"profile": "flat", "thickness_mm": 2.4},
        "lights": {"window_reflection": False, "lights": ring(3, "coloured", 30.0)},
        "coating": {"albedo": [0.5, 0.5, 0.5], "specular": 0.0, "grain": 0.0},
        "markers": {"layout": "none"},
        "render": {"mode": "direct", "spp": 64},
    },
    layer=layer,
    answer=answer,
    method="Noise is in units of a GelSight Mini's, 2.0, 1.4 and 2.5 of 255 a pixel, whatever the pixel's size. The dent is a bell 0.35 mm "
    "across at half its depth; it is visible where an ideal observer who knows its place reaches d' = 3, with all pixels together. Out of "
    "focus is 1.5 mm from the focused plane with an aperture of 2 mm at 40 mm (thin lens); the blur is in this number alone, as gelsim's "
    "pictures are those of a pinhole. Three coloured lights at 30° on a matt coat.",
    quick={"axes": {"noise": [1.0, 2.0], "columns": [60, 120]}},
)
