"""A busy machine: in lockstep nothing is lost; in real time the stage holds or stops safely."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import bags
import pytest
from conftest import BINARIES
from diagnostics import ERROR, Diagnostics, number
from ros import nanoseconds, trajectory
from std_srvs.srv import SetBool
from test_crashes import MOTION, friction_stage

BUSY = 8
WITHIN = 1e-3
DEMO = ["--guides", "guide_2", "--rest", "0.2", "--fine-steps", "1"]


# Ends with the process that started it, also where that is killed.
LOOP = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""


@pytest.fixture
def busy() -> Iterator[None]:
    """Busy loops next to the test, at the priority of any program."""
    loops = [subprocess.Popen([sys.executable, "-c", LOOP]) for _ in range(BUSY)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def stamps(messages: list) -> list[int]:
    return [nanoseconds(message.header.stamp) for message in messages]


def assert_whole(bag: Path) -> None:
    """Every sample of every topic is in the bag; the run ends while the last one is answered."""
    messages = bags.with_mcap_ros2_support(bag)
    encoder = stamps(messages["/stage/encoder"])
    period = encoder[1] - encoder[0]
    assert encoder == list(range(encoder[0], encoder[-1] + period, period))
    assert [nanoseconds(message.clock) for message in messages["/clock"]] == encoder
    assert stamps(messages["/stage/force_cell"]) == stamps(messages["/stage/state"]) == encoder
    for topic in ("/stage/force", "/controller/state"):
        heard = stamps(messages[topic])
        missing = set(encoder[:-1]) - set(heard)
        assert not missing, f"{topic} lacks {len(missing)} of {len(encoder)} samples"
        assert len(heard) == len(set(heard)), f"{topic} has samples twice"
    check = subprocess.run(
        [BINARIES / "friction-stage", "check", bag], capture_output=True, text=True, timeout=300
    )
    assert check.returncode == 0, check.stdout + check.stderr


@pytest.mark.timeout(900)
def test_a_demo_on_a_busy_machine_records_every_sample_of_every_topic(busy, tmp_path):
    command = [BINARIES / "friction-stage", "demo", *DEMO, "--out", tmp_path / "demo", "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert run.returncode == 0, run.stderr
    (guide,) = json.loads(run.stdout)
    assert [move["name"] for move in guide["moves"]] == [
        "50 mm forward",
        "50 mm return",
        "10 µm step",
    ]
    assert_whole(Path(guide["bag"]))


@pytest.mark.timeout(900)
def test_a_motion_that_is_played_on_a_busy_machine_is_recorded_whole(busy, tmp_path):
    command = [BINARIES / "friction-stage", "play", MOTION, "--record", tmp_path / "bag", "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert run.returncode == 0, run.stderr
    assert_whole(tmp_path / "bag")


@pytest.mark.timeout(900)
def test_two_demos_side_by_side_end_as_one_does(tmp_path):
    def demo(name: str) -> subprocess.Popen:
        command = [BINARIES / "friction-stage", "demo", *DEMO, "--out", tmp_path / name, "--json"]
        environment = {**os.environ, "ROS_DOMAIN_ID": "0"}
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        )

    runs = [demo("one"), demo("other")]
    moves = []
    for run in runs:
        out, errors = run.communicate(timeout=900)
        assert run.returncode == 0, errors
        (guide,) = json.loads(out)
        moves.append(guide["moves"])
        assert_whole(Path(guide["bag"]))
    assert moves[0] == moves[1]


@pytest.mark.timeout(900)
@pytest.mark.parametrize("priority", [0, 10])
def test_the_default_pair_on_a_busy_machine_holds_or_stops(ros, start, busy, tmp_path, priority):
    stage = start("stage_node", priority=priority, record=tmp_path / "bag")
    start("controller_node", priority=priority)
    # Not the samples: at the default rate they are more than a busy Python can hear.
    of_stage = Diagnostics(ros)
    diagnostics = Diagnostics(ros, "/controller: controller")
    setpoint = ros.publisher("/stage/setpoint", readers=2)
    begin = number(
        of_stage.until(lambda s: number(s, "sample") > 0, "the first sample", 120.0), "stamp_ns"
    )
    point = {"time": 1.0, "positions": [0.02], "velocities": [0.0], "accelerations": [0.0]}
    setpoint.publish(trajectory([point]))
    end = begin + 12_000_000_000
    of_stage.until(lambda s: number(s, "stamp_ns") > end, "12 s", 300.0)
    status = diagnostics.newest()
    if status.level == ERROR:
        # It may have been stopped just now: it comes to rest from then on.
        end = number(of_stage.newest(), "stamp_ns") + 4_000_000_000
        of_stage.until(lambda s: number(s, "stamp_ns") > end, "4 s", 300.0)
    # Holes in the recording are the machine's, and are reported.
    stage.stop(expected=(0, 3))
    messages = bags.with_mcap_ros2_support(tmp_path / "bag")
    samples = {nanoseconds(m.header.stamp): m.position[0] for m in messages["/stage/encoder"]}
    assert all(-0.1 < x < 0.12 for x in samples.values()), status
    late = [x for stamp, x in samples.items() if stamp > end - 2_000_000_000]
    if status.level == ERROR:
        # Stopped: at rest, wherever that is.
        assert "stopped" in status.message
        assert max(late) - min(late) < WITHIN, status
    else:
        assert max(abs(x - 0.02) for x in late) < WITHIN, status


def missing(stamps: list[int], period: int) -> int:
    """How many samples between the first and the last are not there."""
    return len(set(range(stamps[0], stamps[-1] + 1, period)) - set(stamps))


# With and without a right to a real-time priority.
@pytest.mark.timeout(600)
@pytest.mark.parametrize("priority", [0, 10])
def test_a_recording_by_service_on_a_busy_machine_has_every_sample_or_says_how_many_are_missing(
    ros, start, busy, tmp_path, priority
):
    period = 1_000_000
    stage = start("stage_node", control_rate=1e9 / period, priority=priority, record_into=tmp_path)
    # Whether the loop holds on a busy machine is not what is looked at here.
    start("controller_node", rate=1e9 / period, priority=priority, supervision__enabled=False)
    diagnostics = Diagnostics(ros)
    diagnostics.until(lambda s: number(s, "sample") > 1000, "1000 samples", 120.0)
    recorded: set[Path] = set()
    of_all = 0
    # Each of them begins and ends while states and forces are on their way.
    for _ in range(3):
        before = number(diagnostics.newest(), "recording_dropped_samples")
        begun = ros.call(SetBool, "/stage/record", data=True)
        assert begun.success, begun.message
        at = number(diagnostics.newest(), "sample")
        diagnostics.until(lambda s, at=at: number(s, "sample") > at + 3000, "3000 samples", 120.0)
        ended = ros.call(SetBool, "/stage/record", data=False)
        assert ended.success, ended.message
        (bag,) = {path.parent for path in tmp_path.glob("*/metadata.yaml")} - recorded
        recorded.add(bag)

        counted = number(diagnostics.newest(), "recording_dropped_samples") - before
        of_all += counted
        said = re.search(r"(\d+) samples are missing", ended.message)
        assert (int(said[1]) if said else 0) == counted, ended.message
        messages = bags.with_mcap_ros2_support(bag)
        encoder, states = stamps(messages["/stage/encoder"]), stamps(messages["/controller/state"])
        assert len(encoder) + counted > 3000
        assert stamps(messages["/stage/force_cell"]) == stamps(messages["/stage/state"]) == encoder
        lacks = missing(encoder, period) + missing(states, period)
        assert lacks <= counted, f"{lacks} are missing, {counted} were counted"
        # The controller tells of each sample that it answers.
        forces = stamps(messages["/stage/force"])
        told = {stamp for stamp in states if min(forces) <= stamp <= max(forces)}
        assert not told - set(forces), f"{len(told - set(forces))} forces are missing"
        assert friction_stage("check", bag, code=0)["complete"]
    stage.stop(expected=3 if of_all else 0)
    assert ("the recordings lack" in stage.log()) == bool(of_all), stage.excerpt()


def test_a_setpoint_of_finite_numbers_cannot_poison_the_controller(ros, stage, controller):
    stage(mode="lockstep", control_rate=1000.0)
    controller(rate=1000.0, bandwidth=30.0)
    states = ros.collect("/controller/state")
    setpoint = ros.publisher("/stage/setpoint", readers=2)
    for far in ([1e308, -1e308], [0.0, 1e308], [10.0, 0.0]):
        setpoint.publish(
            trajectory(
                [
                    {
                        "time": 0.1 * (1 + k),
                        "positions": [x],
                        "velocities": [0.0],
                        "accelerations": [0.0],
                    }
                    for k, x in enumerate(far)
                ]
            )
        )
    status = Diagnostics(ros, "/controller: controller")
    status.refusal("refused_setpoints", 3, "point")
    good = {"time": 0.1, "positions": [0.005], "velocities": [0.0], "accelerations": [0.0]}
    setpoint.publish(trajectory([good]))
    ros.until(lambda: states and abs(states[-1].position - 0.005) < 20e-6, "the arrival at 5 mm")
    assert all(abs(state.output) <= 2000.0 for state in states)


def test_a_reset_of_the_stage_alone_is_safe(ros, stage, controller):
    from std_srvs.srv import Trigger

    stage(mode="lockstep", control_rate=1000.0)
    controller(rate=1000.0, bandwidth=30.0)
    # The newest: in lockstep there are more than Python can take.
    encoder = ros.collect("/stage/encoder", depth=1)
    ros.follow([{"time": 0.5, "positions": [0.05], "velocities": [0.0], "accelerations": [0.0]}])
    ros.until(lambda: encoder and abs(encoder[-1].position[0] - 0.05) < 1e-4, "50 mm")
    assert ros.call(Trigger, "/stage/reset").success
    ros.until(lambda: abs(encoder[-1].position[0]) < WITHIN, "the reset")
    at = len(encoder) - 1
    stamp = stamps(encoder[at:])[0]
    ros.until(lambda: stamps(encoder[-1:])[0] > stamp + 1_000_000_000, "a second")
    assert all(abs(m.position[0]) < WITHIN for m in encoder[at:])
    status = Diagnostics(ros, "/controller: controller").newest()
    assert status.level != ERROR and number(status, "stage_resets") == 1, status


def test_a_slow_controller_of_a_low_bandwidth_starts(stage, controller):
    stage(mode="lockstep", control_rate=500.0, physics_rate=40000.0)
    controller(rate=500.0, bandwidth=12.0)


def splits(bag: Path) -> list[str]:
    return sorted(path.name for path in bag.glob("*.mcap"))


@pytest.mark.parametrize("how", [{"record_split_duration": 0.5}, {"record_split_size": 300_000}])
def test_a_recording_is_split_and_read_as_one(ros, stage, controller, tmp_path, how: dict):
    process = stage(mode="lockstep", control_rate=1000.0, record=tmp_path / "bag", **how)
    controller(rate=1000.0, bandwidth=30.0)
    Diagnostics(ros).until(lambda s: int(value(s, "sample")) > 3000, "3000 samples")
    ros.until(lambda: len(splits(tmp_path / "bag")) > 2, "a third file")
    process.stop()
    messages = bags.with_rosbags(tmp_path / "bag")
    encoder = stamps(messages["/stage/encoder"])
    assert encoder == list(range(encoder[0], encoder[-1] + 1_000_000, 1_000_000))


def value(status, key: str) -> str:
    return next(pair.value for pair in status.values if pair.key == key)


def test_a_recording_whose_directory_is_removed_fails(ros, stage, tmp_path):
    import shutil

    process = stage(
        mode="realtime", control_rate=1000.0, record=tmp_path / "bag", record_into=tmp_path
    )
    shutil.rmtree(tmp_path / "bag")
    status = Diagnostics(ros).until(lambda s: s.level == ERROR, "the error")
    assert "removed" in status.message
    # The stage itself is sound: it records again, elsewhere.
    assert ros.call(SetBool, "/stage/record", data=True).success
    Diagnostics(ros).until(lambda s: value(s, "recording") == "true", "another recording")
    begun = int(value(Diagnostics(ros).newest(), "sample"))
    Diagnostics(ros).until(lambda s: int(value(s, "sample")) > begun + 1000, "1000 samples")
    answer = ros.call(SetBool, "/stage/record", data=False)
    assert answer.success, answer.message
    (again,) = tmp_path.glob("*/metadata.yaml")
    encoder = stamps(bags.with_rosbags(again.parent)["/stage/encoder"])
    assert encoder == list(range(encoder[0], encoder[-1] + 1_000_000, 1_000_000))
    # The first one is not forgotten.
    process.stop(expected=1)
    assert "Nothing of it is left" in process.log()
