//! One order of all hypotheses: by what they leave of both records beyond the noise.

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted};
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::{Floor, Measured};

use super::nulls::{Floors, NullRecords};
use super::score::{Judged, Score, errors};
use super::selection::{ALL_BUT_NOISE, Errors};
use super::state::Search;

/// Share of the square of the force that counts like nothing where sensors have no noise at all.
const ROUNDING: f64 = 1e-12;
/// Squares of a noise floor above which the difference between noise floors does not matter.
const FAR_ABOVE: f64 = 30.0;
/// Part of what the next effect must take off that a step of a fit between rounds must bring: the
/// rest passes for no effect. Assumed.
const PART_OF_THE_NEXT: f64 = 0.01;

impl Search<'_> {
    /// The score of errors over the noise that a hypothesis leaves on its own null record, at most
    /// that of the declared model: a law that reduces noise explains nothing.
    fn score_over(&self, errors: &Errors, own: &Floors) -> Score {
        let of = |motor: f64, carriage: f64, own: &Floor, floor: &Floor, record: &Measured| {
            let rounding = ROUNDING * record.force_rms().powi(2);
            let side = |left: f64, own: f64, floor: f64, blur: f64| {
                let beyond = (left - own.min(floor).powi(2)).max(0.0);
                (beyond + blur * floor.powi(2) + rounding).ln()
            };
            let on_motor = match self.has_cell() {
                true => side(motor, own.motor, floor.motor, self.criteria.blur_of_motor),
                false => 0.0,
            };
            on_motor + side(carriage, own.carriage, floor.carriage, self.criteria.blur_of_carriage)
        };
        let (left, floors) = (errors, &self.floors);
        // In newtons of the command.
        let scale = left.of_command.powi(2).max(ROUNDING);
        let scaled = |own: &Floor| Floor { carriage: own.carriage / scale.sqrt(), ..*own };
        let own = Floors { train: scaled(&own.train), holdout: scaled(&own.holdout) };
        let train = (left.train_motor, left.train_carriage / scale);
        let holdout = (left.holdout_motor, left.holdout_carriage / scale);
        Score {
            train: of(train.0, train.1, &own.train, &floors.train, self.train),
            holdout: of(holdout.0, holdout.1, &own.holdout, &floors.holdout, self.holdout),
        }
    }

    /// How far the score of what was found may still fall.
    pub(super) fn room(&self) -> f64 {
        self.best.score.fall_to(&self.quick_score(&Errors::default()))
    }

    /// The score of errors over the noise of the declared model.
    pub(super) fn quick_score(&self, errors: &Errors) -> Score {
        self.score_over(errors, &self.floors)
    }

    pub(super) fn judged(&self, fitted: Fitted) -> Result<Judged, IdentifyError> {
        let errors = errors(&fitted.hypothesis, self.train, self.holdout)?;
        let far = |left: f64, floor: f64| left > FAR_ABOVE * floor.powi(2);
        let (train, holdout) = (&self.floors.train, &self.floors.holdout);
        let is_far = (!self.has_cell()
            || (far(errors.train_motor, train.motor) && far(errors.holdout_motor, holdout.motor)))
            && far(errors.train_carriage, train.carriage)
            && far(errors.holdout_carriage, holdout.carriage);
        let own = match is_far {
            true => self.floors,
            false => NullRecords::new(
                &fitted.hypothesis,
                self.train,
                self.holdout,
                self.controller.as_ref(),
            )?
            .floors(&fitted.hypothesis)?,
        };
        Ok(Judged { score: self.score_over(&errors, &own), errors, fitted })
    }

    /// Fall of the score for which a hypothesis is better than one with less in it, which leaves
    /// this: a curve must explain more than a law in place of an answer, and so must a law
    /// alongside a curve.
    pub(super) fn asked(&self, more: &Hypothesis, less: &Hypothesis, left: &Errors) -> f64 {
        let says_less = |of: &Hypothesis| {
            let mut added = of.effects.iter().skip(self.declared_effects());
            added.any(|part| part.descriptor.is_curve() || part.slips())
        };
        match says_less(more) && (says_less(less) || self.is_explained(left)) {
            true => self.criteria.fall_of_curve,
            false => self.criteria.fall,
        }
    }

    /// The same for what is added to what was found.
    pub(super) fn asked_beside(&self, more: &Hypothesis) -> f64 {
        self.asked(more, self.found(), &self.best.errors)
    }

    /// Whether a hypothesis with more in it is better than one with less.
    pub(super) fn needs(&self, more: &Judged, less: &Judged) -> bool {
        let asked = self.asked(&more.fitted.hypothesis, &less.fitted.hypothesis, &less.errors);
        less.score.fall_to(&more.score) >= asked
    }

    /// Of a fit between rounds, with this much left on the train record, N^2. Only the last one is
    /// brought to its end.
    pub(super) fn on_the_way(&self, left: f64) -> FitBudget {
        let floor = self.floors.train.total().powi(2);
        let counts = (left - floor).max(0.0) + self.criteria.blur_of_carriage * floor;
        let next = (1.0 - (-self.criteria.fall).exp()) * counts;
        FitBudget::KEPT.ending_below(PART_OF_THE_NEXT * next * self.train.rows.len() as f64)
    }

    /// Squares of the train record that a candidate on these sides must come below, N^2: one whose
    /// fit will not is too small, however it ends.
    pub(super) fn worth_on_train(&self, sides: Sides) -> f64 {
        let (errors, floor) = (&self.best.errors, &self.floors.train);
        let rows = self.train.rows.len() as f64;
        let asked = 1.0 - (-self.asked_beside(self.found())).exp();
        let of = |counts: bool, left: f64, floor: f64, blur: f64| {
            let beyond = (left - floor.powi(2)).max(0.0) + blur * floor.powi(2);
            if counts { (rows * left, rows * asked * beyond) } else { (0.0, f64::INFINITY) }
        };
        let by_cell = sides.motor && self.has_cell();
        let criteria = &self.criteria;
        let motor = of(by_cell, errors.train_motor, floor.motor, criteria.blur_of_motor);
        let carriage =
            of(sides.carriage, errors.train_carriage, floor.carriage, criteria.blur_of_carriage);
        motor.0 + carriage.0 - motor.1.min(carriage.1)
    }

    /// What these errors leave on the hold-out beyond the noise of the sensors, N^2.
    pub(super) fn beyond_noise(&self, left: &Errors) -> f64 {
        left.holdout() - self.floors.holdout.total().powi(2)
    }

    pub(super) fn is_noise(&self, left: &Errors) -> bool {
        left.holdout() <= (self.criteria.noise_like * self.floors.holdout.total()).powi(2)
            && self.is_noise_on_train(left)
    }

    pub(super) fn is_noise_on_train(&self, left: &Errors) -> bool {
        left.train() <= (self.criteria.noise_like * self.floors.train.total()).powi(2)
    }

    /// Whether no more is left than where nothing is hidden.
    pub(super) fn is_all_but_noise(&self, left: &Errors) -> bool {
        left.holdout().sqrt() <= ALL_BUT_NOISE * self.floors.holdout.total()
    }

    /// Whether so little of the hold-out is left, as a share and over the noise floor, that what
    /// was found is the answer though more than noise is left.
    pub(super) fn is_explained(&self, left: &Errors) -> bool {
        let floor = self.floors.holdout.total();
        let explainable = self.beyond_noise(&self.before.errors).max(0.0);
        let share = self.beyond_noise(left) <= self.criteria.left_at_most * explainable;
        // Sensors without any noise say nothing of sizes.
        share && (floor <= 0.0 || left.holdout() <= (self.criteria.floors_at_most * floor).powi(2))
    }

    /// Squares that noise leaves on the train record, N^2.
    pub(super) fn noise_squares(&self) -> f64 {
        self.train.rows.len() as f64 * self.floors.train.total().powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::part;
    use super::*;
    use crate::hypothesis::Part;
    use crate::hypothesis::Tolerances;
    use crate::search::{Criteria, Silent};
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    /// Runs with a search on a record of the declared stage whose noise floors are 0.05 N on the
    /// motor and 0.1 N on the carriage.
    fn with_search(runs: impl FnOnce(&mut Search)) {
        let model = StageModel::default();
        let record =
            |seed| Measured::new(&recording(&model, seed, 0.0, 2), &model, "the record").unwrap();
        let (train, holdout) = (record(3), record(4));
        let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let mut search = Search::new(&start, &train, &holdout, &Criteria::USUAL, &Silent).unwrap();
        let floor = Floor { motor: 0.05, carriage: 0.1 };
        search.floors = Floors { train: floor, holdout: floor };
        runs(&mut search);
    }

    fn on_both(motor: f64, carriage: f64) -> Errors {
        Errors {
            train_motor: motor,
            train_carriage: carriage,
            holdout_motor: motor,
            holdout_carriage: carriage,
            of_command: 1.0,
        }
    }

    #[test]
    fn what_takes_out_noise_takes_out_nothing() {
        with_search(|search| {
            let floors = search.floors;
            let quieter = Floor { motor: 0.05, carriage: 0.05 };
            let quieter = Floors { train: quieter, holdout: quieter };
            let noise = search.score_over(&on_both(0.0025, 0.01), &floors);
            // Three quarters of the noise go with a law that leaves as little of a null record.
            let less = on_both(0.0025, 0.0025);
            assert_eq!(noise.fall_to(&search.score_over(&less, &quieter)), 0.0);
            // One that leaves more of a null record than the declared model does is not excused.
            let louder = Floor { motor: 0.05, carriage: 1.0 };
            let louder = Floors { train: louder, holdout: louder };
            let more = on_both(0.0025, 1.0);
            assert!(search.score_over(&more, &louder).fall_to(&noise) > 3.0);
        });
    }

    /// Of 100 N^2, and of three noise floors, with not quite a fifth of it, and with more; and of
    /// the motor, whose model is exact.
    #[test]
    fn more_parameters_must_take_a_fifth_of_what_is_left_on_both_records() {
        with_search(|search| {
            let judged = |search: &Search, errors: Errors| Judged {
                errors,
                score: search.quick_score(&errors),
                ..search.best.clone()
            };
            for (before, after, expected) in [
                (on_both(0.0, 100.0), on_both(0.0, 83.0), false),
                (on_both(0.0, 100.0), on_both(0.0, 81.0), true),
                (on_both(0.0, 0.09), on_both(0.0, 0.075), false),
                (on_both(0.0, 0.09), on_both(0.0, 0.068), true),
                (on_both(0.0, 0.012), on_both(0.0, 0.0098), false),
                (on_both(0.0, 0.0125), on_both(0.0, 0.0098), true),
                (on_both(0.00255, 1.0), on_both(0.0025, 1.0), true),
                (on_both(0.00252, 1.0), on_both(0.0025, 1.0), false),
                // On one record alone.
                (on_both(0.0, 100.0), Errors { train_carriage: 1.0, ..on_both(0.0, 99.0) }, false),
            ] {
                let (less, more) = (judged(search, before), judged(search, after));
                assert_eq!(search.needs(&more, &less), expected, "{before:?} {after:?}");
            }
        });
    }

    /// In place of laws that are an answer, and alongside another curve. Where nothing is an answer
    /// it is asked for no more than a law.
    #[test]
    fn a_curve_must_take_half_of_what_an_answer_leaves() {
        with_search(|search| {
            search.before.errors = on_both(0.0, 100.0);
            let (some, little) = (on_both(0.0, 50.0), on_both(0.0, 0.01));
            let start = search.found().clone();
            let law = start.with(part("cogging", &[("amplitude", 1.0), ("period", 0.01)]));
            let knots = friction_stage_core::plant::EffectDescriptor::find("map").unwrap();
            let values = vec![0.0, 2.0, 0.0, 0.1, 0.0, 0.0, 1.0, 2.0];
            let curve = start.with(Part { descriptor: knots, values });
            let Criteria { fall, fall_of_curve, .. } = search.criteria;
            assert_eq!(search.asked(&law, &start, &some), fall);
            assert_eq!(search.asked(&curve, &start, &some), fall);
            assert_eq!(search.asked(&curve, &law, &little), fall_of_curve);
            assert_eq!(search.asked(&curve, &curve, &some), fall_of_curve);
        });
    }

    /// In noise floors: what is left, and what was before.
    #[test]
    fn laws_are_the_answer_where_they_leave_little_in_shares_and_in_floors() {
        with_search(|search| {
            let floor = search.floors.holdout.total();
            let mut is_explained = |left: f64, before: f64| {
                search.before.errors = on_both(0.0, (before * floor).powi(2));
                search.is_explained(&on_both(0.0, (left * floor).powi(2)))
            };
            assert!(is_explained(6.0, 50.0));
            // A seal that remembers, taken for a hysteresis, and for four laws at once.
            assert!(!is_explained(103.0, 341.0) && !is_explained(38.0, 211.0));
            // Little in noise floors, but not as a share.
            assert!(!is_explained(6.0, 20.0));
        });
    }

    /// A fit of a candidate is given up where it cannot come to what the order asks for.
    #[test]
    fn the_goal_of_a_candidate_is_what_the_order_asks_for() {
        with_search(|search| {
            let rows = search.train.rows.len() as f64;
            search.best.errors = on_both(0.01, 1.0);
            search.best.score = search.quick_score(&search.best.errors);
            let score = |search: &Search, carriage: f64| {
                search.best.score.fall_to(&search.quick_score(&on_both(0.01, carriage)))
            };
            let goal = search.worth_on_train(Sides::CARRIAGE) / rows;
            assert!((score(search, goal) - search.criteria.fall).abs() < 1e-9, "{goal}");
        });
    }
}
