"""One ball, four sensors.

python docs/examples/sensors.py                  # 17 s of processor time; docs/images/gallery_sensors.jpg
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import gelsim
from gelsim.scene.layers import build_scene, preset_names

FIGURE = Path(__file__).parents[1] / "images" / "gallery_sensors.jpg"


def main(quick: bool = False, path: Path = FIGURE) -> dict[str, float]:
    """The same press of a rigid ball into each sensor that comes along; writes the figure.

    Returns:
        Sensor -> force [N].
    """
    pictures, forces = {}, {}
    for name in preset_names()[:1] if quick else preset_names():
        scene = build_scene(
            {
                "sensor": {"preset": name},
                "object": {"shape": "hemisphere", "radius_mm": 3.0, "height_mm": 15.0, "rigid": True},
                "press": {"depth_mm": 0.5, "frames": 2},
                "render": {"resolution": [80, 60] if quick else [400, 300], "spp": 1 if quick else 16},
                "fidelity": "fast",
            }
        )
        press, frames = gelsim.simulate(scene)
        pictures[name], forces[name] = frames[-1].image, float(-press.force[-1, 2])
    draw(path, pictures)
    return forces


def draw(path: Path, pictures: dict[str, np.ndarray]) -> None:
    """A panel a sensor."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 2.7), dpi=90, layout="constrained")
    for panel, (name, picture) in zip(figure.subplots(1, len(pictures), squeeze=False)[0], pictures.items(), strict=True):
        panel.imshow(picture)
        panel.set(title=name, xticks=[], yticks=[])
    figure.savefig(path, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    print(main())
