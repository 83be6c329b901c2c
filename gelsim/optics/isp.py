"""From radiance to the 8-bit picture the sensor's camera delivers: shading, exposure, white balance, noise, tone curve.

    x_c = exposure · gain_c · shading_c · L_c,   x_c += √(x_c / N_c + σ_c²) · normal,   level = 255 · tone(x_c)^gamma + s_c · normal,

shading by `optics.shading`, N the electrons of a white pixel (shot noise; normal in place of Poisson: at N x = 100 electrons the skewness
is 0.1), σ the read noise before the tone curve, s noise after it, as it is measured on finished pictures. Tone: sRGB after
IEC 61966-2-1, or none. Clipped, rounded. The exposure is the preset's, never automatic, so that frames and presses can be compared. Left
out: Bayer mosaic, compression, crosstalk between the colours, fixed-pattern noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.camera import window_transmission
from gelsim.optics.shading import shading_gain
from gelsim.scene import Scene


def develop(scene: Scene, radiance: NDArray[np.float32], index: int = 0) -> NDArray[np.uint8]:
    """The 8-bit picture of a linear one.

    Args:
        radiance: Linear RGB, shape (H, W, 3), of the scene's render resolution where the camera has shading or Fresnel losses.
        index: The frame's number in its press: noise differs from frame to frame, and is the same again for the same scene.seed.
    Returns:
        Shape (H, W, 3).
    """
    camera = scene.camera
    linear = radiance * shading_gain(scene) * (camera.exposure * np.array(camera.white_balance))
    if camera.fresnel:
        linear *= window_transmission(scene)[..., None]
    rng = np.random.default_rng([scene.seed, index])
    if any(camera.full_well) or any(camera.read_noise):
        electrons = np.array(camera.full_well)
        shot = np.divide(1.0, electrons, out=np.zeros(3), where=electrons > 0)
        variance = np.clip(linear, 0, None) * shot + np.array(camera.read_noise) ** 2
        linear += np.sqrt(variance) * rng.standard_normal(linear.shape)
    linear = linear.astype(np.float32)
    levels = srgb_tone(linear) if camera.tone == "srgb" else np.clip(linear, 0.0, 1.0)
    levels = 255.0 * (levels if camera.gamma == 1.0 else levels**camera.gamma)
    if any(camera.noise_sd):
        levels = levels + rng.standard_normal(levels.shape) * np.array(camera.noise_sd)
    return np.rint(np.clip(levels, 0, 255)).astype(np.uint8)


def srgb_tone(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Linear 0…1 to sRGB 0…1, elementwise; values beyond are clipped, as a camera does."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
