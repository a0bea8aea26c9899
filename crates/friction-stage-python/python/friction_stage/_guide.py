"""``fit_guide``: a guide from recordings of the measuring rig."""

from __future__ import annotations

from . import _native
from ._identification import Parameter
from ._source import Recording, native
from ._trace import Trace


class GuideFit:
    """A guide as recordings of the measuring rig show it.

    Attributes:
        parameters: By name, with unit and interval.
        warnings: What a user should know.
        force_rms: What the model leaves of the loops' force, N rms.
        noise_rms: Noise of the force cell, N rms.
    """

    def __init__(self, fitted: _native.FittedGuide) -> None:
        self._fitted = fitted
        self.parameters = {
            name: Parameter(value, unit, (ci95[0], ci95[1]))
            for name, value, unit, ci95 in fitted.parameters()
        }
        self.warnings = fitted.warnings
        self.force_rms = fitted.force_rms
        self.noise_rms = fitted.noise_rms

    def to_catalogue(
        self,
        name: str,
        *,
        description: str | None = None,
        seals: bool = False,
        cage: bool = False,
        lubricant: str | None = None,
    ) -> str:
        """The guide as a catalogue file, which ``select`` and models take."""
        return self._fitted.catalogue_yaml(name, description, seals, cage, lubricant)

    def __repr__(self) -> str:
        values = (f"{name} {p.value:.4g} {p.unit}" for name, p in self.parameters.items())
        return f"<GuideFit {', '.join(values)}>"


def fit_guide(stribeck: Recording, dahl: Recording, *, mass: float | None = None) -> GuideFit:
    """Fits a guide to recordings of the measuring rig.

    Args:
        stribeck: Runs at constant velocity in both directions: a bag, a trace, a data frame or
            arrays with ``time``, ``position`` and ``force_cell``.
        dahl: Slow loops of which the largest breaks away.
        mass: What moves behind the force cell, kg; without, what the recording's model says.

    Raises:
        RecordingError, FitError: With what is wrong.
    """
    if mass is None and isinstance(stribeck, Trace) and stribeck.model is not None:
        mass = stribeck.model.mass
    return GuideFit(_native.fit_guide(native(stribeck, "stribeck"), native(dahl, "dahl"), mass))
