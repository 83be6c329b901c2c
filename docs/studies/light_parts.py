"""What each part of the light is worth in grey levels: `python docs/studies/light_parts.py [--quick]`.

Each part is switched off (or put in place of what is simpler) and the 8-bit picture compared with the whole one, at rest and on a dent
0.8 mm deep and 1.2 mm wide, without markers, grain and noise. Mean and 99th percentile of the difference over pixels and channels; the
last row is the difference of two seeds, below which nothing is seen.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from gelsim import optics
from gelsim.membrane.surface import moved_membrane
from gelsim.optics.camera import apparent_distance
from gelsim.optics.isp import develop
from gelsim.optics.render import Renderer
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene


def dent(places: np.ndarray) -> np.ndarray:
    """0.8 mm deep, 2 mm off the middle."""
    bell = 0.8e-3 * np.exp(-((places[:, 0] - 2e-3) ** 2 + places[:, 1] ** 2) / (2 * 0.6e-3**2))
    return np.stack([0 * bell, 0 * bell, -bell], axis=1)


def variants(scene: Scene) -> dict[str, Scene]:
    """The scene with one part changed, by the part's name."""
    camera, lights, coating = scene.camera, scene.lights, scene.coating
    pinhole = replace(camera, distance_mm=apparent_distance(scene) * 1e3)
    matt = replace(coating, specular=0.0)
    return {
        "inter-reflection and window": scene.replace(render=replace(scene.render, mode="direct")),
        "window's outer face": scene.replace(lights=replace(lights, window_reflection=False)),
        "flakes (pigment instead)": scene.replace(coating=matt),
        "Lambertian lobe (cos^4 instead)": scene.replace(lights=replace(lights, lights=tuple(replace(x, lobe=4.0) for x in lights.lights))),
        "exact refraction (apparent pinhole)": scene.replace(
            camera=pinhole, lights=replace(lights, window_ior=1.0, gel_ior=1.0, window_reflection=False)
        ),
        "change of Fresnel loss over the field": scene.replace(camera=replace(camera, fresnel=not camera.fresnel)),
    }


def main(quick: bool = False) -> dict[str, dict[str, tuple[float, float]]]:
    """Preset -> part -> (mean, 99th percentile) of the difference on the dent [levels of 255]."""
    variant = optics.choose_variant()
    result: dict[str, dict[str, tuple[float, float]]] = {}
    for preset in ("fingertip2017", "digit"):
        scene = build_scene({"sensor": {"preset": preset}, "camera": {"noise_sd": [0.0] * 3}, "markers": {"layout": "none"}})
        size = (96, 72) if quick else (240, 180)
        scene = scene.replace(coating=replace(scene.coating, grain=0.0), render=replace(scene.render, resolution=size, spp=16))

        def picture(changed: Scene, seed: int = 0) -> np.ndarray:
            # Levels before rounding would hide nothing; with it a difference below half a level is lost, which is the user's view.
            return develop(changed, Renderer(changed, variant).radiance(moved_membrane(changed, dent), seed)).astype(float)

        whole, off = picture(scene), variants(scene)
        # The pinhole's comparison has no window light on either side.
        bare = picture(off["window's outer face"])
        rows = {}
        for part, changed in off.items():
            difference = np.abs(picture(changed) - (bare if "pinhole" in part else whole))
            rows[part] = (float(difference.mean()), float(np.percentile(difference, 99)))
        difference = np.abs(picture(scene, 1) - whole)
        rows["two seeds"] = (float(difference.mean()), float(np.percentile(difference, 99)))
        result[preset] = rows
    return result


if __name__ == "__main__":
    table = main("--quick" in sys.argv)
    print("| part | " + " | ".join(table) + " |")
    print("|---" * (len(table) + 1) + "|")
    for part in next(iter(table.values())):
        print(f"| {part} | " + " | ".join("{:.1f} / {:.1f}".format(*rows[part]) for rows in table.values()) + " |")
