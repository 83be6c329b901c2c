"""Direct solution of the symmetric indefinite systems of Newton's method.

The mixed displacement-pressure matrix [[A, Bᵀ], [B, -C]] is symmetric and indefinite: an LDLᵀ factorisation answers it in one go. Intel
MKL's PARDISO does that on both cores; where MKL is not to be had (not x86), SciPy's SuperLU does the same unsymmetrically, several times
slower.

**Single precision.** PARDISO factorises in float32 by default: two thirds of the time, half of the memory. The equations are always
evaluated in float64 and Newton goes on until they hold, so the factor only has to show the way: an answer that is off by 1e-5 of itself
leaves a residual 1e5 times smaller. `SymmetricSystem` checks each factor's first answer, refines it where it is poor, and takes float64
from then on where that does not help.

The matrix is given as CSR arrays of its upper triangle, rows sorted (`assembly.SymmetricPattern`).
"""

from __future__ import annotations

import ctypes
import glob
import os
import site
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from ctypes.util import find_library

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from threadpoolctl import ThreadpoolController

_MTYPE_SYMMETRIC_INDEFINITE = -2

SHIFTS = (1e-3, 8e-3, 0.06, 0.5)
"""Shares of their diagonal by which displacements are made stiffer where the matrix is not that of a minimum, one after the other, from the
one below that which was last enough."""


Product = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def find_mkl() -> str | None:
    """Path or name of MKL's single dynamic library, or None."""
    for prefix in (sys.prefix, site.USER_BASE or sys.prefix):
        places = ("lib", "libmkl_rt*"), ("Library", "bin", "mkl_rt*.dll")
        for path in sorted(path for place in places for path in glob.glob(os.path.join(prefix, *place))):
            return path
    return find_library("mkl_rt")


class _Description(ctypes.Structure):
    """MKL's `matrix_descr`."""

    _fields_ = (("type", ctypes.c_int), ("mode", ctypes.c_int), ("diagonal", ctypes.c_int))


_SYMMETRIC_UPPER = _Description(21, 41, 50)  # with its diagonal


class MklProduct:
    """x to K x, of which MKL reads the upper triangle once, on all its threads; SciPy reads it twice, on one."""

    def __init__(self, mkl: ctypes.CDLL, indptr: NDArray[np.int32], indices: NDArray[np.int32], values: NDArray[np.float64]) -> None:
        self._mkl, self._read, self._handle = mkl, (indptr, indices, values), ctypes.c_void_p()
        n, zero_based = ctypes.c_int(len(indptr) - 1), ctypes.c_int(0)
        arrays = (ctypes.c_void_p(array.ctypes.data) for array in (indptr, indptr[1:], indices, values))
        self._check(mkl.mkl_sparse_d_create_csr(ctypes.byref(self._handle), zero_based, n, n, *arrays))

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        x = np.ascontiguousarray(x, np.float64)
        if len(x) != len(self._read[0]) - 1:
            raise ValueError(f"a vector of {len(x)} for a matrix of {len(self._read[0]) - 1} rows")
        y = np.empty_like(x)
        plain, one, none = ctypes.c_int(10), ctypes.c_double(1.0), ctypes.c_double(0.0)
        given, into = ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data)
        self._check(self._mkl.mkl_sparse_d_mv(plain, one, self._handle, _SYMMETRIC_UPPER, given, none, into))
        return y

    def __del__(self) -> None:
        if self._handle:
            self._mkl.mkl_sparse_destroy(self._handle)

    @staticmethod
    def _check(status: int) -> None:
        if status != 0:
            raise np.linalg.LinAlgError(f"MKL's sparse product: status {status}")


class PardisoSolver:
    """LDLᵀ by MKL PARDISO. `analyse` once a pattern, `factorise` once a matrix, `solve` once a right-hand side.

    `single`: in float32. What goes in and what comes out is float64 either way.
    Attributes: `cost` of a factorisation, in operations over the entries of matrix and factor.
    """

    def __init__(self, threads: int | None = None, single: bool = False) -> None:
        path = find_mkl()
        if path is None:
            raise ImportError("no mkl_rt library")
        asked = os.environ.get("MKL_NUM_THREADS") or os.environ.get("OMP_NUM_THREADS")  # which TBB does not heed
        if os.environ.setdefault("MKL_THREADING_LAYER", "SEQUENTIAL" if asked == "1" else "TBB") == "TBB":
            # idle OpenMP threads spin, which on a busy machine costs more than they bring; TBB's sleep. mkl_rt looks for TBB by name only
            for tbb in sorted(glob.glob(os.path.join(os.path.dirname(path), "libtbb.so.*")), key=len)[:1]:
                ctypes.CDLL(tbb, mode=ctypes.RTLD_GLOBAL)
        self._mkl = ctypes.CDLL(path)
        if threads is not None:
            self._mkl.MKL_Set_Num_Threads(ctypes.c_int(threads))
        self.single, self._dtype = single, np.float32 if single else np.float64
        self.name = "MKL PARDISO, LDLᵀ" + (" in float32" if single else "")
        self._handle = np.zeros(64, np.int64)
        self._iparm = np.zeros(64, np.int32)
        self._iparm[0] = 1  # every value below is ours
        self._iparm[1] = 2  # METIS nested dissection
        self._iparm[7] = 0  # no iterative refinement unless a pivot was perturbed: Newton and GMRES refine
        self._iparm[9] = 10  # pivots under 1e-10 of the norm are perturbed
        # No matching, no scaling, plain pivots: with -C < 0 the matrix is quasi-definite and has an LDLᵀ in any order (Vanderbei 1995).
        # Costs a third less.
        self._iparm[27] = int(single)
        self._iparm[34] = 1  # 0-based indices
        self._analysed = False

    def _call(self, phase: int, b: NDArray[np.float64] | None = None) -> NDArray[np.float64] | None:
        n = len(self._indptr) - 1
        right = np.zeros(n, self._dtype) if b is None else np.ascontiguousarray(b, self._dtype)
        x = np.zeros_like(right)
        error = ctypes.c_int32(0)

        def integer(value: int) -> ctypes._Pointer:  # type: ignore[name-defined]
            return ctypes.byref(ctypes.c_int32(value))  # type: ignore[return-value]

        rhs = 1 if right.ndim == 1 else right.shape[0]
        self._mkl.pardiso(
            ctypes.c_void_p(self._handle.ctypes.data), integer(1), integer(1), integer(_MTYPE_SYMMETRIC_INDEFINITE), integer(phase),
            integer(n), ctypes.c_void_p(self._values.ctypes.data), ctypes.c_void_p(self._indptr.ctypes.data),
            ctypes.c_void_p(self._indices.ctypes.data), None, integer(rhs), ctypes.c_void_p(self._iparm.ctypes.data), integer(0),
            ctypes.c_void_p(right.ctypes.data), ctypes.c_void_p(x.ctypes.data), ctypes.byref(error),
        )  # fmt: skip
        if error.value != 0:
            raise np.linalg.LinAlgError(f"PARDISO phase {phase}: error {error.value}")
        return x.astype(np.float64, copy=False)

    def analyse(self, indptr: NDArray[np.int32], indices: NDArray[np.int32], values: NDArray[np.float64]) -> None:
        """Orders the unknowns for a pattern (upper triangle, CSR). `values` matter for the scaling only."""
        self.release()
        self._indptr, self._indices, self._values = indptr, indices, values.astype(self._dtype)
        self._iparm[17:19] = -1  # to be counted
        self._call(11)
        entries, million_operations = self._iparm[17:19].astype(float)
        self.cost = 1e6 * million_operations / (len(indices) + entries)
        self._analysed = True

    def factorise(self, values: NDArray[np.float64]) -> None:
        self._values = np.ascontiguousarray(values, self._dtype)
        self._call(22)

    @property
    def negative(self) -> int | None:
        """Negative eigenvalues of the matrix factorised last (Sylvester's law: those of D)."""
        return int(self._iparm[22])

    def solve(self, b: NDArray[np.float64]) -> NDArray[np.float64]:
        x = self._call(33, b)
        assert x is not None
        return x

    def product(self, values: NDArray[np.float64]) -> Product:
        """x to K x for a matrix of the pattern analysed last; `values` must stay as they are while it serves."""
        return MklProduct(self._mkl, self._indptr, self._indices, values)

    def release(self) -> None:
        if self._analysed:
            self._call(-1)
            self._analysed = False

    def __del__(self) -> None:
        try:
            self.release()
        except Exception:  # interpreter shutdown
            pass


class SuperLUSolver:
    """The same through SciPy, for machines without MKL."""

    name, single, negative, cost = "SciPy SuperLU", False, None, np.inf

    def analyse(self, indptr: NDArray[np.int32], indices: NDArray[np.int32], values: NDArray[np.float64]) -> None:
        self._indptr, self._indices = indptr, indices

    def factorise(self, values: NDArray[np.float64]) -> None:
        from scipy.sparse.linalg import splu

        n = len(self._indptr) - 1
        upper = sp.csr_matrix((values, self._indices, self._indptr), shape=(n, n))
        full = upper + sp.triu(upper, 1).T
        try:
            self._lu = splu(full.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        except RuntimeError:  # exactly singular: no answer, as Newton sees by it, which may take a shorter step
            self._lu = None

    def solve(self, b: NDArray[np.float64]) -> NDArray[np.float64]:
        if self._lu is None:
            return np.full_like(b, np.nan)
        return self._lu.solve(b.T).T if b.ndim > 1 else self._lu.solve(b)

    def product(self, values: NDArray[np.float64]) -> Product:
        upper = sp.csr_matrix((values, self._indices, self._indptr), shape=(len(self._indptr) - 1,) * 2)
        diagonal = upper.diagonal()
        return lambda x: upper @ x + upper.T @ x - diagonal * x


def gmres(product: Product, b: NDArray[np.float64], tolerance: float, limit: int) -> tuple[NDArray[np.float64], bool]:
    """x of A x = b from zero, by GMRES of at most `limit` products; whether |b - A x| <= tolerance |b|, by its own recurrence.

    One Gram-Schmidt pass of two products of matrix and vector (Saad 2003, algorithm 6.9, in its classical order), and no product to look at
    what is left.
    """
    size = float(np.linalg.norm(b))
    if size == 0.0 or not np.isfinite(size):
        return b.copy(), size == 0.0
    basis, upper = np.empty((limit + 1, len(b))), np.zeros((limit + 1, limit))
    turns, left = np.zeros((limit, 2)), np.zeros(limit + 1)
    basis[0], left[0], number = b / size, size, 0
    while number < limit and abs(left[number]) > tolerance * size:
        known, new = basis[: number + 1], product(basis[number])
        along = known @ new
        new = new - along @ known
        height = float(np.linalg.norm(new))
        column = np.append(along, height)
        for k in range(number):
            c, s = turns[k]
            column[k], column[k + 1] = c * column[k] + s * column[k + 1], c * column[k + 1] - s * column[k]
        radius = float(np.hypot(column[number], column[number + 1]))
        if radius == 0.0 or not np.isfinite(radius):
            break
        c, s = turns[number] = column[number] / radius, column[number + 1] / radius
        column[number], column[number + 1] = radius, 0.0
        upper[: number + 2, number] = column
        left[number], left[number + 1] = c * left[number], -s * left[number]
        number += 1
        if height == 0.0:
            break
        basis[number] = new / height
    x = solve_triangular(upper[:number, :number], left[:number]) @ basis[:number]
    return x, bool(abs(left[number]) <= tolerance * size)


class SymmetricSystem:
    """Solves (K + C) x = b with a direct factorisation of the symmetric K and, for contact's unsymmetric C, GMRES.

    Args:
        positive: Unknowns in which K of an equilibrium that bodies rest in is positive (displacements), for `exact` steps.
    Attributes: `factorisations` and `solves` done so far; `product`, x to K x of the last matrix; `downhill`, whether the last step led
    down from a saddle, by a matrix made stiffer.
    """

    # C couples few points: some ten iterations. Where they fall short the step is inexact, and Newton corrects it.
    KRYLOV_TOLERANCE = 1e-3
    KRYLOV_LIMIT = 20
    # |M⁻¹(b - K x)| / |M⁻¹ b| of a rough step, M being factors of an earlier K.
    FORCING = 0.03
    # Operations of a factorisation for each entry that a product and a solve read in its time. Factors are worn out once a step takes more
    # products than steps with them do on average, their factorisation counted: from there on new ones cost less
    # (`python docs/studies/rough_steps.py`).
    PER_ENTRY = 50.0
    # |b - Kx|/|b| that an answer in float32 may have: 1e-6 to 8e-6 over the stability suite. One matrix of its cone had 9e-5, and Newton
    # took another path from there.
    POOR = 1e-5
    REFINEMENTS = 3

    def __init__(self, positive: NDArray[np.bool_] | None = None) -> None:
        self.positive = positive
        self.direct = make_solver(single=_single.get())
        self.factorisations = self.solves = 0
        self.factored = self.fresh = self._worn = False
        self._stiffened, self.downhill = 0, False  # which of SHIFTS was the last to be needed

    def analyse(self, indptr: NDArray[np.int32], indices: NDArray[np.int32]) -> None:
        """Takes a new pattern."""
        self._pattern = (indices, indptr)
        self.direct.analyse(indptr, indices, np.zeros(len(indices)))
        self.factored = self.fresh = self._worn = False

    def update(self, values: NDArray[np.float64]) -> None:
        """Takes a new matrix, whose `values` stay the caller's until the next; the factors stay those of an earlier one."""
        self._values, self.fresh = values, False
        self.product = self.direct.product(values)

    def factorise(self) -> None:
        """Makes factors of the last matrix."""
        self.direct.factorise(self._values)
        self.factorisations += 1
        self.factored = self.fresh = True
        self._rough = self._products = 0
        self._worn, self._checked = False, not self.direct.single

    def _direct(self, b: NDArray[np.float64]) -> NDArray[np.float64]:
        """K⁻¹ b. A factor in float32 is judged by its first answer, which is refined or, where that does not help, had from float64."""
        self.solves += 1
        x = self.direct.solve(b)
        if self._checked:
            return x
        self._checked = True
        allowed = self.POOR * np.linalg.norm(b)
        for _ in range(self.REFINEMENTS):
            rest = b - self.product(x)
            if np.linalg.norm(rest) <= allowed:
                return x
            x = x + self.direct.solve(rest)
        if np.linalg.norm(b - self.product(x)) <= allowed:
            return x
        indices, indptr = self._pattern
        self.direct = make_solver()
        self.direct.analyse(indptr, indices, self._values)
        self.factorise()
        return self._direct(b)

    def step(self, b: NDArray[np.float64], coupling: Product | None, exact: bool, reach: float = np.inf) -> NDArray[np.float64]:
        """x of the last K as Newton needs it: roughly, by GMRES on factors of an earlier K, or as `solve` on new ones.

        An `exact` one leads down, b·x > 0 in the `positive` unknowns, and changes none of them by more than `reach`, if shifts can do that.

        New ones are made where there are none, where the last step wore them out, where GMRES falls short, and where `exact` asks for it.
        """
        went_down, self.downhill = self.downhill, False
        if self.fresh:
            return self.solve(b, coupling)
        if self.factored and not self._worn and not exact:
            self._rough += 1
            before, start = self.solves, self.direct.solve(b)

            def preconditioned(v: NDArray[np.float64]) -> NDArray[np.float64]:
                self.solves += 1
                product = self.product(v)
                return self.direct.solve(product if coupling is None else product + coupling(v))

            x, enough = gmres(preconditioned, start, self.FORCING, self.KRYLOV_LIMIT)
            self._products += self.solves - before
            self._worn = self.solves - before > (self.direct.cost / self.PER_ENTRY + self._products) / self._rough
            if enough:
                return x
        if exact and self.positive is not None and self.direct.negative is not None:
            return self._down(self.positive, b, coupling, reach, went_down)
        self.factorise()
        return self.solve(b, coupling)

    def _down(
        self, moves: NDArray[np.bool_], b: NDArray[np.float64], coupling: Product | None, reach: float, went_down: bool
    ) -> NDArray[np.float64]:
        """x by the first of the matrix and those shifted on the diagonal of the unknowns that `moves` marks that is good for a step.

        After a step that `went_down` the shift below the last is tried first: where that is too little, all that are smaller are.

        One with more negative eigenvalues than there are others is of a saddle, where a body is about to buckle or to fold: its step does
        not lead to an equilibrium that a press could come to rest in. (Wächter and Biegler 2006, §3.1, correct the inertia in the same
        way.) C has no share in that count: a point that slides off a rim bears less the farther it slides, and the step by C leads back up
        to where it would stick. Then, and once shifted, x is of K alone, which leads down.
        """
        others = int((~moves).sum())
        values, diagonal = self._values, self._pattern[1][:-1][moves]
        least = max(self._stiffened - 1, 0)

        def saddle(number: int | None) -> bool:
            """Whether the matrix shifted by so much, of which it makes factors, is one's."""
            shifted = values
            if number is not None:
                shifted = values.copy()
                shifted[diagonal] += SHIFTS[number] * np.abs(values[diagonal])
            self.update(shifted)
            self.factorise()
            assert self.direct.negative is not None
            return self.direct.negative > others

        shifts = [None, *range(least, len(SHIFTS))]
        if went_down and saddle(least):
            shifts = shifts[2:]
        for number in shifts:
            if saddle(number) and number != shifts[-1]:
                continue
            if number is not None:
                self._stiffened, self.downhill, coupling = number, True, None
            x = self.solve(b, coupling)
            if coupling is not None and b[moves] @ x[moves] < 0.0:
                self.downhill, coupling = True, None
                x = self.solve(b, coupling)
            if np.abs(x[moves]).max() <= reach:
                break
        return x

    def solve(self, b: NDArray[np.float64], coupling: Product | None) -> NDArray[np.float64]:
        """x for the K factorised last: by (1 + K⁻¹ B_tᵀ B_n) x = K⁻¹ b, which needs no product with K."""
        x = self._direct(b)
        if coupling is None:
            return x

        def coupled(v: NDArray[np.float64]) -> NDArray[np.float64]:
            return v + self._direct(coupling(v))

        return gmres(coupled, x, self.KRYLOV_TOLERANCE, self.KRYLOV_LIMIT)[0]


class BatchedSystem:
    """Solves many symmetric systems with one pattern: on CUDA by cuDSS, all in one call; without it one after the other on the CPU.

    Attributes: `factored`, of each system whether `solve` may be asked for; `factor_entries` of
    one factor, 0 where they are not known.
    """

    def __init__(self, count: int, device: str) -> None:
        self.count, self.factored, self.factor_entries = count, np.zeros(count, bool), 0
        self._cudss = None
        if device.startswith("cuda"):
            from gelsim.fem.cudss import CudssBatch, find_cudss

            if find_cudss() is not None:
                self._cudss = CudssBatch(count, device)
        self._direct: list[PardisoSolver | SuperLUSolver | None] = [None] * count
        """Of each system that is solved on the CPU."""
        if self._cudss is None:
            self._direct = [make_solver() for _ in range(count)]
        names = [solver.name for solver in (self._cudss, self._direct[0]) if solver is not None]
        self.name = names[0] + (" on the CPU" if device.startswith("cuda") and self._cudss is None else "")

    @property
    def _here(self) -> NDArray[np.bool_]:
        """Which systems are solved on the CPU."""
        return np.array([direct is not None for direct in self._direct])

    def analyse(self, indptr: NDArray[np.int32], indices: NDArray[np.int32]) -> None:
        """Takes a new pattern; all have to be factorised again."""
        self.factored[:] = False
        self._pattern = indptr, indices
        if self._cudss is not None:
            self._direct = [None] * self.count
            self._cudss.analyse(indptr, indices)
            self.factor_entries = self._cudss.factor_entries
            return
        for one in range(self.count):
            self._solver(one).analyse(indptr, indices, np.zeros(len(indices)))

    def distrust(self, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Leaves systems of which new factors are of no use to the CPU until the next pattern; returns those that were not there yet."""
        new = which & ~self._here
        for one in np.flatnonzero(new):
            self._direct[one] = direct = make_solver()
            direct.analyse(*self._pattern, np.zeros(len(self._pattern[1])))
        self.factored[new] = False
        return new

    def factorise(self, values: wp.array, which: NDArray[np.bool_]) -> None:
        """Factorises the systems `which`; `values` holds those of all, one system after the other."""
        self.factored |= which
        here = which & self._here
        if self._cudss is not None and (which & ~here).any():
            self._cudss.factorise(values, which & ~here)
        for one, part in self._parts(here, len(values)):
            self._solver(one).factorise(np.array(values[part].numpy(), np.float64))

    @property
    def negative(self) -> NDArray[np.integer]:
        """Negative eigenvalues of each system's last factors, -1 where they are not known."""
        found = np.full(self.count, -1) if self._cudss is None else self._cudss.negative.copy()
        for one in np.flatnonzero(self._here):
            counted = self._solver(one).negative
            found[one] = -1 if counted is None else counted
        return found

    def solve(self, b: wp.array, x: wp.array, which: NDArray[np.bool_]) -> None:
        """Writes the solutions of the systems `which` into x; leaves the others' places alone."""
        here = which & self._here
        if self._cudss is not None and (which & ~here).any():
            self._cudss.solve(b, x, which & ~here)
        for one, part in self._parts(here, len(b)):
            x[part].assign(self._solver(one).solve(np.asarray(b[part].numpy(), np.float64)))

    def _parts(self, which: NDArray[np.bool_], length: int) -> Iterator[tuple[int, slice]]:
        """The systems `which`, and where each one's numbers lie among those of all."""
        each = length // self.count
        return ((one, slice(one * each, (one + 1) * each)) for one in np.flatnonzero(which).tolist())

    def _solver(self, one: int | np.integer) -> PardisoSolver | SuperLUSolver:
        solver = self._direct[one]
        assert solver is not None
        return solver


def single_threaded_blas():  # type: ignore[no-untyped-def]
    """A context in which NumPy's OpenBLAS stays on one thread: its idle threads spin, and the vectors here are too short to share."""
    return ThreadpoolController().select(internal_api="openblas").limit(limits=1)


_single: ContextVar[bool] = ContextVar("single", default=True)


@contextmanager
def float64_factors() -> Iterator[None]:
    """While it lasts, a new `SymmetricSystem` factorises in float64: for comparison, and where one solve must be exact."""
    token = _single.set(False)
    try:
        yield
    finally:
        _single.reset(token)


def make_solver(single: bool = False) -> PardisoSolver | SuperLUSolver:
    """The fastest solver that this machine has; `single`: of those that are good for Newton's steps only."""
    try:
        return PardisoSolver(single=single)
    except (ImportError, OSError):
        return SuperLUSolver()
