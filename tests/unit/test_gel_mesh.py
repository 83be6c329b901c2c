"""The gel's mesh: repeatable, conforming, graded as asked, on the dome, with edges along rims; and what makes it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mesh_fixtures import assert_whole, scene

from gelsim.errors import MeshingError
from gelsim.geometry import TET_EDGES, TetMesh, jacobian_determinants, outer_faces, quadratic_tets, tet_quality, tet_volumes, volume
from gelsim.mesh import gel_mesh
from gelsim.mesh.bisection import UNIT, Lattice, Tets, cells_across, kuhn_box, refine, split
from gelsim.mesh.contact_area import core, footprint
from gelsim.mesh.gel_mesh import LONGER_ACROSS, mesh_gel
from gelsim.mesh.rim_edges import LEAST, NEAR_BESIDE, lay_edges
from gelsim.mesh.sizing import SIZES, SizeField
from gelsim.scene.definition import Body, Gel, Press, Scene
from gelsim.shape.shapes import gel_height, rotation

WHOLE, QUARTER = frozenset[str](), frozenset("xy")


# ---------------------------------------------------------------------------------------------------------------- bisection
def near_a_corner(finest: float) -> Callable[[Lattice, Tets], np.ndarray]:
    """Tets whose longest edge, in cells, is above `finest` and half their distance from the origin."""

    def large(points: Lattice, tets: Tets) -> np.ndarray:
        corners = points[tets] / UNIT
        longest = np.linalg.norm(corners[:, TET_EDGES[:, 0]] - corners[:, TET_EDGES[:, 1]], axis=2).max(axis=1)
        return longest > finest + 0.5 * np.linalg.norm(corners, axis=2).min(axis=1)

    return large


def assert_conforming(points: Lattice, tets: Tets, cells: np.ndarray) -> None:
    """Fills the box, and every face is of two tets or lies on one of the box's sides."""
    volumes = tet_volumes(points / UNIT, tets.astype(np.int32))
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(float(np.prod(cells)), rel=1e-12)
    faces = outer_faces(quadratic_tets(points.astype(float), tets.astype(np.int32))[1])[:, :3]  # those of one tet
    corners = points[faces]
    sides = ((corners == 0).all(axis=1) | (corners == cells * UNIT).all(axis=1)).any(axis=1)
    assert sides.all()


def dihedral_angles(vertices: np.ndarray, tets: Tets) -> np.ndarray:
    out = []
    for i, j in TET_EDGES:
        k, m = (n for n in range(4) if n not in (i, j))
        along = vertices[tets[:, j]] - vertices[tets[:, i]]
        one, two = (np.cross(along, vertices[tets[:, n]] - vertices[tets[:, i]]) for n in (k, m))
        out.append(np.arccos((one * two).sum(1) / np.linalg.norm(one, axis=1) / np.linalg.norm(two, axis=1)))
    return np.degrees(np.array(out))


def test_bisection_conforms_and_makes_three_shapes() -> None:
    cells = cells_across(np.array([12.5, 12.5, 2.4]))
    assert cells.tolist() == [5, 5, 1]
    points, tets = refine(*kuhn_box(cells), near_a_corner(0.05))
    assert len(tets) > 1000
    assert_conforming(points, tets, cells)
    # Edges 1, 1, 1, √2, √2, √3 of volume 1/6, 1, 1, √2, 3 of √3/2 of 1/12, and 1, √½, √½, 2 of √¾, ½ of 1/24:
    # 12 (3 V)^(2/3) / Σ l² = 12 · 0.63 / 10, 12 · 0.397 / 6.25, 12 · 0.25 / 3.75.
    shapes = [12 * 0.5 ** (2 / 3) / 10, 12 * 0.25 ** (2 / 3) / 6.25, 0.8]
    quality = tet_quality(points / UNIT, tets.astype(np.int32))
    assert np.abs(quality[:, None] - shapes).min(axis=1).max() < 1e-12
    angles = dihedral_angles(points / UNIT, tets)
    assert angles.min() > 45 - 1e-9 and angles.max() < 120 + 1e-9
    # The planted fault: a tet cut without its neighbours leaves a corner within their faces.
    edge = tets[:1, TET_EDGES[0]]
    middle = np.array([len(points)])
    cut = np.vstack([tets[1:], split(tets[:1], edge, middle)])
    with pytest.raises(AssertionError):
        assert_conforming(np.vstack([points, points[edge[0]].sum(axis=0, keepdims=True) // 2]), cut, cells)


@pytest.mark.parametrize("extent", [(12.5, 12.5, 2.4), (2.5, 2.5, 20.0), (1.0, 1.41, 1.42), (50.0, 3.0, 2.0)])
def test_cells_are_near_cubes(extent: tuple[float, ...]) -> None:
    sides = np.array(extent) / cells_across(np.array(extent))
    assert (sides / min(extent) <= np.sqrt(2) * (1 + 1e-12)).all() and (sides / min(extent) >= np.sqrt(0.5) * (1 - 1e-12)).all()


# ---------------------------------------------------------------------------------------------------------------- the gel
@pytest.mark.parametrize("profile", ["flat", "dome"])
def test_gel(profile: str) -> None:
    mesh = mesh_gel(scene("hemisphere", profile), QUARTER)
    assert set(mesh.groups) == {"bonded", "coated", "side"}
    assert_whole(mesh)
    bonded, coated = mesh.surface("bonded").nodes, mesh.surface("coated").nodes
    assert (bonded[:, 2] == -2.4e-3).all()
    gel = Gel(profile=profile)
    vertices = mesh.rest_positions[np.unique(mesh.groups["coated"][:, :3])]
    assert np.abs(vertices[:, 2] - gel_height(gel, vertices[:, :2])).max() < 1e-15
    off = np.abs(coated[:, 2] - gel_height(gel, coated[:, :2]))
    inside = np.hypot(coated[:, 0], coated[:, 1]) < 11e-3  # away from the crease of the corner's land
    assert off[inside].max() < 1e-15
    if profile == "flat":
        assert volume(mesh) * 1e9 == pytest.approx(12.5 * 12.5 * 2.4, rel=1e-12)
        # The three shapes in cells of 2.5 x 2.5 x 2.4 mm: stretched by up to 2.5 / 2.4 they lose at most its square of their quality.
        assert tet_quality(mesh.rest_positions, mesh.tets).min() > 0.755 / (2.5 / 2.4) ** 2
    sides = mesh.surface("side").nodes
    assert (np.abs(np.abs(sides[:, :2]).max(axis=1) - 12.5e-3) < 1e-15).all()


@pytest.mark.parametrize("shape", ["hemisphere", "cylinder", "box"])
def test_the_same_press_gives_the_same_mesh(shape: str) -> None:
    one, two = (mesh_gel(scene(shape, offset_mm=(1.0, 0.5), tilt_deg=(2.0, 0.0)), WHOLE) for _ in range(2))
    assert one.rest_positions.tobytes() == two.rest_positions.tobytes() and one.tets.tobytes() == two.tets.tobytes()
    assert all(one.groups[name].tobytes() == two.groups[name].tobytes() for name in one.groups)
    other = mesh_gel(scene(shape, offset_mm=(6.0, 0.5)), WHOLE)
    assert one.rest_positions.tobytes() != other.rest_positions.tobytes()


def test_mirrored_meshes_are_symmetric() -> None:
    quarter, whole = (mesh_gel(scene("hemisphere"), planes) for planes in (QUARTER, WHOLE))
    assert not whole.symmetry
    assert volume(whole) == pytest.approx(4 * volume(quarter), rel=1e-12)
    assert_whole(whole)
    nodes = np.unique(whole.rest_positions + 0.0, axis=0)  # + 0.0: -0 counts as 0
    assert len(nodes) == len(whole.rest_positions)
    for axis in (0, 1):
        image = nodes * np.where(np.arange(3) == axis, -1.0, 1.0) + 0.0
        assert np.array_equal(np.unique(image, axis=0), nodes)


GELS = [(7.0, 20.0, 20.0), (25.0, 0.5, 0.5), (25.0, 2.4, 0.05), (60.0, 10.0, 1.0)]


@pytest.mark.parametrize(("size", "thickness", "edge"), GELS, ids=["tall", "thin", "sharp", "large"])
def test_gels_of_all_measures(size: float, thickness: float, edge: float) -> None:
    gel = Gel(profile="dome", size_mm=(size, 0.8 * size), thickness_mm=thickness, edge_thickness_mm=edge)
    given = Scene(object=Body(shape="hemisphere", rigid=True), gel=gel, press=Press(depth_mm=0.3), fidelity="fast")
    mesh = mesh_gel(given, QUARTER)
    assert jacobian_determinants(mesh.rest_positions, mesh.tets).min() > 0
    top = mesh.surface("coated").nodes
    assert np.ptp(top[:, 0]) == pytest.approx(size / 2e3) and np.ptp(top[:, 1]) == pytest.approx(0.4e-3 * size)


def longest_across(mesh: TetMesh) -> np.ndarray:
    """Longest edge of each tet seen from above [m]."""
    ends = mesh.rest_positions[mesh.tets[:, :4]][:, TET_EDGES, :2]
    return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2).max(axis=1)


def test_edges_follow_the_size_field(monkeypatch: pytest.MonkeyPatch) -> None:
    fields: list[SizeField] = []
    field_of = gel_mesh.contact_field
    monkeypatch.setattr(gel_mesh, "contact_field", lambda *given: fields.append(field_of(*given)) or fields[-1])
    given = scene("hemisphere", "flat")
    mesh = mesh_gel(given, QUARTER)
    field = fields[0]
    leg = longest_across(mesh) / np.sqrt(2)
    asked = LONGER_ACROSS * field(mesh.rest_positions[mesh.tets[:, :4]]).min(axis=1)
    assert (leg <= asked * (1 + 1e-9)).all()
    # No finer than asked: a face of half the legs would have been cut four times, a conforming neighbour asks for two of these at most.
    middle = mesh.rest_positions[mesh.tets[:, :4]].mean(axis=1)
    near = (np.hypot(middle[:, 0], middle[:, 1]) < field.high[0]) & (middle[:, 2] > -field.contact)
    assert near.sum() > 50
    assert np.median((leg / asked)[near]) > 0.5
    assert np.median(leg[middle[:, 0] > 9e-3]) > 2 * np.median(leg[near])
    # The planted fault: a mesh of another field does not follow this one.
    monkeypatch.setattr(gel_mesh, "LONGER_ACROSS", 2.5)
    coarse = mesh_gel(given, QUARTER)
    assert (longest_across(coarse) / np.sqrt(2) > LONGER_ACROSS * field(coarse.rest_positions[coarse.tets[:, :4]]).min(axis=1)).any()


def test_a_press_begins_at_a_point_or_it_does_not() -> None:
    """Of balls and cones a small part is touched within a quarter of the depth; of a flat all, of a rod half, but on a dome."""
    begins = replace(scene("hemisphere", "flat", depth_mm=1.0), fidelity="balanced")
    points, size = core(begins, 0.4e-3, of_object=False)
    assert size == pytest.approx(0.28e-3)
    assert np.hypot(*points[:, :2].T).max() == pytest.approx(np.sqrt(2 * 5 * 0.25) * 1e-3, rel=0.1)
    apart = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))
    assert apart.min(axis=1).max() <= 0.5 * size
    assert len(core(begins, 0.2e-3, of_object=False)[0]) and core(begins, 0.2e-3, of_object=False)[1] == SIZES["balanced"].finest
    assert len(core(replace(scene("cone", "flat"), fidelity="balanced"), 0.4e-3, of_object=True)[0])
    for shape in ("punch", "box", "cylinder", "edge"):
        assert not len(core(replace(scene(shape, "flat"), fidelity="balanced"), 0.4e-3, of_object=False)[0]), shape
    for shape in ("box", "cylinder"):
        assert len(core(replace(scene(shape, "dome", depth_mm=0.3), fidelity="balanced"), 0.4e-3, of_object=False)[0]), shape
    assert not len(core(replace(begins, fidelity="fast"), 0.4e-3, of_object=False)[0])


def test_where_a_press_begins_moves_with_it() -> None:
    """An offset moves it on the gel, a tilt on the object: to where its ball is lowest."""
    moved = replace(scene("hemisphere", "flat", offset_mm=(6.0, -2.0)), fidelity="reference")
    assert core(moved, 0.4e-3, of_object=False)[0].mean(axis=0) == pytest.approx([6e-3, -2e-3, 0.0], abs=0.05e-3)
    assert core(moved, 0.4e-3, of_object=True)[0].mean(axis=0)[:2] == pytest.approx([0.0, 0.0], abs=0.05e-3)
    tilted = replace(scene("hemisphere", "flat", tilt_deg=(0.0, 20.0)), fidelity="reference")
    lowest = np.array([0.0, 0.0, 5e-3]) - 5e-3 * rotation(tilted)[2]
    assert abs(lowest[0]) == pytest.approx(5e-3 * np.sin(np.radians(20.0)))
    assert core(tilted, 0.4e-3, of_object=True)[0].mean(axis=0) == pytest.approx(lowest, abs=0.15e-3)


def test_edges_are_short_where_a_press_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    given = replace(scene("hemisphere", "flat"), fidelity="balanced")

    def shorter() -> float:
        """Longest edges of the outer face's triangles within 1 mm of first touch over those 2 to 2.6 mm from it."""
        mesh = mesh_gel(given, QUARTER)
        corners = mesh.rest_positions[mesh.groups["coated"][:, :3], :2]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        away = np.hypot(*corners.mean(axis=1).T)
        return float(longest[away < 1e-3].mean() / longest[(away > 2e-3) & (away < 2.6e-3)].mean())

    assert shorter() < 0.8
    monkeypatch.setattr(gel_mesh, "core", lambda *_, **__: (np.zeros((0, 3)), 1e-3))
    assert shorter() > 0.95  # the planted fault


def test_long_tets_under_a_cylinder() -> None:
    area = footprint(scene("cylinder"))
    assert area.stretch >= 2 and area.high[1] > 2 * area.high[0]
    assert footprint(scene("cylinder", twist_deg=3.0)).stretch >= 2
    assert footprint(scene("cylinder", twist_deg=6.0)).stretch == 1.0
    mesh = mesh_gel(scene("cylinder"), QUARTER)
    assert_whole(mesh)
    spans = np.ptp(mesh.rest_positions[mesh.tets[:, :4]], axis=1)
    near = np.abs(mesh.rest_positions[mesh.tets[:, :4]].mean(axis=1)[:, 0]) < 3e-3
    assert np.median(spans[near, 1] / spans[near, 0]) > 1.4


def test_footprint_classes() -> None:
    """Half widths sit on the classes; small changes of depth keep them, an offset moves the box and covers the patch."""
    a, b = footprint(scene("hemisphere", "flat", depth_mm=0.95)), footprint(scene("hemisphere", "flat", depth_mm=1.0))
    assert a == b
    assert a.high[0] >= np.sqrt(2 * 5 * 1 - 1) * 1e-3  # the undeformed overlap of a ball of 5 mm at 1 mm
    moved = footprint(scene("hemisphere", "flat", offset_mm=(7.0, 0.0)))
    assert moved.low[0] <= 4e-3 and moved.high[0] >= 10e-3 and moved.low[1] == 0.0


def test_contact_on_one_side_is_meshed_there_alone() -> None:
    """Beside the middle there is no mirror image of what is fine; the press at the other side has the same mesh, mirrored."""
    right, left = (scene("hemisphere", "flat", offset_mm=(x, 0.0)) for x in (7.0, -7.0))
    assert footprint(right).side == (1, 0) and footprint(left).side == (-1, 0)
    mesh, other = (mesh_gel(each, frozenset("y")) for each in (right, left))
    assert mesh.symmetry == frozenset("y")
    assert np.array_equal(other.rest_positions, mesh.rest_positions * [-1.0, 1.0, 1.0])
    assert_whole(other)
    assert volume(other) == pytest.approx(volume(mesh), rel=1e-12)
    top = mesh.rest_positions[np.unique(mesh.groups["coated"])]
    beside = [int((np.abs(top[:, 0] - x) < 2e-3).sum()) for x in (7e-3, -7e-3)]
    # Asked for are edges of 0.8 mm at one side and of 5, cut to cells of 2.5 mm, at the other: a tenth of the points in a strip of uniform
    # edges, some more as the fine area ends within it. A mirror image would have as many.
    assert beside[0] > 3 * beside[1]


FOLDS = {
    # A rim across a corner of the gel, where it is 0.4 mm thin, makes a face that leans below a vertex it lay above.
    "rim": ((2.66, 0.61), Press(depth_mm=1.38, tilt_deg=(-6.32, 5.51), offset_mm=(1.59, -0.41), twist_deg=2.99)),
    # Across the crease an edge passes through a vertex: the dome is twice as thick at 12.5 mm as its land, the vertex half as high again.
    "crease": ((2.69, 0.65), Press(depth_mm=1.21, tilt_deg=(8.36, 0.0), offset_mm=(-0.32, 0.48), twist_deg=4.83)),
}


@pytest.mark.parametrize("fold", FOLDS)
def test_what_folds_under_the_dome_is_untangled(fold: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (thickness, edge), press = FOLDS[fold]
    gel = Gel(profile="dome", thickness_mm=thickness, edge_thickness_mm=edge)
    given = Scene(object=Body(shape="flat", rigid=True), gel=gel, press=press, fidelity="fast")
    untangled, seen = gel_mesh._untangled, []
    monkeypatch.setattr(gel_mesh, "_untangled", lambda *args: seen.append((*args, untangled(*args))) or seen[-1][-1])
    mesh = mesh_gel(given, WHOLE)
    assert_whole(mesh)
    top = mesh.rest_positions[np.unique(mesh.groups["coated"][:, :3])]
    assert np.abs(top[:, 2] - gel_height(gel, top[:, :2])).max() < 1e-15
    ((before, tets, _, after),) = seen
    assert np.array_equal(after[:, :2], before[:, :2])
    moved = np.intersect1d(np.flatnonzero(after[:, 2] != before[:, 2]), tets[:, :4])
    assert len(moved) and np.isin(moved, tets[tet_quality(before, tets) < gel_mesh._LEAST, :4]).all()
    straight = after[tets[:, :4]][:, TET_EDGES].mean(axis=2) - before[tets[:, :4]][:, TET_EDGES].mean(axis=2)
    assert np.abs(after[tets[:, 4:]] - before[tets[:, 4:]] - straight).max() < 1e-15  # middles go with their edges
    monkeypatch.setattr(gel_mesh, "_untangled", lambda nodes, tets, inner: nodes)  # the planted fault
    with pytest.raises(MeshingError, match=r"filling the gel.*folded one \(smallest Jacobian -.*try another fidelity"):
        mesh_gel(given, WHOLE)


def test_untangling_leaves_alone_what_does_not_fold_and_what_no_height_unfolds() -> None:
    mesh = mesh_gel(scene("hemisphere"), QUARTER)
    nodes, tets = mesh.rest_positions, mesh.tets
    inner = ~np.isin(np.arange(len(nodes)), outer_faces(tets))
    assert gel_mesh._untangled(nodes, tets, inner).tobytes() == nodes.tobytes()
    vertex = np.intersect1d(np.flatnonzero(inner), tets[:, :4])[0]
    high, aside = nodes.copy(), nodes.copy()
    high[vertex, 2] += 3e-3  # beyond its neighbours: there are heights at which nothing folds
    aside[vertex, 0] += 5e-3  # there are none
    assert tet_quality(high, tets).min() < 0 < 0.05 < tet_quality(gel_mesh._untangled(high, tets, inner), tets).min()
    assert gel_mesh._untangled(aside, tets, inner)[vertex].tobytes() == aside[vertex].tobytes()


def test_a_fold_under_the_dome_is_refined_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no height of a vertex helps the far edges are made shorter."""
    domed, tried, folded = gel_mesh._domed, [], 1

    def folding(gel: Gel, flat: TetMesh) -> TetMesh:
        mesh = domed(gel, flat)
        tried.append(len(flat.tets))
        if len(tried) <= folded:  # the planted fold: an inner vertex beyond its neighbours
            inner = np.setdiff1d(mesh.tets[:, :4], outer_faces(mesh.tets))[0]
            mesh.rest_positions[inner, 0] += 5e-3
        return mesh

    monkeypatch.setattr(gel_mesh, "_domed", folding)
    assert_whole(mesh_gel(scene("hemisphere"), QUARTER))
    assert len(tried) == 2
    tried.clear()
    folded = 9
    with pytest.raises(MeshingError, match=r"filling the gel.*folded one \(smallest Jacobian -.*try another fidelity"):
        mesh_gel(scene("hemisphere"), QUARTER)
    assert len(tried) == len(gel_mesh._FOLDED) and tried[0] < tried[-1]


# ---------------------------------------------------------------------------------------------------------------- rims
def straddling(mesh: TetMesh, radius: float, slack: float) -> int:
    """Faces with corners on both sides of a circle."""
    reach = np.hypot(*mesh.rest_positions[:, :2].T)[mesh.groups["coated"][:, :3]]
    return int(((reach.min(axis=1) < radius - slack) & (reach.max(axis=1) > radius + slack)).sum())


@pytest.mark.parametrize("fidelity", ["fast", "balanced"])
def test_the_gel_has_edges_along_a_rim(fidelity: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A punch's rim: no face of the gel straddles it."""
    punch = Body(shape="punch", radius_mm=3.0, rigid=True)
    given = Scene(object=punch, gel=Gel(profile="flat"), press=Press(depth_mm=0.5), fidelity=fidelity)
    mesh = mesh_gel(given, QUARTER)
    assert_whole(mesh)
    assert volume(mesh) * 1e9 == pytest.approx(12.5 * 12.5 * 2.4, rel=1e-12)
    assert tet_quality(mesh.rest_positions, mesh.tets).min() >= LEAST
    # Vertices lie on chords of the rim, up to 10 µm within it (`sharp_edges`).
    assert straddling(mesh, 3e-3, 10e-6) == 0
    rim = np.abs(np.hypot(*mesh.rest_positions[np.unique(mesh.groups["coated"][:, :3]), :2].T) - 3e-3) < 10e-6
    assert rim.sum() >= 1.5e-3 * np.pi / (1.5 * SIZES[fidelity].rim)
    # the planted fault
    monkeypatch.setattr(gel_mesh, "lay_edges", lambda vertices, tets, *_: (vertices, tets))
    assert straddling(mesh_gel(given, QUARTER), 3e-3, 10e-6) > 10


def test_a_corner_of_a_rim_is_a_vertex_and_no_edge_crosses_it() -> None:
    """A rectangle across a box, off its middle: its corners are vertices, and what lies inside is whole faces."""
    cells = np.array([4, 4, 1])
    points, tets = refine(*kuhn_box(cells), lambda p, t: np.abs(np.ptp(p[t], axis=1)).max(axis=1) > UNIT // 4)
    vertices = points / UNIT
    low, high = np.array([0.93, 1.14]), np.array([2.57, 2.71])
    turns = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    pieces = np.concatenate([np.linspace(a, b, 12) for a, b in zip(turns, np.roll(turns, -1, axis=0), strict=True)]).reshape(4, 12, 2)
    pieces = np.stack([pieces[:, :-1], pieces[:, 1:]], axis=2).reshape(-1, 2, 2)
    moved, cut = lay_edges(vertices, tets, pieces, np.ones(3))
    assert tet_volumes(moved, cut.astype(np.int32)).min() > 0
    assert tet_volumes(moved, cut.astype(np.int32)).sum() == pytest.approx(16.0, rel=1e-12)
    assert tet_quality(moved, cut.astype(np.int32)).min() >= LEAST
    for turn in turns:
        assert np.abs(moved[:, :2] - turn).max(axis=1).min() < 1e-12

    def inside_area(vertices: np.ndarray, tets: Tets) -> float:
        faces = outer_faces(quadratic_tets(vertices, tets.astype(np.int32))[1])[:, :3]
        corners = vertices[faces[(vertices[faces, 2] == 1.0).all(axis=1)], :2]
        middle = corners.mean(axis=1)
        one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = 0.5 * np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
        return float(area[((middle > low) & (middle < high)).all(axis=1)].sum())

    assert inside_area(moved, cut) == pytest.approx(float(np.prod(high - low)), rel=1e-9)
    assert abs(inside_area(vertices, tets) / np.prod(high - low) - 1) > 1e-3  # the planted fault: not laid


def test_faces_at_a_rim_are_short_across_it() -> None:
    """Faces that touch an oblique line go no farther from it than its parallels and a bit: an edge whose end is that near is left whole."""
    points, tets = refine(*kuhn_box(np.array([4, 4, 1])), lambda p, t: np.abs(np.ptp(p[t], axis=1)).max(axis=1) > UNIT // 4)
    vertices, beside = points / UNIT, 0.12
    start, end = np.array([0.5, 0.9]), np.array([3.5, 2.7])
    line = start + np.linspace(0.0, 1.0, 13)[:, None] * (end - start)
    pieces = np.stack([line[:-1], line[1:]], axis=1)
    along = (end - start) / np.linalg.norm(end - start)

    def long_across(beside: float) -> float:
        """Share of the faces on the line's middle part that go farther from it."""
        laid, cut = lay_edges(vertices, tets, pieces, np.ones(3), beside)
        assert tet_volumes(laid, cut.astype(np.int32)).sum() == pytest.approx(16.0, rel=1e-12)
        assert tet_quality(laid, cut.astype(np.int32)).min() >= LEAST
        faces = outer_faces(quadratic_tets(laid, cut.astype(np.int32))[1])[:, :3]
        corners = laid[faces[(laid[faces, 2] == 1.0).all(axis=1)], :2] - start
        away, place = np.abs(corners @ [-along[1], along[0]]), corners @ along
        share = place / np.linalg.norm(end - start)
        beside_it = (away < 1e-9).any(axis=1) & ((share > 0.1) & (share < 0.9)).all(axis=1)
        return float((away[beside_it].max(axis=1) > 0.12 / (1 - NEAR_BESIDE)).mean())

    assert long_across(beside) < 0.1  # cuts that would leave poor tets
    assert long_across(0.0) > 0.4  # the planted fault: none cut


def test_rims_without_mirror_images_are_not_meshed_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plate off the middle: edges lie along its side at x = 4 mm, and none where the image of that would be."""
    trimesh.creation.box(bounds=[[-3, -4, 0], [3, 4, 2]]).export(tmp_path / "part.stl")
    body = Body(shape="mesh", mesh=str(tmp_path / "part.stl"), rigid=True)
    plate = Scene(object=body, gel=Gel(profile="flat"), press=Press(depth_mm=0.5, offset_mm=(1.0, 0.0)), fidelity="fast")

    def on(x: float) -> int:
        at = mesh.rest_positions[np.unique(mesh.groups["coated"][:, :3]), :2] * 1e3
        return int(((np.abs(at[:, 0] - x) < 1e-6) & (np.abs(at[:, 1]) < 4.0)).sum())

    mesh = mesh_gel(plate)
    assert_whole(mesh)
    assert on(4.0) >= 5 and on(-4.0) == 0
    monkeypatch.setattr(gel_mesh, "_unmirrored", lambda area, rims: area)  # the planted fault
    mesh = mesh_gel(plate)
    assert on(-4.0) >= 5
