"""Presses of objects that are not convex or of several materials, on real meshes: they end, and a skin counts alike on a finer mesh."""

from __future__ import annotations

import pytest

from gelsim.errors import SolveStatus
from gelsim.pipeline import stages
from gelsim.scene.definition import Body, Contact, Gel, Grains, Press, Scene, Skin

SHAPES = [
    Body(shape="tube", height_mm=12, length_mm=10),
    Body(shape="shell", height_mm=9),
    Body(shape="torus", height_mm=5),
    Body(shape="tomato", height_mm=12),
    Body(shape="wave", height_mm=5, width_mm=6, length_mm=6),
    Body(shape="emboss", height_mm=5, width_mm=6, length_mm=6),
    Body(shape="rough", height_mm=5, width_mm=6, length_mm=6, amplitude_mm=0.1),
    Body(shape="candy", height_mm=8, width_mm=6, length_mm=6, grains=Grains(count=4, shore_a=45)),
]


@pytest.mark.slow
@pytest.mark.parametrize("body", SHAPES, ids=[body.shape for body in SHAPES])
def test_the_press_ends(body: Body) -> None:
    found = stages.press(Scene(object=body, gel=Gel(profile="flat"), press=Press(depth_mm=0.5, force_n=None, frames=3), fidelity="fast"))
    assert found.status is SolveStatus.CONVERGED and len(found.force) == 3
    assert found.min_jacobian.min() > 0.5 and found.penetration.max() < 40e-6
    assert -found.force[2, 2] > -found.force[1, 2] > 0.0
    assert not found.report.warnings


def force(skin: Skin, fidelity: str) -> float:
    body = Body(shape="hemisphere", height_mm=10, youngs_modulus_kpa=100, skin=skin)
    press = Press(depth_mm=0.8, force_n=None, frames=3)
    gel = Gel(profile="flat", youngs_modulus_kpa=50)
    return float(-stages.press(Scene(object=body, gel=gel, contact=Contact(0.0), press=press, fidelity=fidelity)).force[-1, 2])


@pytest.mark.slow
def test_a_skin_ten_times_stiffer() -> None:
    skin = Skin(thickness_mm=1.0, youngs_modulus_kpa=1000)
    coarse, fine, bare = force(skin, "fast"), force(skin, "balanced"), force(Skin(), "fast")
    # forces of a single material at `fast` are within 2 % of converged ones (docs/validation.md, Accuracy): a skin is resolved as well
    assert coarse == pytest.approx(fine, rel=0.02)
    assert 1.3 * bare < fine < force(Skin(thickness_mm=1.0, youngs_modulus_kpa=100000), "fast")


@pytest.mark.slow
def test_a_skin_of_the_flesh_changes_only_the_mesh() -> None:
    assert force(Skin(thickness_mm=1.0, youngs_modulus_kpa=100), "fast") == pytest.approx(force(Skin(), "fast"), rel=0.02)


@pytest.mark.parametrize(
    ("body", "offset", "beyond"),
    [
        # Half of 25 mm less half of 12 mm, on either side.
        (Body(shape="cylinder", radius_mm=5, rigid=True), (0.0, 0.0), "6.5 mm"),
        (Body(shape="cylinder", radius_mm=5, rigid=True, length_mm=8), (0.0, 0.0), None),
        # Its side is at the height of the gel's face sqrt(3² - 2.5²) = 1.66 mm from the middle, which is at the border.
        (Body(shape="hemisphere", radius_mm=3, rigid=True), (6.0, 0.0), "1.7 mm"),
        # Flush: it bulges beyond the gel, but does not stand there.
        (Body(shape="box", width_mm=12, length_mm=12, height_mm=8), (0.0, 0.0), None),
    ],
)
def test_an_object_beyond_the_border_of_the_gel_is_noted(body: Body, offset: tuple[float, float], beyond: str | None) -> None:
    press = Press(depth_mm=0.5, force_n=None, frames=3, offset_mm=offset)
    found = stages.press(Scene(gel=Gel("flat", (12.0, 12.0), 3.0), object=body, press=press, fidelity="fast"))
    told = list(found.report.warnings)
    assert found.status is SolveStatus.CONVERGED
    assert told == (
        [f"the object goes {beyond} beyond the border of the gel (gel.size_mm = 12 12 mm), whose sides are free: no housing beside it"]
        if beyond
        else []
    )
