"""Workers on a Ray cluster: one actor a core, or as many as asked for. Ray is an optional dependency (`pip install gelsim[ray]`).

All nodes need gelsim and Ray in the same versions, and see the folder of the results under the same path. Each node has caches of its own.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Sequence
from typing import Any

from gelsim.errors import SceneError
from gelsim.work.workers import Died, Handful, Work, settings, wait_asleep


class RayCrew:
    """Actors of the cluster at `address`; "local" starts one on this machine.

    Args:
        count: How many; one per core of the cluster by default.
        gpu: Whether they share the cluster's GPUs.
    Raises:
        SceneError: Ray is not installed, or nothing answers.
    """

    def __init__(self, address: str, count: int | None = None, gpu: bool = False) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
        except ImportError:
            raise SceneError("--ray: Ray is not installed (pip install gelsim[ray])") from None
        self._ray = ray
        _knock(address)
        if not ray.is_initialized():
            try:
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise SceneError(f"--ray {address}: no cluster answers ({str(error).splitlines()[0]})") from None
        has = ray.cluster_resources()
        self.count = count or max(int(has.get("CPU", 1)), 1)
        self._gpu = has.get("GPU", 0.0) / self.count if gpu else 0.0

    def start(self, number: int, make: Callable[..., Work[Any]], arguments: tuple[Any, ...]) -> _Actor:
        actor = self._ray.remote(_Server).options(num_cpus=1, num_gpus=self._gpu, runtime_env={"env_vars": settings(1)})
        return _Actor(self._ray, actor.remote(make, arguments, self._gpu > 0.0))

    def ready(self, workers: Sequence[_Actor], timeout: float) -> list[_Actor]:
        promises = [worker.promise for worker in workers]
        self._ray.wait(promises, timeout=timeout)
        kept, _ = self._ray.wait(promises, num_returns=len(promises), timeout=0)
        return [worker for worker in workers if worker.promise in kept]


def _knock(address: str) -> None:
    """Ray itself waits for minutes for a host that is not there."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), timeout=5.0).close()
    except (OSError, OverflowError) as error:
        raise SceneError(f"--ray {address}: no cluster answers ({error})") from None


class _Server:
    def __init__(self, make: Callable[..., Work[Any]], arguments: tuple[Any, ...], on_gpu: bool) -> None:
        if on_gpu:
            wait_asleep()
        self._work = make(*arguments)

    def begin(self) -> None:
        """Answers once it has been made."""

    def work(self, handful: Handful) -> Any:
        return self._work(handful)


class _Actor:
    def __init__(self, ray: Any, actor: Any) -> None:
        self._ray, self._actor, self.promise = ray, actor, actor.begin.remote()

    def give(self, handful: Handful) -> None:
        self.promise = self._actor.work.remote(handful)

    def take(self) -> Any:
        try:
            return self._ray.get(self.promise)
        except self._ray.exceptions.RayError as error:
            raise Died(f"its actor ended: {str(error).strip().splitlines()[-1]}") from None

    def end(self) -> None:
        self._ray.kill(self._actor)

    def gone(self, until: float) -> None:
        """Ray gives what it held to others when it is free."""
