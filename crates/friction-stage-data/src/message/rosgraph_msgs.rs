//! `rosgraph_msgs`: simulated time.

use serde::{Deserialize, Serialize};

use super::{Definition, RosMessage, Time};

/// What time it is, for nodes with `use_sim_time`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// Simulated time.
    pub clock: Time,
}

impl RosMessage for Clock {
    const PACKAGE: &'static str = "rosgraph_msgs";
    const NAME: &'static str = "Clock";
    const TYPE_HASH: &'static str =
        "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564";
    const TEXT: &'static str = "builtin_interfaces/Time clock";
    const DEPENDENCIES: &'static [Definition] = &[Definition::of::<Time>()];
}
