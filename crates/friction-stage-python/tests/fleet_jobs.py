"""Jobs that the tests of fleets share."""

import hashlib
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

APPLICATION: dict[str, Any] = {
    "name": "a short fine step",
    "motion": {
        "distance": 10e-6,
        "duration": 3e-3,
        "settle": 0.1,
        "conditioning": {"distance": 1e-4, "duration": 0.01, "rest": 0.01},
    },
    "requirement": {"peak_error": 6e-6, "settling_band": 1e-6, "settling_time": 0.05},
    "tolerances": {"stiffness": 0.1, "static_force": 0.1, "coulomb_force": 0.05},
}


def variants_job(directory: Path, out: str = "out", **keys: Any) -> Path:
    """A job file for variants."""
    directory.mkdir(parents=True, exist_ok=True)
    content = {"kind": "variants", "application": APPLICATION, "out": out, "variants": 600}
    path = directory / f"{out}.yaml"
    path.write_text(yaml.safe_dump(content | keys))
    return path


def sweep_job(directory: Path, out: str, **keys: Any) -> Path:
    """A job file for the points of a sweep."""
    axes = {"controller.bandwidth": "40:80:9", "model.mass": "normal(40, 1)"}
    job: dict[str, Any] = {"kind": "sweep", "model": "guide_2", "axes": axes, "out": out}
    path = directory / f"{out}.yaml"
    path.write_text(yaml.safe_dump(job | keys))
    return path


def command(*arguments: object) -> list[str]:
    """The command line of fleets."""
    return [sys.executable, "-m", "friction_stage.fleet", *map(str, arguments)]


def fleet(
    *arguments: object, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Runs it."""
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=False, env=env)


def digests(out: Path) -> dict[str, str]:
    """SHA-256 of every file of a data set."""
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


MACHINES = ("north", "south", "west")
AMPLITUDES = {
    # N, of cogging: steady, rising, and with one recording that does not belong to the others.
    "north": (6.0, 6.02, 5.98, 6.01, 6.0),
    "south": (4.0, 4.4, 4.8, 5.2, 5.6),
    "west": (5.0, 5.02, 9.0, 4.98, 5.0),
}
MOVES = (
    *((-0.05, 0.3, 0.1), (1e-5, 0.05, 0.1), (0.08, 0.3, 0.1), (-0.06, 0.2, 0.1)),
    *((0.07, 0.4, 0.1), (-1e-5, 0.05, 0.1), (-0.05, 0.25, 0.1), (0.03, 0.2, 0.1)),
)
"""Of a recording: m, s, s at rest."""
FIRST_DAY = 1_750_000_000
DAY = 86_400


def write_bags(directory: Path, command_line: Any, recordings: int = 4) -> Path:
    """Short bags of three machines, one a day, each with its cogging; and what they are declared to
    be."""
    from friction_stage import Controller, Model, Motion, simulate

    declared = Model.guide("guide_2")
    controller = Controller(declared, rate=1000.0)
    names = ("position", "force_cell", "force", "reference_position")
    mapping = directory / "columns.yaml"
    directory.mkdir(parents=True)
    lines = ["signals:", "  time: {column: time, unit: s}"]
    lines += [f"  {name}: {{column: {name}}}" for name in names]
    mapping.write_text("\n".join(lines) + "\n")
    (directory / "declared.yaml").write_text(declared.to_yaml())
    for number, machine in enumerate(MACHINES):
        (directory / "bags" / machine).mkdir(parents=True)
        for day in range(recordings):
            cogging = {"amplitude": AMPLITUDES[machine][day], "period": 0.024, "phase": 0.3}
            real = Model.from_dict(declared.to_dict() | {"effects": [{"cogging": cogging}]})
            run = simulate(
                real, Motion.of_moves(MOVES), controller=controller, seed=10 * number + day
            )
            table = directory / f"{machine}_{day}.csv"
            rows = zip(run.time, *(run[name] for name in names), strict=True)
            text = "".join(
                f"{FIRST_DAY + day * DAY + time:.6f},{','.join(repr(float(v)) for v in values)}\n"
                for time, *values in rows
            )
            table.write_text(",".join(("time", *names)) + "\n" + text)
            bag = directory / "bags" / machine / f"day_{day}"
            done = command_line.run("import", table, "--mapping", mapping, "--out", bag)
            assert done.returncode == 0, done.stderr
            table.unlink()
    return directory / "bags"
