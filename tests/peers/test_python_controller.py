"""A controller written in Python closes the loop in lockstep, and moves the stage as the Rust
controller does."""

import math
from pathlib import Path

import bags
from python_controller import Gains, Move, PythonController
from rcl_interfaces.srv import GetParameters
from ros import Ros, nanoseconds, rest

RATE = 4000.0
MASS = 40.0
FORCE_LIMIT = 2000.0
STAGE = {"mode": "lockstep", "wait_for_command": True, "noise": False, "control_rate": RATE}
# The fast move of the paper: 50 mm in 100 ms, and what follows until it has settled.
MOVE, DURATION, WATCHED = 0.05, 100_000_000, 250_000_000


def rust_trace(ros: Ros, stage, controller, bag: Path) -> tuple[dict[int, float], Gains]:
    """Encoder positions (m) by time since the start of the move (ns), and the gains in use."""
    process = stage(**STAGE, record=bag)
    other = controller(rate=RATE, bandwidth=60.0, feedforward__mass=MASS)
    names = [
        "gains.stage.p",
        "gains.stage.i",
        "gains.stage.d",
        "lowpass.frequency",
        "lowpass.damping",
    ]
    values = ros.call(GetParameters, "/controller/get_parameters", names=names).values
    gains = Gains(*(value.double_value for value in values))
    state = ros.collect("/controller/state", depth=10)
    start = ros.follow([rest(0.0, 0.0), rest(DURATION * 1e-9, MOVE)])
    ros.until(lambda: nanoseconds(state[-1].header.stamp) >= start + WATCHED, "the end of the move")
    other.stop()
    process.stop()
    recorded = bags.with_rosbags(bag)
    assert not any(message.saturated for message in recorded["/controller/state"])
    positions = {
        nanoseconds(m.header.stamp) - start: m.position[0] for m in recorded["/stage/encoder"]
    }
    return positions, gains


def python_trace(ros: Ros, stage, gains: Gains) -> dict[int, float]:
    process = stage(**STAGE)
    node = ros.add(PythonController(gains, MASS, RATE, FORCE_LIMIT, context=ros.context))
    ros.until(lambda: node.positions, "the first sample")
    start = max(node.positions) + 100_000_000
    node.move = Move(start, DURATION, 0.0, MOVE)
    ros.until(lambda: max(node.positions) >= start + WATCHED, "the end of the move", timeout=60.0)
    process.stop()
    return {stamp - start: position for stamp, position in node.positions.items()}


def test_a_python_controller_lands_within_1_nm_of_the_rust_controller(
    ros, stage, controller, tmp_path
):
    rust, used = rust_trace(ros, stage, controller, tmp_path / "rust")
    gains = Gains.from_bandwidth(60.0, MASS)
    for name, value in vars(gains).items():
        assert math.isclose(getattr(used, name), value, rel_tol=1e-12), (
            f"{name}: {used}, expected {gains}"
        )

    python = python_trace(ros, stage, gains)
    times = range(0, WATCHED, round(1e9 / RATE))
    lost = [time for time in times if time not in rust or time not in python]
    assert not lost, (
        f"{len(lost)} of {len(times)} samples missing, the first {lost[0]} ns after the start"
    )

    difference = [python[time] - rust[time] for time in times]
    rms = math.sqrt(math.fsum(d * d for d in difference) / len(difference))
    print(f"rms {rms:.2e} m, largest {max(map(abs, difference)):.2e} m over {len(times)} samples")
    assert abs(rust[times[-1]] - MOVE) < 10e-6, f"the stage ended at {rust[times[-1]]} m"
    assert rms < 1e-9, f"rms difference {rms} m"
