"""The camera's shading: a smooth gain over the picture for each colour, as image pipelines correct it and calibrations measure it.

    gain_c(u, v) = exp( Σ_k a_kc u^i v^j ),      1 ≤ i + j ≤ degree,     (i, j) = (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), …

u and v run from −1 to 1 across and down the picture. It multiplies the radiance before exposure. What lights and coating do not explain of
the no-contact picture (housing, light guides, lens) can be kept in it; `gelsim calibrate` says what it is worth on presses it was not
fitted to. Left out: what is steeper than the polynomial.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.scene.definition import Scene
from gelsim.scene.limits import SHADING_DEGREES


def shading_basis(u: NDArray[np.float64], v: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """The polynomials at places (u, v) of shape (N,): shape (N, S), S = degree (degree + 3) / 2."""
    powers = [u ** (total - j) * v**j for total in range(1, degree + 1) for j in range(total + 1)]
    return np.stack(powers, axis=1) if powers else np.zeros((len(u), 0))


def shading_gain(scene: Scene) -> NDArray[np.float64]:
    """Gain of each pixel of the rendered picture, shape (H, W, 3), or (1, 1, 3) where the camera has none."""
    coefficients = np.array(scene.camera.shading).reshape(-1, 3)
    if len(coefficients) == 0:
        return np.ones((1, 1, 3))
    width, height = scene.render.resolution
    v, u = np.mgrid[:height, :width]
    basis = shading_basis((2 * u.ravel() + 1) / width - 1, (2 * v.ravel() + 1) / height - 1, SHADING_DEGREES[len(coefficients)])
    return np.exp(basis @ coefficients).reshape(height, width, 3)
