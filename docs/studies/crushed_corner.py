"""What the two tries of a crushed soft corner give, and how little it takes for the first to fail (docs/mechanics.md §3).

    python docs/studies/crushed_corner.py --factors 0.97 1 1.03 --tries 1

Scene 10 of `gelsim bench --only random`: a corner of 00-22 pressed 9 mm, to 5.6 N; the object's Shore number times each factor. The first
try has six contact points a face; the second has twelve, and volume held at points. Prints how each ended, and seconds of processor time.
"""

from __future__ import annotations

import argparse
import time

from gelsim.bench.presses import facts
from gelsim.bench.random_scenes import draw
from gelsim.fem.problem import PressProblem
from gelsim.fem.quasistatic import run_press
from gelsim.fem.strategy import HELD, PLAIN
from gelsim.pipeline import stages
from gelsim.scene import materials
from gelsim.scene.layers import build_scene

parser = argparse.ArgumentParser()
parser.add_argument("--factors", type=float, nargs="+", default=[0.97, 1.0, 1.03])
parser.add_argument("--tries", type=int, nargs="+", choices=(1, 2), default=(1, 2))
options = parser.parse_args()

print("| factor | try | ended | at [mm] | force [N] | overlap [µm] | halved | s |\n|---|---|---|---|---|---|---|---|")
for factor in options.factors:
    layer = draw(10)
    layer["object"]["shore_00"] = round(factor * layer["object"]["shore_00"], 2)
    scene = build_scene(layer)
    gel, body, placement = stages.bodies(scene)
    of_gel, of_object = materials.gel_material(scene), materials.object_material(scene)
    for number in options.tries:
        start = time.process_time()
        way = (PLAIN, HELD)[number - 1]
        points, held = way.contact_points, way.held
        tried = PressProblem(scene, gel, body, placement, of_gel, of_object, "cpu", contact_points=points, held=held)
        row = facts(run_press(tried, throw=False), scene.press.frames)
        print(
            f"| {factor:g} | {number} | {row['status'].lower()} | {row['approach_mm']:.2f} | {-row['force_n'][2]:.3f} | "
            f"{row['penetration_um']:.0f} | {row['steps_halved']} | {time.process_time() - start:.0f} |",
            flush=True,
        )
