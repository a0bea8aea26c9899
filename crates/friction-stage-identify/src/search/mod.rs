//! Which effects are there? A search over sets of laws, each fitted with everything else and judged
//! by one [score](score::Score) on both records: a law is added, left out, exchanged for another
//! one, or a curve is drawn for what no law has, while that lowers the score by enough.

mod cell;
mod columns;
mod criteria;
mod curve_drawing;
mod curves;
mod exchange;
mod forms;
mod guides;
pub(crate) mod nulls;
mod order;
pub(crate) mod phase;
mod rounds;
mod score;
mod selection;
mod slips;
mod state;

use friction_stage_core::model::StageModel;

use crate::error::IdentifyError;
use crate::fit::{FitBudget, sensor_noise};
use crate::hypothesis::{Hypothesis, Sides, Tolerances};
use crate::record::measured::Measured;

use nulls::NullRecords;
use state::Search;

pub use criteria::Criteria;
pub(crate) use selection::ALL_BUT_NOISE;
pub use selection::{
    Alternative, Errors, Evidence, Inseparable, Outcome, Selection, Silent, Verdict, Watch,
};
pub use state::MOST_LAWS;

/// Turns of laws, exchanges and curves at most.
const MOST_TURNS: usize = 6;

/// Searches for what the declared model lacks.
pub fn search(
    declared: &StageModel,
    tolerances: Tolerances,
    train: &Measured,
    holdout: &Measured,
    watch: &dyn Watch,
) -> Result<Selection, IdentifyError> {
    search_by(&Criteria::USUAL, declared, tolerances, train, holdout, watch)
}

/// The same by other criteria.
pub fn search_by(
    criteria: &Criteria,
    declared: &StageModel,
    tolerances: Tolerances,
    train: &Measured,
    holdout: &Measured,
    watch: &dyn Watch,
) -> Result<Selection, IdentifyError> {
    watch.progress("fit of the declared model", 0.0);
    tolerances.check()?;
    let start = Hypothesis::new(declared, tolerances)?;
    for (name, record) in [("the train record", train), ("the hold-out record", holdout)] {
        let (floor, force) = (start.floor(record).total(), record.force_rms());
        if floor > criteria.hidden * force {
            return Err(IdentifyError::HiddenByNoise {
                name,
                encoder: record.noise,
                cell: record.cell_noise,
                floor,
                force,
            });
        }
    }
    let mut search = Search::new(&start, train, holdout, criteria, watch)?;
    search.refuse_other_guides()?;
    search = search.with_sensors_as_declared()?.with_bristles_of_the_record()?;
    search.run()?;
    search.selection()
}

impl Search<'_> {
    /// Turns of laws, exchanges and curves until none of them finds a better set.
    fn run(&mut self) -> Result<(), IdentifyError> {
        let mut exchanged = false;
        for _ in 0..MOST_TURNS {
            // What was exchanged has rivals of its own.
            let mut changed = self.add_laws()? || exchanged;
            if self.stopped {
                return Ok(());
            }
            if changed {
                self.watch.progress("fit of what was found", 0.9);
                self.go_on_fitting(FitBudget::KEPT)?;
                changed = self.exchange()?;
                exchanged = changed;
            }
            if !changed && self.curve().is_none() {
                changed = self.add_and_exchange()? || self.add_curve()? || self.let_balls_slip()?;
            }
            if changed && self.curve().is_some() {
                self.settle_curve()?;
                self.exchange()?;
            }
            if !changed || self.stopped {
                break;
            }
        }
        if self.found().effects.len() > self.declared_effects() {
            if !self.needs(&self.best, &self.before) {
                self.forget_all();
            }
            self.refuse_guides_in_place_of_laws()?;
        }
        Ok(())
    }

    /// Back to the declared model: what was added is no more than noise.
    fn forget_all(&mut self) {
        let kept = |one: &&mut Evidence| matches!(one.outcome, Outcome::Chosen | Outcome::Equal);
        self.evidence.iter_mut().filter(kept).for_each(|one| one.outcome = Outcome::TooSmall);
        self.inseparable.clear();
        self.runners_up.truncate(self.declared_effects());
        self.best = self.before.clone();
    }

    /// What the train record leaves open of the force on the hold-out, N rms, where the declared
    /// model leaves noise on the train record and no more than that on the hold-out.
    fn left_open(&self) -> Result<Option<f64>, IdentifyError> {
        if !self.is_noise_on_train(&self.best.errors) {
            return Ok(None);
        }
        let hypothesis = self.found();
        let controller = self.controller.as_ref();
        let open = NullRecords::new(hypothesis, self.train, self.holdout, controller)?
            .left_open(&self.best.fitted)?;
        let all = open.hypot(self.floors.holdout.total());
        Ok((self.best.errors.holdout().sqrt() <= self.criteria.noise_like * all).then_some(open))
    }

    fn selection(mut self) -> Result<Selection, IdentifyError> {
        self.best.fitted.hypothesis =
            self.found().with_own_amplitudes(self.declared_effects(), self.train)?;
        let effects = self.found().effects.clone();
        let there = |name: &str| effects.iter().any(|part| part.descriptor.name == name);
        // Two laws that are both there are no rivals: each has taken out what the other one could
        // not.
        self.inseparable.retain(|pair| !there(pair.rival));
        let coordinate = self.coordinate();
        // Nor is what came later a runner-up.
        let runners_up = self
            .runners_up
            .iter()
            .map(|others| others.iter().find(|one| !there(one.name)).copied())
            .collect();
        let added = self.found().effects.len() - self.declared_effects();
        // Nothing is `none`, and little is `found`, while what is left is not noise, or while not
        // everything was tried.
        let wander_of_zero = self.wander_of_zero()?;
        let left_open = match added {
            0 if !self.stopped && !self.is_noise(&self.best.errors) => self.left_open()?,
            _ => None,
        };
        let settled = match added {
            0 => (self.is_noise(&self.best.errors) || left_open.is_some()) && !self.stopped,
            _ => {
                self.is_noise(&self.best.errors)
                    || self.is_explained(&self.best.errors)
                    || wander_of_zero.is_some()
            }
        };
        // Beyond its bound a law would be another one.
        let at_bound = self.best.fitted.has_law_at_bound(self.declared_effects());
        let verdict = if coordinate.is_some() || !settled || at_bound {
            Verdict::Unknown
        } else if added == 0 {
            Verdict::None
        } else if !self.inseparable.is_empty() {
            Verdict::NotSeparable
        } else {
            Verdict::Found
        };
        let has_laws = selection::different_laws(&effects[self.declared_effects()..]) > 0;
        let usable = match verdict == Verdict::Unknown && has_laws {
            true => self.without_laws()?,
            false => self.found().clone(),
        };
        let unproven = self.unproven_ripples();
        let errors_after = self.best.errors;
        let mut after = self.best.fitted.estimate(self.train, Sides::BOTH)?;
        if !self.stopped && !self.watch.stopped() {
            self.watch.progress("what the sensors' noise does to the parameters", 0.97);
            after = sensor_noise::widened(after, self.train)?;
        }
        let declared_floor = self.before.fitted.hypothesis.declared_floor(self.holdout);
        Ok(Selection {
            verdict,
            errors_before: self.before.errors,
            before: self.before.fitted,
            after,
            errors_within_tolerance: self.errors_within_tolerance,
            errors_after,
            evidence: self.evidence,
            coordinate,
            runners_up,
            unproven,
            wander_of_zero,
            inseparable: self.inseparable,
            floor: self.floors.holdout,
            train_floor: self.floors.train,
            declared_floor,
            left_open,
            at_bound,
            usable,
            stopped: self.stopped,
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::fit::fit;
    use crate::hypothesis::Part;
    use crate::residual::missing::Missing;
    use crate::search::selection::different_laws;
    use crate::search::state::{correlation_of_taken, gain_elsewhere};
    use crate::test_records::recording;
    use friction_stage_core::model::EffectParameters;
    use friction_stage_core::plant::EffectDescriptor;

    pub(super) fn part(name: &str, values: &[(&str, f64)]) -> Part {
        let given = EffectParameters::new(name, values.iter().copied());
        let descriptor = EffectDescriptor::find(name).unwrap();
        Part { descriptor, values: descriptor.values_of(&given).unwrap() }
    }

    /// A cell whose zero drifts: a little slower than the law has it at most, and a little faster,
    /// which the noise hides.
    #[test]
    fn a_law_on_a_bound_of_its_parameter_is_not_found() {
        let model = StageModel::default();
        let law = EffectDescriptor::find("force_cell_drift").unwrap();
        let (_, most) = law.parameters[0].bounds;
        for (rate, verdict) in [(most - 1.0, Verdict::Found), (most + 2e-3, Verdict::Unknown)] {
            let record = |seed, moves| {
                let mut trace = recording(&model, seed, 0.0, moves);
                let since = |time: &f64| rate * (time - trace.time[0]);
                let drifted: Vec<f64> = trace.time.iter().map(since).collect();
                trace.force_cell.iter_mut().zip(drifted).for_each(|(cell, more)| *cell += more);
                Measured::new(&trace, &model, "the record").unwrap()
            };
            let (train, holdout) = (record(3, 4), record(4, 2));
            let found = search(&model, Tolerances::default(), &train, &holdout, &Silent).unwrap();
            let effects = found.after.fitted.hypothesis.effects;
            let [Part { descriptor, values }] = &effects[..] else { panic!("{rate}: {effects:?}") };
            assert_eq!(descriptor.name, "force_cell_drift");
            assert!((values[0] - rate.min(most)).abs() < 1e-3, "{rate}: {values:?}");
            assert_eq!(found.verdict, verdict, "{rate}: {values:?}");
            assert_eq!(found.at_bound, verdict == Verdict::Unknown);
            // Under `unknown` it explains a part only, and no model has it.
            assert_eq!(found.usable.effects.is_empty(), verdict == Verdict::Unknown);
        }
    }

    #[test]
    fn ripples_of_one_law_are_one_law_and_a_curve_is_none() {
        let ripple = |period: f64| part("cogging", &[("amplitude", 1.0), ("period", period)]);
        let knots = EffectDescriptor::find("map").unwrap();
        let curve =
            Part { descriptor: knots, values: vec![0.0, 2.0, 0.0, 0.1, 0.0, 0.0, 1.0, 2.0] };
        let drag = part("quadratic_drag", &[("coefficient", 1.0)]);
        assert_eq!(different_laws(&[ripple(0.024), drag.clone(), curve, ripple(0.012)]), 2);
        assert_eq!(different_laws(&[]), 0);
    }

    /// What one tenth of a record shows, and what all of it does: 4 N^2 there, 1 N^2 everywhere.
    #[test]
    fn what_shows_in_one_place_shows_nowhere_else() {
        let rows = 200;
        let missing = |of_row: &dyn Fn(usize) -> f64| Missing {
            motor: vec![0.5; rows],
            carriage: (0..rows).map(of_row).collect(),
        };
        let in_one_place = missing(&|row| if (60..80).contains(&row) { 2.0 } else { 0.1 });
        let everywhere = missing(&|_| 1.0);
        let gone = missing(&|_| 0.0);
        assert!((gain_elsewhere(&in_one_place, &gone) - 0.9 * 0.01).abs() < 1e-12);
        assert!((gain_elsewhere(&everywhere, &gone) - 0.9).abs() < 1e-12);
        // What makes the rest worse shows less than nothing there.
        assert!(gain_elsewhere(&in_one_place, &missing(&|_| 0.2)) < 0.0);
    }

    /// Of what is missing on both sides: the same, the opposite, half of it elsewhere, and nothing.
    #[test]
    fn laws_that_take_out_the_same_are_correlated() {
        let missing = |motor: [f64; 2], carriage: [f64; 2]| Missing {
            motor: motor.into(),
            carriage: carriage.into(),
        };
        let before = missing([3.0, 3.0], [3.0, 3.0]);
        let one = missing([2.0, 3.0], [1.0, 3.0]);
        for (other, expected) in [
            (missing([1.0, 3.0], [-1.0, 3.0]), 1.0),
            (missing([4.0, 3.0], [5.0, 3.0]), -1.0),
            // (1, 0, 2, 0) and (0, 0, 2, 1) were taken.
            (missing([3.0, 3.0], [1.0, 2.0]), 0.8),
            (before.clone(), 0.0),
        ] {
            assert!(
                (correlation_of_taken(&before, &one, &other) - expected).abs() < 1e-12,
                "{other:?}"
            );
        }
    }

    /// Four laws, three of which do nothing, and a cogging that was not tried.
    #[test]
    fn what_pruning_takes_out_makes_room() {
        let model = StageModel::default();
        let hidden = [
            part("constant_force", &[("amplitude", 2.0)]),
            part("cogging", &[("amplitude", 1.0), ("period", 0.006)]),
        ];
        let real =
            StageModel { effects: hidden.iter().map(Part::parameters).collect(), ..model.clone() };
        let record = |seed, moves| {
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let (train, holdout) = (record(3, 6), record(4, 4));
        let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let mut search = Search::new(&start, &train, &holdout, &Criteria::USUAL, &Silent).unwrap();
        let with = [
            part("quadratic_drag", &[("coefficient", 0.1)]),
            part("cable_chain", &[("stiffness", 1.0)]),
            part("motor_gain", &[("fraction", 0.001)]),
        ];
        let four =
            with.into_iter().fold(start.with(hidden[0].clone()), |four, part| four.with(part));
        let fitted = fit(&four, &train, Sides::BOTH, FitBudget::KEPT).unwrap();
        search.best = search.judged(fitted).unwrap();
        search.runners_up.resize(4, Vec::new());
        assert!(search.is_full());
        assert!(search.exchange().unwrap());
        search.run().unwrap();
        let mut names: Vec<&str> =
            search.found().effects.iter().map(|part| part.descriptor.name).collect();
        names.sort_unstable();
        assert_eq!(names, ["cogging", "constant_force"]);
    }
}
