//! `diagnostic_msgs`: how the nodes are doing.

use serde::{Deserialize, Serialize};

use super::{Definition, Header, RosMessage, Time};

/// One named value.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name.
    pub key: String,
    /// Value as text.
    pub value: String,
}

impl KeyValue {
    /// A named value, written as its `Display` says.
    pub fn new(key: impl Into<String>, value: impl ToString) -> Self {
        Self { key: key.into(), value: value.to_string() }
    }
}

impl RosMessage for KeyValue {
    const PACKAGE: &'static str = "diagnostic_msgs";
    const NAME: &'static str = "KeyValue";
    const TYPE_HASH: &'static str =
        "RIHS01_d68081eaa540288c5440753baecef0c4e16e81a5f78ad68902ded5100413bb42";
    const TEXT: &'static str = "string key\nstring value";
    const DEPENDENCIES: &'static [Definition] = &[];
}

/// The state of one component.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// [`OK`](Self::OK), [`WARN`](Self::WARN), [`ERROR`](Self::ERROR) or [`STALE`](Self::STALE).
    pub level: u8,
    /// The component.
    pub name: String,
    /// Its state in words.
    pub message: String,
    /// Which piece of hardware.
    pub hardware_id: String,
    /// The numbers behind it.
    pub values: Vec<KeyValue>,
}

impl DiagnosticStatus {
    /// All is well.
    pub const OK: u8 = 0;
    /// Something to look at.
    pub const WARN: u8 = 1;
    /// Something failed.
    pub const ERROR: u8 = 2;
    /// No news for too long.
    pub const STALE: u8 = 3;

    /// What failed, if anything has.
    pub fn fault(&self) -> Option<&str> {
        (self.level == Self::ERROR).then_some(self.message.as_str())
    }
}

impl RosMessage for DiagnosticStatus {
    const PACKAGE: &'static str = "diagnostic_msgs";
    const NAME: &'static str = "DiagnosticStatus";
    const TYPE_HASH: &'static str =
        "RIHS01_b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4";
    const TEXT: &'static str = "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n\nbyte level\n\
                                string name\nstring message\nstring hardware_id\nKeyValue[] values";
    const DEPENDENCIES: &'static [Definition] = &[Definition::of::<KeyValue>()];
}

/// The states of several components at one time.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Time of the report.
    pub header: Header,
    /// One entry per component.
    pub status: Vec<DiagnosticStatus>,
}

impl RosMessage for DiagnosticArray {
    const PACKAGE: &'static str = "diagnostic_msgs";
    const NAME: &'static str = "DiagnosticArray";
    const TYPE_HASH: &'static str =
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e";
    const TEXT: &'static str = "std_msgs/Header header\nDiagnosticStatus[] status";
    const DEPENDENCIES: &'static [Definition] = &[
        Definition::of::<Header>(),
        Definition::of::<Time>(),
        Definition::of::<DiagnosticStatus>(),
        Definition::of::<KeyValue>(),
    ];
}
