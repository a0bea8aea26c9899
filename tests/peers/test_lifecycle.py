"""Managed nodes: what `ros2 lifecycle` and a LifecycleNode of launch_ros ask and send."""

import pytest
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import (
    ChangeState,
    GetAvailableStates,
    GetAvailableTransitions,
    GetState,
)
from ros import nanoseconds, rest, trajectory
from std_srvs.srv import SetBool


class Life:
    """The lifecycle of one node, seen from a manager."""

    def __init__(self, ros, node: str) -> None:
        self.ros, self.node = ros, node
        self.events: list[TransitionEvent] = []
        subscription = ros.node.create_subscription(
            TransitionEvent, f"{node}/transition_event", self.events.append, 10
        )
        ros.until(lambda: ros.node.count_publishers(subscription.topic_name), "the node's events")

    def change(self, id: int = 0, label: str = "") -> bool:
        wanted = Transition(id=id, label=label)
        return self.ros.call(ChangeState, f"{self.node}/change_state", transition=wanted).success

    def state(self) -> str:
        return self.ros.call(GetState, f"{self.node}/get_state").current_state.label

    def ways(self, service: str = "get_available_transitions") -> set:
        response = self.ros.call(GetAvailableTransitions, f"{self.node}/{service}")
        return {
            (way.start_state.label, way.transition.label, way.goal_state.label)
            for way in response.available_transitions
        }


def moved(samples) -> float:
    return max(abs(sample.position[0]) for sample in samples)


def test_a_managed_stage_takes_samples_always_and_force_when_it_is_active(friction_stage):
    stage = friction_stage(lifecycle=True, control_rate=1000.0, answer_timeout=60.0)
    life = Life(stage.ros, "/stage")
    assert life.state() == "unconfigured"
    assert life.ways() == {
        ("unconfigured", "configure", "configuring"),
        ("unconfigured", "shutdown", "shuttingdown"),
    }
    for _ in range(50):
        stage.step(300.0)
    assert moved(stage.samples) < 1e-6
    assert life.change(Transition.TRANSITION_CONFIGURE)
    assert life.state() == "inactive"
    for _ in range(50):
        stage.step(300.0)
    assert moved(stage.samples) < 1e-6
    assert life.change(label="activate") and life.state() == "active"
    for _ in range(50):
        stage.step(300.0)
    assert moved(stage.samples) > 1e-3
    # Without force it comes to rest; cleaned up, it is where it began.
    assert life.change(Transition.TRANSITION_DEACTIVATE)
    assert life.change(Transition.TRANSITION_CLEANUP) and life.state() == "unconfigured"
    stage.step(300.0)
    assert abs(stage.step(300.0).position[0]) < 1e-6
    assert life.change(label="shutdown") and life.state() == "finalized"
    assert life.ways() == set()
    stage.ros.until(lambda: len(life.events) == 10, "all events")
    seen = [(event.start_state.label, event.goal_state.label) for event in life.events]
    assert seen[:4] == [
        ("unconfigured", "configuring"),
        ("configuring", "inactive"),
        ("inactive", "activating"),
        ("activating", "active"),
    ]
    assert life.events[0].transition.label == "configure"
    assert life.events[1].transition.label == "transition_success"


def test_what_is_no_way_from_a_state_is_refused_and_changes_nothing(friction_stage):
    stage = friction_stage(lifecycle=True, control_rate=1000.0, answer_timeout=60.0)
    life = Life(stage.ros, "/stage")
    for wanted in (
        {"id": Transition.TRANSITION_ACTIVATE},
        {"label": "deactivate"},
        {"id": 99},
        {"label": "no\x1bsense"},
        {"id": Transition.TRANSITION_ON_CONFIGURE_SUCCESS},
    ):
        assert not life.change(**wanted)
    assert life.state() == "unconfigured" and not life.events
    states = stage.ros.call(GetAvailableStates, "/stage/get_available_states").available_states
    assert State(id=State.PRIMARY_STATE_ACTIVE, label="active") in states and len(states) == 11
    graph = life.ways("get_transition_graph")
    assert ("active", "deactivate", "deactivating") in graph and len(graph) == 25
    # ~/enable would pass the states by.
    client = stage.ros.node.create_client(SetBool, "/stage/enable")
    assert not client.service_is_ready()


def test_a_managed_controller_answers_when_it_is_active(ros, stage, controller, start):
    stage(mode="lockstep", control_rate=1000.0, wait_for_command=True)
    start("controller_node", rate=1000.0, bandwidth=30.0, lifecycle=True)
    encoder = ros.collect("/stage/encoder")
    life = Life(ros, "/controller")
    assert life.change(label="configure")
    ros.until(lambda: len(encoder) > 3, "the sample again")
    assert len({nanoseconds(sample.header.stamp) for sample in encoder}) == 1
    assert life.change(label="activate")
    ros.publisher("/stage/setpoint", readers=2).publish(trajectory([rest(0.2, 0.01)]))
    ros.until(lambda: abs(encoder[-1].position[0] - 0.01) < 1e-5, "the arrival")
    assert life.change(label="deactivate") and life.state() == "inactive"


def test_a_node_at_error_is_deactivated(ros, stage):
    """A sample is not answered: an error of lockstep."""
    process = stage(
        mode="lockstep",
        control_rate=1000.0,
        lifecycle=True,
        wait_for_command=False,
        answer_timeout=0.3,
    )
    life = Life(ros, "/stage")
    assert life.change(label="configure") and life.change(label="activate")
    force = ros.publisher("/stage/force")
    encoder = ros.collect("/stage/encoder", depth=10)
    ros.until(lambda: encoder, "a sample")
    message = WrenchStamped(header=encoder[-1].header)
    message.header.stamp.sec += 1
    force.publish(message)
    ros.until(lambda: life.events and life.events[-1].goal_state.label == "inactive", "the end")
    assert life.state() == "inactive"
    assert "deactivated: lockstep" in process.log()


@pytest.mark.parametrize("name", ["stage_node", "controller_node"])
def test_a_node_that_is_not_managed_offers_none_of_it(ros, stage, start, name):
    stage(mode="lockstep", control_rate=1000.0)
    node = name.removesuffix("_node")
    if node == "controller":
        start(name)
        ros.first("/controller/state")
    services = {service for service, _ in ros.node.get_service_names_and_types()}
    ros.until(
        lambda: f"/{node}/enable" in {s for s, _ in ros.node.get_service_names_and_types()},
        "its services",
    )
    assert f"/{node}/change_state" not in services
