"""Where in the picture at rest the coat appeared that each pixel sees now, for renderers that trace; `optics.baked` knows it by itself.

The pixel's ray is met with the membrane's material grid as `optics.baked` does, in the same lines, and the rest place of what it meets is
interpolated between those of the grid's nodes. At the pixel's middle: what a pixel averages over moves as one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gelsim.optics.arrays import Arrays, Values
from gelsim.optics.baked import material_grid, straight_rays, surface_arrays
from gelsim.optics.baked_kernels import MEET_STEPS, MaterialGrid, meet, place_at_rest
from gelsim.optics.camera import project
from gelsim.results import Membrane
from gelsim.scene.definition import Scene


class RestPlaces:
    """A scene's rays and its membrane's rest places, made ready once."""

    def __init__(self, scene: Scene, arrays: Arrays, rest: Membrane) -> None:
        """`rest`: The membrane at rest."""
        width, height = scene.render.resolution
        grid = MaterialGrid(*material_grid(rest), [float(side) for side in scene.gel.size_mm])
        column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        self._arrays = arrays
        self._tables = {
            "full": arrays.floats(straight_rays(scene, column.ravel(), row.ravel())),
            "nodes": arrays.floats(project(scene, rest.positions)),
        }

        def found(tables: dict[str, Any], places: Values, normals: Values) -> Values:
            pixel = arrays.range(width * height)
            row = pixel // width
            seen = meet(arrays, grid, places, normals, pixel * 0, arrays.packet(tables["full"], pixel, 4), None, MEET_STEPS)
            return arrays.interleave(place_at_rest(arrays, grid, tables["nodes"], seen, pixel - row * width, row))

        self._found = arrays.compiled(found)

    def __call__(self, membrane: Membrane) -> Values:
        """Columns and rows [px] of all pixels, in pairs."""
        return self._found(self._tables, *surface_arrays(self._arrays, [membrane]))
