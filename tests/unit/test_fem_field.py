"""Rigid objects as signed distances: right where they are smooth, round at edges, and the same along an edge whichever way it lies."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from manifold3d import CrossSection
from numpy.typing import NDArray

from gelsim.errors import SolveStatus
from gelsim.fem import field as field_module
from gelsim.fem import quiet_warp, rigid_placement
from gelsim.fem.field import (
    CUT_MM,
    ROUNDING,
    FieldGrid,
    _signs,
    distance_field,
    exact_distance,
    opened,
    read_field,
    rim_radius,
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


def wedge(turned: float, angle: float = 90.0) -> tuple[Array, Array, field_module.Distance]:
    """An edge along z = 0, turned about z, of two planes: its direction, their normals (2, 3) at an angle, its distance."""
    azimuth = np.deg2rad(turned)
    out, along = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    down, half = (out - [0.0, 0.0, 1.0]) / np.sqrt(2), np.deg2rad(angle) / 2
    normals = np.array([np.cos(half) * down + sign * np.sin(half) * np.cross(along, down) for sign in (1, -1)])

    def distance(points: Array) -> tuple[Array, Array]:
        heights = points @ normals.T
        nearer = heights.argmax(axis=1)
        across = points - (points @ along)[:, None] * along
        away = np.linalg.norm(across, axis=1)
        # beside both planes' feet, which end at the edge
        corner = (heights - np.cos(2 * half) * heights[:, ::-1] > 0.0).all(axis=1) & (heights.max(axis=1) > 0.0)
        slope = np.where(corner[:, None], across / np.maximum(away, 1e-12)[:, None], normals[nearer])
        return np.where(corner, away, heights.max(axis=1)), slope

    return along, normals, distance


def fillet(normals: Array, radius: float, count: int = 21) -> tuple[Array, Array]:
    """Points on the arc of a radius that touches both planes, and its normals there."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    outward = share * normals[0] + (1.0 - share) * normals[1]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    centre = -radius * normals.sum(axis=0) / (1.0 + normals[0] @ normals[1])
    return centre + radius * outward, outward


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
    value, slope = exact_distance(body)(points)
    assert np.abs(value - found.numpy()).max() < 1.3e-3
    assert np.abs(np.linalg.norm(slope, axis=1) - 1.0).max() < 1e-6
    # the closest point: by closed form; on slivers 30 mm long, as beside a wave, single precision finds it to 1e-4 of their length
    closest = 1e-9 if shapes.has_profile(body) else 3e-3
    assert np.abs(exact_distance(body)(points - value[:, None] * slope)[0]).max() < closest


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
    field = sampled(exact_distance(body), np.array([-4.0, -4.0, -1.0]), np.array([4.0, 4.0, 3.0]), SPACING, 0.1)
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
    field = sampled(distance, np.array([-2.0, -2.0, -1.0]), np.array([2.0, 2.0, 1.0]), SPACING, ROUNDING * SPACING)
    points, step = rng.uniform(-0.3, 0.3, (500, 3)), 1e-5
    _, slope, bend = readings(field.grid("cpu"), points)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        (after, slope_after, _), (before, slope_before, _) = (readings(field.grid("cpu"), points + sign * shift) for sign in (1, -1))
        assert np.abs((after - before) / (2 * step) - slope[:, axis]).max() < 1e-6
        assert np.abs((slope_after - slope_before) / (2 * step) - bend[:, axis]).max() < 2e-2 * np.abs(bend).max()


def outside(turned: float, angle: float, radius: float, spacing: float) -> Array:
    """How far a field's surface lies outside an exact fillet: at places along the edge, and around it [mm]."""
    along, normals, distance = wedge(turned, angle)
    field = sampled(distance, np.array([-1.5, -1.5, -1.0]), np.array([1.5, 1.5, 1.0]), spacing, radius)
    points, outward = fillet(normals, radius)
    places = (np.linspace(-0.7, 0.7, 141)[:, None, None] * along + points).reshape(-1, 3)
    ways = np.tile(outward, (141, 1))
    went = np.zeros(len(places))
    for _ in range(60):
        went -= field(places + went[:, None] * ways)  # which rises by 0.5 to 1 a millimetre
    return went.reshape(141, -1)


@pytest.mark.parametrize("turned", [0.0, 17.0, 31.0, 45.0])
@pytest.mark.parametrize("angle", [60.0, 90.0, 120.0])
def test_an_edge_is_an_exact_fillet_whichever_way_it_lies(turned: float, angle: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A spline takes h²/6 Δf/|∇f| off. Taken back, half of that is left where Δf jumps, at most: at the arc's ends, where
    f = (y - √(r² - x²)) cos becomes a plane, from 1/(r cos²) of half the angle."""
    radius = 3 * SPACING
    bound = SPACING**2 / (12 * radius * np.cos(np.deg2rad(angle / 2)) ** 2)
    assert np.abs(outside(turned, angle, radius, SPACING)).max() < bound < 0.04 * radius
    # planted: the sharp edge, rounded by the spline alone
    monkeypatch.setattr(field_module, "opened", lambda distance, points, radius: distance(points)[0])
    assert np.abs(outside(turned, angle, radius, SPACING)).max() > 4 * bound


@pytest.mark.parametrize("turned", [0.0, 17.0, 31.0, 45.0])
def test_the_sharpest_edge_is_straight(turned: float) -> None:
    """That of ROUNDING spacings: it keeps some of the spline's shrinking, and wavers by no more than teeth of a micrometre at 0.1 mm."""
    radius = ROUNDING * SPACING
    away = outside(turned, 90.0, radius, SPACING)
    assert away[:, 10].std() < 0.01 * radius
    assert -(SPACING**2) / (6 * radius) < away.mean() < 0.0


def test_a_corner_is_a_ball(rng: np.random.Generator) -> None:
    """Of three planes; each of its points has a radius to the place where all three are as deep."""
    normals = np.linalg.qr(rng.standard_normal((3, 3)))[0]

    def distance(points: Array) -> tuple[Array, Array]:
        heights = points @ normals.T  # inside
        return heights.max(axis=1), normals[heights.argmax(axis=1)]

    outward = np.abs(rng.standard_normal((200, 3)))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.abs(opened(distance, 0.1 * (outward - 1.0) @ normals, 0.1)).max() < CUT_MM


def test_thin_walls_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 0.1 mm at a radius of 0.1: their rims have half the thickness. One that narrows by 8 degrees would go."""

    def wall(points: Array, lean: float = 0.0) -> tuple[Array, Array]:
        """Between two planes that lean, below z = 0."""
        normals = np.array([[np.cos(lean), 0.0, np.sin(lean)], [-np.cos(lean), 0.0, np.sin(lean)], [0.0, 0.0, 1.0]])
        heights = points @ normals.T - [0.05, 0.05, 0.0]
        return heights.max(axis=1), normals[heights.argmax(axis=1)]

    rim = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.05, 0.0, -0.2]])
    # a round of radius t/2 touches its top and sides; its corner is t/2 (sqrt(2) - 1) outside it
    expected = [0.0, 0.05 * (np.sqrt(2) - 1), 0.0]
    assert opened(wall, rim, 0.1) == pytest.approx(expected, abs=CUT_MM)
    leaning = lambda points: wall(points, np.deg2rad(4.0))  # noqa: E731
    assert opened(leaning, rim[:1], 0.1) == pytest.approx([0.0], abs=5e-3)
    monkeypatch.setattr(field_module, "LEAST", 0.0)
    assert opened(leaning, rim[:1], 0.1)[0] > 0.02


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
    for given, expected in ((0.6, 0.2), (0.3, 0.1 / ROUNDING), (0.0, 0.04 / ROUNDING), (None, 0.1 / ROUNDING)):
        body = Body(shape="box", rigid=True, edge_radius_mm=given)
        assert spacing(body) == pytest.approx(expected)
        assert rim_radius(body, spacing(body)) == pytest.approx(0.1 if given is None else max(given, 0.04))
    assert outlines.edge_radius(Body(shape="shell", rigid=True, wall_mm=0.24)) == pytest.approx(0.06e-3)


def test_a_default_radius_is_one_that_faces_can_follow() -> None:
    box, given = Body(shape="box", rigid=True), Body(shape="box", rigid=True, edge_radius_mm=0.1)
    assert [1e3 * outlines.edge_radius(body, "fast") for body in (box, given)] == pytest.approx([0.2, 0.1])
    assert 1e3 * outlines.edge_radius(box, "reference") == pytest.approx(0.1) and spacing(box, "fast") == pytest.approx(0.1 / ROUNDING)
    thin, sharp = Body(shape="box", rigid=True, width_mm=0.6), Body(shape="punch", rigid=True)
    assert [1e3 * outlines.edge_radius(body, "fast") for body in (thin, sharp)] == pytest.approx([0.15, 0.0])
