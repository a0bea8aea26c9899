"""A friction-loaded positioning stage: simulate it, read recordings, and ask what a model lacks.

SI units throughout; forces and positions are positive along +x.
"""

from ._native import Controller, Model, Motion, Sample, Stage, __version__
from ._simulate import simulate
from ._trace import MoveResult, Trace
from .errors import (
    ControllerError,
    FitError,
    FrictionStageError,
    IdentificationError,
    ModelError,
    MotionError,
    RecordingError,
    SelectionError,
)

__all__ = [
    "Controller",
    "ControllerError",
    "FitError",
    "FrictionStageError",
    "IdentificationError",
    "Model",
    "ModelError",
    "Motion",
    "MotionError",
    "MoveResult",
    "RecordingError",
    "Sample",
    "SelectionError",
    "Stage",
    "Trace",
    "__version__",
    "simulate",
]
