"""How well two hardnesses of an object can be told apart by what the sensor sees: a derivative by hardness, over the sensor's noise.

Let P(H, d) be what the camera gives at every pixel when an object of Shore H is pressed to approach d, σ its noise. An ideal observer tells
H from H + 1, at the same d, with

    d' = |∂P/∂H| / σ          (the length over all pixels and colours; Green and Swets 1966; noise independent between pixels).

At the same force instead of the same approach the difference is ∂P/∂H - ∂P/∂d (∂F/∂H) / (∂F/∂d). Who does not know how deep the press went
may use only what a deeper or a lighter press cannot imitate: the part of ∂P/∂H at a right angle to ∂P/∂d (the Cramér-Rao bound with d as
nuisance), which is never more than either. All are taken at the approach at which the scene's force is reached. Derivatives are central
differences: presses of H ± STEP, and three successive states of each.

P is the picture in levels before rounding, or, without light, the slopes of the membrane as each pixel sees it, which is what a picture
shows to first order; σ is then SLOPE_NOISE.

Left out: noise that is not the camera's (place, tilt, friction, light that drifts), so that d' is a bound to compare sensors by, not a
promise; what several frames of a press say together; correlation of noise between pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.study.trial import Trial

STEP = 1.5
"""Shore points to either side: the modulus changes by 10 to 20 %, so that d' changes little over it, and far more than the solver errs."""
STATES = 9
"""Recorded states of a press; the one before the last is at the depth that is asked for."""
SLOPE_NOISE = 0.01
"""Standard deviation of a pixel's slope from one frame, chosen: two grey levels of noise, where a slope of 0.1 makes about twenty."""
TOUCHED = 0.05
"""Of the largest change by depth: pixels above this share are said to be touched."""
FURTHEST_MM = 12.0
"""A press that ends at a force may go this far to get there."""
SEARCHED = 13
"""Recorded states of that press: steps of 1 mm; some of 2.4 mm were too long for Newton's method."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensitivity:
    """What a sensor sees of one Shore point of its object, over noise: d', but for `change`."""

    equal_depth: float
    equal_force: float
    unknown_press: float
    """Of who knows neither force nor approach."""
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
    noise = _noise(trial, signal)
    low, high = (_pressed(trial, body.shore_00 + step, depth_mm) for step in (-STEP, STEP))
    seen = {each: _seen(each, signal) for each in (low, high)}
    travel = low.press.approach[-1] - low.press.approach[-3]
    by_depth = (seen[low][2] - seen[low][0] + seen[high][2] - seen[high][0]) / (2 * travel)
    force_by_hardness = (high.force[-2] - low.force[-2]) / (2 * STEP)
    force_by_depth = sum(each.force[-1] - each.force[-3] for each in (low, high)) / (2 * travel)
    return combine(
        (seen[high][1] - seen[low][1]) / (2 * STEP) / noise,
        by_depth / noise,
        float(-force_by_hardness / force_by_depth),
        _pixels_per_sample(trial),
    )


def combine(by_hardness: Array, by_depth: Array, depth_by_hardness: float, weight: float = 1.0) -> Sensitivity:
    """The d' of derivatives over noise.

    Args:
        by_hardness: ∂P/∂H / σ at the same approach, any shape. by_depth: Likewise, in any unit of depth.
        depth_by_hardness: (∂d/∂H) at the same force.
        weight: How many pixels of the camera each sample stands for.
    """
    wanted, deeper = by_hardness.ravel(), by_depth.ravel()
    same_force = wanted + depth_by_hardness * deeper
    touched = np.abs(deeper) > TOUCHED * np.abs(deeper).max()
    return Sensitivity(
        float(np.sqrt(weight) * np.linalg.norm(wanted)),
        float(np.sqrt(weight) * np.linalg.norm(same_force)),
        float(np.sqrt(weight) * np.linalg.norm(wanted - deeper * (wanted @ deeper) / (deeper @ deeper))),
        float(np.sqrt((same_force[touched] ** 2).mean())),
    )


def depth_at_force(trial: Trial) -> float:
    """Approach at which press.force_n is reached [mm].

    Raises:
        SceneError: The scene has no force.
    """
    if trial.scene.press.force_n is None:
        raise SceneError("press.force_n is none: what is asked for is at equal force")
    reach = min(FURTHEST_MM, 0.8 * trial.scene.object.height_mm)
    press = trial.beside({"press.depth_mm": reach, "press.frames": SEARCHED}).press
    return float(press.approach[-1] * 1e3)


def _pressed(trial: Trial, shore: float, depth_mm: float) -> Trial:
    depth = {"press.depth_mm": depth_mm * (STATES - 1) / (STATES - 2), "press.force_n": "none", "press.frames": STATES}
    return trial.beside({"object.shore_00": shore} | depth)


def _seen(trial: Trial, signal: str) -> list[Array]:
    """The last three states as the camera sees them, (H, W, channels)."""
    if signal == "picture":
        from gelsim.study.levels import unrounded

        return [unrounded(trial.scene, frame.radiance) for frame in trial.draw(trial.membranes[-3:])]
    from gelsim.optics.camera import pixel_size

    pixel = pixel_size(trial.scene)
    return [np.dstack(tuple(np.gradient(np.nan_to_num(trial.heights(state)), pixel))) for state in (-3, -2, -1)]


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
