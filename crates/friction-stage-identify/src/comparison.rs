//! How good a model is on one recording: the force that it misses along the motion, and the
//! position error of the closed loop.
//!
//! What comes in are a model and a recording; what goes out are both figures, each with why it is
//! missing where it is, and what they take for granted.

use crate::closed_loop::{self, ClosedLoopError};
use crate::error::IdentifyError;
use crate::hypothesis::{Hypothesis, Part, Sides, Tolerances};
use crate::record::measured::Measured;
use friction_stage_core::model::StageModel;
use friction_stage_data::signals::Trace;

/// Share of what a model misses that the phase or the instant which fits this record best has to
/// explain for the one of the model to be another record's. Assumed.
const ANOTHER_RECORD: f64 = 0.05;

/// What the figures of a comparison take for granted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ComparisonNote {
    /// Balls that slip have the amplitude and phase here that fit this record best, and no part in
    /// the closed loop.
    Slips,
    /// An effect has the phase here that fits this record best.
    OwnPhase {
        /// The effect.
        effect: &'static str,
    },
    /// The map jumps here where that fits this record best.
    OwnJump {
        /// When, s.
        at: f64,
        /// Length of the record, s.
        length: f64,
    },
}

/// A model against one recording.
#[derive(Debug)]
pub struct ModelComparison {
    /// Force that the model misses along the recorded motion, both sides of the cell together, N
    /// rms.
    pub missing_force: Result<f64, IdentifyError>,
    /// Encoder of the closed loop less the recorded one, m rms.
    pub closed_loop: Result<f64, ClosedLoopError>,
    /// What these figures take for granted.
    pub notes: Vec<ComparisonNote>,
}

impl ModelComparison {
    /// Compares a model with a recording, with the phases that a record has for itself.
    pub fn new(model: &StageModel, trace: &Trace) -> ModelComparison {
        let mut notes = Vec::new();
        let mut in_record = model.clone();
        let missing_force = missing_force(model, trace).map(|(rms, here, own)| {
            if here.effects.iter().any(Part::slips) {
                notes.push(ComparisonNote::Slips);
            }
            if !own.is_empty() {
                in_record = here.model();
            }
            if let Some(part) = own.iter().find(|part| part.has_phase_of_record()) {
                notes.push(ComparisonNote::OwnPhase { effect: part.descriptor.name });
            }
            let length = trace.time.last().unwrap_or(&0.0) - trace.time.first().unwrap_or(&0.0);
            for at in own.iter().filter_map(|part| Some(part.curve()?.jump?.at)) {
                notes.push(ComparisonNote::OwnJump { at, length });
            }
            rms
        });
        let closed_loop = closed_loop_error(&in_record, trace);
        ModelComparison { missing_force, closed_loop, notes }
    }
}

/// Rms of the force that the model misses along the recorded motion, N, with the phases that a
/// record has for itself; what stands for the model in this record, and of that the effects which
/// this record has for itself.
fn missing_force(
    model: &StageModel,
    trace: &Trace,
) -> Result<(f64, Hypothesis, Vec<Part>), IdentifyError> {
    let measured = Measured::new(trace, model, "the recording")?;
    let declared = Hypothesis::new(model, Tolerances::default())?;
    let here = declared.in_record(&measured)?;
    let missing = |hypothesis: &Hypothesis| {
        hypothesis.missing(&measured, Sides::BOTH).map(|missing| missing.rms())
    };
    let (as_declared, in_record) = (missing(&declared)?, missing(&here)?);
    if in_record < (1.0 - ANOTHER_RECORD) * as_declared {
        let own = declared.own_of(&here).into_iter().cloned().collect();
        return Ok((in_record, here, own));
    }
    Ok((as_declared, declared, Vec::new()))
}

fn closed_loop_error(model: &StageModel, trace: &Trace) -> Result<f64, ClosedLoopError> {
    let controller = closed_loop::controller_of(trace, &[trace])?;
    Ok(closed_loop::rms(&closed_loop::position_error(model, trace, &controller)?))
}
