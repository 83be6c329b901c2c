"""A rigid object as the gel sees it: how high its underside is over each place, at any pose.

The signed distance of the whole object (`gelsim.fem.field`) is sampled once. Of one orientation the underside is a map of heights, found
by walking up along z as far as the distance allows (sphere tracing); it serves every shift, every turn about z, and every tilt up to
TILT_DEG from the one it was made for: there a wall as high as the gel is thick comes into view by less than a quarter of a cell, and points
of the map are turned and met again by a few corrections. A larger tilt makes a new map.

Left out: what lies more than REACH_MM above the object's lowest point, and undercuts, which the gel does not flow into.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gelsim.fem.field import MARGIN_MM, DistanceField, kept_field, rim_radius, spacing
from gelsim.live.layer import between, keep
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
KEPT = 8
"""Maps of orientations asked for again, as after a reset: 0.1 MB each for a ball of R 5 mm."""
CLOSE_MM = 1e-4
"""Motion of places by one more correction at which they end."""


def whole_field(body: Body) -> tuple[DistanceField, Array]:
    """The signed distance of all of an object, of at most MOST_SAMPLES samples; and points whose hull is the object's [mm], (M, 3).

    Raises:
        SceneError: The shape makes no solid.
    """
    vertices = shapes.object_surface(body, edge_length=np.inf, chord=1e-5).vertices * MM_PER_M
    low, high = vertices.min(axis=0) - MARGIN_MM, vertices.max(axis=0) + MARGIN_MM
    step = max(spacing(body), float((np.prod(high - low) / MOST_SAMPLES) ** (1 / 3)))
    return kept_field(body, file_stamp(body), tuple(low), tuple(high), step, rim_radius(body, step)), vertices


class Underside:
    """Of one rigid object."""

    def __init__(self, body: Body) -> None:
        """Samples its distance: a second or a few, of a file once.

        Raises:
            SceneError: The shape makes no solid.
        """
        self._field, self._corners = whole_field(body)
        self._map: Map | None = None
        self._maps: dict[bytes, Map] = {}

    def forget(self) -> None:
        """Which map serves, which depends on what was asked before."""
        self._map = None

    def heights(self, turn: Array, shift: Array, x: Array, y: Array) -> NDArray[np.float32]:
        """z [mm] of the underside over the places x (columns,) and y (rows,) [mm], (rows, columns); FAR_MM where there is none.

        Args:
            turn, shift: The pose, p -> turn p + shift [mm].
        """
        heights, rest = self._remaining(turn)
        across, along = (way.ravel() for way in np.meshgrid(x - shift[0], y - shift[1]))
        back = np.linalg.inv(rest[:2, :2])

        def look(across: Array, along: Array, z: Array | float) -> Array:
            """Places of the map that a height there puts over the places asked for, and the height that they have: (3, ...)."""
            one, other = across - rest[0, 2] * z, along - rest[1, 2] * z
            one, other = back[0, 0] * one + back[0, 1] * other, back[1, 0] * one + back[1, 1] * other
            return np.stack([one, other, heights.read(one, other)])

        found = look(across, along, heights.lowest)
        if (lean := max(0.0, 1.0 - rest[2, 2] ** 2) ** 0.5) > 1e-9:
            last, going = np.full(len(across), heights.lowest), slice(None)
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
        heights, rest = self._remaining(turn)
        lean = float(np.abs(rest[2, :2]) @ heights.reach)
        lowest = rest[2, 2] * heights.lowest + shift[2] - lean
        highest = -share * lowest if lowest < 0 else lowest + 2 * lean
        level = (highest - shift[2] + lean) / rest[2, 2]
        bounds = [(heights.lowest, level)]
        for first, lows in zip(heights.first[::-1], heights.lows, strict=True):
            near = np.flatnonzero(lows <= level + MAP_MM)
            bounds.insert(0, (first + MAP_MM * (near[0] - 1), first + MAP_MM * (near[-1] + 1)))
        ends = np.array(bounds)
        middle = rest[:2] @ ends.mean(axis=1) + shift[:2]
        half = np.abs(rest[:2]) @ (ends[:, 1] - ends[:, 0]) / 2
        return middle - half, middle + half

    def _remaining(self, turn: Array) -> tuple[Map, Array]:
        """A map that serves a turn, and from its frame to the gel's: a turn about z and a small tilt."""
        if self._map is None or turn[2] @ self._map.turn[2] < LEVEL:
            key = turn.tobytes()
            self._map = self._maps.get(key) or keep(self._maps, key, self._traced(turn), KEPT)
        return self._map, turn @ self._map.turn.T

    def _traced(self, turn: Array) -> Map:
        """The map for an orientation."""
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
        heights = np.pad(z.reshape(len(y), len(x)), 1, constant_values=FAR_MM)  # its border stands for all beyond
        reach = np.abs([x[[0, -1]], y[[0, -1]]]).max(axis=1)
        return Map(turn.copy(), heights, top, (x[0] - MAP_MM, y[0] - MAP_MM), reach, (heights.min(axis=1), heights.min(axis=0)))


@dataclass(frozen=True, eq=False)
class Map:
    """Heights of the underside in one orientation [mm]."""

    turn: Array
    """(3, 3)."""
    heights: Array
    """MAP_MM apart, (rows, columns); FAR_MM where nothing is."""
    top: float
    """Heights above it are not there."""
    first: tuple[float, float]
    """x and y of the first place."""
    reach: Array
    """Greatest |x| and |y|."""
    lows: tuple[Array, Array]
    """The least height of each row, and of each column."""

    @cached_property
    def lowest(self) -> float:
        return float(self.heights.min())

    def read(self, x: Array, y: Array) -> Array:
        """Heights at places of its frame; bilinear, and FAR_MM next to what is not there."""
        found = between(self.heights, (y - self.first[1]) / MAP_MM, (x - self.first[0]) / MAP_MM)
        return np.where(found > self.top, FAR_MM, found)
