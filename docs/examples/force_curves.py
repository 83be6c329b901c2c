"""How hard an object pushes back: force against approach for six hardnesses, without any light.

python docs/examples/force_curves.py             # 6 s of processor time; docs/images/gallery_force_curves.png
"""

from __future__ import annotations

from pathlib import Path

import gelsim
from gelsim.scene.layers import build_scene

FIGURE = Path(__file__).parents[1] / "images" / "gallery_force_curves.png"


def main(quick: bool = False, path: Path = FIGURE) -> dict[int | str, float]:
    """Presses hemispheres of several hardnesses, and a rigid one, a millimetre deep; writes the figure.

    Returns:
        Shore 00, or "rigid" -> force at the end [N].
    """
    presses = {}
    for shore in (10, "rigid") if quick else (5, 10, 20, 30, 50, 70, "rigid"):
        hardness = {"rigid": True} if shore == "rigid" else {"shore_00": shore}
        scene = build_scene(
            {
                "object": {"shape": "hemisphere", "radius_mm": 6.0} | hardness,
                "press": {"depth_mm": 1.0, "frames": 3 if quick else 9},
                "fidelity": "fast",
            }
        )
        presses[shore] = gelsim.press(scene)
    draw(path, presses)
    return {shore: float(-press.force[-1, 2]) for shore, press in presses.items()}


def draw(path: Path, presses: dict[int | str, gelsim.Deformation]) -> None:
    """A curve a press."""
    import matplotlib
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), dpi=90, layout="constrained")
    axes = figure.add_subplot(xlabel="approach [mm]", ylabel="normal force [N]", title="A ball of 6 mm into a gel of Shore 00-17")
    for number, (shore, press) in enumerate(presses.items()):
        colour = matplotlib.colormaps["viridis"](0.9 * number / (len(presses) - 1))
        label = "rigid" if shore == "rigid" else f"00-{shore}"
        axes.plot(1e3 * press.approach, -press.force[:, 2], "o-", markersize=3, color=colour, label=label)
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(path)


if __name__ == "__main__":
    print(main())
