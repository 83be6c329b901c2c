"""What a sensor's light does to a small piece of its membrane: a table over place, height and normal, with its own error. Plain NumPy.

Light that comes straight from the emitters onto a piece of coat at (x, y, z) with normal n, seen by the sensor's camera, is a function of
these alone, for the camera stands still and its direction is a function of the place:

    L_c = Σ_k a_k(x, y, z, n) C_kc,        each component k belongs to one light.

a_k is tabulated over x, y, n_x, n_y (linear on the simplices of the grid's cells: Kuhn's) and z (two layers, linear). A coat whose
channels differ by factors needs one component a light. Paint (markers) returns the share `paint(n)` of what the coat would. `gains` weigh
the light that other parts of the membrane send (`gelsim.optics.baked`); `veil` is what arrives from everywhere and changes little. Measured
by `gelsim.optics.bake`.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.files import whole_file

PACKET = 4
"""Components are stored in fours: one load of 16 bytes."""


@dataclass(frozen=True, eq=False)
class LightField:
    """Lengths in mm, radiance in the renderer's units."""

    table: NDArray[np.float32]
    """a_k: shape (2 heights, R rows of y, C columns of x, M of n_y, M of n_x, K), K a multiple of 4."""
    heights: NDArray[np.float32]
    """z of the two layers, shape (2,)."""
    places: NDArray[np.float32]
    """First and last x, first and last y of the nodes, shape (2, 2)."""
    normals: float
    """n_x and n_y of the nodes run from minus this to plus this; n points out of the gel."""
    colours: NDArray[np.float32]
    """C, shape (K, 3); rows of unused components are 0."""
    light_of: NDArray[np.int32]
    """The light a component belongs to, shape (K,); -1 where unused."""
    paint: NDArray[np.float32]
    """Shape (M, M)."""
    gains: NDArray[np.float32]
    """Reflectance by channel for light from other parts of the membrane, shape (3,)."""
    veil: NDArray[np.float32]
    """Radiance by channel that comes on top everywhere, by place, shape (R, C, 4), the fourth unused."""
    errors: dict[str, Any] = field(default_factory=dict)
    """How far the baked picture was from the path-traced one on surfaces it was not made from, and what the bake cost."""

    def local(self, points: NDArray[np.floating], normals: NDArray[np.floating]) -> NDArray[np.float64]:
        """Components at points in float64, as specification of the kernel.

        Args:
            points: [mm], shape (N, 3). normals: Out of the gel, shape (N, 3).
        Returns:
            a_k, shape (N, K).
        """
        _, rows, columns, size, _, _ = self.table.shape
        at = [np.clip((points[:, 2] - self.heights[0]) / (self.heights[1] - self.heights[0]), -1.0, 2.0)]
        for axis, count in ((1, rows), (0, columns)):
            low, high = self.places[axis]
            at.append(np.clip((points[:, axis] - low) / (high - low) * (count - 1), 0, count - 1))
        for axis in (1, 0):
            at.append(np.clip((normals[:, axis] / self.normals + 1) / 2 * (size - 1), 0, size - 1))
        height, place = at[0], np.stack(at[1:], axis=1)
        first = np.clip(np.floor(place).astype(int), 0, np.array(self.table.shape[1:5]) - 2)
        share = place - first
        order = np.argsort(-share, axis=1)
        node, lane = first.copy(), np.arange(len(points))
        total = np.zeros((len(points), self.table.shape[5]))
        for corner in range(5):
            above = share[lane, order[:, corner - 1]] if corner else np.ones(len(points))
            below = share[lane, order[:, corner]] if corner < 4 else np.zeros(len(points))
            low, high = (self.table[(layer, *node.T)] for layer in (0, 1))
            total += (above - below)[:, None] * (low + height[:, None] * (high - low))
            if corner < 4:
                node[lane, order[:, corner]] += 1
        return total


ARRAYS = ("table", "heights", "places", "colours", "light_of", "paint", "gains", "veil")


def write_field(path: Path, light_field: LightField) -> None:
    """Writes under a temporary name, then renames. Raises OSError."""
    arrays = {name: getattr(light_field, name) for name in ARRAYS}
    about = json.dumps({"normals": light_field.normals, "errors": light_field.errors, "sum": _checksum(light_field)})
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez(file, about=np.array(about), **arrays)


def read_field(path: Path) -> LightField | None:
    """The field in a file; None where there is none, or it is not whole: every byte of the arrays is checked."""
    try:
        # Opened here: NumPy leaves a damaged file open.
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            light_field = LightField(**{name: file[name] for name in ARRAYS}, normals=about["normals"], errors=about["errors"])
    except FileNotFoundError:
        return None
    except Exception:  # whatever a damaged archive makes its reader say, the answer is the same
        return None
    return light_field if _checksum(light_field) == about.get("sum") else None


def _checksum(light_field: LightField) -> str:
    digest = hashlib.sha256(repr((light_field.normals, json.dumps(light_field.errors, sort_keys=True))).encode())
    for name in ARRAYS:
        array = getattr(light_field, name)
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
