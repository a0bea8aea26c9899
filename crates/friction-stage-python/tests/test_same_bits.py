"""For the same input the package and the command line give the same bits."""

import csv
import json
import re
from pathlib import Path

import numpy as np
from conftest import LAUNCH_CONFIG, CommandLine, HiddenEffect
from friction_stage import (
    Model,
    Motion,
    Trace,
    check,
    experiment,
    fit_guide,
    identify,
    read_bag,
    select,
    simulate,
    sweep,
)

SIGNALS = ("position", "force_cell", "force", "reference_position")


def assert_same_bits(found: Trace, expected: Trace) -> None:
    for name in SIGNALS:
        assert np.array_equal(found[name], expected[name]), name


def without_signature(text: str) -> str:
    """A file of the command line without the lines that say who made it."""
    lines = r"<footer>.*</footer>\n|\A# friction-stage .*\n# friction-stage .*\n"
    text, count = re.subn(lines, "", text)
    assert count == 1, text
    return text


def test_simulate_is_the_bag_of_an_experiment(command_line: CommandLine, tmp_path: Path) -> None:
    out = tmp_path / "out"
    fast = ("fast-move", "--guides", "guide_2", "--rest", 0.5)
    printed = command_line.json("experiment", *fast, "--out", out)
    trace = simulate(Model.guide("guide_2"), Motion.fast_move(rest=0.5))
    bag = read_bag(out / "bags" / "guide_2_fast_move")
    assert bag.rows == trace.rows == len(trace.time) > 5000
    assert_same_bits(trace, bag)
    move = printed["results"]["fast_move"][0]["forward"]
    assert trace.moves[1].peak_error == move["peak_error"]
    assert list(trace.moves[1].settling) == move["settling"]


def test_simulate_is_the_bag_of_play_over_ros_in_lockstep(
    command_line: CommandLine, tmp_path: Path
) -> None:
    motion = Motion.of_moves([(2e-3, 0.1, 0.1), (-1e-3, 0.05, 0.1)])
    (tmp_path / "motion.yaml").write_text(motion.to_yaml())
    model = LAUNCH_CONFIG / "stage_with_cogging_and_cable_chain.yaml"
    command_line.json(
        "play",
        tmp_path / "motion.yaml",
        *("--model", model, "--record", tmp_path / "bag", "--seed", 5),
    )
    bag = read_bag(tmp_path / "bag")
    # The bag begins with the first sample that was taken; it goes on after the motion.
    trace = simulate(Model.from_yaml(model), Motion.from_yaml(tmp_path / "motion.yaml"), seed=5)
    for name in ("position", "force_cell", "force"):
        assert np.array_equal(trace[name], bag[name][: trace.rows]), name


def test_experiment_prints_the_same_summary(command_line: CommandLine, tmp_path: Path) -> None:
    arguments = ("dahl", "--guides", "guide_3", "--amplitudes", "1e-6,50e-6", "--seed", 3)
    printed = command_line.json("experiment", *arguments, "--no-bags", "--out", tmp_path / "out")
    found = experiment("dahl", guides=["guide_3"], amplitudes=[50e-6, 1e-6], seed=3)
    assert found.summary == printed
    page = (tmp_path / "out" / "report.html").read_text()
    assert found.report_html == without_signature(page)


def test_sweep_has_the_rows_of_the_command_line(command_line: CommandLine, tmp_path: Path) -> None:
    motion = Motion.of_moves([(2e-5, 0.005, 0.02)])
    (tmp_path / "motion.yaml").write_text(motion.to_yaml())
    printed = command_line.json(
        "sweep",
        *("model.guides.stiffness=lognormal(17e6,0.1)", "controller.bandwidth=40,60"),
        "motion.stretch=1:2:2",
        *("--model", "guide_2", "--motion", tmp_path / "motion.yaml", "--samples", 5),
        *("--seed", 4, "--out", tmp_path / "out"),
    )
    found = sweep(
        Model.guide("guide_2"),
        {
            "model.guides.stiffness": "lognormal(17e6,0.1)",
            "controller.bandwidth": [40, 60],
            "motion.stretch": "1:2:2",
        },
        motion=Motion.from_yaml(tmp_path / "motion.yaml"),
        samples=5,
        seed=4,
    )
    assert found.summary == printed
    with (tmp_path / "out" / "points.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert len(rows) == len(found) == 20
    for name in ("peak_error_m", "rms_error_m", "settling_10000nm_s", "peak_force_n"):
        expected = [float(row[name] or "nan") for row in rows]
        assert np.array_equal(found[name], expected, equal_nan=True), name
    assert [int(row["seed"]) for row in rows] == found["seed"].tolist()


def test_select_prints_the_same_summary(command_line: CommandLine, tmp_path: Path) -> None:
    application = LAUNCH_CONFIG / "application_fine_step_clean.yaml"
    own = LAUNCH_CONFIG / "own_guide_catalogue.yaml"
    printed = command_line.json(
        "select",
        *("--application", application, "--catalogue", own, "--variants", 90, "--seed", 4),
        *("--out", tmp_path / "out"),
    )
    found = select(application, catalogues=[own], variants=90, seed=4)
    assert found.summary == printed
    rows = np.genfromtxt(
        tmp_path / "out" / "variants.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    for name in ("guide", "variant", "seed", "peak_error_m", "static_force"):
        assert np.array_equal(found.variants[name], rows[name]), name


def test_identify_writes_the_same_files(
    command_line: CommandLine, tmp_path: Path, hidden_cogging: HiddenEffect
) -> None:
    train, holdout = tmp_path / "train.csv", tmp_path / "holdout.csv"
    hidden_cogging.train.to_csv(train)
    hidden_cogging.holdout.to_csv(holdout)
    (tmp_path / "declared.yaml").write_text(hidden_cogging.declared.to_yaml())
    printed = command_line.json(
        "identify",
        *("--model", tmp_path / "declared.yaml", "--train", train, "--holdout", holdout),
        *("--out", tmp_path / "command_line"),
    )
    verdict = identify(hidden_cogging.declared, train, holdout)
    verdict.save(tmp_path / "package")
    assert verdict.summary == printed
    for name in ("summary.json", "identified.yaml"):
        ours, theirs = ((tmp_path / by / name).read_text() for by in ("command_line", "package"))
        assert (without_signature(ours) if name == "identified.yaml" else ours) == theirs, name
    figures = [
        sorted(path.name for path in (tmp_path / by / "figures").iterdir())
        for by in ("command_line", "package")
    ]
    assert figures[0] == figures[1] != []
    # From memory it is the same, but for the names in findings.
    memory = identify(
        hidden_cogging.declared, hidden_cogging.train, hidden_cogging.holdout.to_pandas()
    )
    assert memory.summary["effects"] == printed["effects"]
    assert memory.summary["errors"] == printed["errors"]


def test_fit_guide_finds_the_same_parameters(command_line: CommandLine, tmp_path: Path) -> None:
    for arguments in (("stribeck",), ("dahl", "--amplitudes", "420e-6")):
        name = arguments[0]
        command_line.json("experiment", *arguments, "--guides", "guide_2", "--out", tmp_path / name)
    bags = [
        tmp_path / "stribeck" / "bags" / "guide_2_stribeck",
        tmp_path / "dahl" / "bags" / "guide_2_dahl_quick",
    ]
    printed = command_line.json(
        *("fit-guide", "--stribeck", bags[0], "--dahl", bags[1]),
        *("--name", "mine", "--out", tmp_path / "mine.yaml"),
    )
    found = fit_guide(*bags)
    expected = {row["name"]: (row["value"], tuple(row["ci95"])) for row in printed["parameters"]}
    assert {name: (p.value, p.ci95) for name, p in found.parameters.items()} == expected
    assert found.to_catalogue("mine") == without_signature((tmp_path / "mine.yaml").read_text())
    # The same recordings in memory.
    runs = experiment("stribeck", guides=["guide_2"], recordings=True).recordings
    loops = experiment("dahl", guides=["guide_2"], amplitudes=[420e-6], recordings=True).recordings
    memory = fit_guide(runs["guide_2_stribeck"], loops["guide_2_dahl_quick"])
    assert memory.parameters == found.parameters


def test_check_prints_the_same_report(
    command_line: CommandLine, tmp_path: Path, hidden_cogging: HiddenEffect
) -> None:
    hidden_cogging.train.to_csv(tmp_path / "train.csv")
    printed = command_line.json("check", tmp_path / "train.csv", "--model", "guide_2")
    found = check(tmp_path / "train.csv", model=Model.guide("guide_2"))
    assert json.loads(json.dumps(found)) == printed
