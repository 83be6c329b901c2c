"""The same press with objects of four hardnesses: a Shore value seen through the sensor, and the README's figure of it.

    python docs/examples/shore_series.py                  # four hardnesses: a minute and a half; docs/images/shore_series.png
    python docs/examples/shore_series.py --quick          # two hardnesses, coarse: 20 s; nothing is written

A hemisphere is pressed to the same approach, then to the same force. At equal approach a softer object gives way itself and leaves a
shallower, weaker mark; at equal force it has flattened more, so its mark is wider and its rim less bright.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelsim.pipeline import stages
from gelsim.results import Deformation, Frame
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene
from gelsim.units import MM

FIGURE = Path(__file__).parents[1] / "images" / "shore_series.png"
RADIUS_MM = 8.0
DEPTH_MM = 1.2
FORCE_N = 1.5
FURTHEST_MM = {10: 6.5, 30: 4.0, 50: 2.5, 70: 1.8}
"""Approach by which FORCE_N is surely reached; the press ends at the force."""


@dataclass(frozen=True)
class Pressed:
    """A press and the picture of its last state."""

    scene: Scene
    press: Deformation
    frame: Frame

    @property
    def numbers(self) -> dict[str, float]:
        """What the press came to."""
        return {
            "approach_mm": float(self.press.approach[-1] / MM),
            "force_n": float(-self.press.force[-1, 2]),
            "contact_area_mm2": float(self.press.contact_area[-1] / MM**2),
        }


def main(quick: bool = False) -> dict[str, dict[int, dict[str, float]]]:
    """Presses and draws the series; writes the figure unless `quick`.

    Returns:
        "equal approach" and "equal force" -> Shore 00 -> approach [mm], force [N], contact area [mm²].
    """
    series: dict[str, dict[int, Pressed]] = {"equal approach": {}, "equal force": {}}
    for shore in (10, 70) if quick else (10, 30, 50, 70):
        if quick:
            ends = {"depth_mm": 0.5, "force_n": "none", "frames": 2}, {"depth_mm": 1.5, "force_n": 0.15, "frames": 4}
        else:
            ends = (
                {"depth_mm": DEPTH_MM, "force_n": "none", "frames": 5},
                {"depth_mm": FURTHEST_MM[shore], "force_n": FORCE_N, "frames": 11},
            )
        for kind, end in zip(series, ends, strict=True):
            series[kind][shore] = run(shore, end, quick)
    if not quick:
        draw(FIGURE, series)
    return {kind: {shore: pressed.numbers for shore, pressed in row.items()} for kind, row in series.items()}


def run(shore: int, end: dict[str, Any], quick: bool) -> Pressed:
    """One press, and the picture of its end."""
    from gelsim import optics

    scene = build_scene(
        {
            "object": {"shape": "hemisphere", "radius_mm": RADIUS_MM, "shore_00": shore},
            "press": end,
            "render": {"spp": 4, "resolution": [96, 72]} if quick else {"spp": 64},
            "fidelity": "fast" if quick else "balanced",
        }
    )
    press = stages.press(scene)
    (frame,) = optics.render_frames(scene, stages.membranes(scene, press)[-1:])
    pressed = Pressed(scene, press, frame)
    print(f"Shore 00-{shore}:", ", ".join(f"{name} {value:.3g}" for name, value in pressed.numbers.items()), flush=True)
    return pressed


def draw(path: Path, series: dict[str, dict[int, Pressed]]) -> None:
    """Pictures at equal approach, pictures at equal force, and the sections of the latter."""
    from matplotlib.figure import Figure

    from gelsim.pipeline.sheet import INK, draw_section

    equal_force = series["equal force"]
    gel = next(iter(equal_force.values())).scene.gel
    width, left, top, gap, picture, between = 11.6, 0.75, 0.85, 0.08, 2.65, 0.35  # inches
    high = picture * 0.75
    # The section shows less height than a picture.
    lowest, highest = -gel.thickness_mm - 1.0, 2.6
    view = 0.26 * gel.size_mm[0]
    section = picture * (highest - lowest) / (2 * view)
    height = top + 2 * high + section + 2 * between + 0.5
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white")
    title = f"One hemisphere (R {RADIUS_MM:g} mm) in four hardnesses, pressed into a gel of Shore 00-{gel.shore_00:g}"
    figure.text(0.5, 1 - 0.12 / height, title, ha="center", va="top", fontsize=14, color=INK)

    def place(column: int, row: int, tall: float) -> Any:
        lower = height - top - row * (high + between) - tall
        return figure.add_axes(((left + column * (picture + gap)) / width, lower / height, picture / width, tall / height))

    def label(row: int, tall: float, text: str) -> None:
        middle = height - top - row * (high + between) - tall / 2
        figure.text(0.22 / width, middle / height, text, rotation=90, ha="center", va="center", fontsize=11, color=INK)

    rows = {f"equal approach, {DEPTH_MM:g} mm": series["equal approach"], f"equal force, {FORCE_N:g} N": equal_force}
    for row, (name, line) in enumerate(rows.items()):
        for column, (shore, pressed) in enumerate(line.items()):
            axes = place(column, row, high)
            axes.imshow(pressed.frame.image, aspect="auto", interpolation="antialiased")
            axes.set_axis_off()
            n = pressed.numbers
            said = f"{n['force_n']:.2f} N" if row == 0 else f"{n['approach_mm']:.2f} mm"
            axes.set_title(f"{said},  {n['contact_area_mm2']:.0f} mm²", fontsize=10, color=INK, pad=4)
            if row == 0:
                middle = (left + column * (picture + gap) + picture / 2) / width
                figure.text(middle, 1 - 0.42 / height, f"Shore 00-{shore}", ha="center", va="top", fontsize=12, weight="bold", color=INK)
        label(row, high, name)
    for column, pressed in enumerate(equal_force.values()):
        axes = place(column, 2, section)
        draw_section(axes, pressed.scene, pressed.press)
        axes.set_ylim(lowest, highest)
        axes.set_title("")
        axes.tick_params(labelsize=8, labelleft=column == 0)
        if column:
            axes.set_ylabel("")
    label(2, section, "section")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png")
    write_small(path, path)


def write_small(source: Path, target: Path) -> None:
    """The picture in 64 steps a channel: half the size, as the lowest bits are noise that does not compress, and looks the same."""
    import numpy as np
    from PIL import Image

    with Image.open(source) as picture:
        levels = np.asarray(picture.convert("RGB")).astype(int)
    coarse = np.where(levels == 255, 255, np.minimum((levels + 2) // 4 * 4, 255))
    Image.fromarray(coarse.astype(np.uint8)).save(target, optimize=True)


if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
