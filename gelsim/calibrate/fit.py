"""Least squares over sensor and presses at once: Levenberg-Marquardt with a robust loss, priors and bounds.

    minimise  Σ_i ϱ((I_i − M_i(θ, p)) / σ) + Σ_k ((θ_k − θ⁰_k) / s_k)²

over the sensor θ and place, depth and drag p of each press; ϱ is Huber's. The model M is the rest picture, changed (`calibrate.model`):
what does not change says nothing of the lights. Derivatives by geometry are one-sided differences, all presses at once (each pixel
depends on its own press only), those by colour exact. Uncertainties are a jackknife's over blocks of pixels (of the sandwich kind, CR3 of
Bell & McCaffrey 2002): Σ_b δ_b δ_bᵀ with δ_b = (H − H_b)⁻¹ g_b, how far the fit moves without the block. So errors that neighbouring pixels
share (compression, what the model lacks) count as what they are; the plain sandwich H⁻¹ Σ g gᵀ H⁻¹ is too small where there are few blocks
for a parameter, since the fit has then followed each block's own error. Left out: errors that all photographs share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate import model
from gelsim.calibrate.dent import SHALLOWEST, Dents, effective_radius
from gelsim.calibrate.parameters import ALBEDO, EXPOSURE, FLAKE, GEOMETRY, GLOBALS, PRESS, Parameters

Array = NDArray[np.float64]

HUBER = 8.0
"""Residuals beyond so many standard deviations count linearly: with 2, dots that were a pixel off and rims hardly counted (squared error on
test presses of a Mini 44, now 39)."""
PRESS_STEP = 1e-3
"""Of the differences by what a press is [mm]."""
STEPS = {"camera.mm_per_px": 1e-5, "camera.distance_mm": 1e-2, "gel.curvature": 1e-5, "gel.thickness_mm": 1e-3}


@dataclass(frozen=True, eq=False)
class Data:
    """What is fitted to."""

    pixels: model.Pixels
    level: Array
    """Observed, shape (N, 3)."""
    weight: Array
    """Of each observation, shape (N, 3); 0 where it does not count."""
    block: NDArray[np.int64]
    """Pixels of one block share errors."""
    rest: model.Rest
    """The picture without contact, which a press changes."""
    correction: Array
    """Added to the model's levels, shape (N, 3): what the renderer adds to it."""
    balls_mm: Array
    """Radius of each press's ball, shape (P,)."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is believed before the photographs are seen: normal distributions."""

    centre: Parameters
    """Of the sensor; widths and bounds follow from it (`Parameters.prior`)."""
    press_sd: Array
    """Of what is in PRESS [mm], shape (P, 5), about the presses at the start."""
    frozen: NDArray[np.bool_]
    """Parameters of the sensor's vector that are known, and stay as they begin."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """Where the fit ended."""

    parameters: Parameters
    presses: Array
    """Of PRESS, shape (P, 5)."""
    cost: float
    rms: float
    """Of the residuals [levels]."""
    sigma: float
    covariance: Array
    """Of parameters, then presses."""
    iterations: int


class Evaluation:
    """The model at one place, and what its derivatives need."""

    def __init__(
        self, parameters: Parameters, presses: Array, data: Data, dents: Dents,
        still: tuple[model.Surface, list[Array]] | None = None,
    ) -> None:  # fmt: skip
        """`still`: What the pixels see without a press, and each light there, of an evaluation with the same parameters."""
        self.parameters, self.presses, self.data, self.solved = parameters, presses, data, dents
        self.dents = dents.at(parameters.globals[3], parameters.globals[9])
        self.shape = parameters.shape(data.balls_mm)
        self.seen = model.surface(self.shape, self.dents, presses, data.pixels)
        self.lights = [parameters.light(index) for index in range(len(parameters.geometry) + 1)]
        self.shares = [model.visible(self.shape, self.dents, self.seen, light) for light in self.lights]
        if still is None:
            unmoved = model.surface(self.shape, self.dents, presses, model.Pixels(data.pixels.place, np.full(len(data.level), -1)))
            whole = np.ones_like(self.shares[0])
            still = unmoved, [self._map(light, unmoved, whole) for light in self.lights]
        self.still = still
        lit = [self._map(light, self.seen, share) for light, share in zip(self.lights, self.shares, strict=True)]
        self.changes = [after - before for after, before in zip(lit, still[1], strict=True)]
        """Of the exposed radiance by the press, for a unit flux of each light, shape (N,) each."""
        came = model.rest_place(self.shape, self.dents, data.pixels, self.seen)
        self.even, self.paint = data.rest.at(data.pixels.place, came, parameters.globals[6])
        self.linear = self.paint * (self.even + np.array(self.changes).T @ parameters.colours)
        self.level, self.steep = model.tone(self.linear, parameters.globals[6])
        self.level = self.level + data.correction

    def _map(self, light: Array, seen: model.Surface, share: Array) -> Array:
        """Exposed radiance for a unit flux, shape (N,)."""
        specular, roughness = self.parameters.globals[4:6]
        diffuse, glossy = model.light_maps(seen, light, roughness, share)
        return EXPOSURE / (np.pi * light[5] * light[6]) * ((1 - specular) * ALBEDO * diffuse + specular * FLAKE * glossy)

    def sensor_columns(self, frozen: NDArray[np.bool_] | None = None) -> Array:
        """Derivatives of the levels by the parameters' vector, shape (N, 3, K); left at 0 for those of GLOBALS that are frozen."""
        p, count = self.parameters, len(self.data.level)
        columns = np.zeros((count, 3, p.vector.size))
        for k, name in enumerate(GLOBALS):
            if frozen is not None and frozen[k]:
                continue
            step = STEPS.get(name, 1e-4)
            values = p.globals.copy()
            values[k] += step
            other = Evaluation(replace(p, globals=values), self.presses, self.data, self.solved)
            columns[:, :, k] = (other.level - self.level) / step
        scale, start = self.steep * self.paint, len(GLOBALS)
        for index in range(len(p.geometry)):
            for k in range(len(GEOMETRY)):
                geometry = p.geometry.copy()
                geometry[index, k] += 1e-4
                light = replace(p, geometry=geometry).light(index)
                share = model.visible(self.shape, self.dents, self.seen, light)
                changed = self._map(light, self.seen, share) - self._map(light, self.still[0], np.ones_like(share))
                columns[:, :, start + index * len(GEOMETRY) + k] = scale * np.outer(
                    (changed - self.changes[index]) / 1e-4, p.colours[index]
                )
        start += p.geometry.size
        for index, values in enumerate(self.changes):
            for c in range(3):
                columns[:, c, start + 3 * index + c] = scale[:, c] * values
        return columns

    def press_columns(self) -> Array:
        """Derivatives of the levels by what is in PRESS, of each pixel's own press, shape (N, 3, 5)."""
        columns = np.zeros((len(self.data.level), 3, len(PRESS)))
        for k in range(len(PRESS)):
            presses = self.presses.copy()
            presses[:, k] += PRESS_STEP
            other = Evaluation(self.parameters, presses, self.data, self.solved, self.still)
            columns[:, :, k] = (other.level - self.level) / PRESS_STEP
        return columns


def fit(
    start: Parameters,
    presses: Array,
    data: Data,
    dents: Dents,
    prior: Prior,
    iterations: int,
    progress: Callable[[int, int], None],
) -> Fitted:
    """Fits sensor and presses, shape (P, 5), from a start; `progress` is told iterations and their most."""
    sd, low, high = prior.centre.prior()
    sensor_count = len(sd)
    centre = np.concatenate([prior.centre.vector, presses.ravel()])
    pull = np.concatenate([1 / sd**2, (1 / prior.press_sd**2).ravel()])
    floor = np.concatenate([low, np.tile([-np.inf, -np.inf, SHALLOWEST, -np.inf, -np.inf], len(presses))])
    tops = np.full(presses.shape, np.inf)
    tops[:, 2] = dents.deepest(effective_radius(data.balls_mm, start.globals[2]))
    ceiling = np.concatenate([high, tops.ravel()])
    free_always = np.concatenate([~prior.frozen, np.ones(presses.size, bool)])

    def evaluate(vector: Array) -> Evaluation:
        return Evaluation(start.with_vector(vector[:sensor_count]), vector[sensor_count:].reshape(-1, len(PRESS)), data, dents)

    counted = data.weight > 0
    vector = np.clip(np.concatenate([start.vector, presses.ravel()]), floor, ceiling)
    here = evaluate(vector)
    residual = data.level - here.level
    sigma = max(1.4826 * float(np.median(np.abs(residual[counted]))), 0.3)
    damping, done, slow = 1e-3, 0, 0
    hessian, linearised = np.eye(len(vector)), None
    for done in range(1, iterations + 1):
        sigma = max(1.4826 * float(np.median(np.abs(residual[counted]))), 0.3)
        cost = _cost(residual, data.weight, sigma) + float(pull @ (vector - centre) ** 2)
        robust = data.weight * np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(residual), 1e-12)) / sigma**2
        columns = _columns(here, prior.frozen)
        hessian, gradient = _normal(here, columns, residual, robust)
        linearised = here, columns, residual, robust
        hessian += np.diag(pull)
        gradient -= pull * (vector - centre)
        progress(done, iterations)
        better, gain = False, 0.0
        for _ in range(8):
            # A parameter at a bound that wants to go on stays; one that would pass its bound goes there, and the others know of it.
            stuck = ((vector <= floor) & (gradient < 0)) | ((vector >= ceiling) & (gradient > 0)) | ~free_always
            damped = hessian + damping * np.diag(np.diag(hessian) + 1e-12)
            step, free, held = np.zeros_like(vector), np.flatnonzero(~stuck), np.flatnonzero(stuck)
            while len(free):
                step[free] = np.linalg.solve(damped[np.ix_(free, free)], gradient[free] - damped[np.ix_(free, held)] @ step[held])
                passed = (vector[free] + step[free] < floor[free]) | (vector[free] + step[free] > ceiling[free])
                if not passed.any():
                    break
                gone = free[passed]
                step[gone] = np.clip(vector[gone] + step[gone], floor[gone], ceiling[gone]) - vector[gone]
                free, held = free[~passed], np.concatenate([held, gone])
            trial = np.clip(vector + step, floor, ceiling)
            there = evaluate(trial)
            new = data.level - there.level
            trial_cost = _cost(new, data.weight, sigma) + float(pull @ (trial - centre) ** 2)
            if trial_cost < cost:
                gain = (cost - trial_cost) / cost
                vector, here, residual, damping, better = trial, there, new, max(damping / 5, 1e-9), True
                break
            damping *= 6
        slow = slow + 1 if gain < 1e-4 else 0
        if not better or slow == 3:
            break
    covariance = np.zeros_like(hessian)
    free = np.flatnonzero(free_always)
    if linearised is not None:
        covariance[np.ix_(free, free)] = _jackknife(*linearised, hessian, free, pull)
    rms = float(np.sqrt(np.average(residual[counted] ** 2, weights=data.weight[counted])))
    return Fitted(here.parameters, here.presses, float(cost), rms, sigma, covariance, done)


def brightness(parameters: Parameters, presses: Array, data: Data, dents: Dents) -> Array:
    """Mean size of the linear change that each light but the veil makes, all colours together, shape (L,)."""
    here = Evaluation(parameters, presses, data, dents)
    return np.array(
        [np.abs(values).mean() * colours.sum() for values, colours in zip(here.changes[:-1], parameters.colours[:-1], strict=True)]
    )


def _cost(residual: Array, weight: Array, sigma: float) -> float:
    size = np.abs(residual) / sigma
    return float((weight * np.where(size < HUBER, size**2, 2 * HUBER * size - HUBER**2)).sum())


def _columns(here: Evaluation, frozen: NDArray[np.bool_]) -> Array:
    """Derivatives of the levels by the sensor's vector and by what the pixel's own press is, shape (N, 3, K + 5)."""
    sensor = np.zeros((*here.level.shape, len(frozen))) if frozen.all() else here.sensor_columns(frozen)
    return np.concatenate([sensor, here.press_columns()], axis=2)


def _of(press: int, sensor_count: int) -> NDArray[np.int64]:
    """Where the sensor and a press stand in the vector."""
    return np.concatenate([np.arange(sensor_count), sensor_count + len(PRESS) * press + np.arange(len(PRESS))])


def _normal(here: Evaluation, columns: Array, residual: Array, weight: Array) -> tuple[Array, Array]:
    """JᵀWJ and JᵀWr over sensor and presses."""
    width, press_count = columns.shape[2], len(here.presses)
    sensor_count = width - len(PRESS)
    total = sensor_count + len(PRESS) * press_count
    hessian, gradient = np.zeros((total, total)), np.zeros(total)
    for press in range(press_count):
        some = here.data.pixels.press == press
        flat, at = columns[some].reshape(-1, width), _of(press, sensor_count)
        heavy = flat * weight[some].reshape(-1, 1)
        hessian[np.ix_(at, at)] += flat.T @ heavy
        gradient[at] += heavy.T @ residual[some].ravel()
    return hessian, gradient


def _jackknife(
    here: Evaluation, columns: Array, residual: Array, weight: Array, hessian: Array, free: NDArray[np.int64], pull: Array
) -> Array:  # fmt: skip
    """Covariance of the free parameters by how the fit would move without each block, and by the priors' own width."""
    width = columns.shape[2]
    moved = []
    order = np.argsort(here.data.block, kind="stable")
    for some in np.split(order, np.flatnonzero(np.diff(here.data.block[order])) + 1):
        at = _of(int(here.data.pixels.press[some[0]]), width - len(PRESS))
        flat = columns[some].reshape(-1, width)
        heavy = flat * weight[some].reshape(-1, 1)
        rest, gradient = hessian.copy(), np.zeros(len(hessian))
        rest[np.ix_(at, at)] -= flat.T @ heavy
        gradient[at] = heavy.T @ residual[some].ravel()
        moved.append(np.linalg.lstsq(rest[np.ix_(free, free)], gradient[free], rcond=None)[0])
    inverse = np.linalg.pinv(hessian[np.ix_(free, free)])
    return np.transpose(moved) @ np.array(moved) + inverse @ np.diag(pull[free]) @ inverse
