"""The light of episodes: one light field a sensor of the pool, changed by episode in what costs no new one.

Components of a field belong to single lights (`gelsim.data.lightfield`), so the power and colour of each may change afterwards: a light's
colour rows are multiplied by power and colour over what they were when it was measured, exactly. The veil, which the window throws back, is
known for all lights together: it is multiplied by channel by what the lights together became. Exposure, white balance, tone, shading, noise
and markers come after the field anyway.

In the modes "path" and "direct" every episode is traced with its own lights; that takes long, and needs no field.

Fields are measured, and pictures traced, where they are asked to be; from a field pictures are drawn on CPU cores alone: one core draws a
press of 25 in half a second, sixteen processes that shared an H200 drew 2.5 presses a second, two of them six.
"""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.data.lightfield import LightField
from gelsim.errors import DatasetError, SceneError
from gelsim.membrane.surface import GRID_SPACING, Surface
from gelsim.results import Membrane
from gelsim.scene.definition import Camera, Scene
from gelsim.scene.layers import build_scene

QUIET: dict[str, Any] = {"noise_sd": (0.0, 0.0, 0.0), "full_well": (0.0, 0.0, 0.0), "read_noise": (0.0, 0.0, 0.0)}
"""A camera without noise: what is stored; noise is drawn while training."""
AT_ONCE = 8
"""Frames drawn in one launch; an episode has about twenty different ones."""


class Studio:
    """Draws the presses of many scenes, seen by few sensors; keeps the sensors' light fields."""

    def __init__(self, device: str = "cpu", spacing: float = GRID_SPACING) -> None:
        """`device`: Where fields are measured and pictures traced. `spacing`: Of the material grid that surfaces are drawn on [m]."""
        from gelsim import optics

        self._spacing = spacing
        self._variant, self._drawing = optics.choose_variant(device), optics.choose_variant("cpu")
        self._fields: dict[str, LightField] = {}
        self._surface: Surface | None = None
        self._renderers: dict[str, Any] = {}
        """The last one of a sensor."""

    def field(self, sensor: Scene) -> LightField:
        """Of the cache, or measured now: a few minutes of all cores."""
        from gelsim.optics import bake

        key = bake.field_key(sensor)
        if key not in self._fields:
            self._fields[key] = bake.light_field(sensor, self._variant, lambda *_: None)
        return self._fields[key]

    def membranes(self, scene: Scene, nodes: NDArray[np.float64], displacement: NDArray[np.float64]) -> list[Membrane]:
        """The coated surface from the motion of its nodes; episodes of a press that follow each other share it."""
        last = self._surface
        if last is None or last.gel != scene.gel or not np.array_equal(last.nodes, nodes):
            self._surface = last = Surface(scene.gel, nodes, self._spacing)
        return last.states(scene, displacement)

    def pictures(self, scene: Scene, sensor: Scene, membranes: list[Membrane]) -> list[NDArray[np.uint8]]:
        """The membranes as the scene's camera sees them, without noise.

        Args:
            sensor: The scene with the lights that the field was measured with.
        """
        quiet = scene.replace(camera=replace(scene.camera, **QUIET))
        if scene.render.mode != "baked":
            from gelsim import optics

            return [frame.image for frame in optics.render_frames(quiet, membranes, variant=self._variant)]
        from gelsim.optics import bake
        from gelsim.optics.baked import BakedRenderer

        key = f"{bake.field_key(sensor)} {scene.render.resolution}"
        field = relit(self.field(sensor), sensor, scene)
        renderer = self._renderers[key] = BakedRenderer(quiet, field, self._drawing, like=self._renderers.get(key))
        drawn = []
        for first in range(0, len(membranes), AT_ONCE):
            some = membranes[first : first + AT_ONCE]
            # Always the same number: what is compiled for one batch serves all.
            full = some + [some[-1]] * (AT_ONCE - len(some))
            drawn += [image for _, image, _ in renderer.frames(full)[: len(some)]]
        return drawn


def is_measured(sensor: Scene) -> bool:
    """Whether the sensor's light field lies in the cache."""
    from gelsim.optics import bake

    return Path(bake.field_path(sensor)).is_file()


def scene_of(content: bytes) -> Scene:
    """The scene of an episode's scene.toml, every field of which stands there. Raises DatasetError."""
    try:
        return build_scene(tomllib.loads(content.decode()))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DatasetError(f"scene.toml: is damaged ({error})") from None


def noise_of(camera: Camera) -> NDArray[np.float64]:
    """The camera's noise as an episode has it, (3, 3)."""
    return np.array([getattr(camera, name) for name in QUIET])


def relit(field: LightField, before: Scene, after: Scene) -> LightField:
    """The field with the powers and colours of another scene's lights, which stand where they stood.

    Raises:
        SceneError: The lights differ in more than power and colour, or something else that the field was measured for does.
    """
    from gelsim.optics import bake

    old, new = before.lights.lights, after.lights.lights
    same = after.replace(lights=replace(after.lights, lights=tuple(_dark(light) for light in new)))
    if bake.field_key(same) != bake.field_key(before.replace(lights=replace(before.lights, lights=tuple(_dark(light) for light in old)))):
        raise SceneError(
            "an episode may change the powers and colours of the lights, markers, and the camera after the lens; it changed more"
        )
    gains = np.array([np.array(n.rgb) * n.power / np.maximum(np.array(o.rgb) * o.power, 1e-12) for o, n in zip(old, new, strict=True)])
    used = field.light_of >= 0
    colours = field.colours.copy()
    colours[used] *= gains[field.light_of[used]].astype(np.float32)
    # What the lights together send onto the flat membrane, by channel, before and after.
    middle = field.table.shape[3] // 2
    sent = field.table[0, :, :, middle, middle].mean(axis=(0, 1))
    ratio = (sent @ colours) / np.maximum(sent @ field.colours, 1e-12)
    veil = field.veil.copy()
    veil[..., :3] *= ratio
    return replace(field, colours=colours, veil=veil)


def _dark(light: Any) -> Any:
    return dataclasses.replace(light, power=1.0, rgb=(1.0, 1.0, 1.0), peak_nm=None, width_nm=None)
