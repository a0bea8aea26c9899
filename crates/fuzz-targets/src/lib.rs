#![doc = include_str!("../README.md")]
#![warn(missing_docs)]

pub mod mutate;
mod running_node;
pub mod targets;
