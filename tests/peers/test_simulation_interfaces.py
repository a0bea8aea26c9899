"""A test script pauses, steps and resets the stage as any simulator, by `simulation_interfaces`."""

import pytest
from action_msgs.msg import GoalStatus
from friction_stage_testing import program
from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionClient
from ros import nanoseconds, rest, trajectory
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result, SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetEntityState,
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)

PERIOD = 10**6
OK, FAILED = Result.RESULT_OK, Result.RESULT_OPERATION_FAILED
STOPPED, PLAYING, PAUSED = (
    SimulationState.STATE_STOPPED,
    SimulationState.STATE_PLAYING,
    SimulationState.STATE_PAUSED,
)


class Simulator:
    """The services of the stage, as results."""

    def __init__(self, ros) -> None:
        self.ros = ros

    def set(self, state: int) -> int:
        wanted = SimulationState(state=state)
        return self.ros.call(
            SetSimulationState, "/stage/set_simulation_state", state=wanted
        ).result.result

    def state(self) -> int:
        return self.ros.call(GetSimulationState, "/stage/get_simulation_state").state.state

    def step(self, steps: int) -> Result:
        return self.ros.call(StepSimulation, "/stage/step_simulation", steps=steps).result

    def reset(self, scope: int = 0) -> int:
        return self.ros.call(ResetSimulation, "/stage/reset_simulation", scope=scope).result.result

    def entity(self, name: str = "stage"):
        return self.ros.call(GetEntityState, "/stage/get_entity_state", entity=name)


def stamps(samples) -> list[int]:
    return sorted({nanoseconds(sample.header.stamp) for sample in samples})


def test_it_says_what_it_can(ros, stage):
    stage(mode="lockstep", control_rate=1000.0)
    features = ros.call(GetSimulatorFeatures, "/stage/get_simulator_features").features.features
    for feature in (
        SimulatorFeatures.STEP_SIMULATION_SINGLE,
        SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
        SimulatorFeatures.STEP_SIMULATION_ACTION,
        SimulatorFeatures.SIMULATION_STATE_PAUSE,
        SimulatorFeatures.SIMULATION_RESET_STATE,
        SimulatorFeatures.ENTITY_STATE_GETTING,
    ):
        assert feature in features
    assert SimulatorFeatures.SIMULATION_RESET_TIME not in features


def test_a_paused_stage_stands_still_and_steps_are_samples(ros, stage):
    """Without a controller: the free run."""
    stage(mode="lockstep", control_rate=1000.0)
    simulator = Simulator(ros)
    encoder = ros.collect("/stage/encoder")
    ros.until(lambda: encoder, "a sample")
    assert simulator.state() == PLAYING
    assert simulator.set(PAUSED) == OK and simulator.state() == PAUSED
    ros.spin(0.3)
    stood = stamps(encoder)[-1]
    ros.spin(0.3)
    assert stamps(encoder)[-1] == stood
    for steps in (1, 7, 500):
        assert simulator.step(steps).result == OK
        ros.until(lambda: stamps(encoder)[-1] == stood + steps * PERIOD, "the last of the steps")
        stood += steps * PERIOD
    ros.spin(0.2)
    assert stamps(encoder)[-1] == stood
    assert simulator.set(PLAYING) == OK
    ros.until(lambda: stamps(encoder)[-1] > stood + 100 * PERIOD, "time that goes on")
    whole = stamps(encoder)
    assert {b - a for a, b in zip(whole, whole[1:])} == {PERIOD}


def run(friction_stage, processes, drive) -> list:
    """400 samples of a stage under our controller, which answers none before its setpoint."""
    stage = friction_stage(control_rate=1000.0)
    stage.start(
        [str(program("controller_node"))], rate=1000.0, bandwidth=30.0, wait_for_setpoint=True
    )
    ros = stage.ros
    drive(
        ros,
        lambda: ros.publisher("/stage/setpoint", readers=2).publish(
            trajectory([rest(0.1, 0.01), rest(0.3, -0.01)])
        ),
    )
    first = nanoseconds(stage.samples[0].header.stamp)
    ros.until(lambda: stamps(stage.samples[-1:])[0] >= first + 399 * PERIOD, "400 samples")
    by_stamp = {nanoseconds(m.header.stamp): m for m in stage.samples}
    picked = [by_stamp[first + k * PERIOD] for k in range(400)]
    while processes:
        processes.pop().stop()
    return [(m.position[0], m.velocity[0], m.effort[0]) for m in picked]


def test_steps_are_bit_for_bit_the_samples_of_lockstep(friction_stage, friction_stage_processes):
    def playing(_, move) -> None:
        move()

    def stepping(ros, move) -> None:
        simulator = Simulator(ros)
        assert simulator.set(PAUSED) == OK
        # The sample that is out is answered, which is no step.
        move()
        for steps in (1, 1, 3, 95, 250, 49):
            result = simulator.step(steps)
            assert result.result == OK, result

    runs = [run(friction_stage, friction_stage_processes, drive) for drive in (playing, stepping)]
    assert max(abs(position) for position, _, _ in runs[0]) > 5e-3
    assert runs[0] == runs[1]


def test_a_sample_that_is_out_when_steps_are_asked_for_is_none_of_them(friction_stage):
    stage = friction_stage(control_rate=1000.0, answer_timeout=60.0)
    ros, simulator = stage.ros, Simulator(stage.ros)
    client = ActionClient(ros.node, SimulateSteps, "/stage/simulate_steps")
    ros.until(client.server_is_ready, "the action")
    out = nanoseconds(stage.step(0.0).header.stamp)
    assert simulator.set(PAUSED) == OK
    # A goal that is accepted has reached the stage.
    goal = ros.result(client.send_goal_async(SimulateSteps.Goal(steps=1)), "the answer to a goal")
    end = goal.get_result_async()
    # After the answer to the sample that was out the step goes out.
    assert nanoseconds(stage.step(0.0).header.stamp) == out + PERIOD
    ros.spin(0.1)
    assert not end.done()
    stage.force.publish(WrenchStamped(header=stage.sample.header))
    assert ros.result(end, "the end of the step").result.result.result == OK
    ros.spin(0.1)
    assert nanoseconds(stage.sample.header.stamp) == out + PERIOD


def test_what_cannot_be_stepped_says_why(ros, stage):
    stage(mode="lockstep", control_rate=1000.0)
    simulator = Simulator(ros)
    playing = simulator.step(1)
    assert playing.result == FAILED and "not paused" in playing.error_message
    assert simulator.set(PAUSED) == OK
    assert simulator.set(PAUSED) == SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    assert simulator.step(0).result == FAILED
    assert simulator.set(77) == Result.RESULT_FEATURE_UNSUPPORTED
    assert simulator.set(STOPPED) == OK
    assert simulator.set(PAUSED) == SetSimulationState.Response.INCORRECT_TRANSITION
    assert simulator.set(PLAYING) == OK
    assert simulator.entity("robot").result.result == Result.RESULT_NOT_FOUND
    assert simulator.reset(ResetSimulation.Request.SCOPE_TIME) == Result.RESULT_FEATURE_UNSUPPORTED


def test_steps_that_nobody_answers_fail(friction_stage):
    stage = friction_stage(control_rate=1000.0, answer_timeout=0.2)
    stage.step(0.0)
    simulator = Simulator(stage.ros)
    assert simulator.set(PAUSED) == OK
    # The sample that is out, and the first of the steps.
    stage.force.publish(WrenchStamped(header=stage.sample.header))
    result = simulator.step(5)
    assert result.result == FAILED and "no answer to the sample" in result.error_message


def test_a_reset_puts_the_stage_back_and_time_goes_on(friction_stage):
    stage = friction_stage(control_rate=1000.0)
    simulator = Simulator(stage.ros)
    for _ in range(50):
        stage.step(300.0)
    state = simulator.entity().state
    assert state.pose.position.x == pytest.approx(stage.sample.position[0], abs=1e-8)
    assert state.twist.linear.x > 0.01 and state.acceleration.linear.x > 1.0
    assert nanoseconds(state.header.stamp) == nanoseconds(stage.sample.header.stamp)
    before = stage.time
    for scope in (ResetSimulation.Request.SCOPE_STATE, ResetSimulation.Request.SCOPE_DEFAULT):
        assert simulator.reset(scope) == OK
        assert abs(stage.step(0.0).position[0]) < 1e-6
    assert stage.time > before


def test_the_action_steps_with_feedback_and_can_be_stopped(ros, stage):
    stage(mode="lockstep", control_rate=1000.0)
    simulator = Simulator(ros)
    client = ActionClient(ros.node, SimulateSteps, "/stage/simulate_steps")
    ros.until(client.server_is_ready, "the action")
    feedback = []

    def send(steps: int):
        handle = ros.result(
            client.send_goal_async(
                SimulateSteps.Goal(steps=steps), lambda message: feedback.append(message.feedback)
            ),
            "the answer to a goal",
        )
        assert handle.accepted
        return handle

    def result(handle):
        wrapped = ros.result(handle.get_result_async(), "the result of a goal")
        return wrapped.status, wrapped.result.result.result

    assert result(send(10)) == (GoalStatus.STATUS_ABORTED, FAILED)
    assert simulator.set(PAUSED) == OK
    encoder = ros.collect("/stage/encoder")
    # Time stands still: a sample that is heard shows that the stage has found the subscription.
    while not encoder:
        assert result(send(1)) == (GoalStatus.STATUS_SUCCEEDED, OK)
    stood = nanoseconds(simulator.entity().state.header.stamp)
    ros.until(lambda: stamps(encoder[-1:]) == [stood], "the sample of now")
    heard = len(encoder)
    assert result(send(500)) == (GoalStatus.STATUS_SUCCEEDED, OK)
    ros.until(lambda: len(encoder) == heard + 500, "the 500 samples")
    endless = send(10**12)
    ros.until(lambda: feedback and feedback[-1].completed_steps > 500, "feedback")
    assert feedback[-1].completed_steps + feedback[-1].remaining_steps == 10**12
    ros.result(endless.cancel_goal_async(), "the answer to a cancel")
    assert result(endless)[0] == GoalStatus.STATUS_CANCELED
    stood = nanoseconds(simulator.entity().state.header.stamp)
    ros.spin(0.3)
    assert nanoseconds(simulator.entity().state.header.stamp) == stood
    # Nothing is lost of what was on its way.
    ros.until(lambda: stamps(encoder[-1:]) == [stood], "the last sample")
    whole = stamps(encoder)
    assert {b - a for a, b in zip(whole, whole[1:])} == {PERIOD}


def test_in_real_time_it_says_that_it_cannot_pause(ros, stage):
    stage(mode="realtime", control_rate=1000.0)
    simulator = Simulator(ros)
    features = ros.call(GetSimulatorFeatures, "/stage/get_simulator_features").features.features
    assert SimulatorFeatures.STEP_SIMULATION_SINGLE not in features
    assert simulator.set(PAUSED) == Result.RESULT_FEATURE_UNSUPPORTED
    assert simulator.step(1).result == Result.RESULT_FEATURE_UNSUPPORTED
    assert simulator.entity().result.result == OK
    assert simulator.reset(ResetSimulation.Request.SCOPE_STATE) == OK
