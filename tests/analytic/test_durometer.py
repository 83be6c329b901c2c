"""The virtual durometer against closed forms, and its two directions against each other."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from gelsim import durometer
from gelsim.cli import main as cli
from gelsim.data import firmness
from gelsim.durometer import Sample
from gelsim.errors import GelsimError
from gelsim.scene import materials
from gelsim.scene.definition import Body, Skin

TIP = materials.TIP_RADIUS


def test_a_shallow_ball_is_that_of_hertz_on_a_layer() -> None:
    """d/R = 0.17 on 12 mm: Hertz, the approach longer by the layer's first-order share 0.567 F/(E* h), E* = 4 E/3, and softer by finite
    strain, 1 - 0.15 d/R (Zhang et al. 2014)."""
    depth = 0.2e-3
    force = durometer.press_curve("00", durometer.SMOOTH, "fast").at(depth)
    layer = 0.567 * force / (4 / 3 * durometer.BLOCK_MM * 1e-3)

    def hertz(approach: float) -> float:
        return 16 / 9 * TIP**0.5 * approach**1.5 * (1 - 0.15 * depth / TIP)

    # Two corrections of 4.6 and 2.5 % whose products and second orders are left out, and a block of finite width: 3 % (found: -2.1 %; the
    # mesh's own error is 0.1 %, from twice as fine ones).
    assert force == pytest.approx(hertz(depth + layer), rel=0.03)
    # Planted: the layer's share with the wrong sign.
    assert force != pytest.approx(hertz(depth - layer), rel=0.03)


def test_sneddons_ball_by_the_fact_sheet() -> None:
    """E of docs' table at Shore 00 10, 30, 60 and 87 by Sneddon: 54.0, 121.4, 411.8, 2775.7 kPa; the last digit is half a unit."""
    for shore, modulus_kpa in ((10, 54.01), (30, 121.4), (60, 411.8), (87, 2775.7)):
        assert durometer.relations(shore, "00")["sneddon"] == pytest.approx(modulus_kpa * 1e3, rel=5e-4)


def test_a_sticking_tip_needs_more_force_and_reads_softer_moduli() -> None:
    slides, sticks = (durometer.modulus(40.0, "00", friction, "fast") for friction in (durometer.SMOOTH, durometer.STICK))
    assert 1.01 * sticks < slides < 1.15 * sticks
    # The relation of gelsim.scene.materials lies within the 20 % that docs/physics.md gives it.
    assert materials.modulus_from_shore_00(40.0) == pytest.approx(sticks, rel=0.2)


def test_a_foot_that_hardly_rests_on_the_block_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 00-70 the spring gives 0.839 N; of a dead load 1 % above that the foot bears 1 %."""
    spring = durometer.SCALES["00"].spring(70.0)
    without = durometer.modulus(70.0, friction=durometer.SMOOTH, fidelity="fast")
    monkeypatch.setitem(durometer.FOOT_LOADS, "00", 1.01 * spring)
    durometer._modulus_with_foot.cache_clear()
    # To first order the tip bears what it did; a step of the march, a two-hundredth of the depth, is 0.75 % of d^1.5, and is interpolated.
    assert durometer.modulus(70.0, friction=durometer.SMOOTH, fidelity="fast", foot=True) == pytest.approx(without, rel=0.01)
    # Planted: a foot that bears four fifths of the load takes some of the dent from the tip (found: 12 %).
    monkeypatch.setitem(durometer.FOOT_LOADS, "00", 3.92)
    durometer._modulus_with_foot.cache_clear()
    assert durometer.modulus(70.0, friction=durometer.SMOOTH, fidelity="fast", foot=True) < 0.95 * without


def test_a_foot_pushes_the_block_onto_the_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tip and foot go down together, and what the foot displaces rises in its hole: the tip bears more, state after state, never less.

    At 00-40 a ball that sticks bears a fifth by friction on its flanks; left out of the tip's share (as once), its force falls from where
    the foot touches on.
    """
    presses = []
    whole = durometer._press

    def keep(*arguments: Any) -> durometer._Pressed:
        presses.append(whole(*arguments))
        return presses[-1]

    monkeypatch.setattr(durometer, "_press", keep)
    for friction in (durometer.SMOOTH, durometer.STICK):
        durometer._modulus_with_foot.cache_clear()
        durometer.modulus(40.0, friction=friction, fidelity="fast", foot=True)
        press = presses[-1]
        footed = press.tip_force < 0.999 * press.force
        assert footed.sum() > 5 and (np.diff(press.tip_force) > 0).all()


def test_with_the_foot_the_block_is_softer_than_hertz_says_whatever_the_friction() -> None:
    """What docs/physics.md says of the label, 0.70 to 1.01; 00-40, where the block bulges into the hole."""
    smooth, sticks = (
        durometer.modulus(40.0, friction=friction, fidelity="fast", foot=True) for friction in (durometer.SMOOTH, durometer.STICK)
    )
    assert 0.70 < sticks / materials.modulus_from_shore_00(40.0) < smooth / materials.modulus_from_shore_00(40.0) < 1.01


def test_there_and_back() -> None:
    assert durometer.reading(durometer.modulus(33.0, fidelity="fast"), fidelity="fast") == pytest.approx(33.0, abs=1e-6)


@pytest.mark.parametrize(
    "flags",
    [
        ["--shore", "101"],
        ["--shore", "3"],
        ["--modulus-kpa", "0.5"],
        ["--modulus-kpa", "nan"],
        ["--modulus-kpa", "50", "--foot"],
        ["--shore", "30", "--friction", "some"],
        ["--shore", "30", "--friction", "nan"],
        ["--shore", "30", "--skin-mm", "1", "--skin-kpa", "800"],
        ["--modulus-kpa", "100", "--skin-mm", "1"],
        ["--modulus-kpa", "100", "--skin-mm", "12", "--skin-kpa", "800"],
        ["--modulus-kpa", "100", "--skin-mm", "1", "--skin-kpa", "0"],
        ["--modulus-kpa", "0", "--skin-mm", "1", "--skin-kpa", "800"],
    ],
)
def test_what_no_durometer_reads_is_one_line(flags: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["durometer", "--fidelity", "fast", "--friction", "0", *flags]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_the_command_says_both_directions(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["durometer", "--shore", "30", "--fidelity", "fast", "--friction", "0", "--json"]) == 0
    there = json.loads(capsys.readouterr().out)
    assert cli.main(["durometer", "--modulus-kpa", str(there["modulus_kpa"]), "--fidelity", "fast", "--friction", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reading"] == pytest.approx(30.0, abs=1e-6)
    flags = ["--modulus-kpa", str(there["modulus_kpa"]), "--skin-mm", "1", "--skin-kpa", "500", "--fidelity", "fast", "--json"]
    assert cli.main(["durometer", *flags]) == 0
    assert json.loads(capsys.readouterr().out)["reading"] > 35.0
    with pytest.raises(GelsimError):
        durometer.modulus(30.0, "B")


def test_a_foam_is_pressed_as_hertz_says_when_shallow_and_reads_what_its_modulus_says() -> None:
    """The contact modulus is E / (1 - nu^2); beyond Hertz forces differ by the strain, contact over tip radius, that is by sqrt(d)."""
    silicone, depths = durometer.press_curve("00", 0.0, "fast"), (0.05e-3, 0.2e-3)
    for nu in (0.0, 0.3):
        foam = durometer.press_curve("00", 0.0, "fast", nu)
        first, second = (silicone.at(depth) / foam.at(depth) * 0.75 / (1 - nu**2) for depth in depths)
        # Linear in sqrt(d), whose ratio here is 2: what it tends to. The next term, in d, is some 1 % at 0.2 mm.
        assert 2 * first - second == pytest.approx(1.0, abs=0.01)


def test_labels_of_foams_and_skins_between_those_of_the_table_are_what_presses_say() -> None:
    """The silicone in which the tip stands as deep (gelsim.data.firmness), by presses of a foam, of a tomato's skin and of silicone."""
    tip, depth = durometer.SCALES["00"], firmness.DEPTHS_MM[-1] * 1e-3
    silicone, readings = durometer.sample_curve(tip, depth, Sample(), fidelity="fast"), np.linspace(0.0, 98.0, 981)
    for sample in (Sample(0.15), Sample(skin_mm=1.1, skin_ratio=12.0)):
        pressed = durometer.sample_curve(tip, depth, sample, fidelity="fast")
        off = []
        for shore in (5.0, 10.0, 30.0, 50.0):
            modulus = materials.modulus_from_shore_00(shore)
            stands = tip.depth(readings[np.argmax([tip.spring(h) > modulus * pressed.at(tip.depth(h)) for h in readings])])
            alike = materials.shore_00_from_modulus(modulus * pressed.at(stands) / silicone.at(stands))
            skin = Skin(sample.skin_mm, youngs_modulus_kpa=sample.skin_ratio * modulus / 1e3) if sample.skin_mm else Skin()
            told = firmness.shore_00(Body(shore_00=shore, poissons_ratio=sample.poissons_ratio, skin=skin))
            # The point that issues ask for; `reference` presses give docs/datasets.md's figure.
            assert told == pytest.approx(alike, abs=1.0)
            off.append(abs(shore - alike))
        # Planted: labelled by the modulus of the body alone.
        assert max(off) > 1.0


def test_a_skin_of_the_blocks_own_modulus_is_no_skin() -> None:
    bare, skinned = (durometer.sample_curve(durometer.TESTER, 1e-3, Sample(skin_mm=skin), fidelity="fast") for skin in (0.0, 1.0))
    # Another mesh of `fast`, whose own error is below a percent. Planted, a skin of twice the modulus: 12 % more.
    assert skinned.at(1e-3) == pytest.approx(bare.at(1e-3), rel=0.01)
    harder = durometer.sample_curve(durometer.TESTER, 1e-3, Sample(skin_mm=1.0, skin_ratio=2.0), fidelity="fast")
    assert harder.at(1e-3) > 1.1 * bare.at(1e-3)
