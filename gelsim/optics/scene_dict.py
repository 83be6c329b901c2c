"""The whole optical scene as plain data, in Mitsuba's terms; readable and testable without Mitsuba.

Lengths are millimetres here, and only here: the renderer's ray offset is about 1e-4 of (1 + largest coordinate), so metres would put
shadows a tenth of a millimetre off. 4 × 4 arrays are transforms, 3-D arrays are bitmaps; `render` turns both into Mitsuba's own.
"""

from __future__ import annotations

import math

import numpy as np

from gelsim.optics.camera import apparent_distance, apparent_positions, pixel_size
from gelsim.optics.coating import coating_dict
from gelsim.optics.lighting import emitter_dict
from gelsim.results import Membrane
from gelsim.scene.definition import Scene
from gelsim.units import MM_PER_M

INTEGRATORS = {
    # Depth 4: light, membrane and up to two more reflections; a third adds less than albedo³ times a dent's view of itself, below 0.5 %.
    "path": {"type": "path", "max_depth": 4, "rr_depth": 100, "hide_emitters": True},
    "direct": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True},
}


def scene_dict(scene: Scene) -> dict:
    """Camera, lights, coating and integrator; for scalar variants; the mesh comes from `mesh_arrays`.

    Raises:
        SceneError: There is no light.
    """
    return {
        "type": "scene",
        "integrator": dict(INTEGRATORS[scene.render.mode]),
        "camera": camera_dict(scene),
        "coating": coating_dict(scene),
        **emitter_dict(scene),
    }


def path_count(scene: Scene) -> int:
    """Light paths a pixel: render.spp, rounded up until the sampler can lay them out as a grid and every light gets the same number.

    Without the latter the choice among the lights is not evenly stratified: 35 paths for 4 lights are noisier than 16.
    """
    count, lights = scene.render.spp, max(len(scene.lights.lights), 1)
    while True:
        rows = math.isqrt(count)
        if count % rows == 0 and count % lights == 0:
            return count
        count += 1


def camera_dict(scene: Scene) -> dict:
    """The pinhole of `optics.camera`; its own x axis points left in the picture, and up is -y."""
    width, height = scene.render.resolution
    distance = apparent_distance(scene)
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose[2, 3] = -distance * MM_PER_M
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(width * pixel_size(scene) / 2 / distance))),
        "fov_axis": "x",
        "near_clip": 0.1,
        "far_clip": 1e4,
        "to_world": pose,
        # Every sample counts for its own pixel only (box), so that pixels are independent.
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        # Correlated multi-jittered (Kensler 2013): also the choice among the lights is stratified, which removes colour noise.
        "sampler": {"type": "multijitter", "sample_count": path_count(scene)},
    }


def mesh_arrays(membrane: Membrane, scene: Scene | None = None) -> dict[str, np.ndarray]:
    """The membrane as the light sees it, from inside: positions [mm], normals into the gel (-z at rest), uv, faces turned to match.

    With a scene its points are moved sideways, so that `camera_dict`'s pinhole sees each in the pixel of its refracted ray.
    """
    return {
        **moving_arrays(membrane, scene),
        "vertex_texcoords": np.ascontiguousarray(membrane.uv, np.float32),
        "faces": np.ascontiguousarray(membrane.faces[:, ::-1], np.uint32),
    }


def moving_arrays(membrane: Membrane, scene: Scene | None = None) -> dict[str, np.ndarray]:
    """What of `mesh_arrays` changes from frame to frame."""
    positions = membrane.positions if scene is None else apparent_positions(scene, membrane.positions)
    return {
        "vertex_positions": np.ascontiguousarray(positions * MM_PER_M, np.float32),
        "vertex_normals": np.ascontiguousarray(-membrane.normals, np.float32),
    }
