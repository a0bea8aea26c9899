"""The stage under a ros2_control stack, over topics: controller_manager, its spawner, robot_state_publisher.

ros2 launch friction_stage friction_stage_ros2_control.launch.py
ros2 launch friction_stage friction_stage_ros2_control.launch.py mode:=lockstep controller:=pid_controller

Needs controller_manager, joint_state_topic_hardware_interface, joint_state_broadcaster, robot_state_publisher,
force_torque_sensor_broadcaster and the package of the controller. The stage publishes /clock in both modes, and
everything else runs on it. In lockstep every tick of the manager is answered by one command, but which sample a command
was computed from is the hardware plugin's chance: a run does not repeat bit for bit (docs/ros2.md, "ros2_control").
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

HERE = Path(__file__).parent
CONTROLLERS_FILE = str(HERE / "friction_stage_controllers.yaml")
CONTROLLERS = ["joint_trajectory_controller", "forward_command_controller", "pid_controller"]


def generate_launch_description():
    description = ParameterValue((HERE / "friction_stage.urdf").read_text(), value_type=str)
    stage = PythonLaunchDescriptionSource(str(HERE / "friction_stage_stage_only.launch.py"))
    controller = LaunchConfiguration("controller")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "controller",
                default_value=CONTROLLERS[0],
                choices=CONTROLLERS,
                description="controller that commands the stage",
            ),
            # One file for the whole stack, so that rates that must fit each other stand in one place.
            IncludeLaunchDescription(
                stage, launch_arguments={"params_file": CONTROLLERS_FILE}.items()
            ),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": description, "use_sim_time": True}],
                output="screen",
            ),
            Node(
                package="controller_manager",
                executable="ros2_control_node",
                parameters=[CONTROLLERS_FILE],
                output="screen",
                on_exit=Shutdown(reason="the controller manager has ended"),
            ),
            Node(
                package="controller_manager",
                executable="spawner",
                arguments=[
                    "joint_state_broadcaster",
                    "force_cell_broadcaster",
                    controller,
                    "--controller-manager",
                    "/controller_manager",
                    "--param-file",
                    CONTROLLERS_FILE,
                ],
                output="screen",
            ),
        ]
    )
