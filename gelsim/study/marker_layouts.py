"""`markers`: how dense and how large should markers be?"""

from __future__ import annotations

from collections.abc import Sequence

from gelsim.study.definition import Study
from gelsim.work.ledger import Row


def answer(rows: Sequence[Row], study: Study) -> str:
    """The finest and the coarsest pitch of the middle radius in a regular grid, and the smallest against the largest radius."""
    known = [row for row in rows if all(row.get(name) is not None for name in study.metrics)]
    grid = [row for row in known if row["markers.jitter_mm"] == min(r["markers.jitter_mm"] for r in known)]
    radii = sorted({row["markers.radius_mm"] for row in grid})
    if not radii:
        return "No case gave a number."
    radius = radii[len(radii) // 2]
    mine = sorted((row for row in grid if row["markers.radius_mm"] == radius), key=_pitch)

    def said(row: Row) -> str:
        return (
            f"at a pitch of {row['markers.pitch_mm']:g} mm the normal force is off by {row['marker_normal_error_pct']:.2g} % and the shear "
            f"force by {row['marker_shear_error_pct']:.2g} %, and {row['marker_hidden_pct']:.2g} % of the surface is hidden"
        )

    text = f"With markers of {radius:g} mm radius, " + "; ".join(said(row) for row in (mine[0], mine[-1])[: len(mine)]) + "."
    small, large = (
        next(row for row in grid if row["markers.radius_mm"] == r and _pitch(row) == _pitch(mine[0])) for r in (radii[0], radii[-1])
    )
    if small is not large:
        text += (
            f" At {_pitch(small):g} mm, markers of {radii[0]:g} instead of {radii[-1]:g} mm hide "
            f"{small['marker_hidden_pct']:.2g} instead of "
            f"{large['marker_hidden_pct']:.2g} %, and the normal force is off by "
            f"{small['marker_normal_error_pct']:.3g} instead of "
            f"{large['marker_normal_error_pct']:.3g} %."
        )
    return text


def _pitch(row: Row) -> float:
    return row["markers.pitch_mm"]


STUDY = Study(
    name="markers",
    question="How dense and how large should markers be, for force from their motion, and what do they cost the height map?",
    axes={
        "markers.radius_mm": [0.1, 0.2, 0.3],
        "markers.jitter_mm": [0.0, 0.15],
        "markers.pitch_mm": [0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 3.0],
    },
    metrics=("marker_normal_error_pct", "marker_shear_error_pct", "marker_hidden_pct", "marker_fill_error_um"),
    x="markers.pitch_mm",
    colour="markers.radius_mm",
    base={
        "gel": {"profile": "flat", "shore_00": 17.0},
        "object": {"shape": "hemisphere", "rigid": True, "height_mm": 20.0},
        "contact": {"friction_coefficient": 0.8},
        "press": {"depth_mm": 0.8, "force_n": "none", "frames": 5},
        "fidelity": "fast",
    },
    answer=answer,
    method="The force is a linear combination of sums of marker motion in three rings about the contact's middle, fitted to presses of "
    "rigid balls of 3 and 5 mm and judged on one of 4 mm, all pressed 0.8 mm deep and sheared meanwhile, at 48 places of the layout. "
    "Markers are carried along by the gel, and their centres measured with a noise of 0.05 pixels at a radius of 0.2 mm, which falls as "
    "the root of the radius; light is not drawn. Errors are shares of the force, RMS over a press. The height map is taken as perfect "
    "but below markers, where it is filled in harmonically from their rims; its error is over the touched surface.",
    quick={"axes": {"markers.radius_mm": [0.2], "markers.jitter_mm": [0.0], "markers.pitch_mm": [0.8, 3.0]}},
)
