"""When is a new factorisation cheaper than GMRES's products on an old one? (gelsim/fem/linear.py, `SymmetricSystem.PER_ENTRY`)

    python docs/studies/rough_steps.py

Presses a coupled ball with friction, as profile, quarter and whole, once with products until factors are worn out, once with factors for
every step. Prints operations of a factorisation over the entries of matrix and factor, and seconds of processor time, the better of two.
"""

from __future__ import annotations

import time
from typing import Any

from gelsim.fem import newton
from gelsim.fem.linear import SymmetricSystem
from gelsim.pipeline import stages
from gelsim.scene.layers import build_scene

CASES = [("fast", "auto"), ("balanced", "auto"), ("reference", "auto"), ("fast", "mirror"), ("balanced", "mirror"), ("fast", "none")]

seen: list[SymmetricSystem] = []


class Watched(SymmetricSystem):
    always = False
    """Whether every step has factors of its own."""

    def step(self, *arguments: Any, **named: Any) -> Any:
        self.factored = self.factored and not self.always
        return super().step(*arguments, **named)

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        seen.append(self)


newton.SymmetricSystem = Watched  # type: ignore[misc]

print("| scene | unknowns | operations over entries | products: s, factorisations | factors: s, factorisations |\n|---|---|---|---|---|")
for fidelity, symmetry in CASES:
    scene = build_scene(
        {
            "fidelity": fidelity,
            "gel": {"profile": "flat", "youngs_modulus_kpa": 50.0},
            "object": {"shape": "hemisphere", "radius_mm": 5.0, "youngs_modulus_kpa": 200.0},
            "contact": {"friction_coefficient": 0.3},
            "press": {"depth_mm": 1.0, "force_n": "none", "frames": 10, "symmetry": symmetry},
        }
    )
    press, cells = stages.press(scene, device="cpu"), []  # kernels and meshes
    for Watched.always in (False, True):
        seconds = []
        for _ in range(2):
            start = time.process_time()
            press = stages.press(scene, device="cpu")
            seconds.append(time.process_time() - start)
        cells.append(f"{min(seconds):.2f}, {press.report.factorisations}")
    print(f"| {fidelity}, {symmetry} | {press.report.unknowns} | {seen[-1].direct.cost:.0f} | {' | '.join(cells)} |", flush=True)
