"""The few array operations that `optics.baked` and `optics.isp` are written in, by Dr.Jit (vector units, all cores, a GPU) or by NumPy.

NumPy serves where Dr.Jit has no backend (no libLLVM, no CUDA), and is the twin that tests compare with. One-dimensional arrays only.
"""

from __future__ import annotations

import gc
import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from gelsim.optics.variant import VariantChoice, use_variant

Values = Any
"""A one-dimensional float32, int32 or uint32 array of the backend."""


class NumPyArrays:
    """The slow twin."""

    name = "numpy"

    def __init__(self) -> None:
        self.select: Any = np.where
        self.minimum: Any = np.minimum
        self.maximum: Any = np.maximum
        self.sqrt: Any = np.sqrt
        self.atan: Any = np.arctan
        self.atan2: Any = np.arctan2
        self.cos: Any = np.cos
        self.sin: Any = np.sin
        self.log: Any = np.log
        self.power: Any = np.power

    def floats(self, values: Any) -> Values:
        return np.ascontiguousarray(values, np.float32).ravel()

    def numbers(self, values: Any) -> list[Values]:
        """Arrays of one number each, which go with those of any length: cheaper than to gather the same one in every lane."""
        return list(np.asarray(values, np.float32).reshape(-1, 1))

    def words(self, values: Any) -> Values:
        """uint32, whose sums and products wrap."""
        return np.asarray(values).astype(np.uint32)

    def range(self, count: int) -> Values:
        return np.arange(count, dtype=np.int32)

    def whole(self, values: Values) -> Values:
        """Rounded down."""
        return np.floor(values).astype(np.int32)

    def real(self, values: Values) -> Values:
        return values.astype(np.float32)

    def gather(self, source: Values, index: Values) -> Values:
        return source[index]

    def packet(self, source: Values, index: Values, width: int) -> Any:
        """`width` neighbours at index * width, as arrays."""
        return source.reshape(-1, width)[index].T

    def interleave(self, columns: list[Values]) -> Values:
        """The inverse of `packet` over all indices."""
        return np.stack([np.asarray(column, np.float32) for column in columns], axis=1).ravel()

    def stored(self, values: Values) -> Values:
        """Computed before it is gathered from, not anew at every place that gathers."""
        return values

    def running_minimum(self, values: Values, kept: Values, lines: int, steps: int) -> Values:
        """Along steps, the smallest value so far, and what `kept` holds at its step.

        Args:
            values, kept: At step * lines + line.
        Returns:
            Pairs, in the same order.
        """
        values, kept = values.reshape(steps, lines), kept.reshape(steps, lines)
        lowest = np.minimum.accumulate(values, axis=0)
        # Of equal ones the first, as in the loop of the other backend.
        fresh = np.vstack([np.ones((1, lines), bool), values[1:] < lowest[:-1]])
        first = np.maximum.accumulate(np.where(fresh, np.arange(steps)[:, None], 0), axis=0)
        return np.stack([lowest, np.take_along_axis(kept, first, axis=0)], axis=2).ravel()

    def compiled(self, function: Any) -> Any:
        return function

    def numpy(self, values: Values) -> np.ndarray:
        return np.asarray(values)


class DrJitArrays:
    """`backend` is "llvm" or "cuda"; made by `choose_arrays`."""

    def __init__(self, backend: str) -> None:
        import drjit

        self.name, self._dr = backend, drjit
        types = importlib.import_module(f"drjit.{backend}")
        self._float, self._int, self._word = types.Float, types.Int, types.UInt32
        self._packets = {2: types.Array2f, 4: types.Array4f}
        self._any = types.ArrayXf
        self.select: Any = drjit.select
        self.minimum: Any = drjit.minimum
        self.maximum: Any = drjit.maximum
        self.sqrt: Any = drjit.sqrt
        self.atan: Any = drjit.atan
        self.atan2: Any = drjit.atan2
        self.cos: Any = drjit.cos
        self.sin: Any = drjit.sin
        self.log: Any = drjit.log
        self.power: Any = drjit.power

    def floats(self, values: Any) -> Values:
        """Perhaps the very memory of `values`, which may not be written to afterwards."""
        if self._dr.is_array_v(values):  # a Mitsuba variant's
            return self._float(self._dr.detach(values))
        if getattr(values, "is_cuda", False):  # PyTorch's, as it lies
            return self._float(values.reshape(-1))
        return self._float(_aligned(np.asarray(values, np.float32)))

    def numbers(self, values: Any) -> list[Values]:
        flat = np.asarray(values, np.float32).ravel()
        return [self._dr.opaque(self._float, number) for number in flat.tolist()]

    def words(self, values: Any) -> Values:
        return self._word(_aligned(values) if isinstance(values, np.ndarray) else values)

    def range(self, count: int) -> Values:
        return self._dr.arange(self._int, count)

    def whole(self, values: Values) -> Values:
        return self._int(self._dr.floor(values))

    def real(self, values: Values) -> Values:
        return self._float(values)

    def gather(self, source: Values, index: Values) -> Values:
        return self._dr.gather(type(source), source, index)

    def packet(self, source: Values, index: Values, width: int) -> Any:
        if width in self._packets:
            return self._dr.gather(self._packets[width], source, index)
        return self._dr.gather(self._any, source, index, shape=(width, self._dr.width(index)))

    def interleave(self, columns: list[Values]) -> Values:
        return self._dr.ravel(self._packets[len(columns)](*columns))

    def stored(self, values: Values) -> Values:
        self._dr.eval(values)
        return values

    def running_minimum(self, values: Values, kept: Values, lines: int, steps: int) -> Values:
        dr = self._dr
        dr.eval(values, kept)
        line = self.range(lines)
        pairs = dr.empty(self._float, 2 * lines * steps)

        def body(at: Values, lowest: Values, held: Values) -> tuple[Values, Values, Values]:
            value, other = dr.gather(self._float, values, at), dr.gather(self._float, kept, at)
            less = value < lowest
            lowest, held = dr.select(less, value, lowest), dr.select(less, other, held)
            dr.scatter(pairs, self._packets[2](lowest, held), at)
            return at + lines, lowest, held

        state = line, self.real(line * 0) + 1e30, self.real(line * 0)
        dr.while_loop(state, lambda at, lowest, held: at < lines * steps, body)
        return pairs

    def compiled(self, function: Any) -> Any:
        """Traced once for each set of lengths of the arrays in its arguments, which are all it may depend on."""
        # Dr.Jit replays a recording for arrays of other lengths too, with what `len` told the first time.
        frozen: dict[tuple[int, ...], Any] = {}

        def call(*arguments: Any) -> Any:
            lengths = tuple(_lengths(arguments))
            if lengths not in frozen:
                frozen[lengths] = self._dr.freeze(function)
            # While Dr.Jit records, the death of an array that wraps NumPy's memory ends the process: no garbage is collected meanwhile.
            collects = gc.isenabled()
            gc.disable()
            try:
                return frozen[lengths](*arguments)
            finally:
                if collects:
                    gc.enable()

        return call

    def numpy(self, values: Values) -> np.ndarray:
        # Of LLVM's the memory itself, which lives as long as the view: a copy of a picture costs half a millisecond.
        return np.asarray(values)


def _lengths(value: Any) -> Iterator[int]:
    """Of all arrays in nested tuples, lists and dicts; None has none."""
    if isinstance(value, dict | list | tuple):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _lengths(part)
    elif value is not None:
        yield len(value)


def aligned_room(count: int, kind: type = np.float32) -> np.ndarray:
    """Numbers at a multiple of 64 bytes: Dr.Jit uses NumPy's memory as it lies, and would trace anew if it lay otherwise."""
    size = count * np.dtype(kind).itemsize
    room = np.empty(size + 64, np.uint8)
    start = -room.ctypes.data % 64
    return room[start : start + size].view(kind)


def _aligned(values: np.ndarray) -> np.ndarray:
    """Flat, and where Dr.Jit can use it: as it is, or a copy."""
    flat = values.ravel()
    if flat.ctypes.data % 64 == 0:
        return flat
    room = aligned_room(flat.size, flat.dtype.type)
    room[:] = flat
    return room


Arrays = NumPyArrays | DrJitArrays


def clipped(ar: Arrays, a: Values, low: float, high: float) -> Values:
    return ar.minimum(ar.maximum(a, low), high)


def grid_corners(ar: Arrays, u: Values, v: Values, columns: int, rows: int, offset: Values) -> list[tuple[Values, Values]]:
    """Index and weight of the four nodes about place (u, v) of a grid, clamped to its rim."""
    u, v = clipped(ar, u, 0.0, columns - 1.0), clipped(ar, v, 0.0, rows - 1.0)
    i, j = ar.whole(clipped(ar, u, 0.0, columns - 2.0)), ar.whole(clipped(ar, v, 0.0, rows - 2.0))
    s, r = u - ar.real(i), v - ar.real(j)
    first = offset + j * columns + i
    return [(first, (1 - s) * (1 - r)), (first + 1, s * (1 - r)), (first + columns, (1 - s) * r), (first + (columns + 1), s * r)]


def mixed(ar: Arrays, source: Values, corners: list[tuple[Values, Values]], width: int) -> list[Values]:
    """Weighted packets."""
    packets = [(ar.packet(source, index, width), weight) for index, weight in corners]
    return [sum((p[i] * weight for p, weight in packets[1:]), packets[0][0][i] * packets[0][1]) for i in range(width)]


def choose_arrays(variant: VariantChoice) -> Arrays:
    """What suits a Mitsuba variant: its own backend, for which it is selected, or NumPy beside a scalar one."""
    backend = variant.name.split("_")[0]
    if backend not in ("llvm", "cuda"):
        return NumPyArrays()
    use_variant(variant)
    return DrJitArrays(backend)
