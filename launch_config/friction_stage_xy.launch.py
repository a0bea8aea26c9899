"""An x-y stage: two axes, each a stage and its controller in a namespace of its own.

ros2 launch friction_stage friction_stage_xy.launch.py
ros2 launch friction_stage friction_stage_xy.launch.py model_x:=guide_1 model_y:=guide_2 record:=run
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

HERE = Path(__file__).parent
AXES = ("x", "y")


def beside_this_file(name):
    """The path of a file of launch_config that is given by its bare name; anything else as it
    is."""
    return str(HERE / name) if name == Path(name).name and (HERE / name).is_file() else name


def axes(context):
    def given(name):
        return LaunchConfiguration(name).perform(context)

    nodes = []
    for axis in AXES:
        stage = {"model": beside_this_file(given(f"model_{axis}"))}
        if given("record"):
            stage["record"] = f"{given('record')}_{axis}"
        stage = {name: ParameterValue(value, value_type=str) for name, value in stage.items()}
        stage = [beside_this_file(given("params_file")), stage]
        own = given(f"controller_{axis}")
        controller = [str(HERE / "controller_params.yaml")]
        controller += [beside_this_file(own)] if own else []
        common = {
            "namespace": axis,
            "output": "screen",
            "on_exit": Shutdown(reason=f"a node of the axis {axis} has ended"),
        }
        nodes += [
            Node(
                package="friction_stage",
                executable="stage_node",
                name="stage",
                parameters=stage,
                **common,
            ),
            Node(
                package="friction_stage",
                executable="controller_node",
                name="controller",
                parameters=controller,
                condition=IfCondition(LaunchConfiguration("controller_node")),
                **common,
            ),
        ]
    return nodes


def generate_launch_description():
    models = [
        DeclareLaunchArgument(
            f"model_{axis}",
            default_value="guide_1",
            description="guide, model file of launch_config by its name, or path, of the axis "
            f"{axis}",
        )
        for axis in AXES
    ]
    controllers = [
        DeclareLaunchArgument(
            f"controller_{axis}",
            default_value="",
            description=f"parameter file of the controller of the axis {axis}, such as tune writes "
            "(empty: controller_params.yaml)",
        )
        for axis in AXES
    ]
    record = DeclareLaunchArgument(
        "record",
        default_value="",
        description="bag directories to record into, with _x and _y after the name; they must not "
        "exist",
    )
    params_file = DeclareLaunchArgument(
        "params_file",
        default_value="stage_params.yaml",
        description="parameter file of both stages, by path or by its name in launch_config",
    )
    controller_node = DeclareLaunchArgument(
        "controller_node",
        default_value="true",
        choices=["true", "false"],
        description="whether each axis has a controller_node; false: the stages alone",
    )
    arguments = [*models, *controllers, record, params_file, controller_node]
    return LaunchDescription([*arguments, OpaqueFunction(function=axes)])
