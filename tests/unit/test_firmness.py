"""Labels of an object's material: whose they are, and what they are of bodies whose answer is known beforehand."""

from __future__ import annotations

from typing import Any

import pytest

from gelsim import durometer
from gelsim.data import firmness
from gelsim.errors import DatasetError
from gelsim.scene import materials
from gelsim.scene.definition import Body, Grains, Skin


def block(shore: float, **fields: Any) -> Body:
    return Body(**({"shape": "flat", "shore_00": shore, "poissons_ratio": 0.4999} | fields))


def under(shore: float, thickness: float, ratio: float) -> Body:
    return block(shore, skin=Skin(thickness, youngs_modulus_kpa=ratio * materials.modulus_from_shore_00(shore) / 1e3))


def test_a_silicone_keeps_the_reading_it_is_called_by() -> None:
    assert firmness.shore_00(block(30.0, modulus_scale=0.5)) == 30.0
    of_modulus = Body(shape="flat", shore_00=None, youngs_modulus_kpa=materials.modulus_from_shore_00(30.0) / 1e3)
    assert firmness.shore_00(of_modulus) == pytest.approx(30.0, abs=1e-9)
    assert firmness.stiffness(block(30.0, modulus_scale=0.5)) == pytest.approx(0.5 * (firmness.stiffness(block(30.0)) or 0), rel=1e-12)


def test_what_has_no_label() -> None:
    grainy = block(30.0, shape="candy", grains=Grains(12, 0.7, shore_a=60.0))
    for body in (Body(rigid=True), grainy, under(30.0, 3.0, 4.0), under(30.0, 1.0, 0.5), under(30.0, 1.0, 40.0)):
        assert firmness.shore_00(body) is None and firmness.stiffness(body) is None
    assert firmness.shore_00(block(98.9, poissons_ratio=0.2)) is None and (firmness.stiffness(block(98.9, poissons_ratio=0.2)) or 0) > 0


def test_a_skin_as_the_flesh_is_none_and_a_thicker_or_harder_one_reads_harder() -> None:
    assert firmness.shore_00(under(30.0, 1.0, 1.0)) == pytest.approx(30.0, abs=1e-6)
    assert firmness.shore_00(under(30.0, 1e-6, 8.0)) == pytest.approx(30.0, abs=1e-4)
    by_thickness = [firmness.shore_00(under(30.0, skin, 8.0)) or 0 for skin in (0.1, 0.3, 0.6, 1.0, 1.5)]
    by_ratio = [firmness.stiffness(under(30.0, 0.7, ratio)) or 0 for ratio in (1.0, 1.5, 3.0, 6.0, 12.0, 30.0)]
    whole = materials.shore_00_from_modulus(8 * materials.modulus_from_shore_00(30.0))
    assert sorted(by_thickness) == by_thickness and sorted(by_ratio) == by_ratio and 30 < by_thickness[0] < by_thickness[-1] < whole


def test_a_soft_layer_on_a_hard_core_reads_between_them_and_softer_the_thicker() -> None:
    soft, hard = 20.0, 60.0
    ratio = materials.modulus_from_shore_00(soft) / materials.modulus_from_shore_00(hard)
    by_thickness = [firmness.shore_00(under(hard, skin, ratio)) or 0 for skin in (1.5, 1.8, 2.4, 3.5, 5.0, 6.0)]
    assert sorted(by_thickness, reverse=True) == by_thickness and soft < by_thickness[-1] < soft + 6 < by_thickness[0] < hard
    assert firmness.shore_00(under(hard, 3.0, 1 - 1e-9)) == pytest.approx(hard, abs=1e-4)


def test_foams_read_in_order_also_where_no_reading_is_left() -> None:
    """Below 38 kPa a durometer reads under 8, below 29 nothing."""
    for nu in (0.0, 0.13, 0.3):
        told = [firmness.shore_00(block(shore, poissons_ratio=nu)) for shore in (2.0, 4.0, 5.0, 8.0, 10.0, 20.0, 40.0, 60.0, 80.0)]
        known = [each for each in told if each is not None]
        assert len(known) >= 8 and sorted(set(known)) == known


def test_a_ball_of_5_mm_is_about_that_of_closed_forms() -> None:
    """Sneddon's ball, 1 mm deep of R = 2.5 mm, times what the plate below 12 mm adds with chi = sqrt(R d)/h (Dimitriadis et al. 2002),
    times what finite strain takes, 1 - 0.15 d/R (Zhang et al. 2014)."""
    chi = 2.5**0.5 / durometer.BLOCK_MM
    plate = 1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3
    expected = durometer.sneddon_ball(1e-3, 2.5e-3) * 1e6 * plate * (1 - 0.15 / 2.5)
    told = (firmness.stiffness(block(30.0)) or 0) / materials.modulus_from_shore_00(30.0) * 1e6
    # That it sticks adds up to 5 % (docs/physics.md has it for the durometer); found: 1.5 %. Planted: without the plate 17 % less.
    assert told == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf"), True, "1"])
def test_a_row_tells_a_possible_stiffness_or_none(wrong: Any) -> None:
    from test_dataset import make

    from gelsim.data.episodes import check_row

    for known in (None, 0.3, 2):
        check_row(make(stiffness_n_mm=known).row, "row")
    with pytest.raises(DatasetError, match="stiffness_n_mm = .*: expected more than 0 N/mm"):
        check_row(make(stiffness_n_mm=wrong).row, "row")
