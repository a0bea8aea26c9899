//! What does a recording show that the model of a stage lacks?
//!
//! In come a declared model and two recordings; out come the fitted model, the effects that it
//! lacked, the errors before and after on data that no fit has seen, and a verdict.
//!
//! ```
//! use friction_stage_core::model::{EffectParameters, StageModel};
//! use friction_stage_identify::{Measured, Silent, Tolerances, Verdict, search};
//! # use friction_stage_core::{ClosedLoop, control::*, plant::{Rates, Stage}};
//! # use friction_stage_data::signals::Trace;
//! # fn recorded(model: &StageModel, seed: u64) -> Result<Trace, Box<dyn std::error::Error>> {
//! #     let stage = Stage::new(model, Rates::new(1000.0, 20_000.0)?, seed)?;
//! #     let controller = Controller::new(ControllerSettings::paper(model.mass, 1000.0, 2000.0))?;
//! #     let at = |time, position| Point {
//! #         time,
//! #         position,
//! #         velocity: Some(0.0),
//! #         acceleration: Some(0.0),
//! #         effort: 0.0,
//! #     };
//! #     let both_ways = vec![at(1_000_000_000, 0.02), at(2_000_000_000, 0.0)];
//! #     let mut run = ClosedLoop::new(stage, controller, Trajectory::new(0, both_ways)?);
//! #     let mut trace = Trace::default();
//! #     for _ in 0..2500 {
//! #         let cycle = run.cycle()?;
//! #         trace.push(&cycle.sample, &cycle.terms);
//! #     }
//! #     Ok(trace)
//! # }
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let declared = StageModel::default();
//! let mut real = declared.clone();
//! real.effects.push(EffectParameters::new("constant_force", [("amplitude", 5.0)]));
//! // Stand-ins for `friction_stage_data::signals::load` of two bags.
//! let (train, holdout) = (recorded(&real, 1)?, recorded(&real, 2)?);
//! let train = Measured::new(&train, &declared, "train")?;
//! let holdout = Measured::new(&holdout, &declared, "holdout")?;
//! let found = search(&declared, Tolerances::default(), &train, &holdout, &Silent)?;
//! println!("{:?}: {:?}", found.verdict, found.after.fitted.hypothesis.model().effects);
//! # assert_eq!(found.verdict, Verdict::Found);
//! # assert_eq!(found.after.fitted.hypothesis.effects[0].descriptor.name, "constant_force");
//! # Ok(())
//! # }
//! ```
//!
//! The steps: fit what is declared ([`fit`]); drive guides and effects along the measured motion
//! and see what force is missing ([`Hypothesis`]); let every effect of the plant propose and refit
//! itself; keep one only if it lowers the error on held-out data by more than chance and more than
//! its rivals. [`next_experiment`] works out the motion that would settle what is left open.

#![warn(missing_docs)]

pub mod closed_loop;
mod comparison;
mod error;
mod finding;
mod fit;
mod hypothesis;
mod identification;
pub mod next_experiment;
mod null_record;
mod record;
mod residual;
mod residual_location;
mod search;
mod summary;
#[cfg(test)]
mod test_records;

pub use closed_loop::{ClosedLoopError, LinearController};
pub use comparison::{ComparisonNote, ModelComparison};
pub use error::IdentifyError;
pub use finding::{BoundSide, FigureOfMerit, IdentifyFinding, RecordSide};
pub use fit::sensor_noise::MORE_THAN_DECLARED;
pub use fit::{Estimate, FitBudget, Fitted, fit};
pub use hypothesis::nominal_parameter::NominalParameter;
pub use hypothesis::{FreeParameter, Hypothesis, ParameterId, Part, Sides, Tolerances};
pub use identification::{Identification, LoopError, LoopErrors};
pub use next_experiment::{Limits, NextExperiment, NextExperimentError, Plan};
pub use record::joined::joined;
pub use record::lowpass::ZeroPhaseLowpass;
pub use record::measured::{Floor, MIN_SAMPLES, Measured, Step};
pub use record::records::{Record, RecordSource, Records, RecordsError};
pub use record::spectrum;
pub use residual::missing::Missing;
pub use residual_location::{
    MostPower, MotionSignal, PositiveDirection, ResidualLocation, SideResidual, SignalCorrelation,
};
pub use search::phase::{RippleElsewhere, ripple_elsewhere};
pub use search::{
    Alternative, Criteria, Errors, Evidence, Inseparable, MOST_LAWS, Outcome, Selection, Silent,
    Verdict, Watch, search, search_by,
};
pub use summary::{
    Change, FoundEffect, FoundParameter, PositionErrors, RunnerUp, Summary, SummaryFinding,
    in_digits, readable, side_name, taking_part,
};
