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
//! first. Signals that a recording lacks are left out.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use serde::Deserialize;

use super::error::SignalError;
use super::unit::{Dimension, Unit};
use crate::bag::{BagError, topics};
use friction_stage_core::model::{JointType, nearest};

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
    const MAPPED: [Signal; 8] = {
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
    /// Factor.
    pub scale: f64,
    /// What is added, in SI units.
    pub offset: f64,
    /// A column that is taken from the values before anything else: a position is the reference
    /// less the following error.
    pub minus: Option<Column>,
}

impl SignalSource {
    fn plain(place: Place) -> Self {
        Self { place, unit: None, scale: 1.0, offset: 0.0, minus: None }
    }

    /// A value in SI; exactly itself if there is no unit, scale or offset.
    pub fn to_si(&self, value: f64) -> f64 {
        let unit = self.unit.unwrap_or(1.0);
        if (unit, self.scale, self.offset) == (1.0, 1.0, 0.0) {
            return value;
        }
        self.scale * (value * unit) + self.offset
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
    /// Whether the force is a current of which nobody said how much force it makes.
    pub without_force_constant: bool,
    /// How a CSV file is written.
    pub csv: CsvLayout,
    /// For each signal the places to look: the first that has it counts.
    pub signals: BTreeMap<Signal, Vec<SignalSource>>,
    /// Whether somebody asked for exactly these places, so that a missing one is an error.
    pub(crate) asked_for: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MappingFile {
    joint: Option<String>,
    joint_type: Option<JointType>,
    stamp: Option<String>,
    rate: Option<f64>,
    csv: Option<CsvFile>,
    signals: BTreeMap<String, SignalFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CsvFile {
    delimiter: Option<String>,
    header: Option<bool>,
    comment: Option<String>,
    decimal_comma: Option<bool>,
    names_in_line: Option<u64>,
    data_from_line: Option<u64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SignalFile {
    topic: Option<String>,
    field: Option<String>,
    /// As text: YAML would take a column `y` for a truth value.
    column: Option<String>,
    stamp: Option<String>,
    unit: Option<String>,
    scale: Option<f64>,
    offset: Option<f64>,
    minus: Option<String>,
}

impl Mapping {
    /// Reads a mapping file.
    pub fn load(path: &Path) -> Result<Self, SignalError> {
        let text = std::fs::read_to_string(path).map_err(|e| BagError::reading(path, e))?;
        Self::from_yaml(&text, &path.display().to_string())
    }

    /// Reads a mapping; `origin` names the text in errors.
    pub fn from_yaml(text: &str, origin: &str) -> Result<Self, SignalError> {
        let wrong = |key: &str, reason: String| SignalError::Mapping {
            origin: origin.into(),
            key: key.into(),
            reason,
        };
        let file: MappingFile = serde_saphyr::from_str(text).map_err(|error| {
            let hint = match error.without_snippet() {
                serde_saphyr::Error::SerdeUnknownField { field, expected, .. } => {
                    nearest(field, expected.iter().copied())
                }
                _ => String::new(),
            };
            wrong("the file", format!("{}{hint}", error.without_snippet()))
        })?;
        let mut mapping = Self {
            joint: file.joint,
            rate: file.rate,
            joint_type: file.joint_type,
            asked_for: true,
            ..Self::empty()
        };
        if let Some(rate) = mapping.rate
            && !(rate.is_finite() && rate > 0.0)
        {
            return Err(wrong("rate", format!("it is {rate} Hz, must be greater than 0")));
        }
        if let Some(csv) = file.csv {
            let byte = |key: &str, text: &str| match text.as_bytes() {
                [byte] => Ok(*byte),
                _ => Err(wrong(key, format!("it is {text:?}, must be one ASCII character"))),
            };
            mapping.csv = CsvLayout {
                delimiter: match csv.delimiter.as_deref() {
                    None => None,
                    Some("blanks" | "whitespace") => Some(Delimiter::Blanks),
                    Some("tab" | "tabs") => Some(Delimiter::Byte(b'\t')),
                    Some(text) => Some(Delimiter::Byte(byte("csv.delimiter", text)?)),
                },
                header: csv.header,
                comment: csv
                    .comment
                    .as_deref()
                    .map(|text| byte("csv.comment", text))
                    .transpose()?,
                decimal_comma: csv.decimal_comma,
                names_line: csv.names_in_line,
                data_line: csv.data_from_line,
            };
            for (key, line) in
                [("names_in_line", csv.names_in_line), ("data_from_line", csv.data_from_line)]
            {
                if line == Some(0) {
                    return Err(wrong(&format!("csv.{key}"), "lines are counted from 1".into()));
                }
            }
            if mapping.csv.decimal_comma == Some(true)
                && mapping.csv.delimiter == Some(Delimiter::Byte(b','))
            {
                return Err(wrong(
                    "csv.decimal_comma",
                    "the comma also separates columns: give another `delimiter`".into(),
                ));
            }
            if let (Some(names), Some(data)) = (csv.names_in_line, csv.data_from_line)
                && names >= data
            {
                let reason = format!("it is {names}, but the values begin in line {data}");
                return Err(wrong("csv.names_in_line", reason));
            }
        }
        let stamp = file.stamp.as_deref().map_or(Stamp::Auto, stamp);
        let mut joints = JointsOfUnits::default();
        for (name, entry) in file.signals {
            let key = format!("signals.{name}");
            let is_current = name == CURRENT;
            let known = Signal::MAPPED.into_iter().find(|s| s.name() == name);
            let signal = known.or(is_current.then_some(Signal::Force)).ok_or_else(|| {
                let names = || Signal::MAPPED.iter().map(|s| s.name()).chain([CURRENT]);
                wrong(
                    &key,
                    format!(
                        "signals are {}{}",
                        names().collect::<Vec<_>>().join(", "),
                        nearest(&name, names())
                    ),
                )
            })?;
            let column = |text: String| match text.parse::<usize>() {
                Ok(0) => Err(wrong(&key, "columns are counted from 1".into())),
                Ok(number) => Ok(Column::Number(number)),
                Err(_) if mapping.csv.header != Some(false) => Ok(Column::Name(text)),
                Err(_) => {
                    let reason =
                        format!("column {text:?}: without a line of names give its number, from 1");
                    Err(wrong(&key, reason))
                }
            };
            if entry.minus.is_some() && (entry.column.is_none() || signal == Signal::Time) {
                let reason = "`minus` takes a column from another one: it needs `column`, and is \
                              not for times";
                return Err(wrong(&key, reason.into()));
            }
            let minus = entry.minus.map(column).transpose()?;
            let place = match (entry.topic, entry.field, entry.column) {
                (Some(topic), Some(field), None) if signal != Signal::Time => Place::Topic {
                    topic,
                    field,
                    stamp: entry.stamp.as_deref().map_or(stamp.clone(), self::stamp),
                },
                (None, None, Some(text)) => Place::Column(column(text)?),
                (Some(_), _, None) if signal == Signal::Time => {
                    return Err(wrong(
                        &key,
                        "the messages of a bag have stamps: say which with `stamp`".into(),
                    ));
                }
                _ => {
                    return Err(wrong(
                        &key,
                        "it needs `topic` and `field` (in a bag) or `column` (a name, or a number \
                         from 1)"
                            .into(),
                    ));
                }
            };
            let unit = match entry.unit {
                None => None,
                Some(unit) => Some(Unit::named(&unit).ok_or_else(|| {
                    let names = signal.unit_names();
                    let reason = format!(
                        "unit `{unit}` is not known: for {name} it is one of {names}; for others \
                         leave it out and give the `scale` to SI"
                    );
                    wrong(&key, reason)
                })?),
            };
            if let Some(unit) = unit {
                let is_of_signal = signal.has_dimension(unit.dimension);
                let is_plain_current = is_current && unit.dimension == Dimension::Current;
                if !is_of_signal && !is_plain_current && entry.scale.is_none() {
                    let reason = format!(
                        "unit `{}` is none of {name} itself: give the `scale` that makes it one, \
                         in SI units per {}",
                        unit.name, unit.name
                    );
                    return Err(wrong(&key, reason));
                }
                joints.take(signal, unit, entry.scale);
            }
            // Whoever gives a scale knows the unit.
            let unit = unit.map(|unit| unit.size).or(entry.scale.map(|_| 1.0));
            mapping.without_force_constant |= is_current && entry.scale.is_none();
            if signal == Signal::Force && mapping.signals.contains_key(&signal) {
                let reason = "a current counts as the force: give one of them";
                return Err(wrong("signals.current", reason.into()));
            }
            let (scale, offset) = (entry.scale.unwrap_or(1.0), entry.offset.unwrap_or(0.0));
            if !scale.is_finite() || scale == 0.0 || !offset.is_finite() {
                return Err(wrong(
                    &key,
                    format!("scale {scale} and offset {offset}: both finite, scale not 0"),
                ));
            }
            mapping
                .signals
                .insert(signal, vec![SignalSource { place, unit, scale, offset, minus }]);
        }
        if let Some((first, second)) = joints.contradiction() {
            let reason = format!(
                "{} is in {}, {} in {}: one joint does not move along and turn; give one of them \
                 the `scale` of the gear or spindle (rad per m, or m per rad)",
                first.0, first.1.name, second.0, second.1.name
            );
            return Err(wrong(&format!("signals.{}", second.0), reason));
        }
        mapping.joint_type = mapping.joint_type.or(joints.joint());
        let has = |signal: Signal| mapping.signals.contains_key(&signal);
        match (has(Signal::Position), has(Signal::Velocity)) {
            (false, false) => {
                return Err(wrong(
                    "signals.position",
                    "it is missing: without a position, or a velocity, there is nothing to look at"
                        .into(),
                ));
            }
            (true, true) => {
                return Err(wrong(
                    "signals.velocity",
                    "a velocity is integrated where there is no position: give one of them".into(),
                ));
            }
            _ => {}
        }
        let columns = mapping
            .signals
            .values()
            .flatten()
            .filter(|s| matches!(s.place, Place::Column(_)))
            .count();
        if columns != 0 && columns != mapping.signals.len() {
            return Err(wrong(
                "signals",
                "some are topics and some columns: a recording is either a bag or a table".into(),
            ));
        }
        Ok(mapping)
    }

    fn empty() -> Self {
        Self {
            joint: None,
            rate: None,
            joint_type: None,
            without_force_constant: false,
            csv: CsvLayout::default(),
            signals: BTreeMap::new(),
            asked_for: false,
        }
    }

    /// Whether it is for tables.
    pub fn is_for_csv(&self) -> bool {
        self.signals.values().flatten().any(|s| matches!(s.place, Place::Column(_)))
    }

    /// The topics of our own bags. The command is looked for where any of our inputs takes it; the
    /// reference of a row is the setpoint, or what the controller says it made of one.
    ///
    /// `by_stage`: the stage itself recorded it, so that the log time of a joint command is that of
    /// the sample which it answered.
    pub fn own_bag(by_stage: bool) -> Self {
        let at = |topic: &str, field: &str, stamp: Stamp| {
            SignalSource::plain(Place::Topic { topic: topic.into(), field: field.into(), stamp })
        };
        let from = |topic: &str, field: &str| at(topic, field, Stamp::Auto);
        let taken = if by_stage { Stamp::LogTime } else { Stamp::Auto };
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
                vec![
                    from(topics::FORCE, "wrench.force.x"),
                    at(topics::JOINT_COMMANDS, "effort[joint]", taken),
                    from("/stage/commands", "data[0]"),
                    from(topics::CONTROLLER_STATE, "output"),
                ],
            ),
            (Signal::ReferencePosition, reference("positions", "reference_position")),
            (Signal::ReferenceVelocity, reference("velocities", "reference_velocity")),
            (Signal::ReferenceAcceleration, reference("accelerations", "reference_acceleration")),
        ];
        Self { signals: signals.into(), ..Self::empty() }
    }

    /// CSV files with the columns of a [`Trace`](super::Trace) by their names.
    pub fn own_csv() -> Self {
        let signals = Signal::ALL.map(|s| {
            (s, vec![SignalSource::plain(Place::Column(Column::Name(s.name().to_owned())))])
        });
        Self { signals: signals.into(), ..Self::empty() }
    }
}

/// Name in mappings of a force that is a current.
const CURRENT: &str = "current";

/// The joint type that the units of a mapping speak of.
#[derive(Default)]
struct JointsOfUnits {
    found: Vec<(Signal, Unit)>,
}

impl JointsOfUnits {
    /// A unit of its own signal says it; one that a scale makes another does not. A scale of -1
    /// turns a sign.
    fn take(&mut self, signal: Signal, unit: Unit, scale: Option<f64>) {
        if signal.has_dimension(unit.dimension)
            && unit.joint().is_some()
            && scale.is_none_or(|scale| scale.abs() == 1.0)
        {
            self.found.push((signal, unit));
        }
    }

    fn joint(&self) -> Option<JointType> {
        self.found.iter().min_by_key(|(signal, _)| *signal).and_then(|(_, unit)| unit.joint())
    }

    fn contradiction(&self) -> Option<((Signal, Unit), (Signal, Unit))> {
        // The motion says what joint it is, the forces follow.
        let first = *self.found.iter().min_by_key(|(signal, _)| *signal)?;
        let other = self.found.iter().find(|(_, unit)| unit.joint() != first.1.joint())?;
        Some((first, *other))
    }
}

fn stamp(text: &str) -> Stamp {
    match text {
        "auto" => Stamp::Auto,
        "log_time" => Stamp::LogTime,
        "publish_time" => Stamp::PublishTime,
        field => Stamp::Field(field.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapping_says_place_unit_scale_and_offset() {
        let mapping = Mapping::from_yaml(
            "joint: x\nstamp: log_time\nsignals:\n  position: {topic: /j, field: \
             'position[joint]', unit: mm, scale: -1, offset: 0.5}\n\
             \x20 force: {topic: /f, field: data, stamp: header.stamp}\n",
            "m.yaml",
        )
        .unwrap();
        assert_eq!(mapping.joint.as_deref(), Some("x"));
        let position = &mapping.signals[&Signal::Position][0];
        assert_eq!(position.to_si(200.0), 0.5 - 0.2);
        let stamp_of = |source: &SignalSource| match &source.place {
            Place::Topic { stamp, .. } => stamp.clone(),
            Place::Column(_) => panic!("a topic was mapped"),
        };
        assert_eq!(stamp_of(position), Stamp::LogTime);
        assert_eq!(
            stamp_of(&mapping.signals[&Signal::Force][0]),
            Stamp::Field("header.stamp".into())
        );
        assert!(!mapping.is_for_csv());
        // y and n are truth values of old YAML, and good names of columns
        let columns =
            Mapping::from_yaml("signals: {position: {column: y}, force: {column: 3}}", "m.yaml")
                .unwrap();
        assert_eq!(
            columns.signals[&Signal::Position][0].place,
            Place::Column(Column::Name("y".into()))
        );
        assert_eq!(columns.signals[&Signal::Force][0].place, Place::Column(Column::Number(3)));
        assert!(Mapping::own_csv().is_for_csv());
    }

    #[test]
    fn wrong_mappings_are_told_with_the_key_and_what_would_be_right() {
        let cases: &[(&str, &[&str])] = &[
            ("signals: {}", &["signals.position", "missing"]),
            (
                "signals: {position: {column: x}, velocity: {column: v}}",
                &["signals.velocity", "one of them"],
            ),
            ("signals: {positon: {column: x}}", &["signals.positon", "did you mean `position`"]),
            ("signals: {position: {colum: x}}", &["did you mean `column`"]),
            ("signals: {position: {column: 0}}", &["from 1"]),
            ("signals: {position: {topic: /j}}", &["`topic` and `field`"]),
            (
                "signals: {position: {topic: /j, field: x, minus: e}}",
                &["signals.position", "`minus`", "`column`"],
            ),
            ("signals: {position: {column: x, unit: kN}}", &["unit `kN`", "`scale`"]),
            ("signals: {position: {column: x, unit: ell}}", &["unit `ell`", "m, cm, mm", "deg"]),
            (
                "signals: {position: {column: x, unit: mm}, force: {column: f, unit: Nm}}",
                &["signals.force", "position is in mm", "N m", "`scale`"],
            ),
            (
                "signals: {position: {column: x}, force: {column: f, unit: '%'}}",
                &["`%`", "`scale`"],
            ),
            (
                "signals: {position: {column: x}, force: {column: f}, current: {column: i}}",
                &["signals", "one of them"],
            ),
            ("joint_type: rotary\nsignals: {position: {column: x}}", &["rotary", "revolute"]),
            ("signals: {position: {column: x, scale: 0}}", &["scale 0"]),
            (
                "signals: {position: {column: x}, force: {topic: /f, field: x}}",
                &["either a bag or a table"],
            ),
            (
                "signals: {position: {topic: /j, field: x}, time: {topic: /j, field: t}}",
                &["signals.time", "`stamp`"],
            ),
            (
                "csv: {delimiter: ab}\nsignals: {position: {column: x}}",
                &["csv.delimiter", "\"ab\""],
            ),
            ("csv: {header: false}\nsignals: {position: {column: x}}", &["number"]),
            (
                "csv: {decimal_comma: true, delimiter: ','}\nsignals: {position: {column: x}}",
                &["delimiter"],
            ),
            (
                "csv: {names_in_line: 3, data_from_line: 2}\nsignals: {position: {column: x}}",
                &["csv.names_in_line", "line 2"],
            ),
            (
                "csv: {data_from_line: 0}\nsignals: {position: {column: x}}",
                &["csv.data_from_line", "from 1"],
            ),
            ("rate: -1\nsignals: {position: {column: x}}", &["rate", "-1"]),
            ("signals: [", &["m.yaml"]),
            ("", &["m.yaml"]),
        ];
        for (text, expected) in cases {
            let message = Mapping::from_yaml(text, "m.yaml").unwrap_err().to_string();
            for words in *expected {
                assert!(message.contains(words), "{text:?} gave {message:?}, without {words:?}");
            }
        }
    }
}
