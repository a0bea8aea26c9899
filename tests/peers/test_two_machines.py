"""A stage and its controller on two machines, over a link that delays and loses packets."""

import json
import subprocess
import sys
from pathlib import Path

import bags
import pytest
from conftest import BINARIES
from test_crashes import friction_stage
from test_strangers import into_a_network

HERE = Path(__file__).parent
# One way, s, and the share of packets that is lost.
POOR, PERFECT = (0.002, 0.01), (0.0, 0.0)

pytestmark = pytest.mark.skipif(
    not (into_a_network() and Path("/dev/net/tun").exists()),
    reason="needs two machines and a poor link: the test makes them with network namespaces and "
    "TAP devices, which needs the package iproute2, /dev/net/tun, and root or a kernel that "
    "lets users make namespaces (README, second command)",
)


def moved(
    directory: Path, mode: str, rate: float, link: tuple[float, float], reliability: str
) -> dict:
    directory.mkdir()
    script = [sys.executable, str(HERE / "two_machines.py"), str(BINARIES), str(directory)]
    command = [*into_a_network(), *script, mode, str(rate), *map(str, link), reliability]
    run = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert run.returncode == 0, f"{run.stdout}\n{run.stderr}"
    return json.loads(run.stdout)


def loop(bag: Path) -> dict[int, tuple[float, float]]:
    """Position and force by stamp, ns."""
    messages = bags.with_rosbags(bag)
    forces = bags.by_stamp(messages["/stage/force"])
    return {
        stamp: (message.position[0], forces[stamp].wrench.force.x)
        for stamp, message in bags.by_stamp(messages["/stage/encoder"]).items()
        if stamp in forces
    }


def test_lockstep_over_a_poor_link_is_that_over_a_perfect_one(tmp_path):
    poor = moved(tmp_path / "poor", "lockstep", 500.0, POOR, "reliable")
    perfect = moved(tmp_path / "perfect", "lockstep", 500.0, PERFECT, "reliable")
    assert poor["missing_answers"] == 0 and poor["largest_error"] < 1e-3, poor
    # Until one of them moves: the same loop on the noise of the encoder, bit for bit.
    loops = [loop(tmp_path / name / "bag") for name in ("poor", "perfect")]
    start = min(poor["start"], perfect["start"])
    common = {stamp for stamp in loops[0].keys() & loops[1].keys() if stamp < start}
    assert len(common) > 500
    assert all(loops[0][stamp] == loops[1][stamp] for stamp in common)
    assert friction_stage("check", tmp_path / "poor" / "bag", code=0)["complete"]
    replayed = friction_stage("replay", tmp_path / "poor" / "bag", code=0)
    assert replayed["identical"] == replayed["samples"] > 1000, replayed


@pytest.mark.parametrize("reliability", ["reliable", "best_effort"])
def test_in_real_time_over_a_poor_link_the_stage_goes_on_or_is_safe(tmp_path, reliability):
    report = moved(tmp_path / "poor", "realtime", 1000.0, POOR, reliability)
    safe = "commands have stopped: motor force is zero"
    # The supervision ends a loop that does not hold.
    arrived = abs(report["last_position"] - 0.01) < 1e-3
    assert arrived or safe in report["message"], report
    # Commands that come late are gaps in their topic.
    assert friction_stage("check", tmp_path / "poor" / "bag", code=0)["complete"]


def test_machines_that_are_named_find_each_other_without_multicast(tmp_path):
    script = [sys.executable, str(HERE / "static_peers.py"), str(BINARIES), str(tmp_path)]
    run = subprocess.run([*into_a_network(), *script], capture_output=True, text=True, timeout=200)
    assert run.returncode == 0, f"{run.stdout}\n{run.stderr}"
    came = json.loads(run.stdout)
    # Without a name the link joins nothing.
    assert came.pop("nobody") == 0, came
    assert len(came) == 2 and all(count >= 100 for count in came.values()), came
