"""A stage for the tests of your own controller: started by pytest in lockstep, on a ROS domain of
its own.

Needs rclpy, pytest and the programs of friction_stage: in the directory that FRICTION_STAGE_BIN
names, in a prefix of AMENT_PREFIX_PATH, or on the PATH. Install it (`pip install ./testing`) or
write into conftest.py:

    pytest_plugins = "friction_stage_testing"

Then the fixture `friction_stage` starts a stage:

    def test_my_controller_reaches_10_mm(friction_stage):
        stage = friction_stage(model="guide_2", control_rate=1000.0)
        controller = MyController()
        for _ in range(2000):
            stage.step(controller.force(0.01 - stage.sample.position[0]))
        assert abs(stage.sample.position[0] - 0.01) < 1e-5

Nothing here sleeps for a fixed time: it waits for a message, a service or the end of a process, and
a process that ends too early fails the test at once, with its log.
"""

import fcntl
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from builtin_interfaces.msg import Duration
from builtin_interfaces.msg import Time as Stamp
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# Longest wait for anything, s: a busy machine is slow, a test that hangs should say where.
PATIENCE = 30.0

TOPICS = {
    "/stage/encoder": JointState,
    "/stage/force_cell": WrenchStamped,
    "/stage/force": WrenchStamped,
    "/stage/joint_commands": JointState,
    "/stage/setpoint": JointTrajectory,
}


def nanoseconds(stamp: Stamp) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def stamp(nanoseconds: int) -> Stamp:
    return Stamp(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def trajectory(points: list[dict], start: int = 0) -> JointTrajectory:
    """A move of the stage: points as {time: s, positions: [m], velocities: [m/s], ...}; start in
    ns, 0 = now."""
    message = JointTrajectory(joint_names=["stage"])
    message.header.stamp = stamp(start)
    for point in points:
        fields = dict(point)
        at = round(fields.pop("time") * 1e9)
        message.points.append(
            JointTrajectoryPoint(
                time_from_start=Duration(sec=at // 10**9, nanosec=at % 10**9), **fields
            )
        )
    return message


def rest(time: float, position: float) -> dict:
    """A trajectory point at which the stage rests: between two of them the move is a quintic."""
    return {"time": time, "positions": [position], "velocities": [0.0], "accelerations": [0.0]}


def program(name: str) -> Path:
    """The path of a program of friction_stage."""
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    folders = [Path(prefix) / "lib" / "friction_stage" for prefix in prefixes]
    if chosen := os.environ.get("FRICTION_STAGE_BIN"):
        folders = [Path(chosen)]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    found = None if chosen else shutil.which(name)
    assert found, (
        f"no program {name} in {[str(folder) for folder in folders]} or on the PATH: "
        "FRICTION_STAGE_BIN names the directory (cargo build --release makes target/release)"
    )
    return Path(found)


def ros_arguments(parameters: dict[str, object]) -> list[str]:
    """Parameters on a command line, with `__` for `.` in their names."""
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ["-p", f"{name.replace('__', '.')}:={text}"]
    return arguments


class Process:
    def __init__(self, command: list[str], log: Path) -> None:
        self.name = Path(command[0]).name
        self.log_path = log
        # Whether its end was wanted and has been checked.
        self.stopped = False
        with log.open("wb") as out:
            out.write((" ".join(command) + "\n").encode())
            out.flush()
            self.popen = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT
            )

    def log(self) -> str:
        """The command line, and what it has written to stdout and stderr so far."""
        return self.log_path.read_text(errors="replace")

    def excerpt(self) -> str:
        """The log for a person: of a long one the beginning and the end."""
        lines = self.log().splitlines()
        if len(lines) > 80:
            lines = [*lines[:20], f"... {len(lines) - 60} lines ...", *lines[-40:]]
        return "\n".join(lines)

    def outcome(self) -> str:
        code = self.popen.poll()
        return "still running" if code is None else f"exit code {code}"

    def wait(self, timeout: float = 15.0) -> int:
        """Its exit code, when it ends by itself within `timeout` seconds."""
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f"{self.name} did not end within {timeout} s:\n{self.excerpt()}"
            ) from None

    def stop(
        self, how: signal.Signals = signal.SIGTERM, expected: int | tuple[int, ...] = 0
    ) -> None:
        """Ends it with a signal, unless it has ended, and checks its exit code, once."""
        if self.stopped:
            return
        self.stopped = True
        ran = self.popen.poll() is None
        if ran:
            self.popen.send_signal(how)
        try:
            code = self.popen.wait(15.0)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
            raise AssertionError(
                f"{self.name} did not end within 15 s of {how.name}:\n{self.excerpt()}"
            ) from None
        allowed = expected if isinstance(expected, tuple) else (expected,)
        assert code in allowed, (
            f"{self.name} {f'answered {how.name}' if ran else 'ended by itself'} with exit code "
            f"{code} "
            f"instead of {expected}:\n{self.excerpt()}"
        )

    def ended(self, expected: int) -> None:
        """Marks that it ended as the test wanted, and checks how."""
        code = self.wait()
        self.stopped = True
        assert code == expected, (
            f"{self.name} ended with exit code {code} instead of {expected}:\n{self.excerpt()}"
        )


def domain_is_silent(domain: int) -> bool:
    """Whether no DDS participant of this machine listens on the domain's first ports (RTPS 2.3,
    9.6.1)."""
    for port in (7400 + 250 * domain, 7400 + 250 * domain + 10):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True


@contextmanager
def free_domain() -> Iterator[int]:
    """A ROS domain that no other process here uses, in the environment of the tests and their
    processes."""
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


class Ros:
    """An rclpy node in the process of the test, spun only while the test waits: the defaults that a
    user gets, no thread."""

    # Types of the topics by name.
    topics = TOPICS

    def __init__(self, domain: int, processes: list[Process]) -> None:
        self.processes = processes
        self.context = Context()
        rclpy.init(
            context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.node = self.add(rclpy.create_node("peer", context=self.context))

    def __enter__(self) -> "Ros":
        return self

    def __exit__(self, *_: object) -> None:
        for node in self.executor.get_nodes():
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown()
        self.context.try_shutdown()

    def add(self, node: Node) -> Node:
        self.executor.add_node(node)
        return node

    def until(self, condition: Callable[[], Any], what: str, timeout: float = PATIENCE) -> Any:
        """Spins until the condition is true and returns its value; `what` names it in
        the failure."""
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            for process in self.processes:
                ended = process.popen.poll() is not None and not process.stopped
                if ended and not condition():
                    raise AssertionError(
                        f"{process.name} ended, {process.outcome()}, while waiting for {what}"
                    )
            if time.monotonic() > deadline:
                raise AssertionError(f"{timeout} s went by without {what}")
            self.executor.spin_once(timeout_sec=0.1)
        return value

    def spin(self, seconds: float) -> None:
        """Spins for a while: only to show that something does not happen."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def collect(self, topic: str, depth: int = 50_000) -> list:
        """A list to which every message on the topic is added while the test waits for something.

        While one lost packet is repaired all that follow it wait in the reader, at 10,000 a second
        in lockstep; beyond the depth they are lost.
        """
        messages: list = []
        self.node.create_subscription(
            self.topics[topic], topic, messages.append, QoSProfile(depth=depth)
        )
        return messages

    def first(self, topic: str) -> Any:
        """The next message on the topic."""
        messages: list = []
        subscription = self.node.create_subscription(self.topics[topic], topic, messages.append, 10)
        self.until(lambda: messages, f"a message on {topic}")
        self.node.destroy_subscription(subscription)
        return messages[0]

    def publisher(self, topic: str, readers: int = 1, depth: int = 10) -> Any:
        """A publisher that has found its readers."""
        publisher = self.node.create_publisher(self.topics[topic], topic, depth)
        self.until(
            lambda: publisher.get_subscription_count() >= readers,
            f"{readers} subscribers of {topic}",
        )
        return publisher

    def call(self, kind: type, name: str, **request: Any) -> Any:
        """The response of a service."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"the service {name}")
        return self.result(client.call_async(kind.Request(**request)), f"the answer of {name}")

    def result(self, future: Any, what: str) -> Any:
        self.until(future.done, what)
        return future.result()


class Stage:
    """A stage in lockstep: its time stands still until a sample is answered."""

    def __init__(self, ros: Ros, folder: Path, processes: list[Process]) -> None:
        self.ros, self.folder, self.processes = ros, folder, processes
        self.directory: Path | None = None
        self.samples: list[JointState] = []
        """Every sample of the encoder since the start, as they came."""

    def start(self, command: list[str], **parameters: object) -> Process:
        """Starts a program in the stage's ROS domain; it is ended with the test."""
        command = [*command, *(ros_arguments(parameters) if parameters else [])]
        log = self.folder / f"{Path(command[0]).name}-{len(self.processes)}.log"
        process = Process(command, log)
        self.processes.append(process)
        return process

    def begin(self, bag: bool, parameters: dict[str, object]) -> None:
        """Starts stage_node and waits for its first sample."""
        given = {"mode": "lockstep", "wait_for_command": True, **parameters}
        if bag:
            self.directory = self.folder / "bag"
            given["record"] = self.directory
        self.ros.node.create_subscription(
            JointState, "/stage/encoder", self.samples.append, QoSProfile(depth=50_000)
        )
        self.start([str(program("stage_node"))], **given)
        self.force = self.ros.publisher("/stage/force")
        self.ros.until(lambda: self.samples, "the first sample of the stage")

    @property
    def sample(self) -> JointState:
        """The last sample: position m, velocity m/s, effort (force cell) N, each of one joint."""
        return self.samples[-1]

    @property
    def time(self) -> float:
        """Time of the last sample, s. It begins at 1."""
        return nanoseconds(self.sample.header.stamp) * 1e-9

    def step(self, force: float = 0.0) -> JointState:
        """Answers the last sample with a force, N; the next sample."""
        answer = WrenchStamped(header=self.sample.header)
        answer.wrench.force.x = float(force)
        answered, seen = self.sample.header.stamp, len(self.samples)
        self.force.publish(answer)

        def moved_on() -> bool:
            nonlocal seen
            if self.sample.header.stamp != answered:
                return True
            if len(self.samples) > seen:
                # Sent again, because the answer is missing.
                seen = len(self.samples)
                self.force.publish(answer)
            return False

        self.ros.until(moved_on, "the next sample")
        return self.sample

    def controller(self, **parameters: object) -> Process:
        """Starts controller_node beside the stage and waits until it answers samples."""
        process, since = self.start([str(program("controller_node"))], **parameters), self.time
        self.ros.until(lambda: self.time > since, "the first answer of the controller")
        return process

    def run(self, seconds: float) -> list[JointState]:
        """Waits until a controller that is a node has answered samples of so many seconds; these
        samples."""
        since, end = len(self.samples), self.time + seconds
        self.ros.until(lambda: self.time >= end, f"{seconds} s of the stage's time")
        return self.samples[since:]

    def move(self, position: float, seconds: float, within: float = 1e-5) -> list[JointState]:
        """Sends a move to a position (m) on /stage/setpoint and waits until the stage is there; the
        samples meanwhile."""
        # The stage subscribes to setpoints, too.
        setpoint = self.ros.publisher("/stage/setpoint", readers=2)
        since = len(self.samples)
        begun = nanoseconds(self.sample.header.stamp)
        setpoint.publish(trajectory([rest(seconds, position)]))

        def there() -> bool:
            last = self.samples[max(since, len(self.samples) - 20) :]
            return (
                nanoseconds(self.sample.header.stamp) >= begun + round(seconds * 1e9)
                and len(last) == 20
                and all(abs(sample.position[0] - position) <= within for sample in last)
            )

        self.ros.until(there, f"20 samples within {within} m of {position} m")
        self.ros.node.destroy_publisher(setpoint)
        return self.samples[since:]

    def bag(self) -> Path:
        """Ends the recording of a stage that was started with bag=True; its directory, which is
        complete."""
        assert self.directory, "start it with friction_stage(bag=True, ...)"
        ended = self.ros.call(SetBool, "/stage/record", data=False)
        assert ended.success, ended.message
        return self.directory


@pytest.fixture
def friction_stage_domain() -> Iterator[int]:
    """A ROS domain of its own, which everything that the test starts takes from the environment."""
    with free_domain() as domain:
        yield domain


@pytest.fixture
def friction_stage_processes(request: pytest.FixtureRequest) -> Iterator[list[Process]]:
    """The processes that the test started, in order. Those still running at its end get SIGTERM and
    must exit with 0."""
    started: list[Process] = []
    request.node.friction_stage_processes = started
    yield started
    failures = []
    for process in reversed(started):
        try:
            process.stop()
        except AssertionError as failure:
            failures.append(str(failure))
    assert not failures, "\n\n".join(failures)


@pytest.fixture
def friction_stage(
    friction_stage_domain: int, friction_stage_processes: list[Process], tmp_path: Path
) -> Iterator[Callable[..., Stage]]:
    """friction_stage(bag=False, **parameters of stage_node): starts a stage in lockstep that stands
    at its first sample."""
    with ExitStack() as stack:

        def begin(bag: bool = False, **parameters: object) -> Stage:
            ros = stack.enter_context(Ros(friction_stage_domain, friction_stage_processes))
            stage = Stage(ros, tmp_path, friction_stage_processes)
            stage.begin(bag, parameters)
            return stage

        yield begin


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Shows the logs of the processes below a failure."""
    report = yield
    if report.failed:
        for process in getattr(item, "friction_stage_processes", []):
            report.sections.append(
                (f"log of {process.name}, {process.outcome()}", process.excerpt())
            )
    return report
