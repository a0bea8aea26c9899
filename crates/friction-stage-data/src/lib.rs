//! Recordings of a stage: bags of rosbag2 with MCAP, their messages, and tables.

pub mod bag;
pub mod message;
