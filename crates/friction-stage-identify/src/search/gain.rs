//! What is worth an effect, and when enough is explained.

use crate::fit::FitBudget;
use crate::hypothesis::Sides;
use crate::record::measured::Floor;
use friction_stage_core::plant::Side;

use super::selection::{ALL_BUT_NOISE, Errors, Evidence};
use super::state::Search;

/// What an effect must take off the mean square of train and of hold-out, in squares of the floor
/// of its side. Behind the force cell the model of the motor is exact; on the carriage the measured
/// motion stands for the true one, and guides of which no two are alike leave up to a fifth of a
/// square.
const MOTOR_GAIN: f64 = 0.02;
/// The same on the carriage.
pub const CARRIAGE_GAIN: f64 = 0.5;
/// Share of what is still explainable on each record that an effect must take out: below it the law
/// only bends towards what it is not.
pub(super) const LEAST_SHARE: f64 = 0.1;
/// The same on the carriage beside laws that explain nearly all: what is left there is what these
/// are not quite, or nearly all of other effects, of which there are three at most.
const LEAST_SHARE_OF_LITTLE: f64 = 0.25;
/// Share of what laws leave, where that is no noise, that a map must take out for the same, and
/// share of what a map leaves that a law beside it must: the rest of a curve of few knots has a
/// shape that many a law bends towards.
pub(super) const HALF_OF_THE_REST: f64 = 0.5;
/// Share of the best gain that a law with fewer parameters must reach to be preferred.
pub(super) const SIMPLER: f64 = 0.97;
/// Share of the winner's gain that a rival must reach, with no more parameters, for the two not to
/// be separable.
pub const RIVAL: f64 = 0.985;
/// Share of the explainable residual, and floors of noise, that laws which are the answer may
/// leave, where it is more than noise: right ones left 0.02 and 6 floors at most, false ones 0.03
/// and 38, or 0.09 and 103.
pub const LEFT_AT_MOST: f64 = 0.05;
const FLOORS_AT_MOST: f64 = 15.0;
/// Floors up to which the residual of either record passes for noise: a real machine is worth more
/// than one of the declared model.
pub const NOISE_LIKE: f64 = 2.0;

/// Part of what the next effect must take off that a step of a fit between rounds must bring: the
/// rest passes for no effect. Assumed.
const PART_OF_THE_NEXT: f64 = 0.01;

impl Search<'_> {
    /// Least fall of a mean square on this side, N^2.
    pub(super) fn threshold(&self, side: Side) -> f64 {
        self.threshold_over(side, &self.floors.holdout)
    }

    /// The same on a record with this floor.
    fn threshold_over(&self, side: Side, floor: &Floor) -> f64 {
        match side {
            Side::Motor if self.has_cell() => MOTOR_GAIN * floor.motor.powi(2),
            _ => CARRIAGE_GAIN * floor.carriage.powi(2),
        }
    }

    /// Least fall of the mean square, of a record with this floor, that is worth an effect with
    /// whose arrival the errors fall so, N^2. Wherever it acts: what the cell shows is judged as
    /// exactly as the motor, the rest as the carriage.
    pub(super) fn least_gain(&self, without: &Errors, with: &Errors, floor: &Floor) -> f64 {
        let by_cell = self.is_shown_by_cell(without, with);
        self.threshold_over(if by_cell { Side::Motor } else { Side::Carriage }, floor)
    }

    fn is_shown_by_cell(&self, without: &Errors, with: &Errors) -> bool {
        let on_motor = without.holdout_motor - with.holdout_motor;
        on_motor > 0.0 && on_motor >= self.threshold(Side::Motor)
    }

    /// Share of what is still explainable that a candidate must take out.
    fn least_share(&self, shown_by_cell: bool) -> f64 {
        if self.coordinate.is_some() {
            HALF_OF_THE_REST
        } else if self.is_explained(&self.best_errors) && !shown_by_cell {
            LEAST_SHARE_OF_LITTLE
        } else {
            LEAST_SHARE
        }
    }

    /// What a candidate must take off the mean square of train or hold-out where this is what is
    /// left, N^2.
    fn least_of(&self, one: &Evidence, left: f64, floor: &Floor) -> f64 {
        let share = self.least_share(self.is_shown_by_cell(&self.best_errors, &one.errors));
        self.least_gain(&self.best_errors, &one.errors, floor)
            .max(share * (left - floor.total().powi(2)))
    }

    pub(super) fn least_on_train(&self, one: &Evidence) -> f64 {
        self.least_of(one, self.best_errors.train(), &self.floors.train).max(one.chance)
    }

    pub(super) fn least_on_holdout(&self, one: &Evidence) -> f64 {
        self.least_of(one, self.best_errors.holdout(), &self.floors.holdout)
    }

    /// Whether a candidate takes enough out of both records, out of more than one place of the
    /// train record, and out of the hold-out by itself. A bump that is as narrow as can be, at the
    /// place where the stage rested once, takes out whatever was missing during that rest, and lets
    /// the guides go where they fit the hold-out better.
    pub(super) fn is_enough(&self, one: &Evidence) -> bool {
        one.train_gain >= self.least_on_train(one)
            && one.train_gain_elsewhere >= one.chance
            && one.holdout_gain.min(one.holdout_gain_alone) >= self.least_on_holdout(one)
    }

    /// Of a fit on the way from `before`: the last one goes to its end.
    pub(super) fn on_the_way(&self, before: &Errors) -> FitBudget {
        let explainable = before.train() - self.floors.train.total().powi(2);
        let next =
            self.threshold_over(Side::Carriage, &self.floors.train).max(LEAST_SHARE * explainable);
        FitBudget::KEPT.ending_below(PART_OF_THE_NEXT * next * self.train.rows.len() as f64)
    }

    /// Squares of the train record that what was found leaves on these sides, N^2.
    pub(super) fn squares_left(&self, sides: Sides) -> f64 {
        let squares = |side: &[f64], counts: bool| {
            if counts { side.iter().map(|left| left * left).sum() } else { 0.0 }
        };
        squares(&self.best.missing.motor, sides.motor)
            + squares(&self.best.missing.carriage, sides.carriage)
    }

    /// Squares of the train record that a candidate on these sides must come below, N^2: one whose
    /// fit will not is too small, however it ends.
    pub(super) fn gain_on_train(&self, sides: Sides) -> f64 {
        let shown_by_cell = sides.motor && self.has_cell();
        let side = if shown_by_cell { Side::Motor } else { Side::Carriage };
        let least = self.threshold_over(side, &self.floors.train);
        let explainable = self.best_errors.train() - self.floors.train.total().powi(2);
        let rows = self.train.rows.len() as f64;
        self.squares_left(sides) - rows * least.max(self.least_share(shown_by_cell) * explainable)
    }

    /// What these errors leave on the hold-out beyond the noise of the sensors, N^2.
    pub(super) fn beyond_noise(&self, left: &Errors) -> f64 {
        left.holdout() - self.floors.holdout.total().powi(2)
    }

    pub(super) fn is_noise(&self, left: &Errors) -> bool {
        left.holdout() <= (NOISE_LIKE * self.floors.holdout.total()).powi(2)
            && self.is_noise_on_train(left)
    }

    pub(super) fn is_noise_on_train(&self, left: &Errors) -> bool {
        left.train() <= (NOISE_LIKE * self.floors.train.total()).powi(2)
    }

    /// Whether no more is left than where nothing is hidden.
    pub(super) fn is_all_but_noise(&self, left: &Errors) -> bool {
        left.holdout().sqrt() <= ALL_BUT_NOISE * self.floors.holdout.total()
    }

    /// Whether little enough is left of the hold-out for what was found to be the answer.
    pub(super) fn is_explained(&self, left: &Errors) -> bool {
        leaves_little(left.holdout(), self.errors_before.holdout(), self.floors.holdout.total())
    }

    /// Squares that noise leaves on the train record, N^2.
    pub(super) fn noise_squares(&self) -> f64 {
        self.train.rows.len() as f64 * self.floors.train.total().powi(2)
    }
}

/// Whether laws that leave a mean square on the hold-out, of one before, both N^2, over a floor of
/// noise, N, are the answer though more than noise is left.
fn leaves_little(left: f64, before: f64, floor: f64) -> bool {
    let share = left - floor.powi(2) <= LEFT_AT_MOST * (before - floor.powi(2)).max(0.0);
    // Sensors without any noise say nothing of sizes.
    share && (floor <= 0.0 || left <= (FLOORS_AT_MOST * floor).powi(2))
}

#[cfg(test)]
mod tests {
    use super::super::rounds::tests::tried;
    use super::*;
    use crate::hypothesis::{Hypothesis, Tolerances};
    use crate::record::measured::Measured;
    use crate::search::Silent;
    use crate::search::nulls::Floors;
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    /// Of 100 N^2 on both records a law takes a half, by chance it would take 1 N^2: what it does
    /// beside the place that shows it most decides, and what it does to the hold-out by itself.
    #[test]
    fn a_law_must_show_in_more_than_one_place() {
        let model = StageModel::default();
        let record =
            |seed| Measured::new(&recording(&model, seed, 0.0, 2), &model, "the record").unwrap();
        let (train, holdout) = (record(3), record(4));
        let declared = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let mut search = Search::new(&declared, &train, &holdout, &Silent).unwrap();
        search.best_errors =
            Errors { train_carriage: 100.0, holdout_carriage: 100.0, ..Errors::default() };
        for (elsewhere, alone, expected) in
            [(20.0, 60.0, true), (0.5, 60.0, false), (-10.0, 60.0, false), (20.0, 0.0, false)]
        {
            let mut one = tried(&[("position_dependent_friction", 3, 50.0)]).remove(0).one;
            (one.chance, one.train_gain_elsewhere, one.holdout_gain_alone) =
                (1.0, elsewhere, alone);
            assert_eq!(search.is_enough(&one), expected, "{elsewhere} N^2, by itself {alone} N^2");
        }
    }

    /// In floors: what is left, and what was before.
    #[test]
    fn laws_are_the_answer_where_they_leave_little_in_shares_and_in_floors() {
        let over_a_floor =
            |left: f64, before: f64| leaves_little(left * left, before * before, 1.0);
        assert!(over_a_floor(6.0, 50.0));
        // A seal that remembers, taken for a hysteresis, and for four laws at once.
        assert!(!over_a_floor(103.0, 341.0) && !over_a_floor(38.0, 211.0));
        // Little in floors, but not of what there was.
        assert!(!over_a_floor(6.0, 20.0));
        assert!(leaves_little(1e-4, 1.0, 0.0) && !leaves_little(0.1, 1.0, 0.0));
    }

    /// Of 100 N^2 over a floor of 0.1 N: laws that leave a half ask the next one for a tenth of
    /// that, laws that leave nearly nothing for a quarter, unless the cell shows it.
    #[test]
    fn beside_laws_that_explain_nearly_all_the_next_one_must_take_more() {
        let model = StageModel::default();
        let record = |seed, moves| {
            Measured::new(&recording(&model, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let (train, holdout) = (record(3, 4), record(4, 2));
        let declared = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let mut search = Search::new(&declared, &train, &holdout, &Silent).unwrap();
        let floor = Floor { motor: 0.05, carriage: 0.1 };
        search.floors = Floors { train: floor, holdout: floor };
        let on_both = |motor: f64, carriage: f64| Errors {
            train_motor: motor,
            train_carriage: carriage,
            holdout_motor: motor,
            holdout_carriage: carriage,
        };
        search.errors_before = on_both(0.0, 100.0);
        let mut is_enough = |before: Errors, after: Errors| {
            search.best_errors = before;
            let mut one =
                tried(&[("cable_chain", 2, before.holdout() - after.holdout())]).remove(0).one;
            one.errors = after;
            let enough = one.holdout_gain >= search.least_on_holdout(&one);
            assert_eq!(enough, one.train_gain >= search.least_on_train(&one));
            // Its fit is given up where it will not come to just that.
            let sides = if search.is_shown_by_cell(&before, &after) {
                Sides::MOTOR
            } else {
                Sides::CARRIAGE
            };
            let asked = (search.squares_left(sides) - search.gain_on_train(sides))
                / train.rows.len() as f64;
            assert!((asked / search.least_on_train(&one) - 1.0).abs() < 1e-12, "{asked} N^2");
            enough
        };
        for (left, share) in [(50.0, 0.1), (1.0, 0.25)] {
            for (taken, expected) in [(0.9 * share, false), (1.1 * share, true)] {
                let after = on_both(0.0, (1.0 - taken) * left);
                assert_eq!(is_enough(on_both(0.0, left), after), expected, "{taken} of {left} N^2");
            }
        }
        assert!(is_enough(on_both(0.3, 0.7), on_both(0.15, 0.7)));
    }
}
