"""ros2_control's topic hardware moves the stage: free-running on wall time, and in lockstep on simulated time."""

import math

import pytest
from ros import nanoseconds
from topic_hardware import BLIND_CYCLES, TopicHardware

TARGET, DURATION = 0.02, 0.5
SETTLED = DURATION + 0.5


def arrive(ros, hardware, encoder) -> None:
    # The cycles before its first state sent NaN, which moved nothing.
    ros.until(lambda: hardware.start, "a state")
    assert hardware.silent_cycles >= BLIND_CYCLES
    assert hardware.start[1] == pytest.approx(0.0, abs=100e-9)

    def there() -> bool:
        return all(abs(sample.position[0] - TARGET) < 1e-3 for sample in encoder[-50:])

    ros.until(lambda: hardware.elapsed > SETTLED and there(), f"rest at {TARGET} m", timeout=60.0)
    for sample in encoder:
        for field in (sample.position, sample.velocity, sample.effort):
            assert len(field) == 1 and math.isfinite(field[0])


def test_it_closes_the_loop_on_wall_time(ros, stage):
    stage(mode="realtime", control_rate=500.0)
    encoder = ros.collect("/stage/encoder")
    with TopicHardware(
        500.0, TARGET, DURATION, use_sim_time=False, context=ros.context
    ) as hardware:
        arrive(ros, hardware, encoder)


def test_it_closes_the_loop_in_lockstep_on_simulated_time(ros, stage):
    rate = 500.0
    stage(mode="lockstep", control_rate=rate)
    encoder, states = ros.collect("/stage/encoder"), ros.collect("/stage/state")
    with TopicHardware(rate, TARGET, DURATION, use_sim_time=True, context=ros.context) as hardware:
        arrive(ros, hardware, encoder)
        assert hardware.largest_error < 2e-3, f"largest error {hardware.largest_error} m"
        moving = [sample for sample in encoder if sample.position[0] > 1e-4]
        stamps = sorted({nanoseconds(sample.header.stamp) for sample in moving})
        assert all(b - a == 2_000_000 for a, b in zip(stamps, stamps[1:])), "samples were skipped"
        # Every sample was answered, or time would have stood still: as many cycles as samples since the start.
        assert hardware.cycles - hardware.silent_cycles == pytest.approx(
            hardware.elapsed * rate, abs=3
        )
        assert states[-1].motor_force != 0.0
