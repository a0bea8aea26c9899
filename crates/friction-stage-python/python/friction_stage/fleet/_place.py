"""``Place``: a directory on a disk or in a store, as fsspec knows it.

A file appears whole or not at all: on a disk it is written under another name, then renamed;
stores put whole objects.
"""

from __future__ import annotations

import contextlib
import os
import uuid
from typing import Any

import fsspec  # type: ignore[import-untyped]
from fsspec.implementations.local import LocalFileSystem  # type: ignore[import-untyped]

from .._source import Path

WHOLE_OBJECTS = frozenset(
    {"memory", "s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "oci"}
)
"""Protocols where what is put appears whole, and where a rename is a copy."""


class Place:
    """A directory; ``url`` names it on every machine that sees it."""

    def __init__(self, url: Path) -> None:
        self.fs, self.root = fsspec.core.url_to_fs(os.fspath(url))
        self.url: str = self.fs.unstrip_protocol(self.root)

    @property
    def is_local(self) -> bool:
        """Whether it is on a disk."""
        return isinstance(self.fs, LocalFileSystem)

    def path(self, name: str) -> str:
        """The path of a file in it."""
        return f"{self.root.rstrip('/')}/{name}"

    def read(self, name: str) -> bytes:
        """The content of a file."""
        return bytes(self.fs.cat_file(self.path(name)))

    def size(self, name: str) -> int | None:
        """The size of a file, as it is now; ``None`` where there is none."""
        self.fs.invalidate_cache()
        try:
            return int(self.fs.info(self.path(name))["size"])
        except FileNotFoundError:
            return None

    def write(self, name: str, content: bytes) -> None:
        """Writes a file: whole, or an exception and no file."""
        path = self.path(name)
        if not self.is_local and WHOLE_OBJECTS & set(_protocols(self.fs)):
            self.fs.pipe_file(path, content)
            return
        try:
            self._write_and_rename(path, content)
        except FileNotFoundError:
            # Another run took it for what a killed writer left.
            self._write_and_rename(path, content)

    def _write_and_rename(self, path: str, content: bytes) -> None:
        directory, _, last = path.rpartition("/")
        self.fs.makedirs(directory, exist_ok=True)
        other = f"{directory}/.{last}.{uuid.uuid4().hex}.tmp"
        try:
            if self.is_local:
                with open(other, "xb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
                os.replace(other, path)
            else:
                self.fs.pipe_file(other, content)
                self.fs.mv(other, path)
        except BaseException:
            with contextlib.suppress(OSError):
                self.fs.rm_file(other)
            raise

    def remove(self, name: str) -> None:
        """Removes a file, if there is one."""
        with contextlib.suppress(FileNotFoundError):
            self.fs.rm_file(self.path(name))

    def names(self, directory: str) -> list[str]:
        """Names of the files in a directory of it, in order; half-written ones are none."""
        self.fs.invalidate_cache()
        try:
            found: list[Any] = self.fs.ls(self.path(directory), detail=False)
        except FileNotFoundError:
            return []
        names = (str(path).rstrip("/").rpartition("/")[2] for path in found)
        return sorted(name for name in names if not name.startswith("."))

    def remove_half_written(self, directory: str) -> None:
        """Removes what killed writers left."""
        if not self.is_local:
            return
        with contextlib.suppress(FileNotFoundError):
            for path in self.fs.ls(self.path(directory), detail=False):
                name = str(path).rpartition("/")[2]
                if name.startswith(".") and name.endswith(".tmp"):
                    self.remove(f"{directory}/{name}")


def _protocols(fs: Any) -> tuple[str, ...]:
    protocol = fs.protocol
    return (protocol,) if isinstance(protocol, str) else tuple(protocol)
