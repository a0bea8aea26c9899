//! State of a search: the best hypothesis so far and the evidence for it.

use friction_stage_core::plant::Side;

use crate::closed_loop::LinearController;
use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted, fit, race};
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::Measured;
use crate::residual::missing::Missing;
use friction_stage_core::numerics::correlation::correlation_length_along;

use super::criteria::Criteria;
use super::nulls::{Floors, NullRecords, known_controller};
use super::score::{Judged, Score, errors};
use super::selection::{Alternative, Errors, Evidence, Inseparable, Watch, different_laws};

/// Most laws that are added.
pub const MOST_LAWS: usize = 4;
/// Most effects of a law that may repeat.
pub(super) const MOST_OF_ONE: usize = 4;

/// Parts of a record of which one alone is not to speak for a law. Assumed: a rest, or a move, is
/// within one or two of them.
const TENTHS: usize = 10;

/// A search on its way.
pub(super) struct Search<'a> {
    pub(super) train: &'a Measured,
    pub(super) holdout: &'a Measured,
    pub(super) watch: &'a dyn Watch,
    pub(super) criteria: Criteria,
    /// What is left on both records where there is nothing but the declared model.
    pub(super) floors: Floors,
    /// Of both records, where it is known.
    pub(super) controller: Option<LinearController>,
    pub(super) before: Judged,
    /// Of the declared model within its tolerances, where stiffness and damping of the bristles are
    /// from the record.
    pub(super) errors_within_tolerance: Option<Errors>,
    pub(super) best: Judged,
    /// Rounds in which candidates were tried.
    pub(super) rounds: usize,
    pub(super) evidence: Vec<Evidence>,
    /// For each effect the other candidates of its round, the best first.
    pub(super) runners_up: Vec<Vec<Alternative>>,
    pub(super) inseparable: Vec<Inseparable>,
    pub(super) stopped: bool,
}

impl<'a> Search<'a> {
    pub(super) fn new(
        declared: &Hypothesis,
        train: &'a Measured,
        holdout: &'a Measured,
        criteria: &Criteria,
        watch: &'a dyn Watch,
    ) -> Result<Search<'a>, IdentifyError> {
        let alike = fit(declared, train, Sides::BOTH, FitBudget::COMPARED)?;
        let fitted = with_different_guides(&alike.hypothesis, train, FitBudget::KEPT)?;
        let controller = known_controller(train, holdout);
        let floors = NullRecords::new(&fitted.hypothesis, train, holdout, controller.as_ref())?
            .floors(&fitted.hypothesis)?;
        let errors = errors(&fitted.hypothesis, train, holdout)?;
        let before = Judged { fitted, errors, score: Score::default() };
        let mut search = Search {
            train,
            holdout,
            watch,
            criteria: *criteria,
            floors,
            controller,
            runners_up: vec![Vec::new(); before.fitted.hypothesis.effects.len()],
            best: before.clone(),
            before,
            errors_within_tolerance: None,
            rounds: 0,
            evidence: Vec::new(),
            inseparable: Vec::new(),
            stopped: false,
        };
        search.before.score = search.quick_score(&errors);
        search.best = search.before.clone();
        Ok(search)
    }

    /// What was found so far.
    pub(super) fn found(&self) -> &Hypothesis {
        &self.best.fitted.hypothesis
    }

    pub(super) fn has_cell(&self) -> bool {
        self.train.cell.is_some()
    }

    /// Effects that the model declares: they stand first.
    pub(super) fn declared_effects(&self) -> usize {
        self.before.fitted.hypothesis.effects.len()
    }

    /// Effects of this name that were added.
    pub(super) fn added_of(&self, name: &str) -> usize {
        self.found().effects[self.declared_effects()..]
            .iter()
            .filter(|part| part.descriptor.name == name)
            .count()
    }

    /// Whether there are as many laws as may be.
    pub(super) fn is_full(&self) -> bool {
        different_laws(&self.found().effects[self.declared_effects()..]) >= MOST_LAWS
    }

    /// Fits what was found further than was needed on the way there.
    pub(super) fn go_on_fitting(&mut self, effort: FitBudget) -> Result<(), IdentifyError> {
        if self.found().effects.len() == self.declared_effects() {
            return Ok(());
        }
        let fitted = fit(self.found(), self.train, Sides::BOTH, effort)?;
        // A fit begins inside of all bounds, and may end elsewhere.
        if fitted.squares() < self.best.fitted.squares() {
            self.best = self.judged(fitted)?;
        }
        Ok(())
    }

    /// Sides that a fit with this effect has to look at beside those that were found before: what a
    /// sensor reads wrong moves with the fit of either side, and one side alone would bend it.
    pub(super) fn sides_of(&self, side: Side) -> Sides {
        let has_cell = self.has_cell();
        let sensors = self.found().effects.iter().any(|part| part.side() == Side::Sensor);
        match side {
            _ if has_cell && sensors => Sides::BOTH,
            Side::Motor if has_cell => Sides::MOTOR,
            Side::Motor | Side::Carriage if !has_cell => Sides::BOTH,
            Side::Sensor if has_cell => Sides::BOTH,
            _ => Sides::CARRIAGE,
        }
    }
}

/// What a law of `free` parameters that leads from one residual to another takes out of the mean
/// square by chance, N^2, twice over: for each the share of the values that are independent of each
/// other for what is as fast as what the law takes. Of what drifts or wanders a slow law finds few
/// of them.
pub(super) fn by_chance(before: &Missing, after: &Missing, free: usize) -> f64 {
    let of_side = |before: &[f64], after: &[f64]| {
        let squares: f64 = after.iter().map(|left| left * left).sum();
        squares * correlation_length_along(after, &difference(before, after))
    };
    let per_parameter =
        of_side(&before.motor, &after.motor) + of_side(&before.carriage, &after.carriage);
    2.0 * free as f64 * per_parameter / (after.carriage.len() as f64).powi(2)
}

pub(super) fn difference(before: &[f64], after: &[f64]) -> Vec<f64> {
    before.iter().zip(after).map(|(before, after)| before - after).collect()
}

/// Correlation of what two fits take out of a residual of both sides; 0 where one takes out
/// nothing.
pub(super) fn correlation_of_taken(before: &Missing, one: &Missing, other: &Missing) -> f64 {
    let taken = |after: &Missing| -> Vec<f64> {
        [difference(&before.motor, &after.motor), difference(&before.carriage, &after.carriage)]
            .concat()
    };
    let (one, other) = (taken(one), taken(other));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let size = (product(&one, &one) * product(&other, &other)).sqrt();
    if size > 0.0 { product(&one, &other) / size } else { 0.0 }
}

/// Fall of the mean square from one residual of a record to another without the tenth of the record
/// that shows most of it, N^2.
pub(super) fn gain_elsewhere(before: &Missing, after: &Missing) -> f64 {
    let rows = before.carriage.len();
    let fall = |before: &[f64], after: &[f64], tenth: usize| -> f64 {
        let tenth = tenth * before.len() / TENTHS..(tenth + 1) * before.len() / TENTHS;
        before[tenth.clone()]
            .iter()
            .zip(&after[tenth])
            .map(|(before, after)| before * before - after * after)
            .sum()
    };
    let of_tenth = |tenth| {
        fall(&before.motor, &after.motor, tenth) + fall(&before.carriage, &after.carriage, tenth)
    };
    let falls: Vec<f64> = (0..TENTHS).map(of_tenth).collect();
    (falls.iter().sum::<f64>() - falls.iter().copied().fold(f64::NEG_INFINITY, f64::max))
        / rows as f64
}

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
