//! Stage and controller in one process, without DDS: the reference for lockstep, for experiments and for identification.
//!
//! In come a model, controller settings, a seed and a motion, out come samples with every term; no clock, no I/O.

mod closed_loop;
mod paper;
mod settling;

pub use closed_loop::{ClosedLoop, Cycle};
pub use paper::{Move, MoveKind, PaperMotion};
pub use settling::{MoveResult, SETTLING_BANDS, settling};
