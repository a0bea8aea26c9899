"""``Manifest``: what is to be computed, in chunks, and from which inputs.

It is written once, before the first chunk, and holds all that a chunk needs but its bag: whoever
has it can compute any chunk, on any engine. The state of a chunk is its file: in ``data`` for one
that is done, in ``failed`` for one that could not be computed, with its reason. So there is no
second place that could say otherwise, and no file that two machines write at once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..errors import FleetError
from ._dataset import DATA, file_name, whose
from ._place import Place

MANIFEST = "manifest.json"
FAILED = "failed"
SCHEMA_VERSION = 1
READERS = 16
"""Files of a store that are looked at together."""


def digest(content: bytes) -> str:
    """SHA-256 of it."""
    return hashlib.sha256(content).hexdigest()


def failed_name(index: int) -> str:
    """The file that says why a chunk failed."""
    return f"{FAILED}/chunk-{index:08}.json"


@dataclass(frozen=True)
class Task:
    """A chunk, with all that a worker needs.

    Attributes:
        index: Of the chunk.
        out: URL of the results.
        version: Of ``friction_stage`` that the worker must have.
        fingerprint: Of the manifest.
        kind: ``variants``, ``sweep`` or ``bags``.
        settings: What all chunks of the job share.
        chunk: What is this chunk's own.
        texts: Texts that it needs, by their SHA-256.
    """

    index: int
    out: str
    version: str
    fingerprint: str
    kind: str
    settings: Mapping[str, Any]
    chunk: Mapping[str, Any]
    texts: Mapping[str, str]


@dataclass(frozen=True)
class Manifest:
    """A job as it is computed.

    Attributes:
        kind: ``variants``, ``sweep`` or ``bags``.
        version: Of ``friction_stage``.
        settings: What all chunks share: numbers, and texts by their SHA-256.
        inputs: SHA-256 of each input by its name, for people.
        chunks: What each chunk is.
        texts: Application, catalogues, models and mapping, by their SHA-256.
    """

    kind: str
    version: str
    settings: dict[str, Any]
    inputs: dict[str, str]
    chunks: list[dict[str, Any]]
    texts: dict[str, str]

    def _content(self) -> dict[str, Any]:
        return {
            "schema_version": SCHEMA_VERSION,
            "kind": self.kind,
            "friction_stage": self.version,
            "settings": self.settings,
            "inputs": self.inputs,
            "chunks": self.chunks,
            "texts": self.texts,
        }

    @cached_property
    def fingerprint(self) -> str:
        """What tells results of this job from those of any other."""
        said = {key: value for key, value in self._content().items() if key != "inputs"}
        return digest(json.dumps(said, sort_keys=True).encode())

    def write(self, place: Place) -> None:
        """Writes it; the same job gives the same bytes."""
        content = {"fingerprint": self.fingerprint} | self._content()
        place.write(MANIFEST, (json.dumps(content, indent=1) + "\n").encode())

    @staticmethod
    def load(place: Place) -> Manifest | None:
        """The manifest of results; ``None`` where there are none.

        Raises:
            FleetError: It cannot be read, or is not what was written.
        """
        where = f"{place.url}/{MANIFEST}"
        try:
            text = place.read(MANIFEST)
        except FileNotFoundError:
            return None
        try:
            content = json.loads(text)
            if content["schema_version"] != SCHEMA_VERSION:
                raise FleetError(
                    f"{where} has schema version {content['schema_version']}, "
                    f"this friction_stage knows {SCHEMA_VERSION}"
                )
            found = Manifest(
                kind=content["kind"],
                version=content["friction_stage"],
                settings=content["settings"],
                inputs=content["inputs"],
                chunks=content["chunks"],
                texts=content["texts"],
            )
            whole = content["fingerprint"] == found.fingerprint
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if isinstance(error, FleetError):
                raise
            raise FleetError(f"{where} is not the manifest of a fleet: {error!r}") from error
        if not whole:
            raise FleetError(f"{where} was changed: its fingerprint is not that of its content")
        return found

    def task(self, index: int, place: Place) -> Task:
        """What a worker computes for a chunk."""
        chunk = self.chunks[index]
        needed = {key for key in _strings([self.settings, chunk]) if key in self.texts}
        return Task(
            index=index,
            out=place.url,
            version=self.version,
            fingerprint=self.fingerprint,
            kind=self.kind,
            settings=self.settings,
            chunk=chunk,
            texts={key: self.texts[key] for key in sorted(needed)},
        )

    def differences(self, other: Manifest, chunks: bool = True) -> list[str]:
        """What another one has otherwise, in words: of this one, then of the other.

        Args:
            other: The other one.
            chunks: Whether the chunks are compared, too.
        """
        differences: list[str] = []

        def compare(what: str, own: object, its: object) -> None:
            if own != its:
                differences.append(f"{what} is {_short(own)}, not {_short(its)}")

        compare("kind", self.kind, other.kind)
        compare("version of friction_stage", self.version, other.version)
        for key in sorted(self.settings.keys() | other.settings.keys()):
            own, its = self.settings.get(key), other.settings.get(key)
            compare(key, self._named(own), other._named(its))
        if not chunks:
            return differences
        if len(self.chunks) != len(other.chunks):
            compare("number of chunks", len(self.chunks), len(other.chunks))
        elif self.chunks != other.chunks:
            changed = [
                (index, own, its)
                for index, (own, its) in enumerate(zip(self.chunks, other.chunks, strict=True))
                if own != its
            ]
            index, own, its = changed[0]
            keys = [key for key in own.keys() | its.keys() if own.get(key) != its.get(key)]
            name = its.get("bag", f"chunk {index}")
            for key in sorted(keys):
                compare(f"{key} of {name}", self._named(own.get(key)), other._named(its.get(key)))
            if len(changed) > 1:
                differences.append(f"{len(changed) - 1} more chunks differ")
        return differences

    def _named(self, value: object) -> object:
        """A text by the name of the input that it came from."""
        if isinstance(value, list):
            return [self._named(one) for one in value]
        names = {sha: name for name, sha in self.inputs.items()}
        if isinstance(value, str) and value in names:
            return f"{names[value]} (SHA-256 {value[:12]}...)"
        return value


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False, sort_keys=True)
    return text if len(text) <= 120 else text[:117] + "..."


def _strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _strings(one)
    elif isinstance(value, (list, tuple)):
        for one in value:
            yield from _strings(one)


@dataclass(frozen=True)
class States:
    """What became of the chunks so far.

    Attributes:
        done: Rows of each chunk that is there.
        failed: Reason of each chunk that could not be computed.
        foreign: Reason for each file that is in the place of a chunk and is none of it.
    """

    done: dict[int, int]
    failed: dict[int, str]
    foreign: dict[int, str]


def states(manifest: Manifest, place: Place, chunks: range | None = None) -> States:
    """Looks at the files of the chunks, or of some of them."""
    wanted = range(len(manifest.chunks)) if chunks is None else chunks
    indices = {file_name(index): index for index in wanted}
    present = [
        indices[name] for name in (f"{DATA}/{n}" for n in place.names(DATA)) if name in indices
    ]
    fingerprint = manifest.fingerprint

    def look(index: int) -> tuple[int, int | str | None]:
        try:
            with place.fs.open(place.path(file_name(index)), "rb") as file:
                said, number, rows = whose(file)
        except FleetError:
            # Cut off or damaged: it is computed again.
            return index, None
        except OSError as error:
            return index, f"cannot read {file_name(index)}: {error}"
        if (said, number) != (fingerprint, index):
            return index, (
                f"{file_name(index)} is of another job: its fingerprint is {said[:12]}..., "
                f"that of this job {fingerprint[:12]}...; move it away"
            )
        return index, rows

    with ThreadPoolExecutor(READERS) as readers:
        looked = list(readers.map(look, present))
    failed: dict[int, str] = {}
    numbers = {failed_name(index): index for index in wanted}
    for name in place.names(FAILED):
        index = numbers.get(f"{FAILED}/{name}", -1)
        if index < 0:
            continue
        try:
            failed[index] = str(json.loads(place.read(f"{FAILED}/{name}"))["reason"])
        except (OSError, ValueError, KeyError, TypeError):
            failed[index] = f"{FAILED}/{name} cannot be read"
    done = {index: found for index, found in looked if isinstance(found, int)}
    return States(
        done=done,
        failed={index: reason for index, reason in failed.items() if index not in done},
        foreign={index: found for index, found in looked if isinstance(found, str)},
    )
