"""The network that comes along: small, harmless to load, and of use on a press that is rendered here."""

from __future__ import annotations

from pathlib import Path

import pytest

from gelsim.cli import main as gelsim
from learn.checkpoint import load
from learn.predict import predict, shipped_model

ROW_RMSE = 8.0
"""Of firm presses of trained shapes, novel hardness (assets/models/README.md)."""


def test_it_is_small_and_says_what_it_was_trained_on() -> None:
    path = shipped_model("default")
    assert path.stat().st_size < 20e6
    checkpoint = load(path)
    assert checkpoint.provenance["data"][0]["domain"] == "sim" and checkpoint.novelty is not None and checkpoint.spread_factor > 0


@pytest.mark.slow
def test_it_reads_flats_of_hardnesses_that_it_never_saw(tmp_path: Path) -> None:
    """19 and 77 were held out of training. Each within three of the row's errors; planted: either for the other is 58 off."""
    said = {}
    for hardness in (19, 77):
        out = tmp_path / str(hardness)
        flags = [
            "--shape",
            "flat",
            "--shore",
            str(hardness),
            "--depth-mm",
            "1.6",
            "--fidelity",
            "fast",
            "--spp",
            "4",
            "--resolution",
            "320x240",
        ]
        assert gelsim(["render", *flags, "--out", str(out)]) == 0
        (answer,) = predict(shipped_model("default"), [out], device="cpu")
        assert answer["status"] == "ok" and not answer["unlike_training"]
        said[hardness] = answer["shore_00"]
    assert all(abs(said[hardness] - hardness) < 3 * ROW_RMSE for hardness in said), said
