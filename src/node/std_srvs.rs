//! `std_srvs`: the services that the nodes offer.

use ros2_client::Message;
use serde::{Deserialize, Serialize};

/// Request of `std_srvs/srv/SetBool`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetBoolRequest {
    /// On or off.
    pub data: bool,
}

/// Response of `std_srvs/srv/SetBool`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetBoolResponse {
    /// Whether it was done.
    pub success: bool,
    /// What was done, or why not.
    pub message: String,
}

/// Request of `std_srvs/srv/Trigger`: empty, which travels as one byte.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// ROS 2 puts this byte into every message without fields; its value means nothing.
    pub structure_needs_at_least_one_member: u8,
}

/// Response of `std_srvs/srv/Trigger`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// Whether it was done.
    pub success: bool,
    /// What was done, or why not.
    pub message: String,
}

impl Message for TriggerRequest {}
impl Message for TriggerResponse {}
impl Message for SetBoolRequest {}
impl Message for SetBoolResponse {}
