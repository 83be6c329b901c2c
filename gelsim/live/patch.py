"""How the force of a contact goes on over a motion so small that the contact stays what it is: what an implicit time step asks for.

Each cell that touches is a spring along the gel's normal and one along its face, bounded as contact is: it does not pull, and shear stays
within the coefficient of friction times pressure. Their stiffness is shared out as the pressure p is. Its sum: by the Cauchy-Schwarz
inequality a patch that moves as one is at least (Σp)² / p·Ap stiff, A being displacement by traction (on a half-space 5/6 of a ball's
stiffness), and ABOVE_LEAST times that is taken. Only the stability of a step rests on it, no force at rest: a linearly implicit step is
stable if the stiffness it assumes is over half of the true one (tests/unit/test_live_patch.py measures it).

Left out: cells that come to touch, how cells pull on each other, and the turn of what slides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ABOVE_LEAST = 1.4
"""Brings it to 0.75 to 1.2 times the true stiffness, along the normal and along the face, of balls R 3 and 8 down to half the thickness."""


@dataclass(frozen=True, eq=False)
class Patch:
    """M cells of the gel in contact. Motions and wrenches have six numbers, linear before angular, about the origin of the gel's frame."""

    points: Array
    """Middles of the cells on the deformed surface [m], shape (M, 3)."""
    pressure: Array
    """Forces along the normal [N], shape (M,)."""
    shear: Array
    """Forces along x and y of the gel [N], shape (M, 2)."""
    slope: Array
    """Of the gel at rest along x and y, shape (M, 2): a pressure p acts as p (slope, -1)."""
    friction: float
    """Coefficient."""
    normal_stiffness: float
    """Of all cells together [N/m]."""
    shear_stiffness: float
    """Likewise along the face [N/m]."""

    def stiffness(self) -> Array:
        """What a motion of the object adds to the wrench on the gel, bounds aside: (6, 6) [N/m, N, N m]."""
        along, normal = self._springs()
        rows = np.concatenate([along, normal[:, None]], axis=1)
        return np.einsum("mki,mk,mkj->ij", rows, self._shares()[:, [1, 1, 0]], rows)

    def wrench(self, motion: Array) -> Array:
        """Force [N] and torque [N m] on the gel after a small motion of the object in the gel's frame [m, rad], (6,) for (6,)."""
        along, normal = self._springs()
        shares = self._shares()
        pressure = np.maximum(self.pressure + shares[:, 0] * (normal @ motion), 0.0)
        shear = self.shear + shares[:, 1:] * (along @ motion)
        size = np.linalg.norm(shear, axis=1)
        shear *= np.minimum(1.0, self.friction * pressure / np.maximum(size, 1e-30))[:, None]
        force = np.column_stack([shear + pressure[:, None] * self.slope, -pressure])
        return np.concatenate([force.sum(axis=0), np.cross(self.points, force).sum(axis=0)])

    def _shares(self) -> Array:
        """Stiffness of each cell along the normal and along the face [N/m], (M, 2)."""
        total = self.pressure.sum()
        return np.outer(self.pressure / (total if total else 1.0), [self.normal_stiffness, self.shear_stiffness])

    def _springs(self) -> tuple[Array, Array]:
        """How far a motion takes each spring: along x and y (M, 2, 6), and along the normal, into the gel, (M, 6)."""
        moved = np.zeros((len(self.points), 3, 6))  # of the object's point at each cell: v + ω × r
        moved[:, :, :3] = np.eye(3)
        x, y, z = self.points.T
        moved[:, 0, 4], moved[:, 0, 5] = z, -y
        moved[:, 1, 3], moved[:, 1, 5] = -z, x
        moved[:, 2, 3], moved[:, 2, 4] = y, -x
        return moved[:, :2], np.einsum("mk,mki->mi", np.column_stack([self.slope, -np.ones(len(self.points))]), moved)
