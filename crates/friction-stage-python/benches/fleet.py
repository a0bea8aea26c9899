"""What a fleet costs beside the plain program, and how many recordings a core identifies.

    cargo build --release --bin friction-stage
    python crates/friction-stage-python/benches/fleet.py target/release/friction-stage \\
        --variants 1000000 --bags 1000 --rounds 3

Each round computes the variants of the fine step with the program `select` and on every engine, in
turn, so that whatever else the machine does falls on all; time of cores (CPU time, that of the
workers of Dask included) depends on it least. The time of the workers of Ray is not
counted: they end with a run. Clusters have one worker process for each core and are started before
the clock is.
"""

import argparse
import contextlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

from conftest import CommandLine  # noqa: E402
from fleet_clusters import DaskCluster, RayCluster, cluster  # noqa: E402
from fleet_jobs import AMPLITUDES, MOVES, command, variants_job, write_bags  # noqa: E402
from friction_stage import Controller, Model, Motion, identify, simulate  # noqa: E402
from friction_stage.fleet import load_job, run  # noqa: E402
from friction_stage.fleet._chunk import parts  # noqa: E402

APPLICATION = HERE.parents[2] / "launch_config" / "application_fine_step_clean.yaml"


class Memory:
    """Resident memory of a process with its children, largest in each quarter of its time."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._seen: list[tuple[float, int]] = []
        self._process = psutil.Process(process.pid)
        self._thread = threading.Thread(target=self._look, args=(process,))
        self._thread.start()

    def _look(self, process: subprocess.Popen[str]) -> None:
        while process.poll() is None:
            total = 0
            with contextlib.suppress(psutil.Error):
                for one in [self._process, *self._process.children(recursive=True)]:
                    with contextlib.suppress(psutil.Error):
                        total += one.memory_info().rss
            self._seen.append((time.monotonic(), total))
            time.sleep(0.25)

    def quarters(self) -> list[float]:
        """MB."""
        self._thread.join()
        if not self._seen:
            return [0.0]
        first, last = self._seen[0][0], self._seen[-1][0]
        most = [0.0] * 4
        for when, size in self._seen:
            quarter = min(3, int(4 * (when - first) / max(last - first, 1e-9)))
            most[quarter] = max(most[quarter], size / 1e6)
        return most


@dataclass
class Timed:
    """A program that ran: its time, s, that of the cores, s, its memory and what it printed."""

    seconds: float
    cores: float
    memory: list[float]
    printed: str


def cores_until_now() -> float:
    """CPU time of all processes that this one started, s."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    total = ended.ru_utime + ended.ru_stime
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            times = process.cpu_times()
            total += times.user + times.system
    return total


def timed(words: list[str], **environment: str) -> Timed:
    """Runs a program."""
    before, begin = cores_until_now(), time.perf_counter()
    process = subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | environment,
    )
    memory = Memory(process)
    out, _ = process.communicate()
    seconds = time.perf_counter() - begin
    # 3: `select` has something to say of the guides.
    if process.returncode not in (0, 3):
        sys.exit(f"{' '.join(words)} ended with {process.returncode}: {out}")
    return Timed(seconds, cores_until_now() - before, memory.quarters(), out)


@contextlib.contextmanager
def engines(names: list[str], directory: Path) -> Iterator[dict[str, list[str]]]:
    """Arguments of `run` for each engine."""
    kinds = {"dask": DaskCluster, "ray": RayCluster}
    with contextlib.ExitStack() as started:
        given: dict[str, list[str]] = {}
        for name in names:
            given[name] = ["--engine", name]
            if name in kinds:
                one = started.enter_context(cluster(kinds[name], directory / name))
                given[name] += ["--address", one.address]
        yield given


def size_of(out: Path) -> int:
    return sum(path.stat().st_size for path in out.glob("data/*.parquet"))


def compute_variants(
    program: Path, given: dict[str, list[str]], directory: Path, arguments: argparse.Namespace
) -> None:
    ways: dict[str, Callable[[int], Timed]] = {
        "select": lambda turn: timed(
            [
                *(str(program), "select", "--application", str(APPLICATION)),
                *("--variants", str(arguments.variants), "--out", str(directory / f"plain{turn}")),
            ],
            RAYON_NUM_THREADS=str(arguments.workers),
        )
    }
    for name, words in given.items():

        def one(turn: int, name: str = name, words: list[str] = words) -> Timed:
            job = variants_job(
                directory,
                f"{name}{turn}",
                application=str(APPLICATION),
                variants=arguments.variants,
                chunk=arguments.chunk,
            )
            more = ["--workers", str(arguments.workers)] if name == "local" else []
            return timed(command("run", job, "--json", *words, *more))

        ways[name] = one
    rounds: dict[str, list[Timed]] = {name: [] for name in ways}
    for turn in range(arguments.rounds):
        for name, way in ways.items():
            rounds[name].append(way(turn))
    print(
        f"{arguments.variants} variants of the fine step, {arguments.workers} cores, chunks of "
        f"{arguments.chunk}, {arguments.rounds} rounds"
    )
    plain = rounds["select"]
    for name, runs in rounds.items():
        time_ratio = statistics.median(
            a.seconds / b.seconds for a, b in zip(runs, plain, strict=True)
        )
        core_ratio = statistics.median(a.cores / b.cores for a, b in zip(runs, plain, strict=True))
        seconds = statistics.median(one.seconds for one in runs)
        each = statistics.median(one.cores for one in runs) / arguments.variants
        quarters = ", ".join(f"{mb:.0f}" for mb in runs[-1].memory)
        what = "with its workers" if name in ("select", "local") else "the run alone"
        of_cores = "" if name == "ray" else f", cores {core_ratio:.3f} ({1e3 * each:.3f} ms each)"
        print(
            f"  {name:6} {seconds:8.1f} s; over select: time {time_ratio:.3f}{of_cores}; memory by "
            f"quarters {quarters} MB ({what})"
        )
    local = directory / f"{next(iter(given))}0"
    print(f"  {size_of(local) / arguments.variants:.1f} bytes for each variant")
    used = timed(command("report", directory / f"{local.name}.yaml"))
    print(f"  report {used.seconds:.1f} s, {used.cores:.1f} s of a core, {max(used.memory):.0f} MB")


def identify_bags(program: Path, directory: Path, arguments: argparse.Namespace) -> None:
    days = len(next(iter(AMPLITUDES.values())))
    bags = write_bags(directory / "machines", CommandLine(program), days)
    found = sorted(path for path in bags.glob("*/*"))
    listed = [str(found[number % len(found)]) for number in range(arguments.bags)]
    job = directory / "machines" / "job.yaml"
    content = {"kind": "bags", "bags": listed, "model": "declared.yaml", "out": "out"}
    # JSON is YAML.
    job.write_text(json.dumps(content))
    words = command("run", job, "--json", "--workers", arguments.workers)
    used = timed(words)
    size = size_of(directory / "machines" / "out")
    memory = ", ".join(f"{mb:.0f}" for mb in used.memory)
    print(
        f"{arguments.bags} bags of 3 s at 1 kHz ({len(found)} different ones), "
        f"{arguments.workers} cores\n"
        f"  {used.seconds:.1f} s, {used.cores / arguments.bags:.2f} s of a core each, "
        f"{3600 * arguments.bags / used.cores:.0f} an hour for each core\n"
        f"  memory by quarters {memory} MB, {size / arguments.bags / 1e3:.1f} kB for each bag"
    )
    manifest = (directory / "machines" / "out" / "manifest.json").stat().st_size
    print(f"  {manifest / arguments.bags:.0f} bytes of the manifest for each bag")
    used = timed(command("report", job))
    print(f"  report {used.seconds:.1f} s, {used.cores:.1f} s of a core, {max(used.memory):.0f} MB")


def lengths(repeats: list[int]) -> None:
    """What longer recordings cost."""
    declared = Model.guide("guide_2")
    effects = [{"cogging": {"amplitude": 5.0, "period": 0.024, "phase": 0.3}}]
    real = Model.from_dict(declared.to_dict() | {"effects": effects})
    controller = Controller(declared, rate=1000.0)
    for repeat in repeats:
        trace = simulate(real, Motion.of_moves(MOVES * repeat), controller=controller)
        train, holdout = parts(trace, 0.4)
        before = time.process_time()
        verdict = identify(declared, train, holdout, threads=1)
        took = time.process_time() - before
        print(f"  a recording of {trace.rows} samples: {took:.2f} s of a core, {verdict.verdict}")


def hand_out(directory: Path, arguments: argparse.Namespace) -> None:
    """What the run itself costs for each chunk: chunks of three variants."""
    chunks = arguments.small_chunks
    job = load_job(variants_job(directory, "small", variants=3 * chunks, chunk=3))
    before, begin = time.process_time(), time.perf_counter()
    run(job, workers=arguments.workers)
    own, seconds = time.process_time() - before, time.perf_counter() - begin
    print(
        f"{chunks} chunks of 3 variants: {1e3 * own / chunks:.2f} ms of a core each in the run, "
        f"{1e3 * seconds * arguments.workers / chunks:.1f} ms of a worker"
    )
    before = time.process_time()
    again = run(job, workers=arguments.workers)
    own = time.process_time() - before
    assert again.computed == ()
    print(f"  {1e3 * own / chunks:.2f} ms of a core each to see that it is done")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path)
    parser.add_argument("--variants", type=int, default=20_000)
    parser.add_argument("--chunk", type=int, default=20_000)
    parser.add_argument("--bags", type=int, default=30)
    parser.add_argument("--small-chunks", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--engines", default="local,dask,ray")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--directory", type=Path, help="where to write, instead of a temporary one")
    given = parser.parse_args()
    names = [name for name in given.engines.split(",") if name]
    with tempfile.TemporaryDirectory(dir=given.directory) as directory:
        if given.variants:
            with engines(names, Path(directory) / "clusters") as started:
                compute_variants(given.program.absolute(), started, Path(directory), given)
        if given.small_chunks:
            hand_out(Path(directory), given)
        if given.bags:
            identify_bags(given.program.absolute(), Path(directory), given)
            lengths([1, 4, 16])


if __name__ == "__main__":
    main()
