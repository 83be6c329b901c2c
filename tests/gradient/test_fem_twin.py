"""The element kernels against the float64 twin, and the twin against its own energy: energy, residual and tangent of three laws."""

from __future__ import annotations

import numpy as np
import pytest
from fem_fixtures import Array, solids_of, tangent_of

from gelsim.fem import reference
from gelsim.fem.assembly import Solids
from gelsim.fem.elements import TetQuadrature
from gelsim.geometry import TetMesh, quadratic_tets
from gelsim.scene.materials import ElasticMaterial

EPS = np.finfo(float).eps
# Two tets that share a face, of no symmetry, about 1 mm across; positions in metres.
VERTICES = 1e-3 * np.array([[0.0, 0, 0], [1.1, 0.1, 0], [0.2, 0.9, 0.1], [0.3, 0.2, 1.0], [1.0, 1.1, 0.9]])
TETS = np.array([[0, 1, 2, 3], [1, 4, 2, 3]], np.int32)
LAWS = {"neo-hookean": (), "yeoh": (0.06, 0.0025), "ogden": (2.6, 0.5, -2.0, 0.3, 9.0, 0.2)}
"""Ratios far beyond a silicone's, so that each matters."""
NEARLY = 1e-7
STATES = {
    "all equal": np.zeros((3, 3)),
    "two equal": np.diag([-0.1, -0.1, 0.25]),
    "nearly equal": np.diag([0.1 + NEARLY, 0.1 - NEARLY, 0.1]),
}
"""Displacement gradients at which principal stretches coincide, turned into no axis of the frame."""


def deformed(points: int, law: str, nu: float = 0.499) -> Solids:
    """Curved tets strained by some 20 % with pressures of the size of μ; no component prescribed."""
    rng = np.random.default_rng(3)
    nodes, tets = quadratic_tets(VERTICES, TETS)
    nodes[len(VERTICES) :] += 0.03e-3 * rng.uniform(-1, 1, (len(nodes) - len(VERTICES), 3))
    material = ElasticMaterial.from_modulus(50e3, nu, law, LAWS[law])
    solids = solids_of(TetMesh(nodes, tets), material, np.zeros((len(nodes), 3), bool), points)
    pressure = np.zeros(len(nodes))
    pressure[: len(VERTICES)] = rng.uniform(-20, 20, len(VERTICES))
    bend = rng.uniform(-0.05, 0.05, (len(nodes), 3))
    solids.set_state((solids.rest @ rng.uniform(-0.2, 0.2, (3, 3)) + bend, pressure))
    return solids


def twin(solids: Solids) -> tuple[float, Array, Array]:
    u, p = solids.state()
    _, _, _, gradients, weights, shape, law, kappa = (array.numpy() for array in solids._inputs)
    return reference.assemble(u, p, solids.tets, TetQuadrature(gradients, weights, shape), law, kappa)


@pytest.mark.parametrize("points", [4, pytest.param(11, marks=pytest.mark.slow)])
@pytest.mark.parametrize("law", LAWS)
def test_kernels_match_the_twin(points: int, law: str) -> None:
    compare_with_twin(deformed(points, law), law, points)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("law", ["yeoh", "ogden"])
def test_kernels_match_the_twin_at_equal_stretches(law: str, state: str) -> None:
    """Where formulas in principal stretches are 0/0, and next to it, where they lose digits."""
    solids = deformed(4, law)
    turn = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
    solids.set_state((solids.rest @ turn @ STATES[state] @ turn.T, solids.state()[1]))
    compare_with_twin(solids, law, 4)


@pytest.mark.parametrize("law", ["yeoh", "ogden"])
def test_volume_held_at_points(law: str) -> None:
    """κ' (J - 1)²/2 at the points: energy, force and tangent against its own energy by the complex step, beside those of κ - κ'."""
    solids = deformed(4, law)
    held = np.array([300.0, 500.0])
    solids.hold_volume(held)
    _, residual, tangent = twin(solids)
    u, energy = solids.state()[0], 0.0
    _, _, _, gradients, weights, *_ = (array.numpy() for array in solids._inputs)

    def share(t: int, v: Array) -> Array:
        j = [np.linalg.det(np.eye(3) + v.reshape(-1, 3).T @ g) for g in gradients[t]]
        return held[t] / 2 * np.sum([w * (x - 1) ** 2 for w, x in zip(weights[t], j, strict=True)])

    def force_of(t: int, v: Array) -> Array:
        f = [np.eye(3) + v.reshape(-1, 3).T @ g for g in gradients[t]]
        j = [np.linalg.det(x) for x in f]
        parts = [w * (a - 1) * a * g @ np.linalg.inv(x) for w, a, x, g in zip(weights[t], j, f, gradients[t], strict=True)]
        return held[t] * np.sum(parts, axis=0).ravel()

    for t, tet in enumerate(solids.tets):
        place, v = (4 * tet[:, None] + np.arange(3)).ravel(), u[tet].ravel()
        by_energy, by_force = reference.derivative(lambda w, t=t: share(t, w), v), force_of(t, v)
        assert np.abs(by_energy - by_force).max() <= 100 * EPS * np.abs(by_force).max() and np.abs(by_force).max() > 1.0
        energy += share(t, v)
        residual.reshape(-1)[place] += by_force
        tangent.reshape(4 * len(u), -1)[np.ix_(place, place)] += reference.derivative(lambda w, t=t: force_of(t, w), v)
    force = solids.internal_force()[0]
    matrix, wanted = tangent_of(solids).toarray(), tangent[solids.free][:, solids.free]
    # roundings as in compare_with_twin, and Ogden's; forces of held volume are ten times the others'
    bound = 10 * 8 * 30 * EPS
    assert np.abs(force - residual[:, :3]).max() <= bound * np.abs(residual[:, :3]).max()
    assert np.abs(matrix - wanted).max() <= bound * np.abs(wanted).max()
    whole = solids.energy()
    solids._held[0].zero_()
    solids.internal_force()
    assert whole - solids.energy() == pytest.approx(energy, rel=bound)


def compare_with_twin(solids: Solids, law: str, points: int) -> None:
    energy, residual, tangent = twin(solids)
    force, volume, smallest = solids.internal_force()
    kept = solids.free
    # Both are float64 and differ by the order of sums: each entry adds some 40 products a point, 2 tets, the largest of them about ten
    # times the result (p J F⁻ᵀ against the deviatoric stress): 40 · 4 · 2 · 10 roundings, of half an ulp, grow like their root: 30 ulps.
    bound = 30 * EPS * np.sqrt(points / 4)
    if law == "ogden":
        bound *= 8  # the twin's power() squares four times: 16 roundings in place of about two
    assert np.abs(residual[:, :3]).max() > 1.0 and np.abs(residual[:, 3]).max() > 1e-5, "a twin that is zero would prove nothing"
    assert np.abs(force - residual[:, :3]).max() <= bound * np.abs(residual[:, :3]).max()
    # The volume equation ∫ N (J - 1 - p/κ) takes 1 from J, so its roundings are those of ∫ N J, however little is left.
    assert np.abs(volume - residual[:, 3]).max() <= bound * max(np.abs(residual[:, 3]).max(), largest_volume(solids))
    assert smallest == pytest.approx(min_jacobian(solids), rel=bound)
    matrix = tangent_of(solids).toarray()
    wanted = tangent[kept][:, kept]
    assert np.abs(matrix - matrix.T).max() == 0.0
    # entries in u-u (kPa·mm), u-p (mm²) and p-p (mm³/kPa) have sizes of their own
    component = np.broadcast_to(np.arange(4), kept.shape)[kept]
    for rows in (component < 3, component == 3):
        for columns in (component < 3, component == 3):
            block = np.ix_(rows, columns)
            assert np.abs(wanted[block]).max() > 0
            assert np.abs(matrix[block] - wanted[block]).max() <= bound * np.abs(wanted[block]).max()
    assert np.isfinite(energy)


def largest_volume(solids: Solids) -> float:
    """The largest ∫ N dV of a vertex [mm³]."""
    _, _, _, _, weights, shape, *_ = (array.numpy() for array in solids._inputs)
    volumes = np.zeros(len(solids.rest))
    np.add.at(volumes, solids.tets[:, :4], weights @ shape)
    return float(volumes.max())


def min_jacobian(solids: Solids) -> float:
    u = solids.displacement.numpy()
    gradients = solids._inputs[3].numpy()
    return float(np.linalg.det(np.eye(3) + np.einsum("tnc,tqnj->tqcj", u[solids.tets], gradients)).min())


@pytest.mark.parametrize("law", ["yeoh", "ogden"])
def test_twin_residual_is_the_derivative_of_its_energy(law: str) -> None:
    solids = deformed(4, law)
    _, _, _, gradients, weights, shape, constants, kappa = (array.numpy() for array in solids._inputs)
    u, p = solids.state()
    tet = solids.tets[0]
    unknowns = np.concatenate([u[tet].ravel(), p[tet[:4]]])
    data = (gradients[0], weights[0], shape, constants[0], float(kappa[0]))
    residual = reference.element_residual(unknowns, *data)
    energy = reference.derivative(lambda v: reference.element_energy(v[:30].reshape(10, 3), v[30:], *data), unknowns)
    # the complex step has no truncation error: rounding only, as above
    bound = 30 * EPS * (8 if law == "ogden" else 1)
    for part in (slice(0, 30), slice(30, 34)):
        assert np.abs(residual[part]).max() > 1e-3
        assert np.abs(residual[part] - energy[part]).max() <= bound * np.abs(residual[part]).max()


@pytest.mark.parametrize("law", LAWS)
def test_stored_energy_at_a_pressure_that_solves_the_volume_equation(law: str) -> None:
    """`Solids.energy` is ∫ Ŵ + p²/(2κ): the energy without constraint, equal to Π where the volume equations hold."""
    solids = deformed(4, law)
    u, _ = solids.state()
    kappa = float(solids._inputs[7].numpy()[0])
    # volume equations are linear in p: M p/κ = ∫ N (J - 1)
    solids.set_state((u, np.zeros(len(u))))
    vertices = np.flatnonzero(solids.free[:, 3])
    right = solids.internal_force()[1][vertices]
    mass = -kappa * tangent_of(solids).toarray()[np.ix_(solids.equation[vertices, 3], solids.equation[vertices, 3])]
    pressure = np.zeros(len(u))
    pressure[vertices] = kappa * np.linalg.solve(mass, right)
    solids.set_state((u, pressure))
    _, volume, _ = solids.internal_force()
    assert np.abs(volume[vertices]).max() <= 1e-12 * np.abs(right).max()  # a 5 x 5 system of condition below 100
    energy, _, _ = twin(solids)
    # κ/μ = 500 makes p²/(2κ) and p (J - 1) about a hundred times the isochoric part, of which 30 ulps each
    assert solids.energy() == pytest.approx(energy, rel=100 * 30 * EPS)


@pytest.mark.parametrize("law", ["yeoh", "ogden"])
@pytest.mark.parametrize("fault", [None, "pressure of the wrong sign", "tangent at rest", "tangent of another law"])
def test_tangent_against_central_differences(fault: str | None, law: str) -> None:
    """The assembled matrix times a direction is the central difference of the assembled residual along it; faults are seen."""
    solids = deformed(4, law)
    start = solids.state()
    rng = np.random.default_rng(5)
    # one direction in displacements [mm] and pressures [kPa], so that all four blocks take part
    size = np.broadcast_to([1.0, 1.0, 1.0, 20.0], solids.free.shape)[solids.free]
    direction = size * rng.uniform(-1, 1, solids.unknowns)

    def residual(fraction: float) -> Array:
        solids.move(start, direction, fraction)
        force, volume, _ = solids.internal_force()
        return np.concatenate([force, volume[:, None]], axis=1)[solids.free]

    # h = 1e-5: truncation h² times the ratio of third to first derivative, of order 1/(size of F's change)² ~ 10 mm⁻²: 1e-9, times α²/4
    # for α = 9 with a fifth of the weight: 4e-9; rounding ε |R| / (h |K d|) ~ 1e-11
    h = 1e-5
    numeric = (residual(h) - residual(-h)) / (2 * h)
    solids.move(start, direction, 0.0)
    matrix = tangent_of(solids)
    if fault == "tangent of another law":
        matrix = tangent_of(deformed(4, "neo-hookean"))
    elif fault is not None:
        solids.set_state((start[0], -start[1]) if fault.startswith("pressure") else (0 * start[0], start[1]))
        matrix = tangent_of(solids)
    assert np.linalg.norm(numeric) > 1.0
    error = np.linalg.norm(matrix @ direction - numeric) / np.linalg.norm(numeric)
    cosine = (matrix @ direction) @ numeric / np.linalg.norm(matrix @ direction) / np.linalg.norm(numeric)
    assert (error < 1e-8 and cosine > 1 - 1e-12) == (fault is None)


def test_ogden_of_exponent_two_is_neo_hookean() -> None:
    """Σ λ̄² = Ī₁: the two families of kernels, which share no line of the law, give the same energy, forces and matrix."""
    cubic = deformed(4, "neo-hookean")
    material = ElasticMaterial.from_modulus(50e3, 0.499, "ogden", (2.0, 1.0))
    ogden = solids_of(TetMesh(cubic.rest * 1e-3, cubic.tets), material, np.zeros(cubic.rest.shape, bool))
    ogden.set_state(cubic.state())
    for ours, theirs in zip(ogden.internal_force(), cubic.internal_force(), strict=True):
        assert np.abs(np.subtract(ours, theirs)).max() <= 30 * EPS * np.abs(theirs).max()
    ours, theirs = tangent_of(ogden).toarray(), tangent_of(cubic).toarray()
    assert np.abs(ours - theirs).max() <= 30 * EPS * np.abs(theirs).max()
    assert ogden.energy() == pytest.approx(cubic.energy(), rel=30 * EPS)


def test_ogden_keeps_its_digits_at_small_strain() -> None:
    """Forces at strains of 1e-9 are the matrix at rest times the displacements; formed from C they would have seven digits."""
    solids = deformed(4, "ogden")
    u = 1e-9 * solids.rest @ np.random.default_rng(9).uniform(-1, 1, (3, 3))
    solids.set_state((0 * u, np.zeros(len(u))))
    linear = (tangent_of(solids) @ np.concatenate([u, np.zeros((len(u), 1))], axis=1)[solids.free])[solids.equation[:, :3]]
    solids.set_state((u, np.zeros(len(u))))
    force, _, _ = solids.internal_force()
    # what is left out is of second order in the strain, with α = 9 before it: 1e-8; rounding is below that
    assert np.abs(force).max() > 1e-9
    assert np.abs(force - linear).max() <= 1e-8 * np.abs(linear).max()
