//! Proposes a mapping for a table, of text or of arrays.
//!
//! In goes a file; out comes a [`Proposal`]: what it looks like, and which column is likely which
//! signal, by its unit, its name, or the way it moves. What the file does not say is marked, for a
//! person to check.

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

use super::array_table::{self, is_array_file};
use super::arrays::ArrayFile;
use super::error::SignalError;
use super::mapping::{CsvLayout, Signal};
use super::text_layout::{TextLayout, bare_unit};
use super::text_lines::Splitter;
use super::text_value::{Decimal, Value};
use super::unit::{Dimension, Unit};
use crate::bag::{BagError, is_recording};
use friction_stage_core::model::JointType;

/// What to check where no column is a time.
const NO_TIME_COLUMN: &str = "rows per second; no column is a time";

/// Rows that are looked at.
const LOOKED_AT: usize = 20_000;

/// A column as the file shows it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TableColumn {
    /// Number, from 1.
    pub number: usize,
    /// Name; empty where the file gives none.
    pub name: String,
    /// Unit as the file writes it; empty where it gives none.
    pub unit: String,
    /// Smallest value, in that unit; absent for words and times of day.
    pub smallest: Option<f64>,
    /// Largest value.
    pub largest: Option<f64>,
    /// Which signal it is likely, if any.
    pub signal: Option<Signal>,
}

/// A signal that is proposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposedSignal {
    /// The signal.
    pub signal: Signal,
    /// Number of its column, from 1.
    pub column: usize,
    /// Number of a column that is to be taken from it, from 1.
    pub minus: Option<usize>,
    /// Whether it is a current, which a mapping calls so.
    pub is_current: bool,
    /// Unit for the mapping, if the file says a known one.
    pub unit: Option<String>,
    /// Factor for the mapping, where it needs one that the file does not say.
    pub scale: Option<f64>,
    /// What a person has to check, if anything.
    pub check: Option<String>,
}

/// What a table looks like, and a mapping for it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    /// `text`, or how arrays are stored: `npy`, `npz`, `mat`, `mat 7.3`.
    pub format: &'static str,
    /// What of a file of arrays makes no column of this table: words, arrays of other lengths.
    pub not_used: Vec<String>,
    /// What separates columns; empty for arrays.
    pub delimiter: String,
    /// Whether numbers have a decimal comma.
    pub decimal_comma: bool,
    /// Whether the numbers could be read the other way, too.
    pub either_decimal: bool,
    /// Line of the names, from 1.
    pub names_line: Option<u64>,
    /// Line of the units, from 1.
    pub units_line: Option<u64>,
    /// First line of values, from 1; 0 for arrays.
    pub data_line: u64,
    /// Rows that were looked at.
    pub rows: usize,
    /// Rows per second of the time column, Hz.
    pub rate_hz: Option<f64>,
    /// The columns.
    pub columns: Vec<TableColumn>,
    /// The signals.
    pub signals: Vec<ProposedSignal>,
}

/// The values of a column, and whether some are dates or times of day.
struct Samples {
    values: Vec<f64>,
    is_clock: bool,
}

impl Samples {
    fn has_values(&self) -> bool {
        self.values.iter().any(|value| value.is_finite())
    }
}

/// The unit that a name ends with: `t_ms`, or `x/mm` (a quantity over its unit, as DIN 1313 has
/// it); empty where it has none.
fn unit_of_name(name: &str) -> &str {
    // Without the index of a column of an array.
    let name = name.split(['[', '(']).next().unwrap_or_default().trim();
    let is_unit = |text: &str| Unit::named(text).is_some();
    if is_unit(name) {
        return "";
    }
    let over = name.split_once('/').map(|(quantity, unit)| (quantity.trim(), unit.trim()));
    let quantity_over_unit = over.filter(|(quantity, unit)| {
        !quantity.is_empty() && !quantity.contains(' ') && !is_unit(quantity) && is_unit(unit)
    });
    let behind = name.rsplit_once('_').filter(|(_, unit)| is_unit(unit));
    quantity_over_unit.or(behind).map_or("", |(_, unit)| unit)
}

/// Of a table without names: where one column is left that moves, and no force was found, it is
/// the force, for a person to check.
fn the_only_column_left(
    signals: &[ProposedSignal],
    columns: &mut [TableColumn],
) -> Option<ProposedSignal> {
    let is_found = |signal: Signal| signals.iter().any(|found| found.signal == signal);
    let has_names = columns.iter().any(|column| !column.name.is_empty());
    if has_names || !is_found(Signal::Position) || is_found(Signal::Force) {
        return None;
    }
    let mut left = columns
        .iter_mut()
        .filter(|column| column.signal.is_none() && column.smallest < column.largest);
    let (column, None) = (left.next()?, left.next()) else { return None };
    column.signal = Some(Signal::Force);
    Some(ProposedSignal {
        signal: Signal::Force,
        column: column.number,
        minus: None,
        is_current: false,
        unit: Some(Signal::Force.si_unit(joint_of(signals)).to_owned()),
        scale: None,
        check: Some("the only column that is left; is it the force, and its unit?".to_owned()),
    })
}

impl Proposal {
    /// Looks at the file at `path`.
    ///
    /// # Errors
    /// It cannot be read, or holds no table of numbers.
    pub fn of(path: &Path) -> Result<Proposal, SignalError> {
        Self::beside(path, &[])
    }

    /// Looks at a file with further signals of the same motion, which is in others that have the
    /// signals `taken`.
    ///
    /// # Errors
    /// As of [`Proposal::of`].
    pub fn beside(path: &Path, taken: &[Signal]) -> Result<Proposal, SignalError> {
        if is_recording(path) {
            return Err(SignalError::IsRecording { path: path.to_owned() });
        }
        if is_array_file(path) { Self::of_arrays(path, taken) } else { Self::of_text(path, taken) }
    }

    fn of_text(path: &Path, taken: &[Signal]) -> Result<Proposal, SignalError> {
        let reading = |error| BagError::reading(path, error);
        let layout = TextLayout::find(path, &CsvLayout::default()).map_err(reading)?;
        let samples = samples(path, &layout).map_err(reading)?;
        if samples.first().is_none_or(|column| column.values.is_empty()) {
            return Err(SignalError::Csv {
                path: path.to_owned(),
                line: layout.data_line,
                reason: "no rows of numbers were found".into(),
            });
        }
        let named = |texts: &[String]| -> Vec<String> {
            (0..samples.len()).map(|at| texts.get(at).cloned().unwrap_or_default()).collect()
        };
        let (names, units) = (named(&layout.names), named(&layout.units));
        Ok(Proposal {
            format: "text",
            not_used: Vec::new(),
            delimiter: layout.delimiter.to_string(),
            decimal_comma: layout.decimal == Decimal::Comma,
            either_decimal: layout.either_decimal,
            names_line: layout.names_line,
            units_line: layout.units_line,
            data_line: layout.data_line,
            ..Self::of_columns(&names, &units, &samples, taken)
        })
    }

    /// Of a file of arrays, those of the length that a time has, or that most of them have.
    fn of_arrays(path: &Path, taken: &[Signal]) -> Result<Proposal, SignalError> {
        let file = ArrayFile::open(path)?;
        let is_time = |name: &str| words(name).iter().any(|word| TIME.contains(&word.as_str()));
        let times = |length: u64| {
            file.columns.iter().filter(|c| c.length == length && is_time(&c.name)).count()
        };
        let count = |length: u64| file.columns.iter().filter(|c| c.length == length).count();
        let lengths = file.columns.iter().map(|column| column.length).filter(|length| *length > 1);
        let longest = lengths
            .max_by_key(|length| (times(*length).min(1), count(*length), *length))
            .ok_or_else(|| SignalError::Array {
                path: path.to_owned(),
                reason: match file.others(0).as_slice() {
                    [] => "it holds no arrays".into(),
                    others => format!("no array of numbers; it has {}", others.join(", ")),
                },
            })?;
        let columns: Vec<usize> =
            (0..file.columns.len()).filter(|at| file.columns[*at].length == longest).collect();
        let samples: Vec<Samples> = array_table::samples(&file, &columns, LOOKED_AT)?
            .into_iter()
            .map(|(values, is_clock)| Samples { values, is_clock })
            .collect();
        let names: Vec<String> = columns.iter().map(|at| file.columns[*at].name.clone()).collect();
        Ok(Proposal {
            format: file.format.name(),
            not_used: file.others(longest),
            ..Self::of_columns(&names, &vec![String::new(); names.len()], &samples, taken)
        })
    }

    /// Which of these columns are which signals; says nothing of the file.
    fn of_columns(
        names: &[String],
        units: &[String],
        samples: &[Samples],
        taken: &[Signal],
    ) -> Proposal {
        let rows = samples.first().map_or(0, |column| column.values.len());
        let units = |column: usize| match bare_unit(&units[column]) {
            "" => unit_of_name(&names[column]),
            written => written,
        };
        let mut columns: Vec<TableColumn> = names
            .iter()
            .enumerate()
            .map(|(index, name)| {
                let finite = || samples[index].values.iter().copied().filter(|v| v.is_finite());
                let has_values = finite().next().is_some() && !samples[index].is_clock;
                TableColumn {
                    number: index + 1,
                    name: name.clone(),
                    unit: units(index).to_owned(),
                    smallest: has_values.then(|| finite().fold(f64::INFINITY, f64::min)),
                    largest: has_values.then(|| finite().fold(f64::NEG_INFINITY, f64::max)),
                    signal: None,
                }
            })
            .collect();
        let mut signals = Vec::new();
        let has_values = |column: &TableColumn| samples[column.number - 1].has_values();
        let first = columns.iter().find(|column| has_values(column)).map(|column| column.number);
        for signal in [
            Signal::Time,
            Signal::Position,
            Signal::Velocity,
            Signal::ReferencePosition,
            Signal::ReferenceVelocity,
            Signal::ForceCell,
            Signal::Force,
        ] {
            let has_position = |found: &ProposedSignal| found.signal == Signal::Position;
            let is_moving = !taken.is_empty() || signals.iter().any(has_position);
            let is_motion = signal == Signal::Velocity && is_moving
                || signal == Signal::Position && !taken.is_empty();
            if is_motion || taken.contains(&signal) {
                continue;
            }
            let free = columns.iter().filter(|column| column.signal.is_none());
            let best = free
                .map(|column| {
                    let is_first = Some(column.number) == first;
                    let as_signal =
                        |signal| likeness(signal, column, is_first, &samples[column.number - 1]);
                    let best = match signal {
                        // Where the command is known, another force is a measured one.
                        Signal::ForceCell if taken.contains(&Signal::Force) => {
                            as_signal(Signal::ForceCell).max(as_signal(Signal::Force))
                        }
                        signal => as_signal(signal),
                    };
                    (best, column.number)
                })
                .filter(|(likeness, _)| *likeness > 0.0)
                .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
            if let Some((_, number)) = best {
                let column = &mut columns[number - 1];
                column.signal = Some(signal);
                let joint = joint_of(&signals);
                signals.push(proposed(signal, column, &samples[number - 1], joint));
            }
        }
        if taken.is_empty() {
            signals.extend(the_only_column_left(&signals, &mut columns));
            signals.extend(from_following_error(&signals, &mut columns));
        }
        let time = signals.iter().find(|found| found.signal == Signal::Time);
        let rate_hz = time.and_then(|time| {
            let unit = time.unit.as_deref().and_then(Unit::named).map_or(1.0, |unit| unit.size);
            let rate = 1.0 / (unit * usual_step(&samples[time.column - 1].values)?.abs());
            rate.is_finite().then_some(rate)
        });
        Proposal {
            format: "",
            not_used: Vec::new(),
            delimiter: String::new(),
            decimal_comma: false,
            either_decimal: false,
            names_line: None,
            units_line: None,
            data_line: 0,
            rows,
            rate_hz,
            columns,
            signals,
        }
    }

    /// Whether it is of a file of arrays.
    pub fn is_of_arrays(&self) -> bool {
        self.format != "text"
    }

    /// What a person has to check, each with what it is about.
    pub fn checks(&self) -> Vec<(&'static str, &str)> {
        let has_time = self.signals.iter().any(|found| found.signal == Signal::Time);
        let rate = (!has_time).then_some(("rate", NO_TIME_COLUMN));
        let of_signals = self.signals.iter().filter_map(|found| {
            let check = found.check.as_deref()?;
            Some((found.signal.name(), check))
        });
        rate.into_iter().chain(of_signals).collect()
    }

    /// Whether there is a position or a velocity, without which a mapping is none.
    pub fn has_motion(&self) -> bool {
        let motion = [Signal::Position, Signal::Velocity];
        self.signals.iter().any(|found| motion.contains(&found.signal))
    }

    /// A column as a mapping names it: by its name where no other has it, else by its number.
    fn place(&self, number: usize) -> String {
        let name = &self.columns[number - 1].name;
        let again = self.columns.iter().filter(|other| other.name == *name).count() > 1;
        let is_named = self.is_of_arrays() || self.names_line.is_some() && !again;
        if name.is_empty() || !is_named {
            number.to_string()
        } else {
            // A string of JSON is one of YAML.
            serde_json::Value::from(name.as_str()).to_string()
        }
    }

    /// The signals but for the time.
    pub fn recorded(&self) -> impl Iterator<Item = Signal> {
        self.signals.iter().map(|found| found.signal).filter(|signal| *signal != Signal::Time)
    }

    /// The mapping file, with what to check in comments. `joined` are other recordings of the same
    /// motion, with their paths from the directory of `file` on.
    pub fn to_yaml(&self, file: &str, joined: &[(String, Proposal)]) -> String {
        let mut text = format!(
            "# Proposed for {file}. What it does not say itself is marked CHECK.\n\
             # Positive is along +x; `scale: -1` turns a signal round.\n{}",
            self.table_yaml()
        );
        if !joined.is_empty() {
            text += "join:\n";
        }
        for (path, other) in joined {
            let check = match self.has_dates() && other.has_dates() {
                true => "s, added to its times",
                false => "CHECK: s, added to its times; 0 takes both clocks as one",
            };
            let path = serde_json::Value::from(path.as_str());
            let _ = writeln!(text, "  - file: {path}\n    clock_offset: 0   # {check}");
            for line in other.table_yaml().lines() {
                let _ = writeln!(text, "    {line}");
            }
        }
        text
    }

    /// Whether its times are dates or times of day, which are of the same clock in every file.
    pub fn has_dates(&self) -> bool {
        let time = self.signals.iter().find(|found| found.signal == Signal::Time);
        time.is_some_and(|time| self.columns[time.column - 1].smallest.is_none())
    }

    /// The part of a mapping that is of this table.
    fn table_yaml(&self) -> String {
        let mut text = String::new();
        if !self.is_of_arrays() {
            self.write_layout(&mut text);
        }
        self.write_signals(&mut text);
        text
    }

    /// How a text is written.
    fn write_layout(&self, text: &mut String) {
        let delimiter = match self.delimiter.as_str() {
            quoted if quoted.starts_with('`') => quoted.trim_matches('`').to_owned(),
            word => word.to_owned(),
        };
        let names = match self.names_line {
            Some(line) => format!("names_in_line: {line}"),
            None => "header: false".to_owned(),
        };
        // Files of one logger differ in the lines above the names: the mapping is for all of them.
        let _ = writeln!(
            text,
            "# As it is found in each file, unless a line as this one says it:\n\
             # csv: {{delimiter: \"{delimiter}\", decimal_comma: {}, {names}, data_from_line: {}}}",
            self.decimal_comma, self.data_line
        );
        if self.either_decimal {
            let _ = writeln!(
                text,
                "csv: {{decimal_comma: {}}}   # CHECK: or true?",
                self.decimal_comma
            );
        }
    }

    fn write_signals(&self, text: &mut String) {
        if !self.signals.iter().any(|found| found.signal == Signal::Time) {
            let _ = writeln!(text, "rate: 1000   # CHECK: {NO_TIME_COLUMN}");
        }
        *text += "signals:\n";
        for found in &self.signals {
            let place = self.place(found.column);
            let minus = found
                .minus
                .map_or(String::new(), |column| format!(", minus: {}", self.place(column)));
            let quoted =
                |unit: &String| format!(", unit: {}", serde_json::Value::from(unit.as_str()));
            let unit = found.unit.as_ref().map_or(String::new(), quoted);
            let scale = found.scale.map_or(String::new(), |scale| format!(", scale: {scale}"));
            let check = found.check.as_ref().map_or(String::new(), |c| format!("   # CHECK: {c}"));
            let name = if found.is_current { "current" } else { found.signal.name() };
            let _ = writeln!(text, "  {name}: {{column: {place}{minus}{unit}{scale}}}{check}");
        }
        let others: Vec<String> = self
            .columns
            .iter()
            .filter(|column| column.signal.is_none())
            .map(|column| match column.name.as_str() {
                "" => column.number.to_string(),
                name => name.to_owned(),
            })
            .chain(self.not_used.iter().cloned())
            .collect();
        if !others.is_empty() {
            let _ = writeln!(text, "# Not used: {}", others.join(", "));
        }
    }
}

/// Without a position, but with a reference and a following error: the one less the other.
fn from_following_error(
    signals: &[ProposedSignal],
    columns: &mut [TableColumn],
) -> Option<ProposedSignal> {
    const ERROR: &[&str] = &["error", "err", "deviation", "lag", "following"];
    let found = |signal: Signal| signals.iter().find(|found| found.signal == signal);
    if found(Signal::Position).or(found(Signal::Velocity)).is_some() {
        return None;
    }
    let reference = found(Signal::ReferencePosition)?;
    let is_error = |column: &&mut TableColumn| {
        column.signal.is_none()
            && column.smallest < column.largest
            && words(&column.name).iter().any(|word| ERROR.contains(&word.as_str()))
    };
    let error = columns.iter_mut().find(is_error)?;
    error.signal = Some(Signal::Position);
    let sign = "the reference less the error; its sign?".to_owned();
    Some(ProposedSignal {
        signal: Signal::Position,
        minus: Some(error.number),
        check: Some(reference.check.as_ref().map_or(sign.clone(), |unit| format!("{sign} {unit}"))),
        ..reference.clone()
    })
}

/// The columns of the first rows. Times are in s since the first row.
fn samples(path: &Path, layout: &TextLayout) -> std::io::Result<Vec<Samples>> {
    let mut lines = layout.rows(path)?;
    let mut row = Splitter::new(layout.delimiter);
    let mut columns: Vec<Samples> =
        (0..layout.columns).map(|_| Samples { values: Vec::new(), is_clock: false }).collect();
    let mut begins: Vec<Option<i64>> = vec![None; layout.columns];
    while let Some((_, line)) = lines.next()? {
        row.split(line);
        let values: Vec<Value> = row.fields().map(|f| Value::of(f, layout.decimal)).collect();
        if values.len() < layout.columns || !values.iter().any(Value::is_value) {
            continue;
        }
        for ((value, column), begin) in values.iter().zip(&mut columns).zip(&mut begins) {
            column.values.push(match value {
                Value::Number { value, .. } => *value,
                Value::Time { nanoseconds, .. } => {
                    column.is_clock = true;
                    let since = nanoseconds - *begin.get_or_insert(*nanoseconds);
                    since as f64 * 1e-9
                }
                Value::Missing | Value::Text => f64::NAN,
            });
        }
        if columns.first().is_some_and(|column| column.values.len() >= LOOKED_AT) {
            break;
        }
    }
    Ok(columns)
}

/// Words of a name, in small letters: `posActual_mm` has pos, actual, mm.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before = ' ';
    for c in name.chars() {
        let begins = c.is_uppercase() && before.is_lowercase();
        if !c.is_alphabetic() || begins {
            words.push(String::new());
        }
        if c.is_alphabetic() {
            words.last_mut().into_iter().for_each(|word| word.extend(c.to_lowercase()));
        }
        before = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

const TIME: &[&str] = &["t", "time", "timestamp", "stamp", "zeit", "temps", "clock", "secs"];
const POSITION: &[&str] = &[
    "x",
    "q",
    "qm",
    "pos",
    "position",
    "encoder",
    "enc",
    "displacement",
    "travel",
    "lage",
    "weg",
    "istposition",
    "posn",
];
const VELOCITY: &[&str] = &["v", "vel", "velocity", "speed", "geschwindigkeit", "drehzahl"];
const CURRENT: &[&str] =
    &["current", "curr", "iq", "strom", "courant", "amp", "amps", "ampere", "amperes"];
const FORCE: &[&str] = &[
    "f",
    "u",
    "force",
    "torque",
    "effort",
    "current",
    "curr",
    "iq",
    "kraft",
    "moment",
    "strom",
    "drehmoment",
    "thrust",
    "trq",
    "i",
    "motor",
];
const CELL: &[&str] = &["cell", "loadcell", "kraftsensor", "dynamometer", "fx"];
const REFERENCE: &[&str] = &[
    "set",
    "setpoint",
    "sp",
    "ref",
    "reference",
    "cmd",
    "command",
    "commanded",
    "demand",
    "demanded",
    "desired",
    "target",
    "soll",
    "sollposition",
    "nominal",
    "qg",
];
const NO_SIGNAL: &[&str] =
    &["error", "err", "deviation", "lag", "following", "status", "temperature"];

/// The words of a name that say which quantity it is: single letters do only where no longer word
/// does, and of these the first one, as in `F_x`.
fn quantity_of(words: &[String]) -> Vec<&str> {
    let known = |word: &str| {
        [TIME, POSITION, VELOCITY, CURRENT, FORCE, CELL].iter().any(|list| list.contains(&word))
    };
    let is_letter = |word: &&str| word.chars().count() == 1;
    let all: Vec<&str> = words.iter().map(String::as_str).collect();
    let by_word = all.iter().any(|word| !is_letter(word) && known(word));
    let letter = all.iter().position(|word| is_letter(word) && known(word)).filter(|_| !by_word);
    let says = |(at, word): (usize, &&str)| !is_letter(word) || Some(at) == letter;
    all.iter().enumerate().filter(|place| says(*place)).map(|(_, word)| *word).collect()
}

/// How much a column looks like a signal; 0: not at all. By its unit, its name, how it moves.
/// `is_first`: whether it is the first column with values.
fn likeness(signal: Signal, column: &TableColumn, is_first: bool, samples: &Samples) -> f64 {
    let words = words(&column.name);
    let quantity = quantity_of(&words);
    let has = |known: &[&str]| quantity.iter().any(|word| known.contains(word));
    let unit = column.unit.as_str();
    let dimension = Unit::named(unit).map(|unit| unit.dimension);
    let has_unit = |of: Signal| dimension.is_some_and(|dimension| of.has_dimension(dimension));
    let is_named = |named: bool| f64::from(u8::from(named));
    let moves = column.smallest < column.largest;
    let other = has(NO_SIGNAL);
    match signal {
        Signal::Time => {
            let is_monotone = increases(&samples.values) || has(TIME) && falls(&samples.values);
            let score = 2.0 * is_named(samples.is_clock)
                + is_named(has(TIME) || has_unit(Signal::Time))
                + 0.5 * is_named(is_uniform(&samples.values));
            if is_monotone && (score >= 1.0 || is_first) { score } else { 0.0 }
        }
        Signal::Position if moves && !other && !has(REFERENCE) && !has(VELOCITY) && !has(FORCE) => {
            let score = 2.0 * is_named(has_unit(signal)) + 2.0 * is_named(has(POSITION));
            let counts = is_named(Unit::named(unit).is_some_and(|unit| unit.name == "count"));
            let smooth =
                is_named(unit.is_empty() && words.is_empty() && is_smooth(&samples.values));
            score + counts + 0.5 * smooth
        }
        Signal::Velocity if moves && !other && !has(REFERENCE) => {
            2.0 * is_named(has_unit(signal)) + 1.5 * is_named(has(VELOCITY))
        }
        Signal::ReferencePosition if moves && !other && has(REFERENCE) && !has(VELOCITY) => {
            2.0 * is_named(has_unit(signal)) + is_named(has(POSITION)) + 0.5 * is_named(!has(FORCE))
        }
        Signal::ReferenceVelocity if moves && !other && has(REFERENCE) && has(VELOCITY) => 1.0,
        Signal::ForceCell if moves && !other && has(CELL) => 1.0 + is_named(has_unit(signal)),
        Signal::Force if moves && !other && !has(VELOCITY) && !has(POSITION) => {
            let of_drive = [Dimension::Current, Dimension::Voltage, Dimension::Number];
            let drive = dimension.is_some_and(|dimension| of_drive.contains(&dimension));
            2.0 * is_named(has_unit(signal)) + 1.5 * is_named(has(FORCE)) + is_named(drive)
        }
        _ => 0.0,
    }
}

/// The joint type that the units of the signals up to here speak of.
fn joint_of(signals: &[ProposedSignal]) -> JointType {
    let units = signals.iter().filter_map(|found| Unit::named(found.unit.as_deref()?));
    units.filter_map(Unit::joint).next().unwrap_or_default()
}

/// Longest travel of a stage, m. Assumed.
const LONGEST_TRAVEL: f64 = 10.0;

/// The largest unit in which numbers that reach so far are the travel of a stage.
fn unit_of_travel(range: f64) -> &'static str {
    match range {
        range if range <= LONGEST_TRAVEL => "m",
        range if range * 1e-3 <= LONGEST_TRAVEL => "mm",
        _ => "um",
    }
}

/// The signal with its unit, and what the file does not say of it.
fn proposed(
    signal: Signal,
    column: &TableColumn,
    samples: &Samples,
    joint: JointType,
) -> ProposedSignal {
    let written = Some(column.unit.as_str()).filter(|unit| !unit.is_empty());
    let known = written.and_then(Unit::named);
    let names_current = || words(&column.name).iter().any(|word| CURRENT.contains(&word.as_str()));
    let is_current = signal == Signal::Force
        && known.map_or(written.is_none() && names_current(), |unit| {
            unit.dimension == Dimension::Current
        });
    // The first signal of the motion says what joint it is.
    let is_motion = [Signal::Position, Signal::Velocity].contains(&signal);
    let joint = known.and_then(Unit::joint).filter(|_| is_motion).unwrap_or(joint);
    let si = signal.si_unit(joint);
    let (unit, scale, check) = match known {
        None if signal == Signal::Time && samples.is_clock => (None, None, None),
        Some(unit) if unit.dimension == signal.dimension(joint) => (written, None, None),
        _ if signal == Signal::Time => {
            let unit = unit_of_epoch(&samples.values);
            let by_size = format!("{unit} by the size of its numbers");
            let order = if falls(&samples.values) {
                "; the newest row comes first: reverse the rows"
            } else {
                ""
            };
            (Some(unit), None, Some(by_size + order))
        }
        Some(_) if is_current => (written, None, Some(format!("give the `scale`, {si} per A"))),
        None if is_current => (Some("A"), None, Some(format!("A? And its `scale`, {si} per A"))),
        Some(Unit { name: "%", .. }) => {
            (written, Some(1.0), Some(format!("the `scale` is the {si} of 100 %")))
        }
        Some(unit) => {
            let per = unit.dimension.si();
            (written, Some(1.0), Some(format!("the `scale`, {si} per {per}")))
        }
        None => match written {
            Some(unit) => {
                (None, Some(1.0), Some(format!("it is in {unit}: its `scale`, {si} per {unit}")))
            }
            None => {
                let unit = match column.smallest.zip(column.largest) {
                    Some((low, high)) if si == "m" => unit_of_travel(high - low),
                    _ => si,
                };
                (Some(unit), None, Some(format!("the file gives no unit, {unit}?")))
            }
        },
    };
    let unit = unit.map(str::to_owned);
    ProposedSignal { signal, column: column.number, minus: None, is_current, unit, scale, check }
}

/// Unit of times, by how large they are: since 1970, days of a spreadsheet, else by their steps.
fn unit_of_epoch(values: &[f64]) -> &'static str {
    let first = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    let is_of_days = usual_step(values).is_some_and(|step| step < 1e-3);
    match first {
        // From 2001 to 2286 in each unit.
        first if (1e18..1e19).contains(&first) => "ns",
        first if (1e15..1e16).contains(&first) => "us",
        first if (1e12..1e13).contains(&first) => "ms",
        // From 1982 to 2119, counted from 1900.
        first if (30_000.0..80_000.0).contains(&first) && is_of_days => "d",
        // Assumed: a motion is sampled faster than once per second, so that steps of 1 and more
        // are in a smaller unit.
        _ => match usual_step(values).map_or(0.0, f64::abs) {
            step if step < 1.0 => "s",
            step if step < 1e3 => "ms",
            step if step < 1e6 => "us",
            _ => "ns",
        },
    }
}

fn steps(values: &[f64]) -> impl Iterator<Item = f64> + '_ {
    values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| step.is_finite())
}

/// Median of the steps; none for less than two values.
fn usual_step(values: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = steps(values).collect();
    let middle = steps.len() / 2;
    (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Whether values hardly ever fall, and rise.
fn increases(values: &[f64]) -> bool {
    let falling = steps(values).filter(|step| *step < 0.0).count();
    usual_step(values).is_some_and(|step| step > 0.0) && falling * 20 <= values.len()
}

/// Whether values hardly ever rise, and fall.
fn falls(values: &[f64]) -> bool {
    let rising = steps(values).filter(|step| *step > 0.0).count();
    usual_step(values).is_some_and(|step| step < 0.0) && rising * 20 <= values.len()
}

fn is_uniform(values: &[f64]) -> bool {
    let Some(usual) = usual_step(values) else { return false };
    let alike = steps(values).filter(|step| (step / usual - 1.0).abs() < 0.1).count();
    alike * 10 >= 9 * (values.len() - 1)
}

/// Whether values move as a position does: from row to row they go on as before.
fn is_smooth(values: &[f64]) -> bool {
    let steps: Vec<f64> = steps(values).collect();
    let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
    let changes = size(&mut steps.windows(2).map(|pair| pair[1] - pair[0]));
    let moves = size(&mut steps.iter().copied());
    changes < 0.1 * moves
}
