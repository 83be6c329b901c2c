"""Solids of two materials: layers in series against their closed form, kernels with split pressures against the twin, parts of a press."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_fixtures import box_mesh, cap_scene, equilibrium, flat_gel, soft_cap, solved, tangent_of
from scipy.optimize import brentq

from gelsim.fem import reference
from gelsim.fem.assembly import Solids
from gelsim.fem.elements import TetQuadrature, tet_quadrature_data
from gelsim.fem.pattern import split_pressures
from gelsim.fem.problem import Numerics, PressProblem, isochoric_constants
from gelsim.geometry import TET_EDGES, TetMesh
from gelsim.scene import materials
from gelsim.scene.definition import Grains, Skin
from gelsim.scene.materials import ElasticMaterial
from gelsim.shape import shapes

EPS = np.finfo(float).eps
MM = 1e-3


def layered(soft: ElasticMaterial, stiff: ElasticMaterial, split: bool = True) -> tuple[Solids, TetMesh]:
    """A block of 2 mm with its sides on sliding planes, the stiff layer from z = 1.2 mm up, interface along faces of distorted tets."""
    line, heights = np.linspace(0, 2 * MM, 4), np.array([0.0, 0.7, 1.2, 1.7, 2.0]) * MM
    mesh = box_mesh(line, line, heights, ("bottom", "top", "side"))
    x = mesh.rest_positions
    x[:, :2] += 0.1 * (x[:, :2] * (2 * MM - x[:, :2]) / MM) * np.sin(3 * x[:, 2:] / MM)  # sheared within the block: no symmetric pieces
    for middle, (one, two) in enumerate(TET_EDGES):  # and straight, or four points would not integrate them exactly
        x[mesh.tets[:, 4 + middle]] = 0.5 * (x[mesh.tets[:, one]] + x[mesh.tets[:, two]])
    regions = (x[mesh.tets[:, :4], 2].mean(axis=1) > 1.2 * MM).astype(np.int32)
    fixed = (np.abs(x) < 1e-12) | (np.abs(x - 2 * MM) < 1e-12)
    rest = x / MM
    pressures, copies = split_pressures(mesh.tets, regions, len(rest))
    if split:
        rest, fixed = np.concatenate([rest, rest[copies]]), np.concatenate([fixed, fixed[copies]])
    both = (soft, stiff)
    law = np.array([isochoric_constants(material) for material in both])[regions]
    kappa = np.array([material.kappa * 1e-3 for material in both])[regions]
    data = tet_quadrature_data(TetMesh(x / MM, mesh.tets), 4)
    return Solids(rest, mesh.tets, data, law, kappa, fixed, "cpu", pressures if split else None), mesh


def confined_stress(stretch: float, material: ElasticMaterial) -> float:
    """P₃₃ [kPa] of F = diag(1, 1, λ): J = λ, 2c₁ J^(-2/3) (λ - I₁/(3λ)) + κ (J - 1), straight from the law."""
    return material.mu * 1e-3 * stretch ** (-2 / 3) * (stretch - (2 + stretch**2) / (3 * stretch)) + material.kappa * 1e-3 * (stretch - 1)


@pytest.mark.parametrize("split", [True, False], ids=["", "one pressure across the interface"])
@pytest.mark.parametrize(("nu", "shortening"), [(0.0, 0.3), (0.3, 0.2), (0.499, 0.002)])
def test_confined_layers_in_series(nu: float, shortening: float, split: bool) -> None:
    """Both layers carry one stress; stretches are constant in each, pressures jump between them: the mesh holds the answer exactly."""
    soft, stiff = (ElasticMaterial.from_modulus(modulus, nu) for modulus in (50e3, 500e3))
    low, high = 1.2, 0.8

    def upper(stretch: float) -> float:
        return (2 - shortening - low * stretch) / high

    lower = float(brentq(lambda s: confined_stress(s, soft) - confined_stress(upper(s), stiff), 0.5, 1.0, xtol=1e-15))  # type: ignore[arg-type]
    wanted = 4.0 * confined_stress(lower, soft)
    solids, mesh = layered(soft, stiff, split)
    start = np.zeros_like(solids.rest)
    start[:, 2] = -shortening * solids.rest[:, 2] / 2
    iterations = equilibrium(solids, start)
    top = mesh.rest_positions[:, 2] > 2 * MM - 1e-12
    count = len(mesh.rest_positions)
    force = solids.internal_force()[0][:count][top, 2].sum()
    error = abs(force / wanted - 1)
    z = solids.rest[:count, 2]
    exact = np.where(z <= 1.2, (lower - 1) * z, (lower - 1) * low + (upper(lower) - 1) * (z - 1.2))
    moved = np.abs(solids.displacement.numpy()[:count, 2] - exact).max()
    # Newton stops at steps of 1e-11 of the block; κ/μ ≤ 500 makes stresses of it
    fine = error < 1e-8 and moved < 1e-9
    assert iterations > 1 and fine == split


def test_split_pressures_match_the_twin() -> None:
    solids, mesh = layered(ElasticMaterial.from_modulus(50e3, 0.49), ElasticMaterial.from_modulus(200e3, 0.49))
    rng = np.random.default_rng(3)
    u = np.where(solids.free[:, :3], 0.03 * rng.uniform(-1, 1, solids.rest.shape), 0.0)
    solids.set_state((u, np.where(solids.free[:, 3], rng.uniform(-20, 20, len(u)), 0.0)))
    cells, _, _, gradients, weights, shape, law, kappa = (array.numpy() for array in solids._inputs)
    some = np.flatnonzero((cells[:, 10:] != cells[:, :4]).any(axis=1) | (cells[:, :4] % 7 == 0).any(axis=1))[:60]
    part = Solids(solids.rest, mesh.tets[some], tet_quadrature_data(TetMesh(solids.rest, mesh.tets[some]), 4), law[some], kappa[some],
                  ~solids.free[:, :3], "cpu", cells[some, 10:])  # fmt: skip
    part.set_state(solids.state())
    _, p = solids.state()
    used, small = np.unique(cells[some], return_inverse=True)  # a dense twin of the nodes that take part
    small = small.reshape(-1, 14).astype(np.int32)
    _, residual, tangent = reference.assemble(
        u[used], p[used], small[:, :10], TetQuadrature(gradients[some], weights[some], shape), law[some], kappa[some], small[:, 10:]
    )
    force, volume, _ = part.internal_force()
    kept = part.free[used]
    # 30 ulps as in test_fem_twin.py, of up to 24 tets at a node: root of it
    bound = 150 * EPS
    assert (cells[some, 10:] != cells[some, :4]).any() and kept.sum() == part.unknowns
    assert np.abs(force[used] - residual[:, :3]).max() <= bound * np.abs(residual[:, :3]).max()
    assert np.abs(volume[used] - residual[:, 3]).max() <= bound * np.abs(residual[:, 3]).max()
    wanted = tangent[kept][:, kept]
    assert np.abs(tangent_of(part).toarray() - wanted).max() <= bound * np.abs(wanted).max()


def test_pressures_are_split_on_the_interface_alone() -> None:
    solids, mesh = layered(ElasticMaterial.from_modulus(50e3, 0.3), ElasticMaterial.from_modulus(60e3, 0.3))
    copies = solids.rest[len(mesh.rest_positions) :]
    assert len(copies) == 16 and (np.abs(copies[:, 2] - 1.2) < 1e-12).all()  # a 4 x 4 grid of vertices
    assert solids.free[-16:].tolist() == [[False, False, False, True]] * 16


# ---------------------------------------------------------------------------------------------------------------- presses
def capped(stiffness: float | None) -> float:
    """Force [N] of `soft_cap` of 100 kPa whose lowest layers are of another modulus [kPa]; None: of one region."""
    scene, body = cap_scene(100.0, 0.4, 3), soft_cap()
    gel = flat_gel(0.7, 2.1)
    regions = (body.rest_positions[body.tets[:, :4], 2].max(axis=1) < 3e-3).astype(np.int32)
    assert 0 < regions.sum() < len(regions)
    mesh = body if stiffness is None else TetMesh(body.rest_positions, body.tets, body.groups, body.symmetry, regions)
    soft = materials.object_material(scene)
    assert soft is not None
    others = [] if stiffness is None else [ElasticMaterial.from_modulus(stiffness * 1e3, soft.poissons_ratio)]
    place = shapes.placement(scene, mesh.surface("contact"))
    problem = PressProblem(scene, gel, mesh, place, [materials.gel_material(scene), soft, *others], "cpu", Numerics(tolerance=1e-5))
    _, deformation = solved(problem)
    return float(-deformation.force[-1, 2])


def test_a_part_of_the_same_material_changes_nothing() -> None:
    assert capped(100.0) == pytest.approx(capped(None), rel=1e-9)  # from_modulus of the same numbers: the same equations, to the bit or so


def test_a_stiffer_part_stiffens_the_press_and_a_softer_one_softens_it() -> None:
    soft, same, stiff, rigid = capped(20.0), capped(None), capped(1000.0), capped(1e6)
    assert soft < 0.95 * same and 1.05 * same < stiff < rigid
    assert rigid < 1.3 * stiff  # what is left to give way is the gel, and the body above


def test_parts_of_the_scene() -> None:
    scene = cap_scene(100.0, 0.4, 3)
    body = replace(scene.object, skin=Skin(thickness_mm=0.5, shore_a=30), grains=Grains(count=3, youngs_modulus_kpa=900), prony_g=(0.2,),
                   prony_tau_s=(1.0,))  # fmt: skip
    found = materials.object_materials(scene.replace(object=body))
    assert list(found) == ["body", "skin", "grains"] == list(materials.parts(body))
    assert [m.youngs_modulus for m in found.values()] == pytest.approx([100e3, materials.modulus_from_shore_a(30), 900e3], rel=1e-12)
    assert all(m.prony == ((0.2, 1.0),) for m in found.values())
    assert materials.parts(replace(body, skin=Skin())) == ("body", "grains")
