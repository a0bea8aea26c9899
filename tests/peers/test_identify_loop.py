"""The controller measures its loop on a running stage: what it finds is the loop of the stage's
model, and where the stage is not as it should be it refuses, or stops measuring and holds on."""

import cmath
import json
import math
import re
import subprocess
from pathlib import Path

import pytest
from conftest import BINARIES
from ros import nanoseconds, rest
from std_srvs.srv import SetBool, Trigger

RATE = 4000.0
STAGE = {"mode": "lockstep", "control_rate": RATE, "model": "guide_2", "seed": 7}
MEASURED = {
    "identify_loop__enabled": True,
    "identify_loop__lowest": 20.0,
    "identify_loop__highest": 380.0,
    "identify_loop__points": 9,
}
SERVICE = "/controller/identify_loop"


def controller_response(controller: dict, frequency: float) -> complex:
    """Force over error of the PID (backward Euler) and the bilinear lowpass, sampled."""
    rate = controller["rate"]
    z = cmath.exp(2j * math.pi * frequency / rate)
    change = 1 - 1 / z
    pid = controller["p"] + controller["i"] / rate / change + controller["d"] * rate * change
    # s of the bilinear transform, in cutoffs.
    s = (z - 1) / (z + 1) / math.tan(math.pi * controller["lowpass_frequency"] / rate)
    return pid / (s * s + 2 * controller["lowpass_damping"] * s + 1)


def measured_file(message: str) -> Path:
    found = re.search(r"; (\S+\.json)$", message)
    assert found, message
    return Path(found[1])


def test_the_measured_loop_is_that_of_the_model(ros, stage, controller, tmp_path):
    stage(**STAGE)
    controller(**MEASURED, identify_loop__directory=str(tmp_path))
    client = ros.node.create_client(Trigger, SERVICE)
    ros.until(client.service_is_ready, "the service")
    answer = client.call_async(Trigger.Request())
    ros.until(answer.done, "the answer", timeout=240.0)
    assert answer.result().success, answer.result().message
    message = answer.result().message
    assert "crossover" in message and "9 of 9 frequencies" in message, message

    file = measured_file(message)
    loop = json.loads(file.read_text())
    assert loop["controller"]["rate"] == RATE and loop["force"] == 20.0
    for point in loop["points"]:
        assert point["coherence"] > 0.99, point
        open_loop, plant = complex(*point["open_loop"]), complex(*point["stage"])
        ratio = open_loop / plant / controller_response(loop["controller"], point["frequency"])
        assert abs(ratio - 1) < 2e-3, f"{point}: L / P is not the controller, {ratio}"

    run = subprocess.run(
        [BINARIES / "friction-stage", "tune", "guide_2", "--measured", file]
        + ["--variants", "1", "--out", tmp_path / "tuning", "--json"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode in (0, 3), run.stderr
    measured = json.loads(run.stdout)["measured"]
    largest = measured["largest_difference"]
    print(largest, measured["margins"])
    assert largest["points"] >= 6, measured
    assert largest["magnitude"] < 0.02 and largest["phase_degrees"] < 2.0, measured
    # The worst of frequencies between those that were measured is a little worse.
    assert measured["margins"]["modulus_margin"] == pytest.approx(
        measured["model_margins"]["modulus_margin"], abs=0.02
    )
    assert "Measured loop" in (tmp_path / "tuning" / "report.html").read_text()


def test_it_refuses_where_the_stage_may_not_be_moved(ros, stage, controller):
    stage(**STAGE)
    controller()
    refused = ros.call(Trigger, SERVICE)
    assert not refused.success and "identify_loop.enabled is false" in refused.message


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"identify_loop__force": 500.0}, "identify_loop.force is 500 N, must be at most 400 N"),
        ({"identify_loop__highest": 1700.0}, "the second at most 1600 Hz"),
        ({"identify_loop__lowest": 390.0}, "the first must be below the second"),
        ({"identify_loop__duration": 1.0}, "identify_loop.duration allows 1 s"),
        ({"enabled": False}, "the controller is not enabled"),
        ({"identify_loop__error": 1e-8}, "beyond identify_loop.error"),
        (
            {"identify_loop__force": 200.0, "supervision__error": 1e-6},
            "the supervision stopped the stage",
        ),
        ({"identify_loop__directory": "/nowhere/at/all"}, "which is no directory"),
    ],
)
def test_what_cannot_be_measured_is_refused_with_the_reason(
    ros, start, stage, tmp_path, given, expected
):
    stage(**STAGE)
    quick = {
        "identify_loop__points": 3,
        "identify_loop__lowest": 100.0,
        "identify_loop__directory": str(tmp_path),
    }
    start("controller_node", **{**MEASURED, **quick, **given})
    state = ros.collect("/controller/state")
    ros.until(lambda: state, "the state of the controller")
    answer = ros.call(Trigger, SERVICE)
    assert not answer.success and expected in answer.message, answer.message


def test_a_motion_or_a_controller_that_is_disabled_ends_it_and_the_stage_is_held(
    ros, stage, controller, tmp_path
):
    stage(**STAGE)
    long = {**MEASURED, "identify_loop__points": 80}
    controller(**long, identify_loop__directory=str(tmp_path))
    # Only the last: those before are not of now.
    states = ros.collect("/controller/state", depth=10)
    client = ros.node.create_client(Trigger, SERVICE)
    ros.until(client.service_is_ready, "the service")

    def begun():
        """A request, when its sines are seen: they are part of the effort."""
        answer = client.call_async(Trigger.Request())
        del states[:]
        ros.until(
            lambda: answer.done() or any(abs(state.effort) > 1.0 for state in states), "a sine"
        )
        assert not answer.done(), answer.result().message
        return answer

    answer = begun()
    start = ros.follow([rest(0.0, 0.0), rest(20.0, 0.01)])
    ended = ros.result(answer, "the answer")
    assert not ended.success and "a motion began" in ended.message, ended.message
    refused = ros.result(client.call_async(Trigger.Request()), "the refusal")
    assert not refused.success and "a motion is followed" in refused.message, refused.message
    # It comes to where it was to go, without a sine.
    after = start + 20_500_000_000
    ros.until(
        lambda: states and nanoseconds(states[-1].header.stamp) > after, "the end", timeout=120.0
    )
    assert abs(states[-1].position - 0.01) < 1e-6 and states[-1].effort == 0.0

    answer = begun()
    ros.call(SetBool, "/controller/enable", data=False)
    ended = ros.result(answer, "the answer")
    assert not ended.success and "disabled" in ended.message, ended.message
    assert ros.call(SetBool, "/controller/enable", data=True).success
    stopped = nanoseconds(states[-1].header.stamp)
    held = stopped + 500_000_000
    ros.until(lambda: nanoseconds(states[-1].header.stamp) > held, "the loop again")
    assert states[-1].effort == 0.0 and states[-1].enabled and abs(states[-1].error) < 1e-6
