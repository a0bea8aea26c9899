//! Hardening spring: cables, hoses or a bellows that pull the harder per way the further they are
//! stretched.
//!
//! F = -h (x - xc)^3, along +x on the carriage: xc center (m), h hardening (N/m^3). It holds
//! h (x - xc)^4 / 4 and gives it back. Source: cubic part of the spring of G. Duffing ("Erzwungene
//! Schwingungen bei veränderlicher Eigenfrequenz", 1918); the linear part is a `cable_chain`, and a
//! cable may have both. Sizes: assumed, 1 to 10 N over the stroke. Not modelled: hysteresis
//! (`cable_chain`), a spring that is softer when stretched, unequal sides.
//!
//! Distinguished from a `cable_chain` by a stroke long enough for its force to bend. A `cogging` of
//! a period longer than the travel looks like it, and the data cannot say.

use super::regression::least_squares;
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, Motion, Multiplicity, RecordSpecific,
    Residual, Role, descriptor,
};

/// Largest hardening, N/m^3.
const HARDEST: f64 = 1e9;
/// Furthest center, m.
const FURTHEST: f64 = 10.0;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "hardening_spring",
    role: Role::CarriageForce,
    law: "F = -hardening (x - center)^3",
    source: "Duffing 1918, cubic part",
    telltale: "third power of the position at every speed, not seen by the force cell",
    parameters: &[
        EffectParameter::required(
            "hardening",
            "N/m^3",
            "force over the third power of the stretch",
            (0.0, HARDEST),
            100.0,
        ),
        EffectParameter::optional(
            "center",
            "m",
            "position at which it does not pull",
            (-FURTHEST, FURTHEST),
            0.05,
            0.0,
        ),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[1000.0, 0.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::CarriageForce(Box::new(HardeningSpring::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct HardeningSpring {
    hardening: f64,
    center: f64,
}

impl HardeningSpring {
    fn new(values: &[f64]) -> HardeningSpring {
        HardeningSpring { hardening: values[0], center: values[1] }
    }
}

impl ForceLaw for HardeningSpring {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        -self.hardening * (motion.position - self.center).powi(3)
    }

    /// The slope 1 m from the center (assumed as the longest stretch).
    fn stiffness(&self) -> f64 {
        3.0 * self.hardening
    }

    fn stored_energy(&self, position: f64) -> f64 {
        0.25 * self.hardening * (position - self.center).powi(4)
    }
}

/// The polynomial of the third order over position, where it explains more than a straight line.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let at = |k: usize| residual.position[k];
    let base = least_squares(residual.force, |k| [1.0, at(k)])?;
    let fit = least_squares(residual.force, |k| [1.0, at(k), at(k).powi(2), at(k).powi(3)])?;
    let [_, _, second, third] = fit.coefficients;
    let hardening = -third;
    if !fit.improves_on(&base) || hardening <= 0.0 {
        return None;
    }
    // -h (x - xc)^3 has 3 h xc x^2.
    let center = (second / (3.0 * hardening)).clamp(-FURTHEST, FURTHEST);
    Some(vec![hardening.min(HARDEST), center])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn it_pulls_to_its_center_and_eight_times_as_hard_at_twice_the_stretch() {
        let mut spring = HardeningSpring::new(&[2000.0, 0.05]);
        let mut at = |position| spring.force(&Motion { position, ..Motion::default() }, 1e-4);
        assert_eq!(at(0.05), 0.0);
        assert!((at(0.15) + 2.0).abs() < 1e-12 && (at(0.25) + 16.0).abs() < 1e-12);
        assert!((at(-0.05) - 2.0).abs() < 1e-12);
    }

    /// Central differences of the energy.
    #[test]
    fn its_force_is_the_slope_of_its_energy() {
        let mut spring = HardeningSpring::new(&[3000.0, -0.02]);
        for position in [-0.3, -0.02, 0.01, 0.2] {
            let energy = |offset: f64| spring.stored_energy(position + offset);
            let slope = (energy(1e-5) - energy(-1e-5)) / 2e-5;
            let force = spring.force(&Motion { position, ..Motion::default() }, 1e-4);
            assert!((force + slope).abs() < 1e-6, "{position}: {force} {slope}");
        }
    }

    #[test]
    fn proposal_finds_hardening_and_center_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[5000.0, 0.04]);
        assert!((found[0] / 5000.0 - 1.0).abs() < 0.1, "{found:?}");
        assert!((found[1] - 0.04).abs() < 0.01, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
