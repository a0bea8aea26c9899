//! The fine step of the paper's section 4: 10 µm in 3 ms, after a return move and a rest.

use serde::{Deserialize, Serialize};

use friction_stage_core::control::Gains;

use super::fast_move::{after, errors, ideal_viscous, run};
use super::paper::PaperMotion;
use super::settling::{MoveResult, settling};
use super::specimen::{LabError, LabRecording, Settings, Specimen};

/// Number of steps: the first goes against the bristles that the return move left bent, the others
/// on from there.
pub const STEPS: usize = 5;

/// One guide type in the fine steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FineStep {
    /// Name of the specimen.
    pub name: String,
    /// N s/m
    pub viscous_feedforward: f64,
    /// One result per step.
    pub steps: Vec<MoveResult>,
    /// Proportional gain of the controller, N/m: what the guides' stiffness works against.
    pub proportional_gain: f64,
    /// Time (s after the start of the first step) and error (m).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<(f64, f64)>,
}

/// Runs the steps after `rest` s at rest; `feedforward` as in [`super::fast_move`].
pub fn fine_step(
    specimen: &Specimen,
    settings: &Settings,
    rest: f64,
    feedforward: bool,
) -> Result<(FineStep, LabRecording), LabError> {
    fine_step_along(specimen, settings, &PaperMotion::fine(rest, STEPS), feedforward)
}

/// As [`fine_step`], along steps of one's own.
pub(super) fn fine_step_along(
    specimen: &Specimen,
    settings: &Settings,
    motion: &PaperMotion,
    feedforward: bool,
) -> Result<(FineStep, LabRecording), LabError> {
    let viscous = ideal_viscous(specimen, feedforward)?;
    let rows = run("fine-step", specimen, settings, motion, viscous)?;
    let moves = &motion.moves[1..];
    let found = FineStep {
        name: specimen.name.clone(),
        viscous_feedforward: viscous,
        steps: moves.iter().filter_map(|the_move| settling(the_move, errors(&rows))).collect(),
        proportional_gain: Gains::from_bandwidth(specimen.bandwidth, specimen.stage.mass).p,
        points: after(&moves[0], &rows, 0.3),
    };
    let suffix = if feedforward { "_with_viscous_feedforward" } else { "" };
    let name = format!("fine_step{suffix}");
    Ok((found, LabRecording { name, model: specimen.stage.clone(), settings: *settings, rows }))
}
