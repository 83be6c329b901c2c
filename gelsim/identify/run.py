"""`gelsim identify`: reads a recording, finds where and how stiff the object is, and writes what it found beside what was seen.

The search begins with presses at `fast` of moduli spread over the scale, each picture at the approach that suits it best; the best of them
is where least squares begin (`fit`), once at `fast`, then at the scene's fidelity until modulus and place stay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.calibrate import pictures
from gelsim.calibrate.start import find_contacts
from gelsim.errors import SceneError
from gelsim.identify.fit import LEAST_MM, Fit, Problem
from gelsim.identify.pressed import RECORDED, Camera, press_at
from gelsim.identify.recording import Recording, read_recording
from gelsim.pipeline import outputs
from gelsim.scene.definition import Scene
from gelsim.scene.materials import modulus_from_shore_00, shore_00_from_modulus
from gelsim.shape.shapes import furthest_approach
from gelsim.units import MM

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

BEGUN = (15.0, 35.0, 55.0, 75.0)
"""Shore 00 of the presses of the search."""
BOUNDS = (2.0, 97.0)
FIRST_DEPTH_MM, DEEPER = 1.0, 1.6
ROUNDS = 4
STILL = 0.05, 0.03
"""Changes of log E and of the place [mm] that end the rounds."""
SIDES = 0.03
"""Share by which width over height of the pictures may be off from the sensor's field: what rounding to whole pixels makes."""
PLACES_MM = 0.1
"""Places of presses are rounded to: what is left is shifted in the picture; a press in the middle keeps its symmetry."""
UNEXPLAINED = 0.3
"""Share of the squared change that is left, from which on it is warned."""
NAMES = ("report.json", "identify.png")
CERTAIN = 1.645
"""Standard deviations on either side that hold 90 %."""


def identify(
    source: Path,
    scene: Scene,
    *,
    crop: tuple[int, int, int, int] | None = None,
    forces: Path | None = None,
    force_sd: float = 0.02,
    device: str = "auto",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """The modulus of the scene's object by a recording of a press, and how sure that is.

    Args:
        source: A video, a folder of pictures or an episode: `recording.read_recording`.
        scene: The sensor, the object's shape, friction and tilt; the object's hardness and all else of its press count for nothing.
        forces, force_sd: CSV of measured normal forces, and their standard deviation [N].
    Returns:
        What report.json holds: shore_00, youngs_modulus_kpa, their spread and 90 % interval, place_mm, pictures (with approach and force of
        each), unexplained (share of the squared change), warnings. Under "seen" and "drawn" the changes in the pictures [levels], each
        (K, H, W, 3).
    Raises:
        SceneError: Bad input, before anything is solved. SolveError: the object's press finds no equilibrium.
    """
    show = progress or (lambda stage, done, total: None)
    if scene.object.rigid:
        raise SceneError("object.rigid = true: a rigid object has no modulus to be found")
    if not force_sd > 0:
        raise SceneError(f"--force-sd {force_sd:g} N: it must be above 0")
    scene = scene.replace(target_error=None, target_membrane_um=None)
    recording = read_recording(source, crop, forces)
    _check_sides(recording, scene)
    camera = Camera(scene, recording.size, device, show)
    problem = Problem(camera, recording, force_sd)
    place = _place(camera, recording)
    log_modulus, place, approach = _search(problem, scene, place, device, show)
    coarse = scene.replace(fidelity="fast")
    if scene.fidelity != "fast":
        fit = _settle(problem, coarse, log_modulus, place, approach, device, show, rounds=1)
        log_modulus, place, approach = fit.log_modulus, fit.place_mm, fit.approach_mm
    fit = _settle(problem, scene, log_modulus, place, approach, device, show)
    return _report(fit, recording, scene)


def check_free(out: Path, *, force: bool) -> None:
    """Raises SceneError where `write` would write over something, without `force`."""
    outputs.check_free(out, (out / name for name in NAMES), force=force)


def write(report: dict[str, Any], out: Path) -> None:
    """Writes report.json and identify.png into `out`: what the press changed in the video, in the pictures drawn, and what is left."""
    target = outputs.ResultFolder(out, resume=True)
    nothing = np.zeros_like(report["seen"])
    columns = (
        (f"seen: change, x {pictures.GAIN:g}", pictures.residuals(report["seen"], nothing)),
        ("drawn", pictures.residuals(report["drawn"], nothing)),
        ("seen - drawn", pictures.residuals(report["seen"], report["drawn"])),
    )
    captions = [f"picture {row['picture']}: approach {row['approach_mm']:.3f} mm, {row['force_n']:.3g} N" for row in report["pictures"]]
    target.write("identify.png", lambda path: pictures.draw_comparison(path, columns, captions))
    target.write("report.json", lambda path: outputs.write_report(path, told(report)))


def told(report: dict[str, Any]) -> dict[str, Any]:
    """A report without its pictures."""
    return {name: value for name, value in report.items() if name not in ("seen", "drawn")}


def summary(report: dict[str, Any]) -> str:
    """A report in a few lines for people."""
    modulus, sd = report["youngs_modulus_kpa"], report["log_modulus_sd"]
    low, high = report["shore_00_90"]
    shore = "no Shore 00" if report["shore_00"] is None else f"Shore 00 {report['shore_00']:.1f}"
    between = "" if None in (low, high) else f" (90 %: {low:.1f} to {high:.1f})"
    last = report["pictures"][-1]
    return "\n".join([
        f"{shore}{between}, E {modulus:.3g} kPa ({100 * sd:.0f} %)",
        f"deepest picture, number {last['picture']}: approach {last['approach_mm']:.2f} mm, force {last['force_n']:.3g} N",
        f"of the squared change {100 * report['unexplained']:.1f} % is not explained",
        *(f"warning: {each}" for each in report["warnings"]),
    ])  # fmt: skip


def _check_sides(recording: Recording, scene: Scene) -> None:
    """Raises SceneError where the pictures are not of the sensor's field, by their sides."""
    (wide, high), (across, down) = recording.size, scene.camera.field_mm
    if not abs(wide / high / (across / down) - 1) < SIDES:
        raise SceneError(
            f"the pictures are {wide} : {high}, but the sensor sees {across:g} x {down:g} mm (camera.field_mm): give --crop so that they "
            "show what the sensor sees"
        )


def _place(camera: Camera, recording: Recording) -> Array:
    """Of the contact on the gel [mm], by the picture that changed most."""
    contacts, sure = find_contacts(recording.rest, recording.pictures[-1:], np.ones(recording.rest.shape[:2], bool))
    if not sure[0]:
        raise SceneError("no contact can be seen in the pictures: what changes lies nowhere together")
    return camera.places_mm(contacts[:, :2])[0]


def _search(problem: Problem, scene: Scene, place: Array, device: str, show: Progress) -> tuple[float, Array, Array]:
    """Log E [kPa], place and approaches [mm] to begin with."""
    coarse = scene.replace(fidelity="fast")
    found: list[tuple[float, float, Array]] = []
    presses = (BEGUN[len(BEGUN) // 2], *BEGUN)
    for number, shore in enumerate(presses):
        show("search", number, len(presses))
        log_modulus, depth = float(np.log(modulus_from_shore_00(shore) / 1e3)), FIRST_DEPTH_MM
        most = furthest_approach(coarse.replace(press=replace(coarse.press, depth_mm=None))) / MM
        while True:
            pressed = press_at(coarse, log_modulus, _rounded(place), min(depth, most), device, alone=True)
            approaches = np.linspace(0.0, pressed.deepest_mm, RECORDED)[1:]
            drawn = problem.camera.change(pressed.surface, pressed.states(approaches)[0])
            costs = np.array([((each - drawn) ** 2).sum(axis=(1, 2, 3)) for each in problem.recording.change])
            best = costs.argmin(axis=1)
            if best.max() < RECORDED - 3 or depth >= most:
                break
            depth *= DEEPER
        if number == 0:  # says where the object is: until here that is known by an outline that the lamps shift
            place = place + problem.aside(drawn[best])
        else:
            found.append((float(costs.min(axis=1).sum()), log_modulus, approaches[best]))
    show("search", len(presses), len(presses))
    _, log_modulus, approach = min(found, key=lambda one: one[0])
    return log_modulus, place, approach


def _settle(
    problem: Problem, scene: Scene, log_modulus: float, place: Array, approach: Array, device: str, show: Progress, *, rounds: int = ROUNDS
) -> Fit:
    """Rounds of presses and least squares."""
    low, high = (float(np.log(modulus_from_shore_00(shore) / 1e3)) for shore in BOUNDS)
    for number in range(rounds):
        show(f"fit at {scene.fidelity}", number, rounds)
        log_modulus = float(np.clip(log_modulus, low, high))
        pressed = press_at(scene, log_modulus, _rounded(place), 1.2 * float(approach.max()) + 0.1, device)
        fit = problem.solve(problem.start(pressed, np.clip(approach, LEAST_MM, pressed.deepest_mm)))
        at_end = fit.approach_mm.max() > 0.98 * pressed.deepest_mm
        log_modulus, place, approach = fit.log_modulus, fit.place_mm, fit.approach_mm
        if abs(fit.change) < STILL[0] and np.abs(fit.shift_mm).max() < STILL[1] and not at_end:
            break
    show(f"fit at {scene.fidelity}", rounds, rounds)
    return fit


def _rounded(place: Array) -> tuple[float, float]:
    x, y = np.round(place / PLACES_MM) * PLACES_MM + 0.0
    return float(x), float(y)


def _report(fit: Fit, recording: Recording, scene: Scene) -> dict[str, Any]:
    modulus, sd = float(np.exp(fit.log_modulus)), float(np.sqrt(fit.covariance[0, 0]))
    left = recording.change - fit.drawn
    share = float((left**2).sum() / (recording.change**2).sum())

    def shore(change: float) -> float | None:
        try:
            return float(shore_00_from_modulus(modulus * 1e3 * np.exp(change)))
        except SceneError:
            return None

    readings = [shore(-sd), shore(sd)]
    warnings = list(fit.pressed.warnings)
    if share > UNEXPLAINED:
        warnings.append(
            f"{100 * share:.0f} % of the squared change in the pictures is not explained: is the object of this shape, is the sensor this "
            "one, and is the first picture without contact?"
        )
    if not BOUNDS[0] < (shore(0.0) or BOUNDS[1]) < BOUNDS[1]:
        warnings.append(f"the modulus is at an end of what is sought, Shore 00 {BOUNDS[0]:g} to {BOUNDS[1]:g}")
    return {
        "shore_00": shore(0.0), "shore_00_sd": None if None in readings else (readings[1] - readings[0]) / 2,  # type: ignore[operator]
        "shore_00_90": [shore(-CERTAIN * sd), shore(CERTAIN * sd)],
        "youngs_modulus_kpa": modulus, "log_modulus_sd": sd, "place_mm": [float(each) for each in fit.place_mm], "unexplained": share,
        "pictures": [
            {"picture": int(number), "approach_mm": float(d), "approach_sd_mm": float(np.sqrt(var)), "force_n": float(force)}
            for number, d, var, force in zip(recording.numbers, fit.approach_mm, np.diag(fit.covariance)[3:], fit.force, strict=True)
        ],
        "warnings": warnings, "seen": recording.change, "drawn": fit.drawn,
    }  # fmt: skip
