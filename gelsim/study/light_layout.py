"""`light-layout`: how many lights, of which colours, how low, for the best normals?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gelsim.scene.layers import Layer
from gelsim.study.definition import Point, Study
from gelsim.work.ledger import Row

RED, GREEN, BLUE, WHITE = (1.0, 0.05, 0.03), (0.05, 1.0, 0.08), (0.03, 0.08, 1.0), (1.0, 1.0, 1.0)
"""As the camera sees them: a tenth or less of each spills into the others."""
COLOURS = {"coloured": {1: (RED,), 2: (RED, GREEN), 3: (RED, GREEN, BLUE), 4: (RED, GREEN, WHITE, BLUE)}}
DISTANCE_MM = 25.0


def ring(count: int, colours: str, elevation_deg: float) -> list[dict[str, Any]]:
    """Lights around the gel at equal angles, all looking at its middle, as lights.lights of a scene.

    Args:
        colours: "coloured": of different colours as far as there are three; "white".
        elevation_deg: Of the lights below the gel's plane, seen from its middle.
    """
    named = COLOURS["coloured"][count] if colours == "coloured" else (WHITE,) * count
    up = np.radians(elevation_deg)
    lights = []
    for number, rgb in enumerate(named):
        around = 2 * np.pi * number / count
        place = DISTANCE_MM * np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), -np.sin(up)])
        lights.append(
            {
                "name": f"light {number + 1}",
                "position_mm": place.round(6).tolist(),
                "direction": (-place).round(6).tolist(),
                "size_mm": [8.0, 2.0],
                "rgb": list(rgb),
                "power": 100.0,
            }
        )
    return lights


def layer(point: Point) -> Layer:
    return {"lights": {"lights": ring(point["lights"], point["colours"], point["elevation_deg"])}}


def answer(rows: Sequence[Row], study: Study) -> str:
    """The best layout, and what fewer lights or colours cost."""
    metric = study.metrics[0]
    known = sorted((row for row in rows if row.get(metric) is not None), key=lambda row: row[metric])
    if not known:
        return "No case gave a number."

    def said(row: Row) -> str:
        return (
            f"{row['lights']} {row['colours']} light{'s' if row['lights'] > 1 else ''} at {row['elevation_deg']:g}° "
            f"({row['normal_error_deg']:.2g}° of normal, {row['height_error_um']:.2g} µm of height)"
        )

    best = known[0]
    others = [next((row for row in known if test(row)), None) for test in (lambda r: r["colours"] == "white", lambda r: r["lights"] == 1)]
    text = f"Best is {said(best)}"
    if others[0] is not None and others[0] is not best:
        text += f"; the best without colours is {said(others[0])}"
    return text + "."


STUDY = Study(
    name="light-layout",
    question="How many lights, of which colours and how low, give the best normals and heights by photometric stereo?",
    axes={"colours": ["coloured", "white"], "lights": [2, 3, 4], "elevation_deg": [10.0, 30.0, 50.0]},
    metrics=("normal_error_deg", "height_error_um"),
    x="elevation_deg",
    colour="lights",
    base={
        "gel": {"profile": "flat", "thickness_mm": 2.4},
        "camera": {"noise_sd": [2.0, 1.4, 2.5]},
        "lights": {"window_reflection": False},
        "coating": {"albedo": [0.5, 0.5, 0.5], "specular": 0.0, "grain": 0.0},
        "markers": {"layout": "none"},
        "render": {"mode": "direct", "resolution": [120, 90], "spp": 36},
    },
    layer=layer,
    answer=answer,
    method="Each sensor is calibrated on four pictures of known bumpy surfaces and judged on four of pressed bodies: "
    "a cubic regression from colour change and place to the normal, and Poisson's equation for the height. Light comes straight from the "
    "lights onto a matt coat, without inter-reflection; the noise is that of a GelSight Mini's camera, 2.0, 1.4 and 2.5 of 255 in red, "
    "green and blue; the exposure is set for each layout. Errors are over the touched pixels.",
    quick={"axes": {"colours": ["coloured", "white"], "lights": [3], "elevation_deg": [30.0]}},
)
