"""Curved tets and faces: numbering, mirror images, Jacobians."""

import numpy as np
import pytest

from gelsim.geometry import (
    TET_FACES,
    TetMesh,
    TriMesh,
    enclosed_volume,
    face_shape_functions,
    is_closed,
    jacobian_determinants,
    mirror,
    mirror_surface,
    outer_faces,
    quadratic_faces,
    quadratic_tets,
    split_faces,
    tet_quality,
    tet_volumes,
    unfolded,
    volume,
)

EPS = np.finfo(float).eps


@pytest.fixture
def brick() -> TetMesh:
    """The box [0,1] x [0,2] x [0,3] m in six tets, cut at x = 0 and y = 0."""
    corners = np.array([[i, 2 * j, 3 * k] for i in (0.0, 1.0) for j in (0.0, 1.0) for k in (0.0, 1.0)])
    tets = np.array([[0, a, a + b, 7] for a, b in ((1, 2), (1, 4), (2, 1), (2, 4), (4, 1), (4, 2))])
    wrong = tet_volumes(corners, tets) < 0
    tets[wrong] = tets[wrong][:, [1, 0, 2, 3]]
    nodes, tets10 = quadratic_tets(corners, tets.astype(np.int32))
    faces = outer_faces(tets10)
    skin = ~((nodes[faces][:, :, :2] == 0.0).all(axis=1)).any(axis=1)
    return TetMesh(nodes, tets10, {"skin": faces[skin]}, frozenset("xy"))


def test_middles_lie_between_their_vertices(brick: TetMesh) -> None:
    p, t = brick.rest_positions, brick.tets
    for middle, (i, j) in zip(range(4, 10), ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)), strict=True):
        assert np.array_equal(p[t[:, middle]], (p[t[:, i]] + p[t[:, j]]) / 2)  # halves of small integers are exact


def test_straight_jacobian_is_six_volumes(brick: TetMesh) -> None:
    expected = 6.0 * tet_volumes(brick.rest_positions, brick.tets)[:, None]
    # a 3 x 3 determinant of sums of ten terms, each of order 1..3: some hundred roundings
    assert np.abs(jacobian_determinants(brick.rest_positions, brick.tets) - expected).max() <= 300 * EPS * expected.max()
    assert volume(brick) == pytest.approx(6.0, rel=300 * EPS)


def test_outer_faces_close_and_point_out(brick: TetMesh) -> None:
    faces = outer_faces(brick.tets)
    assert is_closed(faces[:, :3])
    assert enclosed_volume(TriMesh(brick.rest_positions, faces[:, :3])) == pytest.approx(6.0, rel=100 * EPS)
    assert is_closed(split_faces(faces))
    assert enclosed_volume(TriMesh(brick.rest_positions, split_faces(faces))) == pytest.approx(6.0, rel=100 * EPS)
    assert not is_closed(faces[1:, :3])


def test_mirror_doubles_shares_the_plane_and_stays_right_side_out(brick: TetMesh) -> None:
    half = mirror(brick, "x")
    whole = mirror(half, "y")
    assert half.symmetry == {"y"} and not whole.symmetry
    assert volume(whole) == pytest.approx(24.0, rel=300 * EPS)
    assert (tet_quality(whole.rest_positions, whole.tets) > 0).all()
    assert len(np.unique(whole.rest_positions, axis=0)) == len(whole.rest_positions)  # nothing doubled on the planes
    faces = outer_faces(whole.tets)
    assert is_closed(faces[:, :3])
    # the named faces are the whole skin, with the same numbering of their middles
    assert {tuple(sorted(f)) for f in faces} == {tuple(sorted(f)) for f in whole.groups["skin"]}
    p, g = whole.rest_positions, whole.groups["skin"]
    assert np.array_equal(p[g[:, 3]], (p[g[:, 0]] + p[g[:, 1]]) / 2) and np.array_equal(p[g[:, 5]], (p[g[:, 2]] + p[g[:, 0]]) / 2)
    middles = p[whole.tets[:, TET_FACES[:, 4]]]
    assert np.array_equal(middles, (p[whole.tets[:, TET_FACES[:, 1]]] + p[whole.tets[:, TET_FACES[:, 2]]]) / 2)


def test_mirror_surface_agrees_with_mirror(brick: TetMesh) -> None:
    from_solid = mirror(brick, "x").surface("skin")
    from_skin = mirror_surface(brick.surface("skin"), "x")
    assert len(from_solid.nodes) == len(from_skin.nodes)
    assert np.array_equal(np.unique(from_solid.nodes, axis=0), np.unique(from_skin.nodes, axis=0))


def test_a_bent_edge_shows_in_the_jacobian() -> None:
    nodes, tets = quadratic_tets(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]], np.int32))
    nodes = nodes.copy()
    middle = tets[0, 4]  # of the edge 01 along x
    nodes[middle, 0] = 0.24  # a middle nearer than a quarter of the edge to a vertex folds the tet there: dx/dxi = 4 * 0.24 - 1 < 0
    assert jacobian_determinants(nodes, tets)[0, 0] < 0
    nodes[middle, 0] = 0.26
    assert jacobian_determinants(nodes, tets).min() > 0


def test_face_functions_are_nodal_and_sum_to_one() -> None:
    points = np.vstack([np.eye(3), (np.eye(3) + np.roll(np.eye(3), 1, axis=1)) / 2])
    assert np.array_equal(face_shape_functions(points), np.eye(6))
    inside = np.random.default_rng(0).dirichlet(np.ones(3), 50)
    assert np.abs(face_shape_functions(inside).sum(axis=1) - 1).max() < 20 * EPS  # six terms of order one


def test_six_node_faces_hold_a_sphere_better_than_flat_ones() -> None:
    """Area of an octant of the unit sphere, π/2, from an icosphere-like refinement: O(h²) flat, O(h⁴) with middles on the sphere."""
    vertices, faces = np.eye(3), np.array([[0, 1, 2]], np.int32)
    flat, curved = [], []
    for _ in range(4):
        surface = quadratic_faces(vertices, faces)
        nodes = surface.nodes / np.linalg.norm(surface.nodes, axis=1, keepdims=True)
        flat.append(_area(vertices, faces))
        curved.append(_curved_area(nodes, surface.faces))
        vertices, faces = nodes, split_faces(surface.faces)
    flat_error, curved_error = (np.abs(np.array(a) - np.pi / 2) for a in (flat, curved))
    assert np.log2(flat_error[-2] / flat_error[-1]) == pytest.approx(2.0, abs=0.15)
    assert np.log2(curved_error[-2] / curved_error[-1]) > 3.0  # above the flat order by one at least; theory 4 on uniform refinement
    assert curved_error[-1] < 0.02 * flat_error[-1]


def _area(p: np.ndarray, f: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]]), axis=1).sum() / 2)


def _curved_area(nodes: np.ndarray, faces: np.ndarray) -> float:
    """Area of six-node faces, each sampled on 16 x 16 flat sub-triangles (which leaves 1/256 of the flat error)."""
    n = 16
    grid = [(i / n, j / n) for i in range(n + 1) for j in range(n + 1 - i)]
    index = {p: k for k, p in enumerate(grid)}
    at = lambda i, j: index[(i / n, j / n)]  # noqa: E731
    cells = [(at(i, j), at(i + 1, j), at(i, j + 1)) for i in range(n) for j in range(n - i)]
    cells += [(at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)) for i in range(n) for j in range(n - i - 1)]
    u = np.array(grid)
    weights = face_shape_functions(np.column_stack([1 - u.sum(1), u]))
    return sum(_area(weights @ nodes[face], np.array(cells)) for face in faces)


@pytest.mark.parametrize("angle", [0.3, 0.5, 0.8])
def test_a_tet_under_a_curved_edge_takes_back_a_tenth_of_its_bend(angle: float) -> None:
    """Two of its faces lie on the unit sphere: with all its middles there it folds at the ends of the edge between them."""
    a, b = np.sin(0.1), np.sin(angle)
    nodes, tets = quadratic_tets(
        np.array([[a, 0, np.cos(0.1)], [-a, 0, np.cos(0.1)], [0, b, np.cos(angle)], [0, -b, np.cos(angle)]]),
        np.array([[0, 1, 2, 3]], np.int32),
    )
    inner = 4 + int(np.argmin(np.linalg.norm(nodes[4:], axis=1)))  # the edge below both faces
    on = np.array([node for node in range(4, 10) if node != inner])
    curved = nodes.copy()
    curved[on] /= np.linalg.norm(curved[on], axis=1)[:, None]
    reference = 6.0 * tet_volumes(nodes, tets)
    assert jacobian_determinants(curved, tets).min() < 0.1 * reference
    out = unfolded(curved, tets, 1.0)
    assert jacobian_determinants(out, tets).min() >= 0.1 * reference
    assert out[on] - nodes[on] == pytest.approx(0.9 * (curved[on] - nodes[on]), rel=1e-12)
    straight = unfolded(curved, tets, 0.0)
    assert straight == pytest.approx(nodes, abs=1e-15)
