//! Guides that are not those of the model.

use crate::error::IdentifyError;
use crate::fit::{FitBudget, fit};
use crate::hypothesis::nominal_parameter::NominalParameter;
use crate::hypothesis::{Hypothesis, ParameterId, Part, Sides, Tolerances};
use friction_stage_core::model::{GuideSource, StageModel};

use super::score::errors;
use super::selection::Errors;
use super::state::{Search, with_different_guides};

impl<'a> Search<'a> {
    /// The search with stiffness and damping of the bristles as the record has them, where the
    /// declared ones end on a bound and leave more than noise and these leave none: how a guide
    /// sticks is what is known least of it, and is no effect that a model lacks. The search would
    /// dress it up as bristles, or as a soft mass.
    pub(super) fn with_bristles_of_the_record(self) -> Result<Search<'a>, IdentifyError> {
        let of_bristles = |id: ParameterId| match id {
            ParameterId::Nominal(one) => NominalParameter::BRISTLES.contains(&one),
            _ => false,
        };
        if self.is_noise(&self.before.errors) || !self.ends_on_a_bound(of_bristles) {
            return Ok(self);
        }
        let free = self.before.fitted.hypothesis.with_any_bristles();
        let Some(mut free) = self.begun_with(&free)? else { return Ok(self) };
        free.errors_within_tolerance = Some(self.before.errors);
        let is_answer = free.is_all_but_noise(&free.before.errors)
            && !free.before.fitted.hypothesis.bristles_beyond_tolerance().is_empty();
        Ok(if is_answer { free } else { self })
    }

    /// The search with encoder and force cell read at the same instants, where a shift between them
    /// that is taken from the train record leaves more than noise on the hold-out and none leaves
    /// no more: the noise of the encoder, which comes back in the force by way of the controller,
    /// looks like a shift where the train record has little else that tells one.
    pub(super) fn with_sensors_as_declared(self) -> Result<Search<'a>, IdentifyError> {
        if self.is_noise(&self.before.errors) {
            return Ok(self);
        }
        let held = self.before.fitted.hypothesis.holding_shift();
        let held = self.begun_with(&held)?.filter(|held| held.is_noise(&held.before.errors));
        Ok(held.unwrap_or(self))
    }

    /// A search that begins with another hypothesis, where that leaves no more than noise on the
    /// train record.
    fn begun_with(&self, other: &Hypothesis) -> Result<Option<Search<'a>>, IdentifyError> {
        let worth = self.criteria.noise_like.powi(2) * self.noise_squares();
        let fitted = fit(other, self.train, Sides::BOTH, FitBudget::COMPARED.gain_below(worth))?;
        if fitted.squares() > worth {
            return Ok(None);
        }
        Search::new(&fitted.hypothesis, self.train, self.holdout, &self.criteria, self.watch)
            .map(Some)
    }

    /// Whether the fit of the declared model ends on a bound of such a parameter.
    fn ends_on_a_bound(&self, such: impl Fn(ParameterId) -> bool) -> bool {
        let both = self.before.fitted.coordinates.iter().zip(&self.before.fitted.at_bound);
        both.into_iter().any(|(one, bound)| *bound && such(one.id))
    }

    /// Guides whose friction is beyond its tolerance are no effect that a model lacks. Where the
    /// declared ones leave more than noise and end on a bound, and others explain everything, these
    /// are the answer, and the search would take laws for them.
    pub(super) fn refuse_other_guides(&self) -> Result<(), IdentifyError> {
        if !self.doubts_the_guides() || self.is_noise(&self.before.errors) {
            return Ok(());
        }
        let declared = self.before.fitted.hypothesis.declared();
        let Some(other) = self.other_guides(declared, FitBudget::KEPT)? else { return Ok(()) };
        // A law may move a parameter a little beyond its tolerance, and leaves something then; no
        // law moves it far.
        let nearly = self.beyond_noise(&other.left)
            < self.criteria.left_at_most * self.beyond_noise(&self.before.errors);
        let all =
            self.is_all_but_noise(&other.left) && (self.friction_ends_on_a_bound() || other.is_far);
        if all || (nearly && other.is_far) {
            return Err(other.refusal(&self.before.errors));
        }
        Ok(())
    }

    /// Where guides far from the declared ones leave no more without a law that was found, or
    /// without all of them, these guides are the answer. Before the search they do not explain
    /// everything where the model lacks another law as well.
    pub(super) fn refuse_guides_in_place_of_laws(&self) -> Result<(), IdentifyError> {
        let first = self.declared_effects();
        let found = self.found();
        if found.effects.len() == first || !self.doubts_the_guides() {
            return Ok(());
        }
        let others_than = |law: usize| found.without(law).effects;
        let singly = (first..found.effects.len()).map(others_than);
        let without_all =
            (found.effects.len() > first + 1).then(|| found.effects[..first].to_vec());
        for laws in singly.chain(without_all) {
            self.watch.progress("guides in place of laws", 0.96);
            let declared = StageModel {
                effects: laws.iter().map(Part::parameters).collect(),
                ..found.declared().clone()
            };
            if let Some(other) = self.other_guides(&declared, self.in_place_of_best())?
                && other.is_far
                && !self.falls_to_best_from(&other.left)
            {
                return Err(other.refusal(&self.before.errors));
            }
        }
        Ok(())
    }

    /// Whether the declared guides would go beyond their tolerance, or have a friction of zero,
    /// which has none.
    fn doubts_the_guides(&self) -> bool {
        let hypothesis = &self.before.fitted.hypothesis;
        let is_zero = |one| hypothesis.declared_value(one, self.train.rate) == 0.0;
        self.friction_ends_on_a_bound() || is_zero(NominalParameter::ViscousFriction)
    }

    /// Whether a parameter of the sliding guides ends on a bound.
    fn friction_ends_on_a_bound(&self) -> bool {
        self.ends_on_a_bound(|id| match id {
            ParameterId::Nominal(one) => NominalParameter::SLIDING.contains(&one),
            _ => false,
        })
    }

    /// The guides of the record under the effects of a model, whatever the tolerance of the
    /// declared ones; none where they are within it.
    fn other_guides(
        &self,
        declared: &StageModel,
        effort: FitBudget,
    ) -> Result<Option<OtherGuides>, IdentifyError> {
        let tolerances = self.before.fitted.hypothesis.tolerances;
        // As for a guide of which nothing is known.
        let wide =
            Tolerances { guides: Tolerances::MOST, presliding: Tolerances::MOST, ..tolerances };
        let holding = |one: Hypothesis| match self.before.fitted.hypothesis.holds_shift() {
            true => one.holding_shift(),
            false => one,
        };
        let start = holding(Hypothesis::new(&self.with_some_viscous_friction(declared)?, wide)?);
        let other = fit(&start, self.train, Sides::BOTH, effort)?.hypothesis;
        // Parameters that make no guide are no answer.
        let Ok(stated) = Hypothesis::new(&other.model(), tolerances) else { return Ok(None) };
        let again = fit(&holding(stated), self.train, Sides::BOTH, FitBudget::COMPARED)?;
        let again = with_different_guides(&again.hypothesis, self.train, effort)?.hypothesis;
        let left = errors(&again, self.train, self.holdout)?;
        let declared = Hypothesis::new(declared, tolerances)?;
        let mut is_far = false;
        let beyond: Vec<String> = NominalParameter::SLIDING
            .into_iter()
            .filter_map(|one| {
                let value =
                    |hypothesis: &Hypothesis| hypothesis.declared_value(one, self.train.rate);
                let (name, unit) = (one.name(), one.unit());
                let (is, was) = (value(&again), value(&declared));
                // Of none at all there is no share, however wide the tolerance: what it brings at
                // the largest speed is one of the Coulomb friction.
                let (factor, tolerance) = match (one, was) {
                    (NominalParameter::ViscousFriction, 0.0) => {
                        let coulomb =
                            again.declared_value(NominalParameter::CoulombForce, self.train.rate);
                        let usual = Tolerances::default().guides.min(tolerances.guides);
                        (1.0 + is * self.train.largest_speed() / coulomb, usual)
                    }
                    _ => ((is / was).max(was / is), declared.tolerance_of(one)),
                };
                // The others show only where a stage hardly moves: what a law does there moves them
                // far.
                if matches!(one, NominalParameter::CoulombForce | NominalParameter::ViscousFriction)
                {
                    is_far |= factor > 1.0 + self.criteria.far_guides * tolerance;
                }
                (factor > 1.0 + tolerance).then(|| {
                    let within = match was {
                        0.0 => String::new(),
                        _ => format!(" within {:.0} %", 100.0 * tolerance),
                    };
                    format!("{name} is {is:.4} {unit}, declared {was:.4} {unit}{within}")
                })
            })
            .collect();
        Ok((!beyond.is_empty()).then_some(OtherGuides { beyond, is_far, left }))
    }

    /// A model whose guides have a viscous friction that a fit can move: where all of it is zero,
    /// as much as makes their Coulomb friction at the largest speed of the record.
    fn with_some_viscous_friction(&self, model: &StageModel) -> Result<StageModel, IdentifyError> {
        let mut guides = model.resolved_guides()?;
        let speed = self.train.largest_speed();
        if speed > 0.0 && guides.iter().all(|guide| guide.viscous_friction == 0.0) {
            guides
                .iter_mut()
                .for_each(|guide| guide.viscous_friction = guide.coulomb_force / speed);
        }
        let guides = guides.into_iter().map(GuideSource::Inline).collect();
        Ok(StageModel { guides, ..model.clone() })
    }
}

/// Guides that are not the declared ones.
struct OtherGuides {
    /// What is beyond its tolerance, in words.
    beyond: Vec<String>,
    /// Whether Coulomb or viscous friction is farther off than a law would move it.
    is_far: bool,
    /// What they leave.
    left: Errors,
}

impl OtherGuides {
    fn refusal(&self, before: &Errors) -> IdentifyError {
        IdentifyError::OtherGuides {
            beyond: self.beyond.join("; "),
            before: before.holdout().sqrt(),
            left: self.left.holdout().sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use friction_stage_core::model::{Encoder, Guide, Motor};
    use friction_stage_data::signals::Trace;

    use super::super::{Silent, Verdict, search};
    use super::*;
    use crate::record::measured::Measured;

    /// An axis under Coulomb and viscous friction without bristles, driven in open loop by steps of
    /// half a second and read at 1 kHz in counts: the exact solution, with rest.
    fn sliding_axis(
        mass: f64,
        coulomb: f64,
        viscous: f64,
        counts: f64,
        steps: impl Iterator<Item = f64>,
    ) -> Trace {
        let (mut position, mut speed, mut trace) = (0.0f64, 0.0f64, Trace::default());
        for (step, force) in steps.enumerate() {
            for row in 0..500 {
                trace.time.push(1e-3 * (500 * step + row) as f64);
                trace.position.push(counts * (position / counts).round());
                trace.force.push(force);
                let mut left: f64 = 1e-3;
                while left > 0.0 {
                    if speed == 0.0 && force.abs() <= coulomb {
                        break;
                    }
                    let way = if speed == 0.0 { force } else { speed }.signum();
                    let (rate, end) = (viscous / mass, (force - way * coulomb) / viscous);
                    // When the speed comes to nothing, from v(t) = end + (v - end) exp(-rate t).
                    let stop = (1.0 - speed / end).ln() / rate;
                    let time = if stop > 0.0 { left.min(stop) } else { left };
                    let (fallen, whole) = ((-rate * time).exp(), time < left);
                    position += end * time + (speed - end) * (1.0 - fallen) / rate;
                    speed = if whole { 0.0 } else { end + (speed - end) * fallen };
                    left -= time;
                }
            }
        }
        trace
    }

    fn axis(mass: f64, coulomb: f64, viscous: f64, stiffness: f64, counts: f64) -> StageModel {
        StageModel {
            mass,
            guides: vec![GuideSource::Inline(Guide {
                stiffness,
                bristle_damping: 2.0 * (stiffness * mass).sqrt() / 10.0,
                viscous_friction: viscous,
                coulomb_force: coulomb,
                static_force: 1.001 * coulomb,
                stribeck_velocity: 1e-3,
                stribeck_exponent: None,
                damping_velocity: None,
            })],
            motor: Motor { force_limit: 20.0 * coulomb },
            encoder: Encoder { resolution: counts, noise: 0.0 },
            ..StageModel::default()
        }
    }

    /// A train record and a hold-out of such an axis whose guides have this friction, N and N s/m.
    fn records(model: &StageModel, coulomb: f64, viscous: f64) -> (Measured, Measured) {
        let record = |shares: [f64; 8]| {
            let steps = (0..6).flat_map(|_| shares).map(|share| share * coulomb);
            let trace = sliding_axis(model.mass, coulomb, viscous, model.encoder.resolution, steps);
            Measured::new(&trace, model, "the record").unwrap()
        };
        (
            record([2.0, -2.0, 1.7, -1.7, 2.0, -1.4, -2.0, 1.4]),
            record([2.0, -1.7, -2.0, 1.7, 1.4, -2.0, 2.0, -1.4]),
        )
    }

    #[test]
    fn guides_that_stick_harder_than_declared_are_no_effect() {
        for (mass, coulomb, viscous, stiffness, counts) in [
            (20.0, 15.0, 80.0, 1.5e7, 1e-7),
            (3.0, 4.0, 30.0, 1e6, 2e-7),
            (150.0, 60.0, 500.0, 3e7, 1e-7),
        ] {
            let model = axis(mass, coulomb, viscous, stiffness, counts);
            let (train, holdout) = records(&model, coulomb, viscous);
            let selection =
                search(&model, Tolerances::default(), &train, &holdout, &Silent).unwrap();
            assert_eq!(selection.verdict, Verdict::None, "{mass} kg");
            let found = &selection.after.fitted.hypothesis;
            let value = |one| found.declared_value(one, train.rate);
            for (one, expected, error) in [
                (NominalParameter::Mass, mass, 0.005),
                (NominalParameter::CoulombForce, coulomb, 0.01),
                (NominalParameter::ViscousFriction, viscous, 0.02),
            ] {
                let found = value(one);
                assert!((found / expected - 1.0).abs() < error, "{}: {found}", one.name());
            }
            let beyond = found.bristles_beyond_tolerance();
            assert!(
                beyond
                    .iter()
                    .any(|(one, factor)| *one == NominalParameter::Stiffness && *factor > 2.0),
                "{beyond:?}"
            );
            assert!(selection.errors_within_tolerance.is_some());
        }
    }

    /// No factor makes anything of a viscous friction of 0, and no tolerance makes it another one.
    #[test]
    fn a_viscous_friction_that_was_left_out_is_refused_however_wide_the_tolerance() {
        let (coulomb, viscous) = (15.0, 80.0);
        let model = axis(20.0, coulomb, 0.0, 1.5e7, 1e-7);
        let (train, holdout) = records(&model, coulomb, viscous);
        for guides in [Tolerances::default().guides, 0.99] {
            let tolerances = Tolerances { guides, ..Tolerances::default() };
            let refused = search(&model, tolerances, &train, &holdout, &Silent).unwrap_err();
            let words = refused.to_string();
            assert!(words.contains("viscous_friction is "), "{guides}: {words}");
            // No part of nothing.
            assert!(words.contains("declared 0.0000 N s/m;"), "{guides}: {words}");
        }
    }

    /// Guides with three times the declared Coulomb and static friction, and static friction of
    /// which nothing is known.
    #[test]
    fn each_parameter_of_other_guides_has_its_own_tolerance() {
        let (coulomb, viscous) = (15.0, 80.0);
        let model = axis(20.0, 0.3 * coulomb, viscous, 1.5e7, 1e-7);
        let (train, holdout) = records(&model, coulomb, viscous);
        for (presliding, is_named) in [(0.3, true), (9.0, false)] {
            let tolerances = Tolerances { presliding, ..Tolerances::default() };
            let refused = search(&model, tolerances, &train, &holdout, &Silent).unwrap_err();
            let words = refused.to_string();
            assert!(words.contains("declared 4.5000 N within"), "{presliding}: {words}");
            assert_eq!(words.contains("static_force is"), is_named, "{presliding}: {words}");
            assert_eq!(words.contains("within 30 %"), is_named, "{presliding}: {words}");
        }
    }

    /// An axis that moves, rests while the force climbs to 0.95 of what it takes to break away, and
    /// moves back, read at 1 kHz in counts as large as its bristles bend.
    fn resting_axis(mass: f64, coulomb: f64, viscous: f64, counts: f64, first: f64) -> Trace {
        let (mut at, mut trace) = (0.0f64, Trace::default());
        let mut push = |position: f64, force: f64| {
            trace.time.push(1e-3 * trace.time.len() as f64);
            trace.position.push(counts * (position / counts).round());
            trace.force.push(force);
        };
        for way in (0..24).map(|turn| if turn % 2 == 0 { 1.0 } else { -1.0 }) {
            let share = (first + 0.37 * at.abs() / counts).fract();
            let (distance, rows) = (way * (0.01 + 0.015 * share), 300 + (500.0 * share) as usize);
            let duration = 1e-3 * rows as f64;
            for row in 0..rows {
                let s = row as f64 / rows as f64;
                let path = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
                let speed = 30.0 * s * s * (1.0 - s) * (1.0 - s);
                let acceleration = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s);
                let force = mass * acceleration * distance / duration.powi(2)
                    + way * coulomb
                    + viscous * speed * distance / duration;
                push(at + distance * path, force);
            }
            at += distance;
            let rest = 400 + (300.0 * share) as usize;
            for row in 0..rest {
                let climbed = 0.3 + 0.65 * row as f64 / rest as f64;
                push(at, -way * coulomb * climbed);
            }
        }
        trace
    }

    #[test]
    fn rests_within_a_count_are_no_effect() {
        for (mass, coulomb, viscous, stiffness, counts) in
            [(20.0, 15.0, 80.0, 1.5e7, 1e-6), (60.0, 40.0, 150.0, 2e7, 2e-6)]
        {
            let model = axis(mass, coulomb, viscous, stiffness, counts);
            let record = |first: f64| {
                let trace = resting_axis(mass, coulomb, viscous, counts, first);
                Measured::new(&trace, &model, "the record").unwrap()
            };
            let (train, holdout) = (record(0.1), record(0.6));
            assert!(
                (0.4..0.7).contains(&train.hidden_rest_share),
                "{mass} kg: {}",
                train.hidden_rest_share
            );
            let selection =
                search(&model, Tolerances::default(), &train, &holdout, &Silent).unwrap();
            assert_eq!(selection.verdict, Verdict::None, "{mass} kg");
            let found = &selection.after.fitted.hypothesis;
            let coulomb_found = found.declared_value(NominalParameter::CoulombForce, train.rate);
            assert!((coulomb_found / coulomb - 1.0).abs() < 0.02, "{coulomb_found} N");
        }
    }
}
