//! Forms of a law and the values that its fit starts from.

use crate::fit::Fitted;
use crate::hypothesis::Part;
use crate::record::measured::Measured;
use friction_stage_core::model::ModelError;

/// Squares of the best of several fits up to which another one is worth going on with.
pub(super) const WITHIN: f64 = 1.4;
/// Share of the squares that counts as equal.
const ALIKE: f64 = 0.99;

/// What a fit starts from, the simplest form of the law first.
pub(super) fn starts(part: &Part, measured: &Measured) -> Vec<Part> {
    let descriptor = part.descriptor;
    let starts = (descriptor.starts)(&part.values, measured.rate.recip());
    let mut starts: Vec<Part> =
        starts.into_iter().map(|values| Part { descriptor, values }).collect();
    starts.sort_by_key(Part::free);
    starts
}

/// The same law without one of its terms, where fewer parameters are free then: a spring without
/// its hysteresis.
pub(super) fn simpler(part: &Part) -> Vec<Part> {
    let without = (0..part.values.len()).map(|value| {
        let mut less = part.clone();
        less.values[value] = 0.0;
        less
    });
    without.filter(|less| (1..part.free()).contains(&less.free())).collect()
}

/// Of fits of several forms those that come close to the best, that one first; of equals the
/// simplest.
pub(super) fn best_of(fitted: Vec<Result<Fitted, ModelError>>, most: usize) -> Vec<Fitted> {
    // A law whose values do not go together has lost; it does not end the search.
    let mut fitted: Vec<Fitted> = fitted.into_iter().flatten().collect();
    fitted.sort_by(|one, other| one.squares().total_cmp(&other.squares()));
    let least = fitted.first().map_or(f64::INFINITY, Fitted::squares);
    fitted.retain(|one| one.squares() <= WITHIN * least);
    let free = |one: &Fitted| one.hypothesis.effects.iter().map(Part::free).sum::<usize>();
    let equals = fitted.iter().take_while(|one| ALIKE * one.squares() <= least).enumerate();
    if let Some((simplest, _)) = equals.min_by_key(|(place, one)| (free(one), *place)) {
        fitted[..=simplest].rotate_right(1);
    }
    fitted.truncate(most);
    fitted
}
