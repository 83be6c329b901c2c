"""A ball that is pressed, dragged until it slides, and let go: where every dot goes, and where the gel sticks to the ball.

python docs/examples/slide_and_release.py        # a minute and a half of processor time; docs/images/gallery_slide.jpg
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import gelsim
from gelsim.results import Deformation, Frame

FIGURE = Path(__file__).parents[1] / "images" / "gallery_slide.jpg"
SCENE = Path(__file__).parents[2] / "scenes" / "slide_and_release.toml"
SHOWN_S = {"pressed": 0.8, "sticks": 1.0, "slips from the rim": 1.2, "slides": 2.0, "let go": 3.0}
"""When each state that is shown is reached [s]."""
SLIPPED = 0.01e-3
"""Way over the ball [m] from which on a place counts as sliding."""


def main(quick: bool = False, path: Path = FIGURE) -> dict[str, float]:
    """The shipped scene; draws the dots' ways, four times as long, and below them how far the gel lags behind the ball.

    Returns:
        State -> share of the contact that has slid since the ball was dragged.
    """
    scene = gelsim.load_scene(SCENE)
    if quick:
        small = replace(scene.render, resolution=(80, 60), spp=1)
        scene = scene.replace(fidelity="fast", press=replace(scene.press, frames=16), render=small)
    press, frames = gelsim.simulate(scene)
    states = {name: int(np.abs(press.time - moment).argmin()) for name, moment in SHOWN_S.items()}
    lags = {name: lag(press, states["pressed"], state) for name, state in states.items()}
    draw(path, press, frames, states, lags)
    return {name: float(np.mean(way > SLIPPED)) if len(way) else 0.0 for name, (_, way) in lags.items()}


def lag(press: Deformation, since: int, state: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the gel that touch, and how far the ball has gone over each since a state [m]."""
    touching = np.flatnonzero(press.contact_pressure[state] > 0.02 * press.contact_pressure[state].max())
    ball = press.object.displacement[state, 0] - press.object.displacement[since, 0]
    gel = press.gel.displacement[state, touching] - press.gel.displacement[since, touching]
    return touching, np.linalg.norm((ball - gel)[:, :2], axis=1)


def draw(
    path: Path, press: Deformation, frames: list[Frame], states: dict[str, int], lags: dict[str, tuple[np.ndarray, np.ndarray]]
) -> None:
    """A column a state."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.6), dpi=90, layout="constrained")
    axes, dots = figure.subplots(2, len(states)), []
    for (name, state), top, below in zip(states.items(), *axes, strict=True):
        start, now = frames[0].marker_pixels, frames[state].marker_pixels
        top.imshow(frames[state].image)
        top.quiver(*start.T, *(now - start).T, color="yellow", angles="xy", scale_units="xy", scale=0.25, width=0.006)
        rows, columns = frames[0].image.shape[:2]
        top.set(title=f"{press.time[state]:g} s: {name}", xticks=[], yticks=[], xlim=(0, columns), ylim=(rows, 0))
        touching, way = lags[name]
        place = 1e3 * (press.gel.rest + press.gel.displacement[state])[touching]
        dots.append(below.scatter(*place.T[:2], c=np.minimum(1e3 * way, 0.3), cmap="inferno", vmin=0.0, vmax=0.3, s=14))
        below.set(xlim=(-4, 6), ylim=(4, -4), aspect="equal", xlabel="x [mm]")
        tangential, normal = np.hypot(*press.force[state, :2]), -press.force[state, 2]
        below.set_title(f"{normal:.2f} N down, {tangential:.2f} N aside" if normal > 0 else "no contact", fontsize=9)
    axes[1, 0].set_ylabel("y [mm]")
    figure.colorbar(dots[-1], ax=axes[1], label="ball over gel [mm]")
    figure.savefig(path, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    print(main())
