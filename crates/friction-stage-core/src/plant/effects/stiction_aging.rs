//! Stiction aging: at rest the contacts grow together, and the stage breaks away harder the longer
//! it has stood.
//!
//! Fs times 1 + f s: f fraction, T time_constant (s), w width (m), in one of two forms:
//! - `saturating`: ds/dt = (1 - s) / T - s |v| / w, from 0 (just moved) to 1 (rested long); at rest
//!   s = 1 - exp(-t / T);
//! - `logarithmic`: s = ln(1 + a / T) with the age a (s) of the contacts, da/dt = 1 - a |v| / w; at
//!   rest a = t, and s grows without end.
//!
//! Sliding renews the contacts over the width. Exact over a step of constant velocity. Starts at s
//! = 0. Source: aging law of rate-and-state friction (Dieterich, J. Geophys. Res. 84, 1979; Ruina,
//! J. Geophys. Res. 88, 1983); saturating: the same with an end (assumed). Sizes: assumed, some 10
//! %, time constant about 1 s, width of about the distance over which the guides break away. It
//! only takes energy. Not modelled: normal load.

use super::regression::{break_away, largest_over_decades, least_squares, step_of};
use super::{
    Action, EffectDescriptor, EffectParameter, FrictionLaw, FrictionTerms, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};
use crate::plant::guides::FrictionScale;

/// Distance that renews the contacts where nothing else is known, m. Assumed: some times the 40 µm
/// at which the paper's guides 1 and 3 have not yet broken away; over less the contacts would be
/// new before the bristles could show that they were old.
const WIDTH: f64 = 200e-6;
/// Shortest and longest time constant, s.
const TIMES: (f64, f64) = (1e-2, 1e4);

/// Names of the forms, in the order of their numbers in a slice of values.
const FORMS: [&str; 2] = ["saturating", "logarithmic"];

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "stiction_aging",
    role: Role::Friction(FrictionTerms::BRISTLES),
    law: "Fs (1 + fraction s); saturating: ds/dt = (1 - s) / time_constant - s |v| / width; \
          logarithmic: s = ln(1 + a / time_constant), da/dt = 1 - a |v| / width",
    source: "Dieterich 1979, Ruina 1983; saturating: the same with an end (assumed)",
    telltale: "a peak at break-away that grows with the rest before it, not seen by the force cell",
    parameters: &[
        EffectParameter::required(
            "fraction",
            "1",
            "part by which Fs has risen after a long rest, or, logarithmic, rises for each factor \
             of e",
            (0.0, 10.0),
            0.1,
        ),
        EffectParameter::optional(
            "time_constant",
            "s",
            "time at rest in which it rises",
            TIMES,
            0.5,
            1.0,
        ),
        EffectParameter::optional(
            "width",
            "m",
            "distance of sliding over which it goes",
            (1e-7, 1e-1),
            1e-4,
            WIDTH,
        ),
        EffectParameter::choice("form", "towards an end, or with the logarithm of time", &FORMS),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.1, 1.0, 2e-4, 0.0],
    check: descriptor::any,
    free: |_, index| index != FORM,
    build: |values| Action::Friction(Box::new(StictionAging::new(values))),
    proposal: Some(propose),
    starts: |values, _| forms(values),
    curve: None,
};

/// Where this value stands.
const FORM: usize = 3;

#[derive(Clone, Copy, Debug)]
enum Form {
    Saturating,
    Logarithmic,
}

#[derive(Debug)]
struct StictionAging {
    form: Form,
    fraction: f64,
    time_constant: f64,
    width: f64,
    /// s of the saturating form; a / T of the logarithmic one.
    age: f64,
}

/// Both forms; a logarithm that follows the exponential from a tenth to all of its time constant
/// rises by 0.4 of its end within a quarter of its time.
fn forms(values: &[f64]) -> Vec<Vec<f64>> {
    let [mut saturating, mut logarithmic] = [values.to_vec(), values.to_vec()];
    let (fraction, time) = (0.4, 0.25);
    if values[FORM] < 0.5 {
        (logarithmic[0], logarithmic[1]) = (fraction * values[0], time * values[1]);
    } else {
        (saturating[0], saturating[1]) = (values[0] / fraction, values[1] / time);
    }
    (saturating[FORM], logarithmic[FORM]) = (0.0, 1.0);
    vec![saturating, logarithmic]
}

impl StictionAging {
    fn new(values: &[f64]) -> StictionAging {
        let form = if values[FORM] < 0.5 { Form::Saturating } else { Form::Logarithmic };
        StictionAging {
            form,
            fraction: values[0],
            time_constant: values[1],
            width: values[2],
            age: 0.0,
        }
    }

    /// s in the middle of a step; moves the age to its end.
    fn advance(&mut self, velocity: f64, step: f64) -> f64 {
        let (growth, renewal) = (self.time_constant.recip(), velocity.abs() / self.width);
        let rate = match self.form {
            Form::Saturating => growth + renewal,
            Form::Logarithmic => renewal,
        };
        let after = |age: f64, time: f64| {
            let gone = -(-rate * time).exp_m1();
            // At rest the logarithmic form has no steady age.
            let grown =
                if rate * time > f64::EPSILON { growth / rate * gone } else { growth * time };
            age - age * gone + grown
        };
        let middle = after(self.age, 0.5 * step);
        self.age = after(middle, 0.5 * step);
        match self.form {
            Form::Saturating => middle,
            Form::Logarithmic => middle.ln_1p(),
        }
    }
}

impl FrictionLaw for StictionAging {
    fn scale(&mut self, motion: &Motion, step: f64, scale: &mut FrictionScale) {
        scale.stat *= 1.0 + self.fraction * self.advance(motion.velocity, step);
    }

    fn reset(&mut self) {
        self.age = 0.0;
    }
}

/// The time constant whose peaks at break-away take most out of the residual.
///
/// To first order in f a bristle that turns over the distance d has the additional friction e with
/// de/ds = (s F - e) / d over the path, F its friction.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let (distance, _) = break_away(residual)?;
    let step = step_of(residual);
    let base = least_squares(residual.force, |k| [residual.friction[k]])?;
    let fit = |time_constant: f64| {
        let mut aging = StictionAging::new(&[1.0, time_constant, WIDTH, 0.0]);
        let mut additional = 0.0;
        let column: Vec<f64> = residual
            .velocity
            .iter()
            .zip(residual.friction)
            .map(|(velocity, friction)| {
                let target = aging.advance(*velocity, step) * friction;
                let before = additional;
                additional =
                    target + (additional - target) * (-velocity.abs() * step / distance).exp();
                -0.5 * (before + additional)
            })
            .collect();
        least_squares(residual.force, |k| [residual.friction[k], column[k]])
    };
    let explained =
        |time_constant: f64| fit(time_constant).map_or(f64::NEG_INFINITY, |fit| fit.explained);
    let duration = step * residual.time.len() as f64;
    let shortest = TIMES.0.max(10.0 * step);
    if shortest >= duration {
        return None;
    }
    let time_constant = largest_over_decades(shortest, duration.min(TIMES.1), explained);
    let fit = fit(time_constant)?;
    let fraction = fit.coefficients[1];
    (fit.improves_on(&base) && fraction > 0.0)
        .then(|| vec![fraction.min(10.0), time_constant, WIDTH, 0.0])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{Record, STEP, assert_silent_on_noise};
    use super::*;
    use crate::model::Catalogue;
    use crate::plant::GuideBank;

    /// Scale of the static friction after a time at a velocity.
    fn stat(aging: &mut StictionAging, velocity: f64, duration: f64) -> f64 {
        let mut scale = FrictionScale::ONE;
        for _ in 0..10_000 {
            scale = FrictionScale::ONE;
            aging.scale(&Motion { velocity, ..Motion::default() }, duration / 10_000.0, &mut scale);
        }
        assert_eq!((scale.coulomb, scale.viscous), (1.0, 1.0));
        scale.stat
    }

    #[test]
    fn static_friction_grows_at_rest_and_is_renewed_by_sliding() {
        let mut aging = StictionAging::new(&[0.5, 2.0, 50e-6, 0.0]);
        let after_rest = stat(&mut aging, 0.0, 3.0);
        assert!((after_rest - (1.0 + 0.5 * (1.0 - (-1.5f64).exp()))).abs() < 1e-4, "{after_rest}");
        // Five widths of sliding.
        assert!((stat(&mut aging, 0.25, 1e-3) - 1.0).abs() < 0.01 * 0.5);
    }

    /// Ruina's law at rest and in steady sliding, where the age is the width over the speed.
    #[test]
    fn in_the_other_form_it_grows_with_the_logarithm_of_the_age() {
        let mut aging = StictionAging::new(&[0.2, 0.5, 50e-6, 1.0]);
        let after_rest = stat(&mut aging, 0.0, 30.0);
        assert!((after_rest - (1.0 + 0.2 * 61f64.ln())).abs() < 1e-4, "{after_rest}");
        let sliding = stat(&mut aging, -25e-6, 60.0);
        assert!((sliding - (1.0 + 0.2 * 5f64.ln())).abs() < 1e-4, "{sliding}");
    }

    /// Peak of the friction, N, when a guide starts slowly after a rest of `rest` seconds.
    fn break_away(rest: f64) -> f64 {
        let mut aging = StictionAging::new(&[0.5, 1.0, WIDTH, 0.0]);
        let mut bank = GuideBank::new(&[Catalogue::builtin().guide("guide_1").unwrap()]);
        let mut peak = 0.0f64;
        let rests = (rest / 1e-3) as usize;
        for k in 0..rests + 2000 {
            let velocity = if k < rests { 0.0 } else { 1e-3 };
            let mut scale = FrictionScale::ONE;
            aging.scale(&Motion { velocity, ..Motion::default() }, 1e-3, &mut scale);
            peak = peak.max(bank.drive(velocity, 1e-3, &scale));
        }
        peak
    }

    #[test]
    fn a_guide_breaks_away_harder_after_a_longer_rest() {
        let peaks = [0.0, 0.5, 5.0].map(break_away);
        assert!(peaks[1] > peaks[0] + 0.2 && peaks[2] > peaks[1] + 0.2, "{peaks:?}");
    }

    /// Slow starts after rests of different length.
    #[test]
    fn proposal_finds_the_time_constant_within_a_factor_of_two_and_nothing_in_noise() {
        let mut position = Vec::new();
        let mut start = 0.0;
        for (index, rest) in [0.2, 2.0, 0.5, 4.0, 1.0, 0.1].into_iter().enumerate() {
            position.extend(std::iter::repeat_n(start, (rest / STEP) as usize));
            let direction = if index % 2 == 0 { 2e-3 } else { -2e-3 };
            position.extend((1..=2000).map(|k| start + direction * f64::from(k) * STEP));
            start += direction * 2000.0 * STEP;
        }
        let values = [0.5, 1.0, WIDTH, 0.0];
        let record = Record::along(position).with_effect(&DESCRIPTOR, &values).with_noise(0.3, 4);
        let found = propose(&record.residual()).unwrap();
        assert!((0.5..2.0).contains(&found[1]) && (0.25..1.0).contains(&found[0]), "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
