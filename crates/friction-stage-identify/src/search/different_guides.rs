//! Fits in which the guides differ from each other.

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted, fit, race};
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::Measured;

/// The fit with guides that differ from each other, from the differences that there are and afresh:
/// the sum of the guides depends on the products of their differences, and what an effect not yet
/// known biased them to is no good start. Guides that are all the same are none either: there no
/// direction is better than its opposite.
pub(super) fn with_different_guides(
    start: &Hypothesis,
    train: &Measured,
    effort: FitBudget,
) -> Result<Fitted, IdentifyError> {
    let Some(afresh) = start.different_guides() else {
        return Ok(fit(start, train, Sides::BOTH, effort)?);
    };
    if start.guides_are_alike() {
        return Ok(fit(&afresh, train, Sides::BOTH, effort)?);
    }
    let fitted = race(&[start.holding_guides(false), afresh], train, Sides::BOTH, effort, 1.0);
    let fitted = fitted.into_iter().collect::<Result<Vec<_>, _>>()?;
    // Of equals the first one.
    let best = fitted
        .into_iter()
        .reduce(|best, other| if other.squares() < best.squares() { other } else { best });
    Ok(best.expect("two fits"))
}
