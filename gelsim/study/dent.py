"""The dent that a press leaves in the gel's coated surface, along x from the apex: how wide it is, and how far it reaches.

The surface is sampled where its material points are now, x + u_x, and compared with the height at rest there. A press that is symmetric
about the apex is meant; others are measured along one half of one line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gelsim.pipeline.outputs import sample_surface
from gelsim.shape.shapes import gel_height
from gelsim.study.trial import Trial
from gelsim.units import MM

SAMPLES = 400
BESIDE = 1e-6
"""The line runs this far [m] beside y = 0, where meshes have edges."""


@dataclass(frozen=True)
class Dent:
    """Lengths in m."""

    depth: float
    width: float
    """Where it is half as deep as at its deepest, from side to side."""
    reach: float
    """From the edge of contact to where it is a tenth as deep."""
    sideways: float
    """The farthest that a point of the surface went sideways: what a marker there would show."""


def measure_dent(trial: Trial) -> Dent:
    """Of the last state of a press."""
    scene, press = trial.scene, trial.press
    start = scene.press.offset_mm[0] * MM
    x = np.linspace(start + BESIDE, 0.5 * scene.gel.size_mm[0] * MM - BESIDE, SAMPLES)
    points = np.stack([x, np.full_like(x, scene.press.offset_mm[1] * MM + BESIDE)], axis=1)
    rest, moved = sample_surface(press.gel, points)
    now = rest + moved[-1]
    descent = gel_height(scene.gel, now[:, :2]) - now[:, 2]
    depth = float(descent.max())
    contact = float(np.sqrt(press.contact_area[-1] / np.pi))
    return Dent(
        depth,
        2 * (_falls_below(now[:, 0], descent, 0.5 * depth) - start),
        _falls_below(now[:, 0], descent, 0.1 * depth) - start - contact,
        float(np.linalg.norm(moved[-1][:, :2], axis=1).max()),
    )


def _falls_below(x: np.ndarray, descent: np.ndarray, level: float) -> float:
    """Where the dent is last that deep, going outward."""
    last = int(np.flatnonzero(descent >= level)[-1])
    if last + 1 == len(x):
        return float(x[-1])
    share = (descent[last] - level) / (descent[last] - descent[last + 1])
    return float(x[last] + share * (x[last + 1] - x[last]))
