"""Section `motion`: presses that slide, come back and let go, beside what theory says of them.

- Cattaneo (1938) and Mindlin (1949), here after Johnson 1985, Contact Mechanics, §7.2: a ball pressed by N on a half-space and dragged
  by δ slips from its rim inward, Q = μ N (1 - (1 - δ/δ₁)^(3/2)) with δ₁ = 3 μ N (2 - ν)/(16 G a), a of Hertz for that N. At ν = ½
  nothing couples normal and tangential displacements, which that theory leaves out.
- What the object does in work on a way that ends where it began is what friction has taken.
- What is mirrored has mirrored forces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from gelsim.bench import closed_forms
from gelsim.bench.section import Case, Known, Options
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.layers import build_scene
from gelsim.units import MM

SLID_R, SLID_DEPTH, SLID_MU, SLID_NU, SLID_KPA = 2.0, 0.04, 0.3, 0.499, 100.0
"""The ball of Cattaneo and Mindlin [mm, mm, 1, 1, kPa]: the gel is 70 radii of contact thick."""
DRAGGED_MM, DRAGGED_FRAMES, SOFT_FRAMES = 0.6, 49, 13
FULL_SLIP = 1.3
"""Of δ₁: from there on all of it slides."""


@cache
def slid(thickness_mm: float = 20.0) -> Deformation:
    """The ball pressed, then dragged until it slides, on a block."""
    first_slide = 3 * SLID_MU * (2 - SLID_NU) / (16 * (1 - SLID_NU)) * (8 / 3) * SLID_DEPTH  # δ₁ of Hertz's force and radius
    return _solved({
        "gel": {"profile": "flat", "thickness_mm": thickness_mm, "size_mm": [2.5 * thickness_mm] * 2, "youngs_modulus_kpa": SLID_KPA,
                "poissons_ratio": SLID_NU},
        "object": {"shape": "hemisphere", "radius_mm": SLID_R, "height_mm": 8.0, "rigid": True},
        "contact": {"friction_coefficient": SLID_MU},
        "camera": {"distance_mm": 200.0},
        "press": {"path": [{"depth_mm": SLID_DEPTH}, {"shear_mm": [1.5 * first_slide, 0.0]}], "frames": 25},
    })  # fmt: skip


def partial_slip(press: Deformation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the states of `slid` after the press: displacement over δ₁, tangential force over μ N, and that of theory."""
    shear, modulus = SLID_KPA * 1e3 / 2 / (1 + SLID_NU), SLID_KPA * 1e3 / (1 - SLID_NU**2)
    dragged = press.time > 1.0 + 1e-9
    normal, tangential = -press.force[dragged, 2], np.abs(press.force[dragged, 0])
    radius = np.cbrt(3 * normal * SLID_R * MM / 4 / modulus)
    share = press.object.displacement[dragged, 0, 0] / (3 * SLID_MU * normal * (2 - SLID_NU) / (16 * shear * radius))
    return share, tangential / (SLID_MU * normal), 1.0 - np.maximum(1.0 - share, 0.0) ** 1.5


def _partial_slip() -> tuple[float, float, float]:
    share, found, theory = partial_slip(slid())
    ratio = (found / theory)[share < 1.0]
    return float(ratio[np.abs(ratio - 1).argmax()]), 1.0, 1.0


def _half_as_thick() -> tuple[float, float, float]:
    (share, found, _), (thin_share, thin_found, _) = partial_slip(slid()), partial_slip(slid(10.0))
    apart = np.interp(share, thin_share, thin_found) - found
    return float(np.abs(apart[share < 1.0]).max()), 0.0, 1.0


def _full_slide() -> tuple[float, float, float]:
    share, found, _ = partial_slip(slid())
    full = found[share > FULL_SLIP]
    return float(full[np.abs(full - 1).argmax()]), 1.0, 1.0


def _ball(soft: bool, friction: float, press: dict[str, Any], fidelity: str = "fast") -> Deformation:
    stiffness = {"youngs_modulus_kpa": 200.0} if soft else {"rigid": True}
    return _solved({
        "gel": {"profile": "flat", "size_mm": [16.0, 16.0], "youngs_modulus_kpa": 50.0},
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 10.0} | stiffness,
        "contact": {"friction_coefficient": friction},
        "press": press,
        "fidelity": fidelity,
    })  # fmt: skip


def _released(soft: bool) -> tuple[float, float, float]:
    press = _ball(soft, 0.0, {"path": [{"depth_mm": 0.5}, {"depth_mm": 0.0}], "frames": 7, "symmetry": "mirror"})
    left = max(np.abs(press.gel.displacement[-1]).max(), np.abs(press.object.displacement[-1]).max() if soft else 0.0)
    return float(left / 1e-6), 0.0, 1.0


@cache
def dragged(soft: bool = False, frames: int = DRAGGED_FRAMES) -> Deformation:
    """A ball pressed, dragged to one side, to the other and back, and lifted off."""
    way = [{"depth_mm": 0.4}, *({"shear_mm": [x, 0.0]} for x in (DRAGGED_MM, -DRAGGED_MM, DRAGGED_MM, 0.0)), {"depth_mm": -0.05}]
    seconds = [0.4, *(abs(step) for step in (DRAGGED_MM, 2 * DRAGGED_MM, 2 * DRAGGED_MM, DRAGGED_MM)), 0.4]
    path = [point | {"duration_s": duration} for point, duration in zip(way, seconds, strict=True)]
    return _ball(soft, 0.3, {"path": path, "frames": 2 * frames})


def loop_area(press: Deformation, first: int = 0, last: int | None = None) -> float:
    """Work [J] of a rigid object that does not turn, from its recorded forces and places; from one state to another."""
    states = slice(first, None if last is None else last + 1)
    way, force = press.object.displacement[states, 0], press.force[states]
    return float((0.5 * (force[1:] + force[:-1]) * np.diff(way, axis=0)).sum())


def _hysteresis() -> tuple[float, float, float]:
    press = dragged()
    assert press.report.energy is not None
    lost = press.report.energy.dissipated_j * 1e6
    return loop_area(press) * 1e6, lost, lost


def _reversed(soft: bool) -> tuple[float, float, float]:
    """Tangential force at the two ends of the full loop."""
    press = dragged(soft, SOFT_FRAMES if soft else DRAGGED_FRAMES)
    ends = [press.force[np.abs(press.time - moment).argmin(), 0] for moment in (0.4 + 3 * DRAGGED_MM, 0.4 + 5 * DRAGGED_MM)]
    return float(-ends[0]), float(ends[1]), float(ends[1])


def _rolled(soft: bool) -> tuple[float, float, float]:
    """Tangential force of a ball rolled to the left over that of one rolled to the right."""
    forces = []
    for angle in (10.0, -10.0):
        way = [{"depth_mm": 0.4}, {"tilt_deg": [0.0, angle]}]
        forces.append(_ball(soft, 0.5, {"path": way, "frames": 7}).force[-1])
    return float(-forces[1][0]), float(forces[0][0]), float(forces[0][0])


def _solved(layer: dict[str, Any]) -> Deformation:
    return stages.press(build_scene(layer), device="cpu")


def known() -> Iterator[Known]:
    slip = "Cattaneo 1938, Mindlin 1949"
    yield Known("pressed and released, no friction, rigid ball: what is left", partial(_released, False), 1.0, "at rest", "µm")
    yield Known("pressed and released, no friction, soft hemisphere: what is left", partial(_released, True), 1.0, "at rest", "µm")
    yield Known("ball in partial slip: tangential force over that of theory, worst state", _partial_slip, 0.05, slip)
    yield Known("… on half the thickness: largest change of Q/μN", _half_as_thick, 0.01, "thick enough")
    yield Known("ball in full slip: tangential force over μN, worst state", _full_slide, 0.01, "Coulomb")
    yield Known("dragged to and fro and lifted off: work done, and lost in friction", _hysteresis, 0.02, "energy", "µJ")
    yield Known("… tangential force after a full reversal, mirrored", partial(_reversed, False), 0.01, "mirror", "N")
    yield Known("… of a soft hemisphere", partial(_reversed, True), 0.01, "mirror", "N")
    yield Known("ball rolled by 10° and by -10°: tangential force, mirrored", partial(_rolled, False), 0.01, "mirror", "N")
    yield Known("… of a soft hemisphere, tilted by 10° and by -10°", partial(_rolled, True), 0.01, "mirror", "N")


def _cases(options: Options) -> Iterator[Case]:
    yield from (Case(item.name, partial(closed_forms.measured, item)) for item in known())


SECTION = replace(closed_forms.SECTION, title="Motion", cases=_cases)
