"""Meshes of the object: whole, graded, on the exact shape, grouped, cached; and what cannot be filled."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mesh_fixtures import QUIET, assert_whole, scene

from gelsim.errors import MeshingError, SceneError
from gelsim.geometry import (
    TriMesh,
    enclosed_volume,
    interface_faces,
    region_volumes,
    volume,
)
from gelsim.mesh import body_mesh
from gelsim.mesh.body_mesh import mesh_object, mesh_report
from gelsim.mesh.inclusions import flesh
from gelsim.mesh.sizing import OBJECT_COARSER, OBJECT_COARSEST, SIZES, Footprint, SizeField, object_edge
from gelsim.scene.definition import Body, Gel, Grains, Press, Scene, Skin
from gelsim.scene.materials import parts
from gelsim.shape.shapes import object_surface, project, shape_symmetry, solid
from gelsim.shape.solids import patch_distances


@pytest.fixture(scope="session")
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def cache(_cache: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("GELSIM_CACHE", str(_cache))
    yield _cache / "meshes"


Wanted = Callable[[Scene], SizeField]


@pytest.fixture
def wanted(monkeypatch: pytest.MonkeyPatch) -> Wanted:
    """The sizes that an object is to be filled with; nothing is filled."""

    class _Enough(Exception):
        """What was to be filled is all that is asked for."""

    def fill(domain: object, field: SizeField, *_: object) -> None:
        raise _Enough(field)

    def of(given: Scene) -> SizeField:
        with pytest.raises(_Enough) as asked:
            mesh_object(given, progress=QUIET)
        return asked.value.args[0]

    monkeypatch.setattr(body_mesh, "_cached_fill", fill)
    return of


OBJECTS = [  # volume in mm³ by hand, of shapes 12 mm tall
    ("hemisphere", 2 / 3 * np.pi * 125 + np.pi * 25 * 7),
    ("cylinder", 25 * (np.pi * 25 / 2 + 10 * 7)),
    ("cone", np.pi * 125 / 3 + np.pi * 25 * 7),
    ("punch", np.pi * 25 * 12),
    ("edge", 25 * 12.0**2),  # cut at the base before its flanks reach their width
    ("box", 10 * 15 * 12.0),
    ("corner", None),
]


@pytest.mark.parametrize(("shape", "expected"), OBJECTS, ids=[o[0] for o in OBJECTS])
def test_objects(shape: str, expected: float | None) -> None:
    mesh = mesh_object(scene(shape), frozenset("x"), QUIET)
    assert mesh.symmetry == {"x"}
    assert set(mesh.groups) == {"base", "contact"}
    assert_whole(mesh)
    base = mesh.surface("base").nodes
    assert (base[:, 2] == 12e-3).all()
    skin = mesh.surface("contact").nodes
    off = np.linalg.norm(project(Body(shape=shape, height_mm=12.0), skin) - skin, axis=1)
    assert np.median(off) < 1e-12
    # Vertices lie on the shape to rounding; a middle that would fold a tet is bent less.
    vertex = np.unique(mesh.groups["contact"][:, :3])
    p = mesh.rest_positions[vertex]
    assert np.linalg.norm(project(Body(shape=shape, height_mm=12.0), p) - p, axis=1).max() < 1e-9
    if expected is not None:
        # Curved faces: a six-node arc of angle θ is off by R θ⁴/2000 or less; θ <= 1 here, 0.25 % of R over the curved part of the skin.
        assert volume(mesh) * 2e9 == pytest.approx(expected, rel=2.5e-3 if shape in ("hemisphere", "cylinder", "cone", "punch") else 1e-9)


def test_a_round_corner_is_filled() -> None:
    body = Body(shape="corner", height_mm=12.0, edge_radius_mm=0.3)
    mesh = mesh_object(Scene(object=body, gel=Gel(profile="flat"), press=Press(depth_mm=0.5), fidelity="fast"), frozenset("x"), QUIET)
    assert_whole(mesh)
    vertex = mesh.rest_positions[np.unique(mesh.groups["contact"][:, :3])]
    assert patch_distances(solid(body, frozenset("x")).patches, vertex).min(axis=1).max() < 1e-9
    surface = object_surface(body, edge_length=1e-3, chord=1e-6)
    # arcs of 0.3 mm under edges of about as much: the tip is off by a tenth of the radius
    assert 2 * volume(mesh) == pytest.approx(enclosed_volume(surface), rel=1e-3) and mesh.rest_positions[:, 2].min() < 0.05e-3


def test_a_skin_and_its_flesh_meet_on_the_exact_interface() -> None:
    body = Body(shape="hemisphere", height_mm=10.0, skin=Skin(thickness_mm=1.0, shore_a=30))
    given = Scene(object=body, gel=Gel(profile="flat"), press=Press(depth_mm=0.5), fidelity="fast")
    mesh = mesh_object(given, frozenset("xy"), QUIET)
    assert_whole(mesh)
    inside = 2 / 3 * np.pi * 4**3 + np.pi * 4**2 * 5
    outside = 2 / 3 * np.pi * 5**3 + np.pi * 5**2 * 5
    volumes = mesh_report(mesh, parts(body))["volume_mm3"]
    # curved faces as in test_objects; a skin is a difference
    assert volumes["body"] == pytest.approx(inside, rel=2.5e-3)  # type: ignore[index]
    assert volumes["skin"] == pytest.approx(outside - inside, abs=2.5e-3 * (outside + inside))  # type: ignore[index]
    faces = interface_faces(mesh.tets, mesh.regions == 0)
    vertex = mesh.rest_positions[np.unique(faces[:, :3])]
    assert len(vertex) > 20
    patches = [p for p, role in zip(flesh(body).patches, flesh(body).roles, strict=True) if role == "contact"]
    assert patch_distances(tuple(patches), vertex).min(axis=1).max() < 1e-9
    middle = mesh.rest_positions[np.unique(faces)]
    assert np.median(patch_distances(tuple(patches), middle).min(axis=1)) < 1e-12
    whole = mesh_object(given, frozenset(), QUIET)
    assert region_volumes(whole) == pytest.approx(4 * region_volumes(mesh), rel=1e-12)
    again, told = mesh_object(given, frozenset("xy"), QUIET), []
    assert np.array_equal(again.regions, mesh.regions) and not told  # from the cache


@pytest.mark.slow
def test_grains_are_balls_in_the_mesh() -> None:
    body = Body(shape="candy", height_mm=8.0, width_mm=6.0, length_mm=6.0, grains=Grains(count=4, shore_a=45))
    mesh = mesh_object(Scene(object=body, gel=Gel(profile="flat"), press=Press(depth_mm=0.5), fidelity="fast"), frozenset(), QUIET)
    assert_whole(mesh)
    volumes = region_volumes(mesh) * 1e9
    # six-node faces of edges of a radius (θ ~ 1): θ⁴/2000 of the radius inside, three times that in volume, as of curved faces above
    assert volumes[1] == pytest.approx(4 * 4 / 3 * np.pi, rel=7.5e-3)
    # all that there is, by its flat outside: the rule of the volumes is not exact in curved tets, 1e-8 of the sum
    outside = np.vstack([mesh.groups["base"], mesh.groups["contact"]])[:, :3]
    assert enclosed_volume(TriMesh(mesh.rest_positions, outside)) * 1e9 == pytest.approx(288.0, rel=1e-12)


CASES = [Body(shape="tube", height_mm=12, length_mm=10), Body(shape="shell", height_mm=9), Body(shape="torus", height_mm=5)]
CASES += [Body(shape="tomato", height_mm=12), Body(shape="wave", height_mm=5), Body(shape="emboss", height_mm=5)]
CASES += [Body(shape="rough", height_mm=5, width_mm=6, length_mm=6)]


@pytest.mark.slow
@pytest.mark.parametrize("body", CASES, ids=[body.shape for body in CASES])
def test_shapes_that_are_not_convex_are_filled(body: Body) -> None:
    symmetry = shape_symmetry(body)
    given = Scene(object=body, gel=Gel(profile="flat"), press=Press(depth_mm=0.5), fidelity="fast")
    mesh = mesh_object(given, symmetry, QUIET)
    assert_whole(mesh)
    surface = object_surface(body, edge_length=2e-3, chord=1e-6)
    area = trimesh.Trimesh(surface.vertices, surface.faces, process=False).area
    # within a micrometre of facets all over; curved faces of edges of a fifth of a wave or a wall: 2 µm of the mesh
    assert volume(mesh) * 2 ** len(symmetry) == pytest.approx(enclosed_volume(surface), abs=3e-6 * area)
    vertex = mesh.rest_positions[np.unique(mesh.groups["contact"][:, :3])]
    assert patch_distances(solid(body, symmetry).patches, vertex).min(axis=1).max() < 1e-9


def test_the_apex_is_a_node() -> None:
    """Of pointed shapes the tip must survive, or the first touch is late."""
    for shape in ("cone", "edge", "corner"):
        mesh = mesh_object(scene(shape), frozenset("x"), QUIET)
        assert mesh.rest_positions[:, 2].min() == pytest.approx(0.0, abs=1e-12)


def test_contact_on_one_side_is_meshed_there_alone() -> None:
    """Beside the middle there is no mirror image of what is fine."""
    tilted = scene("cylinder", "flat", depth_mm=0.4, tilt_deg=(8.0, 0.0))
    body = mesh_object(tilted, frozenset("x"), QUIET)
    assert_whole(mesh_object(tilted, frozenset(), QUIET))
    low = body.rest_positions[np.unique(body.groups["contact"])]
    low = low[low[:, 2] < 1e-3]
    ends = int((low[:, 1] > 5e-3).sum()), int((low[:, 1] < -5e-3).sum())
    assert max(ends) > 2 * min(ends)


def test_an_object_is_fine_where_its_press_begins(wanted: Wanted) -> None:
    given = replace(scene("hemisphere", "flat", depth_mm=1.0), fidelity="balanced")
    centred, beside, tilted = (
        wanted(given.replace(press=replace(given.press, **moved))) for moved in ({}, {"offset_mm": (2.0, 0.0)}, {"tilt_deg": (0.0, 20.0)})
    )
    apex, lowest = np.zeros(3), np.array([5e-3 * np.sin(np.radians(20.0)), 0.0, 5e-3 * (1 - np.cos(np.radians(20.0)))])
    assert centred(apex) < 0.9 * centred.contact and tilted(lowest) < 0.9 * tilted.contact
    assert centred(lowest) > 0.95 * centred.contact and tilted(apex) > 0.95 * tilted.contact
    assert beside.settings() == centred.settings(), "an offset needs no new mesh"


def test_background_mesh_fills_its_box_and_carries_the_field() -> None:
    field = SizeField((0.0, 0.0, -1e-3), (2e-3, 3e-3, 0.0), 0.4e-3, 0.6, 3e-3)
    lower, upper = np.array([-1e-3, -1e-3, -3e-3]), np.array([13e-3, 13e-3, 1e-3])
    points, tets, values = field.background(lower, upper)
    corners = points[tets]
    signed = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 3] - corners[:, 0])
    assert np.abs(signed).sum() / 6 == pytest.approx(np.prod(upper - lower), rel=1e-12) and np.abs(signed).min() > 0
    assert values.min() == 0.4e-3 and values.max() <= 3e-3
    assert np.array_equal(values, field(points))


def test_cache_returns_the_same_mesh_and_mends_itself(cache: Path) -> None:
    given, told = scene("hemisphere"), []
    first = mesh_object(given, frozenset(), QUIET)
    again = mesh_object(given, frozenset(), told.append)
    assert not told
    assert np.array_equal(first.rest_positions, again.rest_positions) and np.array_equal(first.tets, again.tets)
    assert all(np.array_equal(first.groups[name], again.groups[name]) for name in first.groups)
    kept = {path: path.read_bytes() for path in cache.glob("*.npz")}
    other = mesh_object(given, frozenset(), told.append, drawn_before=1)
    assert len(told) == 1 and len(list(cache.glob("*.npz"))) == len(kept) + 1  # filled anew, and kept beside the first
    assert np.array_equal(mesh_object(given, drawn_before=1).rest_positions, other.rest_positions)
    assert np.array_equal(mesh_object(given).rest_positions, first.rest_positions)
    assert not list(cache.glob("*.part"))
    assert not list(cache.rglob("*.partial"))
    for damage in (lambda raw: raw[: len(raw) // 2], lambda raw: b"", lambda raw: raw[:200] + b"\xff" * 64 + raw[264:]):
        for path, raw in kept.items():
            path.write_bytes(damage(raw))
        told.clear()
        mended = mesh_object(given, frozenset(), told.append)
        assert len(told) == 1 and "object" in told[0]
        assert_whole(mended)
    assert not list(Path.cwd().glob("__tracked_surface*"))  # what fTetWild leaves in its working folder


def test_fast_presses_of_nearly_the_same_depth_share_an_objects_mesh(wanted: Wanted) -> None:
    """Both contacts, of radius √(2 R d), are of one class; so are the halves of both depths, 0.725 and 0.75 mm."""
    fast, balanced, other_fast, other_balanced = (
        wanted(replace(scene("hemisphere", depth_mm=depth), fidelity=fidelity))
        for depth in (1.45, 1.5)
        for fidelity in ("fast", "balanced")
    )
    assert fast.settings() == other_fast.settings() and fast.high[2] == pytest.approx(0.85e-3)
    assert balanced.settings() != other_balanced.settings()


def test_an_object_with_much_in_contact_is_coarser_at_fast() -> None:
    """A gel edge of 1 mm: 8 mm³ to be meshed finely want 1.3 mm, 1,600 are 400 cubes of 1.59 mm, 16,000 would be of 3.4."""

    def edge(half: float, depth: float, most: float, **area: object) -> float:
        return object_edge(Footprint((0.0, 0.0), (half, half), 1.0, **area), depth, 1e-3, most)  # type: ignore[arg-type]

    most = SIZES["fast"].most_cubes
    assert edge(2e-3, 0.5e-3, most) == pytest.approx(OBJECT_COARSER * 1e-3)
    assert edge(10e-3, 4e-3, most) == pytest.approx(np.cbrt(1600 / most) * 1e-3)
    assert edge(10e-3, 4e-3, most, side=(1, -1)) == pytest.approx(OBJECT_COARSER * 1e-3), "a quarter of the volume"
    assert edge(20e-3, 10e-3, most) == pytest.approx(OBJECT_COARSEST * 1e-3)
    for finer in ("balanced", "reference"):
        assert edge(20e-3, 10e-3, SIZES[finer].most_cubes) == pytest.approx(OBJECT_COARSER * 1e-3)


def test_dots_keep_their_edges_where_ridges_give_some_up(wanted: Wanted) -> None:
    asked = []
    for shape in ("wave", "emboss"):
        body = Body(shape=shape, shore_00=30.0, wavelength_mm=2.0, amplitude_mm=0.5)
        asked.append(wanted(Scene(object=body, press=Press(depth_mm=3.0), fidelity="fast")).contact)
    gel = 2e-3 / SIZES["fast"].divisions
    assert asked == pytest.approx([OBJECT_COARSEST * gel, OBJECT_COARSER * gel])


def test_a_cache_that_cannot_be_written_is_said_and_survived(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("GELSIM_CACHE", str(tmp_path / "file"))
    told: list[str] = []
    assert_whole(mesh_object(scene("hemisphere"), frozenset("xy"), told.append))
    assert "not kept" in told[-1]


def test_a_change_of_stiffness_or_pose_needs_no_new_mesh() -> None:
    given, told = scene("hemisphere"), []
    mesh_object(given, frozenset(), QUIET)
    softer = given.replace(object=replace(given.object, shore_00=70.0), press=Press(offset_mm=(2.0, 0.0), tilt_deg=(1.0, 0.0)))
    mesh_object(softer, frozenset("x"), told.append)
    assert not told


def test_a_file_is_meshed_on_its_facets(tmp_path: Path) -> None:
    path = tmp_path / "block.stl"
    block = trimesh.creation.box([8.0, 6.0, 10.0])
    trimesh.boolean.difference([block, trimesh.creation.cylinder(1.5, 12.0)]).export(path)
    given = Scene(object=Body(shape="mesh", mesh=str(path)), fidelity="fast")
    mesh = mesh_object(given, frozenset(), QUIET)
    assert_whole(mesh)
    # 1.5 mm hole: fTetWild may move the surface by a twentieth of the contact edge
    expected = abs(trimesh.load_mesh(path).volume)
    assert volume(mesh) * 1e9 == pytest.approx(expected, rel=0.02)
    assert mesh_report(mesh)["elements"] == len(mesh.tets)


def test_every_body_must_reach_the_platen(tmp_path: Path) -> None:
    """One that does not would float, and its press converge without a force."""

    def two(name: str, raised: float) -> Scene:
        one, other = trimesh.creation.box([4.0, 4.0, 4.0]), trimesh.creation.box([4.0, 4.0, 4.0])
        other.apply_translation([6.0, 0.0, raised])
        trimesh.util.concatenate([one, other]).export(tmp_path / name)
        return Scene(object=Body(shape="mesh", mesh=str(tmp_path / name)), fidelity="fast")

    assert volume(mesh_object(two("level.stl", 0.0), progress=QUIET)) * 1e9 == pytest.approx(128.0, rel=0.02)
    floating = two("floating.stl", 1.0)
    for _ in ("filled", "from the cache"):
        with pytest.raises(MeshingError, match=r"floating.stl\) is 2 bodies apart, 1 of .* \(the lowest ends at 4 of 5 mm\); join them"):
            mesh_object(floating, progress=QUIET)


def test_a_cavity_must_face_inward(tmp_path: Path, wanted: Wanted) -> None:
    outer, inner = trimesh.creation.icosphere(2, 5.0), trimesh.creation.icosphere(2, 3.5)

    def ball(name: str) -> Scene:
        trimesh.util.concatenate([outer, inner]).export(tmp_path / name)
        return Scene(object=Body(shape="mesh", mesh=str(tmp_path / name)), fidelity="fast")

    with pytest.raises(SceneError, match=r"ball.stl.*7 x 7 x 7 mm lies in another and its faces point outward.*flip them for a cavity"):
        mesh_object(ball("ball.stl"), progress=QUIET)
    inner.invert()
    assert wanted(ball("hollow.stl"))


def test_what_cannot_be_filled_says_so() -> None:
    field = SizeField((0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3), 1e-3, 0.5, 2e-3)
    sheet = TriMesh(np.array([[0, 0, 0], [5e-3, 0, 0], [0, 5e-3, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(MeshingError, match=r"filling the object \(sheet\).*try") as caught:
        body_mesh._fill(body_mesh.Domain("the object (sheet)", sheet), field, 1.0, 0.15)
    assert "\n" not in str(caught.value)
