"""Engines: where chunks are computed. Each is a ``concurrent.futures.Executor`` and how many chunks
it takes at once."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any, Protocol

from ..errors import FleetError

NAMES = ("local", "dask", "ray")
MOST_UNKNOWN = 512
"""Chunks at once for an executor that does not say how many workers it has. Assumed."""


class Engine(Protocol):
    """Where chunks are computed."""

    name: str

    def slots(self) -> int:
        """How many chunks it computes at once, as far as it is known now."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Starts work."""

    def renew(self) -> None:
        """Makes it work again after it broke."""

    def close(self, stop: bool) -> None:
        """Ends it; ``stop``: without waiting for what runs."""


class Local:
    """Processes of this machine, each on one core."""

    name = "local"

    def __init__(self, workers: int | None = None) -> None:
        if workers is not None and workers < 1:
            raise FleetError(f"workers is {workers}, must be at least 1")
        self._workers = workers or len(os.sched_getaffinity(0))
        self._start()

    def _start(self) -> None:
        import multiprocessing

        # Not fork: this process has threads.
        context = multiprocessing.get_context("spawn")
        self._stop = context.Event()
        self._pool = ProcessPoolExecutor(
            self._workers, mp_context=context, initializer=_become_worker, initargs=(self._stop,)
        )

    def slots(self) -> int:
        return self._workers

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        return self._pool.submit(work, *arguments)

    def renew(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._start()

    def close(self, stop: bool) -> None:
        if stop:
            self._stop.set()
        self._pool.shutdown(wait=True, cancel_futures=True)


def _become_worker(stop: Any) -> None:
    """Ctrl-C is the business of the run; a run that is killed takes its workers with it."""
    import multiprocessing
    from multiprocessing.connection import wait

    from . import _chunk

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _chunk.stopped = stop.is_set
    run = multiprocessing.parent_process()

    def watch() -> None:
        if run is not None:
            wait([run.sentinel])
            # Files appear whole or not at all, so there is nothing to finish.
            os._exit(1)

    threading.Thread(target=watch, name="friction-stage-watch", daemon=True).start()


class Given:
    """An executor of the caller, who also ends it."""

    def __init__(self, executor: Executor, slots: int | None = None) -> None:
        self.name = type(executor).__name__
        self._executor = executor
        self._slots = slots

    def slots(self) -> int:
        if self._slots is not None:
            return self._slots
        # As the executors of Python and of mpi4py say it.
        for name in ("_max_workers", "num_workers"):
            said = getattr(self._executor, name, None)
            if isinstance(said, int) and said > 0:
                return said
        return MOST_UNKNOWN

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        return self._executor.submit(work, *arguments)

    def renew(self) -> None:
        raise FleetError(f"the executor {self.name} broke and is not ours to start again")

    def close(self, stop: bool) -> None:
        pass


class Dask:
    """A cluster of Dask by its scheduler's address, or one of this machine."""

    name = "dask"

    def __init__(self, address: str | None, workers: int | None = None) -> None:
        try:
            distributed: Any = importlib.import_module("distributed")
        except ImportError as error:
            raise FleetError("the engine dask needs: pip install friction-stage[dask]") from error
        try:
            if address is None:
                cores = workers or len(os.sched_getaffinity(0))
                self._client = distributed.Client(
                    n_workers=cores, threads_per_worker=1, dashboard_address=None
                )
            else:
                self._client = distributed.Client(address, timeout="10s")
        except (OSError, ValueError) as error:
            raise FleetError(f"no Dask scheduler at {address}: {error}") from error
        # Every submission is work of its own, also of the same chunk.
        self._executor: Executor = self._client.get_executor(pure=False)

    def slots(self) -> int:
        return sum(self._client.nthreads().values())

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        return self._executor.submit(work, *arguments)

    def renew(self) -> None:
        self._executor = self._client.get_executor(pure=False)

    def close(self, stop: bool) -> None:
        with contextlib.suppress(Exception):
            self._executor.shutdown(wait=False)
        self._client.close()


class Ray:
    """A cluster of Ray by its address, or one of this machine."""

    name = "ray"

    def __init__(self, address: str | None, workers: int | None = None) -> None:
        try:
            ray: Any = importlib.import_module("ray")
        except ImportError as error:
            raise FleetError("the engine ray needs: pip install friction-stage[ray]") from error
        self._ray = ray
        more = {"num_cpus": workers} if address is None and workers is not None else {}
        try:
            ray.init(address=address, log_to_driver=False, logging_level="ERROR", **more)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise FleetError(f"no Ray cluster at {address}: {error}") from error

    def slots(self) -> int:
        return int(self._ray.cluster_resources().get("CPU", 1))

    def submit(self, work: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        reference = self._ray.remote(num_cpus=1)(work).remote(*arguments)
        future: Future[Any] = reference.future()
        return future

    def renew(self) -> None:
        pass

    def close(self, stop: bool) -> None:
        self._ray.shutdown()


def engine_of(
    engine: str | Executor, *, address: str | None = None, workers: int | None = None
) -> Engine:
    """The engine of a name, or an executor that is given."""
    if isinstance(engine, Executor):
        return Given(engine, workers)
    if engine == "local":
        if address is not None:
            raise FleetError("the engine local has no address")
        return Local(workers)
    if engine == "dask":
        return Dask(address, workers)
    if engine == "ray":
        return Ray(address, workers)
    raise FleetError(f"engine is {engine!r}, must be one of {', '.join(NAMES)}, or an executor")
