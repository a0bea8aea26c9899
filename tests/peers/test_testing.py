"""What users test their controllers with (testing/): the fixture, its steps, moves and bags."""

import os
import subprocess
import sys
from pathlib import Path

import bags
import pytest
from ros import nanoseconds

ROOT = Path(__file__).parents[2]


def free_fall(stage, force: float, steps: int) -> list[float]:
    return [stage.step(force).position[0] for _ in range(steps)]


def test_steps_are_samples_and_the_same_forces_give_the_same_motion(friction_stage):
    stage = friction_stage(model="guide_2", control_rate=1000.0)
    assert stage.time == 1.0
    path = free_fall(stage, 200.0, 50)
    # 1 s and as many periods as steps: one sample each.
    assert stage.time == pytest.approx(1.05, abs=1e-9)
    assert path[-1] > 1e-3


def test_it_repeats_bit_for_bit(friction_stage, friction_stage_processes):
    runs = []
    for _ in range(2):
        stage = friction_stage(control_rate=1000.0, seed=7)
        runs.append(free_fall(stage, 150.0, 100))
        friction_stage_processes[-1].stop()
    assert runs[0] == runs[1]


def test_a_move_arrives_and_its_bag_is_complete(friction_stage):
    stage = friction_stage(control_rate=1000.0, bag=True)
    stage.controller(rate=1000.0, bandwidth=30.0)
    samples = stage.move(0.01, seconds=0.3)
    assert abs(samples[-1].position[0] - 0.01) <= 1e-5
    recorded = bags.with_rosbags(stage.bag())["/stage/encoder"]
    stamps = [nanoseconds(message.header.stamp) for message in recorded]
    assert {b - a for a, b in zip(stamps, stamps[1:])} == {10**6}
    assert stamps[0] == 10**9 and len(stamps) > 300
    assert len(stage.run(0.1)) >= 100


def test_a_program_that_ends_fails_the_wait_with_its_log(friction_stage, friction_stage_processes):
    stage = friction_stage(control_rate=1000.0)
    stage.start([sys.executable, "-c", "print('no controller'); raise SystemExit(3)"])
    with pytest.raises(AssertionError, match="exit code 3"):
        stage.run(0.1)
    broken = friction_stage_processes.pop()
    assert "no controller" in broken.log()


def test_the_example_of_ten_lines_passes_and_fails_a_bad_controller(tmp_path):
    """In a pytest of its own, as at a user's."""
    example = ROOT / "examples" / "controller_test" / "test_my_controller.py"
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "testing")}
    for spoil, code in (("", 0), ("0.0 if True else ", 1)):
        text = example.read_text().replace("return self.p", f"return {spoil}self.p")
        copy = tmp_path / f"test_it_{code}.py"
        copy.write_text(text)
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        command += ["-p", "friction_stage_testing", str(copy)]
        ran = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert ran.returncode == code, ran.stdout + ran.stderr
    assert "log of stage_node" in ran.stdout
