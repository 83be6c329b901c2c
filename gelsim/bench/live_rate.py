"""Section `live-rate`: frames a second of `gelsim.LiveSensor`, on a way down and sideways in steps of 20 µm, after a first walk.

All of a frame is looked at, but in the row "force and contact only", whose height and markers are not asked for.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from gelsim.bench.live_presses import THICKNESS_MM
from gelsim.bench.section import Case, Options, Row, Section
from gelsim.errors import SolveStatus
from gelsim.live.sensor import LiveSensor
from gelsim.scene.layers import build_scene
from gelsim.units import MM

WALK = 40


def _rate(friction: float, *, image: bool = False, look: bool = True, soft: bool = False) -> Row:
    scene = build_scene({
        "gel": {"profile": "flat", "thickness_mm": THICKNESS_MM},
        "object": {"shape": "hemisphere", "radius_mm": 8.0, "height_mm": 12.0} | ({"shore_00": 30.0} if soft else {"rigid": True}),
        "contact": {"friction_coefficient": friction},
        "render": {"resolution": [320, 240]},
    })  # fmt: skip
    sensor = LiveSensor(scene, image=image)
    wall, busy, slowest = [], [], 0.0
    for walk in range(2):
        sensor.reset()
        for step in range(2 * WALK):
            down, aside = min(step, WALK), max(step - WALK, 0)
            began, spent = time.perf_counter(), time.process_time()
            frame = sensor.step((aside * 0.02 * MM, 0.0, -down * 0.02 * MM, 1.0, 0.0, 0.0, 0.0), 0.01)
            if look:
                _ = frame.height, frame.marker_pixels
            if walk:
                wall.append(time.perf_counter() - began)
                busy.append(time.process_time() - spent)
    slowest = float(np.max(wall))
    return {
        "status": SolveStatus.CONVERGED.name,
        "median_ms": round(1e3 * float(np.median(wall)), 2),
        "slowest_ms": round(1e3 * slowest, 2),
        "processor_ms": round(1e3 * float(np.median(busy)), 2),
        "rate": round(1.0 / float(np.mean(wall)), 1),
    }


def _cases(options: Options) -> Iterator[Case]:
    yield Case("force and contact only", partial(_rate, 0.5, look=False))
    yield Case("no picture", partial(_rate, 0.5))
    yield Case("picture of 320 × 240", partial(_rate, 0.5, image=True))
    yield Case("picture of 320 × 240, no friction", partial(_rate, 0.0, image=True))
    yield Case("picture of 320 × 240, Shore 00-30", partial(_rate, 0.5, image=True, soft=True))


SECTION = Section(
    title="Live: frames a second",
    columns=(
        ("ball R 8, steps of 20 µm", "name"),
        ("frames a second", "rate"),
        ("median [ms]", "median_ms"),
        ("slowest [ms]", "slowest_ms"),
        ("of processor [ms]", "processor_ms"),
    ),
    cases=_cases,
)
