"""A video's pictures one after the other, baked or traced, as render.mode says.

The random numbers are the same for every frame of one scene: a membrane that did not move gives the same pixels bit by bit, and a video
does not flicker.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from gelsim.data.lightfield import LightField
from gelsim.optics import bake
from gelsim.optics.baked import BakedRenderer
from gelsim.optics.camera import marker_pixels
from gelsim.optics.render import Renderer
from gelsim.optics.rest import rest_pictures
from gelsim.optics.variant import VariantChoice, choose_variant
from gelsim.results import Frame, Membrane
from gelsim.scene.definition import Scene


def render_frames(
    scene: Scene,
    membranes: Sequence[Membrane],
    *,
    progress: Callable[[int, int], None] | None = None,
    device: str = "auto",
    variant: VariantChoice | None = None,
    light_field: LightField | None = None,
    renderer: BakedRenderer | Renderer | None = None,
) -> Iterator[Frame]:
    """The sensor's picture of each membrane, one at a time.

    Args:
        scene: Camera, lights, coating, markers, render and seed are used.
        membranes: Of the scene's gel; all with the same faces and uv.
        progress: Called with (frames done, frames in all) after each.
        device: "auto" | "cpu" | "cuda", see `choose_variant`.
        variant: Overrides the choice.
        light_field: The scene's, for mode "baked"; from the cache, or measured first, if not given.
        renderer: The scene's, if it was made before.
    Raises:
        SceneError: A field that cannot be drawn; before the first frame.
        RenderError: The device cannot render.
    """
    chosen = variant or choose_variant(device)
    scene, _ = bake.settle_mode(scene)
    if scene.camera.rest is not None:  # of a smooth rest nothing can be wrong, and its markers take seconds
        rest_pictures(scene)
    if renderer is not None:
        drawer: Any = renderer
    elif scene.render.mode == "baked":
        drawer = BakedRenderer(scene, light_field or bake.light_field(scene, chosen), chosen)
    else:
        drawer = Renderer(scene, chosen)

    def finished(index: int, drawn: Any) -> Frame:
        radiance, image, height = drawer.fetch(drawn)
        frame = Frame(radiance, image, height, marker_pixels(scene, membranes[index]))
        if progress:
            progress(index + 1, len(membranes))
        return frame

    # While the device draws one frame, the next is prepared here.
    waiting: Any = None
    for index, membrane in enumerate(membranes):
        following = drawer.enqueue(membrane, index)
        if index:
            yield finished(index - 1, waiting)
        waiting = following
    if len(membranes):
        yield finished(len(membranes) - 1, waiting)
