"""Least squares over sensor and presses at once: Levenberg-Marquardt with a robust loss, priors and bounds.

    minimise  Σ_i ϱ((I_i − M_i(θ, p)) / σ) + Σ_k ((θ_k − θ⁰_k) / s_k)²

over the sensor θ and place, depth and drag p of each press; ϱ is Huber's. The model M is the rest picture, changed (`calibrate.model`):
what does not change says nothing of the lights. Derivatives by geometry are one-sided differences, all presses at once (each pixel
depends on its own press only), those by colour exact. Uncertainties are of the sandwich kind: H⁻¹ G H⁻¹ with G the sum over blocks of
pixels of g gᵀ, so that errors that neighbouring pixels share (compression, what the model lacks) count as what they are. Left out: errors
that all photographs share.
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
            for k, what in enumerate(GEOMETRY):
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
    hessian = np.eye(len(vector))
    scores = np.zeros((0, len(vector)))
    for done in range(1, iterations + 1):
        sigma = max(1.4826 * float(np.median(np.abs(residual[counted]))), 0.3)
        cost = _cost(residual, data.weight, sigma) + float(pull @ (vector - centre) ** 2)
        robust = data.weight * np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(residual), 1e-12)) / sigma**2
        hessian, gradient, scores = _normal(here, residual, robust, prior.frozen)
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
    free = np.flatnonzero(free_always)
    inverse = np.linalg.pinv(hessian[np.ix_(free, free)])
    middle = scores[:, free].T @ scores[:, free] + np.diag(pull[free])
    covariance = np.zeros_like(hessian)
    covariance[np.ix_(free, free)] = inverse @ middle @ inverse
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


def _normal(here: Evaluation, residual: Array, weight: Array, frozen: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """JᵀWJ, JᵀWr and the gradient's share of each block, over sensor and presses."""
    data, presses = here.data, here.presses
    own = here.press_columns()
    sensor_count = len(frozen)
    sensor = np.zeros((len(residual), 3, sensor_count)) if frozen.all() else here.sensor_columns(frozen)
    total = sensor_count + presses.size
    hessian = np.zeros((total, total))
    flat = sensor.reshape(-1, sensor_count)
    weighted = flat * weight.reshape(-1, 1)
    hessian[:sensor_count, :sensor_count] = flat.T @ weighted
    scores = np.zeros((int(data.block.max()) + 1, total))
    np.add.at(scores[:, :sensor_count], data.block, (sensor * (weight * residual)[..., None]).sum(axis=1))
    for press in range(len(presses)):
        some = np.flatnonzero(data.pixels.press == press)
        if len(some) == 0:
            continue
        part = slice(sensor_count + len(PRESS) * press, sensor_count + len(PRESS) * (press + 1))
        local = own[some].reshape(-1, len(PRESS))
        heavy = local * weight[some].reshape(-1, 1)
        hessian[part, part] = local.T @ heavy
        hessian[:sensor_count, part] = flat.reshape(-1, 3, sensor_count)[some].reshape(-1, sensor_count).T @ heavy
        hessian[part, :sensor_count] = hessian[:sensor_count, part].T
        np.add.at(scores[:, part], data.block[some], (own[some] * (weight * residual)[some][..., None]).sum(axis=1))
    return hessian, scores.sum(axis=0), scores
