"""Meshes, solids and presses for the tests of the mechanics: structured, deterministic, small, made in milliseconds without fTetWild."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray

from gelsim import materials, shapes
from gelsim.errors import SolveStatus
from gelsim.fem.assembly import Solids, build_pattern
from gelsim.fem.elements import tet_quadrature_data
from gelsim.fem.linear import make_solver
from gelsim.fem.problem import PressProblem, isochoric_constants
from gelsim.fem.quasistatic import run_press
from gelsim.geometry import QuadraticSurface, TetMesh, mirror, mirror_surface, outer_faces, quadratic_tets, tet_volumes
from gelsim.materials import ElasticMaterial
from gelsim.results import Deformation
from gelsim.scene import Body, Contact, Gel, Press, Scene

wp.config.quiet = True
Array = NDArray[np.float64]
MM = MILLI = 1e-3
E_GEL = 50.0  # kPa, the gel of the reference solutions
TOLERANCE = 1e-5  # Newton's in the tests: finer than "fast" has it, so that what is compared is the equations and not where Newton stops


# ---------------------------------------------------------------------------------------------------------------- meshes
def kuhn_box(x: Array, y: Array, z: Array) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and four-node tets of a box, six tets a cell along the paths from its lowest to its highest corner."""
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(len(x), len(y), len(z))
    corner = [number[i : len(x) - 1 + i, j : len(y) - 1 + j, k : len(z) - 1 + k].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    paths = [(1, 2), (1, 4), (2, 1), (2, 4), (4, 1), (4, 2)]
    tets = np.vstack([np.stack([corner[0], corner[a], corner[a + b], corner[7]], axis=1) for a, b in paths])
    wrong = tet_volumes(points, tets) < 0
    tets[wrong] = tets[wrong][:, [1, 0, 2, 3]]
    return points, tets.astype(np.int32)


def box_mesh(x: Array, y: Array, z: Array, bottom: str, top: str, side: str, symmetry: str = "", shake: float = 0.0,
             bend: float = 0.0) -> TetMesh:  # fmt: skip
    """A box of ten-node tets [m] with its faces grouped by name; faces on the planes of `symmetry` belong to none.

    `shake` moves inner vertices, `bend` inner mid-side nodes, at random, by up to this share of the smallest cell.
    """
    rng = np.random.default_rng(7)
    vertices, tets = kuhn_box(x, y, z)
    cell = min(np.diff(line).min() for line in (x, y, z))
    low, high = vertices.min(0), vertices.max(0)

    def moved(points: Array, share: float) -> Array:
        inner = ((points > low + 1e-12) & (points < high - 1e-12)).all(axis=1)
        return points + share * cell * rng.uniform(-1, 1, points.shape) * inner[:, None]

    vertices = moved(vertices, shake)
    nodes, tets10 = quadratic_tets(vertices, tets)
    nodes[len(vertices) :] = moved(nodes[len(vertices) :], bend)
    faces = outer_faces(tets10)
    centre = nodes[faces[:, :3]].mean(axis=1)
    names = np.full(len(faces), side, dtype=object)
    names[centre[:, 2] < low[2] + 1e-12] = bottom
    names[centre[:, 2] > high[2] - 1e-12] = top
    for axis in symmetry:
        column = "xy".index(axis)
        nodes[np.abs(nodes[:, column]) < 1e-12, column] = 0.0
        names[centre[:, column] < low[column] + 1e-12] = ""
    groups = {str(name): faces[names == name] for name in sorted(set(names)) if name}
    return TetMesh(nodes, tets10, groups, frozenset(symmetry))


def graded(fine: float, reach: float, end: float, growth: float) -> Array:
    """Points on 0 … end [m]: steps of `fine` to `reach`, then each `growth` times the last."""
    points = list(np.arange(round(reach / fine) + 1) * fine)
    while points[-1] < end:
        fine *= growth
        points.append(points[-1] + fine)
    points[-1] = end
    if points[-1] - points[-2] < 0.5 * (points[-2] - points[-3]):
        points.pop(-2)
    return np.array(points)


@lru_cache
def flat_gel(fine_mm: float = 0.5, reach_mm: float = 2.5, layers: int = 2, half_mm: float = 12.5, thickness_mm: float = 2.4,
             whole: str = "") -> TetMesh:  # fmt: skip
    """A quarter of a flat gel, fine around the origin, thinner layers above; mirrored at the planes named in `whole`."""
    line = graded(fine_mm * MM, reach_mm * MM, half_mm * MM, 1.7)
    z = -thickness_mm * MM * np.linspace(1, 0, layers + 1) ** 1.4
    mesh = box_mesh(line, line, z, "bonded", "coated", "side", "xy")
    for axis in whole:
        mesh = mirror(mesh, axis)
    return mesh


def quarter_disc(
    radius_mm: float, cells: int, z_mm: Array, bottom: str, top: str, side: str, cap_radius_mm: float | None = None
) -> TetMesh:
    """A quarter of a round block, finer toward its rim, with its middles on the circle; with a spherical underside of `cap_radius_mm`.

    The square grid is mapped by x = u √(1 - v²/2), y = v √(1 - u²/2), which takes the unit square's edge to the unit circle.
    """
    line = np.linspace(0, 1, cells + 1)
    line = line * (1.6 - 0.6 * line) if cap_radius_mm is None else line * (0.6 + 0.4 * line)
    mesh = box_mesh(line, line, z_mm * MM, bottom, top, side, "xy")
    u, v, z = mesh.rest_positions.T
    x, y = radius_mm * MM * u * np.sqrt(1 - v**2 / 2), radius_mm * MM * v * np.sqrt(1 - u**2 / 2)
    if cap_radius_mm is not None:
        rise = cap_radius_mm * MM - np.sqrt((cap_radius_mm * MM) ** 2 - x**2 - y**2)
        z = z + rise * (z.max() - z) / (z.max() - z.min())
    return TetMesh(np.column_stack([x, y, z]), mesh.tets, mesh.groups, mesh.symmetry)


@lru_cache
def soft_cap() -> TetMesh:
    """A quarter of a soft object in its own frame: a ball's cap of R = 5 mm, 8 mm across, on a foot, 8 mm tall overall."""
    z = 8.0 * np.array([0.0, 0.08, 0.2, 0.45, 1.0])
    mesh = quarter_disc(4.0, 5, z, "contact", "base", "flank", cap_radius_mm=5.0)
    groups = {"base": mesh.groups["base"], "contact": np.vstack([mesh.groups["contact"], mesh.groups["flank"]])}
    return TetMesh(mesh.rest_positions, mesh.tets, groups, mesh.symmetry)


# ---------------------------------------------------------------------------------------------------------------- solids alone
def solids_of(mesh: TetMesh, material: ElasticMaterial, fixed: NDArray[np.bool_], points: int = 4) -> Solids:
    """One solid in solver units (mm, kPa)."""
    rest = mesh.rest_positions / MM
    data = tet_quadrature_data(TetMesh(rest, mesh.tets), points)
    count = len(mesh.tets)
    law = np.tile(isochoric_constants(material), (count, 1))
    return Solids(rest, mesh.tets, data, law, np.full(count, material.kappa * 1e-3), fixed, "cpu")


def residual_of(solids: Solids) -> tuple[Array, float]:
    """The equations of the unknowns, and the smallest det F."""
    force, volume, smallest = solids.internal_force()
    return np.concatenate([force, volume[:, None]], axis=1)[solids.free], smallest


def tangent_of(solids: Solids) -> sp.csr_matrix:
    """The whole symmetric tangent."""
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    solids.add_tangent(pattern.pairs, values)
    upper = sp.csr_matrix((values.numpy(), pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size))
    return (upper + sp.triu(upper, 1).T).tocsr()


def equilibrium(solids: Solids, start: Array) -> int:
    """Plain Newton to equilibrium from displacements `start` [mm] (N, 3), whose prescribed components stay; the iterations it took.

    Ends when a step moves no node by more than 1e-11 of the body.
    """
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    solver = make_solver()
    solver.analyse(pattern.indptr, pattern.indices, np.zeros(len(pattern.indices)))
    solids.set_state((start, solids.state()[1]))
    for iteration in range(1, 31):
        residual, smallest = residual_of(solids)
        assert smallest > 0, "an element turned inside out"
        values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
        solids.add_tangent(pattern.pairs, values)
        solver.factorise(values.numpy())
        change = solver.solve(-residual)
        state, fraction = solids.state(), 1.0
        solids.move(state, change, fraction)
        while residual_of(solids)[1] <= 0.1 and fraction > 1e-3:  # an element would turn inside out
            fraction /= 2
            solids.move(state, change, fraction)
        moved = np.zeros(solids.free.shape)
        moved[solids.free] = change
        if np.abs(moved[:, :3]).max() < 1e-11 * np.ptp(solids.rest, axis=0).max():
            return iteration
    raise AssertionError("Newton did not converge in 30 iterations")


# ---------------------------------------------------------------------------------------------------------------- presses
def cap_scene(
    modulus_kpa: float, depth_mm: float, frames: int, friction: float | str = 0.0, gel_kpa: float = E_GEL, **press: object
) -> Scene:
    """`soft_cap` on the flat gel."""
    return Scene(
        gel=Gel(profile="flat", youngs_modulus_kpa=gel_kpa),
        object=Body(shape="hemisphere", radius_mm=5.0, height_mm=8.0, youngs_modulus_kpa=modulus_kpa),
        contact=Contact(friction_coefficient=friction),
        press=Press(depth_mm=depth_mm, force_n=None, frames=frames, **press),  # type: ignore[arg-type]
        fidelity="fast",
    )


def ball_scene(depth_mm: float, frames: int, nu: float = 0.499, friction: float | str = 0.0, radius_mm: float = 5.0,
               modulus_kpa: float = E_GEL, fidelity: str = "fast", **press: object) -> Scene:  # fmt: skip
    """A rigid ball on the flat gel of the reference solutions."""
    return Scene(
        gel=Gel(profile="flat", youngs_modulus_kpa=modulus_kpa, poissons_ratio=nu),
        object=Body(shape="hemisphere", radius_mm=radius_mm, height_mm=10.0, rigid=True),
        contact=Contact(friction_coefficient=friction),
        press=Press(depth_mm=depth_mm, force_n=None, frames=frames, **press),  # type: ignore[arg-type]
        fidelity=fidelity,
    )


def problem_of(scene: Scene, gel: TetMesh, body: TetMesh | QuadraticSurface) -> PressProblem:
    surface = body if isinstance(body, QuadraticSurface) else body.surface("contact")
    gel_material, object_material = materials.gel_material(scene), materials.object_material(scene)
    return PressProblem(scene, gel, body, shapes.placement(scene, surface), gel_material, object_material, "cpu", tolerance=TOLERANCE)


@lru_cache
def rigid_quarter(scene: Scene) -> QuadraticSurface:
    return shapes.rigid_surface(scene, frozenset("xy"))


def rigid_body(scene: Scene, gel: TetMesh) -> QuadraticSurface:
    """The object's surface, cut where the gel is; the whole one is the quarter mirrored, so that both see the same facets."""
    surface = rigid_quarter(scene)
    for axis in sorted({"x", "y"} - gel.symmetry):
        surface = mirror_surface(surface, axis)
    return surface


@lru_cache
def ball_press(scene: Scene, fine_mm: float = 0.5, reach_mm: float = 2.5, whole: str = "") -> tuple[PressProblem, Deformation]:
    """A solved press on the structured gel, and the problem in its last state."""
    gel = flat_gel(fine_mm, reach_mm, whole=whole)
    return solved(problem_of(scene, gel, rigid_body(scene, gel)))


@lru_cache
def cap_press(scene: Scene, whole: str = "") -> tuple[PressProblem, Deformation]:
    """The same of `soft_cap`."""
    body = soft_cap()
    for axis in whole:
        body = mirror(body, axis)
    return solved(problem_of(scene, flat_gel(0.7, 2.1, whole=whole), body))


def solved(problem: PressProblem) -> tuple[PressProblem, Deformation]:
    deformation = run_press(problem)
    assert deformation.status is SolveStatus.CONVERGED
    return problem, deformation
