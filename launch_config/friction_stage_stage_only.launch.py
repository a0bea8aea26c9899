"""The stage alone, for a controller of your own.

ros2 launch friction_stage friction_stage_stage_only.launch.py model:=guide_2 mode:=lockstep
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

HERE = Path(__file__).parent
# Launch arguments that are parameters of the stage; an empty one leaves what the parameter file
# says.
PARAMETERS = {
    "model": "guide_1, guide_2, guide_3, rig:GUIDE, a model file of launch_config by its name, or "
    "the path of one",
    "mode": "realtime or lockstep",
    "drive": "force or servo",
    "record": "bag directory to record into; must not exist",
}


def beside_this_file(name):
    """The path of a file of launch_config that is given by its bare name; anything else as it
    is."""
    return str(HERE / name) if name == Path(name).name and (HERE / name).is_file() else name


def stage(context):
    given = {
        name: LaunchConfiguration(name).perform(context) for name in (*PARAMETERS, "params_file")
    }
    params_file = beside_this_file(given.pop("params_file") or "stage_params.yaml")
    given["model"] = beside_this_file(given["model"])
    overrides = {
        name: ParameterValue(value, value_type=str) for name, value in given.items() if value
    }
    return [
        Node(
            package="friction_stage",
            executable="stage_node",
            name="stage",
            parameters=[params_file, overrides] if overrides else [params_file],
            output="screen",
            on_exit=Shutdown(reason="the stage has ended"),
        )
    ]


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(
            name, default_value="", description=f"{text} (empty: as in params_file)"
        )
        for name, text in PARAMETERS.items()
    ]
    params_file = DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="parameter file, by path or by its name in launch_config",
    )
    return LaunchDescription([*arguments, params_file, OpaqueFunction(function=stage)])
