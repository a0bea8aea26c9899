"""A JointTrajectory of several points moves the stage there."""

import pytest
from ros import nanoseconds, trajectory

# Out, on through a point, and back; cubic between the points, at rest at the end.
# A loop that neither stops nor gives up bandwidth on a busy machine.
UNSUPERVISED = {"supervision__enabled": False, "supervision__delay": 3600.0}
POINTS = [
    {"time": 0.2, "positions": [0.010], "velocities": [0.1]},
    {"time": 0.4, "positions": [0.030], "velocities": [0.05]},
    {"time": 0.7, "positions": [0.020], "velocities": [0.0]},
]


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_trajectory_of_several_points_moves_the_stage_there(ros, stage, controller, mode):
    # 1 kHz and a bandwidth that leaves room for the time on the wire. Wall time on a busy machine
    # promises no delay: there the stage must arrive, in lockstep it must also keep to the way.
    stage(mode=mode, control_rate=1000.0, noise=False, command_timeout=5.0)
    late = {} if mode == "lockstep" else UNSUPERVISED
    controller(rate=1000.0, bandwidth=30.0, **late)
    states = ros.collect("/controller/state")
    encoder = ros.collect("/stage/encoder")
    start = ros.follow(POINTS)
    end = start + 1_200_000_000
    for messages in (states, encoder):
        ros.until(lambda: nanoseconds(messages[-1].header.stamp) > end, "the end of the move")

    assert any(not state.holding for state in states) and states[-1].holding
    for point in POINTS:
        at = start + round(point["time"] * 1e9)
        nearest = min(states, key=lambda state: abs(nanoseconds(state.header.stamp) - at))
        late = (nanoseconds(nearest.header.stamp) - at) * 1e-9
        assert abs(late) <= 2e-3, f"no state within 2 ms of {point['time']} s"
        expected = point["positions"][0] + point["velocities"][0] * late
        assert nearest.reference_position == pytest.approx(expected, abs=10e-6)
        if mode == "lockstep":
            assert nearest.position == pytest.approx(nearest.reference_position, abs=300e-6)
    target = POINTS[-1]["positions"][0]
    ros.until(lambda: abs(encoder[-1].position[0] - target) < 20e-6, f"the arrival at {target} m")


def test_stamp_zero_means_now(ros, stage, controller):
    stage(mode="lockstep", control_rate=1000.0, noise=False)
    controller(rate=1000.0, bandwidth=30.0)
    encoder = ros.collect("/stage/encoder")
    setpoint = ros.publisher("/stage/setpoint", readers=2)
    setpoint.publish(
        trajectory(
            [{"time": 0.1, "positions": [0.005], "velocities": [0.0], "accelerations": [0.0]}]
        )
    )
    ros.until(
        lambda: encoder and abs(encoder[-1].position[0] - 0.005) < 20e-6, "the arrival at 5 mm"
    )
