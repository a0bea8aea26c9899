//! `lifecycle_msgs`: states of a managed node and the ways between them.

use serde::{Deserialize, Serialize};

use super::{Definition, RosMessage};

/// A state of a managed node.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// Number of the state.
    pub id: u8,
    /// Its name.
    pub label: String,
}

impl RosMessage for State {
    const PACKAGE: &'static str = "lifecycle_msgs";
    const NAME: &'static str = "State";
    const TYPE_HASH: &'static str =
        "RIHS01_dd2d02b82f3ebc858e53c431b1e6e91f3ffc71436fc81d0715214ac6ee2107a0";
    const TEXT: &'static str = "uint8 id 0\nstring label";
    const DEPENDENCIES: &'static [Definition] = &[];
}

/// A way from one state to another.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transition {
    /// Number of the transition.
    pub id: u8,
    /// Its name.
    pub label: String,
}

impl RosMessage for Transition {
    const PACKAGE: &'static str = "lifecycle_msgs";
    const NAME: &'static str = "Transition";
    const TYPE_HASH: &'static str =
        "RIHS01_c65d7b31ea134cba4f54fc867b817979be799f7452035cd35fac9b7421fb3424";
    const TEXT: &'static str = "uint8 id 0\nstring label";
    const DEPENDENCIES: &'static [Definition] = &[];
}

/// A node has gone from one state to another.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionEvent {
    /// When, ns.
    pub timestamp: u64,
    /// By which way.
    pub transition: Transition,
    /// From where.
    pub start_state: State,
    /// Where to.
    pub goal_state: State,
}

impl RosMessage for TransitionEvent {
    const PACKAGE: &'static str = "lifecycle_msgs";
    const NAME: &'static str = "TransitionEvent";
    const TYPE_HASH: &'static str =
        "RIHS01_d5f8873a2f0146498f812d7885c7327ce27e463d36811d8792f35ee38c0d6c38";
    const TEXT: &'static str =
        "uint64 timestamp\nTransition transition\nState start_state\nState goal_state";
    const DEPENDENCIES: &'static [Definition] =
        &[Definition::of::<Transition>(), Definition::of::<State>()];
}
