//! Effects that change the friction law of the guides.

use std::f64::consts::TAU;

use super::super::guides::{Change, Elements, Slip};
use super::super::noise::Noise;
use super::{Drive, Effect, Law, Now, Side, identity};

/// Friction that differs by direction: Fc and Fs times 1 + a sgn(v), sigma2 times 1 + b sgn(v).
#[derive(Debug, Clone)]
pub struct AsymmetricFriction {
    /// a.
    pub coulomb: f64,
    /// b.
    pub viscous: f64,
}

impl AsymmetricFriction {
    /// 2 to 12 % of the Coulomb part, 0 to 25 % of the viscous part, either sign.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            coulomb: noise.sign() * noise.log_between(0.02, 0.12),
            viscous: noise.sign() * noise.between(0.0, 0.25),
        })
    }
}

impl Law for AsymmetricFriction {
    identity!("asymmetric_friction", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("coulomb_fraction", self.coulomb), ("viscous_fraction", self.viscous)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { coulomb: factor * self.coulomb, viscous: factor * self.viscous })
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, now: &Now<'_>, _state: &[f64], change: &mut Change) {
        change.level *= 1.0 + self.coulomb * now.v.signum();
        change.viscous *= 1.0 + self.viscous * now.v.signum();
    }
}

/// How friction varies along the rail.
#[derive(Debug, Clone, Copy)]
pub enum Shape {
    /// exp(-((x - center)/width)^2): a tight place.
    Bump {
        /// m.
        center: f64,
        /// m.
        width: f64,
    },
    /// cos(2 pi x/period - phase): a rail that is not straight.
    Wave {
        /// m.
        period: f64,
        /// rad.
        phase: f64,
    },
}

/// Fc and Fs times 1 + f s(x).
#[derive(Debug, Clone)]
pub struct PositionDependentFriction {
    /// f.
    pub fraction: f64,
    /// s.
    pub shape: Shape,
}

impl PositionDependentFriction {
    /// 5 to 30 %, a bump of 5 to 20 mm or a wave of 50 to 200 mm.
    pub fn draw(noise: &mut Noise) -> Effect {
        let fraction = noise.log_between(0.05, 0.3);
        let shape = if noise.unit() < 0.5 {
            Shape::Bump {
                center: noise.between(-0.08, 0.06),
                width: noise.log_between(0.005, 0.02),
            }
        } else {
            Shape::Wave { period: noise.log_between(0.05, 0.2), phase: noise.angle() }
        };
        Box::new(Self { fraction, shape })
    }
}

impl Law for PositionDependentFriction {
    identity!("position_dependent_friction", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        let mut all = vec![("fraction", self.fraction)];
        all.extend(match self.shape {
            Shape::Bump { center, width } => [("center", center), ("width", width)],
            Shape::Wave { period, phase } => [("period", period), ("phase", phase)],
        });
        all
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction, ..self.clone() })
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, now: &Now<'_>, _state: &[f64], change: &mut Change) {
        let shape = match self.shape {
            Shape::Bump { center, width } => (-((now.x - center) / width).powi(2)).exp(),
            Shape::Wave { period, phase } => (TAU * now.x / period - phase).cos(),
        };
        change.level *= 1.0 + self.fraction * shape;
    }
}

/// Contacts of unequal strength in parallel in each guide (Iwan 1966): equal shares of sigma0, slip
/// deflections in geometric progression, so that their strengths sum to g(v).
#[derive(Debug, Clone)]
pub struct DistributedBristles {
    /// Logarithm of largest over smallest slip deflection; 0 is one bristle.
    pub spread: f64,
    /// Number of elements per guide.
    pub elements: usize,
    /// Law of each.
    pub slip: Slip,
}

impl DistributedBristles {
    /// Largest spread that the integrator follows at 1 m/s: a ratio of 100.
    const WIDEST: f64 = 4.6;

    /// Ratio of 4 to 30 over 4 to 8 elements, either law.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            spread: noise.between(4f64.ln(), 30f64.ln()),
            elements: 4 + noise.index(5),
            slip: if noise.unit() < 0.5 { Slip::Gradual } else { Slip::Sudden },
        })
    }
}

impl Law for DistributedBristles {
    identity!("distributed_bristles", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        let sudden = f64::from(u8::from(self.slip == Slip::Sudden));
        vec![("spread", self.spread), ("elements", self.elements as f64), ("sudden", sudden)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { spread: (factor * self.spread).min(Self::WIDEST), ..self.clone() })
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn elements(&self) -> Option<Elements> {
        let place = |i: usize| i as f64 / (self.elements.max(2) - 1) as f64;
        let raw: Vec<f64> = (0..self.elements).map(|i| (self.spread * place(i)).exp()).collect();
        let sum: f64 = raw.iter().sum();
        let share = 1.0 / self.elements as f64;
        Some(Elements { shares: raw.iter().map(|r| (share, r / sum)).collect(), slip: self.slip })
    }
}

/// Static friction that grows with the age of the contact: Fs (1 + b ln(1 + theta/tau)), d
/// theta/dt = 1 - |v| theta/D (aging law of Dieterich 1979 and Ruina 1983).
#[derive(Debug, Clone)]
pub struct StictionAging {
    /// b.
    pub rise: f64,
    /// tau, s.
    pub time_constant: f64,
    /// D, m: travel that renews the contact; the integrator is stable down to 8 µm at 1 m/s.
    pub length: f64,
}

impl StictionAging {
    /// 8 to 40 % per e-fold of 0.1 to 1 s, renewed over 20 to 60 µm.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            rise: noise.log_between(0.08, 0.4),
            time_constant: noise.log_between(0.1, 1.0),
            length: noise.log_between(20e-6, 60e-6),
        })
    }
}

impl Law for StictionAging {
    identity!("stiction_aging", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("fraction", self.rise),
            ("time_constant", self.time_constant),
            ("length", self.length),
        ]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { rise: factor * self.rise, ..self.clone() })
    }
    fn states(&self) -> usize {
        1
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        rate[0] = 1.0 - now.v.abs() * state[0] / self.length;
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, _now: &Now<'_>, state: &[f64], change: &mut Change) {
        change.static_rise += self.rise * (state[0].max(0.0) / self.time_constant).ln_1p();
    }
}

/// Grease that warms with the work done on it: sigma2 (1 - q (1 - exp(-W/W0))), dW/dt = friction
/// power. Each record starts cold.
#[derive(Debug, Clone)]
pub struct ViscousWarmUp {
    /// q: share of sigma2 lost when warm.
    pub fraction: f64,
    /// W0, J.
    pub work: f64,
}

impl ViscousWarmUp {
    /// 15 to 50 % over 20 to 120 J.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            fraction: noise.log_between(0.15, 0.5),
            work: noise.log_between(20.0, 120.0),
        })
    }
}

impl Law for ViscousWarmUp {
    identity!("viscous_warm_up", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("fraction", self.fraction), ("work", self.work)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction, ..self.clone() })
    }
    fn states(&self) -> usize {
        1
    }
    fn rate(&self, _now: &Now<'_>, drive: &Drive, _state: &[f64], rate: &mut [f64]) {
        rate[0] = drive.friction_power;
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, _now: &Now<'_>, state: &[f64], change: &mut Change) {
        change.viscous *= 1.0 - self.fraction * (1.0 - (-state[0] / self.work).exp());
    }
}

/// Dry friction that grows with the load of the drive: Fc and Fs times 1 + c |u|, u the command
/// (Hamon, Gautier, Garrec 2010).
#[derive(Debug, Clone)]
pub struct LoadDependentFriction {
    /// c, 1/N.
    pub rate: f64,
}

impl LoadDependentFriction {
    /// 2 to 15 % at 100 N.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { rate: noise.log_between(2e-4, 1.5e-3) })
    }
}

impl Law for LoadDependentFriction {
    identity!("load_dependent_friction", Carriage);
    // The library has the law, and its search does not add it.
    fn listed(&self) -> bool {
        false
    }
    fn coordinate(&self) -> Option<&'static str> {
        Some("force")
    }
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("rate", self.rate)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { rate: factor * self.rate })
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, now: &Now<'_>, _state: &[f64], change: &mut Change) {
        change.level *= 1.0 + self.rate * now.held(0.0).abs();
    }
}

/// Friction that settles at another level in the course of a record, whatever the motion: Fc and Fs
/// times 1 + f (1 - exp(-t/T)) (assumed). Each record starts alike.
#[derive(Debug, Clone)]
pub struct FrictionDrift {
    /// f.
    pub fraction: f64,
    /// T, s.
    pub time_constant: f64,
}

impl FrictionDrift {
    /// 6 to 25 %, up or down, over 1.5 to 12 s.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self {
            fraction: noise.sign() * noise.log_between(0.06, 0.25),
            time_constant: noise.log_between(1.5, 12.0),
        })
    }
}

impl Law for FrictionDrift {
    identity!("friction_drift", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("fraction", self.fraction), ("time_constant", self.time_constant)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { fraction: factor * self.fraction, ..self.clone() })
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, now: &Now<'_>, _state: &[f64], change: &mut Change) {
        change.level *= 1.0 + self.fraction * (1.0 - (-now.time / self.time_constant).exp());
    }
}

/// Stribeck curve that follows the velocity late: g(w) in place of g(v), dw/dt = (v - w)/T (a lag
/// as Hess and Soom 1990 measured it, here of first order; Armstrong-Helouvry, Dupont, Canudas de
/// Wit 1994).
#[derive(Debug, Clone)]
pub struct FrictionalLag {
    /// T, s; one below `SHORTEST` is none.
    pub time_constant: f64,
}

impl FrictionalLag {
    /// Shortest lag that the integrator follows, s: half a step.
    const SHORTEST: f64 = 10e-6;

    /// 3 to 30 ms.
    pub fn draw(noise: &mut Noise) -> Effect {
        Box::new(Self { time_constant: noise.log_between(3e-3, 30e-3) })
    }
}

impl Law for FrictionalLag {
    identity!("frictional_lag", Carriage);
    fn parameters(&self) -> Vec<(&'static str, f64)> {
        vec![("time_constant", self.time_constant)]
    }
    fn scaled(&self, factor: f64) -> Effect {
        Box::new(Self { time_constant: factor * self.time_constant })
    }
    fn states(&self) -> usize {
        usize::from(self.time_constant >= Self::SHORTEST)
    }
    fn rate(&self, now: &Now<'_>, _drive: &Drive, state: &[f64], rate: &mut [f64]) {
        if let ([late], [rate]) = (state, rate) {
            *rate = (now.v - *late) / self.time_constant;
        }
    }
    fn changes_friction(&self) -> bool {
        true
    }
    fn friction(&self, _now: &Now<'_>, state: &[f64], change: &mut Change) {
        change.sliding_velocity = state.first().copied();
    }
}
