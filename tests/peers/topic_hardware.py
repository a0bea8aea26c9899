"""A stand-in for a controller_manager with joint_state_topic_hardware_interface, in rclpy.

Behaves on the wire as the real one: reads joint states best effort, volatile, depth 5, by joint name, without looking at
their stamps; writes effort-only commands reliable, volatile, depth 1, every cycle, stamped with its own clock; before the
first state the effort is NaN. Its cycle runs on wall time, or on simulated time with use_sim_time: then it says nothing
before the clock runs, and wakes once per period of it. On it runs the effort law of a joint_trajectory_controller.
"""

import math
import threading

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


class TopicHardware(Node):
    """Moves the stage from where it is to `target` (m) within `duration` (s) once it has a state, and holds it there."""

    def __init__(
        self, rate: float, target: float, duration: float, use_sim_time: bool, **options: object
    ) -> None:
        super().__init__(
            "controller_manager",
            **options,
            parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
        )
        self.period, self.target, self.duration = 1.0 / rate, target, duration
        self.use_sim_time, self.clock_moved = use_sim_time, threading.Condition()
        self.position = self.velocity = self.effort = math.nan
        self.start: tuple[float, float] | None = None
        self.integral = 0.0
        self.silent_cycles = self.cycles = 0
        self.largest_error = self.elapsed = 0.0
        self.commands = self.create_publisher(JointState, "/stage/joint_commands", COMMANDS)
        self.own_executor = SingleThreadedExecutor(context=self.context)
        self.own_executor.add_node(self)
        self.running = True
        self.executor_thread = threading.Thread(target=self.spin, daemon=True)
        self.cycle_thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self) -> "TopicHardware":
        self.executor_thread.start()
        self.cycle_thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.running = False
        self.cycle_thread.join(5.0)
        self.executor_thread.join(5.0)
        self.own_executor.shutdown()
        self.destroy_node()

    def spin(self) -> None:
        try:
            while self.running:
                self.own_executor.spin_once(timeout_sec=0.1)
        except ExternalShutdownException:
            pass

    def on_state(self, state: JointState) -> None:
        index = state.name.index("stage")
        # As in the plugin: a non-empty array that is not as long as `name` is an error.
        for field in (state.position, state.velocity, state.effort):
            assert len(field) in (0, len(state.name))
        self.position, self.velocity, self.effort = (
            state.position[index],
            state.velocity[index],
            state.effort[index],
        )

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
        """As rclcpp's. rclpy's misses a simulated time that comes while it begins to wait, and in lockstep no other does."""
        if not self.use_sim_time:
            clock.sleep_until(wake, context=self.context)
            return
        with self.clock_moved:
            while self.running and clock.now() < wake:
                self.clock_moved.wait(0.1)

    def cycle(self, clock: Clock) -> None:
        # On simulated time this waits for the first clock, on wall time it returns at once.
        self.sleep_until(clock, Time(nanoseconds=1, clock_type=clock.clock_type))
        wake = now = clock.now()
        while self.running:
            command = JointState(name=["stage"], effort=[self.update(now.nanoseconds * 1e-9)])
            command.header.stamp = now.to_msg()
            if self.cycles == BLIND_CYCLES:
                self.create_subscription(JointState, "/stage/encoder", self.on_state, STATES)
            self.commands.publish(command)
            wake = wake + Duration(seconds=self.period)
            self.sleep_until(clock, wake)
            now = clock.now()
            wake = max(wake, now, key=lambda time: time.nanoseconds)

    def update(self, now: float) -> float:
        self.cycles += 1
        position, velocity = self.position, self.velocity
        if math.isnan(position):
            self.silent_cycles += 1
            return math.nan
        if self.start is None:
            self.start = (now, position)
        begin, origin = self.start
        self.elapsed = now - begin
        t = min(self.elapsed / self.duration, 1.0)
        stroke = self.target - origin
        reference = origin + stroke * (10 * t**3 - 15 * t**4 + 6 * t**5)
        speed = stroke * (30 * t**2 - 60 * t**3 + 30 * t**4) / self.duration
        error = reference - position
        self.largest_error = max(self.largest_error, abs(error))
        self.integral += I * error * self.period
        self.integral = min(max(self.integral, -INTEGRAL_LIMIT), INTEGRAL_LIMIT)
        return P * error + self.integral + D * (speed - velocity) + VELOCITY_FEEDFORWARD * speed
