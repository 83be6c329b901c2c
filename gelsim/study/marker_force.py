"""Forces recovered from the motion of markers, as gel sensors do it, and what the markers hide.

A layer that is bonded below, incompressible, of thickness t and shear modulus G answers to its surface's displacement u by (Betti's
reciprocity with the layer sheared by a uniform traction, and with it drawn apart by a radial one; linear elasticity, an endless layer)

    F_shear = (G / t) ∫ u dA,        F_normal = (G / t²) ∫ (x - c)·u dA        (c the contact's middle).

So both integrals are taken from the markers, each standing for the area that is nearest to it, in three rings about c, and the force
is a linear combination of the rings (large strains and an end of the rings make more than one worth while). It is fitted by least squares
to presses with a small and a large ball, and judged on one with a ball between them. All are pressed and sheared at once, and met at
PLACES random places and turns of the layout, others than those of the fit; the contact's middle is known, as from the height map.

Marker motion is measured with noise: an outline of radius r crosses 2 π r / p pixels of size p, each of which places it to EDGE_NOISE
pixels, independently, so the centre is known to EDGE_NOISE p sqrt(p / (π r)). What the noise does to the fit and to the judged forces is
taken as its expectation, not drawn. Light is not drawn.

What is hidden: the area of the markers, and the error of a height map that is filled in below them by the harmonic function of their rims.

Presses are moved over the gel as if it were endless; what its rim changes, 7 % of the second integral of a gel of 25 mm, is the same in all
and taken up by the fit. Left out: markers that are lost or taken for another,
friction that differs from place to place, a force that leaves no contact's middle to be known.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError, SolveError, SolveStatus
from gelsim.membrane.markers import marker_layout
from gelsim.scene.definition import Markers, Scene
from gelsim.study.trial import Trial
from gelsim.units import MM

FITTED = ((3.0, 0.2), (5.0, 0.6))
"""Radius of the ball [mm] and share of shear travel in approach, of the presses to fit by."""
JUDGED = ((4.0, 0.4),)
RINGS = np.array([0.0, 1.8, 3.6, 5.4]) * MM
"""Weights of the integrals are hats about all but the last of these distances from the contact's middle."""
PLACES = 48
SHIFT = 1.5 * MM
"""Presses are met up to this far from the gel's middle: half the largest pitch, and the rings stay in the picture."""
EDGE_NOISE = 0.29
"""Of one pixel of an outline [pixels]: 0.05 pixels for the centre of a marker of 0.2 mm in a picture of 19 µm a pixel."""
SPOKES, STEPS = 32, 6
"""Samples of a marker's rim, and of its radius."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MarkerForces:
    """Of the judged presses, over all states and places, with noise."""

    normal_error: float
    """Root mean square over that of the force itself."""
    shear_error: float
    """Likewise, over the shear force."""


@dataclass(frozen=True)
class MarkerCost:
    hidden: float
    """Share of the gel's surface that markers cover."""
    fill_error: float
    """Root mean square over the touched surface of the height that is filled in below markers, minus the true one [m]."""


@dataclass(frozen=True)
class Field:
    """A press as seen by a marker wherever it is."""

    displacement: object
    """Rest x, y (M, 2) [m] to displacements (M, states, 3) [m]."""
    normal: Array
    """Force of each state [N]."""
    shear: Array
    """Along x."""
    middle: Array
    """Of the contact, (states, 2) [m]."""
    reach: float
    """Of contact in the last state [m]."""

    def at(self, points: Array) -> Array:
        return np.asarray(self.displacement(points)).reshape(*points.shape[:-1], len(self.normal), 3)  # type: ignore[operator]


def marker_forces(trial: Trial) -> MarkerForces:
    """Fits and judges.

    Raises:
        SceneError: No depth, too few markers for triangles, or a gel too small for the rings.
        SolveError: One of the presses failed.
    """
    fitted, judged = (_samples(trial, presses, draw) for draw, presses in enumerate((FITTED, JUDGED)))
    errors = []
    for axis in (0, 1):
        seen, noise, force = fitted[axis]
        weights = np.linalg.solve(seen.T @ seen + noise.sum(axis=0), seen.T @ force)
        seen, noise, force = judged[axis]
        squares = (seen @ weights - force) ** 2 + np.einsum("nij,i,j->n", noise, weights, weights)
        errors.append(float(np.sqrt(squares.mean() / (force**2).mean())))
    return MarkerForces(*errors)


def marker_noise(scene: Scene) -> Array:
    """Standard deviation of each marker's measured place along x or y [m]."""
    pixel = scene.camera.field_mm[0] / scene.camera.resolution[0] * MM
    return EDGE_NOISE * pixel * np.sqrt(pixel / (np.pi * marker_layout(scene).radii))


def marker_cost(trial: Trial) -> MarkerCost:
    """Of the first judged press, in its last state.

    Raises:
        SceneError: No depth.
        SolveError: The press failed.
    """
    layout, field = marker_layout(trial.scene), press_field(trial, *JUDGED[0])
    turn = np.linspace(0, 2 * np.pi, SPOKES, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    share = (np.arange(STEPS) + 0.5) / STEPS
    harmonic = np.abs(np.fft.fftfreq(SPOKES, 1 / SPOKES))
    area, squares = 0.0, 0.0
    for offset, rotation in _places(1):
        centres = (layout.centres - offset) @ rotation
        near = np.linalg.norm(centres - field.middle[-1], axis=1) < field.reach
        area += np.pi * field.reach**2
        if not near.any():
            continue
        radii = layout.radii[near]
        disc = centres[near, None, None] + radii[:, None, None, None] * np.concatenate([share, [1.0]])[:, None, None] * ring
        height = field.at(disc)[..., -1, 2]
        rim = np.fft.fft(height[:, -1])
        filled = np.fft.ifft(rim[:, None] * share[:, None] ** harmonic).real
        squares += float((((filled - height[:, :-1]) ** 2).mean(axis=2) * share).mean(axis=1) @ (2 * np.pi * radii**2))
    hidden = float((np.pi * layout.radii**2).mean() / np.median(_whole_cells(layout.centres))) if len(layout.radii) else 0.0
    return MarkerCost(hidden, float(np.sqrt(squares / area)))


def _whole_cells(points: Array) -> Array:
    """`cells` of the points that lie within the outermost: on a small gel most cells are open; of all where none does."""
    from scipy.spatial import KDTree

    half = np.median(KDTree(points).query(points, k=2)[0][:, 1]) / 2
    inside = ((points > points.min(axis=0) + half) & (points < points.max(axis=0) - half)).all(axis=1)
    area = cells(points)
    return area[inside] if inside.any() else area


def cells(points: Array) -> Array:
    """The area (K,) [m²] that is nearer to each point (K, 2) than to others (Voronoi); wrong for points at the rim, whose cells are open.

    A triangle abc of Delaunay's gives a the share (|ab|² cot c + |ac|² cot b) / 8, signed.

    Raises:
        SceneError: They make no triangle.
    """
    from scipy.spatial import Delaunay, QhullError

    try:
        corners = Delaunay(points).simplices
    except (QhullError, ValueError):
        raise SceneError(
            f"markers.pitch_mm: {len(points)} markers are on the gel, too few for a force; a smaller pitch is allowed"
        ) from None
    a, b, c = (points[corners[:, side]] for side in range(3))
    twice = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    usable = twice > 1e-6 * np.median(twice)  # the rim of a regular grid has flat ones
    area = np.zeros(len(points))
    for turn in range(3):
        here, left, right = (points[corners[usable, (turn + step) % 3]] for step in range(3))
        along, across, beyond = left - here, right - here, right - left
        share = (along**2).sum(axis=1) * (across * beyond).sum(axis=1) - (across**2).sum(axis=1) * (along * beyond).sum(axis=1)
        area += np.bincount(corners[usable, turn], share / (8 * twice[usable]), len(points))
    return area


def press_field(trial: Trial, radius_mm: float, shear_share: float) -> Field:
    """A press of the trial's gel; the same for all marker layouts, and solved once in a process.

    Raises:
        SceneError: No depth.
        SolveError: It failed.
    """
    depth = trial.scene.press.depth_mm
    if depth is None:
        raise SceneError("press.depth_mm is none: presses are to this depth, and are sheared by a share of it")
    other = trial.beside({"object.radius_mm": radius_mm, "press.shear_mm": [shear_share * depth, 0.0]})
    return _solved(other.scene.replace(markers=Markers(layout="none")), trial.device)


@functools.lru_cache(maxsize=16)
def _solved(scene: Scene, device: str) -> Field:
    from scipy.interpolate import CloughTocher2DInterpolator

    from gelsim.pipeline import stages

    press = stages.press(scene, device=device, throw=False)
    if press.status is not SolveStatus.CONVERGED:
        raise SolveError(press.message or press.status.value, press)
    moved = press.gel.displacement[1:].transpose(1, 0, 2)
    middle = (press.approach[1:] / press.approach[-1])[:, None] * np.array(scene.press.shear_mm) * MM
    return Field(
        # Beyond the gel's rim, where no ring reaches, 0.
        CloughTocher2DInterpolator(press.gel.rest[:, :2], moved.reshape(len(moved), -1), fill_value=0.0),
        -press.force[1:, 2],
        press.force[1:, 0],
        middle,
        float(np.sqrt(press.contact_area[-1] / np.pi)),
    )


@functools.cache
def _places(draw: int) -> list[tuple[Array, Array]]:
    """Where a press meets the gel, and how the markers are turned to it: quarter turns, which the gel's outline shares."""
    rng = np.random.default_rng(draw)
    turns = [np.array([[c, s], [-s, c]], float) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return [(rng.uniform(-SHIFT, SHIFT, 2), turns[n % 4]) for n in range(PLACES)]


def _samples(
    trial: Trial, presses: Sequence[tuple[float, float]], draw: int
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """Of the normal and of the shear force, for N states and places: integrals (N, rings), their noise (N, rings, rings), force (N,)."""
    layout, needed = marker_layout(trial.scene), 2 * (RINGS[-1] + SHIFT) / MM
    if min(trial.scene.gel.size_mm) < needed:
        size = " x ".join(f"{side:g}" for side in trial.scene.gel.size_mm)
        raise SceneError(
            f"gel.size_mm = {size} mm: forces are read from markers up to {(RINGS[-1] + SHIFT) / MM:g} mm from the gel's middle; "
            f"allowed are sides of {needed:g} mm and more"
        )
    area, noise = cells(layout.centres), marker_noise(trial.scene)
    normal: list[tuple[Array, Array, float]] = []
    shear: list[tuple[Array, Array, float]] = []
    for radius, share in presses:
        field = press_field(trial, radius, share)
        for offset, turn in _places(draw):
            places = (layout.centres - offset) @ turn
            moved = field.at(places)
            for state, middle in enumerate(field.middle):
                away = places - middle
                hats = _hats(np.linalg.norm(away, axis=1)) * area
                by_place = np.concatenate([hats * away[:, 0], hats * away[:, 1]], axis=1)
                u = moved[:, state]
                normal.append((by_place @ u[:, :2].T.ravel(), (by_place * np.tile(noise, 2) ** 2) @ by_place.T, field.normal[state]))
                shear.append((hats @ u[:, 0], (hats * noise**2) @ hats.T, field.shear[state]))
    return _stacked(normal), _stacked(shear)


def _stacked(samples: Sequence[tuple[Array, Array, float]]) -> tuple[Array, Array, Array]:
    seen, noise, force = zip(*samples, strict=True)
    return np.array(seen), np.array(noise), np.array(force)


def _hats(distance: Array) -> Array:
    """(rings, M): 1 at its ring's distance, 0 at the neighbours'."""
    return np.stack([np.interp(distance, RINGS, unit) for unit in np.eye(len(RINGS))[:-1]])
