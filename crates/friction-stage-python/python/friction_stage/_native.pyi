"""The Rust part. ``friction_stage`` has its public names."""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Controller",
    "FittedGuide",
    "Identified",
    "Model",
    "Motion",
    "Plan",
    "Ranking",
    "Sample",
    "Stage",
    "SweepPlan",
    "SweepTally",
    "__version__",
    "check",
    "experiment",
    "fit_guide",
    "identify",
    "read_bag",
    "simulate",
    "sweep",
    "write_csv",
]
__version__: str

_Path = str | PathLike[str]
_Float = NDArray[np.float64]
_Progress = Callable[[str, float], bool | None]
_Source = _Path | tuple[str, dict[str, _Float]]

@final
class Model:
    """A stage: mass, guides, effects, motor, force cell and encoder.

    Models are values: they do not change, compare by content, and can be pickled.
    """

    @staticmethod
    def from_yaml(source: _Path) -> Model:
        """Reads a model file, or a string that holds its YAML.

        Raises:
            ModelError: With the key, the value and what would be right.
        """

    @staticmethod
    def from_dict(model: Mapping[str, Any]) -> Model:
        """The model with these keys, named as in a model file; others have their defaults."""

    @staticmethod
    def guide(name: str) -> Model:
        """The 40 kg stage of the paper on four guides of the catalogue, such as ``guide_2``."""

    @staticmethod
    def rig(name: str) -> Model:
        """The measuring rig of the paper with one guide of the catalogue."""

    @staticmethod
    def guides() -> list[str]:
        """Names of the guides of the built-in catalogue."""

    def to_yaml(self) -> str:
        """The text of a model file, which ``stage_node`` and every command read."""

    def to_dict(self) -> dict[str, Any]:
        """The model as a model file has it."""

    def without_noise(self) -> Model:
        """The same stage without sensor noise and without counts."""

    @property
    def name(self) -> str:
        """Name for people."""

    @property
    def mass(self) -> float:
        """Moving mass of the carriage, kg."""

    @property
    def effects(self) -> list[str]:
        """Names of the effects beyond the guides."""

    @property
    def notes(self) -> list[str]:
        """What is allowed but deserves a word."""

    def __eq__(self, value: object, /) -> bool: ...

@final
class Motion:
    """What a controller follows: points, interpolated as ``joint_trajectory_controller`` does.

    Args:
        time: Of each point, s, ascending.
        position: m.
        velocity: m/s; without it, the motion is linear from point to point.
        acceleration: m/s²; with velocity and acceleration it is quintic.
        effort: Force that is added to that of the controller, N.
    """

    def __new__(
        cls,
        time: _Float,
        position: _Float,
        velocity: _Float | None = None,
        acceleration: _Float | None = None,
        effort: _Float | None = None,
    ) -> Motion: ...
    @staticmethod
    def from_yaml(source: _Path) -> Motion:
        """Reads the file that ``friction-stage play`` takes, or a string that holds it: a
        ``trajectory_msgs/JointTrajectory`` in YAML."""

    @staticmethod
    def of_moves(moves: Sequence[tuple[float, float, float]], *, lead: float = ...) -> Motion:
        """Rest-to-rest moves from 0 on: for each its distance (m), its duration (s) and the rest
        after it (s); ``lead`` s of rest before the first (0.05 s)."""

    @staticmethod
    def fast_move(rest: float = ...) -> Motion:
        """The paper's fast move: return move of 50 mm, ``rest`` s of rest (a minute), then
        50 mm in 100 ms forward and back."""

    @staticmethod
    def fine_step(rest: float = ..., steps: int = 5) -> Motion:
        """The paper's fine steps: return move of 50 mm, ``rest`` s of rest (a minute), then
        steps of 10 µm in 3 ms."""

    def to_yaml(self) -> str:
        """The file that ``friction-stage play`` and ``ros2 topic pub`` take."""

    def stretched(self, factor: float) -> Motion:
        """The same way in ``factor`` times the time."""

    @property
    def duration(self) -> float:
        """Time of the last point, s."""

    def __len__(self) -> int: ...
    def __eq__(self, value: object, /) -> bool: ...

@final
class Controller:
    """A PID with lowpass and feedforward, sampled at a rate.

    What is not given is that of the paper for what the model moves.

    Args:
        model: The stage: its mass and the limit of its motor.
        bandwidth: Crossover of the open loop, Hz (60 Hz); gains and lowpass follow from it.
        rate: Samples per second, Hz.
        mass_feedforward: kg; without, the moving mass.
        viscous_feedforward: N s/m.
        p: N/m.
        i: N/(m s).
        d: N s/m.
        lowpass_frequency: Hz.
        lowpass_damping: Damping ratio.
        force_limit: Largest force in either direction, N.
        anti_windup: ``none``, ``conditional_integration`` or ``back_calculation``.
    """

    def __new__(
        cls,
        model: Model,
        *,
        bandwidth: float = ...,
        rate: float = 4000.0,
        mass_feedforward: float | None = None,
        viscous_feedforward: float = 0.0,
        p: float | None = None,
        i: float | None = None,
        d: float | None = None,
        lowpass_frequency: float | None = None,
        lowpass_damping: float | None = None,
        force_limit: float | None = None,
        anti_windup: str = "conditional_integration",
    ) -> Controller: ...
    @property
    def rate(self) -> float: ...
    @property
    def p(self) -> float: ...
    @property
    def i(self) -> float: ...
    @property
    def d(self) -> float: ...
    @property
    def lowpass_frequency(self) -> float: ...
    @property
    def lowpass_damping(self) -> float: ...
    @property
    def force_limit(self) -> float: ...
    @property
    def mass_feedforward(self) -> float: ...
    @property
    def viscous_feedforward(self) -> float: ...
    def __eq__(self, value: object, /) -> bool: ...

@final
class Sample:
    """What the sensors say at one sampling instant."""

    @property
    def index(self) -> int:
        """Counted from the start."""

    @property
    def time(self) -> float:
        """s"""

    @property
    def position(self) -> float:
        """Encoder, m."""

    @property
    def velocity(self) -> float:
        """Encoder by difference over one sample, m/s."""

    @property
    def force_cell(self) -> float:
        """Force cell over the interval that ends here, N."""

@final
class Stage:
    """A stage at rest at position 0, for a loop of one's own.

    Args:
        model: What it is.
        rate: Samples per second, Hz.
        noise: Whether encoder and force cell have their noise and counts.
        seed: Seed of that noise.
    """

    def __new__(
        cls, model: Model, *, rate: float = 4000.0, noise: bool = True, seed: int = 1
    ) -> Stage: ...
    def step(self, force: float) -> Sample:
        """Holds a motor force, N, until the next sample, and reads that. Beyond the motor's limit
        it is clamped; NaN counts as no force."""

    @property
    def sample(self) -> Sample:
        """The sample that was read last."""

    @property
    def rate(self) -> float:
        """Samples per second, Hz."""

    @property
    def force_limit(self) -> float:
        """Largest force of the motor in either direction, N."""

    @property
    def true_position(self) -> float:
        """Position without noise, m."""

    @property
    def true_velocity(self) -> float:
        """Velocity without noise, m/s."""

    @property
    def guide_forces(self) -> list[float]:
        """Friction of each guide, N, positive against positive motion."""

@final
class Identified:
    @property
    def model(self) -> Model: ...
    @property
    def partial_model(self) -> Model | None: ...
    @property
    def next_motion(self) -> Motion | None: ...
    def summary_json(self) -> str: ...
    def model_file(self) -> str: ...
    def partial_model_file(self) -> str | None: ...
    def text(self, page: str) -> str: ...
    def report(self) -> tuple[str, list[tuple[str, str]]]: ...

@final
class FittedGuide:
    @property
    def warnings(self) -> list[str]: ...
    @property
    def force_rms(self) -> float: ...
    @property
    def noise_rms(self) -> float: ...
    def parameters(self) -> list[tuple[str, float, str, list[float]]]: ...
    def catalogue_yaml(
        self, name: str, description: str | None, seals: bool, cage: bool, lubricant: str | None
    ) -> str: ...

@final
class Plan:
    def __new__(
        cls,
        application: _Path,
        catalogues: Sequence[_Path],
        guides: Sequence[str],
        seed: int,
        variants: int,
    ) -> Plan: ...
    @property
    def variants(self) -> int: ...
    @property
    def guides(self) -> list[str]: ...
    def run(
        self, start: int, stop: int, threads: int | None, progress: _Progress | None
    ) -> dict[str, NDArray[Any]]: ...
    def ranking(self) -> Ranking: ...

@final
class Ranking:
    def add(
        self,
        start: int,
        peak_error: _Float,
        settling_time: _Float,
        saturated: NDArray[np.bool_],
    ) -> None: ...
    def conclude(self) -> tuple[str, str]: ...

@final
class SweepPlan:
    def __new__(
        cls,
        model: Model,
        axes: Sequence[tuple[str, str | Sequence[Any]]],
        motion: Motion | str,
        controller: Controller | None,
        samples: int | None,
        seed: int,
    ) -> SweepPlan: ...
    def to_json(self) -> str: ...
    @staticmethod
    def from_json(text: str) -> SweepPlan: ...
    @property
    def points(self) -> int: ...
    def run(
        self, start: int, stop: int, threads: int | None, progress: _Progress | None
    ) -> dict[str, Any]: ...

@final
class SweepTally:
    def __new__(cls, plan: SweepPlan) -> SweepTally: ...
    def add(self, start: int, columns: dict[str, Any]) -> None: ...
    def conclude(self) -> tuple[str, str, str]: ...

def sweep(
    model: Model,
    axes: Sequence[tuple[str, str | Sequence[Any]]],
    motion: Motion | str,
    controller: Controller | None,
    samples: int | None,
    seed: int,
    progress: _Progress | None,
) -> tuple[dict[str, Any], str, str]: ...
def simulate(
    model: Model,
    motion: Motion,
    controller: Controller | None,
    noise: bool,
    seed: int,
    duration: float | None,
    progress: _Progress | None,
) -> tuple[
    list[str],
    _Float,
    NDArray[np.bool_],
    float,
    list[
        tuple[
            str,
            float,
            float,
            float,
            float,
            tuple[float | None, float | None, float | None],
        ]
    ],
]: ...
def read_bag(
    path: _Path, mapping: _Path | None
) -> tuple[dict[str, NDArray[Any]], float, dict[str, Any], int]: ...
def write_csv(path: _Path, columns: Mapping[str, _Float]) -> None: ...
def check(path: _Path, mapping: _Path | None, model: Model | None) -> dict[str, Any]: ...
def identify(
    model: Model,
    train: Sequence[_Source],
    holdout: Sequence[_Source],
    mapping: _Path | None,
    mass_tolerance: float | None,
    guide_tolerance: float | None,
    presliding_tolerance: float | None,
    limits: tuple[tuple[float, float] | None, float | None, float | None, float | None] | None,
    threads: int | None,
    progress: _Progress | None,
) -> Identified: ...
def fit_guide(stribeck: _Source, dahl: _Source, mass: float | None) -> FittedGuide: ...
def experiment(
    name: str,
    guides: Sequence[str],
    models: Sequence[Model],
    seed: int,
    rest: float | None,
    amplitudes: Sequence[float],
    recordings: bool,
    progress: _Progress | None,
) -> tuple[
    str,
    str,
    str,
    list[tuple[str, str]],
    list[tuple[str, dict[str, NDArray[Any]], float, Model]],
]: ...
