"""The virtual durometer: a tip pressed into a silicone block by finite elements, and so Shore readings to moduli and back.

A durometer's spring (ASTM D2240) holds a tip out of a flat foot by d = T (1 - H/100), with a force of F = F₀ + k H at the reading H:

    scale   tip                                                       T [mm]    F₀ [N]   k [N a point]
    00      ball, R = 1.19 mm, on a shaft as wide                     2.54      0.203    0.00908
    A       cone of 35°, cut off flat at r = 0.395 mm, shaft 0.635    2.54      0.550    0.0750

The block carries F at that depth, so E(H) = F(H) / g(d(H)), where g(d) is the force at E = 1 that a neo-Hookean, nearly incompressible
block of 12 mm on a rigid plate needs: one press, for forces scale with E. The presses are axisymmetric and quasi-static
(`gelsim.fem.planar`); the tip slides freely or sticks. With `foot` the block is also pressed by the foot around the tip, a ring that
carries the rest of the stand's dead load: soft silicone bulges into its hole. Then forces no longer scale, and E is searched for.

Beside them the closed forms: Hertz, F = (16/9) E √R d^1.5, which `gelsim.materials` uses; Sneddon's ball (1965); Scott's fit to balls on
rubber, F = 1.9 E R^0.65 d^1.35 in mm, N and MPa (BS 903); Gent (1958) and Qi et al. (2003) for scale A. Sources: docs/physics.md.

Left out: viscosity (readings are taken after a second), the wall beside the block, wear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelsim import materials
from gelsim.errors import MaterialError, SceneError, SolveError
from gelsim.geometry import PlanarMesh
from gelsim.materials import ElasticMaterial
from gelsim.profiles import gel_profile, rigid_profile
from gelsim.scene import Body, Contact, Gel, Press, Scene
from gelsim.solids import Segment
from gelsim.tables import write_csv
from gelsim.units import MM

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
Row = dict[str, float | None]

BLOCK_MM, BLOCK_RADIUS_MM = 12.0, 30.0
"""The standard asks for 6 mm at least, and for 12 mm from the tip to the block's edge."""
POISSONS_RATIO = 0.4999
READINGS = (8, 10, 14, 17, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 87, 90)
STATES = 49
DIVISIONS = {"fast": 6.0, "balanced": 10.0, "reference": 16.0}
"""Edges across the tip's radius."""
GROWTH, COARSEST = 0.35, 4e-3
"""Edge length gained per length away from the tip; the longest [m]."""
SMOOTH, STICK = 0.0, "stick"
CORNER = 0.05e-3
"""Rounding of the cone's flat end [m]: a sharp one is a singularity that no mesh resolves, and no tip has."""
FOOT_RADIUS, HOLE_RADIUS, HOLE_ROUNDING = 9e-3, 1.5e-3, 0.2e-3
FOOT_LOADS = {"00": 3.92, "A": 9.81}
"""Dead weight on the stand [N]: 0.4 and 1.0 kg."""
FOOT_TOLERANCE = 2e-3
"""Of the search for a modulus, relative in the tip's force."""


@dataclass(frozen=True)
class Durometer:
    """A scale's instrument; SI."""

    scale: str
    travel: float
    preload: float
    rate: float
    tip_radius: float
    """Of the ball, or of the cone's flat end."""
    shaft_radius: float
    half_angle: float = 0.0
    """Of the cone [rad]; 0 for a ball."""
    readings: tuple[float, float] = (8.0, 98.0)
    """For which presses are made: below, the tip goes deeper than the meshes bear."""

    def depth(self, reading: float) -> float:
        """How far the tip is out [m]."""
        return self.travel * (1.0 - reading / 100.0)

    def spring(self, reading: float) -> float:
        """Force [N]."""
        return self.preload + self.rate * reading

    def tip(self, height: float) -> list[Segment]:
        """The tip's profile (r, z) from the axis up to `height` [m]."""
        r, shaft = self.tip_radius, self.shaft_radius
        if not self.half_angle:
            return [Segment((0.0, 0.0), (r, r), r), Segment((r, r), (r, height))]
        rise = (shaft - r) / math.tan(self.half_angle)
        turn = math.pi / 2 - self.half_angle
        cut = CORNER * math.tan(turn / 2)
        begin, end = (r - cut, 0.0), (r + cut * math.cos(turn), cut * math.sin(turn))
        return [
            Segment((0.0, 0.0), begin), Segment(begin, end, CORNER, (r - cut, CORNER)),
            Segment(end, (shaft, rise)), Segment((shaft, rise), (shaft, height)),
        ]  # fmt: skip


SCALES = {
    "00": Durometer("00", materials.TRAVEL, materials.SPRING_PRELOAD, materials.SPRING_RATE, materials.TIP_RADIUS, materials.TIP_RADIUS),
    "A": Durometer("A", 2.54e-3, 0.550, 0.0750, 0.395e-3, 0.635e-3, math.radians(17.5), (10.0, 98.0)),
}


@dataclass(frozen=True, eq=False)
class Curve:
    """What a block carries at E = 1 Pa: depth [m] and force over modulus [m²], both (N,), from 0 on."""

    depth: Array
    force: Array

    def at(self, depth: float) -> float:
        """Force over modulus [m²]; between the states F/d^1.5 is linear in d."""
        if not 0 < depth <= self.depth[-1] * (1 + 1e-9):
            raise MaterialError(f"durometer: depth {depth * 1e3:.3g} mm: the press came to {self.depth[-1] * 1e3:.3g} mm")
        # As a share of d^1.5 the force of a ball hardly bends; that of a cut-off cone does so only in the first states.
        share = self.force[1:] / self.depth[1:] ** 1.5
        return float(np.interp(depth, self.depth[1:], share)) * depth**1.5


@lru_cache
def press_curve(scale: str, friction: float | str = SMOOTH, fidelity: str = "balanced") -> Curve:
    """Presses the tip of a scale into a block, without a foot, to the depth of the softest reading or as far as there is a solution.

    Raises:
        SolveError: The press did not come anywhere.
    """
    instrument = SCALES[scale]
    depth = instrument.depth(instrument.readings[0])
    sizes = _tip_sizes(instrument, fidelity)
    press = _press(_block(friction, fidelity, depth=depth), rigid_profile(instrument.tip(3 * depth), sizes), sizes, 100e3)
    if len(press.approach) < 4:
        raise SolveError(f"durometer {scale}, friction {friction}: stopped at {press.approach[-1] * 1e3:.3g} mm, {press.message}")
    return Curve(press.approach, press.force / 100e3)


def modulus(reading: float, scale: str = "00", friction: float | str = STICK, fidelity: str = "balanced", foot: bool = False) -> float:
    """Young's modulus [Pa] of the block that gives a reading.

    Raises:
        MaterialError: The reading is outside the instrument's range.
    """
    instrument = _instrument(scale, reading)
    if foot:
        return _modulus_with_foot(instrument, reading, friction, fidelity)
    return instrument.spring(reading) / press_curve(scale, friction, fidelity).at(instrument.depth(reading))


def reading(youngs_modulus: float, scale: str = "00", friction: float | str = STICK, fidelity: str = "balanced") -> float:
    """The reading of a block of a modulus [Pa], by bisection: E grows with the reading.

    Raises:
        MaterialError: It would lie outside the instrument's range.
    """
    instrument, curve = SCALES[scale], press_curve(scale, friction, fidelity)
    low, high = instrument.readings
    low = max(low, 100.0 * (1.0 - curve.depth[-1] / instrument.travel))
    ends = [modulus(each, scale, friction, fidelity) for each in (low, high)]
    if not ends[0] <= youngs_modulus <= ends[1]:
        raise MaterialError(
            f"durometer {scale}: E = {youngs_modulus / 1e3:g} kPa reads outside {low:g}…{high:g}; "
            f"allowed is {ends[0] / 1e3:.3g} to {ends[1] / 1e3:.4g} kPa"
        )
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if modulus(middle, scale, friction, fidelity) < youngs_modulus else (low, middle)
    return 0.5 * (low + high)


# ---------------------------------------------------------------------------------------------------------------- closed forms
def sneddon_ball(depth: float, radius: float) -> float:
    """Force over modulus [m²] of a rigid ball on an incompressible half-space (Sneddon 1965): with x = a/R,
    d/R = (x/2) ln((1+x)/(1-x)), F = (4/3) E R² [(1+x²)/2 ln((1+x)/(1-x)) - x]."""
    low, x, high = 0.0, 0.5, 1.0 - 1e-12
    for _ in range(100):
        x = 0.5 * (low + high)
        low, high = (x, high) if 0.5 * x * math.log((1 + x) / (1 - x)) < depth / radius else (low, x)
    return 4 / 3 * radius**2 * (0.5 * (1 + x * x) * math.log((1 + x) / (1 - x)) - x)


def relations(value: float, scale: str) -> dict[str, float | None]:
    """Moduli [Pa] that closed forms and published fits give for a reading; None outside a relation's range."""
    instrument = SCALES[scale]
    depth, force = instrument.depth(value), instrument.spring(value)
    if scale == "00":
        r = instrument.tip_radius
        return {
            "hertz": materials.modulus_from_shore_00(value),
            "sneddon": force / sneddon_ball(depth, r),
            "scott": 1e6 * force / (1.9 * (r * 1e3) ** 0.65 * (depth * 1e3) ** 1.35),
        }
    low, high = materials.SHORE_A_RANGE
    return {
        "gent": 0.0981e6 * (56 + 7.62336 * value) / (0.137505 * (254 - 2.54 * value)),
        "qi": materials.modulus_from_shore_a(value) if low <= value <= high else None,
        # A flat punch of the tip's radius, which a cut-off cone is at small depths.
        "punch": force / (8 / 3 * instrument.tip_radius * depth),
    }


# ---------------------------------------------------------------------------------------------------------------- tables
def compare(scale: str, fidelity: str = "balanced", readings: Sequence[float] | None = None, progress: Progress | None = None) -> list[Row]:
    """Moduli [kPa] of readings by the presses, tip sliding and sticking, and by every relation; None where one has no value."""
    instrument = _instrument(scale, 50.0)
    readings = readings or [h for h in READINGS if instrument.readings[0] <= h <= instrument.readings[1]]
    rows = []
    for number, value in enumerate(readings):
        row: Row = {"reading": float(value)}
        for name, friction in (("sliding", SMOOTH), ("sticking", STICK)):
            try:
                row[name] = modulus(value, scale, friction, fidelity)
            except MaterialError:  # deeper than that press came
                row[name] = None
        row |= relations(value, scale)
        rows.append({key: each if key == "reading" or each is None else each / 1e3 for key, each in row.items()})
        if progress:
            progress("durometer", number + 1, len(readings))
    return rows


def summary(rows: Sequence[Row], scale: str) -> str:
    """The rows as a table for people."""
    names = [name for name in rows[0] if name != "reading"]
    lines = [f"E [kPa] by Shore {scale}", "reading  " + "".join(f"{name:>10}" for name in names)]
    lines += [f"{row['reading']:7g}  " + "".join(f"{'–' if row[n] is None else f'{row[n]:.4g}':>10}" for n in names) for row in rows]
    return "\n".join(lines)


def write(out: Path, rows: Sequence[Row], scale: str) -> None:
    """durometer-SCALE.csv and .png in a folder: moduli against readings, and over the relation that gelsim.materials uses."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    write_csv(out / f"durometer-{scale}.csv", rows)
    used = "hertz" if scale == "00" else "qi"
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name in rows[0]:
        if name == "reading":
            continue
        style = {"sliding": "o-", "sticking": "s-"}.get(name, "--")
        known = [row for row in rows if row[name] is not None]
        left.semilogy([row["reading"] for row in known], [row[name] for row in known], style, label=name, ms=3)
        over = [(row["reading"], (row[name] or 0.0) / (row[used] or 1.0)) for row in known if row[used]]
        right.plot([x for x, _ in over], [y for _, y in over], style, label=name, ms=3)
    left.set(xlabel=f"Shore {scale}", ylabel="E [kPa]")
    right.set(xlabel=f"Shore {scale}", ylabel=f"E over that of {used}")
    left.legend(fontsize=8)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(out / f"durometer-{scale}.png", dpi=130)


# ---------------------------------------------------------------------------------------------------------------- presses
def _instrument(scale: str, value: float) -> Durometer:
    if scale not in SCALES:
        raise SceneError(f"durometer scale {scale!r}: allowed are {', '.join(SCALES)}")
    low, high = SCALES[scale].readings
    if not low <= value <= high:
        raise MaterialError(f"durometer: reading {value:g} Shore {scale}: allowed is {low:g}…{high:g}")
    return SCALES[scale]


def _block(friction: float | str, fidelity: str, *, depth: float | None = None, force: float | None = None) -> Scene:
    """The press to a depth [m] in STATES, or to a force [N] at once; its object stands for the tip, which no shape of a scene is."""
    return Scene(
        gel=Gel(
            profile="flat", size_mm=(2 * BLOCK_RADIUS_MM, 2 * BLOCK_RADIUS_MM), thickness_mm=BLOCK_MM, shore_00=None,
            youngs_modulus_kpa=100.0, poissons_ratio=POISSONS_RATIO,
        ),
        object=Body(shape="hemisphere", radius_mm=1.19, rigid=True),
        contact=Contact(friction_coefficient=friction),
        press=Press(depth_mm=depth and depth / MM, force_n=force, frames=2 if force else STATES),
        fidelity=fidelity,
    )  # fmt: skip


def _tip_sizes(instrument: Durometer, fidelity: str, foot: bool = False) -> Callable[[Array], Array]:
    """Edge lengths at points (N, 2): fine about the tip, and at the hole's edge where there is a foot."""
    radius = instrument.shaft_radius
    finest = radius / DIVISIONS[fidelity]
    # Where the pressure peaks, r [m], and the edges there over the finest: half as long at the corner of a flat end.
    peaks = [(instrument.tip_radius, 0.5)] if instrument.half_angle else []
    peaks += [(HOLE_RADIUS, 1.0), (FOOT_RADIUS, 1.0)] if foot else []

    def sizes(points: Array) -> Array:
        size = np.minimum(finest + GROWTH * np.maximum(np.hypot(*points.T) - radius, 0.0), COARSEST)
        for place, share in peaks:
            size = np.minimum(size, share * finest + GROWTH * np.hypot(points[:, 0] - place, points[:, 1]))
        return size

    return sizes


@dataclass(frozen=True, eq=False)
class _Pressed:
    """A press of the block: approaches [m] and forces [N] of its states, how it ended, and the last one's contact."""

    approach: Array
    force: Array
    message: str
    place: Array
    """r of the contact points [mm], (Q,)."""
    upward: Array
    """Their forces, up to a factor."""

    def within(self, radius: float) -> float:
        """What of the last force [N] acts nearer to the axis than `radius` [m]."""
        return float(self.force[-1] * self.upward[self.place < radius / MM].sum() / self.upward.sum())


def _press(scene: Scene, tip: PlanarMesh, sizes: Callable[[Array], Array], youngs_modulus: float) -> _Pressed:
    from gelsim.fem import quiet_warp

    quiet_warp()
    from gelsim.fem.planar.problem import PlanarProblem
    from gelsim.fem.quasistatic import run_press

    block = gel_profile(scene, BLOCK_RADIUS_MM * MM, np.zeros((0, 2)), sizes)
    problem = PlanarProblem(scene, block, tip, ElasticMaterial.from_modulus(youngs_modulus, POISSONS_RATIO), None, None)
    press = run_press(problem, throw=False)
    contact, solids = problem.contact, problem.solids
    pressure = contact.pressure.numpy()
    upward = np.where(pressure > 0, pressure * contact.normal.numpy()[:, 2], 0.0) * contact.rest_weight
    place = (solids.rest + solids.displacement.numpy())[contact.gel_faces][..., 0] @ contact.shape_values.T
    return _Pressed(press.approach, -press.force[:, 2], press.message, place.ravel(), upward)


def _modulus_with_foot(instrument: Durometer, value: float, friction: float | str, fidelity: str) -> float:
    """Secant search in log E for the block that carries the spring's force at the tip while the foot rests on it."""
    depth, spring, load = instrument.depth(value), instrument.spring(value), FOOT_LOADS[instrument.scale]
    sizes = _tip_sizes(instrument, fidelity, foot=True)
    bend = HOLE_ROUNDING
    outline = [
        *instrument.tip(depth + 2 * bend),
        Segment((instrument.shaft_radius, depth + 2 * bend), (HOLE_RADIUS, depth + 2 * bend)),
        Segment((HOLE_RADIUS, depth + 2 * bend), (HOLE_RADIUS, depth + bend)),
        Segment((HOLE_RADIUS, depth + bend), (HOLE_RADIUS + bend, depth), bend, (HOLE_RADIUS + bend, depth + bend)),
        Segment((HOLE_RADIUS + bend, depth), (FOOT_RADIUS, depth)),
        Segment((FOOT_RADIUS, depth), (FOOT_RADIUS, depth + 5e-3)),
    ]

    tip = rigid_profile(outline, sizes)

    def tip_force(youngs_modulus: float) -> float:
        press = _press(_block(friction, fidelity, force=load), tip, sizes, youngs_modulus)
        if abs(press.force[-1] / load - 1) > 0.01:
            said = f"stopped with {press.force[-1]:.3g} of {load:g} N, {press.message}"
            raise SolveError(f"durometer with foot, E = {youngs_modulus / 1e3:.4g} kPa: {said}")
        return press.within(HOLE_RADIUS)

    guess = spring / press_curve(instrument.scale, friction, fidelity).at(depth)
    points = [(math.log(guess), math.log(tip_force(guess) / spring))]
    points.append((points[0][0] - points[0][1], 0.0))
    for _ in range(8):
        log_modulus = points[-1][0]
        points[-1] = (log_modulus, math.log(tip_force(math.exp(log_modulus)) / spring))
        if abs(points[-1][1]) < FOOT_TOLERANCE:
            return math.exp(log_modulus)
        (a, fa), (b, fb) = points[-2:]
        points.append((b - fb * (b - a) / (fb - fa), 0.0))
    raise SolveError(f"durometer with foot at {value:g} Shore {instrument.scale}: the search for a modulus did not settle")
