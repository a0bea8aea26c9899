"""Clusters of Dask and of Ray on loopback, as processes that the tests started."""

import contextlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil

BIN = Path(sys.executable).parent
HERE = "127.0.0.1"
MEMORY = "--object-store-memory=80000000"


def until(condition: Callable[[], object], *processes: subprocess.Popen[str]) -> None:
    """Waits until it holds, while the processes run."""
    while not condition():
        for process in processes:
            assert process.poll() is None, f"{process.args} ended with {process.returncode}"
        time.sleep(0.02)


def end(process: subprocess.Popen[str]) -> None:
    """Ends a process with all that it started."""
    with contextlib.suppress(psutil.NoSuchProcess):
        every = psutil.Process(process.pid).children(recursive=True)
        process.kill()
        for child in every:
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
    process.wait()


class DaskCluster:
    """A scheduler and two worker processes."""

    name = "dask"

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._file = directory / "scheduler.json"
        self._log = (directory / "log").open("w")
        self._scheduler = self._start(
            *("scheduler", "--host", HERE, "--port", "0", "--no-dashboard"),
            *("--scheduler-file", str(self._file)),
        )
        until(self._file.exists, self._scheduler)
        self.workers = [self.add_worker(), self.add_worker()]

    def _start(self, *words: str, **environment: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, BIN / "dask", *words],
            stdout=self._log,
            stderr=self._log,
            text=True,
            cwd=self._directory,
            env=os.environ | environment,
        )

    @property
    def address(self) -> str:
        return str(json.loads(self._file.read_text())["address"])

    def add_worker(self, **environment: str) -> subprocess.Popen[str]:
        return self._start(
            *("worker", "--scheduler-file", str(self._file), "--host", HERE, "--no-nanny"),
            *("--nthreads", "1", "--no-dashboard", "--local-directory", str(self._directory)),
            **environment,
        )

    def wait(self, workers: int) -> None:
        """Until it has so many workers."""
        from distributed import Client

        with Client(self.address) as client:  # type: ignore[no-untyped-call]
            client.wait_for_workers(workers)

    def kill_a_worker(self) -> None:
        """As the machine would that has no memory left."""
        self.workers.pop().kill()

    def close(self) -> None:
        for process in [*self.workers, self._scheduler]:
            end(process)
        self._log.close()


class RayCluster:
    """Two nodes with a core each. They take runs that have the token of this cluster, so that
    neither the settings of the user nor those of another cluster have a part in it."""

    name = "ray"

    def __init__(self, directory: Path) -> None:
        # Nodes, this process and what it starts; before Ray is loaded, which looks once.
        secret = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
        self._before = {name: os.environ.get(name) for name in secret}
        os.environ.update(secret)
        with socket.socket() as free:
            free.bind((HERE, 0))
            port = free.getsockname()[1]
        self.address = f"{HERE}:{port}"
        self._log = (directory / "log").open("w")
        # Its sockets are below, and their paths must be short.
        self._directory = tempfile.mkdtemp(prefix="ray")
        words = ("--head", f"--port={port}", f"--temp-dir={self._directory}")
        self._nodes = [self._start(*words, "--include-dashboard=false")]
        until(self._answers, self._nodes[0])
        self._nodes.append(self._start(f"--address={self.address}"))

    def _start(self, *words: str) -> subprocess.Popen[str]:
        more = (
            f"--node-ip-address={HERE}",
            "--num-cpus=1",
            "--object-store-memory=80000000",
            "--disable-usage-stats",
        )
        return subprocess.Popen(
            [sys.executable, BIN / "ray", "start", "--block", *words, *more, MEMORY],
            stdout=self._log,
            stderr=self._log,
            text=True,
            # As it is, its workers give way to whatever else the machine does.
            env=os.environ | {"RAY_worker_niceness": "0"},
        )

    def _answers(self) -> bool:
        host, port = self.address.split(":")
        with contextlib.suppress(OSError):
            socket.create_connection((host, int(port))).close()
            return True
        return False

    def wait(self, workers: int) -> None:
        """Until it has so many nodes."""
        import ray

        # The control store answers some time after its port does.
        ray.init(self.address, log_to_driver=False, logging_level=40)
        try:
            until(lambda: sum(node["Alive"] for node in ray.nodes()) >= workers, *self._nodes)
        finally:
            ray.shutdown()  # type: ignore[no-untyped-call]

    def kill_a_worker(self) -> None:
        """The process that computes on the second node."""
        node = psutil.Process(self._nodes[1].pid)

        def workers() -> list[psutil.Process]:
            return [p for p in node.children(recursive=True) if _name(p).startswith("ray::compute")]

        until(workers, self._nodes[1])
        for worker in workers():
            worker.send_signal(signal.SIGKILL)

    def close(self) -> None:
        for node in reversed(self._nodes):
            end(node)
        for name, value in self._before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        self._log.close()
        shutil.rmtree(self._directory, ignore_errors=True)


def _name(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except (psutil.NoSuchProcess, psutil.ZombieProcess):
        return ""


Cluster = DaskCluster | RayCluster


@contextlib.contextmanager
def cluster(kind: type[DaskCluster] | type[RayCluster], directory: Path) -> Iterator[Cluster]:
    """One that is ready, and ended at the end."""
    directory.mkdir(parents=True)
    started: Cluster = kind(directory)
    try:
        started.wait(2)
        yield started
    finally:
        started.close()
