"""What MuJoCo's system identification toolbox says of a recording.

A mass on a slide joint under the recorded force, with the LuGre friction of a passive `dcmotor`
and its viscous part as the joint's damping. The toolbox fits mass and friction to the measured
position in windows that are simulated from a measured state. A spring of the joint and the cogging
of a `dcmotor` can be offered by hand. Whatever it fits is then judged by the shared metric.
"""

from __future__ import annotations

import numpy as np
import mujoco
from mujoco import sysid

from data import Case, Clock, Recording
from declared import GUIDE_KEYS, Fit, Stage, friction, residual
from metric import Motion, force_error, lowpass, rms

# s; of a window that is simulated from a measured state.
WINDOW = 0.05
# Windows for each s of a record, and how many there are at least.
WINDOWS_PER_SECOND = 0.7
FEWEST_WINDOWS = 8
# Samples of a window where they are so far apart that a window of that length holds too few.
FEWEST_SAMPLES = 12
# Step of the simulation, s; half the step is checked afterwards.
STEP = 100e-6
INTEGRATOR = "RK4"
ITERATIONS = 40
# The initial velocity is the slope of a lowpass of the position at this corner, Hz.
STATE_CORNER = 200.0

XML = """
<mujoco>
  <option timestep="{step}" gravity="0 0 0" integrator="{integrator}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="carriage">
      <inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>
      <joint name="{joint}" type="slide" axis="1 0 0" damping="{viscous_friction}"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="force" joint="{joint}"/>
    <dcmotor name="friction" joint="{joint}" input="none" motorconst="0" resistance="1"
          lugre="{stiffness} {bristle_damping} {coulomb_force} {static_force} {stribeck_velocity}"/>
    {cogging}
  </actuator>
  <sensor><jointpos name="position" joint="{joint}"/></sensor>
</mujoco>
"""
# The integer number of poles is one; the gear makes an angle of the position.
COGGING = (
    '<dcmotor name="cogging{i}" joint="stage" input="none" motorconst="0" resistance="1"'
    ' gear="{gear}" cogging="{torque} 1 {phase}"/>'
)


class Fitting:
    """The parameters that the toolbox moves, as factors of the declared values."""

    def __init__(self, case: Case, stage: Stage, hand: bool, step: float):
        self.stage, self.step = stage, step
        self.count = len(stage.guides)
        self.values = {key: stage.total(key) for key in GUIDE_KEYS}
        self.values["stribeck_velocity"] /= self.count
        self.periods = case.offered_periods if hand else []
        tolerance = case.guide_tolerance
        low = 1 - tolerance if tolerance < 1 else 1 / (1 + tolerance)
        mass_low = (
            1 - case.mass_tolerance if case.mass_tolerance < 1 else 1 / (1 + case.mass_tolerance)
        )
        self.params = sysid.ParameterDict()
        self.add("mass", 1.0, mass_low, 1 + case.mass_tolerance)
        for key in GUIDE_KEYS:
            self.add(key, 1.0, low, 1 + tolerance)
        # N/m, and N at position 0.
        if hand and case.offered_spring:
            self.add("spring", 10.0, -1000.0, 1000.0)
            self.add("offset", 0.0, -50.0, 50.0)
        for i, _ in enumerate(self.periods):
            self.add(f"sine{i}", 0.5, -50.0, 50.0)
            self.add(f"cosine{i}", 0.5, -50.0, 50.0)

    def add(self, name: str, start: float, low: float, high: float) -> None:
        self.params.add(sysid.Parameter(name, start, low, high))

    def xml(self, params: sysid.ParameterDict) -> str:
        value = {name: float(params[name].value[0]) for name in params.keys()}
        friction_of = {key: self.values[key] * value[key] for key in GUIDE_KEYS}
        friction_of["static_force"] = max(friction_of["static_force"], friction_of["coulomb_force"])
        cogging = ""
        for i, period in enumerate(self.periods):
            wave = 2 * np.pi / period
            sine, cosine = value[f"sine{i}"], value[f"cosine{i}"]
            cogging += COGGING.format(
                i=i, gear=wave, torque=np.hypot(sine, cosine) / wave, phase=np.arctan2(cosine, sine)
            )
        xml = XML.format(
            step=self.step,
            integrator=INTEGRATOR,
            joint="stage",
            mass=self.stage.mass * value["mass"],
            cogging=cogging,
            **friction_of,
        )
        if "spring" in value:
            # F = -stiffness (x - x0), as stiffness and force at x = 0.
            reference = value["offset"] / value["spring"] if value["spring"] else 0.0
            xml = xml.replace(
                'type="slide"',
                f'type="slide" stiffness="{value["spring"]}" springref="{reference}"',
            )
        return xml

    def build(self, params: sysid.ParameterDict, _spec: object = None) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(self.xml(params))

    def identified(self, params: sysid.ParameterDict) -> tuple[Stage, dict]:
        value = {name: float(params[name].value[0]) for name in params.keys()}
        guides = [
            {key: guide[key] * value[key] for key in GUIDE_KEYS} for guide in self.stage.guides
        ]
        for guide in guides:
            guide["static_force"] = max(guide["static_force"], guide["coulomb_force"])
        effects = [e for e in self.stage.effects]
        if "spring" in value:
            effects.append(
                {
                    "cable_chain": {
                        "stiffness": value["spring"],
                        "center": value["offset"] / value["spring"],
                    }
                }
            )
        for i, period in enumerate(self.periods):
            # MuJoCo's bias acts along the joint, as an effect does.
            sine, cosine = value[f"sine{i}"], value[f"cosine{i}"]
            effects.append(
                {
                    "cogging": {
                        "amplitude": float(np.hypot(sine, cosine)),
                        "period": period,
                        "phase": float(np.arctan2(cosine, sine)),
                    }
                }
            )
        return Stage(self.stage.mass * value["mass"], guides, effects), value


def windows(recording: Recording, motion: Motion, stage: Stage, length: float) -> list[int]:
    """Samples at which windows start, evenly over the record, where the carriage slides."""
    samples = round(length / recording.dt)
    last = motion.rows.stop - samples - 2
    duration = recording.dt * len(recording.position)
    count = max(FEWEST_WINDOWS, round(WINDOWS_PER_SECOND * duration))
    starts = np.linspace(motion.rows.start, last, 8 * count).astype(int)
    # The bristles' state is known where the carriage has slid for a while.
    before = round(0.02 / recording.dt) or 1
    moves = [s for s in starts if motion.moving[max(0, s - before) : s + 1].all()] or list(starts)
    return [moves[i] for i in np.linspace(0, len(moves) - 1, count).astype(int)]


def bristle_states(motion: Motion, stage: Stage) -> np.ndarray:
    """Bristle deflection at the inner samples of the declared guide, driven by the motion."""
    guide = {**stage.guides[0], "viscous_friction": 0.0, "bristle_damping": 0.0}
    return friction(motion, [guide]) / guide["stiffness"]


def step_for(recording: Recording) -> float:
    """A step of at most STEP that divides the sampling interval."""
    return recording.dt / int(np.ceil(recording.dt / STEP - 1e-9))


def sequences(
    fitting: Fitting, recording: Recording, motion: Motion, starts: list[int], length: float
) -> sysid.ModelSequences:
    stage, dt = fitting.stage, recording.dt
    every = round(dt / fitting.step)
    samples = round(length / dt)
    smooth = lowpass(recording.position, dt, min(STATE_CORNER, 0.2 / dt))
    velocity = np.gradient(smooth, dt)
    deflection = bristle_states(motion, stage)
    spec = mujoco.MjSpec.from_string(fitting.xml(fitting.params))
    model = spec.compile()
    states, controls, measured = [], [], []
    offset = sum(e["constant_force"]["amplitude"] for e in stage.effects if "constant_force" in e)
    for start in starts:
        # Inner samples of the motion are one later than those of the recording.
        k = start + 1
        states.append(
            sysid.create_initial_state(
                model, np.array([smooth[k]]), np.array([velocity[k]]), np.array([deflection[start]])
            )
        )
        held = np.repeat(recording.force[k : k + samples] + offset, every)
        times = fitting.step * np.arange(len(held))
        controls.append(sysid.TimeSeries(times, held.reshape(-1, 1)))
        rows = recording.position[k : k + samples].reshape(-1, 1)
        measured.append(sysid.TimeSeries.from_names(dt * np.arange(samples), rows, model))
    names = [f"window_{i}" for i in range(len(starts))]
    return sysid.ModelSequences("stage", spec, names, states, controls, measured)


def in_micrometres(_params, sensors, measured, _model, _all, state, **_rest):
    """Residual of the position at the measured instants, in units of a micrometre.

    The position comes from the state: a sensor shows the state before the step at whose end it
    stands, which is v times the step off.
    """
    times, position = state[:, 0], state[:, 1]
    at = (times[0] <= measured.times) & (measured.times <= times[-1])
    wanted = measured.times[at]
    values = np.interp(wanted, times, position).reshape(-1, 1)
    measured_there = sysid.TimeSeries(wanted, measured.data[at], measured.signal_mapping)
    predicted_there = sysid.TimeSeries(wanted, values, measured.signal_mapping)
    return 1e6 * (values - measured_there.data), predicted_there, measured_there


def position_error(fitting: Fitting, group: sysid.ModelSequences) -> list[float]:
    """Rms of the position error of each window, µm."""
    function = sysid.build_residual_fn(
        models_sequences=[group], build_model=fitting.build, modify_residual=in_micrometres
    )
    found, _, _ = function(fitting.params.as_vector(), fitting.params)
    return [rms(window) for window in found]


def fit_windows(
    recording: Recording,
    train: Motion,
    holdout: Motion,
    case: Case,
    grey: Fit,
    stage: Stage,
    hand: bool,
) -> dict:
    clock = Clock()
    length = max(WINDOW, FEWEST_SAMPLES * recording.dt)
    step = step_for(recording)
    fitting = Fitting(case, stage, hand, step)
    starts = windows(recording, train, stage, length)
    group = sequences(fitting, recording, train, starts, length)
    function = sysid.build_residual_fn(
        models_sequences=[group], build_model=fitting.build, modify_residual=in_micrometres
    )
    clock.lap("load")
    before = position_error(fitting, group)
    done, result = sysid.optimize(
        initial_params=fitting.params,
        residual_fn=function,
        optimizer="scipy",
        loss="soft_l1",
        x_scale="jac",
        verbose=False,
        diff_step=1e-4,
        max_iters=ITERATIONS,
    )
    fitting.params = done
    clock.lap("fit")
    after = position_error(fitting, group)
    finer = Fitting(case, stage, hand, step / 2)
    finer.params = done
    half = position_error(finer, sequences(finer, recording, train, starts, length))
    model, factors = fitting.identified(done)
    low, high = done.get_bounds()
    names, vector = list(done.keys()), done.as_vector()
    near = 1e-3 * (high - low)
    at_bound = [
        name
        for name, value, l, h, n in zip(names, vector, low, high, near)
        if value - l < n or h - value < n
    ]
    # The instants of encoder and command are not among its parameters: they come from the grey box.
    return {
        "holdout": force_error(holdout, residual(holdout, model, grey.shift)).as_dict(),
        "window_position_rms_um": {
            "declared": rms(np.array(before)),
            "fitted": rms(np.array(after)),
            "half_the_step": rms(np.array(half)),
            "median_fitted": float(np.median(after)),
        },
        "factors": factors,
        "at_bound": at_bound,
        "evaluations": int(result.nfev),
        "converged": bool(result.status > 0),
        "cpu": clock.parts,
    }


def compare(
    recording: Recording, train: Motion, holdout: Motion, case: Case, grey: Fit, stage: Stage
) -> dict:
    answer = {
        "tool": f"MuJoCo {mujoco.__version__} sysid",
        "declared": fit_windows(recording, train, holdout, case, grey, stage, hand=False),
    }
    if case.offered_periods or case.offered_spring:
        answer["offered"] = fit_windows(recording, train, holdout, case, grey, stage, hand=True)
    return answer
