"""Section `measured-ball`: force against depth of a rigid ball on a sensor's gel, measured by others; errors as they are.

The data are not in the project: --data or $GELSIM_DATA names their folder; in it feats/measured_force_depth.csv holds the ball R = 7.5 mm
on a gel of 20.75 x 25.25 x 4.0 mm bonded at its back (FEATS, MIT licence). Contact sticks. One modulus is fitted by least squares: with a
rigid ball, force is proportional to it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from gelsim.bench.half_space import solve
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.errors import SolveError, SolveStatus

BALL = Path("feats") / "measured_force_depth.csv"
_TRIED_KPA = 400.0


def _ball_cases(options: Options) -> Iterator[Case]:
    path = None if options.data is None else options.data / BALL
    if path is None or not path.is_file():
        return
    for depth, _ in _ball_data(path):
        yield Case(f"{depth:g} mm", partial(_ball_row, path, depth))


def _ball_data(path: Path) -> list[tuple[float, float]]:
    with path.open() as file:
        return [(float(row["indentation_mm"]), float(row["normal_force_N"])) for row in csv.DictReader(file)]


@lru_cache
def _ball_forces(depths: tuple[float, ...]) -> dict[float, float]:
    """Forces [N] at a modulus of _TRIED_KPA."""
    spacing = depths[0]
    scene: Layer = {
        "gel": {"profile": "flat", "size_mm": [20.75, 25.25], "thickness_mm": 4.0, "youngs_modulus_kpa": _TRIED_KPA},
        "object": {"shape": "hemisphere", "radius_mm": 7.5, "height_mm": 15.0, "rigid": True},
        "contact": {"friction_coefficient": "stick"},
        "press": {"depth_mm": max(depths), "force_n": "none", "frames": 1 + 2 * round(max(depths) / spacing)},
    }
    press = solve(scene)[1]
    return {depth: float(np.interp(depth, press.approach * 1e3, -press.force[:, 2])) for depth in depths}


def _ball_row(path: Path, depth: float) -> Row:
    data = dict(_ball_data(path))
    try:
        forces = _ball_forces(tuple(sorted(data)))
    except SolveError as error:
        return {"status": "SolveError", "message": str(error)}
    measured, tried = np.array(list(data.values())), np.array([forces[d] for d in data])
    scale = float((measured * tried).sum() / (tried**2).sum())
    return {
        "status": SolveStatus.CONVERGED.name,
        "measured_n": data[depth],
        "ours_n": round(scale * forces[depth], 4),
        "error_percent": round(100 * (scale * forces[depth] / data[depth] - 1), 1),
        "modulus_kpa": round(scale * _TRIED_KPA, 1),
        "rms_n": round(float(np.sqrt(np.mean((scale * tried - measured) ** 2))), 3),
    }


def _ball_remarks(rows: list[Row]) -> str:
    row = rows[0]
    if "modulus_kpa" not in row:
        return ""
    return (
        f"One modulus fitted: E = {row['modulus_kpa']:g} kPa; RMS of the differences {row['rms_n']:g} N. The authors' own fit, "
        "incompressible neo-Hookean, is C₁₀ = 72.5 kPa, E = 435 kPa."
    )


SECTION = Section(
    title="Measured: a ball on a sensor's gel",
    columns=(("depth", "name"), ("measured [N]", "measured_n"), ("ours [N]", "ours_n"), ("error [%]", "error_percent")),
    cases=_ball_cases,
    needs="--data DIR or $GELSIM_DATA, a folder of measured data that holds feats/",
    remarks=_ball_remarks,
)
