//! Closing the loop with measured data: what does a recording show that the model lacks?
//!
//! In come a declared model and recordings; out go the fitted model, the effects that it lacked,
//! the errors before and after on data that no fit has seen, and a verdict. The steps: fit what is
//! declared ([`fit`]); drive guides and effects along the measured motion and see what force is
//! missing ([`Hypothesis`]); let every effect of the plant propose and refit itself; keep one only
//! if it lowers the error on held-out data by more than chance and more than its rivals.

pub mod closed_loop;
mod error;
mod fit;
mod hypothesis;
pub mod next_experiment;
mod record;
mod residual;
mod search;
mod summary;
#[cfg(test)]
mod test_records;

pub use closed_loop::{ClosedLoopError, LinearController};
pub use error::IdentifyError;
pub use fit::sensor_noise::MORE_THAN_DECLARED;
pub use fit::{Estimate, FitBudget, Fitted, fit};
pub use hypothesis::nominal_parameter::NominalParameter;
pub use hypothesis::{FreeParameter, Hypothesis, ParameterId, Part, Sides, Tolerances};
pub use next_experiment::{Limits, NextExperiment, NextExperimentError, Plan};
pub use record::joined::joined;
pub use record::lowpass::Lowpass;
pub use record::measured::{Floor, MIN_SAMPLES, Measured, Step};
pub use record::spectrum;
pub use residual::missing::Missing;
pub use search::phase::{RippleElsewhere, ripple_elsewhere};
pub use search::{
    CARRIAGE_GAIN, Errors, Evidence, Inseparable, LEFT_AT_MOST, MOST_LAWS, NOISE_LIKE, Outcome,
    Selection, Silent, Verdict, Watch, search,
};
pub use summary::{
    Change, FoundEffect, FoundParameter, PositionErrors, RunnerUp, Summary, in_digits,
    parameter_warnings, readable, side_name, taking_part,
};
