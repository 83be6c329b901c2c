"""Many presses at once: scenes with the same meshes, their Newton iterations side by side in one launch each.

Every scene runs the same march as a press by itself (quasistatic.py), as a generator; what it asks for is solved here. A tick is one Newton
iteration of every scene that is at work, whatever its load step: contact, forces, matrices and steps of all scenes together, decisions
(converged? chord step? how far along the step?) by vectors with an entry a scene. No scene waits for another, and one that is done leaves.

Newton's rules are those of newton.py but for the steps: on a GPU a solve costs a thirtieth of a factorisation, so GMRES on the factors of
an earlier iteration finds each step (krylov.py), roughly, and a scene gets new factors only when that takes too long.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gelsim.errors import SolveStatus
from gelsim.fem.assembly import Solids
from gelsim.fem.batch_kernels import LANES, balance, largest, move, positions, stiffen, work
from gelsim.fem.contact import SurfaceContact
from gelsim.fem.krylov import BatchedGmres, add_lanes, multiply
from gelsim.fem.linear import SHIFTS, BatchedSystem, single_threaded_blas
from gelsim.fem.newton import (
    GEOMETRIC_BELOW,
    LARGEST_GROWTH,
    LINE_SEARCH_DROP,
    MAX_LINE_SEARCH,
    SMALLEST_JACOBIAN,
    NewtonReport,
    forgotten,
    spent,
    stalls,
)
from gelsim.fem.pattern import PairPattern, SymmetricPattern, build_pattern, pair_keys
from gelsim.fem.problem import PressProblem
from gelsim.fem.quasistatic import Course, Request, march_press
from gelsim.results import Deformation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FORCING = 0.1
"""|R + K step|/|R| to which a step is solved; a scene whose factor does not bring it there in time gets a new one for its next step."""
EXACT = 1e-6
"""… where rough steps did not help."""
SETTLED_AFTER = 6
"""Iterations with rough steps."""
POOR = 0.5
"""… above which the step is not taken but solved anew at once."""
REACH_MM = 2.0
"""Bounds the search for contact. All that is found has its place in the matrix, as a new order costs all scenes."""


@dataclass
class Costs:
    """Where the time of a batch goes: wall seconds by stage, and how often each stage ran. Measuring makes the device wait after each."""

    seconds: dict[str, float] = field(default_factory=dict)
    calls: dict[str, int] = field(default_factory=dict)
    systems: dict[str, int] = field(default_factory=dict)
    """Systems factorised and solved: of a call only the scenes that need it."""
    unknowns: int = 0
    matrix_entries: int = 0
    """Of one scene's upper triangle."""
    factor_entries: int = 0
    """Of one scene's factor, 0 where the solver does not say."""
    element_bytes: int = 0
    """What an assembly reads of one scene's elements."""


def copy_bandwidth(device: str) -> float:
    """Bytes a second of a large copy on a device, read and written: what a computation bound by memory can hope for."""
    count = 1 << (27 if wp.get_device(device).is_cuda else 23)
    a, b = (wp.zeros(count, dtype=wp.float64, device=device) for _ in range(2))
    best = np.inf
    for _ in range(5):
        wp.synchronize_device(device)
        start = time.perf_counter()
        wp.copy(a, b)
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - start)
    return 16.0 * count / best


def capture(launches: Callable[[], None], device: str) -> Callable[[], None]:
    """Records launches as a CUDA graph; what is returned runs them again, on the arrays and numbers that they had."""
    with wp.ScopedCapture(device=device) as captured:
        launches()
    return partial(wp.capture_launch, captured.graph)


def run_batch(
    problems: Sequence[PressProblem], *, courses: Sequence[Course] = (), progress: Callable[[int, int], None] | None = None,
    states: Callable[[int, int], None] | None = None, costs: Costs | None = None,
) -> list[Deformation]:  # fmt: skip
    """Solves presses whose meshes have the same elements; a press that fails says so in its `status`.

    Args:
        courses: Of each press, where it has several tries, what this one goes on from and what it leaves.
        progress: Called with (presses done, presses).
        states: Called with (states recorded, states wanted) of the first press.
        costs: Filled with where the time went.
    Raises:
        ValueError: The meshes differ.
    """
    batch = _Batch(problems, costs, courses)
    with single_threaded_blas():
        return batch.run(progress, states)


@dataclass
class _Residual:
    """Of every scene, by names of newton.Residual."""

    imbalance: Array
    volume_error: Array
    min_jacobian: Array
    finite: Mask
    work: Array
    """Of the equations on the step."""
    slope: Array
    """The same where the step began."""

    @property
    def size(self) -> Array:
        return np.maximum(self.imbalance, self.volume_error)


class _Batch:
    """The scenes' common arrays, and where each scene's Newton stands."""

    def __init__(self, problems: Sequence[PressProblem], costs: Costs | None, courses: Sequence[Course] = ()) -> None:
        self.costs, self.courses = costs, courses or [Course() for _ in problems]
        first = problems[0]
        for problem in problems:
            same = (problem.solids.tets, first.solids.tets), (problem.solids.free, first.solids.free)
            faces = (problem.contact.slave_faces, first.contact.slave_faces), (problem.contact.master_faces, first.contact.master_faces)
            if not all(np.array_equal(a, b) for a, b in (*same, *faces)):
                raise ValueError("the presses of a batch must have the same meshes")
        self.problems, self.count = problems, len(problems)
        self.solids = Solids.join([problem.solids for problem in problems])
        self.contact = SurfaceContact.join([problem.contact for problem in problems])
        self.system = BatchedSystem(self.count, self.solids.device)
        for problem in problems:
            problem.linear_solver = self.system.name
        self.pattern: SymmetricPattern | None = None
        self.nodes, self.unknowns = first.solids.node_count, first.solids.unknowns
        self._single = first.solids
        self._coupled = self._single.keys

        device, total = self.solids.device, self.solids.node_count
        self.equation = wp.array(self.solids.equation, dtype=wp.int32, device=device)
        self.vertex_volume = wp.array(self.solids.vertex_volume, dtype=wp.float64, device=device)
        self.x, self.start_u, self.internal, self.external = (wp.zeros(total, dtype=wp.vec3d, device=device) for _ in range(4))
        self.start_p, self.volume = (wp.zeros(total, dtype=wp.float64, device=device) for _ in range(2))
        length = self.count * self.unknowns
        self.equations, self.step = (wp.zeros(length, dtype=wp.float64, device=device) for _ in range(2))
        self.fraction, self.share = (wp.zeros(self.count, dtype=wp.float64, device=device) for _ in range(2))
        # by lane and by scene what `_Residual` is made of: six maxima, then the work on the step here; by scene also that where it began
        self.lane_sizes = wp.zeros((7, self.count * LANES), dtype=wp.float64, device=device)
        self.sizes = wp.zeros((8, self.count), dtype=wp.float64, device=device)
        self.start_pairing = self.contact.pairing()
        self._record = capture if wp.get_device(device).is_cuda else None
        self._graphs: dict[str, Callable[[], None] | None] = {}
        self._sent: dict[int, Array] = {}
        self.gmres = BatchedGmres(self.count, self.unknowns, str(device))

        # Newton's state of every scene
        self.goal = np.full(self.count, np.inf)
        self.iteration, self.down = np.zeros(self.count, int), np.zeros(self.count, int)
        self.solves = np.zeros(self.count, bool)
        self.factorisations = np.zeros(self.count, int)
        self.sizes_seen: list[list[float]] = [[] for _ in problems]
        """Residuals of each scene's present solve."""
        self.exact_after = np.array([problem.options.exact_after for problem in problems])
        self.inverted, self.whole = np.zeros(self.count, bool), np.zeros(self.count, bool)
        self.options = [problem.options for problem in problems]
        """Of each scene's present solve."""
        self.stiffened = np.zeros(self.count, int)
        """Which of SHIFTS was the last to be needed."""
        self.downhill = np.zeros(self.count, bool)
        """Whose present step leads down from a saddle; `down` counts those of a solve."""
        self.old = np.zeros(self.count, bool)
        """Whose factor served GMRES badly the last time."""
        self.moved = np.zeros(self.count, bool)
        """Who had a matrix of which only the CPU's factors were of use."""

    def run(self, progress: Callable[[int, int], None] | None, states: Callable[[int, int], None] | None) -> list[Deformation]:
        """Drives all marches to their ends."""
        told = [states, *[None] * (self.count - 1)]
        marches = [march_press(*each, progress=one) for *each, one in zip(self.problems, self.courses, told, strict=True)]
        done: list[Deformation | None] = [None] * self.count
        for scene, march in enumerate(marches):
            self._take(scene, next(march))
        active = np.ones(self.count, bool)
        residual = self.residual()
        while active.any():
            while True:
                moved = False
                for scene in np.flatnonzero(active):
                    report = self._ended(scene, residual)
                    if report is None:
                        continue
                    try:
                        with self._stage("march"):
                            request = marches[scene].send(report)
                    except StopIteration as end:
                        press, active[scene] = end.value, False
                        if self.moved[scene]:
                            press = press.warned(f"{self.system.name}: factors of some matrices were of no use; those had the CPU's")
                        done[scene] = press
                        if progress is not None:
                            progress(int((~active).sum()), self.count)
                        continue
                    self._take(scene, request)
                    moved = True
                if not moved:
                    break
                residual = self.residual()
            if active.any():
                residual = self.iterate(active, residual)
        assert all(press is not None for press in done)
        return done  # type: ignore[return-value]

    def _take(self, scene: int, request: Request) -> None:
        """Begins what a march asks for."""
        options = self.problems[scene].options
        self.options[scene] = options = options.brief if request.brief else options
        self.goal[scene] = request.tolerance or options.tolerance
        self.solves[scene] = request.solve
        self.iteration[scene] = self.down[scene] = self.factorisations[scene] = 0
        self.inverted[scene], self.sizes_seen[scene] = False, []
        self.whole[scene] = request.whole

    def _ended(self, scene: int, residual: _Residual) -> NewtonReport | None:
        """Whether, and how, a scene's Newton has ended."""
        iteration, size = int(self.iteration[scene]), float(residual.size[scene])
        self.sizes_seen[scene][iteration:] = [size]
        status, options = None, self.options[scene]
        if self.inverted[scene]:
            status = SolveStatus.INVERTED_ELEMENT
        elif not residual.finite[scene]:
            status = SolveStatus.NONFINITE
        elif iteration > 0 and size <= self.goal[scene]:
            status = SolveStatus.CONVERGED
        elif not self.solves[scene] or spent(iteration, int(self.down[scene]), options) or stalls(self.sizes_seen[scene], options):
            status = SolveStatus.MAX_ITERATIONS
        if status is None:
            return None
        jacobian, factorisations = float(residual.min_jacobian[scene]), int(self.factorisations[scene])
        return NewtonReport(status, iteration, size, jacobian, factorisations, bool(self.down[scene]))

    def residual(self, fraction: Array | None = None) -> _Residual:
        """Contact and equations of all scenes at their present states, or at a fraction of each one's step."""
        with self._stage("residual"):
            if fraction is None:
                self._replay("residual", self._residual)
            else:
                self._send(self.fraction, -fraction)
                self._replay("trial", self._trial)
            unbalanced, external, internal, volume, turned, broken, work, slope = self.sizes.numpy().copy()
        scale = np.maximum(np.maximum(external, internal * 1e-3), 1e-9)
        return _Residual(unbalanced / scale, volume, -turned, broken == 0.0, work, slope)

    def _residual(self) -> None:
        solids, device = self.solids, self.solids.device
        wp.launch(positions, solids.node_count, [solids.rest_positions, solids.displacement, self.x], device=device)
        for array in (self.internal, self.external, self.volume):
            array.zero_()
        self.contact.update(self.x, REACH_MM)
        self.contact.add_force(self.x, self.external)
        solids.add_internal_force(self.internal, self.volume)
        forces = [self.internal, self.external, self.volume, self.vertex_volume, self.equation, self.nodes]
        cells = [solids.element_jacobian, len(solids.tets) // self.count, LANES]
        wp.launch(balance, self.count * LANES, [*forces, *cells, self.step, self.equations, self.lane_sizes], device=device)
        wp.launch(largest, (6, self.count), [LANES, self.lane_sizes, self.sizes], device=device)
        wp.launch(add_lanes, (1, self.count), [LANES, self.lane_sizes[6:], self.sizes[6:]], device=device)

    def _replay(self, name: str, launches: Callable[[], None]) -> None:
        """Runs launches; on CUDA they are recorded the second time, and run as a graph from then on."""
        if self._record is None or name not in self._graphs:  # the first time kernels are loaded
            launches()
            self._graphs[name] = None
            return
        graph = self._graphs[name]
        if graph is None:
            graph = self._graphs[name] = self._record(launches, self.solids.device)
        graph()

    def _send(self, array: wp.array, numbers: Array) -> None:
        """Writes numbers, one a scene, to an array of the device that is written here alone; not where they stand there already."""
        if not np.array_equal(self._sent.get(id(array), []), numbers):
            array.assign(numbers)
            self._sent[id(array)] = numbers

    def iterate(self, active: Mask, residual: _Residual) -> _Residual:
        """One Newton iteration of the active scenes: steps by GMRES on the factors there are, by new ones where those are too old."""
        near = residual.imbalance < GEOMETRIC_BELOW
        self._assemble(near)
        # a scene that does not get there soon goes on with steps of its own factors, solved to the end
        self.old |= self.iteration >= SETTLED_AFTER
        self._factorise(active & (self.old | ~self.system.factored))
        exact = active & (self.iteration >= self.exact_after)
        steep = wp.clone(self.values) if exact.any() else self.values
        self._convexify(exact, steep, near)
        poor = self._solve(active)
        if poor.any():
            self._factorise(poor)
            poor = self._solve(poor)
        if poor.any() and (useless := self.system.distrust(self._useless(poor))).any():
            self.moved |= useless
            self._factorise(useless)
            self._solve(useless)
        self._shorten(exact & near, steep, near)
        self.downhill &= near
        self.down += self.downhill
        for scene in np.flatnonzero(self.downhill):
            self.sizes_seen[scene] = forgotten(self.sizes_seen[scene], self.options[scene])
        after = self._line_search(active, residual)
        self.iteration[active] += 1
        return after

    def _assemble(self, near: Mask) -> None:
        """Tangents of all scenes; makes the pattern grow where it must, and then no factor is left."""
        self._send(self.contact.geometric, near.astype(float))
        for _ in range(2):
            if self.pattern is not None:
                with self._stage("tangent"):
                    self._replay("tangent", self._tangent)
                    missing = int(self.contact.missing.numpy()[0])
                if missing == 0:
                    return
            with self._stage("pattern"):
                self._grow()
        raise AssertionError("the pattern made from the present contact does not hold it")

    def _factorise(self, wanted: Mask) -> None:
        if wanted.any():
            with self._stage("factorise", int(wanted.sum())):
                self.system.factorise(self.values, wanted)
            self.factorisations[wanted] += 1
            self.old[wanted] = False

    def _convexify(self, wanted: Mask, values: wp.array, near: Mask) -> None:
        """Stiffens the matrices of the wanted scenes, with these `values` and factors of them, until they are of saddles no more.

        With `_shorten` it is linear.SymmetricSystem._down.
        """
        saddle = wanted & self._at_saddle() if wanted.any() else wanted
        self.downhill, number = saddle.copy(), np.maximum(self.stiffened - 1, 0)
        self._shares = np.zeros(self.count)
        while saddle.any():
            self._stiffen(saddle, number, values)
            number = number + 1
            saddle &= self._at_saddle() & (number < len(SHIFTS))
        self._send(self.contact.geometric, (near & ~self.downhill).astype(float))

    def _shorten(self, wanted: Mask, values: wp.array, near: Mask) -> None:
        """Solves again where a step leads up, or farther than the normal there holds, of the wanted scenes."""
        if not wanted.any():
            return
        number = np.where(self.downhill, self.stiffened + 1, np.maximum(self.stiffened - 1, 0))
        reach = self.contact.turns_within
        while True:
            self._start_search()
            step = np.abs(self.step.numpy().reshape(self.count, -1)[:, self._moves]).max(axis=1)
            up = wanted & ~self.downhill & (self.sizes.numpy()[7] < 0.0)
            far = wanted & ~up & (step > reach) & (number < len(SHIFTS))
            if not (up | far).any():
                return
            self.downhill |= up | far
            if far.any():
                self._stiffen(far, number, values)
            number = number + far
            self._send(self.contact.geometric, (near & ~self.downhill).astype(float))
            self._solve(up | far)

    def _stiffen(self, wanted: Mask, number: NDArray[np.integer], values: wp.array) -> None:
        """Factors of scenes' matrices, stiffened by the shifts of these numbers."""
        self._shares[wanted] = np.array(SHIFTS)[number[wanted]]
        self._send(self.share, self._shares.copy())
        inputs = [values, self._stiff, len(values) // self.count, self.share, self.values]
        wp.launch(stiffen, (self.count, len(self._stiff)), inputs, device=self.solids.device)
        self._factorise(wanted)
        self.stiffened[wanted] = number[wanted]

    def _at_saddle(self) -> Mask:
        return self.system.negative > self._single.free[:, 3].sum()

    def _useless(self, poor: Mask) -> Mask:
        """Of scenes whose steps are poor those whose factors, new ones, do not even answer their own matrices: slip is no excuse."""
        answer, product = wp.zeros_like(self.equations), wp.zeros_like(self.equations)
        self.system.solve(self.equations, answer, poor)
        self._multiply(answer, product)
        b, found = (array.numpy().reshape(self.count, -1) for array in (self.equations, product))
        return poor & ~(np.linalg.norm(b - found, axis=1) <= POOR * np.linalg.norm(b, axis=1))

    def _solve(self, wanted: Mask) -> Mask:
        """Steps of the wanted scenes; returns those whose factors were of no use."""
        forcing = np.where(self.iteration < SETTLED_AFTER, FORCING, EXACT)
        with self._stage("solve"):
            used, left = self.gmres.solve(self._product, self.system.solve, self.equations, self.step, wanted, forcing)
        if self.costs is not None:
            self.costs.systems["solve"] = self.costs.systems.get("solve", 0) + int(used.sum())
        self.old |= wanted & ~(left <= forcing)
        return wanted & ~(left <= POOR)

    def _product(self, v: wp.array, out: wp.array) -> None:
        """The whole tangents' products with v, contact's unsymmetric part included."""
        self._multiply(v, out)
        self.contact.add_remainder(self.x, self.equation, v, out)

    def _multiply(self, v: wp.array, out: wp.array) -> None:
        out.zero_()
        wp.launch(multiply, len(v), [self._start, self._column, self.values, self.unknowns, v, out], device=self.solids.device)

    def _grow(self) -> None:
        """Makes a pattern that holds the present contact of all scenes, what may come, and what there was: it may come back."""
        gel, body = self.contact.node_pairs(REACH_MM)
        self._coupled = np.union1d(self._coupled, pair_keys(gel, body, self.nodes))
        self.pattern = build_pattern(self._single.free, self._coupled, self.solids.device)
        self._pairs = repeat_pairs(self.pattern, self.count)
        self.values = wp.zeros(self.count * len(self.pattern.indices), dtype=wp.float64, device=self.solids.device)
        self._graphs.pop("tangent", None)
        self.solids.entries(self._pairs)  # now: a graph that is recorded may not allocate
        self.system.analyse(self.pattern.indptr, self.pattern.indices)
        device = self.solids.device
        self._start, self._column = (wp.array(a, dtype=wp.int32, device=device) for a in (self.pattern.indptr, self.pattern.indices))
        single = self._single
        displacements = single.equation[:, :3][single.free[:, :3]]
        self._moves = displacements
        self._stiff = wp.array(self.pattern.indptr[displacements], dtype=wp.int32, device=device)
        if self.costs is not None:
            self.costs.unknowns, self.costs.matrix_entries = self.unknowns, len(self.pattern.indices)
            self.costs.factor_entries = self.system.factor_entries
            self.costs.element_bytes = self._single.element_bytes

    @contextmanager
    def _stage(self, name: str, systems: int = 0) -> Iterator[None]:
        costs = self.costs
        if costs is None:
            yield
            return
        start = time.perf_counter()
        yield
        wp.synchronize_device(self.solids.device)
        costs.seconds[name] = costs.seconds.get(name, 0.0) + time.perf_counter() - start
        costs.calls[name] = costs.calls.get(name, 0) + 1
        costs.systems[name] = costs.systems.get(name, 0) + systems

    def _tangent(self) -> None:
        self.values.zero_()
        self.contact.missing.zero_()
        self.contact.add_stiffness(self.x, self._pairs, self.values)
        self.solids.add_tangent(self._pairs, self.values)

    def _line_search(self, active: Mask, before: _Residual) -> _Residual:
        """newton.Newton._line_search, scene by scene: each is moved to where the work of the unbalanced forces has shrunk."""
        largest_size = np.where((self.iteration >= SETTLED_AFTER) & ~self.downhill, LARGEST_GROWTH * before.size, np.inf)
        lengthens = self.downhill.copy()
        self._start_search()
        searching, fraction = active.copy(), active.astype(float)
        low, high = np.zeros(self.count), np.full(self.count, np.nan)
        low_slope, high_slope = np.zeros(self.count), np.zeros(self.count)
        for trial in range(MAX_LINE_SEARCH):
            residual = self.residual(fraction)
            slope, now = -residual.slope, -residual.work
            if trial == 0:
                searching &= np.isfinite(slope)
                low_slope = slope.copy()
            impossible = (residual.min_jacobian <= SMALLEST_JACOBIAN) | ~residual.finite
            bad = impossible | ~(residual.size <= largest_size)
            last = trial == MAX_LINE_SEARCH - 1
            for scene in np.flatnonzero(searching):
                s, f = slope[scene], fraction[scene]
                if bad[scene]:
                    if impossible[scene] and self.whole[scene] and self.iteration[scene] == 0:
                        searching[scene] = False
                    elif not last:
                        lengthens[scene] = False
                        high[scene], high_slope[scene], fraction[scene] = np.nan, 0.0, low[scene] + 0.5 * (f - low[scene])
                    continue
                w = now[scene]
                if s >= 0 or abs(w) <= LINE_SEARCH_DROP * abs(s) or (w < 0 and f == 1.0 and not lengthens[scene]):
                    searching[scene] = False
                    continue
                if w < 0:
                    low[scene], low_slope[scene] = f, w
                    high_slope[scene] *= 0.5
                else:
                    high[scene], high_slope[scene] = f, w
                    low_slope[scene] *= 0.5 if low[scene] > 0 else 1.0
                if np.isnan(high[scene]) and lengthens[scene]:
                    fraction[scene] *= 1.0 if last else 2.0
                elif np.isnan(high[scene]):
                    searching[scene] = False
                elif not last:
                    share = low_slope[scene] / (low_slope[scene] - high_slope[scene])
                    fraction[scene] = low[scene] + (high[scene] - low[scene]) * min(max(share, 0.05), 0.95)
            if not searching.any():
                break
        lost = active & (impossible | ~np.isfinite(slope))
        if lost.any():
            self.inverted |= lost
            self._send(self.fraction, -np.where(lost, 0.0, fraction))
            self._move()
        return residual

    def _start_search(self) -> None:
        """Keeps where a step begins, and the work on it there; `step` is minus the step."""
        solids = self.solids
        wp.copy(self.start_u, solids.displacement)
        wp.copy(self.start_p, solids.pressure)
        self.contact.copy_pairing(self.start_pairing)
        inputs = [self.equations, self.step, self.equation, self.nodes, LANES, self.lane_sizes[6]]
        wp.launch(work, self.count * LANES, inputs, device=solids.device)
        wp.launch(add_lanes, (1, self.count), [LANES, self.lane_sizes[6:], self.sizes[7:]], device=solids.device)

    def _trial(self) -> None:
        self._move()
        self._residual()

    def _move(self) -> None:
        """Goes to `fraction` of the step, with the pairs that it began with."""
        solids = self.solids
        inputs = [self.start_u, self.start_p, self.step, self.fraction, self.equation, self.nodes, solids.displacement, solids.pressure]
        wp.launch(move, solids.node_count, inputs, device=solids.device)
        self.contact.set_pairing(self.start_pairing)


def repeat_pairs(pattern: SymmetricPattern, count: int) -> PairPattern:
    """The node pairs of `count` scenes that share a pattern; values and nodes of one after those of the other."""
    one, pairs = pattern.pairs, PairPattern()
    nodes, values = len(pattern.equation), len(pattern.indices)
    shift = np.arange(count, dtype=np.int32)[:, None]
    column, row = one.column.numpy(), one.row.numpy()
    arrays = {
        "local": np.tile(one.local.numpy(), (count, 1)),
        "count": np.tile(one.count.numpy(), count),
        "base": (one.base.numpy() + shift * values).ravel(),
        "width": np.tile(one.width.numpy(), count),
        "row": np.append((row[:-1] + shift * len(column)).ravel(), count * len(column)),
        "column": (column + shift * nodes).ravel(),
        "offset": np.tile(one.offset.numpy(), count),
    }
    for name, array in arrays.items():
        setattr(pairs, name, wp.array(np.ascontiguousarray(array, np.int32), dtype=wp.int32, device=one.local.device))
    return pairs
