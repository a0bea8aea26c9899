"""``simulate``: stage and controller in one process."""

from __future__ import annotations

from . import _native
from ._native import Controller, Model, Motion
from ._source import Progress
from ._trace import MoveResult, Trace


def simulate(
    model: Model,
    motion: Motion,
    *,
    controller: Controller | None = None,
    noise: bool = True,
    seed: int = 1,
    duration: float | None = None,
    progress: Progress | None = None,
) -> Trace:
    """Moves a stage under its controller, as the two nodes do in lockstep.

    Args:
        model: The stage.
        motion: What the controller follows from the first sample on.
        controller: Its settings; without, those of the paper for this stage.
        noise: Whether encoder and force cell have their noise and counts.
        seed: Seed of that noise.
        duration: How long, s; without, until the end of the motion.
        progress: Called with a line and the share that is done.

    Raises:
        MotionError, ControllerError, ModelError: With the value that is wrong.
    """
    names, values, saturated, rate, moves = _native.simulate(
        model, motion, controller, noise, seed, duration, progress
    )
    columns = dict(zip(names, values, strict=True)) | {"saturated": saturated}
    return Trace(columns, rate=rate, moves=tuple(MoveResult(*move) for move in moves), model=model)
