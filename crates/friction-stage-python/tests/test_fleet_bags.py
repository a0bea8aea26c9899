"""Fleets of recordings: identification of many bags, and the report over them."""

import json
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import polars as pl
import pytest
from conftest import LAUNCH_CONFIG, ROOT, CommandLine
from fleet_jobs import AMPLITUDES, APPLICATION, DAY, FIRST_DAY, MACHINES, fleet, write_bags
from friction_stage import Model, identify, select
from friction_stage.fleet import (
    Bag,
    BagsJob,
    FleetError,
    VariantsJob,
    identify_bags,
    load_job,
    report,
    run,
    status,
)
from friction_stage.fleet._trend import trend


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory, command_line: CommandLine) -> Path:
    """Five bags of each of three machines, with a broken one among them."""
    directory = tmp_path_factory.mktemp("fleet") / "machines"
    bags = write_bags(directory, command_line, 5)
    broken = bags / "west" / "day_5"
    shutil.copytree(bags / "west" / "day_4", broken)
    (file,) = broken.glob("*.mcap")
    file.write_bytes(b"no recording")
    job = directory / "job.yaml"
    job.write_text("kind: bags\nbags: bags\nmodel: declared.yaml\nout: out\n")
    return directory


@pytest.fixture(scope="module")
def identified(machines: Path) -> subprocess.CompletedProcess[str]:
    """The run over them."""
    return fleet("run", machines / "job.yaml", "--json")


def test_a_broken_bag_is_named_with_its_reason_and_the_rest_goes_on(
    identified: subprocess.CompletedProcess[str], machines: Path
) -> None:
    assert identified.returncode == 3, identified.stderr
    printed = json.loads(identified.stdout)
    assert (printed["chunks"], printed["done"], printed["rows"]) == (16, 15, 15)
    (reason,) = printed["failed"].values()
    assert f"{machines}/bags/west/day_5" in reason and "Error" not in reason
    again = fleet("status", machines / "job.yaml", "--json")
    assert again.returncode == 3
    assert json.loads(again.stdout)["failed"] == printed["failed"]


def test_a_row_is_the_verdict_on_a_bag(
    identified: subprocess.CompletedProcess[str], machines: Path
) -> None:
    rows = pl.read_parquet(machines / "out" / "data" / "*.parquet").sort("bag")
    assert rows["machine"].unique().sort().to_list() == sorted(MACHINES)
    assert rows["verdict"].to_list() == ["found"] * 15
    assert rows["effects"].to_list() == [["cogging"]] * 15
    days = rows.filter(pl.col("machine") == "north")["recorded_s"].to_numpy() - FIRST_DAY
    assert np.allclose(days, DAY * np.arange(5), atol=1.0)
    for machine in MACHINES:
        for day, amplitude in enumerate(AMPLITUDES[machine]):
            url = f"file://{machines}/bags/{machine}/day_{day}"
            (row,) = rows.filter(pl.col("bag") == url).to_dicts()
            found = {(p["owner"], p["name"]): p for p in row["parameters"]}
            own = found["cogging", "amplitude"]
            assert own["unit"] == "N" and own["low"] < own["value"] < own["high"]
            assert own["value"] == pytest.approx(amplitude, abs=0.05)
            assert Model.from_yaml(row["model"]).effects == ["cogging"]
            assert json.loads(row["summary"])["verdict"] == "found"


def test_threads_do_not_change_a_verdict(machines: Path) -> None:
    declared = Model.from_yaml(machines / "declared.yaml")
    sides = [machines / "bags" / "north" / f"day_{day}" for day in (0, 1)]
    one, all_of_them = (identify(declared, *sides, threads=threads) for threads in (1, None))
    assert one.summary == all_of_them.summary


def test_the_report_shows_trends_and_names_outliers(
    identified: subprocess.CompletedProcess[str], machines: Path, tmp_path: Path
) -> None:
    ended = fleet("report", machines / "job.yaml", "--json", "--html", tmp_path / "page.html")
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["machines"]["south"] == {
        "bags": 5,
        "verdicts": {"found": 5},
        "effects": {"cogging": 5},
    }
    (rising,) = (
        one
        for one in found["trends"]
        if (one["machine"], one["parameter"]) == ("south", "cogging.amplitude")
    )
    assert rising["slope_per_s"] * DAY == pytest.approx(0.4, abs=0.02)
    assert rising["level"] == pytest.approx(4.8, abs=0.05) and rising["outliers"] == []
    low, high = rising["slope_ci95"]
    assert rising["moves"] and 0.0 < low * DAY < 0.4 < high * DAY
    stranger = f"file://{machines}/bags/west/day_2"
    assert any(
        line.startswith(f"{stranger}: cogging.amplitude is 9") for line in found["outliers"]
    ), found["outliers"]
    assert not any("north" in line for line in found["outliers"])
    page = (tmp_path / "page.html").read_text()
    # The name of the outlier stands in the figure, and nothing comes from elsewhere.
    assert ">day_2</text>" in page and "<h2>south</h2>" in page and "1 chunks are not there" in page
    assert all(word not in page for word in ("<script", 'src="http', "@import"))


def test_a_bag_of_ones_own_model_holdout_machine_and_time(machines: Path, tmp_path: Path) -> None:
    heavy = Model.from_dict(Model.guide("guide_2").to_dict() | {"name": "heavy"})
    bags = machines / "bags" / "north"
    one = Bag(bags / "day_0", heavy, bags / "day_1", "left", 1.75e9)
    job = BagsJob([one], tmp_path / "out")
    with ThreadPoolExecutor(1) as threads:
        assert run(job, engine=threads).done == 1
    (row,) = pl.read_parquet(tmp_path / "out" / "data" / "*.parquet").to_dicts()
    assert (row["machine"], row["recorded_s"]) == ("left", 1.75e9)
    expected = identify(heavy, bags / "day_0", bags / "day_1")
    assert json.loads(row["summary"]) == expected.summary


def test_bags_in_a_store_give_the_rows_of_those_on_a_disk(machines: Path, tmp_path: Path) -> None:
    store = fsspec.filesystem("memory")
    store.put(str(machines / "bags" / "north" / "day_0"), "/plant/north/day_0", recursive=True)
    rows = []
    with ThreadPoolExecutor(1) as threads:
        for bags in ("memory://plant", f"{machines}/bags/north/day_0*"):
            out = tmp_path / f"out{len(rows)}"
            result = identify_bags(bags, out, model=machines / "declared.yaml", engine=threads)
            assert result.failed == {}
            (row,) = pl.read_parquet(out / "data" / "*.parquet").drop("bag").to_dicts()
            # The one name that differs, that of the recording, is in no number.
            rows.append({k: v for k, v in row.items() if k not in ("summary", "warnings")})
    assert rows[0] == rows[1]
    store.rm("/plant", recursive=True)


def test_a_bag_that_was_changed_is_no_bag_of_the_manifest(machines: Path, tmp_path: Path) -> None:
    shutil.copytree(machines / "bags" / "south", tmp_path / "bags" / "south")
    (tmp_path / "declared.yaml").write_text((machines / "declared.yaml").read_text())
    job = tmp_path / "job.yaml"
    job.write_text("kind: bags\nbags: bags\nmodel: declared.yaml\nout: out\n")
    assert fleet("jobs", job, "--slurm").returncode == 0
    (file,) = (tmp_path / "bags" / "south" / "day_1").glob("*.mcap")
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    # Whoever has the manifest already says it for that bag; a new run says it for the job.
    ended = fleet("chunk", job, "--index", 1)
    assert ended.returncode == 3 and "it was changed" in ended.stdout
    refused = fleet("run", job)
    assert refused.returncode == 3 and "sha256 of file://" in refused.stderr
    assert status(load_job(job)).done == 0


def test_the_report_over_variants_is_the_selection(tmp_path: Path) -> None:
    job = VariantsJob(APPLICATION, tmp_path / "out", 900, seed=2, chunk=250)
    with ThreadPoolExecutor(2) as threads:
        run(job, engine=threads)
    found = report(job)
    expected = select(APPLICATION, variants=900, seed=2)
    (point,) = found.points
    assert point.summary == expected.summary
    assert str(found) == str(expected).rstrip()
    for guide, counts in point.counts["peak_error_m"].items():
        assert counts.sum() == 300, guide
    page = found.page()
    assert "guide_2" in page and page.count("<svg") == 1
    (tmp_path / "out" / "data" / "chunk-00000003.parquet").unlink()
    assert report(job).missing == 1


def test_a_report_needs_results(tmp_path: Path) -> None:
    job = VariantsJob(APPLICATION, tmp_path / "out", 900)
    with pytest.raises(FleetError, match="nothing was begun there"):
        report(job)


def test_a_robust_slope_has_the_interval_of_sen() -> None:
    times = np.arange(100.0)
    noise = np.random.default_rng(1).uniform(-0.1, 0.1, 100)
    unknown = np.full(100, np.nan)
    rising = trend(times, 5.0 + 0.2 * times + noise, unknown)
    assert rising.slope_ci95 is not None and rising.moves and rising.outliers == ()
    assert rising.slope_ci95[0] < 0.2 < rising.slope_ci95[1]
    assert not trend(times, 5.0 + noise, unknown).moves
    spoiled = 5.0 + 0.2 * times + noise
    spoiled[7] += 3.0
    found = trend(times, spoiled, unknown)
    assert found.outliers == (7,) and found.slope == pytest.approx(0.2, abs=0.02)
    # A recording that says itself how little it knows is none.
    wide = unknown.copy()
    wide[7] = 2.0
    assert trend(times, spoiled, wide).outliers == ()
    assert trend(times, np.full(100, 3.0), unknown).outliers == ()


def test_few_values_have_no_outliers() -> None:
    values: Any = np.array([1.0, 1.0, 9.0, 1.0])
    assert trend(np.arange(4.0), values, np.full(4, np.nan)).outliers == ()


def test_five_values_that_rise_are_a_trend_and_four_are_none() -> None:
    # All of 5! orders but two are less steady: 1.7 %. Of 4! it is 8.3 %.
    five, four = np.arange(5.0) ** 2, np.arange(4.0) ** 2
    steady = trend(np.arange(5.0), five, np.full(5, np.nan))
    assert steady.slope_ci95 == (1.0, 7.0) and steady.moves
    assert trend(np.arange(4.0), four, np.full(4, np.nan)).slope_ci95 is None


def test_the_fleet_needs_its_libraries_and_says_which(tmp_path: Path) -> None:
    (tmp_path / "pyarrow.py").write_text("raise ImportError('no pyarrow here')\n")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import friction_stage.fleet"
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ended.stderr.endswith("pip install friction-stage[fleet]\n")


@pytest.mark.timeout(300)
def test_the_page_of_the_documentation_runs_as_written(machines: Path, tmp_path: Path) -> None:
    """Files, commands and Python in their order, beside the repository's files and recordings."""
    (tmp_path / "launch_config").symlink_to(LAUNCH_CONFIG)
    (tmp_path / "declared.yaml").write_text((machines / "declared.yaml").read_text())
    for machine, day in (("west", 0), ("west", 1), ("north", 0)):
        bag = Path("recordings") / machine / f"day_{day}"
        shutil.copytree(machines / "bags" / machine / f"day_{day}", tmp_path / bag)
    text = (ROOT / "docs" / "how-to" / "fleets.md").read_text()
    blocks = re.findall(r"^```(yaml|sh|python)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert [language for language, _ in blocks].count("sh") == 4
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.defpath}"}
    for language, block in blocks:
        if language == "yaml":
            (tmp_path / block.split("\n")[0].removeprefix("# ")).write_text(block)
            continue
        if language == "python":
            (tmp_path / "block.py").write_text(block)
        words = ["/bin/bash", "-euc", block] if language == "sh" else [sys.executable, "block.py"]
        done = subprocess.run(
            words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, block + done.stdout + done.stderr
    assert status(load_job(tmp_path / "sweep.yaml")).is_complete
    points = report(load_job(tmp_path / "points.yaml")).sweep
    assert points is not None and (points.summary["points"], points.summary["failed"]) == (60, 0)
    listed = load_job(tmp_path / "listed.yaml")
    with ThreadPoolExecutor(1) as threads:
        assert run(listed, engine=threads).done == 1
    assert "<svg" in (tmp_path / "machines.html").read_text()
