"""Shore readings, moduli, elastic constants."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gelsim.errors import MaterialError
from gelsim.scene import materials
from gelsim.scene.definition import Body, Gel, LawConstants, Scene

# The same equations, computed apart from this code and rounded to the decimals shown, in kPa.
HERTZ_00 = {8: 39.79, 10: 43.83, 17: 60.20, 20: 68.47, 30: 103.40, 50: 236.71, 70: 650.09, 87: 2698.46}
QI_A = {20: 675.6, 30: 1160.6, 45: 2613.4, 80: 17366.0}


@pytest.mark.parametrize(("shore", "modulus_kpa"), HERTZ_00.items())
def test_shore_00_gives_the_tabulated_modulus(shore: float, modulus_kpa: float) -> None:
    # The table has two decimals: half a unit of the last one.
    assert abs(materials.modulus_from_shore_00(shore) / 1e3 - modulus_kpa) <= 0.005 + 1e-9


@pytest.mark.parametrize(("shore", "modulus_kpa"), QI_A.items())
def test_shore_a_gives_the_tabulated_modulus(shore: float, modulus_kpa: float) -> None:
    # One decimal in the table.
    assert abs(materials.modulus_from_shore_a(shore) / 1e3 - modulus_kpa) <= 0.05 + 1e-9


def test_the_two_scales_meet_where_the_paper_says() -> None:
    # Yuan et al. 2017: Shore A 45 is "87 in 00"; readings are whole numbers, so half a point.
    assert abs(materials.shore_00_from_modulus(materials.modulus_from_shore_a(45.0)) - 87.0) <= 0.5


@pytest.mark.parametrize("shore", [1.0, 8.0, 30.0, 55.5, 99.0])
def test_shore_00_round_trip(shore: float) -> None:
    # Bisection over 98 points, 60 times: 98 / 2^60; what is left is rounding of E, whose relative slope in H is at most 1.5 a point at 99.
    assert abs(materials.shore_00_from_modulus(materials.modulus_from_shore_00(shore)) - shore) <= 1e-12 * 100


@pytest.mark.parametrize("shore", [20.0, 45.0, 80.0])
def test_shore_a_round_trip(shore: float) -> None:
    # log10 of a value with relative rounding 2^-52, divided by 0.0235: below 1e-13 absolute, times a few operations.
    assert abs(materials.shore_a_from_modulus(materials.modulus_from_shore_a(shore)) - shore) <= 1e-12


@pytest.mark.parametrize(
    ("convert", "value"),
    [
        (materials.modulus_from_shore_00, 130.0),
        (materials.modulus_from_shore_00, 0.0),
        (materials.modulus_from_shore_00, math.nan),
        (materials.modulus_from_shore_a, 10.0),
        (materials.modulus_from_shore_a, 95.0),
        (materials.shore_00_from_modulus, 1e3),
        (materials.shore_a_from_modulus, 1e5),
    ],
)
def test_outside_the_range_is_an_error(convert, value: float) -> None:
    with pytest.raises(MaterialError, match="allowed is|relation covers"):
        convert(value)


def test_elastic_constants_match_their_definition() -> None:
    material = materials.ElasticMaterial.from_modulus(100e3, 0.499)
    # Identities in float64: a handful of operations, 1e-12 is thousands of roundings. 1 - 2v loses three digits at v = 0.499.
    assert math.isclose(material.mu, 100e3 / 2.998, rel_tol=1e-12)
    assert math.isclose(material.kappa, 100e3 / 0.006, rel_tol=1e-12)
    assert math.isclose(material.youngs_modulus, 100e3, rel_tol=1e-12)
    assert math.isclose(material.poissons_ratio, 0.499, rel_tol=1e-12)


def test_scene_materials() -> None:
    scene = Scene(gel=Gel(shore_00=17.0, modulus_scale=0.5), object=Body(youngs_modulus_kpa=80.0, modulus_scale=2.0))
    stiff = materials.object_material(scene)
    assert stiff is not None
    # The scale multiplies what a reading gives, not a modulus that was given as such.
    assert math.isclose(materials.gel_material(scene).youngs_modulus, 0.5 * materials.modulus_from_shore_00(17.0), rel_tol=1e-12)
    assert math.isclose(stiff.youngs_modulus, 80e3, rel_tol=1e-12)
    assert materials.object_material(scene.replace(object=replace(scene.object, rigid=True))) is None


@pytest.mark.parametrize(
    ("law", "constants", "shape"),
    [
        ("neo-hookean", LawConstants(), ()),
        ("yeoh", LawConstants(c2_over_c1=0.1, c3_over_c1=-0.004), (0.1, -0.004)),
        ("ogden", LawConstants(alpha=(2.6,)), (2.6, 1.0)),
        # weights rounded to three digits are taken as shares of their sum
        ("ogden", LawConstants(alpha=(2.0, -3.0, 5.0), weight=(0.333, 0.333, 0.333)), (2.0, 1 / 3, -3.0, 1 / 3, 5.0, 1 / 3)),
    ],
)
def test_a_law_keeps_the_modulus_of_the_hardness(law: str, constants: LawConstants, shape: tuple[float, ...]) -> None:
    material = materials.object_material(Scene(object=Body(shore_00=30.0, law=law, law_constants=constants)))
    assert material is not None
    assert material.constants == pytest.approx(shape, rel=1e-12)
    # the identities of the test above
    assert math.isclose(material.youngs_modulus, materials.modulus_from_shore_00(30.0), rel_tol=1e-12)


@pytest.mark.parametrize(("second", "third"), [(0.13, -0.0047), (-0.5, 0.1), (0.0, 0.0)])
def test_a_yeoh_law_that_holds(second: float, third: float) -> None:
    """The stiffest curve of silicones in docs/physics.md, a dip that stays above zero (1 - 2·0.5 e + 0.3 e² ≥ 1/6), and neo-Hooke."""
    materials.law_shape("yeoh", LawConstants(c2_over_c1=second, c3_over_c1=third))


@pytest.mark.parametrize(("second", "third"), [(-0.5, 0.05), (-0.06, 0.0), (0.0, -0.01)])
def test_a_yeoh_law_that_gives_way(second: float, third: float) -> None:
    # 1 + 2 r e + 3 s e²: -2/3 at e = 10/3; -0.2 at 10; -2 at 10
    with pytest.raises(MaterialError, match="gives way"):
        materials.law_shape("yeoh", LawConstants(c2_over_c1=second, c3_over_c1=third))
