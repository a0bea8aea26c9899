//! A friction-loaded positioning stage as software: 40 kg on four recirculating ball guides.
//!
//! [`model`] says what a stage is, [`plant`] moves it, [`control`] drives it, and [`ClosedLoop`]
//! runs both in one process. Pure: no clock, no I/O, no random source of its own.

pub mod closed_loop;
pub mod control;
pub mod model;
pub mod numerics;
pub mod plant;

pub use closed_loop::{ClosedLoop, Cycle};
