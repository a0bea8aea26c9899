//! What a force cell that reads wrong shows for itself, and no law of motor or carriage does.

use crate::error::IdentifyError;
use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::record::measured::{Measured, mean_square};
use friction_stage_core::plant::effects::Role;

use super::selection::Errors;
use super::state::Search;

/// Least gain of a force between command and motion, as a part of its gain on both sides. Assumed.
const SHOWN_WITHOUT: f64 = 0.5;
/// Share of the explainable residual that the zero of a cell may wander by beside a drift that was
/// found. Assumed: the law explains at least nine tenths.
const WANDERS_AT_MOST: f64 = 0.1;
/// Span over which a zero that wanders hardly changes, s, and share of its square that means over
/// such spans show at least. Assumed.
const SLOW: f64 = 1.0;
const SHOWN_BY_MEANS: f64 = 0.9;

impl Search<'_> {
    /// Whether what comes to `before` takes out force that the stage lacks, and not what the cell
    /// reads wrong. A zero may wander by more than the drift that was found, both sides miss that
    /// with opposite signs, and any law or curve that is slow enough follows it. The sum of both
    /// sides, from the command to the motion, is free of it: there a force of motor or carriage
    /// takes out at least half of what it does on the sides.
    pub(super) fn shows_without_cell(
        &self,
        (before, errors_before): (&Hypothesis, &Errors),
        (with, errors_with): (&Hypothesis, &Errors),
    ) -> Result<bool, IdentifyError> {
        if !self.has_cell()
            || !before.effects.iter().any(is_of_cell)
            || with.effects.last().is_some_and(is_of_cell)
        {
            return Ok(true);
        }
        let takes = |before: &Hypothesis,
                     with: &Hypothesis,
                     measured: &Measured,
                     gain: f64|
         -> Result<bool, IdentifyError> {
            Ok(without_cell(before, measured)? - without_cell(with, measured)?
                >= SHOWN_WITHOUT * gain)
        };
        let holdout = self.holdout;
        Ok(takes(before, with, self.train, errors_before.train() - errors_with.train())?
            && takes(
                &before.in_record(holdout)?,
                &with.in_record(holdout)?,
                holdout,
                errors_before.holdout() - errors_with.holdout(),
            )?)
    }

    /// How far the zero of the cell is off on the hold-out beyond the law that was found for it, N
    /// rms. `None` unless that is all that is left: from the command to the motion nothing but
    /// noise is missing, and what the cell reads wrong is slow and little against what was found.
    pub(super) fn wander_of_zero(&self) -> Result<Option<f64>, IdentifyError> {
        let of_cell = self.found().effects[self.declared_effects()..].iter().any(is_of_cell);
        if !self.has_cell() || !of_cell || self.is_noise(&self.best.errors) {
            return Ok(None);
        }
        let little = self.beyond_noise(&self.best.errors)
            <= WANDERS_AT_MOST * self.beyond_noise(&self.before.errors);
        let here = self.found().in_record(self.holdout)?;
        let elsewhere = without_cell(&here, self.holdout)?.sqrt()
            > self.criteria.noise_like * self.floors.holdout.total();
        let missing = here.missing(self.holdout, Sides::MOTOR)?.motor;
        let beyond = mean_square(missing.iter().copied()) - self.floors.holdout.motor.powi(2);
        let means = square_of_means(&self.holdout.at_rows(&self.holdout.time), &missing, SLOW);
        let is_all = little && !elsewhere && beyond > 0.0 && means >= SHOWN_BY_MEANS * beyond;
        Ok(is_all.then(|| beyond.sqrt()))
    }
}

/// Mean square of a signal of which every span has its mean.
fn square_of_means(time: &[f64], signal: &[f64], span: f64) -> f64 {
    let rows: Vec<(f64, f64)> = time.iter().copied().zip(signal.iter().copied()).collect();
    let spans = rows.chunk_by(|(one, _), (next, _)| (one / span).floor() == (next / span).floor());
    let squares = spans
        .map(|rows| rows.iter().map(|(_, value)| value).sum::<f64>().powi(2) / rows.len() as f64);
    squares.sum::<f64>() / signal.len() as f64
}

fn is_of_cell(part: &Part) -> bool {
    part.role() == Role::ForceCell
}

/// Mean square of the force that is missing from the command to the motion, N^2.
fn without_cell(hypothesis: &Hypothesis, measured: &Measured) -> Result<f64, IdentifyError> {
    let missing = hypothesis.missing(measured, Sides::BOTH)?;
    Ok(mean_square(
        missing.motor.iter().zip(&missing.carriage).map(|(motor, carriage)| motor + carriage),
    ))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::super::tests::part;
    use super::*;
    use crate::hypothesis::Tolerances;
    use crate::search::score::errors;
    use crate::search::{Criteria, Silent};
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;
    use friction_stage_core::plant::EffectDescriptor;

    /// A vibration of 0.5 N at 4 Hz on the carriage, and a cell whose zero goes as far: half of it
    /// on the carriage takes as much out of either residual.
    #[test]
    fn what_wanders_in_the_cell_is_no_force_though_a_law_takes_it_out() {
        let (amplitude, frequency) = (0.5, 4.0);
        let vibration = |amplitude: f64, phase: f64| {
            let descriptor = EffectDescriptor::find("external_vibration").unwrap();
            Part { descriptor, values: vec![amplitude, frequency, phase] }
        };
        let drift = EffectDescriptor::find("force_cell_drift").unwrap();
        let drift = Part { descriptor: drift, values: vec![0.0, 0.0, 0.0, 10.0] };
        for in_cell in [true, false] {
            let declared = StageModel::default();
            let shaken = StageModel {
                effects: vec![vibration(amplitude, 0.0).parameters()],
                ..declared.clone()
            };
            let record = |seed, moves| {
                let mut trace =
                    recording(if in_cell { &declared } else { &shaken }, seed, 0.0, moves);
                for (time, reading) in
                    trace.time.iter().zip(&mut trace.force_cell).filter(|_| in_cell)
                {
                    *reading += amplitude * (TAU * frequency * time).sin();
                }
                Measured::new(&trace, &declared, "the record").unwrap()
            };
            let (train, holdout) = (record(3, 4), record(4, 2));
            let start = Hypothesis::new(&declared, Tolerances::default()).unwrap();
            let mut search =
                Search::new(&start, &train, &holdout, &Criteria::USUAL, &Silent).unwrap();
            search.best.fitted.hypothesis = start.with(drift.clone());
            search.best.errors = errors(&search.best.fitted.hypothesis, &train, &holdout).unwrap();
            let part =
                if in_cell { vibration(0.5 * amplitude, PI) } else { vibration(amplitude, 0.0) };
            let with = search.best.fitted.hypothesis.with(part.clone());
            let found = errors(&with, &train, &holdout).unwrap();
            let before = &search.best.errors;
            assert!(
                before.train() - found.train() > 0.02 && before.holdout() - found.holdout() > 0.02,
                "{in_cell}"
            );
            let shows = search
                .shows_without_cell((&search.best.fitted.hypothesis, before), (&with, &found))
                .unwrap();
            assert_eq!(shows, !in_cell);
        }
    }

    /// Beside a drift of 0.5 N/s: a zero that moves by 0.1 N over ten seconds, one by half of the
    /// drift, a reading that shakes three times a second, and a force of the motor that is as slow.
    #[test]
    fn only_a_slow_and_small_rest_of_the_cell_is_a_zero_that_wanders() {
        let model = StageModel::default();
        let record = |seed, moves, size: f64, frequency: f64, in_cell: bool| {
            let mut trace = recording(&model, seed, 0.0, moves);
            for row in 0..trace.len() {
                let time = trace.time[row] - trace.time[0];
                let rest = size * (TAU * frequency * time + seed as f64).sin();
                trace.force_cell[row] += 0.5 * time + if in_cell { rest } else { 0.0 };
                trace.force[row] += if in_cell { 0.0 } else { rest };
            }
            Measured::new(&trace, &model, "the record").unwrap()
        };
        let drift = part("force_cell_drift", &[("rate", 0.5)]);
        for (size, frequency, in_cell, expected) in [
            (0.15, 0.1, true, true),
            (1.0, 0.1, true, false),
            (0.15, 3.0, true, false),
            (0.15, 0.1, false, false),
        ] {
            let (train, holdout) =
                (record(3, 6, size, frequency, in_cell), record(4, 4, size, frequency, in_cell));
            let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
            let mut search =
                Search::new(&start, &train, &holdout, &Criteria::USUAL, &Silent).unwrap();
            search.best.fitted.hypothesis = start.with(drift.clone());
            search.best.errors = errors(&search.best.fitted.hypothesis, &train, &holdout).unwrap();
            let wander = search.wander_of_zero().unwrap();
            assert_eq!(
                wander.is_some(),
                expected,
                "{size} N at {frequency} Hz, in the cell: {in_cell}, {wander:?}"
            );
            assert!(wander.is_none_or(|wander| (0.05..size).contains(&wander)), "{wander:?}");
        }
    }
}
