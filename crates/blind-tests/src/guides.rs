//! Four guides with LuGre friction (Canudas de Wit, Olsson, Astrom, Lischinsky 1995, eqs. 1 to 4
//! with the usual Gaussian Stribeck curve), each with its own parameters, and the ways in which a
//! hidden effect changes that law.
//!
//! dz/dt = v - sigma0 |v| z/g(v), g = Fc + (Fs - Fc) exp(-(v/vs)^2), F = sigma0 z + sigma1 dz/dt +
//! sigma2 v; F opposes +v.

use serde::Serialize;

use super::noise::Noise;

/// Number of guides.
pub const GUIDES: usize = 4;

/// LuGre parameters of one guide.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Guide {
    /// sigma0, N/m.
    pub stiffness: f64,
    /// sigma1, N s/m.
    pub bristle_damping: f64,
    /// sigma2, N s/m.
    pub viscous: f64,
    /// Fc, N.
    pub coulomb_force: f64,
    /// Fs, N.
    pub static_force: f64,
    /// vs, m/s.
    pub stribeck_velocity: f64,
}

impl Guide {
    /// The declared (nominal) guide of the recorded stage runs.
    pub const NOMINAL: Self = Self {
        stiffness: 4.5e5,
        bristle_damping: 900.0,
        viscous: 18.0,
        coulomb_force: 13.5,
        static_force: 16.8,
        stribeck_velocity: 5e-3,
    };

    /// A guide whose parameters lie uniformly within +-`tolerance` (a share) of the nominal ones,
    /// with Fs above Fc.
    pub fn draw(tolerance: f64, noise: &mut Noise) -> Self {
        let nominal = Self::NOMINAL;
        let mut near = |value: f64| value * (1.0 + tolerance * noise.between(-1.0, 1.0));
        let mut guide = Self {
            stiffness: near(nominal.stiffness),
            bristle_damping: near(nominal.bristle_damping),
            viscous: near(nominal.viscous),
            coulomb_force: near(nominal.coulomb_force),
            static_force: near(nominal.static_force),
            stribeck_velocity: near(nominal.stribeck_velocity),
        };
        while guide.static_force <= guide.coulomb_force {
            guide.static_force = near(nominal.static_force);
        }
        guide
    }

    /// g(v) of the law above, N, under `change`.
    fn sliding_force(&self, v: f64, change: &Change) -> f64 {
        let ratio = (change.sliding_velocity.unwrap_or(v) / self.stribeck_velocity).powi(2);
        // exp(-36) is below the rounding of the sum.
        let above = if ratio > 36.0 { 0.0 } else { (-ratio).exp() };
        let static_force = self.static_force * (1.0 + change.static_rise);
        change.level * (self.coulomb_force + (static_force - self.coulomb_force) * above)
    }

    /// Friction at a constant velocity (m/s) without any effect, N.
    pub fn steady(&self, v: f64) -> f64 {
        self.sliding_force(v, &Change::default()) * v.signum() + self.viscous * v
    }
}

/// How effects change the friction law at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// Factor on Fc and Fs.
    pub level: f64,
    /// Increase of Fs, as a share of it.
    pub static_rise: f64,
    /// Factor on sigma2.
    pub viscous: f64,
    /// Velocity at which g is evaluated in place of v, m/s.
    pub sliding_velocity: Option<f64>,
}

impl Default for Change {
    fn default() -> Self {
        Self { level: 1.0, static_rise: 0.0, viscous: 1.0, sliding_velocity: None }
    }
}

/// Time in which a sudden element comes to its limit, s: a step of the integrator.
const SETTLING: f64 = 20e-6;

/// How an element of a guide turns from sticking to slipping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slip {
    /// As LuGre does: gradually, dz/dt = v - |v| z/limit.
    Gradual,
    /// As a Maxwell-slip (Jenkin) element: dz/dt = v until |z| reaches the limit, then z stays
    /// there (Iwan 1966). It comes to the limit, and follows one that moves, within `SETTLING`.
    Sudden,
}

/// The elements that act in parallel in each guide.
#[derive(Debug, Clone, PartialEq)]
pub struct Elements {
    /// Share of sigma0 and of g(v) of each; both sum to 1.
    pub shares: Vec<(f64, f64)>,
    /// Law of all elements.
    pub slip: Slip,
}

impl Elements {
    /// One LuGre bristle.
    pub fn single() -> Self {
        Self { shares: vec![(1.0, 1.0)], slip: Slip::Gradual }
    }

    /// States of all guides together.
    pub fn states(&self) -> usize {
        GUIDES * self.shares.len()
    }

    /// Deflection at which an element slips, m.
    fn limit(guide: &Guide, (stiffness, strength): (f64, f64), sliding_force: f64) -> f64 {
        strength * sliding_force / (stiffness * guide.stiffness)
    }

    /// Friction of all guides together, N (positive opposes +v), and the rates of the deflections,
    /// m/s.
    pub fn force(
        &self,
        guides: &[Guide; GUIDES],
        v: f64,
        change: &Change,
        z: &[f64],
        rate: &mut [f64],
    ) -> f64 {
        let mut total = 0.0;
        let each = self.shares.len();
        for (guide, (z, rate)) in
            guides.iter().zip(z.chunks_exact(each).zip(rate.chunks_exact_mut(each)))
        {
            let sliding = guide.sliding_force(v, change);
            let mut mean = [0.0; 2];
            for (&share, (&z, rate)) in self.shares.iter().zip(z.iter().zip(rate)) {
                let limit = Self::limit(guide, share, sliding);
                *rate = match self.slip {
                    Slip::Gradual => v - v.abs() * z / limit,
                    Slip::Sudden => v.max((-limit - z) / SETTLING).min((limit - z) / SETTLING),
                };
                mean[0] += share.0 * z;
                mean[1] += share.0 * *rate;
            }
            total += guide.stiffness * mean[0]
                + guide.bristle_damping * mean[1]
                + guide.viscous * change.viscous * v;
        }
        total
    }
}
