"""Markers in photographs: which pixels they darken, and the grid they form without contact.

A pixel belongs to a marker if it is darker than 0.8 of the 70th percentile around it. Of the blobs in the no-contact picture that its
border does not cut, pitch and tilt are those of the square grid that fits their centres by least squares, started from the median distance
and direction to the nearest neighbour; radius is that of the median area. Left out: each marker's own place and outline.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.camera import seen_places
from gelsim.optics.rest import DARKEST, even_part, untoned
from gelsim.scene.definition import Markers, Scene
from gelsim.units import MM

Array = NDArray[np.float64]

DARKER = 0.8
NO_GRID = "markers = true, but no grid of dark spots is seen in no_contact: where their centres are is not known"
FEWEST = 6
"""Blobs that make a grid."""


def dark_pixels(photos: Array) -> NDArray[np.bool_]:
    """Pixels that are much darker than around them, of pictures (N, H, W, 3): shape (N, H, W)."""
    from scipy import ndimage

    grey = photos.mean(axis=3)
    side = max(7, grey.shape[2] // 12 | 1)
    return grey < DARKER * ndimage.percentile_filter(grey, 70, size=(1, side, side))


def blobs(picture: Array) -> tuple[Array, Array]:
    """The dark spots of a picture (H, W, 3): centres (column, row) (K, 2) and areas (K,) [px]."""
    from scipy import ndimage

    labels, count = ndimage.label(dark_pixels(picture[None])[0])  # type: ignore[misc]
    if count < FEWEST:
        return np.zeros((0, 2)), np.zeros(0)
    numbers = np.arange(1, count + 1)
    areas = np.asarray(ndimage.sum(labels > 0, labels, numbers), float)
    # Dust is smaller than half a marker, shadows are larger than three; what the border cuts has its centre elsewhere.
    usual = (areas > 0.5 * np.median(areas)) & (areas < 3 * np.median(areas))
    rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    usual &= ~np.isin(numbers, rim)
    return np.array(ndimage.center_of_mass(labels > 0, labels, numbers))[usual, ::-1], areas[usual]


def grid_of(scene: Scene, no_contact: Array) -> Markers | None:
    """The markers of a scene's camera's picture (H, W, 3), which is of its render resolution, as dark and as large as they are in it."""
    from scipy import ndimage

    scale = scene.camera.field_mm[0] / no_contact.shape[1]
    grid = marker_grid(no_contact, lambda pixels: seen_places(scene, pixels) / MM, scale)
    if grid is None:
        return None
    even = np.maximum(untoned(scene, even_part(no_contact)), DARKEST)
    paint = (untoned(scene, no_contact) / even).mean(axis=2)
    labels, count = ndimage.label(dark_pixels(no_contact[None])[0])  # type: ignore[misc]
    darkest = float(np.median(ndimage.labeled_comprehension(paint, labels, np.arange(1, count + 1), _dark, float, 1.0)))
    # A blurred disc takes as much light as a sharp one: its area is that light over what its middle takes.
    taken = np.clip(1 - paint, 0, 1)[ndimage.binary_dilation(labels > 0, iterations=3)].sum() / count
    radius = float(np.sqrt(taken / (np.pi * max(1 - darkest, 0.05)))) * scale
    albedo = float(np.clip(darkest, 0, 1) * np.mean(scene.coating.albedo))
    return replace(grid, radius_mm=min(radius, 0.45 * grid.pitch_mm), albedo=albedo)


def with_grid(scene: Scene, no_contact: Array, warnings: list[str]) -> Scene:
    """The scene with the markers of its picture (`grid_of`); where none is seen it stays as it is, and a warning says so."""
    grid = grid_of(scene, no_contact)
    if grid is None:
        warnings.append(NO_GRID)
        return scene
    return scene.replace(markers=grid)


def _dark(paint: Array) -> float:
    return float(np.percentile(paint, 10))


def marker_grid(no_contact: Array, place: Callable[[Array], Array], mm_per_px: float) -> Markers | None:
    """The markers of a picture (H, W, 3) as a regular grid; None where there are too few.

    Args:
        place: Takes places in the picture [px] to those on the gel [mm], each of shape (K, 2).
        mm_per_px: About the picture's middle.
    """
    from scipy.spatial import KDTree

    centres, areas = blobs(no_contact)
    if len(centres) < FEWEST:
        return None
    centres = place(centres)
    distances, neighbours = KDTree(centres).query(centres, k=2)
    toward = centres[np.asarray(neighbours)[:, 1]] - centres
    turn = np.angle(np.median(np.exp(4j * np.arctan2(toward[:, 1], toward[:, 0])).view(float).reshape(-1, 2), axis=0) @ [1, 1j]) / 4
    middle, step = _grid(
        np.asarray(centres[:, 0] + 1j * centres[:, 1], np.complex128),
        float(np.median(np.asarray(distances)[:, 1])) * complex(np.exp(1j * turn)),
    )
    pitch, radius = abs(step), float(np.sqrt(np.median(areas) / np.pi)) * mm_per_px
    tilt = (np.degrees(np.angle(step)) + 45.0) % 90.0 - 45.0
    # The grid's point that is nearest to the gel's centre.
    index = -middle / step
    offset = middle + step * complex(round(index.real), round(index.imag))
    return Markers(
        layout="grid", pitch_mm=pitch, radius_mm=min(radius, 0.45 * pitch), tilt_deg=float(tilt), offset_mm=(offset.real, offset.imag)
    )


def _grid(places: NDArray[np.complex128], step: complex) -> tuple[complex, complex]:
    """a and b of the grid a + b (m + i n) that is nearest to the places x + i y, from a first guess of it."""
    middle = places[np.abs(places - places.mean()).argmin()]
    for near in (0.25, 0.5, 1.0, 1.0, 1.0):  # of the places, those nearest to the middle: a wrong step miscounts far ones
        chosen = places[np.abs(places - middle) <= np.quantile(np.abs(places - middle), near)]
        index = (chosen - middle) / step
        whole = np.round(index.real) + 1j * np.round(index.imag)
        on_grid = np.abs(index - whole) < 0.3
        if on_grid.sum() < FEWEST:
            continue
        columns = np.column_stack([np.ones(on_grid.sum()), whole[on_grid]])
        middle, step = np.linalg.lstsq(columns, chosen[on_grid], rcond=None)[0]
    return complex(middle), complex(step)
