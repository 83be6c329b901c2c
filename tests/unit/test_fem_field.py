"""Rigid objects as signed distances: right where they are smooth, round at edges, and the same along an edge whichever way it lies."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from manifold3d import CrossSection
from numpy.typing import NDArray

from gelsim.errors import SolveStatus
from gelsim.fem import quiet_warp, rigid_placement
from gelsim.fem.field import (
    ROUNDING,
    FieldGrid,
    _signs,
    distance_field,
    exact_distance,
    read_field,
    sampled,
    signed_distances,
    spacing,
)
from gelsim.pipeline import stages
from gelsim.scene.definition import Body
from gelsim.scene.layers import build_scene
from gelsim.scene.shape_table import SHAPES
from gelsim.shape import outlines, shapes

Array = NDArray[np.float64]
SPACING = 0.125


@pytest.fixture(autouse=True, scope="module")
def _quiet() -> None:
    quiet_warp()


@wp.kernel(enable_backward=False)
def read_all(field: FieldGrid, points: wp.array(dtype=wp.vec3d), value: wp.array(dtype=wp.float64), slope: wp.array(dtype=wp.vec3d),
             bend: wp.array(dtype=wp.mat33d)):  # fmt: skip
    i = wp.tid()
    found = read_field(field, points[i])
    value[i] = found.value
    slope[i] = found.slope
    bend[i] = found.bend


def readings(field: FieldGrid, points: Array) -> tuple[Array, Array, Array]:
    value, slope, bend = (wp.zeros(len(points), dtype=kind, device="cpu") for kind in (wp.float64, wp.vec3d, wp.mat33d))
    wp.launch(read_all, len(points), [field, wp.array(points, dtype=wp.vec3d, device="cpu"), value, slope, bend], device="cpu")
    return value.numpy(), slope.numpy(), bend.numpy()


def wedge(turned: float) -> tuple[np.ndarray, np.ndarray, object]:
    """A right edge along z = 0, turned about z: its direction, the way outward, and its distance."""
    angle = np.deg2rad(turned)
    out, along = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])

    def distance(points: Array) -> Array:
        u, w = points @ out, -points[:, 2]
        return np.where((u <= 0) & (w <= 0), np.maximum(u, w), np.hypot(np.maximum(u, 0), np.maximum(w, 0)))

    return along, out, distance


@pytest.mark.parametrize("shape", [name for name, row in SHAPES.items() if row.made != "file"])
def test_distances_are_those_to_fine_triangles(shape: str, rng: np.random.Generator) -> None:
    """By closed forms, and for reliefs and corners by triangles that are no smaller than they must be, whatever their size."""
    hollow = bool(outlines.bore(Body(shape=shape)))  # which counts as filled until the object is turned
    body = Body(shape=shape, rigid=True, height_mm=30.0, press_side="top" if hollow else "bottom")
    surface = shapes.object_surface(body, edge_length=0.4e-3, chord=1e-6)
    vertices = surface.vertices * 1e3
    mesh = wp.Mesh(points=wp.array(vertices.astype(np.float32), dtype=wp.vec3f, device="cpu"),
                   indices=wp.array(surface.faces.ravel(), dtype=wp.int32, device="cpu"), support_winding_number=True)  # fmt: skip
    points = rng.uniform(vertices.min(axis=0) - 1, vertices.max(axis=0) + 1, (2000, 3))
    found = wp.zeros(len(points), dtype=wp.float64, device="cpu")
    wp.launch(
        signed_distances, len(points), [mesh.id, wp.array(points, dtype=wp.vec3d, device="cpu"), wp.vec3d(), 1e3, found], device="cpu"
    )
    # chords of 1 µm, and single precision over 40 mm: 4e-6 mm
    assert np.abs(exact_distance(body)(points) - found.numpy()).max() < 1.3e-3


def test_sides_told_for_many_points_are_those_asked_one_by_one(rng: np.random.Generator) -> None:
    """Of a comb with sharp teeth on a thin plate; within a cube points lie inside, beside it and behind. One in four is asked at most."""
    comb = CrossSection([[(0, 0), (11 / 4, 0), *((x / 4, (x % 2) + 0.08) for x in range(11, -1, -1))]]).extrude(2.0).to_mesh()
    vertices, faces = comb.vert_properties[:, :3], comb.tri_verts
    mesh = wp.Mesh(points=wp.array(vertices, dtype=wp.vec3f, device="cpu"), indices=wp.array(faces.ravel(), dtype=wp.int32, device="cpu"),
                   support_winding_number=True)  # fmt: skip
    asked = []

    def signed(points: Array) -> Array:
        found = wp.zeros(len(points), dtype=wp.float64, device="cpu")
        places = wp.array(points, dtype=wp.vec3d, device="cpu")
        wp.launch(signed_distances, len(points), [mesh.id, places, wp.vec3d(), 1e3, found], device="cpu")
        asked.append(len(points))
        return found.numpy()

    points = rng.uniform(vertices.min(axis=0) - 0.3, vertices.max(axis=0) + 0.3, (50_000, 3))
    one_by_one = signed(points)
    asked.clear()
    assert (_signs(points, np.abs(one_by_one), lambda places: np.sign(signed(places))) == np.sign(one_by_one)).all()
    assert 0.3 < (one_by_one > 0).mean() < 0.9 and sum(asked) < len(points) / 4


def test_a_ball_is_met_to_nanometres(rng: np.random.Generator) -> None:
    """What is not taken back of the shrinking h²/6 · 2/R is the share (2h/R)²; twice that, for what the spline itself is off."""
    body = Body(shape="hemisphere", rigid=True, radius_mm=5.0)
    field = sampled(exact_distance(body), np.array([-4.0, -4.0, -1.0]), np.array([4.0, 4.0, 3.0]), SPACING)
    points = rng.uniform([-2, -2, -0.2], [2, 2, 1.0], (4000, 3))
    exact = np.linalg.norm(points - [0, 0, 5.0], axis=1) - 5.0
    near = np.abs(exact) < 2 * SPACING
    bound = 2 * SPACING**2 / 6 * (2 / 5.0) * (2 * SPACING / 5.0) ** 2
    assert np.abs(field(points) - exact)[near].max() < bound < 6e-6
    value, slope, bend = readings(field.grid("cpu"), points[near])
    assert np.abs(value - field(points[near])).max() < 1e-12
    outward = (points[near] - [0, 0, 5.0]) / np.linalg.norm(points[near] - [0, 0, 5.0], axis=1, keepdims=True)
    assert np.abs(slope - outward).max() < 1e-4
    assert np.abs(np.trace(bend, axis1=1, axis2=2) - 2 / np.linalg.norm(points[near] - [0, 0, 5.0], axis=1)).max() < 0.01


def test_slope_and_bend_are_the_derivatives(rng: np.random.Generator) -> None:
    """Against differences of the value itself, over a step whose own error is below the bound; a plane bends nowhere."""
    _, _, distance = wedge(17.0)
    field = sampled(distance, np.array([-2.0, -2.0, -1.0]), np.array([2.0, 2.0, 1.0]), SPACING)  # type: ignore[arg-type]
    points, step = rng.uniform(-0.3, 0.3, (500, 3)), 1e-5
    _, slope, bend = readings(field.grid("cpu"), points)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        (after, slope_after, _), (before, slope_before, _) = (readings(field.grid("cpu"), points + sign * shift) for sign in (1, -1))
        assert np.abs((after - before) / (2 * step) - slope[:, axis]).max() < 1e-6
        assert np.abs((slope_after - slope_before) / (2 * step) - bend[:, axis]).max() < 2e-2 * np.abs(bend).max()


@pytest.mark.parametrize("turned", [0.0, 17.0, 31.0, 45.0])
def test_an_edge_has_its_radius_whichever_way_it_lies(turned: float) -> None:
    along, out, distance = wedge(turned)
    field = sampled(distance, np.array([-2.0, -2.0, -1.0]), np.array([2.0, 2.0, 1.0]), SPACING)  # type: ignore[arg-type]
    inward = (np.array([0, 0, 1.0]) - out) / np.sqrt(2)
    aside = (np.array([0, 0, 1.0]) + out) / np.sqrt(2)
    places = np.linspace(-1, 1, 401)[:, None] * along
    recess = _recess(field, places, inward)
    assert recess.std() < 0.006 * SPACING
    off = 0.25 * SPACING
    beside = [_recess(field, places + sign * off * aside, inward) for sign in (1, -1)]
    radius = off**2 / (beside[0] + beside[1] - 2 * recess).mean()
    assert radius == pytest.approx(ROUNDING * SPACING, rel=0.05)
    assert 0.0 < recess.mean() < SPACING


def _recess(field: object, places: Array, inward: Array) -> Array:
    went = np.zeros(len(places))
    for _ in range(60):
        went += field(places + went[:, None] * inward)  # type: ignore[operator]  # falls by 0.7 to 1 a millimetre
    return went


def test_samples_at_points_alone_would_waver(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fault that means over cells are against: worst of four heights of the grid under an edge."""

    def worst() -> float:
        found = []
        for height in (0.0, 0.03, 0.07, 0.1):
            low, high = np.array([-1.5, -1.5, -0.5 + height]), np.array([1.5, 1.5, 0.6 + height])
            found.append(_recess(sampled(distance, low, high, SPACING), places, inward).std())  # type: ignore[arg-type]
        return max(found)

    along, out, distance = wedge(17.0)
    inward = (np.array([0, 0, 1.0]) - out) / np.sqrt(2)
    places = np.linspace(-0.9, 0.9, 401)[:, None] * along
    fair = worst()
    monkeypatch.setattr("gelsim.fem.field.CELL", np.zeros((1, 3)))
    assert fair < 0.006 * SPACING < 0.009 * SPACING < worst()


def star(tips: int = 5) -> trimesh.Trimesh:
    """A star with acute corners under a plate, of two bodies that overlap: closest points see the wrong flank of its tips."""
    angle = np.arange(2 * tips) * np.pi / tips
    outline = np.where(np.arange(2 * tips) % 2 == 0, 3.5, 1.5)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    relief = CrossSection([outline]).extrude(3.2).to_mesh()
    plate = trimesh.creation.box((10, 10, 4), trimesh.transformations.translation_matrix([0, 0, 5.0]))
    return trimesh.util.concatenate([trimesh.Trimesh(relief.vert_properties[:, :3], relief.tri_verts), plate])


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (4.0, -3.0)])
def test_acute_corners_touch_with_no_force_and_no_overlap(tmp_path: object, tilt: tuple[float, float]) -> None:
    """Closest points on faces had 0.5 to 0.8 mm of overlap in the plane, and up to 3 N, before anything touches."""
    path = f"{tmp_path}/star.stl"
    star().export(path)
    scene = build_scene({
        "fidelity": "fast", "object": {"shape": "mesh", "mesh": path, "rigid": True},
        "press": {"depth_mm": 0.2, "force_n": "none", "frames": 3, "tilt_deg": list(tilt)},
    })  # fmt: skip
    press = stages.press(scene)
    assert press.status is SolveStatus.CONVERGED
    assert press.force[0] == pytest.approx(0.0, abs=1e-9) and press.penetration[0] <= 2e-8
    assert (np.diff(-press.force[:, 2]) > 0).all() and press.penetration.max() < 40e-6


@pytest.mark.parametrize("body", [{"shape": "hemisphere"}, {"shape": "cone"}, {"shape": "box"}, {"shape": "torus"}, {"shape": "corner"}])
def test_touch_begins_where_the_surfaces_meet(body: dict[str, object]) -> None:
    """Placed, the field is nowhere negative on the gel; a micrometre lower it is."""
    scene = build_scene({"object": body | {"rigid": True}, "press": {"depth_mm": 0.3, "tilt_deg": [5.0, 12.0]}})
    turn, shift = rigid_placement(scene)
    field = distance_field(scene)
    x, y = np.meshgrid(np.linspace(-12, 12, 1201), np.linspace(-12, 12, 1201))
    places = np.column_stack([x.ravel(), y.ravel()])
    gel = np.column_stack([places, 1e3 * shapes.gel_height(scene.gel, places * 1e-3)])
    away = field((gel - 1e3 * shift) @ turn)
    nearest = gel[np.argsort(away)[:2000]]
    # a grid of 20 µm misses what touches by as much as (14 µm)²/2R at a point of R = 0.05 mm
    assert -2e-5 <= away.min() < 2e-3
    assert field((nearest - 1e3 * shift + [0.0, 0.0, 4e-3]) @ turn).min() < 0.0


def test_a_radius_that_is_given_is_taken() -> None:
    for given, expected in ((0.3, 0.3), (0.0, 0.04), (None, 0.1)):
        body = Body(shape="box", rigid=True, edge_radius_mm=given)
        assert spacing(body) == pytest.approx(expected / ROUNDING)
    assert outlines.edge_radius(Body(shape="shell", rigid=True, wall_mm=0.24)) == pytest.approx(0.06e-3)
