"""The gel's coat: forces and matrices against the complex step on its energy, balloons against their closed form, presses and waves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import warp as wp
from fem_fixtures import ball_scene, flat_gel, problem_of, rigid_body, solved
from planar_fixtures import press_of

from gelsim.fem.coat import Coat, coat_of_edges, coat_of_faces
from gelsim.fem.pattern import build_pattern, element_pairs
from gelsim.fem.sensitivity import press_sensitivity
from gelsim.geometry import quadratic_faces
from gelsim.live.layer import Elastic, Layer
from gelsim.scene.definition import Scene

EPS = np.finfo(float).eps
STIFFNESS = 5.0  # N/m
Array = np.ndarray


def sphere_faces(subdivisions: int, radius: float) -> tuple[Array, Array]:
    """Nodes (N, 3) and six-node faces of a sphere, middles on it."""
    ball = trimesh.creation.icosphere(subdivisions)
    surface = quadratic_faces(np.asarray(ball.vertices, float), np.asarray(ball.faces, np.int32))
    return radius * surface.nodes / np.linalg.norm(surface.nodes, axis=1)[:, None], surface.faces


def arc_edges(count: int, radius: float) -> tuple[Array, Array]:
    """Nodes and three-node edges of a half circle about the axis, from pole to pole."""
    angle = np.linspace(0, np.pi, 2 * count + 1)
    start = 2 * np.arange(count)
    nodes = radius * np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    return np.where(np.abs(nodes) < 1e-12, 0.0, nodes), np.column_stack([start, start + 2, start + 1])


def energy_of_triangles(coat: Coat, displacement: Array) -> complex:
    """μt/2 (I₁ + 1/det C - 3) of each triangle by its three sides alone (Gram matrices), so that nothing is shared with the kernels."""

    def gram(nodes: Array) -> Array:
        a, b, c = np.moveaxis(nodes[coat.pieces], 1, 0)
        sides = np.stack([b - a, c - a], axis=1)
        return sides @ np.swapaxes(sides, 1, 2)

    at_rest, now = gram(coat.rest), gram(coat.rest + displacement)
    first = np.trace(np.linalg.inv(at_rest) @ now, axis1=1, axis2=2)
    growth = np.linalg.det(now) / np.linalg.det(at_rest)
    return complex((STIFFNESS / 6 * 0.5 * np.linalg.det(at_rest) ** 0.5 * (first + 1 / growth - 3)).sum())


def energy_of_pieces(coat: Coat, displacement: Array, turned: bool) -> complex:
    a, b = np.moveaxis(coat.rest[coat.pieces], 1, 0)
    u, v = np.moveaxis(displacement[coat.pieces], 1, 0)

    def square(vectors: Array) -> Array:
        return (vectors**2).sum(axis=1)

    along = square(b + v - a - u) / square(b - a)
    around = ((a + u + b + v)[:, 0] / (a + b)[:, 0]) ** 2 if turned else 1.0
    weight = np.sqrt(square(b - a)) * ((a + b)[:, 0] / 2 if turned else 1.0)
    return complex((STIFFNESS / 6 * weight * (along + around + 1 / (along * around) - 3)).sum())


CASES = ("faces", "edges about the axis", "edges in plane strain")


def case_of(which: str) -> tuple[Coat, Array, Callable[[Array], complex]]:
    """A coat, a large displacement, and its energy."""
    rng = np.random.default_rng(5)
    if which == "faces":
        nodes, faces = sphere_faces(1, 2.0)
        coat = coat_of_faces(faces, nodes, STIFFNESS, "cpu")
        return coat, 0.12 * rng.uniform(-1, 1, nodes.shape) - 0.2 * nodes, lambda u: energy_of_triangles(coat, u)
    turned = which == CASES[1]
    nodes, edges = arc_edges(6, 2.0)
    coat = coat_of_edges(edges, nodes, STIFFNESS, turned)
    displacement = (0.1 * rng.uniform(-1, 1, nodes.shape) - 0.2 * nodes) * [1, 0, 1]
    displacement[nodes[:, 0] == 0, 0] = 0.0
    return coat, displacement, lambda u: energy_of_pieces(coat, u, turned)


def forces(coat: Coat, displacement: Array) -> Array:
    force = wp.zeros(len(displacement), dtype=wp.vec3d, device="cpu")
    coat.add_force(wp.array(displacement, dtype=wp.vec3d, device="cpu"), force)
    return force.numpy()


def matrix(coat: Coat, displacement: Array) -> Array:
    """Dense, over all displacements."""
    count = len(displacement)
    free = np.column_stack([np.ones((count, 3), bool), np.zeros(count, bool)])
    pattern = build_pattern(free, element_pairs(coat.pieces.astype(np.int32), count), "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    coat.add_tangent(wp.array(displacement, dtype=wp.vec3d, device="cpu"), pattern.pairs, values)
    dense = np.zeros((pattern.size, pattern.size))
    rows = np.repeat(np.arange(pattern.size), np.diff(pattern.indptr))
    dense[rows, pattern.indices] = values.numpy()
    return dense + np.triu(dense, 1).T


def worst(coat: Coat, displacement: Array, energy: Callable[[Array], complex]) -> tuple[float, float, float]:
    """Errors of energy, forces and matrix, each relative to its largest."""
    step, plane = 1e-30, np.ones(3) if coat.pieces.shape[1] == 3 else np.array([1, 0, 1])
    found, wanted = forces(coat, displacement), np.zeros(displacement.shape)
    tangent, differences = matrix(coat, displacement), np.zeros((displacement.size, displacement.size))
    for number in np.flatnonzero(np.tile(plane, len(displacement))):
        moved = displacement.astype(complex)
        moved.flat[number] += 1j * step
        wanted.flat[number] = energy(moved).imag / step
        there, back = displacement.copy(), displacement.copy()
        there.flat[number] += 1e-5
        back.flat[number] -= 1e-5
        differences[number] = ((forces(coat, there) - forces(coat, back)) * plane).ravel() / 2e-5
    inside = np.outer(np.tile(plane, len(displacement)), np.tile(plane, len(displacement)))
    forces(coat, displacement)
    return (
        abs(coat.energy() / energy(displacement).real - 1),
        float(np.abs((found - wanted) * plane).max() / np.abs(wanted).max()),
        float(np.abs(tangent * inside - differences).max() / np.abs(differences).max()),
    )


# sums of some hundred terms in float64; central differences of 1e-5 of millimetre-sized pieces: their squares, and noise of EPS/1e-5
BOUNDS = 1e4 * EPS, 1e4 * EPS, 1e-8


@pytest.mark.parametrize("which", CASES)
def test_forces_and_matrix_are_derivatives_of_the_energy(which: str) -> None:
    assert all(error < bound for error, bound in zip(worst(*case_of(which)), BOUNDS, strict=True))


@pytest.mark.parametrize("which", CASES)
def test_a_weight_off_by_a_millionth_is_found(which: str) -> None:
    coat, displacement, energy = case_of(which)
    spoilt = [*coat.constants[:-1], coat.constants[-1] * (1 + 1e-6 * (np.arange(len(coat.pieces)) == 3))]
    other = Coat(coat.kernels, coat.pieces, spoilt, coat.rest, "cpu")
    errors = worst(other, displacement, energy)
    assert errors[0] > BOUNDS[0] and errors[1] > BOUNDS[1]


def test_a_balloon() -> None:
    """p = 2 (E t/3)/R (1/λ - 1/λ⁷) of a neo-Hookean balloon of radius R blown to λ R; as p 4π(λR)² = Σ f·n."""
    radius, known = 2.0, {}
    for stretch in (0.7, 1.3, 2.0):
        pressure = 2 * STIFFNESS / 3 / radius * (1 / stretch - 1 / stretch**7)
        known[stretch] = pressure * 4 * np.pi * (stretch * radius) ** 2
    errors = []
    for fineness in (2, 3):
        nodes, faces = sphere_faces(fineness, radius)
        arc, edges = arc_edges(8 * fineness, radius)
        for stretch, wanted in known.items():
            for rest, coat, copies in ((nodes, coat_of_faces(faces, nodes, STIFFNESS, "cpu"), 1.0),
                                       (arc, coat_of_edges(edges, arc, STIFFNESS, True), 2 * np.pi)):  # fmt: skip
                found = copies * (forces(coat, (stretch - 1) * rest) * rest).sum() / radius
                errors.append(abs(found / wanted - 1))
    coarse, fine = np.reshape(errors, (2, -1))
    # chords for arcs: relative error of area (h/R)²/8 to /12, h = 0.32 and 0.16 of icospheres' halves, 0.20 and 0.13 of arcs'
    assert coarse.max() < 0.01 and (fine < 0.5 * coarse).all()


def coated(scene: Scene, stiffness: float) -> Scene:
    return replace(scene, gel=replace(scene.gel, coat_n_per_m=stiffness))


def test_a_press_as_solid_and_profile() -> None:
    """The same force by triangles and by pieces of edges, and the coat's part of it; the platen's work is stored."""
    by_solid, by_profile, drift = [], [], 0.0
    for stiffness in (0.0, 20.0):
        scene = coated(ball_scene(0.6, 4), stiffness)
        gel = flat_gel(0.5, 2.5)
        _, press = solved(problem_of(scene, gel, rigid_body(scene, gel)))
        by_solid.append(press.force[-1, 2])
        assert press.report.energy is not None
        drift = max(drift, abs(press.report.energy.drift))
        by_profile.append(press_of(scene)[1].force[-1, 2])
    bare, with_coat = np.array(by_solid) / by_profile
    share = by_profile[1] / by_profile[0] - 1
    assert 0.05 < share < 0.5
    assert abs(bare - 1) < 0.02 and abs(with_coat / bare - 1) < 0.05 * share
    assert drift < 0.01


def test_energy_without_the_coats_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Coat, "energy", lambda coat: 0.0)
    scene = coated(ball_scene(0.6, 4), 20.0)
    gel = flat_gel(0.5, 2.5)
    _, press = solved(problem_of(scene, gel, rigid_body(scene, gel)))
    assert press.report.energy is not None and press.report.energy.drift > 0.03


def test_its_part_in_the_derivative_by_the_gels_modulus() -> None:
    """Without it the force is in proportion to the modulus; with it, it is not."""
    force = {}
    for modulus in (49.95, 50.0, 50.05):
        scene = coated(ball_scene(0.4, 3, modulus_kpa=modulus), 20.0)
        gel = flat_gel(0.5, 2.5)
        problem = problem_of(scene, gel, rigid_body(scene, gel))
        force[modulus] = press_sensitivity(problem, [modulus], [])
    slope = (force[50.05].force[-1] - force[49.95].force[-1]) / 0.1
    found = force[50.0].force_gradient[-1, 0]
    assert abs(found / slope - 1) < 5e-5  # test_fem_sensitivity.py's
    assert found < 0.95 * force[50.0].force[-1] / 50.0


def test_many_as_one() -> None:
    """Of scenes with and without a coat, and of others' sizes, each has its own."""
    coat, displacement, _ = case_of("faces")
    nodes, faces = sphere_faces(1, 2.5)
    larger = coat_of_faces(faces, nodes, 2 * STIFFNESS, "cpu")
    joint = Coat.join([None, coat, larger])
    assert joint is not None and Coat.join([None, None]) is None
    none, one, other = np.split(forces(joint, np.vstack([displacement] * 3)), 3)
    assert not none.any()
    assert np.allclose(one, forces(coat, displacement), rtol=1e-12, atol=0)
    assert np.allclose(other, forces(larger, displacement), rtol=1e-12, atol=0)


def test_waves_of_the_live_layer() -> None:
    """The face's compliance with a sheet on it: (C⁻¹ + K)⁻¹ of each wave, K = E t/(1 - ν²) k² along, E t/(2 (1 + ν)) k² across, ν = 1/2."""
    bare, coated_layer = (Layer((12.0, 12.0), Elastic(20.0, 0.49, stiffness)) for stiffness in (0.0, STIFFNESS))
    c, found = bare.spectrum(80).astype(complex), coated_layer.spectrum(80).astype(complex)

    def compliance(answers: Array) -> Array:
        normal, xx, yy, xy, xz, yz = answers
        rows = [[xx, xy, xz], [xy, yy, yz], [-xz, -yz, normal]]
        return np.moveaxis(np.array(rows), (0, 1), (2, 3))

    kx = 2 * np.pi * np.fft.rfftfreq(bare.shape[1], bare.cell[0])[None, :]
    ky = 2 * np.pi * np.fft.fftfreq(bare.shape[0], bare.cell[1])[:, None]
    kx, ky = np.broadcast_arrays(kx, ky)
    sheet = np.zeros((*kx.shape, 3, 3))
    for i, a in enumerate((kx, ky)):
        for j, b in enumerate((kx, ky)):
            sheet[..., i, j] = STIFFNESS * ((4 / 3 - 1 / 3) * a * b + (i == j) * (kx**2 + ky**2) / 3)
    wanted = np.linalg.inv(np.linalg.inv(compliance(c)) + sheet)
    inside = np.s_[1 : bare.shape[0] // 2, 1 : bare.shape[1] // 2]
    error = np.abs(compliance(found) - wanted)[inside].max() / np.abs(wanted[inside]).max()
    assert error < 1e-5  # single precision
    assert np.abs(compliance(c) - wanted)[inside].max() > 100 * error * np.abs(wanted[inside]).max()
