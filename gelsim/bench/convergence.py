"""Section `convergence`: a rigid ball and a soft hemisphere as profiles on four meshes, each with edges half as long as the one before.

Errors are against the finest mesh, orders log₂ of two successive ones. The contact radius is known to a tenth of an edge or so, and does
not fall smoothly.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gelsim.bench.presses import ball, hemisphere
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.scene.layers import build_scene

FINEST = 4.0
PROFILE_RADIUS_MM = 8.0
_DISC_MM = 12.5
_PLACES = np.linspace(0.0, PROFILE_RADIUS_MM, 401)


def _cases(options: Options) -> Iterator[Case]:
    finest = FINEST / 2 if options.quick else FINEST
    for name, scene in (("rigid ball", ball(0.499)), ("hemisphere 200 kPa", hemisphere(200.0, 0.499))):
        for halvings in (3, 2, 1, 0):
            yield _case(name, scene | {"fidelity": "reference"}, finest / 2**halvings)


def _case(name: str, layer: Layer, finer: float) -> Case:
    return Case(f"{name}, edges / {finer:g}", lambda: _measure(name, layer, finer), layer)


def _measure(name: str, layer: Layer, finer: float) -> Row:
    from gelsim.fem import solve_planar
    from gelsim.mesh.profiles import mesh_profiles

    scene = build_scene(layer)
    scene = scene.replace(press=replace(scene.press, frames=6))
    start = time.perf_counter()
    gel, body = mesh_profiles(scene, finer=finer, gel_end=_DISC_MM * 1e-3)
    press = solve_planar(scene, gel, body, depth_mm=None, throw=False)
    place = np.hypot(press.gel.rest[:, 0], press.gel.rest[:, 1]) * 1e3
    order = np.argsort(place)
    profile = np.interp(_PLACES, place[order], press.gel.displacement[-1, order, 2] * 1e6)
    return {
        "status": press.status.name,
        "body": name,
        "edges_mm": round(float(np.diff(np.sort(gel.nodes[np.unique(gel.groups["coated"][:, :2]), 0])).min()) * 1e3, 4),
        "unknowns": press.report.unknowns,
        "force_n": float(-press.force[-1, 2]),
        "radius_mm": math.sqrt(press.contact_area[-1] / math.pi) * 1e3,
        "profile_um": [round(float(v), 4) for v in profile],
        "seconds": round(time.perf_counter() - start, 2),
    }


def _judge(rows: list[Row]) -> list[Row]:
    """Errors against the finest mesh of a body, and their orders."""
    judged = [dict(row) for row in rows]
    for body in dict.fromkeys(row["body"] for row in judged):
        some = sorted((row for row in judged if row["body"] == body), key=lambda row: row["unknowns"])
        best = some[-1]
        for row in some[:-1]:
            row["force_error_percent"] = round(100 * abs(row["force_n"] / best["force_n"] - 1), 4)
            row["radius_error_percent"] = round(100 * abs(row["radius_mm"] / best["radius_mm"] - 1), 2)
            row["profile_rms_um"] = round(float(np.sqrt(np.mean(np.square(np.subtract(row["profile_um"], best["profile_um"]))))), 3)
        for coarse, fine in zip(some[:-2], some[1:-1], strict=True):
            for field in ("force_error_percent", "radius_error_percent", "profile_rms_um"):
                if coarse[field] and fine[field]:
                    fine[field.split("_")[0] + "_order"] = round(math.log2(coarse[field] / fine[field]), 1)
    for row in judged:
        del row["profile_um"]
        row |= {"force_n": round(row["force_n"], 6), "radius_mm": round(row["radius_mm"], 4)}
    return judged


SECTION = Section(
    title="Convergence",
    columns=(
        ("case", "name"), ("shortest edge [mm]", "edges_mm"), ("unknowns", "unknowns"), ("force at 1 mm [N]", "force_n"),
        ("error [%]", "force_error_percent"), ("order", "force_order"), ("contact radius [mm]", "radius_mm"),
        ("error [%]", "radius_error_percent"), ("order", "radius_order"), ("profile, RMS [µm]", "profile_rms_um"),
        ("order", "profile_order"), ("seconds", "seconds"),
    ),
    cases=_cases,
    judge=_judge,
)  # fmt: skip
