//! `std_msgs`: the header and arrays of numbers.

use serde::{Deserialize, Serialize};

use super::{Definition, RosMessage, Time};

/// When and in which frame the data of a message hold.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Time of the sample.
    pub stamp: Time,
    /// Coordinate frame.
    pub frame_id: String,
}

impl Header {
    /// A header with this stamp (ns) and frame.
    pub fn new(stamp_ns: i64, frame_id: impl Into<String>) -> Self {
        Self { stamp: Time::from_nanos(stamp_ns), frame_id: frame_id.into() }
    }
}

impl RosMessage for Header {
    const PACKAGE: &'static str = "std_msgs";
    const NAME: &'static str = "Header";
    const TYPE_HASH: &'static str =
        "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01";
    const TEXT: &'static str = "builtin_interfaces/Time stamp\nstring frame_id";
    const DEPENDENCIES: &'static [Definition] = &[Definition::of::<Time>()];
}

/// One dimension of a multi-dimensional array.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MultiArrayDimension {
    /// Name of the dimension.
    pub label: String,
    /// Number of elements along it.
    pub size: u32,
    /// Elements from one index to the next of the enclosing dimension.
    pub stride: u32,
}

impl RosMessage for MultiArrayDimension {
    const PACKAGE: &'static str = "std_msgs";
    const NAME: &'static str = "MultiArrayDimension";
    const TYPE_HASH: &'static str =
        "RIHS01_5e773a60a4c7fc8a54985f307c7837aa2994252a126c301957a24e31282c9cbe";
    const TEXT: &'static str = "string label\nuint32 size\nuint32 stride";
    const DEPENDENCIES: &'static [Definition] = &[];
}

/// How the flat data of an array are arranged.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MultiArrayLayout {
    /// Dimensions, outermost first; empty for a plain list.
    pub dim: Vec<MultiArrayDimension>,
    /// Elements to skip at the front.
    pub data_offset: u32,
}

impl RosMessage for MultiArrayLayout {
    const PACKAGE: &'static str = "std_msgs";
    const NAME: &'static str = "MultiArrayLayout";
    const TYPE_HASH: &'static str =
        "RIHS01_4c66e6f78e740ac103a94cf63259f968e48c617e7699e829b63c21a5cb50dac6";
    const TEXT: &'static str = "MultiArrayDimension[] dim\nuint32 data_offset";
    const DEPENDENCIES: &'static [Definition] = &[Definition::of::<MultiArrayDimension>()];
}

/// A list of numbers, as `forward_command_controller` sends and takes it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Float64MultiArray {
    /// Arrangement of the data.
    pub layout: MultiArrayLayout,
    /// The numbers.
    pub data: Vec<f64>,
}

impl RosMessage for Float64MultiArray {
    const PACKAGE: &'static str = "std_msgs";
    const NAME: &'static str = "Float64MultiArray";
    const TYPE_HASH: &'static str =
        "RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f";
    const TEXT: &'static str = "MultiArrayLayout layout\nfloat64[] data";
    const DEPENDENCIES: &'static [Definition] =
        &[Definition::of::<MultiArrayLayout>(), Definition::of::<MultiArrayDimension>()];
}
