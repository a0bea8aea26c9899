"""``identify`` and ``read_bag`` on whatever a recording is given as."""

from pathlib import Path

import numpy as np
import pytest
from conftest import HiddenEffect
from friction_stage import Limits, Model, Motion, Verdict, identify, read_bag, simulate


@pytest.fixture(scope="module")
def verdict(hidden_cogging: HiddenEffect) -> Verdict:
    return identify(
        hidden_cogging.declared,
        hidden_cogging.train,
        hidden_cogging.holdout,
        next_experiment=Limits(stroke=(-0.1, 0.1), duration=10.0),
    )


def test_a_hidden_effect_is_found_with_its_parameters(
    verdict: Verdict, hidden_cogging: HiddenEffect
) -> None:
    assert verdict.verdict == "found"
    (effect,) = verdict.effects
    assert (effect.name, effect.side) == ("cogging", "motor")
    amplitude, period = effect.parameters["amplitude"], effect.parameters["period"]
    assert (amplitude.unit, period.unit) == ("N", "m")
    assert amplitude.ci95 is not None and period.ci95 is not None
    assert amplitude.ci95[0] < hidden_cogging.amplitude < amplitude.ci95[1]
    assert period.ci95[0] < hidden_cogging.period < period.ci95[1]
    assert verdict.explained_share > 0.95
    assert "cogging" in str(verdict) and "cogging" in repr(verdict)


def test_the_identified_model_moves_as_the_real_stage(
    verdict: Verdict, hidden_cogging: HiddenEffect
) -> None:
    assert verdict.model.effects == ["cogging"]
    assert Model.from_yaml(verdict.model.to_yaml()) == verdict.model
    errors = verdict.errors["holdout"]["position_rms"]
    assert errors["after"] < 0.1 * errors["before"]


def test_a_next_experiment_stays_within_its_limits(verdict: Verdict) -> None:
    motion = verdict.next_motion
    assert isinstance(motion, Motion) and 1.0 < motion.duration < 20.0
    trace = simulate(verdict.model, motion)
    assert np.abs(trace.reference_position).max() <= 0.1


def test_data_frames_arrays_and_files_are_one_recording(
    hidden_cogging: HiddenEffect, tmp_path: Path
) -> None:
    train, holdout = hidden_cogging.train, hidden_cogging.holdout
    path = tmp_path / "holdout.csv"
    holdout.to_csv(path)
    columns = ("time", "position", "force_cell", "force", "reference_position")
    forms = [
        (train.to_polars(), path),
        ({name: train[name].tolist() for name in columns}, read_bag(path)),
        ([train.to_pandas()], [holdout.to_polars()]),
    ]
    found = [identify(hidden_cogging.declared, one, other) for one, other in forms]
    assert [verdict.verdict for verdict in found] == ["found"] * 3
    amplitudes = [verdict.effects[0].parameters["amplitude"].value for verdict in found]
    # Without velocity and acceleration of the reference the loop is not simulated alike, the
    # residual of the force is.
    assert amplitudes[0] == amplitudes[1] == amplitudes[2]


def test_a_foreign_recording_is_read_by_a_mapping(
    hidden_cogging: HiddenEffect, tmp_path: Path
) -> None:
    train = hidden_cogging.train
    path = tmp_path / "drive.csv"
    rows = np.column_stack([1e3 * train.time, 1e3 * train.position, train.force / 12.5])
    np.savetxt(path, rows, delimiter=";", header="t_ms;x_mm;current", comments="", fmt="%.12g")
    mapping = (
        "signals:\n  time: {column: t_ms, unit: ms}\n  position: {column: x_mm, unit: mm}\n"
        "  force: {column: current, scale: 12.5}\n"
    )
    found = read_bag(path, mapping=mapping)
    assert (found.rate, found.rows) == (2000.0, train.rows)
    assert np.allclose(found.position, train.position, rtol=0, atol=1e-13)
    assert np.allclose(found.force, train.force, rtol=1e-9, atol=1e-8)
    assert found["valid"].all() and found.quality["segments"] == 1
    (tmp_path / "drive.yaml").write_text(mapping)
    again = read_bag(path, mapping=tmp_path / "drive.yaml")
    assert np.array_equal(again.position, found.position)


def test_progress_names_what_is_tried_and_false_ends_the_search(
    hidden_cogging: HiddenEffect,
) -> None:
    lines: list[tuple[str, float]] = []

    def enough(what: str, share: float) -> bool:
        lines.append((what, share))
        return False

    stopped = identify(
        hidden_cogging.declared, hidden_cogging.train, hidden_cogging.holdout, progress=enough
    )
    assert lines[0] == ("fit of the declared model", 0.0)
    assert "stopped" in " ".join(stopped.warnings)
