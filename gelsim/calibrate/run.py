"""The line of a calibration: photographs -> rest and dents -> lights -> fit -> the renderer's correction -> test presses -> preset, report.

The rest is measured: the sensor carries its picture without contact, and only what presses change is fitted (`optics.rest`). The fit's
own model has no inter-reflection and no light that hides another. So the renderer draws the fitted sensor, what it adds to the model's
levels is kept as a constant, and the fit goes on from there. One press of the fit in four is left out of it and judges each state of the
sensor by the renderer's picture; the best one stays, whichever came last. Presses with split = test enter nothing; of each, place and
depth alone (where not given) are then found with the sensor held.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate import dots, drawing, pictures, resting
from gelsim.calibrate import start as beginning
from gelsim.calibrate.dent import SHALLOWEST, Dents, effective_radius, solve_dents
from gelsim.calibrate.fit import Data, Fitted, Prior, brightness, fit
from gelsim.calibrate.model import Rest, rays
from gelsim.calibrate.parameters import GLOBALS, PRESS, Parameters, curvature_of, empty_scene, in_units, light_names, to_scene
from gelsim.calibrate.photos import Photos, read_photos
from gelsim.calibrate.preset import fitted_head, write_preset
from gelsim.data.metrics import picture_errors, said
from gelsim.errors import SceneError
from gelsim.optics.rest import even_part, rest_name, save_levels
from gelsim.pipeline import outputs, stages
from gelsim.scene.definition import Gel, Scene
from gelsim.scene.layers import build_scene, is_preset

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

FIT_WIDTH = 160
"""Pictures are averaged down to at most this width for the fit; the predictions are scored at full size."""
MOST_PIXELS = 9000
"""Compared in one fit, in all photographs together: more changed the squared error on test presses by less than 3 %, and take longer."""
LEAST_REACH = 0.12
"""Of the picture's width, likewise: dots move farther than light changes."""
NEEDED = 1.05
"""A light is needed if the squared error without it is larger by this factor."""
ROUNDS = 2
"""Of the renderer's correction."""
CORRECTION_PATHS, MOST_SPP = 2_000_000, 1024
"""Of a picture that corrects the model: what the membrane sends to itself is gathered from so many paths, whatever the picture's size."""
BEFORE_SPP, SCORE_SPP = 24, 64
SMOOTHING_MM = 0.14
"""Standard deviation of the mean over the renderer's noise in what the membrane sends to itself. Wider, the bright ring at a contact's edge
is lost, and the fit makes up for it with camera and coat."""
VALIDATION = 4
"""One in so many presses is left out of the fit to judge its states; with fewer than twice as many, those of the fit judge."""
UNDETERMINED = 0.7
"""A parameter whose uncertainty is more than this share of its prior's was not determined by the photographs."""
DRAG_SD, UNDRAGGED = 0.3, 1e-6
"""Of the priors of how far a ball was dragged since it touched, by hand and not at all [mm]."""
CROP = 0.625
"""Side of the square about a dent that is scored too, over the picture's width: 400 of 640."""

CONVENTIONS = "albedo, flake reflectance, white balance and exposure: no photograph tells them from the lights' powers"


@dataclass
class _Job:
    """What every stage needs."""

    photos: Photos
    base: Scene
    factor: int
    reduced: Array
    """Photographs for the fit, shape (P, h, w, 3)."""
    rest: Array
    """The picture without contact, at the photographs' own size."""
    small: Rest
    """Likewise, as the fit has it."""
    small_path: Path
    contacts: Array
    """Of the dents: column, row, radius in reduced pixels, shape (P, 3)."""
    counted: NDArray[np.bool_]
    """Pixels that show gel alone, shape (h, w)."""
    dents: Dents
    frozen_globals: NDArray[np.bool_]
    device: str
    show: Progress
    warnings: list[str]
    """Grows on the way."""

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the field in reduced pixels."""
        return self.photos.size[0] / self.factor, self.photos.size[1] / self.factor

    def reach(self, some: NDArray[np.int64]) -> Array:
        """How far from its middle a dent is compared [reduced pixels]."""
        return np.maximum(beginning.FELT * self.contacts[some, 2], LEAST_REACH * self.size[0])

    def data(self, some: NDArray[np.int64], correction: Array | None, most: int = MOST_PIXELS) -> Data:
        reach = self.reach(some)
        stride = max(int(np.ceil(np.sqrt(np.pi * (reach**2).sum() / most))), 1)
        picked = None if correction is None else correction[some]
        balls = self.photos.balls_mm[some]
        return beginning.gather(
            self.reduced[some], self.contacts[some], reach, self.small, balls, self.counted, stride=stride, correction=picked
        )

    def frozen(self, parameters: Parameters) -> NDArray[np.bool_]:
        frozen = np.zeros(parameters.vector.size, bool)
        frozen[: len(GLOBALS)] = self.frozen_globals
        return frozen


def calibrate(
    folder: Path, out: Path, *, sensor: str | None = None, force: bool = False, device: str = "auto", progress: Progress | None = None
) -> dict[str, Any]:
    """Fits a sensor to a folder of photographs, writes preset, report and pictures, and returns the report.

    Args:
        folder: As `gelsim.calibrate.photos` describes.
        out: The preset to write, ending in .toml; report.json, comparison.png and residuals.png go beside it.
        sensor: A shipped preset to start from (gel, window, camera), or a name for a new one.
        force: Write over earlier files of these names.
    Raises:
        SceneError: Bad input; nothing was written.
    """
    begun = time.perf_counter()
    target = _check_out(out, force)
    photos, warnings = _balls_of(folder)
    if not photos.files:
        return resting.at_rest(photos, target, out, sensor, device)
    if photos.gel is not None:
        photos = replace(photos, counted=_within_gel(photos, photos.gel, warnings))
    show = progress or (lambda stage, done, total: None)
    with tempfile.TemporaryDirectory() as scratch:
        job, mm_per_px = _prepare(photos, _base(sensor), Path(scratch), device, show, warnings)
        full_rest = Path(scratch) / "full.png"
        save_levels(job.rest, full_rest)
        first, presses, states, judged = _states(job, mm_per_px)
        state = min(states, key=lambda each: each.error)
        sd = _press_sd(job, presses)
        if len(judged):
            states.append(_of_all(job, state, presses, sd, judged))
            state = min(state, states[-1], key=lambda each: each.error)
        places, press_sd = presses.copy(), np.full(presses.shape, np.nan)
        count = state.fitted.parameters.vector.size
        spread = np.sqrt(np.maximum(np.diag(state.fitted.covariance), 0))
        places[state.which], press_sd[state.which] = state.fitted.presses, spread[count:].reshape(-1, len(PRESS))
        others = np.setdiff1d(np.arange(len(presses)), state.which)
        test, dragged = np.flatnonzero(photos.test), places.copy()
        if len(others):
            # Of a test press three numbers are found, place and depth; drag is found beside them, and said apart.
            straight = sd.copy()
            straight[:, 3:] = UNDRAGGED
            found = _locate(job, state, _rough(job, state.fitted.parameters)[others], straight[others], others)
            dragged[others] = places[others] = found.presses
            if photos.markers:
                found = _locate(job, state, places[others], sd[others], others)
                dragged[others] = found.presses
            press_sd[others] = np.sqrt(np.maximum(np.diag(found.covariance)[count:], 0)).reshape(-1, len(PRESS))
            places[~photos.test] = dragged[~photos.test]
        fitted = state.fitted

        scene = _full_scene(job, fitted.parameters, full_rest)
        if photos.markers:
            scene = dots.with_grid(scene, photos.no_contact, warnings)
        shown_rest, shown = _draw(job, scene, fitted.parameters, places, np.arange(len(places)), SCORE_SPP, "pictures")
        rows = _rows(test if len(test) else np.flatnonzero(~photos.test))
        before = _full_scene(job, first, full_rest)
        before_rest, before_shown = _draw(job, before, first, presses[rows], rows, BEFORE_SPP, "before")
        report = _report(job, state, places, press_sd, shown_rest, shown)
        if len(test) and photos.markers:
            _, drawn = _draw(job, scene, fitted.parameters, dragged[test], test, SCORE_SPP, "dragged")
            report["scores"]["test_dragged"] = _dragged(report, photos, test, dragged[test], drawn)
        report["states"] = {
            "presses_left_out": [photos.files[index] for index in judged],
            "judged_by": "presses of the fit that were left out" if len(judged) else "the presses of the fit: too few to leave some out",
            "mse": {each.name: each.error for each in states},
            "kept": state.name,
        }
        report |= {"out": str(out), "sensor": sensor, "seconds": round(time.perf_counter() - begun, 1)}
        plain = outputs.plain_json(report)
        assert isinstance(plain, dict)
        _write(target, out, scene, plain, job, rows, (shown_rest, shown[rows]), (before_rest, before_shown))
    return plain


def _balls_of(folder: Path) -> tuple[Photos, list[str]]:
    """What can be fitted to, and what is said of the rest: presses of other objects are for `gelsim compare`."""
    photos = read_photos(folder)
    other = np.isnan(photos.balls_mm)
    for index in np.flatnonzero(other & ~photos.test):
        raise SceneError(
            f"{folder / photos.files[index]}: shape = {photos.bodies[index].shape!r}: a sensor is fitted to rigid balls; with split = test "
            "the press is left for gelsim compare"
        )
    balls = photos.only(~other)
    if balls.test.all() and len(photos.files):
        raise SceneError(f"--photos {folder}: no press to fit to; at least one picture of a ball that is not split = test")
    warned = f"{other.sum()} presses of other objects are neither fitted nor scored here: gelsim compare draws them"
    return balls, [warned] if other.any() else []


@dataclass
class _State:
    """A sensor on the way, and how well it predicts."""

    name: str
    fitted: Fitted
    believed: Parameters
    """Centre of its priors."""
    which: NDArray[np.int64]
    """The presses that it was fitted to."""
    correction: Array | None
    """What the renderer adds to the model, of each photograph."""
    error: float = np.inf
    """Mean squared error of the renderer's pictures about the dents of the presses that judge [levels squared]."""


def _states(job: _Job, mm_per_px: float) -> tuple[Parameters, Array, list[_State], NDArray[np.int64]]:
    """The start, all presses at the start, the states of the fit with their errors, and the presses that judged them."""
    train = np.flatnonzero(~job.photos.test)
    left_out = np.arange(len(train)) % VALIDATION == VALIDATION // 2
    if len(train) < 2 * VALIDATION:
        left_out[:] = False
    kept, judging = train[~left_out], train[left_out]
    seed, presses = _seed(job, mm_per_px)
    sd = _press_sd(job, presses)
    data = job.data(kept, None)
    job.show("lights", 0, 1)
    first = beginning.choose_lights(seed, presses[kept], data, job.dents)
    job.show("lights", 1, 1)
    fitted = _fit(job, first, presses[kept], sd[kept], data, first, 30, "fit")
    believed, fitted = _without_needless_lights(job, first, fitted, sd[kept], data)
    presses[kept] = fitted.presses
    states = [_State("fit", fitted, believed, kept, None)]
    presses[judging] = _rough(job, fitted.parameters)[judging]
    for number in range(ROUNDS + 1):
        state = states[-1]
        if len(judging):
            presses[judging] = _locate(job, state, presses[judging], sd[judging], judging).presses
        pictures, added = _correction(job, state, presses, train, f"render {number + 1}")
        state.error, state.correction = _dent_error(job, pictures, judging if len(judging) else kept), added
        if number < ROUNDS:
            data = job.data(kept, added)
            fitted = _fit(job, state.fitted.parameters, presses[kept], sd[kept], data, believed, 10, f"fit {number + 2}")
            presses[kept] = fitted.presses
            states.append(_State(f"fit after render {number + 1}", fitted, believed, kept, added))
    return first, presses, states, judging


def _of_all(job: _Job, state: _State, presses: Array, sd: Array, judged: NDArray[np.int64]) -> _State:
    """The fit gone on from a state with the presses that judged it, which it must then explain at least as well as before."""
    train = np.flatnonzero(~job.photos.test)
    begun = presses.copy()
    begun[state.which] = state.fitted.presses
    begun[judged] = _locate(job, state, begun[judged], sd[judged], judged).presses
    data = job.data(train, state.correction)
    fitted = _fit(job, state.fitted.parameters, begun[train], sd[train], data, state.believed, 10, "fit of all")
    every = _State("fit of all presses", fitted, state.believed, train, state.correction)
    begun[train] = fitted.presses
    pictures, every.correction = _correction(job, every, begun, train, "render all")
    every.error = _dent_error(job, pictures, judged)
    return every


def _dent_error(job: _Job, pictures: Array, which: NDArray[np.int64]) -> float:
    """Mean squared error where dents are compared, over all of these presses."""
    rows, columns = np.mgrid[: pictures.shape[1], : pictures.shape[2]] + 0.5
    near = [
        (np.hypot(columns - c[0], rows - c[1]) <= reach) & job.counted
        for c, reach in zip(job.contacts[which], job.reach(which), strict=True)
    ]
    return float(((pictures[which] - job.reduced[which]) ** 2)[np.array(near)].mean())


def summary(report: Mapping[str, Any]) -> str:
    """A report in a few lines for people."""
    lines = [f"{report['out']}: {len(report['presses'])} presses, {report.get('seconds', 0):.0f} s"]
    for split, score in report["scores"].items():
        lines.append(f"{said(split, score['whole'])}  ({score['count']} pictures)")
    return "\n".join([*lines, *(f"warning: {text}" for text in report["warnings"])])


def _check_out(out: Path, force: bool) -> outputs.ResultFolder:
    if out.suffix != ".toml":
        raise SceneError(f"--out {out}: a sensor preset ends in .toml")
    beside = (out.parent / name for name in (rest_name(out), "report.json", "comparison.png", "residuals.png"))
    outputs.check_free(out, (out, *beside), force=force)
    return outputs.ResultFolder(out.parent, resume=True)


def _base(sensor: str | None) -> Scene:
    """Gel, window, camera of the start: a shipped preset's, without its lights and markers."""
    start = build_scene({"sensor": {"preset": sensor if sensor and is_preset(sensor) else "fingertip2017"}})
    # The veil stands for what the window returns; the fit's camera is upright on the axis.
    upright = replace(start.camera, offset_mm=(0.0, 0.0), tilt_deg=(0.0, 0.0), distortion=(0.0, 0.0), fresnel=False, tone="srgb")
    camera = replace(upright, rest=None, rest_smooth=())
    return empty_scene(start.gel, camera, replace(start.lights, window_reflection=False))


def _prepare(photos: Photos, base: Scene, scratch: Path, device: str, show: Progress, warnings: list[str]) -> tuple[_Job, float]:
    """Reduced pictures, contacts, rest and dents; and the scale of the start [mm a reduced pixel]."""
    factor = int(np.ceil(photos.size[0] / FIT_WIDTH))
    reduced, no_contact = beginning.reduce(photos.pictures, factor), beginning.reduce(photos.no_contact[None], factor)[0]
    counted = beginning.reduce(np.repeat(photos.counted[None, ..., None], 3, axis=3).astype(float), factor)[0, ..., 0] > 0.999
    if photos.gel is not None:
        base = base.replace(gel=photos.gel)
    contacts, sure = beginning.find_contacts(no_contact, reduced, counted)
    # What a person marked is believed.
    marked = np.column_stack([photos.hints[:, :2], beginning.DRAPE * photos.radii]) / factor
    contacts = np.where(np.isfinite(marked), marked, contacts)
    sure |= np.isfinite(marked).all(axis=1)
    if not sure.all():
        lost = [name for name, found in zip(photos.files, sure, strict=True) if not found]
        raise SceneError(
            f"no contact can be seen in {', '.join(lost[:5])}: they differ from no_contact nowhere; leave them out of presses.csv"
        )
    train = ~photos.test
    rest = beginning.rest_picture(photos.no_contact, photos.pictures[train], contacts[train] * factor, beginning.FELT)
    # Eight bits here too: the renderer reads the picture from a file.
    small_path = scratch / "small.png"
    small = save_levels(beginning.reduce(rest[None], factor)[0], small_path)
    clipped = float((reduced >= 254.5).mean())
    if clipped > 0.02:
        warnings.append(f"{100 * clipped:.0f} % of the values are at 255: what is clipped says nothing; photograph with less exposure")
    if (~photos.test).sum() < 5:
        warnings.append(f"{(~photos.test).sum()} presses to fit to: twenty that cover the picture determine a sensor better")
    mm_per_px = photos.mm_per_px or base.camera.field_mm[0] / photos.size[0]
    dents = solve_dents(
        base.gel,
        effective_radius(photos.balls_mm, curvature_of(base.gel)),
        photos.gel is not None,
        lambda done, total: show("dents", done, total),
    )
    frozen = np.zeros(len(GLOBALS), bool)
    frozen[GLOBALS.index("camera.mm_per_px")] = photos.mm_per_px is not None
    for name in ("gel.curvature", "gel.thickness_mm"):
        frozen[GLOBALS.index(name)] = photos.gel is not None
    kept = Rest(small, even_part(small))
    return _Job(
        photos, base, factor, reduced, rest, kept, small_path, contacts, counted, dents, frozen, device, show, warnings
    ), mm_per_px * factor


def _within_gel(photos: Photos, gel: Gel, warnings: list[str]) -> NDArray[np.bool_]:
    """Pixels that are counted: those that show the gel that was given, where the scale is known.

    Raises:
        SceneError: A ball is larger than the gel.
    """
    longest = max(gel.size_mm)
    for name, radius in zip(photos.files, photos.balls_mm, strict=True):
        if 2 * radius > longest:
            raise SceneError(
                f"{name}: a ball of {radius:g} mm radius is larger than the gel, {longest:g} mm at its longer side: check that it is the "
                "radius, not the diameter, and [gel] size_mm"
            )
    if photos.mm_per_px is None:
        return photos.counted
    half = [size / 2 / photos.mm_per_px for size in gel.size_mm]
    rows, columns = np.mgrid[: photos.size[1], : photos.size[0]] + 0.5
    within = (np.abs(columns - photos.size[0] / 2) <= half[0]) & (np.abs(rows - photos.size[1] / 2) <= half[1])
    if (photos.counted & ~within).any():
        warnings.append(f"the gel is smaller than the picture: {100 * (1 - within.mean()):.0f} % of it is neither fitted nor scored")
    return photos.counted & within


def _seed(job: _Job, mm_per_px: float) -> tuple[Parameters, Array]:
    curvature, thickness = curvature_of(job.base.gel), job.base.gel.thickness_mm
    values = np.array([mm_per_px, job.base.camera.distance_mm, curvature, thickness, 0.1, 0.4, 1.0, 0.0, 0.0, 0.5])
    half_field = 0.5 * float(np.hypot(*job.size)) * mm_per_px
    lights = job.base.lights
    window = (lights.window_thickness_mm, lights.window_ior, lights.gel_ior)
    seed = Parameters(
        values,
        np.zeros((0, 7)),
        np.ones((1, 3)),
        half_field,
        job.size[0] / 2,
        window,
        (job.base.gel.size_mm[0] / 2, job.base.gel.size_mm[1] / 2),
    )
    return seed, _rough(job, seed)


def _rough(job: _Job, parameters: Parameters) -> Array:
    """Presses by where their contacts are seen, how wide, and what was given, under a sensor; undragged."""
    photos, curvature = job.photos, parameters.globals[2]
    deepest = job.dents.deepest(effective_radius(photos.balls_mm, curvature))
    place = np.where(np.isfinite(photos.hints[:, :2]), photos.hints[:, :2] / job.factor, job.contacts[:, :2])
    touched, _ = rays(parameters.shape(photos.balls_mm), place - np.array(job.size) / 2)
    apex = touched * (1 + photos.balls_mm * curvature)[:, None]
    presses = beginning.rough_presses(apex, job.contacts[:, 2] * parameters.globals[0], photos.balls_mm, deepest)
    given = np.isfinite(photos.hints[:, 2])
    presses[given, 2] = np.minimum(photos.hints[given, 2], deepest[given])
    return presses


def _press_sd(job: _Job, presses: Array) -> Array:
    """Priors of the presses: wide, but for a depth that was given, and for drag, which only markers show."""
    drag = DRAG_SD if job.photos.markers else UNDRAGGED
    sd = np.tile([2.0, 2.0, 1.0, drag, drag], (len(presses), 1))
    sd[np.isfinite(job.photos.hints[:, 2]), 2] = 1e-3
    return sd


def _fit(
    job: _Job, begin: Parameters, presses: Array, sd: Array, data: Data, believed: Parameters, iterations: int, name: str
) -> Fitted:  # fmt: skip
    prior = Prior(believed, sd, job.frozen(begin))
    return fit(begin, presses, data, job.dents, prior, iterations, lambda done, total: job.show(name, done, total))


def _without_needless_lights(job: _Job, first: Parameters, rough: Fitted, sd: Array, data: Data) -> tuple[Parameters, Fitted]:
    """The start and the rough fit less the lights that it does as well without: the start's lights stand on a grid, and a place between two
    of its points took two of them. The weakest goes first, until one is needed."""
    while len(rough.parameters.geometry) > 1:
        lit = brightness(rough.parameters, rough.presses, data, job.dents)
        kept = np.delete(np.arange(len(lit) + 1), int(lit.argmin()))
        fewer, begin = (replace(each, geometry=each.geometry[kept[:-1]], colours=each.colours[kept]) for each in (first, rough.parameters))
        trial = _fit(job, begin, rough.presses, sd, data, fewer, 10, f"fit of {len(kept) - 1} lights")
        if trial.rms**2 > NEEDED * rough.rms**2:
            break
        first, rough = fewer, trial
    return first, rough


def _locate(job: _Job, state: _State, presses: Array, sd: Array, which: NDArray[np.int64]) -> Fitted:
    """Places and depths of presses with the sensor held."""
    parameters = state.fitted.parameters
    data, held = job.data(which, state.correction, 2 * MOST_PIXELS), Prior(parameters, sd, np.ones(parameters.vector.size, bool))
    return fit(parameters, presses, data, job.dents, held, 15, lambda done, total: job.show("locate", done, total))


def _full_scene(job: _Job, parameters: Parameters, rest: Path) -> Scene:
    """The sensor at the photographs' own resolution."""
    values = parameters.globals.copy()
    values[0] /= job.factor
    return _with_rest(to_scene(replace(parameters, globals=values), job.base, job.photos.size), rest)


def _with_rest(scene: Scene, rest: Path) -> Scene:
    return scene.replace(camera=replace(scene.camera, rest=str(rest)))


def _draw(
    job: _Job, scene: Scene, parameters: Parameters, presses: Array, which: NDArray[np.int64], spp: int, name: str, mode: str = "path"
) -> tuple[Array, Array]:  # fmt: skip
    """The picture at rest, and those of presses, whose numbers are `which`."""
    scene = scene.replace(render=replace(scene.render, mode=mode, spp=spp))
    rest, images = drawing.draw(
        scene, job.dents.at(parameters.globals[3], parameters.globals[9]), job.photos.balls_mm[which], list(presses), device=job.device,
        progress=lambda done, total: job.show(name, done, total),
    )  # fmt: skip
    return rest.astype(float), images.astype(float)


def _correction(job: _Job, state: _State, presses: Array, which: NDArray[np.int64], name: str) -> tuple[Array, Array]:
    """The renderer's reduced pictures of presses, and what it adds to the model's levels; 0 for photographs that are not in `which`."""
    from scipy.ndimage import gaussian_filter

    height, width = job.reduced.shape[1:3]
    fitted = replace(state.fitted, presses=presses[which])
    scene = _with_rest(to_scene(fitted.parameters, job.base, (width, height)), job.small_path)
    spp = int(np.clip(CORRECTION_PATHS / (height * width), BEFORE_SPP, MOST_SPP))
    images, straight = (_draw(job, scene, fitted.parameters, fitted.presses, which, spp, name, mode)[1] for mode in ("path", "direct"))
    own = beginning.model_pictures(
        fitted, job.small, job.dents, job.photos.balls_mm[which], job.contacts[which], job.reach(which), straight
    )
    # What the membrane sends to itself is smooth, so that its noise can be smoothed away; shadows, and what a pixel averages over, are not.
    sd = SMOOTHING_MM / fitted.parameters.globals[0]
    added = gaussian_filter(images - straight, (0, sd, sd, 0)) + (straight - own)
    drawn, whole = np.zeros_like(job.reduced), np.zeros_like(job.reduced)
    drawn[which], whole[which] = images, added
    return drawn, whole


def _rows(which: NDArray[np.int64]) -> NDArray[np.int64]:
    """A few of them, spread evenly."""
    return which[np.unique(np.linspace(0, len(which) - 1, pictures.MOST_ROWS - 1).round().astype(int))]


def _crop(size: tuple[int, int], place: Array) -> tuple[slice, slice]:
    """Rows and columns of the square of CROP about a place (column, row), moved inside the picture."""
    side = min(round(CROP * size[0]), size[1])
    column, row = (int(np.clip(at - side / 2, 0, most - side)) for at, most in zip(place, size, strict=True))
    return slice(row, row + side), slice(column, column + side)


def _report(job: _Job, state: _State, places: Array, press_sd: Array, shown_rest: Array, shown: Array) -> dict[str, Any]:
    photos, fitted, believed = job.photos, state.fitted, state.believed
    spread = np.sqrt(np.maximum(np.diag(fitted.covariance), 0))[: fitted.parameters.vector.size]
    prior, low, high = believed.prior()
    frozen = job.frozen(fitted.parameters)
    scale = np.ones(len(spread))
    scale[0] = 1 / job.factor
    table, loose = {}, []
    for index, name in enumerate(fitted.parameters.names):
        value = float(fitted.parameters.vector[index])
        bound = value <= low[index] or value >= high[index]
        determined = not frozen[index] and not bound and spread[index] < UNDETERMINED * prior[index]
        shown_name, number, sd = in_units(name, value, spread[index])
        _, believed_number, believed_sd = in_units(name, float(believed.vector[index]), prior[index])
        table[shown_name] = {
            "value": number * scale[index],
            "sd": None if frozen[index] else sd * scale[index],
            "prior": believed_number * scale[index],
            "prior_sd": believed_sd * scale[index],
            "state": "given" if frozen[index] else "at its bound" if bound else "determined" if determined else "not determined",
        }
        if not frozen[index] and not determined and "flux" not in name:
            loose.append(shown_name)
    if loose:
        job.warnings.append(f"the photographs do not determine {', '.join(loose)}: kept near the start, or at a bound")
    pixels = (places[:, :2] / (1 + photos.balls_mm * fitted.parameters.globals[2])[:, None]) / fitted.parameters.globals[0] * job.factor
    pixels += np.array(photos.size) / 2
    rows, scores = [], {}
    rest_errors = picture_errors(shown_rest, photos.no_contact, photos.counted)
    for index, file in enumerate(photos.files):
        split = "test" if photos.test[index] else "train"
        near, seen = _crop(photos.size, pixels[index]), photos.pictures[index]
        pairs = [
            (picture_errors(each, seen, photos.counted), picture_errors(each[near], seen[near], photos.counted[near]))
            for each in (shown[index], photos.no_contact)
        ]
        (whole, crop), unmoved = pairs
        rows.append(
            {
                "file": file, "split": split, "offset_mm": places[index, :2], "depth_mm": places[index, 2],
                "sd_mm": press_sd[index, :3], "drag_mm": places[index, 3:],
                "col_px": pixels[index, 0], "row_px": pixels[index, 1], "whole": whole, "crop": crop,
            }
        )  # fmt: skip
        scores.setdefault(split, []).append((whole, crop))
        scores.setdefault(f"no_contact_as_{split}", []).append(unmoved)
    means = {name: _mean_scores(pairs) for name, pairs in scores.items()}
    splits = [split for split in ("train", "test") if split in means]
    ratios = {split: means[split]["whole"]["mse"] / means[f"no_contact_as_{split}"]["whole"]["mse"] for split in splits}
    judge = splits[-1]
    if ratios[judge] > 1:
        job.warnings.append(
            f"the fitted sensor explains the {judge} presses worse than the no-contact picture does (MSE "
            f"{means[judge]['whole']['mse']:.1f}, not {means[f'no_contact_as_{judge}']['whole']['mse']:.1f}): do not use it; "
            f"{_advice(photos)}"
        )
    deepest = job.dents.deepest(effective_radius(photos.balls_mm, fitted.parameters.globals[2]))
    for bounds, what in ((deepest, "deepest that is solved"), (np.full(len(deepest), SHALLOWEST), "least")):
        at = np.flatnonzero(np.isclose(places[:, 2], bounds, rtol=1e-3))
        if len(at):
            job.warnings.append(
                f"depth at its bound of {bounds[at[0]]:.2g} mm, the {what}: {', '.join(photos.files[index] for index in at[:6])}; "
                f"{_advice(photos)}, or leave them out"
            )
    return {
        "parameters": table,
        "conventions": CONVENTIONS,
        "presses": rows,
        "mse_of_no_contact": ratios,
        "scores": means | {"no_contact": _mean_scores([(rest_errors, rest_errors)])},
        "fit": {
            "rms_levels": fitted.rms,
            "noise_levels": fitted.sigma,
            "lights": light_names(fitted.parameters),
            "width_px": job.reduced.shape[2],
        },
        "choices": {
            "start": job.base.sensor.preset,
            **photos.lens_choice,
            "gel": "given" if photos.gel else "thickness and dome fitted, size and hardness of the start",
            "test_presses": "place and depth found from their own photograph with the sensor held" if photos.test.any() else None,
            "score_spp": SCORE_SPP,
        },
        "versions": stages.versions(("numpy", "scipy", "mitsuba")),
        "warnings": job.warnings,
    }


def _dragged(report: dict[str, Any], photos: Photos, test: NDArray[np.int64], presses: Array, drawn: Array) -> dict[str, Any]:
    """Scores of test presses of which drag is found too; puts what was found into their rows."""
    pairs = []
    for index, press, picture in zip(test, presses, drawn, strict=True):
        row = report["presses"][index]
        whole = picture_errors(picture, photos.pictures[index], photos.counted)
        near = _crop(photos.size, np.array([row["col_px"], row["row_px"]]))
        pairs.append((whole, picture_errors(picture[near], photos.pictures[index][near], photos.counted[near])))
        row["dragged"] = {"offset_mm": press[:2], "depth_mm": press[2], "drag_mm": press[3:], "whole": whole}
    return _mean_scores(pairs)


def _advice(photos: Photos) -> str:
    """What is left to try: of the inputs those that were not given, and the ball."""
    tries = [] if photos.mm_per_px else ["give mm_per_px in photos.toml"]
    tries += [] if photos.gel else ["give [gel] with its thickness_mm and profile"]
    return " and ".join(["check ball_radius_mm", *tries])


def _mean_scores(pairs: list[tuple[dict[str, float], dict[str, float]]]) -> dict[str, Any]:
    mean = [{name: float(np.mean([pair[k][name] for pair in pairs])) for name in pairs[0][k]} for k in range(2)]
    return {"count": len(pairs), "whole": mean[0], "crop": mean[1]}


def _write(
    folder: outputs.ResultFolder, out: Path, scene: Scene, report: dict[str, Any], job: _Job, rows: NDArray[np.int64],
    after: tuple[Array, Array], before: tuple[Array, Array],
) -> None:  # fmt: skip
    photos = job.photos
    seen = [photos.no_contact, *photos.pictures[rows]]
    fitted, began = [after[0], *after[1]], [before[0], *before[1]]
    captions = ["no contact"]
    for index in rows:
        score = report["presses"][index]
        captions.append(
            f"{score['file']} ({score['split']}): depth {score['depth_mm']:.2f} mm, "
            f"L1 {score['whole']['l1']:.1f}, MSE {score['whole']['mse']:.0f}"
        )
    columns = (("photograph", seen), ("before: the start", began), ("after: the fitted sensor", fitted))
    folder.write("comparison.png", lambda path: pictures.draw_comparison(path, columns, captions))
    folder.write("residuals.png", lambda path: pictures.draw_residuals(path, seen, fitted, captions))
    folder.write(rest_name(out), lambda path: save_levels(job.rest, path))
    folder.write("report.json", lambda path: outputs.write_report(path, report))
    sensor = report["sensor"]
    name = out.stem if sensor is None or is_preset(sensor) else sensor
    written = scene.replace(camera=replace(scene.camera, rest=rest_name(out)))
    folder.write(out.name, lambda path: write_preset(path, written, fitted_head(report, name)))
