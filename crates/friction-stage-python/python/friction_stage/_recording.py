"""Recordings: bags and CSV files."""

from __future__ import annotations

from typing import Any

from . import _native
from ._native import Model
from ._source import Path
from ._trace import Trace


def read_bag(path: Path, *, mapping: Path | None = None) -> Trace:
    """Reads a rosbag2 directory, an MCAP file or a CSV file onto one uniform grid.

    Args:
        path: The recording.
        mapping: Which topic and field, or which column, is which signal: a YAML file, or a string
            that holds it. Without, the topics and columns of friction-stage itself.

    Returns:
        A trace with the columns of numbers, ``valid`` (per row whether position and forces are
        known), ``quality`` (what the samples were like and what was done to them) and
        ``origin_ns``.

    Raises:
        RecordingError: With the place and what would be right.
    """
    columns, rate, quality, origin_ns = _native.read_bag(path, mapping)
    return Trace(columns, rate=rate, quality=quality, origin_ns=origin_ns)


def check(path: Path, *, mapping: Path | None = None, model: Model | None = None) -> dict[str, Any]:
    """What a recording holds, what is wrong with it, and what can be identified from it.

    The JSON of ``friction-stage check --json``.
    """
    return _native.check(path, mapping, model)
