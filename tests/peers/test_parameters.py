"""Parameters of the stage node, used from rclpy as any ROS 2 program uses them."""

import math
import time

import pytest
import rclpy
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy, qos_profile_parameter_events

from conftest import BINARIES, free_domain
from friction_stage_testing import Process

NODE = "/lab/stage_under_test"
TIMEOUT = 20.0


def command_line(*arguments, name="stage_under_test"):
    return ["-r", f"__node:={name}", "-r", "__ns:=/lab", *arguments]


class User:
    """A node of a user's, with a client for each of the six services, and all events of the
    stage."""

    def __init__(self, stage=NODE):
        self.stage = stage
        self.node = rclpy.create_node("user")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.events = []
        self.node.create_subscription(
            ParameterEvent, "/parameter_events", self._event, qos_profile_parameter_events
        )
        self.clients = {}

    def _event(self, event):
        if event.node == self.stage:
            self.events.append(event)

    def ask(self, kind, service, request):
        if service not in self.clients:
            self.clients[service] = self.node.create_client(kind, f"{self.stage}/{service}")
        client = self.clients[service]
        assert client.wait_for_service(timeout_sec=TIMEOUT), f"{service} is not offered"
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, timeout_sec=TIMEOUT)
        assert future.done(), f"{service} does not answer"
        return future.result()

    def get(self, *names):
        values = self.ask(
            GetParameters, "get_parameters", GetParameters.Request(names=list(names))
        ).values
        return [rclpy.parameter.parameter_value_to_python(value) for value in values]

    def set(self, **values):
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        return self.ask(
            SetParameters, "set_parameters", SetParameters.Request(parameters=parameters)
        ).results

    def set_atomically(self, **values):
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        return self.ask(SetParametersAtomically, "set_parameters_atomically", request).result

    def describe(self, *names):
        request = DescribeParameters.Request(names=list(names))
        return self.ask(DescribeParameters, "describe_parameters", request).descriptors

    def wait_for_events(self, count):
        end = time.monotonic() + TIMEOUT
        while len(self.events) < count and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.1)
        assert len(self.events) >= count, f"{len(self.events)} of {count} events came"

    def drain(self):
        """Takes in all that is on its way: an announcement stays behind only one that was made
        after it."""
        mark = 1000.0 + len(self.events)
        assert self.set(answer_timeout=mark)[0].successful
        while not (
            self.events and self.events[-1].changed_parameters[0].value.double_value == mark
        ):
            self.wait_for_events(len(self.events) + 1)
        return len(self.events)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()


@pytest.fixture(scope="module")
def module_domain():
    with free_domain() as domain:
        rclpy.init(domain_id=domain)
        yield domain
        rclpy.shutdown()


@pytest.fixture(scope="module")
def user(module_domain, tmp_path_factory):
    """One for all tests: the first call of a new client can wait 3 s for the heartbeat of its DDS
    writer."""
    arguments = command_line("-p", "command_timeout:=0.25", "-p", "seed:=7")
    stage = Process(
        [str(BINARIES / "stage_node"), "--ros-args", *arguments],
        tmp_path_factory.mktemp("stage") / "log",
    )
    user = User()
    yield user
    user.close()
    stage.stop()


@pytest.fixture
def node_with(module_domain, processes, tmp_path):
    """node_with(*arguments): runs a stage node beside the one of `user`."""

    def node_with(*arguments, name="stage_under_test"):
        command = [str(BINARIES / "stage_node"), "--ros-args", *command_line(*arguments, name=name)]
        processes.append(Process(command, tmp_path / "stage.log"))
        return processes[-1]

    return node_with


def test_list_names_every_parameter(user):
    names = user.ask(ListParameters, "list_parameters", ListParameters.Request()).result.names
    expected = {
        "model",
        "control_rate",
        "physics_rate",
        "mode",
        "drive",
        "seed",
        "command_timeout",
        "publish_clock",
    }
    assert expected | {"record", "every", "clock_pause", "answer_timeout", "use_sim_time"} <= set(
        names
    )
    assert len(names) == len(set(names))


def test_list_with_a_prefix_lists_that_parameter_only(user):
    result = user.ask(
        ListParameters, "list_parameters", ListParameters.Request(prefixes=["seed"])
    ).result
    assert list(result.names) == ["seed"]


def test_values_of_the_command_line_hold(user):
    assert user.get("command_timeout", "seed", "use_sim_time") == [0.25, 7, False]


def test_an_unknown_parameter_is_not_set(user):
    assert user.get("comand_timeout") == [None]


def test_types(user):
    request = GetParameterTypes.Request(
        names=["model", "control_rate", "every", "publish_clock", "nonsense"]
    )
    types = user.ask(GetParameterTypes, "get_parameter_types", request).types
    assert list(types) == [
        ParameterType.PARAMETER_STRING,
        ParameterType.PARAMETER_DOUBLE,
        ParameterType.PARAMETER_INTEGER,
        ParameterType.PARAMETER_BOOL,
        ParameterType.PARAMETER_NOT_SET,
    ]


def test_describe_says_unit_range_and_read_only(user):
    rate, every, mode, timeout = user.describe("control_rate", "every", "mode", "command_timeout")
    assert rate.name == "control_rate" and rate.type == ParameterType.PARAMETER_DOUBLE
    assert rate.read_only and "[Hz]" in rate.description
    assert rate.floating_point_range[0].from_value > 0.0
    assert not rate.integer_range and not rate.dynamic_typing
    assert (
        every.integer_range[0].from_value == 1
        and every.read_only
        and not every.floating_point_range
    )
    assert "realtime" in mode.additional_constraints and "lockstep" in mode.additional_constraints
    assert "[s]" in timeout.description and not timeout.read_only


def test_a_dump_of_the_node_can_be_loaded_back(user):
    """As `ros2 param dump` and `ros2 param load` do it: all values at once, read-only ones among
    them."""
    names = user.ask(ListParameters, "list_parameters", ListParameters.Request()).result.names
    values = dict(zip(names, user.get(*names)))
    assert values["seed"] == 7 and len(values) > 20
    results = user.set(**values)
    assert [result.reason for result in results if not result.successful] == []
    assert dict(zip(names, user.get(*names))) == values
    [refused] = user.set(seed=8)
    assert not refused.successful and "read-only" in refused.reason


def test_set_takes_effect_and_is_announced(user):
    # Only a subscription that the stage has found hears the announcement.
    while not user.events:
        assert user.set(answer_timeout=1.0)[0].successful
        user.executor.spin_once(timeout_sec=0.1)
    heard = user.drain()
    [result] = user.set(answer_timeout=2.0)
    assert result.successful and result.reason == ""
    assert user.get("answer_timeout") == [2.0]
    user.wait_for_events(heard + 1)
    event = user.events[heard]
    assert [p.name for p in event.changed_parameters] == ["answer_timeout"]
    assert event.changed_parameters[0].value.double_value == 2.0
    assert not event.new_parameters and not event.deleted_parameters
    assert abs(event.stamp.sec - time.time()) < 60


@pytest.mark.parametrize(
    "name, value, reason",
    [
        ("every", 2.0, ["every", "integer", "double", "2.0"]),
        ("every", 2, ["every", "read-only"]),
        ("command_timeout", 1, ["command_timeout", "double", "integer", "write 1.0"]),
        ("command_timeout", math.nan, ["command_timeout", "finite", "NaN"]),
        ("command_timeout", -1.0, ["command_timeout", "-1.0 s", "within"]),
        ("answer_timeout", 0.0, ["answer_timeout", "0.0 s", "within 0.01"]),
        ("control_rate", 2000.0, ["control_rate", "read-only", "-p control_rate:=2000.0"]),
        ("comand_timeout", 1.0, ["comand_timeout", "did you mean `command_timeout`?"]),
    ],
)
def test_a_wrong_value_is_refused_with_the_reason(user, name, value, reason):
    before = user.get("answer_timeout", "command_timeout", "control_rate")
    [result] = user.set(**{name: value})
    assert not result.successful
    for part in reason:
        assert part in result.reason
    assert user.get("answer_timeout", "command_timeout", "control_rate") == before


def test_a_declared_parameter_cannot_be_deleted(user):
    gone = ParameterMsg(
        name="answer_timeout", value=ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
    )
    [result] = user.ask(
        SetParameters, "set_parameters", SetParameters.Request(parameters=[gone])
    ).results
    assert not result.successful and "cannot be deleted" in result.reason


def test_set_parameters_takes_the_good_ones_and_refuses_the_bad_one(user):
    first, second, third = user.set(answer_timeout=3.0, mode="lockstep", command_timeout=0.5)
    assert (first.successful, second.successful, third.successful) == (True, False, True)
    assert user.get("answer_timeout", "command_timeout") == [3.0, 0.5]


def test_set_atomically_takes_all_or_none(user):
    assert user.set_atomically(answer_timeout=4.0, command_timeout=0.75).successful
    assert user.get("answer_timeout", "command_timeout") == [4.0, 0.75]
    result = user.set_atomically(answer_timeout=5.0, command_timeout=-1.0)
    assert not result.successful and "command_timeout" in result.reason
    assert user.get("answer_timeout", "command_timeout") == [4.0, 0.75]


def test_an_atomic_change_is_announced_in_one_event(user):
    while not user.events:
        assert user.set(answer_timeout=6.0)[0].successful
        user.executor.spin_once(timeout_sec=0.1)
    heard = user.drain()
    assert user.set_atomically(answer_timeout=7.0, command_timeout=1.5).successful
    user.wait_for_events(heard + 1)
    assert sorted(p.name for p in user.events[-1].changed_parameters) == [
        "answer_timeout",
        "command_timeout",
    ]
    assert not user.set_atomically(answer_timeout=0.0).successful
    assert user.set_atomically(answer_timeout=8.0).successful
    user.wait_for_events(heard + 2)
    # Nothing was announced for the refused one between the two.
    assert [p.value.double_value for p in user.events[heard + 1].changed_parameters] == [8.0]


def test_the_services_are_offered_once_and_under_the_node(user):
    assert user.node.wait_for_node(NODE, TIMEOUT)
    assert user.get("seed") == [7]
    services = dict(user.node.get_service_names_and_types_by_node("stage_under_test", "/lab"))
    ours = {
        name: types
        for name, types in services.items()
        if name.startswith(NODE + "/") and "parameter" in name
    }
    assert ours == {
        f"{NODE}/describe_parameters": ["rcl_interfaces/srv/DescribeParameters"],
        f"{NODE}/get_parameter_types": ["rcl_interfaces/srv/GetParameterTypes"],
        f"{NODE}/get_parameters": ["rcl_interfaces/srv/GetParameters"],
        f"{NODE}/list_parameters": ["rcl_interfaces/srv/ListParameters"],
        f"{NODE}/set_parameters": ["rcl_interfaces/srv/SetParameters"],
        f"{NODE}/set_parameters_atomically": ["rcl_interfaces/srv/SetParametersAtomically"],
    }
    assert user.node.count_services(f"{NODE}/set_parameters") == 1


def test_two_users_with_several_requests_at_once_get_all_their_answers(user):
    other = user.node.create_client(GetParameters, f"{NODE}/get_parameters")
    assert other.wait_for_service(timeout_sec=TIMEOUT)
    assert user.get("seed") == [7]
    request = GetParameters.Request(names=["seed"])
    for _ in range(20):
        asked = [
            client.call_async(request)
            for client in (user.clients["get_parameters"], other)
            for _ in range(4)
        ]
        for future in asked:
            user.executor.spin_until_future_complete(future, timeout_sec=TIMEOUT)
        assert [future.result().values[0].integer_value for future in asked if future.done()] == [
            7
        ] * 8


def test_a_parameter_file_reaches_the_node(node_with, tmp_path):
    file = tmp_path / "stage.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    every: 2\n    command_timeout: 0.5\n"
        "/lab/stage_with_a_file:\n  ros__parameters:\n    every: 3\n"
        "/other:\n  ros__parameters:\n    every: 4\n    unknown_here: true\n"
    )
    arguments = [
        "--params-file",
        str(file),
        "-p",
        "stage_with_a_file:every:=9",
        "-p",
        "command_timeout:=0.125",
    ]
    node_with(*arguments, name="stage_with_a_file")
    user = User("/lab/stage_with_a_file")
    try:
        # `stage_with_a_file:` alone means /stage_with_a_file, not the node in /lab.
        assert user.get("every", "command_timeout") == [3, 0.125]
    finally:
        user.close()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (
            ["-p", "comand_timeout:=1.0"],
            ["-p comand_timeout:=1.0", "did you mean `command_timeout`?"],
        ),
        (
            ["-p", "command_timeout:=1"],
            ["command_timeout", "type double", "integer 1", "write 1.0"],
        ),
        (["-p", "command_timeout:=-1.0"], ["command_timeout", "-1.0 s", "within"]),
        (["-p", "mode:=lokstep"], ["mode", "did you mean `lockstep`?"]),
        (
            ["-p", "physics_rate:=39999.0"],
            ["physics_rate", "39999", "control_rate 4000", "whole multiple"],
        ),
        (["-p", "every"], ["-p every", ":="]),
        (["--param-file", "x.yaml"], ["--param-file", "did you mean `--params-file`?"]),
    ],
)
def test_a_wrong_command_line_ends_the_node_with_the_reason(node_with, arguments, message):
    said = complaint(node_with(*arguments))
    for part in message:
        assert part in said


def test_a_broken_parameter_file_ends_the_node_with_file_and_line(node_with, tmp_path):
    file = tmp_path / "broken.yaml"
    file.write_text("/**:\n  ros__parameters:\n    every: [1\n")
    assert "broken.yaml, line" in complaint(node_with("--params-file", str(file)))


def complaint(process: Process) -> str:
    """What a node says that ends at its start; an end by panic is none."""
    code = process.wait()
    process.ended(expected=code)
    assert code in (1, 2), process.excerpt()
    # The first line of the log is the command line itself.
    said = process.log().split("\n", 1)[1]
    assert "panicked" not in said
    return said


def test_qos_overrides_are_applied_and_unknown_ones_are_told(ros, start, processes, tmp_path):
    """As rclcpp reads them. A reliable subscription does not hear a best-effort publisher."""
    file = tmp_path / "qos.yaml"
    file.write_text(
        """/**:
  ros__parameters:
    control_rate: 1000.0
    qos_overrides:
      /stage/encoder:
        publisher:
          reliability: best_effort
          history: keep_last
          depth: 5
      /parameter_events:
        publisher:
          depth: 10
"""
    )
    process = start("stage_node", "--ros-args", "--params-file", str(file))
    ros.first("/stage/force_cell")
    [publisher] = ros.node.get_publishers_info_by_topic("/stage/encoder")
    assert publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    [publisher] = ros.node.get_publishers_info_by_topic("/stage/force_cell")
    assert publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    told = "qos_overrides./parameter_events.publisher.depth"
    ros.until(lambda: told in process.log(), "what has no effect")
    assert "/stage/encoder" not in process.log()


@pytest.mark.parametrize(
    "policy, value, words",
    [
        ("depth", "0", "must be an integer of 1 to 100000"),
        ("depth", "ten", "must be an integer of 1 to 100000"),
        ("durability", "transient_local", "must be volatile"),
        ("deadline", "5", "depth, history, reliability and durability can"),
    ],
)
def test_a_wrong_qos_override_ends_the_start_with_what_would_be_right(start, policy, value, words):
    process = start(
        "stage_node",
        "--ros-args",
        "-p",
        f"qos_overrides./stage/encoder.publisher.{policy}:={value}",
    )
    process.ended(1)
    assert words in process.log()
