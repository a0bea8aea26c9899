//! A friction-loaded positioning stage as software: 40 kg on four recirculating ball guides.
//!
//! Data goes one way through the rooms: [`model`] says what a stage is, [`plant`] moves it,
//! [`control`] closes the loop, [`lab`] runs both in one process, [`bag`] keeps what happened,
//! [`identify`] says what a model lacks, [`node`] puts it on ROS 2.

pub mod bag;
pub mod cli;
pub mod control;
pub mod identify;
pub mod lab;
pub mod message;
pub mod model;
pub mod node;
pub mod plant;
pub mod report;

/// Half of a two-sided 95 % interval in standard deviations: 97.5 % quantile of the normal distribution.
pub const TWO_SIDED_95: f64 = 1.959_963_984_540_054;

/// Least and largest of some values; infinite, the wrong way round, where there are none.
pub(crate) fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| (least.min(*value), most.max(*value)))
}
