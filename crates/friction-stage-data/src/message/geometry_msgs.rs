//! `geometry_msgs`: forces, and motion in space.

use serde::{Deserialize, Serialize};

use super::{Definition, Header, RosMessage, Time};

/// A vector in free space.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Along the stage.
    pub x: f64,
    /// Across the stage.
    pub y: f64,
    /// Up.
    pub z: f64,
}

impl RosMessage for Vector3 {
    const PACKAGE: &'static str = "geometry_msgs";
    const NAME: &'static str = "Vector3";
    const TYPE_HASH: &'static str =
        "RIHS01_cc12fe83e4c02719f1ce8070bfd14aecd40f75a96696a67a2a1f37f7dbb0765d";
    const TEXT: &'static str = "float64 x\nfloat64 y\nfloat64 z";
    const DEPENDENCIES: &'static [Definition] = &[];
}

/// Force (N) and torque (N m).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// Force, N.
    pub force: Vector3,
    /// Torque, N m.
    pub torque: Vector3,
}

impl RosMessage for Wrench {
    const PACKAGE: &'static str = "geometry_msgs";
    const NAME: &'static str = "Wrench";
    const TYPE_HASH: &'static str =
        "RIHS01_018e8519d57c16adbe97c9fe1460ef21fec7e31bc541de3d653a35895677ce52";
    const TEXT: &'static str = "Vector3 force\nVector3 torque";
    const DEPENDENCIES: &'static [Definition] = &[Definition::of::<Vector3>()];
}

/// Force and torque with the time of the sample.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WrenchStamped {
    /// Time of the sample.
    pub header: Header,
    /// Force and torque.
    pub wrench: Wrench,
}

impl WrenchStamped {
    /// A force along the stage (N, + along +x); every other component is 0.
    pub fn along_x(header: Header, force: f64) -> Self {
        let mut wrench = Wrench::default();
        wrench.force.x = force;
        Self { header, wrench }
    }
}

impl RosMessage for WrenchStamped {
    const PACKAGE: &'static str = "geometry_msgs";
    const NAME: &'static str = "WrenchStamped";
    const TYPE_HASH: &'static str =
        "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77";
    const TEXT: &'static str = "std_msgs/Header header\nWrench wrench";
    const DEPENDENCIES: &'static [Definition] = &[
        Definition::of::<Header>(),
        Definition::of::<Time>(),
        Definition::of::<Wrench>(),
        Definition::of::<Vector3>(),
    ];
}

/// A rotation as a unit quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

impl Default for Quaternion {
    /// No rotation, as ROS 2 initialises it.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl RosMessage for Quaternion {
    const PACKAGE: &'static str = "geometry_msgs";
    const NAME: &'static str = "Quaternion";
    const TYPE_HASH: &'static str =
        "RIHS01_8a765f66778c8ff7c8ab94afcc590a2ed5325a1d9a076ffff38fbce36f458684";
    const TEXT: &'static str = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1";
    const DEPENDENCIES: &'static [Definition] = &[];
}

/// A frame relative to another.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// m.
    pub translation: Vector3,
    /// Rotation.
    pub rotation: Quaternion,
}

impl RosMessage for Transform {
    const PACKAGE: &'static str = "geometry_msgs";
    const NAME: &'static str = "Transform";
    const TYPE_HASH: &'static str =
        "RIHS01_beb83fbe698636351461f6f35d1abb20010c43d55374d81bd041f1ba2581fddc";
    const TEXT: &'static str = "Vector3 translation\nQuaternion rotation";
    const DEPENDENCIES: &'static [Definition] =
        &[Definition::of::<Vector3>(), Definition::of::<Quaternion>()];
}

/// Velocity in space.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// m/s.
    pub linear: Vector3,
    /// rad/s.
    pub angular: Vector3,
}

impl RosMessage for Twist {
    const PACKAGE: &'static str = "geometry_msgs";
    const NAME: &'static str = "Twist";
    const TYPE_HASH: &'static str =
        "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a";
    const TEXT: &'static str = "Vector3 linear\nVector3 angular";
    const DEPENDENCIES: &'static [Definition] = &[Definition::of::<Vector3>()];
}
