//! Friction drift: Coulomb and static friction change while the stage works.
//!
//! Fc and Fs times 1 + d, in one of three forms:
//! - `steady`: d = r t, r rate (1/s), t time since the start of the record (s);
//! - `time`: d = f (1 - exp(-t / T)), f fraction, T time_constant (s);
//! - `distance`: d = f (1 - exp(-s / w)), s distance travelled (m), w width (m).
//!
//! Preload that changes as the carriage warms, lubricant that spreads. Source: assumed forms, with
//! one thermal mode (as in Bittencourt, Gunnarsson, J. Dyn. Sys. Meas. Control 134(5), 2012,
//! friction over temperature). Sizes: assumed, 5 to 30 %. Each record starts alike. It only takes
//! energy. Not modelled: recovery at rest, a state that one record leaves to the next; the viscous
//! friction, see `viscous_warm_up`.
//!
//! Two speeds distinguish it from `viscous_warm_up`: this one is the same at both.

use super::regression::{along, largest_over_decades, least_squares, viscous_friction};
use super::{
    Action, EffectDescriptor, EffectParameter, FrictionLaw, FrictionTerms, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};
use crate::model::ModelError;
use crate::plant::guides::FrictionScale;

/// Friction must stay positive.
const LEAST: f64 = 0.05;
/// Shortest and longest time constant, s.
const TIMES: (f64, f64) = (0.1, 1e5);
/// Shortest and longest distance, m.
const WIDTHS: (f64, f64) = (1e-3, 1e4);
/// Names of the forms, in the order of their numbers in a slice of values.
const FORMS: [&str; 3] = ["steady", "time", "distance"];
/// Where this value stands.
const FORM: usize = 4;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "friction_drift",
    role: Role::Friction(FrictionTerms::BRISTLES),
    law: "Fc, Fs (1 + d); steady: d = rate t; time: d = fraction (1 - exp(-t / time_constant)); \
          distance: d = fraction (1 - exp(-s / width)), s distance travelled",
    source: "assumed forms; friction over temperature: Bittencourt, Gunnarsson 2012",
    telltale: "changes sign with the velocity, its size follows slow time or the distance \
               travelled, the same at every speed, not seen by the force cell",
    parameters: &[
        EffectParameter::optional(
            "rate",
            "1/s",
            "part by which Fc and Fs rise per time, steady",
            (-1.0, 1.0),
            1e-3,
            0.0,
        ),
        EffectParameter::optional(
            "fraction",
            "1",
            "part by which Fc and Fs have risen in the end",
            (LEAST - 1.0, 10.0),
            0.05,
            0.0,
        ),
        EffectParameter::optional("time_constant", "s", "time in which it comes", TIMES, 1.0, 10.0),
        EffectParameter::optional("width", "m", "distance in which it comes", WIDTHS, 0.3, 3.0),
        EffectParameter::choice("form", "what it follows", &FORMS),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[2e-3, 0.0, 10.0, 3.0, 0.0],
    check: has_what_its_form_follows,
    free: |values, index| match Form::of(values) {
        Form::Steady => index == 0,
        Form::Time => index == 1 || index == 2,
        Form::Distance => index == 1 || index == 3,
    },
    build: |values| Action::Friction(Box::new(FrictionDrift::new(values))),
    proposal: Some(propose),
    starts: every_form,
    curve: None,
};

/// A part that the form does not look at would do nothing.
fn has_what_its_form_follows(values: &[f64]) -> Result<(), ModelError> {
    let [rate, fraction] = [values[0], values[1]];
    let (key, value, limit) = match Form::of(values) {
        Form::Steady if rate == 0.0 && fraction != 0.0 => {
            ("fraction", fraction, "have form `time` or `distance`: form `steady` is by `rate`")
        }
        Form::Time | Form::Distance if fraction == 0.0 && rate != 0.0 => {
            ("rate", rate, "have form `steady`: forms `time` and `distance` are by `fraction`")
        }
        _ => return Ok(()),
    };
    let key = format!("effects.friction_drift: {key}");
    Err(ModelError::Value { key, value, limit: limit.to_owned() })
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Steady,
    Time,
    Distance,
}

impl Form {
    fn of(values: &[f64]) -> Form {
        match values[FORM].round() as u8 {
            0 => Form::Steady,
            1 => Form::Time,
            _ => Form::Distance,
        }
    }
}

#[derive(Debug)]
struct FrictionDrift {
    form: Form,
    rate: f64,
    fraction: f64,
    time_constant: f64,
    width: f64,
    /// m
    travelled: f64,
}

impl FrictionDrift {
    fn new(values: &[f64]) -> FrictionDrift {
        FrictionDrift {
            form: Form::of(values),
            rate: values[0],
            fraction: values[1],
            time_constant: values[2],
            width: values[3],
            travelled: 0.0,
        }
    }

    /// d in the middle of a step.
    fn part(&mut self, motion: &Motion, step: f64) -> f64 {
        let travel = motion.velocity.abs() * step;
        let middle = self.travelled + 0.5 * travel;
        self.travelled += travel;
        let come = |way: f64| -self.fraction * (-way).exp_m1();
        match self.form {
            Form::Steady => self.rate * motion.time,
            Form::Time => come(motion.time / self.time_constant),
            Form::Distance => come(middle / self.width),
        }
    }
}

impl FrictionLaw for FrictionDrift {
    fn scale(&mut self, motion: &Motion, step: f64, scale: &mut FrictionScale) {
        let factor = (1.0 + self.part(motion, step)).max(LEAST);
        scale.coulomb *= factor;
        scale.stat *= factor;
    }

    fn reset(&mut self) {
        self.travelled = 0.0;
    }
}

/// For each form what takes most out of the residual, with errors of the friction; the values of
/// all forms stand side by side, the best one is chosen. One that does not come to an end within
/// the record is steady.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let viscous = viscous_friction(residual)?;
    let dry = |k: usize| viscous * residual.velocity[k] - residual.friction[k];
    let base = least_squares(residual.force, |k| [dry(k), residual.velocity[k]])?;
    let column = |form: Form, time_constant: f64, width: f64| {
        let (rate, fraction) = (1.0, 1.0);
        let mut law = FrictionDrift { form, rate, fraction, time_constant, width, travelled: 0.0 };
        along(residual, |motion, step| law.part(motion, step))
    };
    let fit = |form: Form, extent: f64| {
        let drift = column(form, extent, extent);
        least_squares(residual.force, |k| [dry(k), residual.velocity[k], dry(k) * drift[k]])
    };
    let travelled: f64 = along(residual, |motion, step| motion.velocity.abs() * step).iter().sum();
    let duration = residual.time.last()? - residual.time.first()?;
    let mut values: Vec<f64> =
        DESCRIPTOR.parameters.iter().map(|parameter| parameter.default.unwrap_or(0.0)).collect();
    let mut best: Option<(f64, Form)> = None;
    for (form, (least, greatest), length) in [
        (Form::Steady, TIMES, duration),
        (Form::Time, TIMES, duration),
        (Form::Distance, WIDTHS, travelled),
    ] {
        let (shortest, longest) = ((length / 100.0).max(least), length.min(greatest));
        if longest <= shortest {
            continue;
        }
        let explained =
            |extent: f64| fit(form, extent).map_or(f64::NEG_INFINITY, |fit| fit.explained);
        let extent = match form {
            Form::Steady => longest,
            _ => largest_over_decades(shortest, longest, explained),
        };
        let Some(fit) = fit(form, extent).filter(|fit| fit.improves_on(&base)) else { continue };
        let size = fit.coefficients[2];
        match form {
            Form::Steady => values[0] = size.clamp(-1.0, 1.0),
            Form::Time => values[2] = extent,
            Form::Distance => values[3] = extent,
        }
        if best.is_none_or(|(best, _)| fit.explained > best) {
            best = Some((fit.explained, form));
            if form != Form::Steady {
                values[1] = size.clamp(LEAST - 1.0, 10.0);
            }
        }
    }
    let (_, form) = best?;
    values[FORM] = f64::from(form as u8);
    Some(values)
}

/// Each form; one of which nothing was proposed starts from what the other says.
fn every_form(values: &[f64], _step: f64) -> Vec<Vec<f64>> {
    let mut starts = descriptor::every_form(values, FORM, FORMS.len() as u8);
    let [steady, time, distance] = &mut starts[..] else { return starts };
    match Form::of(values) {
        Form::Steady => {
            // A rise that ends after its own time constant.
            time[1] = values[0] * values[2];
            distance[1] = time[1];
        }
        Form::Time | Form::Distance if values[0] == 0.0 => steady[0] = values[1] / values[2],
        Form::Time | Form::Distance => {}
    }
    starts
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    /// Factor after 2 s at 0.5 m/s.
    fn factor(values: &[f64]) -> f64 {
        let mut drift = FrictionDrift::new(values);
        let mut scale = FrictionScale::ONE;
        for k in 0..2000 {
            scale = FrictionScale::ONE;
            let motion = Motion { time: 1e-3 * f64::from(k), velocity: -0.5, ..Motion::default() };
            drift.scale(&motion, 1e-3, &mut scale);
        }
        assert_eq!((scale.viscous, scale.stat), (1.0, scale.coulomb));
        scale.coulomb
    }

    #[test]
    fn each_form_follows_its_closed_form() {
        let at_end = |part: f64| 1.0 + 0.2 * (1.0 - (-part).exp());
        for (values, expected) in [
            ([0.01, 0.2, 4.0, 0.5, 0.0], 1.02),
            ([0.01, 0.2, 4.0, 0.5, 1.0], at_end(0.5)),
            ([0.01, 0.2, 4.0, 0.5, 2.0], at_end(2.0)),
            ([-1.0, 0.2, 4.0, 0.5, 0.0], LEAST),
        ] {
            let found = factor(&values);
            assert!((found - expected).abs() < 1e-4, "{values:?}: {found}, expected {expected}");
        }
    }

    #[test]
    fn proposal_finds_what_it_follows_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.0, 0.3, 2.0, 3.0, 1.0]);
        assert_eq!(found[FORM], 1.0, "{found:?}");
        assert!(
            (found[1] / 0.3 - 1.0).abs() < 0.2 && (found[2] / 2.0 - 1.0).abs() < 0.25,
            "{found:?}"
        );
        let found = proposal(&DESCRIPTOR, &[0.0, -0.3, 10.0, 0.3, 2.0]);
        assert_eq!(found[FORM], 2.0, "{found:?}");
        assert!(
            (found[1] / -0.3 - 1.0).abs() < 0.2 && (found[3] / 0.3 - 1.0).abs() < 0.25,
            "{found:?}"
        );
        let found = proposal(&DESCRIPTOR, &[0.02, 0.0, 10.0, 3.0, 0.0]);
        assert!((found[0] / 0.02 - 1.0).abs() < 0.1, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }

    #[test]
    fn a_part_that_its_form_does_not_follow_is_refused() {
        for (values, words) in [
            ([0.0, 0.2, 10.0, 3.0, 0.0], ["fraction", "`time` or `distance`"]),
            ([0.01, 0.0, 10.0, 3.0, 1.0], ["rate", "`steady`"]),
            ([0.01, 0.0, 10.0, 3.0, 2.0], ["rate", "`steady`"]),
        ] {
            let refused = DESCRIPTOR.check_values(&values).unwrap_err().to_string();
            assert!(words.iter().all(|word| refused.contains(word)), "{refused}");
        }
        for values in [[0.01, 0.2, 10.0, 3.0, 0.0], [0.01, 0.2, 10.0, 3.0, 2.0], [0.0; 5]] {
            let in_bounds = [values[0], values[1], 10.0, 3.0, values[4]];
            DESCRIPTOR.check_values(&in_bounds).unwrap();
        }
    }

    #[test]
    fn a_fit_starts_from_every_form() {
        let starts = every_form(&[0.01, 0.0, 10.0, 3.0, 0.0], 5e-4);
        assert_eq!(starts.len(), FORMS.len());
        for (start, expected) in starts.iter().zip([0.0, 0.1, 0.1]) {
            assert_eq!(start[1], expected, "{start:?}");
        }
    }
}
