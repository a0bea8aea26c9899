#!/usr/bin/env python3
"""Reference trajectories of a 40 kg stage on four LuGre guides under a sampled PID controller.

Written from the equations alone, sharing no code and no integrator with the library, so that a
disagreement points at one of the two.

Plant (state x, v, z_1..z_4; the force F is constant between two ticks):

    m dv/dt = F - sum_i Ff_i          dx/dt = v
    dz/dt   = v - s0 |v| z / g(v)     g(v) = Fc + (Fs - Fc) exp(-(v/vs)^2)
    Ff      = s0 z + s1 dz/dt + s2 v

Controller, at tick k (t_k = k T), from the exact position y = x(t_k):

    e = r - y    u = kp e + I + kd (e_k - e_{k-1})/T    I_k = I_{k-1} + ki T e_k
    F = lowpass(u) + m_ff (vr_{k+1} - vr_k)/T + d_ff vr_k,   clamped to +-force_limit

The lowpass is the second-order bilinear one, prewarped at its corner.

Integrators. The right-hand side is analytic as long as v keeps its sign, so every run is cut at
each velocity reversal and restarted there; between reversals |v| is s v with s fixed.

  gauss   Gauss-Legendre collocation of 12 stages (order 24, A-stable), Newton iteration to
          rounding, subintervals of at most 1.5 relaxation times of the fastest bristle.
          These are the numbers that are written.
  coarse  the same with 8 stages (order 16) and subintervals twice as long.
  dop853  explicit Runge-Kutta of order 8 (scipy), rtol 1e-13, atol 1e-20, steps at most half
          as long as those of gauss; reversals by root finding on the step length.

The largest differences of gauss to the other two, over the whole closed-loop run, are the
convergence figures in the header of each file.

    python oracle.py            recompute and write the CSV files
    python oracle.py --check    recompute and compare with the CSV files (1e-3 nm)
"""

import argparse
import json
import math
import pathlib
import sys

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

HERE = pathlib.Path(__file__).resolve().parent
TOLERANCE = 1e-12  # m, that is 1e-3 nm
COLUMNS = ["t", "position", "velocity", "z0", "z1", "z2", "z3", "force", "reference"]


# ------------------------------------------------------------------------------------ plant


class Plant:
    """The equations; the state is [x, v, z0, z1, z2, z3]."""

    def __init__(self, case):
        def column(key):
            return np.array([guide[key] for guide in case["guides"]])

        self.mass = case["mass"]
        self.s0 = column("stiffness")
        self.s1 = column("bristle_damping")
        self.s2 = column("viscous_friction")
        self.fc = column("coulomb_force")
        self.fs = column("static_force")
        self.vs = column("stribeck_velocity")

    def rhs(self, state, sign, force):
        """d(state)/dt with |v| read as sign * v."""
        v, z = state[1], state[2:]
        g = self.fc + (self.fs - self.fc) * np.exp(-((v / self.vs) ** 2))
        dz = v - self.s0 * (sign * v) * z / g
        friction = float(np.sum(self.s0 * z + self.s1 * dz + self.s2 * v))
        return np.concatenate(([v, (force - friction) / self.mass], dz))

    def relaxation_rate(self, v):
        """Largest s0 |v| / g(v) of the guides, 1/s."""
        g = self.fc + (self.fs - self.fc) * np.exp(-((v / self.vs) ** 2))
        return float(np.max(self.s0 * abs(v) / g))

    def direction(self, state, force):
        """Sign of the velocity from here on: of v, or of dv/dt where v is 0, or 0 at rest."""
        if state[1] != 0.0:
            return math.copysign(1.0, state[1])
        acceleration = self.rhs(state, 0.0, force)[1]
        return math.copysign(1.0, acceleration) if acceleration != 0.0 else 0.0

    def subinterval(self, state, force, remaining, relaxations):
        """Step length: `relaxations` relaxation times at the fastest speed ahead, at most 50 us
        times `relaxations`."""
        ahead = abs(state[1]) + abs(self.rhs(state, 1.0, force)[1]) * remaining
        fastest = max(self.relaxation_rate(ahead), self.relaxation_rate(state[1]))
        longest = relaxations * min(50e-6, 1.0 / max(fastest, 1e-9))
        return remaining / math.ceil(remaining / longest * (1.0 - 1e-12))


class Gauss:
    """Gauss-Legendre collocation between reversals."""

    def __init__(self, plant, stages, relaxations):
        self.plant, self.stages, self.relaxations = plant, stages, relaxations
        nodes, weights = np.polynomial.legendre.leggauss(stages)
        self.c, self.b = (nodes + 1.0) / 2.0, weights / 2.0
        # Integrals of the Lagrange basis, in Legendre polynomials (well conditioned).
        legendre = np.polynomial.legendre
        # basis[j]: coefficients of l_j.
        basis = np.linalg.inv(legendre.legvander(nodes, stages - 1)).T
        integral = [legendre.legint(row, lbnd=-1) / 2.0 for row in basis]
        self.weights_at = lambda theta: np.array(
            [legendre.legval(2.0 * np.atleast_1d(theta) - 1.0, row) for row in integral]
        ).T
        self.a = self.weights_at(self.c)
        self.dense = self.weights_at(np.linspace(0.0, 1.0, 65)[1:])

    def stage_slopes(self, state, sign, force, h):
        """dv/dt and dz/dt at the stages; x follows from v by the same weights."""
        p, s = self.plant, self.stages
        n = 1 + len(p.s0)
        y0 = state[1:]
        y = np.tile(y0, (s, 1))
        ah = h * self.a
        scale = np.concatenate(([1e-3], np.full(n - 1, 1e-6)))
        for _ in range(50):
            v, z = y[:, :1], y[:, 1:]
            bell = (p.fs - p.fc) * np.exp(-((v / p.vs) ** 2))
            g = p.fc + bell
            rate = p.s0 * sign * v / g
            dz = v - rate * z
            dv = (force - np.sum(p.s0 * z + p.s1 * dz + p.s2 * v, axis=1)) / p.mass
            f = np.column_stack((dv, dz))
            residual = y - y0 - ah @ f
            # Jacobian of f at each stage.
            jac = np.zeros((s, n, n))
            dg = -2.0 * v / p.vs**2 * bell
            dz_dv = 1.0 - p.s0 * sign * z / g * (1.0 - v * dg / g)
            jac[:, 1:, 0] = dz_dv
            jac[:, range(1, n), range(1, n)] = -rate
            jac[:, 0, 0] = -np.sum(p.s1 * dz_dv + p.s2, axis=1) / p.mass
            jac[:, 0, 1:] = -(p.s0 - p.s1 * rate) / p.mass
            matrix = -np.einsum("ij,jkl->ikjl", ah, jac).reshape(s * n, s * n)
            matrix[np.diag_indices(s * n)] += 1.0
            step = np.linalg.solve(matrix, residual.ravel()).reshape(s, n)
            y = y - step
            size = np.max(np.abs(step) / (np.abs(y) + scale))
            if size < 1e-9:  # quadratic: the next step would be below rounding
                break
        else:
            raise RuntimeError(
                f"Newton does not converge: last relative step {size:.3g}, h = {h:.3g} s"
            )
        v, z = y[:, :1], y[:, 1:]
        g = p.fc + (p.fs - p.fc) * np.exp(-((v / p.vs) ** 2))
        dz = v - p.s0 * sign * v / g * z
        dv = (force - np.sum(p.s0 * z + p.s1 * dz + p.s2 * v, axis=1)) / p.mass
        return np.column_stack((y[:, 0], dv, dz))

    def advance(self, state, force, duration):
        """State after `duration` of constant `force`, and the number of reversals on the way."""
        remaining, reversals = duration, 0
        while remaining > 1e-16:
            sign = self.plant.direction(state, force)
            if sign == 0.0:
                return state, reversals
            h = self.plant.subinterval(state, force, remaining, self.relaxations)
            slopes = self.stage_slopes(state, sign, force, h)
            v_inside = state[1] + h * (self.dense @ slopes[:, 1])
            crossed = np.nonzero(v_inside * sign < 0.0)[0]
            if len(crossed) == 0:
                state = state + h * (self.b @ slopes)
                remaining -= h
                continue
            # Reversal: collocate again over exactly the time to v = 0 (secant on the length).
            high = (crossed[0] + 1) / 64.0
            low = crossed[0] / 64.0
            at = lambda theta: state[1] + h * float(self.weights_at(theta)[0] @ slopes[:, 1])
            if low == 0.0 and state[1] == 0.0:
                low = high * 1e-3
                if at(low) * sign <= 0.0:  # leaves v = 0 the other way within rounding
                    state = state.copy()
                    state[1] = -sign * 1e-300
                    continue
            theta = brentq(at, low, high, xtol=1e-16, rtol=1e-14)
            step = theta * h
            slopes = self.stage_slopes(state, sign, force, step)
            state = state + step * (self.b @ slopes)
            state[1] = 0.0
            remaining -= step
            reversals += 1
        return state, reversals


class Dop853:
    """scipy's DOP853 between reversals."""

    def __init__(self, plant, relaxations):
        self.plant, self.relaxations = plant, relaxations

    def leap(self, state, sign, force, duration, stop_at_reversal):
        """Integrate; where v changes sign inside a step, report the step's start instead."""
        solver = DOP853(
            lambda _t, y: self.plant.rhs(y, sign, force), 0.0, state, duration,
            rtol=1e-13, atol=1e-20,
            max_step=self.plant.subinterval(state, force, duration, self.relaxations),
        )
        while solver.status == "running":
            t, y = solver.t, solver.y.copy()
            message = solver.step()
            if solver.status == "failed":
                raise RuntimeError(f"DOP853 failed at {solver.t:.3g} s: {message}")
            if stop_at_reversal:
                parts = np.linspace(0.0, 1.0, 33)[1:]
                inside = solver.dense_output()(t + (solver.t - t) * parts)[1]
                crossed = np.nonzero(inside * sign < 0.0)[0]
                if len(crossed) > 0:
                    return y, t, (solver.t - t) * (crossed[0] + 1) / 32.0
        return solver.y, duration, None

    def advance(self, state, force, duration):
        remaining, reversals = duration, 0
        while remaining > 1e-16:
            sign = self.plant.direction(state, force)
            if sign == 0.0:
                return state, reversals
            state, done, bracket = self.leap(state, sign, force, remaining, True)
            remaining -= done
            if bracket is None:
                break
            at = lambda h: self.leap(state, sign, force, h, False)[0][1]
            low = 1e-6 * bracket
            if at(low) * sign <= 0.0:
                state = state.copy()
                state[1] = -sign * 1e-300
                continue
            length = brentq(at, low, bracket, xtol=1e-19, rtol=1e-13)
            state = self.leap(state, sign, force, length, False)[0]
            state[1] = 0.0
            remaining -= length
            reversals += 1
        return state, reversals


# ------------------------------------------------------------------------------- controller


def tuned(case):
    """kp, ki, kd from the bandwidth: the open loop of a pure mass crosses 1 there."""
    c = case["controller"]
    wc = 2.0 * math.pi * c["bandwidth"]
    wi, wd, wl = wc / 10.0, wc / 3.0, 6.0 * wc
    s = 1j * wc
    lowpass = wl**2 / (s**2 + 2.0 * c["lowpass_damping"] * wl * s + wl**2)
    kp = case["mass"] * wc**2 / abs((1.0 + wi / s + s / wd) * lowpass)
    return {"kp": kp, "ki": kp * wi, "kd": kp / wd, "lowpass_frequency": wl / (2.0 * math.pi)}


def reference(motion, t):
    """Position and velocity of the quintic moves (zero velocity and acceleration at both ends)."""
    position = velocity = 0.0
    for move in motion:
        tau = min(max((t - move["start"]) / move["duration"], 0.0), 1.0)
        position += move["distance"] * tau**3 * (10.0 - 15.0 * tau + 6.0 * tau**2)
        velocity += move["distance"] / move["duration"] * 30.0 * tau**2 * (1.0 - tau) ** 2
    return position, velocity


def simulate(case, run, integrator):
    """Rows of COLUMNS per tick, the last one at the end of the run; number of reversals."""
    c = case["controller"]
    rate = c["rate"]
    period = 1.0 / rate
    ticks = round(run["duration"] * rate)

    warped = math.tan(2.0 * math.pi * c["lowpass_frequency"] * period / 2.0)
    norm = 1.0 / (1.0 + 2.0 * c["lowpass_damping"] * warped + warped**2)
    b0 = warped**2 * norm
    b1, b2 = 2.0 * b0, b0
    a1 = 2.0 * (warped**2 - 1.0) * norm
    a2 = (1.0 - 2.0 * c["lowpass_damping"] * warped + warped**2) * norm

    state = np.array([0.0, 0.0, *run["initial_bristle_deflections"]])
    integral = 0.0
    previous_error = None
    u1 = u2 = y1 = y2 = 0.0
    rows, reversals = [], 0
    for k in range(ticks + 1):
        t = k / rate
        r, vr = reference(run["motion"], t)
        vr_next = reference(run["motion"], (k + 1) / rate)[1]
        error = r - state[0]
        if previous_error is None:
            previous_error = error
        integral += c["ki"] * period * error
        u = c["kp"] * error + integral + c["kd"] * (error - previous_error) / period
        previous_error = error
        y = b0 * u + b1 * u1 + b2 * u2 - a1 * y1 - a2 * y2
        u1, u2, y1, y2 = u, u1, y, y1
        force = y + c["mass_feedforward"] * (vr_next - vr) / period + c["viscous_feedforward"] * vr
        if abs(force) > c["force_limit"]:
            raise RuntimeError(
                f"{run['name']}: {force:.6g} N at {t} s, limit {c['force_limit']} N: "
                "the case must not reach it"
            )
        rows.append([t, *state, force, r])
        if k < ticks:
            state, n = integrator.advance(state, force, period)
            reversals += n
    return np.array(rows), reversals


# ------------------------------------------------------------------------------------- files


def check_case(case):
    for key, value in tuned(case).items():
        given = case["controller"][key]
        if abs(given - value) > 1e-12 * value:
            sys.exit(f"case.json: controller.{key} is {given!r}, the bandwidth gives {value!r}")


def compute(case, run):
    plant = Plant(case)
    fine, reversals = simulate(case, run, Gauss(plant, 12, 1.5))
    coarse, _ = simulate(case, run, Gauss(plant, 8, 3.0))
    other, _ = simulate(case, run, Dop853(plant, 0.75))
    figures = {
        name: tuple(float(np.max(np.abs(fine[:, k] - rows[:, k]))) for k in (1, 2))
        for name, rows in [("coarse", coarse), ("dop853", other)]
    }
    return fine, reversals, figures


def describe(run, rows, reversals, figures):
    error = rows[:, 8] - rows[:, 1]
    peak = int(np.argmax(np.abs(error)))
    lines = [
        f"{run['name']}: {len(rows) - 1} control periods, {reversals} velocity reversals",
        f"peak error {error[peak]:+.6e} m at {rows[peak, 0]:.5f} s, at the end {error[-1]:+.6e} m; "
        f"largest force {np.max(np.abs(rows[:, 7])):.3f} N",
    ]
    for name, text in [
        ("coarse", "8 stages, subintervals twice as long"),
        ("dop853", "DOP853, rtol 1e-13"),
    ]:
        dx, dv = figures[name]
        lines.append(f"largest difference to {text}: {dx * 1e9:.1e} nm, {dv * 1e9:.1e} nm/s")
    return lines


def write(path, lines, rows):
    with open(path, "w", newline="\n") as out:
        out.write("# Written by oracle.py from case.json: do not edit.\n")
        out.write(
            "# Gauss-Legendre collocation, 12 stages (order 24), "
            "restarted at every velocity reversal\n"
        )
        for line in lines:
            out.write(f"# {line}\n")
        out.write(
            "# SI units. force acts from t to the next tick; everything else is the value at t.\n"
        )
        out.write(",".join(COLUMNS) + "\n")
        for row in rows:
            out.write(",".join(f"{value:.17g}" for value in row) + "\n")


def read(path):
    with open(path) as source:
        lines = [line for line in source if not line.startswith("#")]
    if lines[0].strip() != ",".join(COLUMNS):
        sys.exit(f"{path.name}: columns are {lines[0].strip()}, expected {','.join(COLUMNS)}")
    return np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--check", action="store_true", help="compare with the CSV files instead of writing them"
    )
    arguments = parser.parse_args()
    case = json.loads((HERE / "case.json").read_text())
    check_case(case)
    good = True
    for run in case["cases"]:
        rows, reversals, figures = compute(case, run)
        for line in describe(run, rows, reversals, figures):
            print(line)
        worst = max(dx for dx, _ in figures.values())
        if worst > TOLERANCE:
            print(f"  NOT CONVERGED: {worst * 1e9:.1e} nm, limit {TOLERANCE * 1e9:.0e} nm")
            good = False
        path = HERE / f"{run['name']}.csv"
        if arguments.check:
            committed = read(path)
            if committed.shape != rows.shape:
                sys.exit(f"{path.name}: {committed.shape[0]} rows, expected {rows.shape[0]}")
            # Position and bristles in m; velocity and force scaled to what 1e-3 nm makes of them.
            worst = np.max(np.abs(committed - rows), axis=0)
            limits = {"velocity": 1e-9, "force": 1e-4, "t": 1e-15}
            for name, difference in zip(COLUMNS, worst):
                if not difference <= limits.get(name, TOLERANCE):
                    print(
                        f"  {path.name}: column {name} differs by {difference:.3e}, "
                        f"limit {limits.get(name, TOLERANCE):.0e}"
                    )
                    good = False
            print(f"  {path.name}: position within {worst[1] * 1e9:.1e} nm of the file")
        elif good:
            write(path, describe(run, rows, reversals, figures), rows)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
