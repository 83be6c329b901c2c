"""Six-node triangles in the (r, z) half plane of a body of revolution, or in the (x, z) plane of plane strain; three-node edges. NumPy.

A point of the plane is embedded in space as (x, 0, z), so that a node keeps the four unknowns of `assembly` (u_x, u_y, u_z, p), u_y
prescribed as zero. The displacement gradient is then

    H = Σ_a u_a ⊗ (∂N_a/∂x, 0, ∂N_a/∂z)  +  (Σ_a u_xa N_a/r) e_y ⊗ e_y            the second term on bodies of revolution only: u_r/r

and the volume of a point r dr dz (per radian of the revolution) or dx dz (per length). N_a/r is stored in the place of ∂N_a/∂y.

Taylor-Hood (quadratic displacement, linear continuous pressure) is stable in the plane and, with these weights, on bodies of revolution
(Boffi, Brezzi, Fortin 2013, §8.8). Geometry is isoparametric. No quadrature point lies on the axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import MeshingError
from gelsim.fem.elements import tri6_gradient, tri6_shape, triangle_quadrature

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlanarQuadrature:
    """What a solid needs at its quadrature points, in the rest configuration."""

    gradients: Array
    """(∂N/∂x, N/r or 0, ∂N/∂z), shape (T, Q, 6, 3), per unit length."""
    weights: Array
    """det(∂X/∂ξ) times the rule's weight, times r on bodies of revolution, shape (T, Q)."""
    pressure_shape: Array
    """Linear shape functions at the points, shape (Q, 3)."""

    def displacement_gradient(self, displacement: Array) -> Array:
        """H at the points, (T, Q, 3, 3), of displacements at the triangles' nodes, (T, 6, 3)."""
        in_plane = self.gradients * [1.0, 0.0, 1.0]
        h = np.einsum("tni,tqnj->tqij", displacement, in_plane, optimize=True)
        h[..., 1, 1] = np.einsum("tn,tqn->tq", displacement[..., 0], self.gradients[..., 1])
        return h


def planar_quadrature(nodes: Array, triangles: NDArray[np.int32], turned: bool, points: int = 6) -> PlanarQuadrature:
    """Rest gradients of triangles (T, 6) over nodes (N, 3) whose y is 0. Raises MeshingError where the mapping folds over."""
    bary, rule = triangle_quadrature(points)
    reference, shape = tri6_gradient(bary), tri6_shape(bary)
    corners = nodes[triangles][..., [0, 2]]
    jacobian = np.einsum("tni,qnj->tqij", corners, reference)
    determinant = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
    if (determinant <= 0).any():
        bad = int((determinant <= 0).any(axis=1).sum())
        raise MeshingError(f"{bad} of {len(triangles)} six-node triangles fold over at a quadrature point; mesh the profile again")
    inverse = np.empty_like(jacobian)
    inverse[..., 0, 0], inverse[..., 1, 1] = jacobian[..., 1, 1], jacobian[..., 0, 0]
    inverse[..., 0, 1], inverse[..., 1, 0] = -jacobian[..., 0, 1], -jacobian[..., 1, 0]
    inverse /= determinant[..., None, None]
    flat = np.einsum("qnj,tqji->tqni", reference, inverse)
    gradients = np.zeros((*flat.shape[:3], 3))
    gradients[..., 0], gradients[..., 2] = flat[..., 0], flat[..., 1]
    weights = determinant * rule
    if turned:
        radius = corners[..., 0] @ shape.T
        gradients[..., 1] = shape / radius[..., None]
        weights = weights * radius
    return PlanarQuadrature(np.ascontiguousarray(gradients), weights, bary)


def edge_quadrature(points: int) -> tuple[Array, Array]:
    """Gauss points ξ in [0, 1] and weights that sum to 1."""
    place, weight = np.polynomial.legendre.leggauss(points)
    return (place + 1) / 2, weight / 2


def edge_shape(xi: Array) -> Array:
    """Values (..., 3) of the three-node edge's shape functions at ξ: its start, its end, its middle."""
    return np.stack([(1 - xi) * (1 - 2 * xi), xi * (2 * xi - 1), 4 * xi * (1 - xi)], axis=-1)


def edge_gradient(xi: Array) -> Array:
    """Their derivatives by ξ, (..., 3)."""
    return np.stack([4 * xi - 3, 4 * xi - 1, 4 - 8 * xi], axis=-1)


EDGE_CURVATURE = np.array([4.0, 4.0, -8.0])
"""Their second derivatives."""
