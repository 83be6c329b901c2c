"""A ball and a disc against solutions of other codes and published fits; a locking element fails the same checks.

The numbers in `AXISYMMETRIC` and the disc's are from an axisymmetric Taylor-Hood code on other meshes, which agrees with CalculiX 2.20
within 0.2 % (ball: three meshes, 0.1 %; disc 0.3 %): gel E = 50 kPa, disc of radius 12.5 mm and thickness 2.4 mm, inner face fixed, no
friction. A square of 25 mm and a disc of 25 mm differ by far less than the bounds here: the contact is 4 mm across.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_fixtures import E_GEL, MM, ball_press, ball_scene, equilibrium, flat_gel, problem_of, quarter_disc, rigid_body, solids_of, solved

from gelsim.fem.locking import lock
from gelsim.geometry import volume
from gelsim.scene.materials import ElasticMaterial

AXISYMMETRIC = {  # ν = 0.499: depth [mm] -> force [N], contact radius [mm]
    0.1: (0.00931667, 0.7997),
    0.2: (0.0322421, 1.1875),
    0.3: (0.0695297, 1.5015),
    0.4: (0.122351, 1.7764),
    0.5: (0.191661, 2.0119),
    0.6: (0.278244, 2.2310),
}
SOFTER = {0.1: 0.00915064, 0.3: 0.0678379, 0.6: 0.270216}  # the same at ν = 0.49
# Half a cell of 0.5 mm at the contact's rim and a facetted pressure there: measured under 1.1 %, and the issue allows 5 %.
ALLOWED = 0.05


def long_2011(depth_mm: float, radius_mm: float = 5.0, thickness_mm: float = 2.4) -> float:
    """Force [N] on a rigid ball on a bonded incompressible neo-Hookean layer (Long et al. 2011, Biophys. J. 101:643).

    A fit good to a few per cent for 0.3 ≤ R/h ≤ 12.7 and d ≤ min(0.6 h, R).
    """
    r, h, d = radius_mm * MM, thickness_mm * MM, depth_mm * MM
    assert 0.3 <= r / h <= 12.7 and d <= min(0.6 * h, r)
    hertz = 16 / 9 * E_GEL * 1e3 * np.sqrt(r) * d**1.5
    w = (r * d / h**2) ** 1.5
    alpha = 10.05 - 0.63 * np.sqrt(h / r) * (3.1 + (h / r) ** 2)
    beta = 4.8 - 4.23 * (h / r) ** 2
    return float(hertz * (1 + 1.15 * w ** (1 / 3) + alpha * w + beta * w**2) / (1 + 2.3 * w))


def test_longs_fit_is_typed_in_right() -> None:
    """F/F_Hertz = 1.474, 2.142, 3.004 at 0.1, 0.3, 0.6 mm for R = 5 mm, h = 2.4 mm: computed independently to four digits."""
    for depth, ratio in ((0.1, 1.474), (0.3, 2.142), (0.6, 3.004)):
        hertz = 16 / 9 * E_GEL * 1e3 * np.sqrt(5 * MM) * (depth * MM) ** 1.5
        assert long_2011(depth) / hertz == pytest.approx(ratio, abs=6e-4)


def test_ball_force_at_nu_0499() -> None:
    _, press = ball_press(ball_scene(0.6, 7))
    for depth, (wanted, radius) in AXISYMMETRIC.items():
        state = int(np.argmin(np.abs(press.approach - depth * MM)))
        assert press.approach[state] == pytest.approx(depth * MM, rel=1e-9)
        force = -press.force[state, 2]
        assert force == pytest.approx(wanted, rel=ALLOWED)
        # the fit is of an incompressible layer; 2 % of compliance at ν = 0.499, and its own error is a few per cent
        assert force == pytest.approx(long_2011(depth), rel=0.06)
        # areas are counted by points of 6 a face of 0.5 mm: a ring of half a face's height at the rim is in or out
        assert np.sqrt(press.contact_area[state] / np.pi) / MM == pytest.approx(radius, abs=0.25)


def test_ball_force_at_nu_04999() -> None:
    _, press = ball_press(ball_scene(0.6, 7, nu=0.4999))
    for state, depth in ((1, 0.1), (3, 0.3), (6, 0.6)):
        force = -press.force[state, 2]
        assert force == pytest.approx(long_2011(depth), rel=0.06)
        # physics.md 5.11: between ν = 0.499 and 0.4999 the force changes by less than 1 %
        nearly = -ball_press(ball_scene(0.6, 7))[1].force[state, 2]
        assert nearly < force < 1.01 * nearly


def test_ball_force_at_nu_049() -> None:
    """ν reaches the force: 1.8 % to 3 % between 0.49 and 0.499, in the reference and here."""
    _, press = ball_press(ball_scene(0.6, 3, nu=0.49))
    _, stiffer = ball_press(ball_scene(0.6, 7))
    for state, same, depth in ((1, 3, 0.3), (2, 6, 0.6)):
        assert -press.force[state, 2] == pytest.approx(SOFTER[depth], rel=ALLOWED)
        found = stiffer.force[same, 2] / press.force[state, 2]
        # errors of mesh and of rim are common to both: a tenth of them is left
        assert found == pytest.approx(AXISYMMETRIC[depth][0] / SOFTER[depth], abs=0.1 * ALLOWED)


@pytest.mark.parametrize("nu", [0.499, 0.4999])
def test_a_locking_element_is_seen(nu: float) -> None:
    """Displacements alone, p = κ(J - 1) at each point: 14 % too stiff on the mesh that the real element passes on."""
    scene = ball_scene(0.2, 3, nu=nu)
    gel = flat_gel()
    problem = problem_of(scene, gel, rigid_body(scene, gel))
    lock(problem.solids)
    _, press = solved(problem)
    wanted = AXISYMMETRIC[0.2][0] if nu == 0.499 else long_2011(0.2)
    assert -press.force[-1, 2] > (1 + ALLOWED + 0.02) * wanted


@pytest.mark.slow
def test_ball_force_on_a_real_mesh() -> None:
    """The same through fTetWild's unstructured mesh, as users get it by default (its scatter at `fast` can exceed 5 % at 0.1 mm)."""
    from gelsim.mesh import gel_mesh
    from gelsim.shape import shapes

    scene = ball_scene(0.6, 7, fidelity="balanced")
    assert shapes.press_symmetry(scene) == {"x", "y"}
    gel = gel_mesh.mesh_gel(scene, frozenset("xy"))
    _, press = solved(problem_of(scene, gel, rigid_body(scene, gel)))
    for state, depth in enumerate(AXISYMMETRIC, 1):
        assert -press.force[state, 2] == pytest.approx(AXISYMMETRIC[depth][0], rel=ALLOWED)


@pytest.mark.slow
def test_soft_hemisphere_on_real_meshes() -> None:
    """Two soft bodies: E = 200 kPa, R = 5 mm, 25 mm tall, base driven 0.6 mm (same sources; codes agree within 0.5 %)."""
    from dataclasses import replace

    from gelsim.mesh import body_mesh, gel_mesh
    from gelsim.scene.definition import Body

    scene = ball_scene(0.6, 4, fidelity="balanced")
    scene = replace(scene, object=Body(shape="hemisphere", radius_mm=5.0, height_mm=25.0, youngs_modulus_kpa=200.0))
    gel, body = gel_mesh.mesh_gel(scene, frozenset("xy")), body_mesh.mesh_object(scene, frozenset("xy"))
    _, press = solved(problem_of(scene, gel, body))
    for state, wanted in ((1, 0.0183302), (2, 0.0558856), (3, 0.106384)):
        assert -press.force[state, 2] == pytest.approx(wanted, rel=ALLOWED)


@pytest.mark.parametrize(("nu", "wanted"), [(0.49, 1.237), (0.499, 1.394)])
def test_bonded_disc(nu: float, wanted: float) -> None:
    """Radius 5 mm, height 2.4 mm, both faces bonded, compressed by 10 %: force ± 0.3 %. Half the height, the middle plane sliding."""
    disc = quarter_disc(5.0, 7, 1.2 * np.array([0, 0.35, 0.65, 0.85, 1.0]), ("middle", "bonded", "rim"))
    assert 4 * volume(disc) == pytest.approx(np.pi * 25e-6 * 1.2e-3, rel=1e-5)  # a circle by quadratic arcs: (angle of an arc)⁴/700
    node = disc.rest_positions
    fixed = node == 0.0
    fixed[node[:, 2] > 1.2 * MM - 1e-12] = True
    solids = solids_of(disc, ElasticMaterial.from_modulus(E_GEL * 1e3, nu), fixed)
    start = np.zeros_like(node)
    start[:, 2] = -0.1 * solids.rest[:, 2]
    equilibrium(solids, start)
    force = -4 * solids.internal_force()[0][node[:, 2] > 1.2 * MM - 1e-12, 2].sum() * 1e-3
    # the rim where the bond ends is singular (stress ~ r^-0.4), so force falls like h^1.2 of the rim cells: 1.0 % at 6, 0.6 % at 9, 0.4 %
    # at 12 cells a radius; with the reference's 0.3 %
    assert 0 < force / wanted - 1 < 0.013
