"""Plans: what they draw is the same by number, within what was declared, and their mistakes are one clear line."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gelsim.errors import SceneError
from gelsim.generate.plan import Catalogue, load_plan
from gelsim.scene import materials
from gelsim.scene.distributions import check_fields, draw

TINY = Path(__file__).parents[1] / "plan_tiny.toml"


@pytest.fixture(scope="module")
def paper() -> Catalogue:
    return Catalogue(load_plan("paper2017"), 0)


@pytest.fixture(scope="module")
def presses(paper: Catalogue) -> list:
    return [paper.press(number) for number in range(250)]


@pytest.mark.parametrize(
    ("distribution", "low", "high", "mean"),
    [
        ({"uniform": [2.0, 4.0]}, 2, 4, 3.0),
        ({"log_uniform": [1.0, np.e**2]}, 1, np.e**2, (np.e**2 - 1) / 2),
        ({"uniform": [0.0, 4.0], "without": [[1.0, 2.0], [2.0, 3.0]]}, 0, 4, 2.0),
        ({"log_uniform": [1.0, np.e**2], "without": [[1.0, np.e]]}, np.e, np.e**2, np.e**2 - np.e),
        ({"normal": [1.0, 0.5], "within": [0.0, 2.0]}, 0, 2, 1.0),
        ({"integers": [1, 3]}, 1, 3, 2.0),
        ({"choice": [1.0, 5.0], "weights": [3, 1]}, 1, 5, 2.0),
        ({"chance": 0.25, "then": 4.0, "else": {"uniform": [0.0, 1.0]}}, 0, 4, 1.375),
    ],
)
def test_draws_have_the_declared_range_and_mean(distribution: dict, low: float, high: float, mean: float):
    rng = np.random.default_rng(0)
    drawn = np.array([draw(distribution, rng) for _ in range(4000)])
    assert low <= drawn.min() and drawn.max() <= high
    # Four standard errors.
    assert abs(drawn.mean() - mean) < 4 * drawn.std() / np.sqrt(len(drawn))


def test_nothing_is_drawn_from_a_gap():
    rng = np.random.default_rng(1)
    distribution = {"uniform": [8.0, 87.0], "without": [[18.0, 20.0], [60.0, 62.0]]}
    drawn = np.array([draw(distribution, rng) for _ in range(4000)])
    assert not ((drawn > 18) & (drawn < 20)).any() and not ((drawn > 60) & (drawn < 62)).any()
    # As many between the gaps as their share: 40 of 75, four standard errors.
    assert abs(((drawn >= 20) & (drawn <= 60)).mean() - 40 / 75) < 4 * 0.5 / np.sqrt(len(drawn))


def test_what_is_trained_on_by_varied_is_in_no_row_of_paper2017(paper: Catalogue):
    """Same sensors for the same seed; no hardness and no radius that a test row is about."""
    varied = Catalogue(load_plan("varied"), 0)
    assert all(varied.sensor_scene(number) == paper.sensor_scene(number) for number in range(20))
    radii = next(kind for kind in paper.plan.groups[0].kinds if kind.split == "novel_shape").fields["object.radius_mm"]["choice"]
    seen = [varied.press(number) for number in range(250)]
    assert {press.split for press in seen} == {"train", "validation"} and len({press.object.name for press in seen}) > 240
    for body in (press.scene.object for press in seen):
        assert body.shore_00 is None or min(abs(body.shore_00 - held) for held in paper.plan.held_hardness) >= 1
        assert body.shape not in ("hemisphere", "cylinder") or min(abs(np.log(body.radius_mm / radius)) for radius in radii) > 0.05
        assert body.shape not in ("frustum", "box", "punch", "tomato", "candy", "tube")


def test_relative_draws_and_cycles():
    rng = np.random.default_rng(0)
    assert draw({"uniform": [2.0, 2.0], "relative": "times"}, rng, base=3.0) == 6.0
    assert draw([{"uniform": [1.0, 1.0], "relative": "plus"}, 7.0], rng, base=(10.0, 20.0)) == [11.0, 7.0]
    assert [draw({"cycle": ["a", "b"]}, rng, number) for number in range(3)] == ["a", "b", "a"]


def test_a_number_is_the_same_in_any_order(presses: list):
    again = Catalogue(load_plan("paper2017"), 0)
    for number in (17, 3, 11):
        press, other = again.press(number), presses[number]
        assert press.scene == other.scene and press.object.name == other.object.name and press.split == other.split
        assert again.episode(press, 1).layer == again.episode(other, 1).layer
    assert Catalogue(load_plan("paper2017"), 1).press(3).scene != presses[3].scene


def test_no_object_and_no_held_hardness_in_two_splits(paper: Catalogue, presses: list):
    of_object = defaultdict(set)
    for press in presses:
        of_object[press.object.name].add(press.split)
        if press.split in ("train", "validation"):
            assert press.scene.object.shore_00 not in paper.plan.held_hardness
            assert press.group.motion == "human"
        if press.split == "novel_hardness":
            assert press.scene.object.shore_00 in paper.plan.held_hardness
    for splits in of_object.values():
        # The paper's row of the robot is of objects that were trained on.
        assert (
            len(splits - {"robot"}) <= 1 and splits - {"robot"} <= {"train"} or "robot" not in splits or splits <= {"robot", "validation"}
        )
    found = Counter(press.split for press in presses)
    assert set(found) >= {"train", "validation", "novel_hardness", "novel_shape", "robot", "vessels", "complicated", "natural"}


def test_motions_are_the_papers(presses: list):
    robots = [press.scene.press for press in presses if press.group.motion == "robot"]
    assert robots and all(5 <= press.force_n <= 9 and 5 <= press.speed_mm_s <= 7 for press in robots)
    assert {press.group.number for press in presses} == {1, 2, 3, 4, 5}


def test_soft_edges_and_corners_are_pressed_no_further_than_their_kind_says(paper: Catalogue):
    """What a kind of object says of its presses beats plan and group, the robot's too; other shapes go on to 4 mm."""
    presses = [paper.press(number) for number in range(500)]
    soft = [press for press in presses if not press.scene.object.rigid]
    sharp = [press for press in soft if press.scene.object.shape in ("edge", "corner")]
    assert {press.group.motion for press in sharp} == {"human", "robot"} and {press.group.number for press in sharp} == {1, 2}
    assert all(1.2 <= press.scene.press.depth_mm <= 2.4 for press in sharp)
    assert max(press.scene.press.depth_mm for press in soft if press not in sharp) > 4.0


def test_hardness_scale_and_slope_change_gel_and_object_alike(presses: list):
    for press in presses[:50]:
        gel, body = press.scene.gel, press.scene.object
        if body.rigid:
            continue
        ratio = materials.modulus_from_shore_00(body.shore_00) / materials.modulus_from_shore_00(gel.shore_00)
        slope = 1 + np.log(body.modulus_scale / gel.modulus_scale) / np.log(ratio)
        assert 0.4 <= gel.modulus_scale <= 1.2 and 0.92 - 1e-9 <= slope <= 1.08 + 1e-9


def test_gels_of_another_sensor_are_no_gels_of_the_training():
    """Each of the three numbers that a network may be told; `fixed` and assets/mini stay what they were."""
    names = ("thickness_mm", "edge_thickness_mm", "shore_00")
    trained, other, fixed, mini = (plan.sensor_fields | plan.press_fields for plan in map(load_plan, ("paper2017", "gap", "fixed", "mini")))
    for name in names:
        (low, high), (above, _) = (fields[f"gel.{name}"]["uniform"] for fields in (trained, other))
        assert low < high < above and low <= fixed[f"gel.{name}"] <= high
    assert [fixed[f"gel.{name}"] for name in names] == [2.4, 1.0, 17.0] and mini["gel.shore_00"] == 17.0


def planned(tmp_path: Path, old: str, new: str) -> str:
    text = TINY.read_text()
    assert old in text
    path = tmp_path / "plan.toml"
    path.write_text(text.replace(old, new))
    return str(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("uniform = [0.3, 0.4]", "uniform = [0.4, 0.3]", "the first is above the second"),
        ("uniform = [0.3, 0.4]", "uniform = [0.3, 99.0]", r"= 99: allowed for press.depth_mm is 0.001 … 50 mm"),
        ("uniform = [0.3, 0.4]", "normal = [0.3, 0.01], within = [1.0, 2.0]", "hardly ever falls within"),
        ("uniform = [0.3, 0.4]", "uniform = [0.3, 0.4], without = [[0.3, 0.45]]", r"ascending pairs within \[0.3, 0.4\]"),
        ("uniform = [0.3, 0.4]", "uniform = [0.3, 0.4], without = [[0.3, 0.4]]", "that leave something"),
        ("uniform = [0.3, 0.4]", "uniform = [0.3, 0.4], without = [0.35]", "ascending pairs"),
        ("uniform = [0.3, 0.4]", "unifrom = [0.3, 0.4]", "did you mean 'uniform'"),
        ("uniform = [0.3, 0.4]", "uniform = [0.3, inf]", "expected two numbers"),
        ('"press.depth_mm"', '"press.dpeth_mm"', r"unknown field; did you mean 'depth_mm'"),
        ("object.rigid = true", "object.rigid = true\npress = { depth_mm = 1.0 }", r"kinds\[0\].press.*depth_mm"),
        ('"press.force_n"', '"camera.fps"', "here only gel, object, contact, press, fidelity may be drawn"),
        ('shape = "hemisphere"\nobject.radius_mm = 6.0\nobject.rigid', 'shape = "hemishpere"\nobject.rigid', "did you mean 'hemisphere'"),
        ("log_uniform = [0.9, 1.1]", "log_uniform = [0.0, 1.1]", "both must be above 0"),
        ("share = 1.0", "share = -1.0", "expected a number of 0 or more"),
        ('motion = "human"', 'motion = "humna"', "did you mean 'human'"),
        ('split = "train"', 'split = "trian"', "did you mean 'train'"),
        ("count = 2", "count = 0", "expected a whole number, 1"),
        ("end_points = [0.7, 1.0]", "end_points = [1.0, 0.7]", "ascending shares"),
        ('name = "tiny"', 'nmae = "tiny"', "unknown key 'nmae'; did you mean 'name'"),
        ("resolution = [48, 36]", "resolution = 48", "resolution = 48"),
        ("[sensors]", "[sensors", "is not TOML"),
    ],
)
def test_mistakes_in_a_plan_are_one_clear_line(tmp_path: Path, old: str, new: str, said: str):
    with pytest.raises(SceneError, match=said) as error:
        load_plan(planned(tmp_path, old, new))
    assert "plan" in str(error.value) and "\n" not in str(error.value)


def test_what_contradicts_itself_is_told_by_press(tmp_path: Path):
    plan = load_plan(planned(tmp_path, "object.height_mm = 12.0", "object.height_mm = 12.0\nobject.wavelength_mm = 3.0"))
    Catalogue(plan, 0).press(0)
    plan = load_plan(planned(tmp_path, "uniform = [0.3, 0.4]", "uniform = [20.0, 20.0]"))
    with pytest.raises(SceneError, match="plan tiny, seed 0, press"):
        for number in range(8):
            Catalogue(plan, 0).press(number)


def test_a_plan_that_is_not_there_names_those_that_are():
    with pytest.raises(SceneError, match="did you mean 'paper2017'"):
        load_plan("paper2107")
    with pytest.raises(SceneError, match="cannot be read"):
        load_plan("/nowhere/plan.toml")


@pytest.mark.parametrize("table", [{"object": {"uniform": [0, 1]}}, {"gel.thickness": 1.0}, {"lights.lights.pwoer": 1.0}])
def test_only_fields_can_be_drawn(table: dict[str, Any]):
    with pytest.raises(SceneError, match="whole table|unknown field"):
        check_fields(table, "x")


def test_a_base_may_have_a_base(tmp_path: Path) -> None:
    upon, twice = tmp_path / "upon.toml", tmp_path / "twice.toml"
    upon.write_text('base = "gap"\nend_points = [1.0]\nsensors.count = 2\n')
    plan, gap = load_plan(str(upon)), load_plan("gap")
    assert (plan.end_points, plan.sensors, plan.mode, plan.press_fields) == ((1.0,), 2, "path", gap.press_fields)
    assert plan.sensor_fields == gap.sensor_fields
    upon.write_text(f'base = "{twice}"\n')
    twice.write_text(f'base = "{upon}"\n')
    with pytest.raises(SceneError, match="cannot start from itself"):
        load_plan(str(upon))
