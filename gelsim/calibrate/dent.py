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

BALL = "hemisphere"
"""The shape whose dents are tabulated."""
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
    """Tables by ball, over depth and over ρ/√(R' d). A ball of another R' takes those of the nearest, by scaling."""

    radii_mm: Array
    """R' of the balls that were solved, increasing, shape (B,)."""
    deepest_mm: Array
    """Depths are DEPTHS equal steps up to it, shape (B,)."""
    height: Array
    """z / d of the deformed surface at a place in space, shape (B, D, NODES)."""
    slope: Array
    """Its derivative by ρ/√(R' d)."""
    moved: Array
    """Radial and vertical displacement over d of a material point, shape (2, B, D, NODES)."""

    def clipped(self, depth_mm: Array, radius_mm: Array) -> Array:
        """Depths [mm] that the tables reach."""
        return np.clip(depth_mm, SHALLOWEST, self.deepest_mm[nearest_ball(self.radii_mm, radius_mm)])

    def surface(self, distance_mm: Array, depth_mm: Array, radius_mm: Array) -> tuple[Array, Array]:
        """z [mm] and dz/dρ of the dent alone at a distance from first touch; `radius_mm` is R'. Arrays of one shape."""
        unit = np.sqrt(radius_mm * depth_mm)
        row, column = self._place(distance_mm / unit, depth_mm, radius_mm)
        return depth_mm * _bilinear(self.height, row, column), depth_mm / unit * _bilinear(self.slope, row, column)

    def height_at(self, distance_mm: Array, depth_mm: Array, radius_mm: Array) -> Array:
        """The first of `surface` alone."""
        row, column = self._place(distance_mm / np.sqrt(radius_mm * depth_mm), depth_mm, radius_mm)
        return depth_mm * _bilinear(self.height, row, column)

    def pulled(self, distance_mm: Array, depth_mm: Array, radius_mm: Array) -> Array:
        """How far outward [mm] material points have moved, at a rest distance from first touch; arrays of one shape."""
        row, column = self._place(distance_mm / np.sqrt(radius_mm * depth_mm), depth_mm, radius_mm)
        return depth_mm * _bilinear(self.moved[0], row, column)

    def displacement(self, distance_mm: Array, depth_mm: float, radius_mm: float) -> tuple[Array, Array]:
        """Radial and vertical displacement [mm] of material points at a rest distance from first touch."""
        depth = np.full_like(distance_mm, depth_mm)
        row, column = self._place(distance_mm / np.sqrt(radius_mm * depth), depth, np.full_like(distance_mm, radius_mm))
        return depth * _bilinear(self.moved[0], row, column), depth * _bilinear(self.moved[1], row, column)

    def _place(self, scaled: Array, depth_mm: Array, radius_mm: Array) -> tuple[Array, Array]:
        """Row, counted through the balls, and column of the tables."""
        ball = nearest_ball(self.radii_mm, radius_mm)
        row = np.clip(depth_mm * (DEPTHS / self.deepest_mm[ball]) - 1, 0, DEPTHS - 1.000001) + DEPTHS * ball
        return row, np.clip(scaled * ((NODES - 1) / REACH), 0, NODES - 1.000001)


def _bilinear(table: Array, row: Array, column: Array) -> Array:
    i, j = row.astype(np.int64), column.astype(np.int64)
    s, t = row - i, column - j
    flat = table.ravel()
    k = i * NODES + j
    below = flat[k] * (1 - t) + flat[k + 1] * t
    above = flat[k + NODES] * (1 - t) + flat[k + NODES + 1] * t
    return below * (1 - s) + above * s


def effective_radius(ball_mm: Array | float, curvature: float) -> Array:
    """R' [mm] of balls on a dome of curvature 1/R_d [1/mm]."""
    return 1.0 / (1.0 / np.asarray(ball_mm, np.float64) + curvature)


def distinct(radii_mm: Array) -> Array:
    """R' [mm] that differ, in increasing order."""
    return np.asarray(np.unique(np.round(radii_mm, 6)), np.float64)


def nearest_ball(radii_mm: Array, radius_mm: Array) -> NDArray[np.int64]:
    """Number of the solved R' that is nearest, by ratio."""
    return np.searchsorted(np.sqrt(radii_mm[1:] * radii_mm[:-1]), radius_mm)


@dataclass(frozen=True, eq=False)
class Dents:
    """Families of several gel thicknesses."""

    thicknesses_mm: Array
    """Increasing, shape (T,)."""
    families: tuple[DentFamily, ...]
    """On the same depths, with the friction of a scene's default: the ball hardly slips."""
    slippery: tuple[DentFamily, ...] = ()
    """Likewise without friction; none: the ball is taken to stick."""

    def deepest(self, radius_mm: Array) -> Array:
        """Largest depth [mm] that was solved for balls of these R'."""
        return self.families[0].deepest_mm[nearest_ball(self.families[0].radii_mm, radius_mm)]

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
    return DentFamily(
        a.radii_mm, a.deepest_mm, *((1 - share) * getattr(a, name) + share * getattr(b, name) for name in ("height", "slope", "moved"))
    )


THICKNESSES = tuple(float(round(thickness, 3)) for thickness in np.geomspace(1.5, 9.0, 11))
"""Solved [mm] when the gel is not known. Between neighbours, 1.2 apart, the surface is good to 2 µm; 1.6 apart it was off by 10 µm, which
moved the thickness found by 0.3 mm."""


def solve_dents(gel: Gel, radii_mm: Array | float, known: bool, progress: Callable[[int, int], None] | None = None) -> Dents:
    """Families of the gel's own thickness if that is known, else of THICKNESSES.

    Args:
        radii_mm: R' of the balls on the start's dome; other R' are reached by scaling.
    """
    radii = distinct(np.atleast_1d(np.asarray(radii_mm, np.float64)))
    wanted = (gel.thickness_mm,) if known else THICKNESSES
    families: tuple[list[DentFamily], list[DentFamily]] = [], []
    for index, thickness in enumerate(wanted):
        for contact, into in zip((STICKS, Contact(friction_coefficient=0.0)), families, strict=True):
            into.append(solve_family(replace(gel, thickness_mm=thickness), radii, max(wanted), contact))
        if progress:
            progress(index + 1, len(wanted))
    return Dents(np.array(wanted), tuple(families[0]), tuple(families[1]))


def solve_family(gel: Gel, radii_mm: Array, thickest_mm: float, contact: Contact = STICKS) -> DentFamily:
    """Dents of balls of increasing R' in one gel, to depths that a gel of `thickest_mm` allows."""
    deepest = np.minimum(0.75 * thickest_mm, 0.9 * radii_mm)
    tables = [
        _solve(gel, float(radius), np.linspace(most / DEPTHS, most, DEPTHS), contact)
        for radius, most in zip(radii_mm, deepest, strict=True)
    ]
    height, slope, moved = (np.stack(parts) for parts in zip(*tables, strict=True))
    return DentFamily(radii_mm, deepest, height, slope, moved.swapaxes(0, 1))


def _solve(gel: Gel, ball_radius_mm: float, depths: Array, contact: Contact) -> tuple[Array, Array, Array]:
    """Height, slope and motion at the wanted depths; deeper than a gel can be pressed, its last state is kept."""
    deepest = min(0.75 * gel.thickness_mm, float(depths[-1]))
    flat = replace(gel, profile="flat", prony_g=(), prony_tau_s=())
    scene = Scene(
        gel=flat,
        contact=contact,
        object=Body(shape=BALL, rigid=True, radius_mm=ball_radius_mm, height_mm=2 * ball_radius_mm + deepest),
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
    return height, slope, table[:, :2].transpose(1, 0, 2)


def _smooth(places: Array, values: Array, wanted: Array) -> Array:
    """Values at the wanted places by shape-preserving cubics; 0 beyond the last place, reached without a step."""
    from scipy.interpolate import PchipInterpolator

    # A ball that slips may push a point past its neighbour: beyond the farthest so far, the next one that is farther.
    increasing = np.concatenate([[True], places[1:] > np.maximum.accumulate(places)[:-1] + 1e-9])
    table = PchipInterpolator(places[increasing], values[increasing], extrapolate=False)(wanted)
    fade = np.clip((REACH - wanted) / (0.1 * REACH), 0, 1)
    return np.nan_to_num(table) * fade
