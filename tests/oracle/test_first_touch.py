"""Where objects first touch. Rigid ones beside a query that knows no field: the lowest of all balls of the rim's radius inside them.

An object whose edges a ball has rounded is all places of that ball within it, so it touches a plane where the lowest such place does. That
is sought in the distance to its exact surface, by cells that are halved.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gelsim.bench import mesh_parts
from gelsim.fem import quiet_warp, rigid_placement
from gelsim.fem.field import distance_field, exact_distance, rim_radius, spacing
from gelsim.pipeline import stages
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene
from gelsim.shape import shapes
from gelsim.units import MM_PER_M

Array = NDArray[np.float64]
CELL, SMALLEST, KEPT = 0.25, 1e-4, 250
STEEP = 12.0
"""Weight of what a ball sticks out; above 1/sin of half of the sharpest edge (9.6°), so that the least of the sum is inside."""
TILTED = {"sensor": {"preset": "gelsight_mini"}, "press": {"depth_mm": 0.3, "tilt_deg": [5.0, 12.0]}}
PARTS = 60


def lowest(scene: Scene, turn: Array, low: Array, radius: float) -> float:
    """z [mm] of the lowest point of the object, its edges rounded by a radius [mm], placed by a turn (3, 3) and a shift (3,) [mm]."""
    distance = exact_distance(scene.object)
    nodes = shapes.first_touch(scene)[0].nodes * MM_PER_M @ turn.T + low
    start, end = nodes.min(axis=0), nodes.max(axis=0)
    end[2] = min(end[2], start[2] + 2.5)  # deeper than any ball that could be the lowest
    places = np.stack(np.meshgrid(*map(np.arange, start, end + CELL, [CELL] * 3), indexing="ij"), axis=-1).reshape(-1, 3)
    cell, corners = CELL, np.stack(np.meshgrid(*[[-0.25, 0.25]] * 3), axis=-1).reshape(-1, 3)
    while True:
        out = distance((places - low) @ turn)[0] + radius
        cost = places[:, 2] - radius + STEEP * np.maximum(out, 0.0)
        if cell < SMALLEST:
            return float(cost.min())
        may = places[:, 2] + STEEP * np.maximum(out - 0.87 * cell, 0.0)  # somewhere in its cell a ball may lie inside
        best = np.argsort(cost)[:KEPT]
        kept = places[np.union1d(best, np.argsort(may)[:KEPT])]
        places = np.concatenate([places[best], (kept[:, None] + cell * corners).reshape(-1, 3)])
        cell /= 2.0


def off(scene: Scene) -> tuple[float, float]:
    """How far the placed object is from touching the gel [mm], and what B-splines take off a corner of its rims: samples blur by a
    variance of a third of the spacing squared, an arc by half of that over its radius, and a corner has two curvatures."""
    quiet_warp()
    turn, shift = rigid_placement(scene)
    step = spacing(scene.object, scene.fidelity)
    radius = rim_radius(scene.object, step, scene.fidelity)
    return lowest(scene, turn, shift * MM_PER_M, radius), step**2 / 3 / radius


@pytest.mark.parametrize("shape", ["hemisphere", "shell", "torus", "tomato"])
def test_round_shapes_touch_within_a_micrometre(shape: str) -> None:
    away, _ = off(build_scene(TILTED | {"object": {"shape": shape, "rigid": True}}))
    assert abs(away) < 1e-3


@pytest.mark.parametrize("radius", [0.1, 0.3])
@pytest.mark.parametrize("shape", ["corner", "cone", "box", "frustum", "candy", "wave", pytest.param("rough", marks=pytest.mark.slow)])
def test_rims_touch_as_far_off_as_the_grid_blurs_them(shape: str, radius: float) -> None:
    """At 0.1 mm up to 42 µm, at a cone's tip; at 0.3 mm below 7."""
    away, blur = off(build_scene(TILTED | {"object": {"shape": shape, "rigid": True, "edge_radius_mm": radius}}))
    assert abs(away) < blur


@pytest.mark.parametrize("index", [pytest.param(i, marks=[pytest.mark.slow] if i >= 12 else []) for i in range(PARTS)])
def test_mesh_parts_touch_where_their_rounded_surfaces_do(index: int, tmp_path: Path) -> None:
    """Parts on their faces to 4 µm, on rims up to 37 µm late; and no point of the gel is inside before that."""
    drawn = mesh_parts.draw(index, 36)
    body = {name: drawn["object"][name] for name in ("shape", "mesh", "rotation_deg")} | {"rigid": True}
    tilt = [0.0, 0.0] if index % 12 < 6 else drawn["press"]["tilt_deg"]
    scene = mesh_parts.built(TILTED | {"object": body, "press": {"depth_mm": 0.3, "tilt_deg": tilt}}, tmp_path)
    away, blur = off(scene)
    assert -blur < away < blur / 4  # a face overshoots beside its rim; it is as late there as a rim is early, or less
    turn, shift = rigid_placement(scene)
    x, y = np.meshgrid(np.arange(-9, 9, 0.037), np.arange(-8, 8, 0.037))
    gel = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    assert distance_field(scene)((gel - MM_PER_M * shift) @ turn).min() > -5e-4


def test_another_rim_is_seen() -> None:
    """A rim of twice the radius lifts a cone's tip by far more than the grid blurs it."""
    scene = build_scene(TILTED | {"object": {"shape": "cone", "rigid": True, "edge_radius_mm": 0.3}})
    turn, shift = rigid_placement(scene)
    away, blur = off(scene)
    assert abs(lowest(scene, turn, shift * MM_PER_M, 0.6) - away) > 2 * blur


@pytest.mark.parametrize("body", ["box", "torus", "star 5 3.5 0.43", "crescent 3.5 0.77 0.49"])
def test_soft_objects_touch_where_their_surfaces_do(body: str, tmp_path: Path) -> None:
    """Their curved faces, looked at in 231 points each; and there is neither force nor overlap yet."""
    shape = {"shape": "mesh", "mesh": str(mesh_parts.mesh_file(body, tmp_path))} if " " in body else {"shape": body}
    press = {"depth_mm": 0.05, "force_n": "none", "frames": 2, "tilt_deg": [2.0, 3.0]}
    scene = build_scene({"fidelity": "fast", "object": shape | {"shore_00": 60.0}, "press": press})
    solved = stages.press(scene)
    assert not solved.force[0].any() and solved.penetration[0] == 0.0
    nodes = solved.object.rest + solved.object.displacement[0]
    faces = nodes[solved.object.faces6]
    a, b, c = np.array([(i, j, 20 - i - j) for i in range(21) for j in range(21 - i)]).T / 20
    share = np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1)
    places = np.einsum("qk,fkd->fqd", share, faces[faces[..., 2].min(axis=1) < nodes[:, 2].min() + 1e-3]).reshape(-1, 3)
    away = (places[:, 2] - shapes.gel_height(scene.gel, places[:, :2])).min()
    assert abs(away) < 1e-7  # a round face between points 1/20 of its edge apart, half a millimetre at most: (12 µm)² / 2 R
