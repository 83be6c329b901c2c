"""Where the seconds of a press go: the coupled hemisphere at `balanced`, whole body or quarter, by what they are spent on.

    python docs/studies/press_profile.py [--symmetry mirror] [--fidelity balanced]

Seconds are of functions of gelsim.fem, each without those of the others named here: a stop-watch around each, kernels and meshes cached
by a run before. It runs at commit a3241f4 too, before the mechanics were made faster.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections import defaultdict

from gelsim.fem import linear, newton
from gelsim.pipeline import stages
from gelsim.scene.layers import build_scene

WATCHED = (
    ("factorise", linear.PardisoSolver, "factorise"),
    ("solve", linear.PardisoSolver, "solve"),
    ("analyse the pattern", linear.PardisoSolver, "analyse"),
    ("residual, contact search in it", newton.Newton, "residual"),
    ("tangent", newton.Newton, "tangent"),
)


class StopWatch:
    """Seconds and calls by name; a call within another is taken off the outer one."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._inner = [0.0]

    def watch(self, name: str, home: type, method: str) -> None:
        original = getattr(home, method)

        @functools.wraps(original)
        def timed(*arguments, **named):
            start = time.perf_counter()
            self._inner.append(0.0)
            try:
                return original(*arguments, **named)
            finally:
                took = time.perf_counter() - start
                self.seconds[name] += took - self._inner.pop()
                self.calls[name] += 1
                self._inner[-1] += took

        setattr(home, method, timed)


def main(symmetry: str = "mirror", fidelity: str = "balanced") -> dict[str, float]:
    scene = build_scene({
        "gel": {"profile": "flat", "youngs_modulus_kpa": 50.0, "poissons_ratio": 0.499},
        "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": 200.0, "poissons_ratio": 0.499},
        "contact": {"friction_coefficient": 0.0},
        "press": {"depth_mm": 1.0, "force_n": "none", "frames": 11, "symmetry": symmetry},
        "fidelity": fidelity,
    })  # fmt: skip
    stages.press(scene)
    watch = StopWatch()
    for entry in WATCHED:
        if hasattr(*entry[1:]):  # at a3241f4 the tangent was no function of Newton's: there it is part of the rest
            watch.watch(*entry)
    record = stages.Record()
    press = stages.press(scene, record=record)
    whole = record.seconds["press"]
    print(f"| {symmetry}, {fidelity}, {press.report.unknowns} unknowns | calls | seconds | share |\n|---|---|---|---|")
    for name, _, _ in WATCHED:
        print(f"| {name} | {watch.calls[name]} | {watch.seconds[name]:.2f} | {watch.seconds[name] / whole:.0%} |")
    left = whole - sum(watch.seconds.values())
    print(f"| the rest | – | {left:.2f} | {left / whole:.0%} |")
    print(f"| all, {press.newton_iterations.sum()} Newton iterations | – | {whole:.2f} | |")
    return dict(watch.seconds) | {"all": whole}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--symmetry", default="mirror", help="mirror, none or auto (which was what mirror is now, at a3241f4)")
    parser.add_argument("--fidelity", default="balanced")
    options = parser.parse_args()
    main(options.symmetry, options.fidelity)
