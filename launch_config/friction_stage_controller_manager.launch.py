"""What ros2_control runs above a stage: robot_state_publisher, controller_manager and its spawner.

Included by friction_stage_ros2_control.launch.py and friction_stage_xy_ros2_control.launch.py, with
the full paths of their files.
"""

import shutil
import subprocess
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "description": "path of the URDF",
    "controllers_file": "path of the parameter file of the whole stack",
    "broadcasters": "names of the broadcasters to start, with blanks between them",
}
CONTROLLERS = ["joint_trajectory_controller", "forward_command_controller", "pid_controller"]


# Starts a program whose threads all have a real-time priority, below the 50 of the manager's loop.
REAL_TIME = ["chrt", "-f", "5"]


def real_time() -> str:
    """What starts the manager with a real-time priority, where the system permits it. Its loop asks
    for one by itself; the threads that read the states do not, and on a busy machine a command
    would be computed from a state of some samples before."""
    if shutil.which(REAL_TIME[0]) is None:
        return ""
    is_permitted = subprocess.run([*REAL_TIME, "true"], capture_output=True).returncode == 0
    return " ".join(REAL_TIME) if is_permitted else ""


def stack(context):
    description, controllers_file, broadcasters = (
        LaunchConfiguration(name).perform(context) for name in ARGUMENTS
    )
    urdf = ParameterValue(Path(description).read_text(), value_type=str)
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            parameters=[controllers_file, {"robot_description": urdf}],
            output="screen",
            condition=IfCondition(LaunchConfiguration("robot_state_publisher")),
        ),
        Node(
            package="controller_manager",
            executable="ros2_control_node",
            prefix=real_time(),
            parameters=[controllers_file],
            output="screen",
            on_exit=Shutdown(reason="the controller manager has ended"),
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            arguments=[
                *broadcasters.split(),
                LaunchConfiguration("controller"),
                "--controller-manager",
                "/controller_manager",
                "--param-file",
                controllers_file,
            ],
            output="screen",
        ),
    ]


def generate_launch_description():
    arguments = [DeclareLaunchArgument(name, description=text) for name, text in ARGUMENTS.items()]
    controller = DeclareLaunchArgument(
        "controller",
        default_value=CONTROLLERS[0],
        choices=CONTROLLERS,
        description="controller that commands the joints",
    )
    publisher = DeclareLaunchArgument(
        "robot_state_publisher",
        default_value="true",
        choices=["true", "false"],
        description="whether to start it; without it another node must publish /robot_description, "
        "which the controller manager waits for",
    )
    return LaunchDescription([*arguments, controller, publisher, OpaqueFunction(function=stack)])
