"""The element kernels against the float64 twin, and the twin against its own energy: energy, residual and tangent of both laws."""

from __future__ import annotations

import numpy as np
import pytest
from fem_fixtures import Array, solids_of, tangent_of

from gelsim.fem import reference
from gelsim.fem.assembly import Solids
from gelsim.geometry import TetMesh, quadratic_tets
from gelsim.materials import ElasticMaterial

EPS = np.finfo(float).eps
# Two tets that share a face, of no symmetry, about 1 mm across; positions in metres.
VERTICES = 1e-3 * np.array([[0.0, 0, 0], [1.1, 0.1, 0], [0.2, 0.9, 0.1], [0.3, 0.2, 1.0], [1.0, 1.1, 0.9]])
TETS = np.array([[0, 1, 2, 3], [1, 4, 2, 3]], np.int32)


def deformed(points: int, yeoh: bool, nu: float = 0.499) -> Solids:
    """Curved tets strained by some 20 % with pressures of the size of μ; no component prescribed."""
    rng = np.random.default_rng(3)
    nodes, tets = quadratic_tets(VERTICES, TETS)
    nodes[len(VERTICES) :] += 0.03e-3 * rng.uniform(-1, 1, (len(nodes) - len(VERTICES), 3))
    solids = solids_of(TetMesh(nodes, tets), ElasticMaterial.from_modulus(50e3, nu), np.zeros((len(nodes), 3), bool), points)
    if yeoh:
        solids._inputs[6].assign(np.tile([8.0, 0.5, 0.02], (len(tets), 1)))
    pressure = np.zeros(len(nodes))
    pressure[: len(VERTICES)] = rng.uniform(-20, 20, len(VERTICES))
    bend = rng.uniform(-0.05, 0.05, (len(nodes), 3))
    solids.set_state((solids.rest @ rng.uniform(-0.2, 0.2, (3, 3)) + bend, pressure))
    return solids


def twin(solids: Solids) -> tuple[float, Array, Array]:
    u, p = solids.state()
    _, _, _, gradients, weights, shape, law, kappa = (array.numpy() for array in solids._inputs)
    return reference.assemble(u, p, solids.tets, gradients, weights, shape, law, kappa)


@pytest.mark.parametrize("points", [4, pytest.param(11, marks=pytest.mark.slow)])
@pytest.mark.parametrize("yeoh", [False, True])
def test_kernels_match_the_twin(points: int, yeoh: bool) -> None:
    solids = deformed(points, yeoh)
    energy, residual, tangent = twin(solids)
    force, volume, smallest = solids.internal_force()
    kept = solids.free
    # Both are float64 and differ by the order of sums: each entry adds some 40 products a point, 2 tets, the largest of them about ten
    # times the result (p J F⁻ᵀ against the deviatoric stress): 40 · 4 · 2 · 10 roundings, of half an ulp, grow like their root: 30 ulps.
    bound = 30 * EPS * np.sqrt(points / 4)
    assert np.abs(residual[:, :3]).max() > 1.0 and np.abs(residual[:, 3]).max() > 1e-3, "a twin that is zero would prove nothing"
    assert np.abs(force - residual[:, :3]).max() <= bound * np.abs(residual[:, :3]).max()
    assert np.abs(volume - residual[:, 3]).max() <= bound * np.abs(residual[:, 3]).max()
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


def min_jacobian(solids: Solids) -> float:
    u = solids.displacement.numpy()
    gradients = solids._inputs[3].numpy()
    return float(np.linalg.det(np.eye(3) + np.einsum("tnc,tqnj->tqcj", u[solids.tets], gradients)).min())


def test_twin_residual_is_the_derivative_of_its_energy() -> None:
    solids = deformed(4, True)
    _, _, _, gradients, weights, shape, law, kappa = (array.numpy() for array in solids._inputs)
    u, p = solids.state()
    tet = solids.tets[0]
    unknowns = np.concatenate([u[tet].ravel(), p[tet[:4]]])
    data = (gradients[0], weights[0], shape, law[0], float(kappa[0]))
    residual = reference.element_residual(unknowns, *data)
    energy = reference.derivative(lambda v: reference.element_energy(v[:30].reshape(10, 3), v[30:], *data), unknowns)
    # the complex step has no truncation error: rounding only, as above
    for part in (slice(0, 30), slice(30, 34)):
        assert np.abs(residual[part]).max() > 1e-3
        assert np.abs(residual[part] - energy[part]).max() <= 30 * EPS * np.abs(residual[part]).max()


def test_stored_energy_at_a_pressure_that_solves_the_volume_equation() -> None:
    """`Solids.energy` is ∫ Ŵ + p²/(2κ): the energy without constraint, equal to Π where the volume equations hold."""
    solids = deformed(4, False)
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


@pytest.mark.parametrize("fault", [None, "pressure of the wrong sign", "tangent at rest"])
def test_tangent_against_central_differences(fault: str | None) -> None:
    """The assembled matrix times a direction is the central difference of the assembled residual along it; faults are seen."""
    solids = deformed(4, True)
    start = solids.state()
    rng = np.random.default_rng(5)
    # one direction in displacements [mm] and pressures [kPa], so that all four blocks take part
    size = np.broadcast_to([1.0, 1.0, 1.0, 20.0], solids.free.shape)[solids.free]
    direction = size * rng.uniform(-1, 1, solids.unknowns)

    def residual(fraction: float) -> Array:
        solids.move(start, direction, fraction)
        force, volume, _ = solids.internal_force()
        return np.concatenate([force, volume[:, None]], axis=1)[solids.free]

    # h = 1e-5: truncation h² times the ratio of third to first derivative, of order 1/(size of F's change)² ~ 10 mm⁻²: 1e-9; rounding
    # ε |R| / (h |K d|) ~ 1e-11
    h = 1e-5
    numeric = (residual(h) - residual(-h)) / (2 * h)
    solids.move(start, direction, 0.0)
    matrix = tangent_of(solids)
    if fault is not None:
        solids.set_state((start[0], -start[1]) if fault.startswith("pressure") else (0 * start[0], start[1]))
        matrix = tangent_of(solids)
    assert np.linalg.norm(numeric) > 1.0
    error = np.linalg.norm(matrix @ direction - numeric) / np.linalg.norm(numeric)
    cosine = (matrix @ direction) @ numeric / np.linalg.norm(matrix @ direction) / np.linalg.norm(numeric)
    assert (error < 1e-8 and cosine > 1 - 1e-12) == (fault is None)
