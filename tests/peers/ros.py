"""The node of a test, as users have it (testing/), with our own messages."""

import math
import sys
import time
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from friction_stage_msgs.msg import ControllerState, StageState
from rosgraph_msgs.msg import Clock
from simulation_interfaces.msg import Result, SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetEntityState,
    GetSimulatorFeatures,
    SetSimulationState,
    StepSimulation,
)
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

    def follow(self, points: list[dict], lead: float = 5.0) -> int:
        """Has the controller follow a trajectory that starts `lead` s of the stage's time from now.
        Returns its start, ns.

        The first message to a new subscriber may take 3 s, in which lockstep may be a minute on.
        There time stands still meanwhile: it goes on sample by sample until the controller says
        that it has the trajectory.
        """
        states = self.collect("/controller/state", depth=10)
        # The stage hears setpoints too, for its recording.
        setpoint = self.publisher("/stage/setpoint", readers=2)
        self.until(lambda: states, "the state of the controller")
        features = self.call(
            GetSimulatorFeatures, "/stage/get_simulator_features"
        ).features.features
        lockstep = SimulatorFeatures.STEP_SIMULATION_SINGLE in features
        if lockstep:
            self.set_simulation_state(SimulationState.STATE_PAUSED)
        entity = self.call(GetEntityState, "/stage/get_entity_state", entity="stage")
        start = nanoseconds(entity.state.header.stamp) + round(lead * 1e9)

        deadline, sent = time.monotonic() + testing.PATIENCE, -math.inf
        while nanoseconds(states[-1].setpoint_stamp) != start:
            now = time.monotonic()
            late = nanoseconds(states[-1].header.stamp) > start
            assert now < deadline and not late, (
                f"the trajectory of {start} ns was not accepted in time"
            )
            if now - sent > 1.0:
                setpoint.publish(trajectory(points, start))
                sent = now
            if lockstep:
                step = self.call(StepSimulation, "/stage/step_simulation", steps=1).result
                assert step.result == Result.RESULT_OK, step.error_message
            self.executor.spin_once(timeout_sec=0.01)
        if lockstep:
            self.set_simulation_state(SimulationState.STATE_PLAYING)
        return start

    def set_simulation_state(self, state: int) -> None:
        wanted = SimulationState(state=state)
        answer = self.call(SetSimulationState, "/stage/set_simulation_state", state=wanted).result
        assert answer.result == Result.RESULT_OK, answer.error_message
