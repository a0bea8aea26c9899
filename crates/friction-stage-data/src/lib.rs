//! Recordings of a stage: bags of rosbag2 with MCAP, their messages, the signals in them on one
//! grid, and the quality of these.

pub mod bag;
pub mod message;
pub mod quality;
pub mod signals;
pub mod wire;
