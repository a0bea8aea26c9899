//! What a hypothesis leaves of both records, and the score of that.

use crate::error::IdentifyError;
use crate::fit::Fitted;
use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use friction_stage_core::plant::Side;

use super::selection::Errors;

/// Logarithms of what is left of either record beyond the noise, of both sides together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Score {
    pub train: f64,
    pub holdout: f64,
}

impl Score {
    /// How much lower another one is on the record on which it is least so.
    pub(super) fn fall_to(&self, other: &Score) -> f64 {
        (self.train - other.train).min(self.holdout - other.holdout)
    }

    pub(super) fn both(&self) -> f64 {
        self.train + self.holdout
    }

    /// How many times less likely another one is.
    pub(super) fn times_less_likely(&self, other: &Score) -> f64 {
        (0.5 * (other.both() - self.both())).exp()
    }
}

/// A fit with what it leaves.
#[derive(Clone)]
pub(super) struct Judged {
    pub fitted: Fitted,
    pub errors: Errors,
    pub score: Score,
}

impl Judged {
    /// Parameters of its effects that a fit moves.
    pub(super) fn free(&self) -> usize {
        self.fitted.hypothesis.effects.iter().map(Part::free).sum()
    }
}

pub(super) fn errors(
    hypothesis: &Hypothesis,
    train: &Measured,
    holdout: &Measured,
) -> Result<Errors, IdentifyError> {
    let (train_motor, train_carriage) = hypothesis.missing(train, Sides::BOTH)?.squares();
    let (holdout_motor, holdout_carriage) =
        hypothesis.in_record(holdout)?.missing(holdout, Sides::BOTH)?.squares();
    let of_command = of_command(hypothesis, train)?;
    Ok(Errors { train_motor, train_carriage, holdout_motor, holdout_carriage, of_command })
}

/// Share of the command that is left of it as the force of the motor: their product over the square
/// of the command. 1 with a cell.
pub(super) fn of_command(
    hypothesis: &Hypothesis,
    measured: &Measured,
) -> Result<f64, IdentifyError> {
    let on_motor = |part: &Part| part.side() == Side::Motor;
    if measured.cell.is_some() || !hypothesis.effects.iter().any(on_motor) {
        return Ok(1.0);
    }
    let driven = hypothesis.driven(measured, Sides::BOTH, &Driven::default())?;
    let mut product = 0.0;
    for force in driven.forces().filter(|force| force.side() == Side::Motor) {
        let both = force.at_nodes.iter().zip(&measured.command);
        product += both.map(|(force, command)| force * command).sum::<f64>();
    }
    let square: f64 = measured.command.iter().map(|command| command * command).sum();
    Ok(1.0 + product / square.max(f64::MIN_POSITIVE))
}
