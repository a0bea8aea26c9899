//! The fine step of the paper's section 4: 10 µm in 3 ms, after a return move and a rest.

use serde::Serialize;

use friction_stage_core::control::Gains;

use super::fast_move::{after, errors, ideal_viscous, run};
use super::paper::PaperMotion;
use super::settling::{MoveResult, settling};
use super::specimen::{LabError, LabRecording, Settings, Specimen};

/// Number of steps: the first goes against the bristles that the return move left bent, the others
/// on from there.
pub const STEPS: usize = 5;

/// One guide type in the fine steps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FineStep {
    pub name: String,
    /// N s/m
    pub viscous_feedforward: f64,
    /// One result per step.
    pub steps: Vec<MoveResult>,
    /// Proportional gain of the controller, N/m: what the guides' stiffness works against.
    pub proportional_gain: f64,
    /// Time (s after the start of the first step) and error (m).
    #[serde(skip)]
    pub points: Vec<(f64, f64)>,
}

/// Runs the steps after `rest` s at rest; `feedforward` as in [`super::fast_move`].
pub fn fine_step(
    specimen: &Specimen,
    settings: &Settings,
    rest: f64,
    feedforward: bool,
) -> Result<(FineStep, LabRecording), LabError> {
    let motion = PaperMotion::fine(rest, STEPS);
    let viscous = ideal_viscous(specimen, feedforward)?;
    let rows = run("fine-step", specimen, settings, &motion, viscous)?;
    let moves = &motion.moves[1..];
    let found = FineStep {
        name: specimen.name.clone(),
        viscous_feedforward: viscous,
        steps: moves.iter().filter_map(|the_move| settling(the_move, errors(&rows))).collect(),
        // The bandwidth is the paper's 60 Hz, as in `on_stage`.
        proportional_gain: Gains::from_bandwidth(60.0, specimen.stage.mass).p,
        points: after(&moves[0], &rows, 0.3),
    };
    let suffix = if feedforward { "_with_viscous_feedforward" } else { "" };
    let name = format!("fine_step{suffix}");
    Ok((found, LabRecording { name, model: specimen.stage.clone(), settings: *settings, rows }))
}
