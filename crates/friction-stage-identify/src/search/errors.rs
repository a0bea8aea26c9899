//! What a hypothesis misses on both records.

use crate::error::IdentifyError;
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::Measured;

use super::selection::Errors;

pub(super) fn errors(
    hypothesis: &Hypothesis,
    train: &Measured,
    holdout: &Measured,
) -> Result<Errors, IdentifyError> {
    let (train_motor, train_carriage) = hypothesis.missing(train, Sides::BOTH)?.squares();
    let (holdout_motor, holdout_carriage) =
        hypothesis.in_record(holdout)?.missing(holdout, Sides::BOTH)?.squares();
    Ok(Errors { train_motor, train_carriage, holdout_motor, holdout_carriage })
}

/// Mean square of what is missing on a hold-out, N^2.
pub(super) fn errors_on(hypothesis: &Hypothesis, holdout: &Measured) -> Result<f64, IdentifyError> {
    let (motor, carriage) = hypothesis.in_record(holdout)?.missing(holdout, Sides::BOTH)?.squares();
    Ok(motor + carriage)
}
