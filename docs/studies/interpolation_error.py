"""What interpolating the membrane between solved states is off by: every second state of a press left out, and compared where it was.

    python docs/studies/interpolation_error.py                 the table of docs/datasets.md; 1 to 2 minutes a press on a quiet core

The error is of a spacing twice that of the press that is solved; at the press's own it is smaller.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import gelsim
from gelsim.data.motion import Motion
from gelsim.scene.layers import build_scene

PRESSES = {
    "cylinder R 10, 00-30": {
        "object": {"shape": "cylinder", "radius_mm": 10.0, "shore_00": 30.0},
        "press": {"tilt_deg": [4.0, 3.0], "offset_mm": [1.0, -0.5], "shear_mm": [0.2, 0.1], "twist_deg": 2.0},
    },
    "hemisphere R 15, 00-50": {
        "object": {"shape": "hemisphere", "radius_mm": 15.0, "shore_00": 50.0},
        "press": {"tilt_deg": [4.0, 3.0], "offset_mm": [1.0, -0.5], "shear_mm": [0.2, 0.1]},
    },
}


def errors(motion: Motion, stride: int = 2) -> dict[str, float]:
    """Of the states between every `stride`-th: the largest root mean square over the gel of any state, and the largest error [µm]."""
    kept = np.arange(0, len(motion.approach), stride)
    left = np.setdiff1d(np.arange(kept[-1]), kept)
    fewer = replace(motion, **{name: getattr(motion, name)[kept] for name in ("approach", "force", "contact_area", "displacement")})
    linear = np.empty_like(motion.displacement[left])
    for row, state in enumerate(left):
        before, after = kept[kept < state][-1], kept[kept > state][0]
        share = (motion.approach[state] - motion.approach[before]) / (motion.approach[after] - motion.approach[before])
        linear[row] = (1 - share) * motion.displacement[before] + share * motion.displacement[after]
    table = {}
    for name, found in (("cubic", fewer.at(motion.approach[left])[0]), ("straight", linear)):
        off = 1e6 * np.linalg.norm(found - motion.displacement[left], axis=2)
        table |= {f"{name}_rms_um": float(np.sqrt((off**2).mean(axis=1)).max()), f"{name}_largest_um": float(off.max())}
    return table


def main(states: int = 13, fidelity: str = "fast") -> dict[str, dict[str, float]]:
    """Errors by press."""
    found = {}
    for name, layer in PRESSES.items():
        motion_to = {"depth_mm": 1.6, "force_n": 30.0, "frames": states}
        scene = build_scene(layer, {"press": motion_to, "fidelity": fidelity})
        found[name] = errors(Motion.of_press(gelsim.press(scene, device="cpu")))
        print(name, {key: round(value, 2) for key, value in found[name].items()}, flush=True)
    return found


if __name__ == "__main__":
    main()
