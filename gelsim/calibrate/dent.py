"""The dent of a ball in the gel as a family of one parameter, the depth: solved once by finite elements, then interpolated.

A rigid ball of radius R on a dome of radius R_d touches it, to second order in the slopes, as a ball of radius R' = 1/(1/R + 1/R_d)
touches a plane: the gap between the two is the same function of the distance from where they first touch. So the axisymmetric press
of a ball into the flat gel (`gelsim.pipeline.stages`) gives the displacement u(ρ; d) for every place on the dome,

    z(x, y) = h(x, y) + d f(ρ / √(R' d); d),    ρ the distance from first touch,

with f interpolated linearly in ρ/√(R' d) and in d: in that variable the contact's edge stays almost in place. The first touch of a ball
whose apex is at c lies at c R_d / (R + R_d).

Left out: how the gel's thickness falls toward the dome's edge, the gel's borders, the shallow-slope approximation's own error (of second
order in the dome's slope; a test compares with the press solved in three dimensions).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SolveError
from gelsim.pipeline import stages
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene
from gelsim.units import MM

Array = NDArray[np.float64]

DEPTHS = 24
"""Solved depths; between them f is linear."""
REACH = 14.0
"""Largest tabulated ρ/√(R' d); beyond, the gel is taken to be at rest."""
NODES = 561
STICKS = Contact()
"""A scene's default friction."""
SHALLOWEST = 0.03
"""Smallest depth [mm] that the family is used at."""


@dataclass(frozen=True, eq=False)
class DentFamily:
    """Tables over depth (first axis) and over ρ/√(R' d) (second axis)."""

    depths_mm: Array
    """Equally spaced, shape (D,)."""
    height: Array
    """z / d of the deformed surface at a place in space, shape (D, NODES)."""
    slope: Array
    """Its derivative by ρ/√(R' d)."""
    moved: Array
    """Radial and vertical displacement over d of a material point, shape (2, D, NODES)."""

    @property
    def deepest_mm(self) -> float:
        return float(self.depths_mm[-1])

    def surface(self, distance_mm: Array, depth_mm: Array, radius_mm: float) -> tuple[Array, Array]:
        """z [mm] and dz/dρ of the dent alone at a distance from first touch; `radius_mm` is R'. Arrays of one shape."""
        unit = np.sqrt(radius_mm * depth_mm)
        row, column = self._place(distance_mm / unit, depth_mm)
        return depth_mm * _bilinear(self.height, row, column), depth_mm / unit * _bilinear(self.slope, row, column)

    def height_at(self, distance_mm: Array, depth_mm: Array, radius_mm: float) -> Array:
        """The first of `surface` alone."""
        row, column = self._place(distance_mm / np.sqrt(radius_mm * depth_mm), depth_mm)
        return depth_mm * _bilinear(self.height, row, column)

    def pulled(self, distance_mm: Array, depth_mm: Array, radius_mm: float) -> Array:
        """How far outward [mm] material points have moved, at a rest distance from first touch; arrays of one shape."""
        row, column = self._place(distance_mm / np.sqrt(radius_mm * depth_mm), depth_mm)
        return depth_mm * _bilinear(self.moved[0], row, column)

    def displacement(self, distance_mm: Array, depth_mm: float, radius_mm: float) -> tuple[Array, Array]:
        """Radial and vertical displacement [mm] of material points at a rest distance from first touch."""
        depth = np.full_like(distance_mm, depth_mm)
        row, column = self._place(distance_mm / np.sqrt(radius_mm * depth), depth)
        return depth * _bilinear(self.moved[0], row, column), depth * _bilinear(self.moved[1], row, column)

    def _place(self, scaled: Array, depth_mm: Array) -> tuple[Array, Array]:
        first, step = self.depths_mm[0], self.depths_mm[1] - self.depths_mm[0]
        row = np.clip((depth_mm - first) / step, 0, len(self.depths_mm) - 1.000001)
        return row, np.clip(scaled * ((NODES - 1) / REACH), 0, NODES - 1.000001)


def _bilinear(table: Array, row: Array, column: Array) -> Array:
    i, j = row.astype(np.int64), column.astype(np.int64)
    s, t = row - i, column - j
    flat = table.ravel()
    k = i * table.shape[1] + j
    below = flat[k] * (1 - t) + flat[k + 1] * t
    above = flat[k + table.shape[1]] * (1 - t) + flat[k + table.shape[1] + 1] * t
    return below * (1 - s) + above * s


def effective_radius(ball_mm: float, curvature: float) -> float:
    """R' [mm] of a ball on a dome of curvature 1/R_d [1/mm]."""
    return 1.0 / (1.0 / ball_mm + curvature)


@dataclass(frozen=True, eq=False)
class Dents:
    """Families of several gel thicknesses."""

    thicknesses_mm: Array
    """Increasing, shape (T,)."""
    families: tuple[DentFamily, ...]
    """On the same depths, with the friction of a scene's default: the ball hardly slips."""
    slippery: tuple[DentFamily, ...] = ()
    """Likewise without friction; none: the ball is taken to stick."""

    @property
    def deepest_mm(self) -> float:
        return self.families[0].deepest_mm

    def at(self, thickness_mm: float, slip: float = 0.0) -> DentFamily:
        """The family of a thickness, linear in its logarithm between those solved, and between a ball that sticks and one that slips."""
        sticking = self._at(self.families, thickness_mm)
        return _mixed(sticking, self._at(self.slippery, thickness_mm), slip) if self.slippery and slip else sticking

    def _at(self, families: tuple[DentFamily, ...], thickness_mm: float) -> DentFamily:
        if len(families) == 1:
            return families[0]
        place = np.interp(np.log(thickness_mm), np.log(self.thicknesses_mm), np.arange(len(families)))
        index = min(int(place), len(families) - 2)
        return _mixed(families[index], families[index + 1], place - index)


def _mixed(a: DentFamily, b: DentFamily, share: float) -> DentFamily:
    return DentFamily(a.depths_mm, *((1 - share) * getattr(a, name) + share * getattr(b, name) for name in ("height", "slope", "moved")))


THICKNESSES = tuple(float(round(thickness, 3)) for thickness in np.geomspace(1.5, 9.0, 11))
"""Solved [mm] when the gel is not known. Between neighbours, 1.2 apart, the surface is good to 2 µm; 1.6 apart it was off by 10 µm, which
moved the thickness found by 0.3 mm."""


def solve_dents(gel: Gel, ball_radius_mm: float, known: bool, progress: Callable[[int, int], None] | None = None) -> Dents:
    """Families of the gel's own thickness if that is known, else of THICKNESSES.

    Args:
        ball_radius_mm: R' of the start's dome; other R' are reached by scaling.
    """
    wanted = (gel.thickness_mm,) if known else THICKNESSES
    deepest = min(0.75 * max(wanted), 0.9 * ball_radius_mm)
    depths = np.linspace(deepest / DEPTHS, deepest, DEPTHS)
    families: tuple[list[DentFamily], list[DentFamily]] = [], []
    for index, thickness in enumerate(wanted):
        for contact, into in zip((STICKS, Contact(friction_coefficient=0.0)), families, strict=True):
            into.append(_solve(replace(gel, thickness_mm=thickness), ball_radius_mm, depths, contact))
        if progress:
            progress(index + 1, len(wanted))
    return Dents(np.array(wanted), tuple(families[0]), tuple(families[1]))


def _solve(gel: Gel, ball_radius_mm: float, depths: Array, contact: Contact = STICKS) -> DentFamily:
    """One family at the wanted depths; deeper than a gel can be pressed, its last state is kept."""
    deepest = min(0.75 * gel.thickness_mm, float(depths[-1]))
    flat = replace(gel, profile="flat", prony_g=(), prony_tau_s=())
    scene = Scene(
        gel=flat,
        contact=contact,
        object=Body(shape="hemisphere", rigid=True, radius_mm=ball_radius_mm, height_mm=2 * ball_radius_mm + deepest),
        press=Press(depth_mm=deepest, force_n=None, frames=DEPTHS + 1, symmetry="axisymmetric"),
    )
    press = stages.press(scene, throw=False)
    usable = np.flatnonzero(press.converged & (press.approach > 0))
    if len(usable) < 2:
        raise SolveError(f"a ball of {ball_radius_mm:g} mm cannot be pressed into a gel of {gel.thickness_mm:g} mm: {press.message}")
    rest = press.gel.rest / MM
    distance = np.hypot(rest[:, 0], rest[:, 1])
    # The turned profile repeats each node around the axis: one of each is kept.
    _, kept = np.unique(np.round(distance, 6), return_index=True)
    away = np.where(distance[kept, None] > 0, rest[kept, :2] / np.maximum(distance[kept, None], 1e-12), 0.0)
    scaled = np.linspace(0, REACH, NODES)
    tables = []
    for state in usable:
        depth = press.approach[state] / MM
        u = press.gel.displacement[state][kept] / MM
        radial, vertical = (u[:, :2] * away).sum(axis=1), u[:, 2]
        unit = np.sqrt(ball_radius_mm * depth)
        rows = [_smooth(distance[kept] / unit, part / depth, scaled) for part in (radial, vertical)]
        tables.append([*rows, _smooth((distance[kept] + radial) / unit, vertical / depth, scaled)])
    at = np.clip(np.interp(depths, press.approach[usable] / MM, np.arange(len(usable))), 0, len(usable) - 1.000001)
    low = at.astype(int)
    share = (at - low)[:, None, None]
    table = np.array(tables)
    table = (1 - share) * table[low] + share * table[low + 1]
    height = table[:, 2]
    slope = np.gradient(height, scaled, axis=1, edge_order=2)
    slope[:, 0] = 0.0
    return DentFamily(depths, height, slope, table[:, :2].transpose(1, 0, 2))


def _smooth(places: Array, values: Array, wanted: Array) -> Array:
    """Values at the wanted places by shape-preserving cubics; 0 beyond the last place, reached without a step."""
    from scipy.interpolate import PchipInterpolator

    # A ball that slips may push a point past its neighbour: beyond the farthest so far, the next one that is farther.
    increasing = np.concatenate([[True], places[1:] > np.maximum.accumulate(places)[:-1] + 1e-9])
    table = PchipInterpolator(places[increasing], values[increasing], extrapolate=False)(wanted)
    fade = np.clip((REACH - wanted) / (0.1 * REACH), 0, 1)
    return np.nan_to_num(table) * fade
