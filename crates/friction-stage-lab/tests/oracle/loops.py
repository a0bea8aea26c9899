"""Expected responses and margins of linear loops, from python-control (0.10.2).

    python3 loops.py > loops.json

The stage is a mass on a spring and a damper driven by a first-order motor, held and sampled; the
controller is discretised by hand from its definition: integral by the backward rectangle,
derivative by the backward difference, lowpass by Tustin with prewarping.
"""

import json

import control
import numpy as np

CASES = [
    # name, mass, stiffness, damping, motor lag s, delay in samples, rate, bandwidth
    ("paper", 40.0, 1.8e6, 3.8e3, 0.0, 0, 4000.0, 60.0),
    ("plain_mass", 40.0, 0.0, 0.0, 0.0, 0, 4000.0, 60.0),
    ("late", 12.0, 4.0e5, 9.0e2, 4e-4, 2, 2000.0, 40.0),
    ("unstable", 40.0, 1.8e6, 3.8e3, 2e-3, 6, 4000.0, 60.0),
]


def gains(bandwidth, mass):
    """The rule of thumb of the project (corners at 1/10, 1/3 and 6 times the crossover)."""
    w = 2 * np.pi * bandwidth
    integrator, differentiator = w / 10, w / 3
    pid = np.hypot(1.0, w / differentiator - integrator / w)
    ratio = 1 / 6
    lowpass = 1 / np.hypot(1 - ratio**2, 2 * np.sqrt(0.5) * ratio)
    p = mass * w * w / (pid * lowpass)
    return p, p * integrator, p / differentiator, 6 * bandwidth, np.sqrt(0.5)


def case(name, mass, stiffness, damping, lag, samples, rate, bandwidth):
    period = 1 / rate
    plant = control.tf([1], [mass, damping, stiffness])
    if lag:
        plant = plant * control.tf([1], [lag, 1])
    plant = control.tf(control.sample_system(control.ss(plant), period, "zoh"))
    if samples:
        plant = plant * control.tf([1], [1] + [0] * samples, period)
    p, i, d, cutoff, zeta = gains(bandwidth, mass)
    pid = (
        control.tf([p], [1], period)
        + control.tf([i * period, 0], [1, -1], period)
        + control.tf([d / period, -d / period], [1, 0], period)
    )
    w = 2 * np.pi * cutoff
    lowpass = control.sample_system(
        control.tf([w * w], [1, 2 * zeta * w, w * w]), period, "tustin", prewarp_frequency=w
    )
    loop = control.minreal(plant * pid * lowpass, verbose=False)
    frequencies = np.array([1.0, 5.0, 20.0, 33.0, 60.0, 120.0, 250.0, 400.0, 0.3 * rate])
    response = loop(np.exp(2j * np.pi * frequencies * period))
    # On a grid of its own, fine enough for four digits.
    grid = np.geomspace(0.5, 0.4999 * rate, 400_000)
    distance = np.abs(1 + loop(np.exp(2j * np.pi * grid * period)))
    margins = control.stability_margins(loop, returnall=True)
    gain_margins, phase_margins, _, _, phase_at, _ = margins
    poles = control.feedback(loop, 1).poles()
    above = [float(g) for g in gain_margins if g > 1]
    below = [float(g) for g in gain_margins if 0 < g < 1]
    return {
        "name": name,
        "mass": mass,
        "stiffness": stiffness,
        "damping": damping,
        "motor_lag": lag,
        "delay_samples": samples,
        "rate": rate,
        "bandwidth": bandwidth,
        "frequency": frequencies.tolist(),
        "open_loop": [[float(v.real), float(v.imag)] for v in response],
        "stable": bool(np.all(np.abs(poles) < 1)),
        "crossover": float(max(phase_at) / (2 * np.pi)),
        "phase_margin": float(min(abs((m + 180) % 360 - 180) for m in phase_margins)),
        "gain_margin": min(above) if above else None,
        "least_gain": max(below) if below else None,
        "modulus_margin": float(distance.min()),
    }


print(json.dumps([case(*one) for one in CASES], indent=1))
