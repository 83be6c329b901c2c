"""Where the black markers sit on the coating at rest, and their outlines. Plain NumPy, SI.

A square grid, moved from the gel's centre by `offset_mm` and turned by `tilt_deg`; place, size and outline of each marker are then
disturbed, because they are made by hand. The outline in polar form about the marker's centre: r(φ) = r₀ (1 + Σ_{k=2..4} a_k cos(kφ − φ_k)),
a_k normal with a total variance of `outline_jitter`². Both the membrane (markers move with the material) and the coating (markers are
painted on it) need this, and they do not know each other, so it lies below both. Left out: doubled and missing markers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.scene.definition import Scene

OUTLINE_HARMONICS = np.array([2, 3, 4])
"""1 would shift the marker's centre, 0 its size."""


@dataclass(frozen=True, eq=False)
class MarkerLayout:
    """The markers in material coordinates (rest x and y)."""

    centres: NDArray[np.float64]
    """[m], shape (K, 2), row by row from the top left of the picture."""
    radii: NDArray[np.float64]
    """[m], shape (K,)."""
    outline: NDArray[np.complex128]
    """a_k exp(i φ_k) of the harmonics 2, 3, 4; shape (K, 3)."""


def marker_layout(scene: Scene) -> MarkerLayout:
    """The markers of the scene's sensor that lie wholly on the gel.

    Raises:
        SceneError: Unknown layout, or a pitch or radius that is not positive, or markers that overlap.
    """
    markers = scene.markers
    if markers.layout == "none":
        return MarkerLayout(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3), complex))
    if markers.layout != "grid":
        raise SceneError(f"markers.layout is {markers.layout!r}; allowed are 'grid' and 'none'")
    if not 0 < 2 * markers.radius_mm < markers.pitch_mm:
        raise SceneError(
            f"markers.radius_mm is {markers.radius_mm} mm and markers.pitch_mm {markers.pitch_mm} mm; "
            "a radius must be positive and less than half the pitch"
        )
    half_size = np.array(scene.gel.size_mm) / 2
    reach = int(np.ceil((np.hypot(*half_size) + np.hypot(*markers.offset_mm)) / markers.pitch_mm))
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    turn = np.radians(markers.tilt_deg)
    x, y = column * markers.pitch_mm, row * markers.pitch_mm
    centres = np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], axis=-1).reshape(-1, 2)
    centres = centres + np.array(markers.offset_mm)

    # Drawn for the whole grid before cropping, so that a marker keeps its shape when the gel's size changes a little.
    rng = np.random.default_rng(markers.seed)
    centres = centres + markers.jitter_mm * rng.standard_normal(centres.shape)
    radii = markers.radius_mm * np.clip(1 + markers.size_jitter * rng.standard_normal(len(centres)), 0.4, 1.6)
    shape = (len(centres), len(OUTLINE_HARMONICS))
    # Each of the 2 x 3 normal parts contributes half its variance to the outline's.
    spread = markers.outline_jitter / np.sqrt(len(OUTLINE_HARMONICS))
    outline = spread * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))

    # 1.5 radii keep a disturbed outline on the gel.
    inside = np.all(np.abs(centres) + 1.5 * radii[:, None] < half_size, axis=1)
    return MarkerLayout(centres[inside] * 1e-3, radii[inside] * 1e-3, outline[inside])
