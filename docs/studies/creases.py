"""How far do presses squeeze the gel's surface, and are those lost that squeeze it most?

    python docs/studies/creases.py FOLDER [--press 79 ... [--coat 5]] [--fidelity balanced]

A neo-Hookean half space creases where its surface is squeezed to 0.65 of its length, and buckles at any wave length at 0.54 (Hong, Zhao and
Suo 2009; Biot 1963): the finer the faces, the more ways there are. A coat resists (`--coat`, in N/m; the kept gels have none). Presses are
the rigid ones of live's table (`gelsim.bench.live_presses`) that FOLDER keeps (`gelsim bench --only live --out OUT` keeps them in
OUT/kept); those named are solved where they are not, and told state by state. Stretches are the lesser in-plane ones of the gel's outer
faces, by their corners.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np

from gelsim.bench import live_presses

CREASE = 0.65


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--press", type=int, nargs="+", default=[], help="numbers; solved where they are not kept")
    parser.add_argument("--fidelity", default="balanced", choices=("fast", "balanced", "reference"))
    parser.add_argument("--coat", type=float, default=0.0, metavar="N_PER_M", help="of the gels of --press")
    options = parser.parse_args()
    found = []
    for number in options.press or range(live_presses.SOFT):
        name, drawn = live_presses.draw(number)
        if options.coat:
            drawn["gel"]["coat_n_per_m"] = options.coat
        if not options.press and not live_presses.kept_at(drawn, options.folder, options.fidelity).exists():
            continue
        press = live_presses.solved(drawn, options.folder, options.fidelity)
        stretches = np.array([press.gel.least_stretches(state) for state in range(len(press.approach))])
        if options.press:
            for approach, of_state in zip(press.approach, stretches, strict=True):
                print(
                    f"{number} {name}, {1e3 * approach:.3f} mm: {of_state.min():.2f}, {int((of_state < CREASE).sum())} faces below {CREASE}"
                )
        found.append((float(stretches.min()), press.lost, number, name))
    for least, lost, number, name in sorted(found):
        print(f"{least:.2f} {'lost  ' if lost else 'solved'} {number} {name}")
    for low, high in pairwise((0.0, 0.1, CREASE, 1.0)):
        some = [lost for least, lost, _, _ in found if low <= least < high]
        print(f"squeezed to {low:g} to {high:g}: {sum(some)} of {len(some)} presses are lost")


if __name__ == "__main__":
    main()
