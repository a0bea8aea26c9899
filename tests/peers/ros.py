"""An rclpy node in the process of the test, spun only while the test waits for something."""

import time
from collections.abc import Callable
from typing import Any

import rclpy
from builtin_interfaces.msg import Duration
from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticArray
from friction_stage_msgs.msg import ControllerState, StageState
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from processes import Process

TOPICS = {
    "/stage/encoder": JointState,
    "/stage/force_cell": WrenchStamped,
    "/stage/force": WrenchStamped,
    "/stage/joint_commands": JointState,
    "/stage/commands": Float64MultiArray,
    "/stage/setpoint": JointTrajectory,
    "/stage/state": StageState,
    "/controller/state": ControllerState,
    "/clock": Clock,
    "/diagnostics": DiagnosticArray,
}


def nanoseconds(stamp: Stamp) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def stamp(nanoseconds: int) -> Stamp:
    return Stamp(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


class Ros:
    """rclpy with the defaults that a user gets: reliable, volatile, default executor. Not a thread of its own."""

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

    def until(self, condition: Callable[[], Any], what: str, timeout: float = 30.0) -> Any:
        """Spins until the condition is true and returns its value; `what` names it in the failure."""
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

        While one lost packet is repaired all that follow it wait in the reader, at 10,000 a second in lockstep; beyond
        the depth they are lost.
        """
        messages: list = []
        self.node.create_subscription(
            TOPICS[topic], topic, messages.append, QoSProfile(depth=depth)
        )
        return messages

    def first(self, topic: str) -> Any:
        """The next message on the topic."""
        messages: list = []
        subscription = self.node.create_subscription(TOPICS[topic], topic, messages.append, 10)
        self.until(lambda: messages, f"a message on {topic}")
        self.node.destroy_subscription(subscription)
        return messages[0]

    def publisher(self, topic: str, readers: int = 1, depth: int = 10) -> Any:
        """A publisher that has found its readers."""
        publisher = self.node.create_publisher(TOPICS[topic], topic, depth)
        self.until(
            lambda: publisher.get_subscription_count() >= readers,
            f"{readers} subscribers of {topic}",
        )
        return publisher

    def follow(self, points: list[dict], lead: float = 2.0) -> int:
        """Has the controller follow a trajectory `lead` s of the stage's time from now. Returns its start, ns.

        In lockstep time runs several times as fast as the wall clock, and the first message to a new subscriber may take
        3 s: a trajectory that came too late is sent again with a later start, each time further ahead.
        """
        states = self.collect("/controller/state", depth=10)
        # The stage hears setpoints too, for its recording.
        setpoint = self.publisher("/stage/setpoint", readers=2)
        self.until(lambda: states, "the state of the controller")
        for _ in range(10):
            start = nanoseconds(states[-1].header.stamp) + round(lead * 1e9)
            setpoint.publish(trajectory(points, start))
            self.until(
                lambda: (
                    nanoseconds(states[-1].setpoint_stamp) == start
                    or nanoseconds(states[-1].header.stamp) > start
                ),
                "acceptance of the trajectory",
            )
            if nanoseconds(states[-1].setpoint_stamp) == start:
                return start
            lead *= 1.5
        raise AssertionError("the trajectory came too late 10 times")

    def call(self, kind: type, name: str, **request: Any) -> Any:
        """The response of a service."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"the service {name}")
        return self.result(client.call_async(kind.Request(**request)), f"the answer of {name}")

    def result(self, future: Any, what: str) -> Any:
        self.until(future.done, what)
        return future.result()


def trajectory(points: list[dict], start: int = 0) -> JointTrajectory:
    """A move of the stage: points as {time: s, positions: [m], velocities: [m/s], ...}; start in ns, 0 = now."""
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
