"""How wrong a press is, from the press alone: jumps of the stress between elements.

Zienkiewicz and Zhu (1987): the deviatoric Kirchhoff stress τ = μ dev b̄ of a finite-element solution jumps from element to element;
averaged at the vertices it becomes a continuous field τ* that is closer to the truth, and

    η² = Σ ∫ |τ* - τ|²/(2μ) dV  /  Σ ∫ |τ|²/(2μ) dV

estimates the squared relative error in energy. In a displacement-driven press the force follows the energy, so its relative error is
proportional to η², not η. What overlap the contact leaves is missing from the approach, and the force goes with its second power or less
(a ball's on a half-space with 1.5, on a thin layer with 2, a punch's with 1):

    |δF|/F = c η² + 2 ∫ p o dA / (s ∫ p dA)        p pressure, o overlap, s approach

c is measured against converged solutions (docs/validation.md). Left out: error of the pressure field and of the load steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.elements import TetQuadrature, tri6_gradient
from gelsim.fem.planar.elements import PlanarQuadrature

Array = NDArray[np.float64]

# Relative force error over η², on the safe side in all 360 states of the accuracy cases (docs/validation.md): there it was at most 0.16 of
# solids and 0.56 of profiles, whose jumps are smaller than what steps and contact add.
FORCE_ERROR_PER_JUMP = {"solid": 0.2, "profile": 0.8}
# Where a det F is below this, a sharp rim's singularity has no mesh that resolves it, and of solids the profiles' factor is taken: of rigid
# punches the error was 0.6 to 1.1 η². The accuracy cases have det F above 0.8.
DISTORTED = 0.6
# The force's error is that of the worst of so many states, spread from this share of the largest force on: first touch is fewer elements
# than make a mesh.
JUDGED, JUDGED_FROM = 5, 0.1
# RMS error of the membrane over its kink: 0.14 to 0.27 there.
MEMBRANE_ERROR_PER_KINK = 0.25
# A surface counts where it moves by more than this share of its largest motion: the contact and its neighbourhood.
MOVING = 0.05


def judged_states(force: Array) -> NDArray[np.int64]:
    """The states whose error is estimated, of forces (N,)."""
    some = np.flatnonzero(force >= JUDGED_FROM * force.max()) if force.max() > 0 else np.array([len(force) - 1])
    return some[np.unique(np.linspace(0, len(some) - 1, JUDGED).round().astype(np.int64))]


def force_error(jump: Array, overlap: Array, approach: Array, per_jump: float) -> float:
    """Relative error of the force, of the worst of some states.

    Args:
        jump: η² of each, (N,). overlap: Its mean weighted with the pressure, (N,). approach: In the same unit, (N,).
    """
    return float(np.max(per_jump * jump + 2 * np.where(approach > 0, overlap / np.where(approach > 0, approach, 1.0), 0.0)))


def stress_jump(tets: NDArray[np.int32], quadrature: TetQuadrature | PlanarQuadrature, shear: Array, displacement: Array,
                regions: NDArray[np.int32]) -> float:  # fmt: skip
    """η² of a state.

    Args:
        tets: (T, 10), or triangles (T, 6) of the plane, with their `quadrature`.
        shear: Small-strain shear modulus of each tet, (T,). Other laws are judged by the neo-Hookean stress of their deformation.
        displacement: Of all nodes, (N, 3), in the unit of the quadrature's lengths.
        regions: Of which material each tet is, (T,): stress may jump between two, so each has averages of its own.
    """
    weights, shape = quadrature.weights, quadrature.pressure_shape
    f = np.eye(3) + quadrature.displacement_gradient(displacement[tets])
    b = f @ np.swapaxes(f, -1, -2) * np.linalg.det(f)[..., None, None] ** (-2 / 3)
    deviator = b - np.trace(b, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    tau = shear[:, None, None, None] * deviator
    vertices = regions[:, None] * len(displacement) + tets[:, : shape.shape[1]]
    # vertex averages, each point counting with its volume and its nearness
    share = weights[..., None] * shape
    count = (int(regions.max()) + 1) * len(displacement)
    total = np.bincount(vertices.ravel(), share.sum(1).ravel(), count)
    moment = np.einsum("tqa,tqij->taij", share, tau, optimize=True).reshape(-1, 9)
    average = np.stack([np.bincount(vertices.ravel(), moment[:, c], count) for c in range(9)], 1)
    average /= np.where(total > 0, total, 1.0)[:, None]
    recovered = np.einsum("qa,taij->tqij", shape, average[vertices].reshape(*vertices.shape, 3, 3), optimize=True)
    scale = weights / (2 * shear[:, None])
    jump = (scale * ((recovered - tau) ** 2).sum((-2, -1))).sum()
    return float(jump / max((scale * (tau**2).sum((-2, -1))).sum(), 1e-300))


def surface_kink(rest: Array, faces: NDArray[np.int32], displacement: Array) -> float:
    """Edge length times the kink of the normal displacement across edges, root mean square over where the surface moves [unit of rest].

    Args:
        rest: (N, 3), of a surface that is a graph over x, y. faces: six-node faces (F, 6) of these nodes.
        displacement: (N, 3), in the same unit.
    """
    z = displacement[:, 2]
    corners = rest[faces[:, :3]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lying = np.abs(normal[:, 2]) > 1e-3 * np.linalg.norm(normal, axis=1)  # an upright face has no slope over x, y
    if not lying.any():
        return 0.0
    faces, area = faces[lying], 0.5 * np.abs(normal[lying, 2])
    area[np.abs(z[faces]).max(1) <= MOVING * np.abs(z[faces]).max()] = 0.0
    # slopes at the middles of the three sides; the middle nodes say which sides of two faces are one
    shape = tri6_gradient(np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]]))
    jacobian = np.einsum("fnc,end->fecd", rest[faces, :2], shape)
    slope = np.einsum("fn,end,fedc->fec", z[faces], shape, np.linalg.inv(jacobian)).reshape(-1, 2)
    order = np.argsort(faces[:, 3:].ravel(), kind="stable")
    name = faces[:, 3:].ravel()[order]
    first = np.flatnonzero(name[:-1] == name[1:])
    one, other = order[first], order[first + 1]
    along = rest[faces[one // 3, (one + 1) % 3], :2] - rest[faces[one // 3, one % 3], :2]
    jump = slope[one] - slope[other]
    across = along[:, 0] * jump[:, 1] - along[:, 1] * jump[:, 0]
    share = (area[one // 3] + area[other // 3]) / 3
    return float(np.sqrt((share * across**2).sum() / max(area.sum(), 1e-300)))
