"""``identify``: what recordings show that a model lacks."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

from . import _native
from ._native import Model, Motion
from ._source import Path, Progress, Recording, natives


@dataclass(frozen=True)
class Limits:
    """What a next experiment may do.

    Attributes:
        stroke: Lowest and highest position, m; without, those of the train record.
        speed: Largest speed, m/s; without, 1 m/s.
        force: Largest motor force, N; without, that of the model's motor.
        duration: About how long it may take, s; without, 20 s.
    """

    stroke: tuple[float, float] | None = None
    speed: float | None = None
    force: float | None = None
    duration: float | None = None


@dataclass(frozen=True)
class Parameter:
    """A value with its unit and its 95 % interval; ``None`` where the data do not know one."""

    value: float
    unit: str
    ci95: tuple[float, float] | None


@dataclass(frozen=True)
class Effect:
    """An effect that the model lacked.

    Attributes:
        name: Canonical name, such as ``cogging``.
        side: ``motor``, ``carriage`` or ``sensor``.
        coordinate: Of a map, what it is over.
        parameters: By name.
    """

    name: str
    side: str
    coordinate: str | None
    parameters: dict[str, Parameter]


class Verdict:
    """What recordings show that a declared model lacks.

    Attributes:
        summary: Everything, as in ``summary.json``.
    """

    def __init__(self, identified: _native.Identified) -> None:
        self._identified = identified
        self._summary_json = identified.summary_json()
        self.summary: dict[str, Any] = json.loads(self._summary_json)

    @property
    def verdict(self) -> str:
        """``found``, ``none``, ``unknown`` or ``not_separable``."""
        return str(self.summary["verdict"])

    @property
    def model(self) -> Model:
        """The declared model, refitted, with the effects that it lacked.

        Where the verdict is ``unknown`` it is without laws, which explain a part only.
        """
        return self._identified.model

    @property
    def partial_model(self) -> Model | None:
        """The same with laws that explain a part only, where there are any."""
        return self._identified.partial_model

    @property
    def effects(self) -> list[Effect]:
        """The effects that the model lacked."""
        return [
            Effect(
                name=effect["name"],
                side=effect["side"],
                coordinate=effect.get("coordinate"),
                parameters=_parameters(effect["parameters"]),
            )
            for effect in self.summary["effects"]
        ]

    @property
    def declared_parameters(self) -> dict[str, Parameter]:
        """What the model declares, as the recordings show it."""
        return _parameters(self.summary["declared_parameters"])

    @property
    def errors(self) -> dict[str, Any]:
        """Errors before and after, on ``train`` and ``holdout``."""
        return dict(self.summary["errors"])

    @property
    def explained_share(self) -> float:
        """Share of the held-out residual above the noise that is explained."""
        return float(self.summary["explained_share"])

    @property
    def warnings(self) -> list[str]:
        """What a user should know, in sentences."""
        return list(self.summary["warnings"])

    @property
    def next_motion(self) -> Motion | None:
        """The motion that would best settle what is open, where one was asked for."""
        return self._identified.next_motion

    def report_html(self) -> str:
        """The self-contained page of the command line."""
        return self._identified.report()[0]

    def figures(self) -> dict[str, str]:
        """The figures of the page by name, as SVG."""
        return dict(self._identified.report()[1])

    def save(self, directory: Path) -> None:
        """Writes ``identified.yaml``, ``summary.json``, ``report.html`` and the figures.

        Laws that explain a part only are in ``partial.yaml``.
        """
        out = FilePath(directory)
        page, figures = self._identified.report()
        (out / "figures").mkdir(parents=True, exist_ok=True)
        model = self._identified.model_file()
        (out / "identified.yaml").write_text(model, encoding="utf-8")
        partial = self._identified.partial_model_file()
        if partial is None:
            (out / "partial.yaml").unlink(missing_ok=True)
        else:
            (out / "partial.yaml").write_text(partial, encoding="utf-8")
        (out / "summary.json").write_text(self._summary_json, encoding="utf-8")
        (out / "report.html").write_text(page, encoding="utf-8")
        for name, svg in figures:
            (out / "figures" / f"{name}.svg").write_text(svg, encoding="utf-8")

    def __str__(self) -> str:
        text = self._identified.text("")
        return text.rstrip()

    def __repr__(self) -> str:
        names = ", ".join(effect.name for effect in self.effects)
        return f"<Verdict {self.verdict}{': ' + names if names else ''}>"


def identify(
    model: Model,
    train: Recording | Sequence[Recording],
    holdout: Recording | Sequence[Recording],
    *,
    mapping: Path | None = None,
    mass_tolerance: float | None = None,
    guide_tolerance: float | None = None,
    presliding_tolerance: float | None = None,
    next_experiment: Limits | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Verdict:
    """Finds what a declared model lacks.

    Refits the model, traces the residual to an effect, adds it, and shows the error before and
    after on held-out data.

    Args:
        model: What the stage is declared to be.
        train: What is fitted: a bag, an MCAP or CSV file, a trace, a data frame or a mapping of
            arrays with the columns of a trace; or several of them, which are joined.
        holdout: What no fit sees; it decides what is kept.
        mapping: As for ``read_bag``, for files.
        mass_tolerance: How far the mass may be from the declared one, as a share; 1 and more, up to
            9, is a factor of 1 + the tolerance either way.
        guide_tolerance: The same for each parameter of the guides.
        presliding_tolerance: The same for stiffness, damping, static friction and Stribeck
            velocity.
        next_experiment: Asks for the motion that would settle most of what is open.
        threads: How many to use; without, all processors. The verdict is the same.
        progress: Called with a line and the share that is done. Where it returns ``False``, the
            search stops after the running step and what there is becomes the verdict.

    Raises:
        RecordingError, IdentificationError, ModelError: With what is wrong.
    """
    limits = None
    if next_experiment is not None:
        wanted = next_experiment
        limits = (wanted.stroke, wanted.speed, wanted.force, wanted.duration)
    return Verdict(
        _native.identify(
            model,
            natives(train, "train"),
            natives(holdout, "holdout"),
            mapping,
            mass_tolerance,
            guide_tolerance,
            presliding_tolerance,
            limits,
            threads,
            progress,
        )
    )


def _parameters(found: dict[str, Any]) -> dict[str, Parameter]:
    return {
        name: Parameter(
            value=parameter["value"],
            unit=parameter["unit"],
            ci95=None
            if parameter["ci95"] is None
            else (parameter["ci95"][0], parameter["ci95"][1]),
        )
        for name, parameter in found.items()
    }
