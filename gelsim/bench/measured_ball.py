"""Section `measured-ball`: force against depth of a rigid ball on a sensor's gel, measured by others; errors as they are.

The data are not in the project: --data or $GELSIM_DATA names their folder; in it feats/measured_force_depth.csv holds the ball R = 7.5 mm
on a gel of 20.75 x 25.25 x 4.0 mm bonded at its back (FEATS, MIT licence). Its publishers model a contact that sticks; beside it stands the
frictionless limit. One modulus is fitted to each by least squares: with a rigid ball, force is proportional to it.
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


CONTACTS: dict[str, float | str] = {"stick": "stick", "smooth": 0.0}
"""Fields of a row: as its publishers model it, and the other limit."""


@lru_cache
def _ball_forces(depths: tuple[float, ...], friction: float | str) -> dict[float, float]:
    """Forces [N] at a modulus of _TRIED_KPA."""
    scene: Layer = {
        "gel": {"profile": "flat", "size_mm": [20.75, 25.25], "thickness_mm": 4.0, "youngs_modulus_kpa": _TRIED_KPA},
        "object": {"shape": "hemisphere", "radius_mm": 7.5, "height_mm": 15.0, "rigid": True},
        "contact": {"friction_coefficient": friction},
        "press": {"depth_mm": max(depths), "force_n": "none", "frames": 1 + 4 * round(max(depths) / depths[0])},
    }
    press = solve(scene)[1]
    return {depth: float(np.interp(depth, press.approach * 1e3, -press.force[:, 2])) for depth in depths}


def _ball_row(path: Path, depth: float) -> Row:
    data = dict(_ball_data(path))
    row: Row = {"status": SolveStatus.CONVERGED.name, "measured_n": data[depth]}
    measured = np.array(list(data.values()))
    try:
        for label, friction in CONTACTS.items():
            forces = _ball_forces(tuple(sorted(data)), friction)
            tried = np.array([forces[d] for d in data])
            scale = float((measured * tried).sum() / (tried**2).sum())
            row |= {
                f"{label}_n": round(scale * forces[depth], 3),
                f"{label}_error_percent": round(100 * (scale * forces[depth] / data[depth] - 1), 1),
                f"{label}_kpa": round(scale * _TRIED_KPA, 1),
                f"{label}_rms_n": round(float(np.sqrt(np.mean((scale * tried - measured) ** 2))), 3),
            }
    except SolveError as error:
        return row | {"status": "SolveError", "message": str(error)}
    return row


def _ball_remarks(rows: list[Row]) -> str:
    row = rows[0]
    if row["status"] != SolveStatus.CONVERGED.name:
        return ""
    return (
        f"One modulus fitted for each: sticking E = {row['stick_kpa']:g} kPa, RMS {row['stick_rms_n']:g} N; without friction E = "
        f"{row['smooth_kpa']:g} kPa, RMS {row['smooth_rms_n']:g} N. The publishers' own fit, incompressible neo-Hookean and sticking, is "
        "C₁₀ = 72.5 kPa, E = 435 kPa."
    )


SECTION = Section(
    title="Measured: a ball on a sensor's gel",
    columns=(
        ("depth", "name"),
        ("measured [N]", "measured_n"),
        ("ours, sticking [N]", "stick_n"),
        ("error [%]", "stick_error_percent"),
        ("ours, no friction [N]", "smooth_n"),
        ("error [%]", "smooth_error_percent"),
    ),
    cases=_ball_cases,
    needs="--data DIR or $GELSIM_DATA, a folder of measured data that holds feats/",
    remarks=_ball_remarks,
)
