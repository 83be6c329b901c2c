"""`gelsim.LiveBatch`: many live sensors of one kind at once, each with the same objects at poses of its own; on a GPU or the CPU.

    batch = gelsim.LiveBatch(gelsim.load_scene("scenes/press_ball_rigid.toml"), 1024, device="cuda")
    frame = batch.step(poses, dt=0.01)     # (1024, 1, 7), NumPy or torch; what comes out stays on the device

Each sensor answers as `gelsim.LiveSensor` would, and as if the others were not there (`gelsim.live.batch_layer`, `batch_kernels`). Of
several objects the gel meets over each cell the one that is lowest there.

Left out, beside what a live sensor leaves out: a patch for implicit steps (`LiveSensor.patch`), and a soft object beside others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from gelsim.errors import RenderError, SceneError
from gelsim.fem import quiet_warp
from gelsim.live import layer as single
from gelsim.live import soft, stiffening
from gelsim.live.layer import TINY, Layer
from gelsim.live.sensor import (
    BENDINGS,
    DEEPEST,
    MOST_TRAVEL_MM,
    RISE,
    STILL_MM,
    STUCK,
    baked_gel,
    check_overlap,
    check_scene,
    check_time,
)
from gelsim.live.underside import whole_field
from gelsim.membrane.markers import marker_layout
from gelsim.optics.camera import project
from gelsim.scene.definition import Body, Scene
from gelsim.units import MM, MM_PER_M

try:
    import torch
    from torch import Tensor
except ImportError as error:
    raise ImportError('gelsim.LiveBatch computes with PyTorch, which is not installed: pip install "gelsim[learn]"') from error

from gelsim.live.batch_kernels import FAR_MM, undersides
from gelsim.live.batch_layer import Answers, Layers, Residuals, Ways, bounded, read, stream
from gelsim.live.residual import Residual
from gelsim.live.stiffening import Scale

if TYPE_CHECKING:
    from gelsim.live.drawing import Drawer

LEVELS = 3
"""Heights at which the camera's projection is known; between them a parabola."""
FLATTEST = 0.05
"""Of a soft object's height: a layer no thicker counts as pressed flat."""


@dataclass(frozen=True, eq=False)
class BatchFrame:
    """What n sensors answer, as tensors on the device. The grid is `LiveBatch.x` and `y`: (rows, columns) of places in space."""

    image: Tensor | None
    """8-bit sRGB, shape (n, H, W, 3); None without pictures."""
    force: Tensor
    """On each gel by each object [N], shape (n, objects, 3); pressing gives negative z."""
    torque: Tensor
    """Of these forces about the origin of the gel's frame [N m], likewise."""
    contact: Tensor
    """Number of the object that touches a cell of the gel, -1 where none does: int8, shape (n, rows, columns)."""
    _batch: LiveBatch
    _state: State

    @cached_property
    def height(self) -> Tensor:
        """z of the coated surfaces over the grid's places [m], shape (n, rows, columns); found when first looked at."""
        return (self._batch._rest + self._batch._seen_field(self._state)[:, 2]) * MM

    @cached_property
    def marker_pixels(self) -> Tensor:
        """(column, row) of the marker centres [px], shape (n, K, 2); NaN outside the picture; found when first looked at."""
        return self._batch._marker_pixels(self._state)


@dataclass(frozen=True, eq=False)
class State:
    """Of n gels: as `gelsim.live.sensor.State`, over the whole grid. Fields that hold one value a sensor have n values."""

    thickness: Tensor
    """[mm]"""
    pressure: Tensor
    shear: Tensor
    moved: Tensor
    dragged: Tensor
    anchor: Tensor
    bound: Tensor
    owner: Tensor
    """Number of the object that is lowest over a cell, int8."""
    body: Tensor
    """Of a soft object `SoftBody.low`, `thickness` and `squash` (n, 3) [mm]."""
    springs: Tensor
    """As of `Ways`, (n, 9, 9)."""
    aside: Tensor
    """As `gelsim.live.sensor.State.bent`, (n, 2) [mm]."""

    def load(self, layer: Layer) -> Tensor:
        """Normal forces (n,) [mN]."""
        return self.pressure.sum(dim=(1, 2)).double() * (layer.cell[0] * layer.cell[1])

    def of(self, which: Tensor) -> State:
        """Of some sensors."""
        return State(*(getattr(self, field.name)[which] for field in fields(self)))

    def put(self, which: Tensor, other: State) -> State:
        """With some sensors' replaced."""
        return State(*(getattr(self, f.name).index_copy(0, which, getattr(other, f.name)) for f in fields(self)))


@dataclass(frozen=True, eq=False)
class Placed:
    """A soft object before each of n gels, as it is taken for an increment: as `gelsim.live.soft.Spring.placed` does."""

    turn: Tensor
    """(n, 3, 3)."""
    apex: Tensor
    """(n, 2) [mm]."""
    load: Tensor
    """(n,) [mN]."""
    above: Tensor
    """Its height above the apex over the cells (n, rows, columns) [mm]."""

    def of(self, which: Tensor) -> Placed:
        """Of some sensors."""
        return Placed(self.turn[which], self.apex[which], self.load[which], self.above[which])


class LiveBatch:
    """n gels with their cameras, and objects that move in the frame of each: of a soft one the base does."""

    def __init__(
        self, scene: Scene, sensors: int, objects: Sequence[Body] | None = None, *, image: bool = True, device: str = "auto"
    ) -> None:
        """Makes the tables: seconds, and with pictures some more once for each kind of sensor, whose light is then measured and kept.

        Args:
            scene: Its gel, contact, camera, lights, coating and markers count; its press does not.
            sensors: n.
            objects: Rigid ones, or one that is soft; without them the scene's own.
            image: Draw pictures each step.
            device: "auto" | "cpu" | "cuda".
        Raises:
            SceneError: One of several objects is soft, or a soft one or the gel is what a live sensor refuses.
            RenderError: CUDA was asked for and is not there.
        """
        if not isinstance(sensors, int) or sensors < 1:
            raise SceneError(f"sensors = {sensors}: a batch has 1 or more")
        self.objects = tuple(objects if objects is not None else (scene.object,))
        if not self.objects:
            raise SceneError("objects = []: a batch has 1 or more; leave it out for the scene's own")
        for body in self.objects:
            if not body.rigid and len(self.objects) > 1:
                raise SceneError("objects: one of several is soft; allowed are several with rigid = true, or a single soft one")
            check_scene(replace(scene, object=body), "a live sensor", "gelsim.press")
        if device == "cuda" and not torch.cuda.is_available():
            raise RenderError("device = 'cuda': PyTorch finds no GPU here; use device = 'cpu' or 'auto'")
        self.device = "cuda:0" if device == "cuda" or (device == "auto" and torch.cuda.is_available()) else "cpu"
        quiet_warp()
        self._scene = scene.replace(render=replace(scene.render, mode="baked"))
        self._count, gel = sensors, scene.gel
        self._layer, rest, self._friction = baked_gel(scene)
        self.x, self.y = self._layer.x * MM, self._layer.y * MM
        """Of the grid's columns and rows [m]."""
        self._rest = torch.as_tensor(rest, device=self.device)
        thinnest = max(gel.thickness_mm * (1.0 - single.THINNING * DEEPEST) + float(rest.min()), 0.05 * gel.thickness_mm)
        self._layers = Layers(self._layer, (1 - single.THINNER) * thinnest, 1.01 * gel.thickness_mm, self.device)
        self._learnt = Residuals(Residual(self._layer, gel.thickness_mm), self.device)
        self._law = stiffening.law().on(partial(torch.as_tensor, device=self.device))
        x, y = self._layers.x, self._layers.y
        self._rest_slope = self._layers.slope(self._rest)[:, None] if rest.any() else None
        self._places = [self._wp(part) for part in (x[0], y[:, 0], self._rest + RISE * DEEPEST * gel.thickness_mm)]
        """Of the cells' middles, and the heights up to which they are looked at [mm]."""
        self._fields = [whole_field(body)[0].grid(self.device) for body in self.objects]
        rigid = all(body.rigid for body in self.objects)
        self._spring, self._opposite = (None, None) if rigid else self._soft(float(rest.max() - rest.min()))
        self._centres = torch.as_tensor(marker_layout(scene).centres * MM_PER_M, device=self.device)
        self._draws = image
        self._shown: tuple[State, Tensor] | None = None
        if image:
            _ = self._drawer  # measures the light now
        self.reset()

    def _soft(self, drop: float) -> tuple[soft.Spring, Answers]:
        """The soft object's springs, on the device; and its layers' answers over the gel, which drops by so much [mm]."""
        gel, body = self._scene.gel, self.objects[0]
        spring = soft.spring(self._scene.replace(object=body), self._layer)
        lean, points = math.radians(soft.LEAN_DEG), whole_field(body)[1]
        below = float((np.hypot(points[:, 0], points[:, 1]) * math.sin(lean) - points[:, 2] * math.cos(lean)).max())
        lower = (1.0 + RISE + single.THINNING) * DEEPEST * gel.thickness_mm + drop
        self._flattest = max(spring.height - lower, FLATTEST * spring.height)
        opposite = Answers(spring.layer, self._flattest, spring.height + below, self.device, facing=self._layer.shape)
        lows, compliances = (torch.as_tensor(values, device=self.device) for values in (spring.lows, spring.compliances))
        return replace(spring, lows=lows, compliances=compliances), opposite

    @staticmethod
    def _wp(values: Tensor, kind: Any = wp.float32) -> wp.array:
        return wp.from_torch(values.contiguous(), dtype=kind)

    def reset(self, which: Any = None) -> None:
        """Forgets objects and slip of some sensors (numbers, or a mask (n,)); of all without."""
        n, device, (rows, columns) = self._count, self.device, self._layer.shape
        if which is None:
            nothing = torch.zeros((n, 3, rows, columns), device=device)
            thickness = torch.full((n,), float(self._scene.gel.thickness_mm), device=device, dtype=torch.float64)
            owner = torch.full((n, rows, columns), -1, dtype=torch.int8, device=device)
            self._unpressed = torch.zeros(3, device=device, dtype=torch.float64)
            if self._spring is not None:
                self._unpressed[1] = self._spring.height
            body = (
                self._unpressed.repeat(n, 1),
                torch.zeros((n, 9, 9), device=device),
                torch.zeros((n, 2), device=device, dtype=torch.float64),
            )
            of_face = nothing[:, 0], nothing[:, :2], nothing, nothing[:, :2], nothing[:, :2], nothing[:, 0]
            self._state = State(thickness, *of_face, owner, *body)
            self._turn = torch.eye(3, dtype=torch.float64, device=device).repeat(n, len(self.objects), 1, 1)
            self._shift = torch.zeros((n, len(self.objects), 3), dtype=torch.float64, device=device)
            self._known = torch.zeros(n, dtype=torch.bool, device=device)
            return
        mask = torch.zeros(n, dtype=torch.bool, device=device)
        mask[torch.as_tensor(which, device=device)] = True
        self._state = self._released(self._state, mask)
        self._known &= ~mask

    def _released(self, state: State, mask: Tensor) -> State:
        """With some sensors (n,) that touch nothing."""
        values = {f.name: getattr(state, f.name) for f in fields(state)}
        empty = {"thickness": float(self._scene.gel.thickness_mm), "owner": -1, "body": self._unpressed}
        return State(**{k: torch.where(mask.view(-1, *(1,) * (v.ndim - 1)), empty.get(k, 0), v).to(v.dtype) for k, v in values.items()})

    def step(self, poses: Any, dt: float) -> BatchFrame:
        """Moves the objects to poses and says what the sensors see and feel there; `LiveSensor.step` has the rules.

        Args:
            poses: x, y, z of each object's origin [m] and its turn, a quaternion w, x, y, z, in the frame of its gel, (n, objects, 7), or
                (n, 7) of one object: NumPy or torch, on any device.
            dt: Time since the last poses [s]. The gel is elastic: it must be positive, and changes nothing.
        Raises:
            SceneError: Poses are no poses or dt no time, or an object is deeper than DEEPEST of the gel's thickness, or soft and leans far.
        """
        check_time(dt)
        turn, shift = self._poses(poses)
        heights, owner = self._seen(turn, shift, self._state.aside)
        self._check(heights)
        way = self._way(turn, shift)
        pieces = (way / MOST_TRAVEL_MM).ceil().clamp(min=1.0)
        most = int(pieces.max()) if self._friction else 1
        begin = before = self._state, self._turn, self._shift, self._known
        try:
            for piece in range(1, most):
                part = (piece / pieces).double()[:, None]
                there = _between(*begin[1:3], turn, shift, part)
                self._increment(piece < pieces, *there, *self._seen(*there, self._state.aside))
            self._increment(torch.ones_like(self._known), turn, shift, heights, owner)
        except SceneError:
            self._state, self._turn, self._shift, self._known = before  # poses that are refused leave no trace
            raise
        return self._frame()

    def image(self) -> Tensor:
        """Pictures of the present state, 8-bit sRGB, (n, H, W, 3)."""
        return self._drawer.many(self._seen_field(self._state))

    @cached_property
    def _drawer(self) -> Drawer:
        from gelsim.live.drawing import Drawer  # and Mitsuba

        return Drawer(self._scene, self._layer, "cuda" if self.device != "cpu" else "cpu", self._count)

    def _poses(self, poses: Any) -> tuple[Tensor, Tensor]:
        """Turns (n, objects, 3, 3) and shifts [mm] (n, objects, 3)."""
        try:
            values = torch.as_tensor(poses, dtype=torch.float64, device=self.device)
        except (TypeError, ValueError, RuntimeError):
            values = torch.zeros(0)
        if values.ndim == 2 and len(self.objects) == 1:
            values = values[:, None]
        wanted = (self._count, len(self.objects), 7)
        if values.shape != wanted:
            raise SceneError(f"poses have the shape {tuple(values.shape)}; allowed is {wanted}: x, y, z [m] and a quaternion w, x, y, z")
        length = values[..., 3:].norm(dim=-1)
        sound = torch.isfinite(values).all(dim=-1) & ((length - 1).abs() <= 1e-3) & (values[..., :3].abs().amax(dim=-1) <= 1.0)
        if not bool(sound.all()):
            sensor, body = (int(i) for i in torch.nonzero(~sound)[0])
            raise SceneError(
                f"poses[{sensor}, {body}] = {values[sensor, body].tolist()}: allowed are finite metres within 1 m in the gel's frame, and "
                "a quaternion w, x, y, z of length 1 (no turn is 1, 0, 0, 0)"
            )
        w, x, y, z = (values[..., 3:] / length[..., None]).unbind(-1)
        turn = torch.stack([
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ], -1).unflatten(-1, (3, 3))  # fmt: skip
        return turn, values[..., :3] * MM_PER_M

    def _seen(self, turn: Tensor, shift: Tensor, aside: Tensor) -> tuple[Tensor, Tensor]:
        """Heights of the objects [mm] over the grid, (n, objects, rows, columns), and which of them is the lowest, (n, rows, columns).

        Args:
            aside: How a soft object is bent.
        """
        if self._spring is not None:
            shift = torch.cat([shift[..., :2] + aside[:, None], shift[..., 2:]], -1)
        found = torch.empty((len(self.objects), self._count, *self._layer.shape), device=self.device)
        for body, field in enumerate(self._fields):
            poses = self._wp(turn[:, body], wp.mat33d), self._wp(shift[:, body], wp.vec3d)
            inputs = [field, *poses, *self._places, self._wp(found[body])]
            wp.launch(undersides, (self._count, *self._layer.shape), inputs, device=self.device, stream=stream(found.device))
        heights = found.transpose(0, 1)
        return heights, heights.argmin(dim=1).to(torch.int8)

    def _check(self, heights: Tensor) -> None:
        overlap = -(heights.amin(dim=1) - self._rest).amin(dim=(1, 2))
        worst = int(overlap.argmax())
        check_overlap(f"poses[{worst}]", float(overlap[worst]), self._scene.gel.thickness_mm)

    def _way(self, turn: Tensor, shift: Tensor) -> Tensor:
        """The farthest that a cell in contact goes with its object [mm], (n,)."""
        state = self._state
        points = torch.stack([self._layers.x, self._layers.y, 0 * self._layers.x])
        there = points + torch.zeros_like(state.moved)
        there[:, 2] = self._rest + state.moved[:, 2]
        went = self._carried(there, state.owner, (self._turn, self._shift), (turn, shift)) - there
        return (went.norm(dim=1) * (state.pressure > 0)).amax(dim=(1, 2))

    @staticmethod
    def _carried(points: Tensor, owner: Tensor, one: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> Tensor:
        """Where points (n, 3, rows, columns) [mm] go that are on their objects as those go from one pose to another."""
        turn = other[0] @ one[0].transpose(-1, -2)
        shift = other[1] - (turn @ one[1][..., None])[..., 0]
        found = points
        for body in range(turn.shape[1]):
            moved = torch.einsum("nij,njrc->nirc", turn[:, body].float(), points) + shift[:, body].float()[:, :, None, None]
            found = moved if turn.shape[1] == 1 else torch.where((owner == body)[:, None], moved, found)
        return found

    def _increment(self, going: Tensor, turn: Tensor, shift: Tensor, heights: Tensor, owner: Tensor) -> None:
        """One, of the sensors that go on; again from where a soft object's apex lies once it is bent, up to BENDINGS times."""
        known, found = self._state, self._moved(going, turn, shift, heights, owner, self._state)
        again = going
        for _ in range(BENDINGS if self._spring is not None else 0):
            again = again & ((found.aside - known.aside).norm(dim=1) >= STILL_MM)
            if not bool(again.any()):
                break
            heights, owner = self._seen(turn, shift, found.aside)
            known, found = found, self._moved(again, turn, shift, heights, owner, found)
        if self._spring is not None:
            worst = int(found.body[:, 1].argmin())
            soft.check_flat(f"poses[{worst}]", float(found.body[worst, 1]), self._spring.height, self._flattest)
        at = going[:, None]
        self._state, self._known = found, self._known | going
        self._turn, self._shift = torch.where(at[..., None, None], turn, self._turn), torch.where(at[..., None], shift, self._shift)

    def _moved(self, going: Tensor, turn: Tensor, shift: Tensor, heights: Tensor, owner: Tensor, known: State) -> State:
        """Pressure, shear and thickness that go with each other at the new poses, of the sensors that go on.

        Args:
            known: Their first guess, which of soft objects says how they are bent, and the state of the others.
        """
        touching = going & ((heights.amin(dim=1) - self._rest).amin(dim=(1, 2)) < 0)
        if self._spring is not None:
            upright = torch.where(touching, turn[:, 0, 2, 2], 1.0)
            worst = int(upright.argmin())
            soft.check_lean(f"poses[{worst}]", float(upright[worst]))
        if bool((leaving := going & ~touching).any()):
            known = self._released(known, leaving)
        which = torch.nonzero(touching)[:, 0]
        if not len(which):
            return known
        state, guess, height = self._state.of(which), known.of(which), heights.amin(dim=1)[which]
        room, owner = height - self._rest, owner[which]
        way = None
        if self._friction:
            over = torch.where(height < FAR_MM / 2, height, 0.0)
            here = torch.stack(torch.broadcast_tensors(self._layers.x, self._layers.y, over), 1)
            one, other = (turn[which], shift[which]), (self._turn[which], self._shift[which])
            way = (here - self._carried(here, owner, one, other)) * self._known[which][:, None, None, None]
        began, state = state, replace(state, pressure=guess.pressure, shear=guess.shear, body=guess.body)
        placed = None
        if self._spring is not None:
            apex = shift[which, 0, :2] + guess.aside
            placed = Placed(turn[which, 0], apex, guess.load(self._layer), height - shift[which, 0, 2, None, None].float())
        return known.put(which, self._solved(state, began, way, room, owner, placed))

    def _solved(self, state: State, began: State, way: Tensor | None, room: Tensor, owner: Tensor, placed: Placed | None) -> State:
        """As `LiveSensor._move` alternates. Sensors leave as they are done.

        Args:
            began: Before the object went its `way`, as its points over the cells did (n, 3, rows, columns) [mm].
        """
        layers, rest, gel, body = self._layers, self._rest, self._scene.gel, state.body
        kept = replace(state, owner=owner)
        place = torch.arange(len(room), device=room.device)
        p, q, met, dragged, anchor, thickness = state.pressure, state.shear, state.moved, state.dragged, state.anchor, state.thickness
        bound = torch.zeros_like(p)
        bent, turned = torch.zeros_like(q), torch.zeros_like(room[:, :1, :1])
        apex = placed and placed.apex
        ways, softest = layers.ways(thickness), layers.stiffness(thickness)
        springs = self._springs(body, placed)
        facing = self._facing(ways, body, springs)
        if placed is not None:
            met, dragged = layers.moved(facing, p, q), layers.dragged(facing, q)
        if way is not None:
            face = (began.moved if placed is None else layers.moved(facing, began.pressure, began.shear))[:, 2]
            share = single.carried_share(began.pressure, face - room, -way[:, 2])
            anchor = layers.carried_along(anchor, share[:, None] * way[:, :2])
        for round in range(single.ROUNDS):
            before = p
            p, gap = layers.pressed(facing, room - met[:, 2], p, softest, -room.amin(dim=(1, 2), keepdim=True))
            total = p.sum(dim=(1, 2)).clamp(min=TINY).double()
            closer = gap - room
            sunk = closer if placed is None else -layers.moved(ways, p, q)[:, 2]
            back = layers.held_back(p, met[:, :2] - dragged, dragged) if self._friction else torch.zeros_like(p[:, :1, :1])
            now = gel.thickness_mm + (p * (rest - single.THINNING * back * sunk)).sum(dim=(1, 2)).double() / total
            same = (now / thickness - 1).abs() < single.SETTLED
            if placed is not None and self._spring is not None:
                low, squash = ((p * way).sum(dim=(1, 2)).double() / total for way in (placed.above, closer - sunk))
                height = self._spring.height
                own = torch.stack([low, height - low - single.THINNING * back.flatten() * squash, squash], 1)
                changed = (own - body).abs().amax(dim=1) > single.SETTLED * height
                same, body = same & ~changed, torch.where(changed[:, None], own, body)
            settled = single.SETTLED * p.flatten(1).norm(dim=1)
            done = same & ((p - before).flatten(1).norm(dim=1) < settled) & (turned.flatten() < settled) & (round > 0 or not self._friction)
            if bool(done.any()):
                found = State(thickness, p, q, met, dragged, anchor, bound, owner, body, springs, kept.aside[place]).of(done)
                kept = kept.put(place[done], found)
                left = ~done
                if not bool(left.any()):
                    break
                place, owner, room, body = place[left], owner[left], room[left], body[left]
                p, q, met, dragged, anchor, thickness = (v[left] for v in (p, q, met, dragged, anchor, thickness))
                bent, turned, now, same, sunk = (v[left] for v in (bent, turned, now, same, sunk))
                placed = placed and placed.of(left)
            thickness = torch.where(same, thickness, now)
            ways, softest = layers.ways(thickness), layers.stiffness(thickness)
            springs = self._springs(body, placed)
            facing = self._facing(ways, body, springs)
            bound = single.slip_limit(self._friction, p, q.transpose(0, 1), layers.slope(rest - sunk))
            held = bounded(q, bound[:, None])
            met = layers.moved(facing, p, held)
            if self._friction:
                moved = met if placed is None else layers.moved(ways, p, held)
                along, carried = layers.bending(p, moved, rest)
                last, bent = bent, layers.dragged(ways, along) + carried
                turned = softest * ((bent - last) * (p > 0)[:, None]).flatten(1).norm(dim=1)[:, None, None]
                slip = met[:, :2] + bent - anchor
                away = ((slip - dragged) * (p > 0)[:, None]).flatten(1).norm(dim=1)[:, None, None]
                q, free = layers.sheared(facing, slip, bound, held, away, softest)
                dragged = dragged + free - slip
                met = torch.cat([free + anchor - bent, met[:, 2:] + layers.lifted(facing, q - held)[:, None]], 1)
        else:
            kept = kept.put(place, State(thickness, p, q, met, dragged, anchor, bound, owner, body, springs, kept.aside[place]))
        return self._anchored(kept, apex)

    def _anchored(self, state: State, apex: Tensor | None) -> State:
        """With the displacement of the tractions found, how soft objects are bent, and the anchors of what slips moved on."""
        layers = self._layers
        ways = layers.ways(state.thickness)
        moved = met = layers.moved(ways, state.pressure, state.shear)
        if apex is not None:
            met = layers.moved(self._facing(ways, state.body, state.springs), state.pressure, state.shear)
            swung = layers.swung(state.springs, torch.cat([state.shear, state.pressure[:, None]], 1))
            at = torch.cat([torch.ones_like(apex[:, :1]), apex], 1)
            state = replace(state, aside=-(swung[:, :2].double() @ at[:, :, None])[:, :, 0])
        if not self._friction:
            return replace(state, moved=moved, anchor=met[:, :2])
        stuck = state.shear.square().sum(dim=1) < (STUCK * state.bound) ** 2
        along, carried = layers.bending(state.pressure, moved, self._rest)
        anchor = torch.where(stuck[:, None], state.anchor, met[:, :2] + layers.dragged(ways, along) + carried)
        return replace(state, moved=moved, anchor=anchor)

    def _springs(self, body: Tensor, placed: Placed | None) -> Tensor:
        """As of `State`."""
        if self._spring is None or placed is None:
            return torch.zeros((len(body), 9, 9), device=self.device)
        compliance = self._spring.compliance(placed.turn, placed.load, body[:, 0], body[:, 2])
        return self._layers.springs(compliance, placed.apex)

    def _facing(self, ways: Ways, body: Tensor, springs: Tensor) -> Ways:
        """Of gels against what they touch."""
        if self._opposite is None:
            return ways
        thickness = body[:, 1].clamp(min=self._flattest)  # of one that is flatter while it is looked for; at last it is refused
        return Ways(ways.answers + self._opposite.at(thickness), springs)

    def _frame(self) -> BatchFrame:
        layer, layers, state = self._layer, self._layers, self._state
        z = self._rest + state.moved[:, 2]
        force, torque = [], []
        for body in range(len(self.objects)):
            mine = state
            if len(self.objects) > 1:
                its = state.owner == body
                mine = replace(state, pressure=state.pressure * its, shear=state.shear * its[:, None])
            traction = self._tractions(mine, z)
            sums, by_z = traction.flatten(2) @ layers.arms, traction.flatten(2) @ z.flatten(1)[:, :, None]
            force.append(sums[:, :, 0])
            by = torch.cat([sums[:, :, 1:], by_z], 2)  # of force along i, times the place along j
            torque.append(torch.stack([by[:, j, i] - by[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1))], 1))
        newtons = layer.cell[0] * layer.cell[1] * MM**2 * 1e3  # from kPa
        contact = torch.where(state.pressure > 0, state.owner, -1).to(torch.int8)
        forces, torques = torch.stack(force, 1).double() * newtons, torch.stack(torque, 1).double() * newtons * MM
        return BatchFrame(self.image() if self._draws else None, forces, torques, contact, self, state)

    def _tractions(self, state: State, height: Tensor) -> Tensor:
        """Of one object, that others are told, along x, y and z [kPa], (n, 3, rows, columns); `height` of the face [mm]."""
        layers, pressure, moved = self._layers, state.pressure, state.moved[:, 2]
        slope, shear = layers.slope(height), torch.hypot(state.shear[:, 0], state.shear[:, 1])
        work, less = layers.work_and_less(state.thickness, pressure)
        thinner = (less / work.clamp(min=TINY)).flatten()
        scale = Scale(state.thickness.float(), thinner, layers.modulus, self._layer.cell[0] * self._layer.cell[1])
        more = self._law(torch.stack(stiffening.measures(scale, pressure, shear, layers.slope(pressure), moved, slope), 1))
        if self._spring is not None:
            facing = self._facing(layers.ways(state.thickness), state.body, state.springs)
            more = more * stiffening.share(pressure, moved, layers.moved(facing, pressure, state.shear)[:, 2])
        if self._rest_slope is not None:
            pressed = pressure.sum(dim=(1, 2), keepdim=True).clamp(min=TINY)
            slope = slope - (less / (2.0 * pressed)) * self._rest_slope
        found = torch.cat([state.shear + pressure[:, None] * slope.transpose(0, 1), -pressure[:, None]], 1)
        return (1.0 + more)[:, None, None, None] * found

    def _seen_field(self, state: State) -> Tensor:
        """As `gelsim.live.sensor.State.shown`, kept for who looks next."""
        if self._shown is None or self._shown[0] is not state:
            field = self._field(state)
            self._shown = state, field + self._learnt(field, state.pressure, state.shear)
        return self._shown[1]

    def _field(self, state: State) -> Tensor:
        """As `gelsim.live.sensor.State.field`: displacement over the grid [mm], (n, 3, rows, columns)."""
        layers, rest = self._layers, self._rest
        ways = layers.ways(state.thickness)
        facing = self._facing(ways, state.body, state.springs)
        along, carried = layers.bending(state.pressure, state.moved, rest)
        sideways = state.moved[:, :2] + layers.dragged(ways, along) + carried
        z = state.moved[:, 2]
        if self._friction:
            led = layers.led(state.pressure, state.moved, rest)
            z = z + led - layers.sunk(ways, layers.punch(facing, state.pressure > 0, led))
        return torch.cat([sideways, z[:, None]], 1)

    def _marker_pixels(self, state: State) -> Tensor:
        field = self._seen_field(state)
        start = self._centres.expand(self._count, -1, -1)
        at = start
        for _ in range(single.LOOKS):  # x = X + u_t(x)
            at = start + read(field[:, :2], self._layer, at).transpose(1, 2)
        z = read((self._rest + field[:, 2])[:, None], self._layer, at)[:, 0]
        pixels, heights = self._projection
        shares = []
        for i, one in enumerate(heights):
            others = [other for j, other in enumerate(heights) if j != i]
            shares.append(math.prod((z - other) / (one - other) for other in others))
        seen = read(pixels.expand(self._count, -1, -1, -1), self._layer, at)
        found = sum(share[..., None] * seen[:, 2 * i : 2 * i + 2].transpose(1, 2) for i, share in enumerate(shares))
        size = torch.as_tensor(self._scene.render.resolution, device=self.device)
        inside = ((found >= 0) & (found < size)).all(dim=-1, keepdim=True)
        return torch.where(inside, found, math.nan)

    @cached_property
    def _projection(self) -> tuple[Tensor, list[float]]:
        """Pixels of the grid's places at LEVELS heights, (1, 2 LEVELS, rows, columns), and these heights [mm]."""
        reach = self._scene.gel.thickness_mm
        heights = np.linspace(float(self._rest.min()) - DEEPEST * reach, RISE * DEEPEST * reach, LEVELS)
        x, y = np.meshgrid(self.x, self.y)
        found = [project(self._scene, np.stack([x, y, 0 * x + z * MM], -1).reshape(-1, 3)).T.reshape(2, *x.shape) for z in heights]
        return torch.as_tensor(np.concatenate(found), device=self.device)[None], heights.tolist()


def _between(turn: Tensor, shift: Tensor, to_turn: Tensor, to_shift: Tensor, part: Tensor) -> tuple[Tensor, Tensor]:
    """Poses on the way: straight, and turning evenly (Rodrigues' formula)."""
    turned = to_turn @ turn.transpose(-1, -2)
    axis = torch.stack([turned[..., j, i] - turned[..., i, j] for i, j in ((1, 2), (2, 0), (0, 1))], -1)
    length = axis.norm(dim=-1)
    angle = part * torch.atan2(length, turned.diagonal(dim1=-2, dim2=-1).sum(-1) - 1.0)
    unit = axis / length.clamp(min=1e-12)[..., None]
    x, y, z = unit.unbind(-1)
    none = torch.zeros_like(x)
    skew = torch.stack([none, -z, y, z, none, -x, -y, x, none], -1).unflatten(-1, (3, 3))
    sine, cosine = angle.sin()[..., None, None], angle.cos()[..., None, None]
    rotation = torch.eye(3, dtype=turn.dtype, device=turn.device) + sine * skew + (1 - cosine) * skew @ skew
    return rotation @ turn, shift + part[..., None] * (to_shift - shift)
