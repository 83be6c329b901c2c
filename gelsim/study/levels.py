"""A picture in levels before the camera's noise and rounding, for derivatives: `optics.isp` without its last step.

level = 255 · tone(exposure · gain · shading · L)^gamma
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.scene.definition import Scene


def unrounded(scene: Scene, radiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Levels (H, W, 3) of a linear picture (H, W, 3)."""
    from gelsim.optics.shading import shading_gain
    from gelsim.optics.srgb import srgb_tone

    camera = scene.camera
    linear = radiance * shading_gain(scene) * (camera.exposure * np.array(camera.white_balance))
    tone = srgb_tone(linear) if camera.tone == "srgb" else np.clip(linear, 0.0, 1.0)
    return 255.0 * np.asarray(tone, np.float64) ** camera.gamma
