"""Elements and contact of the plane: energies in NumPy whose derivatives the kernels must be, differences of forces for the tangents."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp
from planar_fixtures import Array, grid, solids_of

from gelsim.fem import reference
from gelsim.fem.contact import ContactLaw
from gelsim.fem.elements import tri6_gradient, tri6_shape, triangle_quadrature
from gelsim.fem.equilibrium import tangent_of
from gelsim.fem.pattern import build_pattern, pair_keys
from gelsim.fem.planar.assembly import PlanarSolids
from gelsim.fem.planar.contact import EdgeContact
from gelsim.scene.materials import ElasticMaterial

EPS = np.finfo(float).eps
LAWS = {
    "neo-hookean": ("neo-hookean", ()),
    "yeoh": ("yeoh", (0.1, 0.02)),
    "ogden": ("ogden", (1.5, 0.6, 4.0, 0.4)),
}


def small_solid(law: str, turned: bool) -> PlanarSolids:
    """A dozen distorted triangles, one of whose sides lies on the axis; every node of the others free."""
    nodes, triangles = grid(np.linspace(0, 1.0, 3), np.linspace(0, 0.9, 4), shake=0.2)
    fixed = np.zeros((len(nodes), 3), bool)
    fixed[nodes[:, 0] == 0, 0] = True
    name, constants = LAWS[law]
    solids = solids_of(nodes, triangles, ElasticMaterial.from_modulus(50e3, 0.45, name, constants), fixed, turned)
    rng = np.random.default_rng(5)
    u = 0.012 * rng.uniform(-1, 1, nodes.shape) * [1, 0, 1] + nodes * [0.1, 0, -0.15]
    u[nodes[:, 0] == 0, 0] = 0
    solids.set_state((u, np.where(solids.free[:, 3], rng.uniform(-5, 5, len(nodes)), 0.0)))
    return solids


def twin_energy(solids: PlanarSolids, u: Array, p: Array, turned: bool, stored: bool = False) -> complex:
    """Π of all triangles, or the energy stored at equilibrium: F from the shape functions themselves, with F_yy = (r + u_r)/r or 1."""
    law, kappa = solids._inputs[6].numpy(), solids._inputs[7].numpy()
    bary, rule = triangle_quadrature(6)
    total = 0j
    for t, nodes in enumerate(solids.tets):
        rest = solids.rest[nodes][:, [0, 2]]
        for b, weight in zip(bary, rule, strict=True):
            d, n = tri6_gradient(b), tri6_shape(b)
            to_rest = rest.T @ d
            g = d @ np.linalg.inv(to_rest)
            flat = u[nodes][:, [0, 2]].T @ g
            f = np.eye(3, dtype=complex)
            f[np.ix_([0, 2], [0, 2])] += flat
            radius = n @ rest[:, 0]
            if turned:
                f[1, 1] += n @ u[nodes][:, 0] / radius
            pressure = b @ p[nodes[:3]]
            volume = np.linalg.det(to_rest) * weight * (radius if turned else 1.0)
            spring = pressure**2 / (2 * kappa[t])
            volumetric = spring if stored else pressure * (np.linalg.det(f) - 1) - spring
            total = total + volume * (reference.isochoric_energy(f, law[t]) + volumetric)
    return total


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("law", list(LAWS))
def test_forces_are_derivatives_of_the_energy(law: str, turned: bool) -> None:
    solids = small_solid(law, turned)
    u, p = solids.state()
    force, volume, smallest = solids.internal_force()
    assert 0.3 < smallest < 0.95
    # a sum of 12 triangles by 6 points, each of some hundred operations: under 100 roundings of the largest
    assert solids.energy() == pytest.approx(twin_energy(solids, u, p, turned, stored=True).real, rel=100 * EPS)
    free = np.flatnonzero(solids.free[:, [0, 2]].ravel())
    step = 1e-30
    for index in free[:: max(1, len(free) // 12)]:
        node, axis = index // 2, 2 * (index % 2)
        moved = u.astype(complex)
        moved[node, axis] += 1j * step
        wanted = twin_energy(solids, moved, p, turned).imag / step
        assert force[node, axis] == pytest.approx(wanted, abs=1000 * EPS * np.abs(force).max())
    for node in np.flatnonzero(solids.free[:, 3])[::3]:
        moved = p.astype(complex)
        moved[node] += 1j * step
        assert volume[node] == pytest.approx(twin_energy(solids, u, moved, turned).imag / step, abs=1000 * EPS * np.abs(volume).max())


def differences(solids: PlanarSolids, direction: Array, h: float) -> Array:
    """Central difference of all equations along a direction of the unknowns."""
    start, found = solids.state(), []
    for sign in (1, -1):
        solids.move(start, direction, sign * h)
        force, volume, _ = solids.internal_force()
        found.append(np.concatenate([force, volume[:, None]], axis=1)[solids.free])
    solids.set_state(start)
    return (found[0] - found[1]) / (2 * h)


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("law", list(LAWS))
def test_tangent_is_the_derivative_of_the_forces(law: str, turned: bool) -> None:
    solids = small_solid(law, turned)
    matrix = tangent_of(solids)
    direction = np.random.default_rng(2).normal(size=solids.unknowns)
    wanted = differences(solids, direction, 1e-6)
    # third derivatives times h² (strains of h over cells of 0.3 mm, to the power of the law): 1e-9; rounding over h: 1e-16/1e-6
    bound = 1e-8 * np.abs(wanted).max()
    assert np.abs(wanted).max() > 1.0
    assert np.abs(matrix @ direction - wanted).max() <= bound
    other = tangent_of(small_solid("yeoh" if law != "yeoh" else "ogden", turned))
    assert np.abs(other @ direction - wanted).max() > 1e3 * bound, "another law's tangent must not pass"
    without = tangent_of(small_solid(law, not turned))
    assert np.abs(without @ direction - wanted).max() > 1e3 * bound, "nor that of the other kind of plane"


class Pair:
    """A wavy edge under a ball's or a plane's, all nodes free, a little overlapping."""

    def __init__(self, friction: float, curved: bool, turned: bool = True) -> None:
        rng = np.random.default_rng(4)
        r = np.linspace(0.1, 1.1, 9)
        gel = np.column_stack([r[::-1], 0.002 * rng.uniform(-1, 1, 9)])
        s = np.linspace(0.0, 1.3, 11)
        body = np.column_stack([s, (60 - np.sqrt(3600 - s**2) if curved else 0 * s) - (0.012 if curved else 0.006)])
        self.x = np.insert(np.vstack([gel, body]), 1, 0.0, axis=1)
        start = np.arange(0, 8, 2)
        edges = np.stack([start, start + 2, start + 1], 1)
        other = np.arange(0, 10, 2)
        self.contact = EdgeContact(edges.astype(np.int32), np.stack([other + 9, other + 11, other + 10], 1).astype(np.int32), self.x,
                                   ContactLaw(1500.0, 5e-4, friction, 500.0), turned)  # fmt: skip
        count = len(self.x)
        a, b = np.triu_indices(count, 1)
        free = np.repeat([[True, False, True, False]], count, axis=0)
        self.pattern = build_pattern(free, np.sort(pair_keys(a.astype(np.int32), b.astype(np.int32), count)), "cpu")

    def force(self, x: Array) -> Array:
        at = wp.array(x, dtype=wp.vec3d, device="cpu")
        self.contact.update(at, 1.0)
        force = wp.zeros(len(x), dtype=wp.vec3d, device="cpu")
        self.contact.add_force(at, force)
        return force.numpy().copy()

    def tangent(self, x: Array, geometric: bool = True, coupling: bool = True) -> sp.csr_matrix:
        values = wp.zeros(len(self.pattern.indices), dtype=wp.float64, device="cpu")
        assert self.contact.add_tangent(wp.array(x, dtype=wp.vec3d, device="cpu"), self.pattern.pairs, values, geometric)
        upper = sp.csr_matrix((values.numpy(), self.pattern.indices, self.pattern.indptr))
        matrix = (upper + sp.triu(upper, 1).T).tocsr()
        extra = self.contact.slip_coupling(self.pattern.equation, self.pattern.size) if coupling else None
        return matrix if extra is None else matrix + extra[0].T @ extra[1]

    def settled(self, shear: float) -> Array:
        self.force(self.x)
        self.contact.settle()
        self.contact.set_multipliers(np.random.default_rng(1).uniform([2, -0.3, 0, 0], [6, 0.3, 0, 0], (len(self.contact.vertices), 4)))
        moved = self.x + [0, 0, 0]
        moved[:9, 0] += shear
        self.force(moved)
        return moved

    def potential(self, x: Array) -> float:
        self.force(x)
        c = self.contact
        k = np.repeat(c.stiffness.numpy(), c.points)
        s = np.where(c.face.numpy() >= 0, c.multiplier.numpy() / k - c.gap.numpy(), -1.0)
        return float((c.rest_weight * reference.penalty_potential(s, k, c.law.smoothing)).sum())


def along(function, x: Array, direction: Array, h: float) -> Array:  # type: ignore[no-untyped-def]
    return (function(x + h * direction) - function(x - h * direction)) / (2 * h)


@pytest.mark.parametrize("curved", [True, False])
def test_contact_force_is_the_derivative_of_its_potential(curved: bool) -> None:
    pair = Pair(0.0, curved)
    x = pair.settled(0.0)
    force = pair.force(x)
    assert (pair.contact.pressure.numpy() > 0).sum() >= 10
    assert np.abs(force.sum(0)[2]) <= 100 * EPS * np.abs(force).sum()
    rng = np.random.default_rng(6)
    for _ in range(4):
        direction = rng.normal(size=x.shape) * [1, 0, 1]
        # the third derivative of φ is k/ε: h² k/ε/6 times area, 1e-12 · 1e7; and 1e-16/h
        assert float(along(pair.potential, x, direction, 1e-6)) == pytest.approx(float((force * direction).sum()), rel=1e-4)


@pytest.mark.parametrize("curved", [True, False])
@pytest.mark.parametrize(("friction", "shear"), [(0.0, 0.0), (-1.0, 0.003), (0.4, 0.05)], ids=["none", "stick", "slip"])
def test_contact_tangent_is_the_derivative_of_its_force(curved: bool, friction: float, shear: float) -> None:
    pair = Pair(friction, curved)
    x = pair.settled(shear)
    matrix = pair.tangent(x)
    free = np.repeat([[True, False, True]], len(x), axis=0)
    direction = np.random.default_rng(7).normal(size=x.shape) * [1, 0, 1]
    wanted = along(pair.force, x, direction, 1e-7)[free]
    difference = np.abs(matrix @ direction[free] - wanted).max() / np.abs(wanted).max()
    # left out of the tangents: g N a N of the normal part, first order in the gap (4 µm on 1 mm), and the turn of the friction's plane
    # with the object
    bound = 5e-3 if friction == 0.0 else 0.03
    assert difference < bound
    if friction > 0:
        pair.force(x)
        assert np.abs(pair.tangent(x, coupling=False) @ direction[free] - wanted).max() / np.abs(wanted).max() > 2 * bound
    elif curved:
        pair.force(x)
        assert np.abs(pair.tangent(x, geometric=False) @ direction[free] - wanted).max() / np.abs(wanted).max() > difference
