//! Quality of service of every topic, written out in full.
//!
//! Nothing is left to a default: ros2-client's defaults differ from those of ROS 2
//! (subscriptions are best effort with depth 1 there).

use rustdds::{Duration, QosPolicies, QosPolicyBuilder, policy};

/// Does a lost sample get sent again?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    Reliable,
    BestEffort,
}

/// Does a late subscriber get what was published before it came?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    TransientLocal,
    Volatile,
}

/// A complete profile: keep last `depth`, no deadline, no lifespan, automatic liveliness with an
/// infinite lease, shared ownership.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    pub reliability: Reliability,
    pub durability: Durability,
    /// Samples kept for a subscriber that has not taken them, or that comes late.
    pub depth: u32,
    /// Samples that a reliable publisher holds for the slowest subscriber before a publish is
    /// refused (never waited for). The bound of its memory while a subscriber is frozen.
    pub window: u32,
}

/// Unacknowledged samples that rustdds 0.15 holds when nothing else is said.
pub const DEFAULT_WINDOW: u32 = 8192;

impl Qos {
    /// Reliable, volatile, keep last `depth`: what rclpy's default subscription asks for.
    #[must_use]
    pub const fn reliable(depth: u32) -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::Volatile,
            depth,
            window: DEFAULT_WINDOW,
        }
    }

    /// Best effort, volatile, keep last `depth`: as a subscription it matches every publisher.
    #[must_use]
    pub const fn best_effort(depth: u32) -> Self {
        Self { reliability: Reliability::BestEffort, ..Self::reliable(depth) }
    }

    /// Reliable, transient local, keep last `depth`: late subscribers get the last samples.
    #[must_use]
    pub const fn latched(depth: u32) -> Self {
        Self { durability: Durability::TransientLocal, ..Self::reliable(depth) }
    }

    /// # Panics
    /// The window is larger than [`LARGEST_WINDOW`]: a constant of the program is wrong.
    #[must_use]
    pub const fn window(self, window: u32) -> Self {
        assert!(
            window <= LARGEST_WINDOW,
            "peers receive nothing from a publisher with a larger window"
        );
        Self { window, ..self }
    }
}

/// Most samples that a publisher may hold. Nothing is received from one that holds more
/// (`node::socket_filter`).
pub const LARGEST_WINDOW: u32 = 1 << 18;

/// Unacknowledged samples that outlast a dead or frozen subscriber, whose lease ends after 20 s
/// (rclpy) or 50 s (rustdds): 26 s in lockstep at 10,000 cycles per second, 65 s at 4 kHz. What
/// they take, about 110 MB when full, is given back at its end.
const OUTLASTS_A_LEASE: u32 = LARGEST_WINDOW;

/// Samples of the stage and of the controller: every one arrives, in order also for those that hear
/// them beside a dead subscriber. A window that filled sooner would be answered with a new writer,
/// and DDS keeps the order of one writer only.
pub const SAMPLES: Qos = Qos::reliable(100).window(OUTLASTS_A_LEASE);
/// Commands into the stage. As a subscription, reliable matches reliable publishers only, so
/// commands from ros2_control (reliable, volatile, depth 1) and rclpy's default arrive complete.
pub const COMMANDS: Qos = Qos::reliable(100);
/// Forces of the controller: commands, which a new writer would make another source to the stage,
/// refused until the old one has been silent for long enough.
pub const FORCES: Qos = COMMANDS.window(OUTLASTS_A_LEASE);
/// `/clock`, as the clock publishers of ROS 2 simulators offer it. rclpy's time source asks for
/// best effort, depth 1.
pub const CLOCK: Qos = Qos::reliable(10).window(OUTLASTS_A_LEASE);
/// `/diagnostics`, as diagnostic_updater publishes it.
pub const DIAGNOSTICS: Qos = Qos::reliable(1);
/// `~/controller_state`, as joint_trajectory_controller publishes it.
pub const CONTROLLER_STATE: Qos = Qos::reliable(10).window(OUTLASTS_A_LEASE);
/// `~/transition_event`: `rmw_qos_profile_default`.
pub const TRANSITIONS: Qos = Qos::reliable(10);
/// Feedback of an action: `rmw_qos_profile_default`.
pub const FEEDBACK: Qos = Qos::reliable(10);
/// States of an action's goals: `rcl_action_qos_profile_status_default`.
pub const ACTION_STATUS: Qos = Qos::latched(1);
/// Requests and answers of services: `rmw_qos_profile_services_default`.
pub const SERVICES: Qos = Qos::reliable(10);
/// `/rosout`: `rmw_qos_profile_rosout_default` (rcl_logging), without its lifespan of 10 s.
pub const ROSOUT: Qos = Qos::latched(1000);

impl From<&Qos> for QosPolicies {
    fn from(qos: &Qos) -> Self {
        let limit = |n: u32| i32::try_from(n).unwrap_or(i32::MAX);
        let builder = QosPolicyBuilder::new()
            .durability(match qos.durability {
                Durability::TransientLocal => policy::Durability::TransientLocal,
                Durability::Volatile => policy::Durability::Volatile,
            })
            .reliability(match qos.reliability {
                // Zero: a publish into a full window is refused, it does not wait.
                Reliability::Reliable => {
                    policy::Reliability::Reliable { max_blocking_time: Duration::ZERO }
                }
                Reliability::BestEffort => policy::Reliability::BestEffort,
            })
            .history(policy::History::KeepLast { depth: limit(qos.depth) })
            .ownership(policy::Ownership::Shared)
            .liveliness(policy::Liveliness::Automatic { lease_duration: Duration::INFINITE })
            .deadline(policy::Deadline(Duration::INFINITE))
            .lifespan(policy::Lifespan { duration: Duration::INFINITE });
        match qos.reliability {
            Reliability::Reliable => builder.resource_limits(policy::ResourceLimits {
                max_samples: limit(qos.window.max(qos.depth)),
                max_instances: 1,
                max_samples_per_instance: limit(qos.window.max(qos.depth)),
            }),
            Reliability::BestEffort => builder,
        }
        .build()
    }
}

impl From<&Qos> for ros2_client::qos::QosProfile {
    fn from(qos: &Qos) -> Self {
        use ros2_client::qos;
        Self {
            reliability: match qos.reliability {
                Reliability::Reliable => {
                    qos::Reliability::Reliable { when_full: qos::WhenFull::Fail }
                }
                Reliability::BestEffort => qos::Reliability::BestEffort,
            },
            durability: match qos.durability {
                Durability::TransientLocal => qos::Durability::TransientLocal,
                Durability::Volatile => qos::Durability::Volatile,
            },
            history: qos::History::KeepLast { depth: qos.depth as usize },
            deadline: None,
            lifespan: None,
            liveliness: qos::Liveliness::Automatic,
            liveliness_lease: None,
        }
    }
}

/// The same as the plain numbers of `rmw/types.h`, which rosbag2 writes into
/// `offered_qos_profiles`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RmwNumbers {
    /// 1: keep last.
    pub history: u8,
    pub depth: u32,
    /// 1: reliable, 2: best effort.
    pub reliability: u8,
    /// 1: transient local, 2: volatile.
    pub durability: u8,
    /// 1: automatic.
    pub liveliness: u8,
    /// (s, ns) of deadline, lifespan and liveliness lease: `RMW_DURATION_INFINITE`.
    pub infinite: (i64, u32),
}

impl From<&Qos> for RmwNumbers {
    fn from(qos: &Qos) -> Self {
        Self {
            history: 1,
            depth: qos.depth,
            reliability: match qos.reliability {
                Reliability::Reliable => 1,
                Reliability::BestEffort => 2,
            },
            durability: match qos.durability {
                Durability::TransientLocal => 1,
                Durability::Volatile => 2,
            },
            liveliness: 1,
            infinite: (9_223_372_036, 854_775_807),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_window_refuses_and_does_not_wait() {
        let policies = QosPolicies::from(&SAMPLES);
        assert_eq!(
            policies.reliability(),
            Some(policy::Reliability::Reliable { max_blocking_time: Duration::ZERO })
        );
        let limits = policies.resource_limits().unwrap();
        assert_eq!(limits.max_samples, 1 << 18);
    }

    #[test]
    fn the_window_is_never_smaller_than_the_depth() {
        let policies = QosPolicies::from(&Qos::reliable(500).window(10));
        assert_eq!(policies.resource_limits().unwrap().max_samples, 500);
    }

    #[test]
    fn numbers_of_the_bag_are_those_of_rmw() {
        let numbers = RmwNumbers::from(&ROSOUT);
        assert_eq!((numbers.reliability, numbers.durability), (1, 1));
        let numbers = RmwNumbers::from(&Qos::best_effort(5));
        assert_eq!((numbers.reliability, numbers.durability, numbers.depth), (2, 2, 5));
    }
}
