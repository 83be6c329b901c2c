"""Section `target`: `--target-error` on the objects of `accuracy`: what was chosen, what the press told, and what was true.

Each object is solved at every fidelity and to every target. The true error is that of section accuracy, over the states that the estimate
is of, against the forces of the finest profiles; the cheapest fidelity is the first one whose true error meets the target, which no press
can know of itself.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from gelsim.bench.accuracy import FIDELITIES, press_errors
from gelsim.bench.presses import ball, facts, hemisphere
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.errors import GelsimError
from gelsim.pipeline import stages
from gelsim.scene.layers import build_scene

TARGETS = ("5%", "2%", "1%", "0.5%")


def _cases(options: Options) -> Iterator[Case]:
    objects: list[tuple[str, Layer, str, dict[str, float], str]] = []
    for nu in (0.499,) if options.quick else (0.49, 0.499):
        objects.append((f"rigid ball, ν {nu}", ball(nu), "ball_force.csv", {"nu": nu}, "rigid"))
        for modulus in (200.0,) if options.quick else (50.0, 200.0):
            rows = {"nu": nu, "object_modulus_kPa": modulus}
            objects.append((f"hemisphere {modulus:g} kPa, ν {nu}", hemisphere(modulus, nu), "hemisphere_force.csv", rows, str(modulus)))
    for kind, symmetry in (("solid", "mirror"), ("profile", "auto")):
        for name, scene, table, wanted, modulus in objects:
            pressed = scene | {"press": scene["press"] | {"symmetry": symmetry}}
            layers: dict[str, Layer] = {fidelity: {"fidelity": fidelity} for fidelity in FIDELITIES}
            layers |= {target: {"target_error": target} for target in TARGETS}
            for asked, layer in layers.items():
                given = pressed | layer
                yield Case(f"{name}, {kind}, {asked}", partial(_measure, f"{name}, {kind}", asked, given, table, wanted, modulus), given)


def _measure(case: str, asked: str, scene: Layer, table: str, wanted: dict[str, float], modulus: str) -> Row:
    """A press at a fidelity or to a target; seconds are of all that was solved for it."""
    row: Row = {"object": case, "asked": asked}
    record = stages.Record()
    start = time.perf_counter()
    try:
        made = build_scene(scene)
        press = stages.press(made, device="cpu", record=record, throw=False)
    except GelsimError as error:
        return row | {"status": type(error).__name__, "message": str(error), "seconds": round(time.perf_counter() - start, 2)}
    tried = [one["fidelity"] for one in record.choices["fidelity"]["tried"]] if made.target_error is not None else [asked]
    errors = press_errors(press, table, wanted, modulus)
    told = {key: errors[key] for key in ("judged_percent", "estimate_percent")}
    return row | facts(press, made.press.frames) | told | {"solved": ", then ".join(tried), "seconds": round(record.seconds["press"], 2)}


def _judged(rows: list[Row]) -> list[Row]:
    """Beside each target whether the press says that it is met, whether that is true, and the cheapest fidelity in truth."""
    known = {(row["object"], row["asked"]): row for row in rows if "judged_percent" in row}
    out = []
    for row in rows:
        if row["asked"] in FIDELITIES or "judged_percent" not in row:
            out.append(row)
            continue
        wanted = float(row["asked"].rstrip("%"))
        found = [known[row["object"], fidelity] for fidelity in FIDELITIES if (row["object"], fidelity) in known]
        cheapest = next((one for one in found if one["judged_percent"] <= wanted), None)
        verdict = {
            "says": "met" if row["estimate_percent"] <= wanted else "not met",
            "true": "met" if row["judged_percent"] <= wanted else "not met",
            "cheapest": cheapest and cheapest["asked"],
            "cheapest_seconds": cheapest and cheapest["seconds"],
        }
        out.append(row | verdict)
    return out


def _remarks(rows: list[Row]) -> str:
    rows = [row for row in rows if "says" in row]
    false = sum(row["says"] == "met" and row["true"] == "not met" for row in rows)
    shy = sum(row["says"] == "not met" and row["true"] == "met" for row in rows)
    dear = [row["seconds"] / row["cheapest_seconds"] for row in rows if row.get("cheapest_seconds")]
    said = f"{false} of {len(rows)} targets said to be met are not met in truth; {shy} are met and said not to be."
    return said + (f" A target costs {np.median(dear):.2g} times (median; at most {max(dear):.2g}) the cheapest fidelity." if dear else "")


SECTION = Section(
    title="Target error",
    columns=(
        ("case", "object"), ("target, force", "asked"), ("solved", "solved"), ("says of itself [%]", "estimate_percent"),
        ("says", "says"), ("true [%]", "judged_percent"), ("in truth", "true"), ("seconds", "seconds"),
        ("cheapest in truth", "cheapest"), ("its seconds", "cheapest_seconds"),
    ),
    cases=_cases,
    judge=_judged,
    listed=lambda rows: [row for row in rows if row["asked"] not in FIDELITIES],
    remarks=_remarks,
)  # fmt: skip
