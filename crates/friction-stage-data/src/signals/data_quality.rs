//! The account of a recording: what its samples were like and what was done to them.

use std::ops::Range;

use serde::Serialize;

use super::grid::ClockKind;
use super::mapping::Signal;

/// What was met and done in bringing one signal onto the grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SignalQuality {
    /// The signal.
    pub signal: Signal,
    /// Topic and field, or column.
    pub place: String,
    /// Samples read.
    pub samples: u64,
    /// Samples that are NaN or infinite; taken as missing.
    pub not_finite: u64,
    /// Samples with a stamp that another one has; the first counts.
    pub repeated: u64,
    /// Those of them with another value.
    pub conflicting: u64,
    /// Samples with a stamp before that of an earlier one; put in order.
    pub out_of_order: u64,
    /// Usual (median) interval, s.
    pub interval_s: f64,
    /// Standard deviation of stamps from the clock that they follow, s; only of the position.
    pub jitter_s: Option<f64>,
    /// Samples that are missing, by the usual interval.
    pub missing: u64,
    /// Rows filled from neighbours in place of missing samples.
    pub filled: u64,
    /// Places where more than three samples in a row are missing; NaN in the trace.
    pub gaps: u64,
    /// Longest interval between two samples, s.
    pub longest_interval_s: f64,
    /// Share of the rows that have a value; rows of a pause do not count.
    pub coverage: f64,
    /// Standard deviation of the white noise that its samples show, SI; none where they are too
    /// few.
    pub noise: Option<f64>,
}

/// What the data were like and what was done to them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DataQuality {
    /// Rows on the grid.
    pub rows: usize,
    /// Rows in which the position and every recorded force are known.
    pub valid_rows: usize,
    /// Stretches of such rows.
    pub segments: usize,
    /// Rows per second, Hz.
    pub rate_hz: f64,
    /// How the samples of the position lie in time.
    pub clock: ClockKind,
    /// Rows of pauses, in which the position is not recorded and no value is expected.
    #[serde(skip)]
    pub pauses: Vec<Range<usize>>,
    /// Per signal that was found.
    pub signals: Vec<SignalQuality>,
    /// What a user should know about how they were read.
    pub notes: Vec<SignalNote>,
}

impl DataQuality {
    /// The account of a signal, if there is any sample of it.
    pub fn signal(&self, signal: Signal) -> Option<&SignalQuality> {
        self.signals.iter().find(|q| q.signal == signal)
    }
}

/// Something that a user should know about how the signals were read.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum SignalNote {
    /// A mapping takes two signals from the same place.
    SamePlace {
        /// One of them.
        first: Signal,
        /// The other.
        second: Signal,
    },
    /// All header stamps of a topic are the same, so the time of recording counts.
    UnfilledStamps {
        /// The topic.
        topic: String,
        /// The stamp, ns.
        stamp_ns: i64,
    },
    /// There is no position but a velocity, which was integrated.
    Integrated,
    /// The force is a current, without the force that it makes.
    NoForceConstant,
    /// A CSV file gives a unit, the mapping neither unit nor scale.
    UnitOfFile {
        /// The signal.
        signal: Signal,
        /// Unit in the file.
        unit: String,
        /// Unit that its values are taken in.
        taken: String,
    },
    /// Each number of a column has one mark between thousands, and other columns have decimal
    /// marks; the mapping gives no scale.
    ThousandsInDoubt {
        /// The signal.
        signal: Signal,
        /// Whether the mark is a comma.
        is_comma: bool,
    },
    /// Rows of a CSV file that are none of the table: cut off, or words at its end.
    RowsLeftOut {
        /// How many.
        rows: u64,
        /// Line of the first, from 1.
        first_line: u64,
    },
    /// A proposed mapping still contains CHECK marks.
    Unconfirmed {
        /// What each is about, with what there is to check.
        marks: Vec<String>,
    },
    /// Every sample of a signal is outside the time in which the position is recorded.
    NoTimeInCommon {
        /// The signal.
        signal: Signal,
        /// Topic and field, or column.
        place: String,
        /// Its samples.
        samples: usize,
        /// First and last of its times, s.
        during_s: [f64; 2],
        /// First and last time of the position, s.
        position_s: [f64; 2],
    },
    /// No message has the element of an array that the mapping names.
    NoElement {
        /// The signal.
        signal: Signal,
        /// Topic and field.
        place: String,
        /// Elements of the longest array.
        elements: usize,
        /// Messages.
        messages: u64,
    },
    /// The names in the messages do not say whose a value is.
    Joints {
        /// Topic and field.
        place: String,
        /// Why not.
        doubt: JointDoubt,
    },
    /// Only a part of the recording was read.
    OnlyPart {
        /// Samples of the position in it.
        samples: u64,
        /// Those of the whole recording, where that is known without reading it.
        recorded: Option<u64>,
    },
}

/// Why the names in messages do not say which joint a value is of.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "doubt", rename_all = "snake_case")]
pub enum JointDoubt {
    /// The same index is of several joints.
    Order {
        /// The index.
        index: usize,
        /// The joint that it is of first.
        first: String,
        /// The next one.
        other: String,
    },
    /// There are more or fewer names than values.
    Lengths {
        /// Names.
        names: usize,
        /// Values.
        values: usize,
    },
    /// A joint is named more than once; the first counts.
    Twice {
        /// The joint.
        joint: String,
    },
}

impl SignalNote {
    /// Of the marks that a mapping still has, if any.
    pub(super) fn unconfirmed(marks: &[String]) -> Option<Self> {
        (!marks.is_empty()).then(|| Self::Unconfirmed { marks: marks.to_vec() })
    }

    /// Stable name of the kind, for other programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::SamePlace { .. } => "same_place",
            Self::UnfilledStamps { .. } => "unfilled_stamps",
            Self::Integrated => "integrated_velocity",
            Self::NoForceConstant => "no_force_constant",
            Self::UnitOfFile { .. } => "unit_of_file",
            Self::ThousandsInDoubt { .. } => "thousands_in_doubt",
            Self::RowsLeftOut { .. } => "rows_left_out",
            Self::Unconfirmed { .. } => "unconfirmed",
            Self::NoTimeInCommon { .. } => "no_time_in_common",
            Self::NoElement { .. } => "no_element",
            Self::Joints { .. } => "joints_in_doubt",
            Self::OnlyPart { .. } => "only_part",
        }
    }
}
