//! Why a recording cannot be identified on.

use friction_stage_core::model::ModelError;

/// Why a recording cannot be identified on. The message of each variant says what it is.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
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
        "these are other guides than the model declares: {beyond}; with these values {left:.4} N \
         of {before:.4} N are left. Declare them, or, for a value other than 0, widen its \
         tolerance: `guide-tolerance` for Coulomb and viscous friction, `presliding-tolerance` \
         for static friction and Stribeck velocity"
    )]
    OtherGuides { beyond: String, before: f64, left: f64 },
    #[error(
        "the noise of the sensors hides the force in {name}: encoder and cell read with \
         {encoder:.1e} m and {cell:.1e} N of noise (counts included), which leaves {floor:.1} N, \
         the force is {force:.1} N rms; record with finer counts, or a motion with more \
         acceleration"
    )]
    HiddenByNoise { name: &'static str, encoder: f64, cell: f64, floor: f64, force: f64 },
    #[error(
        "{name} is {value}, must be above 0{}: a share of the declared value, such as 0.16; 1 and \
         more is a factor of 1 + the tolerance either way",
        if most.is_finite() { format!(" and at most {most}") } else { String::new() }
    )]
    Tolerance { name: &'static str, value: f64, most: f64 },
    #[error(transparent)]
    Model(#[from] ModelError),
}
