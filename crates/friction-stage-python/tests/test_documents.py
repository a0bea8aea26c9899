"""The page of the documentation and the notebooks run as they are written."""

import os
import re
import subprocess
from pathlib import Path

import friction_stage
import nbformat
import pytest
from conftest import ROOT
from nbclient import NotebookClient

PAGE = ROOT / "docs" / "python.md"
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


@pytest.fixture
def beside_the_examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory to write into, with the launch configuration of the repository in it."""
    (tmp_path / "launch_config").symlink_to(ROOT / "launch_config")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_page_runs_as_written(
    beside_the_examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 11
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out
    assert "verdict: found" in printed and "did you mean `guide_" in printed


def test_the_page_of_data_frames_runs_and_prints_what_it_says(
    beside_the_examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / "docs" / "how-to" / "data-frames.md").read_text()
    blocks = re.findall(r"^```(\w+)\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert [kind for kind, _ in blocks] == ["sh", *["python", "text"] * 3]
    names: dict[str, object] = {}
    printed = ""
    for kind, block in blocks:
        if kind == "sh":
            program = Path(os.environ["FRICTION_STAGE_BIN"]) / "friction-stage"
            subprocess.run([program, *block.split()[1:]], check=True, capture_output=True)
        elif kind == "python":
            exec(compile(block, "data-frames.md", "exec"), names)
            printed = capsys.readouterr().out
        else:
            assert printed == block


def test_the_page_names_every_function() -> None:
    functions = [name for name in friction_stage.__all__ if name[0].islower()]
    assert len(functions) == 8
    assert [name for name in functions if f"{name}(" not in PAGE.read_text()] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, beside_the_examples: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    outputs = [
        cell for cell in notebook.cells if cell.get("outputs") or cell.get("execution_count")
    ]
    assert outputs == [], "outputs are not committed"
    client = NotebookClient(
        notebook, timeout=100, kernel_name="python3", resources={"metadata": {"path": "."}}
    )
    client.execute()


def test_there_are_two_notebooks() -> None:
    assert [path.stem for path in NOTEBOOKS] == [
        "a_stage_in_ten_minutes",
        "what_does_my_recording_say",
    ]
