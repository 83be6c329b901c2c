"""What a smooth face between two clear media reflects (Fresnel), for unpolarised light. NumPy.

    R = ½ [ ((n₁ c₁ − n₂ c₂)/(n₁ c₁ + n₂ c₂))² + ((n₁ c₂ − n₂ c₁)/(n₁ c₂ + n₂ c₁))² ],    n₁ s₁ = n₂ s₂,

c and s the cosines and sines of the angles with the normal; everything beyond the critical angle n₂/n₁ = s₁.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def reflectance(cosine: ArrayLike, from_index: float, to_index: float) -> NDArray[np.float64]:
    """Reflected share of light that comes through `from_index` at the cosine of its angle with the face's normal, elementwise."""
    first = np.asarray(cosine, np.float64)
    second = np.sqrt(np.clip(1 - (from_index / to_index) ** 2 * (1 - first**2), 0, None))
    across = (from_index * first - to_index * second) / (from_index * first + to_index * second)
    along = (from_index * second - to_index * first) / (from_index * second + to_index * first)
    return 0.5 * (across**2 + along**2)


def critical_angle(from_index: float, to_index: float) -> float:
    """Beyond it [rad] a face reflects everything; π/2 where it never does."""
    return float(np.arcsin(min(to_index / from_index, 1.0)))


def diffuse_return(from_index: float, to_index: float, count: int = 20_000) -> float:
    """Share of Lambertian light that a face reflects: ∫ R(c) 2 c dc over the hemisphere, by midpoints (error below 1e-4)."""
    cosine = (np.arange(count) + 0.5) / count
    return float(np.mean(2 * cosine * reflectance(cosine, from_index, to_index)))
