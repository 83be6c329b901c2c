"""Mesh parts drawn for a section or a study: letters, screws, threads, stars, crescents, gears and prisms, each watertight.

A part is said by its kind and its numbers ("star 5 3.2 0.4"), and the file is written where it is asked for. Part i of a seed is the same
whatever ran before it; it is pressed as random scene i of that seed is (`random_scenes.draw`).
"""

from __future__ import annotations

from pathlib import Path
from string import ascii_uppercase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.bench import random_scenes
from gelsim.bench.section import Layer
from gelsim.files import whole_file
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene

KINDS = ("star", "crescent", "gear", "letter", "thread", "prism")
OBJECTS = 1
"""First number of the spawn keys of objects, beside those of random scenes."""
RIGID = 0.7
"""Share of rigid parts."""
DEPTH = 3.0
"""Of a relief [mm], and of the plate that it stands under."""


def draw(index: int, seed: int) -> Layer:
    """Press number `index`, as a scene file has it but for `mesh`, which says the part (`built`)."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(OBJECTS, index)))

    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 2)

    kind = KINDS[index % len(KINDS)]
    if kind == "star":
        numbers = [int(rng.integers(4, 9)), between(2.0, 5.0), between(0.35, 0.7)]
    elif kind == "crescent":
        numbers = [between(2.0, 5.0), between(0.6, 0.9), between(0.3, 0.7)]
    elif kind == "gear":
        numbers = [int(rng.integers(8, 21)), between(2.5, 5.0)]
    elif kind == "letter":
        numbers = [str(rng.choice(list(ascii_uppercase))), between(4.0, 8.0)]
    elif kind == "thread":
        numbers = [between(3.0, 6.0)]
    else:
        numbers = [int(rng.integers(3, 7)), between(2.0, 5.0), between(0.5, 1.0), str(rng.choice(["standing", "lying"]))]
    body: Layer = {"shape": "mesh", "mesh": " ".join(f"{part}" for part in [kind, *numbers])}
    body["rotation_deg"] = [0.0, 0.0, float(rng.integers(180))]
    if rng.random() < RIGID:
        body["rigid"] = True
    else:
        body |= {"shore_00": round(float(rng.uniform(8.0, 87.0)), 1), "poissons_ratio": float(rng.choice([0.49, 0.499, 0.4999]))}
    return random_scenes.draw(index, seed) | {"object": body}


def with_file(drawn: Layer, folder: Path) -> Layer:
    """A press whose `object.mesh`, if any, says a part, with its file: written into a folder, where it is not there yet."""
    body = drawn["object"]
    return drawn | {"object": body | {"mesh": str(mesh_file(body["mesh"], folder))}} if "mesh" in body else drawn


def built(drawn: Layer, folder: Path) -> Scene:
    """The scene of such a press."""
    return build_scene(with_file(drawn, folder))


def mesh_file(said: str, folder: Path) -> Path:
    """An STL file of a part, lengths in mm, face down."""
    path = folder / f"{said.replace(' ', '_')}.stl"
    if not path.exists():
        import trimesh
        from manifold3d import Manifold

        # in the file's precision before what is tiny goes: what fell together there would leave open edges
        mesh = Manifold(made(said).to_mesh()).simplify(1e-3).to_mesh()
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial:
            trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts).export(partial, file_type="stl")
    return path


def made(said: str) -> Any:
    """The part as a manifold."""
    kind, *words = said.split()
    if kind == "letter":
        return _letter(words[0], float(words[1]))
    if kind == "prism":
        return _prism(*(float(word) for word in words[:3]), lying=words[3] == "lying")
    makers = {"screw": _head, "thread": _thread, "star": _star, "crescent": _crescent, "gear": _gear}
    return makers[kind](*(float(word) for word in words[kind == "screw" :]))  # "screw head 4"


def _under_a_plate(section: Any) -> Any:
    """A relief, its face down at z = 0, under a plate that is as large."""
    from manifold3d import CrossSection

    left, low, right, high = section.bounds()
    plate = CrossSection.square((right - left, high - low)).translate((left, low)).extrude(DEPTH).translate((0, 0, DEPTH - 1e-3))
    return section.extrude(DEPTH) + plate


def _star(tips: float, radius: float, inner: float) -> Any:
    """A star; `inner` is the radius between its tips over theirs."""
    from manifold3d import CrossSection

    angle = np.pi * np.arange(2 * int(tips)) / tips
    reach = radius * np.where(np.arange(2 * int(tips)) % 2, inner, 1.0)
    return _under_a_plate(CrossSection([np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])]))


def _crescent(radius: float, inner: float, shift: float) -> Any:
    """A disc less another one; `inner` and `shift` in its radii."""
    from manifold3d import CrossSection

    moon = CrossSection.circle(radius, 24) - CrossSection.circle(inner * radius, 24).translate((max(shift, 1.05 - inner) * radius, 0))
    return _under_a_plate(moon)


def _gear(teeth: float, radius: float) -> Any:
    """A gear with straight flanks and a bore, lying on its side."""
    from manifold3d import CrossSection

    module = 2 * radius / (teeth + 2)
    root, pitch = radius - 2.25 * module, 2 * np.pi / teeth
    angle = (pitch * (np.arange(int(teeth))[:, None] + np.array([-0.32, -0.13, 0.13, 0.32]))).ravel()
    reach = np.tile([root, radius, radius, root], int(teeth))
    outline = CrossSection([np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])])
    return (outline - CrossSection.circle(0.35 * root, 32)).extrude(DEPTH)


def _prism(sides: float, radius: float, flat: float, *, lying: bool) -> Any:
    """A prism, narrower across by `flat`: on its base, or on an edge."""
    from manifold3d import CrossSection

    angle = 2 * np.pi * np.arange(int(sides)) / sides - np.pi / 2
    face = CrossSection([np.column_stack([radius * np.cos(angle), flat * radius * np.sin(angle)])])
    return face.extrude(2 * radius).translate((0, 0, -radius)).rotate((90, 0, 0)) if lying else face.extrude(2 * DEPTH)


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


def _thread(radius: float, pitch: float = 0.0) -> Any:
    """A threaded rod of an outer radius, lying along x, 12 mm long: ISO's 60 degrees, its crests an eighth of the pitch wide."""
    from manifold3d import Manifold

    pitch = pitch or 0.35 * radius**0.75

    def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
        points = np.array(points)
        turns = points[:, 2] / pitch - np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
        wave = 1 - np.abs(2 * (turns % 1) - 1)
        points[:, :2] *= (radius - 0.866 * pitch * (wave - 0.125).clip(0.0, 0.625))[:, None]
        return points

    rod = Manifold.cylinder(12.0, 1.0, circular_segments=96, center=True).refine_to_length(0.2)
    return rod.warp_batch(move).rotate((0, 90, 0))
