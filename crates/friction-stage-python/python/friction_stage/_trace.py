"""``Trace``: a run as columns of numbers."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._native import Model

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    from matplotlib.axes import Axes

NAMES = (
    "time",
    "reference_position",
    "reference_velocity",
    "reference_acceleration",
    "position",
    "force_cell",
    "force",
)
"""Columns that every trace has."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class MoveResult:
    """How well a move was followed.

    Attributes:
        name: ``conditioning``, ``fast_forward``, ``fast_return``, ``fine_step`` or ``move``.
        start: First instant, s.
        arrival: Instant at which the reference arrives, s.
        target: Reference after the move, m.
        peak_error: Largest error from start to end, m.
        settling: Time after the arrival until the error stays within 10 µm, 1 µm and 0.1 µm, s;
            ``None`` where it stayed outside.
    """

    name: str
    start: float
    arrival: float
    target: float
    peak_error: float
    settling: tuple[float | None, float | None, float | None]


class Trace(Mapping[str, NDArray[Any]]):
    """A run as columns, one row for each sample, in SI units; ``nan`` where a value is missing.

    A mapping from names to numpy arrays; each column is an attribute too (``trace.position``).
    Always there: ``time`` (s, from the first row on), ``reference_position``,
    ``reference_velocity``, ``reference_acceleration``, ``position``, ``force_cell`` and ``force``.
    A simulation adds ``velocity`` (encoder by difference), ``error``, the terms of the controller
    and ``saturated``.

    Attributes:
        rate: Samples per second, Hz.
        moves: What became of each move of the motion of a simulation.
        model: The stage of a simulation or of a run of the laboratory.
        quality: What a recording was like and what was done to it; empty for a simulation.
        origin_ns: Time stamp of the first row on the clock of a recording, ns.
    """

    def __init__(
        self,
        columns: Mapping[str, NDArray[Any]],
        *,
        rate: float,
        moves: tuple[MoveResult, ...] = (),
        quality: Mapping[str, Any] | None = None,
        model: Model | None = None,
        origin_ns: int = 0,
    ) -> None:
        self.origin_ns = origin_ns
        self._columns = dict(columns)
        self.rate = rate
        self.moves = moves
        self.model = model
        self.quality: dict[str, Any] = dict(quality or {})

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns; ``trace.rows`` is the number of rows."""
        return len(self._columns)

    def __getattr__(self, name: str) -> NDArray[Any]:
        # Only for names that are not found otherwise; copying looks for them before there are
        # columns.
        columns = self.__dict__.get("_columns", {})
        if name in columns:
            return columns[name]  # type: ignore[no-any-return]
        raise AttributeError(f"a trace has no {name!r}; it has {', '.join(columns)}")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self._columns["time"])

    @property
    def time(self) -> FloatArray:
        """Time from the first row, s."""
        return self._columns["time"]

    @property
    def position(self) -> FloatArray:
        """Position that the encoder shows, m."""
        return self._columns["position"]

    @property
    def reference_position(self) -> FloatArray:
        """Reference position, m."""
        return self._columns["reference_position"]

    @property
    def force(self) -> FloatArray:
        """Force command, N; that of a row acts until the next row."""
        return self._columns["force"]

    @property
    def force_cell(self) -> FloatArray:
        """Force cell, N; the motor force of the interval that ends with the row."""
        return self._columns["force_cell"]

    @property
    def error(self) -> FloatArray:
        """Reference less position, m."""
        if "error" in self._columns:
            return self._columns["error"]
        return self.reference_position - self.position

    def to_pandas(self) -> pd.DataFrame:
        """The columns as a pandas data frame, without a copy of numbers where pandas allows it."""
        import pandas as pd

        return pd.DataFrame(self._columns, copy=False)

    def to_polars(self) -> pl.DataFrame:
        """The columns as a polars data frame."""
        import polars as pl

        return pl.DataFrame(self._columns)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Writes signals and reference as a CSV file that every command reads; numbers in the
        shortest form that reads back exactly."""
        _native.write_csv(path, {name: self._columns[name] for name in NAMES if name in self})

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draws the position error over time with matplotlib; returns the axes."""
        if axes is None:
            import matplotlib.pyplot as plt

            axes = plt.subplots(layout="constrained")[1]
        axes.plot(self.time, 1e6 * self.error, linewidth=0.8)
        axes.set_xlabel("time, s")
        axes.set_ylabel("position error, µm")
        axes.grid(True, alpha=0.3)
        return axes

    def __repr__(self) -> str:
        return f"<Trace of {self.rows} rows at {self.rate:g} Hz: {', '.join(self._columns)}>"
