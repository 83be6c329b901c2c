"""From radiance to the 8-bit picture the sensor's camera delivers: exposure, white balance, tone curve, noise.

    level = 255 · sRGB( exposure · gain_c · shading_c · L_c )^gamma,     sRGB after IEC 61966-2-1, shading: `optics.shading`,

plus normal noise of `camera.noise_sd` levels, clipped and rounded. The exposure is the preset's, never automatic, so that frames and
presses can be compared. Left out: vignetting, Bayer mosaic, compression, crosstalk between the colours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.shading import shading_gain
from gelsim.scene import Scene


def develop(scene: Scene, radiance: NDArray[np.float32], index: int = 0) -> NDArray[np.uint8]:
    """The 8-bit sRGB picture of a linear one.

    Args:
        radiance: Linear RGB, shape (H, W, 3).
        index: The frame's number in its press: noise differs from frame to frame, and is the same again for the same scene.seed.
    Returns:
        Shape (H, W, 3).
    """
    camera = scene.camera
    radiance = (radiance * shading_gain(scene)).astype(np.float32)
    levels = 255.0 * srgb_tone(radiance * (camera.exposure * np.array(camera.white_balance, np.float32)))
    if camera.gamma != 1.0:
        levels = 255.0 * (levels / 255.0) ** camera.gamma
    if any(camera.noise_sd):
        rng = np.random.default_rng([scene.seed, index])
        levels = levels + rng.standard_normal(levels.shape) * np.array(camera.noise_sd)
    return np.rint(np.clip(levels, 0, 255)).astype(np.uint8)


def srgb_tone(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Linear 0…1 to sRGB 0…1, elementwise; values beyond are clipped, as a camera does."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
