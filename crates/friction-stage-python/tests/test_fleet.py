"""Fleets on this machine: the data set, resuming, and what is refused or goes wrong."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import polars as pl
import pytest
import yaml
from conftest import LAUNCH_CONFIG
from fleet_jobs import APPLICATION, command, digests, fleet, variants_job
from friction_stage import Model, Motion, select, sweep
from friction_stage.fleet import (
    FleetError,
    FleetResult,
    Job,
    OtherJobError,
    SweepJob,
    VariantsJob,
    load_job,
    map_sweep,
    map_variants,
    report,
    run,
    run_share,
    status,
)
from friction_stage.fleet._command_line import main


def run_here(job: Job) -> FleetResult:
    """In threads of this process, where the engine does not matter."""
    with ThreadPoolExecutor(2) as threads:
        return run(job, engine=threads)


def test_the_data_set_holds_the_variants_of_select(tmp_path: Path) -> None:
    result = map_variants(APPLICATION, tmp_path / "out", variants=500, seed=3, chunk=200, workers=1)
    assert (result.done, result.chunks, result.rows, result.failed) == (3, 3, 500, {})
    rows = pl.read_parquet(tmp_path / "out" / "data" / "*.parquet")
    expected = select(APPLICATION, variants=500, seed=3).to_polars()
    assert rows["guide"].to_list() == expected["guide"].to_list()
    for name in ("variant", "seed", "peak_error_m", "saturated", "stribeck_velocity"):
        assert np.array_equal(rows[name].to_numpy(), expected[name].to_numpy()), name
    settling = rows["settling_time_s"].fill_null(float("nan")).to_numpy()
    assert np.array_equal(settling, expected["settling_time_s"].to_numpy(), equal_nan=True)

    # What never settles has no time.
    strict = APPLICATION["requirement"] | {"settling_band": 1e-12}
    with ThreadPoolExecutor(1) as threads:
        map_variants(
            APPLICATION | {"requirement": strict}, tmp_path / "never", variants=30, engine=threads
        )
    never = pl.read_parquet(tmp_path / "never" / "data" / "*.parquet")
    assert never["settling_time_s"].null_count() == 30


def test_a_sweep_computes_every_combination(tmp_path: Path) -> None:
    swept = {"controller.bandwidth": [40.0, 80.0], "mass": [20, 40.5]}
    result = map_variants(
        APPLICATION, tmp_path / "out", variants=60, sweep=swept, chunk=60, workers=1
    )
    assert result.rows == 240
    rows = pl.read_parquet(tmp_path / "out" / "data" / "*.parquet")
    points = rows.select("controller.bandwidth", "mass").unique(maintain_order=True).rows()
    assert points == [(40.0, 20.0), (40.0, 40.5), (80.0, 20.0), (80.0, 40.5)]
    changed = APPLICATION | {"mass": 40.5, "controller": {"bandwidth": 80.0}}
    own = select(changed, variants=60).to_polars()
    last = rows.filter((pl.col("mass") == 40.5) & (pl.col("controller.bandwidth") == 80.0))
    assert last["peak_error_m"].to_list() == own["peak_error_m"].to_list()


SWEEP: dict[str, Any] = {"controller.bandwidth": "40:80:3", "model.guides": ["guide_1", "guide_2"]}


def test_the_data_set_and_the_report_are_those_of_the_sweep(tmp_path: Path) -> None:
    motion = Motion.of_moves([(1e-5, 0.003, 0.02)])
    model = Model.guide("guide_2")
    expected = sweep(model, SWEEP, motion=motion, samples=2, seed=3)
    result = map_sweep(
        model, SWEEP, tmp_path / "out", motion=motion, samples=2, seed=3, chunk=5, workers=2
    )
    assert (result.done, result.rows, result.failed) == (3, 12, {})
    rows = pl.read_parquet(tmp_path / "out" / "data" / "*.parquet")
    assert rows.columns == list(expected.points)
    for name, values in expected.points.items():
        if values.dtype.kind == "f":
            found = rows[name].fill_null(float("nan")).to_numpy()
            assert np.array_equal(found, values, equal_nan=True), name
        else:
            assert rows[name].to_list() == values.tolist(), name
    job = SweepJob(model, SWEEP, tmp_path / "out", motion, samples=2, seed=3, chunk=5)
    found = report(job)
    assert found.sweep is not None and found.sweep.summary == expected.summary
    assert str(found) == str(expected).rstrip()
    page = found.page()
    assert "model.guides" in page and page.count("<svg") == 1
    # Of what is there.
    (tmp_path / "out" / "data" / "chunk-00000001.parquet").unlink()
    part = report(job)
    assert part.missing == 1 and part.sweep is not None and part.sweep.summary["points"] == 7
    # Another value is another job.
    with pytest.raises(OtherJobError, match="plan of the sweep"):
        map_sweep(model, SWEEP, tmp_path / "out", motion=motion, samples=2, seed=4, chunk=5)


def test_a_sweep_whose_points_fail_is_summed_up(tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    job = {"kind": "sweep", "model": "guide_2", "axes": {"model.mass": [40, -1]}, "out": "out"}
    path.write_text(yaml.safe_dump(job))
    assert fleet("run", path).returncode == 0
    answer = fleet("report", path)
    assert answer.returncode == 0 and "1 of 2 points cannot be computed" in answer.stdout, (
        answer.stdout
    )


def test_a_second_run_computes_what_is_missing_with_the_same_bytes(tmp_path: Path) -> None:
    job = load_job(variants_job(tmp_path, chunk=100))
    first = run(job, workers=2)
    assert first.computed == (0, 1, 2, 3, 4, 5)
    before = digests(tmp_path / "out")
    (tmp_path / "out" / "data" / "chunk-00000003.parquet").unlink()
    damaged = tmp_path / "out" / "data" / "chunk-00000005.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-7])
    assert status(job).done == 4
    # On another engine.
    with ThreadPoolExecutor(2) as threads:
        again = run(job, engine=threads)
    assert (again.computed, again.done) == ((3, 5), 6)
    assert digests(tmp_path / "out") == before
    assert run(job).computed == ()


def test_results_in_a_store_of_objects(tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as threads:
        result = map_variants(
            APPLICATION, "memory://fleet/here", variants=300, chunk=100, engine=threads
        )
    assert (result.done, result.out) == (3, "memory:///fleet/here")
    map_variants(APPLICATION, tmp_path / "here", variants=300, chunk=100, workers=1)
    store = fsspec.filesystem("memory")
    found = {
        path.removeprefix("/fleet/here/"): store.cat_file(path) for path in store.find("/fleet")
    }
    files = [path for path in (tmp_path / "here").rglob("*") if path.is_file()]
    assert found == {str(path.relative_to(tmp_path / "here")): path.read_bytes() for path in files}
    store.rm("/fleet", recursive=True)


OTHER_JOBS: list[tuple[dict[str, Any], str]] = [
    ({"seed": 2}, "seed is 1, not 2"),
    ({"variants": 700}, "variants is 600, not 700"),
    ({"guides": ["guide_1"]}, 'guides is [], not ["guide_1"]'),
    ({"application": APPLICATION | {"mass": 41.0}}, "points is"),
]


@pytest.mark.parametrize(("keys", "words"), OTHER_JOBS, ids=[w for _, w in OTHER_JOBS])
def test_results_of_another_job_are_refused_with_what_differs(
    keys: dict[str, Any], words: str, tmp_path: Path
) -> None:
    job = variants_job(tmp_path, chunk=300)
    run_here(load_job(job))
    before = digests(tmp_path / "out")
    other = variants_job(tmp_path, chunk=300, **keys)
    for command_words in (("run", other), ("chunk", other, "--index", 0)):
        refused = fleet(*command_words)
        assert refused.returncode == 3 and words in refused.stderr, refused.stderr
        assert refused.stderr.count("\n") == 1
    assert digests(tmp_path / "out") == before


def test_results_of_another_version_are_refused(tmp_path: Path) -> None:
    job = load_job(variants_job(tmp_path, chunk=300))
    run_here(job)
    # As an older version would have written it: its own version and its own fingerprint.
    code = "from friction_stage import _native; _native.__version__ = '0.1.7'\n"
    code += "import sys; from friction_stage.fleet import load_job\n"
    code += "from friction_stage.fleet._place import Place; job = load_job(sys.argv[1])\n"
    code += "job.plan().write(Place(job.out))"
    subprocess.run([sys.executable, "-c", code, tmp_path / "out.yaml"], check=True)
    with pytest.raises(OtherJobError, match=r'version of friction_stage is "0.1.7", not "0'):
        run_here(job)


def test_a_changed_manifest_and_a_file_of_another_job_are_named(tmp_path: Path) -> None:
    job = load_job(variants_job(tmp_path, chunk=200))
    other = load_job(variants_job(tmp_path, "other", chunk=200, seed=9))
    run_here(job)
    run_here(other)
    stranger = tmp_path / "other" / "data" / "chunk-00000001.parquet"
    mine = tmp_path / "out" / "data" / "chunk-00000001.parquet"
    mine.write_bytes(stranger.read_bytes())
    (tmp_path / "out" / "data" / "chunk-00000002.parquet").unlink()
    ended = fleet("run", tmp_path / "out.yaml")
    # The rest goes on, and nothing of the stranger is overwritten.
    assert ended.returncode == 3
    assert "2 of 3 chunks" in ended.stdout
    assert "chunk 1 failed: data/chunk-00000001.parquet is of another job" in ended.stdout
    assert mine.read_bytes() == stranger.read_bytes()
    manifest = tmp_path / "out" / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"seed": 1', '"seed": 2'))
    with pytest.raises(FleetError, match=r"manifest.json was changed"):
        run_here(job)


BAD_JOBS: list[tuple[str, str]] = [
    ("kind: variant", "kind is 'variant', must be variants or sweep or bags"),
    ("kind: variants\nout: o\napplication: a.yaml", "variants is missing"),
    ("kind: variants\nout: o\nvariant: 3", "unknown key 'variant'; did you mean 'variants'?"),
    ("kind: variants\nout: o\nvariants: 1.5\napplication: a.yaml", "variants is 1.5, must be a"),
    ("kind: variants\nout: o\nvariants: 0\napplication: a.yaml", "variants is 0, must be a whole"),
    ("kind: variants\nout: o\nvariants: 9\napplication: a.yaml", "cannot read the application"),
    ("kind: sweep\nout: o\nmodel: guide_1", "axes is missing"),
    ("kind: sweep\nout: o\nmodel: guide_1\naxes: [a]", "axes is ['a'], must be a mapping from"),
    ("kind: sweep\nout: o\nmodel: guide_1\naxes: {model.mas: [1]}", "did you mean `model.mass`?"),
    ("kind: sweep\nout: o\nmodel: guide_1\naxes: {model.mass: '1:'}", "model.mass"),
    ("kind: sweep\nout: o\nmodel: no.yaml\naxes: {model.mass: [1]}", "cannot read the model"),
    ("kind: sweep\nout: o\nmodel: guide_1\naxes: {}", "nothing is swept"),
    ("kind: sweep\nout: o\nmodel:\naxes: {model.mass: [1]}", "model is missing"),
    ("kind: sweep\nout: o\nmodel: guide_1\naxes: {model.mass: [1, [2, 3]]}", "must be a mapping"),
    ("kind: sweep\nout: o\nmodel: guide_1\naxes: {model.mass: [1, null]}", "must be a mapping"),
    ("kind: sweep\nout: o\nmodel: guide_1\naxes: {1: [40]}", "must be a mapping from keys"),
    ("kind: sweep\nout: o\nmodel: guide_1\nmotion:\naxes: {model.mass: [1]}", "motion is empty"),
    ("kind: bags\nout: o\nbags: nowhere", "no recording in file:///"),
    ("kind: bags\nout: o\nbags: [{bag: a, modle: b}]", "bags[0]: unknown key 'modle'; did you"),
    ("kind: bags\nout: o\nbags: [a]", "has no model: give it one"),
    ("kind: bags\nout: o\nbags: []\nmodel: guide_1", "bags is empty"),
    ("kind: bags\nout: o\nbags: [a]\nmodel: guide_1\nholdout_share: 1", "must be between 0 and 1"),
    ("kind: [", "is not YAML"),
    ("- a", "holds no keys"),
]


@pytest.mark.parametrize(("text", "words"), BAD_JOBS, ids=[w for _, w in BAD_JOBS])
def test_a_bad_job_is_refused_with_what_would_be_right(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "job.yaml"
    path.write_text(text)
    code = main(["run", str(path)])
    message = capsys.readouterr().err
    assert code == 2 and words in message, message
    assert message.startswith("error: ") and message.count("\n") == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["job.yaml"]


def test_a_job_file_names_files_relative_to_itself(tmp_path: Path) -> None:
    text = (LAUNCH_CONFIG / "application_fine_step_clean.yaml").read_text()
    (tmp_path / "application.yaml").write_text(text)
    job = load_job(variants_job(tmp_path, application="application.yaml"))
    assert isinstance(job, VariantsJob)
    assert job.plan().texts and str(job.out).endswith(f"{tmp_path}/out")


def wait_for(condition: Any, process: subprocess.Popen[str]) -> None:
    """Until it holds; the process must not have ended."""
    while not condition():
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


def files_of(out: Path) -> list[Path]:
    return sorted(out.glob("data/*.parquet"))


def children(pid: int) -> list[int]:
    """The processes that a process has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[1]) == pid:
            found.append(int(stat.parent.name))
    return found


@pytest.mark.timeout(300)
def test_a_killed_run_takes_its_workers_along_and_repeats_the_open_chunks_alone(
    tmp_path: Path,
) -> None:
    job = variants_job(tmp_path, variants=4000, chunk=200)
    process = subprocess.Popen(
        command("run", job, "--workers", 2), stderr=subprocess.DEVNULL, text=True
    )
    wait_for(lambda: len(files_of(tmp_path / "out")) >= 4, process)
    workers = children(process.pid)
    process.kill()
    process.wait()
    # No process writes once they have ended, and nothing was cut off.
    while any(Path(f"/proc/{worker}").exists() for worker in workers):
        time.sleep(0.01)
    kept = status(load_job(job))
    assert 4 <= kept.done < 20
    before = {path.name: path.stat().st_mtime_ns for path in files_of(tmp_path / "out")}
    again = run(load_job(job))
    assert (again.done, len(again.computed)) == (20, 20 - kept.done)
    after = {path.name: path.stat().st_mtime_ns for path in files_of(tmp_path / "out")}
    assert {name: after[name] for name in before} == before
    whole = load_job(variants_job(tmp_path, "whole", variants=4000, chunk=200))
    run_here(whole)
    assert digests(tmp_path / "out") == digests(tmp_path / "whole")


@pytest.mark.timeout(300)
def test_a_killed_worker_costs_its_chunk_alone(tmp_path: Path) -> None:
    job = variants_job(tmp_path, variants=4000, chunk=200)
    process = subprocess.Popen(
        command("run", job, "--workers", 2, "--json"),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    wait_for(lambda: len(files_of(tmp_path / "out")) >= 2, process)
    names = {pid: Path(f"/proc/{pid}/cmdline").read_text() for pid in children(process.pid)}
    # Not the process that tracks shared resources.
    workers = [pid for pid, name in names.items() if "spawn_main" in name]
    assert len(workers) == 2, names
    os.kill(workers[0], signal.SIGKILL)
    out, _ = process.communicate()
    assert process.returncode == 0, out
    assert json.loads(out)["done"] == 20
    whole = load_job(variants_job(tmp_path, "whole", variants=4000, chunk=200))
    run_here(whole)
    assert digests(tmp_path / "out") == digests(tmp_path / "whole")


@pytest.mark.timeout(300)
def test_a_chunk_that_kills_its_worker_fails_and_the_rest_goes_on(tmp_path: Path) -> None:
    script = tmp_path / "deadly.py"
    script.write_text(
        "import os, signal, sys\n"
        "from friction_stage.fleet import _run, load_job, run\n"
        "from friction_stage.fleet._chunk import compute\n"
        "def deadly(task):\n"
        "    if task.index == 2:\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return compute(task)\n"
        "if __name__ == '__main__':\n"
        "    _run.compute = deadly\n"
        "    result = run(load_job(sys.argv[1]), workers=2)\n"
        "    print(result.done, dict(result.failed))\n"
    )
    job = variants_job(tmp_path, variants=1000, chunk=100)
    ended = subprocess.run(
        [sys.executable, script, job], capture_output=True, text=True, check=True
    )
    assert ended.stdout.startswith("9 {2: 'no worker could compute it, 3 times: "), ended.stdout


@pytest.mark.timeout(300)
def test_ctrl_c_keeps_what_is_done_and_says_so(tmp_path: Path) -> None:
    job = variants_job(tmp_path, variants=40_000, chunk=200)
    process = subprocess.Popen(command("run", job), stderr=subprocess.PIPE, text=True)
    wait_for(lambda: len(files_of(tmp_path / "out")) >= 2, process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert process.returncode == 130, errors
    kept = status(load_job(job))
    last = errors.splitlines()[-1]
    assert (
        last
        == f"stopped: {kept.done} of 200 chunks are kept in {kept.out}; the same command continues"
    )
    assert "Traceback" not in errors
    assert [path for path in (tmp_path / "out").rglob("*.tmp")] == []


def test_a_progress_callback_stops_a_run(tmp_path: Path) -> None:
    lines: list[str] = []

    def enough(what: str, share: float) -> bool:
        lines.append(what)
        return share < 0.4

    result = run(load_job(variants_job(tmp_path, chunk=100)), workers=1, progress=enough)
    assert result.stopped and 3 <= result.done < 6
    assert lines[0] == "0 of 6 chunks"
    assert run_here(load_job(tmp_path / "out.yaml")).done == 6


def test_progress_is_a_bar_of_60_columns_on_a_terminal(tmp_path: Path) -> None:
    job = variants_job(tmp_path, chunk=100)
    ours, theirs = os.openpty()
    process = subprocess.Popen(
        command("run", job, "--workers", 1), stdout=subprocess.PIPE, stderr=theirs, text=True
    )
    os.close(theirs)
    shown = b""
    # The terminal ends with the last process that has it.
    with contextlib.suppress(OSError):
        while more := os.read(ours, 4096):
            shown += more
    os.close(ours)
    out, _ = process.communicate()
    lines = shown.decode().split("\r")
    assert process.returncode == 0 and "6 of 6 chunks" in out
    assert max(map(len, lines)) <= 60 and any("[#" in line for line in lines), lines
    # Nothing of it is left on the terminal.
    assert lines[-1] == "" and lines[-2].strip() == ""


def test_progress_is_lines_where_there_is_no_terminal(tmp_path: Path) -> None:
    done = fleet("run", variants_job(tmp_path, chunk=300), "--workers", 1)
    assert done.stderr.startswith("fleet: 0 of 2 chunks\n") and "\r" not in done.stderr


def test_a_full_disk_fails_the_chunks_that_do_not_fit_and_a_later_run_goes_on(
    tmp_path: Path,
) -> None:
    job = variants_job(tmp_path, variants=3000, chunk=500)
    # Files may have no more than 20 kB: the manifest fits, a chunk does not.
    path = tmp_path / "limited.py"
    path.write_text(
        "import resource, sys\n"
        "from friction_stage.fleet._command_line import main\n"
        "if __name__ == '__main__':\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        "    sys.exit(main(['run', sys.argv[1], '--json', '--workers', '1']))\n"
    )
    ended = subprocess.run([sys.executable, path, job], capture_output=True, text=True, check=False)
    assert ended.returncode == 3, ended.stderr
    printed = json.loads(ended.stdout)
    assert printed["done"] == 0 and len(printed["failed"]) == 6
    assert "cannot write file://" in printed["failed"]["0"]
    assert "File too large" in printed["failed"]["0"]
    assert files_of(tmp_path / "out") == [] and list(tmp_path.rglob("*.tmp")) == []
    noted = json.loads((tmp_path / "out" / "failed" / "chunk-00000000.json").read_text())
    assert noted["reason"] == printed["failed"]["0"]
    # There is room again.
    again = fleet("run", job)
    assert again.returncode == 0, again.stdout
    assert list((tmp_path / "out" / "failed").iterdir()) == []


def test_a_disk_without_room_for_every_chunk_keeps_those_that_fit(tmp_path: Path) -> None:
    job = variants_job(tmp_path, variants=3000, chunk=500)
    (tmp_path / "out").mkdir()
    # Room for the manifest and some chunks of 30 kB, in a mount that no other process sees.
    script = 'mount -t tmpfs -o size=80k tmpfs "$1" && shift && exec "$@"'
    small = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh"]
    environment = os.environ | {"PATH": f"{os.environ['PATH']}:{os.defpath}:/usr/sbin:/sbin"}

    def on_small_disk(*words: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*small, tmp_path / "out", *map(str, words)],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
        )

    if (
        shutil.which("unshare", path=environment["PATH"]) is None
        or on_small_disk("true").returncode
    ):
        pytest.skip("this system mounts nothing for its users")
    done = on_small_disk(*command("run", job, "--json", "--workers", 1))
    assert done.returncode == 3, done.stderr
    printed = json.loads(done.stdout)
    assert 0 < printed["done"] < 6 and printed["done"] + len(printed["failed"]) == 6
    assert all("No space left on device" in why for why in printed["failed"].values())


def test_tasks_of_a_batch_system_share_the_chunks(tmp_path: Path) -> None:
    job = load_job(variants_job(tmp_path, variants=700, chunk=100))
    shares = [run_share(job, index, 3).computed for index in range(3)]
    assert shares == [(0, 3, 6), (1, 4), (2, 5)]
    assert status(job).is_complete
    assert run_share(job, 0, 3).computed == ()
    with pytest.raises(FleetError, match="index is 3, must be 0 to 2"):
        run_share(job, 3, 3)


def test_the_job_array_of_slurm_computes_every_chunk(tmp_path: Path) -> None:
    job = variants_job(tmp_path, variants=500, chunk=100)
    script = fleet("jobs", job, "--slurm", "--tasks", 2).stdout
    assert "#SBATCH --array=0-1\n" in script
    for index in range(2):
        # As Slurm would start it.
        environment = os.environ | {"SLURM_ARRAY_TASK_ID": str(index)}
        subprocess.run(
            ["/bin/bash"], input=script, text=True, check=True, env=environment, cwd="/",
            stdout=subprocess.DEVNULL,
        )  # fmt: skip
    assert status(load_job(job)).is_complete


def test_the_indexed_job_of_kubernetes_computes_every_chunk(tmp_path: Path) -> None:
    job = variants_job(tmp_path, variants=300, chunk=100)
    refused = fleet("jobs", job, "--kubernetes")
    assert refused.returncode == 2 and "--image" in refused.stderr
    words = ("--kubernetes", "--image", "registry/fleet:1", "--python", sys.executable)
    content = yaml.safe_load(fleet("jobs", job, *words, "--parallelism", 2).stdout)
    spec = content["spec"]
    assert (spec["completions"], spec["parallelism"], spec["completionMode"]) == (3, 2, "Indexed")
    container = spec["template"]["spec"]["containers"][0]
    for index in range(spec["completions"]):
        # As the kubelet would start it.
        environment = os.environ | {"JOB_COMPLETION_INDEX": str(index)}
        subprocess.run(
            container["command"], check=True, env=environment, cwd="/", stdout=subprocess.DEVNULL
        )
    assert status(load_job(job)).is_complete
