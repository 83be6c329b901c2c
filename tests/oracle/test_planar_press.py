"""Presses as profiles: against the axisymmetric code of assets/reference on far other meshes, and against our own solids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planar_fixtures import press_of

from gelsim.bench.accuracy import reference_table
from gelsim.pipeline import stages
from gelsim.scene.definition import Body, Contact, Gel, Press, Scene

DISC = 12.5e-3
"""Radius of the reference's gel [m]."""


def reference_scene(modulus: float | None, nu: float = 0.499, fidelity: str = "balanced") -> Scene:
    gel = Gel(profile="flat", youngs_modulus_kpa=50.0, poissons_ratio=nu)
    rigid = modulus is None
    body = Body(shape="hemisphere", height_mm=10.0 if rigid else 25.0, rigid=rigid, youngs_modulus_kpa=modulus, poissons_ratio=nu)
    press = Press(depth_mm=1.0, force_n=None, frames=11)
    return Scene(gel=gel, object=body, contact=Contact(friction_coefficient=0.0), press=press, fidelity=fidelity)


@pytest.mark.parametrize(("modulus", "nu"), [(None, 0.49), (None, 0.499), (50.0, 0.49), (50.0, 0.499), (200.0, 0.499)])
def test_against_another_axisymmetric_code(modulus: float | None, nu: float) -> None:
    _, press = press_of(reference_scene(modulus, nu), gel_end=DISC)
    wanted = {"nu": nu} | ({"object_modulus_kPa": modulus} if modulus else {})
    table = reference_table("hemisphere_force.csv" if modulus else "ball_force.csv")
    rows = [row for row in table if all(np.isclose(row[key], value) for key, value in wanted.items())]
    assert len(rows) == 10
    for row, force, area in zip(rows, -press.force[1:, 2], press.contact_area[1:], strict=True):
        # theirs is good to 0.1 % (ball) and 0.5 % (hemispheres), ours to 0.3 % where the contact is ten edges wide (docs/validation.md)
        assert force == pytest.approx(row["force_N"], rel=0.008 if modulus else 0.004)
        # their radius is the outermost loaded point, known to a quarter of an edge of up to 0.2 mm; ours to an edge of 0.08 mm
        assert np.sqrt(area / np.pi) * 1e3 == pytest.approx(row["contact_radius_mm"], abs=0.05 + 0.04)
    assert press.penetration.max() < 2e-6  # between the points too; a fortieth of the shortest edges


def test_profile_of_the_gel() -> None:
    _, press = press_of(reference_scene(None), gel_end=DISC)
    table = reference_table("ball_profile_nu0.499.csv")
    place = np.hypot(press.gel.rest[:, 0], press.gel.rest[:, 1]) * 1e3
    near = place < 8
    checked = 0
    for i, approach in enumerate(np.round(press.approach * 1e3, 4)):
        rows = np.array([(row["r_mm"], row["u_r_mm"], row["u_z_mm"]) for row in table if row["approach_mm"] == approach])
        if len(rows):
            outward = (press.gel.displacement[i, :, :2] * press.gel.rest[:, :2]).sum(1) / np.maximum(place * 1e-3, 1e-9)
            for found, column in ((outward, 1), (press.gel.displacement[i, :, 2], 2)):
                difference = found[near] * 1e3 - np.interp(place[near], rows[:, 0], rows[:, column])
                # theirs 1 µm; linear interpolation between rows 0.06 mm apart on a ball of 5 mm: 0.06²/8/5 = 0.1 µm
                assert np.sqrt(np.mean(difference**2)) < 1.5e-3
                checked += 1
    assert checked >= 4


def test_faults_would_be_seen() -> None:
    """A gel 1 % stiffer, a depth per radian instead of the whole turn, ν 0.49 for 0.499: none passes the check of force."""
    scene = reference_scene(None)
    _, press = press_of(replace(scene, gel=replace(scene.gel, youngs_modulus_kpa=50.5)), gel_end=DISC)
    row = [row for row in reference_table("ball_force.csv") if row["nu"] == 0.499][-1]
    assert abs(-press.force[-1, 2] / row["force_N"] - 1) > 0.008
    _, press = press_of(reference_scene(None, 0.49), gel_end=DISC)
    assert abs(-press.force[-1, 2] / row["force_N"] - 1) > 0.008


def test_finer_meshes_agree() -> None:
    """Force at twice the edges within 0.1 %, a quarter of what the reference allows, from 0.2 mm on."""
    (_, coarse), (_, fine) = (press_of(reference_scene(200.0), finer=finer) for finer in (1.5, 3.0))
    assert coarse.force[2:, 2] == pytest.approx(fine.force[2:, 2], rel=1e-3)
    assert coarse.contact_area[-1] == pytest.approx(fine.contact_area[-1], rel=0.03)


def test_friction_and_balance() -> None:
    """Stick is stiffer than no friction, 0.8 between; window and object carry the same; the energy adds up."""
    scene = Scene(object=Body(shape="hemisphere"), press=Press(frames=6))
    forces = {}
    for friction in (0.0, 0.8, "stick"):
        problem, press = press_of(replace(scene, contact=Contact(friction_coefficient=friction)))
        forces[friction] = -press.force[-1, 2]
        assert problem.support_force()[2] == pytest.approx(-problem.contact_force()[2], rel=1e-4)
        assert press.report.energy is not None and abs(press.report.energy.drift) < 2e-3
    # hardly a point slides at 0.8; six steps leave 0.03 % of a force with friction
    assert forces[0.0] < forces[0.8] <= forces["stick"] * (1 + 1e-4)


def test_laws_run_through() -> None:
    """An Ogden law of α = 2 is neo-Hooke."""
    from gelsim.scene.definition import LawConstants

    scene = Scene(object=Body(shape="hemisphere", youngs_modulus_kpa=60.0), press=Press(frames=4))
    _, plain = press_of(scene, tolerance=1e-7)
    ogden = replace(scene.object, law="ogden", law_constants=LawConstants(alpha=(2.0,)))
    _, same = press_of(replace(scene, object=ogden), tolerance=1e-7)
    assert same.force[-1, 2] == pytest.approx(plain.force[-1, 2], rel=1e-5)


@pytest.mark.parametrize("shape", ["cone", "frustum", "punch"])
def test_sharp_tips_and_rims_are_survived(shape: str) -> None:
    """A cone begins with no point in contact at all; rims cut in. Overlap is what linear multipliers leave at a rim."""
    scene = Scene(object=Body(shape=shape, radius_mm=3.0), press=Press(depth_mm=0.8, frames=5), fidelity="fast")
    _, press = press_of(scene)
    assert press.converged.all() and len(press.approach) == 5 and press.min_jacobian.min() > 0.1
    assert (np.diff(-press.force[:, 2]) > 0).all() and press.penetration.max() < 10e-6


@pytest.mark.slow
@pytest.mark.parametrize("body", [Body(shape="hemisphere", youngs_modulus_kpa=200.0), Body(shape="cone", youngs_modulus_kpa=200.0)])
def test_profile_against_the_quarter_of_a_square(body: Body) -> None:
    """Force and membrane of the default gel, where "auto" takes the profile and "mirror" the solid's quarter."""
    scene = Scene(object=body, press=Press(frames=4))
    profile = stages.press(scene)
    solid = stages.press(replace(scene, press=replace(scene.press, symmetry="mirror")))
    assert profile.report.symmetry == "axisymmetric" and solid.report.symmetry == ("x", "y")
    # `balanced` solids are off by 0.3 % (docs/validation.md), under a cone's tip by more; the profile by 0.1 %, and by the square's corners
    assert profile.force[-1, 2] == pytest.approx(solid.force[-1, 2], rel=0.01 if body.shape == "hemisphere" else 0.03)
    from scipy.interpolate import LinearNDInterpolator

    found = LinearNDInterpolator(profile.gel.rest[:, :2], profile.gel.displacement[-1])(solid.gel.rest[:, :2] * (1 - 1e-6))
    difference = np.linalg.norm(found - solid.gel.displacement[-1], axis=1) * 1e6
    # What both say of themselves: 2.9 + 0.8 µm (found: 2.2); under the cone's tip 9.2 + 1.4 (5.3), on another filling 23.2 + 1.4 (4.6), for
    # kinks at a tip do not shrink with the edges. On the safe side, and of use: ten times the error would not be.
    estimates = [press.report.error_estimate.membrane_um for press in (profile, solid) if press.report.error_estimate]
    rms = np.sqrt(np.mean(difference**2))
    assert rms < sum(estimates) < 10.0 * rms and rms < 12.0


@pytest.mark.slow
def test_plane_strain_against_solids() -> None:
    """A rigid rod on a gel of 25 mm: plane strain is a quarter too stiff, as gelsim.mesh.reductions says, and refuses itself for that."""
    from gelsim.mesh.reductions import PLANE_STRAIN_AT_25_MM, choose_reduction

    scene = Scene(gel=Gel(profile="flat"), object=Body(shape="cylinder", rigid=True), press=Press(depth_mm=0.6, frames=4))
    assert choose_reduction(scene).kind == "mirror"
    plane = stages.press(replace(scene, press=replace(scene.press, symmetry="plane-strain")))
    solid = stages.press(scene)
    assert 0.1 < plane.force[-1, 2] / solid.force[-1, 2] - 1 < PLANE_STRAIN_AT_25_MM["rigid"]
