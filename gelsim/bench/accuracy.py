"""Section `accuracy`: a rigid ball and soft hemispheres on a flat gel at every fidelity, against solutions of another code.

Force, contact radius and surface profile are compared with the converged axisymmetric solutions of assets/reference.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from gelsim.bench.presses import ball, hemisphere, press_case
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.fem.indicator import JUDGED_FROM
from gelsim.results import Deformation
from gelsim.scene.layers import assets_folder

FIDELITIES = ("fast", "balanced", "reference")
BOUNDS = {"balanced": (2.0, 3.0, 5.0), "reference": (0.7, 1.5, 2.0)}
"""Of force [%], contact radius [%] and profile [µm]. The radius is held against the finer profiles: the other code's own is known to a
quarter of its edge, up to 5 % of the smallest ones."""
PROFILE_RADIUS_MM = 8.0
"""The membrane within this radius is compared: beyond it nothing moves by more than a few micrometres."""


def _cases(options: Options) -> Iterator[Case]:
    quick = options.quick
    for fidelity in FIDELITIES[:2] if quick else FIDELITIES:
        # What a user gets is the profile; the solids are what a scene gets that has no axis.
        for kind, symmetry in (("solid", "mirror"), ("profile", "auto")):
            press = {"symmetry": symmetry}
            for nu in (0.499,) if quick else (0.49, 0.499):
                profile = "ball_profile_nu0.499.csv" if nu == 0.499 else None
                errors = partial(press_errors, name="ball_force.csv", wanted={"nu": nu}, modulus="rigid", profile=profile)
                scene: Layer = ball(nu) | {"fidelity": fidelity}
                yield press_case(f"rigid ball, ν {nu}, {kind}, {fidelity}", scene | {"press": scene["press"] | press}, errors)
            for modulus, nu in ((200.0, 0.499),) if quick else ((50.0, 0.49), (200.0, 0.49), (50.0, 0.499), (200.0, 0.499)):
                rows = {"nu": nu, "object_modulus_kPa": modulus}
                profile = "hemisphere_gel_profile_nu0.499_E200.csv" if (modulus, nu) == (200.0, 0.499) else None
                errors = partial(press_errors, name="hemisphere_force.csv", wanted=rows, modulus=str(modulus), profile=profile)
                scene = hemisphere(modulus, nu, **press) | {"fidelity": fidelity}
                yield press_case(f"hemisphere {modulus:g} kPa, ν {nu}, {kind}, {fidelity}", scene, errors)


def reference_table(name: str) -> list[dict[str, float]]:
    """A table of assets/reference, a dictionary a row; the approach is called `approach_mm` in each."""
    with (assets_folder() / "reference" / name).open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    return [row | {"approach_mm": round(row["approach_mm"] if "approach_mm" in row else row["depth_mm"], 4)} for row in rows]


def press_errors(press: Deformation, name: str, wanted: dict[str, float], modulus: str, profile: str | None = None) -> Row:
    """Largest relative errors over the states that rows `wanted` of the reference `name` have, and the RMS error of the profile.

    The contact radius also against contact_radius.csv (`docs/studies/contact_radius.py`), whose edges are a quarter as long; `modulus`
    names the object there. Its forces are what the press's own estimate is held against, over the states that this is of.
    """
    rows = [row for row in reference_table(name) if all(math.isclose(row[key], value) for key, value in wanted.items())]
    known = {row["approach_mm"]: row for row in rows}
    finer = _finer(wanted["nu"], modulus)
    estimate = press.report.error_estimate
    assert estimate is not None
    force_errors, radius_errors, finer_errors, judged_errors = [], [], [], []
    least = JUDGED_FROM * -press.force[:, 2].min()
    for i, approach in enumerate(np.round(press.approach * 1e3, 4)):
        if float(approach) in known:
            row = known[float(approach)]
            radius_mm = math.sqrt(press.contact_area[i] / math.pi) * 1e3
            force_errors.append(-press.force[i, 2] / row["force_N"] - 1)
            radius_errors.append(radius_mm / row["contact_radius_mm"] - 1)
            radius_finer, force_finer = finer[float(approach)]
            finer_errors.append(radius_mm / radius_finer - 1)
            if -press.force[i, 2] >= least:
                judged_errors.append(-press.force[i, 2] / force_finer - 1)
    found: Row = {
        "force_error_percent": round(100 * max(map(abs, force_errors)), 2),
        "radius_error_percent": round(100 * max(map(abs, radius_errors)), 1),
        "radius_finer_percent": round(100 * max(map(abs, finer_errors)), 1),
        "radius_finer_rms_percent": round(100 * float(np.sqrt(np.mean(np.square(finer_errors)))), 1),
        "judged_percent": round(100 * max(map(abs, judged_errors)), 3),
        "estimate_percent": round(100 * estimate.force, 2),
    }
    return found | ({"profile_rms_um": round(_profile_error(profile, press), 2)} if profile else {})


def _finer(nu: float, modulus: str) -> dict[float, tuple[float, float]]:
    """Contact radius [mm] and force [N] by approach [mm]."""
    with (assets_folder() / "reference" / "contact_radius.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if float(row["nu"]) == nu and row["object_modulus_kPa"] == modulus]
    return {float(row["approach_mm"]): (float(row["contact_radius_mm"]), float(row["force_N"])) for row in rows}


def _profile_error(name: str, press: Deformation) -> float:
    """Largest RMS difference of u_z [µm] over the states in the profile table, of surface nodes within PROFILE_RADIUS_MM."""
    table = reference_table(name)
    place = np.hypot(press.gel.rest[:, 0], press.gel.rest[:, 1]) * 1e3
    near = place <= PROFILE_RADIUS_MM
    worst = 0.0
    for i, approach in enumerate(np.round(press.approach * 1e3, 4)):
        rows = np.array([(row["r_mm"], row["u_z_mm"]) for row in table if math.isclose(row["approach_mm"], approach)])
        if len(rows):
            difference = press.gel.displacement[i, near, 2] * 1e3 - np.interp(place[near], rows[:, 0], rows[:, 1])
            worst = max(worst, float(np.sqrt(np.mean(difference**2))) * 1e3)
    return worst


def _remarks(rows: list[Row]) -> str:
    """Of each fidelity that has bounds the largest errors of all cases beside them."""
    said = []
    for fidelity, bounds in BOUNDS.items():
        mine = [row for row in rows if row["fidelity"] == fidelity]
        if not mine:
            continue
        solved = all("force_error_percent" in row for row in mine)
        fields = ("force_error_percent", "radius_finer_percent", "profile_rms_um", "radius_error_percent")
        force, radius, profile, coarse = (max((row[field] for row in mine if field in row), default=float("inf")) for field in fields)
        met = solved and all(found <= bound for found, bound in zip((force, radius, profile), bounds, strict=True))
        said.append(
            f"`{fidelity}`, {len(mine)} cases: force {force:g} % ({bounds[0]:g} wanted), radius off finer profiles {radius:g} % "
            f"({bounds[1]:g}; off the table's own {coarse:g} %), profile {profile:g} µm ({bounds[2]:g}): {'met' if met else 'NOT MET'}."
        )
    for kind in ("solid", "profile"):
        judged = [row for row in rows if "judged_percent" in row and f", {kind}, " in row["name"]]
        ratios = [row["estimate_percent"] / max(row["judged_percent"], 1e-3) for row in judged]
        if ratios:
            said.append(
                f"The force error that presses tell of themselves is {min(ratios):.1f} to {max(ratios):.1f} times the true one of {kind}s "
                f"(median {np.median(ratios):.1f}); {sum(ratio < 1 for ratio in ratios)} of {len(ratios)} are off by more than they tell."
            )
    return " ".join(said)


def _draw(rows: list[Row], folder: Path) -> None:
    """speed_against_error.png: force error against seconds of the solve, a line for each object; NGSolve beside us in one run.

    That run is `docs/studies/beside_ngsolve.py`'s: both on the same cores, errors at 1 mm.
    """
    rows = [row for row in rows if "force_error_percent" in row]
    if not rows:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    series: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        name, kind, _ = row["name"].rsplit(", ", 2)
        series.setdefault((name, kind), []).append(row)
    colours = {name: f"C{number}" for number, name in enumerate(dict.fromkeys(name for name, _ in series))}
    for (name, kind), points in series.items():
        style = {"solid": "o-", "profile": "s--"}[kind]
        seconds, errors = [p["seconds"] for p in points], [p["force_error_percent"] for p in points]
        axes.plot(seconds, errors, style, color=colours[name], label=f"{name}, {kind}", ms=4, lw=1)
        for p in points:
            axes.annotate(p["fidelity"][0], (p["seconds"], p["force_error_percent"]), textcoords="offset points", xytext=(4, 3), fontsize=7)
    with (assets_folder() / "reference" / "beside_ngsolve.csv").open() as file:
        beside = [(row["way"], float(row["seconds"]), float(row["force_error_percent"])) for row in csv.DictReader(file)]
    for code, marker in (("gelsim", "*"), ("NGSolve", "v")):
        points = [(seconds, error) for way, seconds, error in beside if way.startswith(code)]
        axes.plot(*zip(*points, strict=True), marker, color="black", label=f"{code}, 200 kPa, ν 0.49, at 1 mm, one run", ms=7, ls="none")
    axes.set(xscale="log", yscale="log", xlabel="seconds of the solve, 10 states", ylabel="largest force error [%]")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.set_title("speed against error (f, b, r: fast, balanced, reference)", fontsize=10)
    axes.grid(alpha=0.3, which="both")
    figure.legend(fontsize=7, loc="outside right upper")
    figure.savefig(folder / "speed_against_error.png", dpi=140)


SECTION = Section(
    title="Accuracy",
    columns=(
        ("case", "name"), ("unknowns", "unknowns"), ("force error, largest [%]", "force_error_percent"),
        ("off finer profiles' from a tenth of the force on [%]", "judged_percent"), ("own estimate of that [%]", "estimate_percent"),
        ("contact radius off the table's, largest [%]", "radius_error_percent"),
        ("off finer profiles', largest [%]", "radius_finer_percent"),
        ("… RMS [%]", "radius_finer_rms_percent"),
        ("profile error, RMS [µm]", "profile_rms_um"), ("overlap [µm]", "penetration_um"), ("seconds", "seconds"),
    ),
    cases=_cases,
    remarks=_remarks,
    draw=_draw,
)  # fmt: skip
