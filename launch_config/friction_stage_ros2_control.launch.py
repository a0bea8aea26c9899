"""The stage under a ros2_control stack, over topics: manager, spawner, robot_state_publisher.

ros2 launch friction_stage friction_stage_ros2_control.launch.py
ros2 launch friction_stage friction_stage_ros2_control.launch.py \\
    mode:=lockstep controller:=pid_controller

Needs controller_manager, joint_state_topic_hardware_interface, joint_state_broadcaster,
robot_state_publisher (not with robot_state_publisher:=false), force_torque_sensor_broadcaster and
the package of the controller. The stage publishes /clock in both modes, and everything else runs on
it. In lockstep every tick of the manager is answered by one command, but which sample a command was
computed from is the hardware plugin's chance: a run does not repeat bit for bit (docs/ros2.md,
"ros2_control").
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

HERE = Path(__file__).parent
# One file for the whole stack, so that rates that must fit each other stand in one place.
CONTROLLERS_FILE = str(HERE / "friction_stage_controllers.yaml")


def included(name, **arguments):
    source = PythonLaunchDescriptionSource(str(HERE / name))
    return IncludeLaunchDescription(source, launch_arguments=arguments.items())


def generate_launch_description():
    stack = {
        "description": str(HERE / "friction_stage.urdf"),
        "controllers_file": CONTROLLERS_FILE,
        "broadcasters": "joint_state_broadcaster force_cell_broadcaster",
    }
    return LaunchDescription(
        [
            # First, so that an argument that it refuses leaves no stage behind.
            included("friction_stage_controller_manager.launch.py", **stack),
            included("friction_stage_stage_only.launch.py", params_file=CONTROLLERS_FILE),
        ]
    )
