"""Contact and friction: forces against the twin's potential, tangents against the twin and against central differences, faults seen."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp
from fem_fixtures import MM, Array, box_mesh

from gelsim.fem import reference
from gelsim.fem.contact import ContactLaw, SurfaceContact
from gelsim.fem.pattern import SymmetricPattern, build_pattern, pair_keys
from gelsim.geometry import quadratic_faces

EPS = np.finfo(float).eps
K, SMOOTHING, MU = 1500.0, 5e-4, 0.4
RADIUS = 60.0
EDGE = 2.6 / 3  # of the object's faces [mm]


class Pair:
    """A gel patch 2 x 2 mm under an object's patch that covers it, a ball's of R = 60 mm or a plane, every node of both free.

    With a `slope` the object is a roof whose ridge runs through the middle of the gel's faces.
    """

    def __init__(self, friction: float, curved: bool, overlap: float = 0.004, waves: float = 0.002, slope: float = 0.0) -> None:
        line = np.linspace(-1, 1, 3) * MM
        gel = box_mesh(line, line, np.array([-1.0, 0.0]) * MM, "bonded", "coated", "side").surface("coated")
        grid = np.linspace(-1.3, 1.3, 4)
        x, y = (a.ravel() for a in np.meshgrid(grid, grid, indexing="ij"))
        number = np.arange(16).reshape(4, 4)
        a, b, c, d = (number[i : 3 + i, j : 3 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
        down = np.vstack([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])  # outward is down
        body = quadratic_faces(np.column_stack([x, y, 0 * x]), down.astype(np.int32))
        nodes = body.nodes.copy()
        if curved:
            nodes[:, 2] = RADIUS - np.sqrt(RADIUS**2 - (nodes[:, :2] ** 2).sum(1))
        nodes[:, 2] += slope * np.abs(nodes[:, 0] - grid[2]) - overlap
        rng = np.random.default_rng(8)
        top = gel.nodes / MM
        # off the lattice, so that no point of the gel lies on an edge of the object's; wavy by less than the overlap
        top = top * [0.9, 0.87, 1] + [0.03, -0.05, 0] + waves * rng.uniform(-1, 1, top.shape)
        self.x = np.vstack([top, nodes])
        self.gel = np.arange(len(top))
        count = len(self.x)
        law = ContactLaw(K, SMOOTHING, friction, K / 3)
        self.contact = SurfaceContact(gel.faces, (body.faces + len(top)).astype(np.int32), self.x, law, "cpu", 6)
        a, b = np.triu_indices(count, 1)
        free = np.repeat([[True, True, True, False]], count, axis=0)
        self.pattern: SymmetricPattern = build_pattern(free, np.sort(pair_keys(a.astype(np.int32), b.astype(np.int32), count)), "cpu")

    def force(self, x: Array) -> Array:
        """Force on every node (N, 3) with the contact of positions x."""
        x_wp = wp.array(x, dtype=wp.vec3d, device="cpu")
        self.contact.update(x_wp, 1.0)
        force = wp.zeros(len(x), dtype=wp.vec3d, device="cpu")
        self.contact.add_force(x_wp, force)
        return force.numpy()

    def tangent(self, x: Array, coupling: bool = True) -> sp.csr_matrix:
        """The tangent at the state of the last `force`, with the unsymmetric part of slipping friction."""
        values = wp.zeros(len(self.pattern.indices), dtype=wp.float64, device="cpu")
        assert self.contact.add_tangent(wp.array(x, dtype=wp.vec3d, device="cpu"), self.pattern.pairs, values, True)
        upper = sp.csr_matrix((values.numpy(), self.pattern.indices, self.pattern.indptr))
        matrix = (upper + sp.triu(upper, 1).T).tocsr()
        extra = self.contact.slip_coupling(self.pattern.equation, self.pattern.size) if coupling else None
        return matrix if extra is None else matrix + extra[0].T @ extra[1]

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


def local(pair: Pair, x: Array, i: int) -> tuple[np.ndarray, tuple]:  # type: ignore[type-arg]
    """The twelve nodes of point i, and what the twin needs to know of it."""
    c = pair.contact
    face = int(c.face.numpy()[i])
    nodes = np.concatenate([c.slave_faces[i // c.points], c.master_faces[face]])
    k = float(c.stiffness.numpy()[i // c.points])
    return nodes, (x[nodes], c.shape_values[i % c.points], c.place.numpy()[i, :2], float(c.multiplier.numpy()[i]), k, SMOOTHING)


def assembled(pair: Pair, x: Array) -> tuple[Array, Array]:
    """Force (N, 3) and Hessian (3N, 3N) of the contact potential at x, by the twin, for the pairing of the last `force`."""
    force, hessian = np.zeros_like(x), np.zeros((x.size, x.size))
    for i in np.flatnonzero(pair.contact.pressure.numpy() > 0):
        nodes, data = local(pair, x, i)
        weight = pair.contact.rest_weight[i]
        force[nodes] += weight * reference.contact_force(*data)
        place = (3 * nodes[:, None] + np.arange(3)).ravel()
        block = reference.derivative(lambda v, data=data: reference.contact_force(v, *data[1:]), data[0])
        hessian[np.ix_(place, place)] += weight * block.reshape(36, 36)
    return force, hessian


def test_twin_force_is_the_derivative_of_its_potential() -> None:
    pair = Pair(0.0, True)
    x = pair.slide(0.0)
    for i in np.argsort(pair.contact.pressure.numpy())[-3:]:
        _, data = local(pair, x, i)
        force = reference.contact_force(*data)
        exact = reference.derivative(lambda v, data=data: reference.contact_potential(v, *data[1:]), data[0])
        # g is a difference of lengths of 1 mm that leaves micrometres: 1e3 roundings
        assert np.abs(force).max() > 0.1
        assert np.abs(force - exact).max() <= 1e3 * EPS * np.abs(exact).max()


@pytest.mark.parametrize("curved", [False, True])
def test_normal_contact_matches_the_twin(curved: bool) -> None:
    pair = Pair(0.0, curved)
    x = pair.slide(0.0)
    force, matrix = pair.force(x), pair.tangent(x)
    pressure, gap = pair.contact.pressure.numpy(), pair.contact.gap.numpy()
    active = pressure > 0
    assert active.sum() > 20
    wanted, hessian = assembled(pair, x)
    # the kernel seeks the foot by six Gauss-Newton steps, each of which gains a factor |g|/R ~ 1e-3 or better: rounding of g rules (1 mm
    # over 1 µm: 1e3 ulps), in sums over some ten points
    assert np.abs(wanted).max() > 0.1
    assert np.abs(force - wanted).max() <= 1e4 * EPS * np.abs(wanted).max()
    assert np.abs(force.sum(axis=0)).max() <= 100 * EPS * np.abs(force).sum()  # what one body gets the other gives
    # the kernel's D²g is that at g = 0: it leaves out g N_α a^αβ N_β, of a size p g (4/edge)² beside k
    stiffness = pair.contact.stiffness.numpy().max()
    left_out = (pressure * np.abs(gap))[active].max() * (4 / EDGE) ** 2 / stiffness
    error = np.abs(matrix.toarray() - hessian).max() / np.abs(hessian).max()
    assert error <= left_out
    assert left_out < 5e-3


def test_normal_tangent_is_exact_where_the_gap_closes() -> None:
    """Overlap carried by multipliers, gap a hundredth of the other test's: what the tangent leaves out shrinks with it."""
    errors = []
    for share in (1.0, 0.01):
        pair = Pair(0.0, False, overlap=0.004 * share, waves=0.002 * share)
        x = pair.slide(0.0)
        pair.force(x)
        _, hessian = assembled(pair, x)
        errors.append(np.abs(pair.tangent(x).toarray() - hessian).max() / np.abs(hessian).max())
    # first order in the gap: a hundredth, within the factor by which the largest entry may change place
    assert errors[1] < 0.03 * errors[0]


def direction_error(pair: Pair, x: Array, matrix: sp.csr_matrix, moving: Array) -> float:
    """Relative L2 distance of matrix times a random direction of the `moving` nodes from the central difference of the force."""
    d = np.where(moving[:, None], np.random.default_rng(10).standard_normal(x.shape), 0.0)
    # rounding: ulp of 1 mm over h = 1e-8; truncation: h²/ε² = 4e-10 at points inside the smoothing zone
    h = 1e-8
    numeric = ((pair.force(x + h * d) - pair.force(x - h * d)) / (2 * h)).ravel()
    assert np.linalg.norm(numeric) > 1.0, "a derivative that is zero would prove nothing"
    product = matrix @ d.ravel()
    return float(np.linalg.norm(product - numeric) / np.linalg.norm(numeric))


ROUNDING = 1e-7  # ε · 1 mm / h = 2e-8, times a few


@pytest.mark.parametrize(("friction", "shear", "slips"), [(-1.0, 0.003, False), (5.0, 0.001, False), (MU, 0.01, True)])
def test_friction_tangent_against_differences(friction: float, shear: float, slips: bool) -> None:
    """Under a flat object, which keeps its normal when only the gel moves, the tangent with its unsymmetric part is exact."""
    pair = Pair(friction, curved=False)
    x = pair.slide(shear)
    size, p = np.linalg.norm(pair.contact.traction.numpy(), axis=1), pair.contact.pressure.numpy()
    assert (p > 0).sum() > 20
    slipping = (p > 0) & (size >= friction * p * (1 - 1e-9)) & (friction > 0)
    assert slipping.sum() == ((p > 0).sum() if slips else 0)
    if friction > 0:
        assert (size <= friction * p * (1 + 4 * EPS)).all()
    gel = np.zeros(len(x), bool)
    gel[pair.gel] = True
    matrix, symmetric = pair.tangent(x), pair.tangent(x, coupling=False)
    assert direction_error(pair, x, matrix, gel) < ROUNDING
    assert abs(symmetric - symmetric.T).max() == 0.0
    pair.force(x)
    if slips:  # negative control: without the coupling of pressure and slip the tangent is wrong by about μ
        assert abs(matrix - matrix.T).max() > 0.1 * abs(matrix).max() * friction
        assert direction_error(pair, x, symmetric, gel) > 0.5 * friction
        backwards = symmetric - (matrix - symmetric)
        assert direction_error(pair, x, backwards, gel) > friction
    # when the object turns the friction's plane turns with it, which the tangent leaves out: the trial traction over edge/4, beside k
    c = pair.contact
    trial = size.max() + c.stick.numpy().max() * np.abs(c.gap.numpy()[p > 0]).max() + np.abs(c.shift.numpy()).max()
    left_out = trial * 4 / EDGE / c.stiffness.numpy().min()
    assert direction_error(pair, x, matrix, np.ones(len(x), bool)) < left_out < 0.03


@pytest.mark.parametrize("friction", [-1.0, MU])
def test_friction_force_matches_the_twin(friction: float) -> None:
    pair = Pair(friction, curved=True)
    x = pair.slide(0.006)
    force = pair.force(x)
    c = pair.contact
    normal_only, _ = assembled(pair, x)
    wanted = np.zeros_like(x)
    for i in np.flatnonzero(c.pressure.numpy() > 0):
        _, (nodes, shape, *_rest) = local(pair, x, i)
        anchor, xi = c.master_faces[c.anchor_face.numpy()[i]], c.anchor_place.numpy()[i, :2]
        there = reference.tri6_shape(np.array([1 - xi[0] - xi[1], xi[0], xi[1]]))
        traction = reference.friction_traction(
            shape @ nodes[:6] - there @ x[anchor], c.normal.numpy()[i], c.shift.numpy()[i], float(c.stick.numpy()[i // c.points]), friction,
            c.pressure.numpy()[i],
        )  # fmt: skip
        weight = c.rest_weight[i]
        np.add.at(wanted, c.slave_faces[i // c.points], weight * np.outer(shape, traction))
        np.add.at(wanted, anchor, -weight * np.outer(there, traction))
    found = force - normal_only
    assert np.abs(wanted).max() > 0.02
    # rounding of the slip, micrometres between places of 1 mm: 1e3 ulps, in sums of ten points, and of the normal part that was taken away
    assert np.abs(found - wanted).max() <= 1e4 * EPS * (np.abs(wanted).max() + np.abs(normal_only).max())
    # a sign turned in the friction is seen
    assert np.abs(found + wanted).max() > np.abs(wanted).max()
    # the gel is dragged against its slip
    pushed = found[pair.gel].sum(axis=0)
    assert pushed @ [1.0, 0.4, 0.0] > 0  # force is ∂/∂u, minus what acts on the gel


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
    """Over a sharp edge points of one face rub on both flanks; the next step begins with what the last one ended with."""
    pair = Pair(-1.0, False, overlap=0.4, slope=1.0)
    moved = pair.slide(0.05)
    contact = pair.contact
    held = contact.pressure.numpy() > 0
    normal, before = contact.normal.numpy()[held], contact.traction.numpy()[held]
    assert (normal[:, 0] > 0.6).sum() > 5 and (normal[:, 0] < -0.6).sum() > 5, "one flank only, nothing shown"
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


def test_freezing_begins_no_contact_beside_a_rim() -> None:
    """A curved face goes on beyond its rim as a parabola, through the gel that lies beside the object: no point keeps that."""
    pair = Pair(0.0, False, overlap=0.0, waves=0.0)
    x = pair.x.copy()
    body, rim = np.arange(len(x)) > pair.gel.max(), 1.3
    x[body, 2] = 0.05 + 0.25 * (rim**2 - x[body, 0] ** 2)  # an arch on the gel's plane, its feet 0.05 mm above it
    x[pair.gel, 0] += rim
    contact, x_wp = pair.contact, wp.array(x, dtype=wp.vec3d, device="cpu")
    contact.update(x_wp, 1.0)
    places = np.einsum("qn,fni->fqi", contact.shape_values, x[contact.slave_faces]).reshape(-1, 3)
    gap, face, beyond = contact.gap.numpy().copy(), contact.face.numpy().copy(), places[:, 0] - rim
    below = 0.05 - 0.25 * (2 * rim * beyond + beyond**2)
    assert (below[(face >= 0) & (beyond > 0.0)] < -0.1).sum() > 10, "the parabola must cut into paired points, or nothing is shown"
    contact.update(x_wp, 1.0, freeze=True)
    assert (contact.face.numpy() == face).all()
    # six steps to the foot and six more: they gain a digit or two each, and a gap is off by the foot's error squared
    assert np.abs(contact.gap.numpy() - gap)[face >= 0].max() < 1e-6
    assert gap.min() > 0.0


def test_frozen_points_keep_the_face_they_lie_on() -> None:
    """However far they slide off it over a ridge: the flank's plane goes on."""
    pair = Pair(0.0, False, overlap=0.4, slope=1.0)
    pair.force(pair.x)
    contact = pair.contact
    face, normal = contact.face.numpy().copy(), contact.normal.numpy().copy()
    x = pair.x.copy()
    x[pair.gel, 0] += 0.3
    kept = {}
    for freeze in (False, True):
        pair.force(pair.x)
        contact.update(wp.array(x, dtype=wp.vec3d, device="cpu"), 1.0, freeze)
        kept[freeze] = (contact.face.numpy() == face).mean(), (contact.normal.numpy() * normal).sum(axis=1).min()
    assert kept[True][0] == 1.0 and kept[True][1] > 1.0 - 1e-9
    assert kept[False][0] < 0.9 and kept[False][1] < 0.1


def test_a_state_is_returned_to() -> None:
    """Pairs, too: a point kept on its flank beyond the ridge is not on the nearest one."""
    pair = Pair(0.5, False, overlap=0.1, slope=1.0)
    moved = pair.slide(0.03)
    pair.contact.settle()
    force, saved = pair.force(moved), pair.contact.save()
    away = moved.copy()
    away[pair.gel] += [0.5, 0.2, 0.0]

    def back(pairs: bool) -> float:
        pair.force(away)
        pair.contact.settle()
        pair.contact.restore(saved)
        if not pairs:
            pair.contact.face.fill_(-1)
        return float(np.abs(pair.force(moved) - force).max() / np.abs(force).max())

    # feet are sought from where they were: rounding of a gap of 0.1 mm in lengths of 1 mm
    assert back(True) <= 1e3 * EPS
    assert back(False) > 0.01


@pytest.mark.parametrize("ends", [False, True])
def test_beside_the_gels_border_nothing_is_touched(ends: bool) -> None:
    """Points of an object's face that lies half over a gel, half beyond it, both 0.1 mm deep."""
    line = np.linspace(0.0, 2.0, 3) * MM
    gel = box_mesh(line, line, np.array([-1.0, 0.0]) * MM, "bonded", "coated", "side").surface("coated")
    body = quadratic_faces(np.array([[1.2, 0.5, -0.1], [1.2, 1.5, -0.1], [2.8, 1.0, -0.1]]), np.array([[0, 1, 2]], np.int32))
    x = np.vstack([gel.nodes / MM, body.nodes])
    faces = (body.faces + len(gel.nodes)).astype(np.int32)
    contact = SurfaceContact(faces, gel.faces, x, ContactLaw(K, SMOOTHING, 0.0, 0.0), "cpu", 12, frozenset("x"), ends)
    contact.update(wp.array(x, dtype=wp.vec3d, device="cpu"), 1.0)
    place = np.einsum("qn,ni->qi", contact.shape_values, body.nodes)
    above, gap = place[:, 0] < 2.0, contact.gap.numpy()
    assert 4 <= above.sum() <= 8 and gap[above] == pytest.approx(-0.1)
    near = ~above & (place[:, 0] < 2.08)
    assert near.any()
    # negative control: a border that is none for the search leaves points just beyond it in the gel
    assert (gap[near] > 1.0).all() if ends else (gap[near] < 0.0).all()
    # of the eight sides of the gel's border two are on the mirror plane
    sides = contact.ends.numpy()
    assert sum(((sides & bit) > 0).sum() for bit in (1, 2, 4)) == (6 if ends else 0)
