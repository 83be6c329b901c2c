"""Blocks of revolution and in plane strain with known answers: patch, bar, bonded disc, Cook's membrane, line contact, ball on a layer."""

from __future__ import annotations

import numpy as np
import pytest
from planar_fixtures import Array, grid, press_of, solids_of

from gelsim.fem.equilibrium import equilibrium
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene
from gelsim.scene.materials import ElasticMaterial

EPS = np.finfo(float).eps


@pytest.mark.parametrize("nu", [0.3, 0.4999])
@pytest.mark.parametrize("turned", [True, False])
def test_patch(turned: bool, nu: float) -> None:
    """Homogeneous strain on the boundary of distorted triangles stays homogeneous inside, with one pressure."""
    nodes, triangles = grid(np.linspace(0, 2.0, 5), np.linspace(0, 1.5, 4), shake=0.25)
    a = np.diag([0.15, 0.0, -0.2]) if turned else np.array([[0.15, 0, 0.1], [0, 0, 0], [-0.05, 0, -0.2]])
    boundary = ((nodes == nodes.min(0)) | (nodes == nodes.max(0)))[:, [0, 2]].any(axis=1)
    fixed = np.repeat(boundary[:, None], 3, 1)
    material = ElasticMaterial.from_modulus(50e3, nu)
    solids = solids_of(nodes, triangles, material, fixed, turned)
    wanted = nodes @ a.T
    inside = np.random.default_rng(1).uniform(-0.02, 0.02, nodes.shape) * ~boundary[:, None] * [1, 0, 1]
    equilibrium(solids, wanted + inside)
    u, p = solids.state()
    bound = 1e-11 + 1e6 * EPS  # as in test_fem_blocks: Newton's end, and rounding at a condition of 1e6
    assert (~boundary).sum() > 20
    assert np.abs(u - wanted).max() <= bound * 2
    f = np.eye(3) + a
    if turned:
        f[1, 1] = 1.15
    exact = material.kappa * 1e-3 * (np.linalg.det(f) - 1)
    assert np.abs(p[solids.free[:, 3]] - exact).max() <= material.kappa * 1e-3 * 10 * bound
    # a fault: one weight 0.1 % off
    solids._inputs[4].numpy()[0, 0] *= 1.001
    equilibrium(solids, wanted)
    assert np.abs(solids.state()[0] - wanted).max() > 1e3 * bound


@pytest.mark.parametrize("nu", [0.3, 0.4999])
def test_bar_with_free_sides(nu: float) -> None:
    """A round bar of radius 1 and length 2 pulled to 1.5: its force where no stress acts across."""
    from scipy.optimize import brentq

    nodes, triangles = grid(np.linspace(0, 1.0, 3), np.linspace(0, 2.0, 4), shake=0.2)
    fixed = np.zeros((len(nodes), 3), bool)
    fixed[nodes[:, 0] == 0, 0] = True
    ends = (nodes[:, 2] == 0) | (nodes[:, 2] == 2.0)
    fixed[ends, 2] = True
    material = ElasticMaterial.from_modulus(50e3, nu)
    solids = solids_of(nodes, triangles, material, fixed, turned=True)
    mu, kappa, stretch = material.mu * 1e-3, material.kappa * 1e-3, 1.5

    def stresses(lateral: float) -> tuple[float, float]:
        """∂W/∂λ across and along the bar."""
        j, i1 = stretch * lateral**2, stretch**2 + 2 * lateral**2
        along = mu / 2 * (2 * stretch * j ** (-2 / 3) - 2 / 3 * j ** (-5 / 3) * lateral**2 * i1) + kappa * (j - 1) * lateral**2
        slope = 2 * stretch * lateral
        across = mu / 2 * (4 * lateral * j ** (-2 / 3) - 2 / 3 * j ** (-5 / 3) * slope * i1) + kappa * (j - 1) * slope
        return across, along

    lateral = brentq(lambda v: stresses(v)[0], 0.7, 1.0, xtol=1e-15)
    stress = stresses(lateral)[1]
    equilibrium(solids, nodes * [lateral - 0.99, 0, 0.5] * 0.9 + nodes * [0, 0, 0.05])
    force, _, _ = solids.internal_force()
    found = 2 * np.pi * force[nodes[:, 2] == 2.0, 2].sum()
    # Newton's end of 1e-11 (equilibrium.py), which κ/μ = 5,000 makes a stress of
    assert found == pytest.approx(np.pi * stress, rel=1e-6)
    assert np.abs(solids.displacement.numpy()[:, 0] - (lateral - 1) * nodes[:, 0]).max() < 1e-9


@pytest.mark.parametrize(("nu", "wanted"), [(0.49, 1.237), (0.499, 1.394)])
def test_bonded_disc(nu: float, wanted: float) -> None:
    """Radius 5 mm, height 2.4 mm, both faces bonded, compressed by 10 %: force [N] ± 0.3 % of another axisymmetric code and CalculiX."""
    rim = 5.0 * (1 - (1 - np.linspace(0, 1, 31)) ** 1.6)
    nodes, triangles = grid(rim, 1.2 * (1 - (1 - np.linspace(0, 1, 13)) ** 1.6))
    fixed = np.zeros((len(nodes), 3), bool)
    fixed[nodes[:, 0] == 0, 0] = True
    fixed[nodes[:, 2] == 0, 2] = True  # the middle plane
    fixed[nodes[:, 2] == 1.2] = True
    solids = solids_of(nodes, triangles, ElasticMaterial.from_modulus(50e3, nu), fixed, turned=True)
    equilibrium(solids, nodes * [0, 0, -0.1])
    force = -2 * np.pi * solids.internal_force()[0][nodes[:, 2] == 1.2, 2].sum() * 1e-3
    # the bond's end is singular: force falls with the cells at the rim, here 1/30 of the radius and less (0.4 % at 12 cells, in 3D)
    assert -0.003 < force / wanted - 1 < 0.003 + 0.004


def test_bonded_disc_gent_lindley() -> None:
    """Small compression at ν → ½: E_a = E (1 + 2 S²), S = R/2h (Gent and Lindley 1959), an estimate good to some per cent for S > 1."""
    for radius in (5.0, 10.0):
        nodes, triangles = grid(radius * (1 - (1 - np.linspace(0, 1, 41)) ** 1.6), np.linspace(0, 1.2, 9))
        fixed = np.zeros((len(nodes), 3), bool)
        fixed[nodes[:, 0] == 0, 0] = True
        fixed[nodes[:, 2] == 0, 2] = True
        fixed[nodes[:, 2] == 1.2] = True
        solids = solids_of(nodes, triangles, ElasticMaterial.from_modulus(50e3, 0.49999), fixed, turned=True)
        equilibrium(solids, nodes * [0, 0, -1e-4])
        force = -2 * np.pi * solids.internal_force()[0][nodes[:, 2] == 1.2, 2].sum()
        apparent = force / (np.pi * radius**2) / 1e-4
        # it takes a parabola of pressure; the exact one lies above for such shape factors by up to 6 % (their figure 3)
        assert apparent == pytest.approx(50 * (1 + 2 * (radius / 4.8) ** 2), rel=0.08)


def cook(n: int) -> tuple[Array, np.ndarray]:  # type: ignore[type-arg]
    nodes, triangles = grid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    s, t = nodes[:, 0], nodes[:, 2]
    s, triangles = 1 - s, triangles[:, [1, 0, 2, 3, 5, 4]]  # so that diagonals fall toward the free end
    return np.column_stack([48 * s, 0 * s, (1 - s) * 44 * t + s * (44 + 16 * t)]), triangles


@pytest.mark.parametrize(("n", "wanted", "finer"), [(8, 6.882, 6.911), (16, 6.911, 6.923)])
def test_cooks_membrane(n: int, wanted: float, finer: float) -> None:
    """E = 240.565, ν = 0.4999, shear of 100 over the end: its tip's rise in P2/P1, computed by other code for compressible neo-Hooke.

    At ν = 0.4999 |J - 1| stays under 1e-3, and the two laws differ by about that.
    """
    nodes, triangles = cook(n)
    fixed = np.repeat((nodes[:, 0] == 0)[:, None], 3, 1)
    solids = solids_of(nodes, triangles, ElasticMaterial.from_modulus(240.565e3, 0.4999), fixed, turned=False)
    load = np.zeros_like(nodes)
    end = np.flatnonzero(nodes[:, 0] == 48)
    end = end[np.argsort(nodes[end, 2])]
    for a, m, b in zip(end[:-2:2], end[1:-1:2], end[2::2], strict=True):
        load[[a, m, b], 2] += 100 / n * np.array([1, 4, 1]) / 6
    start = np.zeros_like(nodes)
    for part in (0.25, 0.5, 0.75, 1.0):
        equilibrium(solids, start, part * load)
        start = solids.state()[0]
    tip = end[-1]
    # the cells may be cut otherwise: as far off as the mesh is from one of half its cells. Ours has 6.902, 6.919, and 6.926 with 32 cells
    assert abs(start[tip, 2] - wanted) < finer - wanted
    assert locked_cook(n) < 0.6 * 8.0, "against 8.0 linear-elastic: the check above must see a locking element"


def locked_cook(n: int) -> float:
    """The tip's rise by constant-strain triangles without a pressure of their own, linear elastic: the negative control."""
    import scipy.sparse as sp
    from scipy.sparse.linalg import spsolve

    nodes, triangles = cook(n)
    used, tri = np.unique(triangles[:, :3], return_inverse=True)
    x, tri = nodes[used][:, [0, 2]], tri.reshape(-1, 3)
    material = ElasticMaterial.from_modulus(240.565, 0.4999)
    lam, mu = material.kappa - 2 * material.mu / 3, material.mu
    d = np.array([[lam + 2 * mu, lam, 0], [lam, lam + 2 * mu, 0], [0, 0, mu]])
    matrix = sp.lil_matrix((2 * len(x), 2 * len(x)))
    for t in tri:
        p = x[t]
        j = np.array([p[1] - p[0], p[2] - p[0]])
        g = np.linalg.solve(j, np.array([[-1, 1, 0], [-1, 0, 1]])).T
        b = np.zeros((3, 6))
        b[0, ::2], b[1, 1::2], b[2, ::2], b[2, 1::2] = g[:, 0], g[:, 1], g[:, 1], g[:, 0]
        place = np.stack([2 * t, 2 * t + 1], 1).ravel()
        matrix[np.ix_(place, place)] += b.T @ d @ b * np.linalg.det(j) / 2
    load = np.zeros(2 * len(x))
    end = np.flatnonzero(x[:, 0] == 48)
    end = end[np.argsort(x[end, 1])]
    for a, b in zip(end[:-1], end[1:], strict=True):
        load[[2 * a + 1, 2 * b + 1]] += 50 / n
    free = np.repeat(x[:, 0] > 0, 2)
    u = np.zeros(2 * len(x))
    u[free] = spsolve(matrix.tocsr()[free][:, free], load[free])
    return float(u[2 * end[-1] + 1])


def layer_scene(shape: str, depth: float) -> Scene:
    """A rigid body of R = 5 mm on a thick, wide layer without friction: near a half space."""
    gel = Gel(profile="flat", size_mm=(100.0, 100.0), thickness_mm=20.0, youngs_modulus_kpa=100.0)
    body = Body(shape=shape, rigid=True, height_mm=5.0, length_mm=100.0 if shape == "cylinder" else None)
    press = Press(depth_mm=depth, force_n=None, frames=3)
    return Scene(gel=gel, object=body, contact=Contact(friction_coefficient=0.0), press=press, fidelity="reference")


def test_line_contact() -> None:
    """Hertz's line contact: b = √(4F'R/πE*), p₀ = √(F'E*/πR), with F' the force per length; the approach needs a datum."""
    _, press = press_of(layer_scene("cylinder", 0.15), finer=3.0, depth_mm=100.0)
    modulus = 100e3 / (1 - 0.499**2)
    force = -press.force[-1, 2] / 0.1
    half = press.contact_area[-1] / 0.1 / 2
    # strains of b/R = 0.1 and the layer's thickness (b/T)² each change the half space by about 1 %
    assert half == pytest.approx(np.sqrt(4 * force * 5e-3 / (np.pi * modulus)), rel=0.03)
    assert press.contact_pressure[-1].max() == pytest.approx(np.sqrt(force * modulus / (np.pi * 5e-3)), rel=0.03)
    assert 0.06 < half / 5e-3 < 0.15


def test_ball_on_a_thick_layer() -> None:
    """Hertz with the correction of a bonded layer (Dimitriadis et al. 2002): χ = √(Rd)/h = 0.025, F = F_Hertz (1 + 1.133 χ + 1.283 χ²)."""
    _, press = press_of(layer_scene("hemisphere", 0.05), finer=3.0)
    hertz = 4 / 3 * 100e3 / (1 - 0.499**2) * np.sqrt(5e-3) * 0.05e-3**1.5
    chi = np.sqrt(5 * 0.05) / 20
    # a parabola for the ball and small strains: d/R = 1 %, of which force takes a part
    assert -press.force[-1, 2] == pytest.approx(hertz * (1 + 1.133 * chi + 1.283 * chi**2), rel=0.01)
    assert np.sqrt(press.contact_area[-1] / np.pi) == pytest.approx(np.sqrt(5 * 0.05) * 1e-3, rel=0.03)
