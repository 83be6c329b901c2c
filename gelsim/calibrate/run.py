"""The line of a calibration: photographs -> dents -> start -> fit -> the renderer's correction -> test presses -> preset, report, pictures.

The fit's own model has no inter-reflection and no light that hides another. So the renderer draws the fitted sensor, what it adds to the
model's levels is kept as a constant, and the fit goes on from there: where this has settled, the renderer's pictures are fitted. Presses
with split = test never enter the sensor's fit; of each, place and depth alone (where not given) are then found with the sensor held.
"""

from __future__ import annotations

import importlib.metadata
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate import dots, drawing, pictures
from gelsim.calibrate import start as beginning
from gelsim.calibrate.dent import Dents, effective_radius, solve_dents
from gelsim.calibrate.fit import Data, Fitted, brightness, fit
from gelsim.calibrate.parameters import GLOBALS, Parameters, curvature_of, empty_scene, in_units, light_names, to_scene
from gelsim.calibrate.photos import Photos, read_photos
from gelsim.calibrate.preset import write_preset
from gelsim.data.metrics import picture_errors
from gelsim.errors import SceneError
from gelsim.pipeline import outputs
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene, preset_names
from gelsim.scene.limits import SHADING_DEGREES

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

FIT_WIDTH = 160
"""Pictures are averaged down to at most this width for the fit; the predictions are scored at full size."""
MOST_PIXELS = 22000
"""Compared in one fit, in all photographs together."""
FELT = 1.8
"""Of a dent's visible radius: how far from its middle a press is compared by itself."""
NEEDED = 1.05
"""A light is needed if the squared error without it is larger by this factor."""
ROUNDS = 2
"""Of the renderer's correction."""
CORRECTION_SPP, SCORE_SPP = 24, 24
SMOOTHING = 0.8
"""Standard deviation [px] of the mean over the renderer's noise in what it adds."""
SHADING_DEGREE = 3
VALIDATION = 4
"""One in so many presses of the fit decides whether shading helps; with fewer than twice as many presses there is none."""
UNDETERMINED = 0.7
"""A parameter whose uncertainty is more than this share of its prior's was not determined by the photographs."""
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
    no_contact: Array
    rest: Array
    masked: NDArray[np.bool_] | None
    contacts: Array
    dents: Dents
    frozen_globals: NDArray[np.bool_]
    device: str

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the field in reduced pixels."""
        return self.photos.size[0] / self.factor, self.photos.size[1] / self.factor

    def data(self, some: NDArray[np.int64], presses: Array, mm_per_px: float, degree: int, correction: tuple[Array, Array] | None) -> Data:
        reach = np.maximum(FELT * self.contacts[some, 2], 6.0) * mm_per_px
        near = np.pi * (reach / mm_per_px) ** 2
        stride = int(np.ceil(np.sqrt((near.sum() + self.rest.shape[0] * self.rest.shape[1]) / MOST_PIXELS)))
        masked = None if self.masked is None else self.masked[np.concatenate([[0], 1 + some])]
        picked = None if correction is None else (correction[0], correction[1][some])
        return beginning.gather(
            self.no_contact, self.reduced[some], presses, mm_per_px, reach, masked,
            stride=max(stride, 1), degree=degree, size=self.size, correction=picked,
        )  # fmt: skip

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
    photos = read_photos(folder)
    show = progress or (lambda stage, done, total: None)
    warnings: list[str] = []
    job, mm_per_px = _prepare(photos, _base(sensor), device, show, warnings)
    train, test = np.flatnonzero(~photos.test), np.flatnonzero(photos.test)

    seed, presses = _seed(job, mm_per_px)
    sd = _press_sd(job, presses)
    data = job.data(train, presses[train], mm_per_px, 0, None)
    show("lights", 0, 1)
    first = beginning.choose_lights(seed, presses[train], data, job.dents, photos.ball_mm)
    show("lights", 1, 1)
    rough = _fit(job, first, presses[train], sd[train], data, first, 25, "rough fit", show)

    degree = 0
    validation: dict[str, Any] = {"tried": False}
    if len(train) >= 2 * VALIDATION:
        validation = _validate_shading(job, rough, first, sd, train, show)
        degree = SHADING_DEGREE if validation["helps"] else 0
    believed, begin = _with_shading(first, degree), _with_shading(rough.parameters, degree)
    fitted = _fit(
        job, begin, rough.presses, sd[train], job.data(train, rough.presses, begin.globals[0], degree, None), believed, 25, "fit", show
    )
    correction = None
    for number in range(ROUNDS):
        correction = _correction(job, fitted, train, degree, show, f"render {number + 1}")
        data = job.data(train, fitted.presses, fitted.parameters.globals[0], degree, correction)
        fitted = _fit(job, fitted.parameters, fitted.presses, sd[train], data, believed, 10, f"fit {number + 2}", show)
        believed, fitted = _without_needless_lights(job, believed, fitted, sd[train], data, show)

    places = presses.copy()
    places[train] = fitted.presses
    press_sd = np.full((len(places), 3), np.nan)
    count = fitted.parameters.vector.size
    spread = np.sqrt(np.maximum(np.diag(fitted.covariance), 0))
    press_sd[train] = spread[count:].reshape(-1, 3)
    if len(test):
        found = _locate(job, fitted.parameters, places[test], sd[test], test, degree, None, show)
        places[test] = found.presses
        moved = _correction(job, replace(found, parameters=fitted.parameters), test, degree, show, "render test")
        found = _locate(job, fitted.parameters, places[test], sd[test], test, degree, moved, show)
        places[test] = found.presses
        press_sd[test] = np.sqrt(np.maximum(np.diag(found.covariance)[count:], 0)).reshape(-1, 3)

    scene = _full_scene(job, fitted.parameters)
    if photos.markers:
        grid = dots.marker_grid(photos.no_contact, fitted.parameters.globals[0] / job.factor)
        if grid is None:
            warnings.append("markers = true, but no grid of dark spots is seen in no_contact: the preset has none")
        else:
            scene = scene.replace(markers=grid)
    shown_rest, shown = _draw(job, scene, fitted.parameters, places, SCORE_SPP, show, "pictures")
    before = _full_scene(job, first)
    rows = _rows(test if len(test) else train)
    before_rest, before_shown = _draw(job, before, first, presses[rows], CORRECTION_SPP, show, "before")
    report = _report(job, scene, fitted, believed, places, press_sd, shown_rest, shown, validation, warnings)
    report |= {"out": str(out), "sensor": sensor, "seconds": round(time.perf_counter() - begun, 1)}
    plain = outputs.plain_json(report)
    assert isinstance(plain, dict)
    _write(target, out, scene, plain, job, sensor, rows, (shown_rest, shown[rows]), (before_rest, before_shown))
    return plain


def summary(report: Mapping[str, Any]) -> str:
    """A report in a few lines for people."""
    lines = [f"{report['out']}: {len(report['presses'])} presses, {report['seconds']:.0f} s"]
    for split, score in report["scores"].items():
        whole = score["whole"]
        lines.append(
            f"{split:<20} L1 {whole['l1']:.2f}  MSE {whole['mse']:.1f}  SSIM {whole['ssim']:.3f}  PSNR {whole['psnr_db']:.1f} dB"
            f"  ({score['count']} pictures)"
        )
    return "\n".join([*lines, *(f"warning: {text}" for text in report["warnings"])])


def _check_out(out: Path, force: bool) -> outputs.ResultFolder:
    if out.suffix != ".toml":
        raise SceneError(f"--out {out}: a sensor preset ends in .toml")
    for path in (out, *(out.parent / name for name in ("report.json", "comparison.png", "residuals.png"))):
        if path.exists() and not force:
            raise SceneError(f"--out {out}: {path} exists; give --force to write over it, or another folder")
    return outputs.ResultFolder(out.parent, resume=True)


def _is_preset(sensor: str) -> bool:
    return sensor in preset_names() or sensor.endswith(".toml")


def _base(sensor: str | None) -> Scene:
    """Gel, window, camera of the start: a shipped preset's, without its lights and markers."""
    start = build_scene({"sensor": {"preset": sensor if sensor and _is_preset(sensor) else "fingertip2017"}})
    # The veil stands for what the window returns; the fit's camera is upright on the axis.
    camera = replace(start.camera, offset_mm=(0.0, 0.0), tilt_deg=(0.0, 0.0), distortion=(0.0, 0.0), fresnel=False, tone="srgb")
    return empty_scene(start.gel, camera, replace(start.lights, window_reflection=False))


def _prepare(photos: Photos, base: Scene, device: str, show: Progress, warnings: list[str]) -> tuple[_Job, float]:
    """Reduced pictures, contacts and dents; and the scale of the start [mm a reduced pixel]."""
    factor = int(np.ceil(photos.size[0] / FIT_WIDTH))
    reduced, no_contact = _reduce(photos.pictures, factor), _reduce(photos.no_contact[None], factor)[0]
    if photos.gel is not None:
        base = base.replace(gel=photos.gel)
    rest = beginning.rest_picture(no_contact, reduced[~photos.test])
    masked = dots.with_margin(dots.dark_pixels(np.concatenate([no_contact[None], reduced]))) if photos.markers else None
    contacts, sure = beginning.find_contacts(rest, reduced, masked)
    if not sure.all():
        lost = [name for name, found in zip(photos.files, sure, strict=True) if not found]
        raise SceneError(
            f"no contact can be seen in {', '.join(lost[:5])}: they differ from no_contact nowhere; leave them out of presses.csv"
        )
    clipped = float((reduced >= 254.5).mean())
    if clipped > 0.02:
        warnings.append(f"{100 * clipped:.0f} % of the values are at 255: what is clipped says nothing; photograph with less exposure")
    if (~photos.test).sum() < 5:
        warnings.append(f"{(~photos.test).sum()} presses to fit to: twenty that cover the picture determine a sensor better")
    mm_per_px = photos.mm_per_px or base.camera.field_mm[0] / photos.size[0]
    radius = effective_radius(photos.ball_mm, curvature_of(base.gel))
    dents = solve_dents(base.gel, radius, photos.gel is not None, lambda done, total: show("dents", done, total))
    frozen = np.zeros(len(GLOBALS), bool)
    frozen[GLOBALS.index("camera.mm_per_px")] = photos.mm_per_px is not None
    for name in ("gel.curvature", "gel.thickness_mm"):
        frozen[GLOBALS.index(name)] = photos.gel is not None
    return _Job(photos, base, factor, reduced, no_contact, rest, masked, contacts, dents, frozen, device), mm_per_px * factor


def _reduce(pictures: Array, factor: int) -> Array:
    """Means over squares of `factor` pixels, from the top left corner; what is left over is cut off."""
    count, height, width = pictures.shape[:3]
    rows, columns = height // factor, width // factor
    return pictures[:, : rows * factor, : columns * factor].reshape(count, rows, factor, columns, factor, 3).mean(axis=(2, 4))


def _seed(job: _Job, mm_per_px: float) -> tuple[Parameters, Array]:
    photos = job.photos
    curvature, thickness = curvature_of(job.base.gel), job.base.gel.thickness_mm
    values = np.array([mm_per_px, job.base.camera.distance_mm, curvature, thickness, 0.1, 0.4, 1.0])
    half_field = 0.5 * float(np.hypot(*job.size)) * mm_per_px
    lights = job.base.lights
    window = (lights.window_thickness_mm, lights.window_ior, lights.gel_ior)
    seed = Parameters(values, np.zeros((0, 7)), np.ones((1, 3)), np.zeros((0, 3)), half_field, job.size[0] / 2, window)
    presses = beginning.rough_presses(job.contacts, mm_per_px, job.size, photos.ball_mm, curvature, job.dents.deepest_mm)
    for k in range(2):
        given = np.isfinite(photos.hints[:, k])
        places = (photos.hints[given, k] / job.factor - job.size[k] / 2) * mm_per_px * (1 + photos.ball_mm * curvature)
        presses[given, k] = places
    given = np.isfinite(photos.hints[:, 2])
    presses[given, 2] = np.minimum(photos.hints[given, 2], job.dents.deepest_mm)
    return seed, presses


def _press_sd(job: _Job, presses: Array) -> Array:
    """Priors of the presses: wide, but for a depth that was given."""
    sd = np.tile([2.0, 2.0, 1.0], (len(presses), 1))
    sd[np.isfinite(job.photos.hints[:, 2]), 2] = 1e-3
    return sd


def _fit(
    job: _Job, begin: Parameters, presses: Array, sd: Array, data: Data, believed: Parameters, iterations: int, name: str, show: Progress
) -> Fitted:  # fmt: skip
    return fit(
        begin, presses, data, job.dents, job.photos.ball_mm, believed=believed, press_sd=sd, frozen=job.frozen(begin),
        iterations=iterations, progress=lambda done, total: show(name, done, total),
    )  # fmt: skip


def _without_needless_lights(
    job: _Job, first: Parameters, rough: Fitted, sd: Array, data: Data, show: Progress
) -> tuple[Parameters, Fitted]:
    """The start and the rough fit less the lights that it does as well without: the start's lights stand on a grid, and a place between two
    of its points took two of them. The weakest goes first, until one is needed."""
    while len(rough.parameters.geometry) > 1:
        lit = brightness(rough.parameters, rough.presses, data, job.dents, job.photos.ball_mm)
        kept = np.delete(np.arange(len(lit) + 1), int(lit.argmin()))
        fewer, begin = (replace(each, geometry=each.geometry[kept[:-1]], colours=each.colours[kept]) for each in (first, rough.parameters))
        trial = _fit(job, begin, rough.presses, sd, data, fewer, 15, f"fit of {len(kept) - 1} lights", show)
        if trial.rms**2 > NEEDED * rough.rms**2:
            break
        first, rough = fewer, trial
    return first, rough


def _with_shading(parameters: Parameters, degree: int) -> Parameters:
    terms = next((count for count, known in SHADING_DEGREES.items() if known == degree), 0)
    return replace(parameters, shading=np.zeros((terms, 3)))


def _locate(
    job: _Job, parameters: Parameters, presses: Array, sd: Array, which: NDArray[np.int64], degree: int,
    correction: tuple[Array, Array] | None, show: Progress,
) -> Fitted:  # fmt: skip
    """Places and depths of presses with the sensor held."""
    data = job.data(which, presses, parameters.globals[0], degree, correction)
    return fit(
        parameters, presses, data, job.dents, job.photos.ball_mm, press_sd=sd, frozen=np.ones(parameters.vector.size, bool),
        iterations=12, progress=lambda done, total: show("locate", done, total),
    )  # fmt: skip


def _validate_shading(
    job: _Job, rough: Fitted, believed: Parameters, sd: Array, train: NDArray[np.int64], show: Progress
) -> dict[str, Any]:
    """Squared error on presses of the fit that are left out, without and with shading."""
    left_out = np.arange(len(train)) % VALIDATION == VALIDATION // 2
    kept, held = train[~left_out], train[left_out]
    errors = {}
    for degree in (0, SHADING_DEGREE):
        begin = _with_shading(rough.parameters, degree)
        data = job.data(kept, rough.presses[~left_out], begin.globals[0], degree, None)
        name = f"fit, shading {degree}"
        inner = _fit(job, begin, rough.presses[~left_out], sd[kept], data, _with_shading(believed, degree), 12, name, show)
        found = _locate(job, inner.parameters, rough.presses[left_out], sd[held], held, degree, None, show)
        errors[degree] = found.rms**2
    return {
        "tried": True,
        "presses_left_out": [job.photos.files[index] for index in held],
        "mse_without": errors[0],
        "mse_with": errors[SHADING_DEGREE],
        "helps": bool(errors[SHADING_DEGREE] < 0.97 * errors[0]),
    }


def _full_scene(job: _Job, parameters: Parameters) -> Scene:
    """The sensor at the photographs' own resolution."""
    values = parameters.globals.copy()
    values[0] /= job.factor
    return to_scene(replace(parameters, globals=values), job.base, job.photos.size)


def _draw(job: _Job, scene: Scene, parameters: Parameters, presses: Array, spp: int, show: Progress, name: str) -> tuple[Array, Array]:
    scene = scene.replace(render=replace(scene.render, mode="path", spp=spp))
    rest, images = drawing.draw(
        scene, job.dents.at(parameters.globals[3]), job.photos.ball_mm, list(presses), device=job.device,
        progress=lambda done, total: show(name, done, total),
    )  # fmt: skip
    return rest.astype(float), images.astype(float)


def _correction(job: _Job, fitted: Fitted, which: NDArray[np.int64], degree: int, show: Progress, name: str) -> tuple[Array, Array]:
    """What the renderer adds to the model's levels: of the rest picture, and of each photograph (0 for those not in `which`)."""
    from scipy.ndimage import gaussian_filter

    height, width = job.rest.shape[:2]
    scene = to_scene(fitted.parameters, job.base, (width, height))
    rest, images = _draw(job, scene, fitted.parameters, fitted.presses, CORRECTION_SPP, show, name)
    reach = np.maximum(FELT * job.contacts[which, 2], 6.0)
    middles, means = beginning.whole_pictures(fitted, degree, job.dents, job.photos.ball_mm, (height, width), reach)
    # What inter-reflection adds is smooth, so that the renderer's noise can be smoothed away; what a pixel averages over is not.
    drawn = np.concatenate([rest[None], images])
    added = gaussian_filter(drawn - means, (0, SMOOTHING, SMOOTHING, 0)) + (means - middles)
    whole = np.zeros((len(job.reduced), height, width, 3))
    whole[which] = added[1:]
    return added[0], whole


def _rows(which: NDArray[np.int64]) -> NDArray[np.int64]:
    """A few of them, spread evenly."""
    return which[np.unique(np.linspace(0, len(which) - 1, pictures.MOST_ROWS - 1).round().astype(int))]


def _crop(picture: Array, place: Array) -> Array:
    """The square of CROP about a place (column, row), moved inside the picture."""
    height, width = picture.shape[:2]
    side = min(round(CROP * width), height)
    column = int(np.clip(place[0] - side / 2, 0, width - side))
    row = int(np.clip(place[1] - side / 2, 0, height - side))
    return picture[row : row + side, column : column + side]


def _report(
    job: _Job, scene: Scene, fitted: Fitted, believed: Parameters, places: Array, press_sd: Array, shown_rest: Array, shown: Array,
    validation: dict[str, Any], warnings: list[str],
) -> dict[str, Any]:  # fmt: skip
    photos = job.photos
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
        warnings.append(f"the photographs do not determine {', '.join(loose)}: kept near the start, or at a bound")
    pixels = (places[:, :2] / (1 + photos.ball_mm * fitted.parameters.globals[2])) / fitted.parameters.globals[0] * job.factor
    pixels += np.array(photos.size) / 2
    rows, scores = [], {}
    rest_errors = picture_errors(shown_rest, photos.no_contact)
    for index, file in enumerate(photos.files):
        split = "test" if photos.test[index] else "train"
        whole = picture_errors(shown[index], photos.pictures[index])
        crop = picture_errors(_crop(shown[index], pixels[index]), _crop(photos.pictures[index], pixels[index]))
        unmoved = picture_errors(photos.no_contact, photos.pictures[index])
        rows.append(
            {
                "file": file, "split": split, "offset_mm": places[index, :2], "depth_mm": places[index, 2], "sd_mm": press_sd[index],
                "col_px": pixels[index, 0], "row_px": pixels[index, 1], "whole": whole, "crop": crop,
            }
        )  # fmt: skip
        scores.setdefault(split, []).append((whole, crop))
        scores.setdefault(f"no_contact_as_{split}", []).append((unmoved, unmoved))
    means = {name: _mean_scores(pairs) for name, pairs in scores.items()}
    error, unmoved_error = (means[name]["whole"]["mse"] for name in ("train", "no_contact_as_train"))
    if error > unmoved_error:
        warnings.append(
            f"the fitted sensor explains the presses worse than the no-contact picture does (MSE {error:.1f}, not "
            f"{unmoved_error:.1f}): do not use it; check ball_radius_mm, mm_per_px and that all pictures are of one sensor"
        )
    return {
        "parameters": table,
        "conventions": CONVENTIONS,
        "presses": rows,
        "scores": means | {"no_contact": _mean_scores([(rest_errors, rest_errors)])},
        "fit": {
            "rms_levels": fitted.rms,
            "noise_levels": fitted.sigma,
            "lights": light_names(fitted.parameters),
            "width_px": job.rest.shape[1],
        },
        "shading": validation,
        "choices": {
            "start": job.base.sensor.preset,
            "gel": "given" if photos.gel else "thickness and dome fitted, size and hardness of the start",
            "test_presses": "place and depth found from their own photograph with the sensor held" if photos.test.any() else None,
            "score_spp": SCORE_SPP,
        },
        "versions": {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "mitsuba")},
        "warnings": warnings,
    }


def _mean_scores(pairs: list[tuple[dict[str, float], dict[str, float]]]) -> dict[str, Any]:
    mean = [{name: float(np.mean([pair[k][name] for pair in pairs])) for name in pairs[0][k]} for k in range(2)]
    return {"count": len(pairs), "whole": mean[0], "crop": mean[1]}


def _write(
    folder: outputs.ResultFolder, out: Path, scene: Scene, report: dict[str, Any], job: _Job, sensor: str | None, rows: NDArray[np.int64],
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
    folder.write("report.json", lambda path: outputs.write_report(path, report))
    name = out.stem if sensor is None or _is_preset(sensor) else sensor
    folder.write(out.name, lambda path: write_preset(path, scene, report, name))
