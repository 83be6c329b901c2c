"""The scene whose pictures are kept, and the renderers that draw it.

The membrane is made up: nodes at fixed places of a disturbed grid, pushed in by a smooth dent beside the middle and dragged along, so that
what is compared is light and the way from nodes to membrane, and no mesh drawn by lot. The camera looks at half the sensor's field, for
markers of 2.6 pixels' radius.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelsim.membrane.surface import Surface
from gelsim.optics import VariantChoice, choose_variant
from gelsim.optics.camera import marker_pixels
from gelsim.optics.render import render_frames
from gelsim.optics.variant import SCALAR
from gelsim.results import Membrane
from gelsim.scene.definition import Render, Scene
from gelsim.scene.layers import build_scene

NODE_SPACING = 0.5e-3
DENT, DENT_WIDTH, DENT_CENTRE = np.array([0.12e-3, -0.06e-3, -0.25e-3]), 0.9e-3, np.array([0.8e-3, -0.5e-3])
"""Displacement in the dent's middle, its standard deviation and place [m]: slopes of 10 degrees, markers dragged by 2 pixels."""
KEPT, NEW = 64, 4
"""Pictures of a reference, and of a comparison."""


@dataclass(frozen=True)
class Shown:
    """A way to draw the scene, for which a reference is kept."""

    mode: str
    window_reflection: bool
    spp: int
    families: tuple[str, ...]
    """Mitsuba's variants that draw the same, by the start of their names."""


SHOWN = {
    "direct": Shown("direct", False, 64, ("llvm", "cuda")),
    "path": Shown("path", True, 256, ("llvm", "cuda")),
    "scalar": Shown("direct", False, 100, ("scalar",)),
}
"""The tracer of gelsim.optics, and Mitsuba's own, which has a reference for itself: instead of refracted rays it has points moved sideways,
which puts 200 pixels at markers' edges and centroids by 0.03 px elsewhere. Its `path` is not kept: now and then it meets a flake that
mirrors a light, 30 levels at once, and such noise is far from normal. `baked` is compared with `path` in tests/oracle/test_baked_light.py.
"""


def shown_scene(shown: Shown) -> Scene:
    """The fingertip sensor, 160 x 120 pixels of half its field."""
    scene = build_scene({"camera": {"field_mm": [9.2, 6.9]}, "render": {"resolution": [160, 120]}})
    return scene.replace(
        render=Render(shown.mode, shown.spp, (160, 120)), lights=replace(scene.lights, window_reflection=shown.window_reflection)
    )


def shown_membrane(scene: Scene) -> Membrane:
    """The gel's surface with the dent, by way of nodes as a press has them."""
    side = np.arange(-12.5e-3, 12.5e-3 + NODE_SPACING / 2, NODE_SPACING)
    nodes = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    nodes[1:-1, 1:-1] += np.random.default_rng(2017).uniform(-0.2, 0.2, nodes[1:-1, 1:-1].shape) * NODE_SPACING
    nodes = nodes.reshape(-1, 2)
    bell = np.exp(-((nodes - DENT_CENTRE) ** 2).sum(axis=1) / (2 * DENT_WIDTH**2))
    (membrane,) = Surface(scene.gel, nodes).states(scene, (bell[:, None] * DENT)[None])
    return membrane


def seeds(lot: int, count: int) -> list[int]:
    """Of the pictures of a lot: 0 is the references', others are new.

    Far apart: means of tiles of two `path` pictures whose seeds differ by 3 have a correlation of 0.29.
    """
    return np.random.default_rng([2017, lot]).integers(2**31, size=count).tolist()


def draw(scene: Scene, seeds: Iterable[int], variant: VariantChoice) -> NDArray[np.uint8]:
    """8-bit pictures of other random numbers each, shape (N, H, W, 3)."""
    membrane = shown_membrane(scene)
    return np.array([next(render_frames(scene.replace(seed=seed), [membrane], variant=variant)).image for seed in seeds])


def marker_places(scene: Scene) -> NDArray[np.float64]:
    """Where markers are in the picture (column, row), shape (K, 2)."""
    places = marker_pixels(scene, shown_membrane(scene))
    return places[np.isfinite(places).all(axis=1)]


def variants() -> dict[str, VariantChoice]:
    """Those that this machine can use, by the start of their names; LLVM first, which must be loaded before another loads the system's."""
    found = (choose_variant("cpu"), choose_variant("auto"), SCALAR)
    return {choice.name.partition("_")[0]: choice for choice in found}
