"""Commands and setpoints as they should not be: each is refused with its reason, and the stage
stays safe."""

import math
import random
import struct

import pytest
from builtin_interfaces.msg import Duration
from diagnostics import ERROR, OK, WARN, Diagnostics, number
from geometry_msgs.msg import WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from ros import nanoseconds, rest, stamp, trajectory
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

SECOND = 10**9
NAN, INF = math.nan, math.inf


def now() -> int:
    return Clock(clock_type=ClockType.SYSTEM_TIME).now().nanoseconds


def wrench(force: float, at: int | None = None) -> WrenchStamped:
    message = WrenchStamped()
    message.header.stamp = stamp(now() if at is None else at)
    message.wrench.force.x = force
    return message


def joints(names: list[str], efforts: list[float], at: int | None = None) -> JointState:
    message = JointState(name=names, effort=efforts)
    message.header.stamp = stamp(now() if at is None else at)
    return message


def array(*values: float) -> Float64MultiArray:
    return Float64MultiArray(data=list(values))


class Source:
    """A publisher that sends what `message` makes, 100 times a second, while the test waits for
    something."""

    def __init__(self, ros, topic: str, message) -> None:
        self.publisher = ros.publisher(topic)
        self.timer = ros.node.create_timer(0.01, lambda: self.publisher.publish(message()))

    def stop(self) -> None:
        self.timer.cancel()

    def go_on(self) -> None:
        self.timer.reset()


@pytest.fixture
def states(ros):
    return ros.collect("/stage/state")


def until_force(ros, states, force: float) -> None:
    del states[:]
    ros.until(
        lambda: any(state.motor_force == force for state in states), f"a motor force of {force} N"
    )


# --- commands that are none

NO_COMMANDS = [
    ("/stage/force", wrench(NAN), ["~/force", "NaN", "must be finite"]),
    ("/stage/force", wrench(INF), ["~/force", "force is inf", "must be finite"]),
    ("/stage/force", wrench(-INF), ["~/force", "force is -inf", "must be finite"]),
    (
        "/stage/joint_commands",
        joints(["stage"], [INF]),
        ["~/joint_commands", "force is inf", "must be finite"],
    ),
    (
        "/stage/joint_commands",
        joints(["slider"], [1.0]),
        ["~/joint_commands", "no joint `stage` among [slider]"],
    ),
    (
        "/stage/joint_commands",
        joints(["stage", "b"], [1.0]),
        ["~/joint_commands", "2 joint names but 1 efforts"],
    ),
    ("/stage/joint_commands", joints([], []), ["~/joint_commands", "no joint `stage` among []"]),
    ("/stage/commands", array(NAN), ["~/commands", "NaN", "must be finite"]),
    ("/stage/commands", array(), ["~/commands", "0 values", "exactly 1"]),
    ("/stage/commands", array(1.0, 2.0), ["~/commands", "2 values", "exactly 1"]),
]


def test_what_is_no_command_is_refused_with_the_reason_and_changes_nothing(ros, stage, states):
    stage(mode="realtime", control_rate=1000.0, command_timeout=10.0)
    diagnostics = Diagnostics(ros)
    Source(ros, "/stage/force", lambda: wrench(30.0))
    until_force(ros, states, 30.0)
    publishers = {topic: ros.publisher(topic) for topic, _, _ in NO_COMMANDS}
    del states[:]
    for count, (topic, message, words) in enumerate(NO_COMMANDS, start=1):
        publishers[topic].publish(message)
        diagnostics.refusal("refused_commands", count, *words)
    assert states and {state.motor_force for state in states} == {30.0}


@pytest.mark.parametrize(
    "topic, message",
    [
        ("/stage/joint_commands", lambda force: joints(["other", "stage"], [1.0, force])),
        ("/stage/commands", array),
    ],
)
def test_the_other_topics_command_as_well(ros, stage, states, topic, message):
    stage(mode="realtime", control_rate=1000.0, command_timeout=10.0)
    commands = ros.publisher(topic)
    commands.publish(message(30.0))
    until_force(ros, states, 30.0)
    assert Diagnostics(ros).newest().level == OK
    # Asking for no force ends it, long before the timeout.
    commands.publish(message(NAN) if message is not array else array(0.0))
    until_force(ros, states, 0.0)
    assert number(Diagnostics(ros).newest(), "stale_commands") == 0


def garbage() -> list[bytes]:
    """Bytes that are no message, most of them in the encapsulation of CDR."""
    chaos = random.Random(1)
    return [
        b"\0",
        b"\0\1\0",
        b"\0\1\0\0",
        bytes(200),
        b"\0\1\0\0" + bytes(7),
        # Another encapsulation, and strings and sequences of 4 GiB.
        b"\x77\x77\0\0" + bytes(100),
        b"\0\1\0\0" + bytes(8) + b"\xff" * 4,
        b"\0\1\0\0" + b"\xff" * 300,
        b"\0\1\0\0" + struct.pack("<iIII", 1, 0, 1, 0) + b"\xff" * 64,
        *(b"\0\1\0\0" + chaos.randbytes(chaos.randrange(4, 2000)) for _ in range(50)),
        chaos.randbytes(60_000),
    ]


def test_bytes_that_are_no_message_do_not_end_the_nodes(ros, stage, controller, states):
    stage(mode="realtime", control_rate=1000.0)
    diagnostics = Diagnostics(ros)
    topics = ["/stage/force", "/stage/joint_commands", "/stage/commands", "/stage/setpoint"]
    # Deep enough that none of a burst gives way to the next before a loaded machine has sent it.
    publishers = [ros.publisher(topic, depth=100) for topic in topics]
    for bad in garbage():
        for publisher in publishers:
            publisher.publish(bad)
    # A message behind them, so that they have all been read when it acts.
    publishers[0].publish(wrench(30.0))
    until_force(ros, states, 30.0)
    status = diagnostics.until(
        lambda status: number(status, "refused_commands") > 100, "over 100 refusals"
    )
    assert status.level == WARN and "unreadable" in status.message
    controller(rate=1000.0, bandwidth=30.0)
    setpoint = ros.publisher("/stage/setpoint", readers=2, depth=100)
    for bad in garbage():
        setpoint.publish(bad)
    setpoint.publish(trajectory([rest(0.3, 0.001)]))
    encoder = ros.collect("/stage/encoder")
    ros.until(
        lambda: encoder and abs(encoder[-1].position[0] - 0.001) < 50e-6,
        "the move behind the garbage",
    )
    # The status that counts them all may come a little after the move.
    Diagnostics(ros, "/controller: controller").until(
        lambda status: number(status, "refused_setpoints") > 20, "over 20 refused setpoints"
    )


# --- stamps


def test_a_stamp_that_repeats_is_of_a_newer_command_and_one_that_goes_back_is_refused(
    ros, stage, states
):
    stage(mode="realtime", control_rate=1000.0, command_timeout=60.0)
    diagnostics = Diagnostics(ros)
    force = ros.publisher("/stage/force")
    at = now()
    force.publish(wrench(30.0, at))
    until_force(ros, states, 30.0)
    del states[:]
    force.publish(wrench(60.0, at - SECOND))
    diagnostics.refusal("refused_commands", 1, f"stamp {at - SECOND} ns goes back behind {at} ns")
    assert states and {state.motor_force for state in states} == {30.0}
    for wanted in (60.0, 50.0, 40.0):
        force.publish(wrench(wanted, at))
        until_force(ros, states, wanted)
    assert number(diagnostics.newest(), "refused_commands") == 1


def test_a_source_whose_clock_was_set_back_may_go_on_after_a_silence(ros, stage, states):
    stage(mode="realtime", control_rate=1000.0, command_timeout=0.1)
    diagnostics = Diagnostics(ros)
    force = ros.publisher("/stage/force")
    ahead = now() + 3600 * SECOND
    force.publish(wrench(30.0, ahead))
    diagnostics.until(lambda status: number(status, "stale_commands") == 1, "the silence")
    force.publish(wrench(60.0, now()))
    until_force(ros, states, 60.0)


class Stepper:
    """A lockstep stage under the test's hand: time stands still until the test answers."""

    def __init__(self, ros, stage, **parameters: object) -> None:
        self.ros = ros
        self.samples = ros.collect("/stage/encoder")
        self.states = ros.collect("/stage/state")
        self.clock = ros.collect("/clock")
        stage(mode="lockstep", control_rate=1000.0, **parameters)
        self.diagnostics = Diagnostics(ros)
        self.force = ros.publisher("/stage/force")
        ros.until(lambda: self.samples, "a sample")

    def at(self) -> int:
        """Stamp of the newest sample, ns."""
        return max(nanoseconds(sample.header.stamp) for sample in self.samples)

    def answered(self, message: WrenchStamped | JointState, publisher=None) -> float:
        """Answers, waits for the next sample, and returns the motor force (N) that led to it."""
        (publisher or self.force).publish(message)
        following = nanoseconds(message.header.stamp) + 1_000_000
        state = self.ros.until(
            lambda: next(
                (state for state in self.states if nanoseconds(state.header.stamp) == following),
                None,
            ),
            "the next sample",
        )
        self.ros.until(lambda: self.at() == following, "its encoder sample")
        return state.motor_force


def test_in_lockstep_only_the_answer_to_the_sample_counts(ros, stage):
    stepper = Stepper(ros, stage, wait_for_command=True, answer_timeout=60.0)
    diagnostics, first = stepper.diagnostics, stepper.at()
    assert stepper.answered(wrench(7.0, first)) == 7.0
    waiting = stepper.at()
    commands = ros.publisher("/stage/commands")
    for count, (publisher, message, words) in enumerate(
        [
            (stepper.force, wrench(8.0, first), f"stamp {first} ns repeats"),
            (
                stepper.force,
                wrench(8.0, first - 1),
                f"stamp {first - 1} ns goes back behind {first} ns",
            ),
            (stepper.force, wrench(8.0, waiting + 1), f"stamp {waiting + 1} ns answers no sample"),
            (
                stepper.force,
                wrench(8.0, waiting + 1_000_000),
                f"waits for the answer to {waiting} ns",
            ),
            (stepper.force, wrench(8.0, 0), "answers no sample"),
            (stepper.force, wrench(NAN, waiting), "NaN"),
            (stepper.force, wrench(INF, waiting), "inf"),
        ],
        start=1,
    ):
        publisher.publish(message)
        diagnostics.refusal("refused_commands", count, words)
    commands.publish(array(8.0))
    diagnostics.refusal("refused_commands", 8, "~/commands: refused, ~/force commands the stage")
    assert stepper.at() == waiting
    assert stepper.answered(wrench(9.0, waiting)) == 9.0


def test_no_effort_in_lockstep_is_an_answer_without_force(ros, stage):
    stepper = Stepper(ros, stage, wait_for_command=True)
    commands = ros.publisher("/stage/joint_commands")
    assert stepper.answered(joints(["stage"], [5.0], stepper.at()), commands) == 5.0
    assert stepper.answered(joints(["stage"], [NAN], stepper.at()), commands) == 0.0
    assert stepper.answered(joints(["stage"], [5.0], stepper.at()), commands) == 5.0
    assert stepper.answered(joints(["stage"], [], stepper.at()), commands) == 0.0


def test_a_command_that_can_answer_no_sample_does_not_stop_time(ros, stage):
    stepper = Stepper(ros, stage)
    commands = ros.publisher("/stage/commands")
    for count, (publisher, message, words) in enumerate(
        [
            (
                commands,
                array(8.0),
                ["~/commands", "carries no stamp", "use ~/force or ~/joint_commands"],
            ),
            (
                stepper.force,
                wrench(8.0, now() // 1000 * 1000 + 1),
                ["~/force", "answers no sample"],
            ),
            (stepper.force, wrench(8.0, 0), ["~/force", "stamp 0 ns", "answers no sample"]),
        ],
        start=1,
    ):
        publisher.publish(message)
        stepper.diagnostics.refusal("refused_commands", count, *words)
    seen = stepper.at()
    ros.until(lambda: stepper.at() > seen + 100_000_000, "time that goes on")
    assert all(state.motor_force == 0.0 for state in stepper.states)


def test_a_missing_answer_is_an_error_and_time_stands_still_until_it_comes(ros, stage):
    stepper = Stepper(ros, stage, wait_for_command=True, answer_timeout=0.3)
    diagnostics = stepper.diagnostics
    # Told to wait for the first command, it does so without complaint.
    sent = len(stepper.samples)
    ros.until(lambda: len(stepper.samples) > sent + 5, "the first sample, sent again and again")
    assert diagnostics.newest().level == OK
    for _ in range(3):
        stepper.answered(wrench(7.0, stepper.at()))
    waiting, before = stepper.at(), len(stepper.samples)
    began = now()
    status = diagnostics.until(lambda status: status.level == ERROR, "the error")
    # The next status after the timeout tells: they come every 0.2 s.
    assert now() - began < 3 * SECOND
    assert "the answer to the last sample is missing" in status.message
    assert number(status, "missing_answers") == 1
    ros.until(lambda: len(stepper.samples) >= before + 2, "the sample, sent again")
    assert {nanoseconds(sample.header.stamp) for sample in stepper.samples[before - 1 :]} == {
        waiting
    }
    assert nanoseconds(stepper.clock[-1].clock) == waiting
    assert number(diagnostics.newest(), "missing_answers") == 1
    assert stepper.answered(wrench(9.0, waiting)) == 9.0
    for _ in range(100):
        stepper.answered(wrench(9.0, stepper.at()))
    assert stepper.states[-1].velocity > 0.0


def test_a_controller_that_answers_once_and_never_again_is_missed(ros, stage):
    stepper = Stepper(ros, stage, answer_timeout=0.3)
    # Answers a sample of before: time stops, and the sample at which it does is not answered.
    stepper.force.publish(wrench(7.0, stepper.at()))
    status = stepper.diagnostics.until(lambda status: status.level == ERROR, "the error")
    assert "the answer to the last sample is missing" in status.message


# --- lockstep by topic hardware, whose stamps say nothing of the sample


def test_what_topic_hardware_sends_after_a_sample_is_its_answer_whatever_its_stamp(ros, stage):
    stepper = Stepper(ros, stage, wait_for_command=True, answer_timeout=60.0)
    commands, first = ros.publisher("/stage/joint_commands"), stepper.at()
    stamps = [first, first, first - 1, 0, now(), first + 2_000_000]
    for count, at in enumerate(stamps):
        commands.publish(joints(["stage"], [10.0 + count], at))
        ros.until(lambda: stepper.at() == first + (count + 1) * 1_000_000, "the next sample")

    # A sample that waits is sent again.
    def at_stamps():
        return {nanoseconds(state.header.stamp): state.motor_force for state in stepper.states}

    ros.until(lambda: len(at_stamps()) >= len(stamps) + 1, "its state")
    forces = at_stamps()
    assert list(forces.values()) == [0.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0]
    status = stepper.diagnostics.newest()
    assert number(status, "refused_commands") == number(status, "unanswered_samples") == 0


def test_an_answer_of_topic_hardware_that_is_missing_moves_time_on_with_the_force_held(ros, stage):
    # The force is held for 5 ms of simulated time, as long as commands may be silent.
    timeout, held = 0.3, 5
    stepper = Stepper(
        ros, stage, wait_for_command=True, answer_timeout=timeout, command_timeout=held * 1e-3
    )
    commands, first = ros.publisher("/stage/joint_commands"), stepper.at()
    commands.publish(joints(["stage"], [7.0], first))
    ros.until(lambda: stepper.at() >= first + 10_000_000, "ten samples, nine without an answer")
    # Before it moves on it asks again, for the case that sample or clock were lost.
    clock = [nanoseconds(message.clock) for message in stepper.clock]
    assert clock.count(first + 1_000_000) > 1 and clock == sorted(clock)
    forces = {nanoseconds(state.header.stamp): state.motor_force for state in stepper.states}
    forces = [forces[first + k * 1_000_000] for k in range(1, 10)]
    assert forces == [7.0] * held + [0.0] * (9 - held)
    status = stepper.diagnostics.newest()
    assert status.level == WARN and "no answer on ~/joint_commands" in status.message
    assert number(status, "unanswered_samples") >= 9 and number(status, "stale_commands") == 1
    # It goes on from whatever comes next.
    commands.publish(joints(["stage"], [9.0], first))
    ros.until(lambda: stepper.states[-1].motor_force == 9.0, "the force of the next command")


# --- sources, limits, silence


def test_of_several_sources_the_first_keeps_the_stage_until_it_falls_silent(ros, stage, states):
    stage(mode="realtime", control_rate=1000.0, command_timeout=1.0)
    diagnostics = Diagnostics(ros)
    first = Source(ros, "/stage/force", lambda: wrench(30.0))
    until_force(ros, states, 30.0)
    del states[:]
    # One on another topic, and one on the same.
    for topic, message in [
        ("/stage/joint_commands", lambda: joints(["stage"], [-40.0])),
        ("/stage/force", lambda: wrench(20.0)),
    ]:
        other = Source(ros, topic, message)
        words = f"{topic.replace('/stage', '~')}: refused, ~/force commands the stage"
        status = diagnostics.until(
            lambda status: words in status.message, "the report of the other source"
        )
        assert status.level == WARN and number(status, "refused_commands") > 0
        if topic == "/stage/joint_commands":
            other.stop()
    assert {state.motor_force for state in states} == {30.0}
    first.stop()
    until_force(ros, states, 20.0)
    # The other one has it now: the first finds it taken.
    del states[:]
    count = number(diagnostics.newest(), "refused_commands")
    first.go_on()
    diagnostics.until(
        lambda status: number(status, "refused_commands") > count + 10, "refusals of the first"
    )
    assert {state.motor_force for state in states} == {20.0}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_force_beyond_the_limit_is_clamped_and_counted_and_ends_when_commands_stop(
    ros, stage, states, sign
):
    stage(mode="realtime", control_rate=1000.0, command_timeout=0.2)
    diagnostics = Diagnostics(ros)
    status = diagnostics.newest()
    assert number(status, "clamped_samples") == number(status, "stale_commands") == 0
    ros.publisher("/stage/force").publish(wrench(sign * 1e300))
    status = diagnostics.until(
        lambda status: number(status, "stale_commands") > 0, "commands that have stopped"
    )
    assert status.level == WARN and "commands have stopped: motor force is zero" in status.message
    ros.until(
        lambda: states and nanoseconds(states[-1].header.stamp) >= number(status, "stamp_ns"),
        "the last states",
    )
    pushed = [state.sample for state in states if state.motor_force != 0.0]
    assert {state.motor_force for state in states} == {0.0, sign * 2000.0}
    # 0.2 s at 1 kHz; a tick more or less, and what a busy machine adds.
    assert len(pushed) == pushed[-1] - pushed[0] + 1 and 190 <= len(pushed) <= 400
    assert number(status, "clamped_samples") == len(pushed)
    assert number(status, "refused_commands") == 0


def test_the_timeout_can_be_changed_while_a_command_holds(ros, stage, states):
    stage(mode="realtime", control_rate=1000.0, command_timeout=3600.0)
    ros.publisher("/stage/force").publish(wrench(30.0))
    until_force(ros, states, 30.0)
    client = AsyncParameterClient(ros.node, "/stage")
    ros.until(client.services_are_ready, "the parameter services")
    (result,) = ros.result(
        client.set_parameters([Parameter("command_timeout", value=0.05)]), "the answer"
    ).results
    assert result.successful, result.reason
    until_force(ros, states, 0.0)


# --- setpoints


def with_times(*times: int) -> JointTrajectory:
    """Points of one and the same position at these times, ns."""
    message = trajectory([rest(0.0, 0.0) for _ in times])
    for point, at in zip(message.points, times):
        point.time_from_start = Duration(sec=at // SECOND, nanosec=at % SECOND)
    return message


def for_joint(name: str) -> JointTrajectory:
    message = trajectory([rest(0.3, 0.001)])
    message.joint_names = [name]
    return message


NO_SETPOINTS = [
    (
        trajectory([rest(0.0, 0.01)]),
        ["jumps by 1.000e-2 m", "at most 1.000e-3 m", "send a trajectory"],
    ),
    (trajectory([rest(0.0, -0.01), rest(1.0, 0.0)]), ["jumps by 1.000e-2 m"]),
    (trajectory([{"time": 0.0, "positions": [NAN]}]), ["point 0", "position is NaN", "finite"]),
    (
        trajectory([{"time": 1.0, "positions": [0.0], "velocities": [INF]}]),
        ["point 0", "velocity is inf", "finite"],
    ),
    (
        trajectory([rest(0.5, 0.0), {"time": 1.0, "positions": [0.0], "effort": [NAN]}]),
        ["point 1", "effort is NaN"],
    ),
    (trajectory([]), ["no points"]),
    (
        with_times(SECOND, SECOND // 2),
        ["point 1", "500000000 ns", "does not come after 1000000000 ns"],
    ),
    (with_times(SECOND, SECOND), ["point 1", "1000000000 ns", "does not come after"]),
    (with_times(-1), ["point 0", "-1 ns"]),
    (trajectory([{"time": 1.0, "velocities": [0.1]}]), ["point 0", "0 positions for 1 joints"]),
    (trajectory([{"time": 1.0, "positions": [0.0, 0.0]}]), ["point 0", "2 positions for 1 joints"]),
    (trajectory([rest(0.3, 0.001)], start=SECOND), ["ends at 1300000000 ns", "before now"]),
    (for_joint("slider"), ["no joint `stage` among [slider]"]),
]


def test_the_controller_refuses_what_is_no_setpoint_and_holds(ros, stage, controller):
    stage(mode="realtime", control_rate=1000.0)
    controller(rate=1000.0, bandwidth=30.0)
    diagnostics = Diagnostics(ros, "/controller: controller")
    states = ros.collect("/controller/state")
    setpoint = ros.publisher("/stage/setpoint", readers=2)
    for count, (message, words) in enumerate(NO_SETPOINTS, start=1):
        setpoint.publish(message)
        diagnostics.refusal("refused_setpoints", count, *words)
    for state in states:
        assert state.enabled and nanoseconds(state.setpoint_stamp) == 0
        assert (
            abs(state.reference_position) < 1e-6
            and abs(state.position) < 10e-6
            and math.isfinite(state.output)
        )
    setpoint.publish(trajectory([rest(0.3, 0.001)]))
    ros.until(lambda: abs(states[-1].position - 0.001) < 50e-6, "the move to 1 mm")
    assert nanoseconds(states[-1].setpoint_stamp) > 0


def test_a_stage_that_drives_itself_refuses_forces_and_setpoints_that_jump(ros, stage, states):
    stage(mode="realtime", drive="servo", control_rate=1000.0)
    diagnostics = Diagnostics(ros)
    setpoint, force = ros.publisher("/stage/setpoint"), ros.publisher("/stage/force")
    setpoint.publish(trajectory([rest(0.0, 0.01)]))
    diagnostics.refusal("refused_commands", 1, "~/setpoint", "jumps by 1.000e-2 m")
    setpoint.publish(trajectory([{"time": 0.0, "positions": [NAN]}]))
    diagnostics.refusal("refused_commands", 2, "~/setpoint", "position is NaN")
    force.publish(wrench(500.0))
    diagnostics.refusal("refused_commands", 3, "~/force", "drives itself", "drive: servo")
    assert states and all(abs(state.position) < 1e-6 for state in states)
    setpoint.publish(trajectory([rest(0.3, 0.001)]))
    ros.until(lambda: abs(states[-1].position - 0.001) < 20e-6, "the move to 1 mm")
