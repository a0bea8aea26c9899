"""``experiment``: the laboratory of the paper."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from . import _native
from ._native import Model
from ._source import Progress
from ._trace import Trace


class ExperimentResult:
    """What an experiment measured.

    Attributes:
        summary: Everything, as in ``summary.json`` of ``friction-stage experiment``.
        report_html: The self-contained page.
        figures: Its figures by name, as SVG.
        recordings: What the sensors said, by specimen and run, where it was asked for.
    """

    def __init__(
        self,
        summary_json: str,
        text: str,
        report_html: str,
        figures: dict[str, str],
        recordings: dict[str, Trace],
    ) -> None:
        self._text = text
        self.summary: dict[str, Any] = json.loads(summary_json)
        self.report_html = report_html
        self.figures = figures
        self.recordings = recordings

    @property
    def results(self) -> dict[str, Any]:
        """What was measured, by experiment."""
        return dict(self.summary["results"])

    @property
    def warnings(self) -> list[str]:
        """What a user must notice."""
        return list(self.summary["warnings"])

    @property
    def notes(self) -> list[str]:
        """Explanations that ask for no action."""
        return list(self.summary["notes"])

    def __str__(self) -> str:
        return self._text

    def __repr__(self) -> str:
        return f"<ExperimentResult {self.summary['experiment']} on {self.summary['guides']}>"


def experiment(
    name: str,
    *,
    guides: Sequence[str] = (),
    models: Sequence[Model] = (),
    seed: int = 1,
    rest: float | None = None,
    amplitudes: Sequence[float] = (),
    recordings: bool = False,
    progress: Progress | None = None,
) -> ExperimentResult:
    """Runs an experiment of the paper on the measuring rig or on the 40 kg stage.

    Args:
        name: ``stribeck``, ``dahl``, ``frequency-response``, ``fast-move``, ``fine-step``,
            ``hunting``, ``rig`` or ``paper`` (all of them).
        guides: By catalogue name; ``+distributed_bristles`` takes its parallel bristles. Without
            guides and models, the paper's three.
        models: Stages or rigs of one's own.
        seed: Of the sensor noise.
        rest: Before the fast move or fine step, s; without, the paper's minute.
        amplitudes: Of the loops of ``dahl``, m; without, twelve from 10 nm to 1 mm.
        recordings: Keep what the sensors said.
        progress: Called with a line and the share that is done.

    Raises:
        ExperimentError, ModelError: With what is wrong.
    """
    summary, text, page, figures, kept = _native.experiment(
        name, list(guides), list(models), seed, rest, list(amplitudes), recordings, progress
    )
    traces = {run: Trace(columns, rate=rate, model=model) for run, columns, rate, model in kept}
    return ExperimentResult(summary, text, page, dict(figures), traces)
