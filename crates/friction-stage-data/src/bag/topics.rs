//! Topics of the stage, as the nodes name them by default.

/// Encoder reading, `sensor_msgs/JointState`.
pub const ENCODER: &str = "/stage/encoder";
/// Force-cell reading, `geometry_msgs/WrenchStamped`.
pub const FORCE_CELL: &str = "/stage/force_cell";
/// Force command, `geometry_msgs/WrenchStamped`.
pub const FORCE: &str = "/stage/force";
/// Force command of topic hardware, `sensor_msgs/JointState`. Its stamps are of the hardware's own
/// clock and may repeat; when the stage took it is the log time of the stage's own bags.
pub const JOINT_COMMANDS: &str = "/stage/joint_commands";
/// Setpoint, `trajectory_msgs/JointTrajectory`.
pub const SETPOINT: &str = "/stage/setpoint";
/// What the controller adds up, `friction_stage_msgs/ControllerState`.
pub const CONTROLLER_STATE: &str = "/controller/state";
/// Name of the joint in every message.
pub const JOINT: &str = "stage";
