"""How far do presses squeeze the gel's surface, and are those lost that squeeze it most?

    python docs/studies/creases.py FOLDER [--press 79 ...] [--fidelity balanced]

A neo-Hookean half space creases where its surface is squeezed to 0.65 of its length, and buckles at any wave length at 0.54 (Hong, Zhao and
Suo 2009; Biot 1963): the finer the faces, the more ways there are. A coat resists. Presses are the rigid ones of live's table
(`gelsim.bench.live_presses`) that FOLDER keeps (`gelsim bench --only live --out OUT` keeps them in OUT/kept), bare to their end; those
named are solved as the commands do, with all tries, and told state by state. Stretches are the lesser in-plane ones of the gel's outer
faces, by their corners.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np

from gelsim.bench import live_presses, mesh_parts
from gelsim.pipeline import stages

CREASE = 0.65


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--press", type=int, nargs="+", default=[], help="numbers; solved anew")
    parser.add_argument("--fidelity", default="balanced", choices=("fast", "balanced", "reference"))
    options = parser.parse_args()
    found = []
    for number in options.press or range(live_presses.SOFT):
        name, drawn = live_presses.draw(number)
        if options.press:
            press = stages.press(mesh_parts.built(drawn, options.folder).replace(fidelity=options.fidelity), device="cpu", throw=False)
        elif live_presses.kept_at(drawn, options.folder, options.fidelity).exists():
            press = live_presses.solved(drawn, options.folder, options.fidelity)
        else:
            continue
        stretches = np.array([press.gel.least_stretches(state) for state in range(len(press.approach))])
        if options.press:
            report = press.report
            print(f"{number} {name}: try {report.tried}, coat {report.coat_n_per_m or 0:.2g} N/m, {press.seconds.sum():.0f} s in it")
            for approach, of_state in zip(press.approach, stretches, strict=True):
                print(f"  {1e3 * approach:.3f} mm: {of_state.min():.2f}, {int((of_state < CREASE).sum())} faces below {CREASE}")
        found.append((float(stretches.min()), press.lost, number, name))
    for least, lost, number, name in sorted(found):
        print(f"{least:.2f} {'lost  ' if lost else 'solved'} {number} {name}")
    for low, high in pairwise((0.0, 0.1, CREASE, 1.0)):
        some = [lost for least, lost, _, _ in found if low <= least < high]
        print(f"squeezed to {low:g} to {high:g}: {sum(some)} of {len(some)} presses are lost")


if __name__ == "__main__":
    main()
