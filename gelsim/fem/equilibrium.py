"""Solids without contact: equilibrium of one body under prescribed displacements and dead loads, in solver units (mm, kPa, mN).

Plain Newton, halved where an element would turn inside out. For blocks with known answers and for specimens between bonded platens; a press
has its own march (quasistatic.py).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray

from gelsim.errors import SolveError
from gelsim.fem.assembly import Solids
from gelsim.fem.elements import tet_quadrature_data
from gelsim.fem.linear import make_solver
from gelsim.fem.pattern import build_pattern
from gelsim.fem.problem import isochoric_constants
from gelsim.geometry import TetMesh
from gelsim.scene.materials import ElasticMaterial
from gelsim.units import MM_PER_M

Array = NDArray[np.float64]


def solids_of(mesh: TetMesh, material: ElasticMaterial, fixed: NDArray[np.bool_], points: int = 4) -> Solids:
    """One solid in solver units; `fixed` (N, 3) says which displacement components are prescribed."""
    rest = mesh.rest_positions * MM_PER_M
    data = tet_quadrature_data(TetMesh(rest, mesh.tets), points)
    count = len(mesh.tets)
    law = np.tile(isochoric_constants(material), (count, 1))
    return Solids(rest, mesh.tets, data, law, np.full(count, material.kappa * 1e-3), fixed, "cpu")


def residual_of(solids: Solids, load: Array | None = None) -> tuple[Array, float]:
    """The equations of the unknowns under nodal forces `load` (N, 3) [mN], and the smallest det F."""
    force, volume, smallest = solids.internal_force()
    force = force if load is None else force - load
    return np.concatenate([force, volume[:, None]], axis=1)[solids.free], smallest


def tangent_of(solids: Solids) -> sp.csr_matrix:
    """The whole symmetric tangent."""
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    solids.add_tangent(pattern.pairs, values)
    upper = sp.csr_matrix((values.numpy(), pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size))
    return (upper + sp.triu(upper, 1).T).tocsr()


def equilibrium(solids: Solids, start: Array, load: Array | None = None, tolerance: float = 1e-11) -> int:
    """Newton from displacements `start` [mm] (N, 3), whose prescribed components stay, to equilibrium; the iterations it took.

    Ends when a step moves no node by more than `tolerance` of the body.

    Raises:
        SolveError: An element is inside out at the start, or 30 iterations were not enough.
    """
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    solver = make_solver()
    solver.analyse(pattern.indptr, pattern.indices, np.zeros(len(pattern.indices)))
    solids.set_state((start, solids.state()[1]))
    for iteration in range(1, 31):
        residual, smallest = residual_of(solids, load)
        if smallest <= 0:
            raise SolveError(f"equilibrium: an element is inside out (det F = {smallest:.3g}); give a smaller displacement or load")
        values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
        solids.add_tangent(pattern.pairs, values)
        solver.factorise(values.numpy())  # type: ignore[arg-type]
        change = solver.solve(-residual)
        state, fraction = solids.state(), 1.0
        solids.move(state, change, fraction)
        while residual_of(solids)[1] <= 0.1 and fraction > 1e-3:  # an element would turn inside out
            fraction /= 2
            solids.move(state, change, fraction)
        moved = np.zeros(solids.free.shape)
        moved[solids.free] = change
        if np.abs(moved[:, :3]).max() < tolerance * np.ptp(solids.rest, axis=0).max():
            return iteration
    raise SolveError("equilibrium: Newton did not converge in 30 iterations; give a smaller displacement or load")
