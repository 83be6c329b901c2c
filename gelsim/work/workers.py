"""Worker processes, of this machine (`LocalCrew`) or of a cluster (`gelsim.work.cluster`).

Each says when it has begun, and is then handed a few pieces of work at a time, so that it is known which of them ended it. It computes on
one thread unless given more: libraries would otherwise start a thread a core in every one. A worker that dies, or takes longer than
SECONDS, is replaced; a process whose parent is gone ends itself. Results do not depend on which worker made them, nor on how many there
are.

A worker that ends, or all that stand still at once, need not be their pieces' fault: of processes that share a GPU one's illegal access
ends all, and all were seen to stand still. All are replaced then, for the GPU's server takes nobody new before the last old one is gone.
Their pieces are put back behind the others; one that was in that LIVES - 1 times is done at the end, while nobody else works whom it could
take along, and is listed as lost if that fails too. No piece is charged for a worker that never began (a GPU's server takes no new clients
for some seconds after others were killed): it is started anew, after a pause. Only when nobody works, none has begun for PATIENCE, and
every place has been tried, the work ends.
"""

from __future__ import annotations

import ctypes
import math
import multiprocessing
import os
import sys
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, TypeVar

from gelsim.errors import GelsimError, SceneError

MOST_WORKERS = 1024
SECONDS = 1800.0
"""Allowed for a handful."""
STARTS, PATIENCE, PAUSE = 3, 30.0, 1.0
"""Workers that may end before they begin while nobody works; more of them only within so many seconds from the first, and each place with a
pause before it is tried anew."""
STILL = 90.0
"""Seconds without an answer from any of many workers, after which they count as standing still; twice that before the first answer, as
kernels are compiled then. For fewer than SECONDS / STILL busy ones it is SECONDS over their number, and once nothing is left to be handed
out twice what the slowest piece took: slow pieces are no standstill."""
QUIET, TIMES = 20.0, 40.0
"""The same of at least SECONDS / STILL workers that have all begun, while more is handed out: so many seconds, or so many times the mean
from one answer to the next, by what the last pieces took. On one H100 32 workers stood still every few minutes (docs/decisions/0007)."""

TOGETHER = 5.0
"""Seconds within which two workers that share a GPU end of one fault: the others are about to."""

SLEEP_WHILE_WAITING = 4
"""CU_CTX_SCHED_BLOCKING_SYNC of cuda.h."""
GONE = 1.0
"""Seconds that processes which were ended are waited for: off a GPU whose server has failed one may never get, and all others waited."""
LIVES = 3
"""Workers that may end, or stand still with all others, over one piece; the last one's end is told."""
MPS_SHARE = "CUDA_MPS_ACTIVE_THREAD_PERCENTAGE"
"""Per cent of a GPU's multiprocessors that a client of MPS may use; without MPS it does nothing."""

Handful = tuple[int, ...]
"""Numbers of pieces of work."""


class WorkError(GelsimError):
    """Work cannot go on: the disk is full, or no worker starts."""


T = TypeVar("T")
Work = Callable[[Handful], T]


class Died(Exception):
    """A worker that ended before it had begun, or before its handful was done; the message says how."""


class Worker(Protocol):
    """Does one handful at a time."""

    def give(self, handful: Handful) -> None:
        """Hands over work; returns at once."""

    def take(self) -> Any:
        """What it made, once it is ready; the first time only that it has begun. Raises Died."""

    def end(self) -> None:
        """Ends it, whatever it is at; returns at once."""

    def gone(self, until: float) -> None:
        """Waits until it has let go of what it held, or for that moment of the monotonic clock."""


class Crew(Protocol):
    """Where workers come from."""

    count: int

    def start(self, number: int, make: Callable[..., Work[Any]], arguments: tuple[Any, ...]) -> Worker:
        """A worker, fresh."""
        ...

    def ready(self, workers: Sequence[Any], timeout: float) -> Sequence[Worker]:
        """Those of `workers` that have something to be taken, or died; waits up to `timeout` seconds for the first."""
        ...


class LocalCrew:
    """Processes of this machine.

    Args:
        threads: Of each. What is computed may depend on it in the last digits, so it does not follow from `count`.
        gpus: CUDA devices; each worker sees one of them, and under NVIDIA's MPS has its share of the multiprocessors and no more, unless
            the caller's environment says another: kernels whose blocks wait for each other (cuDSS) stand still for ever where those of
            several processes each hold a part of the GPU and wait for more. An empty list: workers see no GPU. Of 32 that drew on cores
            beside two H200 nine had opened both GPUs, and never answered. None: they see what this process does.
    """

    def __init__(self, count: int, threads: int = 1, gpus: Sequence[str] | None = None) -> None:
        self.count, self.threads, self.gpus = count, threads, gpus

    def start(self, number: int, make: Callable[..., Work[Any]], arguments: tuple[Any, ...]) -> _Process:
        gpu = {} if self.gpus is None else {"CUDA_VISIBLE_DEVICES": ""}
        if self.gpus:
            share = max(100 // math.ceil(self.count / len(self.gpus)), 1)
            gpu = {"CUDA_VISIBLE_DEVICES": self.gpus[number % len(self.gpus)], MPS_SHARE: os.environ.get(MPS_SHARE, str(share))}
        return _Process(make, arguments, settings(self.threads) | gpu, bool(self.gpus))

    def ready(self, workers: Sequence[_Process], timeout: float) -> list[_Process]:
        pipes = wait([worker.pipe for worker in workers], timeout=timeout)
        return [worker for worker in workers if worker.pipe in pipes]


class _Process:
    def __init__(self, make: Callable[..., Work[Any]], arguments: tuple[Any, ...], environment: dict[str, str], on_gpu: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, make, arguments, os.getpid(), on_gpu), daemon=True)
        with in_environment(environment):
            self.process.start()
        other.close()

    def give(self, handful: Handful) -> None:
        try:
            self.pipe.send(handful)
        except OSError:
            pass  # it is dead already; taking from it will say so

    def take(self) -> Any:
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            self.process.join(GONE)
            raise Died(f"its process ended with code {self.process.exitcode}") from None

    def end(self) -> None:
        self.process.kill()
        self.pipe.close()

    def gone(self, until: float) -> None:
        self.process.join(max(until - time.monotonic(), 0.0))
        if self.process.exitcode is None:  # Python would wait for it at its own end
            multiprocessing.process._children.discard(self.process)  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]


@dataclass
class _Place:
    """One of a crew's, and what its worker is at: to begin, a handful, or nothing."""

    worker: Worker
    since: float
    begun: bool = False
    handful: Handful | None = None
    again: float | None = None
    """When another worker may be started here; None while there is one."""

    @property
    def busy(self) -> bool:
        return self.again is None and (self.handful is not None or not self.begun)


def work_through(
    handfuls: Sequence[Handful],
    crew: Crew,
    make: Callable[..., Work[T]],
    arguments: tuple[Any, ...],
    lost: Callable[[Handful, str, str], T],
    still: bool = False,
    seconds: float = SECONDS,
) -> Iterator[T]:
    """Lets a crew do all handfuls; yields each as it is done, in whatever order.

    Args:
        make: A function of a module that makes, from `arguments`, what does the work; called once in each worker.
        lost: Says what becomes of a handful (status, message) whose workers died or took too long.
        still: Whether all are replaced when nobody answers for long (STILL, QUIET), or two end TOGETHER, each over a piece that ended none
            before: for workers that share a GPU. Those of several GPUs count as of one.
        seconds: Allowed for a handful. One that takes longer is lost, or where workers share a GPU, which may have stopped, done anew.
    Raises:
        WorkError: Workers end before they begin.
    """
    left, alone, troubles = deque(handfuls), deque[Handful](), Counter[Handful]()
    places: list[_Place] = []
    unborn, since_unborn, failed = Counter[int](), 0.0, ""  # by place, since the last answer
    answered, deaths = time.monotonic(), deque[float](maxlen=2)
    took, slowest = deque[float](maxlen=100), 0.0  # seconds of the last pieces of this crew; of any piece
    try:
        for number in range(min(crew.count, len(left))):
            places.append(_Place(crew.start(number, make, arguments), time.monotonic()))
        while left or alone or any(place.handful is not None for place in places):
            now = time.monotonic()
            for number, place in enumerate(places):
                if place.again is not None and place.again <= now and (left or alone):
                    places[number] = _Place(crew.start(number, make, arguments), now)
            busy = [place for place in places if place.busy]
            if not busy:
                time.sleep(0.1)
                continue
            ready = crew.ready([place.worker for place in busy], timeout=1.0)
            now = time.monotonic()
            quiet = 0.0 if ready else now - answered
            all_of_them = None
            if still and len(deaths) == 2 and deaths[1] - deaths[0] < TOGETHER:
                all_of_them = "DIED", "others that share its GPU ended"
            elif still and quiet > max(_allowed(busy, took, seconds), 0.0 if left else 2.0 * slowest):
                all_of_them = "TIMEOUT", f"no worker answered for {quiet:.0f} s"
            if all_of_them:  # who has answered is heard first
                _end([place for place in places if place.again is None and place.worker not in ready])
            for number, place in enumerate(places):
                if place.again is not None:
                    continue
                trouble, innocent = all_of_them, True
                if place.busy and place.worker in ready:
                    try:
                        done = place.worker.take()
                    except Died as died:
                        trouble = "DIED", str(died)
                        if place.handful is not None and not troubles[place.handful]:  # a piece that ends its worker says nothing again
                            deaths.append(time.monotonic())
                    else:
                        answered = time.monotonic()
                        unborn.clear()
                        if place.begun:
                            took.append(answered - place.since)
                            slowest = max(slowest, took[-1])
                            place.handful = None
                            yield done
                        place.begun = True
                elif place.busy and now - place.since > seconds:
                    trouble, innocent = ("TIMEOUT", f"not done after {seconds:g} s"), still
                if trouble:
                    if not all_of_them or place.worker in ready:
                        _end([place])
                    handful, place.handful, place.again = place.handful, None, now + PAUSE
                    if handful is not None:
                        troubles[handful] += 1
                        if not innocent or troubles[handful] == LIVES:
                            yield lost(handful, *trouble)
                        else:
                            (alone if troubles[handful] == LIVES - 1 else left).append(handful)
                    elif not place.begun:
                        since_unborn = since_unborn if unborn else now
                        unborn[number] += 1
                        failed = trouble[1]
                elif not place.busy and (left or (alone and not any(other.handful is not None for other in places))):
                    place.handful, place.since = (left or alone).popleft(), time.monotonic()
                    place.worker.give(place.handful)
            if all(place.again is not None for place in places):  # who begins anew may take as long as at first
                answered = time.monotonic()
                took.clear()
                deaths.clear()
            nobody = not any(place.handful is not None for place in places) and len(unborn) == len(places)
            if (left or alone) and nobody and unborn.total() >= STARTS and now - since_unborn > PATIENCE:
                raise WorkError(f"{unborn.total()} workers ended before they had begun; the last: {failed}")
    finally:
        _end(places)


def _end(some: Sequence[_Place]) -> None:
    """Ends their workers: all before the first is waited for, as a process may not get off a GPU before those that share it are gone."""
    for place in some:
        place.worker.end()
    until = time.monotonic() + GONE
    for place in some:
        place.worker.gone(until)


def _allowed(busy: Sequence[_Place], took: Sequence[float], seconds: float) -> float:
    """Seconds without any answer that are no standstill, by what pieces took since the crew began; `seconds` are allowed for each."""
    if len(busy) >= SECONDS / STILL and len(took) >= len(busy) and all(place.begun for place in busy):
        return max(QUIET, TIMES * sum(took) / len(took) / len(busy))
    return max(STILL, seconds / len(busy)) * (1 if took else 2)


def check_count(workers: int) -> None:
    """Raises SceneError where nobody, or too many, would work."""
    if not 1 <= workers <= MOST_WORKERS:
        raise SceneError(f"--workers {workers}: allowed is 1 … {MOST_WORKERS}")


def load_average() -> float | None:
    """Of this machine in the last minute; None where the system does not say."""
    return round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None


def settings(threads: int) -> dict[str, str]:
    """Environment of a process that shall compute on so many threads."""
    names = {"OMP_NUM_THREADS": str(threads), "MKL_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    # A parent that has pressed left it the layer of its own threads (`fem.linear.PardisoSolver`).
    return names | {"MKL_THREADING_LAYER": "SEQUENTIAL"} if threads == 1 else names


@contextmanager
def in_environment(names: dict[str, str]) -> Iterator[None]:
    """A process that is started in here finds these in its environment, before any library looks for them."""
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(names)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def wait_asleep() -> None:
    """This process sleeps while it waits for its GPU; by CUDA's default it spins, and takes the core from one that has work.

    To be called before anything uses CUDA; without it, or where it refuses, nothing happens.
    """
    try:
        cuda = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return
    if cuda.cuInit(0) == 0:
        cuda.cuDevicePrimaryCtxSetFlags_v2(ctypes.c_int(0), ctypes.c_uint(SLEEP_WHILE_WAITING))


def _serve(pipe: Connection, make: Callable[..., Work[Any]], arguments: tuple[Any, ...], parent: int, on_gpu: bool) -> None:
    end_with(parent)
    if on_gpu:
        wait_asleep()
    try:
        with _a_fault_ends_it():
            work = make(*arguments)
        pipe.send(None)
        while True:
            handful = pipe.recv()
            with _a_fault_ends_it():
                done = work(handful)
            pipe.send(done)
    except (EOFError, OSError, KeyboardInterrupt):  # of the pipe: whoever gave the work is gone
        return


@contextmanager
def _a_fault_ends_it() -> Iterator[None]:
    """At once: after a fault of the GPU this process would stand still on its way out, and with it the crew."""
    try:
        yield
    except Exception:
        with suppress(Exception):
            traceback.print_exc()
            sys.stderr.flush()
        os._exit(1)


def end_with(parent: int) -> None:
    """Ends this process, some half a second later, when its parent is no more: a killed run leaves nobody at work."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
