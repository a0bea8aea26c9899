//! How far a node is seen on the network.

/// How far discovery reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// This machine only: loopback.
    Localhost,
    /// Every network interface, with multicast.
    Subnet,
}

impl Reach {
    /// What the environment may say.
    pub(super) const NAMES: [&'static str; 4] = ["SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"];
}
