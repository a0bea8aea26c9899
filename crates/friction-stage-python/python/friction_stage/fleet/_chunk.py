"""The function that the engines spread: computes a chunk and writes its file.

It depends on its task alone, so that a chunk that is computed twice writes the same bytes.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import _native
from .._identification import Verdict, identify
from .._native import Model
from .._recording import read_bag
from .._trace import NAMES, Trace
from ..errors import FrictionStageError
from . import _bag
from ._dataset import bag_table, file_name, sweep_table, to_bytes, variants_table
from ._manifest import Task, failed_name
from ._place import Place


@dataclass(frozen=True)
class Outcome:
    """What became of a chunk.

    Attributes:
        index: Of the chunk.
        rows: In its file.
        size: Of its file, bytes.
        reason: Why it failed; ``None`` if it is done.
        seconds: How long it took.
        worker: Who computed it.
    """

    index: int
    rows: int
    size: int
    reason: str | None
    seconds: float
    worker: str


class StoppedError(Exception):
    """The run was asked to stop."""


stopped: Callable[[], bool] = lambda: False  # noqa: E731
"""Whether the run was asked to stop; the engine of this machine sets it in its workers."""


def _look(what: str, share: float) -> None:
    if stopped():
        raise StoppedError


def compute(task: Task) -> Outcome:
    """Computes a chunk and writes its file, or the file that says why it failed."""
    # Here, so that a worker reads its version when it works.
    from .. import __version__

    begin = time.perf_counter()
    worker = f"{socket.gethostname()}:{os.getpid()}"
    place = Place(task.out)
    rows = size = 0
    reason = None
    try:
        if __version__ != task.version:
            raise FrictionStageError(
                f"worker {worker} has friction_stage {__version__}, "
                f"the manifest is of {task.version}"
            )
        table = TABLES[task.kind](task)
        content = to_bytes(table, task.fingerprint, task.index)
        try:
            place.write(file_name(task.index), content)
        except OSError as error:
            raise FrictionStageError(
                f"cannot write {place.url}/{file_name(task.index)}: {error.strerror or error}"
            ) from error
        rows, size = table.num_rows, len(content)
    except (FrictionStageError, OSError, MemoryError, ValueError) as error:
        reason = f"{error}" or type(error).__name__
        note_failure(place, task.index, reason)
    else:
        with contextlib.suppress(OSError):
            place.remove(failed_name(task.index))
    return Outcome(task.index, rows, size, reason, time.perf_counter() - begin, worker)


def note_failure(place: Place, index: int, reason: str) -> None:
    """Writes why a chunk failed; where even that cannot be written, the run alone says it."""
    text = json.dumps({"chunk": index, "reason": reason}, indent=1) + "\n"
    with contextlib.suppress(OSError):
        place.write(failed_name(index), text.encode())


def _variants(task: Task) -> Any:
    settings, chunk = task.settings, task.chunk
    plan = plan_of(settings, task.texts, chunk["point"])
    first = int(chunk["first"])
    columns = plan.run(first, first + int(chunk["count"]), 1, _look)
    return variants_table(columns, plan.guides, settings["points"][chunk["point"]]["values"])


def _swept(task: Task) -> Any:
    plan = sweep_plan_of(task.settings, task.texts)
    first = int(task.chunk["first"])
    return sweep_table(plan.run(first, first + int(task.chunk["count"]), 1, _look))


def sweep_plan_of(settings: Mapping[str, Any], texts: Mapping[str, str]) -> _native.SweepPlan:
    """What is computed by a sweep."""
    return _native.SweepPlan.from_json(texts[settings["plan"]])


def plan_of(settings: Mapping[str, Any], texts: Mapping[str, str], point: int) -> _native.Plan:
    """What is computed at a point of a sweep."""
    return _native.Plan(
        texts[settings["points"][point]["application"]],
        [texts[sha] for sha in settings["catalogues"]],
        settings["guides"],
        settings["seed"],
        settings["variants"],
    )


def _identified(task: Task) -> Any:
    settings, chunk = task.settings, task.chunk
    mapping = None if settings["mapping"] is None else task.texts[settings["mapping"]]
    model = Model.from_yaml(task.texts[chunk["model"]])
    sha256 = ""
    with tempfile.TemporaryDirectory(prefix="friction_stage_") as directory:
        copies: dict[str, str] = {}
        for side in ("bag", "holdout"):
            if chunk[side] is None:
                continue
            copies[side], sha = _bag.fetch(chunk[side], Path(directory) / side)
            sha256 = sha256 or sha
            said = chunk["sha256"][side]
            if said is not None and _bag.fingerprint(copies[side]) != said:
                raise FrictionStageError(
                    f"{chunk[side]} is not the recording that the manifest names: it was changed"
                )
        try:
            run = read_bag(copies["bag"], mapping=mapping)
            train: Any = copies["bag"]
            holdout: Any = copies.get("holdout")
            if holdout is None:
                train, holdout = parts(run, settings["holdout_share"])
            verdict = identify(
                model,
                train,
                holdout,
                mapping=mapping,
                mass_tolerance=settings["mass_tolerance"],
                guide_tolerance=settings["guide_tolerance"],
                presliding_tolerance=settings["presliding_tolerance"],
                threads=1,
                progress=_look,
            )
        except FrictionStageError as error:
            # A copy in a temporary directory has a name that the user does not know.
            message = str(error)
            for side, copy in copies.items():
                message = message.replace(copy, chunk[side])
            raise type(error)(message) from error
    recorded = chunk["recorded"]
    if recorded is None and run.origin_ns > 0:
        recorded = run.origin_ns * 1e-9
    return bag_table(_row(chunk, recorded, sha256, verdict))


def parts(run: Trace, holdout_share: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """A recording as what is fitted and, after it, what is held out."""
    cut = round(run.rows * (1.0 - holdout_share))
    sides = []
    for rows in (slice(0, cut), slice(cut, run.rows)):
        known = {name: np.ascontiguousarray(run[name][rows]) for name in NAMES if name in run}
        sides.append({n: v for n, v in known.items() if not np.isnan(v).all()})
    return sides[0], sides[1]


def _row(
    chunk: Mapping[str, Any], recorded: float | None, sha256: str, verdict: Verdict
) -> dict[str, Any]:
    errors = verdict.errors
    owners = [("declared", verdict.declared_parameters)]
    owners += [(effect.name, effect.parameters) for effect in verdict.effects]
    parameters = [
        {
            "owner": owner,
            "name": name,
            "value": found.value,
            "unit": found.unit,
            "low": None if found.ci95 is None else found.ci95[0],
            "high": None if found.ci95 is None else found.ci95[1],
        }
        for owner, of_owner in owners
        for name, found in sorted(of_owner.items())
    ]
    row: dict[str, Any] = {
        "bag": chunk["bag"],
        "machine": chunk["machine"],
        "recorded_s": recorded,
        "sha256": sha256,
        "verdict": verdict.verdict,
        "effects": [effect.name for effect in verdict.effects],
        "explained_share": verdict.explained_share,
        "parameters": parameters,
        "warnings": verdict.warnings,
        "model": verdict.model.to_yaml(),
        "summary": json.dumps(verdict.summary, sort_keys=True),
    }
    for record in ("train", "holdout"):
        for when in ("before", "after"):
            row[f"{record}_force_rms_{when}"] = errors[record]["force_rms"][when]
    return row


TABLES: dict[str, Callable[[Task], Any]] = {
    "variants": _variants,
    "sweep": _swept,
    "bags": _identified,
}
"""What computes a chunk of each kind of job."""
