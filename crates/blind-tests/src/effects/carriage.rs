//! Effects between force cell and motion, other than those that change the friction law.

use std::f64::consts::TAU;

use super::super::guides::GUIDES;
use super::super::noise::Noise;
use super::{Drive, Effect, Law, Now, Side, identity};

/// Standard gravity, m/s^2 (ISO 80000-3).
const GRAVITY: f64 = 9.80665;

/// Mass on the carriage that was not declared.
#[derive(Debug, Clone)]
pub struct Payload {
    /// kg.
    pub mass: f64,
}

impl Payload {
    /// 0.5 to 3 kg: beyond the tolerance of the mass.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { mass: noise.log_between(0.5, 3.0) })
    }
}

impl Law for Payload {
    identity!("payload", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("mass", self.mass)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { mass: factor * self.mass })
    }
    fn added_mass(&self) -> f64 {
        self.mass
    }
}

/// Weight along the rail of a stage that is not level: m g sin(tilt).
#[derive(Debug, Clone)]
pub struct ConstantForce {
    /// Mass on the slope, kg.
    pub mass: f64,
    /// Slope, rad, + when the stage goes downhill towards +x.
    pub tilt: f64,
}

impl ConstantForce {
    /// 1 to 12 mrad at 40 kg.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { mass: 40.0, tilt: noise.sign() * noise.log_between(1e-3, 12e-3) })
    }

    fn force(&self) -> f64 {
        self.mass * GRAVITY * self.tilt.sin()
    }
}

impl Law for ConstantForce {
    identity!("constant_force", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.force())]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { tilt: factor * self.tilt, ..self.clone() })
    }
    fn carriage(&self, _now: &Now<'_>, _state: &[f64]) -> f64 {
        self.force()
    }
}

/// Cable chain: a spring and a hysteresis of Bouc-Wen form (Wen 1976, n = 2), F = -k (x - x0) - H h
/// with L dh/dt = v - |v| h |h|.
#[derive(Debug, Clone)]
pub struct CableChain {
    /// k, N/m.
    pub stiffness: f64,
    /// x0, m.
    pub center: f64,
    /// H, N.
    pub hysteresis: f64,
    /// L, m.
    pub length: f64,
}

impl CableChain {
    /// 8 to 60 N/m, with 0 to 2 N of hysteresis over 2 to 15 mm.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            stiffness: noise.log_between(8.0, 60.0),
            center: noise.between(-0.1, 0.1),
            hysteresis: noise.between(0.0, 2.0),
            length: noise.log_between(0.002, 0.015),
        })
    }
}

impl Law for CableChain {
    identity!("cable_chain", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("stiffness", self.stiffness),
            ("center", self.center),
            ("amplitude", self.hysteresis),
            ("length", self.length),
        ]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self {
            stiffness: factor * self.stiffness,
            hysteresis: factor * self.hysteresis,
            ..self.clone()
        })
    }
    fn states(&self) -> usize {
        1
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        rate[0] = (now.v - now.v.abs() * state[0] * state[0].abs()) / self.length;
    }
    fn carriage(&self, now: &Now<'_>, state: &[f64]) -> f64 {
        -self.stiffness * (now.x - self.center) - self.hysteresis * state[0]
    }
}

/// Drag of air or oil in turbulent flow: F = -D (v/1 m/s)^2 sgn(v).
#[derive(Debug, Clone)]
pub struct QuadraticDrag {
    /// D, N at 1 m/s.
    pub force: f64,
}

impl QuadraticDrag {
    /// 3 to 40 N at 1 m/s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { force: noise.log_between(3.0, 40.0) })
    }
}

impl Law for QuadraticDrag {
    identity!("quadratic_drag", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("coefficient", self.force)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { force: factor * self.force })
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        -self.force * now.v * now.v.abs()
    }
}

/// Balls that enter and leave the loaded zone: one sine over position per guide. Balls that roll
/// keep their phase over the position; where they slip, it walks at random with the distance
/// travelled and starts again in each record.
#[derive(Debug, Clone)]
pub struct BallPassage {
    /// N, per guide.
    pub amplitudes: [f64; GUIDES],
    /// m, per guide.
    pub periods: [f64; GUIDES],
    /// Rms walk of the phase over 1 m, rad; 0: no ball slips.
    pub wander: f64,
    phases: [f64; GUIDES],
    last: f64,
}

impl BallPassage {
    /// New, with phases of 0; those of balls that slip are drawn by [`Law::begin`].
    pub fn new(amplitudes: [f64; GUIDES], periods: [f64; GUIDES], wander: f64) -> Self {
        Self { amplitudes, periods, wander, phases: [0.0; GUIDES], last: 0.0 }
    }

    /// 0.2 to 1 N at 8 to 10 mm, equal within 20 % and 2 %; on every second stage the balls slip,
    /// by 0 to 0.5 rad rms over a metre.
    pub fn draw(noise: &mut Noise) -> Effect {
        let (amplitude, period) = (noise.log_between(0.2, 1.0), noise.between(8e-3, 10e-3));
        let amplitudes = [(); GUIDES].map(|()| amplitude * noise.between(0.8, 1.2));
        let periods = [(); GUIDES].map(|()| period * noise.between(0.98, 1.02));
        let wander = if noise.unit() < 0.5 { noise.between(0.0, 0.5) } else { 0.0 };
        Box::new(Self {
            phases: [(); GUIDES].map(|()| noise.angle()),
            ..Self::new(amplitudes, periods, wander)
        })
    }
}

impl Law for BallPassage {
    identity!("ball_passage", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("amplitude", self.amplitudes.iter().sum::<f64>() / GUIDES as f64),
            ("period", self.periods.iter().sum::<f64>() / GUIDES as f64),
            ("wander", self.wander),
        ]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { amplitudes: self.amplitudes.map(|a| factor * a), ..self.clone() })
    }
    fn begin(&mut self, noise: &mut Noise) {
        self.last = 0.0;
        if self.wander > 0.0 {
            self.phases = self.phases.map(|_| noise.angle());
        }
    }
    fn tick(&mut self, now: &Now<'_>, noise: &mut Noise) {
        let spread = self.wander * (now.x - self.last).abs().sqrt();
        self.last = now.x;
        for phase in &mut self.phases {
            *phase += spread * noise.normal();
        }
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        (0..GUIDES)
            .map(|g| self.amplitudes[g] * (TAU * now.x / self.periods[g] + self.phases[g]).sin())
            .sum()
    }
}

/// A part of the mass that hangs on a spring and a damper: m2 x2'' = k (x - x2) + c (v - v2).
#[derive(Debug, Clone)]
pub struct StructuralMode {
    /// m2, kg: taken from the mass of the carriage, so that the total stays.
    pub mass: f64,
    /// sqrt(k/m2)/2 pi, Hz.
    pub frequency: f64,
    /// c/(2 sqrt(k m2)).
    pub damping: f64,
}

impl StructuralMode {
    /// 0.5 to 4 kg at 35 to 140 Hz with 1 to 5 % damping.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            mass: noise.log_between(0.5, 4.0),
            frequency: noise.log_between(35.0, 140.0),
            damping: noise.log_between(0.01, 0.05),
        })
    }

    fn pull(&self, now: &Now<'_>, state: &[f64]) -> f64 {
        let w = TAU * self.frequency;
        self.mass * (w * w * (state[0] - now.x) + 2.0 * self.damping * w * (state[1] - now.v))
    }
}

impl Law for StructuralMode {
    identity!("structural_mode", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("mass", self.mass), ("frequency", self.frequency), ("damping", self.damping)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { mass: factor * self.mass, ..self.clone() })
    }
    fn added_mass(&self) -> f64 {
        -self.mass
    }
    fn states(&self) -> usize {
        2
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        rate[0] = state[1];
        rate[1] = -self.pull(now, state) / self.mass;
    }
    fn carriage(&self, now: &Now<'_>, state: &[f64]) -> f64 {
        self.pull(now, state)
    }
}

/// Floor that shakes: A sin(2 pi f t + phi), phi differs in each record.
#[derive(Debug, Clone)]
pub struct ExternalVibration {
    /// A, N.
    pub amplitude: f64,
    /// f, Hz.
    pub frequency: f64,
    phase: f64,
}

impl ExternalVibration {
    /// New, with a phase that [`Law::begin`] draws.
    pub fn new(amplitude: f64, frequency: f64) -> Self {
        Self { amplitude, frequency, phase: 0.0 }
    }

    /// 0.3 to 4 N at 8 to 90 Hz.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self::new(noise.log_between(0.3, 4.0), noise.log_between(8.0, 90.0)))
    }
}

impl Law for ExternalVibration {
    identity!("external_vibration", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.amplitude), ("frequency", self.frequency)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { amplitude: factor * self.amplitude, ..self.clone() })
    }
    fn begin(&mut self, noise: &mut Noise) {
        self.phase = noise.angle();
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        self.amplitude * (TAU * self.frequency * now.time + self.phase).sin()
    }
}

/// What a spring has beyond a linear one as it is stretched: its slope is 3 h (x - x0)^2 (Duffing
/// 1918).
#[derive(Debug, Clone)]
pub struct HardeningSpring {
    /// h, N/m^3.
    pub hardening: f64,
    /// x0, m.
    pub center: f64,
}

impl HardeningSpring {
    /// 0.5 to 5 N at 100 mm from the center.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            hardening: noise.log_between(500.0, 5000.0),
            center: noise.between(-0.05, 0.05),
        })
    }
}

impl Law for HardeningSpring {
    identity!("hardening_spring", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("hardening", self.hardening), ("center", self.center)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { hardening: factor * self.hardening, ..self.clone() })
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        self.hardening * (self.center - now.x).powi(3)
    }
}

/// A part of the mass that the carriage carries with play: between two stops it is free, and each
/// stop pushes with a spring and a damper and never pulls. With d = x2 - x, F = k (d - w) + c (v2 -
/// v) >= 0 where d > w, F = k (d + w) + c (v2 - v) <= 0 where d < -w, else 0; m2 x2'' = -F.
#[derive(Debug, Clone)]
pub struct Backlash {
    /// m2, kg: taken from the mass of the carriage, so that the total is the same.
    pub mass: f64,
    /// 2 w, m.
    pub play: f64,
    /// sqrt(k/m2)/2 pi, Hz.
    pub frequency: f64,
    /// c/(2 sqrt(k m2)).
    pub damping: f64,
}

impl Backlash {
    /// 1 to 6 kg with 20 to 400 µm of play, on stops of 60 to 200 Hz with 10 to 30 % damping.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            mass: noise.log_between(1.0, 6.0),
            play: noise.log_between(20e-6, 400e-6),
            frequency: noise.log_between(60.0, 200.0),
            damping: noise.between(0.1, 0.3),
        })
    }

    fn push(&self, now: &Now<'_>, state: &[f64]) -> f64 {
        let (half, w) = (0.5 * self.play, TAU * self.frequency);
        let stretch = state[0] - now.x;
        let depth = stretch - stretch.clamp(-half, half);
        let force = self.mass * (w * w * depth + 2.0 * self.damping * w * (state[1] - now.v));
        if depth > 0.0 {
            force.max(0.0)
        } else if depth < 0.0 {
            force.min(0.0)
        } else {
            0.0
        }
    }
}

impl Law for Backlash {
    identity!("backlash", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("mass", self.mass),
            ("play", self.play),
            ("frequency", self.frequency),
            ("damping", self.damping),
        ]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { mass: factor * self.mass, ..self.clone() })
    }
    fn added_mass(&self) -> f64 {
        -self.mass
    }
    fn states(&self) -> usize {
        2
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        rate[0] = state[1];
        rate[1] = -self.push(now, state) / self.mass;
    }
    fn carriage(&self, now: &Now<'_>, state: &[f64]) -> f64 {
        self.push(now, state)
    }
    fn touch(&self, now: &Now<'_>, state: &[f64]) -> Option<f64> {
        Some((state[0] - now.x).abs() - 0.5 * self.play)
    }
}
