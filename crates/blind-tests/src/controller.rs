//! The controller of the records: PID with lowpass around the encoder, and the nominal mass times
//! the reference acceleration as feedforward.
//!
//! C(s) = kp (wi/s + (1 + s/wd) wl^2/(s^2 + 2 zeta wl s + wl^2)) with wi = wc/10, wd = wc/3, wl = 6
//! wc, zeta = 1/sqrt 2; kp makes |C/(m s^2)| = 1 at wc (rules of thumb as in Schmidt, Schitter,
//! Rankers, "The Design of High Performance Mechatronics", chapter 4). Both terms become difference
//! equations by the trapezoidal rule, the second in direct form II transposed.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// A recursive filter of second order, (b0 + b1/z + b2/z^2)/(1 + a1/z + a2/z^2).
#[derive(Debug, Clone, Copy, Default)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
    memory: [f64; 2],
}

impl Section {
    /// (n0 + n1 s + n2 s^2)/(d0 + d1 s + d2 s^2) by the trapezoidal rule s = 2 rate (z - 1)/(z +
    /// 1).
    fn from_continuous(n: [f64; 3], d: [f64; 3], rate: f64) -> Self {
        let c = 2.0 * rate;
        let expand = |p: [f64; 3]| {
            [
                p[0] + p[1] * c + p[2] * c * c,
                2.0 * (p[0] - p[2] * c * c),
                p[0] - p[1] * c + p[2] * c * c,
            ]
        };
        let (b, a) = (expand(n), expand(d));
        Self { b: b.map(|v| v / a[0]), a: [a[1] / a[0], a[2] / a[0]], memory: [0.0; 2] }
    }

    fn apply(&mut self, input: f64) -> f64 {
        let output = self.b[0] * input + self.memory[0];
        self.memory[0] = self.b[1] * input - self.a[0] * output + self.memory[1];
        self.memory[1] = self.b[2] * input - self.a[1] * output;
        output
    }
}

/// Controller with its memory.
#[derive(Debug, Clone)]
pub struct Controller {
    mass: f64,
    lead: Section,
    integral_gain: f64,
    integral: f64,
    last_error: f64,
}

impl Controller {
    /// For a mass (kg), a crossover (Hz) and a sample rate (Hz).
    pub fn new(mass: f64, bandwidth: f64, rate: f64) -> Self {
        let wc = TAU * bandwidth;
        let (wi, wd, wl) = (wc / 10.0, wc / 3.0, 6.0 * wc);
        // C(j wc)/kp = -j wi/wc + (1 + j wc/wd) L, L = 1/(1 - r^2 + 2 j zeta r) with r = wc/wl.
        let (re, im) = (1.0 - (wc / wl).powi(2), 2.0 * FRAC_1_SQRT_2 * wc / wl);
        let square = re * re + im * im;
        let lead = [(re + im * wc / wd) / square, (re * wc / wd - im) / square];
        let kp = mass * wc * wc / f64::hypot(lead[0], lead[1] - wi / wc);
        Self {
            mass,
            lead: Section::from_continuous(
                [kp * wl * wl, kp / wd * wl * wl, 0.0],
                [wl * wl, 2.0 * FRAC_1_SQRT_2 * wl, 1.0],
                rate,
            ),
            integral_gain: 0.5 * kp * wi / rate,
            integral: 0.0,
            last_error: 0.0,
        }
    }

    /// Force to command, N, for a position error (m) and a reference acceleration (m/s^2).
    pub fn force(&mut self, error: f64, reference_acceleration: f64) -> f64 {
        self.integral += self.integral_gain * (error + self.last_error);
        self.last_error = error;
        self.integral + self.lead.apply(error) + self.mass * reference_acceleration
    }
}
