"""A membrane's picture from its sensor's measured light field (`gelsim.data.lightfield`): milliseconds in place of seconds.

    L_c = g [ Σ_k V_k a_k(x, y, z, n) C_kc + γ_c E_c / π + veil_c(x, y) ],      g = grain (1 - m) + paint(n) m,

in five steps, each over all pixels of a batch of frames at once:

1. *What a pixel sees.* Its ray is straight inside the gel, (x, y) = α + β z. The membrane's grid of material points is solved for the one
   on the ray by Newton's method on the bilinear patches: first at every few pixels, then one more step for each.
2. *Shadows*, V: the visible share of each light, a rectangle cut along its long side. About each piece's middle the heights are laid out in
   polar coordinates; the running minimum along a line, of z - z_light over the distance, is the horizon (Max 1988: horizon maps). The share
   of the piece's height above the horizon is weighed by the cosine at the receiver, and what the tangent plane cuts off is already in a_k.
3. *Inter-reflection*, E: one bounce, from the horizon's silhouettes in 8 directions at 0.2 mm (Max 1986; as Jimenez et al. 2016 use them);
   the surface reflects as a Lambertian one, and γ, fitted once a sensor, stands for the coat's reflectance and for further bounces.
4. *Coat and markers*: grain g and coverage m looked up in material coordinates, averaged over a pixel beforehand.
5. *The image pipeline* of `optics.isp`, in the same kernel.

Left out: lobes of the coat in inter-reflection, folds that the camera sees behind one another (the pixel takes one of the layers),
change of a texture's blur by stretch, and shadows of a light right behind the membrane's own plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.data.lightfield import PACKET, LightField
from gelsim.errors import RenderError
from gelsim.membrane.surface import unmoved
from gelsim.optics.arrays import Arrays, Values, aligned_room, choose_arrays
from gelsim.optics.baked_kernels import DIRECTIONS, LINES, PIECES, STEPS, Layout, coarse_size, draw
from gelsim.optics.camera import gel_ray, make_lens, pixel_size, project
from gelsim.optics.coating import TEXEL, grain_pattern, marker_coverage
from gelsim.optics.isp import Pipeline, as_picture, camera_pipeline, frame_keys, rest_on
from gelsim.optics.lighting import light_pose
from gelsim.optics.variant import VariantChoice
from gelsim.results import Membrane
from gelsim.scene.definition import Scene
from gelsim.units import MM_PER_M

CELL = 0.2
"""Of the grid over the gel for inter-reflection [mm]."""
FINE_CELL = 0.1
"""Of the grid of heights that cast shadows [mm]: cells of 0.2 cut a straight edge's top, and its shadow by 0.1 mm; 39 dB, now 43."""
SHADE_PIXELS, SHADE_MM = 3, 0.12
"""Between places with a shadow value of their own: 4 pixels at 640 × 480, which costs the worst surface 0.2 of 42 dB (6 pixels: 0.8)."""
LIT_MM = 0.06
"""Between places with a light of their own, at most, where pixels are finer: 2 pixels at 640 × 480 differ from one by 64 dB, 3 by 61."""
TEXELS_A_PIXEL = 3.0
"""Of grain and markers; at 320 × 240 a marker's edge was 18 levels off (99.9 % of the pixels) with 1.5, 10 with 4."""


class BakedRenderer:
    """A scene's light field, camera and coat, made ready once to draw many membranes."""

    def __init__(
        self,
        scene: Scene,
        light_field: LightField,
        variant: VariantChoice,
        *,
        shadows: bool = True,
        indirect: bool = True,
        cell: float = CELL,
        like: BakedRenderer | None = None,
    ) -> None:
        """Of `variant` the backend is taken; without `shadows` or `indirect` those are left out; `cell` [mm] is that of inter-reflection.

        `like`: Of a scene that differs in the powers and colours of its lights, markers, grain and what comes after the light alone, with
        the same table of light: what it has made ready is used again.
        """
        self._scene, self._field = scene, light_field
        self._like = like
        self._shadows, self._indirect, self._cell = shadows, indirect, cell
        self._arrays: Arrays = choose_arrays(variant)
        self._tables: dict[str, Any] = {}
        self._layout: Layout | None = None
        self._draw: Any = None

    def radiance(self, membrane: Membrane) -> NDArray[np.float32]:
        """Linear RGB, shape (H, W, 3)."""
        return self.picture(membrane)[0]

    def picture(self, membrane: Membrane) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Linear RGB (H, W, 3), and z of the membrane at the pixels' centres [m] (H, W): NaN where the camera sees no gel."""
        return self.pictures([membrane])[0]

    def pictures(self, membranes: Sequence[Membrane]) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """`picture` of many membranes at once."""
        return [(radiance, height) for radiance, _, height in self._fetched(self.launch(self.upload(membranes)))]

    def frames(self, membranes: Sequence[Membrane], first: int = 0) -> list[tuple[NDArray[np.float32], Any, NDArray[np.float32]]]:
        """Of a press's frames from number `first` on: linear RGB and the picture of `isp.develop`, (H, W, 3), and z [m], (H, W)."""
        return self._fetched(self._started(membranes, first))

    def enqueue(self, membrane: Membrane, index: int = 0) -> tuple[Values, Values | None]:
        """Starts drawing frame `index`, for `fetch`, and does not wait."""
        return self._started([membrane], index)

    def fetch(self, drawn: tuple[Values, Values | None]) -> tuple[NDArray[np.float32], Any, NDArray[np.float32]]:
        """What `frames` gives of a frame that was started."""
        return self._fetched(drawn)[0]

    def _started(self, membranes: Sequence[Membrane], first: int) -> tuple[Values, Values | None]:
        uploaded = self.upload(membranes)
        return self.launch(uploaded, self._arrays.words(frame_keys(self._scene, list(range(first, first + len(membranes))))))

    def _fetched(self, drawn: tuple[Values, Values | None]) -> list[tuple[NDArray[np.float32], Any, NDArray[np.float32]]]:
        width, height = self._scene.render.resolution
        pixels = self._arrays.numpy(drawn[0]).reshape(-1, height, width, 4)
        images = [None] * len(pixels) if drawn[1] is None else as_picture(self._arrays.numpy(drawn[1]), pixels.shape[:3])
        return [(picture[..., :3], image, picture[..., 3]) for picture, image in zip(pixels, images, strict=True)]

    def upload(self, membranes: Sequence[Membrane]) -> tuple[Values, Values]:
        """Vertices and normals of membranes on the device, for `launch`."""
        if self._layout is None:
            self._prepare(membranes[0])
        assert self._layout is not None
        return surface_arrays(self._arrays, membranes)

    def launch(self, uploaded: tuple[Values, Values], keys: Values | None = None) -> tuple[Values, Values | None]:
        """Red, green, blue and z [m] of every pixel of every frame, one after the other, on the device; with `keys` 8-bit pictures too."""
        return self._draw(self._tables, *uploaded, keys)

    # ---- once a scene ----

    def _prepare(self, membrane: Membrane) -> None:
        light_field, put, like = self._field, self._arrays.floats, self._like
        own: dict[str, Any] = {name: put(getattr(light_field, name)) for name in ("paint", "veil")}
        own |= {name: self._arrays.numbers(getattr(light_field, name)) for name in ("colours", "gains")}
        texture, texels = coat_texture(self._scene)
        own["texture"] = put(texture)
        pipeline, camera_tables = camera_pipeline(self._scene, self._arrays)
        own |= camera_tables
        if like is not None and like._layout is not None and like._field.table is light_field.table:
            self._tables = like._tables | own
            self._layout = replace(like._layout, texels=texels, marked=self._scene.markers.layout != "none", pipeline=pipeline)
            self._draw = like._draw if self._layout == like._layout else self._compiled()
        else:
            self._prepare_sensor(material_grid(membrane), texels, pipeline)
            self._tables |= own
            self._draw = self._compiled()
        self._like = None
        if self._scene.camera.has_rest:
            width, height = self._scene.render.resolution
            rest = unmoved(self._scene, membrane)
            still = self._arrays.numpy(self.launch(self.upload([rest]))[0]).reshape(height, width, 4)[..., :3]
            self._tables |= rest_on(self._scene, self._arrays, still)
            self._tables["rest_nodes"] = put(project(self._scene, rest.positions))

    def _compiled(self) -> Any:
        arrays, layout = self._arrays, self._layout
        assert layout is not None

        def drawn(tables: dict[str, Any], places: Values, normals: Values, keys: Values | None) -> tuple[Values, Values | None]:
            return draw(arrays, layout, tables, places, normals, keys)

        return arrays.compiled(drawn)

    def _prepare_sensor(self, grid: tuple[int, int], texels: tuple[int, int], pipeline: Pipeline) -> None:
        """What camera, gel, places of the lights and the field's table make."""
        scene, light_field, put = self._scene, self._field, self._arrays.floats
        columns, rows = grid
        width, height = scene.render.resolution
        shade = max(SHADE_PIXELS, round(SHADE_MM / (pixel_size(scene) * MM_PER_M)))
        lit = max(1, int(LIT_MM / (pixel_size(scene) * MM_PER_M)))
        size = np.array(scene.gel.size_mm)
        cells, fine = ((int(np.ceil(size[0] / cell)) + 1, int(np.ceil(size[1] / cell)) + 1) for cell in (self._cell, FINE_CELL))
        self._tables = {"field": put(_packed(light_field.table))}
        for name, step in {"full": 1, "lit": lit, "coarse": shade}.items():
            across, down = coarse_size(width, height, step)
            column, row = np.meshgrid((np.arange(across) + 0.5) * step, (np.arange(down) + 0.5) * step)
            self._tables[name] = put(straight_rays(scene, column.ravel(), row.ravel()))
        for name, (across, down) in {"plumb": cells, "fine": fine}.items():
            x, y = np.meshgrid(np.linspace(-size[0] / 2, size[0] / 2, across), np.linspace(-size[1] / 2, size[1] / 2, down))
            self._tables[name] = put(np.stack([x, y, 0 * x, 0 * x], axis=-1))
        angles = (np.arange(DIRECTIONS) + 0.5) * 2 * np.pi / DIRECTIONS
        self._tables["directions"] = put(np.stack([np.cos(angles), np.sin(angles)], axis=1))
        pieces = light_pieces(scene) if self._shadows else np.zeros((0, 12))
        if len(pieces):
            self._tables["polar"] = put(_polar_places(pieces, size, fine))
            self._tables["pieces"] = put(pieces)
        self._layout = Layout(
            width,
            height,
            shade,
            lit,
            columns,
            rows,
            cells,
            viewed_cells(scene, cells),
            fine,
            size.tolist(),
            len(pieces),
            self._indirect,
            texels,
            scene.markers.layout != "none",
            light_field.table.shape,
            light_field.places.tolist(),
            light_field.heights.tolist(),
            light_field.normals,
            light_field.light_of.tolist(),
            pipeline,
        )


def surface_arrays(arrays: Arrays, membranes: Sequence[Membrane]) -> tuple[Values, Values]:
    """Places [mm] and normals of membranes' vertices on the backend, in fours and in pairs."""
    nodes = len(membranes[0].positions)
    places = aligned_room(len(membranes) * nodes * 4).reshape(-1, nodes, 4)
    normals = aligned_room(len(membranes) * nodes * 2).reshape(-1, nodes, 2)
    places[..., 3] = 0.0
    for n, membrane in enumerate(membranes):
        # By column: NumPy is slow at three numbers at a time.
        for axis in range(3):
            np.multiply(membrane.positions[:, axis], MM_PER_M, out=places[n, :, axis], casting="unsafe")
        for axis in range(2):
            normals[n, :, axis] = membrane.normals[:, axis]
    return arrays.floats(places), arrays.floats(normals)


def material_grid(membrane: Membrane) -> tuple[int, int]:
    """Columns and rows of a membrane whose vertices are a regular grid of material points, row by row."""
    u, v = membrane.uv[:, 0], membrane.uv[:, 1]
    columns = int(np.argmax(v != v[0])) or len(v)
    rows = len(v) // columns
    regular = columns * rows == len(v) and np.ptp(u.reshape(rows, columns), axis=0).max() < 1e-9
    if not regular or min(rows, columns) < 2:
        raise RenderError('render.mode = "baked" draws membranes on a regular material grid only; use "path"')
    return columns, rows


def _packed(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """The table as the kernel loads it: by node and four components, their values on the first layer and the way to the second."""
    fours = table.reshape(*table.shape[:5], -1, PACKET)
    return np.stack([fours[0], fours[1] - fours[0]], axis=-2)


def straight_rays(scene: Scene, column: NDArray[np.floating], row: NDArray[np.floating]) -> NDArray[np.float64]:
    """The camera's rays inside the gel: (x, y) = α + β z.

    Args:
        column, row: In the picture [px], shape (N,).
    Returns:
        α_x, α_y [mm], β_x, β_y, shape (N, 4).
    """
    origin, direction, _ = gel_ray(make_lens(scene), column, row)
    slope = [direction[axis] / direction[2] for axis in (0, 1)]
    foot = [(origin[axis] - slope[axis] * origin[2]) * MM_PER_M for axis in (0, 1)]
    return np.stack(np.broadcast_arrays(*foot, *slope), axis=-1)


def viewed_cells(scene: Scene, cells: tuple[int, int]) -> tuple[int, int, int, int]:
    """First column and row, columns and rows of the cells over the gel that hold all the camera's rays meet in it."""
    width, height = scene.render.resolution
    rim_column, rim_row = np.meshgrid(np.linspace(0, width, 9), np.linspace(0, height, 9))
    rays = straight_rays(scene, rim_column.ravel(), rim_row.ravel())
    met = np.concatenate([rays[:, :2] + rays[:, 2:] * z for z in (0.0, -scene.gel.thickness_mm)])
    places = (met / scene.gel.size_mm + 0.5) * (np.array(cells) - 1)
    first = np.clip(np.floor(places.min(axis=0)).astype(int) - 1, 0, np.array(cells) - 2)
    last = np.clip(np.ceil(places.max(axis=0)).astype(int) + 1, first + 1, np.array(cells) - 1)
    return int(first[0]), int(first[1]), *(int(count) for count in last - first + 1)  # type: ignore[return-value]


def coat_texture(scene: Scene) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Grain (1 - m) and coverage m by texel, averaged over a pixel's square: (rows, columns, 2), and (columns, rows).

    One texel, and (0, 0), where the coat is the same everywhere.
    """
    if scene.camera.has_rest or (scene.markers.layout == "none" and scene.coating.grain == 0):
        return np.array([[[1.0, 0.0]]], np.float32), (0, 0)
    coverage, grain = marker_coverage(scene), grain_pattern(scene)
    for axis in (0, 1):
        if grain.size > 1:
            grain = _along(axis, _linear_sampling(grain.shape[axis], coverage.shape[axis]), grain)
    pixel = pixel_size(scene) / TEXEL
    step = max(pixel / TEXELS_A_PIXEL, 1.0)
    # Reading between texels blurs too, with a variance of up to step²/6: the box and that together have a pixel's, pixel²/12.
    box = np.sqrt(max(pixel**2 - 2 * step**2, (pixel / 4) ** 2))
    layers = []
    for layer in (grain * (1 - coverage), coverage):
        for axis in (0, 1):
            layer = _along(axis, _box_means(layer.shape[axis], box, step), layer)
        layers.append(layer)
    texture = np.stack(layers, axis=-1)
    return texture, (texture.shape[1], texture.shape[0])


def _along(axis: int, operator: Any, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """A sparse operator applied along an axis of a table."""
    return operator @ values if axis == 0 else np.ascontiguousarray((operator @ np.ascontiguousarray(values.T)).T)


def _linear_sampling(before: int, after: int) -> Any:
    """From `before` texels of a side to `after`, linear between their middles: a sparse operator."""
    from scipy.sparse import csr_array

    at = np.clip((np.arange(after) + 0.5) / after * before - 0.5, 0, before - 1)
    first = np.minimum(at.astype(int), before - 2)
    share = (at - first).astype(np.float32)
    index, rows = np.stack([first, first + 1], axis=1), np.arange(0, 2 * after + 1, 2)
    return csr_array((np.stack([1 - share, share], axis=1).ravel(), index.ravel(), rows), shape=(after, before))


def _box_means(count: int, box: float, step: float) -> Any:
    """Means over intervals of `box` texels about every `step`-th place of `count`: a sparse operator, exact for texels of one value."""
    from scipy.sparse import csr_array

    fewer = int(np.ceil(count / step))
    centres = (np.arange(fewer) + 0.5) * count / fewer
    low, high = np.clip(centres - box / 2, 0, count)[:, None], np.clip(centres + box / 2, 0, count)[:, None]
    texel = low.astype(int) + np.arange(int(np.ceil(box)) + 1)
    within = np.clip(np.minimum(high, texel + 1) - np.maximum(low, texel), 0, None) / (high - low)
    parts = within.astype(np.float32).ravel(), np.minimum(texel, count - 1).ravel(), np.arange(fewer + 1) * texel.shape[1]
    return csr_array(parts, shape=(fewer, count))


def light_pieces(scene: Scene) -> NDArray[np.float64]:
    """What shadows need of the lights, PIECES rows a light.

    Columns: x, y, z of the piece's middle [mm]; half its height, as seen along the ray to the gel's centre; cosine and sine of the
    direction to there; first angle and the inverse of its step; first distance and the inverse of its step; two zeros.
    """
    half = np.array(scene.gel.size_mm) / 2
    corners = np.array([[i, j] for i in (-1, 1) for j in (-1, 1)]) * half
    rows = []
    for light in scene.lights.lights:
        pose = light_pose(light)
        # The side that lies more along the gel's sight of the light is cut; the other is the piece's height.
        for share in (np.arange(PIECES) + 0.5) / PIECES * 2 - 1:
            centre = pose[:3, 3] + share * pose[:3, 0]
            distance = np.hypot(*centre[:2])
            # A lamp behind the middle is seen alike from all sides.
            toward = -centre[:2] / distance if distance > 1e-6 else np.array([1.0, 0.0])
            tall = abs(pose[2, 1] - pose[:2, 1] @ toward * (-centre[2] / max(distance, 1e-6)))
            inside = np.all(np.abs(centre[:2]) < half + 1.0)
            seen = (corners - centre[:2]) @ np.array([[toward[0], -toward[1]], [toward[1], toward[0]]])
            angles = [-np.pi, np.pi] if inside else np.array([-1, 1]) * (np.abs(np.arctan2(seen[:, 1], seen[:, 0])).max() + 0.01)
            nearest = np.linalg.norm(np.maximum(np.abs(centre[:2]) - half, 0))
            reach = [max(nearest, 0.5), np.linalg.norm(seen, axis=1).max()]
            per = (LINES - 1) / (angles[1] - angles[0]), (STEPS - 1) / (reach[1] - reach[0])
            rows.append([*centre, max(tall, 0.05), *toward, angles[0], per[0], reach[0], per[1], 0, 0])
    return np.array(rows).reshape(-1, 12)


def _polar_places(pieces: NDArray[np.float64], size: NDArray[np.float64], cells: tuple[int, ...]) -> NDArray[np.float64]:
    """Column (-9 off the gel) and row in the grid of heights, light's z and 1/distance of each polar place; (STEPS, S, LINES, 4)."""
    x, y, z, _, cosine, sine, first, turn, near, step = (pieces[:, i, None, None] for i in range(10))
    angle = first + np.arange(LINES)[None, :, None] / turn
    distance = near + np.arange(STEPS)[None, None, :] / step
    forward, aside = distance * np.cos(angle), distance * np.sin(angle)
    column = ((x + forward * cosine - aside * sine) / size[0] + 0.5) * (cells[0] - 1)
    row = ((y + forward * sine + aside * cosine) / size[1] + 0.5) * (cells[1] - 1)
    outside = (column < 0) | (row < 0) | (column > cells[0] - 1) | (row > cells[1] - 1)
    distance, z = np.broadcast_to(distance, column.shape), np.broadcast_to(z, column.shape)
    return np.stack([np.where(outside, -9, column), row, z, 1 / distance], axis=-1).transpose(2, 0, 1, 3)
