"""What is refused: as an exception of a kind of its own, with the words of the command line."""

from collections.abc import Callable
from pathlib import Path

import friction_stage as fs
import numpy as np
import pytest
from conftest import LAUNCH_CONFIG, CommandLine, HiddenEffect


def test_every_exception_is_one_of_this_package_and_of_values() -> None:
    kinds = [kind for name, kind in vars(fs).items() if name.endswith("Error")]
    assert len(kinds) == 10
    assert all(issubclass(kind, fs.FrictionStageError) for kind in kinds)
    assert all(issubclass(kind, ValueError) for kind in kinds if kind is not fs.FrictionStageError)


@pytest.mark.parametrize(
    "text",
    ["mass: -1\n", "mas: 40\n", "guides: [guide_9]\n", "effects: [{coging: {}}]\n", ""],
)
def test_a_bad_model_is_refused_in_the_words_of_the_command_line(
    text: str, command_line: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "stage.yaml"
    path.write_text(text)
    with pytest.raises(fs.ModelError) as refused:
        fs.Model.from_yaml(path)
    arguments = ("experiment", "fine-step", "--model", path, "--rest", 0.1, "--no-bags")
    assert str(refused.value) == command_line.error(*arguments, "--out", tmp_path / "out")


def test_bad_recordings_are_refused_in_the_words_of_the_command_line(
    command_line: CommandLine, tmp_path: Path, hidden_cogging: HiddenEffect
) -> None:
    good, other = tmp_path / "good.csv", tmp_path / "other.csv"
    hidden_cogging.train.to_csv(good)
    hidden_cogging.holdout.to_csv(other)
    still = tmp_path / "still.csv"
    rows = np.column_stack([0.001 * np.arange(4000), np.zeros(4000), np.ones(4000)])
    np.savetxt(still, rows, delimiter=",", header="time,position,force", comments="")
    missing = tmp_path / "missing.csv"
    declared = hidden_cogging.declared
    for train, holdout, kind in [
        (missing, other, fs.RecordingError),
        (good, good, fs.IdentificationError),
        (still, other, fs.IdentificationError),
    ]:
        with pytest.raises(kind) as refused:
            fs.identify(declared, train, holdout)
        out = ("--out", tmp_path / "out")
        words = command_line.error(
            *("identify", "--model", "guide_2", "--train", train, "--holdout", holdout), *out
        )
        assert str(refused.value) == words


BAD: list[tuple[type[Exception], str, Callable[[fs.Model, fs.Trace], object]]] = [
    (fs.ModelError, "did you mean `guide_1`", lambda m, t: fs.Model.guide("guid_1")),
    (fs.ModelError, "cannot read the model file a.yaml", lambda m, t: fs.Model.from_yaml("a.yaml")),
    (fs.MotionError, "duration is -1", lambda m, t: fs.Motion.of_moves([(0.1, -1.0, 0.0)])),
    (fs.MotionError, "distance is NaN", lambda m, t: fs.Motion.of_moves([(np.nan, 1.0, 0.0)])),
    (fs.MotionError, "no points", lambda m, t: fs.Motion(np.zeros(0), np.zeros(0))),
    (fs.MotionError, "3 values of position", lambda m, t: fs.Motion(np.zeros(2), np.zeros(3))),
    (fs.MotionError, "is no motion", lambda m, t: fs.Motion.from_yaml("points: []")),
    (
        fs.MotionError,
        "must be 1 to",
        lambda m, t: fs.simulate(m, fs.Motion.fast_move(0.1), duration=-1.0),
    ),
    (fs.ControllerError, "lowpass.frequency", lambda m, t: fs.Controller(m, rate=100.0)),
    (fs.ControllerError, "gains.stage.p is -1", lambda m, t: fs.Controller(m, p=-1.0)),
    (fs.ControllerError, "back_calculation", lambda m, t: fs.Controller(m, anti_windup="no")),
    (fs.ControllerError, "control_rate", lambda m, t: fs.Stage(m, rate=0.0)),
    (fs.RecordingError, "nowhere", lambda m, t: fs.read_bag("nowhere")),
    (
        fs.RecordingError,
        "did you mean `position`",
        lambda m, t: fs.read_bag("x.csv", mapping="signals: {positon: {column: x}}"),
    ),
    (
        fs.RecordingError,
        "train has no column 'time'; it has position",
        lambda m, t: fs.identify(m, {"position": np.zeros(5)}, t),
    ),
    (
        fs.RecordingError,
        "train[1]: 4 values of force for 5 of time",
        lambda m, t: fs.identify(
            m,
            [t, {"time": np.arange(5.0), "position": np.arange(5.0), "force": np.zeros(4)}],
            t,
        ),
    ),
    (
        fs.RecordingError,
        "is not of numbers",
        lambda m, t: fs.identify(m, {"time": ["a"], "position": [1.0]}, t),
    ),
    (fs.IdentificationError, "the hold-out holdout is in", lambda m, t: fs.identify(m, t, t)),
    (
        fs.IdentificationError,
        "next experiment: ",
        lambda m, t: fs.identify(m, t, half(t), next_experiment=fs.Limits(speed=-1.0)),
    ),
    (fs.FitError, "mass", lambda m, t: fs.fit_guide(t.to_pandas(), t)),
    (fs.FitError, "no guide from stribeck and dahl", lambda m, t: fs.fit_guide(t, t)),
    (fs.SelectionError, "cannot read a.yaml", lambda m, t: fs.select("a.yaml")),
    (
        fs.ModelError,
        "unknown guide `guide_4`",
        lambda m, t: fs.select(LAUNCH_CONFIG / APPLICATION, guides=["guide_4"]),
    ),
    (
        fs.SelectionError,
        "2 variants are too few",
        lambda m, t: fs.select(LAUNCH_CONFIG / APPLICATION, variants=2),
    ),
    (fs.SweepError, "did you mean `model.mass`", lambda m, t: fs.sweep(m, {"model.mas": [1.0]})),
    (fs.SweepError, "from:to:count", lambda m, t: fs.sweep(m, {"model.mass": "1:2"})),
    (fs.SweepError, "--samples", lambda m, t: fs.sweep(m, {"model.mass": "normal(40,1)"})),
    (fs.SweepError, "fine-step", lambda m, t: fs.sweep(m, {"model.mass": [1.0]}, motion="no")),
    (fs.ExperimentError, "there are stribeck, dahl", lambda m, t: fs.experiment("dahls")),
    (fs.ExperimentError, "amplitudes", lambda m, t: fs.experiment("rig", amplitudes=[1e-6])),
    (
        fs.ExperimentError,
        "5 must be between",
        lambda m, t: fs.experiment("dahl", amplitudes=[5.0]),
    ),
]
APPLICATION = "application_fine_step_clean.yaml"


def half(trace: fs.Trace) -> dict[str, object]:
    """Another motion, so that it counts as held out."""
    return {
        name: trace[name] * (0.5 if name == "position" else 1.0)
        for name in ("time", "position", "force", "force_cell")
    }


@pytest.mark.parametrize(("kind", "words", "attempt"), BAD)
def test_bad_input_is_refused_with_what_is_wrong(
    kind: type[Exception],
    words: str,
    attempt: Callable[[fs.Model, fs.Trace], object],
    hidden_cogging: HiddenEffect,
) -> None:
    with pytest.raises(kind) as refused:
        attempt(hidden_cogging.declared, hidden_cogging.train)
    assert words in str(refused.value)


def test_a_missing_column_is_said_with_those_that_are_there() -> None:
    trace = fs.simulate(fs.Model.guide("guide_1"), fs.Motion.of_moves([(1e-4, 0.01, 0.0)]))
    with pytest.raises(AttributeError, match=r"no 'positions'; it has time"):
        trace.positions  # noqa: B018
