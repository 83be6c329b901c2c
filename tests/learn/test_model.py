"""The networks: what they must not depend on, what their losses mean, and that they can learn at all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import TINY
from scipy.stats import norm

from gelsim.data.episodes import load_dataset
from learn.config import LearnError, configure
from learn.data import HARDEST, UNBOUND, Batch, Bounds, sides
from learn.features import press_features
from learn.model import BETA, HUBER_DELTA, Output, PaperNet, PressNet, build, gel_input, load_vgg, log_between, parameter_count, shape_of
from learn.recordings import archive
from learn.stream import Stream

CONFIG = configure(**TINY)
GEL = torch.tensor([2.4, 1.0, 17.0])


@pytest.fixture(scope="module")
def batch(fake_data: Path) -> Batch:
    dataset = load_dataset(fake_data)
    return Stream([archive(dataset, sides(dataset, 0)[0], CONFIG.input)], CONFIG).batch(range(8))


def with_output(
    lengths: list[int],
    mean: torch.Tensor,
    spread: torch.Tensor | None,
    target: list[float],
    bounds: Bounds = UNBOUND,
    rank: int = -1,
) -> tuple[Output, Batch]:
    count, steps = mean.shape
    nothing = torch.zeros((count, steps, 3, 1, 1))
    batch = Batch(
        nothing, nothing[:, 0], torch.zeros(count, steps), torch.tensor(lengths), torch.tensor(target), torch.tensor([bounds] * count),
        torch.full((count,), rank),
        torch.full((count, 3), torch.nan), torch.zeros(count, dtype=torch.bool),
    )  # fmt: skip
    return Output(mean, spread, torch.zeros(count, 1)), batch


def test_ours_is_compact() -> None:
    assert parameter_count(build(configure())) <= 10_000_000


def test_the_shape_that_the_network_sees_is_that_of_the_baselines(batch: Batch) -> None:
    """Area, size and slope by NumPy and by torch; the change is strong, so that something is over the threshold."""
    change = 6 * (batch.pictures[:, -1:] - batch.background[:, None])
    found = shape_of(change)[:, 0].numpy()
    pictures = (change + batch.background[:, None]).movedim(2, -1).numpy()
    background = batch.background.movedim(1, -1).numpy()
    told = np.stack([press_features(p, b, np.zeros(1), np.zeros((1, 0, 2)))[0] for p, b in zip(pictures, background, strict=True)])
    assert (told[:, 1] > 0.05).sum() >= 4
    # Sums of 768 float32 numbers.
    assert found[:, 0] ** 2 == pytest.approx(told[:, 1], abs=1e-5) and found[:, 1] / 4 == pytest.approx(told[:, 3], abs=1e-4)
    assert np.expm1(2 * found[:, 2]) == pytest.approx(told[:, 2], rel=1e-4)


def test_a_gel_becomes_four_numbers_and_one_that_is_not_known_four_zeros() -> None:
    nan = torch.nan
    gels = [[2.4, 1.0, 17.0], [2.4 * np.exp(0.2), 1.0, 12.0], [nan, 1.0, 17.0], [2.4, nan, 17.0], [2.4, 1.0, nan]]
    found = gel_input(torch.tensor(gels, dtype=torch.float32))
    rise = (2.4 * np.exp(0.2) - 2.4) / 0.5
    # float32 of differences of numbers of 2.
    assert torch.allclose(found[:2], torch.tensor([[0, 0, 0, 1], [1, rise, -1, 1]], dtype=torch.float32), atol=1e-6)
    assert not found[2:].any()


@pytest.mark.parametrize("told", [True, False])
def test_the_gel_moves_what_is_read_where_the_network_is_told(batch: Batch, told: bool) -> None:
    torch.manual_seed(0)
    network = build(configure(**TINY, show_gel=told)).eval()
    gels = [
        GEL,
        torch.tensor([3.1, 1.0, 17.0]),
        torch.tensor([2.4, 1.75, 17.0]),
        torch.tensor([2.4, 1.0, 22.5]),
        torch.full((3,), torch.nan),
    ]
    with torch.no_grad():
        read = [network.estimate(network(replace(batch, gel=gel.expand(8, 3))), batch.lengths)[0] for gel in gels]
    assert all(torch.isfinite(mean).all() for mean in read)
    for number, mean in enumerate(read):
        assert all(torch.equal(mean, other) != told for other in read[:number])
    if told:  # what is not known is not guessed either: a NaN anywhere is as good as three
        with torch.no_grad():
            half = network.estimate(network(replace(batch, gel=torch.tensor([3.1, torch.nan, 20.0]).expand(8, 3))), batch.lengths)[0]
        assert torch.equal(half, read[-1])


def error_by_heart(part: Batch) -> torch.Tensor:
    """RMSE [Shore 00] of a network on the very presses that it was trained on, 150 steps."""
    network = build(CONFIG)
    optimizer = torch.optim.AdamW(network.parameters(), lr=5e-3)
    for _ in range(150):
        optimizer.zero_grad()
        network.loss(network(part), part).backward()
        optimizer.step()
    with torch.no_grad():
        error = network.estimate(network.eval()(part), part.lengths)[0] - part.target
    return error.square().mean().sqrt()


def test_what_only_the_gel_tells_is_learnt(batch: Batch) -> None:
    """One picture of which four gels made four hardnesses: whoever does not know the gel says one number for all, off by their spread."""
    torch.manual_seed(0)
    one = replace(batch, pictures=batch.pictures[:, :1], signal=batch.signal[:, :1], lengths=torch.ones_like(batch.lengths))
    part = Batch(*(getattr(one, name)[:1].repeat_interleave(4, dim=0) for name in Batch.__dataclass_fields__))
    gels = torch.tensor([[2.0, 1.0, 17.0], [2.8, 1.0, 17.0], [2.4, 0.6, 17.0], [2.4, 1.0, 20.0]])
    part = replace(part, gel=gels, target=torch.tensor([20.0, 70.0, 40.0, 60.0]), bounds=torch.tensor([UNBOUND] * 4))
    assert error_by_heart(part) < 0.15 * part.target.std()


def test_padding_does_not_change_an_output(batch: Batch) -> None:
    torch.manual_seed(0)
    network = build(CONFIG).eval()
    garbage = batch.pictures.clone()
    for number, length in enumerate(batch.lengths):
        garbage[number, length:] = 255 * torch.rand_like(garbage[number, length:])
    assert (batch.lengths < batch.pictures.shape[1]).any()
    with torch.no_grad():
        mean, spread = network.estimate(network(batch), batch.lengths)
        other_mean, other_spread = network.estimate(network(replace(batch, pictures=garbage)), batch.lengths)
        assert spread is not None and other_spread is not None
        # Of one shape: the very bits. Of another, sums may be taken in another order: float32 over ~1e3 terms on a scale of 25.
        assert torch.equal(mean, other_mean) and torch.equal(spread, other_spread)
        longest = int(batch.lengths.max())
        short = replace(batch, pictures=batch.pictures[:, :longest], signal=batch.signal[:, :longest])
        one = Batch(*(getattr(short, name)[2:3] for name in Batch.__dataclass_fields__))
        alone = network.estimate(network(one), one.lengths)[0]
        assert network.estimate(network(short), batch.lengths)[0] == pytest.approx(mean, abs=25 * 1e-4)
        assert alone == pytest.approx(mean[2:3], abs=25 * 1e-4)
        # A picture that is none of the padding does count.
        garbage[:, 0] = 255 - garbage[:, 0]
        assert not torch.allclose(network.estimate(network(replace(batch, pictures=garbage)), batch.lengths)[0], mean, atol=25 * 1e-4)


def test_one_batch_can_be_learnt_by_heart(batch: Batch) -> None:
    torch.manual_seed(0)
    known = ~torch.isnan(batch.target)
    part = Batch(*(getattr(batch, name)[known] for name in Batch.__dataclass_fields__))
    # The hardness of these presses is spread by about 25.
    assert error_by_heart(part) < 0.15 * part.target.std()


def test_the_likelihood_is_least_at_the_truth_and_counts_only_real_pictures() -> None:
    torch.manual_seed(0)
    network = build(CONFIG)
    assert isinstance(network, PressNet)
    scale = float(network.scale)

    def loss(mean: float, spread: float, padded: float = 0.0) -> float:
        output, batch = with_output([2], torch.tensor([[mean, mean, padded]]), torch.tensor([[spread, spread, 1.0]]), [40.0])
        return float(network.loss(output, batch))

    expected = (0.5 * (5 / 8) ** 2 + np.log(8)) * (8 / scale) ** (2 * BETA)
    assert loss(45.0, 8.0) == pytest.approx(expected, rel=1e-6) and loss(45.0, 8.0, 1e3) == loss(45.0, 8.0)
    assert loss(40.0, 8.0) < loss(45.0, 8.0)


def test_the_spread_learns_the_size_of_the_errors() -> None:
    """The gradient over log s vanishes where s² = (y − m)²: the weight s^(2β) is held constant."""
    network = build(CONFIG)
    for factor, sign in ((0.5, -1), (1.0, 0), (2.0, 1)):
        log_spread = torch.tensor([[np.log(5.0 * factor)]], requires_grad=True)
        output, batch = with_output([1], torch.tensor([[45.0]]), log_spread.exp(), [40.0])
        network.loss(output, batch).backward()
        assert log_spread.grad is not None
        gradient = float(log_spread.grad)
        assert abs(gradient) < 1e-6 if sign == 0 else gradient * sign > 0.01


def test_a_rigid_object_is_only_known_to_be_harder() -> None:
    network = build(CONFIG)
    losses = []
    for mean in (HARDEST - 20, HARDEST, HARDEST + 20, HARDEST + 60):
        output, batch = with_output([1], torch.tensor([[mean]]), torch.tensor([[5.0]]), [float("nan")], (HARDEST, float("inf")))
        losses.append(float(network.loss(output, batch)))
    assert losses == sorted(losses, reverse=True) and losses[-1] < 1e-6
    assert losses[1] == pytest.approx(np.log(2) * 5 / float(network.scale), rel=1e-5)  # P(y > HARDEST) = 1/2


@pytest.mark.parametrize("mean", [-200.0, 20.0, 50.0, 59.0, 70.0, 300.0])
@pytest.mark.parametrize("bounds", [(40.0, 60.0), (40.0, np.inf), (-np.inf, 60.0)])
def test_between_bounds_it_is_the_likelihood(bounds: tuple[float, float], mean: float) -> None:
    """Beside SciPy's, far into the tails, where a plain difference of two probabilities is 0; with finite gradients."""
    value, spread = torch.tensor([[mean]], dtype=torch.float64, requires_grad=True), torch.tensor([[5.0]], dtype=torch.float64)
    found = log_between(*(torch.tensor([[end]], dtype=torch.float64) for end in bounds), value, spread.requires_grad_())
    below, above = ((end - mean) / 5.0 for end in bounds)
    one, other = (norm.logcdf(end) for end in ((-above, -below) if below > 0 else (below, above)))
    wanted = other + np.log1p(-np.exp(one - other))
    assert float(found.detach()) == pytest.approx(wanted, rel=1e-6, abs=1e-12)
    found.sum().backward()
    assert value.grad is not None and spread.grad is not None and torch.isfinite(value.grad).all() and torch.isfinite(spread.grad).all()


def test_classes_are_in_order_and_say_what_they_are() -> None:
    network = build(replace(CONFIG, model=replace(CONFIG.model, classes=4)))
    assert isinstance(network, PressNet)
    bounds = network.class_bounds().detach()
    assert bounds[0, 0] == -np.inf and bounds[-1, 1] == np.inf
    assert (bounds[1:, 0] == bounds[:-1, 1]).all() and (bounds[1:-1, 1] > bounds[1:-1, 0]).all()
    losses = []
    for rank in range(4):
        output, batch = with_output([1], torch.tensor([[55.0]]), torch.tensor([[20.0]]), [float("nan")], rank=rank)
        losses.append(float(network.loss(output, batch).detach()) * float(network.scale) / 20.0)
    assert np.exp(-np.array(losses)).sum() == pytest.approx(1.0, abs=1e-5)
    network.loss(*with_output([1], torch.tensor([[55.0]]), torch.tensor([[20.0]]), [float("nan")], rank=1)).backward()
    assert network.cuts is not None and network.cuts.grad is not None and (network.cuts.grad[:2] != 0).all()


def test_vgg16_has_torchvisions_layers() -> None:
    """Names and shapes of torchvision's VGG16 file (its fc8, classifier.6, is not used); the sizes are those of the 2015 paper."""
    with torch.device("meta"):
        network = PaperNet(configure("paper").model)
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    convolutions = [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28]
    assert [name for name in shapes if name.startswith("features.") and name.endswith("weight")] == [
        f"features.{number}.weight" for number in convolutions
    ]
    assert shapes["features.0.weight"] == (64, 3, 3, 3) and shapes["features.28.weight"] == (512, 512, 3, 3)
    assert shapes["classifier.0.weight"] == (4096, 25088) and shapes["classifier.3.weight"] == (4096, 4096)
    vgg = sum(int(np.prod(shape)) for name, shape in shapes.items() if name.startswith(("features.", "classifier.")))
    assert vgg == 138_357_544 - 4_097_000  # the published number of parameters less those of fc8


def test_the_papers_estimate_is_the_mean_of_the_last_three_and_its_loss_is_hubers() -> None:
    with torch.device("meta"):
        network = PaperNet(configure("paper").model)
    output, batch = with_output([5, 4], torch.tensor([[90.0, 90.0, 40.0, 42.0, 44.0], [90.0, 30.0, 31.0, 35.0, 90.0]]), None, [43.0, 32.0])
    assert network.estimate(output, batch.lengths)[0].tolist() == [42.0, 32.0]
    each = [[-3, -1, 1], [-2, -1, 3]]
    huber = [np.mean([0.5 * e**2 if abs(e) <= HUBER_DELTA else HUBER_DELTA * (abs(e) - HUBER_DELTA / 2) for e in row]) for row in each]
    assert float(network.loss(output, batch)) == pytest.approx(np.mean(huber), rel=1e-6)


def test_weights_of_the_wrong_size_are_refused(tmp_path: Path) -> None:
    with torch.device("meta"):
        network = PaperNet(configure("paper").model)
    torch.save({"features.0.weight": torch.zeros(64, 3, 5, 5)}, tmp_path / "vgg.pth")
    with pytest.raises(LearnError, match=r"features.0.weight should have shape \(64, 3, 3, 3\), the file has \(64, 3, 5, 5\)"):
        load_vgg(network, tmp_path / "vgg.pth")


@pytest.mark.slow
def test_the_papers_network_runs_and_takes_its_weights(tmp_path: Path) -> None:
    config = configure("paper")
    torch.manual_seed(0)
    network = PaperNet(config.model).eval()
    one = network.state_dict()["features.28.weight"]
    torch.save(
        {name: tensor for name, tensor in network.state_dict().items() if name.startswith(("features.", "classifier."))}, tmp_path / "w.pth"
    )
    other = PaperNet(config.model).eval()
    with torch.no_grad():  # planted: torch's own initial weights leave a picture a hundredth of its size after thirteen layers
        picture = torch.randn(1, 3, 224, 224)
        assert 0.3 < float(network.features(picture).std() / picture.std()) < 10
    assert not torch.equal(other.state_dict()["features.28.weight"], one)
    load_vgg(other, tmp_path / "w.pth")
    assert torch.equal(other.state_dict()["features.28.weight"], one)
    pictures = 255 * torch.rand(1, 3, 3, 224, 224)
    batch = Batch(
        pictures,
        pictures[:, 0],
        torch.ones(1, 3),
        torch.tensor([3]),
        torch.tensor([30.0]),
        torch.tensor([UNBOUND]),
        torch.tensor([-1]),
        GEL[None],
        torch.tensor([True]),
    )
    with torch.no_grad():
        # The first picture is subtracted: a change of all three alike changes nothing (up to float32 of a difference of 255 levels).
        a, b = (other(replace(batch, pictures=part)).mean for part in (pictures, pictures + 16.0))
        assert a.shape == (1, 3) and torch.allclose(a, b, atol=1e-4)
