//! The ROS 2 nodes: the only room that knows ros2-client.
//!
//! [`stage::run`] and [`controller::run`] are the two nodes. Around them: what the command line and
//! the environment say ([`arguments`], [`parameters`], [`participant`]), topics that no dead peer
//! can stall ([`outlet`], [`inlet`], [`qos`]), rules for commands ([`commands`]), and the recorder.

mod action;
pub mod arguments;
mod assignment;
mod beyond_multicast;
pub mod clock;
pub mod commands;
pub mod control;
pub mod controller;
pub mod controller_settings;
mod delay;
pub mod domain;
pub mod driver;
mod early;
mod follow_joint_trajectory;
mod graph_info;
pub mod graph_watch;
mod help;
mod identify_loop;
pub mod inlet;
pub mod lateness;
mod lifecycle;
pub mod live;
mod lock;
pub mod memory_watch;
pub mod outlet;
pub mod parameters;
mod params_file;
pub mod participant;
pub mod qos;
mod qos_overrides;
mod reach;
pub mod recorder;
mod reopened;
pub mod runtime;
pub mod service;
mod service_error;
mod signals;
mod simulation;
mod socket_filter;
mod source_watch;
pub mod stage;
mod stage_inbox;
mod stage_lockstep;
mod stage_outlets;
mod stage_realtime;
pub mod stage_settings;
pub mod stage_status;
mod static_peers;
pub mod std_srvs;
mod uninterrupted;
pub mod waiter;
mod words;

pub use friction_stage_data::bag::LOCKSTEP_EPOCH;
use friction_stage_data::wire;

use crate::cpu;
