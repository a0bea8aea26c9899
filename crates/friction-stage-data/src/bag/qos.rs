//! Quality of service that a topic was offered with, as rosbag2 keeps it beside the topic.
//!
//! `ros2 bag play` publishes with this profile. The text is the one of rosbag2's metadata version 5
//! (Humble), with numbers as in `rmw/types.h`, which later distributions read as well.

/// Whether samples are sent again until they arrive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reliability {
    /// Sent again until acknowledged.
    Reliable,
    /// Sent once.
    BestEffort,
}

/// Whether late subscribers get what was sent before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Durability {
    /// The last samples are kept for late subscribers.
    TransientLocal,
    /// Late subscribers get new samples only.
    Volatile,
}

/// How many samples are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum History {
    /// The last ones, this many.
    KeepLast(u32),
    /// All of them.
    KeepAll,
}

/// The profile that the publisher of a topic offers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OfferedQos {
    /// Reliable or best effort.
    pub reliability: Reliability,
    /// Volatile or transient local.
    pub durability: Durability,
    /// Keep last (with its depth) or keep all.
    pub history: History,
}

impl Default for OfferedQos {
    /// The default of ROS 2: reliable, volatile, keep last 10.
    fn default() -> Self {
        Self::reliable(10)
    }
}

impl OfferedQos {
    /// Reliable, volatile, keep last `depth`.
    pub const fn reliable(depth: u32) -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::Volatile,
            history: History::KeepLast(depth),
        }
    }

    /// Best effort, volatile, keep last `depth`.
    pub const fn best_effort(depth: u32) -> Self {
        Self {
            reliability: Reliability::BestEffort,
            durability: Durability::Volatile,
            history: History::KeepLast(depth),
        }
    }

    /// The YAML list of one profile that rosbag2 stores as `offered_qos_profiles`.
    pub fn yaml(&self) -> String {
        // rmw/types.h: RMW_DURATION_INFINITE, liveliness 1 = automatic
        const INFINITE: &str = "    sec: 9223372036\n    nsec: 854775807";
        let (history, depth) = match self.history {
            History::KeepLast(depth) => (1, depth),
            History::KeepAll => (2, 0),
        };
        let reliability = match self.reliability {
            Reliability::Reliable => 1,
            Reliability::BestEffort => 2,
        };
        let durability = match self.durability {
            Durability::TransientLocal => 1,
            Durability::Volatile => 2,
        };
        format!(
            "- history: {history}\n  depth: {depth}\n  reliability: {reliability}\n  durability: \
             {durability}\n  deadline:\n{INFINITE}\n  lifespan:\n{INFINITE}\n  liveliness: 1\n  \
             liveliness_lease_duration:\n{INFINITE}\n  avoid_ros_namespace_conventions: false"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yaml_has_the_numbers_of_rmw() {
        let qos = OfferedQos {
            reliability: Reliability::BestEffort,
            durability: Durability::TransientLocal,
            history: History::KeepLast(7),
        };
        let lists: Vec<std::collections::BTreeMap<String, serde_json::Value>> =
            serde_saphyr::from_str(&qos.yaml()).unwrap();
        assert_eq!(lists.len(), 1);
        assert_eq!(lists[0]["history"], 1);
        assert_eq!(lists[0]["depth"], 7);
        assert_eq!(lists[0]["reliability"], 2);
        assert_eq!(lists[0]["durability"], 1);
        assert_eq!(lists[0]["deadline"]["sec"], 9_223_372_036_i64);
        assert_eq!(lists[0]["liveliness_lease_duration"]["nsec"], 854_775_807);
        assert_eq!(lists[0]["avoid_ros_namespace_conventions"], false);
    }
}
