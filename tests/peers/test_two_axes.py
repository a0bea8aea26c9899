"""Two axes in lockstep: one program answers both on one clock, or each has a controller and a clock
of its own."""

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from ros import nanoseconds, rest, trajectory

AXES = ("x", "y")
PERIOD = 10**6


class Axis:
    """An axis as one program sees it: its samples, and where its forces go."""

    def __init__(self, ros, name: str) -> None:
        self.samples: list[JointState] = []
        deep = QoSProfile(depth=50_000)
        stage = f"/{name}/stage"
        ros.node.create_subscription(JointState, f"{stage}/encoder", self.samples.append, deep)
        self.force = ros.node.create_publisher(WrenchStamped, f"{stage}/force", 10)

    @property
    def position(self) -> float:
        return self.samples[-1].position[0]

    @property
    def time(self) -> int:
        return nanoseconds(self.samples[-1].header.stamp)

    def answer(self, force: float) -> None:
        message = WrenchStamped(header=self.samples[-1].header)
        message.wrench.force.x = force
        self.force.publish(message)


def start_stage(start, axis: str, *arguments: str, **parameters: object) -> None:
    given = {"mode": "lockstep", "control_rate": 1000.0, "wait_for_command": True, **parameters}
    start("stage_node", "--ros-args", "-r", f"__ns:=/{axis}", *arguments, **given)


def run_both(start, ros, steps: int) -> tuple[list[float], list[float], list[int]]:
    """Positions of both axes under one program that lets y follow x, and the times of the clock."""
    clock: list[Clock] = []
    ros.node.create_subscription(Clock, "/clock", clock.append, QoSProfile(depth=50_000))
    axes = {name: Axis(ros, name) for name in AXES}
    start_stage(start, "x", model="guide_2")
    # Of two publishers of one clock the later message may have the earlier time.
    start_stage(start, "y", "-r", "/clock:=/y/clock", model="guide_2")
    both = axes.values()
    ros.until(lambda: all(axis.samples for axis in both), "the first sample of both axes")
    ros.until(lambda: all(axis.force.get_subscription_count() >= 1 for axis in both), "both stages")
    x, y = axes["x"], axes["y"]
    paths: tuple[list[float], list[float]] = ([], [])
    for _ in range(steps):
        now = x.time
        assert y.time == now, "both axes are at the same sample"
        for path, axis in zip(paths, both, strict=True):
            path.append(axis.position)
        forces = 150.0, 2e5 * (x.position - y.position)

        def moved_on(now: int = now, forces: tuple[float, float] = forces) -> bool:
            if all(axis.time > now for axis in both):
                return True
            for axis, force in zip(both, forces, strict=True):
                # Sent again when the stage asks again.
                if axis.time == now and axis.samples[-1] is not asked.get(id(axis)):
                    asked[id(axis)] = axis.samples[-1]
                    axis.answer(force)
            return False

        asked: dict[int, JointState] = {}
        ros.until(moved_on, "the next sample of both axes")
    return *paths, [nanoseconds(message.clock) for message in clock]


def test_one_program_runs_two_axes_on_one_clock(start, ros, processes):
    x, y, clock = run_both(start, ros, 300)
    assert x[-1] > 1e-3 and y[-1] > 1e-4, "x is pushed, and y follows it"
    assert clock == sorted(clock)
    assert set(clock) >= {10**9 + k * PERIOD for k in range(300)}
    for process in processes:
        process.stop()
    processes.clear()
    assert run_both(start, ros, 300)[:2] == (x, y), "it repeats bit for bit"


def test_two_controllers_have_a_clock_each(start, ros):
    clocks: dict[str, list[Clock]] = {name: [] for name in AXES}
    samples: dict[str, list[JointState]] = {name: [] for name in AXES}
    for name in AXES:
        own_clock = ("-r", f"/clock:=/{name}/clock")
        deep = QoSProfile(depth=50_000)
        ros.node.create_subscription(Clock, f"/{name}/clock", clocks[name].append, deep)
        encoder = f"/{name}/stage/encoder"
        ros.node.create_subscription(JointState, encoder, samples[name].append, deep)
        # No faster than Python reads every sample of both axes.
        start_stage(start, name, *own_clock, model="guide_2", clock_pause=0.002)
        start("controller_node", "--ros-args", "-r", f"__ns:=/{name}", *own_clock, rate=1000.0)
    ros.until(lambda: all(len(s) > 100 for s in samples.values()), "both axes run")
    setpoint = ros.node.create_publisher(JointTrajectory, "/x/stage/setpoint", 10)
    ros.until(lambda: setpoint.get_subscription_count() == 2, "stage and controller of x")
    setpoint.publish(trajectory([rest(0.2, 1e-3)]))
    ros.until(lambda: abs(samples["x"][-1].position[0] - 1e-3) < 1e-6, "x is at 1 mm")
    for name in AXES:
        times = [nanoseconds(message.clock) for message in clocks[name]]
        assert len(times) > 100 and times == sorted(times)
        assert all(b - a == PERIOD for a, b in zip(times, times[1:], strict=False) if b > a)
    assert samples["y"][-1].position[0] == pytest.approx(0.0, abs=1e-7)
    assert ros.node.count_publishers("/clock") == 0
