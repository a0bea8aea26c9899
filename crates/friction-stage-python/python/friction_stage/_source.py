"""What recordings are given as: files, traces, data frames or arrays."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._trace import NAMES, Trace
from .errors import RecordingError

Path: TypeAlias = "str | os.PathLike[str]"
Progress: TypeAlias = Callable[[str, float], "bool | None"]


@runtime_checkable
class Frame(Protocol):
    """A data frame of pandas, polars or the like."""

    @property
    def columns(self) -> Any: ...

    def __getitem__(self, name: Any, /) -> Any: ...


Recording: TypeAlias = "Path | Trace | Mapping[str, ArrayLike] | Frame"
NativeSource: TypeAlias = "Path | tuple[str, dict[str, NDArray[np.float64]]]"


def native(source: Recording, name: str) -> NativeSource:
    """A recording as the Rust part takes it; ``name`` stands for columns in messages."""
    if isinstance(source, (str, os.PathLike)):
        return source
    present = list(source) if isinstance(source, Mapping) else list(source.columns)
    if "time" not in present or "position" not in present:
        missing = "time" if "time" not in present else "position"
        raise RecordingError(
            f"{name} has no column {missing!r}; it has {', '.join(map(str, present)) or 'none'}, "
            f"known names are {', '.join(NAMES)}"
        )
    return name, {
        column: _numbers(source[column], name, column) for column in NAMES if column in present
    }


def natives(sources: Recording | Sequence[Recording], name: str) -> list[NativeSource]:
    """One recording or several of them."""
    if isinstance(sources, (list, tuple)):
        return [native(source, f"{name}[{index}]") for index, source in enumerate(sources)]
    return [native(sources, name)]  # type: ignore[arg-type]


def _numbers(values: Any, name: str, column: str) -> NDArray[np.float64]:
    try:
        numbers = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{name}: column {column!r} is not of numbers: {error}") from error
    if numbers.ndim != 1:
        raise RecordingError(
            f"{name}: column {column!r} has {numbers.ndim} dimensions, must have one"
        )
    return numbers
