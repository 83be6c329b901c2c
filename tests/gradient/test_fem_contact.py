"""Contact and friction: forces and whole tangents against the twin and central differences, continuity over edges, faults seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp
from fem_fixtures import MM, Array, box_mesh

from gelsim.fem import reference
from gelsim.fem.contact import ContactLaw, RigidContact, SurfaceContact
from gelsim.fem.elements import triangle_quadrature
from gelsim.fem.field import exact_distance, sampled
from gelsim.fem.pattern import SymmetricPattern, build_pattern, pair_keys
from gelsim.geometry import quadratic_faces
from gelsim.scene.definition import Body

EPS = np.finfo(float).eps
K, SMOOTHING, MU = 1500.0, 5e-4, 0.4
RADIUS = 60.0
EDGE = 2.6 / 3  # of the object's faces [mm]
ROUNDED = 1e4 * EPS
"""Relative to the largest entry: gaps of micrometres, and of tenths of the smoothing, between places of 1 mm lose 1e3 to 1e4 ulps."""


class Pair:
    """A gel patch 2 x 2 mm under an object's patch that covers it, a ball's of R = 60 mm or a plane, every node of both free.

    With a `slope` the object is a roof whose ridge runs through the middle of the gel's faces. `symmetry`: planes that the object ends at.
    """

    def __init__(self, friction: float, curved: bool, overlap: float = 0.004, waves: float = 0.002, slope: float = 0.0,
                 symmetry: str = "", grid: tuple[float, float] = (-1.3, 1.3)) -> None:  # fmt: skip
        line = np.linspace(-1, 1, 3) * MM
        gel = box_mesh(line, line, np.array([-1.0, 0.0]) * MM, ("bonded", "coated", "side")).surface("coated")
        across, along = np.linspace(*grid, 4), np.linspace(-1.3, 1.3, 4)
        x, y = (a.ravel() for a in np.meshgrid(across, along, indexing="ij"))
        number = np.arange(16).reshape(4, 4)
        a, b, c, d = (number[i : 3 + i, j : 3 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
        down = np.vstack([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])  # outward is down
        body = quadratic_faces(np.column_stack([x, y, 0 * x]), down.astype(np.int32))
        nodes = body.nodes.copy()
        if curved:
            nodes[:, 2] = RADIUS - np.sqrt(RADIUS**2 - (nodes[:, :2] ** 2).sum(1))
        self.ridge = float(across[2])
        nodes[:, 2] += slope * np.abs(nodes[:, 0] - self.ridge) - overlap
        rng = np.random.default_rng(8)
        top = gel.nodes / MM
        # off the lattice, so that no point of the gel lies on an edge of the object's; wavy by less than the overlap
        top = top * [0.9, 0.87, 1] + [0.03, -0.05, 0] + waves * rng.uniform(-1, 1, top.shape)
        self.x = np.vstack([top, nodes])
        self.gel = np.arange(len(top))
        count = len(self.x)
        law = ContactLaw(K, SMOOTHING, friction, K / 3)
        faces = (body.faces + len(top)).astype(np.int32)
        self.contact = SurfaceContact(gel.faces, faces, self.x, law, "cpu", 6, frozenset(symmetry))
        self.at = triangle_quadrature(6)[0][:, 1:]
        a, b = np.triu_indices(count, 1)
        free = np.repeat([[True, True, True, False]], count, axis=0)
        self.pattern: SymmetricPattern = build_pattern(free, np.sort(pair_keys(a.astype(np.int32), b.astype(np.int32), count)), "cpu")

    def update(self, x: Array) -> None:
        self.contact.update(wp.array(x, dtype=wp.vec3d, device="cpu"), 1.0)

    def force(self, x: Array) -> Array:
        """Force on every node (N, 3) with the contact of positions x."""
        self.update(x)
        force = wp.zeros(len(x), dtype=wp.vec3d, device="cpu")
        self.contact.add_force(wp.array(x, dtype=wp.vec3d, device="cpu"), force)
        return force.numpy()

    def tangent(self, x: Array, d: Array) -> tuple[Array, Array]:
        """Products of what is assembled at the state of the last `force`, and of the remainder, with motions d (N, 3)."""
        at = wp.array(x, dtype=wp.vec3d, device="cpu")
        values = wp.zeros(len(self.pattern.indices), dtype=wp.float64, device="cpu")
        assert self.contact.add_tangent(at, self.pattern.pairs, values, True)
        upper = sp.csr_matrix((values.numpy(), self.pattern.indices, self.pattern.indptr))
        equation = wp.array(self.pattern.equation, dtype=wp.int32, device="cpu")
        product = self.contact.remainder(at, equation, self.pattern.size)
        assert product is not None and self.pattern.size == d.size
        return ((upper + sp.triu(upper, 1).T) @ d.ravel()).reshape(d.shape), product(d.ravel()).reshape(d.shape)

    def slide(self, shear: float) -> Array:
        """Settles at the present place, gives every vertex a multiplier, and moves the gel along by `shear` [mm]."""
        self.force(self.x)
        self.contact.settle()
        rng = np.random.default_rng(9)
        count = len(self.contact.vertices)
        self.contact.set_multipliers(np.column_stack([rng.uniform(2, 6, count), rng.uniform(-0.5, 0.5, (count, 3))]))
        moved = self.x.copy()
        moved[self.gel] += [shear, 0.4 * shear, 0.0]
        self.force(moved)
        return moved

    def places(self, x: Array) -> Array:
        """Of the gel's points (P, 3)."""
        return np.einsum("qn,fni->fqi", self.contact.shape_values, x[self.contact.slave_faces]).reshape(-1, 3)


def touching(pair: Pair) -> Array:
    return np.flatnonzero(pair.contact.pressure.numpy() > 0)


def by_twin(pair: Pair, x: Array, force: Callable[[Array, tuple], Array]) -> Array:  # type: ignore[type-arg]
    """Force (N, 3) at x, which may be complex, for the faces that points met in the last `force`.

    `force` is a point's by its eighteen nodes (gel's face, object's, object's at the step's begin) and what the twin needs to know else.
    """
    total, c = np.zeros_like(x), pair.contact
    met, anchors, stiffness, stick = (a.numpy() for a in (c.face, c.anchor_face, c.stiffness, c.stick))
    place, anchored, shift, multiplier = (a.numpy() for a in (c.place, c.anchor_place, c.shift, c.multiplier))
    tied = c.tied.numpy() > 0
    for i in np.union1d(touching(pair), np.flatnonzero(tied)):
        own = i // c.points
        nodes = np.concatenate([c.slave_faces[own], c.master_faces[met[i]], c.master_faces[anchors[i]]])
        law = ContactLaw(float(stiffness[own]), SMOOTHING, c.law.friction, float(stick[own]))
        known, held = (pair.at[i % c.points], place[i, :2], float(multiplier[i]), law), (anchored[i, :2], shift[i])
        np.add.at(total, nodes, c.rest_weight[i] * force(x[nodes], (known, held)))
    return total


def along(pair: Pair, x: Array, d: Array, force: Callable[[Array, tuple], Array]) -> Array:  # type: ignore[type-arg]
    """Derivative of `by_twin` along d."""
    return reference.derivative(lambda t: by_twin(pair, x + t * d, force), np.array(0.0))


def normal_part(nodes: Array, data: tuple) -> Array:  # type: ignore[type-arg]
    return np.concatenate([reference.contact_force(nodes, *data[0]), np.zeros((6, 3))])


def friction_part(nodes: Array, data: tuple) -> Array:  # type: ignore[type-arg]
    return reference.friction_force(nodes, *data[0], *data[1])


def whole(nodes: Array, data: tuple) -> Array:  # type: ignore[type-arg]
    return normal_part(nodes, data) + friction_part(nodes, data)


def along_the_objects(nodes: Array, data: tuple) -> Array:  # type: ignore[type-arg]
    """Fault: where the line meets the object, the normal is that of the object."""
    at, xi, multiplier, law = data[0]
    gap, _, there = reference.meeting(nodes, at, xi)
    force = reference.penalty_pressure(multiplier / law.stiffness - gap, law.stiffness, SMOOTHING) * reference.face_normal(
        nodes[6:12], there
    )
    shares = [reference.tri6_shape(np.array([1 - v.sum(), *v])) for v in (at, there)]
    return np.outer(np.concatenate([-shares[0], shares[1], np.zeros(6)]), force)


CASES = [(0.0, 0.0, False), (-1.0, 0.003, False), (5.0, 0.001, False), (MU, 0.01, True)]
CURVED, LAWS = pytest.mark.parametrize("curved", [False, True]), pytest.mark.parametrize(("friction", "shear", "slips"), CASES)


@CURVED
@LAWS
def test_force_matches_the_twin(friction: float, shear: float, slips: bool, curved: bool) -> None:
    pair = Pair(friction, curved)
    x = pair.slide(shear)
    force, active = pair.force(x), touching(pair)
    assert len(active) > 20
    size, p = np.linalg.norm(pair.contact.traction.numpy(), axis=1)[active], pair.contact.pressure.numpy()[active]
    if friction > 0:
        assert (size <= friction * p * (1 + 4 * EPS)).all()
    slipping = (size >= friction * p * (1 - 1e-9)) & (friction > 0)
    assert slipping.all() if slips else slipping.mean() < 0.2  # where contact ends next to nothing is pressed
    wanted = by_twin(pair, x, whole)
    scale = np.abs(wanted).max()
    assert scale > 0.1
    assert np.abs(force - wanted).max() <= ROUNDED * scale
    # what one body gets the other gives
    assert np.abs(force.sum(axis=0)).max() <= 100 * EPS * np.abs(force).sum()
    rubbed = by_twin(pair, x, friction_part)
    if friction == 0.0:
        assert np.abs(rubbed).max() == 0.0
        # and in one line
        straight = 100 * EPS * np.abs(force).sum()
        assert np.abs(np.cross(x, force).sum(axis=0)).max() <= straight
        # faults seen: the normal of the object's, as the gel is wavy by 2 µm over sides of 0.45 mm
        other = by_twin(pair, x, along_the_objects)
        assert np.abs(force - other).max() > 1e-3 * scale
        assert np.abs(np.cross(x, other).sum(axis=0)).max() > 1e4 * straight
    else:  # a sign turned in the friction is seen, and the gel is dragged against its slip: force is ∂/∂u, minus what acts on the gel
        assert np.abs(force - wanted + 2 * rubbed).max() > 0.02
        assert rubbed[pair.gel].sum(axis=0) @ [1.0, 0.4, 0.0] > 0


def off(found: Array, wanted: Array) -> float:
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


SEEN = 1e-3
"""Relative error of every planted fault at least: overlap and multipliers of micrometres over sides of 0.45 and 0.9 mm."""


@CURVED
@LAWS
def test_whole_tangent(friction: float, shear: float, slips: bool, curved: bool) -> None:
    """All nodes moving at once: to rounding that of the twin, and of central differences of the kernel's own force."""
    pair = Pair(friction, curved)
    x = pair.slide(shear)
    pair.force(x)
    d = np.random.default_rng(10).standard_normal(x.shape)
    assembled, rest = pair.tangent(x, d)
    wanted = along(pair, x, d, whole)
    assert off(assembled + rest, wanted) <= ROUNDED
    for fault in (assembled, assembled - rest, along(pair, x, d, along_the_objects) + along(pair, x, d, friction_part)):
        assert off(fault, wanted) > SEEN
    if slips:  # without the coupling of pressure and slip the tangent is wrong by about μ
        assert off(assembled, wanted) > 0.25 * friction
    # rounding: ulp of 1 mm over h = 1e-8, times a few; truncation: h²/ε² = 4e-10 at points inside the smoothing zone
    h = 1e-8
    numeric = (pair.force(x + h * d) - pair.force(x - h * d)) / (2 * h)
    assert np.linalg.norm(numeric) > 1.0, "a derivative that is zero would prove nothing"
    assert off(assembled + rest, numeric) < 1e-7


def test_what_is_tied_lets_go_once_that_is_settled() -> None:
    """A sheared gel that sticks is lifted: what is tied keeps its traction while it parts; what comes to touch begins with none."""
    pair = Pair(-1.0, True)
    x, contact = pair.slide(0.003), pair.contact
    contact.augment(tie_at=wp.array(x, dtype=wp.vec3d, device="cpu"))
    tied = contact.tied.numpy() > 0
    assert tied.sum() > 20 and (tied == (contact.pressure.numpy() > 0)).all()

    def dragged(lift: float) -> Array:
        """Traction on the gel's points, where it is lifted by so much [mm]; 4 µm of overlap to begin with."""
        moved = x.copy()
        moved[pair.gel, 2] -= lift
        pair.force(moved)
        return contact.traction.numpy().copy()

    def largest_jump() -> float:
        """Of a tied point's traction between places an eighth of the smoothing apart, as a share of the largest traction."""
        way = np.array([dragged(lift)[tied] for lift in np.arange(0.0, 0.02, SMOOTHING / 8)])
        return float(np.linalg.norm(np.diff(way, axis=0), axis=2).max() / np.linalg.norm(way, axis=2).max())

    assert largest_jump() < 1e-3  # lifting turns no normal
    down = dragged(-0.01)  # all touch, moved by the lift alone: next to nothing along the object
    assert (contact.pressure.numpy() > 0).sum() > tied.sum()
    assert np.linalg.norm(down[~tied], axis=1).max() < 0.1 * np.linalg.norm(down[tied], axis=1).max()
    dragged(0.02)
    contact.augment()
    assert not contact.tied.numpy().any() and not dragged(0.02).any()
    # planted: not tied, a point lets go at once
    contact.set_multipliers(np.ones_like(contact.multipliers))
    assert largest_jump() > 0.9


class RigidPair(Pair):
    """The same gel under a rigid ball of R = 5 mm that is 0.05 mm deep in it."""

    def __init__(self, friction: float) -> None:
        super().__init__(friction, False)
        ball = exact_distance(Body(shape="hemisphere", rigid=True, radius_mm=5.0))
        field = sampled(ball, np.array([-3.0, -3.0, -1.0]), np.array([3.0, 3.0, 2.0]), 0.1, 0.1)
        frame = np.vstack([np.zeros(3), RigidContact.SIDE * np.eye(3)]) - [0.0, 0.0, 0.05]
        self.x[len(self.gel) : len(self.gel) + 4] = frame
        corners = len(self.gel) + np.arange(4)
        self.contact = RigidContact(self.contact.slave_faces, corners, self.x, field, self.contact.law, "cpu", 6)


@pytest.mark.parametrize(("friction", "shear"), [(-1.0, 0.01), (MU, 0.01)], ids=["stick", "slip"])
def test_whole_tangent_under_a_rigid_body(friction: float, shear: float) -> None:
    """Of the gel's forces by its own motion, as the body is driven; what is assembled has the body's curvature already."""
    pair = RigidPair(friction)
    x = pair.slide(shear)
    pair.force(x)
    assert len(touching(pair)) > 20
    d = np.random.default_rng(10).standard_normal(x.shape)
    d[len(pair.gel) :] = 0.0
    assembled, rest = pair.tangent(x, d)
    h = 1e-8
    numeric = (pair.force(x + h * d) - pair.force(x - h * d)) / (2 * h)
    assembled, rest, numeric = (a[pair.gel] for a in (assembled, rest, numeric))
    assert off(assembled + rest, numeric) < 1e-7  # rounding, as above
    assert off(assembled, numeric) > SEEN and off(assembled - rest, numeric) > SEEN


@pytest.mark.parametrize("friction", [0.0, -1.0, MU])
@pytest.mark.parametrize("roof", [False, True])
def test_force_is_continuous_over_an_edge(roof: bool, friction: float) -> None:
    """Between faces of a ball, or over the ridge of a roof of 45°: the gel moves 1 nm, one of its points from one side to the other."""
    pair = Pair(friction, not roof, overlap=0.2 if roof else 0.004, waves=0.0, slope=float(roof))
    pair.slide(0.01)
    c, delta = pair.contact, 1e-6
    touched = touching(pair)
    place = pair.places(pair.x)[touched]
    point = touched[np.argmin(np.abs(place[:, 0] - pair.ridge) + 10 * (np.abs(place[:, 1]) > 0.8))]
    forces, faulty, faces, met = [], [], [], []
    for side in (-0.5, 0.5):
        x = pair.x.copy()
        x[pair.gel, 0] += pair.ridge - pair.places(pair.x)[point, 0] + side * delta
        forces.append(pair.force(x))
        faulty.append(by_twin(pair, x, along_the_objects))
        faces.append(c.face.numpy()[point])
        met.append(c.pressure.numpy()[point])
        c.face.fill_(-1)  # whatever the point met before
        assert np.abs(pair.force(x) - forces[-1]).max() <= ROUNDED * np.abs(forces[-1]).max()
        assert c.face.numpy()[point] == faces[-1]
    assert faces[0] != faces[1] and min(met) > 0.0, "the point must go over, or nothing is shown"
    # Of a point w (Σ|m| + Σ|N|) (dp + dt) at most, Σ|N| ≤ 5/3, dp = k δ tan 45°, dt = (k μ + k_t) δ, and w p Σ|dN|, 16 δ/edge at most.
    k, stick = (np.repeat(a.numpy(), c.points) for a in (c.stiffness, c.stick))
    rate = 10 / 3 * ((1 + max(friction, 0.0)) * k + stick) + 16 / EDGE * (1 + abs(friction)) * c.pressure.numpy()
    traction = np.linalg.norm(c.traction.numpy(), axis=1) * 16 / EDGE
    bound = delta * (c.rest_weight * (rate + traction)).sum()
    assert np.linalg.norm(forces[1] - forces[0], axis=1).sum() < bound
    assert c.rest_weight[point] * min(met) > 2 * bound, "a point lost there would pass"
    if roof:  # planted: the object's normal there, as that of a closest point, turns by 90°
        assert np.linalg.norm(faulty[1] - faulty[0], axis=1).sum() > 100 * bound


def test_a_line_that_misses_the_object_meets_nothing() -> None:
    """A curved face goes on beyond its rim as a parabola, through the gel that lies beside the object."""
    pair, rim = Pair(0.0, False, overlap=0.0, waves=0.0), 1.3
    x = pair.x.copy()
    body = np.arange(len(x)) > pair.gel.max()

    def arch(across: Array) -> Array:
        return 0.25 * (rim**2 - across**2) - 0.15

    x[body, 2] = arch(x[body, 0])  # its feet 0.15 mm in the gel
    x[pair.gel, 0] += rim - 0.3
    for moved in (0.0, 0.2):  # the second time from where the first left them
        x[pair.gel, 0] += moved
        force = pair.force(x)
        across = pair.places(x)[:, 0]
        beside = across > rim
        assert (arch(across[beside]) < -0.16).sum() > 5, "the parabola must cut into the gel, or nothing is shown"
        assert ((pair.contact.face.numpy() < 0) == beside).all()
        assert (pair.contact.gap.numpy()[beside] > 1.0).all() and (pair.contact.pressure.numpy()[beside] == 0.0).all()
        # feet are exact after two steps: rounding of lengths of 1 mm
        assert np.abs(pair.contact.gap.numpy() - arch(across))[~beside].max() < 100 * EPS
        assert np.abs(force).max() > 0.1


def test_a_mirror_planes_points_see_across_it() -> None:
    """A gel tilted by 45° at the plane x = 0, whose lines run out over it. Where the object just ends there they see nothing."""
    height = 0.06
    for plane in ("x", ""):
        pair = Pair(0.0, False, overlap=-height, waves=0.0, symmetry=plane, grid=(0.0, 2.6))
        x = pair.x.copy()
        x[pair.gel, 0] = 0.15 * (x[pair.gel, 0] - x[pair.gel, 0].min())
        pair.update(x)
        x[pair.gel, 2] += x[pair.gel, 0]
        pair.update(x)
        across = pair.places(x)[:, 0]
        beyond = 2 * across - height < 0.0
        assert 2 <= beyond.sum() < len(across) / 2
        face, gap = pair.contact.face.numpy(), pair.contact.gap.numpy()
        assert (face[~beyond] >= 0).all() and (face[beyond] >= 0).all() == (face[beyond] >= 0).any() == bool(plane)
        assert np.abs(gap - np.sqrt(2) * (height - across))[face >= 0].max() < 100 * EPS


def test_penalty_law() -> None:
    """p = φ', p' = slope, both continuous at 0 and ε."""
    s = np.array([-1e-3, 1e-5, 2e-4, SMOOTHING, 3e-3])
    pressure = np.diag(reference.derivative(lambda v: reference.penalty_potential(v, K, SMOOTHING), s))
    assert np.abs(pressure - reference.penalty_pressure(s, K, SMOOTHING)).max() <= 8 * EPS * K * s.max()
    below, above = SMOOTHING * (1 - 1e-9), SMOOTHING * (1 + 1e-9)
    for f in (reference.penalty_potential, reference.penalty_pressure):
        a, b = f(np.array([below, above]), K, SMOOTHING)
        assert a == pytest.approx(b, rel=1e-8)
    assert reference.penalty_pressure(np.array([-1e-9, 0.0, 1e-9]), K, SMOOTHING) == pytest.approx([0, 0, 0], abs=1e-9)


def test_friction_is_kept_from_step_to_step() -> None:
    """Over a ridge contact ends within faces; the next step begins with what the last one ended with."""
    pair = Pair(-1.0, False, overlap=0.4, slope=1.0)
    moved = pair.slide(0.05)
    contact = pair.contact
    held = contact.pressure.numpy() > 0
    share = held.reshape(-1, contact.points).mean(axis=1)
    assert ((share > 0) & (share < 1)).sum() > 2, "on whole faces only, nothing shown"
    before = contact.traction.numpy()[held]
    assert np.abs(before[:, 0]).max() > 10.0
    contact.settle()
    pair.force(moved)
    # sums and differences of a handful of numbers
    assert np.abs(contact.traction.numpy()[held] - before).max() <= 100 * EPS * np.abs(before).max()
    # what linear functions hold of it is no hundredth off but tenths
    contact.kept = np.zeros_like(contact.kept)
    contact.set_multipliers(contact.multipliers)
    pair.force(moved)
    assert np.abs(contact.traction.numpy()[held] - before).max() > 0.1 * np.abs(before).max()


def test_a_state_is_returned_to() -> None:
    """Whatever its points met in between."""
    pair = Pair(0.5, False, overlap=0.1, slope=1.0)
    moved = pair.slide(0.03)
    pair.contact.settle()
    force, saved = pair.force(moved), pair.contact.save()
    away = moved.copy()
    away[pair.gel] += [0.5, 0.2, 0.0]

    def back(restored: bool, met: bool = True) -> float:
        pair.force(away)
        pair.contact.settle()
        if restored:
            pair.contact.restore(saved)
        if not met:
            pair.contact.face.fill_(-1)
        return float(np.abs(pair.force(moved) - force).max() / np.abs(force).max())

    # rounding of a gap of 0.1 mm in lengths of 1 mm
    assert back(True) <= 1e3 * EPS
    assert back(True, met=False) <= 1e3 * EPS, "who meets whom is no history"
    assert back(False) > 0.01
