"""Recordings as every tool of the comparison gets them.

A bag is read with `friction-stage replay --csv`, a table with its columns. Out comes the time, s,
the position that the encoder read, m, and the force that the controller commanded, N, held until
the next sample. Rotary drives use rad and N m in place of m and N.
"""

from __future__ import annotations

import csv
import json
import os
import resource
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

# N m of 100 %, from the scope's description of the screw drive.
RATED_TORQUE = 9.84e-3
ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "launch_config"


def yaml_of(text: str) -> dict:
    """A YAML document; YAML 1.2 has numbers such as 4.5e5, which PyYAML leaves as text."""

    def numbers(value: object) -> object:
        if isinstance(value, dict):
            return {key: numbers(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [numbers(inner) for inner in value]
        if isinstance(value, str):
            try:
                return float(value)
            except ValueError:
                return value
        return value

    return numbers(yaml.safe_load(text))


class ProgramFailed(Exception):
    """A command of friction-stage ended with an error."""


def cpu_seconds() -> float:
    """CPU time of this process and of the processes that it has waited for, s."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


class Clock:
    """CPU seconds by part of the work: load, fit, select."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self.last = cpu_seconds()

    def lap(self, part: str) -> None:
        now = cpu_seconds()
        self.parts[part] = self.parts.get(part, 0.0) + now - self.last
        self.last = now


def run(program: Path, *arguments: object) -> dict:
    """A command with --json; exit code 3 is done with warnings."""
    command = [str(program), *map(str, arguments), "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in (0, 3):
        raise ProgramFailed(f"{' '.join(command)}: {done.stderr.strip()}")
    return json.loads(done.stdout)


@dataclass
class Recording:
    """One recording on a uniform grid of time."""

    dt: float
    position: np.ndarray
    force: np.ndarray


@dataclass
class Case:
    """What a tool gets: files, a declared model, tolerances; and what only the judge gets."""

    name: str
    model: Path
    train: Path
    holdout: Path
    # Band of the force residual, Hz.
    cutoff: float = 200.0
    mapping: Path | None = None
    # How far mass and guides may be from what is declared, as shares.
    mass_tolerance: float = 0.005
    guide_tolerance: float = 0.16
    # A ripple of these periods, m, that a person offers to a tool; else it has to be found.
    offered_periods: list[float] = field(default_factory=list)
    # Spring and ripple that a person offers to a simulator.
    offered_spring: bool = False
    # Laws that are hidden in the recording; None where that is not stated.
    hidden: list[str] | None = None

    def declared(self) -> dict:
        return yaml_of(self.model.read_text())


def on_grid(time: np.ndarray, *columns: np.ndarray) -> tuple[float, list[np.ndarray]]:
    """Sampling interval and the columns at uniform instants; instants up to 20 ms off the grid are
    taken as on it."""
    dt = float(np.median(np.diff(time)))
    off = np.abs(time - time[0] - dt * np.arange(len(time))).max()
    if off > 0.02:
        raise ValueError(f"the instants are up to {off} s off a grid of {dt} s")
    return dt, [np.asarray(column, float) for column in columns]


def read_bag(program: Path, bag: Path, model: Path, scratch: Path) -> Recording:
    run(program, "replay", bag, "--model", model, "--csv", scratch, "--force")
    table = np.genfromtxt(scratch, delimiter=",", names=True)
    dt, (position, force) = on_grid(table["time"], table["recorded_position"], table["force"])
    return Recording(dt, position, force)


def read_table(file: Path, mapping: Path) -> Recording:
    signals = yaml_of(mapping.read_text())["signals"]
    table = np.genfromtxt(file, delimiter=",", names=True)

    def signal(name: str) -> np.ndarray:
        said = signals[name]
        return table[said["column"]] * said.get("scale", 1.0)

    dt, (position, force) = on_grid(signal("time"), signal("position"), signal("force"))
    return Recording(dt, position, force)


def read_scope(file: Path) -> Recording:
    """Export of the screw drive's scope: no position, so the velocity is integrated."""
    with open(file, newline="", encoding="latin-1") as text:
        rows = list(csv.reader(text, delimiter=";"))[14:]
    time, speed, torque = np.array([[float(cell) for cell in row[:3]] for row in rows if row]).T
    speed *= 2 * np.pi / 60
    dt = 1e-3 * float(np.median(np.diff(time)))
    middle = 0.5 * (speed[1:] + speed[:-1])
    position = np.concatenate([[0.0], np.cumsum(middle) * dt])
    return Recording(dt, position, torque * RATED_TORQUE / 100)


def read(program: Path, case: Case, which: str, scratch: Path) -> Recording:
    file = getattr(case, which)
    scratch.mkdir(parents=True, exist_ok=True)
    if file.is_dir():
        return read_bag(program, file, case.model, scratch / f"{case.name}_{which}.csv")
    if "screw" in case.name:
        return read_scope(file)
    return read_table(file, case.mapping)


def recordings_directory(given: Path | None) -> Path | None:
    from_environment = os.environ.get("FRICTION_STAGE_RECORDINGS")
    return given or (Path(from_environment) if from_environment else None)


def measured_cases(directory: Path | None, missing: list[str]) -> list[Case]:
    """The cases whose files are there; the names of the others are added to `missing`."""
    cases = []
    # What a person may offer by hand after a look at the answer of friction-stage.
    offered = {"a": [0.024, 0.012], "e": [8.7e-3]}
    for name in "abcdef":
        cases.append(
            Case(
                name=name,
                model=LAUNCH / "stage_measured_runs.yaml",
                train=(directory or Path("missing")) / name / "train",
                holdout=(directory or Path("missing")) / name / "check",
                offered_periods=offered.get(name, []),
                offered_spring=name == "c",
                hidden=[] if name == "b" else None,
            )
        )
    cases.append(
        Case(
            name="emps",
            model=LAUNCH / "emps.yaml",
            mapping=LAUNCH / "emps_mapping.yaml",
            train=(directory or Path("missing")) / "emps" / "train.csv",
            holdout=(directory or Path("missing")) / "emps" / "check.csv",
            cutoff=100.0,
            mass_tolerance=0.2,
            guide_tolerance=4.0,
            offered_periods=[2.5e-3],
        )
    )
    screw = (directory or Path("missing")) / "screw_drive" / "start_stop"
    cases.append(
        Case(
            name="screw",
            model=Path(__file__).parent / "screw_drive.yaml",
            train=screw / "200.csv",
            holdout=screw / "50.csv",
            mapping=Path(__file__).parent / "screw_drive_mapping.yaml",
            cutoff=5.0,
            mass_tolerance=0.9,
            guide_tolerance=0.9,
        )
    )
    there = [case for case in cases if case.train.exists() and case.holdout.exists()]
    missing.extend(case.name for case in cases if case not in there)
    return there
