#![doc = include_str!("../README.md")]
#![warn(missing_docs)]

pub mod mutate;
pub mod targets;
