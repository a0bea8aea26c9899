//! Asymmetric friction: the guides rub more in one direction than in the other.
//!
//! Fc and Fs times 1 + f sign(v), sigma2 times 1 + h sign(v): f fraction, h viscous_fraction; both
//! above -1 and below 1. At v = 0 nothing changes. A bristle turns over its usual distance to the
//! level of the new direction. Source: separate Coulomb and viscous friction per direction (Janot,
//! Gautier, Brunot, EMPS benchmark, 2019: viscous 167 against 240 N s/m). It only takes energy. Not
//! modelled: bristle stiffness that depends on direction.

use super::regression::{least_squares, viscous_friction};
use super::{
    Action, EffectDescriptor, EffectParameter, FrictionLaw, FrictionTerms, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};
use crate::plant::guides::FrictionScale;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "asymmetric_friction",
    role: Role::Friction(FrictionTerms::BOTH),
    law: "Fc, Fs (1 + fraction sign(v)); sigma2 (1 + viscous_fraction sign(v))",
    source: "Janot, Gautier, Brunot 2019 (EMPS): friction per direction",
    telltale: "residual of the same sign in both directions, gone at rest, not seen by the force \
               cell",
    parameters: &[
        EffectParameter::required(
            "fraction",
            "1",
            "part by which Fc and Fs rise at v > 0 and fall at v < 0",
            LIMITS,
            0.05,
        ),
        EffectParameter::optional(
            "viscous_fraction",
            "1",
            "the same for sigma2",
            LIMITS,
            0.05,
            0.0,
        ),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.05, 0.05],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Friction(Box::new(AsymmetricFriction::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

/// Friction must stay positive.
const LIMITS: (f64, f64) = (-0.95, 0.95);

#[derive(Debug)]
struct AsymmetricFriction {
    fraction: f64,
    viscous_fraction: f64,
}

impl AsymmetricFriction {
    fn new(values: &[f64]) -> AsymmetricFriction {
        AsymmetricFriction { fraction: values[0], viscous_fraction: values[1] }
    }
}

impl FrictionLaw for AsymmetricFriction {
    fn scale(&mut self, motion: &Motion, _step: f64, scale: &mut FrictionScale) {
        let direction = if motion.velocity == 0.0 { 0.0 } else { motion.velocity.signum() };
        scale.coulomb *= 1.0 + self.fraction * direction;
        scale.stat *= 1.0 + self.fraction * direction;
        scale.viscous *= 1.0 + self.viscous_fraction * direction;
    }
}

/// What of the residual goes with the size of the friction and with the size of the velocity,
/// whatever their sign.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let viscous = viscous_friction(residual)?;
    let base = least_squares(residual.force, |_| [1.0])?;
    let fit = least_squares(residual.force, |k| {
        let speed = residual.velocity[k].abs();
        [1.0, -(residual.friction[k].abs() - viscous * speed), -speed]
    })?;
    let [_, fraction, slope] = fit.coefficients;
    fit.improves_on(&base).then(|| {
        vec![fraction.clamp(LIMITS.0, LIMITS.1), (slope / viscous).clamp(LIMITS.0, LIMITS.1)]
    })
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;
    use crate::model::Catalogue;
    use crate::plant::GuideBank;

    #[test]
    fn steady_friction_is_higher_one_way_and_lower_the_other() {
        let guide = Catalogue::builtin().guide("guide_2").unwrap();
        let mut effect = AsymmetricFriction::new(&[0.1, -0.2]);
        for velocity in [0.3, -0.3] {
            let mut bank = GuideBank::new(std::slice::from_ref(&guide));
            let mut force = 0.0;
            for _ in 0..2000 {
                let mut scale = FrictionScale::ONE;
                effect.scale(&Motion { velocity, ..Motion::default() }, 1e-3, &mut scale);
                force = bank.drive(velocity, 1e-3, &scale);
            }
            let direction = velocity.signum();
            let expected = guide.level(velocity) * direction * (1.0 + 0.1 * direction)
                + guide.viscous_friction * velocity * (1.0 - 0.2 * direction);
            assert!(
                (force / expected - 1.0).abs() < 1e-9,
                "{velocity} m/s: {force} N, expected {expected} N"
            );
        }
    }

    #[test]
    fn proposal_finds_both_fractions_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.05, -0.15]);
        assert!(
            (found[0] / 0.05 - 1.0).abs() < 0.15 && (found[1] / -0.15 - 1.0).abs() < 0.15,
            "{found:?}"
        );
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
