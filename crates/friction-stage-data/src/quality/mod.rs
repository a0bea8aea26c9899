//! Quality of a recording: what is wrong with its messages and its signals, and what the motion in
//! it can identify.
//!
//! What comes in is a file or a [`Recording`](crate::signals::Recording); what goes out are typed
//! findings, each with a stable code, a severity and its numbers.

mod check;
mod excitation;
mod finding;
mod log_times;
mod outliers;
mod recording_check;

pub use check::{CheckReport, TopicCheck, check};
pub use excitation::{
    Excitation, HeldSpeed, Judgement, JudgementBasis, NoiseFound, Obstacle, Presliding, RoughFit,
    Spread, Subject, examine, held_speeds,
};
pub use finding::{DataFinding, DeadEvidence, Disagreement, FileFinding, Severity};
pub use outliers::outlier_rows;
pub use recording_check::{RecordingCheck, contradictions};
