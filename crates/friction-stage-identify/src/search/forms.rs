//! Forms of a law and the values that its fit starts from.

use crate::fit::Fitted;
use crate::hypothesis::Part;
use crate::record::measured::Measured;
use friction_stage_core::model::ModelError;

/// Factor on the squares of the best of several fits up to which another one is fitted further.
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
    let equals = fitted.iter().take_while(|one| ALIKE * one.squares() <= least).enumerate();
    if let Some((simplest, _)) = equals.min_by_key(|(place, one)| (free(one), *place)) {
        fitted[..=simplest].rotate_right(1);
    }
    fitted.truncate(most);
    fitted
}

/// Fits of several forms, the best first, without those that have come to what another one with as
/// many parameters leaves.
pub(super) fn different(fitted: Vec<Result<Fitted, ModelError>>) -> Vec<Fitted> {
    let mut fitted: Vec<Fitted> = fitted.into_iter().flatten().collect();
    fitted.sort_by(|one, other| one.squares().total_cmp(&other.squares()));
    let mut kept: Vec<Fitted> = Vec::new();
    for one in fitted {
        let is_alike =
            |other: &Fitted| free(other) == free(&one) && other.squares() >= ALIKE * one.squares();
        if !kept.iter().any(is_alike) {
            kept.push(one);
        }
    }
    kept
}

/// Parameters of its effects that a fit moves.
fn free(fitted: &Fitted) -> usize {
    fitted.hypothesis.effects.iter().map(Part::free).sum()
}

#[cfg(test)]
mod tests {
    use super::super::tests::part;
    use super::*;
    use crate::fit::{FitBudget, race};
    use crate::hypothesis::{Hypothesis, Sides, Tolerances};
    use crate::search::ALL_BUT_NOISE;
    use crate::search::columns::Columns;
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    #[test]
    fn a_spring_with_hysteresis_has_a_form_without_it() {
        let spring = part("cable_chain", &[("stiffness", 20.0), ("amplitude", 1.0)]);
        let less = simpler(&spring);
        assert!(
            less.iter().any(|one| one.value_of("amplitude") == Some(0.0)
                && one.value_of("stiffness") == Some(20.0)),
            "{less:?}"
        );
        assert!(less.iter().all(|one| one.free() < spring.free()), "{less:?}");
    }

    /// Two fits that begin a little apart and one that begins elsewhere.
    #[test]
    fn of_fits_that_come_to_the_same_place_one_stays() {
        let cogging = |period| part("cogging", &[("amplitude", 1.0), ("period", period)]);
        let model = StageModel::default();
        let real = StageModel { effects: vec![cogging(4e-3).parameters()], ..model.clone() };
        let train = Measured::new(&recording(&real, 3, 0.0, 2), &model, "the record").unwrap();
        let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let starts = [9e-3, 4e-3, 4.01e-3].map(|period| start.with(cogging(period)));
        let fitted = race(&starts, &train, Sides::BOTH, FitBudget::KEPT, f64::INFINITY);
        let kept = different(fitted);
        let period = |one: &Fitted| one.hypothesis.effects[0].value_of("period").unwrap();
        let periods: Vec<f64> = kept.iter().map(period).collect();
        assert_eq!(periods.len(), 2, "{periods:?}");
        assert!((periods[0] / 4e-3 - 1.0).abs() < 1e-3, "{periods:?}");
    }

    /// A lag of 0.15 ticks with a delay of 0.99: fits that begin at either alone, or at parts of
    /// their sum, end a tick away from it or without a delay.
    #[test]
    fn a_lag_with_a_delay_that_ends_before_a_tick_is_found() {
        let model = StageModel::default();
        let step = Measured::new(&recording(&model, 3, 0.0, 1), &model, "the record")
            .unwrap()
            .rate
            .recip();
        let lag = part("actuator_lag", &[("time_constant", 0.15 * step), ("delay", 0.99 * step)]);
        let real = StageModel { effects: vec![lag.parameters()], ..model.clone() };
        let train =
            Measured::new(&recording(&real, 3, 0.0, 6), &model, "the train record").unwrap();
        let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let columns = Columns::new(&start, &train).unwrap();
        let values = lag.descriptor.propose(&columns.residual(true)).unwrap();
        let proposed = starts(&Part { descriptor: lag.descriptor, values }, &train);
        let forms: Vec<Hypothesis> = proposed.into_iter().map(|part| start.with(part)).collect();
        let fitted = race(&forms, &train, Sides::BOTH, FitBudget::KEPT, WITHIN);
        let found = best_of(fitted, 1).remove(0);
        let left = found.missing.rms() / found.hypothesis.floor(&train).total();
        assert!(left < ALL_BUT_NOISE, "{left} noise floors, {:?}", found.hypothesis.effects);
        let delay = found.hypothesis.effects[0].value_of("delay").unwrap();
        assert!((delay / (0.99 * step) - 1.0).abs() < 0.02, "{} ticks", delay / step);
    }
}
