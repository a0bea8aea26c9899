"""Fixtures of the peer tests: a ROS domain of its own per test, the nodes under test, and an rclpy node of the test.

Nothing here sleeps for a fixed time: a test waits for a message, a service or the end of a process, and a process
that ends too early fails the test at once, with its log.
"""

import fcntl
import os
import socket
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from processes import Process
from ros import Ros

BINARIES = Path(
    os.environ.get("FRICTION_STAGE_BIN", Path(__file__).parents[2] / "target" / "release")
)


def domain_is_silent(domain: int) -> bool:
    """Whether no DDS participant of this machine listens on the domain's first ports (RTPS 2.3, 9.6.1)."""
    for port in (7400 + 250 * domain, 7400 + 250 * domain + 10):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True


@contextmanager
def free_domain() -> Iterator[int]:
    """A ROS domain that nobody else on this machine uses, in the environment of the tests and their processes."""
    first, _, last = os.environ.get("PEER_DOMAINS", "1-100").partition("-")
    domains = list(range(int(first), int(last or first) + 1))
    start = os.getpid() % len(domains)
    for candidate in domains[start:] + domains[:start]:
        with open(
            Path(tempfile.gettempdir()) / f"ros_domain_{candidate}.{os.getuid()}.lock", "w"
        ) as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            if domain_is_silent(candidate):
                with pytest.MonkeyPatch.context() as environment:
                    environment.setenv("ROS_DOMAIN_ID", str(candidate))
                    environment.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
                    yield candidate
                return
    pytest.fail(f"every ROS domain of {domains[0]} to {domains[-1]} is in use on this machine")


@pytest.fixture
def domain() -> Iterator[int]:
    with free_domain() as domain:
        yield domain


@pytest.fixture
def processes(request: pytest.FixtureRequest) -> Iterator[list[Process]]:
    """The processes that the test started, in order. Those still running at its end get SIGTERM and must exit with 0."""
    started: list[Process] = []
    request.node.processes = started
    yield started
    failures = []
    for process in reversed(started):
        try:
            process.stop()
        except AssertionError as failure:
            failures.append(str(failure))
    assert not failures, "\n\n".join(failures)


@pytest.fixture
def start(domain: int, processes: list[Process], tmp_path: Path) -> Callable[..., Process]:
    """start(program, **parameters): runs a node of the project, with `__` for `.` in the names of parameters."""

    def start(program: str, *arguments: str, **parameters: object) -> Process:
        assert (BINARIES / program).is_file(), (
            f"{BINARIES / program} is not there: cargo build --release --bins --example write_bag"
        )
        command = [str(BINARIES / program), *arguments, "--ros-args"]
        for name, value in parameters.items():
            command += ["-p", f"{name.replace('__', '.')}:={yaml_scalar(value)}"]
        process = Process(command, tmp_path / f"{program}-{len(processes)}.log")
        processes.append(process)
        return process

    return start


def yaml_scalar(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, (int, float)) else str(value)


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
    """controller(**parameters): starts controller_node and returns when it has answered a sample."""

    def controller(**parameters: object) -> Process:
        process = start("controller_node", **parameters)
        ros.first("/controller/state")
        return process

    return controller


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Shows the logs of the nodes below a failure."""
    report = yield
    if report.failed:
        for process in getattr(item, "processes", []):
            report.sections.append(
                (f"log of {process.name}, {process.outcome()}", process.excerpt())
            )
    return report
