//! ROS 2 messages as plain serde structs, one file per ROS package.
//!
//! Each message carries its definition text, its type name and its type hash, so that a recording
//! made from it can be read anywhere. Nothing here knows of DDS: [`cdr`] turns messages into the
//! bytes that travel and back.

pub mod builtin_interfaces;
pub mod cdr;
pub mod control_msgs;
pub mod diagnostic_msgs;
pub mod friction_stage_msgs;
pub mod geometry_msgs;
pub(crate) mod known;
pub mod lifecycle_msgs;
pub mod rosgraph_msgs;
pub mod sensor_msgs;
pub mod std_msgs;
pub mod trajectory_msgs;
pub(crate) mod type_layout;
mod xcdr2;

pub use builtin_interfaces::{Duration, Time};
pub use cdr::{CdrError, from_cdr, to_cdr};
pub use control_msgs::{JointCommand, JointTrajectoryControllerState};
pub use diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
pub use friction_stage_msgs::{ControllerState, StageState, current_type_name};
pub use geometry_msgs::{Quaternion, Transform, Twist, Vector3, Wrench, WrenchStamped};
pub use rosgraph_msgs::Clock;
pub use sensor_msgs::JointState;
pub use std_msgs::{Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout};
pub use trajectory_msgs::{
    JointTrajectory, JointTrajectoryPoint, MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint,
};

use serde::{Serialize, de::DeserializeOwned};

/// The number at a path such as `wrench.force.x` or `position[joint]` in a message (CDR with
/// encapsulation) of a type that only its definition tells, as bags hold it (`ros2msg`); times in
/// s. None where the message lacks it. The error says what does not fit.
pub fn field_value(
    type_name: &str,
    definition: &str,
    path: &str,
    joint: &str,
    message: &[u8],
) -> Result<Option<f64>, String> {
    let layout = type_layout::TypeLayout::parse(type_name, definition)?;
    let path = layout.path(path)?;
    let plain = layout.plain(message)?;
    Ok(layout.value(&path, joint, &plain)?.map(type_layout::Value::as_f64))
}

/// A message of ROS 2: its fields by serde, its identity by constants.
pub trait RosMessage: Serialize + DeserializeOwned + Clone + Send + 'static {
    /// ROS package, e.g. `sensor_msgs`.
    const PACKAGE: &'static str;
    /// Name without package, e.g. `JointState`.
    const NAME: &'static str;
    /// Type hash (`RIHS01_` and the SHA-256 of the type description), as ROS 2 Jazzy computes it.
    const TYPE_HASH: &'static str;
    /// Definition of this message alone, in the `.msg` language.
    const TEXT: &'static str;
    /// Every message type contained in this one, directly or not, each once.
    const DEPENDENCIES: &'static [Definition];
    /// How many of the fields at its end, each a `float64`, a recording of before may lack: they
    /// are 0 then.
    const ADDED_NUMBERS: usize = 0;

    /// Full name as bags and `ros2 topic` show it, e.g. `sensor_msgs/msg/JointState`.
    fn type_name() -> String {
        format!("{}/msg/{}", Self::PACKAGE, Self::NAME)
    }

    /// The text that a bag stores as schema with encoding `ros2msg`: this definition, then each
    /// dependency after a line of 80 `=` and a line `MSG: package/Name`.
    fn definition() -> String {
        let mut text = Self::TEXT.trim_end().to_owned();
        text.push('\n');
        for dependency in Self::DEPENDENCIES {
            text.push_str(&"=".repeat(80));
            text.push_str(&format!(
                "\nMSG: {}/{}\n{}\n",
                dependency.package,
                dependency.name,
                dependency.text.trim_end()
            ));
        }
        text
    }
}

/// The definition of one message type that another contains.
#[derive(Debug, Clone, Copy)]
pub struct Definition {
    /// ROS package.
    pub package: &'static str,
    /// Name without package.
    pub name: &'static str,
    /// Text in the `.msg` language.
    pub text: &'static str,
}

impl Definition {
    /// The definition of `M` alone.
    pub const fn of<M: RosMessage>() -> Self {
        Self { package: M::PACKAGE, name: M::NAME, text: M::TEXT }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every field type that the definition names is a built-in type or is defined in the same
    /// text.
    fn definition_is_closed<M: RosMessage>() {
        let text = M::definition();
        let mut defined = vec![format!("{}/{}", M::PACKAGE, M::NAME)];
        defined.extend(text.lines().filter_map(|l| l.strip_prefix("MSG: ")).map(String::from));
        let mut package = M::PACKAGE.to_owned();
        let mut fields = 0;
        for line in text.lines() {
            if let Some(name) = line.strip_prefix("MSG: ") {
                package = name.split('/').next().unwrap().to_owned();
                continue;
            }
            let line = line.split('#').next().unwrap().trim();
            if line.is_empty() || line.starts_with('=') {
                continue;
            }
            fields += 1;
            let kind = line.split_whitespace().next().unwrap().trim_end_matches("[]");
            let basic = ["bool", "byte", "uint8", "int32", "uint32", "uint64", "float64", "string"];
            let full =
                if kind.contains('/') { kind.to_owned() } else { format!("{package}/{kind}") };
            assert!(
                basic.contains(&kind) || defined.contains(&full),
                "{}: type {kind} is neither built in nor defined",
                M::type_name()
            );
        }
        assert!(fields > 0);
        assert_eq!(M::TYPE_HASH.len(), "RIHS01_".len() + 64);
        assert!(M::TYPE_HASH.starts_with("RIHS01_"));
    }

    #[test]
    fn definitions_contain_all_their_dependencies() {
        definition_is_closed::<Time>();
        definition_is_closed::<Duration>();
        definition_is_closed::<Header>();
        definition_is_closed::<MultiArrayDimension>();
        definition_is_closed::<MultiArrayLayout>();
        definition_is_closed::<Float64MultiArray>();
        definition_is_closed::<JointState>();
        definition_is_closed::<Vector3>();
        definition_is_closed::<Wrench>();
        definition_is_closed::<WrenchStamped>();
        definition_is_closed::<JointTrajectoryPoint>();
        definition_is_closed::<JointTrajectory>();
        definition_is_closed::<Quaternion>();
        definition_is_closed::<Transform>();
        definition_is_closed::<Twist>();
        definition_is_closed::<MultiDOFJointTrajectoryPoint>();
        definition_is_closed::<JointTrajectoryControllerState>();
        definition_is_closed::<JointCommand>();
        definition_is_closed::<lifecycle_msgs::TransitionEvent>();
        definition_is_closed::<Clock>();
        definition_is_closed::<KeyValue>();
        definition_is_closed::<DiagnosticStatus>();
        definition_is_closed::<DiagnosticArray>();
        definition_is_closed::<StageState>();
        definition_is_closed::<ControllerState>();
    }

    #[test]
    fn definition_separates_dependencies_by_eighty_equal_signs() {
        let text = Clock::definition();
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines[0], "builtin_interfaces/Time clock");
        assert_eq!(lines[1], "=".repeat(80));
        assert_eq!(lines[2], "MSG: builtin_interfaces/Time");
        assert_eq!(lines[3], "int32 sec");
    }
}
