//! Up to four LuGre guides, advanced together: one lane each.

use std::f64::consts::LOG2_E;

use wide::f64x4;

use crate::model::{Guide, MAX_GUIDES};

use super::exp2::exp2_of_negative;

/// Largest sum of bristle damping and viscous friction times step over mass: the explicit carriage step is stable below 1.
pub const MAX_STEP_DAMPING: f64 = 0.5;

/// The guides of one stage with their bristles. Lanes without a guide stay at zero force.
///
/// Law (Canudas de Wit et al., IEEE TAC 40(3), 1995): dz/dt = v - sigma0 |v| z / g(v), F = sigma0 z + sigma1 dz/dt + sigma2 v.
#[derive(Clone, Debug)]
pub struct GuideBank {
    count: usize,
    /// sigma0, N/m; its inverse; -log2(e) sigma0, which times |v| t / g is the power of two of the bristle's decay over t.
    stiffness: f64x4,
    compliance: f64x4,
    relaxation: f64x4,
    /// sigma1, N s/m.
    bristle_damping: f64x4,
    /// sum of sigma2, N s/m.
    viscous_friction: f64,
    /// Fc and Fs - Fc, N.
    coulomb_force: f64x4,
    stribeck_force: f64x4,
    /// -log2(e)/vs^2, s^2/m^2.
    stribeck_exponent: f64x4,
    /// -log2(e)/vd^2, s^2/m^2; 0 where the bristle damping is constant.
    damping_exponent: f64x4,
    damping_fades: bool,
    /// Bristle deflection z, m.
    bristle: f64x4,
    start: StartFriction,
}

/// Friction of all guides over velocity at the present deflections, with g and sigma1 as of the middle of the last step:
/// elastic + damping v - slip |v|.
#[derive(Clone, Copy, Debug, Default)]
struct StartFriction {
    /// Sum of sigma0 z, N.
    elastic: f64,
    /// Sum of sigma1 + sigma2, N s/m.
    damping: f64,
    /// Sum of sigma1 sigma0 z / g, N s/m.
    slip: f64,
}

impl GuideBank {
    /// Bristles start unloaded. The guides must have passed [`Guide::check`]; at most [`MAX_GUIDES`].
    pub fn new(guides: &[Guide]) -> GuideBank {
        assert!(guides.len() <= MAX_GUIDES, "{} guides, at most {MAX_GUIDES}", guides.len());
        let lanes = |absent: f64, value: &dyn Fn(&Guide) -> f64| {
            f64x4::new(std::array::from_fn(|lane| guides.get(lane).map_or(absent, value)))
        };
        let mut bank = GuideBank {
            count: guides.len(),
            stiffness: lanes(0.0, &|guide| guide.stiffness),
            compliance: lanes(0.0, &|guide| guide.stiffness.recip()),
            relaxation: lanes(0.0, &|guide| -LOG2_E * guide.stiffness),
            bristle_damping: lanes(0.0, &|guide| guide.bristle_damping),
            viscous_friction: guides.iter().map(|guide| guide.viscous_friction).sum(),
            coulomb_force: lanes(1.0, &|guide| guide.coulomb_force),
            stribeck_force: lanes(0.0, &|guide| guide.static_force - guide.coulomb_force),
            stribeck_exponent: lanes(0.0, &|guide| -LOG2_E * guide.stribeck_velocity.powi(-2)),
            damping_exponent: lanes(0.0, &|guide| {
                guide.damping_velocity.map_or(0.0, |velocity| -LOG2_E * velocity.powi(-2))
            }),
            damping_fades: guides.iter().any(|guide| guide.damping_velocity.is_some()),
            bristle: f64x4::ZERO,
            start: StartFriction::default(),
        };
        bank.refresh(0.0);
        bank
    }

    pub fn count(&self) -> usize {
        self.count
    }

    /// Bristle deflections z, m, one per guide.
    pub fn bristles(&self) -> &[f64] {
        &self.bristle.as_array()[..self.count]
    }

    /// Sets the bristle deflections, m, for a stage that moves at `velocity`; lanes beyond `bristles` stay as they are.
    pub fn set_bristles(&mut self, bristles: &[f64], velocity: f64) {
        for (lane, bristle) in self.bristle.as_mut_array().iter_mut().zip(bristles) {
            *lane = *bristle;
        }
        self.refresh(velocity);
    }

    /// Recomputes what one step hands to the next, after a state was set from outside.
    fn refresh(&mut self, velocity: f64) {
        let squared = f64x4::splat(velocity * velocity);
        self.prepare_start(self.level(squared), self.damping_at(squared));
    }

    #[inline]
    fn prepare_start(&mut self, level: f64x4, damping: f64x4) {
        let elastic = self.stiffness * self.bristle;
        self.start = StartFriction {
            elastic: elastic.reduce_add(),
            damping: damping.reduce_add() + self.viscous_friction,
            slip: (damping / level * elastic).reduce_add(),
        };
    }

    fn level(&self, velocity_squared: f64x4) -> f64x4 {
        self.coulomb_force + self.stribeck_force * exp2_of_negative(self.stribeck_exponent * velocity_squared)
    }

    fn damping_at(&self, velocity_squared: f64x4) -> f64x4 {
        if self.damping_fades {
            self.bristle_damping * exp2_of_negative(self.damping_exponent * velocity_squared)
        } else {
            self.bristle_damping
        }
    }

    /// Bristle velocities dz/dt at velocity v, m/s.
    fn bristle_velocities(&self, velocity: f64) -> (f64x4, f64x4) {
        let v = f64x4::splat(velocity);
        let squared = v * v;
        let rate = v - self.stiffness * v.abs() * self.bristle / self.level(squared);
        (rate, self.damping_at(squared))
    }

    /// Friction of each guide on the carriage at velocity v, N; positive against positive motion.
    pub fn forces(&self, velocity: f64, viscous: &[f64; MAX_GUIDES]) -> [f64; MAX_GUIDES] {
        let (rate, damping) = self.bristle_velocities(velocity);
        (self.stiffness * self.bristle + damping * rate + f64x4::new(*viscous) * f64x4::splat(velocity)).to_array()
    }

    /// Sum of the friction at velocity v, N, exact in v.
    pub fn force(&self, velocity: f64) -> f64 {
        let (rate, damping) = self.bristle_velocities(velocity);
        (self.stiffness * self.bristle + damping * rate).reduce_add() + self.viscous_friction * velocity
    }

    /// Energy stored in the bristles, J: sum of sigma0 z^2 / 2.
    pub fn stored_energy(&self) -> f64 {
        (self.stiffness * self.bristle * self.bristle).reduce_add() / 2.0
    }

    /// Power that the guides turn into heat at velocity v, W: friction power less the power that loads the bristles.
    pub fn dissipated_power(&self, velocity: f64) -> f64 {
        let (rate, _) = self.bristle_velocities(velocity);
        self.force(velocity) * velocity - (self.stiffness * self.bristle * rate).reduce_add()
    }

    /// Sum of sigma2, N s/m.
    pub fn viscous_friction(&self) -> f64 {
        self.viscous_friction
    }

    /// Friction at the start of a step, N, with the Stribeck level of the last step's middle in place of a new exponential.
    ///
    /// First order in the level, which enters the carriage's velocity in second order only: half a step times sigma1/m.
    #[inline]
    pub(super) fn start_force(&self, velocity: f64) -> f64 {
        self.start.elastic + self.start.damping * velocity - self.start.slip * velocity.abs()
    }

    /// Moves the bristles over `step` seconds at the constant velocity v, exactly:
    /// z' = zs + (z - zs) exp(-sigma0 |v| step / g), zs = g sign(v) / sigma0. Stable at any speed and step.
    ///
    /// Returns the momentum that bristles and their damping take from the carriage, N s: the sum over the guides of
    /// step sigma0 (z + z')/2 + sigma1 (z' - z), of which the second part is exact.
    #[inline]
    pub(super) fn advance(&mut self, velocity: f64, step: f64) -> f64 {
        let squared = f64x4::splat(velocity * velocity);
        let level = self.level(squared);
        let damping = self.damping_at(squared);
        let decay = exp2_of_negative(self.relaxation * f64x4::splat(velocity.abs() * step) / level);
        let steady = level * self.compliance * f64x4::splat(1f64.copysign(velocity));
        let excess = self.bristle - steady;
        // The impulse is linear in z and z': what does not need the decay is added up while that is on its way.
        let half = self.stiffness * f64x4::splat(0.5 * step);
        let (of_start, of_end) = (half - damping, half + damping);
        let impulse = (of_start * self.bristle + of_end * steady).reduce_add() + (of_end * excess * decay).reduce_add();
        self.bristle = steady + excess * decay;
        self.prepare_start(level, damping);
        impulse
    }
}
