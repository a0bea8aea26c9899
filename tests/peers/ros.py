"""The node of a test, as users have it (testing/), with our own messages."""

import sys
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from friction_stage_msgs.msg import ControllerState, StageState
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray

# Programs of the tests import this, too.
sys.path.insert(0, str(Path(__file__).parents[2] / "testing"))
import friction_stage_testing as testing  # noqa: E402
from friction_stage_testing import nanoseconds, rest, stamp, trajectory  # noqa: E402

__all__ = ["TOPICS", "Ros", "nanoseconds", "rest", "stamp", "trajectory"]

TOPICS = {
    **testing.TOPICS,
    "/stage/commands": Float64MultiArray,
    "/stage/state": StageState,
    "/controller/state": ControllerState,
    "/clock": Clock,
    "/diagnostics": DiagnosticArray,
}


class Ros(testing.Ros):
    topics = TOPICS

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
