//! `qos_overrides` of parameter files: quality of service of single topics, as rclcpp names it.
//!
//! `qos_overrides./stage/encoder.publisher.depth: 10` names the topic in full, the role, and the
//! policy. What the nodes can do is applied, what no endpoint takes is reported.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;

use ros2_client::ParameterValue;

use super::lock::lock;
use super::qos::{Durability, Qos, Reliability};

/// What stands before the name of the topic.
pub const PREFIX: &str = "qos_overrides.";

/// The role of an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    Publisher,
    Subscription,
}

impl Role {
    const fn name(self) -> &'static str {
        match self {
            Role::Publisher => "publisher",
            Role::Subscription => "subscription",
        }
    }
}

/// Why an override is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OverrideError {
    #[error(
        "parameter `{name}`: expected qos_overrides.TOPIC.publisher.POLICY or \
         qos_overrides.TOPIC.subscription.POLICY"
    )]
    Name { name: String },
    #[error("parameter `{name}` is {value}, must be {expected}")]
    Value { name: String, value: String, expected: &'static str },
    #[error(
        "parameter `{name}`: the policy cannot be chosen here; depth, history, reliability and \
         durability can"
    )]
    Policy { name: String },
}

/// One policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Policy {
    Depth(u32),
    Reliability(Reliability),
    Durability(Durability),
    /// Keep last, as all topics do.
    KeepLast,
}

/// The overrides of one node, and which have been applied.
#[derive(Debug, Default)]
pub struct QosOverrides {
    wanted: BTreeMap<String, Policy>,
    applied: Mutex<BTreeSet<String>>,
}

impl QosOverrides {
    /// From the parameters that begin with [`PREFIX`].
    ///
    /// # Errors
    /// [`OverrideError`] for what names no policy, or one that the nodes do not have.
    pub fn new<'a>(
        parameters: impl IntoIterator<Item = (&'a str, &'a ParameterValue)>,
    ) -> Result<QosOverrides, OverrideError> {
        let mut wanted = BTreeMap::new();
        for (name, value) in parameters {
            wanted.insert(name.to_owned(), policy(name, value)?);
        }
        Ok(QosOverrides { wanted, applied: Mutex::default() })
    }

    /// `default` with what is wanted of the endpoint on `topic` (in full).
    pub fn of(&self, topic: &str, role: Role, default: &Qos) -> Qos {
        let mut qos = *default;
        let endpoint = format!("{PREFIX}{topic}.{}.", role.name());
        for (name, policy) in self.wanted.iter().filter(|(name, _)| name.starts_with(&endpoint)) {
            match *policy {
                Policy::Depth(depth) => qos.depth = depth,
                Policy::Reliability(reliability) => qos.reliability = reliability,
                Policy::Durability(durability) => qos.durability = durability,
                Policy::KeepLast => {}
            }
            lock(&self.applied).insert(name.clone());
        }
        qos
    }

    /// Those that no endpoint has taken.
    pub fn unused(&self) -> Vec<String> {
        let applied = lock(&self.applied);
        self.wanted.keys().filter(|name| !applied.contains(*name)).cloned().collect()
    }
}

fn policy(name: &str, value: &ParameterValue) -> Result<Policy, OverrideError> {
    let parts = || {
        let (endpoint, policy) = name.strip_prefix(PREFIX)?.rsplit_once('.')?;
        let (topic, role) = endpoint.rsplit_once('.')?;
        let known = [Role::Publisher, Role::Subscription].iter().any(|known| known.name() == role);
        (known && topic.starts_with('/')).then_some(policy)
    };
    let policy = parts().ok_or_else(|| OverrideError::Name { name: name.to_owned() })?;
    let refuse = |expected| {
        let value = match value {
            ParameterValue::String(text) => text.clone(),
            other => format!("{other:?}"),
        };
        Err(OverrideError::Value { name: name.to_owned(), value, expected })
    };
    let text = match value {
        ParameterValue::String(text) => text.as_str(),
        _ => "",
    };
    match policy {
        "depth" => match value {
            ParameterValue::Integer(depth @ 1..=100_000) => Ok(Policy::Depth(*depth as u32)),
            _ => refuse("an integer of 1 to 100000"),
        },
        "history" if text == "keep_last" => Ok(Policy::KeepLast),
        "history" => refuse("keep_last"),
        "reliability" => match text {
            "reliable" => Ok(Policy::Reliability(Reliability::Reliable)),
            "best_effort" => Ok(Policy::Reliability(Reliability::BestEffort)),
            _ => refuse("reliable or best_effort"),
        },
        // A publisher may be given a successor, which has nothing for those who come late.
        "durability" if text == "volatile" => Ok(Policy::Durability(Durability::Volatile)),
        "durability" => refuse("volatile"),
        _ => Err(OverrideError::Policy { name: name.to_owned() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::qos::SAMPLES;

    fn text(text: &str) -> ParameterValue {
        ParameterValue::String(text.to_owned())
    }

    #[test]
    fn what_is_wanted_of_an_endpoint_is_applied_to_it_alone() {
        let given = [
            ("qos_overrides./stage/encoder.publisher.depth", ParameterValue::Integer(7)),
            ("qos_overrides./stage/encoder.publisher.reliability", text("best_effort")),
            ("qos_overrides./stage/force.publisher.depth", ParameterValue::Integer(9)),
        ];
        let overrides =
            QosOverrides::new(given.iter().map(|(name, value)| (*name, value))).unwrap();
        let encoder = overrides.of("/stage/encoder", Role::Publisher, &SAMPLES);
        assert_eq!((encoder.depth, encoder.reliability), (7, Reliability::BestEffort));
        assert_eq!(encoder.window, SAMPLES.window);
        assert_eq!(overrides.of("/stage/encoder", Role::Subscription, &SAMPLES), SAMPLES);
        assert_eq!(overrides.unused(), ["qos_overrides./stage/force.publisher.depth"]);
    }

    #[test]
    fn what_names_no_policy_is_refused_with_what_would_be_right() {
        let refused = |name: &str, value: ParameterValue| {
            QosOverrides::new([(name, &value)]).unwrap_err().to_string()
        };
        let endpoint = "qos_overrides./a.publisher";
        for (name, value, expected) in [
            (format!("{endpoint}.depth"), ParameterValue::Integer(0), "1 to 100000"),
            (format!("{endpoint}.depth"), text("ten"), "is ten, must be an integer"),
            (format!("{endpoint}.history"), text("keep_all"), "must be keep_last"),
            (format!("{endpoint}.reliability"), text("maybe"), "reliable or best_effort"),
            (format!("{endpoint}.durability"), text("transient_local"), "must be volatile"),
            (format!("{endpoint}.deadline"), ParameterValue::Integer(1), "depth, history"),
            ("qos_overrides./a.reader.depth".to_owned(), ParameterValue::Integer(1), "TOPIC"),
            ("qos_overrides.depth".to_owned(), ParameterValue::Integer(1), "TOPIC"),
        ] {
            let message = refused(&name, value);
            assert!(message.contains(expected) && message.contains(&name), "{message}");
        }
    }
}
