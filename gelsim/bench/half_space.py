"""Presses whose answers are known: balls, cylinders and punches on gels so thick that they are half-spaces, published fits of thin ones,
and what holds for every press (balance of forces and energies, friction's two limits).

A bonded layer of thickness h is stiffer than the half-space: to first order every approach δ under a force F is less by c F/(E* h) with
c = 0.567 (the first term of Dimitriadis et al. 2002 for a ball, 1.133 a/h of the force, turned into a displacement; the far field of a
point force is the same whatever made it). Contact radius, pressure and the shape of the dent do not know the layer to that order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache, partial

import numpy as np

from gelsim.bench.presses import REFERENCE_GEL, SMOOTH, solved_problem
from gelsim.bench.section import Known, Layer
from gelsim.bench.structured import Array
from gelsim.errors import SolveError, SolveStatus
from gelsim.fem.problem import PressProblem
from gelsim.results import Deformation, EnergyReport

NU = 0.4999
GEL_KPA = 50.0
PLANE_GEL = GEL_KPA / (1 - NU**2)
THICK_MM = 20.0
LAYER = 0.567
"""c above."""


def known() -> Iterator[Known]:
    hertz = "Hertz 1882"
    yield Known("rigid ball R 20, 0.1 mm, on 20 mm: force", _ball_force, 0.02, "Hertz, layer to first order", "N", quick=False)
    yield Known("… contact radius of that force", partial(_ball_part, "radius"), 0.03, hertz, "mm", quick=False)
    yield Known("… greatest pressure of that force", partial(_ball_part, "pressure"), 0.03, hertz, "kPa", quick=False)
    two = "two soft bodies R 20, 100 kPa on 50 kPa"
    yield Known(f"{two}: contact radius of the force", partial(_two_part, "radius"), 0.03, hertz, "mm", quick=False)
    yield Known(f"{two}: greatest pressure", partial(_two_part, "pressure"), 0.03, hertz, "kPa", quick=False)
    yield Known(f"{two}: share of the gel in the dent", _two_split, 0.03, "1/E* of each, Hertz", quick=False)
    yield Known("rigid cylinder R 10 on 20 mm: greatest pressure · 2R/(E* b)", _line, 0.03, "line contact, Hertz", quick=False)
    sneddon = "Sneddon 1965, layer to first order"
    yield Known("rigid punch R 3, 0.06 mm, on 20 mm: force", _thick_punch, 0.02, sneddon, "N", quick=False)
    for nu, force in ((0.49, 1.217), (0.499, 1.331)):
        text = f"sticking punch R 3, 0.5 mm, on 2.4 mm, ν {nu}: force"
        yield Known(text, partial(_punch, nu, force), 0.02, "another code, ± 0.3 %", "N", quick=False)
    for radius, depth in ((2.5, 0.6), (5.0, 0.1), (5.0, 0.6), (10.0, 0.3), (10.0, 0.6)):
        text = f"rigid ball R {radius:g}, {depth:g} mm, on 2.4 mm: force"
        yield Known(text, partial(_long, radius, depth), 0.05, "Long et al. 2011, a fit of some per cent", "N", quick=depth == 0.6)
    yield Known("no friction, 0.3 mm sheared: traction", _no_friction, 1e-12, "exact")
    yield Known("no friction, 0.3 mm sheared: shear force over normal force", _no_shear, 0.01, "exact on a flat gel")
    yield Known("friction 10 against stick: shear force", _stick, 0.02, "the limit of friction", "N")
    for name in ("soft, smooth", "sheared at friction 0.3"):
        yield Known(f"window and contact, {name}: force out of balance", partial(_balance, name), 2e-3, "exact")
        yield Known(f"work, {name}: not stored, dissipated or in the overlap", partial(_energy, name), 0.01, "exact", "J")
        yield Known(f"work, {name}: held by the overlap, an error of the method", partial(_overlap, name), 0.01, "zero", "J")


def solve(scene: Layer) -> tuple[PressProblem, Deformation]:
    problem, press = solved_problem(scene)
    if press.status is not SolveStatus.CONVERGED:
        raise SolveError(f"stopped {press.message}: {press.status.value}", press)
    return problem, press


def _thick(body: Layer, press: Layer, size_mm: float = 100.0) -> Layer:
    gel = {"profile": "flat", "size_mm": [size_mm, size_mm], "thickness_mm": THICK_MM, "youngs_modulus_kpa": GEL_KPA, "poissons_ratio": NU}
    return {"gel": gel, "object": body, "contact": SMOOTH, "press": {"force_n": "none", "frames": 4} | press, "fidelity": "reference"}


# ---------------------------------------------------------------------------------------------------------------- Hertz
def _hertz_fit(place: Array, pressure: Array) -> tuple[float, float]:
    """Greatest pressure and radius of p = p₀ √(1 - r²/a²): a straight line of p² over r², where p is more than a third of the greatest."""
    inside = pressure > pressure.max() / 3
    slope, top = np.polyfit(place[inside] ** 2, pressure[inside] ** 2, 1)
    return float(np.sqrt(top)), float(np.sqrt(-top / slope))


@lru_cache
def _ball() -> Deformation:
    body = {"shape": "hemisphere", "radius_mm": 20.0, "height_mm": 10.0, "rigid": True}
    return solve(_thick(body, {"depth_mm": 0.1}) | {"fidelity": "balanced"})[1]


def _ball_force() -> tuple[float, float, float]:
    press = _ball()
    depth, radius = 0.1, 20.0
    force = 0.0
    for _ in range(20):  # the force that the approach less the layer's share gives
        force = 4 / 3 * PLANE_GEL * math.sqrt(radius) * (depth + LAYER * force / (PLANE_GEL * THICK_MM)) ** 1.5
    return -press.force[-1, 2], force * 1e-3, force * 1e-3


def _ball_part(which: str) -> tuple[float, float, float]:
    return _contact(_ball(), 20.0, PLANE_GEL, which)


def _contact(press: Deformation, radius_mm: float, plane_modulus: float, which: str) -> tuple[float, float, float]:
    """Contact radius [mm] from the area, or greatest pressure [kPa] from the pressures' fit, and Hertz's for the force that we have."""
    force = -press.force[-1, 2] * 1e3
    a = (3 * force * radius_mm / (4 * plane_modulus)) ** (1 / 3)
    if which == "radius":
        return math.sqrt(press.contact_area[-1] / math.pi) * 1e3, a, a
    place = np.hypot(press.gel.rest[:, 0], press.gel.rest[:, 1]) * 1e3
    top = 3 * force / (2 * math.pi * a**2)
    return _hertz_fit(place, press.contact_pressure[-1] * 1e-3)[0], top, top


@lru_cache
def _two() -> Deformation:
    body = {"shape": "hemisphere", "radius_mm": 20.0, "height_mm": 20.0, "youngs_modulus_kpa": 100.0, "poissons_ratio": NU}
    return solve(_thick(body, {"depth_mm": 0.1}) | {"fidelity": "balanced"})[1]


def _two_part(which: str) -> tuple[float, float, float]:
    together = 1 / (1 / PLANE_GEL + (1 - NU**2) / 100.0)
    return _contact(_two(), 20.0, together, which)


def _two_split() -> tuple[float, float, float]:
    """u_z(0) - u_z(r) within the contact is (π p₀/(4 a E*)) r² of each body: the gel's part of both is E*_object/(E*_gel + E*_object)."""
    press = _two()
    radius = math.sqrt(press.contact_area[-1] / math.pi) * 0.8

    def sag(surface) -> float:  # type: ignore[no-untyped-def]
        place, u = np.hypot(surface.rest[:, 0], surface.rest[:, 1]), surface.displacement[-1, :, 2]
        near = (place < radius) & (surface.rest[:, 2] < 1e-3)
        return abs(float(np.polyfit(place[near] ** 2, u[near], 1)[0]))

    gel, body = sag(press.gel), sag(press.object)
    return gel / (gel + body), 100.0 / (100.0 + GEL_KPA), 100.0 / (100.0 + GEL_KPA)


def _line() -> tuple[float, float, float]:
    """p₀ = E* b/(2R) in the middle of a cylinder 40 mm long, from the pressures within 5 mm of there."""
    body = {"shape": "cylinder", "radius_mm": 10.0, "height_mm": 12.0, "length_mm": 40.0, "rigid": True}
    _, press = solve(_thick(body, {"depth_mm": 0.06}, 40.0))
    middle = np.abs(press.gel.rest[:, 1]) < 5e-3
    top, half = _hertz_fit(press.gel.rest[middle, 0] * 1e3, press.contact_pressure[-1, middle] * 1e-3)
    return top * 20.0 / (PLANE_GEL * half), 1.0, 1.0


# ---------------------------------------------------------------------------------------------------------------- punches, thin gels
def _thick_punch() -> tuple[float, float, float]:
    body = {"shape": "punch", "radius_mm": 3.0, "height_mm": 5.0, "rigid": True}
    _, press = solve(_thick(body, {"depth_mm": 0.06}) | {"fidelity": "balanced"})
    force = 2 * 3.0 * PLANE_GEL * 0.06 / (1 - LAYER * 2 * 3.0 / THICK_MM) * 1e-3
    return -press.force[-1, 2], force, force


def _punch(nu: float, force: float) -> tuple[float, float, float]:
    scene: Layer = {
        "gel": REFERENCE_GEL | {"poissons_ratio": nu},
        "object": {"shape": "punch", "radius_mm": 3.0, "rigid": True},
        "contact": {"friction_coefficient": "stick"},
        "press": {"depth_mm": 0.5, "force_n": "none", "frames": 6},
        "fidelity": "balanced",
    }
    return -solve(scene)[1].force[-1, 2], force, force


def long_2011(depth_mm: float, radius_mm: float, thickness_mm: float = 2.4, modulus_kpa: float = GEL_KPA) -> float:
    """Force [N] on a rigid ball on a bonded incompressible neo-Hookean layer (Long et al. 2011, Biophys. J. 101:643).

    A fit good to a few per cent for 0.3 ≤ R/h ≤ 12.7 and d ≤ min(0.6 h, R).
    """
    r, h, d = radius_mm, thickness_mm, depth_mm
    assert 0.3 <= r / h <= 12.7 and d <= min(0.6 * h, r)
    hertz = 16 / 9 * modulus_kpa * math.sqrt(r) * d**1.5 * 1e-3
    w = (r * d / h**2) ** 1.5
    alpha = 10.05 - 0.63 * math.sqrt(h / r) * (3.1 + (h / r) ** 2)
    beta = 4.8 - 4.23 * (h / r) ** 2
    return hertz * (1 + 1.15 * w ** (1 / 3) + alpha * w + beta * w**2) / (1 + 2.3 * w)


@lru_cache
def _thin(radius_mm: float) -> Deformation:
    scene: Layer = {
        "gel": REFERENCE_GEL | {"poissons_ratio": NU},
        "object": {"shape": "hemisphere", "radius_mm": radius_mm, "height_mm": 10.0, "rigid": True},
        "contact": SMOOTH,
        "press": {"depth_mm": 0.6, "force_n": "none", "frames": 7},
        "fidelity": "balanced",
    }
    return solve(scene)[1]


def _long(radius_mm: float, depth_mm: float) -> tuple[float, float, float]:
    press = _thin(radius_mm)
    state = int(np.argmin(np.abs(press.approach * 1e3 - depth_mm)))
    force = long_2011(depth_mm, radius_mm)
    return -press.force[state, 2], force, force


# ---------------------------------------------------------------------------------------------------------------- what always holds
@lru_cache
def _sheared(friction: float | str) -> tuple[PressProblem, Deformation]:
    """A rigid ball, 0.6 mm deep and 0.3 mm to the side."""
    scene: Layer = {
        "gel": REFERENCE_GEL,
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "height_mm": 10.0, "rigid": True},
        "contact": {"friction_coefficient": friction},
        "press": {"depth_mm": 0.6, "force_n": "none", "frames": 9, "shear_mm": [0.3, 0.0]},
        "fidelity": "fast",
    }
    return solve(scene)


@lru_cache
def _smooth() -> tuple[PressProblem, Deformation]:
    body = {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": 200.0}
    press = {"depth_mm": 1.0, "force_n": "none", "frames": 11}
    return solve({"gel": REFERENCE_GEL, "object": body, "contact": SMOOTH, "press": press, "fidelity": "fast"})


def _pressed(name: str) -> tuple[PressProblem, Deformation]:
    return _smooth() if name == "soft, smooth" else _sheared(0.3)


def _no_friction() -> tuple[float, float, float]:
    problem, _ = _sheared(0.0)
    return float(np.abs(problem.contact.traction.numpy()).max()), 0.0, float(problem.contact.pressure.numpy().max())


def _no_shear() -> tuple[float, float, float]:
    force = _sheared(0.0)[1].force[-1]
    return abs(float(force[0] / force[2])), 0.0, 1.0


def _stick() -> tuple[float, float, float]:
    high, stick = (float(_sheared(friction)[1].force[-1, 0]) for friction in (10.0, "stick"))
    return high, stick, stick


def _balance(name: str) -> tuple[float, float, float]:
    problem, _ = _pressed(name)
    force = problem.contact_force()
    off = float(np.linalg.norm(problem.support_force() + force))
    return off / float(np.linalg.norm(force)), 0.0, 1.0


def _energies(name: str) -> EnergyReport:
    found = _pressed(name)[1].report.energy
    assert found is not None
    return found


def _energy(name: str) -> tuple[float, float, float]:
    energy = _energies(name)
    return energy.drift * energy.work_j, 0.0, energy.work_j


def _overlap(name: str) -> tuple[float, float, float]:
    energy = _energies(name)
    return energy.overlap_j, 0.0, energy.work_j
