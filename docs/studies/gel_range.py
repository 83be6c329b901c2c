"""Which gels was a network trained on? Writes their range into a checkpoint that was trained before it was kept, from the plan of its data.

    python docs/studies/gel_range.py assets/models/paper2017.pt assets/models/varied.pt --plan varied --seed 1 --presses 2688
    python docs/studies/gel_range.py assets/models/paper2017.pt assets/models/varied.pt --plan gap --seed 1 --presses 1000 --dry

Draws the plan's first presses and takes those that are trained on, as `gelsim-learn train` does with the rows of a dataset
(`learn.novelty.gel_range`). Which of them a training really had does not matter where they are many: thickness and edge are those of the
plan's few sensors, and hardnesses drawn evenly reach both ends. Everything else in the file stays as it is, to the bit, or it is not
written. With --dry nothing is written: tells how many of the plan's presses, of every split, the checkpoints that there are call strange
for their gel, all together.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from gelsim.data.episodes import gel_facts
from gelsim.generate.plan import Catalogue, load_plan
from learn.checkpoint import load, save
from learn.data import gel_of
from learn.ensemble import Ensemble
from learn.novelty import gel_range
from learn.splits import TRAIN


def same(one: Any, other: Any) -> bool:
    """Whether tables of a checkpoint hold the same, to the bit."""
    if isinstance(one, dict):
        return isinstance(other, dict) and list(one) == list(other) and all(same(one[name], other[name]) for name in one)
    if isinstance(one, torch.Tensor):
        return isinstance(other, torch.Tensor) and one.dtype == other.dtype and torch.equal(one, other)
    return one == other


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("models", nargs="+", type=Path)
parser.add_argument("--plan", required=True)
parser.add_argument("--seed", type=int, required=True)
parser.add_argument("--presses", type=int, default=2688)
parser.add_argument("--dry", action="store_true")
given = parser.parse_args()

catalogue = Catalogue(load_plan(given.plan), given.seed)
presses = [catalogue.press(number) for number in range(given.presses)]
gels = [gel_of(gel_facts(press.scene.gel)) for press in presses]
found = gel_range(gel for gel, press in zip(gels, presses, strict=True) if press.split == TRAIN)
assert found is not None
print(f"plan {given.plan}, seed {given.seed}, {sum(press.split == TRAIN for press in presses)} of {len(presses)} presses are trained on:")
print(f"lowest {found.lowest.tolist()}, highest {found.highest.tolist()} (thickness, edge [mm], Shore 00)")
if given.dry:
    ensemble = Ensemble(given.models, torch.device("cpu"))
    print(f"strange for their gel: {sum(bool(ensemble.strange_gel(gel)) for gel in gels)} of {len(gels)}")
else:
    for path in given.models:
        partial = path.with_suffix(".partial")
        save(partial, replace(load(path), gels=found.to_plain()))
        before, after = (torch.load(file, weights_only=True) for file in (path, partial))
        assert same({name: value for name, value in before.items() if name != "gels"}, {k: v for k, v in after.items() if k != "gels"})
        partial.replace(path)
        print(f"{path}: written; the rest is as it was")
