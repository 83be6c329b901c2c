"""Shore readings, moduli, elastic constants."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gelsim import materials
from gelsim.errors import MaterialError
from gelsim.scene import Body, Gel, Scene

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
