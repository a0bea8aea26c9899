//! Stage and controller in one process, without DDS: the reference for lockstep, for experiments and for identification.
//!
//! In come a model, controller settings, a seed and a motion, out come samples with every term; no clock, no I/O.

mod application;
mod closed_loop;
mod guide_fit;
mod least_squares;
mod paper;
mod rig_motion;
mod selection;
mod settling;
mod variant;

pub use application::{
    Application, ApplicationError, Conditioning, Constraints, Loop, Motion, Requirement, Sealing, Tolerances,
};
pub use closed_loop::{ClosedLoop, Cycle};
pub use guide_fit::{Fitted, GuideFit, GuideFitError, fit_guide};
pub use least_squares::{FitError, Minimum, minimise};
pub use paper::{Move, MoveKind, PaperMotion};
pub use rig_motion::{RigError, RigRecord, dahl_motion, rig_of, run_rig, stribeck_motion};
pub use selection::{Candidate, Plan, Quantiles, Ranked, Selection, SelectionError, Shard, Tally};
pub use settling::{MoveResult, SETTLING_BANDS, settling};
pub use variant::{Experiment, VariantError, VariantResult, variant_seed};
