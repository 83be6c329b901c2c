"""Local worker processes: each is handed a few pieces of work at a time, so that it is known which of them ended a worker.

A worker computes on one thread unless it is given more: libraries would otherwise start a thread a core in each of them. Several GPUs are
given to workers in turn.
A worker that dies, or takes longer than SECONDS, is replaced and its pieces are listed; a worker whose parent is gone ends itself. Results
do not depend on which worker made them, nor on how many there are.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from gelsim.errors import GelsimError

SECONDS = 1800.0
"""Allowed for a handful."""
STARTS = 3
"""Workers that may die before they did anything, one after the other."""

Handful = tuple[int, ...]
"""Numbers of pieces of work."""


class WorkError(GelsimError):
    """Work cannot go on: the disk is full, or no worker starts."""


T = TypeVar("T")
Work = Callable[[Handful], T]


class _Worker:
    def __init__(self, make: Callable[..., Work[Any]], arguments: tuple[Any, ...], environment: dict[str, str]) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, make, arguments, os.getpid()), daemon=True)
        with _environment(environment):
            self.process.start()
        other.close()
        self.handful: Handful | None = None
        self.since = time.monotonic()
        self.worked = False

    def give(self, handful: Handful) -> None:
        self.handful, self.since = handful, time.monotonic()
        try:
            self.pipe.send(handful)
        except OSError:
            pass  # it is dead already; waiting for it will say so

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def work_through(
    handfuls: Sequence[Handful],
    count: int,
    make: Callable[..., Work[T]],
    arguments: tuple[Any, ...],
    lost: Callable[[Handful, str, str], T],
    threads: int = 1,
    gpus: Sequence[str] = (),
) -> Iterator[T]:
    """Lets `count` processes do all handfuls; yields each as it is done, in whatever order.

    Args:
        make: A function of a module that makes, from `arguments`, what does the work; called once in each process.
        lost: Says what becomes of a handful (status, message) whose process died or took too long.
        threads: Of each process. What is computed may depend on it in the last digits, so it does not follow from `count`.
        gpus: CUDA devices; each worker sees one of them.
    Raises:
        WorkError: Workers die before they begin.
    """
    left = deque(handfuls)

    def start(number: int) -> _Worker:
        return _Worker(make, arguments, _settings(threads, gpus[number % len(gpus)] if gpus else None))

    workers = [start(number) for number in range(min(count, len(left)))]
    still_born = 0
    try:
        for worker in workers:
            worker.give(left.popleft())
        while busy := [worker for worker in workers if worker.handful is not None]:
            ready = wait([worker.pipe for worker in busy], timeout=1.0)
            for worker in busy:
                died, late = None, time.monotonic() - worker.since > SECONDS
                if worker.pipe in ready:
                    try:
                        done = worker.pipe.recv()
                    except (EOFError, OSError):
                        worker.process.join(10.0)
                        died = f"its process ended with code {worker.process.exitcode}"
                    else:
                        still_born, worker.worked, worker.handful = 0, True, None
                        yield done
                elif not late:
                    continue
                if died or (late and worker.handful is not None):
                    assert worker.handful is not None
                    still_born += 0 if worker.worked else 1
                    if still_born >= STARTS:
                        raise WorkError(
                            f"{STARTS} worker processes ended before they had done anything; the last: {died or 'took too long'}"
                        )
                    worker.end()
                    yield lost(worker.handful, "DIED" if died else "TIMEOUT", died or f"not done after {SECONDS:g} s")
                    number = workers.index(worker)
                    workers[number] = worker = start(number)
                if left and worker.handful is None:
                    worker.give(left.popleft())
    finally:
        for worker in workers:
            worker.end()


def _settings(threads: int, gpu: str | None) -> dict[str, str]:
    names = {"OMP_NUM_THREADS": str(threads), "MKL_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    if threads == 1:
        names["MKL_THREADING_LAYER"] = "SEQUENTIAL"
    return names if gpu is None else names | {"CUDA_VISIBLE_DEVICES": gpu}


@contextmanager
def _environment(names: dict[str, str]) -> Iterator[None]:
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


def _serve(pipe: Connection, make: Callable[..., Work[Any]], arguments: tuple[Any, ...], parent: int) -> None:
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    work = make(*arguments)
    while True:
        try:
            handful = pipe.recv()
            pipe.send(work(handful))
        except (EOFError, OSError):
            return
        except KeyboardInterrupt:
            return


def _end_with(parent: int) -> None:
    """Ends this process when its parent is no more: a killed run leaves nobody at work."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
