"""A child process that measures cases one after the other, each within a time and all within a memory: what hangs or grows is ended.

The child imports and compiles once; after it was ended a new one is started for the next case. It ends with its parent. In a worker process
(`gelsim.work.workers`), whose time is bounded by who started it, there is no child: the worker's own memory is bounded.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from gelsim.bench.section import Row
from gelsim.work.workers import end_with

GIGABYTE = 1 << 30
START_SECONDS = 300.0
"""Allowed for a child to import what it needs; no case's time."""
_READY = "ready"


class Bounded:
    """Calls `measure` in a child process.

    Args:
        measure: A function of a module, so that the child can import it; returns a row.
        seconds: Allowed for a call. memory: Allowed for the child's own data [bytes], where the system can bound it.
    """

    def __init__(self, measure: Callable[..., Row], seconds: float, memory: int) -> None:
        self._measure, self._seconds, self._memory = measure, seconds, memory
        self._child: Any = None
        self._pipe: Connection | None = None

    def __call__(self, *arguments: object) -> Row:
        if multiprocessing.current_process().daemon:
            _bound(self._memory)
            return _row(self._measure, self._memory, arguments)
        if self._pipe is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, other = context.Pipe()
            self._child = context.Process(target=_serve, args=(other, self._measure, self._memory, os.getpid()), daemon=True)
            self._child.start()
            other.close()
            if not self._pipe.poll(START_SECONDS) or self._pipe.recv() != _READY:
                raise OSError(f"a child process was not ready after {START_SECONDS:g} s")
        self._pipe.send(arguments)
        if not self._pipe.poll(self._seconds):
            self.close()
            return {"status": "TIMEOUT", "message": f"not done after {self._seconds:g} s"}
        try:
            return self._pipe.recv()
        except EOFError:
            self._child.join()
            code = self._child.exitcode
            self.close()
            return {"status": "DIED", "message": f"the process ended with code {code}"}

    def close(self) -> None:
        """Ends the child, whatever it does."""
        if self._pipe is not None:
            self._child.kill()
            self._child.join()
            self._pipe.close()
            self._pipe = self._child = None


def _bound(memory: int) -> None:
    """Bounds this process's own data [bytes]."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    except (ImportError, ValueError, OSError):  # no such bound on this system: the time alone is bounded
        pass


def _row(measure: Callable[..., Row], memory: int, arguments: tuple[object, ...]) -> Row:
    try:
        return measure(*arguments)
    except MemoryError:
        return {"status": "MEMORY", "message": f"more than {memory / GIGABYTE:g} GB"}
    except Exception as error:
        return {"status": type(error).__name__, "message": str(error)}


def _serve(pipe: Connection, measure: Callable[..., Row], memory: int, parent: int) -> None:
    end_with(parent)
    _bound(memory)
    pipe.send(_READY)
    while True:
        try:
            arguments = pipe.recv()
        except EOFError:
            return
        pipe.send(_row(measure, memory, arguments))
