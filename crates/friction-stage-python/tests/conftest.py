"""The wheel as it is installed, and the command line beside it."""

import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from friction_stage import Controller, Model, Motion, Trace, simulate

ROOT = Path(__file__).parents[3]
"""Of the repository."""

LAUNCH_CONFIG = ROOT / "launch_config"


@dataclass(frozen=True)
class CommandLine:
    """The program ``friction-stage``."""

    program: Path

    def run(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [self.program, *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
        )

    def json(self, *arguments: object) -> Any:
        """What it prints, which may come with warnings."""
        done = self.run(*arguments, "--json")
        assert done.returncode in (0, 3), done.stderr
        return json.loads(done.stdout)

    def error(self, *arguments: object) -> str:
        """The words with which it fails."""
        done = self.run(*arguments)
        assert done.returncode in (1, 2), (done.returncode, done.stdout)
        return done.stderr.splitlines()[-1].removeprefix("error: ")


@pytest.fixture(scope="session")
def command_line() -> CommandLine:
    directory = os.environ.get("FRICTION_STAGE_BIN", str(ROOT / "target" / "release"))
    return CommandLine(Path(directory) / "friction-stage")


@dataclass(frozen=True)
class HiddenEffect:
    """A stage with an effect that its declared model lacks, and two recordings of it."""

    declared: Model
    train: Trace
    holdout: Trace
    amplitude = 6.0
    period = 0.024


@pytest.fixture(scope="session")
def hidden_cogging() -> HiddenEffect:
    declared = Model.guide("guide_2")
    cogging = {
        "amplitude": HiddenEffect.amplitude,
        "period": HiddenEffect.period,
        "phase": 0.3,
    }
    real = Model.from_dict(declared.to_dict() | {"effects": [{"cogging": cogging}]})
    controller = Controller(declared, rate=2000.0)
    there_and_back = [(0.1, 1.0, 0.2), (-0.1, 1.0, 0.2), (0.1, 0.5, 0.2), (-0.1, 0.5, 0.2)]
    train = [(-0.05, 0.6, 0.3), (1e-5, 0.1, 0.2), (-1e-5, 0.1, 0.2), *there_and_back]
    holdout = [(0.04, 0.8, 0.3), (-0.08, 0.7, 0.2), (0.06, 1.2, 0.1), (-0.06, 0.4, 0.2)]
    return HiddenEffect(
        declared,
        simulate(real, Motion.of_moves(train), controller=controller, seed=1),
        simulate(real, Motion.of_moves(holdout), controller=controller, seed=2),
    )
