"""A gel that gives in: force while the object is pressed, and while it then stays where it is.

python docs/examples/relaxation.py               # 8 s of processor time; docs/images/gallery_relaxation.png
"""

from __future__ import annotations

from pathlib import Path

import gelsim
from gelsim.scene.layers import build_scene

FIGURE = Path(__file__).parents[1] / "images" / "gallery_relaxation.png"
SHARE, TIME = 0.4, 0.5
"""Of the gel's shear modulus that relaxes, and the time in which it does [s]."""


def main(quick: bool = False, path: Path = FIGURE) -> dict[float, tuple[float, float]]:
    """The same press, 0.5 mm deep, at several speeds, then held for two seconds; writes the figure.

    Returns:
        Speed [mm/s] -> force at the end of the press and after the hold [N].
    """
    presses = {}
    for speed in (0.2, 20.0) if quick else (0.2, 1.0, 5.0, 20.0):
        scene = build_scene(
            {
                "gel": {"prony_g": [SHARE], "prony_tau_s": [TIME]},
                "object": {"shape": "hemisphere", "radius_mm": 4.0, "height_mm": 15.0, "rigid": True},
                "press": {"depth_mm": 0.5, "frames": 6, "speed_mm_s": speed, "hold_s": 2.0},
                "fidelity": "fast",
            }
        )
        presses[speed] = gelsim.press(scene)
    draw(path, presses)
    return {speed: (float(-press.force[-2, 2]), float(-press.force[-1, 2])) for speed, press in presses.items()}


def draw(path: Path, presses: dict[float, gelsim.Deformation]) -> None:
    """Force against approach; the drop at the end is the hold."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), dpi=90, layout="constrained")
    title = f"{100 * SHARE:.0f} % of the gel's shear modulus relax in {TIME:g} s; held for 2 s"
    axes = figure.add_subplot(xlabel="approach [mm]", ylabel="normal force [N]", title=title)
    for speed, press in presses.items():
        axes.plot(1e3 * press.approach, -press.force[:, 2], "o-", markersize=3, label=f"{speed:g} mm/s")
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(path)


if __name__ == "__main__":
    print(main())
