"""Recorded bags open in the Python readers, and played back they give the same motion again."""

import math

import bags
import pytest
from diagnostics import Diagnostics, value
from friction_stage_msgs.msg import ControllerState
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from ros import Ros, nanoseconds, rest
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from test_crashes import friction_stage

RATE = 1000.0
# With noise and quantisation, from a seed; time stands still until the first command, so that every
# sample is answered.
STAGE = {"mode": "lockstep", "wait_for_command": True, "control_rate": RATE, "seed": 7}
MOVE = [rest(0.0, 0.0), rest(0.2, 0.02)]
DURATION = 400_000_000


def record(ros: Ros, stage, controller, bag) -> None:
    """Records a move from the first sample on."""
    process = stage(**STAGE, record=bag)
    encoder = ros.collect("/stage/encoder")
    other = controller(rate=RATE, bandwidth=30.0)
    start = ros.follow(MOVE)
    ros.until(
        lambda: encoder and nanoseconds(encoder[-1].header.stamp) > start + DURATION,
        "the end of the move",
    )
    other.stop()
    process.stop()


def check_contents(messages: dict[str, list]) -> None:
    for topic in [
        "/stage/encoder",
        "/stage/force_cell",
        "/stage/force",
        "/stage/state",
        "/stage/setpoint",
        "/controller/state",
        "/clock",
    ]:
        assert messages.get(topic), f"{topic} is not in the bag, only {sorted(messages)}"
    samples = messages["/stage/encoder"]
    stamps = [nanoseconds(sample.header.stamp) for sample in samples]
    period = round(1e9 / RATE)
    assert all(b - a == period for a, b in zip(stamps, stamps[1:])), "the encoder has holes"
    for sample in samples:
        assert list(sample.name) == ["stage"]
        assert all(
            len(field) == 1 and math.isfinite(field[0])
            for field in (sample.position, sample.velocity, sample.effort)
        )
    assert samples[-1].position[0] == pytest.approx(0.02, abs=50e-6)
    assert list(messages["/stage/setpoint"][-1].points[-1].positions) == [0.02]
    truth = bags.by_stamp(messages["/stage/state"])
    for sample in samples[::50]:
        state = truth[nanoseconds(sample.header.stamp)]
        assert len(state.guide_force) == len(state.bristle_deflection) == 4
        assert sample.position[0] == pytest.approx(state.position, abs=20e-9)


def test_a_bag_opens_in_rosbags_and_in_mcap_ros2_support(ros, stage, controller, tmp_path):
    bag = tmp_path / "bag"
    record(ros, stage, controller, bag)
    ours, theirs = bags.with_rosbags(bag), bags.with_mcap_ros2_support(bag)
    check_contents(ours)
    check_contents(theirs)
    assert {topic: len(messages) for topic, messages in ours.items()} == {
        topic: len(messages) for topic, messages in theirs.items()
    }


class Player(Node):
    """Plays recorded forces back: each answers the sample that it answered when it was recorded."""

    def __init__(self, forces: dict[int, float], **options: object) -> None:
        super().__init__("player", **options)
        self.forces = forces
        self.samples: dict[int, JointState] = {}
        self.publisher = self.create_publisher(WrenchStamped, "/stage/force", 10)
        self.create_subscription(JointState, "/stage/encoder", self.on_encoder, 10)

    def on_encoder(self, sample: JointState) -> None:
        stamp = nanoseconds(sample.header.stamp)
        self.samples.setdefault(stamp, sample)
        if stamp in self.forces:
            answer = WrenchStamped(header=sample.header)
            answer.wrench.force.x = self.forces[stamp]
            self.publisher.publish(answer)


@pytest.mark.timeout(400)
def test_a_bag_played_back_onto_the_force_gives_the_recorded_encoder_exactly(
    ros, stage, controller, tmp_path
):
    record(ros, stage, controller, tmp_path / "bag")
    recorded = bags.with_rosbags(tmp_path / "bag")
    forces = {
        stamp: m.wrench.force.x for stamp, m in bags.by_stamp(recorded["/stage/force"]).items()
    }
    samples = bags.by_stamp(recorded["/stage/encoder"])
    first, last = min(forces), max(forces)
    assert first == min(samples)
    assert len(forces) == (last - first) // round(1e9 / RATE) + 1, "the recorded forces have holes"

    player = ros.add(Player(forces, context=ros.context))
    stage(**STAGE)
    ros.until(lambda: last in player.samples, "the last answered sample", timeout=200.0)

    assert len(forces) > DURATION * 1e-9 * RATE
    for stamp in forces:
        old, new = samples[stamp], player.samples[stamp]
        assert (old.position[0], old.velocity[0], old.effort[0]) == (
            new.position[0],
            new.velocity[0],
            new.effort[0],
        ), f"sample {stamp} ns differs"
    assert max(sample.position[0] for sample in player.samples.values()) > 0.019


def test_time_does_not_wait_for_states_that_no_longer_come(ros, start, tmp_path):
    process = start("stage_node", **STAGE, record=tmp_path / "bag")
    states = ros.publisher("/controller/state")
    force = ros.publisher("/stage/force")
    told: list[int] = []
    answered: list[int] = []
    falls_silent = False

    def answer(sample: JointState) -> None:
        force.publish(WrenchStamped(header=sample.header))
        answered.append(nanoseconds(sample.header.stamp))
        if not falls_silent:
            states.publish(ControllerState(header=sample.header))
            told.append(answered[-1])

    ros.node.create_subscription(JointState, "/stage/encoder", answer, 100)
    hears = "recording_hears_controller"
    Diagnostics(ros).until(lambda status: value(status, hears) == "true", "the states in the bag")
    falls_silent = True
    # It may go on for 512 samples without states.
    silence = 3 * 512 * round(1e9 / RATE)
    ros.until(lambda: answered[-1] > told[-1] + silence, "samples without states")
    process.stop(expected=(0, 3))
    assert "time no longer waits for it" in process.log()


def test_forces_that_come_late_in_real_time_are_replayed_as_they_acted(ros, stage, tmp_path):
    bag, period = tmp_path / "bag", 2_000_000
    process = stage(mode="realtime", control_rate=1e9 / period, seed=7, record=bag)
    force = ros.publisher("/stage/force")
    waiting: list[JointState] = []
    answered = 0

    def answer(sample: JointState) -> None:
        nonlocal answered
        waiting.append(sample)
        # By turns at once and 10 samples late.
        late = 10 if (answered // 50) % 2 else 0
        while len(waiting) > late:
            message = WrenchStamped(header=waiting.pop(0).header)
            time = answered * period * 1e-9
            message.wrench.force.x = 100.0 * math.sin(2.0 * math.pi * 2.0 * time)
            force.publish(message)
            answered += 1

    ros.node.create_subscription(JointState, "/stage/encoder", answer, 100)
    ros.until(lambda: answered > 1000, "1000 answers", timeout=60.0)
    process.stop()

    recorded = bags.with_rosbags(bag)
    forces = {t: m.wrench.force.x for t, m in bags.by_stamp(recorded["/stage/force"]).items()}
    # What acted in the interval that ends at a sample.
    acted = {t: m.motor_force for t, m in bags.by_stamp(recorded["/stage/state"]).items()}
    late = sum(acted.get(t + period) != value for t, value in forces.items())
    assert late > 300, f"{late} of {len(forces)} forces were late"
    report = friction_stage("replay", bag, code=0)
    assert report["identical"] == report["samples"], report
    # By the stamps it would be several N.
    assert report["missing_force_rms_n"] < 0.5, report


def test_the_record_service_starts_and_ends_a_bag(ros, stage, tmp_path):
    stage(mode="realtime", control_rate=1000.0, record_into=tmp_path)
    encoder = ros.collect("/stage/encoder")
    response = ros.call(SetBool, "/stage/record", data=True)
    assert response.success, response.message
    count = len(encoder)
    ros.until(lambda: len(encoder) > count + 300, "300 samples")
    response = ros.call(SetBool, "/stage/record", data=False)
    assert response.success, response.message
    (metadata,) = tmp_path.glob("**/metadata.yaml")
    # The service's answer says where the bag is.
    assert metadata.parent.name in response.message
    assert len(bags.with_rosbags(metadata.parent)["/stage/encoder"]) >= 250
