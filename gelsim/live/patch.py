"""How the force of a contact goes on over a motion so small that the contact stays what it is: what an implicit time step asks for.

Each cell that touches is a spring along the gel's normal and one along its face, bounded as contact is: it does not pull, and shear stays
within friction's bound. Their stiffness is the traction of a flat punch of the contact's area
(`gelsim.live.layer.punch`), which is what a ball's pressure, too, grows by under a small motion (Johnson 1985, §5.3). Only the stability
of a step, and the force between two answers of the gel, rest on it, no force at rest: a linearly implicit step is stable if the stiffness
it assumes is over half of the true one (tests/unit/test_live_patch.py measures it).

Left out: cells that come to touch, how cells pull on each other, and the turn of what slides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.friction import slip_bounds
from gelsim.units import KPA_PER_PA

Array = NDArray[np.float64]


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
    """Of the gel at rest along x and y, shape (M, 2): along its normal a small motion presses."""
    lean: Array
    """Slope that is pressed into it, likewise; it goes with what is stuck to it. A pressure p acts as p (slope + lean, -1)."""
    area: float
    """Of a cell [m²]."""
    bound: Array
    """Of the shear [N], shape (M,)."""
    friction: float
    """Coefficient, by which bounds grow with the pressure."""
    springs: Array
    """Stiffness along the normal and along the face [N/m], shape (M, 2)."""

    @cached_property
    def stiffness(self) -> Array:
        """What a motion of the object adds to the wrench on the gel, bounds aside: (6, 6) [N/m, N, N m]."""
        return (self._pushed @ self._moved.transpose(0, 2, 1)).sum(axis=0)

    def wrench(self, motion: Array) -> Array:
        """Force [N] and torque [N m] on the gel after a small motion of the object in the gel's frame [m, rad], (6,) for (6,)."""
        force = self._forces(motion) if motion.any() else self._at_rest
        return np.concatenate([force.sum(axis=1), torque(self.points, force.T)])

    def changed(self, motion: Array) -> float:
        """By how much a motion changes the forces of the cells, over the normal force."""
        change = self._forces(motion) - self._at_rest
        return float(np.sqrt((change**2).sum(axis=0)).sum() / self.pressure.sum())

    def _forces(self, motion: Array) -> Array:
        """On the cells [N], (3, M)."""
        x, y, normal = motion @ self._pushed
        pressure = np.maximum(self.pressure + normal, 0.0)
        x, y = self.shear[:, 0] + x, self.shear[:, 1] + y
        per_kpa = self.area / KPA_PER_PA  # N
        before, now = (slip_bounds(self.friction, one / per_kpa) for one in (self.pressure, pressure))
        bound = self.bound * now / np.maximum(before, 1e-30)
        held = np.minimum(1.0, bound / np.maximum(np.sqrt(x**2 + y**2), 1e-30))
        rise_x, rise_y = (self.slope + self.lean).T
        return np.stack([held * x + pressure * rise_x, held * y + pressure * rise_y, -pressure])

    @cached_property
    def _at_rest(self) -> Array:
        return self._forces(np.zeros(6))

    @cached_property
    def _pushed(self) -> Array:
        """Forces of the springs by motions, along x, along y and normal, (3, 6, M)."""
        return self.springs.T[[1, 1, 0], None] * self._moved

    @cached_property
    def _moved(self) -> Array:
        """How far motions take each spring, along x, along y and normal into the gel, (3, 6, M): v + ω × r of the object's point there."""
        x, y, z = self.points.T
        moved = np.zeros((3, 6, len(x)))
        moved[0, 0], moved[0, 4], moved[0, 5] = 1.0, z, -y
        moved[1, 1], moved[1, 3], moved[1, 5] = 1.0, -z, x
        moved[2] = self.slope[:, 0] * moved[0] + self.slope[:, 1] * moved[1]
        moved[2, 2:5] -= np.stack([np.ones_like(x), y, -x])
        return moved


def torque(points: Array, forces: Array) -> Array:
    """Σ r × f about the origin, (3,)."""
    arms = points.T @ forces
    return np.array([arms[1, 2] - arms[2, 1], arms[2, 0] - arms[0, 2], arms[0, 1] - arms[1, 0]])
