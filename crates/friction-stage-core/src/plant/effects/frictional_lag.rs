//! Frictional lag: the friction of slow sliding follows the velocity late.
//!
//! The Stribeck curve of each guide is taken at w in place of the velocity v: dw/dt = (v - w) / T,
//! T time_constant (s); g = Fc + (Fs - Fc) exp(-(w / vs)^2). Exact over a step of constant
//! velocity. Starts at rest. Source: the film of the lubricant needs time to build up and to break
//! down (D. Hess, A. Soom, J. Tribol. 112(1), 1990; B. Armstrong-Hélouvry, P. Dupont, C. Canudas
//! de Wit, Automatica 30(7), 1994, section 2.2.4, there a pure delay); assumed: first order. Sizes:
//! 1 to 50 ms (Armstrong-Hélouvry et al. 1994, table 2). It only takes energy. Not modelled: a lag
//! that depends on load or viscosity.
//!
//! Friction that differs where the stage speeds up and where it slows down gives it away: slow
//! starts and slow stops through the Stribeck velocity, at two accelerations.

use super::regression::{along, break_away, largest_over_decades, least_squares, slow_loop};
use super::{
    Action, EffectDescriptor, EffectParameter, FrictionLaw, FrictionTerms, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};
use crate::plant::guides::FrictionScale;

/// Shortest and longest time constant, s.
const TIMES: (f64, f64) = (1e-5, 10.0);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "frictional_lag",
    role: Role::Friction(FrictionTerms::BRISTLES),
    law: "g = Fc + (Fs - Fc) exp(-(w / vs)^2), dw/dt = (v - w) / time_constant",
    source: "Hess, Soom 1990; Armstrong-Hélouvry, Dupont, Canudas de Wit 1994; first order \
             (assumed)",
    telltale: "at slow speed friction is higher as the stage speeds up than as it slows down, not \
               seen by the force cell",
    parameters: &[EffectParameter::required(
        "time_constant",
        "s",
        "time by which the Stribeck curve follows the velocity late",
        TIMES,
        2e-3,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[1e-2],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Friction(Box::new(FrictionalLag::new(values[0]))),
    proposal: Some(propose),
    // Guides that were fitted to the friction have a part of its curve, so that what is left of it
    // looks later than it is.
    starts: |values, _| [1.0, 0.1, 0.01].map(|factor| vec![factor * values[0]]).to_vec(),
    curve: None,
};

#[derive(Debug)]
struct FrictionalLag {
    time_constant: f64,
    /// w, m/s.
    late: f64,
}

impl FrictionalLag {
    fn new(time_constant: f64) -> FrictionalLag {
        FrictionalLag { time_constant, late: 0.0 }
    }

    /// w in the middle of a step; moves it to the end.
    fn advance(&mut self, velocity: f64, step: f64) -> f64 {
        let remains = (-0.5 * step / self.time_constant).exp();
        let middle = velocity + (self.late - velocity) * remains;
        self.late = velocity + (middle - velocity) * remains;
        middle
    }
}

impl FrictionLaw for FrictionalLag {
    fn scale(&mut self, motion: &Motion, step: f64, scale: &mut FrictionScale) {
        scale.stribeck_speed = Some(self.advance(motion.velocity, step).abs());
    }

    fn reset(&mut self) {
        self.late = 0.0;
    }
}

/// Stribeck velocities that a proposal tries, m/s, a factor of 3 apart.
const STRIBECK_VELOCITIES: [f64; 5] = [1e-3, 3e-3, 1e-2, 3e-2, 1e-1];

/// The time constant with which a Stribeck curve that is late takes most out of the residual beyond
/// one that is not.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let (distance, _) = break_away(residual)?;
    let direction = slow_loop(residual, distance);
    let curve = |speed: f64, stribeck: f64| (-(speed / stribeck).powi(2)).exp();
    let mut best: Option<(f64, f64)> = None;
    for stribeck in STRIBECK_VELOCITIES {
        let now = |k: usize| direction[k] * curve(residual.velocity[k], stribeck);
        let base = least_squares(residual.force, |k| {
            [residual.friction[k], residual.velocity[k], residual.acceleration[k], now(k)]
        });
        let fit = |time_constant: f64| {
            let mut lag = FrictionalLag::new(time_constant);
            let late =
                along(residual, |motion, step| curve(lag.advance(motion.velocity, step), stribeck));
            least_squares(residual.force, |k| {
                let [friction, velocity] = [residual.friction[k], residual.velocity[k]];
                let more = now(k) - direction[k] * late[k];
                [friction, velocity, residual.acceleration[k], now(k), more]
            })
        };
        let explained =
            |time_constant: f64| fit(time_constant).map_or(f64::NEG_INFINITY, |fit| fit.explained);
        let (Some(base), time_constant) =
            (base, largest_over_decades(SHORTEST, LONGEST, explained))
        else {
            continue;
        };
        let Some(fit) = fit(time_constant) else { continue };
        if fit.improves_on(&base)
            && fit.coefficients[4] > 0.0
            && best.is_none_or(|(best, _)| fit.explained > best)
        {
            best = Some((fit.explained, time_constant));
        }
    }
    best.map(|(_, time_constant)| vec![time_constant])
}

/// Shortest and longest time constant of a proposal, s.
const SHORTEST: f64 = 3e-4;
const LONGEST: f64 = 0.3;

#[cfg(test)]
mod tests {
    use super::super::regression::record::{Record, STEP, assert_silent_on_noise};
    use super::*;
    use crate::model::Catalogue;
    use crate::plant::GuideBank;

    /// A step of the velocity from 0 in closed form, however it is divided.
    #[test]
    fn the_curve_is_taken_where_the_velocity_was() {
        for step in [1e-4, 1e-3] {
            let mut lag = FrictionalLag::new(5e-3);
            let mut scale = FrictionScale::ONE;
            for _ in 0..(20e-3 / step) as usize {
                let motion = Motion { velocity: -0.1, ..Motion::default() };
                lag.scale(&motion, step, &mut scale);
            }
            let expected = 0.1 * (1.0 - (-(20e-3 - 0.5 * step) / 5e-3f64).exp());
            let found = scale.stribeck_speed.unwrap();
            assert!((found - expected).abs() < 1e-12, "{found} m/s, expected {expected} m/s");
        }
    }

    /// Friction of a guide at 10 mm/s, N: as it speeds up, and as it slows down.
    fn both_ways(time_constant: f64) -> (f64, f64) {
        let mut lag = FrictionalLag::new(time_constant);
        let mut bank = GuideBank::new(&[Catalogue::builtin().guide("guide_1").unwrap()]);
        let mut friction = Vec::new();
        for k in 0..800 {
            let velocity = 0.04 * (1.0 - (f64::from(k) / 400.0 - 1.0).abs());
            let mut scale = FrictionScale::ONE;
            lag.scale(&Motion { velocity, ..Motion::default() }, 1e-3, &mut scale);
            friction.push(bank.drive(velocity, 1e-3, &scale));
        }
        (friction[100], friction[700])
    }

    #[test]
    fn friction_is_higher_speeding_up_than_slowing_down_with_a_lag_and_the_same_without() {
        let (up, down) = both_ways(0.05);
        assert!(up > down + 0.2, "{up} N up, {down} N down");
        let (up, down) = both_ways(1e-5);
        assert!((up - down).abs() < 0.05, "{up} N up, {down} N down");
    }

    /// Slow ramps up and down.
    #[test]
    fn proposal_finds_the_time_constant_within_a_factor_of_two_and_nothing_in_noise() {
        let (mut position, mut at) = (Vec::new(), 0.0);
        for k in 0..24_000 {
            at += STEP * 0.02 * (0.003 * f64::from(k)).sin();
            position.push(at);
        }
        let record = Record::along(position).with_effect(&DESCRIPTOR, &[0.03]).with_noise(0.1, 4);
        let found = propose(&record.residual()).unwrap();
        assert!((0.015..0.06).contains(&found[0]), "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
