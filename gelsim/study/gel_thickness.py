"""`gel-thickness`: what does a thicker gel give, and what does it cost?"""

from __future__ import annotations

from collections.abc import Sequence

from gelsim.study.definition import Study
from gelsim.work.ledger import Row


def answer(rows: Sequence[Row], study: Study) -> str:
    """Thinnest against thickest, for the smallest ball."""
    known = [row for row in rows if all(row.get(name) is not None for name in study.metrics)]
    radius = min((row["object.radius_mm"] for row in known), default=None)
    mine = sorted((row for row in known if row["object.radius_mm"] == radius), key=lambda row: row["gel.thickness_mm"])
    if len(mine) < 2:
        return "Fewer than two thicknesses gave numbers."
    thin, thick = mine[0], mine[-1]
    return (
        f"A ball of {radius:g} mm, pressed to {study.base['press']['depth_mm']:g} mm: from {thin['gel.thickness_mm']:g} to "
        f"{thick['gel.thickness_mm']:g} mm of gel the force falls from {thin['force_n']:.2g} to {thick['force_n']:.2g} N, the dent reaches "
        f"{thick['dent_reach_mm']:.2g} instead of {thin['dent_reach_mm']:.2g} mm beyond the contact (fine detail is lost), and markers "
        f"move {thick['marker_motion_um']:.0f} instead of {thin['marker_motion_um']:.0f} µm."
    )


STUDY = Study(
    name="gel-thickness",
    question="What does a thicker gel change in force and marker motion, and what does it cost in resolution?",
    axes={"gel.thickness_mm": [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0], "object.radius_mm": [2.0, 4.0, 8.0]},
    metrics=("force_n", "dent_reach_mm", "marker_motion_um", "contact_area_mm2"),
    x="gel.thickness_mm",
    colour="object.radius_mm",
    base={
        "gel": {"profile": "flat", "shore_00": 17.0},
        "object": {"shape": "hemisphere", "rigid": True, "height_mm": 20.0},
        "press": {"depth_mm": 0.5, "force_n": "none", "frames": 4, "symmetry": "axisymmetric"},
        "fidelity": "fast",
    },
    answer=answer,
    method="A rigid ball is pressed 0.5 mm deep into a flat gel of Shore 00-17, bonded to the window. The dent is followed along a line "
    "from the apex: how far beyond the contact's edge it has fallen to a tenth (below 0 where a thin gel "
    "swells up around the ball). Marker motion is the farthest that a point of the surface goes sideways under a normal press; shear is "
    "not applied.",
    quick={"axes": {"gel.thickness_mm": [1.0, 2.4, 6.0], "object.radius_mm": [4.0]}},
)
