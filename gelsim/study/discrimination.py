"""How well two hardnesses of an object can be told apart by what the sensor sees: a derivative by hardness, over the sensor's noise.

Let P(H, d) be what the camera gives at every pixel when an object of Shore H is pressed to approach d, σ its noise. An ideal observer tells
H from H + 1, at the same d, with

    d' = |∂P/∂H| / σ          (the length over all pixels and colours; Green and Swets 1966; noise independent between pixels).

At the same force instead of the same approach the difference is ∂P/∂H - ∂P/∂d (∂F/∂H) / (∂F/∂d). Who does not know how deep the press went
may use only what a deeper or a lighter press cannot imitate: the part of ∂P/∂H at a right angle to ∂P/∂d (the Cramér-Rao bound with d as
nuisance), which is never more than either. Who knows the object's radius R no better than by a share s either has what is left of ∂P/∂H by
least squares,

    d'² = min over x, y of |∂P/∂H - x ∂P/∂d - y ∂P/∂ln R|² / σ² + (y / s)²,

where the last term is what is known of R (the Schur complement of the Fisher information with that prior). All are taken at the approach
at which the scene's force is reached. Derivatives are central differences of presses with other H, force and R. Their steps move the
contact's edge about equally far: the slope bends sharply there, so that a derivative by a long step is smeared over a wider ring than one
by a short step, and the one cannot stand in for the other.

P is the picture in levels before rounding, or, without light, the slopes of the membrane as each pixel sees it, which is what a picture
shows to first order; σ is then SLOPE_NOISE.

Left out: what else is not known of a press (the object's shape but for its radius, tilt, friction, light that drifts), so that d' is a
bound to compare sensors by, not a promise; what several frames of a press say together; correlation of noise between pixels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError, SolveError
from gelsim.study.trial import Trial

STEP = 1.5
"""Shore points to either side: the modulus changes by 10 to 20 %, so that d' changes little over it, and far more than the solver errs."""
FORCE_STEP, RADIUS_STEP = 0.025, 0.02
"""Shares to either side. The contact's edge moves by 0.01 to 0.06 mm, as it does for STEP."""
RADIUS_UNKNOWN = 0.1
"""Standard deviation of ln R where the radius is not known, chosen: an object that looks like a ball of 8 mm, told to 0.8 mm."""
STATES = 9
"""Recorded states of a press; the one before the last is at the depth that is asked for."""
SLOPE_NOISE = 0.01
"""Standard deviation of a pixel's slope from one frame, chosen: two grey levels of noise, where a slope of 0.1 makes about twenty."""
TOUCHED = 0.05
"""Of the largest change by depth: pixels above this share are said to be touched."""
FURTHEST_MM = 12.0
"""A press that ends at a force may go this far to get there."""
SEARCHED = 49
"""Recorded states of that press: steps of 0.25 mm. After one of 1 mm Newton's method may find no way back to the force, which was 21 %
beyond it for gel 17 and object 74 with the finest mesh."""
FOUND = 0.01
"""Share by which the force may be missed there."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensitivity:
    """What a sensor sees of one Shore point of its object, over noise: d', but for `change`."""

    equal_depth: float
    equal_force: float
    unknown_press: float
    """Of who knows neither force nor approach."""
    unknown_radius: float
    """Likewise, and the radius to RADIUS_UNKNOWN."""
    change: float
    """At equal force, of a pixel: root mean square over those that a deeper press would change."""


def sensitivity(trial: Trial, signal: str) -> Sensitivity:
    """At the approach at which press.force_n is reached.

    Args:
        trial: A soft object whose hardness is object.shore_00.
        signal: "picture" or "slope".
    Raises:
        SceneError: It has no such hardness, or the scene no force.
        SolveError: One of the presses failed.
    """
    body = trial.scene.object
    if body.shore_00 is None or body.rigid:
        raise SceneError("object.shore_00 is none: what is asked for is a change per Shore point of a soft object")
    depth_mm = depth_at_force(trial)
    force_n = trial.scene.press.force_n
    assert force_n is not None
    softer, harder = (_pressed(trial, depth_mm, {"object.shore_00": body.shore_00 + step}) for step in (-STEP, STEP))
    lighter, firmer = (_pressed(trial, depth_mm, {"press.force_n": force_n * (1 + step)}) for step in (-FORCE_STEP, FORCE_STEP))
    smaller, larger = (_pressed(trial, depth_mm, {"object.radius_mm": body.radius_mm * (1 + step)}) for step in (-RADIUS_STEP, RADIUS_STEP))
    travel = firmer.press.approach[-1] - lighter.press.approach[-1]
    force_by_hardness = (harder.force[-2] - softer.force[-2]) / (2 * STEP)
    force_by_depth = (firmer.force[-1] - lighter.force[-1]) / travel
    noise = _noise(trial, signal)

    def change(low: Trial, high: Trial, state: int) -> Array:
        return (_seen(high, signal, state) - _seen(low, signal, state)) / noise

    return combine(
        change(softer, harder, -2) / (2 * STEP),
        change(lighter, firmer, -1) / travel,
        change(smaller, larger, -2) / np.log((1 + RADIUS_STEP) / (1 - RADIUS_STEP)),
        float(-force_by_hardness / force_by_depth),
        _pixels_per_sample(trial),
    )


def combine(by_hardness: Array, by_depth: Array, by_radius: Array, depth_by_hardness: float, weight: float = 1.0) -> Sensitivity:
    """The d' of derivatives over noise.

    Args:
        by_hardness: ∂P/∂H / σ at the same approach, any shape. by_depth: Likewise, in any unit of depth. by_radius: ∂P/∂ln R / σ.
        depth_by_hardness: (∂d/∂H) at the same force.
        weight: How many pixels of the camera each sample stands for.
    """
    wanted, deeper, rounder = (np.sqrt(weight) * each.ravel() for each in (by_hardness, by_depth, by_radius))
    same_force = wanted + depth_by_hardness * deeper
    touched = np.abs(deeper) > TOUCHED * np.abs(deeper).max()
    return Sensitivity(
        float(np.linalg.norm(wanted)),
        float(np.linalg.norm(same_force)),
        left(wanted, [deeper], [np.inf]),
        left(wanted, [deeper, rounder], [np.inf, RADIUS_UNKNOWN]),
        float(np.sqrt((same_force[touched] ** 2).mean() / weight)),
    )


def left(wanted: Array, nuisances: Sequence[Array], spreads: Sequence[float]) -> float:
    """d' of a change when others are not known: its length beside the best imitation by them, which costs what is known of them.

    Args:
        wanted: Derivative over noise, (P,). nuisances: Likewise, each (P,).
        spreads: Standard deviation of each before the picture is seen; infinite where nothing is known.
    """
    columns = np.vstack([np.column_stack(nuisances), np.diag(1.0 / np.array(spreads))])
    target = np.concatenate([wanted, np.zeros(len(nuisances))])
    return float(np.linalg.norm(target - columns @ np.linalg.lstsq(columns, target)[0]))


def depth_at_force(trial: Trial) -> float:
    """Approach at which press.force_n is reached [mm].

    Raises:
        SceneError: The scene has no force.
        SolveError: It was not found.
    """
    if trial.scene.press.force_n is None:
        raise SceneError("press.force_n is none: what is asked for is at equal force")
    reach = min(FURTHEST_MM, 0.8 * trial.scene.object.height_mm)
    press = trial.beside({"press.depth_mm": reach, "press.frames": SEARCHED}).press
    force, wanted = -press.force[-1, 2], trial.scene.press.force_n
    if abs(force - wanted) > FOUND * wanted:
        raise SolveError(f"press.force_n = {wanted:g} N: the press ended at {force:.3g} N and {press.approach[-1] * 1e3:.3g} mm", press)
    return float(press.approach[-1] * 1e3)


def _pressed(trial: Trial, depth_mm: float, other: Mapping[str, float]) -> Trial:
    """The press to the depth, and one state beyond, or to a force that is reached before that; with other fields."""
    depth = {"press.depth_mm": depth_mm * (STATES - 1) / (STATES - 2), "press.force_n": "none", "press.frames": STATES}
    return trial.beside(depth | dict(other))


def _seen(trial: Trial, signal: str, state: int) -> Array:
    """A state as the camera sees it, (H, W, channels)."""
    if signal == "picture":
        from gelsim.study.levels import unrounded

        return unrounded(trial.scene, trial.draw([trial.membranes[state]])[0].radiance)
    from gelsim.optics.camera import pixel_size

    return np.dstack(tuple(np.gradient(np.nan_to_num(trial.heights(state)), pixel_size(trial.scene))))


def _noise(trial: Trial, signal: str) -> Array:
    if signal == "slope":
        return np.full(2, SLOPE_NOISE)
    noise = np.array(trial.scene.camera.noise_sd)
    if not (noise > 0).all():
        raise SceneError(
            f"camera.noise_sd = {' '.join(f'{n:g}' for n in noise)}: without noise everything can be told apart; above 0 is allowed"
        )
    return noise


def _pixels_per_sample(trial: Trial) -> float:
    """What is rendered is coarser than what the camera delivers."""
    (width, height), (columns, rows) = trial.scene.camera.resolution, trial.scene.render.resolution
    return width * height / (columns * rows)
