"""From photographs to a sensible start: where the contacts are, what the gel looks like at rest, and where light comes from.

Contacts: the largest connected patch in which a photograph differs from the rest picture; the drape around a ball is about half as wide
again as the contact, so a ≈ r / 1.5 and the depth a²/R. Lights: of a set of places around the sensor, those that together explain the
photographs best with non-negative colours, chosen one at a time (orthogonal matching pursuit; Pati et al. 1993). The number of lights
follows from the photographs: one more is taken while it removes a share of the squared error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate import model
from gelsim.calibrate.dent import SHALLOWEST, Dents
from gelsim.calibrate.fit import Data, Evaluation, Fitted
from gelsim.calibrate.parameters import Parameters
from gelsim.optics.shading import shading_basis

Array = NDArray[np.float64]

DRAPE = 1.5
"""Width of the visible dent over that of the contact."""
MOST_LIGHTS, WORTH = 6, 0.08
"""A further light must remove this share of the squared error."""
SUBPIXEL = 0.5 / np.sqrt(3)
"""Gauss' two points across a pixel, from its middle."""
BLOCK = 12
"""Side of the pixel blocks that share errors [pixels of the fit]."""


def rest_picture(no_contact: Array, photos: Array) -> Array:
    """The picture without contact, shape (H, W, 3): the median over all photographs where there are enough to outvote the dents."""
    return np.median(np.concatenate([no_contact[None], photos]), axis=0) if len(photos) >= 6 else no_contact


def find_contacts(rest: Array, photos: Array, masked: NDArray[np.bool_] | None) -> tuple[Array, NDArray[np.bool_]]:
    """Middle (column, row) and radius of each dent [px], shape (P, 3), and whether one was found."""
    from scipy import ndimage

    found = np.zeros((len(photos), 3))
    sure = np.zeros(len(photos), bool)
    width = rest.shape[1]
    for index, photo in enumerate(photos):
        difference = photo - rest
        if masked is not None:
            difference = np.where((masked[0] | masked[1 + index])[..., None], 0.0, difference)
        # Slow drifts of colour are no contact.
        difference = difference - np.median(difference, axis=(0, 1))
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


def gather(
    no_contact: Array, photos: Array, presses: Array, mm_per_px: float, reach_mm: Array, masked: NDArray[np.bool_] | None,
    *, stride: int, degree: int, size: tuple[float, float], correction: tuple[Array, Array] | None = None,
) -> Data:  # fmt: skip
    """The pixels that are fitted: of each photograph those near its dent, of all photographs together the rest.

    Args:
        presses: x, y [mm] of each press; `reach_mm` how far from it its dent is felt, shape (P,).
        masked: Pixels that do not count, of the no-contact picture, then of each photograph, shape (1 + P, H, W).
        stride: Every so many pixels along both axes.
        size: Width and height of the field [px], which the pictures may not quite fill.
        correction: What the renderer adds to the model, of the rest picture (H, W, 3) and of each photograph (P, H, W, 3) [levels].
    """
    height, width = no_contact.shape[:2]
    rows, columns = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    rows, columns = rows.ravel(), columns.ravel()
    place = np.column_stack([columns + 0.5 - size[0] / 2, rows + 0.5 - size[1] / 2])
    far = np.array([np.hypot(*(place * mm_per_px - press[:2]).T) > reach for press, reach in zip(presses, reach_mm, strict=True)])
    far = far.reshape(len(presses), len(place))
    valid = np.ones((1 + len(photos), len(place)), bool) if masked is None else ~masked[:, rows, columns]
    # The rest picture from the pixels that no dent touches: each photograph counts once.
    stack = np.concatenate([no_contact[None, rows, columns], np.where(far[..., None], photos[:, rows, columns], np.nan)])
    stack = np.where(valid[..., None], stack, np.nan)
    counts = np.isfinite(stack[..., 0]).sum(axis=0)
    level = [np.nan_to_num(np.nanmedian(np.where(counts[:, None] > 0, stack, 0.0), axis=0))]
    weight = [np.repeat(counts[:, None].astype(float), 3, axis=1)]
    places, press_of = [place], [np.full(len(place), -1)]
    blocks = [(rows // (BLOCK * stride)) * 1000 + columns // (BLOCK * stride)]
    added = [correction[0][rows, columns] if correction else np.zeros((len(place), 3))]
    for index in range(len(presses)):
        near = np.flatnonzero(~far[index])
        places.append(place[near])
        press_of.append(np.full(len(near), index))
        level.append(photos[index, rows[near], columns[near]])
        weight.append(np.repeat(valid[1 + index, near, None].astype(float), 3, axis=1))
        blocks.append(blocks[0][near] + 10**6 * (index + 1))
        added.append(correction[1][index, rows[near], columns[near]] if correction else np.zeros((len(near), 3)))
    _, block = np.unique(np.concatenate(blocks), return_inverse=True)
    pixels = model.Pixels(np.concatenate(places), np.concatenate(press_of))
    return Data(pixels, np.concatenate(level), np.concatenate(weight), block, _basis(pixels.place, size, degree), np.concatenate(added))


def _basis(place: Array, size: tuple[float, float], degree: int) -> Array:
    return shading_basis(2 * place[:, 0] / size[0], 2 * place[:, 1] / size[1], degree)


def whole_pictures(fitted: Fitted, degree: int, dents: Dents, ball_mm: float, shape: tuple[int, int], reach: Array) -> tuple[Array, Array]:
    """The model's levels of the picture without contact and of each press, shape (1 + P, H, W, 3): at the pixels' middles, as the fit has
    them, and as means over the pixels. The two differ only at a dent: within `reach` [px], shape (P,), of its middle."""
    height, width = shape
    rows, columns = np.mgrid[:height, :width]
    place = np.column_stack([columns.ravel() + 0.5 - width / 2, rows.ravel() + 0.5 - height / 2])
    count = len(fitted.presses)

    def level(places: Array, press: NDArray[np.int64]) -> Array:
        nothing = np.zeros((len(places), 3))
        basis = _basis(places, (width, height), degree)
        data = Data(model.Pixels(places, press), nothing, nothing, np.zeros(len(places), np.int64), basis, nothing)
        return Evaluation(fitted.parameters, fitted.presses, data, dents, ball_mm).level

    middles = level(np.tile(place, (count + 1, 1)), np.repeat(np.arange(-1, count), len(place))).reshape(count + 1, len(place), 3)
    at = fitted.presses[:, :2] / fitted.parameters.globals[0]
    press, pixel = np.nonzero(np.hypot(*(place - at[:, None]).transpose(2, 0, 1)) <= reach[:, None])
    means = middles.copy()
    corners = SUBPIXEL * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    means[1 + press, pixel] = np.mean([level(place[pixel] + corner, press) for corner in corners], axis=0)
    return middles.reshape(count + 1, height, width, 3), means.reshape(count + 1, height, width, 3)


def candidates(half_field_mm: float) -> Array:
    """Lights around the sensor, facing its middle, shape (C, 7) as `Parameters.geometry`."""
    lights = []
    for distance in (1.4 * half_field_mm, 2.2 * half_field_mm):
        for elevation in np.radians([10.0, 20.0, 32.0, 46.0]):
            if distance * np.cos(elevation) < 1.1 * half_field_mm:
                continue
            for azimuth in np.arange(24) * (2 * np.pi / 24):
                across, down = distance * np.cos(elevation), distance * np.sin(elevation)
                lights.append([across, azimuth, -down, 0.0, 0.5 * elevation, np.log(0.4 * distance), np.log(0.15 * distance)])
    return np.array(lights)


def choose_lights(seed: Parameters, presses: Array, data: Data, dents: Dents, ball_mm: float) -> Parameters:
    """`seed` with the lights that explain the pictures best; its veil is kept and coloured anew."""
    from scipy.optimize import nnls

    places = candidates(seed.half_field_mm)
    trial = replace(seed, geometry=places, colours=np.zeros((len(places) + 1, 3)))
    maps = np.array(Evaluation(trial, presses, data, dents, ball_mm).maps).T
    gamma = seed.globals[6]
    target = model.untone(data.level, gamma)
    steep = model.tone(np.clip(target, 1e-4, 1), gamma)[1]
    # The rest picture does not outweigh the dents here.
    weight = np.minimum(data.weight, 1.0) * np.minimum(steep, 3000.0) ** 2 * (data.level < 250)
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


def rough_presses(
    contacts: Array, mm_per_px: float, size: tuple[float, float], ball_mm: float, curvature: float, deepest_mm: float
) -> Array:
    """Ball's apex x, y and depth [mm] from the dents' middles and radii."""
    at = (contacts[:, :2] - np.array(size) / 2) * mm_per_px * (1 + ball_mm * curvature)
    contact = contacts[:, 2] * mm_per_px / DRAPE
    return np.column_stack([at, np.clip(contact**2 / ball_mm, 2 * SHALLOWEST, 0.8 * deepest_mm)])
