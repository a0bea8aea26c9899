//! Rounds of candidates: each law proposes itself from the residual and is fitted with everything
//! that was found before.

use std::mem;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted, fit};
use crate::hypothesis::{Hypothesis, Part, Sides};
use friction_stage_core::plant::effects::{ALL, CommandStage, Multiplicity, ParameterKind, Role};
use friction_stage_core::plant::{EffectDescriptor, Side};

use super::columns::Columns;
use super::different_guides::with_different_guides;
use super::forms::{Forms, starts};
use super::gain::{HALF_OF_THE_REST, RIVAL, SIMPLER};
use super::selection::{Errors, Evidence, Inseparable, Outcome};
use super::state::{
    MOST_OF_ONE, Search, by_chance, correlation_of_taken, errors, errors_on, gain_elsewhere,
};

/// Share of what laws have taken out of the hold-out below which the next one may be what they
/// leave in other forms. Assumed.
const SMALL_REST: f64 = 0.05;
/// Part by which the periods of guides of one type differ at most. Assumed.
const OF_ONE_TYPE: f64 = 0.1;

/// A candidate of a round as it was fitted.
pub(super) struct Candidate {
    pub one: Evidence,
    pub with: Hypothesis,
    /// Fits of all its forms.
    forms: Vec<Fitted>,
}

impl Search<'_> {
    /// Adds effects one by one while any explains enough; whether there was one.
    pub(super) fn add_laws(&mut self) -> Result<bool, IdentifyError> {
        let mut added = false;
        while self.add_one()? {
            added = true;
        }
        Ok(added)
    }

    /// One round: the candidate that explains most is added, if any explains enough.
    fn add_one(&mut self) -> Result<bool, IdentifyError> {
        // As far as the fit of a candidate goes: what that brings would pass for the candidate.
        self.go_on_fitting(FitBudget::COMPARED)?;
        let mut tried = self.try_all(self.rounds)?;
        self.rounds += 1;
        if self.watch.stopped() {
            self.stopped = true;
            return Ok(false);
        }
        let search = &*self;
        tried.par_iter_mut().try_for_each(|Candidate { one, with, .. }| {
            if !search.is_enough(one)
                || !search.shows_without_cell(
                    (&search.best.hypothesis, &search.best_errors),
                    (with, &one.errors),
                )?
                || !search.is_more_than_noise(one, with)?
            {
                one.outcome = Outcome::TooSmall;
            }
            Ok::<_, IdentifyError>(())
        })?;
        let strongest = tried
            .iter()
            .map(|tried| &tried.one)
            .find(|one| one.outcome != Outcome::TooSmall)
            .map(|one| one.holdout_gain);
        let Some(strongest) = strongest else {
            let found = self.add_beside_other_forms(&mut tried)?;
            self.evidence.extend(tried.into_iter().map(|tried| tried.one));
            return Ok(found);
        };
        if self.is_small_rest(strongest) && self.choose_forms_once()? {
            // Beside these the round is another one.
            self.rounds -= 1;
            return Ok(true);
        }
        let winner = winner(&tried, strongest);
        if let Some((one, with)) = self.in_best_form(&tried[winner])? {
            tried[winner] = Candidate { one, with, forms: Vec::new() };
        }
        let winner = tried.remove(winner);
        self.name_rivals(&winner, &mut tried)?;
        self.adopt(winner, tried)?;
        Ok(true)
    }

    /// Those that the data do not tell from the winner of a round: as much of a gain with no more
    /// parameters.
    fn name_rivals(
        &mut self,
        winner: &Candidate,
        others: &mut [Candidate],
    ) -> Result<(), IdentifyError> {
        let gain = winner.one.holdout_gain;
        let missing_with = |with: &Hypothesis| with.missing(self.train, Sides::BOTH);
        for Candidate { one, with, .. } in others {
            let closeness = (one.holdout_gain / gain).min(gain / one.holdout_gain);
            if one.outcome == Outcome::Beaten && closeness >= RIVAL && one.free <= winner.one.free {
                one.outcome = Outcome::Equal;
                let correlation = correlation_of_taken(
                    &self.best.missing,
                    &missing_with(&winner.with)?,
                    &missing_with(with)?,
                );
                self.inseparable.push(Inseparable {
                    effect: winner.one.name,
                    rival: one.name,
                    correlation,
                });
            }
        }
        Ok(())
    }

    /// The winner of a round is there from now on, and the round stands in the evidence.
    fn adopt(&mut self, winner: Candidate, others: Vec<Candidate>) -> Result<(), IdentifyError> {
        let one = Evidence { outcome: Outcome::Chosen, ..winner.one };
        let chosen = winner.with.holding_guides(false);
        let added = &chosen.effects[self.best.hypothesis.effects.len()..];
        let left_by_others: Vec<(&'static str, f64)> = others
            .iter()
            .map(|other| (other.one.name, other.one.errors.holdout().sqrt()))
            .collect();
        self.runners_up.extend(added.iter().map(|_| left_by_others.clone()));
        // Ripples that came together are each a row, with what all of them do.
        let together = added.iter().filter(|part| **part != one.part);
        let together: Vec<Evidence> =
            together.map(|part| Evidence { part: part.clone(), ..one.clone() }).collect();
        let effort = self.on_the_way(&one.errors);
        self.evidence.push(one);
        self.evidence.extend(others.into_iter().map(|other| other.one).chain(together));
        self.take(with_different_guides(&chosen, self.train, effort)?)
    }

    /// Whether what a law would take out is little of what those before it have: it may be what
    /// these leave in forms that are not right.
    fn is_small_rest(&self, gain: f64) -> bool {
        gain < SMALL_REST * (self.errors_before.holdout() - self.best_errors.holdout())
    }

    /// A law that takes half of what is left out of the train record and nothing out of the
    /// hold-out may be right beside laws in forms that are not: adds the strongest of these where
    /// it is worth it once the forms are chosen again beside it. Whether it was.
    fn add_beside_other_forms(&mut self, tried: &mut [Candidate]) -> Result<bool, IdentifyError> {
        let half =
            HALF_OF_THE_REST * (self.best_errors.train() - self.floors.train.total().powi(2));
        let strong = |one: &Evidence| one.train_gain >= self.least_on_train(one).max(half);
        let strong = tried.iter_mut().filter(|tried| strong(&tried.one));
        let Some(Candidate { one, with, .. }) =
            strong.max_by(|a, b| a.one.train_gain.total_cmp(&b.one.train_gain))
        else {
            return Ok(false);
        };
        let effort = self.on_the_way(&one.errors);
        let without = (self.best.clone(), self.best_errors);
        self.take(with_different_guides(&with.holding_guides(false), self.train, effort)?)?;
        let changed = self.choose_forms_again()?;
        let with = mem::replace(&mut self.best, without.0);
        let errors = mem::replace(&mut self.best_errors, without.1);
        let Some(part) = with.hypothesis.effects.last().cloned() else { return Ok(false) };
        let found = self.evidence_of(one.round, part, one.side, 1, &with.hypothesis, errors)?;
        let best = (&self.best.hypothesis, &self.best_errors);
        if !changed
            || !self.is_enough(&found)
            || !self.shows_without_cell(best, (&with.hypothesis, &errors))?
        {
            return Ok(false);
        }
        *one = Evidence { outcome: Outcome::Chosen, ..found };
        let others =
            tried.iter().map(|tried| &tried.one).filter(|other| other.outcome != Outcome::Chosen);
        let others = others.map(|other| (other.name, other.errors.holdout().sqrt())).collect();
        self.runners_up.push(others);
        (self.best, self.best_errors) = (with, errors);
        Ok(true)
    }

    /// Every candidate beside what was found, refitted, the best on the hold-out first.
    fn try_all(&self, round: usize) -> Result<Vec<Candidate>, IdentifyError> {
        let columns = Columns::new(&self.best.hypothesis, self.train)?;
        let there = |name: &str| {
            self.best.hypothesis.effects.iter().any(|part| part.descriptor.name == name)
        };
        let may_be_added = |law: &&EffectDescriptor| {
            let added = self.added_of(law.name);
            law.proposal.is_some()
                && match law.may_repeat() {
                    true => added < MOST_OF_ONE && (added > 0 || !self.is_full()),
                    false => !there(law.name) && !self.is_full(),
                }
        };
        let candidates: Vec<&'static EffectDescriptor> =
            ALL.iter().copied().filter(may_be_added).collect();
        let done = AtomicUsize::new(0);
        let tried: Vec<Option<Candidate>> = candidates
            .par_iter()
            .map(|descriptor| {
                if self.watch.stopped() {
                    return Ok(None);
                }
                let share = done.fetch_add(1, Ordering::Relaxed) as f64 / candidates.len() as f64;
                let what = format!("round {}: {}", round + 1, descriptor.name);
                self.watch.progress(&what, ((round as f64 + share) / 3.0).min(0.85));
                self.try_one(round, descriptor, &columns)
            })
            .collect::<Result<_, IdentifyError>>()?;
        let mut tried: Vec<Candidate> = tried.into_iter().flatten().collect();
        tried.sort_by(|a, b| b.one.holdout_gain.total_cmp(&a.one.holdout_gain));
        Ok(tried)
    }

    /// A candidate in the form that is best with the guides fitted again; `None` where there is no
    /// other, or it does not explain enough.
    fn in_best_form(
        &self,
        tried: &Candidate,
    ) -> Result<Option<(Evidence, Hypothesis)>, IdentifyError> {
        if tried.forms.len() < 2 {
            return Ok(None);
        }
        let sides = self.sides_beside(&tried.one.part);
        let Some(best) = self.best_form(tried.forms.clone(), sides, Forms::Thorough) else {
            return Ok(None);
        };
        let found = self.as_fitted(tried.one.round, best)?;
        Ok(found.filter(|(one, _)| self.is_enough(one)))
    }

    /// One candidate on the side where it explains most; `None` where it proposes nothing.
    fn try_one(
        &self,
        round: usize,
        descriptor: &'static EffectDescriptor,
        columns: &Columns,
    ) -> Result<Option<Candidate>, IdentifyError> {
        // Differences between the guides stay as they are while candidates are tried: the joint
        // refit moves them.
        let held = self.best.hypothesis.holding_guides(true);
        let mut best: Option<Candidate> = None;
        for on_motor in looks(descriptor.role, self.has_cell()) {
            let Some(values) = descriptor.propose(&columns.residual(*on_motor)) else { continue };
            let part = Part { descriptor, values };
            let sides = self.sides_beside(&part);
            let starts: Vec<_> =
                starts(&part, self.train).into_iter().map(|part| held.with(part)).collect();
            let effort = FitBudget::COMPARED.gain_below(self.gain_on_train(sides));
            let forms = self.fitted_forms(&starts, sides, effort);
            let Some(fitted) = self.best_form(forms.clone(), sides, Forms::Quick) else { continue };
            let Some((mut one, mut with)) = self.as_fitted(round, fitted)? else { continue };
            if descriptor.multiplicity == Multiplicity::OnePerGuide {
                (one, with) = self.of_all_guides(one, with)?;
            }
            if best.as_ref().is_none_or(|best| one.holdout_gain >= best.one.holdout_gain) {
                best = Some(Candidate { one, with, forms });
            }
        }
        Ok(best)
    }

    /// Sides that the fit of a candidate looks at.
    pub(super) fn sides_beside(&self, part: &Part) -> Sides {
        if is_late(part.role()) { Sides::BOTH } else { self.sides_of(part.side()) }
    }

    /// A fit whose last effect is a candidate.
    fn as_fitted(
        &self,
        round: usize,
        fitted: Fitted,
    ) -> Result<Option<(Evidence, Hypothesis)>, IdentifyError> {
        let with = fitted.hypothesis;
        let Some(part) = with.effects.last().cloned() else { return Ok(None) };
        let (side, found) = (part.side(), errors(&with, self.train, self.holdout)?);
        Ok(Some((self.evidence_of(round, part, side, 1, &with, found)?, with)))
    }

    /// Evidence of a candidate that adds the last `count` effects of a hypothesis, all of the same
    /// law.
    pub(super) fn evidence_of(
        &self,
        round: usize,
        part: Part,
        side: Side,
        count: usize,
        hypothesis: &Hypothesis,
        errors: Errors,
    ) -> Result<Evidence, IdentifyError> {
        let free = hypothesis.effects.iter().rev().take(count).map(Part::free).sum();
        let missing = hypothesis.missing(self.train, Sides::BOTH)?;
        let last = hypothesis.effects.len();
        let bare =
            (last - count..last).rev().fold(hypothesis.clone(), |bare, index| bare.without(index));
        Ok(Evidence {
            round,
            name: part.descriptor.name,
            side,
            free,
            part,
            errors,
            train_gain: self.best_errors.train() - errors.train(),
            holdout_gain: self.best_errors.holdout() - errors.holdout(),
            train_gain_elsewhere: gain_elsewhere(&self.best.missing, &missing),
            holdout_gain_alone: errors_on(&bare, self.holdout)? - errors.holdout(),
            chance: by_chance(&self.best.missing, &missing, free),
            outcome: Outcome::Beaten,
        })
    }

    /// Guides whose periods differ a little beat, and the ripple of one of them that fits the train
    /// record does not fit the hold-out. Where it is so, the fewest ripples at once that do, as far
    /// as effects may be added.
    fn of_all_guides(
        &self,
        one: Evidence,
        with: Hypothesis,
    ) -> Result<(Evidence, Hypothesis), IdentifyError> {
        if one.train_gain < self.least_on_train(&one)
            || one.holdout_gain >= self.least_on_holdout(&one)
        {
            return Ok((one, with));
        }
        let (descriptor, round, side) = (one.part.descriptor, one.round, one.side);
        let mut groups: Vec<(Evidence, Hypothesis)> = Vec::new();
        let mut last = with.clone();
        for count in 2..=MOST_OF_ONE - self.added_of(descriptor.name) {
            if self.watch.stopped() {
                break;
            }
            let columns = Columns::new(&last, self.train)?;
            let Some(values) = descriptor.propose(&columns.residual(side == Side::Motor)) else {
                break;
            };
            let next = last.with(Part { descriptor, values });
            let Ok(fitted) = fit(&next, self.train, self.sides_of(side), FitBudget::COMPARED)
            else {
                break;
            };
            last = fitted.hypothesis;
            let group = &last.effects[last.effects.len() - count..];
            if !are_of_one_type(group) {
                break;
            }
            let found = errors(&last, self.train, self.holdout)?;
            let evidence = self.evidence_of(round, group[0].clone(), side, count, &last, found)?;
            if self.is_enough(&evidence) {
                groups.push((evidence, last.clone()));
            }
        }
        let most = groups.iter().map(|(group, _)| group.holdout_gain).fold(0.0, f64::max);
        let fewest = groups.into_iter().find(|(group, _)| group.holdout_gain >= SIMPLER * most);
        Ok(fewest.unwrap_or((one, with)))
    }
}

/// Whether a law makes the command late.
fn is_late(role: Role) -> bool {
    role == Role::Command(CommandStage::Lag)
}

/// Whether ripples have periods as guides of one type have them.
fn are_of_one_type(ripples: &[Part]) -> bool {
    let periods: Vec<f64> =
        ripples.iter().filter_map(|part| part.value_of_kind(ParameterKind::Period)).collect();
    let (shortest, longest) = friction_stage_core::numerics::range(&periods);
    periods.len() == ripples.len() && longest <= (1.0 + OF_ONE_TYPE) * shortest
}

/// The simplest law among those that explain about as much as the strongest, of several the one
/// that explains most.
fn winner(tried: &[Candidate], strongest: f64) -> usize {
    let explains = |index: &usize| {
        let one = &tried[*index].one;
        one.outcome != Outcome::TooSmall && one.holdout_gain >= SIMPLER * strongest
    };
    let fewest = (0..tried.len()).filter(explains).map(|index| tried[index].one.free).min();
    let simplest: Vec<usize> = (0..tried.len())
        .filter(explains)
        .filter(|index| Some(tried[*index].one.free) == fewest)
        .collect();
    let most = simplest.iter().map(|index| tried[*index].one.holdout_gain).fold(0.0, f64::max);
    // Of equals first what acts, then what only reads wrong: the answer must not depend on the last
    // digit.
    let equals =
        simplest.into_iter().filter(|index| tried[*index].one.holdout_gain >= RIVAL * most);
    let order = |index: &usize| {
        let one = &tried[*index].one;
        (one.side == Side::Sensor, ALL.iter().position(|listed| listed.name == one.name))
    };
    equals.min_by_key(order).unwrap_or(0)
}

/// Residuals that a candidate looks at: on the motor side (true) or the carriage side (false). What
/// is late by less than a cycle is there when the cell reads: the carriage alone shows it.
fn looks(role: Role, has_cell: bool) -> &'static [bool] {
    match role.side() {
        Side::Motor if is_late(role) && has_cell => &[true, false],
        Side::Motor => &[true],
        Side::Carriage => &[false],
        Side::Sensor if has_cell => &[true, false],
        Side::Sensor => &[false],
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::hypothesis::Tolerances;
    use crate::record::measured::Measured;
    use crate::search::{Silent, Verdict, search};
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    /// Candidates of a round with the free parameters and the gains of their laws.
    pub(in crate::search) fn tried(candidates: &[(&str, usize, f64)]) -> Vec<Candidate> {
        let hypothesis = Hypothesis::new(&StageModel::default(), Tolerances::default()).unwrap();
        let one = |&(name, free, holdout_gain): &(&str, usize, f64)| {
            let descriptor = EffectDescriptor::find(name).unwrap();
            let values = descriptor
                .parameters
                .iter()
                .map(|parameter| parameter.default.unwrap_or(0.0))
                .collect();
            let evidence = Evidence {
                round: 0,
                name: descriptor.name,
                side: descriptor.role.side(),
                free,
                part: Part { descriptor, values },
                errors: Errors::default(),
                train_gain: holdout_gain,
                holdout_gain,
                train_gain_elsewhere: holdout_gain,
                holdout_gain_alone: holdout_gain,
                chance: 0.0,
                outcome: Outcome::Beaten,
            };
            Candidate { one: evidence, with: hypothesis.clone(), forms: Vec::new() }
        };
        candidates.iter().map(one).collect()
    }

    /// Of two laws, the stronger first.
    #[test]
    fn the_winner_is_simple_then_strong_then_one_that_acts() {
        let cases = [
            // A simpler law wins if it explains about as much, and only then.
            ([("stiction_aging", 3, 1.0), ("payload", 1, 0.98)], "payload"),
            ([("stiction_aging", 3, 1.0), ("payload", 1, 0.96)], "stiction_aging"),
            // Of laws that are as simple the one that explains more.
            ([("payload", 1, 1.0), ("quadratic_drag", 1, 0.975)], "payload"),
            ([("quadratic_drag", 1, 1.0), ("payload", 1, 0.975)], "quadratic_drag"),
            // Of equals one that acts before one that reads wrong.
            ([("encoder_scale", 1, 1.0), ("payload", 1, 0.999)], "payload"),
            ([("payload", 1, 1.0), ("encoder_scale", 1, 0.999)], "payload"),
        ];
        for (candidates, expected) in cases {
            let tried = tried(&candidates);
            assert_eq!(tried[winner(&tried, candidates[0].2)].one.name, expected, "{candidates:?}");
        }
    }

    #[test]
    fn what_explains_too_little_never_wins() {
        let mut tried = tried(&[("cable_chain", 2, 1.0), ("payload", 1, 0.999)]);
        tried[1].one.outcome = Outcome::TooSmall;
        assert_eq!(tried[winner(&tried, 1.0)].one.name, "cable_chain");
    }

    /// Two guides whose ripples beat over 30 mm: one ripple that fits the first 20 mm does not fit
    /// the next ones, two do.
    #[test]
    fn ripples_that_beat_are_named_together() {
        let model = StageModel::default();
        let periods = [1.30e-3, 1.36e-3];
        let record = |from: f64, seed, moves| {
            let passages = periods.map(|period| {
                let phase = (TAU * from / period) % TAU;
                EffectDescriptor::find("ball_passage")
                    .unwrap()
                    .parameters_of(&[3.0, period, phase, 0.0, 0.0, 0.0])
            });
            let real = StageModel { effects: passages.to_vec(), ..StageModel::default() };
            let mut trace = recording(&real, seed, 0.0, moves);
            for positions in [&mut trace.position, &mut trace.reference_position] {
                positions.iter_mut().for_each(|position| *position += from);
            }
            Measured::new(&trace, &model, "the record").unwrap()
        };
        let found =
            search(&model, Tolerances::default(), &record(0.0, 3, 6), &record(0.02, 4, 4), &Silent)
                .unwrap();
        let effects = &found.after.fitted.hypothesis.effects;
        assert_eq!(found.verdict, Verdict::Found, "{effects:?}");
        assert!(
            effects.iter().all(|part| part.descriptor.name == "ball_passage" && !part.slips()),
            "{effects:?}"
        );
        let mut named: Vec<f64> =
            effects.iter().filter_map(|part| part.value_of("period")).collect();
        named.sort_by(f64::total_cmp);
        assert_eq!(named.len(), 2, "{effects:?}");
        for (period, expected) in named.iter().zip(periods) {
            assert!((period / expected - 1.0).abs() < 1e-3, "{named:?}");
        }
        // A row for each, of one round.
        let rows: Vec<&Evidence> =
            found.evidence.iter().filter(|one| one.outcome == Outcome::Chosen).collect();
        assert!(
            rows.len() == 2 && rows[0].round == rows[1].round && rows[0].part != rows[1].part,
            "{rows:?}"
        );
        assert_eq!(found.runners_up.len(), 2);
    }
}
