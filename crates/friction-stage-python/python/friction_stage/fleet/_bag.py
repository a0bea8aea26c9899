"""Recordings of a fleet: which there are, what tells one from another, and a copy to read."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import fsspec  # type: ignore[import-untyped]
from fsspec.implementations.local import LocalFileSystem  # type: ignore[import-untyped]

from ..errors import RecordingError

ENDINGS = (".mcap", ".db3", ".csv", ".tsv", ".mat", ".npz", ".npy")
"""Of files that are recordings by themselves."""
WHOLE = 16 << 20
"""Files up to this size are read whole for a fingerprint; of larger ones the ends, bytes."""
END = 1 << 20
"""Of a large file: so much of its beginning and of its end, bytes."""


def find(where: str) -> list[str]:
    """URLs of the recordings below a directory, or that a glob names, in order.

    Raises:
        RecordingError: There is none.
    """
    fs, path = fsspec.core.url_to_fs(where)
    if any(mark in path for mark in "*?["):
        found = {p for p in fs.glob(path) if fs.isdir(p) or p.endswith(ENDINGS)}
        # What lies in a bag that is named itself is no recording of its own.
        bags = {p for p in found if p.rpartition("/")[0] not in found}
    elif not fs.isdir(path):
        bags = {path} if fs.exists(path) else set()
    else:
        files = [str(p) for p in fs.find(path)]
        whole = {p.rpartition("/")[0] for p in files if p.endswith("/metadata.yaml")}
        alone = {p for p in files if p.endswith(ENDINGS) and p.rpartition("/")[0] not in whole}
        bags = whole | alone
    if not bags:
        raise RecordingError(
            f"no recording in {where}: directories with a metadata.yaml, "
            f"or files that end in {', '.join(ENDINGS)}"
        )
    return sorted(fs.unstrip_protocol(bag) for bag in bags)


def machine_of(url: str) -> str:
    """The directory that a recording is in, which is named after its machine."""
    return url.rstrip("/").rpartition("/")[0].rpartition("/")[2] or "machine"


def _files(fs: Any, path: str) -> list[str]:
    return sorted(fs.find(path)) if fs.isdir(path) else [path]


def fingerprint(url: str) -> str:
    """SHA-256 over names, sizes and content of the files of a recording, or over the ends of large
    ones."""
    fs, path = fsspec.core.url_to_fs(url)
    sha = hashlib.sha256()
    for file in _files(fs, path):
        size = fs.size(file)
        sha.update(f"{file[len(path) :]}\0{size}\0".encode())
        if size <= WHOLE:
            sha.update(fs.cat_file(file))
        else:
            sha.update(fs.cat_file(file, 0, END))
            sha.update(fs.cat_file(file, size - END, size))
    return sha.hexdigest()


def fetch(url: str, copy: Path) -> tuple[str, str]:
    """A path of this machine where the recording is, and the SHA-256 of all its content.

    Raises:
        RecordingError: It is not there, or cannot be copied.
    """
    fs, path = fsspec.core.url_to_fs(url)
    if not fs.exists(path):
        raise RecordingError(f"there is no recording {url}")
    local = path
    if not isinstance(fs, LocalFileSystem):
        local = f"{copy}/{path.rstrip('/').rpartition('/')[2]}"
        copy.mkdir(parents=True)
        fs.get(path, local, recursive=fs.isdir(path))
    sha = hashlib.sha256()
    here = fsspec.filesystem("file")
    for file in _files(here, local):
        with open(file, "rb") as content:
            while block := content.read(1 << 20):
                sha.update(block)
    return local, sha.hexdigest()
