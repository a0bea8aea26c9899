"""The real ros2_control moves the stage in lockstep: controller_manager in C++ with
joint_state_topic_hardware_interface and the controllers that launch_config/ starts.

Runs where AMENT_PREFIX_PATH has them, with the Python of that ROS installation.
"""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from diagnostics import OK, Diagnostics, number
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros import nanoseconds, rest, trajectory
from simulation_interfaces.srv import GetEntityState
from std_msgs.msg import Float64MultiArray, String

FILES = Path(__file__).parents[2] / "launch_config"
PARAMETERS = FILES / "friction_stage_controllers.yaml"
BROADCASTERS = ["joint_state_broadcaster", "force_cell_broadcaster"]
PACKAGES = [
    "controller_manager",
    "joint_state_topic_hardware_interface",
    "joint_state_broadcaster",
    "force_torque_sensor_broadcaster",
    "joint_trajectory_controller",
    "pid_controller",
    "forward_command_controller",
]
# Samples of the long run; a million takes five to ten minutes.
SAMPLES = int(os.environ.get("PEER_LOCKSTEP_SAMPLES", "20000"))


def prefix_of(package: str) -> Path | None:
    """The prefix in AMENT_PREFIX_PATH that has the package."""
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        if (Path(prefix) / "share/ament_index/resource_index/packages" / package).is_file():
            return Path(prefix)
    return None


MISSING = [package for package in PACKAGES if prefix_of(package) is None]
pytestmark = pytest.mark.skipif(
    bool(MISSING),
    reason=f"needs a ROS installation with ros2_control; AMENT_PREFIX_PATH lacks {MISSING}",
)


def real_time() -> list[str]:
    """As the launch file starts the manager: all threads with a real-time priority, where the
    system permits it."""
    chrt = shutil.which("chrt")
    command = [chrt, "-f", "5"] if chrt else []
    return command if subprocess.run([*command, "true"]).returncode == 0 else []


class Manager:
    """A stage and the controller_manager above it, as friction_stage_ros2_control.launch.py starts
    them, but for robot_state_publisher: the test publishes the description itself."""

    def __init__(self, ros, start, controller: str) -> None:
        self.ros = ros
        given = ["--ros-args", "--params-file", str(PARAMETERS)]
        folder = prefix_of("controller_manager") / "lib/controller_manager"
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.description = ros.node.create_publisher(String, "/robot_description", latched)
        self.description.publish(String(data=(FILES / "friction_stage.urdf").read_text()))
        start("stage_node", *given, "-r", "__node:=stage", "-p", "mode:=lockstep")
        manager = [*real_time(), str(folder / "ros2_control_node"), *given]
        self.process = start(*manager)
        spawner = start(
            str(folder / "spawner"),
            *BROADCASTERS,
            controller,
            "--controller-manager",
            "/controller_manager",
            "--param-file",
            str(PARAMETERS),
        )
        ros.until(lambda: spawner.popen.poll() is not None, "the end of the spawner", timeout=60.0)
        spawner.ended(0)
        self.diagnostics = Diagnostics(ros)

    def state(self) -> tuple[float, float, float]:
        """Time of the stage, s, its true position, m, and its velocity, m/s."""
        state = self.ros.call(GetEntityState, "/stage/get_entity_state", entity="stage").state
        return nanoseconds(state.header.stamp) * 1e-9, state.pose.position.x, state.twist.linear.x

    def rests_at(self, position: float, within: float, timeout: float = 60.0) -> None:
        deadline = time.monotonic() + timeout
        while True:
            _, x, v = self.state()
            if abs(x - position) < within and abs(v) < 1e-4:
                return
            assert time.monotonic() < deadline, f"at {x} m with {v} m/s, wanted {position} m"

    def every_sample_was_answered(self) -> int:
        """The number of samples so far."""
        status = self.diagnostics.newest()
        for counter in ("refused_commands", "unanswered_samples", "surplus_commands"):
            assert number(status, counter) == 0, f"{status}\n{self.process.excerpt()}"
        assert status.level == OK, status
        return number(status, "sample")


@pytest.fixture
def manager(ros, start) -> Callable[[str], Manager]:
    """manager(controller)"""
    started: list[Manager] = []

    def begin(controller: str) -> Manager:
        started.append(Manager(ros, start, controller))
        return started[-1]

    yield begin
    for one in started:
        one.process.stop(signal.SIGINT)


class Goals:
    def __init__(self, ros) -> None:
        name = "/joint_trajectory_controller/follow_joint_trajectory"
        self.ros, self.client = ros, ActionClient(ros.node, FollowJointTrajectory, name)
        ros.until(self.client.server_is_ready, "the action")

    def reach(self, position: float, seconds: float = 0.5) -> None:
        goal = FollowJointTrajectory.Goal(trajectory=trajectory([rest(seconds, position)]))
        handle = self.ros.result(self.client.send_goal_async(goal), "the answer to a goal")
        assert handle.accepted
        answer = self.ros.result(handle.get_result_async(), f"the goal {position} m is reached")
        code, text = answer.result.error_code, answer.result.error_string
        assert (answer.status, code) == (GoalStatus.STATUS_SUCCEEDED, 0), f"{code}: {text}"


def test_goals_of_joint_trajectory_controller_succeed(ros, manager):
    stack = manager("joint_trajectory_controller")
    goals = Goals(ros)
    for position in (0.02, 0.0, 0.02, 0.01):
        goals.reach(position)
        # The tolerance of the goal.
        assert abs(stack.state()[1] - position) < 2e-3
    # The integral needs seconds of simulated time.
    stack.rests_at(0.01, within=1e-4)
    assert stack.every_sample_was_answered() > 2000


@pytest.mark.timeout(0)
def test_the_manager_never_stands_still(ros, manager):
    stack = manager("joint_trajectory_controller")
    goals = Goals(ros)
    began, first = time.monotonic(), stack.every_sample_was_answered()
    samples, reached = first, 0
    while samples < SAMPLES:
        goals.reach(0.0 if reached % 2 else 0.02)
        reached += 1
        samples = round(stack.state()[0] * 1000) - 1000
    samples = stack.every_sample_was_answered()
    seconds = time.monotonic() - began
    print(f"{samples - first} samples and {reached} goals in {seconds:.0f} s")


def test_pid_controller_reaches_its_setpoints(ros, manager):
    from control_msgs.msg import MultiDOFCommand

    stack = manager("pid_controller")
    # It subscribes best effort.
    quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    reference = ros.node.create_publisher(MultiDOFCommand, "/pid_controller/reference", quality)
    ros.until(reference.get_subscription_count, "the controller")
    for position in (0.005, 0.0, 0.005, 0.002):
        reference.publish(MultiDOFCommand(dof_names=["stage"], values=[position]))
        stack.rests_at(position, within=5e-5)
    assert stack.every_sample_was_answered() > 2000


def test_forward_command_controller_pushes_the_stage(ros, manager):
    stack = manager("forward_command_controller")
    force = ros.node.create_publisher(Float64MultiArray, "/forward_command_controller/commands", 1)
    ros.until(force.get_subscription_count, "the controller")
    # Beyond the friction of four guides, until it has moved a millimetre.
    force.publish(Float64MultiArray(data=[400.0]))
    ros.until(lambda: stack.state()[1] > 1e-3, "the stage moves")
    force.publish(Float64MultiArray(data=[0.0]))
    ros.until(lambda: abs(stack.state()[2]) < 1e-4, "the stage rests")
    stack.every_sample_was_answered()
