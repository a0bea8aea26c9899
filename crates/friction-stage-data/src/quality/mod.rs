//! Quality of a recording: what is wrong with its messages and its signals, and what the motion in
//! it can identify.

mod check;
mod excitation;
pub(crate) mod outliers;
mod problem;

pub use check::{CheckReport, Coverage, TopicCheck, check};
pub use excitation::{Excitation, Judgement, NoiseFound, RoughFit, Spread, examine};
pub use problem::{DataProblem, Severity};
