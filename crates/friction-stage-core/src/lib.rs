#![doc = include_str!("../README.md")]
#![warn(missing_docs)]

pub mod closed_loop;
pub mod control;
pub mod model;
pub mod numerics;
pub mod plant;
pub mod text_file;
pub mod yaml;

pub use closed_loop::{ClosedLoop, Cycle};
