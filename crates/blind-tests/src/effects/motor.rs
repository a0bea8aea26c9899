//! Effects between command and force cell.

use std::f64::consts::TAU;

use super::super::noise::Noise;
use super::{Drive, Effect, Law, Now, Side, identity};

/// Detent force: sum over k of A_k cos(2 pi k (x - x0)/p - phi_k), independent of the current
/// (Gieras, Piech, Tomczuk, "Linear Synchronous Motors", 2nd ed. 2012, chapter 3).
#[derive(Debug, Clone)]
pub struct Cogging {
    /// p, m.
    pub period: f64,
    /// A_k (N) and phi_k (rad) for k = 1, 2, ...
    pub harmonics: Vec<(f64, f64)>,
}

impl Cogging {
    /// One harmonic.
    pub fn new(amplitude: f64, period: f64, phase: f64) -> Self {
        Self { period, harmonics: vec![(amplitude, phase)] }
    }

    /// 1 to 8 N at 10 to 32 mm, in half of the cases with a second harmonic of 10 to 35 %.
    pub fn draw(noise: &mut Noise) -> Effect {
        let mut cogging =
            Self::new(noise.log_between(1.0, 8.0), noise.between(0.010, 0.032), noise.angle());
        if noise.unit() < 0.5 {
            cogging
                .harmonics
                .push((cogging.harmonics[0].0 * noise.between(0.1, 0.35), noise.angle()));
        }
        Box::new(cogging)
    }
}

impl Law for Cogging {
    identity!("cogging", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        let (amplitude, phase) = self.harmonics[0];
        vec![
            ("amplitude", amplitude),
            ("period", self.period),
            ("phase", phase),
            ("second_amplitude", self.harmonics.get(1).map_or(0.0, |h| h.0)),
        ]
    }
    fn scaled(&self, factor: f64) -> Effect {
        let harmonics =
            self.harmonics.iter().map(|&(amplitude, phase)| (factor * amplitude, phase)).collect();
        Box::new(Self { harmonics, ..self.clone() })
    }
    fn motor(&self, now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        let angle = TAU * now.x / self.period;
        let wave = |(k, &(amplitude, phase)): (usize, &(f64, f64))| {
            amplitude * ((k + 1) as f64 * angle - phase).cos()
        };
        force + self.harmonics.iter().enumerate().map(wave).sum::<f64>()
    }
}

/// Force constant that depends on position: F (1 + r cos(2 pi x/p - phi)) (Rohrig and Jochheim
/// 2002).
#[derive(Debug, Clone)]
pub struct ForceRipple {
    /// r.
    pub fraction: f64,
    /// p, m.
    pub period: f64,
    /// phi, rad.
    pub phase: f64,
}

impl ForceRipple {
    /// 1 to 5 % at 12 to 32 mm.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            fraction: noise.log_between(0.01, 0.05),
            period: noise.between(0.012, 0.032),
            phase: noise.angle(),
        })
    }
}

impl Law for ForceRipple {
    identity!("force_ripple", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("fraction", self.fraction), ("period", self.period), ("phase", self.phase)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction, ..self.clone() })
    }
    fn rank(&self) -> u8 {
        4
    }
    fn motor(&self, now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        force + force * self.fraction * (TAU * now.x / self.period - self.phase).cos()
    }
}

/// Motor that makes (1 + e) times the force commanded.
#[derive(Debug, Clone)]
pub struct MotorGain {
    /// e.
    pub fraction: f64,
}

impl MotorGain {
    /// 1 to 5 %, up or down.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { fraction: noise.sign() * noise.log_between(0.01, 0.05) })
    }
}

impl Law for MotorGain {
    identity!("motor_gain", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("fraction", self.fraction)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction })
    }
    fn rank(&self) -> u8 {
        3
    }
    fn motor(&self, _now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        force + force * self.fraction
    }
}

/// Current loop: tau dF/dt = F_command(t - delay) - F.
#[derive(Debug, Clone)]
pub struct ActuatorLag {
    /// tau, s; 0 leaves the delay only.
    pub time_constant: f64,
    /// Delay, s.
    pub delay: f64,
}

impl ActuatorLag {
    /// A first order of 0.15 to 0.8 ms, a delay of 0.55 to 1.2 ms, or half of both. A delay below
    /// one tick alone would not show at the end of an interval, where the cell is read.
    pub fn draw(noise: &mut Noise) -> Effect {
        let (time_constant, delay) =
            (noise.log_between(0.15e-3, 0.8e-3), noise.log_between(0.55e-3, 1.2e-3));
        Box::new(match noise.index(3) {
            0 => Self { time_constant, delay: 0.0 },
            1 => Self { time_constant: 0.0, delay },
            _ => Self { time_constant: 0.5 * time_constant, delay: 0.5 * delay },
        })
    }
}

impl Law for ActuatorLag {
    identity!("actuator_lag", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("time_constant", self.time_constant), ("delay", self.delay)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { time_constant: factor * self.time_constant, delay: factor * self.delay })
    }
    fn delay(&self) -> Option<f64> {
        Some(self.delay)
    }
    fn rank(&self) -> u8 {
        0
    }
    fn states(&self) -> usize {
        usize::from(self.time_constant > 0.0)
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        if let ([force], [rate]) = (state, rate) {
            *rate = (now.held(self.delay) - *force) / self.time_constant;
        }
    }
    fn motor(&self, now: &Now<'_>, _force: f64, state: &[f64]) -> f64 {
        state.first().copied().unwrap_or_else(|| now.held(self.delay))
    }
}

/// Drive that needs w newtons of command before it makes any force: the force is what the command
/// has beyond +-w (Tao and Kokotovic 1994).
#[derive(Debug, Clone)]
pub struct DeadZone {
    /// w, N.
    pub width: f64,
}

impl DeadZone {
    /// 0.5 to 5 N.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { width: noise.log_between(0.5, 5.0) })
    }
}

impl Law for DeadZone {
    identity!("dead_zone", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("width", self.width)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { width: factor * self.width })
    }
    fn rank(&self) -> u8 {
        1
    }
    fn motor(&self, _now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        force.signum() * (force.abs() - self.width).max(0.0)
    }
}

/// Motor whose iron saturates: its force is bounded by S, F / S = sin(atan(u / S)) (the rounded
/// corner of a magnetisation curve).
#[derive(Debug, Clone)]
pub struct MotorSaturation {
    /// S, N.
    pub limit: f64,
}

impl MotorSaturation {
    /// 2.5 to 8 kN: 12 to 1.2 % of the largest force of the programme.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { limit: noise.log_between(2500.0, 8000.0) })
    }
}

impl Law for MotorSaturation {
    identity!("motor_saturation", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("saturation_force", self.limit)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        // What is lost goes with 1/S^2.
        Box::new(Self { limit: self.limit / factor.sqrt() })
    }
    fn rank(&self) -> u8 {
        2
    }
    fn motor(&self, _now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        self.limit * (force / self.limit).atan().sin()
    }
}

/// Motor whose force constant falls in proportion to the speed: (1 - c |v|) u.
#[derive(Debug, Clone)]
pub struct MotorDroop {
    /// c, s/m.
    pub coefficient: f64,
}

impl MotorDroop {
    /// 2 to 15 % at 1 m/s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { coefficient: noise.log_between(0.02, 0.15) })
    }
}

impl Law for MotorDroop {
    identity!("motor_droop", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("coefficient", self.coefficient)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { coefficient: factor * self.coefficient })
    }
    fn rank(&self) -> u8 {
        4
    }
    fn motor(&self, now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        force * (1.0 - self.coefficient * now.v.abs())
    }
}

/// Damping that varies along the track: F + c v cos(2 pi x/p - phi), where eddy currents brake
/// unevenly (odd), or F + c |v| cos(2 pi x/p - phi), where a current loop of finite gain lets the
/// ripple of the induced voltage through (even; assumed).
#[derive(Debug, Clone)]
pub struct SpeedRipple {
    /// c, N s/m.
    pub coefficient: f64,
    /// p, m.
    pub period: f64,
    /// phi, rad.
    pub phase: f64,
    /// Whether it changes its sign with v.
    pub odd: bool,
}

impl SpeedRipple {
    /// 8 to 60 N s/m at 12 to 32 mm, either law.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            coefficient: noise.log_between(8.0, 60.0),
            period: noise.between(0.012, 0.032),
            phase: noise.angle(),
            odd: noise.unit() < 0.5,
        })
    }
}

impl Law for SpeedRipple {
    identity!("speed_ripple", Motor);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("coefficient", self.coefficient),
            ("period", self.period),
            ("phase", self.phase),
            ("odd", f64::from(u8::from(self.odd))),
        ]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { coefficient: factor * self.coefficient, ..self.clone() })
    }
    fn motor(&self, now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        let speed = if self.odd { now.v } else { now.v.abs() };
        force + self.coefficient * speed * (TAU * now.x / self.period - self.phase).cos()
    }
}
