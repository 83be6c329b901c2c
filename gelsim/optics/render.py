"""Membranes to pictures by path tracing (Mitsuba 3: Jakob et al. 2022).

Per pixel the mean over `render.spp` paths of the light that reaches the camera: L = ∫ f(ω, ω') L_i(ω') cos θ dω' at the membrane, its
direct part by sampling points on the lights, its indirect part by sampling the coating. The random numbers are the same for every frame of
one scene: a membrane that did not move gives the same pixels bit by bit, and a video does not flicker. Left out: see `optics.camera`
(refraction of camera rays), `optics.lighting` (the window's outer face), `optics.coating`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from gelsim.optics.camera import height_map, marker_pixels
from gelsim.optics.isp import develop
from gelsim.optics.scene_dict import mesh_arrays, path_count, scene_dict
from gelsim.optics.variant import VariantChoice, choose_variant, use_variant
from gelsim.results import Frame, Membrane
from gelsim.scene import Scene


def render_frames(
    scene: Scene,
    membranes: Sequence[Membrane],
    *,
    progress: Callable[[int, int], None] | None = None,
    device: str = "auto",
    variant: VariantChoice | None = None,
) -> Iterator[Frame]:
    """The sensor's picture of each membrane, one at a time.

    Args:
        scene: Camera, lights, coating, markers, render and seed are used.
        membranes: Of the scene's gel; all with the same faces and uv.
        progress: Called with (frames done, frames in all) after each.
        device: "auto" | "cpu" | "cuda", see `choose_variant`.
        variant: Overrides the choice.
    Raises:
        SceneError: A field that cannot be drawn; before the first frame.
        RenderError: The device cannot render.
    """
    renderer = Renderer(scene, variant or choose_variant(device))
    for index, membrane in enumerate(membranes):
        radiance = renderer.radiance(membrane)
        yield Frame(radiance, develop(scene, radiance, index), height_map(scene, membrane), marker_pixels(scene, membrane))
        if progress:
            progress(index + 1, len(membranes))


class Renderer:
    """A scene's camera, lights and coating, made ready once to draw many membranes."""

    def __init__(self, scene: Scene, variant: VariantChoice) -> None:
        self._seed = scene.seed
        self._spp = path_count(scene)
        self._mitsuba = use_variant(variant)
        self._parts = {name: _native(self._mitsuba, part) for name, part in scene_dict(scene).items()}
        self._coating = self._mitsuba.load_dict(self._parts.pop("coating"))
        self._scene = None

    def radiance(self, membrane: Membrane, seed: int | None = None) -> NDArray[np.float32]:
        """Linear RGB of the membrane, shape (H, W, 3); `seed` other than the scene's gives an independent estimate."""
        mi = self._mitsuba
        arrays = mesh_arrays(membrane)
        if self._scene is None or mi.variant().startswith("scalar"):
            # Scalar variants rebuild: they gain nothing from an update in place.
            mesh = _mesh(mi, arrays, self._coating)
            self._scene = mi.load_dict({**self._parts, "membrane": mesh})
        else:
            parameters = mi.traverse(self._scene)
            parameters["membrane.vertex_positions"] = arrays["vertex_positions"].ravel()
            parameters["membrane.vertex_normals"] = arrays["vertex_normals"].ravel()
            parameters.update()
        picture = mi.render(self._scene, spp=self._spp, seed=self._seed if seed is None else seed)
        return np.array(picture, np.float32)


def _mesh(mi: ModuleType, arrays: dict[str, np.ndarray], coating: object) -> object:
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


def _native(mi: ModuleType, value: object) -> object:
    """Plain data with Mitsuba's own transforms and bitmaps in place of arrays."""
    if isinstance(value, dict):
        return {key: _native(mi, item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return mi.ScalarTransform4f(value) if value.shape == (4, 4) else mi.Bitmap(value)
    return value
