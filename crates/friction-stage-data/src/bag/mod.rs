//! Recordings: rosbag2 directories with MCAP, written, read, checked and repaired.
//!
//! What comes in are messages as CDR bytes with a time; what goes out is a directory that
//! `ros2 bag play` takes from Humble on, or the messages of one in the order of time. [`Trace`] is
//! a recording as columns of numbers.

pub mod check;
mod definition;
pub mod error;
pub mod excitation;
mod file;
pub mod import;
pub mod mapping;
mod metadata;
mod outliers;
pub mod problem;
pub mod provenance;
pub mod qos;
pub mod reader;
pub mod recording;
pub mod recover;
pub mod resample;
mod source;
pub mod trace;
pub mod writer;

pub use check::{CheckReport, check};
pub use error::BagError;
pub use excitation::{Excitation, examine};
pub use file::Damage;
pub use import::{ImportReport, import};
pub use mapping::{Mapping, Signal};
pub use problem::{DataProblem, Severity};
pub use provenance::Provenance;
pub use qos::OfferedQos;
pub use reader::{BagMessage, BagReader, Topic};
pub use recording::{DataQuality, Recording, load};
pub use recover::{RecoverReport, recover};
pub use resample::{ClockKind, SignalQuality};
pub use source::is_csv;
pub use trace::Trace;
pub use writer::{BagOptions, BagWriter, Compression, TopicId};

/// Topics of the stage, as the nodes name them by default.
pub mod topics {
    /// Encoder reading, `sensor_msgs/JointState`.
    pub const ENCODER: &str = "/stage/encoder";
    /// Force-cell reading, `geometry_msgs/WrenchStamped`.
    pub const FORCE_CELL: &str = "/stage/force_cell";
    /// Force command, `geometry_msgs/WrenchStamped`.
    pub const FORCE: &str = "/stage/force";
    /// Setpoint, `trajectory_msgs/JointTrajectory`.
    pub const SETPOINT: &str = "/stage/setpoint";
    /// What the controller adds up, `friction_stage/ControllerState`.
    pub const CONTROLLER_STATE: &str = "/controller/state";
    /// Name of the joint in every message.
    pub const JOINT: &str = "stage";
}
