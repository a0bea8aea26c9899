"""A position controller for the stage as a ROS 2 user would write it with rclpy: PID, lowpass,
feedforward.

It answers every encoder sample with a force that carries the sample's stamp, which is all that
lockstep asks for. The law is that of the project's own controller, written down a second time.
"""

import math
from dataclasses import dataclass

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from ros import nanoseconds


@dataclass
class Gains:
    """p N/m, i N/(m s), d N s/m; lowpass Hz and damping ratio."""

    p: float
    i: float
    d: float
    lowpass_frequency: float
    lowpass_damping: float

    @classmethod
    def from_bandwidth(cls, bandwidth: float, mass: float) -> "Gains":
        """For a free mass: integrator at 1/10, differentiator at 1/3 of the crossover, lowpass at 6
        times it."""
        crossover = 2 * math.pi * bandwidth
        integrator, differentiator, lowpass = crossover / 10, crossover / 3, 6 * crossover
        damping = 1 / math.sqrt(2)
        s = 1j * crossover
        shape = (1 + integrator / s + s / differentiator) * lowpass**2
        shape /= s**2 + 2 * damping * lowpass * s + lowpass**2
        p = mass * crossover**2 / abs(shape)
        return cls(p, p * integrator, p / differentiator, 6 * bandwidth, damping)


@dataclass
class Move:
    """From rest at `origin` to rest at `target` (m): minimum jerk over `duration` from `start` on
    (ns)."""

    start: int
    duration: int
    origin: float
    target: float

    def fraction(self, time: int) -> float:
        return min(max((time - self.start) / self.duration, 0.0), 1.0)

    def position(self, time: int) -> float:
        t = self.fraction(time)
        return self.origin + (self.target - self.origin) * (10 * t**3 - 15 * t**4 + 6 * t**5)

    def velocity(self, time: int) -> float:
        t = self.fraction(time)
        return (
            (self.target - self.origin)
            * (30 * t**2 - 60 * t**3 + 30 * t**4)
            / (self.duration * 1e-9)
        )


class PythonController(Node):
    """Holds `reference` until `move` is set, and then follows it. Keeps the position (m) of each
    sample by its stamp."""

    def __init__(
        self, gains: Gains, mass: float, rate: float, force_limit: float, **options: object
    ) -> None:
        super().__init__("python_controller", **options)
        self.gains, self.mass, self.rate, self.force_limit = gains, mass, rate, force_limit
        self.period = 1.0 / rate
        self.period_ns = round(1e9 / rate)
        self.reference = 0.0
        self.move: Move | None = None
        self.integral = 0.0
        self.last_error: float | None = None
        self.x1 = self.x2 = self.y1 = self.y2 = 0.0
        k, z = math.tan(math.pi * gains.lowpass_frequency * self.period), gains.lowpass_damping
        n = 1 / (1 + 2 * z * k + k * k)
        self.b0 = k * k * n
        self.a1, self.a2 = 2 * (k * k - 1) * n, (1 - 2 * z * k + k * k) * n
        self.positions: dict[int, float] = {}
        self.force = self.create_publisher(WrenchStamped, "/stage/force", 10)
        self.create_subscription(
            JointState, "/stage/encoder", self.on_encoder, QoSProfile(depth=10)
        )

    def on_encoder(self, sample: JointState) -> None:
        now = nanoseconds(sample.header.stamp)
        position = sample.position[sample.name.index("stage")]
        # The stage sends a sample again when its answer does not come: it gets the same answer
        # again.
        if now not in self.positions:
            self.positions[now] = position
            self.answer = WrenchStamped(header=sample.header)
            self.answer.wrench.force.x = self.update(now, position)
        self.force.publish(self.answer)

    def update(self, now: int, position: float) -> float:
        """The force (N) that answers the sample at `now` (ns)."""
        target, velocity, acceleration = self.reference, 0.0, 0.0
        if self.move is not None:
            target, velocity = self.move.position(now), self.move.velocity(now)
            acceleration = (self.move.velocity(now + self.period_ns) - velocity) / self.period
        error = target - position
        self.integral += self.gains.i * self.period * error
        change = 0.0 if self.last_error is None else error - self.last_error
        self.last_error = error
        feedback = self.lowpass(
            self.gains.p * error + self.integral + self.gains.d * change / self.period
        )
        force = feedback + self.mass * acceleration
        return min(max(force, -self.force_limit), self.force_limit)

    def lowpass(self, x: float) -> float:
        y = self.b0 * (x + 2 * self.x1 + self.x2) - self.a1 * self.y1 - self.a2 * self.y2
        self.x1, self.x2 = x, self.x1
        self.y1, self.y2 = y, self.y1
        return y
