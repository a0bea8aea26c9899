"""A stand-in for a controller_manager with joint_state_topic_hardware_interface 1.1.0, in rclpy.

On the wire, and in what can overtake what, as the real pair: two nodes, each with a clock of its
own.

The manager's loop has a thread. On simulated time it sleeps until its clock is a period on from
where it was, then reads, computes and writes, once: whoever waits for a second command of the same
tick waits for ever. A clock that comes again is no tick.

The plugin's node has another thread for its `/clock` and its joint states (best effort, volatile,
depth 5, by joint name, whatever their stamp). Reading takes the states that it heard last; writing
publishes the effort (reliable, volatile, depth 1) with the time that the plugin's own clock shows.
Sample and clock of a tick may reach the plugin after the manager: the command is then computed from
the sample before, or has the stamp of the tick before, or both. Before the first state the effort
is NaN.

On it runs the effort law of a joint_trajectory_controller.
"""

import math
import threading
from dataclasses import dataclass

from rclpy.clock import Clock, JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState

STATES = QoSProfile(
    depth=5, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
)
COMMANDS = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE
)
# p N/m, i N/(m s), d N s/m, limit of the integral term N, friction feedforward N s/m
P, I, D, INTEGRAL_LIMIT, VELOCITY_FEEDFORWARD = 39500.0, 60000.0, 2000.0, 100.0, 30.0
# Cycles before the states are looked for, so that some are certainly without one.
BLIND_CYCLES = 50


@dataclass(frozen=True)
class State:
    stamp: int
    position: float
    velocity: float


class Plugin(Node):
    """The hardware's node. Its subscriptions are spun by a thread that knows nothing of the
    manager's loop."""

    def __init__(self, use_sim_time: bool, **options: object) -> None:
        super().__init__(
            "stage_hardware",
            **options,
            parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
        )
        self.state: State | None = None
        self.commands = self.create_publisher(JointState, "/stage/joint_commands", COMMANDS)

    def connect(self) -> None:
        self.create_subscription(JointState, "/stage/encoder", self.on_state, STATES)

    def on_state(self, state: JointState) -> None:
        index = state.name.index("stage")
        # As in the plugin: a non-empty array that is not as long as `name` is an error.
        for field in (state.position, state.velocity, state.effort):
            assert len(field) in (0, len(state.name))
        stamp = state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
        self.state = State(stamp, state.position[index], state.velocity[index])

    def read(self) -> State | None:
        return self.state

    def write(self, effort: float) -> int:
        """Publishes the command; returns its stamp, ns."""
        now = self.get_clock().now()
        command = JointState(name=["stage"], effort=[effort])
        command.header.stamp = now.to_msg()
        self.commands.publish(command)
        return now.nanoseconds


class TopicHardware(Node):
    """Moves the stage from where it is to `target` (m) within `duration` (s) once it has a state,
    and holds it there."""

    def __init__(
        self, rate: float, target: float, duration: float, use_sim_time: bool, **options: object
    ) -> None:
        super().__init__(
            "controller_manager",
            **options,
            parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
        )
        self.plugin = Plugin(use_sim_time, **options)
        self.period, self.target, self.duration = 1.0 / rate, target, duration
        self.use_sim_time, self.clock_moved = use_sim_time, threading.Condition()
        self.start: tuple[float, float] | None = None
        self.integral = 0.0
        self.silent_cycles = self.cycles = 0
        # Cycles whose command had an older stamp, and an older state, than the manager's tick.
        self.late_stamps = self.late_states = 0
        self.largest_error = self.elapsed = 0.0
        self.executors = [SingleThreadedExecutor(context=self.context) for _ in range(2)]
        self.executors[0].add_node(self)
        self.executors[1].add_node(self.plugin)
        self.running = True
        self.threads = [
            threading.Thread(target=self.spin, args=(executor,), daemon=True)
            for executor in self.executors
        ]
        self.threads.append(threading.Thread(target=self.run, daemon=True))

    def __enter__(self) -> "TopicHardware":
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.running = False
        for thread in reversed(self.threads):
            thread.join(5.0)
        for executor in self.executors:
            executor.shutdown()
        self.plugin.destroy_node()
        self.destroy_node()

    def spin(self, executor: SingleThreadedExecutor) -> None:
        try:
            while self.running:
                executor.spin_once(timeout_sec=0.1)
        except ExternalShutdownException:
            pass

    def run(self) -> None:
        clock = self.get_clock()
        threshold = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=None, on_clock_change=True
        )
        with clock.create_jump_callback(threshold, post_callback=self.on_clock):
            self.cycle(clock)

    def on_clock(self, _: object) -> None:
        with self.clock_moved:
            self.clock_moved.notify_all()

    def sleep_until(self, clock: Clock, wake: Time) -> None:
        """As rclcpp's. rclpy's misses a simulated time that comes while it begins to wait, and in
        lockstep no other does."""
        if not self.use_sim_time:
            clock.sleep_until(wake, context=self.context)
            return
        with self.clock_moved:
            while self.running and clock.now() < wake:
                self.clock_moved.wait(0.1)

    def cycle(self, clock: Clock) -> None:
        # On simulated time this waits for the first clock, on wall time it returns at once.
        self.sleep_until(clock, Time(nanoseconds=1, clock_type=clock.clock_type))
        period = Duration(seconds=self.period)
        wake = now = clock.now()
        while self.running:
            if self.cycles == BLIND_CYCLES:
                self.plugin.connect()
            state = self.plugin.read()
            stamp = self.plugin.write(self.update(now.nanoseconds * 1e-9, state))
            if self.use_sim_time and state is not None:
                self.late_stamps += stamp < now.nanoseconds
                self.late_states += state.stamp < now.nanoseconds
            # On simulated time a period on from where the clock was found; on wall time at fixed
            # deadlines.
            wake = (now if self.use_sim_time else wake) + period
            self.sleep_until(clock, wake)
            now = clock.now()
            wake = max(wake, now, key=lambda time: time.nanoseconds)

    def update(self, now: float, state: State | None) -> float:
        self.cycles += 1
        if state is None:
            self.silent_cycles += 1
            return math.nan
        if self.start is None:
            self.start = (now, state.position)
        begin, origin = self.start
        self.elapsed = now - begin
        t = min(self.elapsed / self.duration, 1.0)
        stroke = self.target - origin
        reference = origin + stroke * (10 * t**3 - 15 * t**4 + 6 * t**5)
        speed = stroke * (30 * t**2 - 60 * t**3 + 30 * t**4) / self.duration
        error = reference - state.position
        self.largest_error = max(self.largest_error, abs(error))
        self.integral += I * error * self.period
        self.integral = min(max(self.integral, -INTEGRAL_LIMIT), INTEGRAL_LIMIT)
        return (
            P * error + self.integral + D * (speed - state.velocity) + VELOCITY_FEEDFORWARD * speed
        )
