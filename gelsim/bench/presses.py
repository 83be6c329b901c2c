"""Cases that are scenes: solved as the commands solve them, with what every press says of itself."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from gelsim.bench.section import Case, Layer, Row
from gelsim.errors import GelsimError, SolveStatus
from gelsim.fem.problem import Numerics, PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.fem.strategy import contact_points
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene import materials
from gelsim.scene.layers import build_scene

# The gel of the reference solutions: flat, 50 kPa; no friction, 1 mm of approach in ten steps, as solids ("auto" would take a profile).
REFERENCE_GEL: Layer = {"profile": "flat", "youngs_modulus_kpa": 50.0}
REFERENCE_PRESS: Layer = {"depth_mm": 1.0, "force_n": "none", "frames": 11, "symmetry": "mirror"}
SMOOTH: Layer = {"friction_coefficient": 0.0}


def hemisphere(modulus: float, nu: float, **press: Any) -> Layer:
    """A soft hemisphere of R = 5 mm on the reference gel."""
    return {
        "gel": REFERENCE_GEL | {"poissons_ratio": nu},
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": modulus, "poissons_ratio": nu},
        "contact": SMOOTH,
        "press": REFERENCE_PRESS | press,
    }


def ball(nu: float) -> Layer:
    """A rigid ball of R = 5 mm on it."""
    body = {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 10.0, "rigid": True}
    return {"gel": REFERENCE_GEL | {"poissons_ratio": nu}, "object": body, "contact": SMOOTH, "press": REFERENCE_PRESS}


def press_case(name: str, scene: Layer, further: Callable[[Deformation], Row] | None = None) -> Case:
    """A scene as a case; `further` adds to the row what is compared with something else."""
    return Case(name, lambda: measure(scene, further), scene)


def measure(scene: Layer, further: Callable[[Deformation], Row] | None = None) -> Row:
    """Solves a scene; a row of plain numbers, also where it fails."""
    row: Row = {"fidelity": scene.get("fidelity", "balanced")}
    record = stages.Record()
    start = time.perf_counter()
    try:
        made = build_scene(scene)
        press = stages.press(made, device="cpu", record=record, throw=False)
    except GelsimError as error:
        return row | {"status": type(error).__name__, "message": str(error), "seconds": round(time.perf_counter() - start, 2)}
    given = press.report.coat_n_per_m is not None and made.gel.coat_n_per_m == 0.0
    row |= {"seconds": round(record.seconds["press"], 2), "coated": given}
    return row | facts(press, made.press.frames) | (further(press) if further else {})


def facts(press: Deformation, states_wanted: int) -> Row:
    """What every press says of itself."""
    return {
        "status": press.status.name,
        "message": press.message if press.status is not SolveStatus.CONVERGED else "",
        "ended_by": press.report.ended_by,
        "tried": press.report.tried,
        "states": len(press.approach),
        "states_wanted": states_wanted,
        "unknowns": press.report.unknowns,
        "steps_halved": press.report.steps_halved,
        "stress_jump": press.report.stress_jump,
        "newton_iterations": int(press.newton_iterations.sum()),
        "factorisations": press.report.factorisations,
        "min_jacobian": round(float(press.min_jacobian.min()), 3),
        "penetration_um": round(float(press.penetration.max()) * 1e6, 2),
        "drift_percent": round(100 * _drift(press), 2),
        "approach_mm": round(float(press.approach[-1]) * 1e3, 4),
        "contact_mm2": round(float(press.contact_area[-1]) * 1e6, 1),
        "force_n": [round(float(f), 6) for f in press.force[-1]],
    }


def _drift(press: Deformation) -> float:
    assert press.report.energy is not None
    return press.report.energy.drift


def solved_problem(scene: Layer) -> tuple[PressProblem, Deformation]:
    """A solved scene, and the problem in its last state: for what a `Deformation` does not tell. The meshes are those of the commands.

    Raises:
        GelsimError: The scene is none, or cannot be meshed.
    """
    made = build_scene(scene)
    gel, body, placement = stages.bodies(made)
    numerics = Numerics(contact_points=contact_points(made))
    problem = PressProblem(made, gel, body, placement, materials.press_materials(made), "cpu", numerics)
    return problem, run_press(problem, throw=False)
