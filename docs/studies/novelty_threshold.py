"""From which distance on is a press unlike the training? By sensors outside its ranges.

    python docs/studies/novelty_threshold.py RUNS/paper2017/model.pt RUNS/rows_paper2017_gap/predictions.csv [...]

The tables are `gelsim-learn eval --model` of that network alone on plan `gap`: a training's own threshold comes from sensors of its plan,
and a real one is no more like these than `gap`'s are. Writes the distance that 99 % of their presses stay below into the checkpoint;
everything else in it stays as it is.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from learn.checkpoint import load, save
from learn.novelty import QUANTILE

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("model", type=Path)
parser.add_argument("predictions", type=Path, nargs="+")
given = parser.parse_args()

kept = load(given.model)
assert isinstance(kept.novelty, dict)
strangeness = [float(row["novelty"]) for table in given.predictions for row in csv.DictReader(table.open(newline=""))]
threshold = kept.novelty["threshold"] * float(np.nanquantile(strangeness, QUANTILE))
print(f"{given.model}: {kept.novelty['threshold']:.3f} -> {threshold:.3f}, of {len(strangeness)} presses")
save(given.model, replace(kept, novelty=kept.novelty | {"threshold": threshold}))
