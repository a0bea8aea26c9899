//! Viscous warm-up: grease that is worked through gets thinner.
//!
//! sigma2 times 1 - f ((1 - q) min(1, s / w) + q (1 - exp(-s / w))): f fraction, w width (m), q form: 0 in proportion up to the end, 1 ever
//! slower; s distance (m) that the grease remembers, ds/dt = |v| - s / T with the time constant T (s) in which it recovers.
//! Source: assumed forms, in the distance worked through up to the state in which the grease stays, with linear recovery; viscosity falls by 1 to 3 % per kelvin (assumed). It only takes energy (f below 1).
//! Not modelled: change of the Coulomb part, heat from elsewhere.

use super::regression::{largest_over_decades, least_squares, viscous_friction};
use super::{Effect, EffectDescriptor, EffectParameter, FrictionScale, Motion, Residual, Side};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "viscous_warm_up",
    side: Side::Carriage,
    law: "sigma2 (1 - fraction min(1, s / width)), form 1: sigma2 (1 - fraction (1 - exp(-s / width))), ds/dt = |v| - s / time_constant",
    source: "assumed form, saturating with the distance worked through, recovering in time",
    telltale: "proportional to v, sets in with the distance travelled, not seen by the force cell",
    confused_with: &["quadratic_drag", "asymmetric_friction"],
    parameters: &[
        EffectParameter::required("fraction", "1", "part of sigma2 that goes in the end", (-5.0, 0.95), 0.1),
        EffectParameter::optional("width", "m", "distance over which it goes", (1e-3, 1e4), 1.0, 1.0),
        EffectParameter::optional("time_constant", "s", "time in which it recovers", (0.1, 1e6), 10.0, 1e6),
        EffectParameter::optional("form", "1", "0: in proportion up to the end, 1: ever slower", (0.0, 1.0), 1.0, 0.0),
    ],
    check: super::any,
    // One form or the other.
    free: |_, index| index < 3,
    build: |values| {
        let [fraction, width, time_constant, form] = [values[0], values[1], values[2], values[3]];
        Box::new(ViscousWarmUp { fraction, width, time_constant, form, remembered: 0.0 })
    },
    propose,
};

#[derive(Debug)]
struct ViscousWarmUp {
    fraction: f64,
    width: f64,
    time_constant: f64,
    form: f64,
    /// s, m.
    remembered: f64,
}

impl Effect for ViscousWarmUp {
    fn friction(&mut self, motion: &Motion, step: f64, scale: &mut FrictionScale) {
        let before = self.remembered;
        // Exact for the step's constant velocity.
        let steady = motion.velocity.abs() * self.time_constant;
        self.remembered = steady + (before - steady) * (-step / self.time_constant).exp();
        let worked = 0.5 * (before + self.remembered) / self.width;
        let gone = (1.0 - self.form) * worked.min(1.0) - self.form * (-worked).exp_m1();
        scale.viscous *= 1.0 - self.fraction * gone;
    }

    fn scales_friction(&self) -> bool {
        true
    }

    fn reset(&mut self) {
        self.remembered = 0.0;
    }
}

/// Recovery times that a proposal tries, as multiples of the record's length.
const RECOVERIES: [f64; 4] = [0.1, 0.3, 1.0, 1e3];

/// The width and recovery whose loss of viscous friction takes most out of the residual beside a constant error of it.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let viscous = viscous_friction(residual)?;
    let (first, last) = (*residual.time.first()?, *residual.time.last()?);
    let step = (last - first) / residual.time.len() as f64;
    let base = least_squares(residual.force, |k| [residual.velocity[k]])?;
    let mut best: Option<(f64, Vec<f64>)> = None;
    for recovery in RECOVERIES {
        let time_constant = (recovery * (last - first)).clamp(0.1, 1e6);
        let mut remembered = 0.0;
        let path: Vec<f64> = residual
            .velocity
            .iter()
            .map(|velocity| {
                remembered += step * (velocity.abs() - remembered / time_constant);
                remembered
            })
            .collect();
        let longest = path.iter().copied().fold(0.0, f64::max);
        if longest <= 0.0 {
            continue;
        }
        let fit = |width: f64| {
            least_squares(residual.force, |k| {
                let velocity = residual.velocity[k];
                [velocity, velocity * (path[k] / width).min(1.0)]
            })
        };
        let explained = |width: f64| fit(width).map_or(f64::NEG_INFINITY, |fit| fit.explained);
        let width = largest_over_decades((longest / 300.0).max(1e-3), (2.0 * longest).clamp(2e-3, 1e4), explained);
        let Some(fit) = fit(width).filter(|fit| fit.improves_on(&base)) else { continue };
        if best.as_ref().is_none_or(|(most, _)| fit.explained > *most) {
            let fraction = (fit.coefficients[1] / viscous).clamp(-5.0, 0.95);
            best = Some((fit.explained, vec![fraction, width, time_constant, 0.0]));
        }
    }
    best.map(|(_, values)| values)
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn viscous_friction_falls_with_the_distance_in_either_direction_and_nothing_else_does() {
        let mut warm_up = (DESCRIPTOR.build)(&[0.4, 2.0, 1e6, 0.0]);
        let mut scale = FrictionScale::ONE;
        // 1 m in all, half of it back.
        for k in 0..2000 {
            scale = FrictionScale::ONE;
            let velocity = if k < 1000 { 0.5 } else { -0.5 };
            warm_up.friction(&Motion { velocity, ..Motion::default() }, 1e-3, &mut scale);
        }
        let expected = 1.0 - 0.4 * 0.5;
        assert!((scale.viscous - expected).abs() < 1e-4, "{scale:?} {expected}");
        assert_eq!((scale.coulomb, scale.stat), (1.0, 1.0));
        warm_up.reset();
        scale = FrictionScale::ONE;
        warm_up.friction(&Motion { velocity: 0.5, ..Motion::default() }, 1e-6, &mut scale);
        assert!((scale.viscous - 1.0).abs() < 1e-6);
    }

    #[test]
    fn in_the_other_form_it_falls_ever_slower() {
        let mut warm_up = (DESCRIPTOR.build)(&[0.4, 0.5, 1e6, 1.0]);
        let mut scale = FrictionScale::ONE;
        // 2 m.
        for _ in 0..2000 {
            scale = FrictionScale::ONE;
            warm_up.friction(&Motion { velocity: 1.0, ..Motion::default() }, 1e-3, &mut scale);
        }
        assert!((scale.viscous - (1.0 - 0.4 * (1.0 - (-4.0f64).exp()))).abs() < 1e-4, "{scale:?}");
    }

    #[test]
    fn proposal_finds_fraction_and_width_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.4, 0.3, 1e6, 0.0]);
        assert!((found[0] / 0.4 - 1.0).abs() < 0.2 && (found[1] / 0.3 - 1.0).abs() < 0.25, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
