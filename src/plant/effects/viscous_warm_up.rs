//! Viscous warm-up: grease that is worked through gets thinner.
//!
//! sigma2 times 1 - f (1 - exp(-s / w)): s distance travelled since the start (m), f fraction, w width (m).
//! Source: assumed form, saturating with the work done; viscosity falls by 1 to 3 % per kelvin (assumed).
//! It only takes energy (f below 1).
//! Not modelled: cooling at rest, change of the Coulomb part.

use super::regression::{largest_over_decades, least_squares, viscous_friction};
use super::{Effect, EffectDescriptor, EffectParameter, FrictionScale, Motion, Residual, Side};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "viscous_warm_up",
    side: Side::Carriage,
    law: "sigma2 (1 - fraction (1 - exp(-s / width))), s distance travelled",
    source: "assumed form, saturating with the work done",
    telltale: "proportional to v, sets in with the distance travelled, not seen by the force cell",
    confused_with: &["quadratic_drag", "asymmetric_friction"],
    parameters: &[
        EffectParameter::required("fraction", "1", "part of sigma2 that goes in the end", (-5.0, 0.95), 0.1),
        EffectParameter::optional("width", "m", "distance over which it goes", (1e-3, 1e4), 1.0, 1.0),
    ],
    check: super::any,
    free: super::all_free,
    build: |values| Box::new(ViscousWarmUp { fraction: values[0], width: values[1], travelled: 0.0 }),
    propose,
};

#[derive(Debug)]
struct ViscousWarmUp {
    fraction: f64,
    width: f64,
    /// s, m.
    travelled: f64,
}

impl Effect for ViscousWarmUp {
    fn friction(&mut self, motion: &Motion, step: f64, scale: &mut FrictionScale) {
        let path = motion.velocity.abs() * step;
        let middle = self.travelled + 0.5 * path;
        self.travelled += path;
        scale.viscous *= 1.0 + self.fraction * (-middle / self.width).exp_m1();
    }

    fn scales_friction(&self) -> bool {
        true
    }

    fn reset(&mut self) {
        self.travelled = 0.0;
    }
}

/// The width whose loss of viscous friction takes most out of the residual beside a constant error of it.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let viscous = viscous_friction(residual)?;
    let mut travelled = 0.0;
    let mut last = *residual.position.first()?;
    let path: Vec<f64> = residual
        .position
        .iter()
        .map(|position| {
            travelled += (position - last).abs();
            last = *position;
            travelled
        })
        .collect();
    if travelled <= 0.0 {
        return None;
    }
    let base = least_squares(residual.force, |k| [residual.velocity[k]])?;
    let fit = |width: f64| {
        least_squares(residual.force, |k| {
            let velocity = residual.velocity[k];
            [velocity, -velocity * (-path[k] / width).exp_m1()]
        })
    };
    let explained = |width: f64| fit(width).map_or(f64::NEG_INFINITY, |fit| fit.explained);
    let width = largest_over_decades((travelled / 300.0).max(1e-3), (2.0 * travelled).min(1e4), explained);
    let fit = fit(width)?;
    fit.improves_on(&base).then(|| vec![(fit.coefficients[1] / viscous).clamp(-5.0, 0.95), width])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn viscous_friction_falls_with_the_distance_in_either_direction_and_nothing_else_does() {
        let mut warm_up = (DESCRIPTOR.build)(&[0.4, 0.5]);
        let mut scale = FrictionScale::ONE;
        // 1 m in all, half of it back.
        for k in 0..2000 {
            scale = FrictionScale::ONE;
            let velocity = if k < 1000 { 0.5 } else { -0.5 };
            warm_up.friction(&Motion { velocity, ..Motion::default() }, 1e-3, &mut scale);
        }
        let expected = 1.0 - 0.4 * (1.0 - (-2.0f64).exp());
        assert!((scale.viscous - expected).abs() < 1e-4, "{scale:?} {expected}");
        assert_eq!((scale.coulomb, scale.stat), (1.0, 1.0));
        warm_up.reset();
        scale = FrictionScale::ONE;
        warm_up.friction(&Motion { velocity: 0.5, ..Motion::default() }, 1e-6, &mut scale);
        assert!((scale.viscous - 1.0).abs() < 1e-6);
    }

    #[test]
    fn proposal_finds_fraction_and_width_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.4, 0.3]);
        assert!((found[0] / 0.4 - 1.0).abs() < 0.2 && (found[1] / 0.3 - 1.0).abs() < 0.25, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
