"""rclpy action clients drive the controller through `follow_joint_trajectory`, as
joint_trajectory_controller."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
from diagnostics import Diagnostics
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros import nanoseconds, rest, trajectory
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

ACTION = "/controller/follow_joint_trajectory"
RATE = 1000.0
PERIOD = round(1e9 / RATE)
Result = FollowJointTrajectory.Result

# Exact tests: the stage stands at sample 0 until the first setpoint.
WAITING = {"wait_for_command": True}, {"wait_for_setpoint": True}


class Goals:
    """An action client, whose every wait is for an event."""

    def __init__(self, ros) -> None:
        self.ros = ros
        self.client = ActionClient(ros.node, FollowJointTrajectory, ACTION)
        ros.until(self.client.server_is_ready, "the action")

    def send(self, goal, feedback=None):
        sent = self.client.send_goal_async(goal, feedback_callback=feedback)
        return self.ros.result(sent, "the answer to a goal")

    def result(self, handle):
        """(status, code, text) of a goal, refused ones too."""
        wrapped = self.ros.result(handle.get_result_async(), "the result of a goal")
        return wrapped.status, wrapped.result.error_code, wrapped.result.error_string

    def cancel(self, handle):
        return self.ros.result(handle.cancel_goal_async(), "the answer to a cancel")

    def reach(self, position: float, seconds: float = 0.1) -> None:
        handle = self.send(goal([rest(seconds, position)]))
        assert handle.accepted
        assert self.result(handle) == SUCCESS


SUCCESS = (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL, "Goal successfully reached!")

# Time runs as fast as the machine allows: a goal that is to be under way when the next call arrives
# outlasts the way of the call.
LONG = rest(60.0, 0.2)


def goal(points, start=0, path=None, end=None, time=0.0, name="stage"):
    """A goal with tolerances of position (m) and time (s)."""
    message = FollowJointTrajectory.Goal(trajectory=trajectory(points, start))
    if path is not None:
        message.path_tolerance = [JointTolerance(name=name, position=path)]
    if end is not None:
        message.goal_tolerance = [JointTolerance(name=name, position=end)]
    sec = int(time // 1)
    message.goal_time_tolerance = Duration(sec=sec, nanosec=round((time - sec) * 1e9))
    return message


@pytest.fixture
def pair(stage, controller):
    """pair(stage={...}, **parameters): both nodes in lockstep at 1 kHz."""

    def pair(stage_parameters=None, **parameters):
        stage(mode="lockstep", control_rate=RATE, **(stage_parameters or {}))
        return controller(rate=RATE, bandwidth=30.0, **parameters)

    return pair


def test_a_goal_is_followed_with_feedback_at_its_rate(ros, pair):
    pair(action_monitor_rate=40.0)
    feedback = []
    goals = Goals(ros)
    handle = goals.send(
        goal([rest(1.0, 0.05)], end=1e-5, time=1.0),
        lambda message: feedback.append(message.feedback),
    )
    assert handle.accepted
    assert goals.result(handle) == SUCCESS
    # The last of it may come after the result.
    ros.until(lambda: len(feedback) >= 40, "the feedback of 1 s")
    stamps = [nanoseconds(one.header.stamp) for one in feedback]
    assert {b - a for a, b in zip(stamps, stamps[1:])} == {25 * 10**6}
    for one in feedback:
        assert list(one.joint_names) == ["stage"]
        desired, actual, error = (p.positions[0] for p in (one.desired, one.actual, one.error))
        assert error == pytest.approx(desired - actual, abs=1e-15)
    assert any(one.desired.velocities[0] > 0.05 for one in feedback)


def run(ros, pair, drive):
    """Encoder of the first 400 samples of a run that `drive` sets off, by stamp."""
    pair(WAITING[0], **WAITING[1])
    encoder = ros.collect("/stage/encoder")
    ros.until(lambda: encoder, "sample 0")
    first = nanoseconds(encoder[0].header.stamp)
    drive()
    ros.until(lambda: nanoseconds(encoder[-1].header.stamp) > first + 400 * PERIOD, "400 samples")
    samples = {
        nanoseconds(m.header.stamp): (m.position[0], m.velocity[0], m.effort[0]) for m in encoder
    }
    return [samples[first + k * PERIOD] for k in range(400)]


def test_a_goal_is_bit_for_bit_the_move_of_a_setpoint(
    ros, start, stage, controller, pair, processes
):
    # With a force of the sender's own along the way.
    points = [{**rest(0.1, 0.01), "effort": [20.0]}, {**rest(0.3, -0.02), "effort": [0.0]}]

    def by_setpoint():
        ros.publisher("/stage/setpoint", readers=2).publish(trajectory(points))

    def by_goal():
        assert Goals(ros).send(goal(points)).accepted

    def by_topic():
        publisher = ros.node.create_publisher(JointTrajectory, "/controller/joint_trajectory", 10)
        ros.until(publisher.get_subscription_count, "the controller")
        publisher.publish(trajectory(points))

    runs = []
    for drive in (by_setpoint, by_goal, by_topic):
        runs.append(run(ros, pair, drive))
        while processes:
            processes.pop().stop()
    assert max(abs(position) for position, _, _ in runs[0]) > 0.015
    assert runs[0] == runs[1] == runs[2]


def test_a_cancel_holds_within_one_sample(ros, pair):
    # No faster than Python reads every state.
    pair({"clock_pause": 0.001})
    states = ros.collect("/controller/state")
    goals = Goals(ros)
    handle = goals.send(goal([LONG]))
    ros.until(lambda: states and states[-1].reference_velocity > 3e-4, "motion")
    answer = goals.cancel(handle)
    assert answer.return_code == CancelGoal.Response.ERROR_NONE
    assert [info.goal_id for info in answer.goals_canceling] == [handle.goal_id]
    assert goals.result(handle) == (GoalStatus.STATUS_CANCELED, 0, "")
    ros.until(lambda: states[-1].reference_velocity == 0.0, "the hold")
    at = max(k for k, state in enumerate(states) if state.reference_velocity != 0.0)
    ros.until(lambda: len(states) > at + 500, "half a second")
    assert states[at].reference_position < 0.199
    assert states[at + 1].reference_position == states[at].position
    assert {state.reference_position for state in states[at + 1 :]} == {states[at].position}
    assert abs(states[-1].error) < 1e-4
    # It is over: no second cancel, and the next goal is followed.
    assert goals.cancel(handle).return_code == CancelGoal.Response.ERROR_GOAL_TERMINATED
    goals.reach(0.0, 0.3)


def test_all_goals_are_cancelled_at_once_and_unknown_ones_are_told(ros, pair):
    pair()
    goals = Goals(ros)
    handle = goals.send(goal([LONG]))
    assert handle.accepted
    everything = CancelGoal.Request()
    response = ros.call(CancelGoal, f"{ACTION}/_action/cancel_goal", goal_info=everything.goal_info)
    assert response.return_code == CancelGoal.Response.ERROR_NONE
    assert goals.result(handle)[0] == GoalStatus.STATUS_CANCELED
    everything.goal_info.goal_id.uuid[0] = 7
    response = ros.call(CancelGoal, f"{ACTION}/_action/cancel_goal", goal_info=everything.goal_info)
    assert response.return_code == CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID


def test_a_new_goal_takes_the_place_of_the_old_one(ros, pair):
    pair()
    # Two clients: of two programs, as far as the controller knows.
    one, other = Goals(ros), Goals(ros)
    first = one.send(goal([LONG]))
    second = other.send(goal([rest(0.5, 0.01)], end=1e-5, time=2.0))
    assert first.accepted and second.accepted
    status, code, text = one.result(first)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert text == "Current goal preempted by new incoming action."
    assert other.result(second) == SUCCESS


def test_a_setpoint_takes_the_place_of_a_goal(ros, pair):
    pair()
    goals = Goals(ros)
    handle = goals.send(goal([LONG]))
    ros.publisher("/stage/setpoint", readers=2).publish(trajectory([rest(0.5, 0.01)]))
    status, code, text = goals.result(handle)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert "preempted" in text


def test_tolerances_fail_a_goal_with_their_code_and_it_holds(ros, pair):
    pair()
    states = ros.collect("/controller/state")
    goals = Goals(ros)
    off_the_path = goals.send(goal([rest(0.3, 0.1)], path=1e-8))
    assert goals.result(off_the_path) == (
        GoalStatus.STATUS_ABORTED,
        Result.PATH_TOLERANCE_VIOLATED,
        "Aborted due to path tolerance violation",
    )
    seen = len(states)
    ros.until(lambda: len(states) > seen + 500, "half a second")
    assert len({state.reference_position for state in states[-100:]}) == 1
    # Half a count of the encoder is never read.
    never = goals.send(goal([rest(0.2, 0.5e-9)], end=1e-12, time=0.25))
    status, code, text = goals.result(never)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.GOAL_TOLERANCE_VIOLATED)
    late = float(
        re.fullmatch(r"Aborted due to goal_time_tolerance exceeding by (\S+) seconds", text)[1]
    )
    assert late == pytest.approx(0.25, abs=0.002)
    goals.reach(0.0)


def test_defaults_of_the_tolerances_are_parameters(ros, pair):
    pair(constraints__stage__trajectory=1e-8)
    goals = Goals(ros)
    assert goals.result(goals.send(goal([rest(0.3, 0.1)])))[1] == Result.PATH_TOLERANCE_VIOLATED
    # -1: none for this goal.
    assert goals.result(goals.send(goal([rest(0.5, 0.0)], path=-1.0))) == SUCCESS


SWING = [{"time": 0.1, "positions": [0.35], "velocities": [9.0]}, rest(0.2, 0.35)]
BAD = {
    "another joint": (
        lambda g: setattr(g.trajectory, "joint_names", ["arm"]),
        -2,
        "Incoming joint arm",
    ),
    "two joints": (
        lambda g: setattr(g.trajectory, "joint_names", ["stage", "arm"]),
        -2,
        "Joints on incoming trajectory don't match",
    ),
    "no joint": (lambda g: setattr(g.trajectory, "joint_names", []), -2, "Joints on incoming"),
    "a joint of several degrees": (
        lambda g: setattr(g.multi_dof_trajectory, "joint_names", ["base"]),
        -2,
        "Incoming joint base",
    ),
    "no points": (lambda g: setattr(g.trajectory, "points", []), -1, "Empty trajectory received."),
    "over already": (
        lambda g: setattr(g.trajectory.header.stamp, "nanosec", 1),
        -3,
        "that ends in the past",
    ),
    "times that fall": (
        lambda g: setattr(g.trajectory, "points", trajectory([rest(0.2, 0), rest(0.1, 0)]).points),
        -1,
        "not strictly increasing",
    ),
    "moving at the end": (
        lambda g: setattr(g.trajectory.points[-1], "velocities", [0.1]),
        -1,
        "Velocity of last trajectory point of joint stage is not zero",
    ),
    "two positions": (
        lambda g: setattr(g.trajectory.points[0], "positions", [0.0, 0.0]),
        -1,
        "Mismatch between joint_names size (1) and positions (2) at point #0.",
    ),
    "no position": (
        lambda g: setattr(g.trajectory.points[0], "positions", []),
        -1,
        "positions (0)",
    ),
    "no number": (
        lambda g: setattr(g.trajectory.points[0], "positions", [float("nan")]),
        -1,
        "must be finite",
    ),
    "beyond the stroke": (
        lambda g: setattr(g.trajectory.points[0], "positions", [9.0]),
        -1,
        "must stay between",
    ),
    "beyond the stroke in between": (
        lambda g: setattr(g.trajectory, "points", trajectory(SWING).points),
        -1,
        "must stay between",
    ),
}


def test_goals_that_cannot_be_followed_are_refused_with_code_and_text(ros, pair):
    pair()
    states = ros.collect("/controller/state")
    goals, diagnostics = Goals(ros), Diagnostics(ros, "/controller: controller")
    for name, (spoil, code, text) in BAD.items():
        bad = goal([rest(0.1, 0.01)])
        spoil(bad)
        handle = goals.send(bad)
        assert not handle.accepted, name
        status, told, words = goals.result(handle)
        assert (status, told) == (GoalStatus.STATUS_UNKNOWN, code), (name, words)
        assert text in words, (name, words)
    diagnostics.refusal("refused_goals", len(BAD))
    assert {state.reference_position for state in states} == {states[0].reference_position}
    goals.reach(0.01)


def test_tolerances_without_meaning_leave_the_defaults(ros, pair):
    controller = pair()
    goals = Goals(ros)
    for bad in (
        goal([rest(0.1, 0.01)], path=-0.5),
        goal([rest(0.1, 0.0)], end=-7.0),
        goal([rest(0.1, 0.01)], path=1e-9, name="arm"),
        goal([rest(0.1, 0.0)], path=float("nan")),
        goal([rest(0.1, 0.01)], path=1e-9, time=-3.0),
    ):
        assert goals.result(goals.send(bad)) == SUCCESS
    assert controller.log().count("Using default tolerances") == 4


def test_a_disabled_controller_takes_no_goals_and_gives_up_the_one_it_follows(ros, pair):
    pair()
    goals = Goals(ros)
    handle = goals.send(goal([LONG]))
    assert ros.call(SetBool, "/controller/enable", data=False).success
    status, code, text = goals.result(handle)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert "deactivate" in text
    refused = goals.send(goal([rest(0.1, 0.01)]))
    assert not refused.accepted
    assert goals.result(refused)[2] == "Can't accept new action goals. Controller is not running."
    assert ros.call(SetBool, "/controller/enable", data=True).success
    goals.reach(0.0, 0.5)


def test_a_reset_of_the_stage_ends_a_goal(ros, pair):
    pair()
    states = ros.collect("/controller/state", depth=10)
    goals = Goals(ros)
    handle = goals.send(goal([LONG]))
    ros.until(lambda: states and states[-1].position > 0.002, "motion")
    assert ros.call(Trigger, "/stage/reset").success
    assert goals.result(handle)[:2] == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)


CLIENT = """
import rclpy
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from test_follow_joint_trajectory import ACTION, FollowJointTrajectory, goal, rest
rclpy.init()
node = rclpy.create_node("mortal")
client = ActionClient(node, FollowJointTrajectory, ACTION)
client.wait_for_server()
sent = client.send_goal_async(goal([rest(2.0, 0.05)]))
rclpy.spin_until_future_complete(node, sent)
assert sent.result().accepted
sent.result().get_result_async()
print("under way", flush=True)
rclpy.spin(node)
"""


def test_a_client_that_dies_leaves_its_goal_to_be_finished(ros, pair):
    """As under joint_trajectory_controller. Others are served meanwhile."""
    pair()
    states = ros.collect("/controller/state", depth=10)
    goals = Goals(ros)
    client = subprocess.Popen(
        [sys.executable, "-c", CLIENT], cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True
    )
    try:
        assert client.stdout.readline() == "under way\n"
    finally:
        client.kill()
        client.wait()
    ros.until(lambda: states and states[-1].reference_position == 0.05, "the end of the motion")
    goals.reach(0.0, 0.3)


def test_controller_state_is_that_of_joint_trajectory_controller(ros, pair):
    pair(state_publish_rate=100.0)
    states = []
    ros.node.create_subscription(
        JointTrajectoryControllerState, "/controller/controller_state", states.append, 1000
    )
    Goals(ros).reach(0.02, 0.5)
    ros.until(lambda: len(states) > 50, "half a second of states")
    stamps = [nanoseconds(state.header.stamp) for state in states]
    assert {b - a for a, b in zip(stamps, stamps[1:])} == {10**7}
    for state in states:
        assert list(state.joint_names) == ["stage"] and state.speed_scaling_factor == 1.0
        assert state.error.positions[0] == pytest.approx(
            state.reference.positions[0] - state.feedback.positions[0], abs=1e-15
        )
        assert len(state.output.effort) == 1


def test_trajectories_on_the_topic_are_checked_as_goals(ros, pair):
    pair()
    diagnostics = Diagnostics(ros, "/controller: controller")
    publisher = ros.node.create_publisher(JointTrajectory, "/controller/joint_trajectory", 10)
    ros.until(publisher.get_subscription_count, "the controller")
    publisher.publish(trajectory([]))
    diagnostics.refusal("refused_setpoints", 1, "Empty trajectory received.")


@pytest.mark.timeout(400)
def test_a_thousand_goals_leave_nothing_behind(ros, pair):
    controller = pair()
    goals = Goals(ros)
    known = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros.node.create_subscription(
        GoalStatusArray,
        f"{ACTION}/_action/status",
        lambda message: known.append(len(message.status_list)),
        latched,
    )

    def memory() -> int:
        status = Path(f"/proc/{controller.popen.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+) kB", status)[1])

    def goals_of_all_kinds() -> int:
        for k in range(500):
            kind = k % 5
            if kind == 0:
                handle = goals.send(goal([LONG]))
                goals.cancel(handle)
                assert goals.result(handle)[0] == GoalStatus.STATUS_CANCELED, k
            elif kind == 1:
                handle = goals.send(goal([rest(0.1, 0.1)], path=1e-9))
                assert goals.result(handle)[0] == GoalStatus.STATUS_ABORTED, k
            elif kind == 2:
                assert not goals.send(goal([])).accepted
            else:
                goals.reach(0.001 * (k % 2), 0.02)
        return memory()

    # The DDS library takes memory for samples in steps of megabytes until it has what it keeps,
    # with goals and without. A goal that stayed would take its part in every round.
    rounds = [goals_of_all_kinds()]
    while len(rounds) < 3 or rounds[-1] - rounds[-2] > 500:
        assert len(rounds) < 16, f"kB after each 500 goals: {rounds}"
        rounds.append(goals_of_all_kinds())
    print(f"kB after each 500 goals: {rounds}")
    # Those that are over and are remembered, and the one of the moment.
    assert 50 < max(known) <= 101
