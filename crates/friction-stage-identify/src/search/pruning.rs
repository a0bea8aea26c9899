//! Backwards: what the others have made superfluous goes.

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted};
use friction_stage_core::model::Coordinate;

use super::curves::CURVE_ALONE;
use super::different_guides::with_different_guides;
use super::gain::HALF_OF_THE_REST;
use super::selection::{Errors, Evidence, Outcome};
use super::state::{Search, errors};

/// How many times the noise above what was found a fit without one of its effects may leave on the
/// train record while it is worth going on, and how many times that one with another curve in place
/// of an effect: to pass they may leave half of the noise more on the hold-out, or twice as much.
const MANY_TIMES: f64 = 3.0;

impl Search<'_> {
    /// Backwards: an effect that the others have made superfluous goes.
    pub(super) fn prune(&mut self) -> Result<(), IdentifyError> {
        // The laws without the curve, with where it stands, for as long as nothing else changes.
        let mut alone: Option<(usize, Fitted, Errors)> = None;
        let mut index = self.declared_effects();
        while index < self.best.hypothesis.effects.len() {
            self.watch.progress("pruning", 0.95);
            if let (None, Some(curve)) = (&alone, self.curve()) {
                let (laws, left) = self.without(curve, FitBudget::KEPT)?;
                alone = Some((curve, laws, left));
            }
            let (fewer, found) = match &alone {
                Some((curve, laws, left)) if *curve == index => (laws.clone(), *left),
                _ => self.without(index, self.in_place_of_best())?,
            };
            if self.leaves_about_as_much(&found) {
                self.strike(index);
                (self.best, self.best_errors) = (fewer, found);
                alone = None;
                continue;
            }
            if let Some((curve, _, left)) = alone.as_ref().filter(|(curve, ..)| *curve != index)
                && let Some((with, over)) = self.with_curve_in_place_of(index, *curve, left)?
            {
                let curve = curve - usize::from(*curve > index);
                self.strike(index);
                self.replace_curve(curve, with, over)?;
                alone = None;
            } else {
                index += 1;
            }
        }
        Ok(())
    }

    /// Of a fit that says the same with less: one that leaves far more on the train record is given
    /// up.
    pub(super) fn in_place_of_best(&self) -> FitBudget {
        FitBudget::KEPT.gain_below(self.best.squares() + MANY_TIMES * self.noise_squares())
    }

    /// Whether what was found is not worth more than this.
    pub(super) fn leaves_about_as_much(&self, found: &Errors) -> bool {
        found.holdout() - self.best_errors.holdout()
            < self.least_gain(found, &self.best_errors, &self.floors.holdout)
    }

    /// What was found, fitted without one of its effects.
    fn without(&self, index: usize, effort: FitBudget) -> Result<(Fitted, Errors), IdentifyError> {
        let fewer = if self.best.hypothesis.effects.len() == self.declared_effects() + 1 {
            self.before.clone()
        } else {
            with_different_guides(&self.best.hypothesis.without(index), self.train, effort)?
        };
        let left = errors(&fewer.hypothesis, self.train, self.holdout)?;
        Ok((fewer, left))
    }

    /// A curve stands for what a law beside it has left: without that law it is another one. The
    /// fit with that one in place of both, if the law does not take as much of what it leaves as
    /// one that comes beside a curve must, and the laws alone leave far more: such a law was biased
    /// towards what none of them is.
    fn with_curve_in_place_of(
        &self,
        law: usize,
        curve: usize,
        alone: &Errors,
    ) -> Result<Option<(Fitted, Coordinate)>, IdentifyError> {
        let bare = self.best.hypothesis.without(law.max(curve)).without(law.min(curve));
        let left = errors(&bare, self.train, self.holdout)?;
        let effort =
            FitBudget::KEPT.gain_below(MANY_TIMES * (self.best.squares() + self.noise_squares()));
        let Some((with, over)) = self.with_curve(&bare, &left, 0.0, effort)? else {
            return Ok(None);
        };
        let found = errors(&with.hypothesis, self.train, self.holdout)?;
        let least = self
            .least_gain(&found, &self.best_errors, &self.floors.holdout)
            .max(HALF_OF_THE_REST * self.beyond_noise(&found));
        let is_bent = found.holdout() - self.best_errors.holdout() < least
            && self.beyond_noise(&found) < CURVE_ALONE * self.beyond_noise(alone);
        Ok(is_bent.then_some((with, over)))
    }

    /// Row of the evidence that says when an effect was added. Of several of a name they were added
    /// in the order in which they stand.
    pub(super) fn row_of(&self, index: usize) -> Option<usize> {
        let added = &self.best.hypothesis.effects[self.declared_effects()..=index];
        let name = self.best.hypothesis.effects[index].descriptor.name;
        let before = added.iter().filter(|part| part.descriptor.name == name).count() - 1;
        let is_chosen = |row: &usize| {
            self.evidence[*row].name == name && self.evidence[*row].outcome == Outcome::Chosen
        };
        (0..self.evidence.len()).filter(is_chosen).nth(before)
    }

    /// Notes in the evidence that an effect goes, before it does.
    pub(super) fn strike(&mut self, index: usize) {
        let name = self.best.hypothesis.effects[index].descriptor.name;
        if let Some(row) = self.row_of(index) {
            self.evidence[row].outcome = Outcome::Pruned;
            let round = self.evidence[row].round;
            let in_round =
                |one: &Evidence, outcome: Outcome| one.round == round && one.outcome == outcome;
            // Of ripples that came together others may stay.
            if !self.evidence.iter().any(|one| in_round(one, Outcome::Chosen)) {
                let equals = self.evidence.iter_mut().filter(|one| in_round(one, Outcome::Equal));
                equals.for_each(|one| one.outcome = Outcome::Beaten);
            }
        }
        if self.added_of(name) == 1 {
            self.inseparable.retain(|pair| pair.effect != name);
        }
        self.runners_up.remove(index);
    }
}
