//! Backwards: what the others have made superfluous goes, and a law that has come to say no more than a simpler one gives way to it.

use crate::identify::IdentifyError;
use crate::identify::fit::{Effort, Fitted};
use crate::identify::hypothesis::Part;
use crate::model::Coordinate;
use crate::plant::Side;

use super::columns::Columns;
use super::curves::CURVE_ALONE;
use super::guides::with_different_guides;
use super::worth::HALF_OF_THE_REST;
use super::{Errors, Evidence, Outcome, Search, errors};

/// How many times the noise above what was found a fit without one of its effects may leave on the train record while it is worth going on, and how many times
/// that one with another curve in place of an effect: to pass they may leave half of the noise more on the hold-out, or twice as much.
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
                let (laws, left) = self.without(curve, Effort::KEPT)?;
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

    /// Of a fit that says the same with less: one that leaves far more on the train record is given up.
    fn in_place_of_best(&self) -> Effort {
        Effort::KEPT.worth_below(self.best.squares() + MANY_TIMES * self.noise_squares())
    }

    /// Whether what was found is not worth more than this.
    fn leaves_about_as_much(&self, found: &Errors) -> bool {
        found.holdout() - self.best_errors.holdout() < self.least_gain(found, &self.best_errors)
    }

    /// What was found, fitted without one of its effects.
    fn without(&self, index: usize, effort: Effort) -> Result<(Fitted, Errors), IdentifyError> {
        let fewer = if self.best.hypothesis.effects.len() == self.declared_effects() + 1 {
            self.before.clone()
        } else {
            with_different_guides(&self.best.hypothesis.without(index), self.train, effort)?
        };
        let left = errors(&fewer.hypothesis, self.train, self.holdout)?;
        Ok((fewer, left))
    }

    /// A curve stands for what a law beside it has left: without that law it is another one. The fit with that one in place of both, if the law does not take
    /// as much of what it leaves as one that comes beside a curve must, and the laws alone leave far more: such a law was bent towards what none of them is.
    fn with_curve_in_place_of(
        &self,
        law: usize,
        curve: usize,
        alone: &Errors,
    ) -> Result<Option<(Fitted, Coordinate)>, IdentifyError> {
        let bare = self.best.hypothesis.without(law.max(curve)).without(law.min(curve));
        let left = errors(&bare, self.train, self.holdout)?;
        let effort = Effort::KEPT.worth_below(MANY_TIMES * (self.best.squares() + self.noise_squares()));
        let Some((with, over)) = self.with_curve(&bare, &left, 0.0, effort)? else { return Ok(None) };
        let found = errors(&with.hypothesis, self.train, self.holdout)?;
        let least = self.least_gain(&found, &self.best_errors).max(HALF_OF_THE_REST * self.beyond_noise(&found));
        let is_bent = found.holdout() - self.best_errors.holdout() < least
            && self.beyond_noise(&found) < CURVE_ALONE * self.beyond_noise(alone);
        Ok(is_bent.then_some((with, over)))
    }

    /// A law was chosen while effects that came later were still in the residual, and some of its parameters stood for these: a spring with a far centre is
    /// a constant force. Where a law with fewer parameters that came close to it leaves about as much in its place, that one stays.
    pub(super) fn simplify(&mut self) -> Result<(), IdentifyError> {
        for index in self.declared_effects()..self.best.hypothesis.effects.len() {
            let Some(chosen) = self.row_of(index).map(|row| self.evidence[row].clone()) else { continue };
            let bare = self.best.hypothesis.without(index);
            let there = |name: &str| bare.effects.iter().any(|part| part.descriptor.name == name);
            let is_simpler = |one: &Evidence| {
                one.round == chosen.round
                    && one.free < chosen.free
                    && one.holdout_gain >= HALF_OF_THE_REST * chosen.holdout_gain
                    && !there(one.name)
            };
            let simpler: Vec<Evidence> = self.evidence.iter().filter(|one| is_simpler(one)).cloned().collect();
            if simpler.is_empty() {
                continue;
            }
            self.watch.progress("simpler laws", 0.96);
            let columns = Columns::new(&bare, self.train)?;
            for one in simpler {
                let descriptor = one.part.descriptor;
                let on_motor = one.side == Side::Motor && self.has_cell();
                let Some(values) = (descriptor.propose)(&columns.residual(on_motor)) else { continue };
                let mut other = self.best.hypothesis.clone();
                other.effects[index] = Part { descriptor, values };
                // Values that do not go together are no law in place of another.
                let Ok(fitted) = with_different_guides(&other, self.train, self.in_place_of_best()) else { continue };
                let found = errors(&fitted.hypothesis, self.train, self.holdout)?;
                if self.leaves_about_as_much(&found) {
                    let mut others = self.runners_up[index].clone();
                    others.retain(|(name, _)| *name != one.name);
                    self.strike(index);
                    self.runners_up.insert(index, others);
                    let same = |row: &&mut Evidence| row.round == one.round && row.name == one.name;
                    self.evidence.iter_mut().filter(same).for_each(|row| row.outcome = Outcome::Chosen);
                    (self.best, self.best_errors) = (fitted, found);
                    break;
                }
            }
        }
        Ok(())
    }

    /// Row of the evidence that says when an effect was added. Of several of a name they were added in the order in which they stand.
    fn row_of(&self, index: usize) -> Option<usize> {
        let added = &self.best.hypothesis.effects[self.declared_effects()..=index];
        let name = self.best.hypothesis.effects[index].descriptor.name;
        let before = added.iter().filter(|part| part.descriptor.name == name).count() - 1;
        let is_chosen =
            |row: &usize| self.evidence[*row].name == name && self.evidence[*row].outcome == Outcome::Chosen;
        (0..self.evidence.len()).filter(is_chosen).nth(before)
    }

    /// Notes in the evidence that an effect goes, before it does.
    pub(super) fn strike(&mut self, index: usize) {
        let name = self.best.hypothesis.effects[index].descriptor.name;
        if let Some(row) = self.row_of(index) {
            self.evidence[row].outcome = Outcome::Pruned;
            let round = self.evidence[row].round;
            let in_round = |one: &Evidence, outcome: Outcome| one.round == round && one.outcome == outcome;
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
