"""The stage and its controller.

ros2 launch friction_stage friction_stage.launch.py
ros2 launch friction_stage friction_stage.launch.py \\
    model:=stage_with_cogging_and_cable_chain.yaml record:=bag_of_today
ros2 launch friction_stage friction_stage.launch.py params_file:=lockstep_params.yaml
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = Path(__file__).parent


def controller(context):
    params_file = LaunchConfiguration("params_file").perform(context) or "controller_params.yaml"
    if params_file == Path(params_file).name and (HERE / params_file).is_file():
        params_file = str(HERE / params_file)
    return [
        Node(
            package="friction_stage",
            executable="controller_node",
            name="controller",
            parameters=[params_file],
            output="screen",
            on_exit=Shutdown(reason="the controller has ended"),
        )
    ]


def generate_launch_description():
    params_file = DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="parameter file for both nodes, by path or by its name in launch_config "
        "(empty: stage_params.yaml and controller_params.yaml)",
    )
    # It declares model, mode, drive and record, and takes params_file as it is here.
    stage = PythonLaunchDescriptionSource(str(HERE / "friction_stage_stage_only.launch.py"))
    return LaunchDescription(
        [params_file, IncludeLaunchDescription(stage), OpaqueFunction(function=controller)]
    )
