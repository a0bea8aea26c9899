"""``simulate`` and ``Stage``."""

import pickle
import threading

import numpy as np
import pytest
from friction_stage import Controller, Model, Motion, Stage, simulate


def test_a_free_mass_under_constant_force_moves_as_newton_says() -> None:
    model = Model.from_dict({"mass": 40.0, "guides": [_frictionless()]}).without_noise()
    stage = Stage(model, rate=1000.0)
    while stage.sample.time < 0.5:
        stage.step(80.0)
    # 2 m/s² over half a second.
    assert stage.sample.position == pytest.approx(0.25, rel=1e-4)
    assert stage.true_velocity == pytest.approx(1.0, rel=1e-4)


def _frictionless() -> dict[str, float]:
    return {
        "stiffness": 1e-3,
        "bristle_damping": 0.0,
        "viscous_friction": 0.0,
        "coulomb_force": 1e-6,
        "static_force": 1e-6,
        "stribeck_velocity": 1e-3,
    }


def test_a_loop_of_ones_own_with_the_same_forces_reads_the_same_bits() -> None:
    model = Model.guide("guide_3")
    trace = simulate(model, Motion.of_moves([(1e-3, 0.05, 0.1)]), seed=7)
    stage = Stage(model, seed=7)
    positions, cells = [], []
    for force in trace.force:
        positions.append(stage.sample.position)
        cells.append(stage.sample.force_cell)
        stage.step(force)
    assert np.array_equal(positions, trace.position)
    assert np.array_equal(cells, trace.force_cell)


def test_the_seed_decides_the_noise_and_without_noise_there_is_none() -> None:
    model, motion = Model.guide("guide_1"), Motion.of_moves([(1e-4, 0.02, 0.02)])
    first, again, other = (simulate(model, motion, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.position, again.position)
    assert not np.array_equal(first.force_cell, other.force_cell)
    quiet = [simulate(model, motion, noise=False, seed=seed) for seed in (1, 2)]
    assert np.array_equal(quiet[0].position, quiet[1].position)
    # The lead-in at rest: nothing moves.
    assert np.all(quiet[0].position[:100] == 0.0)


def test_controller_settings_change_the_loop() -> None:
    model, motion = Model.guide("guide_2"), Motion.fast_move(rest=0.2)
    # Four guides with 18 N s/m each.
    viscous = 4 * 18.0
    plain = simulate(model, motion)
    fed = simulate(model, motion, controller=Controller(model, viscous_feedforward=viscous))
    slow = simulate(model, motion, controller=Controller(model, bandwidth=30.0))
    assert plain.moves[1].name == "fast_forward"
    assert fed.moves[1].peak_error < plain.moves[1].peak_error < slow.moves[1].peak_error
    at_2_khz = simulate(model, motion, controller=Controller(model, rate=2000.0))
    assert (at_2_khz.rate, at_2_khz.rows) == (2000.0, plain.rows // 2)


def test_terms_add_up_to_the_force_and_moves_are_those_of_the_error() -> None:
    trace = simulate(Model.guide("guide_1"), Motion.fine_step(rest=0.3, steps=2))
    total = trace.feedback + trace.mass_feedforward + trace.viscous_feedforward
    assert np.allclose(total, trace.force, rtol=0, atol=1e-9)
    assert np.array_equal(trace.error, trace.reference_position - trace.position)
    step = trace.moves[-1]
    inside = trace.time >= step.start
    assert step.name == "fine_step"
    assert step.peak_error == np.abs(trace.error[inside]).max()


def test_columns_own_their_numbers_and_pandas_takes_them() -> None:
    trace = simulate(Model.guide("guide_1"), Motion.of_moves([(1e-4, 0.02, 0.02)]))
    assert trace.position.flags.c_contiguous and trace.position.flags.writeable
    # A view of the vector of Rust: numpy does not own it, and nothing was copied.
    assert trace.position.base is not None
    frame, other = trace.to_pandas(), trace.to_polars()
    assert list(frame.columns) == list(trace) == other.columns
    assert np.array_equal(frame["error"], trace.error)
    assert np.array_equal(other["error"].to_numpy(), trace.error)
    axes = trace.plot()
    assert "µm" in axes.get_ylabel() and len(axes.lines[0].get_xdata()) == trace.rows


def test_the_interpreter_goes_on_while_a_simulation_runs() -> None:
    counted, stop = [0], threading.Event()

    def count() -> None:
        while not stop.is_set():
            counted[0] += 1

    counter = threading.Thread(target=count)
    counter.start()
    try:
        before = counted[0]
        simulate(Model.guide("guide_1"), Motion.of_moves([(1e-3, 0.1, 30.0)]))
        during = counted[0] - before
    finally:
        stop.set()
        counter.join()
    # With the lock held it would be 0.
    assert during > 1000


def test_progress_goes_from_0_towards_1_and_its_exceptions_end_the_work() -> None:
    model, motion = Model.guide("guide_1"), Motion.of_moves([(1e-3, 0.1, 5.0)])
    shares: list[float] = []
    simulate(model, motion, progress=lambda what, share: shares.append(share))
    assert shares[0] == 0.0 and 0.9 < shares[-1] < 1.0 and shares == sorted(shares)

    def refuse(what: str, share: float) -> None:
        raise RuntimeError(f"no more of {what}")

    with pytest.raises(RuntimeError, match="no more of simulating"):
        simulate(model, motion, progress=refuse)


def test_models_are_values() -> None:
    model = Model.guide("guide_2")
    assert Model.from_yaml(model.to_yaml()) == model == pickle.loads(pickle.dumps(model))
    assert Model.from_dict(model.to_dict()) == model
    heavier = Model.from_dict(model.to_dict() | {"mass": 50.0})
    assert (heavier.mass, heavier != model) == (50.0, True)


def test_a_motion_of_points_is_linear_cubic_or_quintic() -> None:
    model = Model.guide("guide_1")
    time, position = np.array([0.1, 0.2]), np.array([0.0, 1e-3])
    linear = simulate(model, Motion(time, position))
    middle = np.searchsorted(linear.time, 0.125)
    assert linear["reference_position"][middle] == pytest.approx(0.25e-3)
    rest = np.zeros(2)
    quintic = simulate(model, Motion(time, position, rest, rest))
    # 10 u^3 - 15 u^4 + 6 u^5 at a quarter.
    assert quintic["reference_position"][middle] == pytest.approx(1e-3 * 0.103515625)


def test_a_motion_file_is_read_and_written() -> None:
    motion = Motion.fine_step(rest=0.1, steps=1)
    again = Motion.from_yaml(motion.to_yaml())
    assert (len(again), again.duration) == (len(motion), motion.duration)
    assert motion.stretched(2.0).duration == pytest.approx(2 * motion.duration)
