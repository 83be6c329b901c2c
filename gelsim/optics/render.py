"""Membranes to pictures: the light by `optics.tracer` on Mitsuba's vectorised variants, by Mitsuba's own path tracer on scalar ones.

Left out: see `optics.tracer`, `optics.camera`, `optics.lighting`, `optics.coating`; `left_out` for scalar variants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.membrane.surface import unmoved
from gelsim.optics.arrays import choose_arrays
from gelsim.optics.camera import height_map
from gelsim.optics.isp import Developer, as_picture, rest_on
from gelsim.optics.lighting import check_lights
from gelsim.optics.rest_places import RestPlaces
from gelsim.optics.scene_dict import mesh_arrays, path_count, scene_dict
from gelsim.optics.tracer import Tracer
from gelsim.optics.variant import VariantChoice, use_variant
from gelsim.results import Membrane
from gelsim.scene.definition import Scene


def left_out(scene: Scene, variant: VariantChoice) -> list[str]:
    """What of the scene this variant does not draw, in words for the report."""
    if not variant.name.startswith("scalar"):
        return []
    missing = ["light that the window's outer face returns (lights.window_reflection)"] if scene.lights.window_reflection else []
    missing += ["the lamps' lobes (lights.lights.lobe)"] if any(light.lobe != 1 for light in scene.lights.lights) else []
    return [f"{variant.name} draws without {part}: pictures differ by some grey levels; LLVM or CUDA draws it" for part in missing]


def drawn_by(scene: Scene, variant: VariantChoice) -> Scene:
    """The scene without what `left_out` says."""
    if not left_out(scene, variant):
        return scene
    lights = tuple(replace(light, lobe=1.0) for light in scene.lights.lights)
    return scene.replace(lights=replace(scene.lights, lights=lights, window_reflection=False))


class Renderer:
    """A scene's camera, lights and coating, made ready once to draw many membranes."""

    def __init__(self, scene: Scene, variant: VariantChoice) -> None:
        mi = use_variant(variant)
        check_lights(scene)
        self._scene = scene
        if variant.name.startswith("scalar"):
            self._scalar = ScalarRenderer(mi, scene, scene_dict(scene))
        else:
            self._scalar = None
            self._tracer = Tracer(mi, scene, scene.render.spp)
        self._arrays = choose_arrays(variant)
        self._developer: Developer | None = None
        self._places: RestPlaces | None = None

    def radiance(self, membrane: Membrane, seed: int | None = None) -> NDArray[np.float32]:
        """Linear RGB of the membrane, shape (H, W, 3); `seed` other than the scene's gives an independent estimate."""
        seed = self._scene.seed if seed is None else seed
        if self._scalar is not None:
            return self._scalar.radiance(membrane, seed)
        self._tracer.place(membrane)
        return np.array(self._tracer.picture(seed), np.float32)

    @staticmethod
    def radiances(renderers: Sequence[Renderer], membrane: Membrane, seed: int) -> list[NDArray[np.float32]]:
        """`radiance` of each of several renderers of one gel and camera: the membrane is placed once."""
        first = renderers[0]
        if first._scalar is not None:
            return [renderer.radiance(membrane, seed) for renderer in renderers]
        first._tracer.place(membrane)
        for other in renderers[1:]:
            other._tracer.place_as(first._tracer)
        return [np.array(renderer._tracer.picture(seed), np.float32) for renderer in renderers]

    def _prepare(self, membrane: Membrane) -> Developer:
        """The image pipeline; of a sensor with a photograph of its rest, its light at rest has to be drawn for it."""
        if self._developer is None:
            rest = None
            if self._scene.camera.has_rest:
                still = unmoved(self._scene, membrane)
                rest = rest_on(self._scene, self._arrays, self.radiance(still))
                self._places = RestPlaces(self._scene, self._arrays, still)
            self._developer = Developer(self._scene, self._arrays, rest)
        return self._developer

    def enqueue(self, membrane: Membrane, index: int = 0) -> tuple[Any, Any, Any]:
        """Starts drawing frame `index`, for `fetch`; only scalar variants wait."""
        developer = self._prepare(membrane)
        came = None if self._places is None else self._places(membrane)
        if self._scalar is not None:
            radiance = self._scalar.radiance(membrane, self._scene.seed)
            image = as_picture(developer(self._arrays.floats(radiance), index, came), radiance.shape[:2])
            return radiance, image, height_map(self._scene, membrane)
        self._tracer.place(membrane)
        picture, height = self._tracer.picture(self._scene.seed), self._tracer.height()
        self._tracer.dr.eval(picture, height)
        return picture, developer(self._arrays.floats(picture.array), index, came), height

    def fetch(self, drawn: tuple[Any, Any, Any]) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
        """Of a frame that was started: linear RGB and the 8-bit picture, (H, W, 3), and z at the pixels' centres [m], (H, W)."""
        if self._scalar is not None:
            return drawn
        radiance, packed, height = (np.array(values) for values in drawn)
        return radiance, as_picture(packed, height.shape), height * np.float32(1e-3)


class ScalarRenderer:
    """Mitsuba's own path tracer, camera and reflectances: slower, without the window's reflections and emission lobes.

    It shares no equation of the light with `Tracer`, whose check it is in tests.
    """

    def __init__(self, mi: ModuleType, scene: Scene, parts: dict) -> None:
        self._mitsuba, self._scene, self._spp = mi, scene, path_count(scene)
        self._parts = {name: native(mi, part) for name, part in parts.items()}
        self._coating = mi.load_dict(self._parts.pop("coating"))

    def radiance(self, membrane: Membrane, seed: int) -> NDArray[np.float32]:
        """Linear RGB, shape (H, W, 3)."""
        mesh = membrane_mesh(self._mitsuba, mesh_arrays(membrane, self._scene), self._coating)
        scene = self._mitsuba.load_dict({**self._parts, "membrane": mesh})
        return np.array(self._mitsuba.render(scene, spp=self._spp, seed=seed), np.float32)


def membrane_mesh(mi: ModuleType, arrays: dict[str, np.ndarray], coating: object) -> object:
    """Mitsuba's mesh of `mesh_arrays`, with a BSDF."""
    properties = mi.Properties()
    properties["bsdf"] = coating
    mesh = mi.Mesh(
        "membrane",
        vertex_count=len(arrays["vertex_positions"]),
        face_count=len(arrays["faces"]),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    for name, values in arrays.items():
        parameters[name] = values.ravel()
    parameters.update()
    return mesh


def native(mi: ModuleType, value: object) -> object:
    """Plain data with Mitsuba's own transforms and bitmaps in place of arrays."""
    if isinstance(value, dict):
        return {key: native(mi, item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return mi.ScalarTransform4f(value) if value.shape == (4, 4) else mi.Bitmap(value)
    return value
