"""Orders of convergence of the mixed tets, fitted on four meshes against a Papkovich–Neuber solution of Navier's equations.

    u = a ((3 − 4ν) b e_z − z ∇b),   p = κ div u = a κ (2 − 4ν) ∂b/∂z,   b = exp(kx) cos(0.6 ky) cos(0.8 kz), which is harmonic,

(Barber, Elasticity, ch. 21) needs no body force. With it prescribed on the boundary of a block, quadratic displacements have errors of
third order in the edge, and linear pressures of second, in the L2 norm (Boffi, Brezzi, Fortin 2013, ch. 8: Taylor–Hood).
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_fixtures import MM, Array, box_mesh, equilibrium, solids_of

from gelsim.fem.assembly import Solids
from gelsim.fem.elements import tet10_shape, tet_quadrature
from gelsim.geometry import outer_faces
from gelsim.scene.materials import ElasticMaterial

SIZE = 2.0  # mm
K = 1.2  # 1/mm
AMPLITUDE = 1e-6  # strains of 1e-5: what is not linear is that share of the answer, far below the errors
CELLS = (2, 3, 4, 6)


def exact(place: Array, nu: float) -> tuple[Array, Array]:
    """u [mm] and div u at places (…, 3) [mm]."""
    x, y, z = np.moveaxis(place, -1, 0)
    grown, across, along = np.exp(K * x), np.cos(0.6 * K * y), np.cos(0.8 * K * z)
    b, b_z = grown * across * along, -0.8 * K * grown * across * np.sin(0.8 * K * z)
    slope = np.stack([K * b, -0.6 * K * grown * np.sin(0.6 * K * y) * along, b_z], axis=-1)
    u = -z[..., None] * slope
    u[..., 2] += (3 - 4 * nu) * b
    return AMPLITUDE * u, AMPLITUDE * (2 - 4 * nu) * b_z


def errors(cells: int, nu: float, planted: bool = False) -> tuple[float, float]:
    """Errors of displacement and pressure in the L2 norm, over the answer's."""
    line = np.linspace(0, SIZE * MM, cells + 1)
    mesh, material = box_mesh(line, line, line, ("bonded", "top", "side"), shake=0.15), ElasticMaterial.from_modulus(50e3, nu)
    boundary = np.zeros(len(mesh.rest_positions), bool)
    boundary[np.unique(outer_faces(mesh.tets))] = True
    solids = solids_of(mesh, material, np.repeat(boundary[:, None], 3, 1))
    if planted:  # a shape function that is a little off in every tet: consistent no more
        gradients = solids._inputs[3].numpy()
        gradients[:, :, 4] *= 1.01
        solids._inputs[3].assign(gradients)
    wanted, _ = exact(solids.rest, nu)
    equilibrium(solids, np.where(boundary[:, None], wanted, 0.0))
    return l2_errors(solids, material.kappa * 1e-3, nu)


def l2_errors(solids: Solids, kappa: float, nu: float) -> tuple[float, float]:
    bary, weights = tet_quadrature(11)
    place = np.einsum("qn,tnc->tqc", tet10_shape(bary), solids.rest[solids.tets])
    u, p = solids.state()
    corners = solids.rest[solids.tets[:, :4]]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))[:, None] * weights
    wanted, divergence = exact(place, nu)
    found = np.einsum("qn,tnc->tqc", tet10_shape(bary), u[solids.tets])
    pressure = np.einsum("qn,tn->tq", bary, p[solids.tets[:, :4]])

    def over(error: Array, answer: Array) -> float:
        return float(np.sqrt((volume * error**2).sum() / (volume * answer**2).sum()))

    return over(np.linalg.norm(found - wanted, axis=-1), np.linalg.norm(wanted, axis=-1)), over(
        pressure - kappa * divergence, kappa * divergence
    )


def orders(nu: float, planted: bool = False) -> tuple[Array, Array]:
    """Fitted orders of displacement and pressure, and the errors (meshes, 2)."""
    found = np.array([errors(cells, nu, planted) for cells in CELLS])
    return -np.polyfit(np.log(CELLS), np.log(found), 1)[0], found


def as_they_should_be(fitted: Array) -> bool:
    """Edges fall to a third: an order fitted 0.3 too low is 1.4 times the error on the finest mesh."""
    return bool(fitted[0] > 3.0 - 0.3 and fitted[1] > 2.0 - 0.3)


@pytest.mark.parametrize("nu", [0.3, 0.499])
def test_errors_fall_with_the_elements_orders(nu: float) -> None:
    fitted, found = orders(nu)
    assert as_they_should_be(fitted), (fitted, found)


def test_an_inconsistent_element_is_found_out() -> None:
    fitted, found = orders(0.3, planted=True)
    assert not as_they_should_be(fitted) and fitted[1] < 1.5, (fitted, found)  # found: 2.66, 1.32
