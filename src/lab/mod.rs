//! Stage and controller in one process, without DDS: the reference for lockstep, for experiments and for identification.
//!
//! In come a model, controller settings, a seed and a motion, out come samples with every term; no clock, no I/O.

mod application;
mod closed_loop;
mod paper;
mod selection;
mod settling;
mod variant;

pub use application::{
    Application, ApplicationError, Conditioning, Constraints, Loop, Motion, Requirement, Sealing, Tolerances,
};
pub use closed_loop::{ClosedLoop, Cycle};
pub use paper::{Move, MoveKind, PaperMotion};
pub use selection::{Candidate, Plan, Quantiles, Ranked, Selection, SelectionError, Shard, Tally};
pub use settling::{MoveResult, SETTLING_BANDS, settling};
pub use variant::{Experiment, VariantError, VariantResult, variant_seed};
