//! Forms of a law and the values that its fit starts from: which of them is the right one?

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted, fit, race};
use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::record::measured::{Floor, Measured};
use friction_stage_core::plant::Side;

use super::columns::Columns;
use super::different_guides::with_different_guides;
use super::gain::{HALF_OF_THE_REST, SIMPLER};
use super::selection::{ALL_BUT_NOISE, Errors};
use super::state::{Search, errors};

/// How forms of a law are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Forms {
    /// With the guides held as they are: enough to tell whether the law wins a round.
    Quick,
    /// Those that come close to each other with the guides fitted again: held, these speak for the
    /// form that is most like what they were biased to.
    Thorough,
}

/// Share of the squares of one fit below which another one is better on the train record.
const BETTER_START: f64 = 0.99;
/// Share of the squares without a law to which one start must come, and above which another comes
/// close to it.
const WORTH_A_LOOK: f64 = 0.7;
/// The same, with the guides fitted again, for the fits of several to be brought to their ends.
const WORTH_THE_END: f64 = 0.9;

impl Search<'_> {
    /// Fits from several starts beside what was found, each as far as it may become the best one.
    pub(super) fn fitted_forms(
        &self,
        starts: &[Hypothesis],
        sides: Sides,
        effort: FitBudget,
    ) -> Vec<Fitted> {
        // A law whose values do not go together has lost; it does not end the search.
        race(starts, self.train, sides, effort, WORTH_A_LOOK.recip())
            .into_iter()
            .flatten()
            .collect()
    }

    /// The best of these fits; of about equal ones that which leaves least on the hold-out, and of
    /// these the first.
    pub(super) fn best_form(
        &self,
        mut fitted: Vec<Fitted>,
        sides: Sides,
        forms: Forms,
    ) -> Option<Fitted> {
        let (train, without) = (self.train, self.squares_left(sides));
        let least = fitted.iter().map(Fitted::squares).fold(f64::INFINITY, f64::min);
        if least < WORTH_A_LOOK * without {
            fitted.retain(|one| one.squares() * WORTH_A_LOOK < least);
        }
        let floor = fitted
            .first()
            .map_or(Floor { motor: 0.0, carriage: 0.0 }, |one| one.hypothesis.floor(train));
        let floor = if sides.motor { floor.motor } else { 0.0 }.hypot(if sides.carriage {
            floor.carriage
        } else {
            0.0
        });
        let noise = train.rows.len() as f64 * (ALL_BUT_NOISE * floor).powi(2);
        // Squares, the start as it was fitted, and the same with guides that differ afresh and go
        // on.
        let afresh = |one: &Hypothesis| one.different_guides().unwrap_or_else(|| one.clone());
        let mut judged: Vec<(f64, Fitted, Hypothesis)> = fitted
            .into_iter()
            .map(|one| (one.squares(), one.clone(), afresh(&one.hypothesis)))
            .collect();
        for effort in [FitBudget::COMPARED, FitBudget::KEPT] {
            if judged.len() < 2 || forms == Forms::Quick || least > WORTH_A_LOOK * without {
                break;
            }
            let free: Vec<Hypothesis> = judged.iter().map(|(.., free)| free.clone()).collect();
            let further = race(&free, train, sides, effort, WORTH_THE_END.recip());
            for ((squares, _, free), further) in judged.iter_mut().zip(further) {
                if let Ok(further) = further {
                    *squares = squares.min(further.squares());
                    *free = further.hypothesis;
                }
            }
            let mut order: Vec<f64> = judged.iter().map(|(squares, ..)| *squares).collect();
            order.sort_by(f64::total_cmp);
            // Where one leaves no more than noise, the end of the fits is noise too.
            if order[0] <= noise {
                break;
            }
            // The two best, if they come close to each other.
            judged
                .retain(|(squares, ..)| *squares <= order[1] && squares * WORTH_THE_END < order[0]);
        }
        let least = judged.iter().map(|(squares, ..)| *squares).fold(f64::INFINITY, f64::min);
        judged.retain(|(squares, ..)| BETTER_START * squares <= least);
        let mut best: Option<(f64, Fitted)> = None;
        for (_, one, _) in judged {
            let Ok(found) = errors(&one.hypothesis, train, self.holdout) else { continue };
            let left = found.holdout();
            if best.as_ref().is_none_or(|(least, _)| left < SIMPLER * least) {
                best = Some((left, one));
            }
        }
        best.map(|(_, one)| one)
    }

    /// Chooses forms again before a further law is added, once for so many effects. Whether that
    /// changed one.
    pub(super) fn choose_forms_once(&mut self) -> Result<bool, IdentifyError> {
        let effects = self.best.hypothesis.effects.len();
        let first = std::mem::replace(&mut self.forms_chosen, effects) != effects;
        Ok(first && self.choose_forms_again()?)
    }

    /// The form of a law was chosen while effects that came later were still in the residual: where
    /// more than noise is left, it is proposed again without them. Whether that changed one.
    pub(super) fn choose_forms_again(&mut self) -> Result<bool, IdentifyError> {
        let mut changed = false;
        for index in self.declared_effects()..self.best.hypothesis.effects.len() {
            if self.is_all_but_noise(&self.best_errors) {
                break;
            }
            let forms = self.forms_of(index)?;
            if forms.len() < 2 {
                continue;
            }
            self.watch.progress(
                &format!("forms of {}", self.best.hypothesis.effects[index].descriptor.name),
                0.85,
            );
            changed |= self.take_better_form(&forms)? || self.take_simpler_form(index, &forms)?;
        }
        Ok(changed)
    }

    /// What was found with a law in each of its forms, as it proposes itself beside the others; the
    /// guides are held.
    fn forms_of(&self, index: usize) -> Result<Vec<Hypothesis>, IdentifyError> {
        let part = &self.best.hypothesis.effects[index];
        let (descriptor, on_motor) =
            (part.descriptor, part.side() == Side::Motor && self.has_cell());
        let columns = Columns::new(&self.best.hypothesis.without(index), self.train)?;
        let Some(values) = descriptor.propose(&columns.residual(on_motor)) else {
            return Ok(Vec::new());
        };
        let held = self.best.hypothesis.holding_guides(true);
        let in_place = |part: Part| {
            let mut other = held.clone();
            other.effects[index] = part;
            other
        };
        Ok(starts(&Part { descriptor, values }, self.train).into_iter().map(in_place).collect())
    }

    /// Takes the best of these forms where it is clearly better than what was found on the train
    /// record, or as good and clearly better on the hold-out.
    fn take_better_form(&mut self, forms: &[Hypothesis]) -> Result<bool, IdentifyError> {
        let fitted = self.fitted_forms(forms, Sides::BOTH, FitBudget::COMPARED);
        let Some(found) = self.best_form(fitted, Sides::BOTH, Forms::Thorough) else {
            return Ok(false);
        };
        let worth = self.best.squares() / BETTER_START;
        let effort = self.on_the_way(&self.best_errors).gain_below(worth);
        let found = with_different_guides(&found.hypothesis, self.train, effort)?;
        let found_errors = errors(&found.hypothesis, self.train, self.holdout)?;
        let half = HALF_OF_THE_REST * self.beyond_noise(&self.best_errors);
        let least = if self.beyond_noise(&found_errors) < half {
            BETTER_START.recip()
        } else {
            BETTER_START
        };
        let is_better = found.squares() < least * self.best.squares()
            && found_errors.holdout() < self.best_errors.holdout();
        if is_better {
            (self.best, self.best_errors) = (found, found_errors);
        }
        Ok(is_better)
    }

    /// A term of a law that the train record asks for and the hold-out is worse with goes: a
    /// warm-up that follows where the zero of a cell wandered.
    fn take_simpler_form(
        &mut self,
        index: usize,
        forms: &[Hypothesis],
    ) -> Result<bool, IdentifyError> {
        let free = self.best.hypothesis.effects[index].free();
        for form in forms.iter().filter(|form| form.effects[index].free() < free) {
            // Values that do not go together are no form.
            let Ok(held) = fit(form, self.train, Sides::BOTH, FitBudget::COMPARED) else {
                continue;
            };
            if !self.does_harm_beside(&errors(&held.hypothesis, self.train, self.holdout)?) {
                continue;
            }
            let found = with_different_guides(
                &held.hypothesis,
                self.train,
                self.on_the_way(&self.best_errors),
            )?;
            let found_errors = errors(&found.hypothesis, self.train, self.holdout)?;
            if self.does_harm_beside(&found_errors) {
                (self.best, self.best_errors) = (found, found_errors);
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether what was found leaves more on the hold-out than this, by what is worth an effect.
    fn does_harm_beside(&self, other: &Errors) -> bool {
        self.best_errors.holdout() - other.holdout()
            > self.least_gain(&self.best_errors, other, &self.floors.holdout)
    }
}

/// What a fit starts from, the simplest form of the law first.
pub(super) fn starts(part: &Part, measured: &Measured) -> Vec<Part> {
    let descriptor = part.descriptor;
    let starts = (descriptor.starts)(&part.values, measured.rate.recip());
    let mut starts: Vec<Part> =
        starts.into_iter().map(|values| Part { descriptor, values }).collect();
    starts.sort_by_key(Part::free);
    starts
}

#[cfg(test)]
mod tests {
    use super::super::tests::part;
    use super::*;
    use crate::hypothesis::Tolerances;
    use crate::search::Silent;
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    /// A cell that drifts by 0.2 N/s, and by 0.8 N with a time constant of 1 s: in the train record
    /// alone, or in both.
    #[test]
    fn a_term_that_the_hold_out_is_worse_with_goes() {
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
        for (in_holdout, stays) in [(0.0, false), (0.8, true)] {
            let (train, holdout) = (record(3, 6, 0.8), record(4, 4, in_holdout));
            let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
            let mut search = Search::new(&start, &train, &holdout, &Silent).unwrap();
            search
                .take(
                    fit(&start.with(drift.clone()), &train, Sides::BOTH, FitBudget::KEPT).unwrap(),
                )
                .unwrap();
            search.choose_forms_again().unwrap();
            let found = search.best.hypothesis.effects[0].value_of("amplitude").unwrap();
            assert_eq!(found != 0.0, stays, "{in_holdout} N on the hold-out: {found} N");
        }
    }

    /// A lag of 0.15 ticks behind a delay of 0.99: fits that begin at either alone, or at parts of
    /// their sum, end a tick beside it or without a delay.
    #[test]
    fn a_lag_behind_a_delay_that_ends_before_a_tick_is_found() {
        let model = StageModel::default();
        let step = Measured::new(&recording(&model, 3, 0.0, 1), &model, "the record")
            .unwrap()
            .rate
            .recip();
        let lag = part("actuator_lag", &[("time_constant", 0.15 * step), ("delay", 0.99 * step)]);
        let real = StageModel { effects: vec![lag.parameters()], ..model.clone() };
        let record = |seed, moves| {
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let (train, holdout) = (record(3, 6), record(4, 4));
        let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let search = Search::new(&start, &train, &holdout, &Silent).unwrap();
        let columns = Columns::new(&start, &train).unwrap();
        let values = lag.descriptor.propose(&columns.residual(true)).unwrap();
        let proposed = starts(&Part { descriptor: lag.descriptor, values }, &train);
        let forms: Vec<Hypothesis> = proposed.into_iter().map(|part| start.with(part)).collect();
        let fitted = search.fitted_forms(&forms, Sides::BOTH, FitBudget::KEPT);
        let found = search.best_form(fitted, Sides::BOTH, Forms::Quick).unwrap();
        let left = found.missing.rms() / found.hypothesis.floor(&train).total();
        assert!(left < ALL_BUT_NOISE, "{left} floors, {:?}", found.hypothesis.effects);
        let delay = found.hypothesis.effects[0].value_of("delay").unwrap();
        assert!((delay / (0.99 * step) - 1.0).abs() < 0.02, "{} ticks", delay / step);
    }
}
