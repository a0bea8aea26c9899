"""``sweep``: a stage over the values of its keys."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._native import Controller, Model, Motion
from ._source import Progress

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


class Sweep:
    """How well a motion was followed at every point.

    Attributes:
        summary: Everything, as in ``summary.json`` of ``friction-stage sweep``.
        points: The points as columns, as in ``points.csv``.
    """

    def __init__(self, columns: Mapping[str, Any], summary_json: str, text: str) -> None:
        self._text = text
        self.summary: dict[str, Any] = json.loads(summary_json)
        self.points: dict[str, NDArray[Any]] = {
            name: np.asarray(values, dtype=np.str_) if isinstance(values, list) else values
            for name, values in columns.items()
        }

    def __getitem__(self, column: str) -> NDArray[Any]:
        return self.points[column]

    def __len__(self) -> int:
        return int(self.summary["points"])

    def to_pandas(self) -> pd.DataFrame:
        """The points as a pandas data frame."""
        import pandas as pd

        return pd.DataFrame(self.points)

    def to_polars(self) -> pl.DataFrame:
        """The points as a polars data frame."""
        import polars as pl

        return pl.DataFrame(self.points)

    def __str__(self) -> str:
        return self._text

    def __repr__(self) -> str:
        keys = ", ".join(axis["key"] for axis in self.summary["axes"])
        return f"<Sweep of {len(self)} points over {keys}>"


def given_axes(
    axes: Mapping[str, str | Sequence[float | str | bool] | NDArray[Any]],
) -> list[tuple[str, str | list[Any]]]:
    """The axes as the native code takes them."""
    return [
        (key, values if isinstance(values, str) else np.asarray(values).tolist())
        for key, values in axes.items()
    ]


def sweep(
    model: Model,
    axes: Mapping[str, str | Sequence[float | str | bool] | NDArray[Any]],
    *,
    motion: Motion | str = "fine-step",
    controller: Controller | None = None,
    samples: int | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> Sweep:
    """Moves a stage over the values of keys of its model, controller and motion.

    Args:
        model: The stage.
        axes: Keys as dotted paths, such as ``model.mass``, ``model.guides.stiffness``,
            ``controller.bandwidth`` or ``motion.distance``, each with its values: one by one, or as
            the command line takes them, such as ``"20:60:5"`` or ``"normal(40, 2)"``. Several keys
            make a grid.
        motion: ``fine-step``, ``fast-move`` or a motion.
        controller: With all its gains; without, it follows the mass of each point.
        samples: Values that are drawn of the distributions at each place of the grid.
        seed: Of draws and noise; a point depends on seed and its number only.
        progress: Called with a line and the share that is done.

    Raises:
        SweepError: With the key, the value and what would be right.
    """
    given = given_axes(axes)
    return Sweep(*_native.sweep(model, given, motion, controller, samples, seed, progress))
