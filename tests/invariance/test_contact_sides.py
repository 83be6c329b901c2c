"""Contact's points on the gel's faces or on the object's: the same press, but for what two discretisations of it differ by."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gelsim.errors import SolveStatus
from gelsim.fem.contact import rest_weights
from gelsim.fem.elements import triangle_quadrature
from gelsim.fem.problem import PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.fem.recording import _hats
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.layers import build_scene
from gelsim.scene.materials import gel_material, object_material

# At `balanced` each is within 2 % of the force and 5 µm of the surface of a converged solution (docs/validation.md, Accuracy).
FORCE, SURFACE = 0.02, 5e-6


def press(on_object: bool, **contact: object) -> tuple[PressProblem, Deformation]:
    scene = build_scene(
        {
            "fidelity": "balanced",
            "gel": {"profile": "flat", "youngs_modulus_kpa": 50.0},
            "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": 200.0},
            "contact": contact,
            "press": {"depth_mm": 0.8, "force_n": "none", "frames": 5, "symmetry": "mirror", "shear_mm": [0.0, 0.0]},
        }
    )
    gel, body, placement = stages.bodies(scene)
    problem = PressProblem(scene, gel, body, placement, gel_material(scene), object_material(scene), "cpu", on_object=on_object)
    return problem, run_press(problem)


@pytest.fixture(scope="module", params=[0.0, 0.5])
def both(request: pytest.FixtureRequest) -> list[tuple[PressProblem, Deformation]]:
    return [press(on_object, friction_coefficient=request.param) for on_object in (False, True)]


@pytest.mark.slow
def test_the_same_press(both: Any) -> None:
    (_, one), (_, other) = both
    assert one.status is other.status is SolveStatus.CONVERGED
    force = np.abs(one.force[1:, 2])
    assert one.force[-1, 2] < -0.1  # the gel is pushed down
    assert np.abs(other.force[1:, 2] + force).max() < FORCE * force.max()
    apart = np.linalg.norm(one.gel.displacement[-1] - other.gel.displacement[-1], axis=1)
    assert np.sqrt(np.mean(apart**2)) < SURFACE
    # area by the object's points: read to a part of a face, at first touch of one or two
    assert other.contact_area[-1] == pytest.approx(one.contact_area[-1], rel=0.06)
    drift = [abs(deformation.info["energy"]["drift"]) for deformation in (one, other)]
    assert max(drift) < 0.01


@pytest.mark.slow
def test_what_the_points_carry_is_what_the_window_bears(both: Any) -> None:
    for problem, deformation in both:
        assert problem.support_force()[2] == pytest.approx(-problem.contact_force()[2], rel=2e-3)
        # and the pressure at the gel's nodes, over the areas that they stand for, is what all points carry along their normals
        contact, faces = problem.contact, problem.gel.groups["coated"]
        areas = rest_weights(problem.solids.rest, faces, contact.points) @ _hats(triangle_quadrature(contact.points)[0])
        lumped = np.bincount(faces.ravel(), areas.ravel())
        nodes = np.unique(faces)
        carried = float((deformation.contact_pressure[-1, : len(nodes)] * 1e-3 * lumped[nodes]).sum())
        assert carried == pytest.approx(float((contact.rest_weight * contact.pressure.numpy()).sum()), rel=1e-9)
