"""Pictures of a fitted sensor by the renderer: what `gelsim render --sensor sensor.toml` shows, with the dent of `calibrate.dent`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gelsim import optics
from gelsim.calibrate.dent import DentFamily, effective_radius
from gelsim.calibrate.drag import carried
from gelsim.calibrate.parameters import curvature_of
from gelsim.membrane import surface
from gelsim.results import Membrane
from gelsim.scene.definition import Scene
from gelsim.units import MM

Array = NDArray[np.float64]

SETTLED = 6
"""Turns of the fixed point: a drag of a tenth of the contact's radius changes by less than a tenth of itself from turn to turn."""


def dented(scene: Scene, dents: DentFamily, ball_mm: float, press: Array) -> Membrane:
    """The coated surface under a ball, press of `parameters.PRESS`."""
    curvature = curvature_of(scene.gel)
    centre = press[:2] / (1 + ball_mm * curvature)
    radius = float(effective_radius(np.array(ball_mm), curvature))
    depth = float(dents.clipped(press[2], np.array(radius)))

    def displacement(places: Array) -> Array:
        rest = places / MM - centre
        away = rest
        if press[3:].any():
            # Where the drag carries it; the dent then acts there.
            contact = np.full(len(rest), np.sqrt(radius * depth))
            for _ in range(SETTLED):
                away = rest + carried(away, contact, scene.gel.thickness_mm, np.broadcast_to(press[3:], rest.shape))
        distance = np.sqrt((away**2).sum(axis=1)) + 1e-12
        radial, vertical = dents.displacement(distance, depth, radius)
        return np.column_stack([away * (1 + radial / distance)[:, None] - rest, vertical]) * MM

    return surface.moved_membrane(scene, displacement)


def draw(
    scene: Scene,
    dents: DentFamily,
    balls_mm: Array | float,
    presses: Sequence[Array],
    *,
    device: str = "auto",
    progress: Callable[[int, int], None] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The picture without contact (H, W, 3), and one of each press (P, H, W, 3), 8 bit; `balls_mm`: of all, or of each."""
    balls = np.broadcast_to(balls_mm, (len(presses),)).astype(float)
    surfaces = [surface.rest_membrane(scene), *(dented(scene, dents, ball, press) for ball, press in zip(balls, presses, strict=True))]
    frames = [frame.image for frame in optics.render_frames(scene, surfaces, device=device, progress=progress)]
    return frames[0], np.array(frames[1:], np.uint8).reshape(len(presses), *frames[0].shape)
