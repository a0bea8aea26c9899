//! Which topic and field, or which column, is which signal of the stage, and in which unit.
//!
//! A mapping is a small YAML file. For a bag:
//!
//! ```yaml
//! joint_type: revolute           # or prismatic; default: by the units
//! joint: x_axis                  # which joint `[joint]` means; default: "stage", or the only one
//! stamp: header.stamp            # or log_time, publish_time, any field; without it the header's
//!                                # where it is filled
//! signals:
//!   position: {topic: /joint_states, field: "position[joint]", unit: mm}
//!   current: {topic: /drive/current, field: "data[0]", unit: A, scale: 12.4}    # N per A
//!   force_cell: {topic: /loadcell, field: wrench.force.z, scale: -1}
//! ```
//!
//! and for a table:
//!
//! ```yaml
//! csv: {delimiter: ";"}          # optional: the layout of the file is detected
//! signals:
//!   time: {column: t_ms, unit: ms}
//!   position: {column: x, unit: mm, offset: -0.1}
//!   force: {column: 4}           # the fourth
//! ```
//!
//! A column of a file of arrays is a variable, `run.pos` a field of a struct, `pos[:,0]` (as NumPy
//! counts) or `pos(:,1)` (as MATLAB does) one of a matrix.
//!
//! A value in SI is `scale * (value * unit) + offset`, the offset in SI units. A unit of another
//! dimension needs a `scale`, in SI too: the lead over 2 pi for turns of a spindle, N per A for a
//! current, which counts as the force. `minus: COLUMN` subtracts another column from the value
//! first; `plus: COLUMN` with its `plus_unit` adds a second column of times. Signals that a
//! recording lacks are left out.
//!
//! Signals that stand in another recording of the same motion, with a clock of its own, are joined:
//!
//! ```yaml
//! join:
//!   - file: cell.csv             # in the directory of the recording, or below it
//!     clock_offset: 12.5         # s, added to its times; default 0
//!     signals:
//!       time: {column: Time_s}
//!       force_cell: {column: F, unit: N}
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use crate::bag::{Provenance, topics};
use friction_stage_core::model::JointType;

/// A signal of the stage; SI units, positive along +x. Units are those of a prismatic joint, see
/// [`JointType`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Signal {
    /// Time of the sample, s. Only in a table: the messages of a bag have stamps.
    Time,
    /// Reference position, m.
    ReferencePosition,
    /// Reference velocity, m/s.
    ReferenceVelocity,
    /// Reference acceleration, m/s².
    ReferenceAcceleration,
    /// Position that the encoder shows, m.
    Position,
    /// Force cell, N.
    ForceCell,
    /// Force command, N.
    Force,
    /// Measured velocity, m/s. Only in a mapping, in place of a position: it is integrated.
    Velocity,
}

impl Signal {
    /// All of them, in the order of the columns of a [`Trace`](super::Trace).
    pub const ALL: [Signal; 7] = [
        Signal::Time,
        Signal::ReferencePosition,
        Signal::ReferenceVelocity,
        Signal::ReferenceAcceleration,
        Signal::Position,
        Signal::ForceCell,
        Signal::Force,
    ];

    /// All that a mapping may name.
    pub(super) const MAPPED: [Signal; 8] = {
        let [a, b, c, d, e, f, g] = Signal::ALL;
        [a, b, c, d, e, f, g, Signal::Velocity]
    };

    /// Name in mapping files, the same as the column of a trace.
    pub fn name(self) -> &'static str {
        super::trace::COLUMNS.get(self as usize).copied().unwrap_or("velocity")
    }
}

impl fmt::Display for Signal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Which time of a message counts.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Stamp {
    /// That of the header, if the messages have one and it is filled; else that of the recorder.
    Auto,
    /// The same, of a value that acted over the time of a row before it.
    IntervalEnd,
    /// When it was recorded.
    LogTime,
    /// When it was sent.
    PublishTime,
    /// A field: a time, or a number of seconds.
    Field(String),
}

/// Where the values of a signal stand.
#[derive(Debug, Clone, PartialEq)]
pub enum Place {
    /// A field of the messages of a topic.
    Topic {
        /// Name of the topic.
        topic: String,
        /// Path of the field, see [`Mapping`].
        field: String,
        /// Which time of the message counts.
        stamp: Stamp,
    },
    /// A column of a table.
    Column(Column),
}

impl Place {
    /// Whether its values acted over the time of a row before their stamps.
    pub(super) fn ends_interval(&self) -> bool {
        matches!(self, Place::Topic { stamp: Stamp::IntervalEnd, .. })
    }

    /// Whether its stamps are when the messages were recorded.
    pub(super) fn is_by_log_time(&self) -> bool {
        matches!(self, Place::Topic { stamp: Stamp::LogTime, .. })
    }

    /// Whether it is a field of the messages of a topic.
    pub(super) fn is_of_topic(&self, name: &str) -> bool {
        matches!(self, Place::Topic { topic, .. } if topic == name)
    }

    /// Whether it has the stamps of another one: those of the same messages.
    pub(super) fn has_stamps_of(&self, other: &Place) -> bool {
        match (self, other) {
            (Place::Topic { topic: a, stamp: s, .. }, Place::Topic { topic: b, stamp: t, .. }) => {
                a == b && s == t
            }
            _ => false,
        }
    }
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Column {
    /// By its number, from 1.
    Number(usize),
    /// By its name in the first line.
    Name(String),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Topic { topic, field, .. } => write!(f, "{topic} {field}"),
            Self::Column(Column::Number(number)) => write!(f, "column {number}"),
            Self::Column(Column::Name(name)) => write!(f, "column {name}"),
        }
    }
}

/// Where a signal comes from and how it becomes SI.
#[derive(Debug, Clone, PartialEq)]
pub struct SignalSource {
    /// Where its values stand.
    pub place: Place,
    /// Size of its unit in SI; `None` where the mapping does not say it.
    pub unit: Option<f64>,
    /// Factor; `None` where the mapping gives none, which is 1.
    pub scale: Option<f64>,
    /// What is added, in SI units.
    pub offset: f64,
    /// A column that is taken from the values before anything else: a position is the reference
    /// less the following error.
    pub minus: Option<Minus>,
    /// Of times: a column that is added, such as the nanoseconds next to the seconds.
    pub plus: Option<Plus>,
}

/// A column of times that is added to another one.
#[derive(Debug, Clone, PartialEq)]
pub struct Plus {
    /// The column.
    pub column: Column,
    /// Its unit, s.
    pub unit: f64,
}

impl Plus {
    /// Where its times stand.
    pub(super) fn source(&self) -> SignalSource {
        let plain = SignalSource::plain(Place::Column(self.column.clone()));
        SignalSource { unit: Some(self.unit), ..plain }
    }
}

/// A column that is taken from another one.
#[derive(Debug, Clone, PartialEq)]
pub struct Minus {
    /// The column.
    pub column: Column,
    /// Its unit in units of that other column.
    pub size: f64,
}

impl SignalSource {
    fn plain(place: Place) -> Self {
        Self { place, unit: None, scale: None, offset: 0.0, minus: None, plus: None }
    }

    /// A value in SI; exactly itself if there is no unit, scale or offset.
    pub fn to_si(&self, value: f64) -> f64 {
        let (unit, scale) = (self.unit.unwrap_or(1.0), self.factor());
        if (unit, scale, self.offset) == (1.0, 1.0, 0.0) {
            return value;
        }
        scale * (value * unit) + self.offset
    }

    /// A time of so many whole units in ns, where a unit is a whole number of them.
    pub(super) fn whole_nanos(&self, value: i64) -> Option<i64> {
        let whole = |nanoseconds: f64| {
            // Up to what the rounding of its factors makes of it.
            let near = nanoseconds.round();
            let is_whole = (nanoseconds - near).abs() <= 4.0 * f64::EPSILON * near.abs();
            (is_whole && near.abs() < 1e27).then_some(near as i128)
        };
        let unit =
            whole(1e9 * self.unit.unwrap_or(1.0) * self.factor()).filter(|unit| *unit != 0)?;
        let time = i128::from(value).checked_mul(unit)?.checked_add(whole(1e9 * self.offset)?)?;
        i64::try_from(time).ok()
    }

    /// What its values are multiplied by, besides the size of their unit.
    pub(super) fn factor(&self) -> f64 {
        self.scale.unwrap_or(1.0)
    }
}

/// What separates the columns of a text table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delimiter {
    /// One character.
    Byte(u8),
    /// Any number of blanks and tabs.
    Blanks,
}

impl fmt::Display for Delimiter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Blanks => f.write_str("blanks"),
            Self::Byte(b'\t') => f.write_str("tabs"),
            Self::Byte(byte) => write!(f, "`{}`", char::from(*byte)),
        }
    }
}

/// What a mapping says of how a CSV file is written; the rest is found by looking at it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CsvLayout {
    /// Between columns.
    pub delimiter: Option<Delimiter>,
    /// Whether a line above the values names the columns.
    pub header: Option<bool>,
    /// Lines that begin with this are left out.
    pub comment: Option<u8>,
    /// Whether numbers have a comma for the decimal point.
    pub decimal_comma: Option<bool>,
    /// Line of the names, from 1.
    pub names_line: Option<u64>,
    /// First line of values, from 1.
    pub data_line: Option<u64>,
    /// Words that stand for a value that is missing, besides those that are known.
    pub missing: Vec<String>,
}

/// Which topic and field, or column, is which signal.
///
/// A field is a path through the message: `wrench.force.x`, `data[2]`; `position[joint]` is the
/// element of the joint that the message names so in `name` or `joint_names`;
/// `points[only]` is the element of a list of one, and a message with several of them has no value.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    /// Name of the joint that `[joint]` stands for; without it [`topics::JOINT`], or the only one
    /// that the messages name.
    pub joint: Option<String>,
    /// Rate of the rows, Hz; without it that of the position.
    pub rate: Option<f64>,
    /// Joint type, where the mapping says it or its units do.
    pub joint_type: Option<JointType>,
    /// What a proposed mapping marks for a person to check, while the marks stand in it.
    pub unconfirmed: Vec<String>,
    /// Whether the force is a current whose force constant is not given.
    pub without_force_constant: bool,
    /// How a CSV file is written.
    pub csv: CsvLayout,
    /// For each signal the places to look: the first that has it counts.
    pub signals: BTreeMap<Signal, Vec<SignalSource>>,
    /// Recordings with the other signals.
    pub join: Vec<Joined>,
    /// Whether exactly these places were asked for, so that a missing one is an error.
    pub(crate) asked_for: bool,
}

/// Another recording of the same motion, and which of its signals are wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct Joined {
    /// Its path, from the directory of the recording on.
    pub file: PathBuf,
    /// What is added to its times for them to be those of the recording, s.
    pub clock_offset: f64,
    /// Where its signals stand.
    pub mapping: Mapping,
}

impl Joined {
    /// Its path, where the recording is at `recording`.
    pub fn path(&self, recording: &Path) -> PathBuf {
        recording.parent().unwrap_or(Path::new("")).join(&self.file)
    }

    /// What is added to its times, ns.
    pub fn clock_offset_ns(&self) -> i64 {
        (self.clock_offset * 1e9).round() as i64
    }
}

impl Mapping {
    pub(super) fn empty() -> Self {
        Self {
            joint: None,
            rate: None,
            joint_type: None,
            unconfirmed: Vec::new(),
            without_force_constant: false,
            csv: CsvLayout::default(),
            signals: BTreeMap::new(),
            join: Vec::new(),
            asked_for: false,
        }
    }

    /// The places of a signal, for people.
    pub(super) fn places(&self, signal: Signal) -> String {
        let places = self.signals.get(&signal).into_iter().flatten();
        places.map(|source| source.place.to_string()).collect::<Vec<_>>().join(" or ")
    }

    /// Whether it is for tables.
    pub fn is_for_csv(&self) -> bool {
        self.signals.values().flatten().any(|s| matches!(s.place, Place::Column(_)))
    }

    /// The topics of our own bags. The command is looked for where any of our inputs takes it; the
    /// reference of a row is the setpoint, or what the controller says it made of one.
    ///
    /// `recorder`: what the stage that recorded it says of the run, if it did. Then the log time of
    /// a joint command is that of the sample which it answered; and where time did not wait for the
    /// answer, the force of a row is the one that acted, which comes with the state of the stage.
    /// `namespace`: that of the nodes, empty without one.
    pub fn own_bag(recorder: Option<&Provenance>, namespace: &str) -> Self {
        let at = |topic: &str, field: &str, stamp: Stamp| {
            let topic = format!("{namespace}{topic}");
            SignalSource::plain(Place::Topic { topic, field: field.into(), stamp })
        };
        let from = |topic: &str, field: &str| at(topic, field, Stamp::Auto);
        let taken = if recorder.is_some() { Stamp::LogTime } else { Stamp::Auto };
        let acted = recorder
            .is_some_and(Provenance::is_of_forces_in_real_time)
            .then(|| at(topics::STATE, "motor_force", Stamp::IntervalEnd));
        let reference = |point: &str, state: &str| {
            vec![
                from(topics::SETPOINT, &format!("points[only].{point}[joint]")),
                from(topics::CONTROLLER_STATE, state),
            ]
        };
        let signals = [
            (Signal::Position, vec![from(topics::ENCODER, "position[joint]")]),
            (
                Signal::ForceCell,
                vec![
                    from(topics::FORCE_CELL, "wrench.force.x"),
                    from(topics::ENCODER, "effort[joint]"),
                ],
            ),
            (
                Signal::Force,
                acted
                    .into_iter()
                    .chain([
                        from(topics::FORCE, "wrench.force.x"),
                        at(topics::JOINT_COMMANDS, "effort[joint]", taken),
                        from("/stage/commands", "data[0]"),
                        from(topics::CONTROLLER_STATE, "output"),
                    ])
                    .collect(),
            ),
            (Signal::ReferencePosition, reference("positions", "reference_position")),
            (Signal::ReferenceVelocity, reference("velocities", "reference_velocity")),
            (Signal::ReferenceAcceleration, reference("accelerations", "reference_acceleration")),
        ];
        Self { signals: signals.into(), ..Self::empty() }
    }

    /// CSV files with the columns of a [`Trace`](super::Trace) by their names.
    pub fn own_csv() -> Self {
        let column = |name: &str| SignalSource::plain(Place::Column(Column::Name(name.to_owned())));
        let signals = Signal::ALL.map(|signal| {
            // The tables of `play` have the unit in the name.
            let with_unit = match signal {
                Signal::Time => Some("time_s"),
                Signal::ReferencePosition => Some("reference_m"),
                Signal::Position => Some("position_m"),
                Signal::Force => Some("force_n"),
                Signal::ForceCell => Some("force_cell_n"),
                Signal::Velocity | Signal::ReferenceVelocity | Signal::ReferenceAcceleration => {
                    None
                }
            };
            (signal, std::iter::once(signal.name()).chain(with_unit).map(column).collect())
        });
        Self { signals: signals.into(), ..Self::empty() }
    }
}
