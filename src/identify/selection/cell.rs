//! What a force cell that reads wrong shows for itself, and no law of motor or carriage does.

use crate::identify::IdentifyError;
use crate::identify::hypothesis::{Hypothesis, Part, Sides};
use crate::identify::measured::Measured;
use crate::plant::Side;

use super::worth::HALF_OF_THE_REST;
use super::{Evidence, Search};

impl Search<'_> {
    /// Whether a candidate takes out force that the stage lacks, and not what the cell reads wrong. A zero may wander by more than the drift that was found, both
    /// sides miss that with opposite signs, and any law that is slow enough follows it. The sum of both sides, from the command to the motion, is free of it: there
    /// a force of motor or carriage takes out at least what it does on the sides.
    pub(super) fn shows_without_cell(&self, one: &Evidence, with: &Hypothesis) -> Result<bool, IdentifyError> {
        if !self.has_cell() || !self.best.hypothesis.effects.iter().any(is_of_cell) || is_of_cell(&one.part) {
            return Ok(true);
        }
        let takes =
            |of: &Hypothesis, with: &Hypothesis, measured: &Measured, gain: f64| -> Result<bool, IdentifyError> {
                Ok(without_cell(of, measured)? - without_cell(with, measured)? >= HALF_OF_THE_REST * gain)
            };
        let (best, holdout) = (&self.best.hypothesis, self.holdout);
        Ok(takes(best, with, self.train, one.train_gain)?
            && takes(&best.in_record(holdout)?, &with.in_record(holdout)?, holdout, one.holdout_gain)?)
    }
}

fn is_of_cell(part: &Part) -> bool {
    part.side() == Side::Sensor && !part.is_of_encoder()
}

/// Mean square of the force that is missing from the command to the motion, N^2.
fn without_cell(hypothesis: &Hypothesis, measured: &Measured) -> Result<f64, IdentifyError> {
    let missing = hypothesis.missing(measured, Sides::BOTH)?;
    let both = missing.motor.iter().zip(&missing.carriage);
    Ok(both.map(|(motor, carriage)| (motor + carriage).powi(2)).sum::<f64>() / missing.carriage.len() as f64)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;
    use crate::identify::closed_loop::tests::recording;
    use crate::identify::hypothesis::Tolerances;
    use crate::identify::selection::{Silent, errors};
    use crate::model::StageModel;
    use crate::plant::EffectDescriptor;

    /// A vibration of 0.5 N at 4 Hz on the carriage, and a cell whose zero goes as far: half of it on the carriage takes as much out of either residual.
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
            let shaken = StageModel { effects: vec![vibration(amplitude, 0.0).parameters()], ..declared.clone() };
            let record = |seed, moves| {
                let mut trace = recording(if in_cell { &declared } else { &shaken }, seed, 0.0, moves);
                for (time, reading) in trace.time.iter().zip(&mut trace.force_cell).filter(|_| in_cell) {
                    *reading += amplitude * (TAU * frequency * time).sin();
                }
                Measured::new(&trace, &declared, "the record").unwrap()
            };
            let (train, holdout) = (record(3, 4), record(4, 2));
            let start = Hypothesis::new(&declared, Tolerances::default()).unwrap();
            let mut search = Search::new(&start, &train, &holdout, &Silent).unwrap();
            search.best.hypothesis = start.with(drift.clone());
            search.best_errors = errors(&search.best.hypothesis, &train, &holdout).unwrap();
            let part = if in_cell { vibration(0.5 * amplitude, PI) } else { vibration(amplitude, 0.0) };
            let with = search.best.hypothesis.with(part.clone());
            let found = errors(&with, &train, &holdout).unwrap();
            let one = search.evidence_of(0, part.clone(), part.side(), 1, &with, found).unwrap();
            assert!(one.train_gain > 0.02 && one.holdout_gain > 0.02, "in the cell: {in_cell}, {one:?}");
            assert_eq!(search.shows_without_cell(&one, &with).unwrap(), !in_cell);
        }
    }
}
