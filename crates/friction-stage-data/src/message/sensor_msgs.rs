//! `sensor_msgs`: the state of joints.

use serde::{Deserialize, Serialize};

use super::{Definition, Header, RosMessage, Time};

/// Position (m), velocity (m/s) and effort (N) of joints; every array is empty or as long as
/// `name`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Time of the sample.
    pub header: Header,
    /// Joint names.
    pub name: Vec<String>,
    /// Position of each joint, m.
    pub position: Vec<f64>,
    /// Velocity of each joint, m/s.
    pub velocity: Vec<f64>,
    /// Force on each joint, N.
    pub effort: Vec<f64>,
}

impl RosMessage for JointState {
    const PACKAGE: &'static str = "sensor_msgs";
    const NAME: &'static str = "JointState";
    const TYPE_HASH: &'static str =
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e";
    const TEXT: &'static str = "std_msgs/Header header\n\nstring[] name\nfloat64[] position\n\
                                float64[] velocity\nfloat64[] effort";
    const DEPENDENCIES: &'static [Definition] =
        &[Definition::of::<Header>(), Definition::of::<Time>()];
}
