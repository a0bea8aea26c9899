"""Metric, driven guides and readers of the comparison, against closed forms."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from blind import TRAIN, draw, trajectory  # noqa: E402
from data import Recording, read_scope, yaml_of  # noqa: E402
from declared import Stage, friction, hysteresis, residual  # noqa: E402
from judge import judge_terms, judge_verdict  # noqa: E402
from metric import Motion, force_error, noise_floor, rms  # noqa: E402

DT = 5e-4
GUIDE = dict(
    stiffness=4e5,
    bristle_damping=900.0,
    viscous_friction=20.0,
    coulomb_force=10.0,
    static_force=14.0,
    stribeck_velocity=0.005,
)


def under_held_force(force: np.ndarray, mass: float) -> Recording:
    """Exact motion of a mass under a force that is held in each interval."""
    acceleration = force / mass
    velocity = np.concatenate([[0.0], np.cumsum(acceleration[:-1]) * DT])
    steps = velocity[:-1] * DT + 0.5 * acceleration[:-1] * DT**2
    return Recording(DT, np.concatenate([[0.0], np.cumsum(steps)]), force)


def test_a_mass_under_a_held_force_leaves_no_residual():
    force = 50 * np.random.default_rng(1).standard_normal(8000)
    motion = Motion(under_held_force(force, 40.0), 200.0, 40.0, 1e-4)
    free = Stage(40.0, [], [])
    error = force_error(motion, residual(motion, free))
    assert error.all_rows < 1e-6
    assert error.force > 10
    # A wrong mass leaves its share of the force.
    heavier = force_error(motion, residual(motion, Stage(40.4, [], [])))
    assert heavier.all_rows == pytest.approx(0.01 * error.force, rel=1e-3)


def test_a_constant_force_that_is_not_in_the_model_is_the_error_on_all_rows():
    force = 50 * np.random.default_rng(1).standard_normal(8000)
    recording = under_held_force(force, 40.0)
    recording.force = recording.force + 3.0
    motion = Motion(recording, 200.0, 40.0, 1e-4)
    stage = Stage(40.0, [], [{"constant_force": {"amplitude": -2.0}}])
    assert force_error(motion, residual(motion, stage)).all_rows == pytest.approx(1.0, abs=1e-6)


def test_moving_rows_are_those_above_the_speed():
    time = DT * np.arange(8000)
    position = np.where(time < 2, 0.01 * time, 0.02)
    motion = Motion(Recording(DT, position, np.zeros(8000)), 200.0, 40.0, 1e-4)
    wrong = np.where(motion.time < 2, 3.0, 4.0)
    error = force_error(motion, wrong)
    assert error.moving_rows == pytest.approx(3.0, abs=1e-2)
    assert 3.4 < error.all_rows < 3.6


def test_noise_floor_is_that_of_the_second_difference_in_the_band():
    motion = Motion(Recording(DT, np.linspace(0, 1, 200_000), np.zeros(200_000)), 200.0, 40.0, 1e-4)
    w = np.linspace(0, np.pi, 200_001)
    # Zero phase: the gain of the Butterworth filter squared.
    gain = 1 / (1 + (np.tan(w / 2) / np.tan(np.pi * 200 * DT)) ** 8)
    power = np.trapezoid((2 - 2 * np.cos(w)) ** 2 * gain**2, w) / np.pi
    assert noise_floor(motion, 40.0, 1e-9, 0.0) == pytest.approx(
        40e-9 / DT**2 * np.sqrt(power), rel=0.02
    )


@pytest.mark.parametrize("speed", [0.002, 0.1, -0.1])
def test_a_guide_at_constant_speed_has_its_stribeck_friction(speed):
    position = speed * DT * np.arange(6000)
    motion = Motion(Recording(DT, position, np.zeros(6000)), 200.0, 40.0, 1e-4)
    steady = 10 + 4 * np.exp(-((speed / 0.005) ** 2)) + 20 * abs(speed)
    found = friction(motion, [GUIDE, GUIDE])[3000:5900]
    assert found == pytest.approx(2 * np.sign(speed) * steady, rel=1e-6)


def test_a_guide_in_presliding_is_a_spring():
    time = DT * np.arange(6000)
    position = 1e-8 * np.sin(2 * np.pi * 2 * time)
    motion = Motion(Recording(DT, position, np.zeros(6000)), 200.0, 40.0, 1e-4)
    spring = 4e5 * 1e-8 * np.sin(2 * np.pi * 2 * motion.time)
    damper = 920 * 1e-8 * 4 * np.pi * np.cos(2 * np.pi * 2 * motion.time)
    inner = slice(1000, 5000)
    assert rms((friction(motion, [GUIDE]) - spring - damper)[inner]) < 0.01 * rms(spring[inner])


def test_numbers_of_yaml_1_2_are_numbers():
    assert yaml_of("stiffness: 4.5e5\nname: a stage\n") == {"stiffness": 4.5e5, "name": "a stage"}


def test_a_scope_file_is_torque_and_integrated_speed(tmp_path):
    file = tmp_path / "scope.csv"
    head = [f"line {i}" for i in range(12)] + [";speed;torque"]
    lines = [f"{40.0 * i};60;50.0" for i in range(10)]
    file.write_text("\n".join([*head, "ms;rpm;%", *lines]))
    found = read_scope(file)
    assert found.dt == pytest.approx(0.04)
    assert found.position == pytest.approx(2 * np.pi * 0.04 * np.arange(10))
    assert found.force == pytest.approx(4.92e-3)


def test_a_seed_always_draws_the_same_stage():
    assert draw(3) == draw(3)
    assert draw(3) != draw(4)


def test_a_trajectory_ends_after_all_moves_and_rests():
    last = trajectory(TRAIN)["points"][-1]["time_from_start"]
    total = 0.5 + sum(duration + rest for _, duration, rest in TRAIN)
    assert last["sec"] + 1e-9 * last["nanosec"] == pytest.approx(total)


def test_terms_count_as_false_unless_a_hidden_law_shows_as_them():
    hidden = [("cogging", {"period": 0.024}), ("quadratic_drag", {"coefficient": 20.0})]
    found = judge_terms({"sin 24.6 mm": 1, "cos 12.3 mm": 1, "x": 1}, hidden)
    assert found == {"hidden": 2, "shown": 1, "false_terms": 2}


def test_a_verdict_is_right_with_all_names_only():
    answer = {"verdict": "found", "effects": ["cogging"]}
    assert judge_verdict(answer, [("cogging", {})])
    assert not judge_verdict(answer, [("cogging", {}), ("quadratic_drag", {})])
    assert not judge_verdict(answer, [])
    assert judge_verdict({"verdict": "unknown", "effects": ["map"]}, [("map", {})])
    assert not judge_verdict(
        {"verdict": "unknown", "effects": ["map"]}, [("map", {}), ("ball_passage", {})]
    )


def test_a_hysteresis_turns_over_its_width():
    there = np.linspace(0.0, 1e-3, 1001)
    path = np.concatenate([there, there[-2::-1]])
    h = hysteresis(path, 1e-4, "dahl")
    assert h[100] == pytest.approx(1 - np.exp(-1))
    assert h[1000] == pytest.approx(1 - np.exp(-10))
    assert h[1100] == pytest.approx(-1 + (1 + h[1000]) * np.exp(-1))
