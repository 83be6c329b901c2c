"""The smallest dent that a camera shows: a bell in the gel's surface, of standard deviation BELL, at which an ideal observer who knows its
place reaches d' = SEEN.

The picture's change ΔP is drawn finely around the gel's middle and linear in the dent's depth. Pixels of size p average it over their area,
a lens out of focus over its blur disc, and each adds noise σ. Averaged over where pixels lie on the dent,

    d'² = Σ_colours (1 / (σ² p²)) ∫ |ΔP^(f)|² sinc²(p f_x) sinc²(p f_y) B²(f) d²f,      B(f) = 2 J₁(π c f) / (π c f),

(Parseval; Green and Swets 1966). The blur disc has c = APERTURE · defocus / distance on the gel (thin lens, geometric optics): 0 where
the camera is focused, on the gel at rest, and for DEEP that of a dent at the bottom of a press.

Left out: diffraction, shot noise, the mosaic of colours; gelsim's pictures are sharp everywhere (a pinhole), so the lens is only here.
"""

from __future__ import annotations

import numpy as np

from gelsim.errors import SceneError
from gelsim.study.levels import unrounded
from gelsim.study.photometric import exposed
from gelsim.study.trial import Trial
from gelsim.units import MM

BELL = 0.15e-3
"""[m]; 0.35 mm across at half its depth, and twice the membrane's grid."""
DEPTH = 2e-6
"""Drawn; slopes reach 0.008."""
SEEN = 3.0
APERTURE = 2e-3
"""Of the lens [m], such as f/2 at a focal length of 4 mm."""
DEEP = 1.5e-3
"""Out of focus by this [m]."""
FINE = {"camera.field_mm": [4.0, 3.0], "camera.resolution": [160, 120], "render.resolution": [160, 120]}
"""What is drawn: pixels of 25 µm, beyond whose frequencies the dent has nothing."""


def smallest_dent(trial: Trial, defocus: float) -> float:
    """Its depth [m].

    Args:
        defocus: Distance from the focused plane [m].
    Raises:
        SceneError: The camera has no noise.
    """
    from scipy.special import j1

    camera = trial.scene.camera
    noise = np.array(camera.noise_sd)
    if not (noise > 0).all():
        raise SceneError(f"camera.noise_sd = {' '.join(f'{n:g}' for n in noise)}: without noise every dent is seen; above 0 is allowed")
    change, step = trial.once(_change)
    pixel = camera.field_mm[0] * MM / camera.resolution[0]
    down, along = (np.fft.fftfreq(count, step)[shape] for count, shape in zip(change.shape, (np.s_[:, None], np.s_[None, :]), strict=False))
    blur = np.pi * APERTURE * defocus / (camera.distance_mm * MM) * np.hypot(down, along)
    disc = np.where(blur > 1e-9, 2 * j1(blur) / np.maximum(blur, 1e-9), 1.0)
    passed = np.sinc(pixel * along) * np.sinc(pixel * down) * disc
    # Parseval: the integral over frequencies of a sampled field is its sum of squares times the area of a sample.
    power = (np.abs(np.fft.fft2(change, axes=(0, 1))) ** 2 * passed[..., None] ** 2).sum(axis=(0, 1)) / passed.size * step**2
    return SEEN / float(np.sqrt((power / (noise * pixel) ** 2).sum()))


def _change(trial: Trial) -> tuple[np.ndarray, float]:
    """∂P/∂depth (H, W, 3) [levels/m] around the middle, and its pixels' size [m]."""
    from gelsim.membrane.surface import moved_membrane
    from gelsim.optics.camera import pixel_size

    near = trial.beside(FINE)

    def displacement(places: np.ndarray) -> np.ndarray:
        height = -DEPTH * np.exp(-(places**2).sum(axis=1) / (2 * BELL**2))
        return np.stack([np.zeros_like(height), np.zeros_like(height), height], axis=1)

    scene = exposed(near.scene, near.rest)
    dent, rest = (unrounded(scene, frame.radiance) for frame in (near.draw([moved_membrane(near.scene, displacement)])[0], near.rest))
    return (dent - rest) / DEPTH, pixel_size(near.scene)
