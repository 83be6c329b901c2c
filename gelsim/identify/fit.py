"""Modulus, place and approaches by least squares on what a press changes in the pictures, and on measured force if there is one.

    min over log E, x, y, d₁ … d_K   Σ_k |ΔP_k - ΔM(E, x, y, d_k)|² / (n s²)  +  Σ_k (F_k - F(E, d_k))² / σ²

ΔP is the change from the untouched sensor in the video, ΔM in the pictures drawn: where the contact ends, how the membrane slopes and where
the markers went are all in it. Levenberg and Marquardt's method; derivatives are differences of drawn pictures. What the model lacks is
shared by pixels that lie near each other, in all pictures: n counts the numbers of a patch of PATCH_MM, so that a patch weighs as one
observation, and the covariance is H⁻¹ G H⁻¹, with G the sum of g gᵀ over patches (White 1980; Liang and Zeger 1986).
Left out: errors that the whole picture shares, such as a gel of another modulus or a coefficient of friction that is not the true one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.identify.pressed import LOG_STEP, Camera, Pressed
from gelsim.identify.recording import Recording

Array = NDArray[np.float64]

ITERATIONS = 8
APPROACH_STEP_MM, PLACE_STEP_MM = 0.02, 0.05
LEAST_MM = 0.02
PATCH_MM = 1.0
FARTHEST_MM = 0.2
"""That a place may be shifted without a press there."""
SMOOTH_MM = 0.5
LEVELS = 0.3
"""Least standard deviation of a level: the drawn pictures' own rounding."""
LARGEST = 1.0
"""Change of log E by one solve: the moduli between presses are interpolated."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit stands, by the presses of one modulus and place."""

    pressed: Pressed
    change: float
    """Of log E from the presses'."""
    shift_mm: Array
    """Of the place from the presses', (2,)."""
    approach_mm: Array
    """(K,)."""
    drawn: Array
    """What it changes in the pictures [levels], (K, H, W, 3)."""
    force: Array
    """[N], (K,)."""
    cost: float
    covariance: Array
    """Of log E, x [mm], y [mm], and the approaches [mm]."""

    @property
    def log_modulus(self) -> float:
        return self.pressed.log_modulus + self.change

    @property
    def place_mm(self) -> Array:
        return np.array(self.pressed.place_mm) + self.shift_mm


class Problem:
    """The sums of squares of one recording and one press."""

    def __init__(self, camera: Camera, recording: Recording, force_sd: float) -> None:
        self.camera, self.recording, self.force_sd = camera, recording, force_sd
        wide, high = recording.size
        rows, columns = np.mgrid[:high, :wide] + 0.5
        places = camera.places_mm(np.column_stack([columns.ravel(), rows.ravel()]))
        patch = np.floor(places / PATCH_MM).astype(int)
        self.patch = np.unique(patch, axis=0, return_inverse=True)[1].reshape(-1)
        """Number of each pixel's patch, (H W,)."""

    def aside(self, drawn: Array) -> Array:
        """By how much drawn changes (K, H, W, 3) are to be shifted to lie on those seen, as whole pixels allow [mm]: the largest
        correlation, smooth parts alone, for dots stay where they are."""
        from scipy.ndimage import gaussian_filter
        from scipy.signal import fftconvolve

        wide, high = self.recording.size
        middle = np.array([[wide / 2, high / 2], [wide / 2 + 1, high / 2]])
        per_px = float(np.abs(np.diff(self.camera.places_mm(middle), axis=0)).max())
        blur = (0, SMOOTH_MM / per_px, SMOOTH_MM / per_px, 0)
        seen, drawn = gaussian_filter(self.recording.change, blur), gaussian_filter(drawn, blur)
        likeness = fftconvolve(seen, drawn[:, ::-1, ::-1], mode="same", axes=(1, 2)).sum(axis=(0, 3))
        row, column = np.unravel_index(int(likeness.argmax()), likeness.shape)
        shift = np.array([[column - (wide - 1) // 2, row - (high - 1) // 2]], float)
        return np.asarray(self.camera.places_mm(middle[:1] + shift) - self.camera.places_mm(middle[:1]), float)[0]

    def start(self, pressed: Pressed, approach_mm: Array) -> Fit:
        """The presses as they are; the numbers are those of `solve`."""
        zero = np.zeros(2)
        drawn, force = self._drawn(pressed, approach_mm)
        return Fit(pressed, 0.0, zero, approach_mm, drawn, force, np.inf, np.eye(3 + len(approach_mm)))

    def solve(self, fit: Fit) -> Fit:
        """The least squares by the fit's presses."""
        damping, scale = 1e-3, self._scale(fit)
        fit = replace(fit, cost=self._cost(fit, scale))
        for _ in range(ITERATIONS):
            hessian, gradient, _ = self._normal(fit, scale)
            while True:
                step = np.asarray(np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient), float)
                trial = self._moved(fit, step)
                trial = replace(trial, cost=self._cost(trial, scale))
                if trial.cost <= fit.cost or damping > 1e3:
                    break
                damping *= 10
            gained = fit.cost - trial.cost
            if gained > 0:
                fit, damping = trial, damping / 5
            if gained < 1e-4 * fit.cost:
                break
        hessian, _, scores = self._normal(fit, self._scale(fit))
        inverse = np.linalg.inv(hessian)
        return replace(fit, covariance=inverse @ (scores.T @ scores) @ inverse)

    # ---- the sums ----

    def _drawn(
        self, pressed: Pressed, approach_mm: Array, change: float = 0.0, shift_mm: Array | tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Array, Array]:
        displacement, force = pressed.states(approach_mm, change, (float(shift_mm[0]), float(shift_mm[1])))
        return self.camera.change(pressed.surface, displacement), force

    def _moved(self, fit: Fit, step: Array) -> Fit:
        change = float(np.clip(fit.change + step[0], -LARGEST, LARGEST))
        shift = np.clip(fit.shift_mm + step[1:3], -FARTHEST_MM, FARTHEST_MM)
        approach = np.clip(fit.approach_mm + step[3:], LEAST_MM, fit.pressed.deepest_mm)
        drawn, force = self._drawn(fit.pressed, approach, change, shift)
        return replace(fit, change=change, shift_mm=shift, approach_mm=approach, drawn=drawn, force=force)

    def _scale(self, fit: Fit) -> float:
        """n s²."""
        left = self.recording.change - fit.drawn
        return max(float((left**2).mean()), LEVELS**2) * left.size / (self.patch.max() + 1)

    def _cost(self, fit: Fit, scale: float) -> float:
        cost = float(((self.recording.change - fit.drawn) ** 2).sum()) / scale
        if self.recording.force is not None:
            cost += float((((self.recording.force - fit.force) / self.force_sd) ** 2).sum())
        return cost

    def _normal(self, fit: Fit, scale: float) -> tuple[Array, Array, Array]:
        """JᵀJ, Jᵀr, and each patch's (and each force's) part of the latter, (B, P)."""
        count = len(fit.approach_mm)
        pressed, approach, change, shift = fit.pressed, fit.approach_mm, fit.change, fit.shift_mm
        left = self.recording.change - fit.drawn
        stiffer, stronger = self._drawn(pressed, approach, change + LOG_STEP, shift)
        inward = np.where(approach + APPROACH_STEP_MM > pressed.deepest_mm, -APPROACH_STEP_MM, APPROACH_STEP_MM)
        deeper, harder = self._drawn(pressed, approach + inward, change, shift)
        aside = [self._drawn(pressed, approach, change, shift + along)[0] for along in PLACE_STEP_MM * np.eye(2)]
        columns = np.stack([
            (stiffer - fit.drawn) / LOG_STEP, *((drawn - fit.drawn) / PLACE_STEP_MM for drawn in aside),
            (deeper - fit.drawn) / inward[:, None, None, None],
        ], axis=-1)  # fmt: skip
        hessian, gradient = np.zeros((3 + count, 3 + count)), np.zeros(3 + count)
        scores = np.zeros((self.patch.max() + 1, 3 + count))
        for k in range(count):
            some = np.array([0, 1, 2, 3 + k])
            flat = columns[k].reshape(-1, 4)
            hessian[np.ix_(some, some)] += flat.T @ flat / scale
            by_pixel = (columns[k] * left[k][..., None]).sum(axis=2).reshape(-1, 4) / scale
            gradient[some] += by_pixel.sum(axis=0)
            for place, column in enumerate(some):
                scores[:, column] += np.bincount(self.patch, by_pixel[:, place], len(scores))
        if self.recording.force is not None:
            rows = np.zeros((count, 3 + count))
            rows[:, 0] = (stronger - fit.force) / LOG_STEP
            rows[np.arange(count), 3 + np.arange(count)] = (harder - fit.force) / inward
            rows /= self.force_sd
            hessian += rows.T @ rows
            gradient += rows.T @ ((self.recording.force - fit.force) / self.force_sd)
            scores = np.vstack([scores, rows])  # of variance 1 each
        return hessian, gradient, scores
