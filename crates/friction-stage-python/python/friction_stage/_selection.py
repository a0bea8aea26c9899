"""``select``: which guide for an application."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._source import Path, Progress

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


class Selection:
    """Which guide for an application, with every variant that was computed.

    Attributes:
        summary: Everything, as in ``summary.json`` of ``friction-stage select``.
        variants: The variants as columns.
    """

    def __init__(self, summary_json: str, text: str, variants: Mapping[str, NDArray[Any]]) -> None:
        self._text = text
        self.summary: dict[str, Any] = json.loads(summary_json)
        self.variants = dict(variants)

    @property
    def choice(self) -> str | None:
        """The guide to take; ``None`` where none meets the requirement in any variant."""
        choice = self.summary["choice"]
        return None if choice is None else str(choice)

    @property
    def ranking(self) -> list[dict[str, Any]]:
        """One row for each guide, best first, with quantiles, chance and reasons."""
        return list(self.summary["ranking"])

    @property
    def warnings(self) -> list[str]:
        """What a user must notice."""
        return list(self.summary["warnings"])

    @property
    def notes(self) -> list[str]:
        """Explanations that ask for no action."""
        return list(self.summary["notes"])

    def to_pandas(self) -> pd.DataFrame:
        """The variants as a pandas data frame."""
        import pandas as pd

        return pd.DataFrame(self.variants)

    def to_polars(self) -> pl.DataFrame:
        """The variants as a polars data frame."""
        import polars as pl

        return pl.DataFrame(self.variants)

    def __str__(self) -> str:
        return self._text

    def __repr__(self) -> str:
        return f"<Selection {self.choice} from {self.summary['variants']} variants>"


def plan_of(
    application: Path | Mapping[str, Any],
    catalogues: Sequence[Path],
    guides: Sequence[str],
    variants: int,
    seed: int,
) -> _native.Plan:
    """What is to be computed."""
    if isinstance(application, Mapping):
        application = json.dumps(dict(application))
    return _native.Plan(application, list(catalogues), list(guides), seed, variants)


def conclude(plan: _native.Plan, columns: Mapping[str, NDArray[Any]]) -> Selection:
    """The selection from all variants of a plan, in order."""
    ranking = plan.ranking()
    ranking.add(0, columns["peak_error_m"], columns["settling_time_s"], columns["saturated"])
    summary, text = ranking.conclude()
    named = dict(columns)
    named["guide"] = np.array(plan.guides)[columns["guide"]]
    return Selection(summary, text, named)


def select(
    application: Path | Mapping[str, Any],
    *,
    catalogues: Sequence[Path] = (),
    guides: Sequence[str] = (),
    variants: int = 3000,
    seed: int = 1,
    progress: Progress | None = None,
) -> Selection:
    """Chooses a guide: ranks every guide by what it reaches over its tolerances.

    Args:
        application: What the stage is to do and to reach: a YAML file, a string that holds it, or
            its keys.
        catalogues: Files with guides of one's own, or strings that hold them, beside the built-in
            ones.
        guides: Choose among these only.
        variants: Over all guides, dealt to them in turn.
        seed: Of tolerances and noise; a variant depends on seed, guide and its number only.
        progress: Called with a line and the share that is done.

    Raises:
        SelectionError, ModelError: With what is wrong.
    """
    plan = plan_of(application, catalogues, guides, variants, seed)
    return conclude(plan, plan.run(0, variants, None, progress))
