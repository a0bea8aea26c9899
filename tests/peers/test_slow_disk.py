"""A disk that stalls while a stage records: in real time what the bag lacks is counted and said, in
lockstep time waits."""

import re
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from diagnostics import OK, WARN, Diagnostics, number, value
from friction_stage_testing import Process
from std_srvs.srv import SetBool
from test_crashes import assert_no_holes, assert_python_reads, friction_stage, stamps

# Samples in real time that may wait for the recorder (docs/ros2.md, What a bag can lack).
RING = 16_384


def samples(diagnostics: Diagnostics, more_than: int) -> int:
    """The stage's sample, when it is beyond that one."""
    status = diagnostics.until(
        lambda status: number(status, "sample") > more_than, f"sample {more_than}", timeout=90.0
    )
    return number(status, "sample")


def lacks(messages: list, period: int) -> int:
    """Samples that are missing between the first and the last."""
    times = stamps(messages)
    assert all(b > a for a, b in zip(times, times[1:])), "samples are there twice or out of order"
    return round((times[-1] - times[0]) / period) + 1 - len(times)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("controlled", [False, True], ids=["alone", "with a controller"])
@pytest.mark.parametrize("sync", ["end", "interval"])
def test_in_real_time_what_a_stalled_disk_costs_is_counted_and_said(
    ros, start, disk, tmp_path, sync, controlled
):
    rate, bag = 4000.0, tmp_path / "bag"
    process = start("stage_node", record=bag, record_sync=sync, control_rate=rate)
    if controlled:
        # Whether the loop holds is not what is looked at here.
        start("controller_node", rate=rate, supervision__enabled=False)
    diagnostics = Diagnostics(ros)
    begun = samples(diagnostics, 2000)
    disk.touch()
    # The stage goes on, until more samples wait than there is room for.
    samples(diagnostics, begun + RING + 4000)
    # It is said while the disk stalls.
    status = diagnostics.until(
        lambda status: number(status, "recording_dropped_samples") > 0,
        "samples that are missing",
        60.0,
    )
    assert status.level == WARN and "lack" in status.message, status
    ros.until(lambda: "its recorder waits" in process.log(), "a word in the log")
    disk.unlink()
    samples(diagnostics, number(status, "sample") + 2000)
    status = diagnostics.newest()
    assert value(status, "recording") == "true"
    process.stop(expected=3)

    log = process.log()
    (said,) = re.findall(
        rf"recorded \d+ messages in {re.escape(str(bag))}; (\d+) samples are missing", log
    )
    assert int(said) >= number(status, "recording_dropped_samples")
    assert re.search(r" WARN .*the recording lacks \d+ samples so far", log), process.excerpt()
    messages = assert_python_reads(bag)
    period = round(1e9 / rate)
    encoder = lacks(messages["/stage/encoder"], period)
    assert encoder > 2000
    for topic in ("/stage/force_cell", "/stage/state"):
        assert stamps(messages[topic]) == stamps(messages["/stage/encoder"])
    states = lacks(messages["/controller/state"], period) if controlled else 0
    # States that are missing before the first and after the last one in the bag count as well.
    assert int(said) >= encoder + states if controlled else int(said) == encoder
    report = friction_stage("check", bag, code=3)
    assert report["complete"] and not report["damage"]


@pytest.mark.timeout(300)
@pytest.mark.parametrize("sync", ["end", "interval"])
def test_in_lockstep_time_waits_for_a_stalled_disk_and_nothing_is_lost(
    ros, start, disk, tmp_path, sync
):
    process = start(
        "stage_node",
        mode="lockstep",
        record=tmp_path / "bag",
        record_sync=sync,
        answer_timeout=60.0,
    )
    start("controller_node")
    diagnostics = Diagnostics(ros)
    samples(diagnostics, 2000)
    disk.touch()
    # What was on its way when it stalled.
    at = number(diagnostics.newest(), "sample")
    seen = standstill(diagnostics)
    # Of a chunk of half a second that was not yet due, at the rate of this machine.
    assert seen - at < 40_000, f"time went on for {seen - at} samples"
    disk.unlink()
    now = samples(diagnostics, seen + 5000)
    status = diagnostics.newest()
    assert status.level == OK and number(status, "recording_dropped_samples") == 0, status
    process.stop()
    messages = assert_python_reads(tmp_path / "bag")
    assert_no_holes(messages["/stage/encoder"], 250_000)
    assert len(messages["/stage/encoder"]) > now
    answered = set(stamps(messages["/stage/force"]))
    # No peer had found another before the first answer, and the last sample may be out.
    begin, end = min(answered), stamps(messages["/stage/encoder"])[-1]
    missing = {t for t in stamps(messages["/stage/encoder"]) if begin <= t < end} - answered
    assert not missing, f"{len(missing)} forces are missing"
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]


def stalled(start: Callable[..., Process], ros, disk: Path, bag: Path) -> Process:
    """A stage whose recorder waits for its disk."""
    process = start("stage_node", record=bag)
    diagnostics = Diagnostics(ros)
    begun = samples(diagnostics, 2000)
    disk.touch()
    # Half a second is brought to the file at once.
    samples(diagnostics, begun + 4000)
    return process


def test_a_node_that_is_ended_while_its_disk_stalls_ends_with_it_and_its_bag_is_whole(
    ros, start, disk, tmp_path
):
    process = stalled(start, ros, disk, tmp_path / "bag")
    heard = time.monotonic()

    def hear(_: DiagnosticArray) -> None:
        nonlocal heard
        heard = time.monotonic()

    ros.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 1)
    process.popen.terminate()
    # It is silent, and keeps what it has.
    ros.until(lambda: time.monotonic() - heard > 2.0, "the end of its diagnostics")
    ros.until(lambda: "the disk of the recording does not answer" in process.log(), "its words")
    assert process.popen.poll() is None
    disk.unlink()
    process.ended(expected=0)
    messages = assert_python_reads(tmp_path / "bag")
    assert_no_holes(messages["/stage/encoder"], 250_000)
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]


def standstill(diagnostics: Diagnostics) -> int:
    """The sample at which time stands still."""
    still, seen = 0, None
    while still < 5:
        status = diagnostics.newest()
        still = still + 1 if number(status, "sample") == seen else 0
        seen = number(status, "sample")
    return seen


@pytest.mark.parametrize("signals", [1, 2])
def test_a_lockstep_that_waits_for_its_disk_ends_on_signals_as_real_time_does(
    ros, start, disk, tmp_path, signals
):
    process = start("stage_node", mode="lockstep", record=tmp_path / "bag", answer_timeout=60.0)
    start("controller_node")
    diagnostics = Diagnostics(ros)
    samples(diagnostics, 2000)
    disk.touch()
    last = standstill(diagnostics)
    process.popen.terminate()
    ros.until(lambda: "the disk of the recording does not answer" in process.log(), "its words")
    assert process.popen.poll() is None
    if signals == 2:
        process.popen.terminate()
        process.ended(expected=1)
        disk.unlink()
        friction_stage("recover", tmp_path / "bag", "--out", tmp_path / "whole", code=3)
        assert_no_holes(assert_python_reads(tmp_path / "whole")["/stage/encoder"], 250_000)
        return
    disk.unlink()
    process.ended(expected=0)
    encoder = assert_python_reads(tmp_path / "bag")["/stage/encoder"]
    assert_no_holes(encoder, 250_000)
    assert len(encoder) > last
    assert friction_stage("check", tmp_path / "bag", code=0)["complete"]


@pytest.mark.parametrize("service", [False, True], ids=["alone", "during the end of a recording"])
def test_another_signal_ends_a_node_whose_disk_does_not_answer(ros, start, disk, tmp_path, service):
    process = stalled(start, ros, disk, tmp_path / "bag")
    if service:
        client = ros.node.create_client(SetBool, "/stage/record")
        ros.until(client.service_is_ready, "the service")
        client.call_async(SetBool.Request(data=False))
        # It serves others meanwhile.
        Diagnostics(ros).newest()
    process.popen.terminate()
    ros.until(lambda: "the disk of the recording does not answer" in process.log(), "its words")
    process.popen.terminate()
    process.ended(expected=1)
    disk.unlink()
    recovered = friction_stage("recover", tmp_path / "bag", "--out", tmp_path / "whole", code=3)
    assert recovered["messages"] > 0
    assert_no_holes(assert_python_reads(tmp_path / "whole")["/stage/encoder"], 250_000)
