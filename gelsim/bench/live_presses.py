"""Rigid presses drawn for `live`: balls, cylinders, boxes, letters, screws and textures, by six motions, to three depths.

Press i of a seed is the same whatever ran before it: its numbers come from SeedSequence(seed, spawn_key=(i,)); of 36 in a row each kind
goes each way once. Letters and screws are mesh files, written where they are asked for. What was solved is kept as press.npz.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from string import ascii_uppercase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.bench.section import Layer
from gelsim.errors import SceneError
from gelsim.files import whole_file
from gelsim.pipeline import outputs, stages
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene
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
    return KINDS[index % 6], MOTIONS[(index + index // 6) % 6]


def shares_of(index: int) -> tuple[float, ...]:
    """Those of `SHARES` that a press comes to."""
    return tuple(share for share in SHARES if share <= DEEPEST.get(kind_of(index)[0], RIMMED))


def approaches(scene: Scene) -> NDArray[np.float64]:
    """From first touch [m] of the recorded states, (N,)."""
    way = motion(scene.press) or straight(scene.press, scene.press.depth_mm or 0.0)
    return np.interp(way.recorded, way.time, way.approach) * MM


def built(drawn: Layer, folder: Path) -> Scene:
    """The scene of a drawn press; mesh files are written into a folder."""
    body = drawn["object"]
    if "mesh" in body:
        body = body | {"mesh": str(_mesh_file(body["mesh"], folder))}
    return build_scene(drawn | {"object": body})


def solved(drawn: Layer, folder: Path, fidelity: str) -> Deformation:
    """The press by finite elements, as it was kept in a folder, or solved now and kept there.

    A press that ended before is kept as far as it came.
    """
    scene = built(drawn, folder).replace(fidelity=fidelity)
    key = hashlib.sha256(json.dumps(drawn, sort_keys=True).encode()).hexdigest()[:16]
    path = folder / f"{key}-{fidelity}.npz"
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


# ---- meshes ----


def _mesh_file(said: str, folder: Path) -> Path:
    """An STL file of "letter A 5", "screw head 4" or "thread 4", whose last word is its size [mm]."""
    import trimesh

    path = folder / f"{said.replace(' ', '_')}.stl"
    if not path.exists():
        *words, size = said.split()
        made = {"letter": lambda size: _letter(words[1], size), "screw": _head, "thread": _thread}[words[0]]
        mesh = made(float(size)).simplify(1e-3).to_mesh64()
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial:
            trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts).export(partial, file_type="stl")
    return path


def _letter(letter: str, height: float) -> Any:
    """A stamp: one bold letter of a height, 3 mm deep, its face down, its edges rounded by 0.2 mm."""
    from manifold3d import CrossSection, FillRule, JoinType, Manifold, OpType
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    font = FontProperties(family="DejaVu Sans", weight="bold")
    outlines: Any = TextPath((0, 0), letter, size=height / 0.73, prop=font).to_polygons(closed_only=True)  # of capitals
    face = CrossSection([outline[:-1] for outline in outlines], FillRule.EvenOdd)
    left, low, right, high = face.bounds()
    face = face.translate((-(left + right) / 2, -(low + high) / 2))
    angle = np.radians(np.linspace(0, 90, 7))
    steps = 0.2 * np.stack([1 - np.cos(angle), 1 - np.sin(angle)], axis=1)
    parts = [face.offset(-inset, JoinType.Round, circular_segments=48).extrude(3.0 - lift).translate((0, 0, lift)) for inset, lift in steps]
    return Manifold.batch_boolean(parts, OpType.Add)


def _head(radius: float) -> Any:
    """A pan head of a radius, its top down, with a cross 0.3 radii deep."""
    from manifold3d import CrossSection

    along = np.linspace(0, np.pi / 2, 13)
    outline = np.column_stack([radius * np.sin(along) ** 0.6, 0.55 * radius * (1 - np.cos(along) ** 0.6)])
    head = CrossSection([np.vstack([outline, [(radius, radius), (0, radius)]])]).revolve(96)
    arms = [CrossSection.square(side, True) for side in ((1.2 * radius, 0.3 * radius), (0.3 * radius, 1.2 * radius))]
    cross = (arms[0] + arms[1]).extrude(0.3 * radius, scale_top=(0.7, 0.7))
    return head - cross.translate((0, 0, -1e-3))


def _thread(radius: float) -> Any:
    """A threaded rod of an outer radius, lying along x, 12 mm long: ISO's 60 degrees, its crests an eighth of the pitch wide."""
    from manifold3d import Manifold

    pitch = 0.35 * radius**0.75

    def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
        points = np.array(points)
        turns = points[:, 2] / pitch - np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
        wave = 1 - np.abs(2 * (turns % 1) - 1)
        points[:, :2] *= (radius - 0.866 * pitch * (wave - 0.125).clip(0.0, 0.625))[:, None]
        return points

    rod = Manifold.cylinder(12.0, 1.0, circular_segments=96, center=True).refine_to_length(0.2)
    return rod.warp_batch(move).rotate((0, 90, 0))
