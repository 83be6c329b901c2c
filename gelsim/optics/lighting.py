"""The sensor's coloured emitters. Pure data.

Each light is a rectangle of flux Φ (per colour channel) and of an intensity that falls as cos^m; as Lambertian (m = 1, all that scalar
variants know) its radiance is L = Φ / (π A). It stands inside the window, on the
gel's side of the window's face to the air: no refracting face lies between light and membrane, so every point of the membrane can be
connected to the light directly (next-event estimation). The window's and the gel's indices are close (1.49 and 1.41: 0.08 % reflected at
normal incidence), and a light's place is that of its image seen from the gel. Left out: what the housing
reflects back (docs/optics.md).
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SceneError, within
from gelsim.optics.camera import project
from gelsim.optics.spectra import light_colour
from gelsim.scene.definition import Light, Scene
from gelsim.scene.fields import which
from gelsim.shape.shapes import gel_height


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


def check_lights(scene: Scene) -> None:
    """Raises SceneError: no light at all; one beyond the coat, in the picture's way within the gel, or that lights nothing of the gel."""
    sensor = f"sensor {scene.sensor.preset!r}: " if scene.sensor.preset.endswith(".toml") else ""
    if not scene.lights.lights:
        raise SceneError(f"{sensor}lights.lights is empty; a sensor preset (load_scene) fills it, or give at least one light")
    gel = scene.gel
    half = np.array(gel.size_mm) / 2
    corners = np.array(list(itertools.product((-half[0], half[0]), (-half[1], half[1]), (-gel.thickness_mm, 0.0))))
    for index, light in enumerate(scene.lights.lights):
        with within(f"{sensor}{which(scene.lights.lights, index)}"):
            _check_light(scene, light, corners)


def _check_light(scene: Scene, light: Light, corners: NDArray[np.float64]) -> None:
    gel, half = scene.gel, corners[-1, :2]
    x, y, z = light.position_mm
    where = f"lights.lights.position_mm = {x:g} {y:g} {z:g} mm"
    if abs(x) < half[0] and abs(y) < half[1]:
        coat = float(gel_height(gel, np.array([[x, y]]) * 1e-3)[0] * 1e3)
        if z >= coat:
            raise SceneError(f"{where} is beyond the gel's coat, which is at z = {coat:.3g} mm there; lights stand below it")
        seen = project(scene, np.array([light.position_mm]) * 1e-3)[0]
        if z > -gel.thickness_mm and np.all((seen >= 0) & (seen < scene.render.resolution)):
            raise SceneError(
                f"{where} is inside the gel and in the camera's view; allowed is below z = {-gel.thickness_mm:g} mm, "
                f"or beside camera.field_mm = {scene.camera.field_mm[0]:g} {scene.camera.field_mm[1]:g} mm"
            )
    pose = light_pose(light)
    sources = pose[:3, 3] + [i * pose[:3, 0] + j * pose[:3, 1] for i in (-1, 1) for j in (-1, 1)]
    faces = [(sources, pose[:3, 2])]
    if mirrored_light(scene, light):
        faces.append((sources * [1, 1, -1] + [0, 0, 2 * mirror_height(scene)], pose[:3, 2] * [1, 1, -1]))
    if all(((corners[:, None] - places) @ facing).max() <= 0 for places, facing in faces):
        dx, dy, dz = light.direction
        raise SceneError(
            f"{where} and direction = {dx:g} {dy:g} {dz:g}: it faces away from all of the gel; "
            f"toward the gel's centre would be direction = {0 - x:g} {0 - y:g} {-gel.thickness_mm / 2 - z:g}"
        )


def mirror_height(scene: Scene) -> float:
    """z of the window's outer face [mm], were the window gel: there a light's mirror image is taken."""
    lights = scene.lights
    return -(scene.gel.thickness_mm + lights.window_thickness_mm * lights.gel_ior / lights.window_ior)


def mirrored_light(scene: Scene, light: Light) -> bool:
    """Whether the light is seen in the window's outer face too."""
    return scene.lights.window_reflection and light.position_mm[2] > mirror_height(scene)


def emitter_dict(scene: Scene) -> dict[str, dict]:
    """One rectangle a light, for `scene_dict`.

    Raises:
        SceneError: Of `check_lights`.
    """
    check_lights(scene)
    emitters = {}
    for i, light in enumerate(scene.lights.lights):
        emitters[f"light_{i}"] = {
            "type": "rectangle",
            "to_world": light_pose(light),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": light_radiance(light).tolist()}},
        }
    return emitters
