"""A ball that is pressed, dragged and turned: which way every marker goes.

python docs/examples/shear_markers.py            # 12 s of processor time; docs/images/gallery_shear_markers.jpg
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import gelsim
from gelsim.scene.layers import build_scene

FIGURE = Path(__file__).parents[1] / "images" / "gallery_shear_markers.jpg"
MOTIONS = {
    "pressed": {},
    "pressed and dragged 0.5 mm": {"shear_mm": [0.5, 0.0]},
    "pressed and turned 15°": {"twist_deg": 15.0},
}


def main(quick: bool = False, path: Path = FIGURE) -> dict[str, tuple[float, float]]:
    """Three presses of a rigid ball with different motions; writes their pictures with the markers' ways, four times as long.

    Returns:
        Motion -> mean way of the markers in x and in y [px].
    """
    pictures, ways = {}, {}
    for name, motion in list(MOTIONS.items())[:2] if quick else MOTIONS.items():
        scene = build_scene(
            {
                "gel": {"profile": "flat"},
                "object": {"shape": "hemisphere", "radius_mm": 4.0, "height_mm": 15.0, "rigid": True},
                "press": {"depth_mm": 0.6, "frames": 2} | motion,
                "render": {"resolution": [80, 60] if quick else [480, 360], "spp": 1 if quick else 16},
                "fidelity": "fast",
            }
        )
        _, frames = gelsim.simulate(scene)
        pictures[name] = frames[-1].image
        ways[name] = frames[0].marker_pixels, frames[-1].marker_pixels - frames[0].marker_pixels
    draw(path, pictures, ways)
    return {name: tuple(np.nanmean(way, axis=0)) for name, (_, way) in ways.items()}


def draw(path: Path, pictures: dict[str, np.ndarray], ways: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """A panel a motion."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 3), dpi=90, layout="constrained")
    for panel, (name, picture) in zip(figure.subplots(1, len(pictures)), pictures.items(), strict=True):
        start, way = ways[name]
        panel.imshow(picture)
        panel.quiver(*start.T, *way.T, color="yellow", angles="xy", scale_units="xy", scale=0.25, width=0.005)
        panel.set(title=name, xticks=[], yticks=[], xlim=(0, picture.shape[1]), ylim=(picture.shape[0], 0))
    figure.savefig(path, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    print(main())
