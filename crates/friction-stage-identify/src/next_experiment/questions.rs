//! What a record leaves to ask, and how well a motion answers: how far the forces of two laws
//! differ that may both adapt themselves.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::limits::NextExperimentError;
use crate::fit::objective::{derivatives, stacked};
use crate::fit::{FitBudget, fit};
use crate::hypothesis::{FreeParameter, Hypothesis, ParameterId, Part, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use crate::search::{Criteria, Evidence, Outcome, Selection};
use friction_stage_core::model::ModelError;
use friction_stage_core::numerics::TWO_SIDED_95;
use friction_stage_core::numerics::correlation::correlation_length;
use friction_stage_core::plant::effects::ALL;

/// Part of a law's gain by which the gain of its rival must be smaller for a search to separate the
/// two: no law is exact. Assumed.
const OF_A_LAW: f64 = 0.03;
/// Weight of what is declared in the squares of a motion: what counts is what the motion itself
/// would show.
const DATA_ALONE: f64 = 0.0;
/// Half width of the 95 % interval of an effect's parameter, as a part of its value, above which it
/// counts as open.
pub(super) const VAGUE: f64 = 0.2;
/// Standard deviation of a declared parameter, in its tolerance, above which the data have
/// determined hardly anything about it.
pub(super) const UNTOLD: f64 = 0.5;

/// What a piece of motion does to the alternatives: sums of squares over its rows, N^2.
#[derive(Clone, Debug)]
pub(super) struct Sums {
    /// J'J of each alternative.
    pub(super) gram: Vec<DMatrix<f64>>,
    /// J'd and d'd of each question.
    pub(super) gradient: Vec<DVector<f64>>,
    pub(super) square: Vec<f64>,
    pub(super) rows: usize,
}

impl Sums {
    pub(super) fn plus(&self, other: &Sums) -> Sums {
        Sums {
            gram: self.gram.iter().zip(&other.gram).map(|(a, b)| a + b).collect(),
            gradient: self.gradient.iter().zip(&other.gradient).map(|(a, b)| a + b).collect(),
            square: self.square.iter().zip(&other.square).map(|(a, b)| a + b).collect(),
            rows: self.rows + other.rows,
        }
    }
}

/// A hypothesis that adapts itself.
pub(super) struct Alternative {
    pub(super) hypothesis: Hypothesis,
    pub(super) coordinates: Vec<FreeParameter>,
}

/// Whether `truth` could be mistaken for an alternative.
pub(super) struct Question {
    pub(super) subject: Subject,
    pub(super) truth: Hypothesis,
    pub(super) alternative: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Subject {
    /// Effect (index in the model) against a rival, either way round.
    Rival { effect: usize, rival: &'static str },
    /// The model against itself without an effect: what there is to explain.
    Without { effect: usize },
    /// The model with one more effect against the model.
    Untested { effect: &'static str },
}

/// Everything that the present record leaves to ask.
pub(super) struct Questions {
    /// The first one is the identified model.
    pub(super) alternatives: Vec<Alternative>,
    pub(super) questions: Vec<Question>,
    /// Variance of a row's noise, widened for its correlation, N^2.
    pub(super) variance: f64,
    pub(super) sides: Sides,
}

impl Questions {
    pub(super) fn new(
        selection: &Selection,
        train: &Measured,
    ) -> Result<Questions, NextExperimentError> {
        let after = &selection.after.fitted.hypothesis;
        let sides = Sides { motor: train.cell.is_some(), carriage: true };
        let has_cell = train.cell.is_some();
        let alternative = |hypothesis: Hypothesis| {
            let coordinates = hypothesis.coordinates(sides, has_cell);
            Alternative { hypothesis, coordinates }
        };
        let mut alternatives = vec![alternative(after.clone())];
        let mut questions = Vec::new();
        let refitted: Vec<(usize, &'static str, Hypothesis)> = rivals(selection)
            .into_par_iter()
            .filter_map(|(effect, part)| {
                let name = part.descriptor.name;
                // A rival whose values do not go together with the rest is none.
                let fitted =
                    fit(&after.without(effect).with(part), train, sides, FitBudget::COMPARED)
                        .ok()?;
                Some((effect, name, fitted.hypothesis))
            })
            .collect();
        let mut asked = Vec::new();
        for (effect, rival, hypothesis) in refitted {
            let subject = Subject::Rival { effect, rival };
            questions.push(Question {
                subject,
                truth: after.clone(),
                alternative: alternatives.len(),
            });
            alternatives.push(alternative(hypothesis.clone()));
            questions.push(Question { subject, truth: hypothesis, alternative: 0 });
            if !asked.contains(&effect) {
                asked.push(effect);
                let subject = Subject::Without { effect };
                questions.push(Question {
                    subject,
                    truth: after.clone(),
                    alternative: alternatives.len(),
                });
                alternatives.push(alternative(after.without(effect)));
            }
        }
        for descriptor in ALL.iter().copied().filter(|law| !law.is_curve()) {
            let there = after.effects.iter().any(|part| part.descriptor.name == descriptor.name);
            if there && !descriptor.may_repeat() {
                continue;
            }
            let part = Part { descriptor, values: descriptor.typical.to_vec() };
            let subject = Subject::Untested { effect: descriptor.name };
            questions.push(Question { subject, truth: after.with(part), alternative: 0 });
        }
        let missing = &selection.after.fitted.missing;
        let (motor, carriage) = missing.squares();
        let rows = missing.motor.len() + missing.carriage.len();
        let mean = (motor + carriage) * missing.carriage.len().max(1) as f64 / rows.max(1) as f64;
        let floor = selection.floor.total();
        let longer = correlation_length(&missing.carriage).max(correlation_length(&missing.motor));
        Ok(Questions {
            alternatives,
            questions,
            variance: mean.max(0.5 * floor * floor).max(f64::MIN_POSITIVE) * longer,
            sides,
        })
    }

    /// What a motion, measured or simulated, says to all questions.
    pub(super) fn sums(&self, measured: &Measured) -> Result<Sums, ModelError> {
        let (mut own, mut jacobians) = (Vec::new(), Vec::new());
        for Alternative { hypothesis, coordinates, .. } in &self.alternatives {
            let driven = hypothesis.driven(measured, self.sides, &Driven::default())?;
            let left = stacked(
                &hypothesis.missing_of(&driven, measured, self.sides),
                coordinates,
                DATA_ALONE,
            );
            jacobians.push(derivatives(
                hypothesis,
                coordinates,
                &driven,
                measured,
                self.sides,
                &left,
                DATA_ALONE,
            )?);
            own.push(left);
        }
        let sums: Vec<(DVector<f64>, f64)> = self
            .questions
            .par_iter()
            .map(|question| {
                let coordinates = &self.alternatives[question.alternative].coordinates;
                let truth = stacked(
                    &question.truth.missing(measured, self.sides)?,
                    coordinates,
                    DATA_ALONE,
                );
                let difference = truth - &own[question.alternative];
                let gradient = jacobians[question.alternative].tr_mul(&difference);
                Ok((gradient, difference.norm_squared()))
            })
            .collect::<Result<_, ModelError>>()?;
        let (gradient, square) = sums.into_iter().unzip();
        Ok(Sums {
            gram: jacobians.iter().map(|jacobian| jacobian.tr_mul(jacobian)).collect(),
            gradient,
            square,
            rows: measured.rows.len(),
        })
    }

    /// How an alternative adapts best to all of `sums`, in scales of its coordinates.
    pub(super) fn adapted(&self, question: usize, sums: &Sums) -> DVector<f64> {
        let alternative = self.questions[question].alternative;
        let bounds: Vec<(f64, f64)> = self.alternatives[alternative]
            .coordinates
            .iter()
            .map(|one| {
                ((one.bounds.0 - one.value) / one.scale, (one.bounds.1 - one.value) / one.scale)
            })
            .collect();
        within_bounds(&sums.gram[alternative], &sums.gradient[question], &bounds)
    }

    /// Sum of squares that is left over `part` with this adaptation.
    pub(super) fn left(&self, question: usize, part: &Sums, adapted: &DVector<f64>) -> f64 {
        let gram = &part.gram[self.questions[question].alternative];
        (part.square[question] - 2.0 * part.gradient[question].dot(adapted)
            + adapted.dot(&(gram * adapted)))
        .max(0.0)
    }

    /// Mean square over `part` that an alternative adapted to `all` cannot imitate, N^2.
    pub(super) fn separable(&self, question: usize, part: &Sums, all: &Sums) -> f64 {
        self.left(question, part, &self.adapted(question, all)) / part.rows.max(1) as f64
    }

    /// Standard deviations of the coordinates of the identified model, in their scales: from the
    /// data and their tolerance.
    pub(super) fn deviations(&self, sums: &Sums) -> Vec<f64> {
        let coordinates = &self.alternatives[0].coordinates;
        let mut information = &sums.gram[0] / self.variance;
        for (index, one) in coordinates.iter().enumerate() {
            // A tolerance is knowledge; the bounds of an effect are not.
            information[(index, index)] +=
                if matches!(one.id, ParameterId::Effect { .. }) { 1e-9 } else { 1.0 };
        }
        match information.cholesky().map(|factors| factors.inverse()) {
            Some(inverse) => {
                inverse.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
            }
            None => vec![1.0; coordinates.len()],
        }
    }

    /// Coordinates of the identified model that its data hardly know, by their index.
    pub(super) fn vague(&self, deviations: &[f64]) -> Vec<usize> {
        let coordinates = &self.alternatives[0].coordinates;
        (0..coordinates.len())
            .filter(|index| {
                let (one, deviation) = (&coordinates[*index], deviations[*index]);
                match one.id {
                    // How the guides differ is not asked for: their sum is.
                    ParameterId::Spread { .. } => false,
                    ParameterId::Nominal(declared) => declared.is_factor() && deviation > UNTOLD,
                    // A term that is not there is no doubt.
                    ParameterId::Effect { .. } => {
                        one.value.abs() > 1e-3 * one.scale
                            && TWO_SIDED_95 * deviation * one.scale > VAGUE * one.value.abs()
                    }
                }
            })
            .collect()
    }

    /// The larger of both ways round: of two laws of which one contains the other, only the richer
    /// one can be recognised.
    pub(super) fn rival(&self, effect: usize, rival: &str, part: &Sums, all: &Sums) -> f64 {
        self.of(|subject| match subject {
            Subject::Rival { effect: of, rival: by } => of == effect && by == rival,
            _ => false,
        })
        .map(|question| self.separable(question, part, all))
        .fold(0.0, f64::max)
    }

    /// Mean square below which the search would take the rival for as good.
    pub(super) fn needed(
        &self,
        effect: usize,
        part: &Sums,
        all: &Sums,
        carriage_floor: f64,
    ) -> f64 {
        let gain = self
            .of(|subject| subject == Subject::Without { effect })
            .map(|question| self.separable(question, part, all))
            .fold(0.0, f64::max);
        let seen = Criteria::USUAL.seen_on_carriage() * carriage_floor.powi(2);
        seen.max(OF_A_LAW * gain)
    }

    pub(super) fn of(&self, is: impl Fn(Subject) -> bool) -> impl Iterator<Item = usize> {
        (0..self.questions.len()).filter(move |index| is(self.questions[*index].subject))
    }
}

/// For each added effect the rivals that came close: those that are as good, and the runner-up.
pub(super) fn rivals(selection: &Selection) -> Vec<(usize, Part)> {
    let declared = selection.before.hypothesis.effects.len();
    let mut rivals: Vec<(usize, Part)> = Vec::new();
    let mut rounds = Vec::new();
    let mut chosen: Vec<_> =
        selection.evidence.iter().filter(|one| one.outcome == Outcome::Chosen).collect();
    for (effect, part) in
        selection.after.fitted.hypothesis.effects.iter().enumerate().skip(declared)
    {
        if part.descriptor.is_curve() {
            continue;
        }
        // Of several of a name the first one is the one that was added first.
        let Some(place) = chosen.iter().position(|one| one.name == part.descriptor.name) else {
            continue;
        };
        let won = chosen.remove(place);
        // Of ripples that were chosen together the first stands for all.
        if rounds.contains(&won.round) {
            continue;
        }
        rounds.push(won.round);
        let mut others: Vec<_> = selection
            .evidence
            .iter()
            .filter(|one| one.round == won.round && one.outcome != Outcome::Chosen)
            .collect();
        others.sort_by(|a, b| b.holdout_gain.total_cmp(&a.holdout_gain));
        let close = |(rank, one): &(usize, &&Evidence)| {
            one.outcome == Outcome::Equal || (*rank == 0 && one.outcome == Outcome::Beaten)
        };
        for (_, one) in others.iter().enumerate().filter(close) {
            rivals.push((effect, one.part.clone()));
        }
    }
    rivals
}

/// The p within `bounds`, which hold 0, that makes p'Gp - 2 g'p least: Newton steps on the free
/// coordinates up to the first bound, which is then held until its gradient points inwards (active
/// set; Nocedal, Wright, "Numerical Optimization", ch. 16.5).
pub(super) fn within_bounds(
    gram: &DMatrix<f64>,
    gradient: &DVector<f64>,
    bounds: &[(f64, f64)],
) -> DVector<f64> {
    let count = gradient.len();
    let mut p = DVector::zeros(count);
    let mut held = vec![false; count];
    // Directions in which nothing changes stay where they are.
    let ridge = 1e-11 * gram.diagonal().max() + f64::MIN_POSITIVE;
    for _ in 0..8 * count + 8 {
        let free: Vec<usize> = (0..count).filter(|index| !held[*index]).collect();
        let downhill: DVector<f64> = gradient - gram * &p;
        let mut blocked = None;
        if !free.is_empty() {
            let mut matrix = gram.select_rows(free.iter()).select_columns(free.iter());
            for index in 0..free.len() {
                matrix[(index, index)] += ridge;
            }
            let right =
                DVector::from_iterator(free.len(), free.iter().map(|index| downhill[*index]));
            let Some(step) = matrix.cholesky().map(|factors| factors.solve(&right)) else { break };
            let mut reach = 1.0;
            for (step, index) in step.iter().zip(&free) {
                let (lower, upper) = bounds[*index];
                let room = if *step > 0.0 { upper - p[*index] } else { lower - p[*index] };
                if *step != 0.0 && room / step < reach {
                    (reach, blocked) = (f64::max(room / step, 0.0), Some(*index));
                }
            }
            for (step, index) in step.iter().zip(&free) {
                p[*index] += reach * step;
            }
        }
        match blocked {
            Some(index) => held[index] = true,
            None => {
                let downhill: DVector<f64> = gradient - gram * &p;
                let scale = 1e-9 * gradient.amax();
                let inwards = |index: &usize| {
                    let (lower, upper) = bounds[*index];
                    let at_upper = (upper - p[*index]).abs() <= (p[*index] - lower).abs();
                    held[*index]
                        && (if at_upper { -downhill[*index] } else { downhill[*index] }) > scale
                };
                match (0..count).find(inwards) {
                    Some(index) => held[index] = false,
                    None => break,
                }
            }
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_a_square_form_stays_within_its_bounds() {
        // (p0 - 3)^2 + (p1 + p0 - 1)^2: free it is at (3, -2).
        let gram = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 1.0]);
        let gradient = DVector::from_column_slice(&[4.0, 1.0]);
        let free = within_bounds(&gram, &gradient, &[(-10.0, 10.0), (-10.0, 10.0)]);
        assert!((free[0] - 3.0).abs() < 1e-6 && (free[1] + 2.0).abs() < 1e-6, "{free}");
        // With p1 at least -1 the rest follows from it: p0 = (4 + 1)/2.
        let bounded = within_bounds(&gram, &gradient, &[(-10.0, 10.0), (-1.0, 10.0)]);
        assert!((bounded[1] + 1.0).abs() < 1e-9 && (bounded[0] - 2.5).abs() < 1e-6, "{bounded}");
        // With p0 at most 1 as well, p1 is free again: p1 = 0.
        let both = within_bounds(&gram, &gradient, &[(-10.0, 1.0), (-1.0, 10.0)]);
        assert!((both[0] - 1.0).abs() < 1e-9 && both[1].abs() < 1e-6, "{both}");
        // A coordinate that does nothing stays where it is.
        let idle = within_bounds(
            &DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 0.0]),
            &DVector::from_column_slice(&[0.5, 0.0]),
            &[(-1.0, 1.0); 2],
        );
        assert!((idle[0] - 0.5).abs() < 1e-6 && idle[1] == 0.0, "{idle}");
    }
}
