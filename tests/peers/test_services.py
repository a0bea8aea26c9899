"""Parameters of the controller and services of both nodes, as rclpy programs use them."""

import pytest
from diagnostics import Diagnostics, number
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.serialization import serialize_message
from ros import Ros, nanoseconds
from std_srvs.srv import SetBool, Trigger

CONTROLLER = {
    "bandwidth",
    "gains.stage.p",
    "gains.stage.i",
    "gains.stage.d",
    "lowpass.frequency",
    "lowpass.damping",
    "feedforward.mass",
    "feedforward.viscous",
    "rate",
    "tuning",
}


class Parameters:
    def __init__(self, ros, node: str) -> None:
        self.ros = ros
        self.client = AsyncParameterClient(ros.node, node)
        ros.until(self.client.services_are_ready, f"the parameter services of {node}")

    def names(self) -> set[str]:
        return set(self.ros.result(self.client.list_parameters([], 0), "the list").result.names)

    def get(self, name: str):
        values = self.ros.result(self.client.get_parameters([name]), f"the value of {name}").values
        return parameter_value_to_python(values[0]) if values else None

    def set(self, name: str, value):
        (result,) = self.ros.result(
            self.client.set_parameters([Parameter(name, value=value)]), f"{name}"
        ).results
        return result


@pytest.fixture
def on_controller(ros, stage, controller):
    stage(mode="realtime", control_rate=1000.0)
    controller(rate=1000.0, bandwidth=30.0)
    return Parameters(ros, "controller")


def test_the_controller_lists_its_parameters_and_gives_their_values(on_controller):
    assert CONTROLLER <= on_controller.names()
    assert on_controller.get("bandwidth") == 30.0
    assert on_controller.get("rate") == 1000.0
    assert on_controller.get("lowpass.frequency") == 180.0


def test_a_gain_that_is_set_is_the_gain_that_acts(ros, stage, controller):
    # In lockstep: in real time the loop gives up bandwidth while the machine is too busy.
    stage(mode="lockstep", control_rate=1000.0)
    controller(rate=1000.0, bandwidth=30.0)
    on_controller = Parameters(ros, "controller")
    states = ros.collect("/controller/state", depth=10)
    # While the gains follow from the bandwidth, a gain of one's own is refused.
    result = on_controller.set("gains.stage.p", 12345.0)
    assert not result.successful and "tuning" in result.reason
    for name, value in (("tuning", "gains"), ("gains.stage.p", 12345.0)):
        result = on_controller.set(name, value)
        assert result.successful, result.reason
    assert on_controller.get("gains.stage.p") == 12345.0
    del states[:]
    ros.until(lambda: len(states) > 50, "states with the new gain")
    newest = states[-10:]
    assert any(state.error != 0.0 for state in newest)
    for state in newest:
        assert state.proportional == pytest.approx(12345.0 * state.error)


def test_the_controller_refuses_with_a_reason(on_controller):
    before = on_controller.get("gains.stage.p")
    for name, value, reason in [
        ("bandwidth", -1.0, ["bandwidth", "-1.0 Hz", "within"]),
        ("bandwidth", "fast", ["bandwidth", "double", "string"]),
        ("bandwidth", float("nan"), ["bandwidth", "finite"]),
        # The lowpass at 6 times the bandwidth does not fit below half the rate.
        ("bandwidth", 100.0, ["lowpass.frequency", "600", "500"]),
        ("bandwith", 1.0, ["bandwith", "did you mean `bandwidth`?"]),
        ("rate", 2000.0, ["rate", "read-only"]),
    ]:
        result = on_controller.set(name, value)
        assert not result.successful, f"{name} = {value} was taken"
        for word in reason:
            assert word in result.reason
    assert on_controller.get("bandwidth") == 30.0
    assert on_controller.get("gains.stage.p") == before


def test_descriptors_say_type_range_and_whether_read_only(ros, on_controller):
    response = ros.call(
        DescribeParameters, "/controller/describe_parameters", names=["gains.stage.p", "rate"]
    )
    gain, rate = response.descriptors
    assert gain.type == rate.type == ParameterType.PARAMETER_DOUBLE
    assert gain.description and rate.description
    assert gain.floating_point_range[0].from_value == 0.0 and not gain.read_only
    assert rate.read_only


def test_all_parameters_at_once_are_told_and_described(ros, on_controller):
    """Answers that are longer than a frame of the network: several kilobytes."""
    names = sorted(on_controller.names())
    values = ros.call(GetParameters, "/controller/get_parameters", names=names).values
    assert len(values) == len(names)
    described = ros.call(DescribeParameters, "/controller/describe_parameters", names=names)
    assert [descriptor.name for descriptor in described.descriptors] == names
    # More than an Ethernet frame, and half of the largest datagram at most: parameters are added.
    assert 1500 < len(serialize_message(described)) < 8192


def test_a_program_with_many_topics_and_clients_is_answered(ros, stage):
    """Its discovery messages fill datagrams of tens of kilobytes when the stage asks for them."""
    publishers = [ros.node.create_publisher(WrenchStamped, f"/other_{k}", 10) for k in range(150)]
    stage(mode="lockstep", control_rate=1000.0)
    clients = [ros.node.create_client(Trigger, "/stage/reset") for _ in range(3)]
    for client in clients:
        ros.until(client.service_is_ready, "the service")
        assert ros.result(client.call_async(Trigger.Request()), "the answer").success
    assert len(publishers) == 150


def test_reset_puts_the_stage_back_to_0_and_time_goes_on(ros, stage):
    stage(mode="realtime", control_rate=1000.0)
    encoder = ros.collect("/stage/encoder")
    force = ros.publisher("/stage/force")
    push(force, 300.0)
    ros.until(lambda: encoder and encoder[-1].position[0] > 1e-3, "a millimetre of motion")
    before = nanoseconds(encoder[-1].header.stamp)
    response = ros.call(Trigger, "/stage/reset")
    assert response.success, response.message
    ros.until(lambda: abs(encoder[-1].position[0]) < 1e-6, "position 0")
    stamps = [nanoseconds(sample.header.stamp) for sample in encoder]
    assert all(a < b for a, b in zip(stamps, stamps[1:])) and stamps[-1] > before


def test_a_disabled_stage_is_not_moved_and_an_enabled_one_is(ros, stage):
    stage(mode="realtime", control_rate=1000.0)
    encoder = ros.collect("/stage/encoder")
    force = ros.publisher("/stage/force")
    for on in (False, True):
        response = ros.call(SetBool, "/stage/enable", data=on)
        assert response.success, response.message
        push(force, 300.0)
        if on:
            ros.until(lambda: encoder[-1].position[0] > 1e-3, "a millimetre of motion")
        else:
            count = len(encoder)
            ros.until(lambda: len(encoder) > count + 200, "200 samples")
            assert abs(encoder[-1].position[0]) < 1e-6


def push(publisher, force: float) -> None:
    """A single force (N): it acts until the stage finds that no other comes."""
    message = WrenchStamped()
    message.header.stamp = Clock(clock_type=ClockType.SYSTEM_TIME).now().to_msg()
    message.wrench.force.x = force
    publisher.publish(message)


def test_a_disabled_controller_sends_no_force_and_an_enabled_one_does(ros, on_controller):
    states = ros.collect("/controller/state", depth=10)
    for on in (False, True):
        response = ros.call(SetBool, "/controller/enable", data=on)
        assert response.success, response.message
        ros.until(lambda: states and states[-1].enabled == on, f"enabled = {on}")
        if not on:
            assert states[-1].output == 0.0


def test_publishers_have_the_name_of_their_node_also_when_they_were_replaced(
    ros, stage, controller, domain
):
    stage(mode="lockstep", control_rate=1000.0)
    controller(rate=1000.0, bandwidth=20.0)
    diagnostics = Diagnostics(ros)
    ros.until(
        lambda: number(diagnostics.newest(), "sample") > 70_000,
        "more samples than one publisher sends",
        300.0,
    )
    for topic, node in (("/stage/encoder", "stage"), ("/controller/state", "controller")):

        def names(observer, topic=topic):
            return {info.node_name for info in observer.node.get_publishers_info_by_topic(topic)}

        # One that was there all the time, and one that comes now.
        ros.until(lambda: names(ros) == {node}, f"the name {node}")
        with Ros(domain, []) as late:
            late.until(lambda: names(late) == {node}, f"the name {node} in a new participant")
            published = late.node.get_publisher_names_and_types_by_node(node, "/")
            assert topic in dict(published)
