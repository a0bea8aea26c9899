//! Closing the loop with measured data: what does a recording show that the model lacks?
//!
//! In come a declared model and recordings; out go the fitted model, the effects that it lacked,
//! the errors before and after on data that no fit has seen, and a verdict. The steps: fit what is
//! declared ([`fit`]); drive guides and effects along the measured motion and see what force is
//! missing ([`Hypothesis`]); let every effect of the plant propose and refit itself; keep one only
//! if it lowers the error on held-out data by more than chance and more than its rivals.

pub mod closed_loop;
mod curve;
mod declared;
mod driven;
mod fit;
mod guide_slopes;
mod hypothesis;
pub mod inverse_dynamics;
mod knot_slopes;
mod lowpass;
mod measured;
pub mod next_experiment;
mod objective;
mod phase;
mod selection;
mod sensor_noise;
mod slipping;
pub mod spectrum;
mod summary;
mod uncertainty;

pub use declared::Declared;
pub use fit::{Effort, Estimate, Fitted, fit};
pub use hypothesis::{Coordinate, Hypothesis, Missing, Part, Place, Sides, Tolerances};
pub use lowpass::Lowpass;
pub use measured::{Floor, MIN_SAMPLES, Measured, Step};
pub use next_experiment::{Limits, NextExperiment, NextExperimentError, Plan};
pub use phase::{RippleElsewhere, ripple_elsewhere};

pub use closed_loop::{ClosedLoopError, LinearController};
pub use selection::{
    CARRIAGE_GAIN, Errors, Evidence, Inseparable, LEFT_AT_MOST, MOST_LAWS, NOISE_LIKE, Outcome,
    Selection, Silent, Verdict, Watch, search,
};
pub use sensor_noise::MORE_THAN_DECLARED;
pub use summary::{
    Change, FoundEffect, FoundParameter, PositionErrors, RunnerUp, Summary, in_digits,
    parameter_warnings, readable, side_name, taking_part,
};
pub use uncertainty::correlation_length;

use friction_stage_core::model::ModelError;

/// Why a recording cannot be identified on.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    #[error("{name} has {samples} samples that can be used, at least {least} are needed")]
    TooShort { name: String, samples: usize, least: usize },
    #[error(
        "{name} has neither a force command nor a force-cell reading: without a force there is no \
         residual"
    )]
    NoForce { name: String },
    #[error("{name} does not move: the position stays within {travel:e} m")]
    NoMotion { name: String, travel: f64 },
    #[error(
        "records at {first:.6} Hz and {other:.6} Hz do not compare sample by sample: bring both to \
         the lower of them with `rate` in a mapping"
    )]
    Rates { first: f64, other: f64 },
    #[error(
        "these are other guides than the model declares: {beyond} (tolerance {tolerance:.0} %); \
         with these values {left:.4} N of {before:.4} N are left. Declare them, or widen the \
         tolerance of the guides"
    )]
    OtherGuides { beyond: String, tolerance: f64, before: f64, left: f64 },
    #[error(
        "the noise of the sensors hides the force in {name}: encoder and cell read with \
         {encoder:.1e} m and {cell:.1e} N of noise (counts included), which leaves {floor:.1} N, \
         the force is {force:.1} N rms; record with finer counts, or a motion with more \
         acceleration"
    )]
    HiddenByNoise { name: &'static str, encoder: f64, cell: f64, floor: f64, force: f64 },
    #[error(transparent)]
    Model(#[from] ModelError),
}
