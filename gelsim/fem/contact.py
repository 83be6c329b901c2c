"""Contact of the gel's outer surface with the object's surface: gap, pressure, friction, and their tangents.

Each quadrature point x of the gel's six-node faces (the slave's) looks along the outward normal of its own face for the object's (the
master's) curved faces, so a sphere has no facets, and meets them at y(ξ). With n that normal turned round, the gap is g = n·(x - y). n is
a function of the point's own face: unlike the normal of a closest place it jumps nowhere, and g is continuous over kinks and ridges of
the object. (A line that leaves the object's outline loses it, and what the point carried; where the gel wraps a rim it meets the flank.)
Pressure is a C² penalty per rest area of the slave, shifted by a multiplier λ (augmented Lagrangian, Simo and Laursen 1992):

    p = 0 (s ≤ 0),  k s²/(2ε) (0 < s < ε),  k (s - ε/2) (s ≥ ε),       s = λ/k - g.

It acts along n, on x and against it on y. k = c E/h of each face is soft enough that the quadratic faces, which cannot follow a sphere
exactly, do not turn their sub-micrometre misfit into pressure ripples; λ, the pressure projected on linear functions over the slave's
faces, then carries the load. What linear functions cannot hold, under a sharp rim, each point keeps for itself, but for the overlap that
the misfit is granted (LEFT_MM). Derivatives, with ν the master's normal at y, a_α the slave's tangents and a^α their duals:

    δg = ν·(δx - δy - g δn)/(ν·n),   δn = -a^α (n·δx,α),   δξ from  δx - δy - g δn - δg n = y,α δξ^α .

Friction goes the same way: with e the tangential slip of a point since the last load step (against the place on the master that it touched
then) and λ_t the traction multiplier, the trial traction is λ_t + k_t e, cut back to μp (friction.py) where it exceeds that. A point that
did not touch then slips only from where it does: while the master, moving by w in the step, closes the gap, it passes by (`begin_step`).
"stick" has no bound, and a point that parts drops its whole traction at once: where an equilibrium lies on that jump Newton finds none.
Points that touched when the solve began are tied then: they keep their traction through it, whether they part or not. Assembled is the
symmetric part, p' n nᵀ and friction's at constant p and n; `remainder` is the exact rest, unsymmetric. Far from equilibrium that is left
out, and the slipping tangent is replaced by its secant, which resists a reversal of the slip as well.

A rigid object is no surface but a distance (`RigidContact`, field.py). Left out: self-contact, adhesion, points of both surfaces at once
(`penetration` is what shows if one's are too few)."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu

from gelsim.fem.assembly import join_arrays
from gelsim.fem.contact_kernels import (
    Layout,
    add_remainder,
    contact_force,
    contact_tangent,
    field_gaps,
    friction_force,
    friction_tangent,
    gap_changes,
    place_points,
    surface_gaps,
    vec6d,
)
from gelsim.fem.elements import tri6_gradient, tri6_shape, triangle_quadrature
from gelsim.fem.field import DistanceField
from gelsim.fem.friction import slip_bounds
from gelsim.fem.pattern import PairPattern
from gelsim.geometry import split_faces
from gelsim.scene.definition import Contact

Array = NDArray[np.float64]

LEFT_MM = 3e-3  # overlap that the penalty bears where linear multipliers do not fit: with less, the membrane on a ball is further off
LOOKED_MM = 1.0  # distance within which every search for the other surface looks at least
SEEN = 8  # parts of a face's side between the places where overlap is looked for: 4 to 9 ms a state at `fast`; 32 find up to 4 µm more
# Corners of the four flat triangles of a six-node face (geometry.split_faces), in the face's (ξ1, ξ2).
_SUB_CORNERS = np.array(
    [[[0, 0], [0.5, 0], [0, 0.5]], [[0.5, 0], [1, 0], [0.5, 0.5]], [[0, 0.5], [0.5, 0.5], [0, 1]], [[0.5, 0], [0.5, 0.5], [0, 0.5]]]
)


# Arrays of SurfaceContact with an entry a point that change, and that do not (stiffnesses: an entry a face).
_STATE = ("face", "place", "normal", "gap", "pressure", "traction", "shift", "anchor_face", "anchor_place", "multiplier", "tied")
_CONSTANTS = ("weight", "stiffness", "stick")
_PLACES = ("face", "place", "gap", "anchor_face", "anchor_place")  # of a ContactState


@dataclass(frozen=True)
class ContactState:
    """Pairs, friction's history and what carries the load, to return to; an entry a point but for `multipliers`.

    Places stay on the device.
    """

    face: wp.array
    place: wp.array
    gap: wp.array
    anchor_face: wp.array
    anchor_place: wp.array
    multipliers: Array
    """(V, 4), at the slave's face vertices."""
    kept: Array
    """(P, 4)."""
    passed: Array
    """(P, 3)."""
    apart: Apart


@dataclass(frozen=True)
class Apart:
    """Points that face the master without touching it, where a load step begins."""

    points: NDArray[np.integer]
    """(K,)."""
    nodes: NDArray[np.int32]
    """Of the master's faces that they face, and how much each moves the place there, (K, n)."""
    shares: Array
    line: Array
    """Along which the gap is measured, towards the slave, (K, 3)."""
    gap: Array
    """[mm], (K,)."""


NOWHERE = Apart(np.zeros(0, int), np.zeros((0, 6), np.int32), np.zeros((0, 6)), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True)
class ContactLaw:
    """Constants of the penalty and of friction, in solver units."""

    stiffness: float
    """k·h [kPa]: the penalty of a face times its size h, the root of its area."""
    smoothing: float
    """ε [mm]."""
    friction: float
    """μ; 0 for none, -1 for sticking."""
    stick_stiffness: float
    """k_t·h [kPa], likewise."""

    @staticmethod
    def coefficient(contact: Contact) -> float:
        """μ of a scene's contact, as `friction` has it."""
        return -1.0 if contact.friction_coefficient == "stick" else float(contact.friction_coefficient)

    def borne(self, pressure: Array) -> Array:
        """Tractions [kPa] that friction bears at pressures [kPa]; inf where nothing slides."""
        return slip_bounds(self.friction, pressure) if self.friction >= 0.0 else np.full_like(pressure, np.inf)

    def slides(self, size: Array, pressure: Array) -> NDArray[np.bool_]:
        """Whether points slide, by the sizes of their tractions [kPa] as they were cut back."""
        return (size > 0.0) & (size >= self.borne(pressure) * (1 - 1e-9))


def rest_weights(rest: Array, faces: NDArray[np.int32], points: int) -> Array:
    """Share of each quadrature point in the area of its six-node face, (F, points)."""
    bary, rule = triangle_quadrature(points)
    tangents = np.einsum("fni,qnj->fqij", rest[faces], tri6_gradient(bary))
    return np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=-1) * rule


def _beside(rest: Array, faces: NDArray[np.int32], symmetry: frozenset[str]) -> NDArray[np.int32]:
    """Of each face the neighbours across its three sides (F, 3); -1 where the surface ends, -2 at a mirror plane."""
    middle = faces[:, 3:]
    found = np.full(middle.shape, -1, np.int32)
    order = np.argsort(middle.ravel(), kind="stable")
    sides = middle.ravel()[order]
    pairs = np.flatnonzero(sides[1:] == sides[:-1])
    one, two = order[pairs], order[pairs + 1]
    found.ravel()[one], found.ravel()[two] = two // 3, one // 3
    for axis in symmetry:
        plane = (found == -1) & (np.abs(rest[middle, "xy".index(axis)]) < 1e-9)
        found[plane] = -2
    return found


class SurfaceContact:
    """The slave's faces against the master's, with the state of the current iterate. Positions are given in mm."""

    turns_within = np.inf
    """Way of a point [mm] beyond which the normal there says nothing of where it came from: of an exact step at most."""
    CORNERS = 3
    """Vertices of a face; its other nodes are in the middle of its sides."""
    OBLIQUE = True
    """Whether gaps are told along the slave's normals; else they are distances."""
    STATE = _STATE

    def __init__(self, slave_faces: NDArray[np.int32], master_faces: NDArray[np.int32], rest: Array, law: ContactLaw, device: str,
                 points: int = 6, symmetry: frozenset[str] = frozenset()) -> None:  # fmt: skip
        self.law, self.device, self.points = law, device, points
        self.slave_faces, self.master_faces = slave_faces, master_faces
        bary = triangle_quadrature(points)[0]
        self.shape_values = tri6_shape(bary)
        self.rest_weight = rest_weights(rest, slave_faces, points).ravel()
        count = len(self.rest_weight)
        face_area = self.rest_weight.reshape(-1, points).sum(1)

        def array(data: object, dtype: object) -> wp.array:
            return wp.array(data, dtype=dtype, device=device)

        self.slave = array(slave_faces, wp.int32)
        self.master = array(master_faces, wp.int32)
        self.shape = array(self.shape_values, vec6d)
        self.own = array(bary[:, 1:], wp.vec2d)
        self.weight = array(self.rest_weight, wp.float64)
        self.beside = array(_beside(rest, master_faces, symmetry), wp.int32)
        self.corners = array(_SUB_CORNERS, wp.vec2d)
        self.scenes, self.nodes = 1, len(rest)
        self._tree: wp.Mesh | None = None  # grown at first use, where the bodies are: refitting keeps its order
        self.face = wp.full(count, -1, dtype=wp.int32, device=device)
        self.place = wp.zeros(count, dtype=wp.vec3d, device=device)
        self.normal = wp.zeros(count, dtype=wp.vec3d, device=device)
        self.gap = wp.full(count, 1e9, dtype=wp.float64, device=device)
        self.pressure = wp.zeros(count, dtype=wp.float64, device=device)
        self.traction = wp.zeros(count, dtype=wp.vec3d, device=device)
        self._k = np.repeat(law.stiffness / np.sqrt(face_area), points)
        self._kt = np.repeat(law.stick_stiffness / np.sqrt(face_area), points)
        self.stick = array(self._kt[::points], wp.float64)
        self.shift = wp.zeros(count, dtype=wp.vec3d, device=device)
        self.anchor_face = wp.full(count, -1, dtype=wp.int32, device=device)
        self.anchor_place = wp.zeros(count, dtype=wp.vec3d, device=device)
        self.tied = wp.zeros(count, dtype=wp.int32, device=device)
        self.multiplier = wp.zeros(count, dtype=wp.float64, device=device)
        self.stiffness = array(self._k[::points], wp.float64)
        self.vertices, local = np.unique(slave_faces[:, :3], return_inverse=True)
        self._corner = local.reshape(-1, 3)
        self._bary = bary
        mass = np.einsum("fq,qa,qb->fab", self.rest_weight.reshape(-1, points), bary, bary)
        rows = np.repeat(self._corner, 3, axis=1).ravel()
        columns = np.tile(self._corner, (1, 3)).ravel()
        matrix = sp.csc_matrix((mass.ravel(), (rows, columns)))
        # pressure, then the three components of traction: one across a mirror plane is zero on it
        self._projections = []
        for column in (None, 0, 1, 2):
            free = np.ones(len(self.vertices), bool)
            if column is not None and "xyz"[column] in symmetry:
                free = np.abs(rest[self.vertices, column]) > 1e-9
            self._projections.append((np.flatnonzero(free), splu(matrix[free][:, free])))
        self.multipliers = np.zeros((len(self.vertices), 4))
        self.kept = np.zeros((count, 4))
        """Pressure, and traction on the slave [kPa], beyond the multipliers, of every point."""
        self.passed = np.zeros((count, 3))
        """What of every point's motion along the master since the step began was before they touched [mm]."""
        self._apart = NOWHERE
        self.bend = wp.zeros(1, dtype=wp.mat33d, device=device)
        self.missing = wp.zeros(1, dtype=wp.int32, device=device)
        self._share()

    def _share(self) -> None:
        """What the kernels take once a scene, and how they find their scene."""
        self.layout = Layout()
        self.layout.points, self.layout.faces, self.layout.nodes = self.points, len(self.slave_faces), self.nodes
        self.geometric = wp.zeros(self.scenes, dtype=wp.float64, device=self.device)
        self.friction = wp.full(self.scenes, self.law.friction, dtype=wp.float64, device=self.device)

    @staticmethod
    def join(contacts: Sequence[SurfaceContact]) -> SurfaceContact:
        """One contact of many scenes with the same faces, for `update`, `add_force` and `add_tangent` in one launch each.

        The scenes' own contacts go on as views of its state. Its law is the first one's but for stiffnesses and friction.
        """
        joint = copy.copy(contacts[0])
        joint.scenes = len(contacts)
        joint.__dict__.pop("_corners", None)
        joint._tree = None
        for name in joint.STATE + _CONSTANTS:
            arrays = [getattr(contact, name) for contact in contacts]
            whole, length = join_arrays(arrays), len(arrays[0])
            setattr(joint, name, whole)
            for number, contact in enumerate(contacts) if name in joint.STATE else ():
                setattr(contact, name, whole[number * length : (number + 1) * length])
        joint._share()
        joint.friction.assign([contact.law.friction for contact in contacts])
        joint.frictional = any(contact.frictional for contact in contacts)
        return joint

    @cached_property
    def _corners(self) -> tuple[wp.array, wp.array, wp.array]:
        """The object's triangles: nodes of a scene that are their corners, places of all scenes' corners, and who is whose."""
        used, local = np.unique(split_faces(self.master_faces), return_inverse=True)
        indices = local.ravel() + len(used) * np.arange(self.scenes)[:, None]
        points = wp.zeros(self.scenes * len(used), dtype=wp.vec3f, device=self.device)
        used, indices = (wp.array(a.ravel(), dtype=wp.int32, device=self.device) for a in (used, indices))
        return used, indices, points

    @property
    def can_tie(self) -> bool:
        """Whether anything sticks, and may be tied (`augment`)."""
        return self.law.friction < 0.0

    @cached_property
    def frictional(self) -> bool:
        return self.law.friction != 0.0

    def _master_shape(self, place: Array) -> Array:
        """How much the six nodes of the master's faces move places (K, 3), ξ and a 0."""
        return tri6_shape(_barycentric(place))

    def _launch(self, kernel: wp.Kernel, *inputs: object) -> None:
        """One thread a quadrature point; every kernel begins with the slave's faces and their shape functions."""
        wp.launch(kernel, len(self.weight), [self.slave, self.shape, self.layout, *inputs], device=self.device)

    def update(self, x: wp.array, reach: float) -> None:
        """Places, normals and gaps of all quadrature points within `reach` [mm] for positions x."""
        used, triangles, points = self._corners
        wp.launch(place_points, len(points), [x, used, self.nodes, points], device=self.device)
        if self._tree is None:
            self._tree = wp.Mesh(points=points, indices=triangles)
        else:
            self._tree.refit()
        pairing = [self.face, self.place, self.normal, self.gap]
        self._launch(surface_gaps, x, self.own, self._tree.id, self.master, self.corners, self.beside, reach, *pairing)

    def overlap(self, x: wp.array) -> float:
        """The largest overlap [mm] anywhere on the slave's faces for positions x: also between the points, where nothing opposes it.

        Where gaps are told along the slave's normals it is the distance to the plane that touches the object where these meet it: of a
        convex object never less than the depth.
        """
        steps = np.arange(SEEN + 1)
        first, second = (grid.ravel() for grid in np.meshgrid(steps, steps))
        on = first + second <= SEEN
        seen = self._seen_at(np.stack([SEEN - first - second, first, second], axis=1)[on] / SEEN)
        seen.update(x, LOOKED_MM)
        gap = seen.gap.numpy()
        inside = np.flatnonzero(gap < 0.0)
        return float((-gap[inside] * (seen._cosines(x, inside) if self.OBLIQUE else 1.0)).max(initial=0.0))

    def _cosines(self, x: wp.array, points: NDArray[np.integer]) -> Array:
        """Of the angle between the two surfaces' normals where points look."""
        nodes = x.numpy()[self.master_faces[self.face.numpy()[points]]]
        first, second = np.einsum("knd,knc->dkc", tri6_gradient(_barycentric(self.place.numpy()[points])), nodes)
        across = np.cross(first, second)
        return np.abs((across * self.normal.numpy()[points]).sum(axis=1)) / np.linalg.norm(across, axis=1)

    def _seen_at(self, bary: Array) -> SurfaceContact:
        """The same surfaces with other points on the slave's faces (Q, 3), for `update` alone."""
        seen = copy.copy(self)
        seen.points, count = len(bary), len(bary) * len(self.slave_faces)
        seen.shape = wp.array(tri6_shape(bary), dtype=vec6d, device=self.device)
        seen.own = wp.array(bary[:, 1:], dtype=wp.vec2d, device=self.device)
        seen.weight = wp.zeros(count, dtype=wp.float64, device=self.device)
        seen.face = wp.full(count, -1, dtype=wp.int32, device=self.device)
        seen.place, seen.normal = (wp.zeros(count, dtype=wp.vec3d, device=self.device) for _ in range(2))
        seen.gap = wp.full(count, 1e9, dtype=wp.float64, device=self.device)
        seen._share()
        return seen

    def _normal_inputs(self) -> list[object]:
        """What the kernels of normal contact share."""
        pairing = [self.weight, self.master, self.face, self.place, self.normal, self.gap]
        return [*pairing, self.multiplier, self.stiffness, self.law.smoothing]

    def _friction_inputs(self) -> list[object]:
        """What the kernels of friction share."""
        pairing = [self.weight, self.master, self.normal, self.pressure, self.anchor_face, self.anchor_place]
        return [*pairing, self.shift, self.friction, self.stick, self.tied]

    def add_force(self, x: wp.array, force: wp.array) -> None:
        """Adds what contact and friction of the last `update` ask of the nodes, against their forces on them, to `force`."""
        self._launch(contact_force, *self._normal_inputs(), self.pressure, force)
        if self.frictional:
            self._launch(friction_force, x, *self._friction_inputs(), self.traction, force)

    def add_tangent(self, x: wp.array, pattern: PairPattern, values: wp.array, geometric: bool) -> bool:
        """Adds the tangent's symmetric part; False where the pattern lacks a pair (then build a new one from `node_pairs`).

        Without `geometric` only p' n nᵀ, and the secant of friction: far from equilibrium the pressures of a wrong overlap would make the
        rest indefinite.
        """
        self.geometric.fill_(1.0 if geometric else 0.0)
        self.missing.zero_()
        self.add_stiffness(x, pattern, values)
        return int(self.missing.numpy()[0]) == 0

    def add_stiffness(self, x: wp.array, pattern: PairPattern, values: wp.array) -> None:
        """`add_tangent` with the `geometric` that stands; sets `missing` where the pattern lacks a pair."""
        self._launch(contact_tangent, x, *self._normal_inputs(), self.bend, self.geometric, pattern, values, self.missing)
        if self.frictional:
            self._launch(friction_tangent, x, *self._friction_inputs(), self.geometric, pattern, values, self.missing)

    def remainder(self, x: wp.array, equation: wp.array, unknowns: int) -> Callable[[Array], Array] | None:
        """What the last `add_tangent` left out, as its product with a vector of unknowns; None where that is nothing."""
        if self.layout.rigid and not self.frictional:
            return None
        out = wp.zeros(unknowns, dtype=wp.float64, device=self.device)

        def product(v: Array) -> Array:
            out.zero_()
            self.add_remainder(x, equation, wp.array(v, dtype=wp.float64, device=self.device), out)
            return np.array(out.numpy(), np.float64)

        return product

    def add_remainder(self, x: wp.array, equation: wp.array, v: wp.array, out: wp.array) -> None:
        """Adds `remainder` of v to `out`, where `geometric` stands."""
        pairing = [self.weight, self.master, self.face, self.place, self.normal, self.gap, self.multiplier, self.stiffness]
        friction = [self.frictional, self.anchor_face, self.anchor_place, self.shift, self.friction, self.stick, self.tied]
        self._launch(add_remainder, x, self.own, *pairing, self.law.smoothing, self.bend, *friction, self.geometric, equation, v, out)

    def gap_changes(self, x: wp.array, equation: wp.array) -> Callable[[Array], Array]:
        """The derivative of all points' gaps, as its product with a vector of unknowns; 0 where a point meets nothing.

        Along the lines of a soft object's contact it is not the force's direction (`force_direction`).
        """
        out = wp.zeros(len(self.weight), dtype=wp.float64, device=self.device)
        pairing = [self.master, self.face, self.place, self.normal, self.gap]

        def product(v: Array) -> Array:
            along = wp.array(v, dtype=wp.float64, device=self.device)
            self._launch(gap_changes, x, self.own, *pairing, self.bend, equation, along, out)
            return np.array(out.numpy(), np.float64)

        return product

    def force_direction(self, points: NDArray[np.integer], equation: NDArray[np.int32], unknowns: int) -> sp.csr_matrix:
        """Matrix (P, unknowns) of paired points, the negative of which, transposed, takes their forces to nodal ones."""
        face, place, normal = self.face.numpy()[points], self.place.numpy()[points], self.normal.numpy()[points]
        return self._relative_motion(points, normal, face, place, equation, unknowns)

    def _relative_motion(self, points: NDArray[np.integer], vector: Array, face: NDArray[np.int32], place: Array,
                         equation: NDArray[np.int32], unknowns: int) -> sp.csr_matrix:  # fmt: skip
        """Matrix (P, unknowns) that takes displacements to vector·(motion of the point less that of the place on the master)."""
        nodes = np.concatenate([self.slave_faces[points // self.points], self.master_faces[face]], axis=1)
        weights = np.concatenate([self.shape_values[points % self.points], -self._master_shape(place)], axis=1)
        columns = equation[nodes, :3]
        values = weights[:, :, None] * vector[:, None, :]
        free = columns >= 0
        index = np.broadcast_to(np.arange(len(points))[:, None, None], columns.shape)
        return sp.csr_matrix((values[free], (index[free], columns[free])), shape=(len(points), unknowns))

    def slip(self, x: wp.array) -> Array:
        """Tangential slip [mm] of every point since the load step began, against the place on the master that it touched then, (P, 3).

        Zero where friction's traction is.
        """
        normal = self.normal.numpy()
        held = np.flatnonzero((self.anchor_face.numpy() >= 0) & (self.traction.numpy() != 0.0).any(axis=1))
        along = self._moved(held, x.numpy()) - self.passed[held]
        found = np.zeros((len(normal), 3))
        found[held] = along - (along * normal[held]).sum(axis=1, keepdims=True) * normal[held]
        return found

    def _moved(self, points: NDArray[np.integer], x: Array) -> Array:
        """What points have moved [mm] at nodes x against the places on the master that they met when the load step began, (K, 3)."""
        place = np.einsum("qn,qni->qi", self.shape_values[points % self.points], x[self.slave_faces[points // self.points]])
        shape = self._master_shape(self.anchor_place.numpy()[points])
        return place - np.einsum("qn,qni->qi", shape, x[self.master_faces[self.anchor_face.numpy()[points]]])

    def begin_step(self, moves: Array) -> None:
        """Foresees which points will touch in a load step, for which the nodes are expected to move by `moves` [mm] (N, 3).

        For the share of the step in which the motion w towards each other closes the gap such a point passes along the master.
        """
        if not self.frictional:
            return
        apart = self._apart
        own = np.einsum("kn,kni->ki", self.shape_values[apart.points % self.points], moves[self.slave_faces[apart.points // self.points]])
        w = np.einsum("kn,kni->ki", apart.shares, moves[apart.nodes]) - own
        closing = (w * apart.line).sum(axis=1)
        share = np.divide(apart.gap, closing, out=np.zeros(len(w)), where=closing > 0.0).clip(max=1.0)
        self.passed = np.zeros_like(self.passed)
        self.passed[apart.points] = share[:, None] * (closing[:, None] * apart.line - w)
        self.set_multipliers(self.multipliers)

    def settle(self) -> None:
        """Ends a load step: the multipliers take the tractions over, slip counts from the present places.

        Friction that linear functions cannot hold, over a sharp edge or where contact ends within a face, each point keeps.
        """
        self.augment()
        if self.frictional:
            traction = np.where(self.pressure.numpy()[:, None] > 0.0, self.traction.numpy(), 0.0)
            self.kept[:, 1:] = traction - self._at_points(self.multipliers[:, 1:])
            self.shift.assign(-traction)
            self.passed, self._apart = np.zeros_like(traction), self._facing()
        self.anchor_face.assign(self.face)
        self.anchor_place.assign(self.place)

    def _facing(self) -> Apart:
        """The points that face the master without touching it, by the last `update` and `add_force`."""
        face, gap = self.face.numpy(), self.gap.numpy()
        points = np.flatnonzero((face >= 0) & (gap > 0.0) & (self.pressure.numpy() <= 0.0))
        shares = self._master_shape(self.place.numpy()[points])
        return Apart(points, self.master_faces[face[points]], shares, self.normal.numpy()[points], gap[points])

    def go_on_from(self, here: ContactState, before: ContactState | None = None, ratio: float = 0.0) -> None:
        """Takes the multipliers, and what is kept beyond them, over from `here`; with `before`, gone on by `ratio` of the change since."""
        multipliers, self.kept = here.multipliers, here.kept.copy()
        if before is not None:
            multipliers = multipliers + ratio * (multipliers - before.multipliers)
            self.kept[:, 0] += ratio * (here.kept[:, 0] - before.kept[:, 0])
        self.set_multipliers(multipliers)

    def set_multipliers(self, at_vertices: Array) -> None:
        """Sets λ and λ_t [kPa] at the slave's face vertices, (V, 4); negative pressure becomes 0."""
        self.multipliers = at_vertices.copy()
        self.multipliers[:, 0] = np.maximum(at_vertices[:, 0], 0.0)
        at_points = self._at_points(self.multipliers)
        self.multiplier.assign(np.maximum(at_points[:, 0] + self.kept[:, 0], 0.0))
        if self.frictional:
            self.shift.assign(-at_points[:, 1:] - self.kept[:, 1:] - self._kt[:, None] * self.passed)

    def _at_points(self, at_vertices: Array) -> Array:
        """Linear functions over the slave's faces, (V, C), at the quadrature points, (P, C)."""
        return np.einsum("qa,fac->fqc", self._bary, at_vertices[self._corner]).reshape(-1, at_vertices.shape[1])

    def augment(self, left: float = LEFT_MM, tie_at: wp.array | None = None) -> None:
        """λ and λ_t become the present pressure and traction, projected (L²) on linear functions over the slave's faces.

        Pressure that these miss is kept by its points, but for what an overlap of `left` [mm] bears; inf: none is. With positions `tie_at`,
        of what sticks, points that touch are tied until the next augmentation; others stick from here on, should they come to touch.
        """
        tractions = self.pressure.numpy()[:, None]
        if self.frictional:
            touches = tractions > 0.0
            tractions = np.concatenate([tractions, np.where(touches, self.traction.numpy(), 0.0)], axis=1)
            tied = touches[:, 0] & (tie_at is not None)
            self.tied.assign(tied.astype(np.int32))
        count = tractions.shape[1]
        moment = np.einsum("fqc,qa->fac", (self.rest_weight[:, None] * tractions).reshape(-1, self.points, count), self._bary)
        at_vertices = np.zeros((len(self.vertices), 4))
        for c, (free, projection) in enumerate(self._projections[:count]):
            total = np.bincount(self._corner.ravel(), moment[..., c].ravel(), len(self.vertices))
            at_vertices[free, c] = projection.solve(total[free])
        pressure = tractions[:, 0]
        missed = pressure - self._at_points(np.maximum(at_vertices[:, :1], 0.0))[:, 0]
        self.kept = self.kept.copy()  # states that were saved hold it
        self.kept[:, 0] = np.where(pressure > 0.0, missed - np.clip(missed, -left * self._k, left * self._k), 0.0)
        if tie_at is not None:
            apart = np.flatnonzero(~tied & (self.anchor_face.numpy() >= 0))
            self.kept[apart, 1:] = -self._at_points(at_vertices[:, 1:])[apart]
            self.passed = self.passed.copy()
            self.passed[apart] = self._moved(apart, tie_at.numpy())
        self.set_multipliers(at_vertices)

    def projection(self, points: NDArray[np.integer]) -> tuple[sp.csr_matrix, SuperLU]:
        """What `augment` projects with: the vertices' linear functions at some points (P, V), and the factor of their mass matrix."""
        corners = self._corner[points // self.points]
        values = self._bary[points % self.points]
        rows = np.repeat(np.arange(len(points)), 3)
        shape = sp.csr_matrix((values.ravel(), (rows, corners.ravel())), shape=(len(points), len(self.vertices)))
        return shape, self._projections[0][1]

    def pairing(self) -> tuple[wp.array, wp.array, wp.array]:
        """Who touches where, as `update` left it and goes on from: kept faces depend on it."""
        return wp.clone(self.face), wp.clone(self.place), wp.clone(self.gap)

    def copy_pairing(self, kept: tuple[wp.array, wp.array, wp.array]) -> None:
        """Writes the present pairing over an earlier one."""
        for array, into in zip((self.face, self.place, self.gap), kept, strict=True):
            wp.copy(into, array)

    def set_pairing(self, pairing: tuple[wp.array, wp.array, wp.array]) -> None:
        for array, kept in zip((self.face, self.place, self.gap), pairing, strict=True):
            wp.copy(array, kept)

    def save(self) -> ContactState:
        """The present state, to return to when a step is halved."""
        places = {name: wp.clone(getattr(self, name)) for name in _PLACES}
        return ContactState(**places, multipliers=self.multipliers, kept=self.kept, passed=self.passed, apart=self._apart)

    def restore(self, state: ContactState) -> None:
        for name in _PLACES:
            wp.copy(getattr(self, name), getattr(state, name))
        self.kept, self.passed, self._apart = state.kept, state.passed, state.apart
        self.tied.fill_(0)
        self.set_multipliers(state.multipliers)

    def forget(self) -> None:
        """No history, no multipliers, no pairs: as it was made."""
        self.anchor_face.fill_(-1)
        self.tied.fill_(0)
        self.face.fill_(-1)
        self.kept, self.passed, self._apart = np.zeros_like(self.kept), np.zeros_like(self.passed), NOWHERE
        self.set_multipliers(np.zeros_like(self.multipliers))

    def inherit(self, before: SurfaceContact, x: wp.array, reach: float) -> None:
        """Goes on from what `before`, of the same two surfaces, had settled at positions x: its tractions, and no slip since."""
        self.forget()
        self.update(x, reach)
        self.set_multipliers(before.multipliers)
        self.anchor_face.assign(self.face)
        self.anchor_place.assign(self.place)

    def node_pairs(self, margin: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Node pairs (slave, master) that contact may couple in any scene: of points nearer than `margin` [mm], or than what their
        multiplier bears across, and of the faces around them."""
        own_face = np.arange(len(self.weight)) // self.points % len(self.slave_faces)
        gap, face = self.gap.numpy(), self.face.numpy()
        borne_across = self.multiplier.numpy() / np.repeat(self.stiffness.numpy(), self.points)
        near = (gap < np.maximum(margin, borne_across)) & (face >= 0)
        slave, master = own_face[near], face[near]
        if self.frictional:
            anchor = self.anchor_face.numpy()
            held = (anchor >= 0) & (near | (self.tied.numpy() > 0))
            slave, master = np.append(slave, own_face[held]), np.append(master, anchor[held])
        touching = sp.csr_matrix((np.ones(len(slave), bool), (slave, master)), shape=(len(self.slave_faces), len(self.master_faces)))
        own_nodes, nodes_around = self._incidence
        coupled = (own_nodes @ (touching @ nodes_around)).tocoo()
        return coupled.row, coupled.col

    @cached_property
    def _incidence(self) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """The slave's nodes against its faces, and the master's faces against the nodes of all faces that share a vertex with them."""

        def incidence(faces: NDArray[np.int32]) -> sp.csr_matrix:
            rows = np.repeat(np.arange(len(faces)), faces.shape[1])
            return sp.csr_matrix((np.ones(rows.size, bool), (rows, faces.ravel())))

        corners = incidence(self.master_faces[:, : self.CORNERS])
        return incidence(self.slave_faces).T.tocsr(), corners @ corners.T @ incidence(self.master_faces)


class RigidContact(SurfaceContact):
    """The slave's faces against a rigid body, which is a signed distance (field.py) and moves as a whole.

    `corners` are nodes of a tetrahedron that moves with it: the origin of its frame and the places SIDE along its axes. A place on the body
    is counted in them.
    """

    OBLIQUE = False
    STATE = (*_STATE, "bend")
    SIDE = 10.0
    """[mm]"""

    def __init__(self, slave_faces: NDArray[np.int32], corners: NDArray[np.integer], rest: Array, field: DistanceField, law: ContactLaw,
                 device: str, points: int = 6, symmetry: frozenset[str] = frozenset()) -> None:  # fmt: skip
        whole = np.array([[*corners, corners[-1], corners[-1]]], np.int32)
        super().__init__(slave_faces, whole, rest, law, device, points, symmetry)
        self.bend = wp.zeros(len(self.weight), dtype=wp.mat33d, device=device)
        self.field = field.grid(device)
        if law.friction >= 0.0:  # what sticks keeps its place on the object, and the normal there
            self.turns_within = field.rim  # along 1.6 of which the normal turns by a right angle

    def _share(self) -> None:
        super()._share()
        self.layout.rigid = True

    def _seen_at(self, bary: Array) -> SurfaceContact:
        seen = super()._seen_at(bary)
        seen.bend = wp.zeros(len(seen.weight), dtype=wp.mat33d, device=self.device)
        return seen

    def _master_shape(self, place: Array) -> Array:
        return body_shares(place)

    def update(self, x: wp.array, reach: float) -> None:
        """Gaps of all points that lie on the field's grid, whatever `reach`."""
        pairing = [self.face, self.place, self.normal, self.gap, self.bend]
        self._launch(field_gaps, x, self.master, self.field, wp.float64(self.SIDE), *pairing)


def _barycentric(place: Array) -> Array:
    """Barycentric coordinates (K, 3) of places (K, 3), ξ and a 0."""
    return np.column_stack([1 - place.sum(1), place[:, :2]])


def body_shares(place: Array) -> Array:
    """How much the six nodes (`RigidContact`: four corners, the last of them three times) move places (K, 3) of a rigid body."""
    return np.column_stack([1 - place.sum(1), place, np.zeros((len(place), 2))])
