"""The object's press at a modulus, as pictures: approach and a small change of the modulus are free, the mesh and the place are not.

A press is solved at E and at E·exp(LOG_STEP) on the same meshes, so that what the mesh does to one it does to the other. Displacements of
the gel's surface between recorded states are cubic splines of the approach, between moduli linear in log E.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from gelsim import optics
from gelsim.membrane.surface import Surface, rest_membrane
from gelsim.optics.bake import light_field
from gelsim.optics.baked import BakedRenderer
from gelsim.optics.camera import seen_places
from gelsim.optics.isp import without_noise
from gelsim.optics.rest import resized
from gelsim.pipeline import stages
from gelsim.results import Deformation
from gelsim.scene.definition import Press, Scene
from gelsim.units import MM

Array = NDArray[np.float64]

LOG_STEP = 0.15
"""Of log E between the two presses: one to two points of Shore 00."""
RECORDED = 14
FINER = 2
"""Pixels drawn along a side of one that is compared."""


class Camera:
    """Draws membranes at the size of the pictures that are compared, without noise, by the baked light."""

    def __init__(self, scene: Scene, size: tuple[int, int], device: str, progress: Callable[[str, int, int], None]) -> None:
        self.size = size
        drawn = replace(scene.render, mode="baked", resolution=(FINER * size[0], FINER * size[1]))
        self.scene = without_noise(scene.replace(render=drawn))
        self._variant = optics.choose_variant(device)
        self._renderer = BakedRenderer(self.scene, light_field(self.scene, self._variant, progress), self._variant)
        self.rest = self._draw([rest_membrane(self.scene)])[0]

    def places_mm(self, pixels: Array) -> Array:
        """Where on the gel the compared picture's (column, row) lie [mm], both (M, 2)."""
        return seen_places(self.scene, FINER * pixels) / MM

    def change(self, surface: Surface, displacement: Array) -> Array:
        """What displacements of the surface's nodes (K, G, 3) [m] change in the picture [levels], (K, H, W, 3)."""
        return self._draw(surface.states(self.scene, displacement)) - self.rest

    def _draw(self, membranes: list) -> Array:
        frames = optics.render_frames(self.scene, membranes, variant=self._variant, renderer=self._renderer)
        return np.array([resized(frame.image.astype(float), self.size) for frame in frames])


@dataclass(frozen=True, eq=False)
class Pressed:
    """An object pressed at a place, at moduli near `log_modulus`."""

    log_modulus: float
    """Of E [kPa]."""
    place_mm: tuple[float, float]
    deepest_mm: float
    surface: Surface
    at_modulus: CubicSpline
    """Displacements (3 G,) [m] and normal force [N] by approach [mm]."""
    stiffer: CubicSpline
    """The same at `log_modulus` + LOG_STEP."""
    warnings: tuple[str, ...] = ()

    def states(self, approach_mm: Array, change: float = 0.0, shift_mm: tuple[float, float] = (0.0, 0.0)) -> tuple[Array, Array]:
        """Displacements of the nodes (K, G, 3) [m] and normal force (K,) [N], log E changed by `change` and the place by `shift_mm`.

        A shift takes the displacements along, to first order; it is to be small beside the contact.
        """
        first, second = self.at_modulus(approach_mm), self.stiffer(approach_mm)
        mixed = first + change / LOG_STEP * (second - first)
        moved = mixed[:, :-1].reshape(len(approach_mm), -1, 3)
        if any(shift_mm):
            moved = moved - np.tensordot(np.array(shift_mm) * MM, self.surface.slopes(moved), 1)
        return moved, mixed[:, -1]


def press_at(
    scene: Scene, log_modulus: float, place_mm: tuple[float, float], depth_mm: float, device: str, *, alone: bool = False
) -> Pressed:
    """Presses the scene's object, of a modulus exp(`log_modulus`) kPa, at a place of the gel; `alone`: at no other modulus.

    Raises:
        SceneError, MeshingError: It cannot be pressed there. SolveError: it finds no equilibrium.
    """
    presses = [
        stages.press(_of(scene, log_modulus + step, place_mm, depth_mm), device=device) for step in ((0.0,) if alone else (0.0, LOG_STEP))
    ]
    first = presses[0]
    surface = Surface(scene.gel, first.gel.rest[:, :2])
    deepest = float(min(press.approach[-1] for press in presses)) / MM
    splines = [_spline(press) for press in presses]
    return Pressed(log_modulus, place_mm, deepest, surface, splines[0], splines[-1], first.report.warnings)


def _of(scene: Scene, log_modulus: float, place_mm: tuple[float, float], depth_mm: float) -> Scene:
    body = replace(scene.object, shore_00=None, shore_a=None, modulus_scale=1.0, youngs_modulus_kpa=float(np.exp(log_modulus)))
    press = Press(
        depth_mm=depth_mm,
        force_n=None,
        frames=RECORDED,
        offset_mm=place_mm,
        tilt_deg=scene.press.tilt_deg,
        speed_mm_s=scene.press.speed_mm_s,
    )
    return scene.replace(object=body, press=press)


def _spline(press: Deformation) -> CubicSpline:
    values = np.column_stack([press.gel.displacement.reshape(len(press.approach), -1), -press.force[:, 2]])
    return CubicSpline(press.approach / MM, values)
