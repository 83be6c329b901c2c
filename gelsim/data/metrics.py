"""How far two pictures are apart, in the numbers that the literature on tactile images uses; on levels 0 … 255.

    L1 = mean |a − b|,   MSE = mean (a − b)²,   PSNR = 10 log₁₀(255² / MSE),   SSIM after Wang et al. 2004

SSIM: Gaussian window of σ = 1.5 px (cut at 11 × 11), K₁ = 0.01, K₂ = 0.03, mean over the places whose window lies inside the picture and
over the colours. Left out: other versions of SSIM (uniform windows, grey pictures), whose numbers differ in the second digit.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

WINDOW_SD, WINDOW_REACH = 1.5, 5


def picture_errors(picture: NDArray, wanted: NDArray, counted: NDArray[np.bool_] | None = None) -> dict[str, float]:
    """l1, mse, ssim and psnr_db of a picture against another, both (H, W, 3) of levels, at least 11 pixels high and wide.

    Args:
        counted: Pixels that are compared, shape (H, W); all of them, when left out.
    """
    a, b = np.asarray(picture, np.float64), np.asarray(wanted, np.float64)
    some = slice(None) if counted is None or counted.all() else counted
    mse = float(((a - b)[some] ** 2).mean())
    psnr = float("inf") if mse == 0 else 10 * float(np.log10(255**2 / mse))
    return {"l1": float(np.abs(a - b)[some].mean()), "mse": mse, "ssim": structural_similarity(a, b, counted), "psnr_db": psnr}


def said(name: str, errors: Mapping[str, float | None]) -> str:
    """Errors in a line for people; a report has no PSNR where pictures are equal."""
    psnr = errors["psnr_db"]
    line = f"{name:<20} L1 {errors['l1']:.2f}  MSE {errors['mse']:.1f}  SSIM {errors['ssim']:.3f}"
    return line if psnr is None else f"{line}  PSNR {psnr:.1f} dB"


def structural_similarity(a: NDArray[np.float64], b: NDArray[np.float64], counted: NDArray[np.bool_] | None = None) -> float:
    """SSIM of two pictures (H, W, 3) of levels 0 … 255, over windows whose middles are counted."""
    from scipy.ndimage import correlate1d

    steps = np.arange(-WINDOW_REACH, WINDOW_REACH + 1)
    window = np.exp(-0.5 * (steps / WINDOW_SD) ** 2)
    window /= window.sum()

    inner = slice(WINDOW_REACH, -WINDOW_REACH)

    def blur(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return correlate1d(correlate1d(values, window, axis=0), window, axis=1)[inner, inner]

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b, both = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2, blur(a * b) - mean_a * mean_b
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    index = (2 * mean_a * mean_b + c1) * (2 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return float(index.mean() if counted is None or not counted[inner, inner].any() else index[counted[inner, inner]].mean())
