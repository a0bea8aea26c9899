//! What a record leaves open, which pieces of motion tell most of it in the time that there is, and
//! what they are expected to tell.

use rayon::prelude::*;

use super::layout::Layout;
use super::limits::NextExperimentError;
use super::motion::{REST, Segment};
use super::proposal::{Separation, Sharpened, Shown};
use super::questions::{Questions, Subject, Sums};
use crate::hypothesis::ParameterId;
use crate::record::measured::Measured;
use crate::search::Selection;
use friction_stage_core::numerics::TWO_SIDED_95;

/// Part of the first piece's evidence per second below which a further piece is not worth its time.
const WORTH: f64 = 0.02;
/// Rise of the logarithmic evidence below which nothing has been gained at all.
const NOTHING: f64 = 1e-3;
/// Most pieces: a motion that a person can still read.
const MOST_PIECES: usize = 8;
/// Untested effects that a motion is made for, where nothing else is open.
pub(super) const MOST_UNTESTED: usize = 5;

/// A piece that keeps to the limits, with what it says.
pub(super) struct Candidate {
    pub(super) segment: Segment,
    /// s, with the way to it.
    duration: f64,
    sums: Sums,
}

/// Pieces that keep to the limits, each run with the identified model.
pub(super) fn candidates(
    layout: &Layout,
    questions: &Questions,
) -> Result<Vec<Candidate>, NextExperimentError> {
    let tried = |segment: Segment| -> Result<Option<Candidate>, NextExperimentError> {
        let mut path = layout.approach(layout.middle(), segment.start(layout.limits.stroke));
        let from = path.seconds();
        segment.follow(&mut path, layout.gentle);
        let duration = path.seconds() - from + REST;
        if duration > layout.limits.duration {
            return Ok(None);
        }
        match layout.simulate(&path, layout.middle(), from)? {
            Some(run) if !run.measured.rows.is_empty() => {
                Ok(Some(Candidate { segment, duration, sums: questions.sums(&run.measured)? }))
            }
            _ => Ok(None),
        }
    };
    layout.candidates().into_par_iter().filter_map(|segment| tried(segment).transpose()).collect()
}

/// An effect that the record would not have shown.
struct Untested {
    effect: &'static str,
    question: usize,
    /// What it would have left on the record, N^2.
    square: f64,
}

/// What a record leaves open.
pub(super) struct Agenda<'a> {
    selection: &'a Selection,
    questions: &'a Questions,
    present: Sums,
    /// Of the coordinates, on the record.
    deviations: Vec<f64>,
    /// Effects, by their index, with rivals that the record hardly tells from them.
    rivals: Vec<(usize, &'static str)>,
    /// Questions about these.
    asked: Vec<usize>,
    /// Coordinates that the record hardly knows.
    vague: Vec<usize>,
    /// Those that the record shows least first.
    untested: Vec<Untested>,
    /// Noise of the sensors, N.
    floor: f64,
}

impl<'a> Agenda<'a> {
    pub(super) fn new(
        selection: &'a Selection,
        questions: &'a Questions,
        train: &Measured,
    ) -> Result<Agenda<'a>, NextExperimentError> {
        let present = questions.sums(train)?;
        let mut rivals: Vec<(usize, &'static str)> = Vec::new();
        for question in &questions.questions {
            if let Subject::Rival { effect, rival } = question.subject
                && !rivals.contains(&(effect, rival))
            {
                rivals.push((effect, rival));
            }
        }
        rivals.retain(|(effect, rival)| {
            let difference = questions.rival(*effect, rival, &present, &present);
            let name = selection.after.fitted.hypothesis.effects[*effect].descriptor.name;
            difference < questions.needed(*effect, &present, &present, selection.floor.carriage)
                || selection
                    .inseparable
                    .iter()
                    .any(|pair| (pair.effect, pair.rival) == (name, *rival))
        });
        let asked = questions
            .of(|subject| match subject {
                Subject::Rival { effect, rival } => rivals.contains(&(effect, rival)),
                _ => false,
            })
            .collect();
        let mut untested: Vec<Untested> = Vec::new();
        for (question, one) in questions.questions.iter().enumerate() {
            if let Subject::Untested { effect } = one.subject {
                let square = questions.separable(question, &present, &present);
                untested.push(Untested { effect, question, square });
            }
        }
        untested.sort_by(|a, b| a.square.total_cmp(&b.square));
        untested.truncate(MOST_UNTESTED);
        let deviations = questions.deviations(&present);
        let vague = questions.vague(&deviations);
        let floor = selection.floor.total().max(f64::MIN_POSITIVE);
        Ok(Agenda {
            selection,
            questions,
            present,
            deviations,
            rivals,
            asked,
            vague,
            untested,
            floor,
        })
    }

    /// Pieces behind those that have to be there, the one that tells most per second first; none
    /// where none tells anything.
    pub(super) fn choose(
        &self,
        candidates: &[Candidate],
        forced: &[Segment],
        layout: &Layout,
    ) -> Vec<Segment> {
        self.greedy(candidates, forced, layout, |all| {
            self.evidence(all, &self.asked) + self.knowledge(all)
        })
    }

    /// The same for what the record would not have shown.
    pub(super) fn choose_for_untested(
        &self,
        candidates: &[Candidate],
        layout: &Layout,
    ) -> Vec<Segment> {
        let asked: Vec<usize> = self.untested.iter().map(|one| one.question).collect();
        self.greedy(candidates, &[], layout, |all| self.evidence(all, &asked))
    }

    /// Evidence for each question, as a logarithm: no one drowns the others.
    fn evidence(&self, all: &Sums, asked: &[usize]) -> f64 {
        let unit = self.present.rows as f64 * self.floor * self.floor;
        let evidence = |question: usize| {
            (self.questions.left(question, all, &self.questions.adapted(question, all)) / unit)
                .ln_1p()
        };
        asked.iter().map(|question| evidence(*question)).sum()
    }

    /// How much better the vague coordinates are known, likewise.
    fn knowledge(&self, all: &Sums) -> f64 {
        if self.vague.is_empty() {
            return 0.0;
        }
        let now = self.questions.deviations(all);
        self.vague.iter().map(|index| (self.deviations[*index] / now[*index]).ln()).sum()
    }

    fn greedy(
        &self,
        candidates: &[Candidate],
        forced: &[Segment],
        layout: &Layout,
        worth: impl Fn(&Sums) -> f64,
    ) -> Vec<Segment> {
        let mut pieces = forced.to_vec();
        let mut all = self.present.clone();
        let mut left =
            layout.limits.duration - forced.iter().map(|piece| layout.duration(piece)).sum::<f64>();
        let mut best_rate = 0.0;
        let mut value = worth(&all);
        while pieces.len() < MOST_PIECES {
            let better = candidates
                .iter()
                .filter(|one| one.duration <= left && !pieces.contains(&one.segment))
                .map(|one| (one, worth(&all.plus(&one.sums)) - value))
                .max_by(|a, b| (a.1 / a.0.duration).total_cmp(&(b.1 / b.0.duration)));
            let Some((one, gain)) = better else { break };
            let rate = gain / one.duration;
            if gain < NOTHING || rate < WORTH * best_rate {
                break;
            }
            best_rate = rate.max(best_rate);
            pieces.push(one.segment);
            left -= one.duration;
            all = all.plus(&one.sums);
            value += gain;
        }
        pieces
    }

    fn floors(&self, square: f64) -> f64 {
        square.sqrt() / self.floor
    }

    /// How well the new motion tells the open effects from their rivals.
    pub(super) fn separations(&self, new: &Sums) -> Vec<Separation> {
        let (questions, present, all) = (self.questions, &self.present, &self.present.plus(new));
        let separation = |(effect, rival): &(usize, &'static str)| {
            let after = questions.rival(*effect, rival, new, all);
            let needed = questions.needed(*effect, new, all, self.selection.floor.carriage);
            Separation {
                effect: self.selection.after.fitted.hypothesis.effects[*effect]
                    .descriptor
                    .name
                    .to_owned(),
                rival: (*rival).to_owned(),
                before: self.floors(questions.rival(*effect, rival, present, present)),
                after: self.floors(after),
                needed: self.floors(needed),
                separates: after >= needed,
            }
        };
        self.rivals.iter().map(separation).collect()
    }

    /// How much better the vague parameters are known with the new motion.
    pub(super) fn sharpened(&self, new: &Sums) -> Vec<Sharpened> {
        let deviations = self.questions.deviations(&self.present.plus(new));
        let sharpened = |index: &usize| {
            let one = &self.questions.alternatives[0].coordinates[*index];
            let (name, unit) = match one.id {
                ParameterId::Effect { effect, value } => {
                    let descriptor =
                        self.selection.after.fitted.hypothesis.effects[effect].descriptor;
                    let parameter = descriptor.parameters.get(value);
                    let name = parameter.map_or("", |parameter| parameter.name);
                    (
                        format!("{}.{name}", descriptor.name),
                        parameter.map_or("", |parameter| parameter.unit),
                    )
                }
                ParameterId::Nominal(declared) => (declared.name().to_owned(), "1"),
                ParameterId::Spread { .. } => ("difference between guides".to_owned(), "1"),
            };
            let reach = |deviation: f64| {
                Some(TWO_SIDED_95 * deviation * one.scale).filter(|reach| reach.is_finite())
            };
            let (before, after) = (reach(self.deviations[*index]), reach(deviations[*index]));
            Sharpened { name, unit: unit.to_owned(), before, after }
        };
        self.vague.iter().map(sharpened).collect()
    }

    /// What the untested effects would leave in the new motion.
    pub(super) fn shown(&self, new: &Sums) -> Vec<Shown> {
        let all = self.present.plus(new);
        let shown = |one: &Untested| Shown {
            effect: one.effect.to_owned(),
            before: self.floors(one.square),
            after: self.floors(self.questions.separable(one.question, new, &all)),
        };
        self.untested.iter().map(shown).collect()
    }
}
