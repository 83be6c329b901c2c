"""Training as a whole: resume equals an uninterrupted run, checkpoints run nothing, several devices equal one."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import TINY, fake_dataset

from gelsim.data.episodes import load_dataset
from gelsim.errors import GelsimError
from learn import checkpoint, cli
from learn.config import LearnError, configure, from_plain, to_plain
from learn.data import held_presses, sides
from learn.estimate import batches, estimate
from learn.logs import read_curves
from learn.model import PressNet
from learn.predict import find_model
from learn.recordings import Reading, archive
from learn.train import Begin, Place, _average, rate_at, train


def test_a_resumed_run_ends_with_the_bits_of_an_uninterrupted_one(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    config = configure(**TINY, steps=6)

    def stop_after_two(stage: str, done: int, total: int) -> None:
        if stage == "training" and done == 2:  # not at a checkpoint of its own
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(fake_data, tmp_path / "run", config, reading=Reading(progress=stop_after_two))
    half = checkpoint.load(tmp_path / "run" / "last.pt")
    assert half.step == 2
    train(fake_data, tmp_path / "run", config, resume=True)
    whole, resumed = (checkpoint.load(folder / "last.pt") for folder in (tiny_run, tmp_path / "run"))
    assert whole.step == resumed.step == 6 and whole.optimizer and resumed.optimizer
    for name, tensor in whole.network.items():
        assert torch.equal(tensor, resumed.network[name]), name
        if name not in ("centre", "scale"):
            assert not torch.equal(tensor, half.network[name]), name  # it did learn meanwhile
    for number, state in whole.optimizer["state"].items():
        assert all(torch.equal(value, resumed.optimizer["state"][number][key]) for key, value in state.items())
    assert whole.averaged and resumed.averaged
    assert all(torch.equal(tensor, resumed.averaged[name]) for name, tensor in whole.averaged.items())
    assert whole.best == resumed.best
    best = [checkpoint.load(folder / "model.pt") for folder in (tiny_run, tmp_path / "run")]
    assert best[0].spread_factor == best[1].spread_factor and best[0].novelty is not None and best[1].novelty is not None
    assert torch.equal(best[0].novelty["whitening"], best[1].novelty["whitening"])
    assert [row for row in read_curves(tiny_run) if row[1] == "validation_loss"] == [
        row for row in read_curves(tmp_path / "run") if row[1] == "validation_loss"
    ]


def test_an_interrupted_run_leaves_a_network_that_knows_its_spread_and_what_is_strange(fake_data: Path, tmp_path: Path) -> None:
    config = configure(**TINY, steps=6)

    def stop_after_four(stage: str, done: int, total: int) -> None:
        if stage == "training" and done == 4:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(fake_data, tmp_path / "run", config, reading=Reading(progress=stop_after_four))
    left = checkpoint.load(tmp_path / "run" / "model.pt")
    assert left.step < 4 and left.spread_factor != 1.0 and left.novelty is not None


def test_a_training_keeps_the_range_of_its_gels(fake_data: Path, tmp_path: Path) -> None:
    """As they were. Planted: gels that are all hidden from the network, a validation press of another gel, presses of none."""
    data = shutil.copytree(fake_data, tmp_path / "data")
    dataset = load_dataset(data)

    def keep(of_training: bool) -> dict[str, torch.Tensor] | None:
        for row in dataset.rows:
            if row["index"] in dataset.splits["validation"]:
                row["gel"] = {"thickness_mm": 9.0, "edge_thickness_mm": 0.5, "shore_00": 40.0}
            elif row["index"] in dataset.splits["train"][:3] or not of_training:
                row.pop("gel", None)
        (data / "meta" / "episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in dataset.rows))
        train(data, tmp_path / "run", configure(**TINY, steps=1, hide_gel=1.0), force=True)
        return checkpoint.load(tmp_path / "run" / "model.pt").gels

    gels = keep(of_training=True)
    assert gels is not None and gels["lowest"].tolist() == [2.1, 0.8, 13.0] and gels["highest"].tolist() == [2.7, 1.4, 19.0]
    assert keep(of_training=False) is None


@pytest.mark.filterwarnings("ignore")  # of torch, in torch
@pytest.mark.skipif(shutil.which("g++") is None, reason="torch.compile wants a compiler")
def test_compiled_convolutions_learn_the_same(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    """To rounding: sums are taken in another order, and AdamW's first steps, each of the learning rate whatever the gradient, turn the sign
    of the smallest of them. Planted: another seed is off by 0.4."""
    from torch._dynamo.utils import counters

    counters.clear()
    config = configure(**TINY, steps=6, compile=True)
    train(fake_data, tmp_path / "run", config)
    assert counters["frames"]["ok"] == 1
    whole, compiled = (checkpoint.load(folder / "last.pt") for folder in (tiny_run, tmp_path / "run"))
    assert list(whole.network) == list(compiled.network) and whole.network.keys() == compiled.averaged.keys()  # type: ignore[union-attr]
    found = [[float(row[2]) for row in read_curves(folder) if row[1] == "loss"] for folder in (tiny_run, tmp_path / "run")]
    assert found[0] == pytest.approx(found[1], abs=1e-2), found


def test_a_run_writes_what_it_promises(tiny_run: Path) -> None:
    names = {path.name for path in tiny_run.iterdir()}
    assert {"config.json", "run.json", "curves.csv", "curves.png", "tensorboard", "last.pt", "model.pt", "report.json"} <= names
    assert any((tiny_run / "tensorboard").glob("events.*"))
    assert from_plain(json.loads((tiny_run / "config.json").read_text())) == configure(**TINY, steps=6)
    report = json.loads((tiny_run / "report.json").read_text())
    assert report["videos_per_s"] > 0 and report["memory_mb"] > 0 and report["prediction"]["milliseconds"] > 0
    assert report["validation_presses"] > 0 and report["validation_rmse"] > 0 and report["provenance"]["begun_from"] == "random weights"
    assert str(tiny_run) not in (tiny_run / "run.json").read_text()  # no path of this machine travels with a checkpoint


def test_a_config_from_before_the_gel_was_told_means_that_it_is_not(tiny_run: Path) -> None:
    config = configure(**TINY)
    plain = to_plain(config)
    assert config.model.show_gel and plain["augment"]["hide_gel"] == 0.2
    del plain["model"]["show_gel"], plain["augment"]["hide_gel"]
    old = from_plain(plain)
    assert not old.model.show_gel and old.augment.hide_gel == 0.0
    assert replace(old.model, show_gel=True) == config.model and replace(old.augment, hide_gel=0.2) == config.augment
    # Any other field that lacks is still an error.
    del plain["model"]["show_shape"]
    with pytest.raises(LearnError, match="section 'model' should hold"):
        from_plain(plain)
    # A network that is told cannot pass for one that is not.
    told = torch.load(tiny_run / "model.pt", weights_only=True)
    del told["config"]["model"]["show_gel"]
    torch.save(told, tiny_run.parent / "stripped.pt")
    with pytest.raises(LearnError, match="embed.weight"):
        checkpoint.load(tiny_run.parent / "stripped.pt").build()


def test_an_existing_run_is_not_touched(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    with pytest.raises(LearnError, match="--resume"):
        train(fake_data, tiny_run, configure(**TINY, steps=6))
    with pytest.raises(LearnError, match="other settings"):
        train(fake_data, tiny_run, configure(**TINY, steps=7), resume=True)
    with pytest.raises(LearnError, match="no run"):
        train(fake_data, tmp_path / "nothing", configure(**TINY, steps=6), resume=True)
    other = fake_dataset(tmp_path / "other", seed=1, rigid=False)
    with pytest.raises(LearnError, match="other data"):
        train(other, tiny_run, configure(**TINY, steps=6), resume=True)


def test_classes_refine_what_was_trained(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    """Presses of which only soft, middle or hard is known, after ones whose hardness was."""
    data = shutil.copytree(fake_data, tmp_path / "data")
    rows = [json.loads(line) for line in (fake_data / "meta" / "episodes.jsonl").read_text().splitlines()]
    for row in rows:
        if row["shore_00"] is not None:
            row["hardness_class"], row["shore_00"] = int(row["shore_00"] // 30), None
    (data / "meta" / "episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    config = configure(**TINY | {"validate_every": 100}, steps=300, rate=3e-3)
    train(data, tmp_path / "run", config, begin=Begin(tiny_run / "model.pt"))
    kept = checkpoint.load(tmp_path / "run" / "model.pt")
    network = kept.build()
    assert isinstance(network, PressNet) and kept.config.model.classes == 3
    dataset = load_dataset(data)
    presses = held_presses(archive(dataset, sides(dataset, 0)[0], config.input), config.input, False, 0)
    shown = [press for press in presses if press is not None and press.rank >= 0]
    told, found = np.array([press.rank for press in shown]), estimate(network, batches(shown, torch.device("cpu"))).mean
    cuts = network.class_bounds()[:-1, 1].detach().numpy()
    assert (cuts.searchsorted(found) == told).mean() > 0.6  # by chance a third


def test_a_refused_training_leaves_nothing(
    fake_data: Path, tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, config = tmp_path / "run", configure(**TINY, steps=1)
    rows = [json.loads(line) for line in (fake_data / "meta" / "episodes.jsonl").read_text().splitlines()]

    def planted(name: str, **facts: object) -> Path:
        """The data, with something else said of all presses."""
        data = shutil.copytree(fake_data, tmp_path / name)
        (data / "meta" / "episodes.jsonl").write_text("".join(json.dumps(row | facts) + "\n" for row in rows))
        return data

    unknown, rigid, dark = planted("unknown", shore_00=None), planted("rigid", shore_00=None, rigid=True), planted("dark", pictures=False)
    # By the data, by another file, by the number of devices; and an earlier run is as it was.
    for data in (unknown, rigid):
        with pytest.raises(GelsimError, match="no press of known hardness"):
            train(data, out, config)
    with pytest.raises(LearnError, match="only --model paper has a VGG16"):
        train(fake_data, out, config, begin=Begin(vgg_weights=tiny_run / "model.pt"))
    with monkeypatch.context() as patch:
        patch.setattr("learn.train._place", lambda device: contextlib.nullcontext(Place(0, 3, torch.device("cpu"))))
        with pytest.raises(LearnError, match="a multiple of the 3 devices"):
            train(fake_data, out, config)
    assert not out.exists()
    before = {path.name: path.stat().st_mtime_ns for path in tiny_run.iterdir()}
    with pytest.raises(GelsimError, match="no press of known hardness"):
        train(rigid, tiny_run, config, force=True)
    assert {path.name: path.stat().st_mtime_ns for path in tiny_run.iterdir()} == before
    # While presses are read, of which a cache may be left: the corrected command is taken.
    with pytest.raises(GelsimError, match="plan"):
        train(dark, out, config)
    assert not out.exists() or [path.name for path in out.iterdir()] == ["cache"]
    (tmp_path / "file").touch()
    flags = ["train", "--preset", "mini", "--steps", "1", "--data", str(fake_data)]
    assert cli.main([*flags, "--out", str(out), "--cache", str(tmp_path / "file" / "x")]) == 2
    assert f"gelsim-learn: {tmp_path / 'file' / 'x'}: Not a directory\n" in capsys.readouterr().err
    assert train(fake_data, out, config)["step"] == 1


def test_a_result_folder_that_cannot_be_is_told(
    fake_data: Path, tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.touch()
    for command in (["train", "--preset", "mini"], ["eval", "--model", str(tiny_run / "model.pt"), "--no-baselines"]):
        for out in (file, file / "x"):
            assert cli.main([*command, "--data", str(fake_data), "--out", str(out)]) == 2
            assert capsys.readouterr().err == f"gelsim-learn: {out}: Not a directory\n"


def test_fine_tuning_on_a_few_real_presses_begins_from_the_network(fake_data: Path, tiny_run: Path, tmp_path: Path) -> None:
    real = fake_dataset(tmp_path / "real", seed=2, domain="real")
    config = configure(**TINY, steps=1, real_presses=5, rate=0.0)
    report = train(fake_data, tmp_path / "tuned", config, real=real, begin=Begin(tiny_run / "model.pt"))
    assert report["provenance"]["begun_from"] == "model.pt" and len(report["provenance"]["data"]) == 2
    before, after = (checkpoint.load(path / "model.pt").network for path in (tiny_run, tmp_path / "tuned"))
    assert all(torch.equal(before[name], after[name]) for name in before)  # at rate 0
    with pytest.raises(LearnError, match="network and input are others"):
        train(fake_data, tmp_path / "wrong", configure(**TINY | {"hidden": 8}, steps=1), begin=Begin(tiny_run / "model.pt"))


def test_fine_tuning_begins_from_a_shipped_network_by_name(
    fake_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is handed to the training, which the test above watches: a step of the shipped network takes minutes on a busy core."""
    given: list[Path | None] = []
    monkeypatch.setattr("learn.train.train", lambda *_, begin, **__: given.append(begin.init))
    arguments = ["train", "--data", str(fake_data), "--out", str(tmp_path / "tuned"), "--init"]
    assert cli.main([*arguments, "varied"]) == 0 and given == [find_model("varied", "--init")]
    for name, words in (("defualt", "no such file"), ("default", "stands for 3 networks; name one: paper2017, varied, families")):
        assert cli.main([*arguments, name]) == 2
        told = capsys.readouterr().err
        assert f"--init {name}" in told and words in told and len(given) == 1


def test_weights_are_averaged_as_told(tiny_run: Path) -> None:
    """Two equal networks, one of which moves: after three steps the other is where the sums say."""
    network, averaged = (checkpoint.load(tiny_run / "model.pt").build() for _ in range(2))
    expected = 0.0
    begun = next(averaged.parameters()).clone()
    for step in range(3):
        with torch.no_grad():
            next(network.parameters()).add_(1.0)
        _average(averaged, network, step, 0.15)
        decay = min(0.15, (1 + step) / (10 + step))
        expected = decay * expected + (1 - decay) * (step + 1)
    assert torch.allclose(next(averaged.parameters()), begun + expected, atol=1e-5)


def test_fewer_presses_are_a_part_of_all(fake_data: Path, tmp_path: Path) -> None:
    few = train(fake_data, tmp_path / "few", configure(**TINY, steps=1, presses=5), reading=Reading(tmp_path / "cache"))
    every = train(fake_data, tmp_path / "all", configure(**TINY, steps=1), reading=Reading(tmp_path / "cache"))
    assert few["presses"] <= 5 < every["presses"]
    assert not (tmp_path / "few" / "cache").exists() and len(list((tmp_path / "cache").glob("*/pictures.npy"))) == 1


def test_the_papers_rate_falls_in_steps() -> None:
    config = configure("paper")
    assert [rate_at(step, config) for step in (0, 999, 1000, 2500)] == pytest.approx([1e-3, 1e-3, 1e-4, 1e-5])
    assert config.train.steps == 10_000 and config.input.frames == 5


def test_our_rate_rises_and_falls() -> None:
    config = configure(steps=1000, warmup=100)
    rates = [rate_at(step, config) for step in range(1000)]
    assert max(rates) == rates[99] == rates[100] == config.train.rate and rates[0] == config.train.rate / 100
    assert rates[-1] < 0.02 * config.train.rate and rates[550] == pytest.approx(0.505 * config.train.rate)


# ---- checkpoints ----


class Payload:
    """Runs code when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, ...]:
        return (open, (str(self.trace), "w"))


def test_a_pickled_payload_is_refused_and_not_run(tiny_run: Path, tmp_path: Path) -> None:
    good = torch.load(tiny_run / "model.pt", weights_only=True)
    trace = tmp_path / "trace"
    torch.save(good | {"provenance": {"note": Payload(trace)}}, tmp_path / "bad.pt")
    with pytest.raises(LearnError, match="was not loaded"):
        checkpoint.load(tmp_path / "bad.pt")
    assert not trace.exists()
    torch.load(tmp_path / "bad.pt", weights_only=False)["provenance"]["note"].close()
    assert trace.exists()  # the payload is a live one


def test_what_is_read_has_weights_in_half_precision(tiny_run: Path, tmp_path: Path) -> None:
    """2⁻¹¹ of each at most, 2⁻²⁵ of tiny ones; what is one number exactly (planted: it too), and what a training goes on from."""
    kept = checkpoint.load(tiny_run / "last.pt")
    kept.network["centre"] = torch.tensor(44.1)
    for optimizer in (None, kept.optimizer):
        checkpoint.save(tmp_path / "again.pt", replace(kept, optimizer=optimizer))
        again = checkpoint.load(tmp_path / "again.pt")
        assert all(tensor.dtype == torch.float32 for tensor in again.build().state_dict().values())
        same = {name: torch.equal(again.network[name], tensor) for name, tensor in kept.network.items()}
        assert all(same.values()) == (optimizer is not None) and same["centre"] and same["scale"]
        for name, tensor in kept.network.items():
            assert torch.allclose(again.network[name], tensor, rtol=2**-11, atol=2**-25)


def test_damaged_and_foreign_checkpoints_are_refused(tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = torch.load(tiny_run / "model.pt", weights_only=True)

    def refused(words: str, **changes: object) -> None:
        torch.save(good | changes, tmp_path / "bad.pt")
        with pytest.raises(LearnError, match=words):
            checkpoint.load(tmp_path / "bad.pt").build()

    refused("no checkpoint of gelsim-learn", format="other")
    refused("step is str", step="6")
    refused("model = 'huge'", config=good["config"] | {"model": good["config"]["model"] | {"model": "huge"}})
    refused("section 'train'", config=good["config"] | {"train": {}})
    refused("wants", network=good["network"] | {"head.bias": torch.zeros(3)})
    refused("of torch.float64, the config wants", network={name: tensor.double() for name, tensor in good["network"].items()})
    refused("wants None", network=good["network"] | {"extra": torch.zeros(3)})
    (tmp_path / "half.pt").write_bytes((tiny_run / "model.pt").read_bytes()[:5000])
    with pytest.raises(LearnError, match="was not loaded"):
        checkpoint.load(tmp_path / "half.pt")
    with pytest.raises(LearnError, match="cannot be read"):
        checkpoint.load(tmp_path / "none.pt")
    monkeypatch.setattr(checkpoint, "LARGEST", 1000)
    with pytest.raises(LearnError, match="MiB"):
        checkpoint.load(tiny_run / "model.pt")


def test_settings_are_checked() -> None:
    for wrong, words in (
        ({"setps": 3}, "did you mean 'steps'"),
        ({"steps": 0}, "steps = 0"),
        ({"rate": float("nan")}, "rate = nan"),
        ({"picture": (8, 8)}, "picture"),
        ({"batch": 2.5}, "expected a whole number"),
        ({"mirror": "maybe"}, "expected true or false"),
        ({"model": "paper"}, "224"),
    ):
        with pytest.raises(LearnError, match=words):
            configure(**wrong)
    config = configure("paper", seed=3)
    assert from_plain(json.loads(json.dumps(to_plain(config)))) == config


WITHOUT_THREADS = """
import gc, sys
from pathlib import Path
from learn.cli import main
code = main()
gc.collect()
left = [task.read_text().strip() for task in Path("/proc/self/task").glob("*/comm")]
sys.exit(code or any("gloo" in name for name in left))
"""
"""A training whose process group ends with it: threads that it leaves behind abort the process now and then, when the interpreter ends."""


@pytest.mark.slow
def test_two_processes_train_as_one(fake_data: Path, tmp_path: Path) -> None:
    """The gradient of a batch is the mean of its shares': equal up to the order of float32 sums, amplified by Adam's division."""
    flags = [
        f"--{name.replace('_', '-')}={'x'.join(map(str, value)) if isinstance(value, tuple) else value}" for name, value in TINY.items()
    ]
    flags += ["--steps=2", "--clip=0", f"--data={fake_data}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
    script = tmp_path / "threads.py"
    script.write_text(WITHOUT_THREADS)
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", str(script)]
    for command, out in (([sys.executable, "-m", "learn.cli"], "one"), (torchrun, "two")):
        done = subprocess.run([*command, "train", *flags, f"--out={tmp_path / out}"], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    one, two = (checkpoint.load(tmp_path / out / "last.pt").network for out in ("one", "two"))
    begun = checkpoint.load(tmp_path / "one" / "last.pt")
    moved = replace(begun.config.train).rate
    for name in one:
        # Two steps of Adam move a weight by up to twice the rate; shares that were not averaged would differ by as much.
        assert (one[name] - two[name]).abs().max() <= 0.05 * moved, name
