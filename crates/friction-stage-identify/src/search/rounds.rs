//! Rounds of candidates: each law proposes itself from the residual and is fitted given everything
//! that was found before; those that come close to the strongest are fitted with everything else.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted, fit, race};
use crate::hypothesis::{Hypothesis, Part, Sides};
use friction_stage_core::plant::effects::{ALL, CommandStage, Multiplicity, ParameterKind, Role};
use friction_stage_core::plant::{EffectDescriptor, Residual, Side};

use super::columns::Columns;
use super::forms::{WITHIN, best_of, starts};
use super::score::{Judged, errors, of_command};
use super::selection::{Alternative, Evidence, Outcome};
use super::state::{MOST_OF_ONE, Search, by_chance, gain_elsewhere};

/// Part by which the periods of guides of one type differ at most. Assumed.
const OF_ONE_TYPE: f64 = 0.1;
/// Part of the strongest candidate's fall from which on another one is fitted with everything else,
/// and how many are at most.
const COMES_CLOSE: f64 = 0.5;
const MOST_FITTED: usize = 3;
/// Part of the strongest candidate's gain that another one must reach with its first steps, or it
/// is not fitted further.
const SHOWS_EARLY: f64 = 0.25;
/// Part of the fall that counts as equal: which of two laws is named must not depend on the last
/// digits.
const SAME: f64 = 0.05;

/// A candidate of a round as it was fitted, with the guides held.
pub(super) struct Candidate {
    pub one: Evidence,
    pub with: Hypothesis,
    /// Fits of its forms, the best first.
    forms: Vec<Fitted>,
}

/// The first steps of a candidate.
struct Glance {
    law: &'static EffectDescriptor,
    sides: Sides,
    forms: Vec<Fitted>,
    /// Fall of the score of the train record.
    fall: f64,
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

    /// One round: the best candidate is added, if any explains enough.
    fn add_one(&mut self) -> Result<bool, IdentifyError> {
        let mut tried = self.try_all(self.rounds)?;
        self.rounds += 1;
        if self.watch.stopped() {
            self.stopped = true;
            return Ok(false);
        }
        let fitted = self.fitted_with_everything(&tried);
        for (place, judged) in &fitted {
            let fall = self.best.score.fall_to(&judged.score);
            let one = &mut tried[*place].one;
            if judged.errors.train() > one.errors.train() {
                continue;
            }
            one.errors = judged.errors;
            one.train_gain = self.best.errors.train() - judged.errors.train();
            one.holdout_gain = self.best.errors.holdout() - judged.errors.holdout();
            one.fall = fall;
            one.outcome = match self.needs(judged, &self.best) {
                true => Outcome::Beaten,
                false => Outcome::TooSmall,
            };
        }
        let enough = fitted.into_iter().filter(|(_, judged)| self.needs(judged, &self.best));
        let better = |best, other| match self.is_preferred(&other, &best, &tried) {
            true => other,
            false => best,
        };
        let best = enough.reduce(better);
        let Some((place, judged)) = best else {
            self.evidence.extend(tried.into_iter().map(|tried| tried.one));
            return Ok(false);
        };
        let winner = tried.remove(place);
        self.adopt(winner, judged, tried);
        Ok(true)
    }

    /// Whether a candidate is to be added rather than another one: the simpler one unless the other
    /// is better by enough, of as many parameters the better one, of equals what acts.
    fn is_preferred(
        &self,
        (one_place, one): &(usize, Judged),
        (other_place, other): &(usize, Judged),
        tried: &[Candidate],
    ) -> bool {
        let order = |place: usize| {
            let one = &tried[place].one;
            (
                self.is_unproven(&one.part),
                one.side == Side::Sensor,
                ALL.iter().position(|listed| listed.name == one.name),
            )
        };
        match one.free().cmp(&other.free()) {
            std::cmp::Ordering::Less => !self.needs(other, one),
            std::cmp::Ordering::Greater => self.needs(one, other),
            std::cmp::Ordering::Equal => {
                let better = other.score.both() - one.score.both();
                match better.abs() < SAME * self.criteria.fall {
                    true => order(*one_place) < order(*other_place),
                    false => better > 0.0,
                }
            }
        }
    }

    /// The strongest candidates fitted with everything that may move, each in its best form.
    fn fitted_with_everything(&self, tried: &[Candidate]) -> Vec<(usize, Judged)> {
        let is_enough = |tried: &&Candidate| tried.one.outcome != Outcome::TooSmall;
        let strongest =
            tried.iter().filter(is_enough).map(|tried| tried.one.fall).fold(0.0, f64::max);
        let mut close: Vec<usize> = (0..tried.len())
            .filter(|place| {
                is_enough(&&tried[*place]) && tried[*place].one.fall >= COMES_CLOSE * strongest
            })
            .collect();
        close.sort_by(|a, b| tried[*b].one.fall.total_cmp(&tried[*a].one.fall));
        close.truncate(MOST_FITTED);
        let left = close.iter().map(|place| tried[*place].one.errors.train());
        let effort = self.on_the_way(left.fold(f64::INFINITY, f64::min));
        let mut starts: Vec<(usize, Hypothesis)> = Vec::new();
        for place in close {
            let Candidate { with, forms, .. } = &tried[place];
            let forms = forms.iter().map(|form| &form.hypothesis);
            // What came together has no other form.
            let forms: Vec<&Hypothesis> = if with.effects.len() > self.found().effects.len() + 1 {
                vec![with]
            } else {
                forms.collect()
            };
            for form in forms {
                let free = form.holding_guides(false);
                starts.extend(free.different_guides().map(|afresh| (place, afresh)));
                if !free.guides_are_alike() || free.different_guides().is_none() {
                    starts.push((place, free));
                }
            }
        }
        let hypotheses: Vec<Hypothesis> = starts.iter().map(|(_, start)| start.clone()).collect();
        let fitted = race(&hypotheses, self.train, Sides::BOTH, effort, WITHIN);
        let places = starts.iter().map(|(place, _)| *place);
        let fitted: Vec<(usize, Fitted)> =
            places.zip(fitted).filter_map(|(place, fitted)| Some((place, fitted.ok()?))).collect();
        // Given up on the way, or fitted to less: they are no answer.
        let least = fitted.iter().map(|(_, one)| one.squares()).fold(f64::INFINITY, f64::min);
        let worth = WITHIN * (least + self.criteria.blur_of_carriage * self.noise_squares());
        fitted
            .into_par_iter()
            .filter(|(_, one)| one.squares() <= worth)
            .filter_map(|(place, fitted)| Some((place, self.judged(fitted).ok()?)))
            .collect()
    }

    /// The winner of a round is there from now on, and the round stands in the evidence.
    fn adopt(&mut self, winner: Candidate, judged: Judged, others: Vec<Candidate>) {
        let one = Evidence { outcome: Outcome::Chosen, ..winner.one };
        let added = &judged.fitted.hypothesis.effects[self.found().effects.len()..];
        let left_by_others: Vec<Alternative> = others
            .iter()
            .map(|other| Alternative {
                name: other.one.name,
                holdout_rms: other.one.errors.holdout().sqrt(),
                times_less_likely: judged
                    .score
                    .times_less_likely(&self.quick_score(&other.one.errors)),
            })
            .collect();
        self.runners_up.extend(added.iter().map(|_| left_by_others.clone()));
        // Ripples that came together are each a row, with what all of them do.
        let together: Vec<Evidence> =
            added[1..].iter().map(|part| Evidence { part: part.clone(), ..one.clone() }).collect();
        self.evidence.push(one);
        self.evidence.extend(others.into_iter().map(|other| other.one).chain(together));
        self.best = judged;
    }

    /// Every candidate beside what was found, refitted, the best on the hold-out first.
    fn try_all(&self, round: usize) -> Result<Vec<Candidate>, IdentifyError> {
        let columns = Columns::new(self.found(), self.train)?;
        let there =
            |name: &str| self.found().effects.iter().any(|part| part.descriptor.name == name);
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
        let tell = |what: &str, law: &EffectDescriptor, of: usize| {
            let share = done.fetch_add(1, Ordering::Relaxed) as f64 / of as f64;
            let line = format!("round {}: {what}{}", round + 1, law.name);
            self.watch.progress(&line, ((round as f64 + share) / 3.0).min(0.85));
        };
        let glances = candidates
            .par_iter()
            .flat_map_iter(|law| {
                looks(law.role, self.has_cell()).iter().map(move |look| (*law, *look))
            })
            .filter_map(|(law, on_motor)| {
                tell("", law, 4 * candidates.len());
                self.glance(law, &columns.residual(on_motor)).transpose()
            });
        let glances = glances.collect::<Result<Vec<Glance>, IdentifyError>>()?;
        let takes = |fall: f64| 1.0 - (-fall).exp();
        let falls = glances.iter().map(|glance| glance.fall);
        let strongest = falls.fold(self.asked_beside(self.found()), f64::max);
        let tried = glances.into_par_iter().map(|glance| {
            tell("", glance.law, 4 * candidates.len());
            match takes(glance.fall) >= SHOWS_EARLY * takes(strongest) {
                true => self.looked_at(round, glance),
                false => self.passed_over(round, glance),
            }
        });
        let tried = tried.collect::<Result<Vec<_>, IdentifyError>>()?;
        // Each on the side where it explains most.
        let mut best: Vec<Candidate> = Vec::new();
        for one in tried.into_iter().flatten() {
            match best.iter_mut().find(|other| other.one.name == one.one.name) {
                Some(other) if one.one.fall >= other.one.fall => *other = one,
                Some(_) => {}
                None => best.push(one),
            }
        }
        best.sort_by(|a, b| b.one.fall.total_cmp(&a.one.fall));
        Ok(best)
    }

    /// The first steps of a candidate in each of its forms; `None` where it proposes nothing.
    fn glance(
        &self,
        law: &'static EffectDescriptor,
        residual: &Residual,
    ) -> Result<Option<Glance>, IdentifyError> {
        if self.watch.stopped() {
            return Ok(None);
        }
        let Some(values) = law.propose(residual) else { return Ok(None) };
        let part = Part { descriptor: law, values };
        let sides = self.sides_beside(&part);
        // Differences between the guides are as they are while candidates are tried: the joint
        // refit moves them.
        let held = self.found().holding_guides(true);
        let starts: Vec<_> =
            starts(&part, self.train).into_iter().map(|part| held.with(part)).collect();
        let effort = FitBudget::GLANCE.gain_below(self.worth_on_train(sides));
        let forms = best_of(race(&starts, self.train, sides, effort, 2.0 * WITHIN), usize::MAX);
        let Some(first) = forms.first() else { return Ok(None) };
        let (motor, carriage) = first.missing.squares();
        let mut errors = self.best.errors;
        errors.of_command = of_command(&first.hypothesis, self.train)?;
        if sides.motor && self.has_cell() {
            errors.train_motor = motor;
        }
        if sides.carriage {
            errors.train_carriage = carriage;
        }
        let fall = self.best.score.train - self.quick_score(&errors).train;
        Ok(Some(Glance { law, sides, forms, fall }))
    }

    /// A candidate whose first steps have shown too little, as these leave it; `None` where they
    /// show nothing.
    fn passed_over(
        &self,
        round: usize,
        glance: Glance,
    ) -> Result<Option<Candidate>, IdentifyError> {
        if glance.fall < SAME * self.criteria.fall {
            return Ok(None);
        }
        let first = glance.forms.into_iter().next();
        let Some(Fitted { hypothesis, .. }) = first else { return Ok(None) };
        // Values that do not go together in the other record are no candidate.
        Ok(self.candidate(round, 1, hypothesis, Vec::new()).ok())
    }

    /// A candidate whose first steps have shown enough.
    fn looked_at(&self, round: usize, glance: Glance) -> Result<Option<Candidate>, IdentifyError> {
        let Glance { law, sides, forms, .. } = glance;
        let starts: Vec<Hypothesis> = forms.into_iter().map(|form| form.hypothesis).collect();
        let effort = FitBudget::COMPARED.gain_below(self.worth_on_train(sides));
        let forms = best_of(race(&starts, self.train, sides, effort, WITHIN), MOST_FITTED);
        let Some(fitted) = forms.first() else { return Ok(None) };
        let one = self.candidate(round, 1, fitted.hypothesis.clone(), forms.clone());
        let Ok(one) = one else { return Ok(None) };
        Ok(Some(match law.multiplicity {
            Multiplicity::OnePerGuide => self.of_all_guides(one)?,
            _ => one,
        }))
    }

    /// Sides that the fit of a candidate looks at.
    pub(super) fn sides_beside(&self, part: &Part) -> Sides {
        if is_late(part.role()) { Sides::BOTH } else { self.sides_of(part.side()) }
    }

    /// A candidate that adds the last `count` effects of a hypothesis, all of the same law.
    pub(super) fn candidate(
        &self,
        round: usize,
        count: usize,
        with: Hypothesis,
        forms: Vec<Fitted>,
    ) -> Result<Candidate, IdentifyError> {
        let first = with.effects.len() - count;
        let part = with.effects[first].clone();
        let free = with.effects[first..].iter().map(Part::free).sum();
        let errors = errors(&with, self.train, self.holdout)?;
        let score = self.quick_score(&errors);
        let fall = self.best.score.fall_to(&score);
        let mut one = Evidence {
            round,
            name: part.descriptor.name,
            side: part.side(),
            free,
            part,
            errors,
            train_gain: self.best.errors.train() - errors.train(),
            holdout_gain: self.best.errors.holdout() - errors.holdout(),
            fall,
            outcome: Outcome::TooSmall,
        };
        if fall >= self.asked_beside(&with) && self.shows_by_itself(&one, &with, count)? {
            one.outcome = Outcome::Beaten;
        }
        Ok(Candidate { one, with, forms })
    }

    /// Whether the gain of a candidate is more than as many parameters gain by chance, in more than
    /// one place of the train record, and remains on the hold-out with everything else unchanged.
    /// A bump that is as narrow as can be, at the place where the stage rested once, explains
    /// whatever was missing during that rest, and lets the guides move to where they fit the
    /// hold-out better.
    fn shows_by_itself(
        &self,
        one: &Evidence,
        with: &Hypothesis,
        count: usize,
    ) -> Result<bool, IdentifyError> {
        let missing = with.missing(self.train, Sides::BOTH)?;
        let before = &self.best.fitted.missing;
        let chance = by_chance(before, &missing, one.free);
        let mut bare = with.clone();
        bare.effects.truncate(with.effects.len() - count);
        let bare = self.quick_score(&errors(&bare, self.train, self.holdout)?);
        Ok(one.train_gain >= chance
            && gain_elsewhere(before, &missing) >= chance
            && bare.holdout - self.quick_score(&one.errors).holdout >= self.asked_beside(with)
            && self.shows_without_cell((self.found(), &self.best.errors), (with, &one.errors))?)
    }

    /// Guides whose periods differ a little beat, and the ripple of one of them that fits the train
    /// record does not fit the hold-out. Where it is so, the fewest ripples at once that do, as far
    /// as effects may be added.
    fn of_all_guides(&self, one: Candidate) -> Result<Candidate, IdentifyError> {
        let left = self.quick_score(&one.one.errors);
        if self.best.score.train - left.train < self.criteria.fall
            || self.best.score.holdout - left.holdout >= self.criteria.fall
        {
            return Ok(one);
        }
        let (descriptor, round, side) = (one.one.part.descriptor, one.one.round, one.one.side);
        let mut groups: Vec<Candidate> = Vec::new();
        let mut last = one.with.clone();
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
            if !are_of_one_type(&last.effects[last.effects.len() - count..]) {
                break;
            }
            let group = self.candidate(round, count, last.clone(), Vec::new())?;
            if group.one.outcome != Outcome::TooSmall {
                groups.push(group);
            }
        }
        let most = groups.iter().map(|group| group.one.fall).fold(0.0, f64::max);
        let enough = |group: &Candidate| group.one.fall >= most - self.criteria.fall;
        Ok(groups.into_iter().find(enough).unwrap_or(one))
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
    use crate::search::selection::Errors;
    use crate::search::{Criteria, Silent, Verdict, search};
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
                fall: 1.0,
                outcome: Outcome::Beaten,
            };
            Candidate { one: evidence, with: hypothesis.clone(), forms: Vec::new() }
        };
        candidates.iter().map(one).collect()
    }

    /// Of two laws with their falls of the score, either way round.
    #[test]
    fn the_winner_is_simple_then_strong_then_one_that_acts() {
        let model = StageModel::default();
        let record =
            |seed| Measured::new(&recording(&model, seed, 0.0, 2), &model, "the record").unwrap();
        let (train, holdout) = (record(3), record(4));
        let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let search = Search::new(&start, &train, &holdout, &Criteria::USUAL, &Silent).unwrap();
        let fall = search.criteria.fall;
        for (laws, falls, expected) in [
            // A simpler law wins if it explains about as much, and only then.
            (["stiction_aging", "payload"], [3.0, 3.0 - 0.8 * fall], "payload"),
            (["stiction_aging", "payload"], [3.0, 3.0 - 1.2 * fall], "stiction_aging"),
            // Of laws that are as simple the one that explains more.
            (["payload", "quadratic_drag"], [3.0, 3.0 - 0.5 * fall], "payload"),
            (["quadratic_drag", "payload"], [3.0, 3.0 - 0.5 * fall], "quadratic_drag"),
            // Of equals one that acts before one that reads wrong.
            (["encoder_scale", "payload"], [3.0, 3.0 - 1e-3 * fall], "payload"),
            (["payload", "encoder_scale"], [3.0, 3.0 - 1e-3 * fall], "payload"),
        ] {
            let candidates = tried(&laws.map(|law| (law, 1, 1.0)));
            let judged = |place: usize| {
                let mut judged = search.best.clone();
                judged.fitted.hypothesis = start.with(candidates[place].one.part.clone());
                judged.score.train -= falls[place];
                judged.score.holdout -= falls[place];
                (place, judged)
            };
            for (one, other) in [(0, 1), (1, 0)] {
                let is_one = search.is_preferred(&judged(one), &judged(other), &candidates);
                let preferred = if is_one { one } else { other };
                assert_eq!(laws[preferred], expected, "{laws:?} {falls:?}");
            }
        }
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
