"""A network halfway between two, weight by weight: between one and itself trained on, which forgets less (Wortsman et al. 2022, WiSE-FT).

    python docs/studies/halfway.py BEFORE.pt AFTER.pt OUT.pt
    gelsim-learn train --data SOME --init OUT.pt --rate 1e-9 --warmup 0 --steps 1 --out RUN       fits spread and novelty anew
    python docs/studies/halfway.py BEFORE.pt AFTER.pt OUT.pt --fitted RUN/model.pt

All but the weights, and what was fitted, is AFTER's. Only networks of one origin have weights that may be averaged.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from learn.checkpoint import load, save

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
for name in ("before", "after", "out"):
    parser.add_argument(name, type=Path)
parser.add_argument("--fitted", type=Path, help="a checkpoint whose spread factor, novelty distance and gels are taken")
given = parser.parse_args()

before, after = load(given.before), load(given.after)
assert before.network.keys() == after.network.keys()
weights = {name: 0.5 * (before.network[name].float() + after.network[name].float()) for name in after.network}
made = replace(after, network=weights)
if given.fitted:
    fitted = load(given.fitted)
    made = replace(made, spread_factor=fitted.spread_factor, novelty=fitted.novelty, gels=fitted.gels)
save(given.out, made)
