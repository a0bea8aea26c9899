"""The run: gives open chunks to an engine, takes in what became of them, and can be stopped,
killed and started again at any time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from .._native import Controller, Model, Motion
from .._source import Path, Progress
from ..errors import FleetError, OtherJobError
from ._chunk import Outcome, StoppedError, compute, note_failure
from ._dataset import DATA, file_name
from ._engine import Engine, engine_of
from ._job import CHUNK, HOLDOUT_SHARE, AnyBag, BagsJob, Job, SweepJob, VariantsJob
from ._manifest import MANIFEST, Manifest, states
from ._place import Place

ATTEMPTS = 3
"""How often a chunk is given to an engine whose workers are lost with it."""
AHEAD = 2
"""Chunks that an engine has for each that it computes, so that no worker waits for the run."""
LOOK = 0.2
"""Time between two looks whether to stop, s."""


@dataclass(frozen=True)
class FleetResult:
    """What became of a job.

    Attributes:
        out: URL of the results.
        kind: ``variants``, ``sweep`` or ``bags``.
        chunks: How many there are.
        done: How many are there, those of runs before included.
        computed: Chunks of this run.
        rows: In the data set.
        failed: Reason of each chunk that could not be computed.
        stopped: The run was asked to stop; the rest is open.
        seconds: Of this run.
        core_seconds: Of the chunks of this run, together.
    """

    out: str
    kind: str
    chunks: int
    done: int
    computed: tuple[int, ...]
    rows: int
    failed: Mapping[int, str]
    stopped: bool
    seconds: float
    core_seconds: float

    @property
    def is_complete(self) -> bool:
        """Whether every chunk is there."""
        return self.done == self.chunks

    def to_dict(self) -> dict[str, Any]:
        """As ``--json`` prints it."""
        return {
            "out": self.out,
            "kind": self.kind,
            "chunks": self.chunks,
            "done": self.done,
            "computed": len(self.computed),
            "rows": self.rows,
            "failed": {str(index): reason for index, reason in self.failed.items()},
            "stopped": self.stopped,
            "seconds": self.seconds,
            "core_seconds": self.core_seconds,
        }


def prepare(job: Job) -> tuple[Manifest, Place]:
    """The manifest of a job, written where there is none.

    Raises:
        FleetError: The results are of another job or of another version; with what differs.
    """
    manifest, place = job.plan(), Place(job.out)
    found = Manifest.load(place)
    if found is None:
        manifest.write(place)
        return manifest, place
    _refuse(place, found.differences(manifest))
    return found, place


def _refuse(place: Place, differences: Sequence[str]) -> None:
    if differences:
        raise OtherJobError(
            f"{place.url}/{MANIFEST} is of another job or version: {'; '.join(differences)}; "
            "take another directory, or continue with what it was begun with"
        )


def run(
    job: Job,
    *,
    engine: str | Executor = "local",
    address: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetResult:
    """Computes the chunks of a job that are not there.

    Args:
        job: What is to be computed.
        engine: ``local`` (processes of this machine), ``dask``, ``ray``, or anything that is a
            ``concurrent.futures.Executor``.
        address: Of the scheduler of Dask or of the cluster of Ray.
        workers: How many; without, one for each core that this process may use.
        progress: Called with a line and the share that is done. Where it returns ``False``, the
            run stops; what is done is kept.

    Raises:
        FleetError: The job cannot be run as it is given, or the results are not of this job.
    """
    manifest, place = prepare(job)
    started = engine_of(engine, address=address, workers=workers)
    return _Run(manifest, place, started, progress).through()


class _Run:
    def __init__(
        self, manifest: Manifest, place: Place, engine: Engine, progress: Progress | None
    ) -> None:
        self.manifest = manifest
        self.place = place
        self.engine = engine
        self.progress = progress
        before = states(manifest, place)
        self.done: dict[int, int] = dict(before.done)
        self.failed: dict[int, str] = dict(before.foreign)
        chunks = range(len(manifest.chunks))
        self.open: deque[int] = deque(i for i in chunks if i not in self.done | self.failed)
        self.running: dict[Future[Outcome], int] = {}
        self.ended: SimpleQueue[Future[Outcome]] = SimpleQueue()
        self.attempts: dict[int, int] = {}
        # Chunks with which a worker was lost twice: each runs by itself, to see which one it is.
        self.suspects: deque[int] = deque()
        self.computed: list[int] = []
        self.core_seconds = 0.0

    def through(self) -> FleetResult:
        begin = time.perf_counter()
        stopped = True
        try:
            goes_on = self._tell()
            while goes_on and (self.open or self.suspects or self.running):
                self._give()
                lost = [future for future in self._ended() if self._take(future)]
                if lost:
                    self._recover(lost)
                goes_on = self._tell()
            stopped = bool(self.open or self.suspects or self.running)
        finally:
            for future in self.running:
                future.cancel()
            self.engine.close(stopped)
        self.place.remove_half_written(DATA)
        return FleetResult(
            out=self.place.url,
            kind=self.manifest.kind,
            chunks=len(self.manifest.chunks),
            done=len(self.done),
            computed=tuple(sorted(self.computed)),
            rows=sum(self.done.values()),
            failed=dict(sorted(self.failed.items())),
            stopped=stopped,
            seconds=time.perf_counter() - begin,
            core_seconds=self.core_seconds,
        )

    def _ended(self) -> Iterator[Future[Outcome]]:
        """What has ended of what runs; waits a moment for the first."""
        try:
            future = self.ended.get(timeout=LOOK)
            while True:
                # Others were given up with an engine that broke.
                if future in self.running:
                    yield future
                future = self.ended.get_nowait()
        except Empty:
            return

    def _tell(self) -> bool:
        if self.progress is None:
            return True
        all_of_them = len(self.manifest.chunks)
        line = f"{len(self.done)} of {all_of_them} chunks"
        if self.failed:
            line += f", {len(self.failed)} failed"
        share = (len(self.done) + len(self.failed)) / all_of_them
        return self.progress(line, share) is not False

    def _give(self) -> None:
        """Keeps the engine busy."""
        if self.suspects and not self.open:
            if not self.running:
                self._submit(self.suspects.popleft())
            return
        most = max(1, self.engine.slots() * AHEAD)
        while self.open and len(self.running) < most:
            self._submit(self.open.popleft())

    def _submit(self, index: int) -> None:
        try:
            future = self.engine.submit(compute, self.manifest.task(index, self.place))
        except BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        self.running[future] = index
        future.add_done_callback(self.ended.put)

    def _take(self, future: Future[Outcome]) -> bool:
        """Takes in what became of a chunk; whether it was lost with its worker."""
        try:
            outcome = future.result()
        except (Exception, CancelledError) as error:
            if isinstance(error, StoppedError):
                raise FleetError("a worker was asked to stop by another run") from error
            return True
        index = self.running.pop(future)
        self.core_seconds += outcome.seconds
        if outcome.reason is not None:
            self.failed[index] = outcome.reason
        elif (size := self.place.size(file_name(index))) != outcome.size:
            self._fail(
                index,
                f"worker {outcome.worker} wrote {outcome.size} bytes of {file_name(index)}, here "
                f"are {'none' if size is None else size}: {self.place.url} must be the same place "
                "for all machines",
            )
        else:
            self.done[index] = outcome.rows
            self.computed.append(index)
        return False

    def _recover(self, lost: Sequence[Future[Outcome]]) -> None:
        """Gives chunks that were lost with their workers to others."""
        broke = False
        for future in lost:
            error = future.exception() if not future.cancelled() else CancelledError()
            broke |= isinstance(error, BrokenExecutor)
            index = self.running.pop(future)
            reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
            self._lost(index, " ".join(reason.split()))
        if broke:
            # Whatever else it had is lost as well.
            for future, index in list(self.running.items()):
                future.cancel()
                self._lost(index, "its worker ended")
            self.running.clear()
            self.engine.renew()

    def _lost(self, index: int, why: str) -> None:
        attempts = self.attempts[index] = self.attempts.get(index, 0) + 1
        if attempts >= ATTEMPTS:
            self._fail(index, f"no worker could compute it, {attempts} times: {why}")
        elif attempts == ATTEMPTS - 1:
            self.suspects.append(index)
        else:
            self.open.appendleft(index)

    def _fail(self, index: int, reason: str) -> None:
        self.failed[index] = reason
        note_failure(self.place, index, reason)


def map_variants(
    application: Path | Mapping[str, Any],
    out: Path,
    *,
    variants: int,
    seed: int = 1,
    catalogues: Sequence[Path] = (),
    guides: Sequence[str] = (),
    sweep: Mapping[str, Sequence[float]] | None = None,
    chunk: int = CHUNK,
    engine: str | Executor = "local",
    address: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetResult:
    """Computes variants of a stage into a data set: ``select``, as large as one likes.

    The arguments are those of ``VariantsJob`` and of ``run``.

    Raises:
        FleetError, SelectionError, ModelError: With what is wrong.
    """
    job = VariantsJob(
        application, out, variants, seed, catalogues, guides, dict(sweep or {}), chunk
    )
    return run(job, engine=engine, address=address, workers=workers, progress=progress)


def map_sweep(
    model: Path | Model,
    axes: Mapping[str, str | Sequence[float | str | bool]],
    out: Path,
    *,
    motion: Motion | str = "fine-step",
    controller: Controller | None = None,
    samples: int | None = None,
    seed: int = 1,
    chunk: int = CHUNK,
    engine: str | Executor = "local",
    address: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetResult:
    """Computes the points of a sweep into a data set: ``sweep``, as large as one likes.

    The arguments are those of ``SweepJob`` and of ``run``.

    Raises:
        FleetError, SweepError, ModelError: With what is wrong.
    """
    job = SweepJob(model, dict(axes), out, motion, controller, samples, seed, chunk)
    return run(job, engine=engine, address=address, workers=workers, progress=progress)


def identify_bags(
    bags: Path | Sequence[AnyBag],
    out: Path,
    *,
    model: Path | Model | None = None,
    mapping: Path | None = None,
    holdout_share: float = HOLDOUT_SHARE,
    mass_tolerance: float | None = None,
    guide_tolerance: float | None = None,
    presliding_tolerance: float | None = None,
    engine: str | Executor = "local",
    address: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetResult:
    """Identifies recordings into a data set: ``identify``, for as many as there are.

    The arguments are those of ``BagsJob`` and of ``run``.

    Raises:
        FleetError, RecordingError, ModelError: With what is wrong.
    """
    job = BagsJob(
        bags,
        out,
        model,
        mapping,
        holdout_share,
        mass_tolerance,
        guide_tolerance,
        presliding_tolerance,
    )
    return run(job, engine=engine, address=address, workers=workers, progress=progress)


def status(job: Job) -> FleetResult:
    """What became of a job so far, without computing anything.

    Raises:
        FleetError: There are no results, or they cannot be read.
    """
    place = Place(job.out)
    manifest = Manifest.load(place)
    if manifest is None:
        raise FleetError(f"{place.url} has no {MANIFEST}: nothing was begun there")
    found = states(manifest, place)
    return FleetResult(
        out=place.url,
        kind=manifest.kind,
        chunks=len(manifest.chunks),
        done=len(found.done),
        computed=(),
        rows=sum(found.done.values()),
        failed=dict(sorted((found.failed | found.foreign).items())),
        stopped=False,
        seconds=0.0,
        core_seconds=0.0,
    )


def run_share(job: Job, index: int, tasks: int | None = None) -> FleetResult:
    """Computes one chunk in this process, or every chunk of one of ``tasks`` tasks: what a job
    array of Slurm or of Kubernetes calls.

    The manifest is that of the results, where there is one.

    Raises:
        FleetError: With what is wrong.
    """
    place = Place(job.out)
    manifest = Manifest.load(place)
    if manifest is None:
        manifest, place = prepare(job)
    else:
        # Not the bags: each chunk looks at its own.
        _refuse(place, manifest.differences(job.plan(chunks=False), chunks=False))
    begin = time.perf_counter()
    all_of_them = len(manifest.chunks)
    last = (all_of_them if tasks is None else tasks) - 1
    if tasks is not None and tasks < 1:
        raise FleetError(f"tasks is {tasks}, must be at least 1")
    if not 0 <= index <= last:
        raise FleetError(f"index is {index}, must be 0 to {last}")
    mine = range(index, all_of_them, tasks or all_of_them)
    before = states(manifest, place, mine)
    computed, failed, rows, seconds = [], {}, 0, 0.0
    for chunk in mine:
        if chunk in before.foreign:
            failed[chunk] = before.foreign[chunk]
        if chunk in before.done or chunk in before.foreign:
            rows += before.done.get(chunk, 0)
            continue
        outcome = compute(manifest.task(chunk, place))
        seconds += outcome.seconds
        if outcome.reason is None:
            computed.append(chunk)
            rows += outcome.rows
        else:
            failed[chunk] = outcome.reason
    return FleetResult(
        out=place.url,
        kind=manifest.kind,
        chunks=len(mine),
        done=len(mine) - len(failed),
        computed=tuple(computed),
        rows=rows,
        failed=failed,
        stopped=False,
        seconds=time.perf_counter() - begin,
        core_seconds=seconds,
    )
