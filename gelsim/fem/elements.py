"""Ten-node tetrahedra and six-node triangles: shape functions, quadrature, rest-configuration gradients. NumPy, float64.

Displacement is quadratic, pressure linear and continuous (Taylor-Hood): the pair is inf-sup stable, so it neither locks nor lets the
pressure oscillate as ν → ½ (Boffi, Brezzi, Fortin 2013, §8.8). Geometry is isoparametric: mid-side nodes may lie on a curved boundary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import MeshingError
from gelsim.geometry import TET_EDGES, TetMesh

Array = NDArray[np.float64]


def tet_quadrature(points: int) -> tuple[Array, Array]:
    """Barycentric points (Q, 4) and weights (Q,) that sum to 1/6 (the reference volume).

    4 points integrate quadratics exactly, which is the stiffness of a straight linear-elastic ten-node tet; 11 (Keast 1986) integrate
    quartics.
    """
    if points == 4:
        a, b = 0.5854101966249685, 0.1381966011250105
        bary = np.full((4, 4), b) + (a - b) * np.eye(4)
        return bary, np.full(4, 1 / 24)
    if points == 11:
        bary = [np.full(4, 0.25)]
        weights = [-74 / 5625]
        for i in range(4):
            row = np.full(4, 1 / 14)
            row[i] = 11 / 14
            bary.append(row)
            weights.append(343 / 45000)
        a, b = 0.399403576166799, 0.100596423833201
        for i, j in TET_EDGES:
            row = np.full(4, b)
            row[[i, j]] = a
            bary.append(row)
            weights.append(56 / 2250)
        return np.array(bary), np.array(weights)
    raise ValueError(f"tet quadrature with {points} points is not known; 4 and 11 are")


def triangle_quadrature(points: int) -> tuple[Array, Array]:
    """Barycentric points (Q, 3) and weights (Q,), which sum to 1/2. 6: degree 4; 12: 6 (Dunavant 1985); 24 to 192: so in each quarter."""
    if points in (24, 48, 96, 192):
        bary, weights = triangle_quadrature(points // 4)
        corners = np.eye(3)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
        quarters = [middles, *(np.stack([corners[i], middles[i], middles[i - 1]]) for i in range(3))]
        return np.vstack([bary @ quarter for quarter in quarters]), np.tile(weights / 4, 4)

    def orbit3(a: float) -> list[list[float]]:
        b = (1 - a) / 2
        return [[a, b, b], [b, a, b], [b, b, a]]

    def orbit6(a: float, b: float) -> list[list[float]]:
        c = 1 - a - b
        return [[a, b, c], [b, c, a], [c, a, b], [b, a, c], [a, c, b], [c, b, a]]

    if points == 3:
        bary, weights = orbit3(2 / 3), [1 / 3] * 3
    elif points == 6:
        bary = orbit3(0.108103018168070) + orbit3(0.816847572980459)
        weights = [0.223381589678011] * 3 + [0.109951743655322] * 3
    elif points == 12:
        bary = orbit3(0.501426509658179) + orbit3(0.873821971016996) + orbit6(0.053145049844817, 0.310352451033784)
        weights = [0.116786275726379] * 3 + [0.050844906370207] * 3 + [0.082851075618374] * 6
    else:
        raise ValueError(f"triangle quadrature with {points} points is not known; 6, 12, 24, 48, 96 and 192 are")
    return np.array(bary), np.array(weights) / 2


def tet10_shape(bary: Array) -> Array:
    """Values of the ten shape functions, (..., 10), at barycentric points (..., 4)."""
    corner = bary * (2 * bary - 1)
    middle = 4 * bary[..., TET_EDGES[:, 0]] * bary[..., TET_EDGES[:, 1]]
    return np.concatenate([corner, middle], axis=-1)


def tet10_gradient(bary: Array) -> Array:
    """Derivatives with respect to the reference coordinates ξ = (λ1, λ2, λ3), (..., 10, 3)."""
    dlambda = np.array([[-1.0, -1.0, -1.0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    corner = (4 * bary - 1)[..., :, None] * dlambda
    i, j = TET_EDGES[:, 0], TET_EDGES[:, 1]
    middle = 4 * (bary[..., i, None] * dlambda[j] + bary[..., j, None] * dlambda[i])
    return np.concatenate([corner, middle], axis=-2)


def tri6_shape(bary: Array) -> Array:
    """Values of the six shape functions, (..., 6), at barycentric points (..., 3)."""
    corner = bary * (2 * bary - 1)
    a, b, c = bary[..., 0], bary[..., 1], bary[..., 2]
    return np.concatenate([corner, np.stack([4 * a * b, 4 * b * c, 4 * c * a], axis=-1)], axis=-1)


def tri6_gradient(bary: Array) -> Array:
    """Derivatives with respect to ξ = (λ1, λ2), (..., 6, 2)."""
    dlambda = np.array([[-1.0, -1.0], [1, 0], [0, 1]])
    corner = (4 * bary - 1)[..., :, None] * dlambda
    i, j = np.array([0, 1, 2]), np.array([1, 2, 0])
    middle = 4 * (bary[..., i, None] * dlambda[j] + bary[..., j, None] * dlambda[i])
    return np.concatenate([corner, middle], axis=-2)


@dataclass(frozen=True, eq=False)
class TetQuadrature:
    """What a solid needs at its quadrature points, in the rest configuration."""

    gradients: Array
    """∂N/∂X, shape (T, Q, 10, 3), per unit length."""
    weights: Array
    """det(∂X/∂ξ) times the rule's weight, shape (T, Q)."""
    pressure_shape: Array
    """Linear shape functions at the points, shape (Q, 4)."""

    def displacement_gradient(self, displacement: Array) -> Array:
        """∂u/∂X at the points, (T, Q, 3, 3), of displacements at the tets' nodes, (T, 10, 3)."""
        return np.einsum("tni,tqnj->tqij", displacement, self.gradients, optimize=True)


def tet_quadrature_data(mesh: TetMesh, points: int) -> TetQuadrature:
    """Rest gradients of a mesh. Raises MeshingError where the mapping folds over."""
    bary, weights = tet_quadrature(points)
    reference = tet10_gradient(bary)
    jacobian = np.einsum("tni,qnj->tqij", mesh.rest_positions[mesh.tets], reference)
    determinant = np.linalg.det(jacobian)
    if (determinant <= 0).any():
        bad = int((determinant <= 0).any(axis=1).sum())
        raise MeshingError(f"{bad} of {len(mesh.tets)} ten-node tets fold over at a quadrature point; mesh the shape again")
    gradients = np.einsum("qnj,tqji->tqni", reference, np.linalg.inv(jacobian))
    return TetQuadrature(np.ascontiguousarray(gradients), determinant * weights, bary)
