"""Where the object goes, as one piecewise linear motion in time, whichever way the scene says it: by the short form's fields (`depth_mm`,
`force_n`, `shear_mm`, `twist_deg`, `hold_s`), by `press.path`, or by a measured trajectory, `press.path_csv`.

The object moves as a whole from where it first touches: it goes down by the approach and sideways by the shear, and turns about its pivot,
its apex. A leg that ends at a force has the force linear in time instead of the approach, which the march finds.

Left out: how far a press to a force goes (`gelsim.fem.quasistatic`), and where it first touches (`gelsim.shape.shapes`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gelsim.scene.definition import Press, Scene
from gelsim.scene.measured_path import measured_path

Array = NDArray[np.float64]

TURN_STEP = 5.0
"""[degrees] Half of it takes a point 12 mm from the axis 0.01 mm off its chord."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A piecewise linear motion of K knots; leg k goes from knot k - 1 to knot k."""

    time: Array
    """[s], (K,), from 0."""
    approach: Array
    """From first touch [mm], (K,); NaN where a force says how far, until the march has found it."""
    force: Array
    """Normal force [N] at the knots whose leg ends at one, (K,); NaN at the others, until the march has been there."""
    by_force: NDArray[np.bool_]
    """Whether leg k is driven by its force, (K,)."""
    shear: Array
    """From first touch [mm], (K, 2)."""
    turn: Array
    """About x, then y, then z [degrees], (K, 3), as tilt_deg; the first is how it stands at first touch."""
    recorded: Array
    """Times of the recorded states [s], (N,), the first is 0."""
    apex_z: bool = False
    """The approach is counted from z = 0 and not from where the object touches (a measured path)."""

    def from_touch(self, touch: float) -> Motion:
        """The same counted from first touch, where the apex lies at z = `touch` [mm]."""
        return replace(self, approach=self.approach + touch, apex_z=False) if self.apex_z else self

    def leg_after(self, time: float) -> int:
        """Number of the leg that a motion is on just after a time [s]; K at its end."""
        return int(np.searchsorted(self.time, time * (1 + 1e-12), side="right"))

    def at(self, leg: int, time: float) -> tuple[float, float, Array, Array]:
        """At a time [s] of a leg: approach [mm] and force [N], NaN where that does not drive it, shear [mm] (2,), turn [degrees] (3,)."""
        begin, end = leg - 1, leg
        share = (time - self.time[begin]) / (self.time[end] - self.time[begin])

        def between(values: Array) -> Array:
            return values[begin] + share * (values[end] - values[begin])

        known = np.nan if self.by_force[leg] else float(between(self.approach))
        return known, float(between(self.force)) if self.by_force[leg] else np.nan, between(self.shear), between(self.turn)

    def reached(self, knot: int, approach: float, force: float) -> Motion:
        """With what is not said of a knot, its approach [mm] or its force [N], as it was found."""
        approaches, forces = self.approach.copy(), self.force.copy()
        (approaches if self.by_force[knot] else forces)[knot] = approach if self.by_force[knot] else force
        return replace(self, approach=approaches, force=forces)

    def stays_from(self, leg: int, time: float) -> Motion:
        """Cut off within a leg: the pose there is that of all knots from the leg's end on."""
        approach, _, shear, turn = self.at(leg, time)
        shift = self.time[leg] - time
        times, recorded = self.time.copy(), self.recorded.copy()
        times[leg:] -= shift
        left = recorded > self.time[leg] * (1 + 1e-12)
        recorded = np.append(recorded[recorded < time * (1 - 1e-12)], [time, *(recorded[left] - shift)])
        approaches, shears, turns = self.approach.copy(), self.shear.copy(), self.turn.copy()
        approaches[leg:], shears[leg:], turns[leg:] = approach, shear, turn
        return replace(self, time=times, approach=approaches, shear=shears, turn=turns, recorded=recorded)

    @property
    def deepest(self) -> float:
        """Largest approach [mm] that is known; 0 where only forces are."""
        return float(np.nanmax(self.approach))

    @property
    def sideways(self) -> Array:
        """Largest shear along x and y [mm], (2,)."""
        return np.abs(self.shear).max(axis=0)

    @property
    def turns(self) -> NDArray[np.bool_]:
        """Whether it is ever turned about x, y, z, (3,)."""
        return (self.turn != 0.0).any(axis=0)

    def turns_on_way(self) -> Array:
        """Its turns, no more than TURN_STEP apart, (T, 3) [degrees]."""
        found = [self.turn[:1]]
        for before, after in pairwise(self.turn):
            count = int(np.ceil(np.abs(after - before).max() / TURN_STEP))
            found.append(before + np.arange(1, count + 1)[:, None] / max(count, 1) * (after - before))
        return np.vstack(found)

    @property
    def rolls(self) -> bool:
        """Whether a tilt changes on the way, so that another part of the object comes to touch."""
        return bool(np.ptp(self.turn[:, :2], axis=0).any())


def straight(press: Press, depth_mm: float, hold: bool = True) -> Motion:
    """The short form's motion to a depth [mm]: shear and twist in proportion to the approach, then (with `hold`) its hold."""
    seconds, frames = depth_mm / press.speed_mm_s, press.frames
    stays = hold and press.hold_s > 0.0
    time = np.cumsum([0.0, seconds, *([press.hold_s] if stays else [])])
    share = np.minimum(np.arange(len(time)), 1.0)[:, None]
    recorded = seconds * np.arange(frames) / (frames - 1)
    return Motion(
        time,
        depth_mm * share[:, 0],
        np.full(len(time), np.nan),
        np.zeros(len(time), bool),
        share * press.shear_mm,
        np.array([*press.tilt_deg, 0.0]) + share * [0.0, 0.0, press.twist_deg],
        np.append(recorded, time[2:]),
    )


def motion(press: Press) -> Motion | None:
    """The motion that a path says, one way or the other; None of the short form (`straight`)."""
    if press.path_csv is not None:
        rows = np.array(measured_path(press.path_csv))
        time, count = rows[:, 0] - rows[0, 0], len(rows)
        recorded = np.linspace(0.0, time[-1], press.frames)
        shear = rows[:, 1:3] - rows[0, 1:3]
        return Motion(time, -rows[:, 3], np.full(count, np.nan), np.zeros(count, bool), shear, rows[:, 4:7], recorded, apex_z=True)
    if not press.path:
        return None
    depth, force, shear, twist, tilt = 0.0, np.nan, (0.0, 0.0), 0.0, press.tilt_deg
    knots: list[tuple] = [(depth, force, False, shear, (*tilt, twist))]
    for point in press.path:
        if point.depth_mm is not None:
            depth, force = point.depth_mm, np.nan
        elif point.force_n is not None:
            depth, force = np.nan, point.force_n
        shear = shear if point.shear_mm is None else point.shear_mm
        twist = twist if point.twist_deg is None else point.twist_deg
        tilt = tilt if point.tilt_deg is None else point.tilt_deg
        knots.append((depth, force, not np.isnan(force), shear, (*tilt, twist)))
    depths, forces, by_force, shears, turns = (np.array(column) for column in zip(*knots, strict=True))
    time = np.cumsum([0.0, *(point.duration_s for point in press.path)])
    counts = shared_out(press.frames - 1, np.diff(time))
    recorded = [begin + (end - begin) * np.arange(1, n + 1) / n for begin, end, n in zip(time[:-1], time[1:], counts, strict=True)]
    return Motion(time, depths, forces, by_force, shears, turns, np.concatenate([[0.0], *recorded]))


def shared_out(states: int, seconds: Array) -> list[int]:
    """Recorded states of legs that take so long: one each, the others one by one to where they lie farthest apart in time."""
    counts = [1] * len(seconds)
    for _ in range(states - len(seconds)):
        counts[int(np.argmax(np.asarray(seconds) / counts))] += 1
    return counts


def widest(scene: Scene) -> Motion:
    """What a scene's motion reaches at most, for meshes, fields and mirror planes; the approach of a force is not known yet."""
    found = motion(scene.press)
    return straight(scene.press, 1.0 if scene.press.depth_mm is None else scene.press.depth_mm) if found is None else found
