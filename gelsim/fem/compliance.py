"""A soft object's motion under small tractions on its surface, its base held: linear elasticity on the tets of a press.

Left out: all that is not linear, and parts of other materials.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.fem.assembly import Solids
from gelsim.fem.elements import tet_quadrature_data, tri6_gradient, tri6_shape
from gelsim.fem.linear import make_solver
from gelsim.fem.pattern import build_pattern
from gelsim.fem.problem import Numerics, isochoric_constants
from gelsim.geometry import TetMesh
from gelsim.scene.materials import ElasticMaterial
from gelsim.units import KPA_PER_PA, MM_PER_M

Array = NDArray[np.float64]


CUTS = 8
"""Of a face's edges, into pieces fine enough for forces that end within a face."""


def _middles(cuts: int) -> Array:
    """Barycentric middles of the cuts² like triangles that a triangle is cut into, (cuts², 3)."""
    i, j = np.divmod(np.arange(cuts**2), cuts)
    down = i + j >= cuts  # the other half of the square of corners
    a, b = np.where(down, cuts - i - 1 / 3, i + 1 / 3), np.where(down, cuts - j - 1 / 3, j + 1 / 3)
    return np.stack([cuts - a - b, a, b], axis=1) / cuts


class HeldBody:
    """Of a mesh with groups "base", which is held, and "contact". Lengths in mm, tractions in kPa, forces in mN.

    Attributes: `points`, the middles of small pieces of the contact faces, (Q, 3); `facing`, these pieces' areas along their outward
    normals, (Q, 3); `areas`, their z, below 0 where they face down, (Q,); `height`, of the base.
    """

    def __init__(self, mesh: TetMesh, material: ElasticMaterial) -> None:
        rest = mesh.rest_positions * MM_PER_M
        self.height = float(rest[np.unique(mesh.groups["base"]), 2].mean())
        fixed = np.zeros((len(rest), 3), bool)
        fixed[np.unique(mesh.groups["base"])] = True
        count = len(mesh.tets)
        data = tet_quadrature_data(TetMesh(rest, mesh.tets), Numerics().tet_points)
        law = np.tile(isochoric_constants(material), (count, 1))
        self._solids = Solids(rest, mesh.tets, data, law, np.full(count, material.kappa * KPA_PER_PA), fixed, "cpu")
        bary = _middles(CUTS)
        self._faces, self._shape = mesh.groups["contact"], tri6_shape(bary)
        corners = rest[self._faces]
        self.points = np.einsum("qa,fac->fqc", self._shape, corners).reshape(-1, 3)
        ways = np.einsum("qad,fac->fqcd", tri6_gradient(bary), corners)
        self.facing = np.cross(ways[..., 0], ways[..., 1]).reshape(-1, 3) / (2 * len(bary))
        self.areas = self.facing[:, 2]

    def work(self, forces: Array) -> Array:
        """What each of K sets of forces (K, Q, 3) on the points does on the motion by each, (K, K) [mN mm]."""
        solids = self._solids
        pattern = build_pattern(solids.free, solids.keys, "cpu")
        tangent = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
        solids.add_tangent(pattern.pairs, tangent)
        solver = make_solver()
        values = np.asarray(tangent.numpy(), np.float64)
        solver.analyse(pattern.indptr, pattern.indices, values)
        solver.factorise(values)
        shares = forces.reshape(len(forces), *self._faces.shape[:1], -1, 3)
        loads = np.zeros((len(forces), solids.node_count, 4))
        for load, of_faces in zip(loads, np.einsum("kfqc,qa->kfac", shares, self._shape), strict=True):
            np.add.at(load[:, :3], self._faces, of_faces)
        right = loads[:, solids.free]
        return right @ np.stack([solver.solve(load) for load in right]).T
