"""Solids without contact whose answers are known: patch test, rotation, bars of three laws, Cook's membrane, bonded discs."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from gelsim.bench.section import Known
from gelsim.bench.structured import Array, box_mesh, quarter_disc
from gelsim.fem.assembly import Solids
from gelsim.fem.equilibrium import equilibrium, solids_of
from gelsim.fem.locking import lock
from gelsim.geometry import TetMesh, outer_faces
from gelsim.scene.materials import ElasticMaterial
from gelsim.units import MM

MODULUS = 50e3  # Pa
AFFINE = np.array([[0.2, 0.3, -0.1], [0.0, -0.15, 0.1], [0.1, 0.05, -0.1]])
"""A finite displacement gradient that bends no rule of the law: det F = 0.95."""
LAWS: dict[str, tuple[float, ...]] = {"neo-hookean": (), "yeoh": (0.096, -0.0036), "ogden": (2.9, 1.0)}
"""Constants of the order of Dragon Skin 20's (docs/physics.md)."""


def known() -> Iterator[Known]:
    for nu in (0.3, 0.4999):
        yield Known(f"patch test, distorted tets, ν {nu}: u off A x", partial(_patch, nu), 1e-9, "exact")
    for angle in (1.0, 90.0):
        yield Known(f"rotation by {angle:g}°: force over μ h²", partial(_rotation, angle), 1e-13, "exact")
    for law in LAWS:
        for stretch in (0.6, 1.7):
            yield Known(f"bar, {law}, λ = {stretch}: nominal stress", partial(_bar, law, stretch), 2e-3, "incompressible, ν 0.4999", "kPa")
    cook = "another code, plane strain"
    for cells in (8, 16, 32):
        # the clamped corner is singular, so errors fall like h; the other code's move by 0.6 and 1.1 % from 8 to 32 cells, and a tet has
        # longer edges
        for component, name in ((1, "v"), (0, "u")):
            yield Known(
                f"Cook's membrane, {cells} cells: {name}", partial(_cook, cells, component), 0.2 / cells, cook, "mm", quick=cells < 32
            )
    yield Known("Cook's membrane, small load, 16 cells: v", partial(_cook_linear, False), 0.01, cook, "mm")
    yield Known("Cook's membrane, small load, 16 cells, a locking element: v", partial(_cook_linear, True), 0.01, cook, "mm", control=True)
    for nu, force in ((0.49, 1.237), (0.499, 1.394)):
        yield Known(f"bonded disc R 5, h 2.4, 10 %, ν {nu}", partial(_disc, nu, force), 7e-3, "another code, ± 0.3 %", "N")
    yield Known(
        "bonded disc D 25, h 2.4, 0.1 %: apparent modulus", _gent_lindley, 0.1, "Gent and Lindley 1959, with the bulk modulus", "kPa"
    )


def _block(shake: float = 0.25) -> tuple[TetMesh, NDArray[np.bool_]]:
    """A block of 2 mm with shaken vertices, and which of its nodes are on the boundary."""
    line = np.linspace(0, 2 * MM, 4)
    mesh = box_mesh(line, line, line, ("bonded", "top", "side"), shake=shake)
    boundary = np.zeros(len(mesh.rest_positions), bool)
    boundary[np.unique(outer_faces(mesh.tets))] = True
    return mesh, boundary


def _patch(nu: float) -> tuple[float, float, float]:
    mesh, boundary = _block()
    solids = solids_of(mesh, ElasticMaterial.from_modulus(MODULUS, nu), np.repeat(boundary[:, None], 3, 1))
    wanted = solids.rest @ AFFINE.T
    noise = np.random.default_rng(11).uniform(-0.02, 0.02, wanted.shape) * np.abs(wanted).max()
    equilibrium(solids, np.where(boundary[:, None], wanted, wanted + noise))
    return float(np.abs(solids.displacement.numpy() - wanted).max()), 0.0, float(np.abs(wanted).max())


def _rotation(angle_deg: float) -> tuple[float, float, float]:
    mesh, _ = _block()
    material = ElasticMaterial.from_modulus(MODULUS, 0.4999)
    solids = solids_of(mesh, material, np.zeros((len(mesh.rest_positions), 3), bool))
    axis = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    cross, angle = np.cross(np.eye(3), axis), np.deg2rad(angle_deg)
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    solids.set_state((solids.rest @ (turn - np.eye(3)).T, np.zeros(len(solids.rest))))
    force, _, _ = solids.internal_force()
    return float(np.abs(force).max()), 0.0, material.mu * 1e-3 * (2.0 / 3.0) ** 2


def _bar(law: str, stretch: float) -> tuple[float, float, float]:
    """Nominal stress [kPa] of a bar with free sides, and the closed form of the incompressible law (physics.md §5.7)."""
    material = ElasticMaterial.from_modulus(MODULUS, 0.4999, law, LAWS[law])
    mesh, boundary = _block()
    top = mesh.rest_positions[:, 2] > 2 * MM - 1e-12
    fixed = np.abs(mesh.rest_positions) < 1e-12
    fixed[top, 2] = True
    solids = solids_of(mesh, material, fixed)
    start = solids.rest * (np.array([stretch**-0.5, stretch**-0.5, stretch]) - 1)
    start[~boundary] += np.random.default_rng(11).uniform(-0.01, 0.01, (int((~boundary).sum()), 3))
    equilibrium(solids, start)
    stress = float(solids.internal_force()[0][top, 2].sum()) / 4.0
    mu, excess = material.mu * 1e-3, stretch**2 + 2 / stretch - 3
    closed = mu * (stretch - stretch**-2)
    if law == "yeoh":
        closed *= 1 + 2 * LAWS[law][0] * excess + 3 * LAWS[law][1] * excess**2
    elif law == "ogden":
        alpha = LAWS[law][0]
        closed = 2 * mu / alpha * (stretch ** (alpha - 1) - stretch ** (-alpha / 2 - 1))
    return stress, closed, closed


# ---------------------------------------------------------------------------------------------------------------- Cook's membrane
COOK = -5.818, 6.923
"""Tip displacement (u, v) [mm] at 32 cells a side: neo-Hookean, E 240.565, ν 0.4999, F 100 per unit thickness."""
COOK_SMALL = 7.752
"""v [mm] of linear elasticity, E 250, likewise."""


def _cook(cells: int, component: int) -> tuple[float, float, float]:
    return cook_tip(cells, 240.565, 100.0)[component], COOK[component], COOK[component]


def _cook_linear(locked: bool) -> tuple[float, float, float]:
    """A thousandth of the load, a thousandth of the displacement."""
    return 1e3 * cook_tip(16, 250.0, 0.1, locked)[1], COOK_SMALL, COOK_SMALL


@lru_cache
def cook_tip(cells: int, modulus_kpa: float, force: float, locked: bool = False) -> tuple[float, float]:
    """Displacement (u, v) [mm] of the point (48, 60), mean over the thickness, of a slab one cell thick that cannot move along z.

    The tapered panel (0, 0), (48, 44), (48, 60), (0, 44), clamped at x = 0, carries `force` [kPa mm] a unit thickness, spread evenly along
    its other end.
    """
    line = np.linspace(0.0, 1.0, cells + 1)
    thickness = 44.0 / cells
    mesh = box_mesh(line, line, np.array([0.0, 1.0]), ("back", "front", "rim"))
    s, t, w = mesh.rest_positions.T
    nodes = np.column_stack([48 * s, 44 * s + t * (44 - 28 * s), thickness * w]) * MM
    mesh = TetMesh(nodes, mesh.tets, mesh.groups)
    fixed = np.zeros(nodes.shape, bool)
    fixed[(w == 0.0) | (w == 1.0), 2] = True
    fixed[s == 0.0] = True
    solids = solids_of(mesh, ElasticMaterial.from_modulus(modulus_kpa * 1e3, 0.4999), fixed)
    if locked:
        lock(solids)
    faces = mesh.groups["rim"]
    faces = faces[(s[faces] == 1.0).all(axis=1)]
    corner = solids.rest[faces[:, :3]]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    load = np.zeros(nodes.shape)
    # a constant traction on a flat six-node face goes to its middles, a third of the area each
    load[:, 1] = np.bincount(faces[:, 3:].ravel(), np.repeat(area / 3, 3), len(nodes)) * force / 16.0
    displacement: Array = np.zeros(nodes.shape)
    for share in np.linspace(0, 1, 6)[1:]:
        equilibrium(solids, displacement, load * share, 1e-9)
        displacement = solids.state()[0]
    tip = (s == 1.0) & (t == 1.0)
    u, v, _ = displacement[tip].mean(axis=0)
    return float(u), float(v)


# ---------------------------------------------------------------------------------------------------------------- bonded discs
def _compressed(radius_mm: float, cells: int, half_mm: float, material: ElasticMaterial, strain: float) -> float:
    """Force [N] on a disc of height 2 half_mm, bonded to both platens; a quarter of its half, the middle plane sliding."""
    disc = quarter_disc(radius_mm, cells, half_mm * np.array([0, 0.35, 0.65, 0.85, 1.0]), ("middle", "bonded", "rim"))
    node = disc.rest_positions
    top = node[:, 2] > half_mm * MM - 1e-12
    fixed = node == 0.0
    fixed[top] = True
    solids: Solids = solids_of(disc, material, fixed)
    start = np.zeros_like(node)
    start[:, 2] = -strain * solids.rest[:, 2]
    equilibrium(solids, start)
    return float(-4 * solids.internal_force()[0][top, 2].sum() * 1e-3)


def _disc(nu: float, force: float) -> tuple[float, float, float]:
    """The rim where the bond ends is singular: force falls like h^1.2 of the rim cells. Two meshes, extrapolated by that."""
    material = ElasticMaterial.from_modulus(MODULUS, nu)
    coarse, fine = (_compressed(5.0, cells, 1.2, material, 0.1) for cells in (6, 9))
    return fine + (fine - coarse) / ((9 / 6) ** 1.2 - 1), force, force


def _gent_lindley() -> tuple[float, float, float]:
    """E_a = E (1 + 2 S²), S = D/(4h), in series with the bulk modulus; a formula good to some per cent."""
    material = ElasticMaterial.from_modulus(MODULUS, 0.499)
    shape_factor = 25.0 / (4 * 2.4)
    apparent = 1 / (1 / (MODULUS * (1 + 2 * shape_factor**2)) + 1 / material.kappa) * 1e-3
    ours = _compressed(12.5, 10, 1.2, material, 1e-3) / (np.pi * 12.5**2 * 1e-3) * 1e3
    return ours, apparent, apparent
