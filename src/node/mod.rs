//! The ROS 2 nodes: the only room that knows ros2-client.
pub mod arguments;
pub mod inlet;
pub mod outlet;
pub mod parameters;
mod params_file;
pub mod participant;
pub mod qos;
pub mod service;
