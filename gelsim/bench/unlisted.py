"""Section `unlisted`: axisymmetric scenes that no reference table holds, quarters at `balanced` against profiles at `reference`.

Other radii, moduli, depths and thicknesses than those that sizes were chosen on: force and contact radius at every state but first touch,
and the surface along the radius, in which a mesh that is too coarse somewhere shows. Profiles are what such scenes get unasked; they have
other elements, and no mesh drawn by lot. They are off by what section `accuracy` says, and their gel is a disc of the square's area (up to
0.3 % of the force here, docs/mechanics.md §4): agreement is no proof, disagreement is one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from gelsim.bench.presses import SMOOTH
from gelsim.bench.section import Case, Layer, Options, Row, Section
from gelsim.bench.structured import Array
from gelsim.errors import GelsimError, SolveStatus
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.layers import build_scene

FORCE_PERCENT, RADIUS_PERCENT, PROFILE_UM = 2.0, 3.0, 5.0
RADII_MM = np.linspace(0.0, 8.0, 81)

SCENES: dict[str, tuple[Layer, Layer, float]] = {
    # name: gel, object, depth [mm]
    "rigid ball R 3, gel 100 kPa 2 mm": ({"youngs_modulus_kpa": 100.0, "thickness_mm": 2.0}, {"radius_mm": 3.0, "rigid": True}, 0.8),
    "rigid ball R 12, gel 50 kPa 2.4 mm": ({"youngs_modulus_kpa": 50.0}, {"radius_mm": 12.0, "rigid": True}, 0.5),
    "hemisphere R 8, 100 kPa, gel 50 kPa 3.5 mm": (
        {"youngs_modulus_kpa": 50.0, "thickness_mm": 3.5}, {"radius_mm": 8.0, "youngs_modulus_kpa": 100.0}, 1.2,
    ),
    "hemisphere R 3, 1 MPa, gel 50 kPa 2.4 mm": ({"youngs_modulus_kpa": 50.0}, {"radius_mm": 3.0, "youngs_modulus_kpa": 1000.0}, 0.8),
    "hemisphere R 5, 20 kPa, gel 80 kPa 2.4 mm": ({"youngs_modulus_kpa": 80.0}, {"radius_mm": 5.0, "youngs_modulus_kpa": 20.0}, 1.5),
}  # fmt: skip


def _cases(options: Options) -> Iterator[Case]:
    names = list(SCENES)[:1] if options.quick else list(SCENES)
    for name in names:
        yield Case(name, partial(_measure, name), scene(name, "balanced"))


def scene(name: str, fidelity: str, symmetry: str = "mirror") -> Layer:
    gel, body, depth = SCENES[name]
    return {
        "gel": {"profile": "flat"} | gel,
        "object": {"shape": "hemisphere", "height_mm": 15.0 if body.get("rigid") else 25.0} | body,
        "contact": SMOOTH,
        "press": {"depth_mm": depth, "force_n": "none", "frames": 6, "symmetry": symmetry},
        "fidelity": fidelity,
    }


def profile(press: Deformation, state: int) -> Array:
    """Mean height change [µm] of the surface over RADII_MM, from rings of nodes smoothed by a cubic through their radius."""
    place = np.hypot(press.gel.rest[:, 0], press.gel.rest[:, 1]) * 1e3
    order = np.argsort(place)
    where, first = np.unique(np.round(place[order], 3), return_index=True)
    return np.interp(RADII_MM, where, press.gel.displacement[state, order[first], 2] * 1e6)


def _measure(name: str) -> Row:
    presses = []
    for fidelity, symmetry in (("balanced", "mirror"), ("reference", "axisymmetric")):
        try:
            press = stages.press(build_scene(scene(name, fidelity, symmetry)), device="cpu", throw=False)
        except GelsimError as error:
            return {"status": type(error).__name__, "message": str(error)}
        if press.status is not SolveStatus.CONVERGED:
            return {"status": press.status.name, "message": press.message}
        presses.append(press)
    ours, fine = presses
    force = 100 * (ours.force[1:, 2] / fine.force[1:, 2] - 1)
    radius = 100 * (np.sqrt(ours.contact_area[1:] / fine.contact_area[1:]) - 1)
    apart = [float(np.sqrt(np.mean((profile(ours, i) - profile(fine, i)) ** 2))) for i in range(1, len(ours.approach))]
    well = np.abs(force).max() <= FORCE_PERCENT and np.abs(radius).max() <= RADIUS_PERCENT and max(apart) <= PROFILE_UM
    return {
        "status": SolveStatus.CONVERGED.name,
        "force_n": round(-float(fine.force[-1, 2]), 4),
        "radius_mm": round(math.sqrt(float(fine.contact_area[-1]) / math.pi) * 1e3, 3),
        "force_percent": [round(float(v), 2) for v in force],
        "radius_percent": [round(float(v), 1) for v in radius],
        "profile_um": [round(v, 2) for v in apart],
        "estimate_percent": round(100 * _estimate(ours), 2),
        "verdict": "within" if well else "NOT WITHIN",
    }


def _estimate(press: Deformation) -> float:
    estimate = press.report.error_estimate
    assert estimate is not None
    return estimate.force


SECTION = Section(
    title="Unlisted scenes",
    columns=(
        ("scene", "name"), ("force at full depth [N]", "force_n"), ("contact radius [mm]", "radius_mm"),
        ("force off at each of five states [%]", "force_percent"), ("radius off [%]", "radius_percent"),
        ("profile off, RMS [µm]", "profile_um"), ("own estimate, force [%]", "estimate_percent"), ("verdict", "verdict"),
    ),
    cases=_cases,
    remarks=lambda rows: f"Allowed at every state: force {FORCE_PERCENT:g} %, radius {RADIUS_PERCENT:g} %, profile {PROFILE_UM:g} µm.",
)  # fmt: skip
