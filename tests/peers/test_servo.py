"""The stage drives itself along setpoints: the measuring rig, and setpoints that are streamed one
by one."""

import statistics

import pytest
from diagnostics import ERROR, OK, Diagnostics
from ros import nanoseconds, trajectory
from std_srvs.srv import SetBool

# Guide 2 at constant velocity (crates/friction-stage-core/src/model/catalogue.yaml): Coulomb
# friction and viscous friction.
COULOMB, VISCOUS = 4.8, 18.0


def test_the_measuring_rig_follows_a_motion_and_its_cell_reads_the_friction_of_the_guide(
    ros, stage
):
    stage(
        model="rig:guide_2",
        drive="servo",
        control_rate=1000.0,
        physics_rate=100000.0,
        servo_bandwidth=60.0,
    )
    cell = ros.collect("/stage/force_cell")
    encoder = ros.collect("/stage/encoder")
    setpoint = ros.publisher("/stage/setpoint")
    # 40 mm at 40 mm/s, with a ramp at both ends.
    setpoint.publish(
        trajectory(
            [
                {"time": 0.2, "positions": [0.004], "velocities": [0.04], "accelerations": [0.0]},
                {"time": 1.1, "positions": [0.040], "velocities": [0.04], "accelerations": [0.0]},
                {"time": 1.3, "positions": [0.044], "velocities": [0.0], "accelerations": [0.0]},
            ]
        )
    )
    ros.until(
        lambda: encoder and abs(encoder[-1].position[0] - 0.044) < 5e-6, "the arrival at 44 mm"
    )
    moving = {nanoseconds(m.header.stamp) for m in encoder if 0.015 < m.position[0] < 0.035}
    forces = [m.wrench.force.x for m in cell if nanoseconds(m.header.stamp) in moving]
    assert len(forces) > 300
    # Noise of 0.05 N over hundreds of samples; the velocity settles within a few percent of 0.7 N.
    assert statistics.fmean(forces) == pytest.approx(COULOMB + VISCOUS * 0.04, abs=0.1)


def test_streamed_setpoints_move_the_stage(ros, stage, controller):
    stage(mode="realtime", control_rate=1000.0)
    controller(rate=1000.0, bandwidth=30.0)
    encoder = ros.collect("/stage/encoder", depth=10)
    states = ros.collect("/controller/state", depth=10)
    setpoint = ros.publisher("/stage/setpoint", readers=2)
    target = 0.0
    while target < 0.01:
        target = min(target + 2e-4, 0.01)
        seen = len(encoder)
        setpoint.publish(trajectory([{"time": 0.0, "positions": [target], "velocities": [0.02]}]))
        ros.until(lambda: len(encoder) > seen + 5, "the next samples")
    setpoint.publish(trajectory([{"time": 0.0, "positions": [target], "velocities": [0.0]}]))
    ros.until(lambda: abs(encoder[-1].position[0] - 0.01) < 20e-6, "the arrival at 10 mm")
    assert states[-1].reference_position == 0.01


def test_a_loop_of_its_own_that_does_not_hold_is_stopped_until_it_is_enabled(ros, stage, tmp_path):
    # A motor that the static friction holds.
    model = tmp_path / "weak.yaml"
    model.write_text(
        "mass: 40.0\nguides: [guide_1, guide_1, guide_1, guide_1]\nmotor: {force_limit: 20.0}\n"
    )
    stage(model=str(model), mode="realtime", drive="servo", control_rate=1000.0)
    diagnostics = Diagnostics(ros)
    assert diagnostics.newest().level == OK
    ros.publisher("/stage/setpoint").publish(
        trajectory([{"time": 0.2, "positions": [0.02], "velocities": [0.0]}])
    )
    status = diagnostics.until(lambda status: status.level == ERROR, "the stop")
    assert status.message.startswith("stopped: "), status
    ros.publisher("/stage/setpoint").publish(
        trajectory([{"time": 0.2, "positions": [0.01], "velocities": [0.0]}])
    )
    diagnostics.refusal("refused_commands", 1, "the loop was stopped")
    assert ros.call(SetBool, "/stage/enable", data=True).success
    diagnostics.until(lambda status: status.level == OK, "a loop that holds")


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_stage_and_controller_say_the_same_of_a_loop_that_was_stopped(
    ros, stage, controller, tmp_path, mode
):
    model = tmp_path / "weak.yaml"
    model.write_text(
        "mass: 40.0\nguides: [guide_1, guide_1, guide_1, guide_1]\nmotor: {force_limit: 20.0}\n"
    )
    stage(model=str(model), mode=mode, control_rate=1000.0)
    controller(rate=1000.0, bandwidth=30.0)
    of_stage, of_controller = Diagnostics(ros), Diagnostics(ros, "/controller: controller")
    for one in (of_stage, of_controller):
        one.until(lambda status: status.level == OK and status.message == "running", "a sound loop")
    ros.follow([{"time": 0.2, "positions": [0.02], "velocities": [0.0]}])
    status = of_controller.until(lambda status: status.level == ERROR, "the stop")
    assert status.message.startswith("stopped: "), status
    # The controller is silent: the stage moves on without force, or waits for an answer.
    of_stage.until(
        lambda status: (
            "commands have stopped" in status.message
            if mode == "realtime"
            else status.level == ERROR and "the answer to the last sample" in status.message
        ),
        "the same from the stage",
    )
    assert ros.call(SetBool, "/controller/enable", data=True).success
    for one in (of_stage, of_controller):
        one.until(lambda status: status.level == OK and status.message == "running", "a sound loop")
