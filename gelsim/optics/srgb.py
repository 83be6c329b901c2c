"""The tone curve of sRGB (IEC 61966-2-1), elementwise on values 0 … 1."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SRGB_FOOT = 0.0031308
"""Below it the curve is a line of slope 12.92."""


def srgb_tone(linear: NDArray[np.floating]) -> NDArray[Any]:
    """Linear to sRGB; values beyond 0 … 1 are clipped, as a camera does."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= SRGB_FOOT, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def srgb_linear(tone: NDArray[np.floating]) -> NDArray[Any]:
    """The inverse of `srgb_tone`."""
    return np.where(tone <= 12.92 * SRGB_FOOT, tone / 12.92, ((tone + 0.055) / 1.055) ** 2.4)
