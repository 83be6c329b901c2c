"""From photographs to a sensible start: where the contacts are, what the gel looks like at rest, and where light comes from.

Contacts: the largest connected patch in which a photograph, its dots filtered away, differs from the rest; the drape around a ball is
about half as wide again as the contact, so a ≈ r / 1.5 and the depth a²/R. Lights: of a set of places around the sensor and below its gel,
those that together explain best what the presses change, with non-negative colours, chosen one at a time (orthogonal matching pursuit;
Pati et al. 1993). The number of lights follows from the photographs: one more is taken while it removes a share of the squared error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate import model
from gelsim.calibrate.dent import SHALLOWEST, Dents
from gelsim.calibrate.fit import Data, Evaluation, Fitted
from gelsim.calibrate.parameters import CLEAR_MM, OUT_OF_VIEW, Parameters
from gelsim.optics.rest import UPPER

Array = NDArray[np.float64]

DRAPE = 1.5
"""Width of the visible dent over that of the contact."""
MOST_LIGHTS, WORTH = 6, 0.04
"""A further light must remove this share of the squared error."""
UNPAINTED = 0.8
"""Of the even light: darker is a dot."""
DOT = 20
"""Windows across the picture that a dot takes less than half of."""
OUTVOTED = 6
"""Photographs that outvote their dents."""
AGREED = 3
"""Photographs that make a rest with the one without contact: of fewer, one whose dent was found wrongly would decide."""
QUIET = 5
"""Side of the windows in which noise is told from paint [px]: with 25 values a variance is right to a quarter."""
FELT = 2.2
"""Of a dent's visible radius: how far from its middle a press is compared; beyond, the photograph shows the rest."""
BLOCK = 12
"""Side of the pixel blocks that share errors [pixels of the fit]."""


def reduce(pictures: Array, factor: int) -> Array:
    """Means over squares of `factor` pixels, from the top left corner; what is left over is cut off."""
    count, height, width = pictures.shape[:3]
    rows, columns = height // factor, width // factor
    return pictures[:, : rows * factor, : columns * factor].reshape(count, rows, factor, columns, factor, 3).mean(axis=(2, 4))


def even_light(pictures: Array) -> Array:
    """Pictures (N, H, W, 3) without their dots: a high percentile of windows somewhat larger than a dot."""
    from scipy import ndimage

    side = pictures.shape[2] // DOT | 1
    return np.asarray(ndimage.percentile_filter(pictures, UPPER, size=(1, side, side, 1)))


def find_contacts(no_contact: Array, photos: Array, counted: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Middle (column, row) and radius of each dent [px], shape (P, 3), and whether one was found.

    Of a median over all photographs the dents are outvoted where there are enough of them.
    """
    from scipy import ndimage

    found = np.zeros((len(photos), 3))
    sure = np.zeros(len(photos), bool)
    width = no_contact.shape[1]
    even = even_light(np.concatenate([no_contact[None], photos]))
    rest = np.median(even, axis=0) if len(photos) >= OUTVOTED else even[0]
    for index in range(len(photos)):
        difference = even[1 + index] - rest
        # Slow drifts of colour are no contact.
        difference = (difference - np.median(difference[counted], axis=0)) * counted[..., None]
        size = np.sqrt((ndimage.gaussian_filter(difference, (0.012 * width, 0.012 * width, 0)) ** 2).sum(axis=2))
        level = max(0.3 * np.percentile(size, 99.7), 2.0)
        labels, count = ndimage.label(size > level)  # type: ignore[misc]
        if count == 0:
            continue
        masses = np.asarray(ndimage.sum(size, labels, np.arange(1, count + 1)))
        chosen = labels == 1 + int(np.argmax(masses))
        filled = np.asarray(ndimage.binary_fill_holes(chosen), bool)
        row, column = np.argwhere(filled).mean(axis=0) + 0.5
        found[index] = column, row, np.sqrt(filled.sum() / np.pi)
        sure[index] = filled.sum() >= 12
    return found, sure


def rest_picture(no_contact: Array, photos: Array, contacts: Array, felt: float) -> Array:
    """The picture without contact, shape (H, W, 3): of each pixel the median of the photographs whose dents are farther from it than `felt`
    times their radius, where there are enough of them; a sensor drifts between its no-contact photograph and the others."""
    if len(photos) < AGREED:
        return no_contact
    rows, columns = np.mgrid[: no_contact.shape[0], : no_contact.shape[1]] + 0.5
    stack = np.concatenate([no_contact[None], photos])
    for picture, (column, row, radius) in zip(stack[1:], contacts, strict=True):
        picture[np.hypot(columns - column, rows - row) <= felt * radius] = np.nan
    rest = np.nanmedian(stack, axis=0)
    return _quieter(rest, _noise_variance(stack, rest))


def _noise_variance(stack: Array, rest: Array) -> Array:
    """Of a median over photographs [levels squared], shape (H, W, 3), by how neighbouring pixels of one photograph differ from it; NaN does
    not count. A drift of the light is no noise: neighbours share it."""
    counted = np.isfinite(stack).sum(axis=0)
    from_neighbour = np.abs(np.diff(stack - rest, axis=2))
    # By the mean of sizes, not their median, which whole levels make too small. A difference has twice a pixel's variance.
    one = np.pi / 4 * np.nanmean(from_neighbour, axis=(0, 1, 2)) ** 2 / (1 - 1 / max(float(np.median(counted)), 2.0))
    # π/2 times the mean's for many photographs, the photograph's own for one.
    return one * (np.pi / 2) / (counted + np.pi / 2 - 1)


def _quieter(picture: Array, noise: Array) -> Array:
    """A picture less the noise of that variance, by Wiener's filter over windows of QUIET px: where neighbours differ by no more than noise
    they become alike, dots and scratches stay. Noise that is kept would be taken for paint, which moves with the gel."""
    from scipy.ndimage import uniform_filter

    def mean_of(values: Array) -> Array:
        return np.asarray(uniform_filter(values, QUIET, axes=(0, 1)))

    mean = mean_of(picture)
    spread = np.maximum(mean_of(picture**2) - mean**2, 1e-9)
    return mean + np.maximum(1 - mean_of(noise) / spread, 0) * (picture - mean)


def gather(
    photos: Array, contacts: Array, reach: Array, rest: model.Rest, balls_mm: Array, counted: NDArray[np.bool_], *, stride: int,
    correction: Array | None = None,
) -> Data:  # fmt: skip
    """The pixels that are fitted: of each photograph those near its dent. Far ones are the rest, whatever the sensor.

    Args:
        contacts: Column and row of each dent's middle [px]; `reach` how far from it its dent is felt [px], shape (P,).
        counted: Pixels that show gel, shape (H, W).
        stride: Every so many pixels along both axes.
        correction: What the renderer adds to the model, of each photograph (P, H, W, 3) [levels].
    """
    height, width = photos.shape[1:3]
    rows, columns = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    shown = counted[rows, columns]
    rows, columns = rows[shown], columns[shown]
    press, pixel = np.nonzero(np.hypot(columns + 0.5 - contacts[:, :1], rows + 0.5 - contacts[:, 1:2]) <= reach[:, None])
    row, column = rows[pixel], columns[pixel]
    block = (row // (BLOCK * stride)) * 1000 + column // (BLOCK * stride) + 10**6 * press
    place = np.column_stack([column + 0.5 - width / 2, row + 0.5 - height / 2])
    level = photos[press, row, column]
    added = correction[press, row, column] if correction is not None else np.zeros_like(level)
    return Data(model.Pixels(place, press), level, np.ones_like(level), np.unique(block, return_inverse=True)[1], rest, added, balls_mm)


def model_pictures(fitted: Fitted, rest: model.Rest, dents: Dents, balls_mm: Array, contacts: Array, reach: Array, drawn: Array) -> Array:
    """The model's levels of each press at the pixels' middles, as the fit has them, shape (P, H, W, 3).

    Within `reach` [px], shape (P,), of the dents' middles `contacts` (P, 2); elsewhere they are `drawn`.
    """
    height, width = drawn.shape[1:3]
    rows, columns = np.mgrid[:height, :width] + 0.5
    near = np.hypot(columns - contacts[:, 0, None, None], rows - contacts[:, 1, None, None]) <= reach[:, None, None]
    press, row, column = np.nonzero(near)
    place = np.column_stack([column + 0.5 - width / 2, row + 0.5 - height / 2])
    nothing = np.zeros((len(place), 3))
    pictures = drawn.copy()
    pictures[press, row, column] = Evaluation(
        fitted.parameters, fitted.presses, Data(model.Pixels(place, press), nothing, nothing, press, rest, nothing, balls_mm), dents
    ).level
    return pictures


def candidates(half_field_mm: float, thickness_mm: float) -> Array:
    """Lights around the sensor and below its gel, facing its middle, shape (C, 7) as `Parameters.geometry`."""
    lights = []
    for distance in half_field_mm * np.array([0.7, 1.05, 1.5, 2.2]):
        for elevation in np.radians([5.0, 12.0, 22.0, 35.0, 50.0]):
            below = distance * np.cos(elevation) < OUT_OF_VIEW * half_field_mm
            if below and distance * np.sin(elevation) < thickness_mm + CLEAR_MM:
                continue
            for azimuth in np.arange(24) * (2 * np.pi / 24):
                across, down = distance * np.cos(elevation), distance * np.sin(elevation)
                lights.append([across, azimuth, -down, 0.0, 0.5 * elevation, np.log(0.4 * distance), np.log(0.15 * distance)])
    return np.array(lights)


def choose_lights(seed: Parameters, presses: Array, data: Data, dents: Dents) -> Parameters:
    """`seed` with the lights that explain best what the presses change; its veil is kept and coloured anew."""
    from scipy.optimize import nnls

    places = candidates(seed.half_field_mm, seed.globals[3])
    trial = replace(seed, geometry=places, colours=np.zeros((len(places) + 1, 3)))
    here = Evaluation(trial, presses, data, dents)
    maps = np.array(here.changes).T
    gamma = seed.globals[6]
    seen = model.untone(data.level, gamma)
    target = seen - here.paint * here.even
    steep = model.tone(np.clip(seen, 1e-4, 1), gamma)[1]
    # Of dots, whose place is not found yet, nothing is asked.
    weight = np.minimum(steep, 3000.0) ** 2 * (data.level < 250) * (here.paint > UNPAINTED)
    grams = np.array([maps.T @ (maps * weight[:, c : c + 1]) for c in range(3)])
    sides = np.array([maps.T @ (weight[:, c] * target[:, c]) for c in range(3)])
    squares = [(weight[:, c] * target[:, c] ** 2).sum() for c in range(3)]

    def solve(chosen: list[int]) -> tuple[float, Array]:
        error, colours = 0.0, np.zeros((len(chosen), 3))
        for c in range(3):
            gram = grams[c][np.ix_(chosen, chosen)]
            root = np.linalg.cholesky(gram + 1e-9 * np.trace(gram) * np.eye(len(chosen)))
            colours[:, c], _ = nnls(root.T, np.linalg.solve(root, sides[c][chosen]))
            x = colours[:, c]
            error += squares[c] - 2 * sides[c][chosen] @ x + x @ gram @ x
        return error, colours

    veil = len(places)
    chosen, (error, colours) = [veil], solve([veil])
    while len(chosen) <= MOST_LIGHTS:
        best, index = min((solve([*chosen, k])[0], k) for k in range(veil) if k not in chosen)
        if len(chosen) > 1 and best > (1 - WORTH) * error:
            break
        chosen.append(index)
        error, colours = solve(chosen)
    kept = [k for k in range(1, len(chosen)) if colours[k].max() > 0]
    colours = np.concatenate([colours[kept], colours[:1]])
    floor = 0.02 * max(colours[:-1].max(), 1e-9)
    # A colour of nothing has no derivative by the light's place: a little of each.
    return replace(seed, geometry=places[[chosen[k] for k in kept]], colours=np.maximum(colours, floor))


def rough_presses(apex_mm: Array, radius_mm: Array, balls_mm: Array, deepest_mm: Array) -> Array:
    """Presses as of PRESS, undragged, from the apexes' places, shape (P, 2), and the dents' visible radii."""
    depth = np.clip((radius_mm / DRAPE) ** 2 / balls_mm, 2 * SHALLOWEST, 0.8 * deepest_mm)
    return np.column_stack([apex_mm, depth, np.zeros((len(depth), 2))])
