"""An x-y stage under one controller_manager: a stage for each joint, in real time.

ros2 launch friction_stage friction_stage_xy_ros2_control.launch.py
ros2 launch friction_stage friction_stage_xy_ros2_control.launch.py model_y:=guide_2 record:=run

Needs the packages that friction_stage_ros2_control.launch.py needs, without
force_torque_sensor_broadcaster. All nodes have the clock of the machine. In lockstep both stages
would publish /clock (docs/how-to/several-axes.md).
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

HERE = Path(__file__).parent
CONTROLLERS_FILE = str(HERE / "friction_stage_xy_controllers.yaml")


def included(name, **arguments):
    source = PythonLaunchDescriptionSource(str(HERE / name))
    return IncludeLaunchDescription(source, launch_arguments=arguments.items())


def generate_launch_description():
    stages = {"params_file": CONTROLLERS_FILE, "controller_node": "false"}
    stack = {
        "description": str(HERE / "friction_stage_xy.urdf"),
        "controllers_file": CONTROLLERS_FILE,
        "broadcasters": "joint_state_broadcaster",
    }
    return LaunchDescription(
        [
            # First, so that an argument that it refuses leaves no stage behind.
            included("friction_stage_controller_manager.launch.py", **stack),
            included("friction_stage_xy.launch.py", **stages),
        ]
    )
