"""Several networks that read as one: mixture of their normals, by closed form, and what must not be mixed."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gelsim.data.episodes import load_dataset
from learn import checkpoint
from learn.config import LearnError
from learn.data import Press, held_presses
from learn.ensemble import Ensemble, _distance
from learn.evaluate import evaluate
from learn.novelty import Novelty, novelty_from_plain
from learn.recordings import archive

CPU = torch.device("cpu")


@pytest.fixture
def presses(fake_data: Path, tiny_run: Path) -> list[Press]:
    dataset, config = load_dataset(fake_data), checkpoint.load(tiny_run / "model.pt").config
    read = archive(dataset, [row["index"] for row in dataset.rows][:5], config.input)
    return [press for press in held_presses(read, config.input, False, 0) if press is not None]


@pytest.fixture
def second(tiny_run: Path, tmp_path: Path) -> Path:
    """The same network but for a mean 12 points higher, twice the spread by its factor, and everything strange."""
    kept = checkpoint.load(tiny_run / "model.pt")
    network = {name: tensor.clone() for name, tensor in kept.network.items()}
    network["centre"] += 12
    assert kept.novelty is not None
    strange = kept.novelty | {"threshold": kept.novelty["threshold"] / 100}
    checkpoint.save(
        tmp_path / "second.pt", replace(kept, network=network, spread_factor=2 * kept.spread_factor, novelty=strange, optimizer=None)
    )
    return tmp_path / "second.pt"


def test_two_networks_read_as_the_mixture_of_their_normals(tiny_run: Path, second: Path, presses: list[Press]) -> None:
    """Means 12 apart: 6 from the middle each. The least strange of two distances is that of the first.

    Planted: the mean of the spreads alone, the sum of the variances, the largest distance.
    """
    one, other, both = (
        Ensemble(models, CPU).read(presses) for models in ([tiny_run / "model.pt"], [second], [tiny_run / "model.pt", second])
    )
    assert other.mean == pytest.approx(one.mean + 12, abs=1e-4) and other.spread == pytest.approx(2 * one.spread, rel=1e-5)
    assert both.mean == pytest.approx(one.mean + 6, abs=1e-4)
    assert both.spread == pytest.approx(np.sqrt(2.5 * one.spread**2 + 36), rel=1e-5)
    assert np.array_equal(both.novelty, one.novelty) and np.all(other.novelty > one.novelty)


def test_a_network_beside_itself_reads_as_it_does_alone(tiny_run: Path, presses: list[Press]) -> None:
    alone, twice = (Ensemble([tiny_run / "model.pt"] * count, CPU) for count in (1, 2))
    for once, again in ((alone.read(presses), twice.read(presses)), (alone.unread(3), twice.unread(3))):
        assert np.allclose(once.mean, again.mean, rtol=1e-12) and np.allclose(once.spread, again.spread, rtol=1e-12)
        assert np.array_equal(once.novelty, again.novelty, equal_nan=True)


def test_what_shows_nothing_is_read_as_the_trainings_mean(tiny_run: Path) -> None:
    network = checkpoint.load(tiny_run / "model.pt").build()
    unread = Ensemble([tiny_run / "model.pt"], CPU).unread(2)
    assert unread.mean.tolist() == [float(network.centre)] * 2 and unread.spread.tolist() == [float(network.scale)] * 2
    assert np.isnan(unread.novelty).all()


def test_networks_of_other_pictures_are_refused(tiny_run: Path, tmp_path: Path) -> None:
    kept = checkpoint.load(tiny_run / "model.pt")
    other = replace(kept, config=replace(kept.config, input=replace(kept.config.input, frames=kept.config.input.frames + 1)))
    checkpoint.save(tmp_path / "other.pt", other)
    with pytest.raises(LearnError, match=r"other\.pt: takes other pictures"):
        Ensemble([tiny_run / "model.pt", tmp_path / "other.pt"], CPU)


def test_an_evaluation_of_two_tells_both(fake_data: Path, tiny_run: Path, second: Path, tmp_path: Path) -> None:
    """And reads what the ensemble reads. Planted: only the first is read."""
    rows = ["novel_hardness"]
    reports = [evaluate(models, fake_data, tmp_path / str(number), rows=rows) for number, models in
               enumerate(([tiny_run / "model.pt"], [tiny_run / "model.pt", second]))]  # fmt: skip
    assert [[model["model"] for model in report["models"]] for report in reports] == [["model.pt"], ["model.pt", "second.pt"]]
    first, pair = (_estimates(tmp_path / str(number) / "predictions.csv") for number in range(2))
    assert pair == pytest.approx(first + 6, abs=1e-4)


def _estimates(path: Path) -> np.ndarray:
    with path.open() as file:
        return np.array([float(line["estimate"]) for line in csv.DictReader(file)])


def test_novelty_without_a_fit_is_not_known(tiny_run: Path, tmp_path: Path, presses: list[Press]) -> None:
    kept = checkpoint.load(tiny_run / "model.pt")
    assert isinstance(kept.novelty, dict) and Novelty(**kept.novelty).threshold > 0
    checkpoint.save(tmp_path / "bare.pt", replace(kept, novelty=None))
    assert np.isnan(Ensemble([tmp_path / "bare.pt"], CPU).read(presses).novelty).all()


def test_a_gel_that_one_network_knows_is_not_strange(tiny_run: Path, tmp_path: Path) -> None:
    """Ranges of 2.1 to 2.7 mm and of 3.1 to 3.7 mm. Planted: what either finds strange; the span over both, which hides the gap."""
    kept = checkpoint.load(tiny_run / "model.pt")
    assert kept.gels is not None
    for name, gels in (("thick", {name: end + torch.tensor([1.0, 0.0, 0.0]) for name, end in kept.gels.items()}), ("old", None)):
        checkpoint.save(tmp_path / f"{name}.pt", replace(kept, gels=gels))
    alone, thick, old = tiny_run / "model.pt", tmp_path / "thick.pt", tmp_path / "old.pt"

    def strange(models: list[Path]) -> list[bool]:
        ensemble = Ensemble(models, CPU)
        return [bool(ensemble.strange_gel((thickness, 1.0, 17.0))) for thickness in (2.4, 2.9, 3.4, 4.0)]

    assert strange([alone]) == [False, True, True, True] and strange([thick]) == [True, True, False, True]
    assert strange([alone, thick]) == [False, True, False, True]
    assert strange([alone, old]) == [False] * 4  # nobody can say what the other knew
    (words,) = Ensemble([alone, thick, alone], CPU).strange_gel((4.0, 1.0, 17.0))
    assert words.endswith("thickness 4.0 mm is outside what it was trained on (2.1 to 2.7 or 3.1 to 3.7 mm)")


def test_what_cannot_be_measured_is_strange(tiny_run: Path) -> None:
    """Statistics with a NaN, or too large for their squares. Planted: a NaN that stays one, which is what no fit at all gives."""
    novelty = novelty_from_plain(checkpoint.load(tiny_run / "model.pt").novelty)
    assert novelty is not None
    odd = novelty.mean.repeat(3, 1)
    odd[0, 0], odd[1, 0] = torch.nan, 1e300
    distance = _distance(novelty, odd)
    assert np.isinf(distance[:2]).all() and distance[2] == 0
