"""Shapes: closed, of the right volume, on the exact surface, placed so that they just touch; and files that are no solids."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gelsim.errors import SceneError
from gelsim.geometry import TriMesh, enclosed_volume, face_shape_functions, is_closed
from gelsim.mesh.inclusions import flesh, grain_centres
from gelsim.scene.definition import Body, Gel, Grains, Press, Scene, Skin
from gelsim.scene.layers import build_scene
from gelsim.shape.shapes import (
    gel_height,
    object_surface,
    placement,
    press_symmetry,
    project,
    rigid_surface,
    shape_symmetry,
    sharp_edges,
    solid,
)
from gelsim.shape.solids import Plane, solid_surface
from gelsim.views.inspection import inspect

PI = np.pi
DOME_RADIUS = (12.5**2 + 1.4**2) / 2.8  # mm, of the default dome: 1.4 mm deep at 12.5 mm


def cap(radius: float, rise: float) -> float:
    return PI * rise**2 * (radius - rise / 3)


def sagitta(radius: float, half: float) -> float:
    return radius - np.sqrt(radius**2 - half**2)


def segment(radius: float, half: float) -> float:
    """Area of the circular segment of half width `half`."""
    angle = np.arcsin(half / radius)
    return radius**2 * (angle - np.sin(angle) * np.cos(angle))


S30, S14 = sagitta(30, 12.5), sagitta(14, 12.5)
TOP = 5 + 25 / np.tan(np.radians(75))
# Volumes in mm³ by hand.
VOLUMES = [
    (Body(shape="hemisphere"), 2 / 3 * PI * 125 + PI * 25 * 20),
    (Body(shape="hemisphere", radius_mm=30), cap(30, S30) + PI * 12.5**2 * (25 - S30)),
    (Body(shape="hemisphere", radius_mm=14, height_mm=12), cap(14, S14) + PI * 12.5**2 * (12 - S14)),
    (Body(shape="hemisphere", radius_mm=25), 2 / 3 * PI * 25**3),
    (Body(shape="cylinder"), 25 * (PI * 25 / 2 + 10 * 20)),
    (Body(shape="cylinder", radius_mm=30), 25 * (segment(30, 12.5) + 25 * (25 - S30))),
    (Body(shape="cylinder", radius_mm=50, height_mm=1), 25 * segment(50, np.sqrt(99))),
    (Body(shape="cone"), PI * 125 / 3 + PI * 25 * 20),
    (Body(shape="cone", radius_mm=30, angle_deg=60, height_mm=10), PI / 3 * 10 * 100 / 3),
    (Body(shape="punch"), PI * 25 * 25),
    (Body(shape="frustum"), PI / 3 * 25 * (25 + 5 * TOP + TOP**2)),
    (Body(shape="edge"), 25 * (12.5**2 + 25 * 12.5)),
    (Body(shape="flat"), 25.0**3),
    (Body(shape="box"), 10 * 15 * 25.0),
]
BODIES = [body for body, _ in VOLUMES] + [Body(shape="corner"), Body(shape="corner", width_mm=3, height_mm=20)]


# Shapes that are not convex, or uneven below; volumes in mm³ by hand.
K5 = 2 * PI / 3 * 5  # of waves of 3 mm, half of a block of 10 mm across
MEAN = np.sin(K5) / K5  # of a cosine over the block
OTHERS = [
    # a ring of 25π - 16π, and a foot of 6 mm above it: 2 ∫ (25 - 5 - √(25 - x²)) dx to x = 3
    (Body(shape="tube"), 25 * (9 * PI + 2 * (60 - (6 + 12.5 * np.arcsin(0.6))))),
    (Body(shape="shell"), 2 / 3 * PI * (125 - 64) + PI * (25 - 16) * 20),
    (Body(shape="torus"), PI**2 * 5 * 1.25**2 + PI * 6.25**2 * (25 - 1.25)),
    (Body(shape="tomato"), 4 / 3 * PI * 125 - cap(5, 1) + PI * 9 * (25 - 9)),
    (Body(shape="wave"), 100 * (25 - 0.1 * (1 - MEAN))),
    (Body(shape="emboss"), 100 * (25 - 0.2 * (1 - (1 + MEAN) ** 2 / 4))),
]


@pytest.mark.parametrize("symmetry", ["", "x", "xy"])
@pytest.mark.parametrize(("body", "expected"), OTHERS, ids=[body.shape for body, _ in OTHERS])
def test_volumes_of_shapes_that_are_not_convex(body: Body, expected: float, symmetry: str) -> None:
    chord = 4e-6
    surface = object_surface(body, edge_length=4e-3, chord=chord, symmetry=frozenset(symmetry))
    assert is_closed(surface.faces)
    found = enclosed_volume(surface) * 1e9 * 2 ** len(symmetry)
    # as in test_volumes, but that chords of a hollow lie on its other side
    area = trimesh.Trimesh(surface.vertices, surface.faces, process=False).area * 2 ** len(symmetry)
    assert abs(found - expected) <= 4 / 3 * chord * area * 1e9
    assert surface.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-15)
    edges = sharp_edges(body)
    if body.shape in ("torus", "tomato"):  # creases point inward or lie at the base
        assert not len(edges)
    for axis in symmetry:
        assert surface.vertices[:, "xy".index(axis)].min() == 0.0


def test_a_soft_corner_is_round() -> None:
    """All of it is a radius away from the corner that lies so deep in the sharp one; nothing is sharp below, and the top stays."""
    sharp, body, radius = Body(shape="corner"), Body(shape="corner", edge_radius_mm=0.3), 0.3e-3
    surface = object_surface(body, edge_length=1e-3, chord=1e-6)
    assert is_closed(surface.faces)
    assert surface.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-12) and surface.vertices[:, 2].max() == pytest.approx(25e-3)
    assert (sharp_edges(sharp)[..., 2].min(axis=1) < 1e-6).any() and sharp_edges(body)[..., 2].min() > 5e-3  # where its sides begin
    low = surface.vertices[(np.abs(surface.vertices) < 4e-3).all(axis=1)]
    normals = np.array([p.normal for p in solid(sharp).patches[:3] if isinstance(p, Plane)])
    beyond = (low - [0.0, 0.0, radius]) @ normals.T  # of the corner within, which has its apex a radius up
    assert beyond.max() == pytest.approx(radius, abs=1e-9) and beyond.max(axis=1).min() > 0.5 * radius
    away = np.array([np.linalg.norm(p - nearest(p - [0, 0, radius], normals) - [0, 0, radius]) for p in low[::7]])
    assert away == pytest.approx(radius, abs=1e-9)
    halves = object_surface(body, edge_length=1e-3, chord=1e-6, symmetry=frozenset("x"))
    assert enclosed_volume(halves) * 2 == pytest.approx(enclosed_volume(surface), rel=1e-5)


def nearest(point: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Of the cone of what lies below three planes through the origin the point that is nearest, by quadratic programming in the dual."""
    from scipy.optimize import nnls

    pushed, _ = nnls(normals.T, point)  # Moreau: what is not of the cone is of its polar, which the normals span
    return point - normals.T @ pushed


def test_what_has_no_soft_rim_says_so() -> None:
    with pytest.raises(SceneError, match='edge_radius_mm = 0.2 mm: of soft shapes corner has one, shape = "box" none'):
        build_scene({"object": {"shape": "box", "edge_radius_mm": 0.2}})
    assert build_scene({"object": {"shape": "box", "edge_radius_mm": 0.2, "rigid": True}})


def test_a_tube_has_the_wall_it_says() -> None:
    body = Body(shape="tube", radius_mm=4, wall_mm=0.6, height_mm=12, length_mm=10)
    surface = object_surface(body, edge_length=2e-3, chord=2e-6)
    out = np.hypot(surface.vertices[:, 0], surface.vertices[:, 2] - 4e-3) * 1e3
    ring = (surface.vertices[:, 2] < 4e-3) & (np.abs(surface.vertices[:, 1]) < 5e-3)  # but the ends, flat between both
    bore, outside = ring & (out < 3.7), ring & (out > 3.7)
    assert bore.any() and outside.any()
    assert np.abs(out[bore] - 3.4).max() < 1e-9 and np.abs(out[outside] - 4.0).max() < 1e-9
    assert shape_symmetry(body) == {"x", "y"}


def test_rough_heights_are_band_limited_and_seeded() -> None:
    body = Body(shape="rough", amplitude_mm=0.15, wavelength_mm=2.0, height_mm=6)
    field = solid(body).patches[0]
    kx, ky, _, size = np.array(field.waves).T  # type: ignore[union-attr]
    lengths = 2 * PI / np.hypot(kx, ky) * 1e3
    assert 2.0 <= lengths.min() < 2.02 and 7.0 < lengths.max() <= 8.0
    assert (size**2).sum() / 2 == pytest.approx(0.15e-3**2, rel=1e-12)  # the variance of a sum of waves
    x = np.linspace(-5e-3, 5e-3, 801)
    z, slopes = field.heights(np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2))  # type: ignore[union-attr]
    # off the lowest point by half a step of 12.5 µm both ways: k² a ~ 1.5 mm⁻¹ of curvature lifts it by 0.06 µm
    assert 0.0 <= z.min() < 0.1e-6
    assert 0.5 * 0.15e-3 < z.std() < 2 * 0.15e-3
    h = 1e-8
    along, _ = field.heights(np.array([[1e-3 + h, 2e-3], [1e-3 - h, 2e-3]]))  # type: ignore[union-attr]
    assert field.heights(np.array([[1e-3, 2e-3]]))[1][0, 0] == pytest.approx((along[0] - along[1]) / (2 * h), rel=1e-6)  # type: ignore[union-attr]
    other = solid(replace(body, pattern_seed=1)).patches[0]
    assert other != field and solid(replace(body, shore_00=50.0)).patches[0] == field
    assert not shape_symmetry(body) and abs(slopes).max() < 5


# ---------------------------------------------------------------------------------------------------------------- what lies inside
SKIN = Skin(thickness_mm=0.5, shore_a=30)
FLESH = [  # volumes in mm³ by hand
    (Body(shape="hemisphere", skin=SKIN), 2 / 3 * PI * 4.5**3 + PI * 4.5**2 * 20),
    (Body(shape="cylinder", skin=SKIN), 24 * (PI * 4.5**2 / 2 + 9 * 20)),
    (Body(shape="box", skin=SKIN), 9 * 14 * 24.5),
    (Body(shape="cone", skin=SKIN), PI * 4.5**3 / 3 + PI * 4.5**2 * (25 - 4.5 - 0.5 * np.sqrt(2))),
    (Body(shape="edge", skin=SKIN), 24 * (12**2 + 24 * (25 - 12 - 0.5 * np.sqrt(2)))),
    # ball of 4.5 about z = 5, foot of 2.5 from where it leaves the ball
    (Body(shape="tomato", skin=SKIN), 4 / 3 * PI * 4.5**3 - cap(4.5, sagitta(4.5, 2.5)) + PI * 2.5**2 * (25 - 5 - np.sqrt(14.0))),
]


@pytest.mark.parametrize(("body", "expected"), FLESH, ids=[body.shape for body, _ in FLESH])
def test_flesh_lies_a_thickness_inside(body: Body, expected: float) -> None:
    vertices, faces, patch = solid_surface(flesh(body), 2e-3, 2e-6)
    area = trimesh.Trimesh(vertices, faces, process=False).area
    assert is_closed(faces)
    assert abs(enclosed_volume(TriMesh(vertices, faces)) * 1e9 - expected) <= 4 / 3 * 2e-6 * area * 1e9 + 1e-9 * expected
    role = np.array(flesh(body).roles)[patch]
    inside = np.unique(faces[role == "contact"])
    away = np.linalg.norm(project(body, vertices[inside]) - vertices[inside], axis=1)
    away = away[vertices[inside, 2] < 24e-3]  # nearer the base it is the base that is closest
    assert away.min() > 0.5e-3 - 1e-12
    assert np.median(away) == pytest.approx(0.5e-3, abs=1e-12)  # but at creases, farther


def test_a_skin_that_leaves_nothing_is_an_error() -> None:
    with pytest.raises(SceneError, match="object.skin.thickness_mm = 5 mm leaves nothing of the punch"):
        flesh(Body(shape="punch", skin=Skin(thickness_mm=5, shore_a=30)))


def test_grains_keep_their_distance() -> None:
    body = Body(shape="hemisphere", height_mm=12, grains=Grains(count=25, radius_mm=0.8, shore_a=45), skin=SKIN)
    centres = grain_centres(body)
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)[np.triu_indices(25, 1)]
    assert apart.min() > 2.25 * 0.8e-3
    away = np.linalg.norm(project(body, centres) - centres, axis=1)
    assert away[centres[:, 2] < 9e-3].min() > 0.5e-3 + 1.25 * 0.8e-3 - 1e-9 and away.min() > 1.25 * 0.8e-3 - 1e-9  # the base has no skin
    assert np.array_equal(centres, grain_centres(replace(body, grains=replace(body.grains, shore_a=60))))
    assert not np.array_equal(centres, grain_centres(replace(body, grains=replace(body.grains, seed=1))))
    assert not shape_symmetry(body)
    with pytest.raises(SceneError, match=r"object.grains.count = 500: only \d+ of radius 0.8 mm found room in the hemisphere"):
        grain_centres(replace(body, grains=replace(body.grains, count=500)))


def name(body: Body) -> str:
    return f"{body.shape}-{body.radius_mm:g}-{body.height_mm:g}"


@pytest.mark.parametrize("symmetry", ["", "x", "y", "xy"])
@pytest.mark.parametrize("body", BODIES, ids=name)
def test_surfaces_are_closed_and_cut_exactly(body: Body, symmetry: str) -> None:
    planes = frozenset(symmetry)
    if not planes <= shape_symmetry(body):
        pytest.skip("the shape has no such plane")
    surface = object_surface(body, edge_length=4e-3, chord=5e-5, symmetry=planes)
    assert is_closed(surface.faces)
    assert enclosed_volume(surface) > 0
    lowest, highest = surface.vertices[:, 2].min(), surface.vertices[:, 2].max()
    assert abs(lowest) < 1e-15 and highest == pytest.approx(body.height_mm * 1e-3, rel=1e-14)
    for axis in planes:
        assert surface.vertices[:, "xy".index(axis)].min() == 0.0
    edges = surface.vertices[surface.faces] - surface.vertices[np.roll(surface.faces, 1, axis=1)]
    assert np.linalg.norm(edges, axis=2).max() <= 4e-3 * (1 + 1e-12)


@pytest.mark.parametrize(("body", "expected"), VOLUMES, ids=[name(b) for b, _ in VOLUMES])
def test_volumes(body: Body, expected: float) -> None:
    surface = object_surface(body, edge_length=4e-3, chord=2e-6)
    # An inscribed facet lies at most the chord's sagitta below the shape at its edges, and 4/3 of it in the middle of a triangle.
    area = trimesh.Trimesh(surface.vertices, surface.faces, process=False).area
    missing = expected * 1e-9 - enclosed_volume(surface)
    assert -1e-12 * expected * 1e-9 <= missing <= 4 / 3 * 2e-6 * area


@pytest.mark.parametrize("body", BODIES, ids=name)
def test_projection_is_idempotent_and_never_farther_than_the_surface(body: Body) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-15e-3, -15e-3, -3e-3], [15e-3, 15e-3, 28e-3], (400, 3))
    on = project(body, points)
    assert np.abs(project(body, on) - on).max() < 1e-12  # a picometre: roundings of 1e-18 m, but a square root where planes meet
    vertices = object_surface(body, edge_length=2e-3).vertices
    assert np.abs(project(body, vertices) - vertices).max() < 1e-12
    nearest = np.linalg.norm(vertices[None] - points[:, None], axis=2).min(axis=1)
    assert (np.linalg.norm(on - points, axis=1) <= nearest + 1e-12).all()


def test_press_symmetry_follows_the_motion() -> None:
    def of(shape: str = "hemisphere", **press: object) -> set[str]:
        return set(press_symmetry(Scene(object=Body(shape=shape), press=Press(**press))))  # type: ignore[arg-type]

    assert of() == {"x", "y"}
    assert of(tilt_deg=(3.0, 0.0)) == {"x"}
    assert of(tilt_deg=(0.0, 3.0)) == {"y"}
    assert of(shear_mm=(0.5, 0.0)) == {"y"}
    assert of(offset_mm=(0.0, 1.0)) == {"x"}
    assert of(twist_deg=5.0) == of(symmetry="none") == set()
    assert of("corner") == {"x"}
    assert of("corner", shear_mm=(0.1, 0.0)) == set()


def test_rotation_keeps_the_plane_that_symmetry_names() -> None:
    scene = Scene(object=Body(shape="cylinder", rigid=True), press=Press(tilt_deg=(4.0, 0.0)))
    turn, _ = placement(scene, rigid_surface(scene, frozenset("x")))
    assert np.array_equal(turn @ [1.0, 0.0, 0.0], [1.0, 0.0, 0.0])


def test_gel_height_is_a_sphere_with_the_stated_thicknesses() -> None:
    gel = Gel()
    xy = np.array([[0.0, 0.0], [12.5e-3, 0.0], [0.0, -12.5e-3], [3e-3, 4e-3], [12.5e-3, 12.5e-3]])
    z = gel_height(gel, xy) * 1e3
    assert z[0] == 0.0
    assert z[1] == pytest.approx(-1.4, rel=1e-12) and z[2] == pytest.approx(-1.4, rel=1e-12)
    assert z[3] == pytest.approx(np.sqrt(DOME_RADIUS**2 - 25) - DOME_RADIUS, rel=1e-12)
    assert z[4] == pytest.approx(-2.4 + 0.5)  # the land in the corner, where the sphere lies 0.4 mm below the window
    assert not gel_height(Gel(profile="flat"), xy).any()


@pytest.mark.parametrize("offset", [(0.0, 0.0), (2.0, 1.0), (-7.0, 3.0)])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (6.0, -9.0)])
def test_a_ball_is_placed_where_two_spheres_touch(offset: tuple[float, float], tilt: tuple[float, float]) -> None:
    scene = Scene(object=Body(shape="hemisphere", rigid=True), press=Press(offset_mm=offset, tilt_deg=tilt))
    surface = rigid_surface(scene, frozenset())
    turn, shift = placement(scene, surface)
    centre = turn @ [0.0, 0.0, 5e-3] + shift
    reach = DOME_RADIUS + 5.0
    expected = np.sqrt(reach**2 - (centre[0] * 1e3) ** 2 - (centre[1] * 1e3) ** 2) - DOME_RADIUS
    # 0.2 µm is asked for; the six-node faces are within 0.05 µm of the ball (below) and the search within 0.01 µm.
    assert centre[2] * 1e3 == pytest.approx(expected, abs=0.06e-3)


@pytest.mark.parametrize("tilt", [2.0, -7.0])
def test_a_tilted_ball_rolls_on_a_flat_gel(tilt: float) -> None:
    scene = Scene(gel=Gel(profile="flat"), object=Body(shape="hemisphere", rigid=True), press=Press(tilt_deg=(tilt, 0.0)))
    turn, shift = placement(scene, rigid_surface(scene, frozenset("x")))
    # the ball's centre stays 5 mm above the gel; the apex, turned about, lies 5 mm (1 - cos) higher than the point that touches
    assert shift[2] == pytest.approx(5e-3 * (1 - np.cos(np.radians(tilt))), abs=0.06e-6)
    assert turn.T @ turn == pytest.approx(np.eye(3), abs=1e-15)


def test_a_tilted_block_touches_with_its_corner() -> None:
    scene = Scene(gel=Gel(profile="flat"), object=Body(shape="box", rigid=True), press=Press(tilt_deg=(3.0, 2.0)))
    turn, shift = placement(scene, rigid_surface(scene, frozenset()))
    corners = np.array([[i, j, 0.0] for i in (-5e-3, 5e-3) for j in (-7.5e-3, 7.5e-3)]) @ turn.T
    assert shift[2] == pytest.approx(-corners[:, 2].min(), abs=1e-15)


def test_beside_the_gel_is_an_error() -> None:
    scene = Scene(object=Body(shape="hemisphere", rigid=True, radius_mm=0.5), press=Press(offset_mm=(12.4, 0.0)))
    placement(scene, rigid_surface(scene, frozenset()))  # a sliver still lies over it
    surface = rigid_surface(scene, frozenset())
    away = type(surface)(surface.nodes + [30e-3, 0.0, 0.0], surface.faces)
    with pytest.raises(SceneError, match="press.offset_mm"):
        placement(scene, away)


@pytest.mark.parametrize("body", BODIES, ids=name)
def test_rigid_surfaces_lie_on_the_shape_between_their_nodes(body: Body) -> None:
    scene = Scene(object=Body(**{**vars(body), "rigid": True}), press=Press(depth_mm=0.5))
    surface = rigid_surface(scene, frozenset())
    inside = np.random.default_rng(2).dirichlet(np.ones(3), 4)
    points = np.einsum("qn,fni->fqi", face_shape_functions(inside), surface.nodes[surface.faces]).reshape(-1, 3)
    low = points[:, 2] < 0.75e-3
    off = np.linalg.norm(project(scene.object, points[low]) - points[low], axis=1)
    # A quadratic misses an arc by its third derivative, 3 r/R³ · h³ √3/216 = 7 nm for h = 0.25 mm, R = 5 mm, r = 3 mm: three times that
    # for faces that are no symmetric pieces of it. Round a cone's tip the hull's 15 degrees rule: r θ³ √3/216 = 0.11 µm at r = 0.75 mm.
    assert off.max() < (0.33e-6 if body.shape == "cone" else 21e-9)
    edges = surface.nodes[surface.faces[:, :3]] - surface.nodes[np.roll(surface.faces[:, :3], 1, axis=1)]
    near = (surface.nodes[surface.faces[:, :3]] ** 2).sum(axis=2).max(axis=1) < 0.5e-3**2
    assert np.linalg.norm(edges[near], axis=2).max() <= 0.25e-3 * (1 + 1e-12)


def test_half_of_a_rigid_surface_is_half_of_the_whole() -> None:
    scene = Scene(object=Body(shape="punch", rigid=True))
    quarter = rigid_surface(scene, frozenset("xy"))
    assert quarter.nodes[:, :2].min() == 0.0
    area = trimesh.Trimesh(quarter.nodes, quarter.faces[:, :3], process=False).area
    assert area == pytest.approx((PI * 25 + 2 * PI * 5 * 25) / 4 * 1e-6, rel=1e-3)  # chords of 15 degrees or 0.25 mm: 1 - cos(h/2R)


def test_frustum_angle_is_bounded() -> None:
    with pytest.raises(SceneError, match=r"object.angle_deg = 30°: allowed for a frustum is 45 … 90°"):
        Scene(object=Body(shape="frustum", angle_deg=30.0))
    for angle in (45.0, 90.0):
        Scene(object=Body(shape="frustum", angle_deg=angle))


# ---------------------------------------------------------------------------------------------------------------- files
def part(tmp_path: Path, mesh: trimesh.Trimesh, kind: str = "stl") -> str:
    path = tmp_path / f"part.{kind.split('_')[0]}"
    mesh.export(path, file_type=kind)
    return str(path)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply", "off", "glb"])
def test_a_file_lands_with_its_lowest_point_at_the_origin(tmp_path: Path, kind: str) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=4.0)
    mesh.apply_translation([30.0, -20.0, 7.0])
    mesh.invert()  # inside out: turned back
    surface = object_surface(Body(shape="mesh", mesh=part(tmp_path, mesh, kind)), edge_length=1.0)
    assert is_closed(surface.faces)
    # STL stores float32: 30 mm to 2 nm
    assert surface.vertices.min(axis=0) == pytest.approx([-4e-3, -4e-3, 0.0], abs=5e-9)
    assert enclosed_volume(surface) == pytest.approx(abs(mesh.volume) * 1e-9, rel=1e-5)


def test_units(tmp_path: Path) -> None:
    mesh = trimesh.creation.box([0.01, 0.01, 0.02])  # metres
    path = part(tmp_path, mesh)
    with pytest.raises(SceneError, match=r'0.01 x 0.01 x 0.02 mm when read in mm; allowed: 0.5 to 100 mm .*mesh_unit = "(cm|m|in)"'):
        object_surface(Body(shape="mesh", mesh=path), edge_length=1.0)
    surface = object_surface(Body(shape="mesh", mesh=path, mesh_unit="m"), edge_length=1.0)
    assert enclosed_volume(surface) == pytest.approx(2e-6, rel=1e-5)


def test_what_is_no_solid(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=4.0)
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    cases = {
        "is not closed": part(tmp_path, mesh),
        "cannot be read": str(tmp_path / "missing.stl"),
        "no STL, OBJ, PLY, OFF or GLB": str(tmp_path / "part.blend"),
    }
    Path(cases["no STL, OBJ, PLY, OFF or GLB"]).write_bytes(b"x")
    (tmp_path / "noise.ply").write_bytes(b"\x00\x01 not a mesh")
    cases["cannot be read as PLY"] = str(tmp_path / "noise.ply")
    for message, path in cases.items():
        with pytest.raises(SceneError, match=message) as caught:
            object_surface(Body(shape="mesh", mesh=path), edge_length=1.0)
        assert "\n" not in str(caught.value) and "object.mesh" in str(caught.value) and "allowed" in str(caught.value)


def block(extent: float, x: float = 0.0, *, inward: bool = False) -> trimesh.Trimesh:
    mesh = trimesh.creation.box([extent] * 3)
    mesh.apply_translation([x, 0.0, 0.0])
    if inward:
        mesh.invert()
    return mesh


BODIES = {  # with what is filled [mm³] and what is noted
    "that touch": ([block(4), block(3, 3.5)], 91.0, []),
    "that overlap": ([block(4), block(4, 3.0)], 112.0, ["the sum of their volumes is 16 mm³ more"]),
    "around a cavity, a ball loose in it": ([block(6), block(4, inward=True), block(2)], 160.0, []),
    "inside one": ([block(6), block(4)], 216.0, ["4 x 4 x 4 mm lies in another"]),
    "inside out beside one": ([block(6), block(4, 6.0, inward=True)], 216.0, ["4 x 4 x 4 mm is inside out"]),
    "over a cavity": ([block(6), block(4, inward=True), block(3, 2.5)], 170.0, ["the sum of their volumes is 9 mm³ more"]),
}


@pytest.mark.parametrize("name", BODIES)
def test_bodies_of_a_file_are_counted_as_they_are_filled(name: str, tmp_path: Path) -> None:
    bodies, expected, noted = BODIES[name]
    facts = inspect(Path(part(tmp_path, trimesh.util.concatenate(bodies))))
    assert facts["volume_mm3"] == pytest.approx(expected, rel=1e-6)
    notes = facts.get("notes", [])
    assert len(notes) == len(noted) and all(text in note for text, note in zip(noted, notes, strict=True))


def test_a_fine_file_is_thinned_within_its_tolerance(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=5.0)
    surface = object_surface(Body(shape="mesh", mesh=part(tmp_path, mesh)), edge_length=1.0)
    assert len(surface.faces) < 81_920 / 3 and is_closed(surface.faces)
    radius = np.linalg.norm(surface.vertices - [0, 0, 5e-3], axis=1)
    assert np.abs(radius - 5e-3).max() < 6e-6  # 5 µm and the icosphere's own chord of 0.5 µm
