"""Surface normals and heights out of a sensor's pictures, as such sensors are calibrated in practice: by a regression from colour.

The change of a pixel's three levels against the no-contact frame, and its place, are mapped to the normal (n_x, n_y) by a cubic polynomial
in the colours whose coefficients are linear in place, fitted by least squares to pictures of known surfaces (a smooth form of the table of
Johnson and Adelson 2009). The height follows from the slopes by Poisson's equation with no change at the picture's border, solved by sine
transforms. Surfaces: `optics.probes`, bells and ridges to fit by, balls, rods, boxes, wedges and rings to judge by; the sensor's noise is
in both. The exposure is set so that the mean of the no-contact frame is LEVEL, as a camera would be, or a brighter layout would win.

Left out: what a learned mapping with a neighbourhood would gain; errors of the calibration bodies' own places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.results import Frame, Membrane
from gelsim.scene.definition import Scene
from gelsim.study.trial import Trial

FITTED, JUDGED = 4, 4
"""Pictures to fit by, and to judge by."""
MOST_TRIED = 60
"""Bodies that are tried for a place in the picture."""
LEVEL = 0.18
"""Linear mean of the no-contact frame: 118 of 255."""
RIDGE = 1e-4
"""Of the mean square of a feature: where the colours of two lights are the same, the fit has no answer of its own."""
TOUCHED = 20e-6
"""A pixel whose surface moved by more [m] is judged."""
STEEP = np.sin(np.radians(30.0))
"""Of the normal's sideways part."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reconstruction:
    """Errors over the touched pixels of the judged pictures."""

    normal_error_deg: float
    """Mean angle between recovered and true normal."""
    steep_normal_error_deg: float
    """The same where the surface is steeper than STEEP."""
    height_error_um: float
    """Root mean square."""


def reconstruct(trial: Trial) -> Reconstruction:
    """Calibrates a sensor on known surfaces and recovers others from its pictures."""
    from gelsim.optics.camera import pixel_size
    from gelsim.optics.probes import bumpy_membrane

    frames = trial.draw([bumpy_membrane(trial.scene, seed) for seed in range(FITTED)] + _judged(trial))
    scene = exposed(trial.scene, trial.rest)
    pixel = pixel_size(scene)
    background = _levels(scene, trial.rest, 0)
    features = [_features(_levels(scene, frame, 1 + number) - background) for number, frame in enumerate(frames)]
    descents = [np.nan_to_num(trial.rest.height - frame.height).astype(float) for frame in frames]
    truths = [_normals(descent, pixel) for descent in descents]
    fit = _fitted(np.concatenate(features[:FITTED]), np.concatenate([truth.reshape(-1, 2) for truth in truths[:FITTED]]))
    angles, steep, heights = [], [], []
    for number in range(FITTED, FITTED + JUDGED):
        found = np.clip(features[number] @ fit, -0.97, 0.97).reshape(truths[number].shape)
        touched = descents[number] > TOUCHED
        angles.append(_angle(found, truths[number])[touched])
        steep.append((np.linalg.norm(truths[number], axis=-1) > STEEP)[touched])
        upright = np.sqrt(np.clip(1 - (found**2).sum(axis=-1), 0.05, 1))
        height = integrate(-found[..., 0] / upright, -found[..., 1] / upright, pixel)
        heights.append((height + descents[number])[touched])
    angle = np.degrees(np.concatenate(angles))
    walls = angle[np.concatenate(steep)]
    return Reconstruction(float(angle.mean()), float(walls.mean()), float(np.sqrt((np.concatenate(heights) ** 2).mean()) * 1e6))


def _judged(trial: Trial) -> list[Membrane]:
    """Bodies that lie wholly in the picture: beyond its border the height is not known, and what is integrated begins there."""
    from gelsim.optics import height_map
    from gelsim.optics.probes import dented_membrane

    inside: list[Membrane] = []
    for seed in range(MOST_TRIED):
        membrane = dented_membrane(trial.scene, seed)
        descent = np.nan_to_num(trial.rest.height - height_map(trial.scene, membrane))
        if max(descent[[0, -1]].max(), descent[:, [0, -1]].max()) < TOUCHED:
            inside.append(membrane)
        if len(inside) == JUDGED:
            return inside
    raise SceneError(f"camera.field_mm: of {MOST_TRIED} bodies fewer than {JUDGED} fit into the picture; a larger field is allowed")


def exposed(scene: Scene, rest: Frame) -> Scene:
    """The scene with the exposure that gives its no-contact frame the mean LEVEL."""
    return scene.replace(camera=replace(scene.camera, exposure=LEVEL / float(rest.radiance.mean())))


def integrate(slope_x: Array, slope_y: Array, spacing: float) -> Array:
    """The height (H, W) whose slopes along columns and rows come nearest to those given, 0 one pixel beyond the border.

    Least squares over differences between neighbours; their normal equations are Poisson's, diagonal in sines.
    """
    from scipy.fft import dstn, idstn

    padded_x, padded_y = (np.pad(slope, 1, mode="edge") for slope in (slope_x, slope_y))
    # Slopes halfway between pixels, so that the divergence is that of the five-point stencil.
    half_x, half_y = (padded_x[1:-1, 1:] + padded_x[1:-1, :-1]) / 2, (padded_y[1:, 1:-1] + padded_y[:-1, 1:-1]) / 2
    divergence = (np.diff(half_x, axis=1) + np.diff(half_y, axis=0)) * spacing
    rows, columns = slope_x.shape
    along = 2 * np.cos(np.pi * np.arange(1, columns + 1) / (columns + 1)) - 2
    down = 2 * np.cos(np.pi * np.arange(1, rows + 1) / (rows + 1)) - 2
    return np.asarray(idstn(dstn(divergence, type=1) / (down[:, None] + along), type=1))


def _levels(scene: Scene, frame: Frame, index: int) -> Array:
    from gelsim.optics.isp import develop

    return develop(scene, frame.radiance, index) / 255.0


def _features(change: Array) -> Array:
    """(pixels, 60): all products of up to three colours, each by itself and times x and y."""
    rows, columns = change.shape[:2]
    colours = change.reshape(-1, 3)
    terms = [np.ones(len(colours))]
    for degree in (1, 2, 3):
        terms += [np.prod(colours[:, list(chosen)], axis=1) for chosen in combinations_with_replacement(range(3), degree)]
    products = np.stack(terms, axis=1)
    x, y = (axis.ravel()[:, None] for axis in np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows)))
    return np.hstack([products, products * x, products * y])


def _fitted(features: Array, wanted: Array) -> Array:
    scale = np.sqrt((features**2).mean(axis=0)) + 1e-12
    scaled = features / scale
    normal = scaled.T @ scaled / len(scaled) + RIDGE * np.eye(scaled.shape[1])
    return np.linalg.solve(normal, scaled.T @ wanted / len(scaled)) / scale[:, None]


def _normals(descent: Array, spacing: float) -> Array:
    """(n_x, n_y) of the surface at -descent, (H, W, 2)."""
    down, along = np.gradient(descent, spacing)
    return np.stack([along, down], axis=-1) / np.sqrt(1 + along**2 + down**2)[..., None]


def _angle(a: Array, b: Array) -> Array:
    full = [np.concatenate([n, np.sqrt(np.clip(1 - (n**2).sum(axis=-1, keepdims=True), 0, 1))], axis=-1) for n in (a, b)]
    unit = [n / np.linalg.norm(n, axis=-1, keepdims=True) for n in full]
    return np.arccos(np.clip((unit[0] * unit[1]).sum(axis=-1), -1, 1))
