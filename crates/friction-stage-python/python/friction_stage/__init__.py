"""A friction-loaded positioning stage: simulate it, read recordings, and ask what a model lacks.

SI units throughout; forces and positions are positive along +x.
"""

from ._experiment import ExperimentResult, experiment
from ._guide import GuideFit, fit_guide
from ._identification import Effect, Limits, Parameter, Verdict, identify
from ._native import Controller, Model, Motion, Sample, Stage, __version__
from ._recording import check, read_bag
from ._selection import Selection, select
from ._simulation import simulate
from ._sweep import Sweep, sweep
from ._trace import MoveResult, Trace
from .errors import (
    ControllerError,
    ExperimentError,
    FitError,
    FrictionStageError,
    IdentificationError,
    ModelError,
    MotionError,
    RecordingError,
    SelectionError,
    SweepError,
)

__all__ = [
    "Controller",
    "ControllerError",
    "Effect",
    "ExperimentError",
    "ExperimentResult",
    "FitError",
    "FrictionStageError",
    "GuideFit",
    "IdentificationError",
    "Limits",
    "Model",
    "ModelError",
    "Motion",
    "MotionError",
    "MoveResult",
    "Parameter",
    "RecordingError",
    "Sample",
    "Selection",
    "SelectionError",
    "Stage",
    "Sweep",
    "SweepError",
    "Trace",
    "Verdict",
    "__version__",
    "check",
    "experiment",
    "fit_guide",
    "identify",
    "read_bag",
    "select",
    "simulate",
    "sweep",
]
