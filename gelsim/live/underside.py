"""A rigid object as the gel sees it: how high its underside is over each place, at any pose.

The signed distance of the whole object (`gelsim.fem.field`) is sampled once. Of one orientation the underside is a map of heights, found
by walking up along z as far as the distance allows (sphere tracing); it serves every shift, every turn about z, and every tilt up to
TILT_DEG from the one it was made for: there a wall as high as the gel is thick comes into view by less than a quarter of a cell, and points
of the map are turned and met again by a few corrections. A larger tilt makes a new map.

Left out: what lies more than REACH_MM above the object's lowest point, and undercuts, which the gel does not flow into.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.field import MARGIN_MM, kept_field, spacing
from gelsim.live.layer import between
from gelsim.scene.definition import Body
from gelsim.shape import shapes
from gelsim.shape.mesh_file import file_stamp
from gelsim.units import MM_PER_M

Array = NDArray[np.float64]

MAP_MM = 0.1
"""Between the map's places: half a cell of the gel."""
TILT_DEG = 1.0
LEVEL = math.cos(math.radians(TILT_DEG))
REACH_MM = 6.0
"""Above the lowest point; a gel is thinner."""
FAR_MM = 1e3
"""Height where there is no object."""
MOST_SAMPLES = 8e6
"""Of the distance; a larger object is sampled more coarsely."""
CORRECTIONS = 4
"""Of a tilted map, at most: each gains a factor of the slope times the tilt."""
CLOSE_MM = 1e-4
"""Motion of places by one more correction at which they end."""


class Underside:
    """Of one rigid object."""

    def __init__(self, body: Body) -> None:
        """Samples its distance: a second or a few, of a file once.

        Raises:
            SceneError: The shape makes no solid.
        """
        vertices = shapes.object_surface(body, edge_length=np.inf, chord=1e-5).vertices * MM_PER_M
        low, high = vertices.min(axis=0) - MARGIN_MM, vertices.max(axis=0) + MARGIN_MM
        step = max(spacing(body), float((np.prod(high - low) / MOST_SAMPLES) ** (1 / 3)))
        self._field = kept_field(body, file_stamp(body), tuple(low), tuple(high), step)
        self._corners = vertices
        self._turn: Array | None = None

    def forget(self) -> None:
        """The map: which serves depends on what was asked before."""
        self._turn = None

    def heights(self, turn: Array, shift: Array, x: Array, y: Array) -> NDArray[np.float32]:
        """z [mm] of the underside over the places x (columns,) and y (rows,) [mm], (rows, columns); FAR_MM where there is none.

        Args:
            turn, shift: The pose, p -> turn p + shift [mm].
        """
        rest = self._remaining(turn)
        across, along = (way.ravel() for way in np.meshgrid(x - shift[0], y - shift[1]))
        back = np.linalg.inv(rest[:2, :2])

        def look(across: Array, along: Array, z: Array | float) -> Array:
            """Places of the map that a height there puts over the places asked for, and the height that they have: (3, ...)."""
            one, other = across - rest[0, 2] * z, along - rest[1, 2] * z
            one, other = back[0, 0] * one + back[0, 1] * other, back[1, 0] * one + back[1, 1] * other
            return np.stack([one, other, self._read(one, other)])

        found = look(across, along, self._lowest)
        if (lean := max(0.0, 1.0 - rest[2, 2] ** 2) ** 0.5) > 1e-9:
            last, going = np.full(len(across), self._lowest), slice(None)
            for _ in range(CORRECTIONS):
                now = np.where(found[2, going] < FAR_MM / 2, found[2, going], last)
                far = np.abs(now - last) * lean >= CLOSE_MM
                if not far.any():
                    break
                going, last = np.arange(len(across))[going][far], now[far]
                found[:, going] = look(across[going], along[going], last)
        one, other, z = found
        turned = rest[2, 0] * one + rest[2, 1] * other + rest[2, 2] * z + shift[2]
        return np.where(z < FAR_MM / 2, turned, FAR_MM).astype(np.float32).reshape(len(y), len(x))

    def low(self, share: float, turn: Array, shift: Array) -> tuple[Array, Array]:
        """A rectangle, least and greatest (x, y) [mm], beside which the underside is higher than `share` of its depth below z = 0.

        Of an object above z = 0, which has no depth, the rectangle holds its lowest point.
        """
        rest = self._remaining(turn)
        lean = float(np.abs(rest[2, :2]) @ self._reach)
        lowest = rest[2, 2] * self._lowest + shift[2] - lean
        highest = -share * lowest if lowest < 0 else lowest + 2 * lean
        level = (highest - shift[2] + lean) / rest[2, 2]
        bounds = [(self._lowest, level)]
        for first, lows in zip(self._first[::-1], self._lows, strict=True):
            near = np.flatnonzero(lows <= level + MAP_MM)
            bounds.insert(0, (first + MAP_MM * (near[0] - 1), first + MAP_MM * (near[-1] + 1)))
        ends = np.array(bounds)
        middle = rest[:2] @ ends.mean(axis=1) + shift[:2]
        half = np.abs(rest[:2]) @ (ends[:, 1] - ends[:, 0]) / 2
        return middle - half, middle + half

    def _remaining(self, turn: Array) -> Array:
        """From the frame of a map that serves a turn to the gel's: a turn about z and a small tilt."""
        if self._turn is None or turn[2] @ self._turn[2] < LEVEL:
            self._trace(turn)
        assert self._turn is not None
        return turn @ self._turn.T

    def _read(self, x: Array, y: Array) -> Array:
        """Heights of the map at places of its frame; bilinear, and FAR_MM next to what is not there."""
        found = between(self._map, (y - self._first[1]) / MAP_MM, (x - self._first[0]) / MAP_MM)
        return np.where(found > self._top, FAR_MM, found)

    def _trace(self, turn: Array) -> None:
        """Makes the map for an orientation."""
        corners = self._corners @ turn.T
        low, high = corners.min(axis=0), corners.max(axis=0)
        counts = [int(np.ceil((high[i] - low[i]) / MAP_MM / 2)) for i in (0, 1)]
        first = [(low[i] + high[i]) / 2 - counts[i] * MAP_MM for i in (0, 1)]
        x, y = (first[i] + MAP_MM * np.arange(2 * counts[i] + 1) for i in (0, 1))
        rays = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        z = np.full(len(rays), low[2] - 0.05)
        top = low[2] + min(REACH_MM, high[2] - low[2] + 0.1)
        alive = np.arange(len(rays))
        close = 0.02
        for _ in range(200):
            away = self._field(np.column_stack([rays[alive], z[alive]]) @ turn, order=1)  # the last looks mend what that is off by
            going = away > close
            z[alive[going]] += np.maximum(away[going] - close / 2, close / 2)
            alive = alive[going & (z[alive] < top)]
            if len(alive) == 0:
                break
        hit = np.flatnonzero(z < top)
        for _ in range(3):  # Newton's steps along z
            points = np.column_stack([rays[hit], z[hit]])
            here, above = self._field(points @ turn), self._field((points + [0, 0, 1e-3]) @ turn)
            slope = np.minimum((above - here) / 1e-3, -0.1)
            z[hit] -= np.clip(here / slope, -0.1, 0.1)
        z[z >= top] = FAR_MM
        # Its border stands for all beyond.
        self._map, self._top = np.pad(z.reshape(len(y), len(x)), 1, constant_values=FAR_MM), top
        self._turn, self._first = turn.copy(), (x[0] - MAP_MM, y[0] - MAP_MM)
        self._reach = np.abs([x[[0, -1]], y[[0, -1]]]).max(axis=1)
        self._lows, self._lowest = (self._map.min(axis=1), self._map.min(axis=0)), float(self._map.min())
