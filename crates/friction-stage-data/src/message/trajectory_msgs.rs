//! `trajectory_msgs`: moves of joints.

use serde::{Deserialize, Serialize};

use super::{
    Definition, Duration, Header, Quaternion, RosMessage, Time, Transform, Twist, Vector3,
};

/// Where each joint is to be at one time; every array is empty or as long as the list of joints.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// Position of each joint, m.
    pub positions: Vec<f64>,
    /// Velocity of each joint, m/s.
    pub velocities: Vec<f64>,
    /// Acceleration of each joint, m/s².
    pub accelerations: Vec<f64>,
    /// Force to add on each joint, N.
    pub effort: Vec<f64>,
    /// Time from the start of the trajectory.
    pub time_from_start: Duration,
}

impl RosMessage for JointTrajectoryPoint {
    const PACKAGE: &'static str = "trajectory_msgs";
    const NAME: &'static str = "JointTrajectoryPoint";
    const TYPE_HASH: &'static str =
        "RIHS01_de8907036d8bd45aac6f30cc9044a3d4a329c42cbf719aff7d95a584cfa532d7";
    const TEXT: &'static str = "float64[] positions\nfloat64[] velocities\nfloat64[] \
                                accelerations\n\
                                float64[] effort\nbuiltin_interfaces/Duration time_from_start";
    const DEPENDENCIES: &'static [Definition] = &[Definition::of::<Duration>()];
}

/// A move: one point is the setpoint of now, several are interpolated.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// Time from which the points count.
    pub header: Header,
    /// Joint names, in the order of the values in each point.
    pub joint_names: Vec<String>,
    /// The points, in the order of time.
    pub points: Vec<JointTrajectoryPoint>,
}

impl RosMessage for JointTrajectory {
    const PACKAGE: &'static str = "trajectory_msgs";
    const NAME: &'static str = "JointTrajectory";
    const TYPE_HASH: &'static str =
        "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e";
    const TEXT: &'static str =
        "std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points";
    const DEPENDENCIES: &'static [Definition] = &[
        Definition::of::<Header>(),
        Definition::of::<Time>(),
        Definition::of::<JointTrajectoryPoint>(),
        Definition::of::<Duration>(),
    ];
}

/// Where each joint with several degrees of freedom is to be at one time. A stage has none: only as
/// part of other messages.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDOFJointTrajectoryPoint {
    /// Place of each joint.
    pub transforms: Vec<Transform>,
    /// Velocity of each joint.
    pub velocities: Vec<Twist>,
    /// Acceleration of each joint.
    pub accelerations: Vec<Twist>,
    /// Time from the start of the trajectory.
    pub time_from_start: Duration,
}

impl RosMessage for MultiDOFJointTrajectoryPoint {
    const PACKAGE: &'static str = "trajectory_msgs";
    const NAME: &'static str = "MultiDOFJointTrajectoryPoint";
    const TYPE_HASH: &'static str =
        "RIHS01_6ada1085b5ee64eaa069b074968e69f0e27c8c5e6f5bb0586dd1c834ef0e32b8";
    const TEXT: &'static str = "geometry_msgs/Transform[] transforms\ngeometry_msgs/Twist[] \
                                velocities\ngeometry_msgs/Twist[] accelerations\n\
                                builtin_interfaces/Duration time_from_start";
    const DEPENDENCIES: &'static [Definition] = &[
        Definition::of::<Transform>(),
        Definition::of::<Twist>(),
        Definition::of::<Vector3>(),
        Definition::of::<Quaternion>(),
        Definition::of::<Duration>(),
    ];
}

/// A move of joints with several degrees of freedom.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDOFJointTrajectory {
    /// Time from which the points count.
    pub header: Header,
    /// Joint names.
    pub joint_names: Vec<String>,
    /// The points, in the order of time.
    pub points: Vec<MultiDOFJointTrajectoryPoint>,
}
