"""How `bench --only live` compares: presses are drawn alike, errors are what they are, a wrong gel is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gelsim.bench import live, live_presses, mesh_parts, runner
from gelsim.bench.section import Options, Row
from gelsim.live import layer, sensor
from gelsim.pipeline import stages
from gelsim.scene.layers import build_scene

BALL = 12
"""A drawn press that `fast` solves in two seconds."""


def test_of_36_presses_each_kind_goes_each_way_once(tmp_path: Path) -> None:
    drawn = [live_presses.draw(index)[1] for index in range(36)]
    assert drawn == [live_presses.draw(index)[1] for index in range(36)] and drawn[0] != live_presses.draw(0, seed=1)[1]
    assert len({live_presses.kind_of(index) for index in range(36)}) == 36
    for index, said in enumerate(drawn):
        scene = mesh_parts.built(said, tmp_path)  # a valid one
        steps = live_presses.approaches(scene) / (live_presses.THICKNESS_MM * 1e-3)
        for share in live_presses.shares_of(index):
            assert np.abs(steps - share).min() < 1e-9
        if live_presses.kind_of(index)[1] == "released":
            assert steps.argmax() < len(steps) - len(live_presses.shares_of(index))  # it is looked at on the way back


def test_soft_presses_are_drawn_beside_the_rigid_ones(tmp_path: Path) -> None:
    """And may be twice as far off."""
    for index in range(live.COUNT, live.COUNT + live.SOFT_COUNT):
        scene = mesh_parts.built(live_presses.draw(index)[1], tmp_path)
        assert not scene.object.rigid and 10 <= (scene.object.shore_00 or 0) <= 70
    assert not any("shore_00" in live_presses.draw(index)[1]["object"] for index in range(live.COUNT))
    assert len({live_presses.kind_of(index) for index in range(live.COUNT, live.COUNT + live.SOFT_COUNT)}) == live.SOFT_COUNT
    row = {"share": 0.25, "height_um": 10.0, "picture_db": 35.0 - 20 * np.log10(2), "soft": True}
    assert live.excess(row) == pytest.approx(1.0) and live.excess(row | {"soft": False}) == pytest.approx(2.0)


def test_a_press_is_solved_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = {
        "gel": {"profile": "flat"},
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "rigid": True},
        "press": {"depth_mm": 0.2, "frames": 2},
    }
    first = live_presses.solved(drawn, tmp_path, "fast")
    monkeypatch.setattr(stages, "press", None)
    again = live_presses.solved(drawn, tmp_path, "fast")
    np.testing.assert_array_equal(first.gel.displacement, again.gel.displacement)
    assert again.report.error_estimate == first.report.error_estimate


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, list[Row]]:
    """A drawn ball at its depths beside `fast`, and with a gel a tenth too soft; pictures are left out."""
    folder = tmp_path_factory.mktemp("presses")
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live, "picture", lambda scene, press, state: np.zeros((240, 320, 3), np.uint8))
        for faulty in (False, True):
            if faulty:
                patch.setattr(sensor, "Elastic", lambda shear_kpa, *others: layer.Elastic(shear_kpa / 1.1, *others))
            live._solved.cache_clear()
            found[faulty] = [live.measured(BALL, share, folder, by=(stages.LIVE, "fast")) for share in live_presses.shares_of(BALL)]
    live._solved.cache_clear()
    return found


def test_a_ball_is_within_the_bounds_and_a_softer_gel_is_not(rows: dict[bool, list[Row]]) -> None:
    for row, faulty in zip(rows[False], rows[True], strict=True):
        place = live.SHARES.index(row["share"])
        # `fast` is itself off by 2.3 % and 6 µm at most on balls (docs/validation.md, Accuracy).
        assert abs(row["force_percent"]) < live.BOUNDS["force_percent"][1][place] + 2.3
        assert row["height_um"] < live.BOUNDS["height_um"][1][place] + 6.0
        assert row["marker_um"] < live.BOUNDS["marker_um"][1][place]
        assert faulty["force_percent"] == pytest.approx(100 * ((1 + row["force_percent"] / 100) / 1.1 - 1), abs=1.5)


def test_a_table_counts_what_is_within() -> None:
    some = [{"share": 0.1, "height_um": value, "by": stages.LIVE, "over": value / 2} for value in (1.0, 1.5, 3.0)]
    (only,) = live.summary(some, [])
    assert (only["within"], only["median"], only["worst"]) == ("2 of 3", "1.5", "3")
    pictures = [{"share": 0.4, "picture_db": value} for value in (30.0, 33.0, 40.0)]
    (only,) = live.summary(pictures, [])
    assert (only["within"], only["worst"]) == ("2 of 3", "30")
    assert live.excess({"share": 0.4, "picture_db": 26.0}) == pytest.approx(10 ** (6 / 20))
    assert [row["over"] for row in live._listed(some)] == [1.5, 0.75, 0.5]


def test_poses_are_those_that_the_scene_says(tmp_path: Path) -> None:
    path = [{"depth_mm": 0.2}, {"twist_deg": 20.0}, {"shear_mm": [0.3, 0.1]}, {"depth_mm": -0.01}]
    scene = build_scene({"object": live.BALL, "gel": {"profile": "flat"}, "press": {"path": path, "frames": 5}, "fidelity": "live"})
    press = stages.press(scene)
    found = list(live.poses(scene, press))
    down = [shift[2] for _, shift in found]
    np.testing.assert_allclose(np.diff(down), [-0.2e-3, 0.0, 0.0, 0.21e-3], atol=1e-12)
    np.testing.assert_allclose(found[3][1][:2] - found[1][1][:2], [0.3e-3, 0.1e-3], atol=1e-12)
    np.testing.assert_allclose(found[2][0] @ found[1][0].T @ [1, 0, 0], [np.cos(np.pi / 9), np.sin(np.pi / 9), 0], atol=1e-12)
    # Its work is what it takes on the way: friction took some, and none came back.
    work = live.walked(scene, press)
    assert len(work) == 4 and 0 < work.sum() < work[:3].sum()


def test_one_worker_measures_what_one_press_says_at_all_its_depths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Others would solve it too, each for a depth."""
    handed: list[list[str]] = []

    def work_through(handfuls: list[tuple[int, ...]], _crew: object, _make: object, arguments: tuple, _lost: object) -> list[list[Row]]:
        handed.extend([arguments[0][number][1] for number in handful] for handful in handfuls)
        return []

    monkeypatch.setattr(runner, "work_through", work_through)
    runner.run(tmp_path, Options(("live",)), workers=2)
    depths = [len(live_presses.shares_of(index)) for index in range(live.COUNT + live.SOFT_COUNT)]
    finer = [len(live_presses.shares_of(index)) for index in live.TWICE]
    assert [len(handful) for handful in handed] == [*depths, *finer, *([1] * len(live.LOOPS))]
    assert all(len({name.rpartition(":")[0] for name in handful}) == 1 for handful in handed)
