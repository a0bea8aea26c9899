//! `control_msgs`: what joint_trajectory_controller says of itself, as of Jazzy.

use serde::{Deserialize, Serialize};

use super::{
    Definition, Duration, Header, JointState, JointTrajectoryPoint, MultiDOFJointTrajectoryPoint,
    Quaternion, RosMessage, Time, Transform, Twist, Vector3,
};

/// State of a joint trajectory controller at one time.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryControllerState {
    /// Time of the state.
    pub header: Header,
    /// Joints of the controller.
    pub joint_names: Vec<String>,
    /// Where the joints should be.
    pub reference: JointTrajectoryPoint,
    /// Where they are.
    pub feedback: JointTrajectoryPoint,
    /// Reference less feedback.
    pub error: JointTrajectoryPoint,
    /// What the controller commands.
    pub output: JointTrajectoryPoint,
    /// Joints with several degrees of freedom: none.
    pub multi_dof_joint_names: Vec<String>,
    /// Of those joints.
    pub multi_dof_reference: MultiDOFJointTrajectoryPoint,
    /// Of those joints.
    pub multi_dof_feedback: MultiDOFJointTrajectoryPoint,
    /// Of those joints.
    pub multi_dof_error: MultiDOFJointTrajectoryPoint,
    /// Of those joints.
    pub multi_dof_output: MultiDOFJointTrajectoryPoint,
    /// Speed of the trajectory's time: 1.
    pub speed_scaling_factor: f64,
}

impl RosMessage for JointTrajectoryControllerState {
    const PACKAGE: &'static str = "control_msgs";
    const NAME: &'static str = "JointTrajectoryControllerState";
    const TYPE_HASH: &'static str =
        "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480";
    const TEXT: &'static str = "std_msgs/Header header\nstring[] joint_names\n\
        trajectory_msgs/JointTrajectoryPoint reference\n\
        trajectory_msgs/JointTrajectoryPoint feedback\n\
        trajectory_msgs/JointTrajectoryPoint error\n\
        trajectory_msgs/JointTrajectoryPoint output\n\
        string[] multi_dof_joint_names\n\
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference\n\
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback\n\
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error\n\
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output\n\
        float64 speed_scaling_factor";
    const DEPENDENCIES: &'static [Definition] = &[
        Definition::of::<Header>(),
        Definition::of::<Time>(),
        Definition::of::<JointTrajectoryPoint>(),
        Definition::of::<Duration>(),
        Definition::of::<MultiDOFJointTrajectoryPoint>(),
        Definition::of::<Transform>(),
        Definition::of::<Twist>(),
        Definition::of::<Vector3>(),
        Definition::of::<Quaternion>(),
    ];
}

/// Commands of one interface for several joints, as topic hardware of 2026 sends them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointCommand {
    /// Time of the command.
    pub header: Header,
    /// Joints.
    pub joint_names: Vec<String>,
    /// What the values are, e.g. `effort`.
    pub interface_name: String,
    /// One for each joint.
    pub values: Vec<f64>,
}

impl JointCommand {
    /// The same for efforts as a `JointState`; another interface is given back.
    pub fn into_efforts(self) -> Result<JointState, String> {
        match self.interface_name.as_str() {
            "effort" => Ok(JointState {
                header: self.header,
                name: self.joint_names,
                effort: self.values,
                ..JointState::default()
            }),
            _ => Err(self.interface_name),
        }
    }
}

impl RosMessage for JointCommand {
    const PACKAGE: &'static str = "control_msgs";
    const NAME: &'static str = "JointCommand";
    const TYPE_HASH: &'static str =
        "RIHS01_6080a1df9d28b6badffa5efb27d4ba4ae657c4f6dd2b519b178a32db12405985";
    const TEXT: &'static str = "std_msgs/Header header\nstring[] joint_names\nstring \
                                interface_name\nfloat64[] values";
    const DEPENDENCIES: &'static [Definition] =
        &[Definition::of::<Header>(), Definition::of::<Time>()];
}
