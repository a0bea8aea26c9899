//! The stage on ROS 2: [`node`] holds the nodes, [`cli`] the command line.

pub mod cli;
pub mod cpu;
pub mod directory;
pub mod interrupt;
pub mod made_by;
pub mod node;
pub mod outcome;
