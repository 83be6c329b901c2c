"""How wrong a press is, from the press alone: jumps of the stress between elements.

Zienkiewicz and Zhu (1987): the deviatoric Kirchhoff stress τ = μ dev b̄ of a finite-element solution jumps from element to element;
averaged at the vertices it becomes a continuous field τ* that is closer to the truth, and

    η² = Σ ∫ |τ* - τ|²/(2μ) dV  /  Σ ∫ |τ|²/(2μ) dV

estimates the squared relative error in energy. In a displacement-driven press the force follows the energy, so its relative error is
proportional to η², not η; the factor is measured against converged solutions (docs/validation.md). Left out: error of the pressure field
and of the load steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.elements import TetQuadrature

Array = NDArray[np.float64]

# Relative force error over η²: in `gelsim bench --only accuracy` it lay between 0.1 and 0.8, so this errs on the safe side.
FORCE_ERROR_PER_JUMP = 0.8


def stress_jump(tets: NDArray[np.int32], quadrature: TetQuadrature, shear: Array, displacement: Array, regions: NDArray[np.int32]) -> float:
    """η² of a state.

    Args:
        tets: (T, 10), with their `quadrature`.
        shear: Small-strain shear modulus of each tet, (T,). Other laws are judged by the neo-Hookean stress of their deformation.
        displacement: Of all nodes, (N, 3), in the unit of the quadrature's lengths.
        regions: Of which material each tet is, (T,): stress may jump between two, so each has averages of its own.
    """
    gradients, weights, shape = quadrature.gradients, quadrature.weights, quadrature.pressure_shape
    h = np.einsum("tni,tqnj->tqij", displacement[tets], gradients, optimize=True)
    f = np.eye(3) + h
    b = f @ np.swapaxes(f, -1, -2) * np.linalg.det(f)[..., None, None] ** (-2 / 3)
    deviator = b - np.trace(b, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    tau = shear[:, None, None, None] * deviator
    vertices = regions[:, None] * len(displacement) + tets[:, :4]
    # vertex averages, each point counting with its volume and its nearness
    share = weights[..., None] * shape
    count = (int(regions.max()) + 1) * len(displacement)
    total = np.bincount(vertices.ravel(), share.sum(1).ravel(), count)
    moment = np.einsum("tqa,tqij->taij", share, tau, optimize=True).reshape(-1, 9)
    average = np.stack([np.bincount(vertices.ravel(), moment[:, c], count) for c in range(9)], 1)
    average /= np.where(total > 0, total, 1.0)[:, None]
    recovered = np.einsum("qa,taij->tqij", shape, average[vertices].reshape(-1, 4, 3, 3), optimize=True)
    scale = weights / (2 * shear[:, None])
    jump = (scale * ((recovered - tau) ** 2).sum((-2, -1))).sum()
    return float(jump / max((scale * (tau**2).sum((-2, -1))).sum(), 1e-300))
