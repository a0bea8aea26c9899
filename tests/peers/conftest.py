"""Fixtures of the peer tests, on top of those that users have (testing/): a ROS domain of its own
per test, the nodes under test, and an rclpy node of the test.

Nothing here sleeps for a fixed time: a test waits for a message, a service or the end of a process,
and a process that ends too early fails the test at once, with its log.
"""

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

os.environ.setdefault("FRICTION_STAGE_BIN", str(Path(__file__).parents[2] / "target" / "release"))

pytest.register_assert_rewrite("friction_stage_testing")

from friction_stage_testing import Process, free_domain, program, ros_arguments  # noqa: E402

from ros import Ros  # noqa: E402

__all__ = ["BINARIES", "free_domain"]

pytest_plugins = "friction_stage_testing"

BINARIES = Path(os.environ["FRICTION_STAGE_BIN"])


@pytest.fixture
def domain(friction_stage_domain: int) -> int:
    return friction_stage_domain


@pytest.fixture
def processes(friction_stage_processes: list[Process]) -> list[Process]:
    return friction_stage_processes


@pytest.fixture
def start(domain: int, processes: list[Process], tmp_path: Path) -> Callable[..., Process]:
    """start(program, *arguments, **parameters): runs a program of the project, or that of a path,
    with `__` for `.` in the names of parameters."""

    def start(name: str, *arguments: str, **parameters: object) -> Process:
        given = ros_arguments(parameters) if parameters else []
        command = [str(program(name)), *arguments, *given]
        process = Process(command, tmp_path / f"{Path(name).name}-{len(processes)}.log")
        processes.append(process)
        return process

    return start


@pytest.fixture
def ros(domain: int, processes: list[Process]) -> Iterator[Ros]:
    """An rclpy node in the test's process."""
    with Ros(domain, processes) as ros:
        yield ros


@pytest.fixture
def stage(start: Callable[..., Process], ros: Ros) -> Callable[..., Process]:
    """stage(**parameters): starts stage_node and returns when its encoder has been heard."""

    def stage(**parameters: object) -> Process:
        process = start("stage_node", **parameters)
        ros.first("/stage/encoder")
        return process

    return stage


@pytest.fixture
def controller(start: Callable[..., Process], ros: Ros) -> Callable[..., Process]:
    """controller(**parameters): starts controller_node and returns when it has answered a
    sample."""

    def controller(**parameters: object) -> Process:
        process = start("controller_node", **parameters)
        ros.first("/controller/state")
        return process

    return controller


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A file: while it exists, programs that are started from now on wait when they write into a
    recording or have removed a directory."""
    library, stalls = tmp_path / "slow_disk.so", tmp_path / "stalls"
    command = [
        "cc",
        "-O2",
        "-Wall",
        "-Werror",
        "-shared",
        "-fPIC",
        "-o",
        str(library),
        str(Path(__file__).with_name("slow_disk.c")),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    before = os.environ.get("LD_PRELOAD")
    monkeypatch.setenv("LD_PRELOAD", f"{library}:{before}" if before else str(library))
    monkeypatch.setenv("DISK_STALLS", str(stalls))
    yield stalls
    # A node that waits would not end.
    stalls.unlink(missing_ok=True)
