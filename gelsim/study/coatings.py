"""`coating`: how shiny should the coat be?"""

from __future__ import annotations

from collections.abc import Sequence

from gelsim.study.definition import Study
from gelsim.study.light_layout import ring
from gelsim.work.ledger import Row


def answer(rows: Sequence[Row], study: Study) -> str:
    """The matt coat against what shows texture best, and what has the best normals."""
    known = [row for row in rows if all(row.get(name) is not None for name in study.metrics)]
    if not known:
        return "No case gave a number."
    matt = min(known, key=lambda row: row["coating.specular"])
    sharp = max(known, key=lambda row: row["texture_signal_per_um"])
    steep = min(known, key=lambda row: row["steep_normal_error_deg"])

    text = (
        f"By a micrometre of texture a pixel of a matt coat changes by {_signal(matt)}, and normals at walls above 30° are off by "
        f"{_walls(matt)}"
    )
    if sharp is not matt:
        text += f"; texture is shown best by {_coat(sharp)}, {_signal(sharp)}, at {_walls(sharp)}"
    if steep not in (matt, sharp):
        text += f"; walls by {_coat(steep)}, {_walls(steep)}, at {_signal(steep)}"
    return text + "."


def _coat(row: Row) -> str:
    return f"{100 * row['coating.specular']:.0f} % flakes of roughness {row['coating.roughness']:g}"


def _signal(row: Row) -> str:
    return f"{row['texture_signal_per_um']:.2g} of the noise"


def _walls(row: Row) -> str:
    return f"{row['steep_normal_error_deg']:.2g}°"


STUDY = Study(
    name="coating",
    question="What does a shinier coat gain for fine texture, and what does it lose at steep walls?",
    axes={"coating.roughness": [0.15, 0.3, 0.5], "coating.specular": [0.0, 0.25, 0.5, 0.75, 1.0]},
    metrics=("texture_signal_per_um", "steep_normal_error_deg", "normal_error_deg", "height_error_um"),
    x="coating.specular",
    colour="coating.roughness",
    base={
        "gel": {"profile": "flat", "thickness_mm": 2.4},
        "camera": {"noise_sd": [2.0, 1.4, 2.5]},
        "lights": {"window_reflection": False, "lights": ring(3, "coloured", 30.0)},
        "coating": {"albedo": [0.5, 0.5, 0.5], "grain": 0.0},
        "markers": {"layout": "none"},
        "render": {"mode": "path", "resolution": [120, 90], "spp": 64},
    },
    answer=answer,
    method="Three coloured lights at 30° below the gel's plane; the exposure is set for each coat, the noise is 2.0, 1.4 and 2.5 of 255 in "
    "red, green and blue. Texture is a wave of 1 mm in x and y, 2 µm high. Normals are recovered as in light-layout: a cubic "
    "regression from colour change, calibrated on four pictures and judged on four others, over the touched pixels. Flakes are a GGX lobe "
    "of that width; light is followed with inter-reflection.",
    quick={"axes": {"coating.roughness": [0.15], "coating.specular": [0.0, 1.0]}},
)
