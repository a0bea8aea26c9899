"""launch_config/ and package.xml agree with each other, with the programs and with the messages."""

import ast
import importlib
import json
import math
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
import tomllib
import yaml
from conftest import BINARIES
from control_msgs.msg import JointCommand
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.clock import Clock, ClockType
from ros import TOPICS
from sensor_msgs.msg import JointState
from topic_hardware import COMMANDS, STATES

ROOT = Path(__file__).parents[2]
FILES = ROOT / "launch_config"
CARGO = tomllib.loads((ROOT / "Cargo.toml").read_text())
NODES = {"stage": "stage_node", "controller": "controller_node"}
AXES = ("x", "y")
VALUES = {
    ParameterType.PARAMETER_BOOL: "bool_value",
    ParameterType.PARAMETER_INTEGER: "integer_value",
    ParameterType.PARAMETER_DOUBLE: "double_value",
    ParameterType.PARAMETER_STRING: "string_value",
}


def read_yaml(name: str) -> dict:
    return yaml.safe_load((FILES / name).read_text())


def flat(tree: dict, prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def parameters(ros, node: str) -> dict:
    """Every parameter of a running node with its value, by its own services."""
    names = ros.call(ListParameters, f"{node}/list_parameters").result.names
    values = ros.call(GetParameters, f"{node}/get_parameters", names=names).values
    return {
        name: getattr(value, VALUES[value.type]) for name, value in zip(names, values, strict=True)
    }


# --- parameter files


@pytest.mark.parametrize("node", NODES)
def test_parameter_file_holds_every_parameter_with_its_default(node, start, ros):
    file = FILES / f"{node}_params.yaml"
    written = dict(flat(read_yaml(file.name)[f"/**/{node}"]["ros__parameters"]))
    # What the node works out by itself is refused when given, so it stands in comments.
    derived = re.findall(r"^ *# ((?:gains|lowpass)\.\S+): (\S+)", file.read_text(), re.MULTILINE)
    start(NODES[node], "--ros-args", "-r", "__ns:=/plain")
    defaults = parameters(ros, f"/plain/{node}")
    defaults.pop("use_sim_time")
    found = written | {name: pytest.approx(float(value), rel=1e-14) for name, value in derived}
    assert found == defaults
    types = {name: type(value) for name, value in written.items()}
    assert types == {name: type(defaults[name]) for name in written}, (
        "1 is an integer, 1.0 a double"
    )

    start(NODES[node], "--ros-args", "-r", "__ns:=/given", "--params-file", str(file))
    given = parameters(ros, f"/given/{node}")
    given.pop("use_sim_time")
    assert given == defaults


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("file", ["lockstep_params.yaml", "friction_stage_controllers.yaml"])
def test_nodes_take_the_values_of_files_for_several_nodes(file, node, start, ros):
    expected = {}
    for section, content in read_yaml(file).items():
        if section.removeprefix("/**/").removeprefix("/**") in ("", node):
            expected |= dict(flat(content["ros__parameters"]))
    assert expected
    start(NODES[node], "--ros-args", "--params-file", str(FILES / file))
    found = parameters(ros, f"/{node}")
    assert {name: found.get(name) for name in expected} == expected


# --- ros2_control


def test_urdf_and_controllers_fit_the_stage_and_each_other():
    robot = ElementTree.parse(FILES / "friction_stage.urdf").getroot()
    stack = read_yaml("friction_stage_controllers.yaml")
    of = {node: content["ros__parameters"] for node, content in stack.items()}
    model = read_yaml("stage_guide_1.yaml")

    joint = robot.find("joint[@name='stage']")
    assert joint.get("type") == "prismatic" and joint.find("axis").get("xyz") == "1 0 0"
    assert float(joint.find("limit").get("effort")) == model["motor"]["force_limit"]
    links = {link.get("name"): link for link in robot.findall("link")}
    moving = joint.find("child").get("link")
    assert float(links[moving].find("inertial/mass").get("value")) == model["mass"]
    assert joint.find("parent").get("link") in links

    hardware = {
        parameter.get("name"): parameter.text
        for parameter in robot.findall("ros2_control/hardware/param")
    }
    assert hardware == {
        "joint_commands_topic": "/stage/joint_commands",
        "joint_states_topic": "/stage/encoder",
        "trigger_joint_command_threshold": "-1.0",
    }
    controlled = robot.find("ros2_control/joint")
    assert controlled.get("name") == of["stage"].get("joint", "stage") == "stage"
    assert [interface.get("name") for interface in controlled.findall("command_interface")] == [
        "effort"
    ]
    states = [interface.get("name") for interface in controlled.findall("state_interface")]
    assert states == ["position", "velocity", "effort"]

    assert of["/**"] == {"use_sim_time": True}
    assert of["stage"]["control_rate"] <= of["controller_manager"]["update_rate"]
    assert of["stage"]["physics_rate"] % of["stage"]["control_rate"] == 0
    assert of["stage"]["publish_clock"] is True and of["stage"]["wait_for_command"] is False
    assert of["stage"]["frame_id"] == of["force_cell_broadcaster"]["frame_id"] == moving
    assert of["force_cell_broadcaster"]["interface_names"] == {"force": {"x": "stage/effort"}}
    trajectory = of["joint_trajectory_controller"]
    assert (
        trajectory["joints"]
        == of["forward_command_controller"]["joints"]
        == of["pid_controller"]["dof_names"]
    )
    assert trajectory["joints"] == ["stage"] and set(trajectory["state_interfaces"]) <= set(states)
    loaded = {name for name, value in of["controller_manager"].items() if isinstance(value, dict)}
    # joint_state_broadcaster needs no parameters.
    assert loaded == set(of) - {"/**", "stage", "controller_manager"} | {"joint_state_broadcaster"}


def of_joint(parameters: dict, joint: str = "stage") -> dict:
    """What a controller's parameters say of the joint, and of its goals, as if it were `stage`."""
    found = {}
    if "gains" in parameters:
        found["gains"] = {"stage": parameters["gains"][joint]}
    if "constraints" in parameters:
        constraints = parameters["constraints"]
        found["constraints"] = {
            "goal_time": constraints["goal_time"],
            "stage": constraints[joint],
        }
    return found


def test_urdf_and_controllers_of_two_axes_fit_the_stages_and_each_other():
    robot = ElementTree.parse(FILES / "friction_stage_xy.urdf").getroot()
    stack = read_yaml("friction_stage_xy_controllers.yaml")
    of = {node: content["ros__parameters"] for node, content in stack.items()}
    one = read_yaml("friction_stage_controllers.yaml")
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    assert tuple(joints) == AXES
    blocks = robot.findall("ros2_control")
    assert len({block.get("name") for block in blocks}) == len(blocks) == len(AXES)
    for axis, block in zip(AXES, blocks, strict=True):
        assert [joint.get("name") for joint in block.findall("joint")] == [axis]
        assert {param.get("name"): param.text for param in block.findall("hardware/param")} == {
            "joint_commands_topic": f"/{axis}/stage/joint_commands",
            "joint_states_topic": f"/{axis}/stage/encoder",
            "trigger_joint_command_threshold": "-1.0",
        }
        moving = joints[axis].find("child").get("link")
        assert of[f"/{axis}/stage"] == {"joint": axis, "frame_id": moving}
    assert of["/**/stage"]["control_rate"] <= of["controller_manager"]["update_rate"]
    # No /clock without a node that publishes it.
    assert not any("use_sim_time" in given for given in of.values())
    joints_of = {"joint_trajectory_controller": "joints", "forward_command_controller": "joints"}
    for name, key in (joints_of | {"pid_controller": "dof_names"}).items():
        assert of[name][key] == list(AXES)
        alone = one[name]["ros__parameters"]
        assert of[name] | {key: ["stage"]} | of_joint(alone) == alone
        for axis in AXES:
            assert of_joint(of[name], axis) == of_joint(alone)


@pytest.mark.parametrize("topic", ["joint_commands", "joint_commands/effort"])
def test_stages_take_their_own_joint_of_commands_for_both(topic, start, ros):
    """As one hardware component for both axes sends them, on one topic."""
    samples: dict[str, list[JointState]] = {axis: [] for axis in AXES}
    for axis in AXES:
        own = ("-r", f"__ns:=/{axis}", "-r", f"~/{topic}:=/{topic}")
        file = str(FILES / "friction_stage_xy_controllers.yaml")
        start("stage_node", "--ros-args", *own, "--params-file", file)
        encoder = f"/{axis}/stage/encoder"
        ros.node.create_subscription(JointState, encoder, samples[axis].append, STATES)
    kind = JointState if topic == "joint_commands" else JointCommand
    publisher = ros.node.create_publisher(kind, f"/{topic}", COMMANDS)
    ros.until(lambda: publisher.get_subscription_count() == len(AXES), "both stages")
    forces = [300.0, -300.0]

    def moved() -> bool:
        if kind is JointState:
            command = JointState(name=list(AXES), effort=forces)
        else:
            command = JointCommand(joint_names=list(AXES), interface_name="effort", values=forces)
        command.header.stamp = Clock(clock_type=ClockType.SYSTEM_TIME).now().to_msg()
        publisher.publish(command)
        return all(heard and abs(heard[-1].position[0]) > 1e-3 for heard in samples.values())

    ros.until(moved, "both axes in motion")
    for axis, force in zip(AXES, forces, strict=True):
        sample = samples[axis][-1]
        assert sample.name == [axis] and sample.header.frame_id == f"carriage_{axis}"
        assert math.copysign(1.0, sample.position[0]) == math.copysign(1.0, force)


# --- layouts


def resolves(kind: type, path: str) -> bool:
    """Whether a path such as `wrench.force.x` or `position[0]` names a number in a message."""
    field, _, rest = path.partition(".")
    name, index, _ = field.partition("[")
    declared = kind.get_fields_and_field_types().get(name)
    if declared is None or bool(index) != declared.startswith("sequence<"):
        return False
    if "/" in declared:
        package, _, message = declared.partition("/")
        return bool(rest) and resolves(
            getattr(importlib.import_module(f"{package}.msg"), message), rest
        )
    return not rest


def test_foxglove_layout_plots_what_is_published():
    layout = json.loads((FILES / "friction_stage_foxglove.json").read_text())
    panels = layout["configById"]

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert paths
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic in TOPICS and resolves(TOPICS[topic], field), path


def test_plotjuggler_layout_plots_what_is_published():
    root = ElementTree.parse(FILES / "friction_stage_plotjuggler.xml").getroot()
    splitter = root.find(".//DockSplitter")
    assert (
        int(splitter.get("count"))
        == len(splitter.findall("DockArea"))
        == len(splitter.get("sizes").split(";"))
    )
    curves = [curve.get("name") for curve in root.iter("curve")]
    assert curves
    for curve in curves:
        topic = next((topic for topic in TOPICS if curve.startswith(f"{topic}/")), "")
        assert topic, curve
        field = curve.removeprefix(f"{topic}/")
        # PlotJuggler shows a JointState by the names of its joints.
        field = (
            re.sub(r"^stage/(\w+)$", r"\1[0]", field)
            if topic == "/stage/encoder"
            else field.replace("/", ".")
        )
        assert resolves(TOPICS[topic], field), curve


# --- launch files

LAUNCH_FILES = sorted(FILES.glob("*.launch.py"))


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_launch_file_names_programs_and_files_that_exist(file):
    tree = ast.parse(file.read_text(), file.name)
    compile(tree, file.name, "exec")
    assert any(
        isinstance(node, ast.FunctionDef) and node.name == "generate_launch_description"
        for node in tree.body
    )
    calls = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Node"
    ]
    for call in calls:
        words = {
            word.arg: word.value.value
            for word in call.keywords
            if isinstance(word.value, ast.Constant)
        }
        if words["package"] == "friction_stage":
            assert words["executable"] in [program["name"] for program in CARGO["bin"]]
            assert NODES[words["name"]] == words["executable"]
    strings = [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    for name in strings:
        if re.fullmatch(r"\w+\.(yaml|urdf|launch\.py)", name):
            assert (FILES / name).is_file(), name
    # Examples in the opening words too.
    for name in re.findall(r"\b\w+\.(?:yaml|urdf|launch\.py)\b", ast.get_docstring(tree)):
        assert (FILES / name).is_file(), name


def described(file: Path):
    """The description of a launch file, and a context, with the launch of a ROS installation."""
    reason = "needs the launch of a ROS installation: no wheels of it exist"
    launch = pytest.importorskip("launch", reason=reason, exc_type=ImportError)
    pytest.importorskip("launch_ros", reason=reason, exc_type=ImportError)
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    context = launch.LaunchContext()
    return PythonLaunchDescriptionSource(str(file)).get_launch_description(context), context


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_launch_describes_it(file):
    description, _ = described(file)
    names = [argument.name for argument in description.get_launch_arguments()]
    wanted = set()
    if "_xy" in file.name:
        wanted |= {"model_x", "model_y", "controller_x", "controller_y", "record"}
        wanted |= {"params_file", "controller_node"}
    elif "controller_manager" not in file.name:
        wanted |= {"model", "mode", "drive", "record", "params_file"}
    if "ros2_control" in file.name:
        wanted |= {"controller", "robot_state_publisher"}
    assert wanted <= set(names)


def programs_of(name: str, **arguments: str) -> list[str]:
    """The programs that a launch file starts."""
    description, context = described(FILES / name)
    from launch_ros.actions import Node

    context.launch_configurations.update(arguments)
    found, entities = [], [description]
    while entities:
        entity = entities.pop(0)
        if not isinstance(entity, Node):
            entities = [*(entity.visit(context) or []), *entities]
        elif entity.condition is None or entity.condition.evaluate(context):
            found.append(entity.node_executable)
    return found


STACK = ["robot_state_publisher", "ros2_control_node", "spawner"]


@pytest.mark.parametrize(
    ("name", "stages"),
    [
        ("friction_stage_ros2_control.launch.py", ["stage_node"]),
        ("friction_stage_xy_ros2_control.launch.py", ["stage_node", "stage_node"]),
    ],
)
def test_robot_state_publisher_can_be_left_out(name, stages):
    assert programs_of(name) == STACK + stages
    assert programs_of(name, robot_state_publisher="false") == STACK[1:] + stages


def test_two_axes_have_a_controller_node_each_unless_it_is_left_out():
    both = ["stage_node", "controller_node"] * 2
    assert programs_of("friction_stage_xy.launch.py") == both
    assert programs_of("friction_stage_xy.launch.py", controller_node="false") == both[::2]


# --- the package


def test_package_xml_agrees_with_the_crate_and_the_messages():
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    assert package.get("format") == "3"
    assert package.findtext("export/build_type") == "ament_cargo"
    # cargo-ament-build installs under the crate's name, `ros2 run` looks under the package's.
    assert package.findtext("name") == CARGO["package"]["name"]
    assert package.findtext("version") == CARGO["workspace"]["package"]["version"]
    assert package.findtext("license") == CARGO["workspace"]["package"]["license"]
    assert (ROOT / package.find("license").get("file")).is_file()
    messages = ElementTree.parse(ROOT / "msg" / "package.xml").getroot()
    used = {kind.__module__.partition(".")[0] for kind in TOPICS.values()}
    assert messages.findtext("name") in used
    # Whoever has no use for our own messages needs no build of them.
    used -= {messages.findtext("name")}
    assert used <= {dependency.text for dependency in package.findall("exec_depend")}
    assert CARGO["package"]["metadata"]["ros"]["install_to_share"] == ["launch_config"]


def test_the_package_of_the_messages_has_another_name_and_all_of_them():
    package = ElementTree.parse(ROOT / "msg" / "package.xml").getroot()
    build = (ROOT / "msg" / "CMakeLists.txt").read_text()
    assert package.findtext("name") == f"{CARGO['package']['name']}_msgs"
    assert f"project({package.findtext('name')})" in build
    assert package.findtext("version") == CARGO["workspace"]["package"]["version"]
    (listed,) = re.findall(r"set\(messages (.*)\)", build)
    assert set(listed.split()) == {path.name for path in (ROOT / "msg").glob("*.msg")}


FIND_BOTH = """
import os
from pathlib import Path

from ament_index_python import get_package_prefix
from friction_stage_msgs.msg import StageState
from rclpy.serialization import serialize_message

# As `ros2 run` looks for the programs of a package.
programs = Path(get_package_prefix("friction_stage")) / "lib/friction_stage"
print(*sorted(path.name for path in programs.iterdir() if os.access(path, os.X_OK)))
print(len(serialize_message(StageState())) > 0, get_package_prefix("friction_stage_msgs"))
"""


@pytest.mark.parametrize("messages_last", [True, False])
def test_programs_and_messages_are_found_whichever_is_sourced_last(messages_last, tmp_path):
    """With the index of installed packages, by which `ros2 run` finds programs; there are no wheels
    of `ros2 run` itself."""
    programs = tmp_path / "install"
    for path in ("share/ament_index/resource_index/packages", "lib/friction_stage"):
        (programs / path).mkdir(parents=True)
    (programs / "share/ament_index/resource_index/packages/friction_stage").touch()
    for name in NODES.values():
        (programs / "lib/friction_stage" / name).symlink_to(BINARIES / name)
    # What is sourced last stands first.
    prefixes = [sys.prefix, str(programs)] if messages_last else [str(programs), sys.prefix]
    environment = os.environ | {"AMENT_PREFIX_PATH": ":".join(prefixes)}
    command = [sys.executable, "-c", FIND_BOTH]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == ["controller_node stage_node", f"True {sys.prefix}"]


def test_file_names_are_unique_and_flat():
    """`ros2 launch PACKAGE NAME` searches the whole share by name."""
    assert all(path.is_file() for path in FILES.iterdir())
