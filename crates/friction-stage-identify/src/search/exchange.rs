//! Exchanges: with everything that was found, is each law needed, in this form, and no other one?

use std::collections::BTreeSet;
use std::mem;

use rayon::prelude::*;

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted, race};
use crate::hypothesis::{Hypothesis, Part, Sides};
use friction_stage_core::plant::Side;

use super::columns::Columns;
use super::forms::{WITHIN, different, simpler, starts};
use super::score::Judged;
use super::selection::{Alternative, Errors, Evidence, Inseparable, Outcome};
use super::state::{Search, correlation_of_taken, with_different_guides};

/// Part of the gain of a law that another one must have had in its round to be tried in its place.
const HALF_AS_GOOD: f64 = 0.5;
/// Part of the fall that counts by which one form of a law must be better than another.
const BETTER_FORM: f64 = 0.1;

/// What stands in the place of a law.
#[derive(Clone, Copy, PartialEq, Eq)]
enum InPlace {
    Nothing,
    /// The same law without one of its terms.
    LessOfIt,
    OtherForm,
    /// The law of this row of the evidence.
    Law(usize),
}

impl Search<'_> {
    /// A law was added while effects that came later were still in the residual, and its form, its
    /// values, or those of the others, stood for these: a spring with a far centre is a constant
    /// force, a gain of the cell together with one of the motor is an encoder of another scale.
    /// Each law is left out, put in its other forms, and exchanged for those that came close to it,
    /// with everything else fitted again. Returns whether anything changed.
    pub(super) fn exchange(&mut self) -> Result<bool, IdentifyError> {
        let mut changed = false;
        let mut index = self.declared_effects();
        let known = mem::take(&mut self.inseparable);
        while index < self.found().effects.len() && !self.watch.stopped() {
            match self.exchange_one(index, &known)? {
                Some(InPlace::Nothing) => changed = true,
                Some(_) => (changed, index) = (true, index + 1),
                None => index += 1,
            }
        }
        if changed {
            self.go_on_fitting(FitBudget::KEPT)?;
        }
        Ok(changed)
    }

    /// A law that explains enough of the train record, and not of the hold-out, may be right where
    /// the forms of the other laws are wrong: the strongest of these is added, and everything else
    /// is exchanged given it. Returns whether the result is better.
    pub(super) fn add_and_exchange(&mut self) -> Result<bool, IdentifyError> {
        let last = self.rounds.checked_sub(1);
        let strong = |one: &&(usize, &Evidence)| {
            let fall = self.best.score.train - self.quick_score(&one.1.errors).train;
            Some(one.1.round) == last && fall >= self.asked_beside(self.found())
        };
        let rows: Vec<(usize, &Evidence)> = self.evidence.iter().enumerate().collect();
        let strongest = rows.iter().filter(strong);
        let strongest =
            strongest.max_by(|a, b| a.1.train_gain.total_cmp(&b.1.train_gain)).map(|one| one.0);
        let first = self.declared_effects();
        let (Some(row), false) = (
            strongest,
            self.is_noise(&self.best.errors)
                || self.is_full()
                || self.found().effects.len() == first,
        ) else {
            return Ok(false);
        };
        let without = (
            self.best.clone(),
            self.evidence.clone(),
            self.runners_up.clone(),
            self.inseparable.clone(),
        );
        let with = self.found().with(self.evidence[row].part.clone()).holding_guides(false);
        let fitted = with_different_guides(&with, self.train, FitBudget::KEPT);
        let Ok(beside) = fitted.and_then(|fitted| self.judged(fitted)) else { return Ok(false) };
        self.best = beside;
        self.evidence[row].outcome = Outcome::Chosen;
        self.runners_up.push(Vec::new());
        self.exchange()?;
        let found = self.needs(&self.best, &without.0);
        if !found {
            (self.best, self.evidence, self.runners_up, self.inseparable) = without;
        }
        Ok(found)
    }

    fn exchange_one(
        &mut self,
        index: usize,
        known: &[Inseparable],
    ) -> Result<Option<InPlace>, IdentifyError> {
        let label = self.found().label(index);
        self.watch.progress(&format!("alternatives to {label}"), 0.95);
        let row = self.row_of(index);
        let judged = self.in_place_of(index, row, known)?;
        if let Some((what, one)) = self.preferred(&judged) {
            match what {
                InPlace::Nothing => {
                    self.strike(index);
                    self.best = one;
                }
                InPlace::LessOfIt | InPlace::OtherForm => self.best = one,
                InPlace::Law(row) => self.give_way(index, row, one),
            }
            return Ok(Some(what));
        }
        self.runners_up[index] = self.runner_up_of(index, &judged);
        let bare = self.found().without(index);
        for (what, one) in &judged {
            let InPlace::Law(row) = what else { continue };
            let (effect, rival) =
                (self.found().effects[index].descriptor.name, self.evidence[*row].name);
            let alike = one.free() == self.best.free()
                && !self.needs(one, &self.best)
                && !self.needs(&self.best, one);
            // Another form of it may have been named already.
            let is_known = self.inseparable.iter().any(|p| (p.effect, p.rival) == (effect, rival));
            if !alike || is_known {
                continue;
            }
            let without = bare.missing(self.train, Sides::BOTH)?;
            let correlation =
                correlation_of_taken(&without, &self.best.fitted.missing, &one.fitted.missing);
            self.evidence[*row].outcome = Outcome::Equal;
            self.inseparable.push(Inseparable { effect, rival, correlation });
        }
        Ok(None)
    }

    /// The one of these that is to stand in the place of what was found: the simplest of which no
    /// other is better by enough. `None` where that is what was found.
    fn preferred(&self, others: &[(InPlace, Judged)]) -> Option<(InPlace, Judged)> {
        let mut order: Vec<(Option<InPlace>, &Judged)> =
            others.iter().map(|(what, one)| (Some(*what), one)).collect();
        order.push((None, &self.best));
        // Of as many parameters what was found comes first, and another law is better by enough or
        // not at all; another form is the same law.
        let is_same_law =
            |what| matches!(what, None | Some(InPlace::OtherForm | InPlace::LessOfIt));
        order.sort_by(|(what, one), (other, two)| {
            (one.free(), !is_same_law(*what)).cmp(&(two.free(), !is_same_law(*other))).then_with(
                || {
                    let margin = |what: &Option<InPlace>| match what {
                        None => BETTER_FORM * self.criteria.fall,
                        _ => 0.0,
                    };
                    let left = |what, one: &Judged| one.score.both() - margin(what);
                    left(what, one).total_cmp(&left(other, two))
                },
            )
        });
        let best = order.into_iter().reduce(|best, other| {
            let same =
                best.1.free() == other.1.free() && is_same_law(best.0) && is_same_law(other.0);
            if !same && self.needs(other.1, best.1) { other } else { best }
        });
        best.and_then(|(what, one)| Some((what?, one.clone())))
    }

    /// What could stand in the place of an effect, fitted.
    fn in_place_of(
        &self,
        index: usize,
        row: Option<usize>,
        known: &[Inseparable],
    ) -> Result<Vec<(InPlace, Judged)>, IdentifyError> {
        let bare = self.found().without(index);
        let mut others: Vec<(InPlace, Hypothesis)> = Vec::new();
        let mut judged: Vec<(InPlace, Judged)> = Vec::new();
        match bare.effects.len() == self.declared_effects() {
            true => judged.push((InPlace::Nothing, self.before.clone())),
            false => others.push((InPlace::Nothing, bare.clone())),
        }
        let part = &self.found().effects[index];
        if !part.descriptor.is_curve() && !part.slips() {
            let columns = Columns::new(&bare, self.train)?;
            let on_motor = part.side() == Side::Motor && self.has_cell();
            let in_place = |part: Part| {
                let mut other = self.found().clone();
                other.effects[index] = part;
                other
            };
            let terms = simpler(part);
            others.extend(terms.into_iter().map(|term| (InPlace::LessOfIt, in_place(term))));
            if self.room() > BETTER_FORM * self.criteria.fall
                && let Some(values) = part.descriptor.propose(&columns.residual(on_motor))
            {
                let forms = starts(&Part { descriptor: part.descriptor, values }, self.train);
                others.extend(forms.into_iter().map(|form| (InPlace::OtherForm, in_place(form))));
            }
            if let Some(chosen) = row.map(|row| &self.evidence[row]) {
                for row in 0..self.evidence.len() {
                    let one = &self.evidence[row];
                    if !self.may_stand_for(chosen, one, &bare, known) {
                        continue;
                    }
                    let descriptor = one.part.descriptor;
                    let on_motor = one.side == Side::Motor && self.has_cell();
                    // Given the laws that were added later it may propose nothing.
                    let values = descriptor
                        .propose(&columns.residual(on_motor))
                        .unwrap_or_else(|| one.part.values.clone());
                    let part = Part { descriptor, values };
                    let forms = starts(&part, self.train).into_iter().chain(simpler(&part));
                    others.extend(forms.map(|form| (InPlace::Law(row), in_place(form))));
                }
            }
        }
        judged.extend(self.raced(others));
        // A curve depends on the laws that were found: without one of them it is drawn again.
        if let Some(curve) = self.curve().filter(|curve| *curve != index) {
            let without = bare.without(curve - usize::from(curve > index));
            let drawn = self.with_settled_curve(&without)?;
            judged.extend(drawn.map(|drawn| (InPlace::Nothing, drawn)));
        }
        Ok(judged)
    }

    /// Fits of hypotheses in place of what was found, each with guides that differ as they do and
    /// afresh; forms of one law side by side. They are given up where they leave far more on the
    /// train record, except that a term may be there that only the train record asks for.
    fn raced(&self, others: Vec<(InPlace, Hypothesis)>) -> Vec<(InPlace, Judged)> {
        let of_one_law = |(one, _): &(InPlace, Hypothesis), (other, _): &(InPlace, Hypothesis)| {
            one == other && matches!(one, InPlace::OtherForm | InPlace::Law(_))
        };
        let fitted = others.par_chunk_by(of_one_law).flat_map_iter(|forms| {
            let what = forms[0].0;
            let forms = forms.iter().map(|(_, form)| form.holding_guides(false)).collect();
            self.forms_in_place(what, forms).into_iter().map(move |one| (what, one))
        });
        fitted
            .collect::<Vec<_>>()
            .into_iter()
            .filter_map(|(what, fitted)| Some((what, self.judged(fitted).ok()?)))
            .collect()
    }

    /// Fits of the forms of one law in place of what was found, the best first: a few steps of
    /// each, then those that may stand there as far as it matters between rounds. What is chosen is
    /// brought to its end later.
    fn forms_in_place(&self, what: InPlace, forms: Vec<Hypothesis>) -> Vec<Fitted> {
        let worth = match what {
            InPlace::LessOfIt => f64::INFINITY,
            _ => self.worth_in_place(),
        };
        let quick = FitBudget::COMPARED.gain_below(2.0 * worth);
        let compared = different(race(&forms, self.train, Sides::BOTH, quick, 2.0 * WITHIN));
        let least = compared.first().map_or(f64::INFINITY, Fitted::squares);
        let begins: Vec<Hypothesis> = compared
            .iter()
            .filter(|one| one.squares() <= 2.0 * worth)
            .flat_map(|one| [Some(one.hypothesis.clone()), one.hypothesis.different_guides()])
            .flatten()
            .collect();
        let effort = self.on_the_way(least / self.train.rows.len() as f64).gain_below(worth);
        let further = race(&begins, self.train, Sides::BOTH, effort, WITHIN);
        // A fit begins inside of all bounds, and may end elsewhere than where it was begun.
        let mut fitted =
            different(further.into_iter().chain(compared.into_iter().map(Ok)).collect());
        // Of other forms of the law itself only those that come close.
        fitted.retain(|one| one.squares() <= worth || what != InPlace::OtherForm);
        fitted
    }

    /// Squares on the train record up to which a fit may stand in the place of the best one, N^2.
    fn worth_in_place(&self) -> f64 {
        let blur = self.criteria.blur_of_carriage * self.noise_squares();
        WITHIN * (self.best.fitted.squares() + blur)
    }

    /// Of a fit that may replace what was found: one that leaves far more is given up.
    pub(super) fn in_place_of_best(&self) -> FitBudget {
        FitBudget::KEPT.gain_below(self.worth_in_place())
    }

    /// Whether what was found is better than other guides under the declared effects that leave
    /// this.
    pub(super) fn falls_to_best_from(&self, other: &Errors) -> bool {
        let asked = self.asked(self.found(), &self.before.fitted.hypothesis, other);
        self.quick_score(other).fall_to(&self.best.score) >= asked
    }

    /// Laws that were fitted in the place of one, each once, the best first, then those of its
    /// round.
    fn runner_up_of(&self, index: usize, judged: &[(InPlace, Judged)]) -> Vec<Alternative> {
        let mut laws: Vec<Alternative> = judged
            .iter()
            .filter_map(|(what, one)| match what {
                InPlace::Law(row) => Some(Alternative {
                    name: self.evidence[*row].name,
                    holdout_rms: one.errors.holdout().sqrt(),
                    times_less_likely: self.best.score.times_less_likely(&one.score),
                }),
                _ => None,
            })
            .collect();
        laws.sort_by(|a, b| a.times_less_likely.total_cmp(&b.times_less_likely));
        laws.extend(self.runners_up[index].iter().copied());
        let mut names = BTreeSet::new();
        laws.retain(|one| names.insert(one.name));
        laws
    }

    /// Whether a law that was beaten in the round of a chosen one is tried in its place: it had
    /// half of its gain, or is a rival of another law, and is not in the model already. What cannot
    /// be distinguished from one of the laws may not be distinguishable from another one either.
    fn may_stand_for(
        &self,
        chosen: &Evidence,
        one: &Evidence,
        bare: &Hypothesis,
        known: &[Inseparable],
    ) -> bool {
        let was_beaten = one.round == chosen.round
            && one.outcome != Outcome::Chosen
            && one.outcome != Outcome::Pruned;
        let comes_close = one.holdout_gain >= HALF_AS_GOOD * chosen.holdout_gain;
        let is_rival = self
            .inseparable
            .iter()
            .chain(known)
            .any(|pair| pair.rival == one.name && pair.effect != chosen.name);
        was_beaten
            && (comes_close || is_rival)
            && !bare.effects.iter().any(|part| part.descriptor.name == one.name)
    }

    /// An effect gives way to the law of a row of the evidence.
    fn give_way(&mut self, index: usize, row: usize, judged: Judged) {
        let name = self.evidence[row].name;
        let mut others = self.runners_up[index].clone();
        others.retain(|other| other.name != name);
        self.strike(index);
        self.runners_up.insert(index, others);
        self.evidence[row].outcome = Outcome::Chosen;
        self.best = judged;
    }

    /// Row of the evidence that says when an effect was added. Of several of a name they were added
    /// in the order in which they stand.
    pub(super) fn row_of(&self, index: usize) -> Option<usize> {
        let added = &self.found().effects[self.declared_effects()..=index];
        let name = self.found().effects[index].descriptor.name;
        let before = added.iter().filter(|part| part.descriptor.name == name).count() - 1;
        let is_chosen = |row: &usize| {
            self.evidence[*row].name == name && self.evidence[*row].outcome == Outcome::Chosen
        };
        (0..self.evidence.len()).filter(is_chosen).nth(before)
    }

    /// Notes in the evidence that an effect is about to be removed.
    pub(super) fn strike(&mut self, index: usize) {
        let name = self.found().effects[index].descriptor.name;
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

#[cfg(test)]
mod tests {
    use super::super::rounds::tests::tried;
    use super::super::tests::part;
    use super::*;
    use crate::fit::fit;
    use crate::hypothesis::Tolerances;
    use crate::record::measured::Measured;
    use crate::search::{Criteria, Silent};
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    fn record_of(real: &StageModel, seed: u64, moves: u64) -> Measured {
        let declared = StageModel::default();
        Measured::new(&recording(real, seed, 0.0, moves), &declared, "the record").unwrap()
    }

    /// A search that has found these laws.
    fn with_laws<'a>(laws: &[Part], train: &'a Measured, holdout: &'a Measured) -> Search<'a> {
        let start = Hypothesis::new(&StageModel::default(), Tolerances::default()).unwrap();
        let mut search = Search::new(&start, train, holdout, &Criteria::USUAL, &Silent).unwrap();
        let with = laws.iter().fold(start, |with, part| with.with(part.clone()));
        let fitted = fit(&with, train, Sides::BOTH, FitBudget::KEPT).unwrap();
        search.best = search.judged(fitted).unwrap();
        search.runners_up = vec![Vec::new(); laws.len()];
        search
    }

    /// A cell that drifts by 0.2 N/s, and by 0.8 N with a time constant of 1 s: in the train record
    /// alone, or in both.
    #[test]
    fn a_term_that_the_hold_out_is_worse_with_is_removed() {
        let model = StageModel::default();
        let record = |seed, moves, warm_up: f64| {
            let mut trace = recording(&model, seed, 0.0, moves);
            for (time, reading) in trace.time.iter().zip(&mut trace.force_cell) {
                *reading += 0.2 * time - warm_up * (-time).exp_m1();
            }
            Measured::new(&trace, &model, "the record").unwrap()
        };
        let drift =
            part("force_cell_drift", &[("rate", 0.2), ("amplitude", 0.8), ("time_constant", 1.0)]);
        for (in_holdout, expected) in [(0.0, false), (0.8, true)] {
            let (train, holdout) = (record(3, 6, 0.8), record(4, 4, in_holdout));
            let mut search = with_laws(std::slice::from_ref(&drift), &train, &holdout);
            search.exchange().unwrap();
            let found = search.found().effects[0].value_of("amplitude").unwrap();
            assert_eq!(found != 0.0, expected, "{in_holdout} N on the hold-out: {found} N");
        }
    }

    /// A spring whose centre is far off is no better than a constant force; one whose centre is
    /// within the travel is.
    #[test]
    fn a_law_that_says_no_more_than_a_simpler_one_gives_way_to_it() {
        let model = StageModel::default();
        for (hidden, expected) in [
            (part("constant_force", &[("amplitude", 2.0)]), "constant_force"),
            (part("cable_chain", &[("stiffness", 200.0), ("center", 0.0)]), "cable_chain"),
        ] {
            let real = StageModel { effects: vec![hidden.parameters()], ..model.clone() };
            let (train, holdout) = (record_of(&real, 3, 6), record_of(&real, 4, 4));
            let spring = match expected {
                "cable_chain" => hidden,
                _ => part("cable_chain", &[("stiffness", 0.2), ("center", -10.0)]),
            };
            let mut search = with_laws(&[spring], &train, &holdout);
            let mut rows = tried(&[("cable_chain", 2, 1.0), ("constant_force", 1, 0.9)]);
            rows[0].one.outcome = Outcome::Chosen;
            search.evidence = rows.into_iter().map(|tried| tried.one).collect();
            let other =
                Alternative { name: "constant_force", holdout_rms: 0.1, times_less_likely: 9.0 };
            search.runners_up = vec![vec![other]];
            search.exchange().unwrap();
            let effects = &search.found().effects;
            assert_eq!(
                effects.iter().map(|part| part.descriptor.name).collect::<Vec<_>>(),
                [expected],
                "{effects:?}"
            );
            let chosen = search.evidence.iter().find(|one| one.outcome == Outcome::Chosen).unwrap();
            assert_eq!((chosen.name, search.runners_up.len()), (expected, 1));
        }
    }

    /// A motor that gives more and an encoder of another scale are a cell and a motor of other
    /// gains. Each alone is what it is.
    #[test]
    fn a_law_that_says_the_same_beside_all_that_was_found_is_a_rival() {
        let model = StageModel::default();
        let gain = part("motor_gain", &[("fraction", 0.019)]);
        let scale = part("encoder_scale", &[("fraction", -0.035)]);
        let of_cell = part("force_cell_gain", &[("fraction", 0.019)]);
        let known = Inseparable { effect: "motor_gain", rival: "encoder_scale", correlation: 1.0 };
        let both = (vec![gain.clone(), scale], vec![of_cell.clone(), gain]);
        for ((hidden, found), of_scale, known, expected) in [
            (both.clone(), 0.6, None, true),
            (both.clone(), 0.1, None, false),
            // What is a rival of the one may be one of the other.
            (both, 0.1, Some(known), true),
            ((vec![of_cell.clone()], vec![of_cell]), 0.6, None, false),
        ] {
            let real = StageModel {
                effects: hidden.iter().map(Part::parameters).collect(),
                ..model.clone()
            };
            let (train, holdout) = (record_of(&real, 3, 6), record_of(&real, 4, 4));
            let mut search = with_laws(&found, &train, &holdout);
            let mut rows = tried(&[("force_cell_gain", 1, 1.0), ("encoder_scale", 1, of_scale)]);
            rows[0].one.outcome = Outcome::Chosen;
            search.evidence = rows.into_iter().map(|tried| tried.one).collect();
            search.inseparable.extend(known);
            search.exchange().unwrap();
            let is_rival = |pair: &Inseparable| {
                (pair.effect, pair.rival) == ("force_cell_gain", "encoder_scale")
            };
            assert_eq!(
                search.inseparable.iter().any(is_rival),
                expected,
                "{:?}",
                search.inseparable
            );
            assert!(
                search.inseparable.iter().all(|pair| pair.correlation > 0.9),
                "{:?}",
                search.inseparable
            );
        }
    }
}
