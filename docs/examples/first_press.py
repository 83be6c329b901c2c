"""A soft ball pressed into a GelSight, from a scene to a picture.

python docs/examples/first_press.py              # 9 s of processor time; docs/images/gallery_first_press.jpg
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import gelsim
from gelsim.scene.layers import build_scene

FIGURE = Path(__file__).parents[1] / "images" / "gallery_first_press.jpg"


def main(quick: bool = False, path: Path = FIGURE) -> dict[str, float]:
    """Presses, draws, writes the figure: picture, change since first touch, height.

    Returns:
        force_n, dent_mm.
    """
    scene = build_scene(
        {
            "object": {"shape": "hemisphere", "radius_mm": 6.0, "shore_00": 30},
            "press": {"depth_mm": 1.0, "frames": 2 if quick else 4},
            "render": {"resolution": [80, 60] if quick else [480, 360], "spp": 1 if quick else 16},
            "fidelity": "fast",
        }
    )
    press, frames = gelsim.simulate(scene)
    change = frames[-1].image.astype(float) - frames[0].image
    dent = 1e3 * (frames[0].height - frames[-1].height)
    draw(path, frames[-1].image, np.clip(128 + 2 * change, 0, 255).astype(np.uint8), dent)
    return {"force_n": float(-press.force[-1, 2]), "dent_mm": float(np.nanmax(dent))}


def draw(path: Path, picture: np.ndarray, change: np.ndarray, dent: np.ndarray) -> None:
    """Three panels side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 3), dpi=90, layout="constrained")
    panels = figure.subplots(1, 3)
    for panel, image, title in zip(
        panels, (picture, change, dent), ("picture", "change since first touch, twice", "dent [mm]"), strict=True
    ):
        shown = panel.imshow(image)
        panel.set(title=title, xticks=[], yticks=[])
    figure.colorbar(shown, ax=panels[-1])
    figure.savefig(path, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    print(main())
