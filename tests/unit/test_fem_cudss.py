"""What cuDSS is told, by a library that only listens: it is not to be had without a GPU."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import warp as wp

from gelsim.fem import cudss


class Listener:
    """Answers every call with success, and gives each matrix a handle of its own."""

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.handles = 0

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any) -> int:
            self.heard.append(name)
            if name.startswith("cudssMatrixCreate"):
                self.handles += 1
                arguments[0]._obj.value = self.handles
            return 0

        return call

    def told(self) -> list[str]:
        """Since it was asked last."""
        heard, self.heard = self.heard, []
        return [name.removeprefix("cudss") for name in heard]


def test_only_what_has_changed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    values, other, b, x, y = (wp.zeros(6, dtype=wp.float64, device="cpu") for _ in range(5))
    library = Listener()
    monkeypatch.setattr(cudss, "find_cudss", lambda: "nowhere/libcudss.so")
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: library)
    monkeypatch.setattr(wp, "get_stream", lambda _: SimpleNamespace(cuda_stream=0))
    solver = cudss.CudssBatch(2, "cpu")
    indptr, indices = np.array([0, 2, 3], np.int32), np.array([0, 1, 1], np.int32)
    both, first = np.array([True, True]), np.array([True, False])
    for _ in range(2):  # a new pattern has new matrices, of which nothing is known
        solver.analyse(indptr, indices)
        assert library.told()[-6:] == ["DataSet", "MatrixSetValues", "MatrixSetValues", "MatrixSetValues", "Execute", "DataGet"]
        solver.factorise(values, both)
        assert library.told() == ["MatrixSetValues", "Execute"]
        solver.solve(b, x, both)
        assert library.told() == ["MatrixSetValues", "MatrixSetValues", "Execute"]
        solver.solve(b, x, both)
        assert library.told() == ["Execute"]
        solver.solve(b, y, first)
        assert library.told() == ["DataSet", "MatrixSetValues", "Execute"]
        solver.factorise(values, first)
        assert library.told() == ["Execute"]
        solver.factorise(other, both)
        assert library.told() == ["DataSet", "MatrixSetValues", "Execute"]
