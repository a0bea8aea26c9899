"""Options of the lockstep: an answer to every Nth sample only, and a pause between a sample and its
clock."""

import statistics
import time

from geometry_msgs.msg import WrenchStamped
from rosgraph_msgs.msg import Clock
from ros import nanoseconds
from sensor_msgs.msg import JointState

# Stamp of the first sample, ns, and the period at 1 kHz.
FIRST, PERIOD = 1_000_000_000, 1_000_000


def test_only_every_nth_sample_waits_for_an_answer(ros, stage):
    every = 4
    seen: list[int] = []
    force = ros.node.create_publisher(WrenchStamped, "/stage/force", 10)

    def answer(sample: JointState) -> None:
        index = (nanoseconds(sample.header.stamp) - FIRST) // PERIOD
        if not seen or index > seen[-1]:
            seen.append(index)
        if index % every == 0:
            command = WrenchStamped()
            command.header.stamp = sample.header.stamp
            command.wrench.force.x = 100.0
            force.publish(command)

    ros.node.create_subscription(JointState, "/stage/encoder", answer, 100)
    stage(mode="lockstep", control_rate=1000.0, wait_for_command=True, every=every)
    states = ros.collect("/stage/state")
    ros.until(lambda: seen and seen[-1] >= 400, "400 samples with answers to 100")
    assert seen == list(range(seen[0], seen[-1] + 1))
    # The force is held over the samples in between.
    moving = [state for state in states if state.sample > 0]
    assert moving and all(state.motor_force == 100.0 for state in moving)


def test_the_clock_comes_a_pause_after_its_sample(ros, stage):
    pause = 0.02
    samples: dict[int, float] = {}
    clocks: dict[int, float] = {}
    ros.node.create_subscription(
        JointState,
        "/stage/encoder",
        lambda message: samples.setdefault(nanoseconds(message.header.stamp), time.monotonic()),
        100,
    )
    ros.node.create_subscription(
        Clock,
        "/clock",
        lambda message: clocks.setdefault(nanoseconds(message.clock), time.monotonic()),
        100,
    )
    stage(mode="lockstep", control_rate=1000.0, clock_pause=pause)
    ros.until(lambda: len(samples.keys() & clocks.keys()) > 20, "20 samples and their clocks")
    pauses = [clocks[stamp] - samples[stamp] for stamp in samples.keys() & clocks.keys()]
    assert statistics.median(pauses) > pause / 2
