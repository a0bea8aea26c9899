//! Effects that are in no list: the honest answer to them is "unknown", with the coordinate
//! that they follow.

use super::super::guides::Change;
use super::super::noise::Noise;
use super::{Drive, Effect, Law, Now, Side, identity};

/// What unlisted effects have in common.
macro_rules! unlisted {
    ($name:literal, $coordinate:literal) => {
        identity!($name, Carriage);
        fn listed(&self) -> bool {
            false
        }
        fn coordinate(&self) -> Option<&'static str> {
            Some($coordinate)
        }
    };
}

/// Joint of two rails: a dip of force over a short way, F = -A exp(-((x - c)/w)^4) in both
/// directions.
#[derive(Debug, Clone)]
pub struct RailJoint {
    /// A, N.
    pub force: f64,
    /// c, m.
    pub center: f64,
    /// w, m.
    pub width: f64,
}

impl RailJoint {
    /// 4 to 20 N over 1 to 4 mm.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            force: noise.sign() * noise.log_between(4.0, 20.0),
            center: noise.between(-0.045, 0.0),
            width: noise.log_between(0.001, 0.004),
        })
    }
}

impl Law for RailJoint {
    unlisted!("rail_joint", "position");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.force), ("center", self.center), ("width", self.width)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { force: factor * self.force, ..self.clone() })
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        -self.force * (-((now.x - self.center) / self.width).powi(4)).exp()
    }
}

/// A force that appears at a time in the record (something leans on the carriage).
#[derive(Debug, Clone)]
pub struct ForceStep {
    /// N.
    pub force: f64,
    /// s from the start of each record.
    pub time: f64,
}

impl ForceStep {
    /// 1 to 6 N after 4 to 12 s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            force: noise.sign() * noise.log_between(1.0, 6.0),
            time: noise.between(4.0, 12.0),
        })
    }
}

impl Law for ForceStep {
    unlisted!("force_step", "time");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.force), ("time", self.time)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { force: factor * self.force, ..self.clone() })
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        // Over 1 ms, so that the integrator sees no jump.
        self.force * 0.5 * (1.0 + ((now.time - self.time) / 1e-3).tanh())
    }
}

/// Friction that changes at a time in the record (a seal that comes loose): Fc and Fs times 1 + f
/// from then on.
#[derive(Debug, Clone)]
pub struct FrictionStep {
    /// f.
    pub fraction: f64,
    /// s from the start of each record.
    pub time: f64,
}

impl FrictionStep {
    /// 8 to 30 %, up or down, after 4 to 12 s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            fraction: noise.sign() * noise.log_between(0.08, 0.3),
            time: noise.between(4.0, 12.0),
        })
    }
}

impl Law for FrictionStep {
    unlisted!("friction_step", "time");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("fraction", self.fraction), ("time", self.time)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction, ..self.clone() })
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, now: &Now<'_>, _state: &[f64], change: &mut Change) {
        change.level *= 1.0 + self.fraction * 0.5 * (1.0 + ((now.time - self.time) / 1e-3).tanh());
    }
}

/// A workpiece that is taken off, or put on, at a time in the record: the mass changes by m from
/// then on.
#[derive(Debug, Clone)]
pub struct PayloadStep {
    /// m, kg.
    pub mass: f64,
    /// s from the start of each record.
    pub time: f64,
}

impl PayloadStep {
    /// 0.5 to 3 kg, more or less, after 4 to 12 s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            mass: noise.sign() * noise.log_between(0.5, 3.0),
            time: noise.between(4.0, 12.0),
        })
    }
}

impl Law for PayloadStep {
    unlisted!("payload_step", "time");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("mass", self.mass), ("time", self.time)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { mass: factor * self.mass, ..self.clone() })
    }
    fn added_mass_now(&self, now: &Now<'_>) -> f64 {
        self.mass * 0.5 * (1.0 + ((now.time - self.time) / 1e-3).tanh())
    }
}

/// Eddy-current brake: F = -2 B (v/vc)/(1 + (v/vc)^2), largest at vc (Wouterse 1991, eq. 12).
#[derive(Debug, Clone)]
pub struct SaturatingBrake {
    /// B, N.
    pub force: f64,
    /// vc, m/s.
    pub speed: f64,
}

impl SaturatingBrake {
    /// 3 to 15 N at 50 to 250 mm/s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { force: noise.log_between(3.0, 15.0), speed: noise.log_between(0.05, 0.25) })
    }
}

impl Law for SaturatingBrake {
    unlisted!("saturating_brake", "velocity");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.force), ("speed", self.speed)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { force: factor * self.force, ..self.clone() })
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        let ratio = now.v / self.speed;
        -2.0 * self.force * ratio / (1.0 + ratio * ratio)
    }
}

/// Seal that sticks: a lip with drag S (1 + m q) p; p follows the direction over 0.1 mm, the
/// freshness q grows at rest within tau and is rubbed off over a travel L.
#[derive(Debug, Clone)]
pub struct SealMemory {
    /// S, N.
    pub force: f64,
    /// m.
    pub rise: f64,
    /// tau, s.
    pub time_constant: f64,
    /// L, m.
    pub length: f64,
}

impl SealMemory {
    /// 2 to 6 N, three to six times that after a rest of 0.05 to 0.3 s, over 3 to 20 mm.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            force: noise.log_between(2.0, 6.0),
            rise: noise.between(2.0, 5.0),
            time_constant: noise.log_between(0.05, 0.3),
            length: noise.log_between(0.003, 0.02),
        })
    }
}

impl Law for SealMemory {
    unlisted!("seal_memory", "travelled distance");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("amplitude", self.force),
            ("rise", self.rise),
            ("time_constant", self.time_constant),
            ("length", self.length),
        ]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { force: factor * self.force, ..self.clone() })
    }
    fn states(&self) -> usize {
        2
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        let speed = now.v.abs();
        rate[0] = (now.v - speed * state[0]) / 1e-4;
        rate[1] = (1.0 - state[1]) / self.time_constant - speed * state[1] / self.length;
    }
    fn carriage(&self, _now: &Now<'_>, state: &[f64]) -> f64 {
        -self.force * (1.0 + self.rise * state[1]) * state[0]
    }
}

/// A dog dragged along with play: it presses with a spring k outside a gap of +-w and slides at a
/// force A, so after each reversal it is silent over 2 w.
#[derive(Debug, Clone)]
pub struct LostMotion {
    /// A, N.
    pub force: f64,
    /// w, m.
    pub gap: f64,
    /// k, N/m.
    pub stiffness: f64,
}

impl LostMotion {
    /// 2 to 8 N, +-1 to 6 mm, 20 kN/m.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            force: noise.log_between(2.0, 8.0),
            gap: noise.log_between(0.001, 0.006),
            stiffness: 2e4,
        })
    }

    fn press(&self, x: f64, dog: f64) -> f64 {
        let apart = x - dog;
        self.stiffness * (apart - apart.clamp(-self.gap, self.gap))
    }
}

impl Law for LostMotion {
    unlisted!("lost_motion", "travelled distance");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("amplitude", self.force), ("gap", self.gap), ("stiffness", self.stiffness)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self {
            force: factor * self.force,
            stiffness: factor * self.stiffness,
            ..self.clone()
        })
    }
    fn states(&self) -> usize {
        1
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        // Sliding begins gradually, as in LuGre without a Stribeck curve, at the rate at which the
        // spring is pressed.
        let pressed = self.press(now.x, state[0]) / self.force;
        rate[0] = if pressed * now.v > 0.0 { now.v * pressed.abs().min(1.0).powi(4) } else { 0.0 };
    }
    fn carriage(&self, now: &Now<'_>, state: &[f64]) -> f64 {
        -self.press(now.x, state[0])
    }
}

/// A force that depends on position times velocity (a damper on a lever that turns): F = -c x v.
#[derive(Debug, Clone)]
pub struct PositionVelocity {
    /// c, N s/m^2.
    pub coefficient: f64,
}

impl PositionVelocity {
    /// 150 to 800 N s/m^2: 1.5 to 8 N at 100 mm and 100 mm/s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { coefficient: noise.log_between(150.0, 800.0) })
    }
}

impl Law for PositionVelocity {
    unlisted!("position_velocity", "position and velocity");
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("coefficient", self.coefficient)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { coefficient: factor * self.coefficient })
    }
    fn carriage(&self, now: &Now<'_>, _state: &[f64]) -> f64 {
        -self.coefficient * now.x * now.v
    }
}
