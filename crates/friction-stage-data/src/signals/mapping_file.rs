//! Reads a [`Mapping`] from YAML.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use serde::Deserialize;

use super::error::SignalError;
use super::mapping::{
    Column, CsvLayout, Delimiter, Joined, Mapping, Minus, Place, Plus, Signal, SignalSource, Stamp,
};
use super::unit::{Dimension, Unit};
use crate::bag::BagError;
use friction_stage_core::model::{JointType, nearest};
use friction_stage_core::{text_file, yaml};

/// Name in mappings of a force that is a current.
const CURRENT: &str = "current";

/// Which topic and field, or column, is which signal.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MappingFile {
    /// Which joint `[joint]` in a field means; by default `stage`, or the only one.
    joint: Option<String>,
    /// Whether it moves along an axis or turns about one, where no unit says it.
    joint_type: Option<JointType>,
    /// When a message counts: `log_time` (when it was recorded), `publish_time` (when it was sent),
    /// or a field such as `header.stamp`; by default the stamp of the header where it is filled.
    stamp: Option<String>,
    /// Samples per second that the recording is brought to, Hz; by default its own.
    rate: Option<f64>,
    /// How a table is written, where that is not found.
    csv: Option<CsvFile>,
    /// The signals: `time` (of a table), `position` or `velocity`, and where they are recorded
    /// `reference_position`, `reference_velocity`, `reference_acceleration`, `force`, `current` in
    /// the place of `force`, and `force_cell`.
    signals: BTreeMap<String, SignalFile>,
    /// Recordings of the same run with further signals.
    #[serde(default)]
    join: Vec<JoinFile>,
}

/// A recording of the same run.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JoinFile {
    /// The recording, in the directory of the first one or below it.
    file: PathBuf,
    /// What is added to its times, s; by default 0.
    clock_offset: Option<f64>,
    /// As in the mapping.
    joint: Option<String>,
    /// As in the mapping.
    stamp: Option<String>,
    /// As in the mapping.
    rate: Option<f64>,
    /// As in the mapping.
    csv: Option<CsvFile>,
    /// As in the mapping.
    signals: BTreeMap<String, SignalFile>,
}

/// How a text table is written. What is left out is found from the text.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CsvFile {
    /// What parts the cells: one character, `tab`, or `blanks`.
    delimiter: Option<String>,
    /// Whether the columns have names.
    header: Option<bool>,
    /// What a line begins with that is none of the table.
    comment: Option<String>,
    /// Whether `1,5` is one and a half.
    decimal_comma: Option<bool>,
    /// The line with the names of the columns, from 1 on.
    names_in_line: Option<u64>,
    /// The first line with numbers, from 1 on.
    data_from_line: Option<u64>,
    /// Words that stand for a value that was not measured.
    #[serde(default)]
    missing: Vec<String>,
}

/// Where a signal is, and what its numbers are.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SignalFile {
    /// Topic of a bag.
    topic: Option<String>,
    /// Field of its messages, such as `position[joint]`, `data[0]` or `wrench.force.x`.
    field: Option<String>,
    /// Column of a table, by its name or, from 1 on, its number.
    // As text: YAML would take a column `y` for a truth value.
    column: Option<String>,
    /// As in the mapping, for this signal.
    stamp: Option<String>,
    /// Unit of the numbers, such as `mm`, `inch` or `counts`; by default that of the name, else SI.
    unit: Option<String>,
    /// Factor on the numbers in their unit; -1 turns a sign round. A unit of another kind needs
    /// one, such as N per A.
    scale: Option<f64>,
    /// What is added after the factor, in SI units.
    offset: Option<f64>,
    /// Column that is taken away first.
    minus: Option<String>,
    /// Its unit; by default that of the signal.
    minus_unit: Option<String>,
    /// Second column of a time, such as its nanoseconds, that is added.
    plus: Option<String>,
    /// Its unit.
    plus_unit: Option<String>,
}

impl Mapping {
    /// Reads a mapping file.
    pub fn load(path: &Path) -> Result<Self, SignalError> {
        let text = text_file::read(path).map_err(|e| BagError::reading(path, e))?;
        Self::from_yaml(&text, &path.display().to_string())
    }

    /// Reads a mapping; `origin` names the text in errors.
    pub fn from_yaml(text: &str, origin: &str) -> Result<Self, SignalError> {
        let file: MappingFile = yaml::read(text)
            .map_err(|problem| Keys { origin, above: String::new() }.wrong("the file", problem))?;
        let mapping = file.mapping(origin)?;
        Ok(Mapping { unconfirmed: marks(text), ..mapping })
    }
}

/// Where the comment of a line of YAML begins: with a `#` at its begin or behind a blank, and not
/// between quotes.
fn comment_of(line: &str) -> Option<usize> {
    let (mut quote, mut before, mut escaped) = (None, ' ', false);
    for (at, c) in line.char_indices() {
        match (c, quote) {
            _ if escaped => {}
            ('#', None) if before.is_whitespace() => return Some(at),
            ('"' | '\'', None) if " {[,:".contains(before) => quote = Some(c),
            (c, Some(open)) if c == open => quote = None,
            _ => {}
        }
        escaped = c == '\\' && quote == Some('"') && !escaped;
        before = c;
    }
    None
}

/// What the comments of a proposed mapping mark for a person to check, each with its key.
fn marks(text: &str) -> Vec<String> {
    let mark = |line: &str| {
        let (before, comment) = line.split_at(comment_of(line)?);
        let check = comment.trim_start_matches(['#', ' ']).strip_prefix("CHECK")?;
        let check = check.trim_start_matches([':', ' ']);
        let key = before.split(':').next().unwrap_or_default().trim();
        Some(if key.is_empty() { check.to_owned() } else { format!("{key}: {check}") })
    };
    text.lines().filter_map(mark).collect()
}

/// Where in the file a key stands, for errors.
struct Keys<'a> {
    origin: &'a str,
    above: String,
}

impl Keys<'_> {
    fn wrong(&self, key: &str, reason: impl Into<String>) -> SignalError {
        SignalError::Mapping {
            origin: self.origin.into(),
            key: format!("{}{key}", self.above),
            reason: reason.into(),
        }
    }
}

impl MappingFile {
    fn mapping(mut self, origin: &str) -> Result<Mapping, SignalError> {
        let keys = Keys { origin, above: String::new() };
        let join = std::mem::take(&mut self.join);
        let joint_type = self.joint_type;
        let mut mapping = self.of_one_recording(&keys)?;
        mapping.joint_type = joint_type.or(mapping.joint_type);
        let has = |signal: Signal| mapping.signals.contains_key(&signal);
        match (has(Signal::Position), has(Signal::Velocity)) {
            (false, false) => {
                let reason = "it is missing: without a position, or a velocity, there is nothing \
                              to look at";
                return Err(keys.wrong("signals.position", reason));
            }
            (true, true) => {
                let reason =
                    "a velocity is integrated where there is no position: give one of them";
                return Err(keys.wrong("signals.velocity", reason));
            }
            _ => {}
        }
        for (index, other) in join.into_iter().enumerate() {
            let keys = Keys { origin, above: format!("join[{index}].") };
            let joined = other.joined(&keys)?;
            for signal in joined.mapping.signals.keys().filter(|s| **s != Signal::Time) {
                let key = format!("signals.{signal}");
                if [Signal::Position, Signal::Velocity].contains(signal) {
                    let reason = "the motion is that of the recording itself: give the file with \
                                  it to the command, and join the other one";
                    return Err(keys.wrong(&key, reason));
                }
                let others = mapping.join.iter().map(|other| &other.mapping);
                let mut earlier = std::iter::once(&mapping).chain(others);
                if earlier.any(|mapping| mapping.signals.contains_key(signal)) {
                    return Err(keys.wrong(&key, "it is mapped twice: give one place"));
                }
            }
            if let (Some(first), Some(second)) = (mapping.joint_type, joined.mapping.joint_type)
                && first != second
            {
                let reason = format!(
                    "by its units the joint is {}, in the recording it is {}",
                    second.name(),
                    first.name()
                );
                return Err(keys.wrong("signals", reason));
            }
            mapping.without_force_constant |= joined.mapping.without_force_constant;
            mapping.join.push(joined);
        }
        Ok(mapping)
    }

    fn of_one_recording(self, keys: &Keys) -> Result<Mapping, SignalError> {
        if let Some(rate) = self.rate
            && !(rate.is_finite() && rate > 0.0)
        {
            return Err(keys.wrong("rate", format!("it is {rate} Hz, must be greater than 0")));
        }
        let mut mapping = Mapping {
            joint: self.joint,
            rate: self.rate,
            csv: self.csv.map(|csv| csv.layout(keys)).transpose()?.unwrap_or_default(),
            asked_for: true,
            ..Mapping::empty()
        };
        let stamp = self.stamp.as_deref().map_or(Stamp::Auto, stamp);
        let mut joints = JointsOfUnits::default();
        for (name, entry) in self.signals {
            let key = format!("signals.{name}");
            let is_current = name == CURRENT;
            let known = Signal::MAPPED.into_iter().find(|s| s.name() == name);
            let signal = known.or(is_current.then_some(Signal::Force)).ok_or_else(|| {
                let names = || Signal::MAPPED.iter().map(|s| s.name()).chain([CURRENT]);
                let reason = format!(
                    "signals are {}{}",
                    names().collect::<Vec<_>>().join(", "),
                    nearest(&name, names())
                );
                keys.wrong(&key, reason)
            })?;
            if signal == Signal::Force && mapping.signals.contains_key(&signal) {
                let reason = "a current counts as the force: give one of them";
                return Err(keys.wrong("signals.current", reason));
            }
            mapping.without_force_constant |= is_current && entry.scale.is_none();
            let wrong = |reason: String| keys.wrong(&key, reason);
            let unit = entry.unit(&name, signal, is_current, &wrong)?;
            if let Some(unit) = unit {
                joints.take(signal, unit, entry.scale);
            }
            let source = entry.source(signal, unit, &stamp, mapping.csv.header, &wrong)?;
            mapping.signals.insert(signal, vec![source]);
        }
        if let Some((first, second)) = joints.contradiction() {
            let reason = format!(
                "{} is in {}, {} in {}: one joint does not move along and turn; give one of them \
                 the `scale` of the gear or spindle (rad per m, or m per rad)",
                first.0, first.1.name, second.0, second.1.name
            );
            return Err(keys.wrong(&format!("signals.{}", second.0), reason));
        }
        mapping.joint_type = joints.joint();
        let is_column = |source: &&SignalSource| matches!(source.place, Place::Column(_));
        let columns = mapping.signals.values().flatten().filter(is_column).count();
        if columns != 0 && columns != mapping.signals.len() {
            let reason = "some are topics and some columns: a recording is either a bag or a \
                          table; `join` the other one";
            return Err(keys.wrong("signals", reason));
        }
        Ok(mapping)
    }
}

impl JoinFile {
    fn joined(self, keys: &Keys) -> Result<Joined, SignalError> {
        let is_plain = |part: Component| matches!(part, Component::Normal(_) | Component::CurDir);
        if self.file.as_os_str().is_empty() || !self.file.components().all(is_plain) {
            let reason = format!(
                "it is {:?}, must be in the directory of the recording or below it: a relative \
                 path without `..`",
                self.file.display().to_string()
            );
            return Err(keys.wrong("file", reason));
        }
        let clock_offset = self.clock_offset.unwrap_or(0.0);
        // Where times are dates, 1970 is 0; what is further away than that is no clock.
        if !clock_offset.is_finite() || clock_offset.abs() >= 1e10 {
            let reason = format!("it is {clock_offset} s, must be a time in s");
            return Err(keys.wrong("clock_offset", reason));
        }
        let file = MappingFile {
            joint: self.joint,
            joint_type: None,
            stamp: self.stamp,
            rate: self.rate,
            csv: self.csv,
            signals: self.signals,
            join: Vec::new(),
        };
        let mapping = file.of_one_recording(keys)?;
        if mapping.signals.keys().all(|signal| *signal == Signal::Time) {
            return Err(keys.wrong("signals", "none is wanted from it: name one, or leave it out"));
        }
        Ok(Joined { file: self.file, clock_offset, mapping })
    }
}

impl CsvFile {
    fn layout(self, keys: &Keys) -> Result<CsvLayout, SignalError> {
        let byte = |key: &str, text: &str| match text.as_bytes() {
            [byte] => Ok(*byte),
            _ => Err(keys.wrong(key, format!("it is {text:?}, must be one ASCII character"))),
        };
        let layout = CsvLayout {
            delimiter: match self.delimiter.as_deref() {
                None => None,
                Some("blanks" | "whitespace") => Some(Delimiter::Blanks),
                Some("tab" | "tabs") => Some(Delimiter::Byte(b'\t')),
                Some(text) => Some(Delimiter::Byte(byte("csv.delimiter", text)?)),
            },
            header: self.header,
            comment: self.comment.as_deref().map(|text| byte("csv.comment", text)).transpose()?,
            decimal_comma: self.decimal_comma,
            names_line: self.names_in_line,
            data_line: self.data_from_line,
            missing: self.missing.iter().map(|word| word.trim().to_owned()).collect(),
        };
        for (key, line) in
            [("names_in_line", layout.names_line), ("data_from_line", layout.data_line)]
        {
            if line == Some(0) {
                return Err(keys.wrong(&format!("csv.{key}"), "lines are counted from 1"));
            }
        }
        if layout.decimal_comma == Some(true) && layout.delimiter == Some(Delimiter::Byte(b',')) {
            let reason = "the comma also separates columns: give another `delimiter`";
            return Err(keys.wrong("csv.decimal_comma", reason));
        }
        if let (Some(names), Some(data)) = (layout.names_line, layout.data_line)
            && names >= data
        {
            let reason = format!("it is {names}, but the values begin in line {data}");
            return Err(keys.wrong("csv.names_in_line", reason));
        }
        Ok(layout)
    }
}

impl SignalFile {
    /// The unit, which must be one of the signal unless a scale makes it one.
    fn unit(
        &self,
        name: &str,
        signal: Signal,
        is_current: bool,
        wrong: &dyn Fn(String) -> SignalError,
    ) -> Result<Option<Unit>, SignalError> {
        let Some(written) = &self.unit else { return Ok(None) };
        let unit = Unit::named(written).ok_or_else(|| {
            let names = signal.unit_names();
            wrong(format!(
                "unit `{written}` is not known: for {name} it is one of {names}; for others leave \
                 it out and give the `scale` to SI"
            ))
        })?;
        let is_of_signal = signal.has_dimension(unit.dimension);
        let is_plain_current = is_current && unit.dimension == Dimension::Current;
        if !is_of_signal && !is_plain_current && self.scale.is_none() {
            return Err(wrong(format!(
                "unit `{}` is none of {name} itself: give the `scale` that makes it one, in SI \
                 units per {}",
                unit.name, unit.name
            )));
        }
        Ok(Some(unit))
    }

    fn source(
        self,
        signal: Signal,
        unit: Option<Unit>,
        stamp: &Stamp,
        header: Option<bool>,
        wrong: &dyn Fn(String) -> SignalError,
    ) -> Result<SignalSource, SignalError> {
        let column = |text: String| match text.parse::<usize>() {
            Ok(0) => Err(wrong("columns are counted from 1".into())),
            Ok(number) => Ok(Column::Number(number)),
            Err(_) if header != Some(false) => Ok(Column::Name(text)),
            Err(_) => Err(wrong(format!(
                "column {text:?}: without a line of names give its number, from 1"
            ))),
        };
        if self.minus.is_some() && (self.column.is_none() || signal == Signal::Time) {
            let reason = "`minus` takes a column from another one: it needs `column`, and is not \
                          for times";
            return Err(wrong(reason.into()));
        }
        let minus_unit = self.minus_unit.as_deref().map(|written| {
            Unit::named(written)
                .filter(|of| unit.is_some_and(|unit| unit.dimension == of.dimension))
                .ok_or_else(|| {
                    let written = format!("`minus_unit` is `{written}`, must be one of the same ");
                    wrong(written + "kind as `unit`")
                })
        });
        let minus_unit = minus_unit.transpose()?;
        if minus_unit.is_some() && self.minus.is_none() {
            return Err(wrong("`minus_unit` is the unit of the column of `minus`".into()));
        }
        let size = minus_unit.zip(unit).map_or(1.0, |(of, unit)| of.size / unit.size);
        let minus = self.minus.map(column).transpose()?.map(|column| Minus { column, size });
        let plus = match (self.plus, self.plus_unit.as_deref()) {
            (None, None) => None,
            (Some(added), Some(unit)) if signal == Signal::Time && self.column.is_some() => {
                let unit = Unit::named(unit).filter(|unit| unit.dimension == Dimension::Time);
                let unit = unit.ok_or_else(|| wrong("`plus_unit` must be one of time".into()))?;
                Some(Plus { column: column(added)?, unit: unit.size })
            }
            _ => {
                let reason = "`plus` adds a column of times to another one, as in `time: {column: \
                              sec, plus: nanosec, plus_unit: ns}`";
                return Err(wrong(reason.into()));
            }
        };
        let place = match (self.topic, self.field, self.column) {
            (Some(topic), Some(field), None) if signal != Signal::Time => Place::Topic {
                topic,
                field,
                stamp: self.stamp.as_deref().map_or(stamp.clone(), self::stamp),
            },
            (None, None, Some(text)) => Place::Column(column(text)?),
            (Some(_), _, None) if signal == Signal::Time => {
                let reason = "the messages of a bag have stamps: say which with `stamp`";
                return Err(wrong(reason.into()));
            }
            _ => {
                let reason = "it needs `topic` and `field` (in a bag) or `column` (a name, or a \
                              number from 1)";
                return Err(wrong(reason.into()));
            }
        };
        let (scale, offset) = (self.scale, self.offset.unwrap_or(0.0));
        let factor = scale.unwrap_or(1.0);
        if !factor.is_finite() || factor == 0.0 || !offset.is_finite() {
            let reason = format!("scale {factor} and offset {offset}: both finite, scale not 0");
            return Err(wrong(reason));
        }
        // Whoever gives a scale knows the unit.
        let unit = unit.map(|unit| unit.size).or(scale.map(|_| 1.0));
        Ok(SignalSource { place, unit, scale, offset, minus, plus })
    }
}

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
