"""The virtual durometer: a tip pressed into a silicone block by finite elements, and so Shore readings to moduli and back.

A durometer's spring (ASTM D2240) holds a tip out of a flat foot by d = T (1 - H/100), with a force of F = F₀ + k H at the reading H:

    scale   tip                                                       T [mm]    F₀ [N]   k [N a point]
    00      ball, R = 1.19 mm, on a shaft as wide                     2.54      0.203    0.00908
    A       cone of 35°, cut off flat at r = 0.395 mm, shaft 0.635    2.54      0.550    0.0750

The block carries F at that depth, so E(H) = F(H) / g(d(H)), where g(d) is the force at E = 1 that a neo-Hookean, nearly incompressible
block of 12 mm on a rigid plate needs: one press, for forces scale with E. The presses are axisymmetric and quasi-static
(`gelsim.fem.planar`); the tip slides, freely or with friction, or sticks. With `foot` the block is also pressed by the foot around the tip,
a ring that carries the rest of the stand's dead load: soft silicone bulges into its hole. Forces scale with E then too, so each reading
takes one press: where the tip's share of the force has come down to the spring's share of the load, E is known.

Beside them the closed forms: Hertz, F = (16/9) E √R d^1.5, which `gelsim.scene.materials` uses; Sneddon's ball (1965); Scott's fit to balls
on rubber, F = 1.9 E R^0.65 d^1.35 in mm, N and MPa (BS 903); Gent (1958) and Qi et al. (2003) for scale A. Sources: docs/physics.md.

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
from scipy.optimize import root_scalar

from gelsim.errors import MaterialError, SceneError, SolveError
from gelsim.geometry import PlanarMesh
from gelsim.mesh.profiles import gel_profile, rigid_profile
from gelsim.scene import materials
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene
from gelsim.scene.materials import ElasticMaterial
from gelsim.shape.solids import Segment
from gelsim.tables import write_csv
from gelsim.units import MM

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
Row = dict[str, float | None]

BLOCK_MM, BLOCK_RADIUS_MM = 12.0, 30.0
"""The standard asks for 6 mm at least, and for 12 mm from the tip to the block's edge."""
POISSONS_RATIO = 0.4999
NO_SKIN = (0.0, 1.0)
READINGS = (8, 10, 14, 17, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 87, 90)
STATES = 49
MODULUS = 100e3
"""Of the blocks that are pressed [Pa]; what comes out is over it."""
DIVISIONS = {"fast": 6.0, "balanced": 10.0, "reference": 16.0}
"""Edges across the tip's radius."""
GROWTH, COARSEST = 0.35, 4e-3
"""Edge length gained per length away from the tip; the longest [m]."""
SMOOTH, STICK = 0.0, "stick"
FRICTIONS: dict[str, float | str] = {"smooth": SMOOTH, "sliding": 0.15, "sticking": STICK}
"""Of tables. Without friction a soft block slips away under the tip until an element turns inside out; 0.15 comes through everywhere."""
CORNER = 0.05e-3
"""Rounding of the cone's flat end [m]: a sharp one is a singularity that no mesh resolves, and no tip has."""
FOOT_RADIUS, HOLE_RADIUS, HOLE_ROUNDING = 9e-3, 1.5e-3, 0.2e-3
FOOT_LOADS = {"00": 3.92, "A": 9.81}
"""Dead weight on the stand [N]: 0.4 and 1.0 kg."""
HOLE_DEPTH = 1.5e-3
SINK_STEPS, LONGEST_MARCH, LONGEST_STEP, DEEPEST = 20, 200, 0.05e-3, 9e-3
"""Of a press with foot: steps while the foot sinks in, and at most until it touches; the longest step and the whole way [m]."""


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


TESTER = Durometer("5 mm", 1e-3, 0.0, 0.0, 2.5e-3, 2.5e-3, readings=(0.0, 0.0))
"""A firmness tester held by hand: a ball of 5 mm across, 1 mm deep; it has no spring."""


@dataclass(frozen=True)
class Sample:
    """What is pressed: a block, or one under a skin that adheres to it."""

    poissons_ratio: float = POISSONS_RATIO
    """Of block and skin."""
    skin_mm: float = 0.0
    """Its thickness, of the block's own; 0: none."""
    skin_ratio: float = 1.0
    """Its modulus over that of the block, which is the one that forces are over."""


USED = {"00": "hertz", "A": "qi"}
"""The relation that gelsim.scene.materials takes."""


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
def press_curve(
    scale: str, friction: float | str = SMOOTH, fidelity: str = "balanced", poissons_ratio: float = POISSONS_RATIO,
    skin: tuple[float, float] = NO_SKIN,
) -> Curve:  # fmt: skip
    """Presses the tip of a scale into a block, without a foot, to the depth of the softest reading or as far as there is a solution.

    Args:
        skin: Its thickness [mm], and its modulus over the block's.
    Raises:
        SolveError: The press did not come anywhere.
    """
    instrument = SCALES[scale]
    return sample_curve(instrument, instrument.depth(instrument.readings[0]), Sample(poissons_ratio, *skin), friction, fidelity)


def sample_curve(
    instrument: Durometer, depth: float, sample: Sample, friction: float | str = STICK, fidelity: str = "balanced"
) -> Curve:  # fmt: skip
    """Presses a tip to a depth [m], or as far as there is a solution. Raises SolveError: It did not come anywhere."""
    sizes = _tip_sizes(instrument, fidelity)
    tip = rigid_profile(instrument.tip(3 * depth), sizes)
    press = _press(_block(friction, fidelity, depth, poissons_ratio=sample.poissons_ratio), tip, sizes, sample=sample)
    if len(press.approach) < 4:
        reached = f"{press.approach[-1] * 1e3:.3g} mm"
        raise SolveError(f"durometer {instrument.scale}, friction {friction}: stopped at {reached}, {press.message}")
    return Curve(press.approach, press.force)


def modulus(
    reading: float, scale: str = "00", friction: float | str = STICK, fidelity: str = "balanced", foot: bool = False,
    poissons_ratio: float = POISSONS_RATIO,
) -> float:  # fmt: skip
    """Young's modulus [Pa] of the block that gives a reading.

    Raises:
        MaterialError: The reading is outside the instrument's range, or the press did not come that far.
    """
    instrument = _instrument(scale, reading)
    if foot:
        return _modulus_with_foot(scale, reading, friction, fidelity, poissons_ratio)
    return instrument.spring(reading) / press_curve(scale, friction, fidelity, poissons_ratio).at(instrument.depth(reading))


def reading(
    youngs_modulus: float, scale: str = "00", friction: float | str = STICK, fidelity: str = "balanced",
    poissons_ratio: float = POISSONS_RATIO, skin: tuple[float, float] = NO_SKIN,
) -> float:  # fmt: skip
    """The reading of a block of a modulus [Pa], `skin` on (`press_curve`): E grows with the reading.

    Raises:
        MaterialError: It would lie outside the instrument's range.
    """
    instrument, curve = SCALES[scale], press_curve(scale, friction, fidelity, poissons_ratio, skin)

    def modulus_at(reading: float) -> float:
        return instrument.spring(reading) / curve.at(instrument.depth(reading))

    low, high = instrument.readings
    low = max(low, 100.0 * (1.0 - curve.depth[-1] / instrument.travel))
    ends = [modulus_at(each) for each in (low, high)]
    if not ends[0] <= youngs_modulus <= ends[1]:
        raise MaterialError(
            f"durometer {scale}: E = {youngs_modulus / 1e3:g} kPa reads outside {low:g}…{high:g}; "
            f"allowed is {ends[0] / 1e3:.3g} to {ends[1] / 1e3:.4g} kPa"
        )
    return root_scalar(lambda each: modulus_at(each) - youngs_modulus, bracket=(low, high)).root


# ---------------------------------------------------------------------------------------------------------------- closed forms
def sneddon_ball(depth: float, radius: float) -> float:
    """Force over modulus [m²] of a rigid ball on an incompressible half-space (Sneddon 1965): with x = a/R,
    d/R = (x/2) ln((1+x)/(1-x)), F = (4/3) E R² [(1+x²)/2 ln((1+x)/(1-x)) - x]."""
    x = root_scalar(lambda x: x * math.atanh(x) - depth / radius, bracket=(0.0, 1.0 - 1e-12)).root
    return 4 / 3 * radius**2 * ((1 + x * x) * math.atanh(x) - x)


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
def compare(
    scale: str, fidelity: str = "balanced", readings: Sequence[float] | None = None, progress: Progress | None = None, foot: bool = False
) -> list[Row]:
    """Moduli [kPa] of readings by the presses, for each of FRICTIONS, with `foot` each with it too, and by every relation.

    None where one has no value.
    """
    instrument = _instrument(scale, 50.0)
    readings = readings or [h for h in READINGS if instrument.readings[0] <= h <= instrument.readings[1]]
    rows = []
    for number, value in enumerate(readings):
        row: Row = {"reading": float(value)}
        for name, friction in FRICTIONS.items():
            for footed in (False, True) if foot else (False,):
                try:
                    row["foot, " * footed + name] = modulus(value, scale, friction, fidelity, footed)
                except MaterialError:  # deeper than that press came
                    row["foot, " * footed + name] = None
        row |= relations(value, scale)
        rows.append({key: each if key == "reading" or each is None else each / 1e3 for key, each in row.items()})
        if progress:
            progress("durometer", number + 1, len(readings))
    return rows


def summary(rows: Sequence[Row], scale: str) -> str:
    """The rows as a table for people."""
    names = [name for name in rows[0] if name != "reading"]
    lines = [f"E [kPa] by Shore {scale}", "reading  " + "".join(f"{name:>16}" for name in names)]
    lines += [f"{row['reading']:7g}  " + "".join(f"{'–' if row[n] is None else f'{row[n]:.4g}':>16}" for n in names) for row in rows]
    used = USED[scale]
    for name in (name for name in names if name.removeprefix("foot, ") in FRICTIONS):
        over = [100 * (row[name] / row[used] - 1) for row in rows if row[name] and row[used]]  # type: ignore[operator]
        if over:
            lines.append(f"{name}: {min(over):+.0f} to {max(over):+.0f} % of {used}, which gelsim uses")
    return "\n".join(lines)


def write(out: Path, rows: Sequence[Row], scale: str) -> None:
    """durometer-SCALE.csv and .png in a folder: moduli against readings, and over the relation that gelsim.scene.materials uses."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    write_csv(out / f"durometer-{scale}.csv", rows)
    used = USED[scale]
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name in rows[0]:
        if name == "reading":
            continue
        style = {"smooth": "o-", "sliding": "v-", "sticking": "s-"}.get(name.removeprefix("foot, "), "--")
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


def _block(friction: float | str, fidelity: str, depth: float, states: int = STATES, poissons_ratio: float = POISSONS_RATIO) -> Scene:
    """The press to a depth [m]; its object stands for the tip, which no shape of a scene is."""
    return Scene(
        gel=Gel(
            profile="flat", size_mm=(2 * BLOCK_RADIUS_MM, 2 * BLOCK_RADIUS_MM), thickness_mm=BLOCK_MM, shore_00=None,
            youngs_modulus_kpa=MODULUS / 1e3, poissons_ratio=poissons_ratio,
        ),
        object=Body(shape="hemisphere", radius_mm=1.19, rigid=True),
        contact=Contact(friction_coefficient=friction),
        press=Press(depth_mm=depth / MM, force_n=None, frames=states),
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
    """A press of the block at E = 1 Pa, state by state: approach [m], force over modulus [m²], and of that what the tip carries."""

    approach: Array
    force: Array
    tip_force: Array
    message: str
    """Why it ended, if it is not whole."""


class _BoreEnough(Exception):
    """Ends a march."""


def _press(
    scene: Scene, tip: PlanarMesh, sizes: Callable[[Array], Array], least_share: float = 0.0, sample: Sample | None = None
) -> _Pressed:  # fmt: skip
    """Presses until the tip carries less than `least_share` of the whole; what touches nearer to the axis than the hole is the tip's."""
    from gelsim.fem import quiet_warp

    quiet_warp()
    from gelsim.fem.planar.problem import PlanarProblem
    from gelsim.fem.planar.recording import PlanarRecorder
    from gelsim.fem.quasistatic import run_press

    sample = sample or Sample(scene.gel.poissons_ratio)
    block = gel_profile(scene, BLOCK_RADIUS_MM * MM, np.zeros((0, 2)), sizes, sample.skin_mm * MM)
    moduli = (MODULUS, MODULUS * sample.skin_ratio)
    problem = PlanarProblem(scene, block, tip, [ElasticMaterial.from_modulus(each, sample.poissons_ratio) for each in moduli], None, None)
    contact, solids = problem.contact, problem.solids
    states: list[tuple[float, float]] = []

    def keep(*_: int) -> None:
        pressure = contact.pressure.numpy()
        along = pressure * contact.normal.numpy()[:, 2]
        if contact.frictional:  # a good part of what a tip bears deep in a block, by its flanks
            along = along + contact.traction.numpy()[:, 2]
        along = np.where(pressure > 0, along, 0.0) * contact.rest_weight
        place = (solids.rest + solids.displacement.numpy())[contact.slave_faces][..., 0] @ contact.shape_values.T
        force, whole = -problem.contact_force()[2] / MODULUS, along.sum()
        share = along[place.ravel() < HOLE_RADIUS / MM].sum() / whole if whole else 1.0
        states.append((force, share * force))
        if share < least_share:
            raise _BoreEnough

    message = ""
    try:
        message = run_press(problem, record=PlanarRecorder, progress=keep, throw=False).message
    except _BoreEnough:
        pass
    assert scene.press.depth_mm is not None
    approach = np.linspace(0.0, scene.press.depth_mm * MM, scene.press.frames)[: len(states)]
    force, tip_force = np.array(states).T
    return _Pressed(approach, force, tip_force, message)


@lru_cache
def _modulus_with_foot(scale: str, value: float, friction: float | str, fidelity: str, poissons_ratio: float) -> float:
    """Forces scale with E. So one press of tip and foot tells it: at first touch the tip carries all; where its share has come down to the
    spring's of the dead load, E is the load over the force that a block of 1 Pa carries there."""
    instrument = SCALES[scale]
    depth, spring, load = instrument.depth(value), instrument.spring(value), FOOT_LOADS[scale]
    # As far as a flat round punch of the foot's size would sink into a half-space, and by how much a step.
    guess = relations(value, scale)["hertz" if scale == "00" else "gent"]
    assert guess is not None
    sink = (load - spring) / (8 / 3 * guess * FOOT_RADIUS)
    spacing = min(max(sink / SINK_STEPS, depth / LONGEST_MARCH), LONGEST_STEP)
    frames = math.ceil(min(depth + 4 * sink, DEEPEST) / spacing) + 1
    sizes = _tip_sizes(instrument, fidelity, foot=True)
    tip = rigid_profile(_tip_and_foot(instrument, depth), sizes)
    scene = _block(friction, fidelity, spacing * (frames - 1), frames, poissons_ratio)
    press = _press(scene, tip, sizes, spring / load)
    share = press.tip_force[1:] / press.force[1:]
    if share[-1] > spring / load:
        raise MaterialError(
            f"durometer with foot at {value:g} Shore {scale}, friction {friction}: the press ended at {press.approach[-1] * 1e3:.3g} mm, "
            f"the tip bearing {share[-1]:.3g} of all where the reading asks for {spring / load:.3g}: {press.message}"
        )
    last = slice(-2, None)
    return load / float(np.interp(-spring / load, -share[last], press.force[last]))


def _tip_and_foot(instrument: Durometer, depth: float) -> list[Segment]:
    """Profile of the tip, `depth` [m] out of the foot's face, of the hole about it, deeper than any bulge comes, and of the foot."""
    edge, bend = depth + HOLE_ROUNDING, HOLE_ROUNDING
    top = edge + HOLE_DEPTH
    return [
        *instrument.tip(top),
        Segment((instrument.shaft_radius, top), (HOLE_RADIUS, top)),
        Segment((HOLE_RADIUS, top), (HOLE_RADIUS, edge)),
        Segment((HOLE_RADIUS, edge), (HOLE_RADIUS + bend, depth), bend, (HOLE_RADIUS + bend, edge)),
        Segment((HOLE_RADIUS + bend, depth), (FOOT_RADIUS, depth)),
        Segment((FOOT_RADIUS, depth), (FOOT_RADIUS, depth + 5e-3)),
    ]
