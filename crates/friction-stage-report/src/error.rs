//! Why a report could not be made.

use friction_stage_core::model::ModelError;
use friction_stage_identify::IdentifyError;
use friction_stage_lab::LabError;

use crate::figure::FigureError;

/// Why a report could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A figure that could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// A model that cannot be evaluated or written.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A residual that cannot be computed.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// A specimen without a guide of its own.
    #[error(transparent)]
    Lab(#[from] LabError),
}
