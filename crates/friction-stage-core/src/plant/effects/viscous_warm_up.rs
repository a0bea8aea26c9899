//! Viscous warm-up: grease that is worked through gets thinner.
//!
//! sigma2 times 1 - f g, f fraction, and g from 0 to 1 in one of five forms:
//! - `proportion`: min(1, s / w), `distance`: 1 - exp(-s / w), with the distance (m) that the
//!   grease remembers, ds/dt = |v| - s / T: w width (m), T time_constant (s) in which it recovers;
//! - `time`: 1 - exp(-t / H) with the time t since the start: H warm_up_time (s), of the machine as
//!   a whole that gets warm;
//! - `work`: 1 - exp(-W / E) with the heat (J) that friction leaves in it, dW/dt = F v - W / T: E
//!   work (J), T time_constant (s) in which it cools;
//! - `structure`: dg/dt = (1 - g) |v| / w - g / T, of a structure that shear breaks and that builds
//!   up again: w width (m), T time_constant (s).
//!
//! A time_constant of 1e6 s is none.
//!
//! Source of structure: Moore, Trans. Br. Ceram. Soc. 58, 1959, where g is the broken part of the
//! structure; the others assumed; viscosity falls by 1 to 3 % per kelvin (assumed). It only takes
//! energy (f below 1). Each start is a cold one. Not modelled: change of the Coulomb part, heat
//! from elsewhere.

use super::regression::{largest_over_decades, least_squares, viscous_friction};
use super::{
    Action, EffectDescriptor, EffectParameter, FrictionLaw, FrictionTerms, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};
use crate::plant::guides::FrictionScale;

/// Names of the forms, in the order of their numbers in a slice of values.
const FORMS: [&str; 5] = ["proportion", "distance", "time", "work", "structure"];

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "viscous_warm_up",
    role: Role::Friction(FrictionTerms::VISCOUS),
    law: "sigma2 (1 - fraction g); proportion: g = min(1, s / width), distance: 1 - exp(-s / \
          width), ds/dt = |v| - s / time_constant; time: 1 - exp(-t / warm_up_time); work: 1 - \
          exp(-W / work), dW/dt = F v - W / time_constant; structure: dg/dt = (1 - g) |v| / width \
          - g / time_constant",
    source: "assumed forms, saturating with the distance worked through, the time or the work of \
             friction; structure: Moore 1959",
    telltale: "proportional to v, sets in with the distance travelled or the time, not seen by the \
               force cell",
    parameters: &[
        EffectParameter::required(
            "fraction",
            "1",
            "part of sigma2 that goes in the end",
            (-5.0, 0.95),
            0.1,
        ),
        EffectParameter::optional(
            "width",
            "m",
            "distance over which it goes",
            (1e-3, 1e4),
            1.0,
            1.0,
        ),
        EffectParameter::optional(
            "time_constant",
            "s",
            "time in which it recovers",
            (0.1, NEVER),
            10.0,
            NEVER,
        ),
        EffectParameter::choice(
            "form",
            "with the distance in proportion or ever slower, with time, with work, or as a \
             structure breaks",
            &FORMS,
        ),
        EffectParameter::optional(
            "warm_up_time",
            "s",
            "time over which it falls, form time",
            (1e-2, 1e6),
            10.0,
            10.0,
        ),
        EffectParameter::optional(
            "work",
            "J",
            "work over which it falls, form work",
            (1e-3, 1e9),
            10.0,
            100.0,
        ),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.1, 1.0, 1e6, 0.0, 10.0, 100.0],
    check: descriptor::any,
    // One form alone, and no recovery where there is none.
    free: |values, index| match (Form::of(values), index) {
        (_, 0)
        | (Form::Proportion | Form::Distance | Form::Structure, 1)
        | (Form::Time, WARM_UP_TIME)
        | (Form::Work, WORK) => true,
        (Form::Time, _) => false,
        (_, TIME_CONSTANT) => values[TIME_CONSTANT] < NEVER,
        _ => false,
    },
    build: |values| Action::Friction(Box::new(ViscousWarmUp::new(values))),
    proposal: Some(propose),
    starts: warm_up_forms,
    curve: None,
};

/// Time constant of grease that does not recover, s.
const NEVER: f64 = 1e6;
/// Where these values stand.
const TIME_CONSTANT: usize = 2;
const FORM: usize = 3;
const WARM_UP_TIME: usize = 4;
const WORK: usize = 5;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Proportion,
    Distance,
    Time,
    Work,
    Structure,
}

impl Form {
    fn of(values: &[f64]) -> Form {
        match values[FORM] {
            code if code < 0.5 => Form::Proportion,
            code if code < 1.5 => Form::Distance,
            code if code < 2.5 => Form::Time,
            code if code < 3.5 => Form::Work,
            _ => Form::Structure,
        }
    }

    /// g, from s, t or W and what it is compared with.
    fn gone(self, through: f64, extent: f64) -> f64 {
        match self {
            Form::Proportion => (through / extent).min(1.0),
            // Of what is near 0 no more than its sum with 1 counts: no need of exp_m1.
            Form::Distance | Form::Time | Form::Work => 1.0 - (-through / extent).exp(),
            Form::Structure => through,
        }
    }
}

#[derive(Debug)]
struct ViscousWarmUp {
    form: Form,
    fraction: f64,
    /// w, H or E.
    extent: f64,
    /// T, s.
    time_constant: f64,
    /// s, t or W; g itself of a structure.
    gone_through: f64,
    /// Length of the last step, s, and what of s or W it left: one step is as long as the other.
    remains: (f64, f64),
}

impl ViscousWarmUp {
    fn new(values: &[f64]) -> ViscousWarmUp {
        let form = Form::of(values);
        let extent = match form {
            Form::Proportion | Form::Distance | Form::Structure => values[1],
            Form::Time => values[WARM_UP_TIME],
            Form::Work => values[WORK],
        };
        ViscousWarmUp::of(form, values[0], extent, values[TIME_CONSTANT])
    }

    fn of(form: Form, fraction: f64, extent: f64, time_constant: f64) -> ViscousWarmUp {
        ViscousWarmUp {
            form,
            fraction,
            extent,
            time_constant,
            gone_through: 0.0,
            remains: (0.0, 1.0),
        }
    }

    /// Part of s or W that is left after a step.
    fn remains(&mut self, step: f64) -> f64 {
        if step != self.remains.0 {
            self.remains = (step, (-step / self.time_constant).exp());
        }
        self.remains.1
    }

    /// What was gone through after a step that begins with `before` of it. Exact for the step's
    /// constant velocity and friction.
    fn after(&mut self, before: f64, motion: &Motion, step: f64) -> f64 {
        let (steady, remains) = match self.form {
            Form::Proportion | Form::Distance => {
                (motion.velocity.abs() * self.time_constant, self.remains(step))
            }
            Form::Time => return before + step,
            // What bristles give back as they spring does not cool the grease.
            Form::Work => (
                (motion.friction * motion.velocity).max(0.0) * self.time_constant,
                self.remains(step),
            ),
            Form::Structure => {
                let gain = motion.velocity.abs() / self.extent;
                let loss = gain + self.time_constant.recip();
                (gain / loss, (-loss * step).exp())
            }
        };
        steady + (before - steady) * remains
    }
}

impl FrictionLaw for ViscousWarmUp {
    fn scale(&mut self, motion: &Motion, step: f64, scale: &mut FrictionScale) {
        let before = self.gone_through;
        self.gone_through = self.after(before, motion, step);
        let through = 0.5 * (before + self.gone_through);
        scale.viscous *= 1.0 - self.fraction * self.form.gone(through, self.extent);
    }

    fn feels_friction(&self) -> bool {
        self.form == Form::Work
    }

    fn reset(&mut self) {
        self.gone_through = 0.0;
    }
}

/// Recovery times that a proposal tries, as multiples of the record's length.
const RECOVERIES: [f64; 3] = [0.1, 0.3, 1.0];

/// Every form, with and without recovery; without it structure is distance.
fn warm_up_forms(values: &[f64], _step: f64) -> Vec<Vec<f64>> {
    let form = |code: f64, time_constant: f64| {
        let mut start = values.to_vec();
        (start[FORM], start[TIME_CONSTANT]) = (code, time_constant);
        start
    };
    let codes = [Form::Proportion, Form::Distance, Form::Work].map(|form| f64::from(form as u8));
    // A form without recovery has forgotten what was proposed for one with it.
    let recovery = if values[TIME_CONSTANT] < NEVER {
        values[TIME_CONSTANT]
    } else {
        DESCRIPTOR.parameters[TIME_CONSTANT].scale
    };
    let recovering = codes
        .into_iter()
        .chain([f64::from(Form::Structure as u8)])
        .map(|code| form(code, recovery));
    let lasting = codes.map(|code| form(code, NEVER));
    lasting
        .into_iter()
        .chain([form(f64::from(Form::Time as u8), NEVER)])
        .chain(recovering)
        .collect()
}

/// For each form what takes most out of the residual beside a constant error of the viscous
/// friction; the values of all forms stand side by side, the best one is chosen. The time constant
/// is the best one there is, though the form chosen may do without.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let viscous = viscous_friction(residual)?;
    let (first, last) = (*residual.time.first()?, *residual.time.last()?);
    let step = (last - first) / residual.time.len() as f64;
    let base = least_squares(residual.force, |k| [residual.velocity[k]])?;
    let mut values: Vec<f64> =
        DESCRIPTOR.parameters.iter().map(|parameter| parameter.default.unwrap_or(0.0)).collect();
    let (mut best, mut best_recovery): (Option<(f64, f64, Form)>, Option<f64>) = (None, None);
    let recoveries =
        RECOVERIES.map(|part| (Form::Proportion, (part * (last - first)).clamp(0.1, NEVER)));
    let forms = [(Form::Proportion, NEVER), (Form::Time, NEVER), (Form::Work, NEVER)];
    values[TIME_CONSTANT] = recoveries[RECOVERIES.len() - 1].1;
    for (form, time_constant) in forms.into_iter().chain(recoveries) {
        let mut law = ViscousWarmUp::of(form, 0.0, 1.0, time_constant);
        let mut gone_through = if matches!(form, Form::Time) { first } else { 0.0 };
        let path: Vec<f64> = (0..residual.time.len())
            .map(|k| {
                let motion = Motion {
                    velocity: residual.velocity[k],
                    friction: residual.friction[k],
                    ..Motion::default()
                };
                gone_through = law.after(gone_through, &motion, step);
                gone_through
            })
            .collect();
        let longest = path.iter().copied().fold(0.0, f64::max);
        if longest <= 0.0 {
            continue;
        }
        let index = match form {
            Form::Proportion | Form::Distance | Form::Structure => 1,
            Form::Time => WARM_UP_TIME,
            Form::Work => WORK,
        };
        let fit = |extent: f64| {
            least_squares(residual.force, |k| {
                let velocity = residual.velocity[k];
                [velocity, velocity * form.gone(path[k], extent)]
            })
        };
        let explained = |extent: f64| fit(extent).map_or(f64::NEG_INFINITY, |fit| fit.explained);
        let (least, greatest) = DESCRIPTOR.parameters[index].bounds;
        let (from, to) =
            ((longest / 300.0).max(least), (2.0 * longest).clamp(2.0 * least, greatest));
        let extent = largest_over_decades(from, to, explained);
        let Some(fit) = fit(extent) else { continue };
        if time_constant == NEVER {
            values[index] = extent;
        } else if best_recovery.is_none_or(|best| fit.explained > best) {
            (best_recovery, values[TIME_CONSTANT]) = (Some(fit.explained), time_constant);
        }
        if fit.improves_on(&base) && best.is_none_or(|(best, ..)| fit.explained > best) {
            best = Some((fit.explained, fit.coefficients[1], form));
            values[index] = extent;
        }
    }
    let (_, slope, form) = best?;
    values[0] = (slope / viscous).clamp(-5.0, 0.95);
    values[FORM] = f64::from(form as u8);
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::{Rates, Stage};

    #[test]
    fn viscous_friction_falls_with_the_distance_in_either_direction_and_nothing_else_does() {
        let mut warm_up = ViscousWarmUp::new(&[0.4, 2.0, 1e6, 0.0, 10.0, 100.0]);
        let mut scale = FrictionScale::ONE;
        // 1 m in all, half of it back.
        for k in 0..2000 {
            scale = FrictionScale::ONE;
            let velocity = if k < 1000 { 0.5 } else { -0.5 };
            warm_up.scale(&Motion { velocity, ..Motion::default() }, 1e-3, &mut scale);
        }
        let expected = 1.0 - 0.4 * 0.5;
        assert!((scale.viscous - expected).abs() < 1e-4, "{scale:?} {expected}");
        assert_eq!((scale.coulomb, scale.stat), (1.0, 1.0));
        warm_up.reset();
        scale = FrictionScale::ONE;
        warm_up.scale(&Motion { velocity: 0.5, ..Motion::default() }, 1e-6, &mut scale);
        assert!((scale.viscous - 1.0).abs() < 1e-6);
    }

    #[test]
    fn in_the_other_form_it_falls_ever_slower() {
        let mut warm_up = ViscousWarmUp::new(&[0.4, 0.5, 1e6, 1.0, 10.0, 100.0]);
        let mut scale = FrictionScale::ONE;
        // 2 m.
        for _ in 0..2000 {
            scale = FrictionScale::ONE;
            warm_up.scale(&Motion { velocity: 1.0, ..Motion::default() }, 1e-3, &mut scale);
        }
        assert!((scale.viscous - (1.0 - 0.4 * (1.0 - (-4.0f64).exp()))).abs() < 1e-4, "{scale:?}");
    }

    /// At a constant velocity v the distance that is remembered is v T (1 - exp(-t / T)), however
    /// the time is divided into steps.
    #[test]
    fn what_is_remembered_does_not_hang_on_the_lengths_of_the_steps() {
        let mut warm_up = ViscousWarmUp::new(&[0.4, 1.0, 0.7, 0.0, 10.0, 100.0]);
        let motion = Motion { velocity: 0.3, ..Motion::default() };
        let (mut time, mut scale) = (0.0, FrictionScale::ONE);
        for step in [5e-4, 5e-4, 2e-3, 1e-4].into_iter().cycle().take(2000) {
            scale = FrictionScale::ONE;
            warm_up.scale(&motion, step, &mut scale);
            time += step;
        }
        // The mean of a step is that of its middle, but for the square of the step.
        let expected = 1.0 - 0.4 * 0.3 * 0.7 * (1.0 - (-(time - 5e-5) / 0.7f64).exp());
        assert!((scale.viscous - expected).abs() < 1e-9, "{} {expected}", scale.viscous);
    }

    #[test]
    fn with_time_it_falls_at_rest_too_and_with_work_it_falls_by_what_friction_takes() {
        let left = |values: &[f64], motion: Motion| {
            let mut warm_up = ViscousWarmUp::new(values);
            let mut scale = FrictionScale::ONE;
            for _ in 0..2000 {
                scale = FrictionScale::ONE;
                warm_up.scale(&motion, 1e-3, &mut scale);
            }
            scale.viscous
        };
        let expected = 1.0 - 0.4 * (1.0 - (-4.0f64).exp());
        let at_rest = left(&[0.4, 1.0, 1e6, 2.0, 0.5, 100.0], Motion::default());
        assert!((at_rest - expected).abs() < 1e-4, "{at_rest}");
        // 60 N at 0.2 m/s for 2 s are 24 J.
        let worked = left(
            &[0.4, 1.0, 1e6, 3.0, 0.5, 6.0],
            Motion { velocity: -0.2, friction: -60.0, ..Motion::default() },
        );
        assert!((worked - expected).abs() < 1e-4, "{worked}");
        let at_rest = left(&[0.4, 1.0, 1e6, 3.0, 0.5, 6.0], Motion::default());
        assert_eq!(at_rest, 1.0);
    }

    #[test]
    fn a_structure_breaks_with_shear_and_builds_up_at_rest() {
        let mut warm_up = ViscousWarmUp::new(&[0.4, 0.5, 2.0, 4.0, 10.0, 100.0]);
        let mut viscous = |velocity: f64, seconds: usize| {
            let mut scale = FrictionScale::ONE;
            for _ in 0..1000 * seconds {
                scale = FrictionScale::ONE;
                warm_up.scale(&Motion { velocity, ..Motion::default() }, 1e-3, &mut scale);
            }
            scale.viscous
        };
        // 0.3 m/s over 0.5 m are 0.6 1/s against a recovery of 0.5 1/s: of the structure 0.6 / 1.1
        // break.
        let broken = 0.6 / 1.1;
        let worked = viscous(-0.3, 30);
        assert!((worked - (1.0 - 0.4 * broken)).abs() < 1e-4, "{worked}");
        let rested = viscous(0.0, 3);
        assert!((rested - (1.0 - 0.4 * broken * (-1.5f64).exp())).abs() < 1e-4, "{rested}");
    }

    #[test]
    fn a_stage_is_warmed_by_the_work_of_its_own_friction() {
        let speed = |fraction: f64| {
            let warm_up = [("fraction", fraction), ("form", 3.0), ("work", 0.5)];
            let model = StageModel {
                effects: vec![EffectParameters::new("viscous_warm_up", warm_up)],
                ..StageModel::default().without_noise()
            };
            let mut stage = Stage::new(&model, Rates::DEFAULT, 0).unwrap();
            for _ in 0..500 {
                stage.advance(200.0);
            }
            stage.state().velocity
        };
        let (cold, warm) = (speed(0.0), speed(0.5));
        assert!(warm > 1.001 * cold, "{cold} m/s, warm {warm} m/s");
    }

    #[test]
    fn every_form_is_tried_with_and_without_recovery_whichever_was_found() {
        for time_constant in [7.0, NEVER] {
            let starts = warm_up_forms(&[0.3, 1.0, time_constant, 0.0, 10.0, 100.0], 5e-4);
            let has = |form: f64, recovers: bool| {
                starts
                    .iter()
                    .any(|start| start[FORM] == form && (start[TIME_CONSTANT] < NEVER) == recovers)
            };
            assert!(
                [0.0, 1.0, 3.0].into_iter().all(|form| has(form, false) && has(form, true)),
                "{starts:?}"
            );
            assert!(has(2.0, false) && has(4.0, true) && starts.len() == 8, "{starts:?}");
        }
    }

    #[test]
    fn proposal_tells_time_and_work_from_distance() {
        for (form, index, extent) in [(2.0, WARM_UP_TIME, 0.5), (3.0, WORK, 12.0)] {
            let mut values = vec![0.6, 1.0, 1e6, form, 10.0, 100.0];
            values[index] = extent;
            let found = proposal(&DESCRIPTOR, &values);
            assert_eq!(found[FORM], form, "{found:?}");
            assert!(
                (found[0] / 0.6 - 1.0).abs() < 0.2 && (found[index] / extent - 1.0).abs() < 0.25,
                "{found:?}"
            );
        }
    }

    #[test]
    fn proposal_finds_fraction_and_width_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.4, 0.3, 1e6, 0.0, 10.0, 100.0]);
        assert!(
            (found[0] / 0.4 - 1.0).abs() < 0.2 && (found[1] / 0.3 - 1.0).abs() < 0.25,
            "{found:?}"
        );
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
