"""Presses drawn for `live`: balls, cylinders, boxes, letters, screws and textures, by six motions, to three depths; from number SOFT on
balls, cylinders and boxes that are soft.

Press i of a seed is the same whatever ran before it: its numbers come from SeedSequence(seed, spawn_key=(i,)); of 36 rigid ones in a row
each kind goes each way once. Letters and screws are mesh files, written where they are asked for. What was solved is kept as press.npz.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from string import ascii_uppercase

import numpy as np
from numpy.typing import NDArray

from gelsim.bench.mesh_parts import built
from gelsim.bench.section import Layer
from gelsim.errors import SceneError
from gelsim.files import whole_file
from gelsim.pipeline import outputs, stages
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.motion import motion, straight
from gelsim.units import MM

SEED = 40
THICKNESS_MM = 2.4
SHARES = (0.1, 0.25, 0.4)
"""Of the thickness: where a press is looked at, on its way down, or back up."""
STEP = 0.05
"""Of the thickness, between two recorded states."""
DEEPEST, RIMMED = {"ball": 0.4, "cylinder": 0.4}, 0.25
"""Of the thickness: where presses end, and where others do, as around a deep rim finite elements take minutes or find no equilibrium."""

SOFT = 100
"""Number of the first soft press."""
SHORE_00 = 10, 70
"""Of soft ones."""
KINDS = ("ball", "cylinder", "box", "letter", "screw", "texture")
MOTIONS = ("centred", "tilted", "off centre", "sheared", "twisted", "released")


def draw(index: int, seed: int = SEED) -> tuple[str, Layer]:
    """What press number `index` is, in words, and its scene, as a file has it; of letters and screws `mesh` says which."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    kind, way = kind_of(index)

    def between(low: float, high: float, digits: int = 2) -> float:
        return round(float(rng.uniform(low, high)), digits)

    def aside(low: float, high: float) -> list[float]:
        """A vector along the gel, of a drawn length and way."""
        length, way = rng.uniform(low, high), rng.uniform(0.0, 2 * np.pi)
        return [round(float(length * share), 3) for share in (np.cos(way), np.sin(way))]

    body: Layer = {"rigid": True}
    rims = between(0.1, 0.3)  # over a fifth of a block's width finite elements find no first touch
    if kind == "ball":
        body |= {"shape": "hemisphere", "radius_mm": round(float(2.0 * 6.0 ** rng.random()), 2), "height_mm": 12.0}
        name = f"ball R {body['radius_mm']:g}"
    elif kind == "cylinder":
        body |= {"shape": "cylinder", "radius_mm": between(1.5, 8.0), "length_mm": between(5.0, 12.0)}
        body |= {"height_mm": 10.0, "edge_radius_mm": rims}
        name = f"cylinder R {body['radius_mm']:g}, {body['length_mm']:g} long"
    elif kind == "box":
        body |= {"shape": "box", "width_mm": between(3.0, 8.0), "length_mm": between(3.0, 8.0), "height_mm": 8.0, "edge_radius_mm": rims}
        name = f"box {body['width_mm']:g} × {body['length_mm']:g}, rims of {rims:g}"
    elif kind == "letter":
        letter = str(rng.choice(list(ascii_uppercase)))
        body |= {"shape": "mesh", "mesh": f"letter {letter} {between(4.0, 8.0):g}"}
        name = body["mesh"]
    elif kind == "screw":
        body |= {"shape": "mesh", "mesh": str(rng.choice(["screw head", "thread"])) + f" {between(3.0, 6.0):g}"}
        name = body["mesh"]
    else:
        shape = str(rng.choice(["wave", "emboss", "rough"]))
        body |= {"shape": shape, "width_mm": between(5.0, 8.0), "length_mm": between(5.0, 8.0), "height_mm": 6.0, "edge_radius_mm": rims}
        body |= {"amplitude_mm": between(0.02, 0.08) if shape == "rough" else between(0.05, 0.3), "wavelength_mm": between(1.5, 4.0)}
        body |= {"pattern_seed": int(rng.integers(100))} if shape == "rough" else {}
        name = f"{shape} of {body['amplitude_mm']:g} every {body['wavelength_mm']:g}"
    if kind != "ball":
        body["rotation_deg"] = [0.0, 0.0, between(0.0, 180.0, 0)]

    last = DEEPEST.get(kind, RIMMED)
    deepest = last * THICKNESS_MM
    press: Layer = {"offset_mm": aside(0.0, 1.0)}
    if way == "tilted":
        press["tilt_deg"] = aside(1.0, 6.0)
    elif way == "off centre":
        press["offset_mm"] = aside(3.0, 5.0)
    elif way == "sheared":
        press["shear_mm"] = aside(0.2 * deepest, 1.2 * deepest)
    elif way == "twisted":
        press["twist_deg"] = between(3.0, 15.0)
    if index >= SOFT:
        del body["rigid"]
        body.pop("edge_radius_mm", None)
        body["shore_00"] = int(rng.integers(SHORE_00[0], SHORE_00[1] + 1))
        name = f"{name.partition(',')[0] if kind == 'box' else name}, Shore 00-{body['shore_00']}"
    if way == "released":
        low, high = STEP * THICKNESS_MM, (last + STEP) * THICKNESS_MM
        steps = round(last / STEP) + 1
        down: Layer = {"depth_mm": high, "duration_s": float(steps), "shear_mm": aside(0.0, 0.8 * high)}
        press |= {"path": [down, {"depth_mm": low, "duration_s": float(steps - 1)}], "frames": 2 * steps}
    else:
        press |= {"depth_mm": deepest, "frames": round(last / STEP) + 1}
    scene: Layer = {
        "gel": {"profile": "dome" if rng.random() < 0.3 else "flat", "thickness_mm": THICKNESS_MM},
        "object": body,
        "contact": {"friction_coefficient": 0.0 if rng.random() < 0.1 else between(0.2, 1.0)},
        "press": press,
        "render": {"resolution": [320, 240]},
    }
    return f"{name}, {way}", scene


def kind_of(index: int) -> tuple[str, str]:
    """What is pressed, and how it moves."""
    if index >= SOFT:
        return KINDS[(index - SOFT) % 3], MOTIONS[(index - SOFT) * 5 // 3 % 6]
    return KINDS[index % 6], MOTIONS[(index + index // 6) % 6]


def shares_of(index: int) -> tuple[float, ...]:
    """Those of `SHARES` that a press comes to."""
    return tuple(share for share in SHARES if share <= DEEPEST.get(kind_of(index)[0], RIMMED))


def approaches(scene: Scene) -> NDArray[np.float64]:
    """From first touch [m] of the recorded states, (N,)."""
    way = motion(scene.press) or straight(scene.press, scene.press.depth_mm or 0.0)
    return np.interp(way.recorded, way.time, way.approach) * MM


def kept_at(drawn: Layer, folder: Path, fidelity: str) -> Path:
    """Where a press is kept in a folder."""
    key = hashlib.sha256(json.dumps(drawn, sort_keys=True).encode()).hexdigest()[:16]
    return folder / f"{key}-{fidelity}.npz"


def solved(drawn: Layer, folder: Path, fidelity: str) -> Deformation:
    """The press by finite elements, as it was kept in a folder, or solved now and kept there.

    A press that ended before is kept as far as it came.
    """
    scene, path = built(drawn, folder).replace(fidelity=fidelity), kept_at(drawn, folder, fidelity)
    if path.exists():
        try:
            return outputs.read_press(path).reporting(**vars(outputs.solve_report(outputs.read_account(path))))
        except SceneError:  # of an older form
            path.unlink()
    record = stages.Record()
    press = stages.press(scene, device="cpu", record=record, throw=False, enough=lambda _: True)  # no try at rest again
    with whole_file(path) as partial:
        outputs.write_press(partial, scene, press, {"info": press.report.table()})
    return press
