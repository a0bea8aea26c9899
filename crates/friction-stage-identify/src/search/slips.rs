//! Ripples of balls that slip: their phase is each record's own.

use crate::error::IdentifyError;
use crate::fit::{FitBudget, fit};
use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::residual::slipping;
use friction_stage_core::plant::Side;

use super::score::errors;
use super::selection::{Evidence, Outcome};
use super::state::{MOST_OF_ONE, Search, by_chance, with_different_guides};

/// Slips of balls that are tried, rad/sqrt(m): from one that hardly shows within a record to one
/// that turns the phase within a few strokes.
const SLIPS: [f64; 5] = [0.1, 0.25, 0.35, 0.5, 1.0];

/// Part of the share that a larger one takes from which on a smaller slip does as well.
const SMALLER_SLIP: f64 = 0.97;

impl Search<'_> {
    /// Where more than noise is left: is it a ripple on the carriage whose phase each record has
    /// for itself? Such a ripple is granted more than any law, so that it comes after all of them
    /// and after the curves. Whether one was found. Without a cell it cannot be distinguished from
    /// a ripple of the motor on a machine that was homed again.
    pub(super) fn let_balls_slip(&mut self) -> Result<bool, IdentifyError> {
        if !self.has_cell() || self.is_noise(&self.best.errors) {
            return Ok(false);
        }
        // What passed for one with a fixed phase, or for a curve, goes: this would be in their
        // place.
        let goes = |part: &Part| part.descriptor.is_curve() || slipping::may_slip(part.descriptor);
        let mut with = self.found().holding_guides(true);
        for index in (self.declared_effects()..with.effects.len()).rev() {
            if goes(&with.effects[index]) {
                with = with.without(index);
            }
        }
        let others = with.effects.len();
        let mut left = errors(&with, self.train, self.holdout)?;
        let mut evidence = Vec::new();
        let mut slips = SLIPS.to_vec();
        while with.effects.len() < others + MOST_OF_ONE {
            if self.watch.stopped() {
                self.stopped = true;
                return Ok(false);
            }
            self.watch.progress(&format!("balls that slip, ripple {}", evidence.len() + 1), 0.93);
            let Some((part, slip)) = self.slipping_ripple(&with, &slips)? else { break };
            // The guides are of one type.
            slips = vec![slip];
            let fitted = fit(
                &with.with(part.clone()),
                self.train,
                self.sides_of(Side::Carriage),
                FitBudget::COMPARED,
            )?;
            let found = errors(&fitted.hypothesis, self.train, self.holdout)?;
            let before = with.own_numbers(self.train);
            let free = 1 + fitted.hypothesis.own_numbers(self.train).saturating_sub(before);
            let missing = fitted.hypothesis.missing(self.train, Sides::BOTH)?;
            let missing_before = with.missing(self.train, Sides::BOTH)?;
            let before = self.quick_score(&left);
            let fall = before.fall_to(&self.quick_score(&found));
            let gain = left.train() - found.train();
            let is_enough =
                fall >= self.criteria.fall && gain >= by_chance(&missing_before, &missing, free);
            evidence.push(Evidence {
                round: self.rounds + evidence.len(),
                name: part.descriptor.name,
                side: part.side(),
                free,
                part,
                errors: found,
                train_gain: gain,
                holdout_gain: left.holdout() - found.holdout(),
                fall,
                outcome: if is_enough { Outcome::Chosen } else { Outcome::TooSmall },
            });
            if !is_enough {
                break;
            }
            (with, left) = (fitted.hypothesis, found);
        }
        if with.effects.len() == others {
            return Ok(false);
        }
        let effort = self.on_the_way(left.train());
        let slipping = with_different_guides(&with.holding_guides(false), self.train, effort)?;
        let slipping = self.judged(slipping)?;
        if !self.needs(&slipping, &self.best) {
            return Ok(false);
        }
        for index in (self.declared_effects()..self.found().effects.len()).rev() {
            if goes(&self.found().effects[index]) {
                self.strike(index);
                self.best.fitted.hypothesis = self.found().without(index);
            }
        }
        self.rounds += evidence.len();
        self.evidence.extend(evidence);
        self.best = slipping;
        self.runners_up.resize(self.found().effects.len(), Vec::new());
        Ok(true)
    }

    /// The ripple with a phase of each record's own that takes most out of the hold-out along the
    /// way, with the smallest of `slips` that does about as well, and that; its period is that of
    /// the train record.
    fn slipping_ripple(
        &self,
        beside: &Hypothesis,
        slips: &[f64],
    ) -> Result<Option<(Part, f64)>, IdentifyError> {
        let train = beside.missing(self.train, Sides::CARRIAGE)?.carriage;
        let holdout =
            beside.in_record(self.holdout)?.missing(self.holdout, Sides::CARRIAGE)?.carriage;
        let mut best: Option<(Part, f64, f64)> = None;
        for slip in slips {
            if self.watch.stopped() {
                break;
            }
            let Some(part) = slipping::strongest(&train, self.train, *slip)? else { continue };
            let share = slipping::share_along_the_way(&holdout, self.holdout, &part);
            if best.as_ref().is_none_or(|(.., best)| SMALLER_SLIP * share > *best) {
                best = Some((part, *slip, share));
            }
        }
        Ok(best.map(|(part, slip, _)| (part, slip)))
    }
}

#[cfg(test)]
mod tests {
    use crate::hypothesis::Tolerances;
    use crate::record::measured::Measured;
    use crate::search::{Silent, Verdict, search};
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;
    use friction_stage_core::plant::EffectDescriptor;

    /// Balls that slip show the train record and the hold-out other phases: with that of the train
    /// record the hold-out becomes worse.
    #[test]
    fn balls_that_slip_are_named_though_each_record_has_its_own_phase() {
        let model = StageModel::default();
        let record = |phase, seed, moves| {
            let slip = [6.0, 1.3e-3, phase, 0.0, 0.0, 2.0];
            let passage = EffectDescriptor::find("ball_passage").unwrap().parameters_of(&slip);
            let real = StageModel { effects: vec![passage], ..StageModel::default() };
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let (train, holdout) = (record(0.3, 3, 6), record(2.3, 4, 4));
        let found = search(&model, Tolerances::default(), &train, &holdout, &Silent).unwrap();
        let effects = &found.after.fitted.hypothesis.effects;
        let (left, floors) = (found.errors_after, (found.train_floor, found.floor));
        assert_eq!(found.verdict, Verdict::Found, "{left:?} over {floors:?}, {effects:?}");
        assert!(
            effects.iter().all(|part| part.descriptor.name == "ball_passage" && part.slips()),
            "{effects:?}"
        );
        assert!(found.explained_share() > 0.9, "{}", found.explained_share());
        let (amplitude, period) = (effects[0].values[0], effects[0].values[1]);
        assert!((period / 1.3e-3 - 1.0).abs() < 0.01, "{period}");
        // Four guides of 1.5 N in any phase.
        assert!((2.0..12.0).contains(&amplitude), "{amplitude}");
    }
}
