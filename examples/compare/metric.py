"""The one figure that every tool is judged by: the force that a model misses on held-out data.

In come a recording and a force that a model predicts along its motion, out comes the rms of
measured less predicted force in a band, over all rows and over the moving ones, N.

The command is held between samples, so the second difference of the position over the interval
squared is exactly the mean force of the two intervals around a sample over the mass. All forces
stand at samples as such means. Both pass the same zero-phase lowpass; the ends and the rows before
the guides have first slid are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, filtfilt, sosfiltfilt

from data import Recording

# Order of the lowpass, run forward and backward.
ORDER = 4
# s left out at either end: the transient of the filter.
ENDS = 0.1
# Bristles have forgotten how they started after this many break-away lengths (Fs / stiffness).
BREAK_AWAY_LENGTHS = 7
# The carriage counts as moving above this speed, m/s.
MOVING = 1e-3
# Corner below which the encoder shows the motion at rest, Hz, and speed below which it is a rest.
REST_CORNER = 100.0
REST_SPEED = 5e-4


def lowpass(signal: np.ndarray, dt: float, corner: float) -> np.ndarray:
    """Zero-phase Butterworth lowpass of each column; at or above Nyquist nothing is done."""
    if 2 * corner * dt >= 1:
        return np.asarray(signal, float)
    sections = butter(ORDER, corner, fs=1 / dt, output="sos")
    return sosfiltfilt(sections, signal, axis=0)


def interval_means(held: np.ndarray) -> np.ndarray:
    """Mean at each inner sample of the two intervals around it, of a value for each interval."""
    return 0.5 * (held[:-1] + held[1:])


class Motion:
    """Measured motion and force of a recording at its inner samples, in one band."""

    def __init__(
        self,
        recording: Recording,
        cutoff: float,
        mass: float,
        break_away: float,
        moving: float = MOVING,
    ):
        self.dt, self.cutoff = recording.dt, cutoff
        x, dt = recording.position, self.dt
        # What a carriage of this mass does above the corner under the command: an encoder of
        # nanometres reads more noise than motion there. Only used where the carriage rests.
        frequency = np.fft.rfftfreq(len(x), dt)
        corner = min(REST_CORNER, 0.2 / dt)
        numerator, denominator = butter(ORDER, corner, fs=1 / dt)
        slow = filtfilt(numerator, denominator, x)
        gain = 1 / (1 + (frequency / corner) ** (2 * ORDER))
        with np.errstate(divide="ignore", invalid="ignore"):
            integral = np.where(frequency > 0, (1 - gain) / (2 * np.pi * frequency) ** 2, 0.0)
        spectrum = np.fft.rfft(recording.force / mass)
        fast = np.fft.irfft(-integral * spectrum, len(x))
        speed = np.gradient(slow, dt)
        rests = np.abs(speed) < REST_SPEED
        self.driven = np.where(rests, slow + fast, x)
        # Velocity of each interval, for what has a memory.
        self.interval_velocity = np.diff(self.driven) / dt
        self.position = x[1:-1]
        self.velocity = speed[1:-1]
        self.acceleration = (x[2:] - 2 * x[1:-1] + x[:-2]) / dt**2
        self.force = interval_means(recording.force[:-1])
        self.time = dt * np.arange(1, len(x) - 1)
        self.moving = np.abs(self.velocity) > moving
        self.force_in_band = self.band(self.force)
        self.acceleration_in_band = self.band(self.acceleration)
        ends = round(ENDS / dt)
        slid = np.flatnonzero(np.abs(self.position - self.position[0]) > break_away)
        start = max(ends, (slid[0] if len(slid) else 0) + ends)
        self.rows = slice(start, len(self.position) - ends)

    def band(self, signal: np.ndarray) -> np.ndarray:
        return lowpass(signal, self.dt, self.cutoff)


@dataclass
class ForceError:
    """Rms of the force residual in the band, N."""

    all_rows: float
    moving_rows: float
    # Of the measured force, in the same band, for shares.
    force: float

    def as_dict(self) -> dict:
        return {
            "all_rows": self.all_rows,
            "moving_rows": self.moving_rows,
            "relative": self.all_rows / self.force,
        }


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def force_error(motion: Motion, residual_in_band: np.ndarray) -> ForceError:
    """The figures of a residual that stands at the inner samples and is in the band already."""
    kept, moving = residual_in_band[motion.rows], motion.moving[motion.rows]
    return ForceError(rms(kept), rms(kept[moving]), rms(motion.force_in_band[motion.rows]))


def noise_floor(motion: Motion, mass: float, noise: float, count: float, seed: int = 1) -> float:
    """Rms of what the encoder's noise and counts alone leave of m a in the band, N.

    What the noise does to the driven bristles is not in it.
    """
    random = np.random.default_rng(seed)
    samples = len(motion.position) + 2
    wrong = noise * random.standard_normal(samples) + count * random.uniform(-0.5, 0.5, samples)
    shaken = motion.band(mass * (wrong[2:] - 2 * wrong[1:-1] + wrong[:-2]) / motion.dt**2)
    return rms(shaken[motion.rows])
