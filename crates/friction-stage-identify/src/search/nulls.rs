//! What noise alone gives: the floor of a record, and what a law gains on records in which there is
//! nothing for it to explain.
//!
//! A residual that is driven along a measured motion is not the noise of the sensors, and a law that
//! makes the part of that motion in it smaller (less mass, a mass on a soft spring) takes noise out
//! of both records. No rule tells such a law from a right one; its gain on null records
//! ([`Hypothesis::null_record`]) does.

use crate::closed_loop::{LinearController, controller_of};
use crate::error::IdentifyError;
use crate::fit::{FitBudget, fit};
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::{Floor, Measured};

use super::selection::{Errors, Evidence};
use super::state::{Search, errors};

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

    /// Fall of the mean squares of train and hold-out from one hypothesis to another where the first
    /// is all there is, N^2.
    fn gains(
        &self,
        without: &Hypothesis,
        with: &Hypothesis,
        sides: Sides,
    ) -> Result<(f64, f64), IdentifyError> {
        let left = |hypothesis: &Hypothesis| -> Result<Errors, IdentifyError> {
            let fitted = fit(hypothesis, &self.train, sides, FitBudget::COMPARED)?;
            errors(&fitted.hypothesis, &self.train, &self.holdout)
        };
        let (without, with) = rayon::join(|| left(without), || left(with));
        let (without, with) = (without?, with?);
        Ok((without.train() - with.train(), without.holdout() - with.holdout()))
    }
}

/// The controller of the train record, where both show that it is one.
pub(super) fn known_controller(train: &Measured, holdout: &Measured) -> Option<LinearController> {
    let (train, holdout) = (train.controlled()?, holdout.controlled()?);
    controller_of(&train, &[&train, &holdout]).ok()
}

impl Search<'_> {
    /// Whether a candidate that takes enough out of both records takes enough more than it does of
    /// records in which there is nothing for it.
    pub(super) fn is_more_than_noise(
        &self,
        one: &Evidence,
        with: &Hypothesis,
    ) -> Result<bool, IdentifyError> {
        let (least_on_train, least_on_holdout) =
            (self.least_on_train(one), self.least_on_holdout(one));
        // There is no more noise than all of it.
        if one.train_gain - self.floors.train.total().powi(2) >= least_on_train
            && one.holdout_gain - self.floors.holdout.total().powi(2) >= least_on_holdout
        {
            return Ok(true);
        }
        let best = &self.best.hypothesis;
        let records = NullRecords::new(best, self.train, self.holdout, self.controller.as_ref())?;
        let (on_train, on_holdout) =
            records.gains(&best.holding_guides(true), with, self.sides_beside(&one.part))?;
        Ok(one.train_gain - on_train >= least_on_train
            && one.holdout_gain - on_holdout >= least_on_holdout)
    }

    /// Whether everything that was added takes as much more out of both records than noise would
    /// give it, as one law must.
    pub(super) fn is_all_more_than_noise(&self) -> Result<bool, IdentifyError> {
        let (before, now) = (&self.errors_before, &self.best_errors);
        let (on_train, on_holdout) =
            (before.train() - now.train(), before.holdout() - now.holdout());
        let (train, holdout) =
            (self.floors.train.total().powi(2), self.floors.holdout.total().powi(2));
        let (least_on_train, least_on_holdout) = (
            self.least_gain(before, now, &self.floors.train),
            self.least_gain(before, now, &self.floors.holdout),
        );
        if on_train - train >= least_on_train && on_holdout - holdout >= least_on_holdout {
            return Ok(true);
        }
        let records = NullRecords::new(
            &self.before.hypothesis,
            self.train,
            self.holdout,
            self.controller.as_ref(),
        )?;
        let (by_noise, by_noise_there) =
            records.gains(&self.before.hypothesis, &self.best.hypothesis, Sides::BOTH)?;
        Ok(on_train - by_noise >= least_on_train && on_holdout - by_noise_there >= least_on_holdout)
    }
}
