"""`/clock` drives nodes on simulated time, and never goes back."""

import pytest
import rclpy
from rclpy.parameter import Parameter
from ros import nanoseconds
from std_srvs.srv import Trigger

PERIOD = 50_000_000


@pytest.fixture
def simulated(ros):
    node = rclpy.create_node(
        "simulated",
        context=ros.context,
        parameter_overrides=[Parameter("use_sim_time", value=True)],
    )
    return ros.add(node)


@pytest.mark.parametrize(
    "parameters", [{"mode": "lockstep"}, {"mode": "realtime", "publish_clock": True}]
)
def test_a_node_on_simulated_time_follows_the_clock(ros, stage, simulated, parameters):
    fired: list[int] = []
    simulated.create_timer(
        PERIOD * 1e-9, lambda: fired.append(simulated.get_clock().now().nanoseconds)
    )
    stage(control_rate=1000.0, **parameters)
    clock = ros.collect("/clock")
    ros.until(lambda: len(fired) > 20, "20 ticks of a timer on simulated time")
    seen = [nanoseconds(message.clock) for message in clock]
    assert seen == sorted(seen)

    # What the node believes is what was published, and its timer keeps that time. A busy machine
    # may need a moment.
    def believed():
        return simulated.get_clock().now().nanoseconds

    ros.until(
        lambda: abs(believed() - nanoseconds(clock[-1].clock)) <= 100_000_000,
        "agreement of node and clock",
    )
    # The first tick comes when the clock jumps from 0 to where it is.
    mean = (fired[-1] - fired[1]) / (len(fired) - 2)
    assert mean == pytest.approx(PERIOD, rel=0.05)


def test_the_clock_does_not_go_back_on_reset(ros, stage, simulated):
    stage(mode="lockstep", control_rate=1000.0)
    clock = ros.collect("/clock")
    ros.until(lambda: len(clock) > 500, "half a second of simulated time")
    before = nanoseconds(clock[-1].clock)
    assert ros.call(Trigger, "/stage/reset").success
    count = len(clock)
    ros.until(lambda: len(clock) > count + 100, "the clock after the reset")
    seen = [nanoseconds(message.clock) for message in clock]
    assert all(a < b for a, b in zip(seen, seen[1:])) and seen[-1] > before
    assert simulated.get_clock().now().nanoseconds >= before


def test_the_clock_comes_after_the_sample_of_its_time(ros, stage):
    stage(mode="lockstep", control_rate=1000.0)
    encoder, clock = ros.collect("/stage/encoder"), ros.collect("/clock")
    ros.until(lambda: len(clock) > 200 and len(encoder) > 200, "200 samples")
    stamps = {nanoseconds(sample.header.stamp) for sample in encoder}
    common = [
        nanoseconds(m.clock) for m in clock if min(stamps) <= nanoseconds(m.clock) <= max(stamps)
    ]
    assert len(common) > 100 and set(common) <= stamps
