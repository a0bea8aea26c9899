//! What a search gives: the verdict with its evidence, and what it tells while it runs.

use std::collections::BTreeSet;

use friction_stage_core::model::Coordinate;
use friction_stage_core::plant::Side;

use crate::fit::{Estimate, Fitted};
use crate::hypothesis::{Hypothesis, Part};
use crate::record::measured::Floor;

/// Floors that a recording leaves at most when nothing is hidden in it: 1.0 to 1.2 were seen.
pub(crate) const ALL_BUT_NOISE: f64 = 1.3;

/// Errors of a hypothesis: mean squares of the missing force, N^2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Train record, motor side.
    pub train_motor: f64,
    /// Train record, carriage side.
    pub train_carriage: f64,
    /// Hold-out, motor side.
    pub holdout_motor: f64,
    /// Hold-out, carriage side.
    pub holdout_carriage: f64,
    /// Share of the command that is left of it as the force of the motor, of the train record. Only
    /// with a cell is a newton known: without one a motor that gives a tenth leaves a tenth of
    /// everything.
    pub of_command: f64,
}

impl Default for Errors {
    fn default() -> Errors {
        Errors {
            train_motor: 0.0,
            train_carriage: 0.0,
            holdout_motor: 0.0,
            holdout_carriage: 0.0,
            of_command: 1.0,
        }
    }
}

impl Errors {
    /// Of both sides on the train record.
    pub fn train(&self) -> f64 {
        self.train_motor + self.train_carriage
    }

    /// Of both sides on the hold-out.
    pub fn holdout(&self) -> f64 {
        self.holdout_motor + self.holdout_carriage
    }
}

/// What became of a candidate in one round.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// Round of the search, from 0.
    pub round: usize,
    /// Name of the law.
    pub name: &'static str,
    /// Side on which it acts.
    pub side: Side,
    /// Parameters that the fit moved.
    pub free: usize,
    /// The law with its fitted values.
    pub part: Part,
    /// With this candidate.
    pub errors: Errors,
    /// Fall of the mean square with this candidate, N^2.
    pub train_gain: f64,
    /// The same on the hold-out.
    pub holdout_gain: f64,
    /// Fall of the score that it brings, on the record on which that is less.
    pub fall: f64,
    /// What became of it.
    pub outcome: Outcome,
}

/// What became of a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It is in the model from then on.
    Chosen,
    /// Less than chance, the floor or what is left to explain ask for.
    TooSmall,
    /// Another one does better.
    Beaten,
    /// Explains as much as the chosen one.
    Equal,
    /// Chosen, and once the others were there not needed any more, or no more than a simpler law.
    Pruned,
}

/// Two laws that explain the data equally.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inseparable {
    /// Effect that was added.
    pub effect: &'static str,
    /// Law that would do as well.
    pub rival: &'static str,
    /// Correlation of what the one explains of the train residual with what the other does.
    pub correlation: f64,
}

/// A law that could have stood in the place of one that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alternative {
    /// Its name.
    pub name: &'static str,
    /// What it would leave of the hold-out, N rms.
    pub holdout_rms: f64,
    /// How many times less likely it is than what was found, each record and side as one
    /// measurement of normal errors whose variance is what is left beyond the noise: the square
    /// root of how many times as much it leaves, of all records and sides multiplied.
    pub times_less_likely: f64,
}

/// How the search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The effects that were added explain what was missing.
    Found,
    /// Nothing is missing but noise.
    None,
    /// Something is missing that no law explains: a map over a coordinate stands for it, or it is
    /// left.
    Unknown,
    /// Two laws explain the data equally.
    NotSeparable,
}

/// Result of the search.
#[derive(Clone, Debug)]
pub struct Selection {
    /// How the search ended.
    pub verdict: Verdict,
    /// The declared model, fitted.
    pub before: Fitted,
    /// What was found.
    pub after: Estimate,
    /// Of the declared model.
    pub errors_before: Errors,
    /// Of the declared model within its tolerances, where stiffness and damping of the bristles are
    /// from the record because they are beyond theirs; then `before` has them, too.
    pub errors_within_tolerance: Option<Errors>,
    /// Of what was found.
    pub errors_after: Errors,
    /// Every candidate of every round.
    pub evidence: Vec<Evidence>,
    /// Coordinate of the map, where one was needed.
    pub coordinate: Option<Coordinate>,
    /// For each effect of `after`: the best other candidate of its round with its held-out rms, N.
    pub runners_up: Vec<Option<Alternative>>,
    /// Pairs that the data do not tell apart.
    pub inseparable: Vec<Inseparable>,
    /// Ripples over the position that go through few periods within the travel, with how many.
    pub unproven: Vec<(&'static str, f64)>,
    /// How far the zero of the cell is off on the hold-out beyond the law that was found for it,
    /// where that is all that is left, N rms.
    pub wander_of_zero: Option<f64>,
    /// Against which everything is judged on the hold-out: what the declared model leaves where it
    /// is all there is, with the sensors and the motion of the record.
    pub floor: Floor,
    /// The same on the train record.
    pub train_floor: Floor,
    /// Of the declared noise.
    pub declared_floor: Floor,
    /// What the train record leaves open of the force on the hold-out, N rms, where nothing is
    /// added and that is why more than noise is left.
    pub left_open: Option<f64>,
    /// Whether a law that was added has a value on a bound, beyond which it would be another one.
    pub at_bound: bool,
    /// What goes into a model: all that was found, but for laws that are no answer, in whose place
    /// stands a curve, if one was needed.
    pub usable: Hypothesis,
    /// Whether the watch stopped the search.
    pub stopped: bool,
}

impl Selection {
    /// The laws that explain a part only, where the verdict is `unknown`: no model has them.
    pub fn partial_laws(&self) -> Vec<&'static str> {
        let found = &self.after.fitted.hypothesis.effects[self.before.hypothesis.effects.len()..];
        let laws = found.iter().map(|part| part.descriptor).filter(|law| !law.is_curve());
        match self.verdict {
            Verdict::Unknown => {
                laws.map(|law| law.name).collect::<BTreeSet<_>>().into_iter().collect()
            }
            _ => Vec::new(),
        }
    }

    /// Laws that were added, those of which there are several counted once.
    pub fn added_laws(&self) -> usize {
        let effects = &self.after.fitted.hypothesis.effects;
        different_laws(&effects[self.before.hypothesis.effects.len()..])
    }

    /// Whether nothing was added, though more is left of the hold-out than where nothing is
    /// missing, and not because the train record leaves it open.
    pub fn leaves_more_than_usual(&self) -> bool {
        self.verdict == Verdict::None
            && self.left_open.is_none()
            && self.errors_after.holdout().sqrt() > ALL_BUT_NOISE * self.floor.total()
    }

    /// Share of the held-out residual above the floor of the declared noise that the added effects
    /// take out; 0 where there is nothing to explain.
    pub fn explained_share(&self) -> f64 {
        let floor = self.declared_floor.total().powi(2);
        let explainable = self.errors_before.holdout() - floor;
        if explainable <= 0.0 {
            return 0.0;
        }
        (self.errors_before.holdout() - self.errors_after.holdout()) / explainable
    }
}

/// What the search tells while it runs.
pub trait Watch: Sync {
    /// A line about what is tried now, and the share of the work that is done.
    fn progress(&self, _what: &str, _share: f64) {}
    /// Whether to stop and return what there is.
    fn stopped(&self) -> bool {
        false
    }
}

/// A watch that says nothing and never stops.
pub struct Silent;
impl Watch for Silent {}

/// Laws among effects, those of which there are several counted once; a map is none.
pub(super) fn different_laws(effects: &[Part]) -> usize {
    let laws = effects.iter().map(|part| part.descriptor).filter(|law| !law.is_curve());
    laws.map(|law| law.name).collect::<BTreeSet<_>>().len()
}
