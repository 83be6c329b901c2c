"""Scores against closed forms, baselines against what they must find, and an evaluation as a whole."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import fake_dataset

from gelsim.data.episodes import load_dataset
from learn import checkpoint, scores
from learn.baselines import NAMES, RIDGES, fit_baselines, over_time, ridge_weights
from learn.config import LearnError, configure
from learn.evaluate import FIRM_N, _row_report, evaluate, table
from learn.features import press_features
from learn.predict import predict


def test_errors_of_a_known_row() -> None:
    true, said = np.array([10.0, 20.0, 30.0]), np.array([12.0, 20.0, 26.0])
    found = scores.errors(true, said, ["a", "b", "c"])
    assert (
        found["rmse"] == pytest.approx(np.sqrt(20 / 3))
        and found["r2"] == pytest.approx(1 - 20 / 200)
        and found["bias"] == pytest.approx(-2 / 3)
    )


def test_intervals_are_over_objects_not_presses(rng: np.random.Generator) -> None:
    """Twenty presses of each object err alike, so they tell no more than one: the interval must not shrink."""
    true, error = rng.uniform(10, 80, 30), rng.normal(0, 5, 30)
    names = [f"o{number}" for number in range(30)]
    once = scores.bootstrap(true, true + error, names)["rmse"]
    often = scores.bootstrap(np.repeat(true, 20), np.repeat(true + error, 20), [name for name in names for _ in range(20)])["rmse"]
    assert often == pytest.approx(once, rel=1e-9)
    assert once[0] < scores.rmse(true, true + error) < once[1]


def test_intervals_hold_what_they_promise(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """In 95 % of 200 repetitions the interval holds the true RMSE; percentile intervals of 60 objects are known to be a little short."""
    monkeypatch.setattr(scores, "BOOTSTRAPS", 300)
    hits = 0
    for seed in range(200):
        true, error = rng.uniform(10, 80, 60), rng.normal(0, 5, 60)
        low, high = scores.bootstrap(true, true + error, [str(number) for number in range(60)], seed)["rmse"]
        hits += low <= 5 <= high
    # The standard deviation of such a share is 1.5 %: 93 % less four of these.
    assert hits / 200 >= 0.87


def test_an_honest_spread_covers_what_it_says(rng: np.random.Generator) -> None:
    true, spread = np.full(20_000, 50.0), rng.uniform(2, 10, 20_000)
    found = scores.calibration(true, true + spread * rng.standard_normal(20_000), spread)
    # Four standard deviations of a share of 20,000: 4 sqrt(p (1 - p) / n) <= 1.4 %.
    assert all(found["coverage"][f"{level:.0%}"] == pytest.approx(level, abs=0.015) for level in scores.LEVELS)
    assert found["rms_of_error_over_spread"] == pytest.approx(1, abs=0.02)
    assert scores.calibration(true, true + 2 * spread, spread)["coverage"]["50%"] == 0


def test_ranks_and_order() -> None:
    assert scores.spearman([1, 2, 3, 4], [10, 20, 20, 40]) == pytest.approx(0.9486832980505138)  # 1.5 ranks each: 4.5/sqrt(5 * 4.5)
    assert scores.spearman([1, 2, 3], [3, 2, 1]) == -1 and np.isnan(scores.spearman([1, 2], [5, 5]))
    apart = scores.told_apart(np.array([10.0, 30.0, 75.0, 86.0]), np.array([20.0, 25.0, 80.0, 80.0]))
    assert apart["0–40"] == {"pairs": 1, "right_order": 1.0} and apart["70–100"] == {"pairs": 1, "right_order": 0.5}


def test_baselines_find_a_law_that_is_there(rng: np.random.Generator) -> None:
    """Hardness is linear in how the area grows, and the last frame alone does not show it."""
    inputs = configure().input

    def press(shore: float) -> tuple[np.ndarray, np.ndarray]:
        end = rng.uniform(1, 3)
        signal = np.linspace(0.1, end, 12)
        area = signal * (1 + shore / 50) * rng.uniform(0.5, 2)
        return signal, np.stack([signal, area, signal * shore / 100], axis=1)

    shores = rng.uniform(10, 80, 120)
    curves = [press(shore) for shore in shores]
    learnt = fit_baselines(curves[:80], shores[:80], inputs)
    asked = [over_time(curve, inputs) for curve in curves[80:]]
    error = {name: scores.rmse(shores[80:], learnt.predict(name, asked)) for name in NAMES}
    assert error[NAMES[0]] > 15 and error[NAMES[3]] < 0.5 * error[NAMES[0]] and error[NAMES[2]] < error[NAMES[0]]
    assert learnt.predict(NAMES[2], [None])[0] == pytest.approx(shores[:80].mean())


def test_the_ridge_is_the_one_that_leaves_the_least_error_when_each_press_is_left_out(rng: np.random.Generator) -> None:
    """Against really leaving each out; the features are mostly noise, so that fitting well and predicting well are two things."""
    x, weights = rng.normal(size=(30, 20)), np.zeros(20)
    weights[:2] = 3.0
    y = x @ weights + rng.normal(0, 3, 30)
    gram = x @ x.T
    found = []
    for ridge in RIDGES * np.linalg.eigvalsh(gram).clip(0).mean():
        left_out = []
        for out in range(30):
            rest = np.arange(30) != out
            alpha = np.linalg.solve(gram[np.ix_(rest, rest)] + ridge * np.eye(29), y[rest])
            left_out.append(y[out] - gram[out, rest] @ alpha)
        found.append((np.mean(np.square(left_out)), np.linalg.solve(gram + ridge * np.eye(30), y)))
    best = min(range(len(found)), key=lambda number: found[number][0])
    assert 0 < best < len(RIDGES) - 1
    # float64, with a condition number of at most 1e4 over the smallest ridge.
    assert ridge_weights(gram, y) == pytest.approx(found[best][1], abs=1e-8)


def test_features_of_a_dent_that_is_known() -> None:
    """A disc of one change: its area is a share of the picture, its size R/√2, and markers that move outward by 1 % spread by 1 %."""
    rows, columns, radius = 60, 80, 12.0
    x, y = np.meshgrid(np.arange(columns) - 40.0, np.arange(rows) - 30.0)
    background = np.full((rows, columns, 3), 100.0)
    picture = background + 40.0 * (np.hypot(x, y) <= radius)[..., None]
    markers = np.random.default_rng(0).uniform(0, 1, (1, 40, 2)).repeat(2, axis=0)
    markers[1] += 0.01 * (markers[0] - 0.5)
    found = press_features(np.stack([background, picture]), background, np.array([0.0, 1.0]), markers)
    # A disc drawn in pixels is off by about a pixel in 12 of its radius times its circumference: 1/R in size, 2/R² in area.
    assert found[0, 1:].tolist() == [0] * 5
    assert found[1, 1] == pytest.approx(np.pi * radius**2 / (rows * columns), rel=0.03)
    assert found[1, 3] == pytest.approx(radius / np.sqrt(2) / columns, rel=0.03)
    assert found[1, 5] == pytest.approx(0.01, rel=1e-6)


def test_objects_of_several_materials_are_ranked_by_their_body() -> None:
    """As `gelsim dataset` writes them: no hardness of the whole. Planted: by `shore_00` there is nothing to rank."""
    rows = [{"shape": "tomato", "object": f"t{n // 2}", "shore_00": None, "body_shore_00": 10.0 + n // 2} for n in range(8)]
    found = scores.ranking(rows, np.array([1, 2, 3, 4, 9, 9, 5, 6], float))
    assert found == {"tomato": {"objects": 4, "presses": 8, "spearman": pytest.approx(0.8)}}


def test_firm_presses_have_an_error_of_their_own() -> None:
    def press(force: float | None, error: float) -> dict:
        row = {"object": "a", "peak_force_n": force, "rigid": False, "body_shore_00": 30.0}
        return {"row": row, "true": 30.0, "estimate": 30.0 + error, "spread": 5.0, "novelty": 0.0, "contact": True, "unlike": False}

    report = _row_report("robot", [press(FIRM_N, 3.0), press(4.0, -3.0), press(0.4, 40.0), press(None, 40.0)], False)
    assert (report["firm"]["presses"], report["firm"]["rmse"]) == (2, 3.0)


def test_an_evaluation_writes_the_table_of_the_paper(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    report = evaluate([tiny_run / "model.pt"], fake_data, tmp_path / "eval", baselines_from=fake_data)
    text = (tmp_path / "eval" / "table.md").read_text()
    assert "1398, 0.9564, 5.18" in text and "73, 0.7868, 11.05" in text and "683, 0.8524, 10.28" in text and text == table(report)
    assert set(report["rows"]) == {"novel_hardness", "novel_shape", "robot", "natural"}
    kept = json.loads((tmp_path / "eval" / "report.json").read_text())
    with (tmp_path / "eval" / "predictions.csv").open() as file:
        lines = list(csv.DictReader(file))
    mine = [line for line in lines if line["split"] == "novel_hardness"]
    error = np.array([float(line["true"]) - float(line["estimate"]) for line in mine])
    assert kept["rows"]["novel_hardness"]["rmse"] == pytest.approx(np.sqrt((error**2).mean())) and len(mine) == 6
    for name in ("novel_hardness.png", "calibration.png", "errors.png"):
        assert (tmp_path / "eval" / name).stat().st_size > 5000
    assert kept["rows"]["natural"]["ranking"]["tomato"]["objects"] == 3
    with pytest.raises(LearnError, match="--force"):
        evaluate([tiny_run / "model.pt"], fake_data, tmp_path / "eval")
    with pytest.raises(LearnError, match="no split 'nonsense'"):
        evaluate([tiny_run / "model.pt"], fake_data, tmp_path / "other", rows=["nonsense"])


def test_an_evaluation_calls_strange_what_a_prediction_does(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    """By the gel too. Planted: a network of a harder range, which no distance of pictures tells from the other."""
    kept = checkpoint.load(tiny_run / "model.pt")
    assert kept.gels is not None
    harder = {name: end + torch.tensor([0.0, 0.0, 20.0]) for name, end in kept.gels.items()}
    checkpoint.save(tmp_path / "harder.pt", replace(kept, gels=harder))
    for model, all_strange in ((tiny_run / "model.pt", False), (tmp_path / "harder.pt", True)):
        row = evaluate([model], fake_data, tmp_path / model.stem, rows=["novel_hardness"])["rows"]["novel_hardness"]
        assert (row["unlike_training"] == row["presses"]) == all_strange
        told = [answer["unlike_training"] for answer in predict([model], [fake_data])]
        indices = load_dataset(fake_data).splits["novel_hardness"]
        assert row["unlike_training"] == sum(told[index] for index in indices)


def test_baselines_may_learn_from_another_dataset(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    """A dataset of twice the presses: the network reads the same, the baselines do not; and it must have something to learn from."""
    teacher = fake_dataset(tmp_path / "teacher", presses=2, seed=1)
    model = [tiny_run / "model.pt"]
    own = evaluate(model, fake_data, tmp_path / "own", baselines_from=fake_data)["rows"]["novel_hardness"]
    other = evaluate(model, fake_data, tmp_path / "other", baselines_from=teacher)
    row = other["rows"]["novel_hardness"]
    assert other["baselines_from"] == "teacher" and row["rmse"] == own["rmse"]
    assert row["baselines"][NAMES[0]] == own["baselines"][NAMES[0]]  # the same hardnesses
    assert all(row["baselines"][name]["rmse"] != own["baselines"][name]["rmse"] for name in NAMES[1:])
    (teacher / "meta" / "splits.json").write_text(json.dumps({"novel_shape": []}))
    with pytest.raises(LearnError, match="--baselines-from"):
        evaluate(model, fake_data, tmp_path / "nothing", baselines_from=teacher)
    assert not (tmp_path / "nothing").exists()
