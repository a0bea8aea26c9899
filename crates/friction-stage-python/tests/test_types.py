"""The package says its types: strictly, and as they are at run time."""

import os
import subprocess
import sys
from pathlib import Path

import friction_stage
import pytest
from friction_stage import fleet

pytestmark = pytest.mark.timeout(300)

HERE = Path(__file__).parent


def run(*arguments: str, directory: Path) -> None:
    # Not the sources beside the tests but the wheel.
    environment = {key: value for key, value in os.environ.items() if key != "MYPYPATH"}
    done = subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=directory,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_file_that_uses_everything_is_strictly_typed(tmp_path: Path) -> None:
    used = (HERE / "uses_everything.py").read_text()
    missing = [name for name in friction_stage.__all__ if f"fs.{name}" not in used]
    missing += [name for name in fleet.__all__ if f"fleet.{name}" not in used]
    assert missing == []
    cache = f"--cache-dir={tmp_path / 'cache'}"
    run("mypy", "--strict", cache, str(HERE / "uses_everything.py"), directory=tmp_path)


def test_the_package_itself_is_strictly_typed(tmp_path: Path) -> None:
    run(
        "mypy",
        "--strict",
        f"--cache-dir={tmp_path / 'cache'}",
        "-p",
        "friction_stage",
        directory=tmp_path,
    )


def test_the_stubs_are_those_of_the_module(tmp_path: Path) -> None:
    run("mypy.stubtest", "friction_stage._native", directory=tmp_path)
