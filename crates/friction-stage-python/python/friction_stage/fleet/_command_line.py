"""The command line: reads arguments, prints what became of a job, chooses the exit code."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ..errors import FrictionStageError, OtherJobError
from ._engine import NAMES
from ._job import Job, load_job
from ._job_files import kubernetes, slurm
from ._progress import ProgressLine
from ._report import report
from ._run import FleetResult, prepare, run, run_share, status

DONE, WRONG, CHUNKS_FAILED, INTERRUPTED = 0, 2, 3, 130
MOST_REASONS = 10
"""Reasons that a summary prints; ``status --json`` has all."""

EPILOG = """exit codes: 0 done; 2 wrong arguments; 3 chunks failed, or the results are of
another job; 130 stopped with Ctrl-C, what is done is kept"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; the exit code."""
    given = _parser().parse_args(arguments)
    try:
        code: int = given.command(given)
    except OtherJobError as error:
        print(f"error: {error}", file=sys.stderr)
        return CHUNKS_FAILED
    except (FrictionStageError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return WRONG
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m friction_stage.fleet",
        description="Many variants and many recordings, on as many machines as it takes.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, does: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=does, description=does, epilog=EPILOG)
        added.add_argument("job", metavar="JOB.yaml", help="what is to be computed")
        added.set_defaults(command=globals()[f"_{name}"])
        return added

    def prints_json(added: argparse.ArgumentParser) -> None:
        added.add_argument("--json", action="store_true", help="print JSON")

    added = command("run", "Compute the chunks that are not there.")
    added.add_argument("--engine", choices=NAMES, default="local", help="where; local by default")
    added.add_argument("--address", help="of the scheduler of Dask or of the cluster of Ray")
    added.add_argument("--workers", type=int, help="how many on this machine; one for each core")
    prints_json(added)

    added = command("chunk", "Compute one chunk, or the chunks of one task, in this process.")
    added.add_argument("--index", type=int, required=True, help="of the chunk or task, from 0 on")
    added.add_argument("--tasks", type=int, help="tasks that share the chunks")
    prints_json(added)

    added = command("jobs", "Print a job file for a batch system, and write the manifest.")
    system = added.add_mutually_exclusive_group(required=True)
    system.add_argument("--slurm", action="store_true", help="a job array, for sbatch")
    system.add_argument("--kubernetes", action="store_true", help="an Indexed Job, for kubectl")
    added.add_argument("--tasks", type=int, help="tasks or pods; one per chunk, 1000 at most")
    added.add_argument("--python", help="the interpreter on the machines")
    added.add_argument("--image", help="of the pods, with friction_stage in it")
    added.add_argument("--parallelism", type=int, help="pods at once")

    prints_json(command("status", "Say what is done and what failed."))

    added = command("report", "Rank, show distributions and trends, and name outliers.")
    added.add_argument("--html", metavar="FILE", help="write a self-contained page")
    prints_json(added)
    return parser


def _run(given: argparse.Namespace) -> int:
    job = load_job(given.job)
    progress = ProgressLine()
    try:
        # What an engine has to say is no result: Ray prints of lost workers.
        with contextlib.redirect_stdout(sys.stderr):
            result = run(
                job,
                engine=given.engine,
                address=given.address,
                workers=given.workers,
                progress=progress,
            )
    except KeyboardInterrupt:
        progress.end()
        return _interrupted(job)
    finally:
        progress.end()
    return _conclude(result, given.json)


def _interrupted(job: Job) -> int:
    try:
        kept = status(job)
        state = f"{kept.done} of {kept.chunks} chunks are kept in {kept.out}"
    except FrictionStageError:
        state = "nothing was begun"
    print(f"stopped: {state}; the same command continues", file=sys.stderr)
    return INTERRUPTED


def _chunk(given: argparse.Namespace) -> int:
    try:
        result = run_share(load_job(given.job), given.index, given.tasks)
    except KeyboardInterrupt:
        print("stopped; a chunk that was not finished left nothing", file=sys.stderr)
        return INTERRUPTED
    return _conclude(result, given.json)


def _status(given: argparse.Namespace) -> int:
    return _conclude(status(load_job(given.job)), given.json)


def _conclude(result: FleetResult, as_json: bool) -> int:
    if as_json:
        print(json.dumps(result.to_dict(), indent=1))
    else:
        rows = {"sweep": "points"}.get(result.kind, result.kind)
        line = f"{result.done} of {result.chunks} chunks, {result.rows} {rows} in {result.out}"
        if result.seconds:
            line += (
                f"; {len(result.computed)} chunks in {result.seconds:.1f} s, "
                f"{result.core_seconds / 3600.0:.3g} core hours"
            )
        print(line)
        for index, reason in list(result.failed.items())[:MOST_REASONS]:
            print(f"  chunk {index} failed: {reason}")
        if len(result.failed) > MOST_REASONS:
            print(f"  and {len(result.failed) - MOST_REASONS} more: status --json has all")
    return CHUNKS_FAILED if result.failed else DONE


def _jobs(given: argparse.Namespace) -> int:
    if given.kubernetes and given.image is None:
        print("error: --kubernetes needs --image, with friction_stage in it", file=sys.stderr)
        return WRONG
    manifest, _ = prepare(load_job(given.job))
    chunks = len(manifest.chunks)
    where = given.job if "://" in given.job else str(Path(given.job).absolute())
    if given.slurm:
        text = slurm(where, chunks, tasks=given.tasks, python=given.python or sys.executable)
    else:
        text = kubernetes(
            where,
            chunks,
            image=given.image,
            tasks=given.tasks,
            parallelism=given.parallelism,
            python=given.python or "python3",
        )
    print(text, end="")
    return DONE


def _report(given: argparse.Namespace) -> int:
    found = report(load_job(given.job))
    if given.html is not None:
        Path(given.html).write_text(found.page(), encoding="utf-8")
    if given.json:
        print(json.dumps(found.to_dict(), indent=1))
    else:
        print(found)
        if given.html is not None:
            print(f"page: {given.html}")
    return DONE
