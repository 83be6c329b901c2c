"""How well a sensor shows fine shallow texture: what its picture changes by for a micrometre of it, over the camera's noise.

The gel's surface is moved along z by A sin(k x) sin(k y), k = 2π / WAVELENGTH, and the picture P developed at the exposure of
`photometric`. The signal of a pixel is

    sqrt( mean over pixels of Σ_colours ((P - P_rest) / σ)² ) / A,

σ the camera's noise: d' of an ideal observer of one pixel, per micrometre. It is linear in A while slopes, 2π A / WAVELENGTH, are small
against the width of the coat's lobe. Both pictures are drawn from the same random numbers, so that most of their own noise cancels. Left
out: how deep an object's texture goes into the gel; what neighbours that are averaged gain.
"""

from __future__ import annotations

import numpy as np

from gelsim.errors import SceneError
from gelsim.study.levels import unrounded
from gelsim.study.photometric import exposed
from gelsim.study.trial import Trial

WAVELENGTH = 1e-3
"""Of the wave along x and along y [m]."""
AMPLITUDE = 2e-6
"""Slopes reach 0.013."""


def texture_signal(trial: Trial) -> float:
    """[1/m].

    Raises:
        SceneError: The camera has no noise, or pixels are too coarse for the wave.
    """
    from gelsim.membrane.surface import moved_membrane
    from gelsim.optics.camera import pixel_size

    noise = np.array(trial.scene.camera.noise_sd)
    if not (noise > 0).all():
        raise SceneError(f"camera.noise_sd = {' '.join(f'{n:g}' for n in noise)}: without noise every texture is seen; above 0 is allowed")
    if pixel_size(trial.scene) > WAVELENGTH / 4:
        raise SceneError(f"render.resolution: pixels of {pixel_size(trial.scene) * 1e3:.2g} mm are too coarse for a wave of 1 mm")
    wave = 2 * np.pi / WAVELENGTH

    def displacement(places: np.ndarray) -> np.ndarray:
        height = AMPLITUDE * np.sin(wave * places[:, 0]) * np.sin(wave * places[:, 1])
        return np.stack([np.zeros_like(height), np.zeros_like(height), height], axis=1)

    scene = exposed(trial.scene, trial.rest)
    frame = trial.draw([moved_membrane(trial.scene, displacement)])[0]
    change = (unrounded(scene, frame.radiance) - unrounded(scene, trial.rest.radiance)) / noise
    return float(np.sqrt((change**2).sum(axis=-1).mean()) / AMPLITUDE)
