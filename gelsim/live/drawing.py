"""The picture of a live sensor: the coated surface from the layer's field, and its light from `optics.baked`, on the backend that draws.

The surface is that of `membrane.surface.Grid` with spaces of a cell, in millimetres: the material point X at x = X + u_t(x), its height
u_z(x) on that of the gel at rest, which between nodes is taken from the layer's grid, less what that is off at X: 1 µm on a dome of
R 14 mm, more at the kink in its corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.live import layer as gel_layer
from gelsim.live.layer import Layer
from gelsim.membrane.surface import Grid
from gelsim.optics import bake
from gelsim.optics.arrays import Arrays, Values, choose_arrays, grid_corners
from gelsim.optics.baked import BakedRenderer, material_grid
from gelsim.optics.isp import frame_keys
from gelsim.optics.variant import choose_variant
from gelsim.scene.definition import Gel, Scene
from gelsim.shape.shapes import gel_height
from gelsim.units import MM, MM_PER_M

INDIRECT_CELL = 0.4
"""Of the grid for inter-reflection [mm]: 8.7 ms of kernels on one thread where 0.2 takes 13.1. Beside that 63 dB on balls, 47 on rims;
beside paths 45.4 and 36.9 dB where that has 45.6 and 37.1."""
RIM = 4
"""Cells beyond the layer's, over which the gel's rim may be moved."""


class Drawer:
    """Pictures of a sensor, or of some of a kind at once, made ready once."""

    def __init__(self, scene: Scene, layer: Layer, device: str, sensors: int = 1) -> None:
        """Measures the sensor's light, if it is not kept."""
        variant = choose_variant(device)
        self._scene = scene
        self._renderer = BakedRenderer(scene, bake.light_field(scene, variant), variant, cell=INDIRECT_CELL)
        arrays = choose_arrays(variant)
        self._surface = Surface(arrays, scene.gel, layer, sensors)
        self._renderer.upload([self._surface.still])
        self._keys = arrays.words(frame_keys(scene, list(range(sensors))))

    def draw(self, field: NDArray[np.float32]) -> NDArray[np.uint8]:
        """8-bit sRGB, (H, W, 3), of the layer's displacement [mm], (3, rows, columns)."""
        return self._renderer.fetch(self._launched(field))[1]

    def many(self, fields: Any) -> Any:
        """8-bit sRGB of each sensor, (sensors, H, W, 3), of displacements [mm], (sensors, 3, rows, columns): PyTorch's, on the device."""
        import torch

        width, height = self._scene.render.resolution
        words: Any = self._launched(fields.contiguous())[1]
        packed = words.torch() if fields.is_cuda else torch.from_numpy(np.asarray(words).copy())
        return packed.view(torch.uint8)[: 3 * len(fields) * height * width].view(len(fields), height, width, 3)

    def _launched(self, field: Any) -> tuple[Values, Values | None]:
        return self._renderer.launch(self._surface.under(field), self._keys)


@dataclass(frozen=True)
class Sizes:
    """Of the material grid, and of the layer's."""

    columns: int
    rows: int
    layer: tuple[int, int]
    """Columns, rows."""
    first: tuple[float, float]
    """Middle of the layer's first cell [mm]."""
    cell: tuple[float, float]
    sensors: int


class Surface:
    """A gel's coated surface on the backend."""

    def __init__(self, arrays: Arrays, gel: Gel, layer: Layer, sensors: int = 1) -> None:
        grid = Grid(gel, gel_layer.CELL_MM * MM)  # a finer one would show the layer's cells as facets
        self.still = grid.membrane(np.zeros((len(grid.places), 3)), np.zeros((0, 3)))
        """At rest, without markers."""
        first = float(layer.x[0]), float(layer.y[0])
        sizes = Sizes(*material_grid(self.still), (layer.shape[1], layer.shape[0]), first, layer.cell, sensors)
        x, y = (
            first + cell * np.arange(-RIM, count + RIM, dtype=np.float64)
            for first, cell, count in zip(sizes.first, sizes.cell, sizes.layer, strict=True)
        )
        rest = gel_height(gel, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) * MM).reshape(len(y), len(x)) * MM_PER_M
        nodes = np.column_stack([self.still.positions * MM_PER_M, np.zeros(len(grid.places))])
        nodes[:, 2] -= gel_layer.between(rest, (nodes[:, 1] - y[0]) / sizes.cell[1], (nodes[:, 0] - x[0]) / sizes.cell[0])
        self._rest, self._nodes = arrays.floats(rest), arrays.floats(nodes)
        self._floats = arrays.floats
        self._moved = arrays.compiled(lambda rest, nodes, field: moved(arrays, sizes, rest, nodes, field))

    def under(self, field: Any) -> tuple[Values, Values]:
        """What `BakedRenderer.upload` gives of membranes, under the layer's displacement [mm], (sensors, 3, rows, columns)."""
        return self._moved(self._rest, self._nodes, self._floats(field))


def moved(ar: Arrays, st: Sizes, rest: Values, nodes: Values, field: Values) -> tuple[Values, Values]:
    """Places [mm] in fours and normals in pairs of a material grid's nodes, sensor after sensor.

    Args:
        rest: Height of the gel at the layer's cells, and RIM beyond [mm].
        nodes: Places of the material grid at rest [mm], in fours; of z what `rest` between its places is less.
        field: Displacement at the layer's cells [mm], three components one after the other, sensor after sensor.
    """
    cells = st.layer[0] * st.layer[1]
    count = st.columns * st.rows
    lane = ar.range(count * st.sensors)
    sensor = lane // count
    node = lane - sensor * count
    x, y, z, nothing = ar.packet(nodes, node, 4)

    def corners(x: Values, y: Values, rim: int) -> list[tuple[Values, Values]]:
        column, row = (x - st.first[0]) * (1 / st.cell[0]) + rim, (y - st.first[1]) * (1 / st.cell[1]) + rim
        first = lane * 0 if rim else sensor * (3 * cells)  # there is one rest
        return grid_corners(ar, column, row, st.layer[0] + 2 * rim, st.layer[1] + 2 * rim, first)

    def around(x: Values, y: Values) -> list[tuple[Values, Values]]:
        """Index and weight of the sixteen cells about a place, as `layer.smooth_between` reads them."""
        found = []
        for at, first, cell, count in zip((x, y), st.first, st.cell, st.layer, strict=True):
            place = ar.minimum(ar.maximum((at - first) * (1 / cell), 0.0), count - 1.0)
            before = ar.whole(ar.minimum(place, count - 2.0))
            steps = [ar.minimum(ar.maximum(before + i, 0), count - 1) for i in range(-1, 3)]
            found.append(list(zip(steps, gel_layer.keys(place - ar.real(before)), strict=True)))
        columns, rows = found
        return [(sensor * (3 * cells) + row * st.layer[0] + column, down * right) for row, down in rows for column, right in columns]

    def read(source: Values, at: list[tuple[Values, Values]], part: int = 0) -> Values:
        return sum(ar.gather(source, index + part * cells) * weight for index, weight in at)

    u, v = x, y
    for look in range(gel_layer.LOOKS, 0, -1):  # x = X + u_t(x)
        at = corners(u, v, 0) if look > 1 else around(u, v)
        u, v = x + read(field, at), y + read(field, at, 1)
    z = z + read(field, around(u, v), 2) + read(rest, corners(u, v, RIM))
    places = ar.stored(ar.interleave([u, v, z, nothing]))

    row = node // st.columns
    column = node - row * st.columns

    def along(place: Values, stride: int, count: int) -> list[Any]:
        """Twice the derivative by index: central, of second order at the ends too."""
        inner = ar.minimum(ar.maximum(place, 1), count - 2)
        middle = lane + (inner - place) * stride
        one, two, three = (ar.packet(places, middle + way * stride, 4) for way in (-1, 0, 1))
        beyond = ar.real(place - inner) * 2.0
        return [three[i] - one[i] + beyond * (three[i] - 2.0 * two[i] + one[i]) for i in range(3)]

    right, down = along(column, 1, st.columns), along(row, st.columns, st.rows)
    normal = [right[i] * down[j] - right[j] * down[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    length = ar.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    return places, ar.interleave([normal[0] / length, normal[1] / length])
