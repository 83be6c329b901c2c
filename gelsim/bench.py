"""`gelsim bench`: speed against error, and the numerical-stability suite, as tables and plots (docs/validation.md is made from them).

Three sections. `accuracy` presses a rigid ball and soft hemispheres into a flat gel at every fidelity and compares force, contact radius
and surface profile with the converged axisymmetric solutions of assets/reference (another code). `stability` runs named hard cases and
says how each ended. `speed` times the coupled hemisphere as a whole body and as the quarter that its symmetry allows. Each case is one
line of results.jsonl, written as soon as it is known, so that a run that was stopped goes on with --resume.

Seconds are wall seconds of the solve alone, kernels compiled and meshes cached before; a busy machine makes them longer.
"""

from __future__ import annotations

import csv
import json
import math
import os
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelsim import pipeline
from gelsim.errors import GelsimError, SceneError, SolveStatus
from gelsim.results import Deformation
from gelsim.scene_file import assets_folder, build_scene

SECTIONS = ("accuracy", "stability", "speed")
FIDELITIES = ("fast", "balanced", "reference")
RESULTS = "results.jsonl"

Layer = dict[str, Any]

# The reference solutions: a flat gel of 50 kPa, no friction, 1 mm of approach.
REFERENCE_GEL: Layer = {"profile": "flat", "youngs_modulus_kpa": 50.0}
REFERENCE_PRESS: Layer = {"depth_mm": 1.0, "force_n": "none", "frames": 11}
SMOOTH: Layer = {"friction_coefficient": 0.0}
PROFILE_RADIUS_MM = 8.0
"""The membrane within this radius is compared: beyond it nothing moves by more than a few micrometres."""


@dataclass(frozen=True)
class Case:
    """A scene with a name; `reference` is the file and the rows of it that the press is compared with."""

    section: str
    name: str
    scene: Layer
    reference: tuple[str, dict[str, float]] | None = None
    profile: str | None = None

    @property
    def key(self) -> str:
        return f"{self.section}/{self.name}"


def cases(sections: tuple[str, ...], quick: bool) -> list[Case]:
    """All cases of the sections, in the order they are run."""
    made = {"accuracy": _accuracy, "stability": _stability, "speed": _speed}
    return [case for section in sections for case in made[section](quick)]


def _hemisphere(modulus: float, nu: float, **press: Any) -> Layer:
    return {
        "gel": REFERENCE_GEL | {"poissons_ratio": nu},
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": modulus, "poissons_ratio": nu},
        "contact": SMOOTH,
        "press": REFERENCE_PRESS | press,
    }


def _ball(nu: float) -> Layer:
    body = {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 10.0, "rigid": True}
    return {"gel": REFERENCE_GEL | {"poissons_ratio": nu}, "object": body, "contact": SMOOTH, "press": REFERENCE_PRESS}


def _accuracy(quick: bool) -> Iterator[Case]:
    for fidelity in FIDELITIES[:2] if quick else FIDELITIES:
        for nu in (0.499,) if quick else (0.49, 0.499):
            profile = "ball_profile_nu0.499.csv" if nu == 0.499 else None
            scene = _ball(nu) | {"fidelity": fidelity}
            yield Case("accuracy", f"rigid ball, ν {nu}, {fidelity}", scene, ("ball_force.csv", {"nu": nu}), profile)
        for modulus, nu in ((200.0, 0.499),) if quick else ((50.0, 0.49), (200.0, 0.49), (50.0, 0.499), (200.0, 0.499)):
            rows = {"nu": nu, "object_modulus_kPa": modulus}
            profile = "hemisphere_gel_profile_nu0.499_E200.csv" if (modulus, nu) == (200.0, 0.499) else None
            scene = _hemisphere(modulus, nu) | {"fidelity": fidelity}
            yield Case("accuracy", f"hemisphere {modulus:g} kPa, ν {nu}, {fidelity}", scene, ("hemisphere_force.csv", rows), profile)


def _speed(quick: bool) -> Iterator[Case]:
    rows = ("hemisphere_force.csv", {"nu": 0.499, "object_modulus_kPa": 200.0})
    for symmetry, said in (("auto", "quarter, found by itself"), ("none", "whole body")):
        for fidelity in FIDELITIES[:2]:
            scene = _hemisphere(200.0, 0.499, symmetry=symmetry) | {"fidelity": fidelity}
            yield Case("speed", f"hemisphere, {said}, {fidelity}", scene, rows)


def _stability(quick: bool) -> Iterator[Case]:
    def case(name: str, object: Layer | None = None, press: Layer | None = None, **sections: Layer) -> Case:
        scene = {"object": {"shape": "hemisphere"} | (object or {}), "press": {"frames": 6} | (press or {}), "fidelity": "fast"} | sections
        return Case("stability", name, scene)

    stick: Layer = {"friction_coefficient": "stick"}
    for nu in (0.49, 0.4999, 0.49999):
        yield case(f"ν {nu} of both", {"poissons_ratio": nu}, gel={"poissons_ratio": nu})
    for gel, body in ((100.0, 1.0), (50.0, 5.0), (50.0, 5e3), (50.0, 5e4)):
        yield case(f"object {body:g} kPa on a gel of {gel:g} kPa", {"youngs_modulus_kpa": body}, gel={"youngs_modulus_kpa": gel})
    yield case("hemisphere R 2.5 into the dome", {"radius_mm": 2.5})
    yield case("rigid ball R 2.5, 1.2 mm deep", {"radius_mm": 2.5, "height_mm": 5.0, "rigid": True}, {"depth_mm": 1.2})
    yield case("sharp edge", {"shape": "edge"})
    yield case("sharp corner", {"shape": "corner"})
    yield case("sharp rigid corner", {"shape": "corner", "rigid": True}, {"depth_mm": 0.6})
    yield case("soft flat punch", {"shape": "punch", "radius_mm": 3.0})
    yield case("rigid flat punch, stick", {"shape": "punch", "radius_mm": 3.0, "rigid": True}, {"depth_mm": 0.5}, contact=stick)
    yield case("tilt 20°", press={"tilt_deg": [0.0, 20.0]})
    yield case("2 mm shear, stick", press={"shear_mm": [2.0, 0.0]}, contact=stick)
    yield case("2 mm shear, friction 0.5", press={"shear_mm": [2.0, 0.0]}, contact={"friction_coefficient": 0.5})
    yield case("20° twist, friction 0.8", press={"twist_deg": 20.0})
    yield case("25 kPa hemisphere until 9 N", {"youngs_modulus_kpa": 25.0}, {"depth_mm": "none", "force_n": 9.0})
    yield case("cylinder R 50 over the whole gel", {"shape": "cylinder", "radius_mm": 50.0}, {"depth_mm": 0.6})
    yield case("half off the gel", press={"offset_mm": [11.0, 0.0]})
    yield case("tilted block, its border inside the contact", {"shape": "box"}, {"tilt_deg": [3.0, 5.0], "depth_mm": 0.6})
    yield case("cone", {"shape": "cone"})
    yield case("one load step", press={"frames": 2})
    yield case("50 load steps", press={"frames": 51})
    yield case("mirrored: offset and tilt +", press={"offset_mm": [2.0, 0.0], "tilt_deg": [0.0, 8.0]})
    yield case("mirrored: offset and tilt -", press={"offset_mm": [-2.0, 0.0], "tilt_deg": [0.0, -8.0]})


def run(out: Path, *, sections: tuple[str, ...] = SECTIONS, quick: bool = False, resume: bool = False, force: bool = False,
        progress: Callable[[str, int, int], None] | None = None) -> dict[str, Any]:  # fmt: skip
    """Runs the cases and writes results.jsonl, one CSV a section, bench.md and plots into `out`.

    Raises:
        SceneError: `out` holds results and neither `resume` nor `force` was given.
    """
    ledger = out / RESULTS
    if ledger.exists() and not (resume or force):
        raise SceneError(f"--out {out}: holds a benchmark already; give --resume to go on, --force to begin again")
    out.mkdir(parents=True, exist_ok=True)
    if force:
        ledger.unlink(missing_ok=True)
    rows = [json.loads(line) for line in ledger.read_text().splitlines()] if ledger.exists() else []
    done = {row["key"] for row in rows}
    todo = cases(sections, quick)
    for number, case in enumerate(todo):
        if progress:
            progress("bench", number, len(todo))
        if case.key not in done:
            rows.append(measure(case))
            with ledger.open("a") as file:
                file.write(json.dumps(rows[-1], allow_nan=False) + "\n")
    if progress:
        progress("bench", len(todo), len(todo))
    order = {case.key: number for number, case in enumerate(todo)}
    rows = sorted((row for row in rows if row["key"] in order), key=lambda row: order[row["key"]])
    for section in sections:
        _write_csv(out / f"{section}.csv", [row for row in rows if row["section"] == section])
    (out / "bench.md").write_text(describe(rows))
    draw(rows, out / "speed_against_error.png")
    return {"out": str(out), "cases": len(rows), "failed": [row["key"] for row in rows if row["status"] != SolveStatus.CONVERGED.name]}


def measure(case: Case) -> dict[str, Any]:
    """Solves one case; a row of plain numbers, also where it fails."""
    row: dict[str, Any] = {"key": case.key, "section": case.section, "name": case.name, "fidelity": case.scene["fidelity"]}
    record = pipeline.Record()
    start = time.perf_counter()
    try:
        scene = build_scene(case.scene)
        press = pipeline.press(scene, device="cpu", record=record, throw=False)
    except GelsimError as error:
        return row | {"status": type(error).__name__, "message": str(error), "seconds": round(time.perf_counter() - start, 2)}
    row |= {
        "status": press.status.name,
        "message": press.message if press.status is not SolveStatus.CONVERGED else "",
        "states": len(press.approach),
        "states_wanted": scene.press.frames,
        "seconds": round(record.seconds["press"], 2),
        "unknowns": press.info["unknowns"],
        "steps_halved": press.info["steps_halved"],
        "stress_jump": press.info["stress_jump"],
        "newton_iterations": int(press.newton_iterations.sum()),
        "factorisations": press.info["factorisations"],
        "min_jacobian": round(float(press.min_jacobian.min()), 3),
        "penetration_um": round(float(press.penetration.max()) * 1e6, 2),
        "approach_mm": round(float(press.approach[-1]) * 1e3, 4),
        "force_n": [round(float(f), 6) for f in press.force[-1]],
    }
    return row | (_errors(case, press) if case.reference else {})


def _table(name: str) -> list[dict[str, float]]:
    with (assets_folder() / "reference" / name).open() as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def _errors(case: Case, press: Deformation) -> dict[str, Any]:
    """Largest relative errors over the states that the reference has, and the RMS error of the profile."""
    assert case.reference is not None
    name, wanted = case.reference
    force, radius = {}, {}
    for row in _table(name):
        if all(math.isclose(row[key], value) for key, value in wanted.items()):
            approach = row["approach_mm"] if "approach_mm" in row else row["depth_mm"]
            force[round(approach, 4)], radius[round(approach, 4)] = row["force_N"], row["contact_radius_mm"]
    force_errors, radius_errors = [], []
    for i, approach in enumerate(np.round(press.approach * 1e3, 4)):
        if float(approach) in force:
            force_errors.append(-press.force[i, 2] / force[float(approach)] - 1)
            radius_errors.append(math.sqrt(press.contact_area[i] / math.pi) * 1e3 / radius[float(approach)] - 1)
    found: dict[str, Any] = {
        "force_error_percent": round(100 * max(map(abs, force_errors)), 2),
        "radius_error_percent": round(100 * max(map(abs, radius_errors)), 1),
        "radius_error_rms_percent": round(100 * float(np.sqrt(np.mean(np.square(radius_errors)))), 1),
    }
    if case.profile:
        found["profile_rms_um"] = round(_profile_error(case.profile, press), 2)
    return found


def _profile_error(name: str, press: Deformation) -> float:
    """Largest RMS difference of u_z [µm] over the states in the profile table, of surface nodes within PROFILE_RADIUS_MM."""
    table = _table(name)
    column = "approach_mm" if "approach_mm" in table[0] else "depth_mm"
    place = np.hypot(press.gel.rest[:, 0], press.gel.rest[:, 1]) * 1e3
    near = place <= PROFILE_RADIUS_MM
    worst = 0.0
    for i, approach in enumerate(np.round(press.approach * 1e3, 4)):
        rows = np.array([(row["r_mm"], row["u_z_mm"]) for row in table if math.isclose(row[column], approach)])
        if len(rows):
            difference = press.gel.displacement[i, near, 2] * 1e3 - np.interp(place[near], rows[:, 0], rows[:, 1])
            worst = max(worst, float(np.sqrt(np.mean(difference**2))) * 1e3)
    return worst


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    if rows:
        columns = list(dict.fromkeys(key for row in rows for key in row if key not in ("key", "section")))
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)


# Columns of the tables for people: header, field.
_COLUMNS = {
    "accuracy": (
        ("case", "name"), ("unknowns", "unknowns"), ("force error, largest [%]", "force_error_percent"),
        ("contact radius error, largest [%]", "radius_error_percent"), ("… RMS [%]", "radius_error_rms_percent"),
        ("profile error, RMS [µm]", "profile_rms_um"), ("overlap [µm]", "penetration_um"), ("seconds", "seconds"),
    ),
    "speed": (
        ("case", "name"), ("unknowns", "unknowns"), ("Newton iterations", "newton_iterations"), ("factorisations", "factorisations"),
        ("force error, largest [%]", "force_error_percent"), ("seconds", "seconds"),
    ),
    "stability": (
        ("case", "name"), ("ended", "status"), ("states", "states"), ("steps halved", "steps_halved"),
        ("Newton iterations", "newton_iterations"), ("smallest det F", "min_jacobian"), ("overlap [µm]", "penetration_um"),
        ("force [N]", "force_n"), ("seconds", "seconds"),
    ),
}  # fmt: skip


def describe(rows: list[dict[str, Any]]) -> str:
    """The tables as Markdown."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    lines = [
        f"Made by `gelsim bench` on {os.cpu_count()} cores ({platform.machine()}), load {load:.1f} at the end. "
        "Seconds: the solve alone, kernels and meshes cached.",
        "",
    ]
    for section, columns in _COLUMNS.items():
        part = [row for row in rows if row["section"] == section]
        if part:
            lines += [f"### {section.capitalize()}", "", "| " + " | ".join(h for h, _ in columns) + " |", "|" + "---|" * len(columns)]
            lines += ["| " + " | ".join(_cell(row.get(field)) for _, field in columns) + " |" for row in part]
            lines.append("")
    return "\n".join(lines)


def _cell(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, list):
        return ", ".join(f"{v:.4g}" for v in value)
    return str(value).lower() if isinstance(value, str) and value.isupper() else str(value)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Force error against seconds of the solve, a line for each object."""
    rows = [row for row in rows if "force_error_percent" in row]
    if not rows:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot()
    series: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        series.setdefault(row["name"].rsplit(", ", 1)[0] + (" (speed)" if row["section"] == "speed" else ""), []).append(row)
    for name, points in series.items():
        axes.plot([p["seconds"] for p in points], [p["force_error_percent"] for p in points], "o-", label=name, ms=4, lw=1)
        for p in points:
            axes.annotate(p["fidelity"][0], (p["seconds"], p["force_error_percent"]), textcoords="offset points", xytext=(4, 3), fontsize=7)
    axes.set(xscale="log", yscale="log", xlabel="seconds of the solve, 10 states", ylabel="largest force error [%]")
    axes.set_title("speed against error (f, b, r: fast, balanced, reference)", fontsize=10)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7)
    figure.savefig(path, dpi=140)
