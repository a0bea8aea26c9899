"""Dask with two worker processes and Ray with two nodes: the bytes of the run on this machine,
though workers and runs are killed."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import friction_stage
import pytest
import yaml
from conftest import CommandLine
from fleet_clusters import Cluster, DaskCluster, RayCluster, cluster, end, until
from fleet_jobs import APPLICATION, command, digests, fleet, sweep_job, variants_job, write_bags
from friction_stage.fleet import load_job, run, status

VARIANTS, CHUNK = 20_000, 500
SHORT = APPLICATION | {
    "motion": APPLICATION["motion"] | {"settle": 0.02},
    "requirement": APPLICATION["requirement"] | {"settling_time": 0.015},
}


@pytest.fixture(scope="module")
def jobs(tmp_path_factory: pytest.TempPathFactory, command_line: CommandLine) -> Path:
    """A directory with 2 x 10^4 variants and twelve bags to compute, and what this machine makes of
    them."""
    directory = tmp_path_factory.mktemp("jobs") / "here"
    write_bags(directory, command_line, 4)
    run(load_job(variants(directory, "variants")))
    run(load_job(sweep_job(directory, "sweep", samples=10, chunk=10)))
    result = run(load_job(bags(directory, "verdicts")))
    assert (result.done, result.failed) == (12, {})
    return directory


def variants(directory: Path, out: str) -> Path:
    return variants_job(directory, out, variants=VARIANTS, chunk=CHUNK, application=SHORT)


def bags(directory: Path, out: str) -> Path:
    path = directory / f"{out}.yaml"
    job = {"kind": "bags", "bags": "bags", "model": "declared.yaml", "out": out}
    path.write_text(yaml.safe_dump(job))
    return path


@pytest.fixture(scope="module", params=[DaskCluster, RayCluster], ids=["dask", "ray"])
def engine(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Cluster]:
    with cluster(request.param, tmp_path_factory.mktemp("cluster") / "files") as started:
        yield started


def begin(job: Path, engine: Cluster) -> subprocess.Popen[str]:
    """Starts a run; what it says on the way is in a file beside the job."""
    with job.with_suffix(".log").open("w") as log:
        return subprocess.Popen(
            command("run", job, "--engine", engine.name, "--address", engine.address, "--json"),
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )


def ended(process: subprocess.Popen[str], job: Path, code: int) -> dict[str, Any]:
    """What it printed at its end."""
    printed, _ = process.communicate()
    assert process.returncode == code, printed + job.with_suffix(".log").read_text()
    try:
        found: dict[str, Any] = json.loads(printed)
    except json.JSONDecodeError:
        pytest.fail(f"not JSON alone: {printed}")
    return found


def files(out: Path) -> int:
    return len(list(out.glob("data/chunk-*.parquet")))


@pytest.mark.timeout(300)
def test_a_killed_run_over_bags_is_continued_with_the_same_bytes(
    engine: Cluster, jobs: Path
) -> None:
    out = f"verdicts_{engine.name}"
    job = bags(jobs, out)
    process = begin(job, engine)
    until(lambda: files(jobs / out) >= 3, process)
    end(process)
    # What was running may end on the cluster, and is used.
    kept = status(load_job(job)).done
    result = ended(begin(job, engine), job, 0)
    assert result["done"] == 12
    assert kept >= 3 and result["computed"] <= 12 - kept
    assert digests(jobs / out) == digests(jobs / "verdicts")


@pytest.mark.timeout(300)
def test_a_killed_worker_changes_no_byte(engine: Cluster, jobs: Path) -> None:
    out = f"variants_{engine.name}"
    job = variants(jobs, out)
    process = begin(job, engine)
    until(lambda: files(jobs / out) >= 4, process)
    engine.kill_a_worker()
    result = ended(process, job, 0)
    assert (result["done"], result["rows"], result["failed"]) == (40, VARIANTS, {})
    assert digests(jobs / out) == digests(jobs / "variants")


@pytest.mark.timeout(300)
def test_a_sweep_has_the_same_bytes_on_a_cluster(engine: Cluster, jobs: Path) -> None:
    out = f"sweep_{engine.name}"
    result = ended(begin(sweep_job(jobs, out, samples=10, chunk=10), engine), jobs / out, 0)
    assert (result["done"], result["rows"], result["failed"]) == (9, 90, {})
    assert digests(jobs / out) == digests(jobs / "sweep")


@pytest.mark.timeout(300)
def test_a_run_that_one_engine_began_is_ended_by_another(engine: Cluster, jobs: Path) -> None:
    out = f"both_{engine.name}"
    job = load_job(variants(jobs, out))
    began = run(
        job,
        engine=engine.name,
        address=engine.address,
        progress=lambda what, share: share < 0.2,
    )
    assert began.stopped and 8 <= began.done < 40
    kept = status(job).done
    again = run(job)
    assert again.done == 40 and len(again.computed) <= 40 - kept
    assert digests(jobs / out) == digests(jobs / "variants")


@pytest.mark.timeout(300)
def test_a_worker_of_another_version_is_named_and_the_others_go_on(
    jobs: Path, tmp_path: Path
) -> None:
    # The package as it is, but for its version.
    package = Path(friction_stage.__file__).parent
    shutil.copytree(package, tmp_path / "older" / "friction_stage")
    init = tmp_path / "older" / "friction_stage" / "__init__.py"
    init.write_text(init.read_text() + '\n__version__ = "0.1.7"\n')
    job = variants(jobs, "mixed")
    with cluster(DaskCluster, tmp_path / "cluster") as started:
        assert isinstance(started, DaskCluster)
        started.workers.append(started.add_worker(PYTHONPATH=str(tmp_path / "older")))
        started.wait(3)
        result = ended(begin(job, started), job, 3)
    assert 0 < result["done"] < 40 and result["done"] + len(result["failed"]) == 40
    now = friction_stage.__version__
    words = f"has friction_stage 0.1.7, the manifest is of {now}"
    assert all(words in reason for reason in result["failed"].values())
    # Without it, the same command continues.
    run(load_job(job))
    assert digests(jobs / "mixed") == digests(jobs / "variants")


def test_a_cluster_that_is_not_there_is_named(jobs: Path) -> None:
    nowhere = "tcp://127.0.0.1:1"
    done = fleet("run", variants(jobs, "none"), "--engine", "dask", "--address", nowhere)
    assert done.returncode == 2, done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"error: no Dask scheduler at {nowhere}: "), done.stderr


def test_engines_are_named_where_they_are_missing(jobs: Path, tmp_path: Path) -> None:
    for module, engine in (("distributed", "dask"), ("ray", "ray")):
        (tmp_path / f"{module}.py").write_text("raise ImportError\n")
        code = (
            f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
            "from friction_stage.fleet._command_line import main\n"
            f"sys.exit(main(['run', {str(jobs / 'variants.yaml')!r}, '--engine', {engine!r}]))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False
        )
        assert done.returncode == 2
        assert f"pip install friction-stage[{engine}]" in done.stderr
