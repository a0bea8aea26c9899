//! Effects in the readings.

use std::f64::consts::TAU;

use super::super::noise::Noise;
use super::{Drive, Effect, Law, Now, Side, identity};

/// Interpolation error of an encoder: d cos(2 pi x/p - phi) + d/4 cos(4 pi x/p), the offset and
/// gain errors of its two signals (Heydemann 1981).
#[derive(Debug, Clone)]
pub struct EncoderSde {
    /// d, m.
    pub amplitude: f64,
    /// p, m.
    pub period: f64,
    /// phi, rad.
    pub phase: f64,
}

impl EncoderSde {
    /// 0.3 to 1.5 % of a period of 4 to 40 µm.
    pub fn draw(noise: &mut Noise) -> Effect {
        let period = noise.log_between(4e-6, 40e-6);
        Box::new(Self {
            amplitude: period * noise.log_between(0.003, 0.015),
            period,
            phase: noise.angle(),
        })
    }
}

impl Law for EncoderSde {
    identity!("encoder_sde", Sensor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.amplitude), ("period", self.period), ("phase", self.phase)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { amplitude: factor * self.amplitude, ..self.clone() })
    }
    fn encoder(&self, now: &Now<'_>, _force: f64) -> f64 {
        let angle = TAU * now.x / self.period;
        self.amplitude * ((angle - self.phase).cos() + 0.25 * (2.0 * angle).cos())
    }
}

/// Encoder that reads (1 + e) x.
#[derive(Debug, Clone)]
pub struct EncoderScale {
    /// e.
    pub fraction: f64,
}

impl EncoderScale {
    /// 1 to 4 %, up or down: less hides in the tolerance of the mass.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { fraction: noise.sign() * noise.log_between(0.01, 0.04) })
    }
}

impl Law for EncoderScale {
    identity!("encoder_scale", Sensor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("fraction", self.fraction)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction })
    }
    fn encoder(&self, now: &Now<'_>, _force: f64) -> f64 {
        self.fraction * now.x
    }
}

/// Force cell that reads (1 + e) F.
#[derive(Debug, Clone)]
pub struct ForceCellGain {
    /// e.
    pub fraction: f64,
}

impl ForceCellGain {
    /// 1 to 5 %, up or down.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { fraction: noise.sign() * noise.log_between(0.01, 0.05) })
    }
}

impl Law for ForceCellGain {
    identity!("force_cell_gain", Sensor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("fraction", self.fraction)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction })
    }
    fn cell(&self, _now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        self.fraction * force
    }
}

/// Force cell whose zero drifts at a rate, with a random walk on top.
#[derive(Debug, Clone)]
pub struct ForceCellDrift {
    /// N/s.
    pub rate: f64,
    /// Rms of the walk over 1 s, N.
    pub wander: f64,
    walk: f64,
}

impl ForceCellDrift {
    /// New, without a walk so far.
    pub fn new(rate: f64, wander: f64) -> Self {
        Self { rate, wander, walk: 0.0 }
    }

    /// 0.02 to 0.2 N/s, with a walk of 5 % of what has drifted after 40 s.
    pub fn draw(noise: &mut Noise) -> Effect {
        let rate = noise.log_between(0.02, 0.2);
        Box::new(Self::new(noise.sign() * rate, 0.05 * rate * 40.0 / 40f64.sqrt()))
    }
}

impl Law for ForceCellDrift {
    identity!("force_cell_drift", Sensor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("rate", self.rate), ("wander", self.wander)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self::new(factor * self.rate, factor * self.wander))
    }
    fn begin(&mut self, _noise: &mut Noise) {
        self.walk = 0.0;
    }
    fn tick(&mut self, now: &Now<'_>, noise: &mut Noise) {
        self.walk += self.wander * now.tick.sqrt() * noise.normal();
    }
    fn cell(&self, now: &Now<'_>, _force: f64, _state: &[f64]) -> f64 {
        self.rate * now.time + self.walk
    }
}

/// Error of a disc that is not centred, or of the lead of a screw: d cos(2 pi x/p - phi), once per
/// turn (Slocum 1992).
#[derive(Debug, Clone)]
pub struct EncoderCyclicError {
    /// d, m.
    pub amplitude: f64,
    /// p, m.
    pub period: f64,
    /// phi, rad.
    pub phase: f64,
}

impl EncoderCyclicError {
    /// 50 to 500 millionths of a period of 3 to 60 mm: 0.15 to 30 µm.
    pub fn draw(noise: &mut Noise) -> Effect {
        let period = noise.log_between(3e-3, 60e-3);
        Box::new(Self {
            amplitude: period * noise.log_between(50e-6, 500e-6),
            period,
            phase: noise.angle(),
        })
    }
}

impl Law for EncoderCyclicError {
    identity!("encoder_cyclic_error", Sensor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.amplitude), ("period", self.period), ("phase", self.phase)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { amplitude: factor * self.amplitude, ..self.clone() })
    }
    fn encoder(&self, now: &Now<'_>, _force: f64) -> f64 {
        self.amplitude * (TAU * now.x / self.period - self.phase).cos()
    }
}

/// Encoder on a motor that twists the drive before it moves the carriage: F/k ahead of it.
#[derive(Debug, Clone)]
pub struct EncoderCompliance {
    /// 1/k, m/N.
    pub compliance: f64,
}

impl EncoderCompliance {
    /// A drive of 30 to 300 N/µm.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { compliance: noise.log_between(30e6, 300e6).recip() })
    }
}

impl Law for EncoderCompliance {
    identity!("encoder_compliance", Sensor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("compliance", self.compliance)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { compliance: factor * self.compliance })
    }
    fn encoder(&self, _now: &Now<'_>, force: f64) -> f64 {
        self.compliance * force
    }
}

/// Lowpass of the cell's amplifier: T dy/dt = F - y, and the cell shows y.
#[derive(Debug, Clone)]
pub struct ForceCellLag {
    /// T, s; one below `SHORTEST` is none.
    pub time_constant: f64,
}

impl ForceCellLag {
    /// Shortest lag that the integrator follows, s: half a step.
    const SHORTEST: f64 = 10e-6;

    /// A corner of 60 to 600 Hz.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { time_constant: (TAU * noise.log_between(60.0, 600.0)).recip() })
    }
}

impl Law for ForceCellLag {
    identity!("force_cell_lag", Sensor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("time_constant", self.time_constant)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { time_constant: factor * self.time_constant })
    }
    fn states(&self) -> usize {
        usize::from(self.time_constant >= Self::SHORTEST)
    }
    fn rate(&self, _now: &Now<'_>, drive: &Drive, state: &[f64], rate: &mut [f64]) {
        if let ([shown], [rate]) = (state, rate) {
            *rate = (drive.motor_force - *shown) / self.time_constant;
        }
    }
    fn cell(&self, _now: &Now<'_>, force: f64, state: &[f64]) -> f64 {
        state.first().map_or(0.0, |shown| shown - force)
    }
}
