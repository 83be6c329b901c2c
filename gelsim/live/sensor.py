"""`gelsim.LiveSensor`: a sensor that answers each time the object moves, from the baked gel and the baked light.

    sensor = gelsim.LiveSensor(gelsim.load_scene("scenes/press_ball_rigid.toml"))
    frame = sensor.step((0, 0, -0.5e-3, 1, 0, 0, 0), dt=1 / 30)

One sensor, one object. `gelsim.live.layer` has the mechanics, `gelsim.live.underside` the object's shape, `gelsim.live.soft` how a soft one
gives way, docs/live.md what they are worth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gelsim.errors import SceneError
from gelsim.fem import quiet_warp
from gelsim.live import layer as gel_layer
from gelsim.live import stiffening
from gelsim.live.layer import Elastic, Layer, SoftBody, Values, Window
from gelsim.live.patch import Patch, torque
from gelsim.live.residual import Residual
from gelsim.live.stiffening import Scale
from gelsim.membrane.markers import marker_layout
from gelsim.optics.camera import marker_pixels
from gelsim.results import Membrane
from gelsim.scene import materials
from gelsim.scene.definition import Scene
from gelsim.shape.shapes import gel_height
from gelsim.units import KPA_PER_PA, MM, MM_PER_M

if TYPE_CHECKING:
    from gelsim.live.drawing import Drawer

Array = NDArray[np.float64]
Place = tuple[slice, slice]

MOST_TRAVEL_MM = 0.1
"""Of the object in one increment of friction; a longer step is cut."""
DEEPEST = 0.6
"""Indentation over thickness up to which it was measured; deeper ones are refused."""
RISE = 0.5
"""Of the deepest overlap: cells over which the object is no higher are looked at, as the gel rises beside a contact."""
WINDOW = 8
"""Cells by which the part of the grid that is looked at grows."""
BENDINGS = 2
"""Of a soft object's apex in an increment, at most: without, heights beside a sheared ball are 11 µm off, with one 6.4, with two 5.9."""
STILL_MM = 2e-3
"""Motion of the apex at which they end."""
STUCK = 0.999
"""Of the frictional bound, below which it sticks."""


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """What the sensor answers to one pose. The grid is `LiveSensor.x` and `y`: (rows, columns) of places in space."""

    image: NDArray[np.uint8] | None
    """8-bit sRGB, shape (H, W, 3); None without pictures."""
    force: Array
    """On the gel by the object [N], shape (3,); pressing gives negative z."""
    torque: Array
    """Of that force about the origin of the gel's frame [N m], shape (3,)."""
    contact: NDArray[np.bool_]
    """Where the object touches the gel, shape (rows, columns)."""
    _sensor: LiveSensor
    _state: State

    @cached_property
    def height(self) -> NDArray[np.float32]:
        """z of the coated surface over the grid's places [m], shape (rows, columns); found when first looked at."""
        return self._sensor._height(self._state)

    @cached_property
    def marker_pixels(self) -> Array:
        """(column, row) of the marker centres [px], shape (K, 2); NaN outside the picture; found when first looked at."""
        return self._sensor._marker_pixels(self._state)


@dataclass(frozen=True, eq=False)
class State:
    """Tractions on a window of the gel, and where its face is under them; of a gel that nothing touches the window has no cells."""

    window: Window
    body: SoftBody | None
    """What is over it, where that is soft."""
    place: Place
    """Rows and columns of the grid."""
    pressure: Values
    """[kPa], as all here over the window's rows and columns."""
    shear: Values
    """By friction, (2, rows, columns) [kPa]."""
    gel: Values
    """Height of the gel at rest [mm], over the whole grid."""
    moved: Values
    """Displacement (3, rows, columns) [mm] of what is now over a place."""
    met: Values
    """The same less that of the object's face there, which is 0 of a rigid one."""
    dragged: Values
    """About how much of that along the face the shear makes, (2, rows, columns) [mm]."""
    anchor: Values
    """Motion along the face at which nothing slips, (2, rows, columns) [mm]. Where it sticks it is not taken from the solution, whose
    rounding would add up."""
    bound: Values
    """Of shear (rows, columns) [kPa]."""
    friction: float
    """Coefficient."""
    learnt: Residual
    """Of the gel."""

    @property
    def facing(self) -> Window:
        """The window against the object."""
        return gel_layer.against(self.window, self.body)

    @property
    def load(self) -> float:
        """Normal force [mN]."""
        return float(self.pressure.sum()) * self.window.layer.cell[0] * self.window.layer.cell[1]

    @cached_property
    def bent(self) -> Array:
        """How far a soft object's apex has been moved along the gel, where its base has not, (2,) [mm]."""
        if self.body is None:
            return np.zeros(2)
        layer = self.window.layer
        return self.body.motion(layer.cell[0] * layer.cell[1], self.pressure, self.shear)[:2]

    @cached_property
    def stiffer(self) -> float:
        """How many times as large as here the tractions are that others are told."""
        if not self.pressure.any():
            return 1.0
        share = 1.0 if self.body is None else float(stiffening.share(self.pressure, self.moved[2], self.met[2]))
        return 1.0 + share * float(stiffening.law()(self.measures))

    @cached_property
    def measures(self) -> Values:
        """x that `stiffer` goes by."""
        window, (work, less) = self.window, self._work_and_less
        scale = Scale(
            window.thickness, np.float64(less / work), window.layer.material.shear_kpa, window.layer.cell[0] * window.layer.cell[1]
        )
        fields = self.pressure, np.hypot(*self.shear), window.slope(self.pressure), self.moved[2], self._face_slope
        return np.array(stiffening.measures(scale, *fields))

    @cached_property
    def _work_and_less(self) -> tuple[float, float]:
        return gel_layer.work_and_less(self.window, self.pressure)

    @cached_property
    def points(self) -> Array:
        """Middles of the cells that touch, on the deformed surface [mm], (M, 3)."""
        rows, columns = self.place
        row, column = np.nonzero(self.pressure)
        x, y = self.window.layer.x[columns], self.window.layer.y[rows]
        return np.stack([x[column], y[row], (self.rest + self.moved[2])[row, column]]).T

    @property
    def rest(self) -> Values:
        """Height of the gel at rest [mm]."""
        return self.gel[self.place]

    @cached_property
    def slope(self) -> Values:
        """Along x and y, (2, rows, columns): pressure acts along the normal of it.

        It is that of the face; and as the layer is as thick as the gel is where the pressure is, what the object is moved along to a place
        where it is thinner asks for work: the gel answers by a force, which goes by its slope at rest.
        """
        if not (self.gel.any() and self.pressure.any()):
            return self._face_slope
        _, less = self._work_and_less
        by: Any = np.float32(less / (2.0 * float(self.pressure.sum())))
        return self._face_slope - by * self.window.slope(self.rest)

    @cached_property
    def _face_slope(self) -> Values:
        return self.window.slope(self.rest + self.moved[2])

    @cached_property
    def field(self) -> Values:
        """Displacement over the whole grid [mm], (3, rows, columns)."""
        whole = self.window.layer.window(self.window.layer.shape, self.window.thickness)
        if self.pressure.size == 0:
            return np.zeros((3, *whole.shape), np.float32)
        p, q = self.over(self.pressure, whole.shape), self.over(self.shear, whole.shape)
        along, _ = self.window.bending(self.pressure, self.moved, self.rest)
        moved = whole.moved(p, q)
        led = whole.led(p, moved, self.gel) if self.friction and p.any() else None
        bent = whole.dragged(self.over(along, whole.shape))
        moved[:2] += bent + whole.carried(moved, moved[2] + (self.gel - gel_layer.level(self.pressure, self.rest)))
        if led is not None:
            (held,) = gel_layer.punch(self.facing, self.pressure > 0, led[None, *self.place])
            moved[2] += led - whole.sunk(self.over(held, whole.shape))
        return moved

    @cached_property
    def shown(self) -> Values:
        """The same with what the layer lacks: what is seen of the face. What is felt goes by `field` alone."""
        return self.field + self.learnt(*self.whole) if self.pressure.any() else self.field

    @property
    def whole(self) -> tuple[Values, Values, Values]:
        """Displacement, pressure and shear over the whole grid."""
        shape = self.window.layer.shape
        return self.field, self.over(self.pressure, shape), self.over(self.shear, shape)

    def over(self, values: NDArray, shape: tuple[int, int]) -> NDArray:
        """Values of the window's cells over the whole grid; 0 elsewhere."""
        wide = np.zeros((*values.shape[:-2], *shape), values.dtype)
        wide[..., *self.place] = values
        return wide

    def seen(self, place: Place) -> tuple[Values, Values, Values]:
        """Pressure, shear and anchor over another window."""
        if place == self.place:
            return self.pressure, self.shear, self.anchor
        shape = self.window.layer.shape
        anchor = self.field[:2].copy()  # of cells that do not touch yet, and are followed anew until they do
        anchor[:, *self.place] = self.anchor
        return self.over(self.pressure, shape)[place], self.over(self.shear, shape)[:, *place], anchor[:, *place]


class LiveSensor:
    """A gel, its camera, and one object that moves in its frame: of a soft one the base does."""

    def __init__(self, scene: Scene, *, image: bool = True, device: str = "auto") -> None:
        """Makes the tables: seconds, and with pictures some more once for each sensor, whose light is then measured and kept.

        Args:
            scene: Its gel, contact, camera, lights, coating, markers and object count; its press does not.
            image: Draw a picture each step, by the sensor's baked light; without, Mitsuba is not needed until `image()` is called.
            device: "auto" | "cpu" | "cuda", of the pictures.
        Raises:
            SceneError: The gel or the object is viscous, or the object has parts of other materials or another law than neo-Hooke's.
        """
        check_scene(scene, "a live sensor", "gelsim.press")
        quiet_warp()
        from gelsim.live import soft
        from gelsim.live.underside import Underside

        scene = scene.replace(render=replace(scene.render, mode="baked"))
        self._scene = scene
        self._layer, self._rest, self._friction = baked_gel(scene)
        self.x, self.y = self._layer.x * MM, self._layer.y * MM
        """Of the grid's columns and rows [m]."""
        self._learnt = Residual(self._layer, scene.gel.thickness_mm)
        self._object = Underside(scene.object)
        self._spring = None if scene.object.rigid else soft.spring(scene, self._layer)
        centres = marker_layout(scene).centres
        self._markers = np.column_stack([centres, gel_height(scene.gel, centres)])
        self._draws, self._device = image, device
        self._pose: tuple[Array, Array] | None = None
        self._punched: tuple[Window | None, NDArray[np.bool_], Array] = (None, np.zeros((0, 0), bool), np.zeros((0, 2)))
        if image:
            _ = self._drawer  # measures the light now
        self.reset()

    def reset(self) -> None:
        """Forgets the object: the gel is at rest and remembers no slip."""
        self._object.forget()
        self._release()
        self._pose = None
        self._clear = 0.0

    def _release(self) -> None:
        nothing = np.zeros((3, 0, 0), np.float32)
        window = self._layer.window(self._layer.shape, self._scene.gel.thickness_mm)
        at_rest = nothing[0], nothing[:2], self._rest, nothing, nothing, nothing[:2], nothing[:2], nothing[0]
        self._state = State(window, None, (slice(0, 0), slice(0, 0)), *at_rest, self._friction, self._learnt)

    def step(self, pose: ArrayLike, dt: float) -> LiveFrame:
        """Moves the object to a pose and says what the sensor sees and feels there.

        The way from the last pose is taken straight, in pieces of MOST_TRAVEL_MM: friction remembers it. The same poses after a `reset`
        give the same frames.

        Args:
            pose: x, y, z of the object's origin [m] and its turn, a quaternion w, x, y, z, in the gel's frame, (7,).
            dt: Time since the last pose [s]. The gel is elastic: it must be positive, and changes nothing.
        Raises:
            SceneError: pose is no pose or dt no time, or the object is deeper than DEEPEST of the gel's thickness, or soft and leans far.
        """
        check_time(dt)
        self._go(*_pose(pose))
        return self._frame()

    def ahead(self, pose: ArrayLike) -> Patch:
        """How the gel would answer at a pose: as `step` and `patch` would, but it stays where it is, and remembers nothing of it."""
        kept = self.state
        self._go(*_pose(pose))
        patch = self.patch()
        self.state = kept
        return patch

    @property
    def state(self) -> tuple[State, tuple[Array, Array] | None, float]:
        """Where object and gel are and what friction remembers, to return to: whole, and never changed."""
        return self._state, self._pose, self._clear

    @state.setter
    def state(self, kept: tuple[State, tuple[Array, Array] | None, float]) -> None:
        self._state, self._pose, self._clear = kept

    @property
    def clearance(self) -> float:
        """Least gap between object and gel along z at the last pose [m]; 0 where they touch, and before the first."""
        return self._clear * MM

    def _go(self, turn: Array, shift: Array) -> None:
        before = self._pose
        ways = [(turn, shift)]
        if before is not None and self._state.pressure.any() and self._friction:
            pieces = max(1, math.ceil(self._travel(before, (turn, shift)) / MOST_TRAVEL_MM))
            ways = [part_way(before, (turn, shift), part / pieces) for part in range(1, pieces)] + ways
        last, kept = self._seen(turn, shift), self.state
        try:
            for way in ways[:-1]:
                self._increment(way, self._seen(*way))
            self._increment((turn, shift), last)
        except SceneError:
            self.state = kept  # a pose that is refused leaves no trace
            raise

    def _increment(self, pose: tuple[Array, Array], seen: tuple[Place, Values, Values]) -> None:
        """One; again from where a soft object's apex lies once it is bent, up to BENDINGS times."""
        before, known = self.state, self._state
        self._move(pose, seen, known)
        for _ in range(BENDINGS if self._spring is not None else 0):
            last, known = known, self._state
            if np.linalg.norm(known.bent - last.bent) < STILL_MM:
                break
            self.state = before
            self._move(pose, self._seen(*pose, known), known)

    def image(self) -> NDArray[np.uint8]:
        """The picture of the present state, 8-bit sRGB, shape (H, W, 3): for a loop that steps more often than it looks."""
        return self._drawer.draw(self._state.shown)

    def marker_pixels(self) -> Array:
        """(column, row) of the marker centres in the present state [px], (K, 2); NaN outside the picture."""
        return self._marker_pixels(self._state)

    @cached_property
    def _drawer(self) -> Drawer:
        from gelsim.live.drawing import Drawer  # and Mitsuba

        return Drawer(self._scene, self._layer, self._device)

    def patch(self) -> Patch:
        """The cells that touch, and how their forces go on over a small motion: for an implicit step of a simulator around the sensor."""
        layer, state = self._layer, self._state
        touching = state.pressure > 0
        cell = layer.cell[0] * layer.cell[1] * MM**2 * 1e3 * state.stiffer  # kPa to N
        per_metre = cell / MM  # kPa/mm to N/m
        window, cells, springs = self._punched
        if window is not state.window or not np.array_equal(cells, touching):
            found = gel_layer.punch(state.facing, touching, np.ones((2 if self._friction else 1, *touching.shape), np.float32))
            springs = np.zeros((touching.sum(), 2))
            springs[:, : len(found)] = found[:, touching].T
            self._punched = state.window, touching, springs
        at_rest = state.window.slope(state.rest)
        return Patch(
            state.points * MM,
            (state.pressure[touching] * cell).astype(float),
            (state.shear[:, touching].T * cell).astype(float),
            at_rest[:, touching].T.astype(float),
            (state.slope - at_rest)[:, touching].T.astype(float),
            layer.cell[0] * layer.cell[1] * MM**2,
            (state.bound[touching] * cell).astype(float),
            self._friction,
            springs * per_metre,
        )

    def _travel(self, one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
        """The farthest that a point in contact goes along the gel [mm]."""
        points = self._state.points
        moved = (points - one[1]) @ one[0] @ other[0].T + other[1]
        return float(np.linalg.norm(moved - points, axis=1).max())

    def _seen(self, turn: Array, shift: Array, known: State | None = None) -> tuple[Place, Values, Values]:
        """Rows and columns over which the object may touch; its heights over them, and over the gel at rest [mm].

        Args:
            known: How a soft object is bent; left out, as now.
        """
        layer, gel = self._layer, self._scene.gel
        shift = shift + [*(known or self._state).bent, 0.0]
        low, high = self._object.low(RISE, turn, shift)
        rows, columns = (
            slice(max(0, int(np.searchsorted(way, low[i])) - WINDOW // 2), min(len(way), int(np.searchsorted(way, high[i])) + WINDOW // 2))
            for i, way in ((1, layer.y), (0, layer.x))
        )
        heights = self._object.heights(turn, shift, layer.x[columns], layer.y[rows])
        room = (heights - self._rest[rows, columns]).astype(np.float32, copy=False)
        overlap = -float(room.min(initial=math.inf))
        check_overlap("pose", overlap, gel.thickness_mm)
        return (rows, columns), heights, room

    def _move(self, pose: tuple[Array, Array], seen: tuple[Place, Values, Values], known: State) -> None:
        """Pressure, shear and thickness that go with each other at the new pose; of a soft object `known` says how it is bent."""
        layer, gel, state = self._layer, self._scene.gel, self._state
        (turn, shift), (region, heights, room) = pose, seen
        lowest = float(room.min(initial=math.inf))
        if lowest >= 0:
            self._release()
            self._pose, self._clear = (turn, shift), lowest
            return
        place = self._place(region, room < -RISE * lowest)
        *last, anchor = state.seen(place)
        p, q = (known.pressure, known.shear) if known.place == place else last
        inside = tuple(slice(part.start - whole.start, part.stop - whole.start) for part, whole in zip(place, region, strict=True))
        heights, room, rest = heights[inside], room[inside], self._rest[place]
        window, moved, met, dragged = state.window, state.moved, state.met, state.dragged
        body, spring = None, self._spring
        if spring is not None:
            put = partial(spring.placed, turn, shift[:2] + known.bent, known.load, layer.x[place[1]], layer.y[place[0]])
            body = put(0.0, spring.height, 0.0) if known.body is None else put(known.body.low, known.body.thickness, known.body.squash)
        if place != state.place:
            window = layer.window(p.shape, window.thickness)
        facing = gel_layer.against(window, body)
        if place != state.place or facing is not window:
            met, dragged = facing.moved(p, q), facing.dragged(q)
        if self._pose is not None and self._friction:
            # Where a point of the object that is now over a place came from.
            x, y = np.meshgrid(layer.x[place[1]], layer.y[place[0]])
            here = np.stack([x, y, np.where(heights < 1e2, heights, 0.0)]).reshape(3, -1) - shift[:, None]
            way = here - self._pose[0] @ turn.T @ here + (shift - self._pose[1])[:, None]
            *along, up = way.reshape(3, *p.shape).astype(np.float32)
            face = met[2] if known is state else facing.moved(*last)[2]
            share = gel_layer.carried_share(last[0], face - room, -up)
            anchor = gel_layer.carried_along(anchor, share * np.stack(along), layer.cell)
        solved = not self._friction  # a flat face that goes along the gel changes its shear alone
        bent, turned, bound = np.zeros_like(met[:2]), 0.0, np.zeros_like(p)
        for _ in range(gel_layer.ROUNDS):
            before = p
            p, gap = gel_layer.pressure(facing, room, p, room - met[2])
            total = float(p.sum())
            if total == 0.0:  # a touch that is less than rounding
                break
            sunk = gap - room if body is None else -window.moved(p, q)[2]
            thinning = gel_layer.THINNING * gel_layer.held_back(window, p, met[:2] - dragged, dragged) if self._friction else 0.0
            thickness = gel.thickness_mm + float((p * (rest - thinning * sunk)).sum()) / total
            same = abs(thickness / window.thickness - 1) < gel_layer.SETTLED
            if spring is not None and body is not None:
                low = float((p * (heights - shift[2])).sum()) / total
                squash = float((p * (gap - room - sunk)).sum()) / total
                own = spring.height - low - thinning * squash
                if max(abs(low - body.low), abs(own - body.thickness), abs(squash - body.squash)) > gel_layer.SETTLED * spring.height:
                    same, body = False, put(low, own, squash)
            settled = gel_layer.SETTLED * float(np.linalg.norm(p))
            if same and solved and float(np.linalg.norm(p - before)) < settled and turned < settled:
                break
            bound = gel_layer.slip_limit(self._friction, p, q, window.slope(rest - sunk))
            held = gel_layer.bounded(q, bound)
            if not (same and np.array_equal(p, before) and np.array_equal(held, q)):
                window = window if same else window.at(thickness)
                facing = facing if same else gel_layer.against(window, body)
                met = facing.moved(p, held)
            if self._friction:
                moved = met if body is None else window.moved(p, held)
                along, carried = window.bending(p, moved, rest)
                last, bent = bent, window.dragged(along) + carried
                turned = window.stiffness * float(np.linalg.norm((bent - last) * (p > 0)))
                slip: Any = met[:2] + bent - anchor
                q, left = gel_layer.shear(facing, slip, bound, held, float(np.linalg.norm((slip - dragged) * (p > 0))))
                dragged = dragged + left - slip
                met = np.stack([*(left + anchor - bent), met[2] + facing.lifted(q - held)])
                solved = True
        if not (window is state.window and np.array_equal(p, state.pressure) and np.array_equal(q, state.shear)):
            moved = window.moved(p, q)
            met = moved if body is None else facing.moved(p, q)
        stuck = q[0] ** 2 + q[1] ** 2 < (np.float32(STUCK) * bound) ** 2
        if self._friction:
            along, carried = window.bending(p, moved, rest)
            anchor = np.where(stuck, anchor, met[:2] + window.dragged(along) + carried)
        dragged, anchor = dragged.astype(np.float32, copy=False), anchor.astype(np.float32, copy=False)
        felt = window, body, place, p, q, self._rest, moved, met, dragged, anchor, bound
        self._state = State(*felt, self._friction, self._learnt)
        self._pose, self._clear = (turn, shift), 0.0

    def _place(self, region: Place, near: NDArray[np.bool_]) -> Place:
        """Rows and columns around some cells of a region and the next ones, which tell their slope: those of before, if they are enough and
        not too many."""
        found = []
        for axis, (part, now) in enumerate(zip(region, self._state.place, strict=True)):
            cells = part.start + np.flatnonzero(near.any(axis=1 - axis))
            first, last = max(part.start, int(cells[0]) - 1), min(part.stop, int(cells[-1]) + 2)
            count = min(WINDOW * math.ceil((last - first) / WINDOW), part.stop - part.start)
            if part.start <= now.start <= first and last <= now.stop <= part.stop and now.stop - now.start <= count + WINDOW:
                found.append(now)
            else:
                start = min(max((first + last - count) // 2, part.start), part.stop - count)
                found.append(slice(start, start + count))
        return found[0], found[1]

    def _frame(self) -> LiveFrame:
        layer, state = self._layer, self._state
        area = layer.cell[0] * layer.cell[1] * MM**2 * 1e3 * state.stiffer  # kPa to N
        touching = state.pressure > 0
        p = state.pressure[touching]
        tangential = state.shear[:, touching] + p * state.slope[:, touching]
        traction = (np.stack([*tangential, -p]).astype(np.float64) * area).T
        return LiveFrame(
            self.image() if self._draws else None,
            traction.sum(axis=0),
            torque(state.points * MM, traction),
            state.over(touching, layer.shape),
            self,
            state,
        )

    def _height(self, state: State) -> NDArray[np.float32]:
        return ((self._rest + state.shown[2]) * MM).astype(np.float32)

    def _marker_pixels(self, state: State) -> Array:
        membrane = Membrane(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 3), np.int32), self._spots(state))
        return marker_pixels(self._scene, membrane)

    def _spots(self, state: State) -> Array:
        """Where the markers are [m], (K, 3)."""
        return self._markers + self._displaced(state, self._markers[:, :2])

    def displaced(self, places: Array) -> Array:
        """Displacements [m], (M, 3), of the material points of the surface that rest over places (M, 2) [m]."""
        return self._displaced(self._state, places)

    def pressure_at(self, places: Array) -> Array:
        """Contact pressure [Pa], (M,), on the material points of the surface that rest over places (M, 2) [m]."""
        state = self._state
        whole = state.over(state.pressure * np.float32(state.stiffer), self._layer.shape)
        return self._read(whole, self._now_at(state, places), gel_layer.between).astype(float) / KPA_PER_PA

    def _now_at(self, state: State, places: Array) -> Array:
        """Where on the grid [mm], (M, 2), the points that rest over places (M, 2) [m] have come to."""
        rest = places * MM_PER_M
        at = rest
        for look in range(gel_layer.LOOKS, 0, -1):  # x = X + u_t(x)
            between = gel_layer.between if look > 1 else gel_layer.smooth_between
            at = rest + self._read(state.shown[:2], at, between).T
        return at

    def _displaced(self, state: State, places: Array) -> Array:
        at = self._now_at(state, places)
        height = self._read(state.shown[2], at) * MM + gel_height(self._scene.gel, at * MM)
        return np.column_stack([at * MM - places, height - gel_height(self._scene.gel, places)])

    def _read(self, values: Values, at: Array, between: Callable = gel_layer.smooth_between) -> NDArray[np.floating]:
        """Of the grid, (..., M), at places (M, 2) [mm]."""
        layer = self._layer
        return between(values, (at[:, 1] - layer.y[0]) / layer.cell[1], (at[:, 0] - layer.x[0]) / layer.cell[0])


def baked_gel(scene: Scene) -> tuple[Layer, Values, float]:
    """Of a scene's gel: its layer, its height at rest over the layer's cells [mm], and the coefficient of friction."""
    gel, material = scene.gel, materials.gel_material(scene)
    layer = gel_layer.shared(gel.size_mm, Elastic(material.mu * KPA_PER_PA, material.poissons_ratio, gel.coat_n_per_m))
    places = np.stack(np.meshgrid(layer.x * MM, layer.y * MM), axis=-1)
    rest = gel_height(gel, places.reshape(-1, 2)).reshape(layer.shape).astype(np.float32) * np.float32(MM_PER_M)
    friction = gel_layer.STICK if scene.contact.friction_coefficient == "stick" else float(scene.contact.friction_coefficient)
    return layer, rest, friction


def check_time(dt: float) -> None:
    """Raises SceneError where a step's time [s] is none."""
    if not (isinstance(dt, (int, float)) and math.isfinite(dt) and dt > 0):
        raise SceneError(f"dt = {dt!r} s: a step's time is a positive number, for example 0.033")


def check_overlap(where: str, overlap: float, thickness: float) -> None:
    """Raises SceneError where an object is deeper in a gel than DEEPEST of its thickness [mm]."""
    if overlap > DEEPEST * thickness:
        raise SceneError(
            f"{where}: the object overlaps the gel by {overlap:.2f} mm; allowed is {DEEPEST:g} of gel.thickness_mm = "
            f"{thickness:g} mm, so {DEEPEST * thickness:.2f} mm; press less deep, or use finite elements (gelsim.press)"
        )


def check_scene(scene: Scene, who: str, instead: str) -> None:
    """Raises SceneError where `who` asks for what the baked gel has not; `instead` has."""
    body = scene.object
    if not body.rigid:
        if len(parts := materials.parts(body)) > 1:
            raise SceneError(f"object.{parts[1]}: {who} has soft objects of one material; leave it out, or use {instead}")
        for name, given in (("prony_g", list(body.prony_g)), ("law", body.law if body.law != "neo-hookean" else "")):
            if given:
                raise SceneError(f"object.{name} = {given!r}: {who} has neo-Hookean, elastic objects; leave it out, or use {instead}")
    if scene.gel.prony_g:
        raise SceneError(f"gel.prony_g = {list(scene.gel.prony_g)}: {who} has an elastic gel; leave it out, or use {instead}")


def _pose(pose: ArrayLike) -> tuple[Array, Array]:
    """The turn (3, 3) and the shift [mm] of a pose."""
    try:
        values = np.asarray(pose, float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.shape != (7,) or not np.isfinite(values).all():
        raise SceneError(f"pose = {pose!r}: allowed are 7 finite numbers: x, y, z [m] and a quaternion w, x, y, z")
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1) > 1e-3:
        raise SceneError(f"pose: its quaternion has the length {length:.4g}; allowed is 1 (w, x, y, z; no turn is 1, 0, 0, 0)")
    if np.abs(values[:3]).max() > 1.0:
        raise SceneError(f"pose: {values[:3].tolist()} m is over 1 m away; allowed are metres in the gel's frame, such as 0, 0, -0.0005")
    return Rotation.from_quat(np.roll(values[3:], -1)).as_matrix(), values[:3] * MM_PER_M


def part_way(one: tuple[Array, Array], other: tuple[Array, Array], part: float) -> tuple[Array, Array]:
    """A pose on the way: straight, and turning evenly."""
    turned = Rotation.from_matrix(other[0] @ one[0].T).as_rotvec() * part
    return Rotation.from_rotvec(turned).as_matrix() @ one[0], one[1] + part * (other[1] - one[1])
