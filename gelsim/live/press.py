"""`fidelity = "live"`: a press walked by the live sensor instead of solved by finite elements, as the same `Deformation`.

The object goes the way that the scene says (scene/motion.py), from first touch, recorded state after recorded state; where a force says how
far, the approach is found by Brent's method. The gel's face comes back as six-node faces over the sensor's grid, so that all that draws or
writes a press takes this one too.

The error is not computed from the press but looked up: beside finite elements (`gelsim bench --only live`, docs/studies/live_speed.py) it
depends on how deep the press is, and on whether the object is round where it touches.

Left out: what `gelsim.live` leaves out, such as viscous gels, grooves, the gel's sides; how a soft object's own surface is deformed; the
smallest det F, which nothing here has (NaN).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar
from scipy.spatial.transform import Rotation

from gelsim.errors import PressEnd, SceneError, SolveStatus
from gelsim.fem import rigid_placement
from gelsim.geometry import QuadraticSurface, split_faces
from gelsim.live.sensor import LiveFrame, LiveSensor, check_scene
from gelsim.results import Deformation, ErrorEstimate, SolveReport, SurfaceMotion
from gelsim.scene import materials
from gelsim.scene.definition import Scene
from gelsim.scene.motion import Motion, motion, straight
from gelsim.shape import shapes
from gelsim.shape.orientation import is_reoriented, turned
from gelsim.units import MM, MM_PER_M

Array = NDArray[np.float64]

ROUND = ("hemisphere",)
"""Shapes without an edge where they touch."""
COMPARED = ("flat", "dome")
"""Profiles of gels that were."""
SHARES = (0.0, 0.1, 0.25, 0.4, 0.6)
"""Approach over the gel's thickness."""
OF_ROUND = ((0.033, 0.033, 0.035, 0.051, 0.07), (0.0, 3.5, 4.6, 9.1, 13.3))
"""Worst relative error of the force, and of the height [µm], of round objects by `SHARES`: sheared, twisted, released and domes too;
at 0.6 forces of three balls beside `fast`."""
OF_EDGED = ((0.071, 0.071, 0.14, 0.28, 0.28), (0.0, 14.8, 47.0, 107.0, 107.0))
"""Likewise of all others, forces from 0.25 on of a sharp punch without friction beside `fast` (0.066 and 0.064 with), heights there without
the residual; deeper none was compared."""
OF_SOFT_ROUND = ((0.054, 0.054, 0.047, 0.047, 0.073), (0.0, 4.7, 7.4, 8.8, 16.1))
"""Likewise of soft balls: R 3 to 20 mm, Shore 00-10 to 70, SLENDER, friction 0 to 1."""
OF_SOFT_EDGED = ((0.363, 0.363, 0.099, 0.114, 0.114), (0.0, 9.2, 22.4, 42.5, 42.5))
"""Of the other soft ones; at 0.1 of a leaning cylinder, at 0.25 of a torus; deeper none was compared."""
OF_LOW_ROUND = ((0.011, 0.011, 0.035, 0.075, 0.075), (0.0, 1.6, 10.0, 31.0, 31.0))
"""Of balls lower than SLENDER: R 5 to 20 mm, 2 to 8 mm high, 30 Shore 00, straight down, beside `fast`; deeper none was compared."""
OF_LOW_EDGED = ((0.21, 0.21, 0.27, 0.35, 0.35), (0.0, 24.0, 69.0, 130.0, 130.0))
"""Of the other soft ones up to LOW: boxes, punches and a cylinder 2 to 6 mm high, forces of Shore 00-10 to 60 and without friction too:
their sides bulge under a pressure that is not even, and without friction the gel stiffens under a flat face."""
LOW = 2.5
"""Height over the gel's thickness."""
SLENDER = 1.0, 4.0
"""Height over radius of the soft balls that were compared in all motions: lower ones are slabs, higher ones rods."""
SOFTEST, MOST_LEAN_DEG = 0.7, 6.0
"""Modulus of these over the gel's, at least, and their tilt, at most."""
FORCE_TOLERANCE = 1e-3
"""Of a force that is sought."""
MOST_WALKS = 5
"""To a force: friction remembers the way, which has other steps than the search."""
FIRST_LOOK_MM = 0.05
"""Beyond where it stands, of the approach of a force; each look goes twice as far as the last."""


def expected_error(scene: Scene, approach_mm: float) -> tuple[float, float]:
    """Relative error of the force, and of the membrane [µm, root mean square over contact and neighbourhood], at an approach."""
    share = approach_mm / scene.gel.thickness_mm
    body = scene.object
    edged = body.shape not in ROUND
    low = body.height_mm <= LOW * scene.gel.thickness_mm if edged else body.height_mm < SLENDER[0] * body.radius_mm
    tables = (OF_LOW_ROUND, OF_LOW_EDGED) if low else (OF_SOFT_ROUND, OF_SOFT_EDGED)
    known = (OF_ROUND, OF_EDGED)[edged] if body.rigid else tables[edged]
    force, height = (float(np.interp(share, SHARES, values)) for values in known)
    return force, height


def live_error(scene: Scene) -> tuple[float, float] | None:
    """`expected_error` of a press that `live_press` is known to be good at, before it is walked; None of others.

    Those are round objects on a flat or domed, elastic gel without a coat, rigid or soft, up to the deepest that was compared with finite
    elements, and a thickness away from its sides, beyond which the baked gel goes on.
    """
    body, gel = scene.object, scene.gel
    deepest = shapes.furthest_approach(scene) * MM_PER_M
    bare = not gel.prony_g and gel.coat_n_per_m == 0.0
    suits = body.shape in ROUND and gel.profile in COMPARED and bare and motion(scene.press) is None
    if not suits or not (body.rigid or _known_soft(scene)) or deepest > SHARES[3] * gel.thickness_mm:
        return None
    assert body.radius_mm is not None
    wide = np.sqrt(2 * body.radius_mm * deepest) + gel.thickness_mm
    away = np.abs(scene.press.offset_mm) + np.abs(scene.press.shear_mm)
    return expected_error(scene, deepest) if (away + wide <= np.array(gel.size_mm) / 2).all() else None


def _known_soft(scene: Scene) -> bool:
    """Whether soft balls like a scene's were compared."""
    body, (gel, *several) = scene.object, materials.press_materials(scene)
    elastic = body.law == "neo-hookean" and not body.prony_g and len(several) == 1
    slender = SLENDER[0] * body.radius_mm <= body.height_mm <= SLENDER[1] * body.radius_mm
    upright = not is_reoriented(body) and np.hypot(*scene.press.tilt_deg) <= MOST_LEAN_DEG
    return elastic and slender and upright and several[0].youngs_modulus >= SOFTEST * gel.youngs_modulus


def live_press(scene: Scene, *, progress: Callable[[int, int], None] | None = None) -> Deformation:
    """Walks a press.

    Args:
        progress: Called with (states recorded, states wanted).
    Raises:
        SceneError: What `LiveSensor` has not, or the object goes deeper than DEEPEST of the gel's thickness.
    """
    press, way = scene.press, motion(scene.press)
    walk = _Walk(scene, np.array([*press.tilt_deg, 0.0]) if way is None else way.turn[0], progress)
    if way is not None:
        return walk.record(way.from_touch(walk.pivot[2]), None, PressEnd.PATH)
    if press.depth_mm is not None:
        return walk.record(straight(press, press.depth_mm), press.force_n, PressEnd.DEPTH)
    assert press.force_n is not None
    depth, end = walk.depth_of(press.force_n)
    for _ in range(MOST_WALKS):
        found = walk.record(straight(press, depth), None, end)
        reached = float(-found.force[-1, 2])
        if end is PressEnd.LIMIT or abs(reached - press.force_n) <= FORCE_TOLERANCE * press.force_n:
            break
        depth *= (press.force_n / reached) ** (2 / 3)  # as of a ball by Hertz
        walk.sensor.reset()
    return found


class _Walk:
    """One press."""

    def __init__(self, scene: Scene, begin: Array, progress: Callable[[int, int], None] | None) -> None:
        """`begin`: how it stands at first touch, (3,) [degrees]."""
        check_scene(scene, 'fidelity = "live"', "another fidelity")
        self.scene, self.begin, self.progress = scene, begin, progress
        self.clock = time.perf_counter()
        self.surface = shapes.rigid_surface(scene, frozenset())
        self.turn, shift = rigid_placement(scene)
        self.shift = shift * MM_PER_M
        self.pivot = np.array([*scene.press.offset_mm, self.shift[2]])
        self.sensor = LiveSensor(scene, image=False)

    def go(self, approach: float, shear: Array, turn: Array) -> LiveFrame:
        """Moves the object to an approach [mm], a shear [mm] and a turn [degrees] beyond first touch."""
        turned_by, shift = self.pose(approach, shear, turn)
        quaternion = Rotation.from_matrix(turned_by).as_quat()[[3, 0, 1, 2]]
        try:
            return self.sensor.step([*(shift * MM), *quaternion], 1.0)
        except SceneError as error:
            raise SceneError(f'fidelity = "live": at an approach of {approach:.3g} mm: {error}; or take another fidelity') from None

    def pose(self, approach: float, shear: Array, turn: Array) -> tuple[Array, Array]:
        """The object's turn (3, 3) and shift [mm]: it goes down and sideways, and turns about its pivot."""
        by = turned(turn) @ turned(self.begin).T
        return by @ self.turn, by @ (self.shift - self.pivot) + self.pivot + [*shear, -approach]

    def normal_force(self, approach: float, shear: Array, turn: Array) -> float:
        """At a pose, without going there [N]."""
        kept = self.sensor.state
        force = -self.go(approach, shear, turn).force[2]
        self.sensor.state = kept
        return float(force)

    def approach_of(self, force: float, start: float, shear: Array, turn: Array, most: float = np.inf) -> float:
        """Approach [mm] at which the normal force is `force` [N], sought from `start` on; `most` where it is not reached before."""

        def missing(approach: float) -> float:
            return self.normal_force(approach, shear, turn) - force

        here = missing(start)
        if abs(here) <= FORCE_TOLERANCE * force:
            return start
        step = -np.sign(here) * FIRST_LOOK_MM
        one, other = start, min(start + step, most)
        while (there := missing(other)) * here > 0.0:
            if other >= most:
                return most
            step *= 2.0
            one, here, other = other, there, min(other + step, most)
        return root_scalar(missing, bracket=(one, other), xtol=1e-6).root

    def depth_of(self, force: float) -> tuple[float, PressEnd]:
        """Depth [mm] of a press to a force [N], straight down, and what it ends at."""
        most = shapes.furthest_approach(self.scene) * MM_PER_M
        depth = self.approach_of(force, 0.0, np.zeros(2), self.begin, most)
        self.sensor.reset()
        return depth, PressEnd.LIMIT if depth >= most else PressEnd.FORCE

    def record(self, way: Motion, stop_n: float | None, end: PressEnd) -> Deformation:
        """Goes along a way, and says what was recorded."""
        sensor, knots = self.sensor, len(way.time)
        x, y = sensor.x, sensor.y
        nodes, faces = _grid(self.scene.gel.size_mm, x[1] - x[0], y[1] - y[0])
        rest = np.column_stack([nodes, shapes.gel_height(self.scene.gel, nodes)])
        states: list[tuple[float, float, LiveFrame, Array, Array, tuple[Array, Array], float]] = []
        time_s, approach, leg = 0.0, float(way.approach[0]), 1

        def keep(frame: LiveFrame, pose: tuple[Array, Array]) -> None:
            now = time.perf_counter()
            states.append((time_s, approach, frame, sensor.displaced(nodes), sensor.pressure_at(nodes), pose, now - self.clock))
            self.clock = now
            if self.progress is not None:
                self.progress(len(states), len(way.recorded))

        shear, turn = way.shear[0], way.turn[0]
        way = way.reached(0, approach, 0.0)
        keep(self.go(approach, shear, turn), self.pose(approach, shear, turn))
        stopped = False
        while leg < knots:
            due = way.recorded[way.recorded > time_s * (1 + 1e-12)]
            time_s = float(min(due[0] if len(due) else np.inf, way.time[leg]))
            approach_of_leg, force, shear, turn = way.at(leg, time_s)
            approach = self.approach_of(force, approach, shear, turn) if way.by_force[leg] else approach_of_leg
            before, frame = sensor.state, self.go(approach, shear, turn)
            if stop_n is not None and leg == 1 and -frame.force[2] >= stop_n:
                if -frame.force[2] > (1 + FORCE_TOLERANCE) * stop_n:
                    sensor.state = before
                    time_s = self.time_of(stop_n, way, states[-1][0], time_s)
                    approach, _, shear, turn = way.at(leg, time_s)
                    frame = self.go(approach, shear, turn)
                way, stopped, stop_n = way.stays_from(leg, time_s), True, None
            if np.isclose(way.recorded, time_s, rtol=1e-9).any():
                keep(frame, self.pose(approach, shear, turn))
            if time_s >= way.time[leg] * (1 - 1e-12):
                way = way.reached(leg, approach, float(-frame.force[2]))
                leg += 1
        return self._deformation(QuadraticSurface(rest, faces), states, PressEnd.FORCE if stopped else end)

    def time_of(self, force: float, way: Motion, low: float, high: float) -> float:
        """When [s], between two times of a way's first leg, the normal force reaches `force` [N]."""

        def missing(at: float) -> float:
            approach, _, shear, turn = way.at(1, at)
            return self.normal_force(approach, shear, turn) - force

        return root_scalar(missing, bracket=(low, high), xtol=1e-9).root

    def _deformation(self, gel: QuadraticSurface, states: list, end: PressEnd) -> Deformation:
        times, approach, frames, moved, pressure, poses, seconds = (list(part) for part in zip(*states, strict=True))
        cell = (self.sensor.x[1] - self.sensor.x[0]) * (self.sensor.y[1] - self.sensor.y[0])
        body = self.surface.nodes * MM_PER_M
        placed = body @ self.turn.T + self.shift
        object_moved = np.array([body @ turn.T + shift - placed for turn, shift in poses]) * MM
        count = len(states)
        force, membrane_um = expected_error(self.scene, max(approach))
        none = np.zeros(count, np.int32)
        deformation = Deformation(
            approach=np.array(approach) * MM,
            time=np.array(times),
            force=np.array([frame.force for frame in frames]),
            contact_area=np.array([frame.contact.sum() * cell for frame in frames]),
            contact_pressure=np.array(pressure),
            gel=SurfaceMotion(gel.nodes, split_faces(gel.faces), np.array(moved), gel.faces),
            object=SurfaceMotion(placed * MM, split_faces(self.surface.faces), object_moved, self.surface.faces),
            min_jacobian=np.full(count, np.nan),
            penetration=np.zeros(count),
            newton_iterations=none,
            linear_iterations=none,
            seconds=np.array(seconds),
            converged=np.ones(count, bool),
            status=SolveStatus.CONVERGED,
            report=SolveReport(symmetry=(), rigid_object=True, ended_by=end, error_estimate=ErrorEstimate(force, membrane_um)),
        )
        wanted = self.scene.press.force_n
        if end is PressEnd.LIMIT:
            deformation = deformation.warned(
                f"press.force_n = {wanted:g} N was not reached: the press ended at {approach[-1]:.3g} mm with {-frames[-1].force[2]:.3g} N"
            )
        away, thickness = self._from_sides(frames), self.scene.gel.thickness_mm
        if away < thickness:
            deformation = deformation.warned(
                f"the contact came {away:.2g} mm near the gel's side, beyond which the baked gel goes on: forces are too large "
                f"there. Stay its thickness away, {thickness:.3g} mm, or take another fidelity"
            )
        return deformation

    def _from_sides(self, frames: list[LiveFrame]) -> float:
        """How near to the gel's sides it was touched at most [mm]; infinite where it was not."""
        rows, columns = np.nonzero(np.any([frame.contact for frame in frames], axis=0))
        half = np.array(self.scene.gel.size_mm) / 2
        away = [
            side - np.abs(places[touched]).max(initial=-np.inf) * MM_PER_M
            for side, places, touched in ((half[0], self.sensor.x, columns), (half[1], self.sensor.y, rows))
        ]
        return float(min(away))


def _grid(size_mm: tuple[float, float], dx: float, dy: float) -> tuple[Array, NDArray[np.int32]]:
    """Places over the gel (N, 2) [m], about dx, dy apart, and six-node faces over them (F, 6): two in each square of three by three."""
    counts = [2 * max(1, round(size * MM / step / 2)) + 1 for size, step in zip(size_mm, (dx, dy), strict=True)]
    x, y = (np.linspace(-size / 2, size / 2, count) * MM for size, count in zip(size_mm, counts, strict=True))
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    number = np.arange(len(nodes)).reshape(counts[1], counts[0])
    a, b, c = number[:-2:2, :-2:2], number[:-2:2, 1:-1:2], number[:-2:2, 2::2]
    d, e, f = number[1:-1:2, :-2:2], number[1:-1:2, 1:-1:2], number[1:-1:2, 2::2]
    g, h, i = number[2::2, :-2:2], number[2::2, 1:-1:2], number[2::2, 2::2]
    lower, upper = np.stack([a, c, i, b, f, e], -1), np.stack([a, i, g, e, h, d], -1)
    return nodes, np.concatenate([lower.reshape(-1, 6), upper.reshape(-1, 6)]).astype(np.int32)
