"""The register of what a study can measure: name, what it says with its unit, and how it is got from a trial. All are plain numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gelsim.units import KPA, MM

if TYPE_CHECKING:
    from gelsim.study.trial import Trial


@dataclass(frozen=True)
class Metric:
    """Something to be measured of a trial."""

    label: str
    """What it is, with its unit: the axis of a plot."""
    measure: Callable[[Trial], float]


METRICS: dict[str, Metric] = {}


def metric(name: str, label: str) -> Callable[[Callable[[Trial], float]], Callable[[Trial], float]]:
    """Decorates a function that measures a trial: studies know it by `name`, plots by `label`, what it is with its unit."""

    def keep(measure: Callable[[Trial], float]) -> Callable[[Trial], float]:
        METRICS[name] = Metric(label, measure)
        return measure

    return keep


# ---- mechanics: of the last recorded state ----


@metric("force_n", "normal force [N]")
def _force(trial: Trial) -> float:
    return float(trial.force[-1])


@metric("approach_mm", "approach [mm]")
def _approach(trial: Trial) -> float:
    return float(trial.press.approach[-1] / MM)


@metric("contact_area_mm2", "contact area [mm²]")
def _area(trial: Trial) -> float:
    return float(trial.press.contact_area[-1] / MM**2)


@metric("peak_pressure_kpa", "peak pressure [kPa]")
def _pressure(trial: Trial) -> float:
    return float(trial.press.contact_pressure[-1].max() / KPA)


@metric("dent_depth_mm", "depth of the dent [mm]")
def _dent_depth(trial: Trial) -> float:
    from gelsim.study.dent import measure_dent

    return trial.once(measure_dent).depth / MM


@metric("dent_width_mm", "width of the dent at half depth [mm]")
def _dent_width(trial: Trial) -> float:
    from gelsim.study.dent import measure_dent

    return trial.once(measure_dent).width / MM


@metric("dent_reach_mm", "reach of the dent beyond the contact [mm]")
def _dent_reach(trial: Trial) -> float:
    from gelsim.study.dent import measure_dent

    return trial.once(measure_dent).reach / MM


@metric("marker_motion_um", "largest sideways motion of the surface [µm]")
def _marker_motion(trial: Trial) -> float:
    from gelsim.study.dent import measure_dent

    return trial.once(measure_dent).sideways * 1e6


# ---- telling hardnesses apart (study.discrimination); signal "slope": the membrane's slopes, "picture": levels of the camera ----


def _dprime(signal: str, what: str) -> Callable[[Trial], float]:
    def measure(trial: Trial) -> float:
        from gelsim.study.discrimination import sensitivity

        return getattr(trial.once(sensitivity, signal), what)

    return measure


for _signal in ("slope", "picture"):
    for _what, _said in (
        ("equal_depth", "d' per Shore point at equal depth"),
        ("equal_force", "d' per Shore point at equal force"),
        ("unknown_press", "d' per Shore point, force and depth unknown"),
        ("unknown_radius", "d' per Shore point, radius unknown too (by 10 %)"),
        ("change", "change of a pixel per Shore point / noise"),
    ):
        METRICS[f"{_signal}_{_what}"] = Metric(f"{_signal}: {_said}", _dprime(_signal, _what))


# ---- photometric stereo (study.photometric) ----


@metric("normal_error_deg", "error of recovered normals, mean [°]")
def _normal_error(trial: Trial) -> float:
    from gelsim.study.photometric import reconstruct

    return trial.once(reconstruct).normal_error_deg


@metric("steep_normal_error_deg", "error of normals above 30°, mean [°]")
def _steep_normal_error(trial: Trial) -> float:
    from gelsim.study.photometric import reconstruct

    return trial.once(reconstruct).steep_normal_error_deg


@metric("height_error_um", "error of recovered height, RMS [µm]")
def _height_error(trial: Trial) -> float:
    from gelsim.study.photometric import reconstruct

    return trial.once(reconstruct).height_error_um


@metric("texture_signal_per_um", "pixel change per µm of texture / noise")
def _texture_signal(trial: Trial) -> float:
    from gelsim.study.texture import texture_signal

    return trial.once(texture_signal) * 1e-6


def _smallest_dent(focused: bool) -> Callable[[Trial], float]:
    def measure(trial: Trial) -> float:
        from gelsim.study.visible import DEEP, smallest_dent

        return smallest_dent(trial, 0.0 if focused else DEEP) * 1e6

    return measure


METRICS["smallest_dent_um"] = Metric("smallest visible dent [µm]", _smallest_dent(True))
METRICS["smallest_dent_deep_um"] = Metric("smallest visible dent out of focus [µm]", _smallest_dent(False))


# ---- markers (study.marker_force) ----


@metric("marker_normal_error_pct", "error of normal force from markers, RMS [%]")
def _marker_normal(trial: Trial) -> float:
    from gelsim.study.marker_force import marker_forces

    return 100 * trial.once(marker_forces).normal_error


@metric("marker_shear_error_pct", "error of shear force from markers, RMS [%]")
def _marker_shear(trial: Trial) -> float:
    from gelsim.study.marker_force import marker_forces

    return 100 * trial.once(marker_forces).shear_error


@metric("marker_hidden_pct", "surface that markers hide [%]")
def _marker_hidden(trial: Trial) -> float:
    from gelsim.study.marker_force import marker_cost

    return 100 * trial.once(marker_cost).hidden


@metric("marker_fill_error_um", "error of height filled in below markers, RMS [µm]")
def _marker_fill(trial: Trial) -> float:
    from gelsim.study.marker_force import marker_cost

    return trial.once(marker_cost).fill_error * 1e6
