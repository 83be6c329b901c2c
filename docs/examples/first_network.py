"""From nothing to a network that reads hardness: presses by a plan, a training, a reading.

python docs/examples/first_network.py              # minutes, most of them the sensor's light; out/first_network
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from gelsim.cli.main import main as gelsim
from gelsim.data.episodes import load_dataset
from learn.cli import main as gelsim_learn
from learn.predict import predict

ROOT = Path(__file__).parents[2]
MINI = ROOT / "assets" / "mini"


def main(quick: bool = False, folder: Path = ROOT / "out" / "first_network") -> list[dict[str, Any]]:
    """Makes, trains, reads; quick: two presses without pictures, and a few steps on the small dataset that comes along.

    Returns:
        What the network says of test presses (`learn.predict.predict`), the true hardness beside it.
    """
    data, run = folder / "data", folder / "run"
    least = ["--no-light"] if quick else []
    gelsim(["dataset", "--plan", "mini", "--episodes", "2" if quick else "60", "--out", str(data), *least])
    made = MINI if quick else data
    gelsim_learn(["train", "--preset", "mini", "--data", str(made), "--out", str(run), "--steps", "20" if quick else "500"])
    presses = load_dataset(made)
    unseen = [made / presses.rows[presses.positions[number]]["file"] for number in presses.splits["novel_shape"]]
    return list(predict([run / "model.pt"], unseen[:3]))


if __name__ == "__main__":
    for answer in main(quick="--quick" in sys.argv):
        print(f"{answer['shore_00']:.0f} ± {answer['spread']:.0f}, in truth {answer['true']:.0f}")
