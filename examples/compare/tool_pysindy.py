"""What PySINDy says of a recording: sparse regression on a library of terms.

Three ways. On the residual of the grey box (mass and LuGre of the declared model, fitted and
driven by the measured motion), with periods from a grid that is chosen without the truth; the same
with periods that a person offers; and on the raw states, as its introduction shows it. The
threshold is chosen by cross-validation in blocks of time. After the first two the terms are fitted
again, jointly with the grey box.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pysindy as ps

from data import Case, Clock
from declared import Fit, Stage, fit, residual
from metric import Motion, force_error, rms

# Periods of the library, m (or rad): a sixth of an octave apart, from an arbitrary start.
GRID = 1.37e-3 * 2 ** (np.arange(38) / 6)
# Scale of the smooth sign of the velocity, m/s: about the declared Stribeck velocity.
SIGN_SCALE = 5e-3
# Terms have an rms of one, so that a threshold is in N of their contribution.
THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
BLOCKS = 5

# A term: its name and its values at the inner samples.
Term = tuple[str, Callable[[Motion], np.ndarray]]


def grid(stroke: float) -> np.ndarray:
    """Periods of the grid that a stroke tells apart: half a wave more or less along it."""
    periods: list[float] = []
    for period in GRID[GRID < stroke]:
        if not periods or stroke / periods[-1] - stroke / period >= 0.5:
            periods.append(period)
    return np.array(periods)


def library(scale: float, speed: float, periods: np.ndarray) -> list[Term]:
    """Terms of position, velocity and acceleration, and a sine and cosine of each period.

    `scale`: the stroke, m; `speed`: scale of the smooth sign, m/s.
    """

    def sign(m: Motion) -> np.ndarray:
        return np.tanh(m.velocity / speed)

    terms: list[Term] = [
        ("1", lambda m: np.ones_like(m.position)),
        ("x", lambda m: m.position),
        ("x^2", lambda m: m.position**2),
        ("x^3", lambda m: m.position**3),
        ("v", lambda m: m.velocity),
        ("v^2", lambda m: m.velocity**2),
        ("v|v|", lambda m: m.velocity * np.abs(m.velocity)),
        ("sign v", sign),
        ("sign^2 v", lambda m: sign(m) ** 2),
        ("x sign v", lambda m: m.position * sign(m)),
        ("x^2 sign v", lambda m: m.position**2 * sign(m)),
        ("a", lambda m: m.acceleration),
        ("jerk", lambda m: np.gradient(m.acceleration, m.dt)),
    ]
    for period in periods:
        if period < scale:
            name = f"{1e3 * period:.3g} mm"
            wave = 2 * np.pi / period
            terms.append((f"sin {name}", lambda m, w=wave: np.sin(w * m.position)))
            terms.append((f"cos {name}", lambda m, w=wave: np.cos(w * m.position)))
    return terms


def columns(motion: Motion, terms: list[Term]) -> np.ndarray:
    return motion.band(np.column_stack([values(motion) for _, values in terms]))


def sparse(features: np.ndarray, target: np.ndarray, dt: float, threshold: float) -> np.ndarray:
    """Coefficients of PySINDy for target = features @ coefficients."""
    model = ps.SINDy(
        optimizer=ps.STLSQ(threshold=threshold, alpha=1e-6), feature_library=ps.IdentityLibrary()
    )
    with warnings.catch_warnings():
        # It warns where a threshold leaves no term, which is an answer here.
        warnings.simplefilter("ignore")
        model.fit(features, t=dt, x_dot=target.reshape(-1, 1))
    return np.asarray(model.coefficients())[0]


def select(features: np.ndarray, target: np.ndarray, dt: float) -> tuple[np.ndarray, float]:
    """Coefficients at the threshold with the least error in blocks that the fit did not see."""
    blocks = np.array_split(np.arange(len(target)), BLOCKS)
    errors = []
    for threshold in THRESHOLDS:
        wrong = 0.0
        for block in blocks:
            rest = np.setdiff1d(np.arange(len(target)), block)
            found = sparse(features[rest], target[rest], dt, threshold)
            wrong += np.sum((target[block] - features[block] @ found) ** 2)
        errors.append(wrong)
    # The largest of equals: no term where no term helps.
    best = max(t for t, e in zip(THRESHOLDS, errors) if e <= min(errors) * (1 + 1e-9))
    return sparse(features, target, dt, best), best


def on_residual(
    train: Motion, holdout: Motion, case: Case, grey: Fit, periods: np.ndarray, stage: Stage
) -> dict:
    clock = Clock()
    terms = library(np.ptp(train.position), sign_scale(train), periods)
    thin = max(1, int(1 / (2.5 * case.cutoff * train.dt)))
    table, held = columns(train, terms)[train.rows], columns(holdout, terms)
    left = residual(train, grey.stage, grey.shift)[train.rows]
    left_held = residual(holdout, grey.stage, grey.shift)
    # An rms of one each, so that a threshold is in N (mN m for a small rotary drive).
    size = np.array([rms(column) for column in table.T])
    unit = unit_of(case)
    clock.lap("load")
    found, threshold = select((table / size)[::thin], left[::thin] / unit, thin * train.dt)
    clock.lap("select")
    kept = np.flatnonzero(found)
    coefficients = unit * found / size
    answer = {
        "threshold": threshold * unit,
        "offered": len(terms),
        "terms": {terms[i][0]: unit * found[i] for i in kept},
        "holdout": force_error(holdout, left_held - held @ coefficients).as_dict(),
    }
    if len(kept):
        again = fit(train, stage, case, columns(train, [terms[i] for i in kept]))
        clock.lap("fit")
        together = residual(holdout, again.stage, again.shift) - held[:, kept] @ again.coefficients
        answer["holdout_refitted"] = force_error(holdout, together).as_dict()
    answer["cpu"] = clock.parts
    return answer


def unit_of(case: Case) -> float:
    """N of a threshold of one: a drive of mN m needs other thresholds than one of 100 N."""
    return 1.0 if case.cutoff > 20 else 1e-3


def sign_scale(motion: Motion) -> float:
    return SIGN_SCALE if np.abs(motion.velocity).max() < 5 else 0.5


def on_states(train: Motion, holdout: Motion, case: Case) -> dict:
    """Raw states x and v with the force as the control input: dv/dt = library + b F."""
    clock = Clock()
    terms = library(np.ptp(train.position), sign_scale(train), grid(np.ptp(train.position)))
    # The derivative of the state cannot be made of itself.
    terms = [term for term in terms if term[0] not in ("a", "jerk")]
    thin = max(1, int(1 / (2.5 * case.cutoff * train.dt)))
    table = np.column_stack([columns(train, terms), train.force_in_band])[train.rows]
    held = np.column_stack([columns(holdout, terms), holdout.force_in_band])
    size = np.array([rms(column) for column in table.T])
    target = train.acceleration_in_band[train.rows]
    clock.lap("load")
    # Thresholds in N over the declared mass; the control input is subject to them, too.
    mass = Stage.of(case.declared()).mass / unit_of(case)
    found, threshold = select((table / size)[::thin], mass * target[::thin], thin * train.dt)
    clock.lap("select")
    coefficients = found / mass / size
    inertia = 1 / coefficients[-1] if coefficients[-1] else float("nan")
    missed = inertia * (held @ coefficients - holdout.acceleration_in_band)
    kept = [terms[i][0] for i in np.flatnonzero(found[:-1])]
    return {
        "threshold": threshold,
        "offered": len(terms) + 1,
        "terms": kept,
        "mass": inertia,
        "holdout": force_error(holdout, missed).as_dict(),
        "cpu": clock.parts,
    }


def compare(train: Motion, holdout: Motion, case: Case, grey: Fit, stage: Stage) -> dict:
    answer = {
        "tool": f"PySINDy {ps.__version__}",
        "found": on_residual(train, holdout, case, grey, grid(np.ptp(train.position)), stage),
    }
    if case.offered_periods:
        answer["offered"] = on_residual(
            train, holdout, case, grey, np.array(case.offered_periods), stage
        )
    answer["raw_states"] = on_states(train, holdout, case)
    return answer
