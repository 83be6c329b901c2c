"""Shape functions and quadrature rules against what defines them."""

from __future__ import annotations

import itertools
from math import factorial

import numpy as np
import pytest
from fem_fixtures import MM, box_mesh

from gelsim.errors import MeshingError
from gelsim.fem.elements import (
    tet10_gradient,
    tet10_shape,
    tet_quadrature,
    tet_quadrature_data,
    tri6_gradient,
    tri6_shape,
    triangle_quadrature,
)
from gelsim.geometry import FACE_EDGES, TET_EDGES, TetMesh, face_shape_functions

EPS = np.finfo(float).eps


@pytest.mark.parametrize(("points", "degree"), [(4, 2), (11, 4)])
def test_tet_rules_integrate_polynomials(points: int, degree: int) -> None:
    bary, weights = tet_quadrature(points)
    assert weights.sum() == pytest.approx(1 / 6, rel=8 * EPS)
    # ∫ λ₁^i λ₂^j λ₃^k over the reference tet = i! j! k! / (i + j + k + 3)!
    wrong = []
    for i, j, k in itertools.product(range(degree + 2), repeat=3):
        if i + j + k <= degree + 1:
            exact = factorial(i) * factorial(j) * factorial(k) / factorial(i + j + k + 3)
            found = (weights * bary[:, 1] ** i * bary[:, 2] ** j * bary[:, 3] ** k).sum()
            # the published points have 15 digits; weights of both signs cost one more
            if abs(found - exact) > 1e-14:
                wrong.append(i + j + k)
    assert set(wrong) == {degree + 1}, "exact to the degree it claims and no further"


@pytest.mark.parametrize(("points", "degree"), [(3, 2), (6, 4), (12, 6), (24, 4), (48, 6), (96, 4)])
def test_triangle_rules_integrate_polynomials(points: int, degree: int) -> None:
    bary, weights = triangle_quadrature(points)
    assert bary.sum(axis=1) == pytest.approx(np.ones(points), abs=1e-14)
    assert (weights > 0).all(), "contact pressures weighted negatively could pull"
    wrong = []
    for i, j in itertools.product(range(degree + 2), repeat=2):
        if i + j <= degree + 1:
            exact = factorial(i) * factorial(j) / factorial(i + j + 2)
            if abs((weights * bary[:, 1] ** i * bary[:, 2] ** j).sum() - exact) > 1e-14:
                wrong.append(i + j)
    assert set(wrong) == {degree + 1}


def test_unknown_rules_are_named() -> None:
    with pytest.raises(ValueError, match="7 points"):
        tet_quadrature(7)
    with pytest.raises(ValueError, match="7 points"):
        triangle_quadrature(7)


def barycentric(corners: int) -> np.ndarray:
    return np.random.default_rng(1).dirichlet(np.ones(corners), 20)


@pytest.mark.parametrize(
    ("shape", "gradient", "edges"),
    [(tet10_shape, tet10_gradient, TET_EDGES), (tri6_shape, tri6_gradient, FACE_EDGES)],
    ids=["tet10", "tri6"],
)
def test_shape_functions(shape, gradient, edges) -> None:  # type: ignore[no-untyped-def]
    corners = int(edges.max()) + 1
    bary = barycentric(corners)
    nodes = np.vstack([np.eye(corners), 0.5 * (np.eye(corners)[edges[:, 0]] + np.eye(corners)[edges[:, 1]])])
    assert np.array_equal(shape(nodes), np.eye(len(nodes)))  # 1 at its node, 0 at the others; all numbers are exact in binary
    assert shape(bary).sum(axis=-1) == pytest.approx(np.ones(len(bary)), abs=8 * EPS)
    assert np.abs(gradient(bary).sum(axis=-2)).max() <= 16 * EPS
    # a quadratic's central difference has no truncation error: rounding over the step
    h = 2.0**-10
    for direction in range(1, corners):
        step = np.zeros(corners)
        step[[0, direction]] = -h, h
        difference = (shape(bary + step) - shape(bary - step)) / (2 * h)
        assert np.abs(difference - gradient(bary)[..., direction - 1]).max() <= 8 * EPS / h
    # the space holds every quadratic
    quadratic = lambda b: b[..., 1] ** 2 - 3 * b[..., 1] * b[..., 2] + b[..., 0]  # noqa: E731
    assert shape(bary) @ quadratic(nodes) == pytest.approx(quadratic(bary), abs=32 * EPS)


def test_face_functions_of_both_homes_agree() -> None:
    bary = barycentric(3)
    assert np.array_equal(tri6_shape(bary), face_shape_functions(bary))


@pytest.mark.parametrize("points", [4, 11])
def test_rest_gradients(points: int) -> None:
    line = np.linspace(0, 1, 3) * MM
    mesh = box_mesh(line, line, line, ("bottom", "top", "side"), shake=0.2)
    data = tet_quadrature_data(mesh, points)
    assert data.weights.sum() == pytest.approx(1e-9, rel=100 * EPS)  # the box's volume; 48 tets times the rule
    # gradients of a quadratic field of the nodes are those of the field; straight tets hold it exactly
    field = lambda x: x[..., 0] ** 2 + 2 * x[..., 0] * x[..., 1] - x[..., 2] ** 2  # noqa: E731
    bary, _ = tet_quadrature(points)
    x = np.einsum("tnc,qn->tqc", mesh.rest_positions[mesh.tets], tet10_shape(bary))
    exact = np.stack([2 * x[..., 0] + 2 * x[..., 1], 2 * x[..., 0], -2 * x[..., 2]], axis=-1)
    found = np.einsum("tn,tqnc->tqc", field(mesh.rest_positions)[mesh.tets], data.gradients)
    assert np.abs(found - exact).max() <= 200 * EPS * np.abs(exact).max()  # 10 products of up to 10 times the sum


def test_a_tet_folded_over_is_refused() -> None:
    line = np.linspace(0, 1, 2) * MM
    mesh = box_mesh(line, line, line, ("bottom", "top", "side"))
    nodes = mesh.rest_positions.copy()
    tet = mesh.tets[0]
    nodes[tet[4]] = nodes[tet[3]] + 0.6 * (nodes[tet[3]] - nodes[tet[4]])  # a middle thrown beyond the opposite vertex
    with pytest.raises(MeshingError, match="fold over"):
        tet_quadrature_data(TetMesh(nodes, mesh.tets), 4)
