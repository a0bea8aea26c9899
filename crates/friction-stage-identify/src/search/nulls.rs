//! What noise alone gives: the floor of a record, and what a law gains on records in which there is
//! nothing for it to explain.
//!
//! A residual that is driven along a measured motion is not the noise of the sensors, and a law
//! that makes the part of that motion in it smaller (less mass, a mass on a soft spring) takes
//! noise out of both records. No rule tells such a law from a right one; its gain on null records
//! ([`Hypothesis::null_record`]) does.

use crate::closed_loop::{LinearController, controller_of};
use crate::error::IdentifyError;
use crate::fit::Fitted;
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::{Floor, Measured};

/// Both records as a hypothesis alone would have made them.
pub(super) struct NullRecords {
    train: Measured,
    holdout: Measured,
}

/// What two records leave of a hypothesis that is all there is.
#[derive(Clone, Copy)]
pub(super) struct Floors {
    pub train: Floor,
    pub holdout: Floor,
}

impl NullRecords {
    pub(super) fn new(
        hypothesis: &Hypothesis,
        train: &Measured,
        holdout: &Measured,
        controller: Option<&LinearController>,
    ) -> Result<NullRecords, IdentifyError> {
        let there = hypothesis.in_record(holdout)?;
        let (train, holdout) = rayon::join(
            || hypothesis.null_record(train, controller, 1),
            || there.null_record(holdout, controller, 2),
        );
        Ok(NullRecords { train: train?, holdout: holdout? })
    }

    /// What is left of the hypothesis that they are of: at least what the sensors' noise leaves.
    pub(super) fn floors(&self, hypothesis: &Hypothesis) -> Result<Floors, IdentifyError> {
        let there = hypothesis.in_record(&self.holdout)?;
        let of = |hypothesis: &Hypothesis, record: &Measured| -> Result<Floor, IdentifyError> {
            let floor = hypothesis.floor(record);
            let (motor, carriage) = hypothesis.missing(record, Sides::BOTH)?.squares();
            Ok(Floor {
                motor: floor.motor.max(motor.sqrt()),
                carriage: floor.carriage.max(carriage.sqrt()),
            })
        };
        Ok(Floors { train: of(hypothesis, &self.train)?, holdout: of(&there, &self.holdout)? })
    }

    /// Force on the hold-out that is not known after the fit that they are of, N rms.
    pub(super) fn left_open(&self, fitted: &Fitted) -> Result<f64, IdentifyError> {
        let there = fitted.hypothesis.in_record(&self.holdout)?;
        Ok(fitted.left_open(&self.train, &there, &self.holdout, Sides::BOTH)?.sqrt())
    }
}

/// The controller of the train record, where both show that it is one.
pub(crate) fn known_controller(train: &Measured, holdout: &Measured) -> Option<LinearController> {
    let (train, holdout) = (train.controlled()?, holdout.controlled()?);
    controller_of(&train, &[&train, &holdout]).ok()
}

#[cfg(test)]
mod tests {
    use friction_stage_core::model::StageModel;

    use super::*;
    use crate::fit::{FitBudget, fit};
    use crate::hypothesis::Tolerances;
    use crate::test_records::recording;

    /// Against what fits to records of other noise make of another motion.
    #[test]
    fn what_a_record_leaves_open_is_what_fits_to_its_like_differ_by() {
        let model = StageModel::default();
        let record = |seed, moves| {
            Measured::new(&recording(&model, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let (other, start) = (record(90, 4), Hypothesis::new(&model, Tolerances::default()));
        let start = start.unwrap();
        let force = |hypothesis: &Hypothesis| hypothesis.missing(&other, Sides::BOTH).unwrap();
        let (as_it_is, mut differ, mut open) = (force(&start), 0.0, 0.0);
        const RECORDS: u64 = 6;
        for seed in 1..=RECORDS {
            let train = record(seed, 2);
            let fitted = fit(&start, &train, Sides::BOTH, FitBudget::KEPT).unwrap();
            let moved = force(&fitted.hypothesis);
            let change =
                as_it_is.carriage.iter().zip(&moved.carriage).map(|(a, b)| (a - b).powi(2));
            differ += change.sum::<f64>() / moved.carriage.len() as f64;
            open += fitted.left_open(&train, &fitted.hypothesis, &other, Sides::BOTH).unwrap();
        }
        let ratio = (open / differ).sqrt();
        assert!((0.5..2.5).contains(&ratio), "{ratio}: {open} {differ}");
    }
}
