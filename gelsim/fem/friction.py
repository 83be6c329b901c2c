"""The law of friction, which has its only home here: what traction a point bears at its pressure before it slides, and how that grows.

Coulomb's: |τ| ≤ μ p. The kernels of contact compile `slip_bound` and `slip_bound_slope` (contact_kernels.py); contact of profiles, the
energy balance and `gelsim.live` call them with arrays. So both are expressions that Warp and NumPy read alike, without a branch: `**`,
`np.where`, `np.cbrt` will do, and NumPy's minimum and maximum if imported as `min` and `max`; a number is written `np.float64(2.0)` within
the expression, a constant of the module `np.float64(SCALE)`, SCALE a plain float.

"stick" has no bound and μ = 0 no friction, whatever the law says; `gelsim.live` sticks by a μ of 1000. A further constant of the scene goes
μ's way: `Contact` (scene/definition.py), `ContactLaw` (contact.py), `LiveSensor`. reference.py has a copy, against which tests hold this.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def slip_bound(mu: Any, p: Any) -> Any:
    """Largest traction [kPa] at a pressure p [kPa]; μ is `contact.friction_coefficient`.

    Both are of an area at rest: of the area as it is now p is lower where the gel is stretched, which a law that is not linear in p feels.
    """
    return mu * p


def slip_bound_slope(mu: Any, p: Any) -> Any:
    """Its derivative by p. It is part of the tangent alone: a wrong one costs iterations, not accuracy."""
    return mu


def slip_bounds(mu: float, p: NDArray[np.floating]) -> NDArray[Any]:
    """`slip_bound` of arrays, in their precision."""
    return np.asarray(slip_bound(mu, p), p.dtype)
