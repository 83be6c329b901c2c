"""NVIDIA's cuDSS for batches: LDLᵀ of many symmetric matrices with one pattern, all on the GPU (the package nvidia-cudss).

Plain pivots, as for PARDISO (linear.py): with -C < 0 the matrices are quasi-definite. No matching either, which cuDSS 1.0 does by itself
for a batch of one, by the values at the analysis: here there are none yet; presses that failed at first touch did not do so for that,
but for points frozen beside a rim. A mask says which of the batch a call is for.
"""

from __future__ import annotations

import ctypes
import glob
import os
import sysconfig
from ctypes import c_int, c_int64, c_size_t, c_void_p
from ctypes.util import find_library

import numpy as np
import warp as wp
from numpy.typing import NDArray

# cudss.h and cudss_data_types.h of version 0.8 and 1.0; 32-bit indices and 64-bit reals by CUDA's library_types.h
_MATCHING, _PIVOT_TYPE, _UBATCH_SIZE, _MATCHING_NONE, _PIVOT_NONE = 3, 7, 18, 0, 1
_LU_NNZ, _INERTIA, _UBATCH_MASK = 1, 3, 25
_ANALYSIS, _FACTORIZATION, _REFACTORIZATION, _SOLVE = 3, 4, 8, 1008
_REAL_64, _INT_32 = 1, 10
_SYMMETRIC, _UPPER, _BASE_ZERO, _COLUMN_MAJOR = 1, 2, 0, 0


def find_cudss() -> str | None:
    """Path or name of the library, or None. GELSIM_CUDSS names it where it is not installed as a package."""
    if path := os.environ.get("GELSIM_CUDSS"):
        return path
    for folder in {sysconfig.get_path("platlib"), sysconfig.get_path("purelib")}:
        for path in sorted(glob.glob(os.path.join(folder, "nvidia", "*", "lib", "libcudss.so*")), key=len):
            return path
    return find_library("cudss")


class CudssBatch:
    """As linear.BatchedSystem: `analyse` once a pattern, `factorise` once matrices change, `solve`.

    Raises:
        ImportError: The library is not there.
    """

    name = "NVIDIA cuDSS, LDLᵀ, batched"

    def __init__(self, count: int, device: str) -> None:
        path = find_cudss()
        if path is None:
            raise ImportError("cuDSS is not installed: pip install nvidia-cudss-cu13 (or -cu12, as your driver has it)")
        for name in ("libnvrtc", "libcublasLt", "libcublas"):  # its needs, which as packages lie beside it
            for needed in glob.glob(os.path.join(os.path.dirname(path), f"{name}.so*")):
                ctypes.CDLL(needed, mode=ctypes.RTLD_GLOBAL)
        self._library = ctypes.CDLL(path)
        self.count, self.device = count, device
        self._handle, self._config, self._data = c_void_p(), c_void_p(), c_void_p()
        self._objects: list[c_void_p] = []
        self._mask = np.zeros(0, np.int32)
        self._places: dict[int | None, int | None] = {}
        """What the library was told last: the systems to work on, and where each matrix's numbers lie."""
        self._factored = False
        self._call("cudssCreate", ctypes.byref(self._handle))
        self._call("cudssSetStream", self._handle, c_void_p(wp.get_stream(device).cuda_stream))
        self._call("cudssConfigCreate", ctypes.byref(self._config))
        self._set(_UBATCH_SIZE, count)
        self._set(_PIVOT_TYPE, _PIVOT_NONE)
        self._set(_MATCHING, _MATCHING_NONE)

    def analyse(self, indptr: NDArray[np.int32], indices: NDArray[np.int32]) -> None:
        """Orders the unknowns for a pattern: upper triangle, CSR."""
        self._forget()
        n, entries = len(indptr) - 1, len(indices)
        self._rows, self._columns = (wp.array(a, dtype=wp.int32, device=self.device) for a in (indptr, indices))
        self._n = n
        self._matrix, self._right, self._left = (self._object() for _ in range(3))
        self._call(
            "cudssMatrixCreateCsr", ctypes.byref(self._matrix), c_int64(n), c_int64(n), c_int64(entries), c_void_p(self._rows.ptr),
            None, c_void_p(self._columns.ptr), None, c_int(_INT_32), c_int(_INT_32), c_int(_REAL_64), c_int(_SYMMETRIC), c_int(_UPPER),
            c_int(_BASE_ZERO),
        )  # fmt: skip
        self._mask, self._places = np.zeros(0, np.int32), {}
        for matrix in (self._right, self._left):
            self._call(
                "cudssMatrixCreateDn", ctypes.byref(matrix), c_int64(n), c_int64(1), c_int64(n), None, c_int(_REAL_64), c_int(_COLUMN_MAJOR)
            )
        self._call("cudssDataCreate", self._handle, ctypes.byref(self._data))
        self._select(np.ones(self.count, bool))
        values, vector = (wp.zeros(self.count * k, dtype=wp.float64, device=self.device) for k in (entries, n))
        for matrix, array in ((self._matrix, values), (self._right, vector), (self._left, vector)):
            self._place(matrix, array)
        self._execute(_ANALYSIS)
        self._factored = False
        self.factor_entries = int(self._get(_LU_NNZ, 1, np.int64)[0])

    def factorise(self, values: wp.array, which: NDArray[np.bool_]) -> None:
        self._select(which if self._factored else np.ones(self.count, bool))
        self._place(self._matrix, values)
        self._execute(_REFACTORIZATION if self._factored else _FACTORIZATION)
        self._factored = True

    @property
    def negative(self) -> NDArray[np.integer]:
        """Negative eigenvalues of each matrix's last factors; -1 of several matrices, of which cuDSS does not tell each one's."""
        return self._get(_INERTIA, 2, np.int32)[1:] if self.count == 1 else np.full(self.count, -1)

    def solve(self, b: wp.array, x: wp.array, which: NDArray[np.bool_]) -> None:
        self._select(which)
        self._place(self._right, b)
        self._place(self._left, x)
        self._execute(_SOLVE)

    def _select(self, which: NDArray[np.bool_]) -> None:
        """Says which systems the next call is for, where that has changed."""
        if np.array_equal(which, self._mask):
            return
        self._mask = np.ascontiguousarray(which, np.int32)
        self._call("cudssDataSet", self._handle, self._data, c_int(_UBATCH_MASK), c_void_p(self._mask.ctypes.data),
                   c_size_t(self._mask.nbytes))  # fmt: skip

    def _place(self, matrix: c_void_p, array: wp.array) -> None:
        """Says where a matrix's numbers lie, where that has changed."""
        if self._places.get(matrix.value) != array.ptr:
            self._call("cudssMatrixSetValues", matrix, c_void_p(array.ptr))
            self._places[matrix.value] = array.ptr

    def _get(self, parameter: int, length: int, dtype: type) -> NDArray[np.integer]:
        found, written = np.zeros(length, dtype), c_size_t(0)
        self._call("cudssDataGet", self._handle, self._data, c_int(parameter), c_void_p(found.ctypes.data), c_size_t(found.nbytes),
                   ctypes.byref(written))  # fmt: skip
        return found

    def _set(self, parameter: int, value: int) -> None:
        self._call("cudssConfigSet", self._config, c_int(parameter), ctypes.byref(c_int(value)), c_size_t(4))

    def _execute(self, phase: int) -> None:
        self._call("cudssExecute", self._handle, c_int(phase), self._config, self._data, self._matrix, self._left, self._right)

    def _call(self, name: str, *arguments: object) -> None:
        status = getattr(self._library, name)(*arguments)
        if status != 0:
            raise np.linalg.LinAlgError(f"{name}: cuDSS status {status}")

    def _object(self) -> c_void_p:
        self._objects.append(c_void_p())
        return self._objects[-1]

    def _forget(self) -> None:
        for one in self._objects:
            self._library.cudssMatrixDestroy(one)
        self._objects = []
        if self._data:
            self._library.cudssDataDestroy(self._handle, self._data)
            self._data = c_void_p()

    def __del__(self) -> None:
        try:
            self._forget()
            self._library.cudssConfigDestroy(self._config)
            self._library.cudssDestroy(self._handle)
        except Exception:  # interpreter shutdown
            pass
