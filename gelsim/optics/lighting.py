"""The sensor's coloured emitters. Pure data.

Each light is a rectangle of flux Φ (per colour channel) and of an intensity that falls as cos^m; as Lambertian (m = 1, all that scalar
variants know) its radiance is L = Φ / (π A). It stands inside the window, on the
gel's side of the window's face to the air: no refracting face lies between light and membrane, so every point of the membrane can be
connected to the light directly (next-event estimation). The window's and the gel's indices are close (1.49 and 1.41: 0.08 % reflected at
normal incidence), and a light's place is that of its image seen from the gel. Left out: what the housing
reflects back (docs/optics.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError
from gelsim.optics.spectra import light_colour
from gelsim.scene import Light, Scene


def light_pose(light: Light) -> NDArray[np.float64]:
    """Takes the square [-1, 1]² with normal +z to the light's rectangle [mm], shape (4, 4): its first side lies along the gel."""
    normal = np.array(light.direction, float)
    normal /= np.linalg.norm(normal)
    along = np.cross([0.0, 0.0, 1.0], normal)
    # A light that looks straight up has no side along the gel of its own: x then.
    along = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-9 else np.array([1.0, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, 0] = along * light.size_mm[0] / 2
    pose[:3, 1] = np.cross(normal, along) * light.size_mm[1] / 2
    pose[:3, 2] = normal
    pose[:3, 3] = light.position_mm
    return pose


def light_radiance(light: Light) -> NDArray[np.float64]:
    """Radiance of the light's face [mW / mm² sr], shape (3,)."""
    return light.power * light_colour(light) / (np.pi * light.size_mm[0] * light.size_mm[1])


def emitter_dict(scene: Scene) -> dict[str, dict]:
    """One rectangle a light, for `scene_dict`.

    Raises:
        SceneError: No light at all.
    """
    if not scene.lights.lights:
        raise SceneError("lights.lights is empty; a sensor preset (load_scene) fills it, or give at least one light")
    emitters = {}
    for i, light in enumerate(scene.lights.lights):
        emitters[f"light_{i}"] = {
            "type": "rectangle",
            "to_world": light_pose(light),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": light_radiance(light).tolist()}},
        }
    return emitters
