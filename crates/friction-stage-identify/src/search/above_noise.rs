//! Whether laws reduce the residual of both records by more than that of null records.

use crate::error::IdentifyError;
use crate::hypothesis::{Hypothesis, Sides};

use super::nulls::NullRecords;
use super::selection::Evidence;
use super::state::Search;

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
