"""Section `random`: scenes drawn from the ranges of the paper (hemispheres, cylinders, flats, edges, corners; Shore 00 8 to 87, and rigid).

Scene i is the same whatever ran before it: its numbers come from SeedSequence(SEED, spawn_key=(i,)). Each is solved at `fast` in a child
process that is ended after SECONDS or above MEMORY. Wanted: 99.5 % converge. Every one that does not is listed with what it said. One to a
force whose search ended where no equilibrium was found counts among these, though the states on the way there converged; one squashed as
far as a press to a force goes, or that gives way before, does not, and is named.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gelsim.bench import presses
from gelsim.bench.bounded import GIGABYTE, Bounded
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.errors import PressEnd, SolveStatus
from gelsim.scene.shape_table import SHAPES

SEED = 2017
COUNT, QUICK_COUNT = 300, 4
SECONDS = 1800.0
MEMORY = 8 * GIGABYTE
WANTED = 0.995


def draw(index: int, seed: int = SEED) -> Layer:
    """Scene number `index`, as a scene file has it."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))

    def between(low: float, high: float, digits: int = 3) -> float:
        return round(float(rng.uniform(low, high)), digits)

    def sometimes(share: float, low: float, high: float) -> float:
        value = between(low, high)
        return value if rng.random() < share else 0.0

    shape = str(rng.choice(["hemisphere", "cylinder", "flat", "edge", "corner"], p=[0.4, 0.3, 0.1, 0.1, 0.1]))
    body: Layer = {"shape": shape, "height_mm": between(20.0, 30.0, 1)}
    if SHAPES[shape].has_radius:
        body["radius_mm"] = round(float(2.5 * 20.0 ** rng.random()), 2)  # 2.5 to 50, as many small as large
    if rng.random() < 0.08:
        body["rigid"] = True
    else:
        body |= {"shore_00": between(8.0, 87.0, 1), "poissons_ratio": float(rng.choice([0.49, 0.499, 0.4999]))}
    gel: Layer = {
        "profile": str(rng.choice(["dome", "flat"], p=[0.7, 0.3])),
        "thickness_mm": between(2.0, 3.0, 2),
        "shore_00": between(5.0, 17.0, 1),
        "modulus_scale": between(0.5, 2.0, 2),
        "poissons_ratio": float(rng.choice([0.49, 0.499, 0.4999])),
    }
    press: Layer = {
        "frames": 6,
        "force_n": between(5.0, 9.0, 2),
        "depth_mm": "none" if rng.random() < 0.1 else between(0.3, 1.2),
        "tilt_deg": [sometimes(0.4, -10.0, 10.0), sometimes(0.4, -10.0, 10.0)],
        "offset_mm": [sometimes(0.5, -4.0, 4.0), sometimes(0.5, -4.0, 4.0)],
        "shear_mm": [sometimes(0.3, -0.5, 0.5), sometimes(0.3, -0.5, 0.5)],
        "twist_deg": sometimes(0.2, -5.0, 5.0),
    }
    friction: float | str = "stick" if rng.random() < 0.1 else between(0.0, 1.2, 2)
    return {"gel": gel, "object": body, "press": press, "contact": {"friction_coefficient": friction}, "fidelity": "fast"}


def _cases(options: Options) -> Iterator[Case]:
    bounded = Bounded(measure_drawn, SECONDS, MEMORY)
    for index in range(QUICK_COUNT if options.quick else COUNT):
        scene = draw(index)
        named: Row = {"shape": scene["object"]["shape"], "said": said(scene), "friction": scene["contact"]["friction_coefficient"]}
        yield Case(f"{index:03d}", lambda index=index, named=named: named | bounded(index), scene)


def measure_drawn(index: int) -> Row:
    return presses.measure(draw(index))


def said(scene: Layer) -> str:
    """A scene in a few words."""
    body, press = scene["object"], scene["press"]
    words = [body.get("mesh", body["shape"]) + (f" R {body['radius_mm']:g}" if "radius_mm" in body else "")]
    words.append("rigid" if body.get("rigid") else f"00-{body['shore_00']:g}")
    words.append(f"{scene['gel']['profile']} {scene['gel']['thickness_mm']:g} mm 00-{scene['gel']['shore_00']:g}")
    words.append("to force" if press["depth_mm"] == "none" else f"{press['depth_mm']:g} mm")
    words += [
        f"{name.split('_')[0]} {press[name][0]:g}, {press[name][1]:g}" for name in ("tilt_deg", "offset_mm", "shear_mm") if any(press[name])
    ]
    words += [f"twist {press['twist_deg']:g}°"] if press["twist_deg"] else []
    return ", ".join([*words, f"μ {scene['contact']['friction_coefficient']}"])


def as_asked(row: Row) -> bool:
    """Whether a press was solved to its end, or as far as the object bears, without a coat that nobody asked for."""
    solved = row["status"] == SolveStatus.CONVERGED.name and row["ended_by"] not in (PressEnd.LOST, PressEnd.SLOW)
    return solved and not row.get("coated")


def _failed(rows: list[Row]) -> list[Row]:
    return [row for row in rows if not as_asked(row)]


def _by_shape(rows: list[Row]) -> list[Row]:
    """One row a shape for the table."""
    table = []
    for shape in (*sorted({row["shape"] for row in rows if "shape" in row}), "all"):
        mine = [row for row in rows if shape in (row.get("shape"), "all")]
        solved = [row for row in mine if as_asked(row)]
        if not solved:
            continue

        def percentile(field: str, share: float, solved: list[Row] = solved) -> float:
            return round(float(np.percentile([row[field] for row in solved], share)), 2)

        table.append({
            "shape": shape, "scenes": len(mine), "converged": len(solved), "share_percent": round(100 * len(solved) / len(mine), 2),
            "halved": sum(row["steps_halved"] > 0 for row in solved), "penetration_um": percentile("penetration_um", 50),
            "penetration_worst_um": percentile("penetration_um", 100), "min_jacobian": percentile("min_jacobian", 0),
            "drift_percent": percentile("drift_percent", 50), "seconds": percentile("seconds", 50),
            "seconds_worst": percentile("seconds", 100),
        })  # fmt: skip
    return table


def _remarks(rows: list[Row]) -> str:
    from gelsim.bench.report import table

    failed = _failed(rows)
    limited = [row for row in rows if as_asked(row) and not PressEnd(row["ended_by"]).wanted]
    squashed = ", ".join(row["name"] for row in limited)
    share = 1 - len(failed) / len(rows)
    reached = sum(as_asked(row) and row not in limited for row in rows)
    verdict = "too few scenes to tell" if len(rows) < COUNT else "met" if share >= WANTED else "NOT MET"
    lines = [
        f"{len(rows) - len(failed)} of {len(rows)} converge, {100 * share:.2f} % "
        f"(wanted {100 * WANTED:g} % of {COUNT}: {verdict}), seed {SEED}. "
        f"To a force that they do not carry: {squashed or 'none'}. "
        f"Without these: {100 * reached / len(rows):.2f} %.",
        "",
        *table(
            (
                ("shape", "shape"), ("scenes", "scenes"), ("converged", "converged"), ("with halved steps", "halved"),
                ("overlap, median [µm]", "penetration_um"), ("… largest", "penetration_worst_um"), ("smallest det F", "min_jacobian"),
                ("energy drift, median [%]", "drift_percent"), ("seconds, median", "seconds"), ("… longest", "seconds_worst"),
            ),
            _by_shape(rows),
        ),
    ]  # fmt: skip
    return "\n".join(lines)


SECTION = Section(
    title="Random scenes",
    columns=(("scene", "name"), ("what", "said"), ("ended", "status"), ("by", "ended_by"), ("states", "states"), ("says", "message")),
    cases=_cases,
    remarks=_remarks,
    listed=_failed,
)
