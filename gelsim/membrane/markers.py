"""Where the black markers sit on the coating at rest, and their outlines. Plain NumPy, SI.

A square grid turned by `tilt_deg`, places by lot, or those of a file, moved from the gel's centre by `offset_mm`; place, size and outline
of each are then disturbed, because markers are made by hand. The outline in polar form about the marker's centre:
r(φ) = r₀ (1 + Σ_{k=2..4} a_k cos(kφ − φ_k)), a_k normal with a total variance of `outline_jitter`². The membrane (markers move with the
material) and the coating (markers are painted on it) both need this and do not know each other, so it lies below both. Left out: doubled
and missing markers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.scene.definition import Markers, Scene
from gelsim.tables import read_csv

MOST_DRAWS = 30
"""For each marker of a random layout."""
PLACES = ("x_mm", "y_mm", "radius_mm")
"""Columns of markers.places."""
OUTLINE_HARMONICS = np.array([2, 3, 4])
"""1 would shift the marker's centre, 0 its size."""


@dataclass(frozen=True, eq=False)
class MarkerLayout:
    """The markers in material coordinates (rest x and y)."""

    centres: NDArray[np.float64]
    """[m], shape (K, 2); of a grid row by row from the top left of the picture."""
    radii: NDArray[np.float64]
    """[m], shape (K,)."""
    outline: NDArray[np.complex128]
    """a_k exp(i φ_k) of the harmonics 2, 3, 4; shape (K, 3)."""


def marker_layout(scene: Scene) -> MarkerLayout:
    """The markers of the scene's sensor that lie wholly on the gel.

    Raises:
        SceneError: A file that cannot be read, or markers by lot that find no room.
    """
    markers = scene.markers
    if markers.layout == "none":
        return MarkerLayout(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3), complex))
    half_size = np.array(scene.gel.size_mm) / 2
    # What is random is drawn for all markers before cropping, so that one keeps its shape when the gel's size changes a little.
    rng = np.random.default_rng(markers.seed)
    radius = markers.radius_mm
    if markers.layout == "list":
        centres, radius = _listed(str(markers.places), markers.radius_mm)
    elif markers.layout == "random":
        centres = _scattered(markers, half_size, rng)
    else:
        reach = int(np.ceil((np.hypot(*half_size) + np.hypot(*markers.offset_mm)) / markers.pitch_mm))
        row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        turn = np.radians(markers.tilt_deg)
        x, y = column * markers.pitch_mm, row * markers.pitch_mm
        centres = np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], axis=-1).reshape(-1, 2)
    centres = centres + np.array(markers.offset_mm)
    centres = centres + markers.jitter_mm * rng.standard_normal(centres.shape)
    radii = radius * np.clip(1 + markers.size_jitter * rng.standard_normal(len(centres)), 0.4, 1.6)
    shape = (len(centres), len(OUTLINE_HARMONICS))
    # Each of the 2 x 3 normal parts contributes half its variance to the outline's.
    spread = markers.outline_jitter / np.sqrt(len(OUTLINE_HARMONICS))
    outline = spread * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))

    # 1.5 radii keep a disturbed outline on the gel.
    inside = np.all(np.abs(centres) + 1.5 * radii[:, None] < half_size, axis=1)
    return MarkerLayout(centres[inside] * 1e-3, radii[inside] * 1e-3, outline[inside])


def _scattered(markers: Markers, half_size: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """As many places [mm] as a grid of the pitch has, drawn one after the other, none nearer to another than 2.5 radii."""
    count = int(4 * half_size[0] * half_size[1] / markers.pitch_mm**2)
    places = np.zeros((0, 2))
    for place in (2 * rng.random((MOST_DRAWS * count, 2)) - 1) * half_size:
        if len(places) == count:
            return places
        if len(places) == 0 or np.min(((places - place) ** 2).sum(axis=1)) >= (2.5 * markers.radius_mm) ** 2:
            places = np.concatenate([places, place[None]])
    raise SceneError(
        f'markers.layout = "random": {count} markers of markers.radius_mm = {markers.radius_mm:g} mm find no room on the gel; a larger '
        f"markers.pitch_mm than {markers.pitch_mm:g} mm, or smaller ones"
    )


def _listed(path: str, radius_mm: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places and radii [mm] of a CSV file."""
    header, rows = read_csv(Path(path), f"markers.places {path!r}", known=PLACES)
    try:
        table = np.array([[float(row.get(name) or (radius_mm if name == "radius_mm" else "nan")) for name in PLACES] for row in rows])
    except ValueError as error:
        raise SceneError(f"markers.places {path!r}: {error}") from None
    table = table.reshape(-1, 3)
    if "y_mm" not in header or not np.isfinite(table).all() or not (table[:, 2] > 0).all():
        raise SceneError(f"markers.places {path!r}: each line has a finite x_mm and y_mm, and a radius_mm above 0 if that is given")
    return table[:, :2], table[:, 2]
