"""The declared stage driven along the measured motion, and its fit to a recording.

    F = m a + sum over guides of (sigma0 z + sigma1 dz/dt + sigma2 v) - F_effects

LuGre (Canudas de Wit, Olsson, Astrom, Lischinsky 1995): dz/dt = v - sigma0 |v| z / g(v),
g = Fc + (Fs - Fc) exp(-(v / vs)^2), solved exactly for a velocity that is constant in an interval.
This is the grey box that PySINDy and MuJoCo are judged with, and what friction-stage identified is
evaluated with. Written for this comparison: it shares no code with friction-stage.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from data import Case, Recording
from metric import BREAK_AWAY_LENGTHS, MOVING, Motion, interval_means

GUIDE_KEYS = (
    "stiffness",
    "bristle_damping",
    "viscous_friction",
    "coulomb_force",
    "static_force",
    "stribeck_velocity",
)
# As a share of the sampling interval: how far the instants of encoder and command may be apart.
TIME_SHIFT = 0.05
# Guide 1 of the catalogue, for a model that names its guides.
CATALOGUE = {
    "guide_1": dict(
        stiffness=4.5e5,
        bristle_damping=900.0,
        viscous_friction=18.0,
        coulomb_force=13.5,
        static_force=16.8,
        stribeck_velocity=0.005,
    )
}


class NotEvaluated(Exception):
    """A law that this evaluation does not have."""


@dataclass
class Stage:
    mass: float
    guides: list[dict]
    effects: list[dict]

    @staticmethod
    def of(model: dict) -> Stage:
        guides = [CATALOGUE[g] if isinstance(g, str) else g for g in model["guides"]]
        return Stage(model["mass"], [dict(guide) for guide in guides], model.get("effects") or [])

    def total(self, key: str) -> float:
        return sum(guide[key] for guide in self.guides)


def motion_of(recording: Recording, case: Case) -> Motion:
    stage = Stage.of(case.declared())
    break_away = max(g["static_force"] / g["stiffness"] for g in stage.guides)
    # A rotary drive is in rad: what counts as moving there is a share of its largest speed.
    fastest = np.abs(np.diff(recording.position)).max() / recording.dt
    moving = MOVING if case.cutoff > 20 else 0.05 * fastest
    return Motion(recording, case.cutoff, stage.mass, BREAK_AWAY_LENGTHS * break_away, moving)


def bristle(velocity: np.ndarray, dt: float, guide: dict, level: np.ndarray) -> np.ndarray:
    """Force of one bristle in each interval; `level` is a factor on g of each interval."""
    stiffness = guide["stiffness"]
    coulomb, static = guide["coulomb_force"], guide["static_force"]
    g = level * (
        coulomb + (static - coulomb) * np.exp(-((velocity / guide["stribeck_velocity"]) ** 2))
    )
    end = np.sign(velocity) * g / stiffness
    kept = np.exp(-np.abs(velocity) * dt * stiffness / g)
    added = end * (1 - kept)
    z, states = 0.0, [0.0]
    for share, gain in zip(kept.tolist(), added.tolist()):
        z = share * z + gain
        states.append(z)
    z = np.array(states)
    return stiffness * 0.5 * (z[1:] + z[:-1]) + guide["bristle_damping"] * np.diff(z) / dt


def friction(motion: Motion, guides: list[dict], effects: list[dict] = ()) -> np.ndarray:
    """Force of the guides against the motion at the inner samples, N."""
    v, dt = motion.interval_velocity, motion.dt
    x = 0.5 * (motion.driven[1:] + motion.driven[:-1])
    level, viscous, parts = np.ones_like(v), np.ones_like(v), [(1.0, 1.0, 1.0)]
    for effect in effects:
        ((name, values),) = effect.items()
        if name == "asymmetric_friction":
            level = level * (1 + values["fraction"] * np.sign(v))
            viscous = viscous * (1 + values.get("viscous_fraction", 0.0) * np.sign(v))
        elif name == "position_dependent_friction":
            if values.get("period", 0.0) > 0:
                shape = np.sin(2 * np.pi * x / values["period"] + values.get("phase", 0.0))
            else:
                shape = np.exp(
                    -(((x - values.get("center", 0.0)) / values.get("width", 0.05)) ** 2)
                )
            level = level * (1 + values["fraction"] * shape)
        elif name == "viscous_warm_up":
            viscous = viscous * (1 - values["fraction"] * warmth(v, dt, values))
        elif name == "distributed_bristles":
            if values.get("form", "gradual") != "gradual":
                raise NotEvaluated("distributed_bristles that slip suddenly")
            stiff = [values.get(f"stiffness_share_{i}", float(i == 1)) for i in (1, 2, 3)]
            strong = [values.get(f"strength_share_{i}", float(i == 1)) for i in (1, 2, 3)]
            pairs = [*zip(stiff, strong), (1 - sum(stiff), 1 - sum(strong))]
            scale = values.get("stiffness", 1.0)
            parts = [(scale * a, a, b) for a, b in pairs if a > 1e-9 and b > 1e-9]
        elif name == "map" and values.get("side") in ("friction", "viscous"):
            curve = knots(values, x, v, dt * (np.arange(len(v)) + 0.5))
            if values["side"] == "friction":
                level = level * (1 + curve)
            else:
                viscous = viscous * (1 + curve)
    total = np.zeros(len(v))
    for guide in unique(guides):
        count = sum(guide == other for other in guides)
        for stiff, damped, strong in parts:
            part = {
                **guide,
                "stiffness": guide["stiffness"] * stiff,
                "bristle_damping": guide["bristle_damping"] * damped,
            }
            total += count * bristle(v, dt, part, strong * level)
        total += count * guide["viscous_friction"] * viscous * v
    return interval_means(total)


def unique(guides: list[dict]) -> list[dict]:
    return [guide for i, guide in enumerate(guides) if guide not in guides[:i]]


def warmth(v: np.ndarray, dt: float, values: dict) -> np.ndarray:
    form = values.get("form", "proportion")
    if form == "time":
        return 1 - np.exp(-dt * np.arange(len(v)) / values["warm_up_time"])
    if form not in ("proportion", "distance"):
        raise NotEvaluated(f"viscous_warm_up of the form {form}")
    stays = np.exp(-dt / values.get("time_constant", 1e6))
    travelled, way = 0.0, []
    for step in (np.abs(v) * dt).tolist():
        travelled = stays * travelled + step
        way.append(travelled)
    share = np.array(way) / values.get("width", 1.0)
    return np.minimum(1, share) if form == "proportion" else 1 - np.exp(-share)


def hysteresis(x: np.ndarray, width: float, form: str) -> np.ndarray:
    """Share of a hysteresis along a path: h = u sign(v), du/ds = (1 - u) / width (Dahl)."""
    if form != "dahl":
        raise NotEvaluated(f"cable_chain of the form {form}")
    h, shares = 0.0, [0.0]
    for step in np.diff(x).tolist():
        side = math.copysign(1.0, step)
        h = side + (h - side) * math.exp(-abs(step) / width)
        shares.append(h)
    return np.array(shares)


def knots(values: dict, x: np.ndarray, v: np.ndarray, t: np.ndarray) -> np.ndarray:
    coordinate = {"position": x, "velocity": v, "time": t}[values["coordinate"]]
    if values.get("jump"):
        raise NotEvaluated("map with a jump")
    at = np.linspace(values["from"], values["to"], len(values["values"]))
    return np.interp(coordinate, at, values["values"])


def effect_force(motion: Motion, effects: list[dict], mass: float) -> np.ndarray:
    """Force of the effects along +x at the inner samples, N."""
    x, v, a, t = motion.position, motion.velocity, motion.acceleration, motion.time
    total = np.zeros_like(x)
    for effect in effects:
        ((name, p),) = effect.items()
        if name == "cogging":
            total += p["amplitude"] * np.sin(2 * np.pi * x / p["period"] + p.get("phase", 0.0))
        elif name == "ball_passage":
            if p.get("spread") or p.get("wander"):
                raise NotEvaluated("ball_passage whose guides differ or whose phase wanders")
            total += p["amplitude"] * np.sin(2 * np.pi * x / p["period"] + p.get("phase", 0.0))
        elif name == "constant_force":
            total += p["amplitude"]
        elif name == "cable_chain":
            total -= p["stiffness"] * (x - p.get("center", 0.0))
            if p.get("amplitude"):
                total -= p["amplitude"] * hysteresis(x, p["width"], p.get("form", "dahl"))
        elif name == "quadratic_drag":
            total -= p["coefficient"] * v * np.abs(v)
        elif name == "hardening_spring":
            total -= p["hardening"] * (x - p.get("center", 0.0)) ** 3
        elif name == "payload":
            total -= p["mass"] * a
        elif name == "motor_gain":
            total += p["fraction"] * motion.force
        elif name == "force_ripple":
            total += (
                motion.force
                * p["fraction"]
                * np.sin(2 * np.pi * x / p["period"] + p.get("phase", 0.0))
            )
        elif name == "external_vibration":
            total += p["amplitude"] * np.sin(2 * np.pi * p["frequency"] * t + p.get("phase", 0.0))
        elif name == "map":
            side = p.get("side", "carriage")
            if side in ("carriage", "motor"):
                total += knots(p, x, v, t)
            elif side == "mass":
                raise NotEvaluated("map of the mass")
        elif name not in (
            "asymmetric_friction",
            "position_dependent_friction",
            "viscous_warm_up",
            "distributed_bristles",
        ):
            raise NotEvaluated(name)
    return total


def residual(motion: Motion, stage: Stage, shift: float = 0.0) -> np.ndarray:
    """Measured less predicted force in the band, N; `shift` is how late the encoder reads, s."""
    predicted = stage.mass * motion.acceleration + friction(motion, stage.guides, stage.effects)
    predicted = motion.band(predicted - effect_force(motion, stage.effects, stage.mass))
    return motion.force_in_band - predicted - shift * np.gradient(predicted, motion.dt)


@dataclass
class Fit:
    stage: Stage
    shift: float
    # Coefficients of linear terms that were fitted at the same time, N per unit of each.
    coefficients: np.ndarray
    evaluations: int


def fit(motion: Motion, stage: Stage, case: Case, terms: np.ndarray | None = None) -> Fit:
    """Least squares for mass, common factors of the guides' parameters and time shift.

    `terms` are columns in the band that the force may hold in addition; they are solved for in each
    step (variable projection).
    """
    low, high = 1 / (1 + case.guide_tolerance), 1 + case.guide_tolerance
    if case.guide_tolerance < 1:
        low = 1 - case.guide_tolerance
    mass_low = 1 - case.mass_tolerance if case.mass_tolerance < 1 else 1 / (1 + case.mass_tolerance)
    size = len(GUIDE_KEYS)
    bounds = (
        [mass_low, *[low] * size, -TIME_SHIFT],
        [1 + case.mass_tolerance, *[high] * size, TIME_SHIFT],
    )
    # A band of 200 Hz needs no more rows than this.
    thin = max(1, int(1 / (2.5 * case.cutoff * motion.dt)))
    basis = None
    if terms is not None and terms.shape[1]:
        basis, _ = np.linalg.qr(terms[motion.rows][::thin])

    constant = [e for e in stage.effects if "constant_force" in e]
    if constant and terms is None:
        basis = np.ones((len(motion.position[motion.rows][::thin]), 1))
        basis /= np.linalg.norm(basis)

    def of(factors: np.ndarray) -> tuple[Stage, float]:
        fitted = copy.deepcopy(stage)
        fitted.mass *= factors[0]
        for guide in fitted.guides:
            for key, factor in zip(GUIDE_KEYS, factors[1:-1]):
                guide[key] *= factor
            guide["static_force"] = max(guide["static_force"], guide["coulomb_force"])
        return fitted, factors[-1] * motion.dt

    def left(factors: np.ndarray) -> np.ndarray:
        found = residual(motion, *of(factors))[motion.rows][::thin]
        return found if basis is None else found - basis @ (basis.T @ found)

    start = np.array([1.0] * (size + 1) + [0.0])
    done = least_squares(left, start, bounds=bounds, diff_step=1e-5, x_scale="jac", max_nfev=40)
    fitted, shift = of(done.x)
    coefficients = np.zeros(0)
    if basis is not None:
        found = residual(motion, fitted, shift)[motion.rows][::thin]
        columns = np.ones((len(found), 1)) if terms is None else terms[motion.rows][::thin]
        coefficients = np.linalg.lstsq(columns, found, rcond=None)[0]
        if terms is None:
            fitted.effects = [e for e in fitted.effects if "constant_force" not in e]
            before = sum(e["constant_force"]["amplitude"] for e in constant)
            fitted.effects.append(
                {"constant_force": {"amplitude": before - float(coefficients[0])}}
            )
            coefficients = np.zeros(0)
    return Fit(fitted, shift, coefficients, done.nfev)
