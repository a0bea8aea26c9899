//! What can go wrong when the signals of a stage are read from a recording.

use std::path::PathBuf;

use thiserror::Error;

use crate::bag::BagError;
use friction_stage_core::model::ModelError;

/// Why the signals of a recording could not be read, with the place and what would be right.
#[derive(Debug, Error)]
pub enum SignalError {
    /// The recording itself could not be read or written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The model in a bag cannot be read.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A recording lacks a signal that a trace needs.
    #[error("{} has no {signal}: it needs {needs}; it has {has}", path.display())]
    MissingSignal {
        /// The recording.
        path: PathBuf,
        /// The signal.
        signal: &'static str,
        /// Where it would come from.
        needs: String,
        /// What is there instead.
        has: String,
    },
    /// A mapping file that says something impossible.
    #[error("mapping {origin}: {key}: {reason}")]
    Mapping {
        /// The mapping file.
        origin: String,
        /// Key in it.
        key: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A field that the messages of a topic do not have, or that cannot be read from them.
    #[error("field `{field}` of topic {topic} ({type_name}): {reason}")]
    Field {
        /// The topic.
        topic: String,
        /// Its type.
        type_name: String,
        /// The field asked for.
        field: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// Time stamps that no run of one clock has.
    #[error("time stamps of {signal} ({place}): {reason}")]
    Clock {
        /// The signal.
        signal: &'static str,
        /// Where it comes from.
        place: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A joined recording whose times are not those of the recording.
    #[error(
        "{} begins at {begins_s} s, the position is recorded from {from_s} s to {to_s} s: they \
         have no time in common; `clock_offset` in the mapping is added to the times of the joined \
         file",
        joined.display()
    )]
    NoTimeInCommon {
        /// What is joined.
        joined: PathBuf,
        /// First time of the joined one with its offset, s.
        begins_s: f64,
        /// First time that is wanted, s.
        from_s: f64,
        /// Last time that is wanted, s.
        to_s: f64,
    },
    /// Columns in memory that are no table.
    #[error(
        "{}: {count} values of {column} for {rows} of time: give one for each row",
        name.display()
    )]
    Columns {
        /// What stands for their path.
        name: PathBuf,
        /// The column.
        column: &'static str,
        /// Its values.
        count: usize,
        /// Values of time.
        rows: usize,
    },
    /// A value in memory that no unit can mean.
    #[error("{}: row {row}: {reason}", name.display())]
    ImpossibleValue {
        /// What stands for their path.
        name: PathBuf,
        /// Row, counted from 0.
        row: usize,
        /// Which value, and what would be right.
        reason: String,
    },
    /// A part of a recording in which there is next to nothing.
    #[error(
        "{} has {samples} samples of {signal} from {} s to {}, by the time since the first one; 2 \
         are needed for a rate",
        path.display(), from.unwrap_or(0.0),
        to.map_or_else(|| "its end".to_owned(), |to| format!("{to} s"))
    )]
    EmptyPart {
        /// The recording.
        path: PathBuf,
        /// The signal.
        signal: &'static str,
        /// First time that was asked for, s.
        from: Option<f64>,
        /// Last time that was asked for, s.
        to: Option<f64>,
        /// Samples in between.
        samples: usize,
    },
    /// Too few samples for a rate.
    #[error(
        "{} has {samples} usable samples of {signal} (a value, at a time of its own), of {total} \
         in all; 2 are needed for a rate",
        path.display()
    )]
    TooFewSamples {
        /// The recording.
        path: PathBuf,
        /// The signal.
        signal: &'static str,
        /// Finite samples with different stamps.
        samples: usize,
        /// Samples that there are.
        total: usize,
    },
    /// A bag where a table is needed.
    #[error(
        "{} is a directory, or a recording already, and no table; `friction-stage check` shows the \
         topics of a recording, and with `--mapping` what is in them",
        path.display()
    )]
    IsRecording {
        /// The bag.
        path: PathBuf,
    },
    /// A file of arrays that cannot be read, or lacks what is asked for.
    #[error("{}: {reason}", path.display())]
    Array {
        /// The file.
        path: PathBuf,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A CSV file with something else than numbers under the right names.
    #[error("{} line {line}: {reason}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// What is wrong and what would be right.
        reason: String,
    },
}
