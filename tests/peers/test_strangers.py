"""Strangers on the network: hostile datagrams cost the stage nothing, other machines do not reach
it, and what it does not support it says."""

import functools
import json
import os
import random
import re
import subprocess
import sys
from pathlib import Path

import pytest
import rtps
from conftest import BINARIES
from ros import nanoseconds
from rtps import ANY_READER, PUBLICATIONS, WRITER, Stranger
from std_srvs.srv import SetBool
from test_crashes import running

HERE = Path(__file__).parent
REALTIME = {"mode": "realtime", "control_rate": 1000.0, "physics_rate": 10000.0}
# Datagrams of the random test.
DATAGRAMS = int(os.environ.get("STRANGERS", "20000"))


def memory(process) -> dict[str, int]:
    """Address space and resident memory of a process, MiB."""
    status = Path(f"/proc/{process.popen.pid}/status").read_text()
    return {
        name: int(re.search(rf"{name}:\s+(\d+) kB", status)[1]) // 1024
        for name in ("VmSize", "VmRSS")
    }


def assert_in_order(ros, process, before: dict[str, int]) -> None:
    """A new peer finds the stage, hears every sample at full rate, and is answered; memory is as
    before."""
    encoder = ros.collect("/stage/encoder")
    ros.until(lambda: len(encoder) > 1000, "1000 samples")
    stamps = [nanoseconds(message.header.stamp) for message in encoder]
    assert stamps == list(range(stamps[0], stamps[-1] + 1, 1_000_000)), "samples were lost"
    assert ros.call(SetBool, "/stage/enable", data=True).success
    after = memory(process)
    assert after["VmRSS"] < 200, after
    # Address space that was reserved and not yet used counts as well.
    assert after["VmSize"] < before["VmSize"] + 500, (before, after)


HOSTILE = {
    "fragment of 4 GiB": rtps.fragment(PUBLICATIONS, 1, 0xFFFFFFFF),
    "heartbeat over 2^40 samples": rtps.heartbeat(PUBLICATIONS, 1, 1 << 40),
    "heartbeat over 2^33 samples": rtps.heartbeat(PUBLICATIONS, 1, 1 << 33),
    "gap over 2^40 samples": rtps.gap(PUBLICATIONS, 100, 1 << 40),
    "request for fragment 2^32 - 1": rtps.fragment_request(rtps.SUBSCRIPTIONS, 1, 0xFFFFFFFF - 40),
    "request for fragment 0": rtps.fragment_request(rtps.SUBSCRIPTIONS, 1, 0),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_datagram_costs_the_stage_nothing(ros, stage, case):
    process = stage(**REALTIME)
    before = memory(process)
    stranger = Stranger(process.popen.pid)
    # As a participant that the stage has discovered: its heartbeats would count.
    for _ in range(3):
        stranger.send(stranger.announcement())
        ros.spin(0.1)
    stranger.send(stranger.message(HOSTILE[case]))
    assert_in_order(ros, process, before)


def mutated(stranger: Stranger, chaos: random.Random) -> bytes:
    """A datagram of plausible submessages, some bytes of it changed, some of it cut off."""
    entities = chaos.choice(
        [
            PUBLICATIONS,
            rtps.SUBSCRIPTIONS,
            rtps.PARTICIPANTS,
            ANY_READER + WRITER,
            chaos.randbytes(8),
        ]
    )
    count = chaos.choice(
        [chaos.randrange(1, 300), chaos.randrange(1 << 33), chaos.randrange(1 << 64)]
    )
    other = chaos.choice([count + chaos.randrange(300), chaos.randrange(1 << 64)])
    pieces = [
        lambda: rtps.data(entities, count, chaos.randbytes(chaos.randrange(300))),
        lambda: rtps.fragment(
            entities, count, chaos.randrange(1 << chaos.randrange(1, 33)), chaos.randrange(1 << 16)
        ),
        lambda: rtps.heartbeat(entities, count, other, chaos.randrange(1 << 31)),
        lambda: rtps.gap(entities, count, other),
        lambda: rtps.acknack(entities, count, chaos.randrange(1 << 31)),
        lambda: rtps.fragment_request(
            entities, count, chaos.randrange(1 << chaos.randrange(1, 33))
        ),
        lambda: rtps.submessage(
            chaos.randrange(256), chaos.randbytes(chaos.randrange(80)), chaos.randrange(256)
        ),
        lambda: stranger.announcement()[20:],
        lambda: stranger.publication("rt/chaos", "std_msgs::msg::dds_::String_")[20:],
    ]
    datagram = bytearray(
        stranger.message(*(chaos.choice(pieces)() for _ in range(chaos.randrange(1, 5))))
    )
    for _ in range(chaos.choice([0, 0, 1, 4, 20])):
        datagram[chaos.randrange(20, len(datagram))] = chaos.randrange(256)
    return bytes(
        datagram[: len(datagram) - chaos.choice([0, 0, 0, chaos.randrange(len(datagram))])]
    )


def test_random_datagrams_cost_the_stage_nothing(ros, stage):
    process = stage(**REALTIME)
    before = memory(process)
    chaos = random.Random(1)
    strangers = [Stranger(process.popen.pid) for _ in range(5)]
    for sent in range(DATAGRAMS // len(strangers[0].targets)):
        stranger = chaos.choice(strangers)
        stranger.send(
            chaos.randbytes(chaos.randrange(200)) if sent % 10 == 0 else mutated(stranger, chaos)
        )
        # What comes faster than it can be read is lost in the socket's buffer and tests nothing.
        ros.spin(0.0005)
        assert process.popen.poll() is None, (
            f"the stage ended after {sent} datagrams:\n{process.excerpt()}"
        )
    assert_in_order(ros, process, before)


def test_a_stage_that_is_filled_up_closes_its_bag_and_ends(ros, start, tmp_path):
    process = start("stage_node", **REALTIME, record=tmp_path / "bag")
    ros.first("/stage/encoder")
    # Fragments of the largest samples that are heard, each of another writer: a MiB for a hundred
    # bytes.
    stranger = Stranger(process.popen.pid)
    for _ in range(5000):
        prefix = bytes([1, 15]) + os.urandom(10)
        datagram = stranger.message(rtps.fragment(PUBLICATIONS, 1, (1 << 20) - 1), prefix=prefix)
        stranger.socket.sendto(datagram, stranger.targets[0])
        ros.spin(0.001)
        if process.popen.poll() is not None:
            break
    process.ended(expected=1)
    # Threads of the DDS library may log after it.
    ends = [
        line for line in process.log().splitlines() if line.startswith("error: this node takes ")
    ]
    assert len(ends) == 1 and "more than 1024 MB" in ends[0], process.excerpt()
    command = [str(BINARIES / "friction-stage"), "check", str(tmp_path / "bag"), "--json"]
    report = json.loads(subprocess.run(command, capture_output=True, text=True, timeout=60).stdout)
    assert report["complete"] and not report["damage"]


# Nothing that the command starts outlives it, or `unshare`, however they end: its processes are a
# namespace of their own.
WITH_ITS_PROCESSES = ["--pid", "--fork", "--kill-child", "--mount-proc"]


@functools.cache
def into_a_network() -> list[str]:
    """What runs a command in a network namespace of its own, as root of it; empty where nothing
    does."""
    for way in (["unshare", "--net"], ["unshare", "--map-root-user", "--net"]):
        # In some containers /proc cannot be mounted.
        for command in ([*way, *WITH_ITS_PROCESSES], way):
            try:
                if (
                    subprocess.run(
                        [*command, "ip", "link", "set", "lo", "up"], capture_output=True
                    ).returncode
                    == 0
                ):
                    return command
            except FileNotFoundError:
                continue
    return []


@pytest.mark.skipif(
    not into_a_network(),
    reason="needs a second machine: the test makes one with a network namespace, which needs the "
    "package iproute2, and root or a kernel that lets users make namespaces (README, second "
    "command)",
)
def test_another_machine_does_not_reach_a_stage_of_this_machine(tmp_path):
    command = [
        *into_a_network(),
        sys.executable,
        str(HERE / "other_machine.py"),
        str(BINARIES / "stage_node"),
        str(tmp_path),
    ]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, f"{run.stdout}\n{run.stderr}"
    moved = json.loads(run.stdout)
    # The same datagrams move the stage where they may: from this machine, and with the range of a
    # subnet.
    assert moved["LOCALHOST"]["here"] > 1e-3, moved
    assert moved["SUBNET"]["other machine"] > 1e-3, moved
    assert moved["LOCALHOST"]["other machine"] == 0.0, moved


@pytest.mark.skipif(
    "--pid" not in into_a_network(),
    reason="needs a network and processes of its own: iproute2, and root or a kernel that lets "
    "users make namespaces (README, second command)",
)
def test_nothing_on_another_machine_outlives_the_script_that_started_it(ros, tmp_path):
    mark = f"{tmp_path}/node"
    inner = (
        "import subprocess, sys; subprocess.Popen("
        f"[sys.executable, '-c', 'input()', {mark!r}], stdin=subprocess.PIPE).wait()"
    )
    script = subprocess.Popen([*into_a_network(), sys.executable, "-c", inner])

    def runs() -> bool:
        return any(line.rstrip().endswith(f"input() {mark}") for line in running(tmp_path))

    try:
        ros.until(runs, "the start of the node")
    finally:
        script.kill()
        script.wait()
    ros.until(lambda: not runs(), "the end of the node")


@pytest.mark.parametrize("strategy", ["Enforce", "Permissive"])
def test_security_is_refused(start, monkeypatch, strategy):
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", strategy)
    for program in ("stage_node", "controller_node"):
        process = start(program)
        process.ended(expected=1)
        last = process.log().splitlines()[-1]
        assert last.startswith(
            "error: ROS_SECURITY_ENABLE is true: DDS security is not supported"
        ), last


def test_what_has_no_effect_is_said_at_the_start(ros, stage, start, monkeypatch):
    monkeypatch.setenv("ROS_STATIC_PEERS", "10.0.0.1;lab")
    process = start("stage_node", "--ros-args", "--enclave", "/lab", "--", **REALTIME)
    ros.first("/stage/encoder")
    warnings = [line for line in process.log().splitlines() if " WARN " in line]
    assert any("the enclave /lab has no effect" in line for line in warnings), process.excerpt()
    assert any(
        'ROS_STATIC_PEERS is "10.0.0.1;lab" and has no effect' in line for line in warnings
    ), process.excerpt()
