"""What a ball that is dragged sideways does to the gel's surface: a hand that presses also drags, and the dots show it.

A disc of contact of radius a that sticks moves by δ, and the coat around it follows. Of a linear, incompressible layer of thickness t,
bonded below, the surface answers a tangential traction of wave number k along it by c_L/(G k), across it by c_T/(G k), h = k t:

    c_L = (sinh 2h + 2h) / (2 cosh 2h + 2 + 4h²),    c_T = tanh h      (½ and 1 for a half-space)

and under the traction q ∝ 1/√(1 − ρ²/a²) of a half-space's rigid shift (Johnson 1985, 3.7) a point at ρ, at the angle θ from the drag,
moves by f₀ + f₂ cos 2θ along the drag and by f₂ sin 2θ across it, times δ,

    f₀ = N ∫ sin(ka)/k · (c_L + c_T)/2 · J₀(kρ) dk,    f₂ = N ∫ sin(ka)/k · (c_T − c_L)/2 · J₂(kρ) dk,

N such that f₀ is 1 on the mean over the contact. The half-space's part is in closed form; what the layer takes from it falls as exp(−2h).
Left out: the dent's steepness, slip, and the normal forces that a thin layer's drag brings.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REACH, NODES = 14.0, 281
"""Largest tabulated ρ/a, and places up to it."""
LAYERS = np.geomspace(1.0, 16.0, 9)
"""Tabulated t/a; a thinner layer is taken for the first, a thicker for the last."""


@lru_cache(maxsize=1)
def _tables() -> tuple[Array, Array]:
    """f₀ and f₂ over t/a (first axis) and ρ/a, each of shape (LAYERS, NODES)."""
    from scipy.special import j0, jv

    rho = np.linspace(0, REACH, NODES)
    inverse = 1 / np.maximum(rho, 1.0)
    # ∫ sin k / k J₀ = asin(1/ρ) and ∫ sin k / k J₂ = √(1 − 1/ρ²)/ρ outside of the contact, π/2 and 0 inside.
    f0, f2 = np.tile(0.75 * np.arcsin(inverse), (len(LAYERS), 1)), np.tile(0.25 * inverse * np.sqrt(1 - inverse**2), (len(LAYERS), 1))
    for row, layer in enumerate(LAYERS):
        k = (np.arange(2000) + 0.5) * (12.0 / layer / 2000)
        h = k * layer
        along = (np.sinh(2 * h) + 2 * h) / (2 * np.cosh(2 * h) + 2 + 4 * h**2) - 0.5
        across = np.tanh(h) - 1
        weight = np.sinc(k / np.pi) * (k[1] - k[0])
        f0[row] += j0(np.outer(rho, k)) @ (weight * (along + across) / 2)
        f2[row] += jv(2, np.outer(rho, k)) @ (weight * (across - along) / 2)
        inside = rho <= 1
        scale = np.average(f0[row, inside], weights=np.maximum(rho[inside], 1e-9))
        f0[row], f2[row] = f0[row] / scale, f2[row] / scale
    fade = np.clip((REACH - rho) / (0.1 * REACH), 0, 1)
    return f0 * fade, f2 * fade


def carried(away_mm: Array, contact_mm: Array, thickness_mm: float, drag_mm: Array) -> Array:
    """How far the coat has moved sideways [mm], shape (N, 2), where it now lies `away_mm` from the contact's middle.

    Args:
        away_mm: Shape (N, 2).
        contact_mm: Radius of the contact, shape (N,).
        drag_mm: Of the ball since it touched, shape (N, 2).
    """
    if not np.any(drag_mm):
        return np.zeros_like(away_mm)
    f0, f2 = _tables()
    distance = np.sqrt((away_mm**2).sum(axis=1)) + 1e-12
    row = np.interp(np.log(thickness_mm / contact_mm), np.log(LAYERS), np.arange(len(LAYERS)))
    column = np.minimum(distance / contact_mm * ((NODES - 1) / REACH), NODES - 1.000001)
    i, j = np.minimum(row.astype(int), len(LAYERS) - 2), column.astype(int)
    s, t = row - i, column - j
    both, turned = (
        (1 - s) * ((1 - t) * table[i, j] + t * table[i, j + 1]) + s * ((1 - t) * table[i + 1, j] + t * table[i + 1, j + 1])
        for table in (f0, f2)
    )
    # cos 2θ and sin 2θ of the angle from the drag: 2 n (n·d) − d is the drag mirrored at the direction n to the point.
    toward = away_mm / distance[:, None]
    mirrored = 2 * toward * (toward * drag_mm).sum(axis=1, keepdims=True) - drag_mm
    return both[:, None] * drag_mm + turned[:, None] * mirrored
