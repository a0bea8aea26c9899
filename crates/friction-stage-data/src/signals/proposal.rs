//! Proposes a mapping for a table, of text or of arrays.
//!
//! In goes a file; out comes a [`Proposal`]: what it looks like, and which column is likely which
//! signal, by its unit, its name, or the way it moves. What the file does not say is marked, for a
//! person to check.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

use super::array_table::{self, is_array_file};
use super::arrays::ArrayFile;
use super::column_name::{ColumnName, Quantity, Role, unit_of_name, unit_of_suffix};
use super::error::SignalError;
use super::mapping::{CsvLayout, Delimiter, Signal};
use super::text_layout::{TextLayout, bare_unit, name};
use super::text_lines::Splitter;
use super::text_value::{Decimal, Value};
use super::unit::{Dimension, Unit};
use crate::bag::{BagError, is_recording};
use friction_stage_core::model::JointType;

/// Rows per second that are proposed where nothing says them.
const RATE: f64 = 1000.0;

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
    /// Whether no other column of the table has its name.
    #[serde(skip)]
    pub is_alone: bool,
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
    /// Unit of that column, where it is another one.
    pub minus_unit: Option<String>,
    /// Number of a column of nanoseconds that is to be added to it, from 1.
    pub plus: Option<usize>,
    /// Whether it is a current, which a mapping calls so.
    pub is_current: bool,
    /// Unit for the mapping, if the file says a known one.
    pub unit: Option<String>,
    /// Factor for the mapping, where it needs one that the file does not say.
    pub scale: Option<f64>,
    /// What is to be added, in SI units.
    pub offset: Option<f64>,
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
    /// Rows per second for the mapping where no column is a time, and what to check of them.
    pub stated_rate: Option<(f64, String)>,
    /// What a person has to check of the table as a whole.
    pub table_checks: Vec<String>,
    /// Whether the motion is chosen by how the columns move, since no name or unit says one.
    pub is_motion_guessed: bool,
    /// Columns of the same file with times of their own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub own_clocks: Vec<Proposal>,
}

/// The values of a column, and whether some are dates or times of day.
struct Samples {
    values: Vec<f64>,
    is_clock: bool,
    /// Different words, so many at most.
    words: Vec<String>,
}

impl Samples {
    fn none() -> Samples {
        Samples { values: Vec::new(), is_clock: false, words: Vec::new() }
    }

    fn add_word(&mut self, field: &[u8]) {
        let word: String = name(field).chars().take(QUOTED).collect();
        if self.words.len() < MOST_WORDS && !self.words.contains(&word) {
            self.words.push(word);
        }
    }

    fn has_values(&self) -> bool {
        self.values.iter().any(|value| value.is_finite())
    }
}

/// What to check where numbers can be read with a decimal point and with a decimal comma.
const EITHER_DECIMAL: &str = "the numbers that were looked at can be read either way";
/// How likely a column must be as a signal for a person to choose, as part of the likeliest.
/// Assumed: half.
const RIVAL: f64 = 0.5;
/// What the axis of the motion adds to the likeness of another signal: it decides between two that
/// are alike otherwise.
const SAME_AXIS: f64 = 0.25;
/// How many usual steps the step from one second to the next may be, where columns without names
/// are seconds and nanoseconds: of other parts of a whole it is 1000 and more. Assumed.
const CARRY: f64 = 100.0;
/// Most different words of a column that are kept.
const MOST_WORDS: usize = 4;
/// Characters of a line that are quoted.
const QUOTED: usize = 60;
/// Part of the travel of its reference that a position makes at least. Assumed: half.
const FOLLOWS: f64 = 0.5;
/// Most captures that a column counts.
const MOST_CAPTURES: usize = 1000;

/// A column for a person: its name, or its number.
fn shown(column: &TableColumn) -> String {
    match column.name.as_str() {
        "" => format!("column {}", column.number),
        name => format!("`{name}`"),
    }
}

/// Names, units as the file writes them, and values of all columns.
struct Table<'a> {
    names: &'a [String],
    units: &'a [String],
    samples: &'a [Samples],
    /// Columns of each name.
    counts: HashMap<&'a str, usize>,
}

impl<'a> Table<'a> {
    fn new(names: &'a [String], units: &'a [String], samples: &'a [Samples]) -> Table<'a> {
        let mut counts = HashMap::new();
        for name in names {
            *counts.entry(name.as_str()).or_default() += 1;
        }
        Table { names, units, samples, counts }
    }

    /// The column at an index.
    fn column(&self, at: usize) -> TableColumn {
        let samples = &self.samples[at];
        let finite = || samples.values.iter().copied().filter(|v| v.is_finite());
        let has_values = samples.has_values() && !samples.is_clock;
        let unit = match bare_unit(&self.units[at]) {
            // A number in brackets is an index.
            none if none.bytes().all(|byte| byte.is_ascii_digit()) => {
                let written = unit_of_name(&self.names[at]);
                unit_of_suffix(written).unwrap_or(written)
            }
            written => written,
        };
        TableColumn {
            number: at + 1,
            name: self.names[at].clone(),
            unit: unit.to_owned(),
            smallest: has_values.then(|| finite().fold(f64::INFINITY, f64::min)),
            largest: has_values.then(|| finite().fold(f64::NEG_INFINITY, f64::max)),
            signal: None,
            is_alone: self.counts.get(self.names[at].as_str()) == Some(&1),
        }
    }

    /// The columns of each time where several times stand in the table: each with the columns that
    /// it is named after or has the path of, or else with those behind it. None where there is one
    /// clock: times next to each other that are named after nothing are of the same rows.
    fn blocks(&self) -> Vec<Vec<usize>> {
        let is_time = |at: &usize| {
            let column = self.column(*at);
            let said = ColumnName::of(&column.name).quantity == Some(Quantity::Time)
                || Unit::named(&column.unit).is_some_and(|u| u.dimension == Dimension::Time);
            said && increases(&self.samples[*at].values)
        };
        let times: Vec<usize> = (0..self.names.len()).filter(is_time).collect();
        let is_same = |one: usize, two: usize| {
            let pairs = self.samples[one].values.iter().zip(&self.samples[two].values);
            pairs.into_iter().all(|(a, b)| a == b || a.is_nan() || b.is_nan())
        };
        if times.len() < 2 || times.iter().skip(1).all(|at| is_same(times[0], *at)) {
            return Vec::new();
        }
        let names: Vec<ClockName> = self.names.iter().map(|name| ClockName::of(name)).collect();
        let is_any_time: Vec<bool> = (0..names.len()).map(|at| times.contains(&at)).collect();
        let own_time = |at: usize| {
            times.iter().copied().find(|time| match is_any_time[at] {
                true => *time == at,
                false => names[*time].is_time_of(&names[at]),
            })
        };
        let own: Vec<Option<usize>> = (0..names.len()).map(own_time).collect();
        let have_own = own.iter().zip(&is_any_time).any(|(own, is_time)| !is_time && own.is_some());
        let stand_apart = times.windows(2).all(|pair| pair[1] > pair[0] + 1)
            && times.last().is_some_and(|at| at + 1 < self.names.len());
        if !have_own && !stand_apart {
            return Vec::new();
        }
        let mut blocks = vec![Vec::new(); times.len()];
        let mut before = 0;
        for (at, time) in own.iter().enumerate() {
            let block = time.and_then(|time| times.binary_search(&time).ok());
            if is_any_time[at] {
                before = block.unwrap_or(before);
            }
            blocks[block.unwrap_or(before)].push(at);
        }
        blocks
    }
}

/// What a name says of the time that belongs to it: its path, and the name without a unit.
struct ClockName<'a> {
    path: Option<&'a str>,
    bare: &'a str,
}

impl ClockName<'_> {
    fn of(name: &str) -> ClockName<'_> {
        let bare = name.split(['[', '(', '{']).next().unwrap_or_default().trim();
        ClockName { path: name.rsplit_once(['.', '/']).map(|(path, _)| path), bare }
    }

    /// Whether it is the time of a column: `pos.t` of `pos.x`, `AxisPos_t [s]` of `AxisPos [mm]`.
    fn is_time_of(&self, column: &ClockName) -> bool {
        let behind = self.bare.strip_prefix(column.bare).filter(|_| !column.bare.is_empty());
        self.path.is_some() && self.path == column.path
            || behind.is_some_and(|rest| rest.starts_with(|c: char| !c.is_alphanumeric()))
    }
}

impl ProposedSignal {
    /// Adds something that a person has to check.
    fn add_check(&mut self, check: &str) {
        self.check = Some(match &self.check {
            Some(before) => format!("{before}; {check}"),
            None => check.to_owned(),
        });
    }

    /// Asks whether it is one of these columns.
    fn add_rivals(&mut self, rivals: &[String]) {
        let [first, others @ ..] = rivals else { return };
        let others = match others {
            [] => String::new(),
            [other] => format!(", or {other}"),
            others => format!(", or one of {} others", others.len()),
        };
        self.add_check(&format!("or is it {first}{others}?"));
    }
}

/// What to check where no column can be the motion.
const NO_MOTION: &str = "no column moves that could be a position or a velocity: name it, or the \
                         file that has it first";

fn has_motion(signals: &[ProposedSignal]) -> bool {
    let motion = [Signal::Position, Signal::Velocity];
    signals.iter().any(|found| motion.contains(&found.signal))
}

/// Where no name and no unit says a motion: the column that goes on from row to row most as before,
/// for a person to check.
fn moves_most_like_a_position(
    signals: &[ProposedSignal],
    columns: &mut [TableColumn],
    samples: &[Samples],
) -> Option<ProposedSignal> {
    let values = |column: &TableColumn| samples[column.number - 1].values.as_slice();
    let mut candidates: Vec<(f64, usize)> = columns
        .iter()
        .enumerate()
        .filter(|(_, column)| column.signal.is_none() && column.smallest < column.largest)
        .filter(|(_, column)| {
            let name = ColumnName::of(&column.name);
            let values = values(column);
            let is_clock = is_uniform(values) && (increases(values) || falls(values));
            let is_counter =
                counts_captures(&column.name) && captures(values).is_some_and(|count| count > 1);
            matches!(name.quantity, None | Some(Quantity::Position))
                && ![Role::Other, Role::Asked].contains(&name.role)
                && !is_clock
                && !is_counter
                && Unit::named(&column.unit).is_none_or(|unit| !is_none_of_motion(unit.dimension))
        })
        .map(|(at, column)| (roughness(values(column)), at))
        .filter(|(roughness, _)| roughness.is_finite())
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (&(_, at), others) = candidates.split_first()?;
    let others: Vec<String> = others.iter().map(|(_, at)| shown(&columns[*at])).collect();
    let column = &mut columns[at];
    column.signal = Some(Signal::Position);
    let joint = joint_of(signals);
    let mut found = proposed(Signal::Position, column, &samples[column.number - 1], joint);
    found.add_check("no name or unit says a motion: of what moves, this does most like a position");
    found.add_rivals(&others);
    Some(found)
}

/// How many captures a column counts, if it counts any: different whole numbers.
fn captures(values: &[f64]) -> Option<usize> {
    let mut seen: Vec<i64> = Vec::new();
    for value in values.iter().filter(|value| value.is_finite()) {
        let whole = *value as i64;
        if whole as f64 != *value || seen.len() > MOST_CAPTURES {
            return None;
        }
        if !seen.contains(&whole) {
            seen.push(whole);
        }
    }
    Some(seen.len())
}

/// A position that moves far less than its reference may be the error of following it, or be in
/// another unit.
fn ask_for_a_following_error(signals: &mut [ProposedSignal], columns: &[TableColumn]) {
    let travel = |signal: Signal| {
        let found = signals.iter().find(|found| found.signal == signal)?;
        let unit = found.unit.as_deref().and_then(Unit::named).map_or(1.0, |unit| unit.size);
        let column = columns.iter().find(|column| column.number == found.column)?;
        let range = unit * found.scale.unwrap_or(1.0) * (column.largest? - column.smallest?);
        (found.minus.is_none() && range > 0.0).then_some(range)
    };
    let both = travel(Signal::Position).zip(travel(Signal::ReferencePosition));
    let Some((position, reference)) = both.filter(|(one, other)| *one < FOLLOWS * other) else {
        return;
    };
    let part = 100.0 * position / reference;
    for found in signals.iter_mut().filter(|found| found.signal == Signal::Position) {
        found.add_check(&format!(
            "it moves by {part:.2} % of the reference only: is it the error of following it?"
        ));
    }
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
        minus_unit: None,
        plus: None,
        is_current: false,
        unit: Some(Signal::Force.si_unit(joint_of(signals)).to_owned()),
        scale: None,
        offset: None,
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
            // An example says most of what stands in their place.
            let lines = layout.lines_above(path).map_err(reading)?;
            let last = lines.iter().rev().find(|(_, text)| !text.is_empty());
            let example = last.map_or(String::new(), |(line, text)| {
                let begin: String = text.chars().take(QUOTED).collect();
                let more = if begin.len() < text.len() { "..." } else { "" };
                format!("; line {line} is `{begin}{more}`")
            });
            return Err(SignalError::Csv {
                path: path.to_owned(),
                line: layout.data_line,
                reason: format!("no rows of numbers were found{example}"),
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
            ..Self::of_table(&names, &units, &samples, taken)
        }
        .with_names_unplaced(&layout)
        .with_few_rows()
        .with_rows_of_other_lengths(&layout, path)
        .map_err(reading)?
        .with_first_row_that_counts(&samples, &layout)
        .with_factors(&layout.lines_before(layout.data_line + 1, path).map_err(reading)?)
        .with_thousands_in_doubt(&layout)
        .with_stated_rate(&layout.lines_above(path).map_err(reading)?))
    }

    /// Of a file of arrays, those of the length that a time has, or that most of them have.
    fn of_arrays(path: &Path, taken: &[Signal]) -> Result<Proposal, SignalError> {
        let file = ArrayFile::open(path)?;
        let is_time = |name: &str| ColumnName::of(name).quantity == Some(Quantity::Time);
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
            .map(|(values, is_clock)| Samples { values, is_clock, words: Vec::new() })
            .collect();
        let names: Vec<String> = columns.iter().map(|at| file.columns[*at].name.clone()).collect();
        Ok(Proposal {
            format: file.format.name(),
            not_used: file.others(longest),
            ..Self::of_table(&names, &vec![String::new(); names.len()], &samples, taken)
        })
    }

    /// Which of these columns are which signals; says nothing of the file. Columns with times of
    /// their own are proposals of their own.
    fn of_table(
        names: &[String],
        units: &[String],
        samples: &[Samples],
        taken: &[Signal],
    ) -> Proposal {
        let table = Table::new(names, units, samples);
        let all: Vec<usize> = (0..names.len()).collect();
        let whole = Self::of_columns(&table, &all, taken);
        let blocks = table.blocks();
        let is_motion =
            |found: &&ProposedSignal| [Signal::Position, Signal::Velocity].contains(&found.signal);
        let motion = whole.signals.iter().find(is_motion).map(|found| found.column - 1);
        let Some(first) =
            blocks.iter().position(|block| motion.is_none_or(|at| block.contains(&at)))
        else {
            return whole;
        };
        let mut proposal = Self::of_columns(&table, &blocks[first], taken);
        for (_, block) in blocks.iter().enumerate().filter(|(index, _)| *index != first) {
            let taken: Vec<Signal> = taken.iter().copied().chain(proposal.recorded()).collect();
            let other = Self::of_columns(&table, block, &taken);
            proposal.own_clocks.push(other);
        }
        proposal
    }

    /// Which of the columns `own` of a table are which signals.
    fn of_columns(table: &Table, own: &[usize], taken: &[Signal]) -> Proposal {
        let samples = table.samples;
        let rows = samples.first().map_or(0, |column| column.values.len());
        let mut columns: Vec<TableColumn> = own.iter().map(|at| table.column(*at)).collect();
        let mut signals: Vec<ProposedSignal> = Vec::new();
        let has_values = |column: &TableColumn| samples[column.number - 1].has_values();
        let first = columns.iter().find(|column| has_values(column)).map(|column| column.number);
        let split = split_time(&columns, samples).filter(|_| !taken.contains(&Signal::Time));
        if let Some((seconds, nanoseconds)) = split {
            for column in &mut columns {
                if [seconds, nanoseconds].contains(&column.number) {
                    column.signal = Some(Signal::Time);
                }
            }
            signals.push(ProposedSignal {
                signal: Signal::Time,
                column: seconds,
                minus: None,
                minus_unit: None,
                plus: Some(nanoseconds),
                is_current: false,
                unit: Some("s".to_owned()),
                scale: None,
                offset: None,
                check: table.names[nanoseconds - 1]
                    .is_empty()
                    .then(|| "by their numbers these are seconds and nanoseconds".to_owned()),
            });
        }
        let mut is_motion_guessed = false;
        // The name of the motion, of whose axis the forces are to be.
        let mut motion: Option<ColumnName> = None;
        for signal in [
            Signal::Time,
            Signal::Position,
            Signal::Velocity,
            Signal::ReferencePosition,
            Signal::ReferenceVelocity,
            Signal::ForceCell,
            Signal::Force,
        ] {
            // A force is sought among what is no motion.
            if signal == Signal::ForceCell && taken.is_empty() && !has_motion(&signals) {
                signals.extend(from_following_error(&signals, &mut columns));
                if !has_motion(&signals) {
                    let guessed = moves_most_like_a_position(&signals, &mut columns, samples);
                    is_motion_guessed = guessed.is_some();
                    signals.extend(guessed);
                }
            }
            let has_position = |found: &ProposedSignal| found.signal == Signal::Position;
            let is_moving = !taken.is_empty() || signals.iter().any(has_position);
            let is_motion = signal == Signal::Velocity && is_moving
                || signal == Signal::Position && !taken.is_empty();
            if is_motion || taken.contains(&signal) || signal == Signal::Time && split.is_some() {
                continue;
            }
            let free = columns.iter().filter(|column| column.signal.is_none());
            let mut candidates: Vec<(f64, usize)> = free
                .map(|column| {
                    let is_first = Some(column.number) == first;
                    let as_signal =
                        |signal| likeness(signal, column, is_first, &samples[column.number - 1]);
                    let likeness = match signal {
                        // Where the command is known, another force is a measured one.
                        Signal::ForceCell if taken.contains(&Signal::Force) => {
                            as_signal(Signal::ForceCell).max(as_signal(Signal::Force))
                        }
                        signal => as_signal(signal),
                    };
                    let of_axis = motion
                        .as_ref()
                        .is_some_and(|motion| ColumnName::of(&column.name).is_of_same_axis(motion));
                    (
                        likeness + if likeness > 0.0 && of_axis { SAME_AXIS } else { 0.0 },
                        column.number,
                    )
                })
                .filter(|(likeness, _)| *likeness > 0.0)
                .collect();
            candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let Some(&(best, number)) = candidates.first() else { continue };
            let rivals: Vec<String> = candidates[1..]
                .iter()
                .filter(|(likeness, number)| match signal {
                    Signal::Time => false,
                    // A second position is worth a question, however it is called.
                    Signal::Position if has_unit_of(signal, &table.column(number - 1)) => true,
                    _ => *likeness >= RIVAL * best,
                })
                .map(|(_, number)| shown(&table.column(number - 1)))
                .collect();
            let joint = joint_of(&signals);
            let Some(column) = columns.iter_mut().find(|column| column.number == number) else {
                continue;
            };
            column.signal = Some(signal);
            let mut found = proposed(signal, column, &samples[number - 1], joint);
            let name = ColumnName::of(&column.name);
            if motion.as_ref().is_some_and(|motion| name.is_of_other_axis(motion)) {
                found.add_check("by its name it is of another axis than the motion");
            }
            found.add_rivals(&rivals);
            if [Signal::Position, Signal::Velocity].contains(&signal) {
                motion = Some(name);
            }
            signals.push(found);
        }
        let mut table_checks = Vec::new();
        if taken.is_empty() {
            signals.extend(the_only_column_left(&signals, &mut columns));
            if !has_motion(&signals) {
                table_checks.push(NO_MOTION.to_owned());
            }
        }
        ask_for_a_following_error(&mut signals, &columns);
        let mut proposal = Proposal {
            format: "",
            not_used: Vec::new(),
            delimiter: String::new(),
            decimal_comma: false,
            either_decimal: false,
            names_line: None,
            units_line: None,
            data_line: 0,
            rows,
            rate_hz: None,
            columns,
            signals,
            stated_rate: None,
            table_checks,
            is_motion_guessed,
            own_clocks: Vec::new(),
        };
        proposal.take_a_time_that_does_not_rise(samples);
        proposal.find_captures(samples);
        let time = proposal.signals.iter().find(|found| found.signal == Signal::Time);
        proposal.rate_hz = time.and_then(|time| {
            let unit = time.unit.as_deref().and_then(Unit::named).map_or(1.0, |unit| unit.size);
            let unit = unit * time.scale.unwrap_or(1.0);
            let whole = samples[time.column - 1].values.as_slice();
            let step = match time.plus {
                Some(part) => usual_step(&joined_time(whole, &samples[part - 1].values)),
                None => usual_step(whole),
            };
            let rate = 1.0 / (unit * step?.abs());
            rate.is_finite().then_some(rate)
        });
        if time.is_none() {
            let counter =
                proposal.columns.iter().find(|c| counts_rows(&samples[c.number - 1].values));
            let of_counter = counter
                .map_or(String::new(), |column| format!("; {} counts the rows", shown(column)));
            let check = format!("rows per second; no column is a time{of_counter}");
            proposal.stated_rate = Some((RATE, check));
        }
        proposal
    }

    /// A column that is called a time and does not rise from row to row is one all the same: what
    /// is wrong with it is for a person to see.
    fn take_a_time_that_does_not_rise(&mut self, samples: &[Samples]) {
        if self.signals.iter().any(|found| found.signal == Signal::Time) {
            return;
        }
        let is_time = |column: &&mut TableColumn| {
            column.signal.is_none()
                && samples[column.number - 1].has_values()
                && ColumnName::of(&column.name).quantity == Some(Quantity::Time)
        };
        let Some(column) = self.columns.iter_mut().find(is_time) else { return };
        column.signal = Some(Signal::Time);
        let values = &samples[column.number - 1].values;
        let mut found = proposed(Signal::Time, column, &samples[column.number - 1], joint_of(&[]));
        let falling = steps(values).filter(|step| *step < 0.0).count();
        let same = steps(values).filter(|step| *step == 0.0).count();
        found.add_check(&match falling {
            0 => format!(
                "{same} of {} rows have the time of the row before: too coarse (leave it out and \
                 give the `rate`), or rows of several axes",
                values.len()
            ),
            _ => format!("it goes back {falling} times: several captures in one file?"),
        });
        self.signals.insert(0, found);
    }

    /// Says which column counts captures or axes that stand in one file.
    fn find_captures(&mut self, samples: &[Samples]) {
        let may_count = |column: &&TableColumn| {
            let has_words = !samples[column.number - 1].words.is_empty();
            column.signal.is_none()
                && (counts_captures(&column.name) || has_words && names_signals(&column.name))
        };
        for column in self.columns.iter().filter(may_count) {
            if let words @ [_, _, ..] = samples[column.number - 1].words.as_slice() {
                self.table_checks.push(format!(
                    "{} has different words ({}, ...): rows of several axes or signals, which must \
                     be files of their own",
                    shown(column),
                    words.join(", ")
                ));
                continue;
            }
            let count = captures(&samples[column.number - 1].values);
            if let Some(count) = count.filter(|count| *count > 1) {
                self.table_checks.push(format!(
                    "{} has {count} values: rows of several captures or axes, which must be files \
                     of their own",
                    shown(column)
                ));
            }
        }
    }

    /// The same with what to check where the names are not as many as the columns.
    fn with_names_unplaced(mut self, layout: &TextLayout) -> Proposal {
        if let Some((line, names)) = layout.unplaced {
            self.table_checks.push(format!(
                "line {line} has {names} names for {} columns: which is of which it does not say, \
                 so the columns have numbers",
                layout.columns
            ));
        }
        self
    }

    /// The same with what to check where there are fewer rows than columns.
    fn with_few_rows(mut self) -> Proposal {
        if self.rows < self.columns.len() {
            self.table_checks.push(format!(
                "{} rows of {} columns: where each signal is a row, turn the table round",
                self.rows,
                self.columns.len()
            ));
        }
        self
    }

    /// The same with what to check where blanks separate columns and rows differ in their number:
    /// of a cell that is blank it is not known which it is.
    fn with_rows_of_other_lengths(
        mut self,
        layout: &TextLayout,
        path: &Path,
    ) -> std::io::Result<Proposal> {
        if layout.delimiter != Delimiter::Blanks {
            return Ok(self);
        }
        let (mut lines, mut row) = (layout.rows(path)?, Splitter::new(layout.delimiter));
        let (mut rows, mut others) = (0, 0);
        while let Some((_, line)) = lines.next()? {
            row.split(line);
            let is_value = |field: &[u8]| layout.value(field).is_value();
            if row.fields().any(is_value) {
                rows += 1;
                others += usize::from(row.len() != layout.columns);
            }
            if rows >= LOOKED_AT {
                break;
            }
        }
        // The last row may be cut off.
        if others > 1 {
            self.table_checks.push(format!(
                "{others} of {rows} rows have not {} values: where a cell is blank, it is not \
                 known which",
                layout.columns
            ));
        }
        Ok(self)
    }

    /// The same with what to check where the first row counts the columns, as the names of a table
    /// without names do.
    fn with_first_row_that_counts(mut self, samples: &[Samples], layout: &TextLayout) -> Proposal {
        let first: Vec<f64> =
            samples.iter().filter_map(|column| column.values.first().copied()).collect();
        let counts =
            |from: f64| first.iter().zip(0..).all(|(one, at)| *one == from + f64::from(at));
        if layout.names_line.is_none() && first.len() > 2 && (counts(0.0) || counts(1.0)) {
            self.table_checks.push(format!(
                "line {line} counts the columns: where it is no row, `csv: {{names_in_line: \
                 {line}, data_from_line: {}}}`",
                layout.data_line + 1,
                line = layout.data_line
            ));
        }
        self
    }

    /// The same with what to check where a line above the rows has a factor for each column.
    fn with_factors(mut self, above: &[(u64, String)]) -> Proposal {
        const FACTOR: [&str; 7] =
            ["factor", "faktor", "scale", "scaling", "skalierung", "gain", "offset"];
        for (line, text) in above {
            let fields: Vec<&str> = text
                .split(|c: char| ";\t|".contains(c) || c == ',' && !self.decimal_comma)
                .collect();
            let Some((label, values)) = fields.split_first() else { continue };
            let label = label.to_lowercase();
            let is_factor = |value: &&str| {
                let value = value.trim().replace(',', ".");
                value.parse::<f64>().is_ok()
            };
            let count = values.iter().filter(|value| is_factor(value)).count();
            let is_label = FACTOR.iter().any(|word| label.contains(word));
            if is_label && !label.contains("horizontal") && count + 1 >= self.columns.len().max(2) {
                let begins = match *line == self.data_line {
                    true => {
                        format!(", and begin the rows with `csv: {{data_from_line: {}}}`", line + 1)
                    }
                    false => String::new(),
                };
                self.table_checks.push(format!(
                    "line {line} has factors or offsets of the columns, which are not applied: \
                     give them as `scale` and `offset`{begins}"
                ));
            }
        }
        self
    }

    /// The same with a scale to check for columns whose marks may be decimal ones.
    fn with_thousands_in_doubt(mut self, layout: &TextLayout) -> Proposal {
        let written = if self.decimal_comma { "1.234" } else { "1,234" };
        let others = self.own_clocks.iter_mut().flat_map(|other| &mut other.signals);
        for found in self.signals.iter_mut().chain(others) {
            if layout.thousands_in_doubt.contains(&(found.column - 1)) {
                found.scale.get_or_insert(1.0);
                found.add_check(&format!(
                    "each number is written as {written} and taken for 1234; where it is 1.234, a \
                     thousandth of this `scale`"
                ));
            }
        }
        self
    }

    /// The same with the rate that a line above the table says, where no column is a time.
    fn with_stated_rate(mut self, above: &[(u64, String)]) -> Proposal {
        let said: Vec<(u64, f64, bool)> = above
            .iter()
            .filter_map(|(line, text)| {
                let (rate, is_of_samples) = rate_in(text, self.decimal_comma)?;
                Some((*line, rate, is_of_samples))
            })
            .collect();
        // A rate of samples counts before others, and of several none.
        let is_any_of_samples = said.iter().any(|(.., is_of_samples)| *is_of_samples);
        let mut rates = said.iter().filter(|(.., of)| *of || !is_any_of_samples);
        let Some(&(line, rate, _)) = rates.next() else { return self };
        if rates.any(|(_, other, _)| *other != rate) {
            return self;
        }
        // A stated rate is preferred to a row counter without a unit.
        let rows = self.rows as f64;
        let time = self.signals.iter().position(|found| found.signal == Signal::Time);
        let is_counter = time.is_some_and(|at| {
            let column = self.column(self.signals[at].column);
            let range = column.and_then(|column| Some(column.largest? - column.smallest?));
            let is_called_one = column.is_some_and(|column| {
                ColumnName::of(&column.name).quantity == Some(Quantity::Time)
            });
            self.signals[at].check.is_some() && !is_called_one && range == Some(rows - 1.0)
        });
        if let Some(at) = time.filter(|_| is_counter) {
            let number = self.signals.remove(at).column;
            let column = self.columns.iter_mut().find(|column| column.number == number);
            column.into_iter().for_each(|column| column.signal = None);
            self.rate_hz = None;
        }
        if time.is_none() || is_counter {
            let check = format!("rows per second, as line {line} says; no column is a time");
            self.stated_rate = Some((rate, check));
        }
        self
    }

    /// Whether it is of a file of arrays.
    pub fn is_of_arrays(&self) -> bool {
        self.format != "text"
    }

    /// What a person has to check, each with what it is about.
    pub fn checks(&self) -> Vec<(&'static str, &str)> {
        let decimal = self.either_decimal.then_some(("decimal_comma", EITHER_DECIMAL));
        let rate = self.stated_rate.as_ref().map(|(_, check)| ("rate", check.as_str()));
        let of_table = self.table_checks.iter().map(|check| ("table", check.as_str()));
        let of_signals = self.signals.iter().filter_map(|found| {
            let check = found.check.as_deref()?;
            Some((found.signal.name(), check))
        });
        let of_others = self.own_clocks.iter().flat_map(Proposal::checks);
        decimal.into_iter().chain(rate).chain(of_table).chain(of_signals).chain(of_others).collect()
    }

    /// Whether there is a position or a velocity, without which a mapping is none.
    pub fn has_motion(&self) -> bool {
        has_motion(&self.signals)
    }

    /// A column as a mapping names it: by its name where no other has it, else by its number.
    fn place(&self, number: usize) -> String {
        // A string of JSON is one of YAML.
        match self.column(number) {
            // A number in a mapping is that of a column.
            Some(column)
                if column.is_alone
                    && !column.name.is_empty()
                    && column.name.parse::<usize>().is_err() =>
            {
                serde_json::Value::from(column.name.as_str()).to_string()
            }
            _ => number.to_string(),
        }
    }

    /// The signals but for the time.
    pub fn recorded(&self) -> impl Iterator<Item = Signal> {
        let others = self.own_clocks.iter().flat_map(|other| &other.signals);
        let all = self.signals.iter().chain(others).map(|found| found.signal);
        all.filter(|signal| *signal != Signal::Time)
    }

    fn column(&self, number: usize) -> Option<&TableColumn> {
        self.columns.iter().find(|column| column.number == number)
    }

    /// The mapping file, with what to check in comments. `joined` are other recordings of the same
    /// motion, with their paths from the directory of `file` on.
    pub fn to_yaml(&self, file: &str, joined: &[(String, Proposal)]) -> String {
        let mut text = format!(
            "# Proposed for {file}. What it does not say itself is marked CHECK.\n\
             # Positive is along +x; `scale: -1` turns a signal round.\n{}",
            self.table_yaml(&self.not_found(joined))
        );
        let own = Path::new(file).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let with_signals = |others: &'_ [Proposal]| {
            others.iter().filter(|other| other.recorded().next().is_some()).cloned().collect()
        };
        let own_clocks: Vec<Proposal> = with_signals(&self.own_clocks);
        let mut all: Vec<(&str, &Proposal, bool)> =
            own_clocks.iter().map(|other| (own.as_str(), other, true)).collect();
        for (path, other) in joined {
            all.push((path, other, self.has_dates() && other.has_dates()));
            all.extend(other.own_clocks.iter().map(|block| (path.as_str(), block, false)));
        }
        if !all.is_empty() {
            text += "join:\n";
        }
        for (path, other, is_one_clock) in all {
            let check = match is_one_clock {
                true => "s, added to its times",
                false => "CHECK: s, added to its times; 0 takes both clocks as one",
            };
            let path = serde_json::Value::from(path);
            let _ = writeln!(text, "  - file: {path}\n    clock_offset: 0   # {check}");
            for line in other.table_yaml(&[]).lines() {
                let _ = writeln!(text, "    {line}");
            }
        }
        text
    }

    /// Whether its times are dates or times of day, which are of the same clock in every file.
    pub fn has_dates(&self) -> bool {
        let time = self.signals.iter().find(|found| found.signal == Signal::Time);
        let column = time.and_then(|time| self.column(time.column));
        column.is_some_and(|column| column.smallest.is_none())
    }

    /// What a recording needs and no table has.
    fn not_found(&self, joined: &[(String, Proposal)]) -> Vec<Signal> {
        let all: Vec<Signal> =
            self.recorded().chain(joined.iter().flat_map(|(_, other)| other.recorded())).collect();
        let has = |signals: [Signal; 2]| signals.iter().any(|signal| all.contains(signal));
        let motion = (!has([Signal::Position, Signal::Velocity])).then_some(Signal::Position);
        let force = (!has([Signal::Force, Signal::ForceCell])).then_some(Signal::Force);
        motion.into_iter().chain(force).collect()
    }

    /// The part of a mapping that is of this table, with a line to fill in for what is `not_found`.
    fn table_yaml(&self, not_found: &[Signal]) -> String {
        let mut text = String::new();
        if !self.is_of_arrays() {
            self.write_layout(&mut text);
        }
        self.write_signals(&mut text, not_found);
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
                "csv: {{decimal_comma: {}}}   # CHECK: {EITHER_DECIMAL}",
                self.decimal_comma
            );
        }
    }

    fn write_signals(&self, text: &mut String, not_found: &[Signal]) {
        for check in &self.table_checks {
            let _ = writeln!(text, "# CHECK: {check}");
        }
        if let Some((rate, check)) = &self.stated_rate {
            let _ = writeln!(text, "rate: {rate}   # CHECK: {check}");
        }
        *text += "signals:\n";
        for found in &self.signals {
            let place = self.place(found.column);
            let minus = found
                .minus
                .map_or(String::new(), |column| format!(", minus: {}", self.place(column)));
            let quoted = |key: &str, unit: &Option<String>| {
                let unit = unit.as_ref().map(|unit| serde_json::Value::from(unit.as_str()));
                unit.map_or(String::new(), |unit| format!(", {key}: {unit}"))
            };
            let minus = minus + &quoted("minus_unit", &found.minus_unit);
            let plus = found.plus.map_or(String::new(), |column| {
                format!(", plus: {}, plus_unit: ns", self.place(column))
            });
            let unit = quoted("unit", &found.unit);
            let scale = found.scale.map_or(String::new(), |scale| format!(", scale: {scale}"));
            let offset = found.offset.map_or(String::new(), |value| format!(", offset: {value}"));
            let scale = scale + &offset;
            let check = found.check.as_ref().map_or(String::new(), |c| format!("   # CHECK: {c}"));
            let name = if found.is_current { "current" } else { found.signal.name() };
            let _ =
                writeln!(text, "  {name}: {{column: {place}{minus}{unit}{plus}{scale}}}{check}");
        }
        let can_be =
            |column: &TableColumn| column.signal.is_none() && column.smallest < column.largest;
        for signal in not_found.iter().filter(|_| self.columns.iter().any(can_be)) {
            let unit = signal.si_unit(joint_of(&self.signals));
            let _ = writeln!(
                text,
                "  # {signal}: {{column: NAME, unit: {unit}}}   # not found; if it is one of those \
                 below"
            );
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
    let found = |signal: Signal| signals.iter().find(|found| found.signal == signal);
    if found(Signal::Position).or(found(Signal::Velocity)).is_some() {
        return None;
    }
    let reference = found(Signal::ReferencePosition)?;
    let unit = |column: &TableColumn| Unit::named(&column.unit);
    let dimension = |column: &TableColumn| unit(column).map(|unit| unit.dimension);
    let asked = columns.iter().find(|column| column.number == reference.column)?.clone();
    let is_error = |column: &&mut TableColumn| {
        let name = ColumnName::of(&column.name);
        column.signal.is_none()
            && column.smallest < column.largest
            && name.role == Role::Other
            && matches!(name.quantity, None | Some(Quantity::Position))
            && dimension(column) == dimension(&asked)
    };
    let error = columns.iter_mut().find(is_error)?;
    error.signal = Some(Signal::Position);
    let sign = "the reference less the error; its sign?".to_owned();
    Some(ProposedSignal {
        signal: Signal::Position,
        minus: Some(error.number),
        minus_unit: (unit(error) != unit(&asked)).then(|| error.unit.clone()),
        check: Some(reference.check.as_ref().map_or(sign.clone(), |unit| format!("{sign} {unit}"))),
        ..reference.clone()
    })
}

/// The columns of the first rows. Times are in s since the first row.
fn samples(path: &Path, layout: &TextLayout) -> std::io::Result<Vec<Samples>> {
    let mut lines = layout.rows(path)?;
    let mut row = Splitter::new(layout.delimiter);
    let mut columns: Vec<Samples> = (0..layout.columns).map(|_| Samples::none()).collect();
    let mut begins: Vec<Option<i64>> = vec![None; layout.columns];
    while let Some((_, line)) = lines.next()? {
        row.split(line);
        let values: Vec<Value> = row.fields().map(|f| Value::of(f, layout.decimal)).collect();
        // Settings between captures and what is at the end of a table begin with words.
        let is_of_table = !layout.begins_with_value || values.first() != Some(&Value::Text);
        if values.len() < layout.columns || !is_of_table || !values.iter().any(Value::is_value) {
            continue;
        }
        let fields = row.fields().zip(&values).zip(&mut columns).zip(&mut begins);
        for (((field, value), column), begin) in fields {
            if *value == Value::Text {
                column.add_word(field);
            }
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

/// How much a column looks like a signal; 0: not at all. By its unit, its name, how it moves.
/// `is_first`: whether it is the first column with values.
fn likeness(signal: Signal, column: &TableColumn, is_first: bool, samples: &Samples) -> f64 {
    use Quantity::{Acceleration, Current, Force, ForceCell, Position, Time, Velocity};
    let name = ColumnName::of(&column.name);
    let unit = Unit::named(&column.unit);
    let dimension = unit.map(|unit| unit.dimension);
    let has_unit = |of: Signal| dimension.is_some_and(|dimension| of.has_dimension(dimension));
    // A motor may turn where the stage moves along: other units need a scale, not another signal.
    let is_none_of_motion = dimension.is_some_and(is_none_of_motion);
    let is = |named: bool| f64::from(u8::from(named));
    let is_named = |quantity: Quantity| is(name.quantity == Some(quantity));
    if signal == Signal::Time {
        let is_time = name.quantity == Some(Time);
        let is_monotone = increases(&samples.values) || is_time && falls(&samples.values);
        let score = 2.0 * is(samples.is_clock)
            + is(is_time || has_unit(Signal::Time))
            + 0.5 * is(is_uniform(&samples.values));
        // What counts the rows says no time, unless it has no other name.
        let may_be_first = is_first && !(name.has_words && counts_rows(&samples.values));
        return if is_monotone && (score >= 1.0 || may_be_first) { score } else { 0.0 };
    }
    let moves = column.smallest < column.largest;
    if !moves || name.role == Role::Other || matches!(name.quantity, Some(Time | Acceleration)) {
        return 0.0;
    }
    let is_asked = name.role == Role::Asked;
    // Of two the one that is said to be measured.
    let measured = 0.5 * is(name.role == Role::Measured);
    match (signal, name.quantity) {
        (Signal::Position, None | Some(Position)) if !is_asked && !is_none_of_motion => {
            let counts = is(unit.is_some_and(|unit| unit.name == "count"));
            let smooth =
                is(column.unit.is_empty() && !name.has_words && is_smooth(&samples.values));
            let said = 2.0 * is(has_unit(signal)) + 2.0 * is_named(Position) + counts;
            said + 0.5 * smooth + if said > 0.0 { measured } else { 0.0 }
        }
        (Signal::Velocity, None | Some(Velocity)) if !is_asked => {
            let said = 2.0 * is(has_unit(signal)) + 1.5 * is_named(Velocity);
            said + if said > 0.0 { measured } else { 0.0 }
        }
        (Signal::ReferencePosition, None | Some(Position)) if is_asked && !is_none_of_motion => {
            2.0 * is(has_unit(signal)) + is_named(Position) + 0.5
        }
        (Signal::ReferenceVelocity, None | Some(Velocity)) if is_asked => {
            is(has_unit(signal)) + is_named(Velocity)
        }
        (Signal::ForceCell, Some(ForceCell)) => 1.0 + is(has_unit(signal)),
        (Signal::Force, None | Some(Force | ForceCell | Current)) => {
            let of_drive = [Dimension::Current, Dimension::Voltage, Dimension::Number];
            let drive = dimension.is_some_and(|dimension| of_drive.contains(&dimension));
            2.0 * is(has_unit(signal)) + 1.5 * is(name.quantity.is_some()) + is(drive)
        }
        _ => 0.0,
    }
}

/// Whether a position has no such unit.
fn is_none_of_motion(dimension: Dimension) -> bool {
    [Signal::Time, Signal::Velocity, Signal::Force].iter().any(|of| of.has_dimension(dimension))
        || dimension == Dimension::Current
}

/// Whether the file gives a unit that a signal has.
fn has_unit_of(signal: Signal, column: &TableColumn) -> bool {
    Unit::named(&column.unit).is_some_and(|unit| signal.has_dimension(unit.dimension))
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
    let names_current = || ColumnName::of(&column.name).quantity == Some(Quantity::Current);
    let is_current = signal == Signal::Force
        && known.map_or(written.is_none() && names_current(), |unit| {
            unit.dimension == Dimension::Current
        });
    // The first signal of the motion says what joint it is.
    let is_motion = [Signal::Position, Signal::Velocity].contains(&signal);
    let joint = known.and_then(Unit::joint).filter(|_| is_motion).unwrap_or(joint);
    let si = signal.si_unit(joint);
    let is_bare_time = signal == Signal::Time && written.is_none();
    let ticks = offset_of_ticks(&samples.values).filter(|_| is_bare_time);
    let (unit, scale, check) = match known {
        None if signal == Signal::Time && samples.is_clock => (None, None, None),
        Some(unit) if unit.dimension == signal.dimension(joint) => (written, None, None),
        None if signal == Signal::Time && written.is_some() => {
            let unit = written.unwrap_or_default();
            (None, Some(1.0), Some(format!("it is in {unit}: its `scale`, s per {unit}")))
        }
        _ if ticks.is_some() => {
            (None, Some(TICK), Some("ticks of 100 ns by the size of its numbers".to_owned()))
        }
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
        // A unit of the other kind of joint would make it that joint.
        Some(unit) if signal.has_dimension(unit.dimension) => {
            let unit = written.unwrap_or_default();
            (None, Some(1.0), Some(format!("it is in {unit}: its `scale`, {si} per {unit}")))
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
    ProposedSignal {
        signal,
        column: column.number,
        minus: None,
        minus_unit: None,
        plus: None,
        is_current,
        unit,
        scale,
        offset: ticks,
        check,
    }
}

/// What some programs count times in, s.
const TICK: f64 = 1e-7;

/// What makes ticks of 100 ns times since 1970, s, where numbers are as large as those from 1970 to
/// 2120: since 1601, as Windows counts, or since the year 1, as .NET does.
fn offset_of_ticks(values: &[f64]) -> Option<f64> {
    let first = values.iter().copied().find(|value| value.is_finite())?;
    [-11_644_473_600.0, -62_135_596_800.0].into_iter().find(|offset| {
        let since_1970 = first * TICK + offset;
        (0.0..150.0 * 31_556_952.0).contains(&since_1970)
    })
}

/// Unit of times, by how large they are: since 1970, days of a spreadsheet or of MATLAB, else by
/// their steps.
fn unit_of_epoch(values: &[f64]) -> &'static str {
    // Assumed: a motion is sampled with 20 Hz to 1 MHz.
    const SLOWEST: f64 = 0.05;
    const FASTEST: f64 = 1e-6;
    let first = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    let step = usual_step(values).map_or(0.0, f64::abs);
    match first {
        // From 2001 to 2286 in each unit.
        first if (1e18..1e19).contains(&first) => "ns",
        first if (1e15..1e16).contains(&first) => "us",
        first if (1e12..1e13).contains(&first) => "ms",
        first if (1e9..1e10).contains(&first) => "s",
        // From 1982 to 2119, counted from 1900, or from 1943 to 2107, counted from the year 0.
        first if (30_000.0..80_000.0).contains(&first) && step < 1e-3 => "d",
        first if (710_000.0..770_000.0).contains(&first) && step < 1e-3 => "d",
        // A part of a day.
        _ if step > 0.0 && step < FASTEST => "d",
        _ if step <= SLOWEST => "s",
        _ if step * 1e-3 <= SLOWEST => "ms",
        _ if step * 1e-6 <= SLOWEST => "us",
        _ => "ns",
    }
}

/// Numbers of the columns of seconds and of nanoseconds that are one time, as messages of ROS have
/// it: of the same name but for the word for the unit, with whole numbers below 10^9.
fn split_time(columns: &[TableColumn], samples: &[Samples]) -> Option<(usize, usize)> {
    const SECONDS: &[&str] = &["seconds", "secs", "sec", "s"];
    const NANOSECONDS: &[&str] = &["nanoseconds", "nanosecs", "nanosec", "nsecs", "nsec", "nanos"];
    let stem = |column: &TableColumn, words: &[&str]| {
        let name = column.name.trim().to_lowercase();
        let stem = words.iter().find_map(|word| name.strip_suffix(word)).map(str::to_owned)?;
        stem.chars().next_back().is_none_or(|c| !c.is_alphanumeric()).then_some(stem)
    };
    let values = |column: &TableColumn| samples[column.number - 1].values.as_slice();
    let is_whole = |value: &f64| value.is_nan() || value.fract() == 0.0;
    let is_part = |value: &f64| value.is_nan() || is_whole(value) && (0.0..1e9).contains(value);
    // Without names they stand next to each other, and the one begins again as the other goes on.
    let begins_again = |whole: &TableColumn, part: &TableColumn| {
        let joined = joined_time(values(whole), values(part));
        let usual = usual_step(&joined).unwrap_or(f64::NAN);
        let steps = || steps(values(whole)).zip(steps(values(part))).zip(steps(&joined));
        steps().all(|((whole, part), _)| (whole > 0.0) == (part < 0.0))
            && steps().all(|((whole, _), joined)| whole <= 0.0 || joined < CARRY * usual)
    };
    columns.iter().find_map(|part| {
        let named = stem(part, NANOSECONDS);
        if named.is_none() && !part.name.is_empty() {
            return None;
        }
        let is_seconds = |whole: &&TableColumn| match part.name.is_empty() {
            true => {
                whole.name.is_empty()
                    && whole.number + 1 == part.number
                    && whole.smallest < whole.largest
                    && begins_again(whole, part)
            }
            false => stem(whole, SECONDS) == named,
        };
        let whole = columns.iter().find(is_seconds)?;
        let is_time = increases(&joined_time(values(whole), values(part)));
        let fit = values(whole).iter().all(is_whole) && values(part).iter().all(is_part);
        (fit && is_time).then_some((whole.number, part.number))
    })
}

/// Times, s since the first whole second, of whole seconds and the nanoseconds next to them.
fn joined_time(whole: &[f64], part: &[f64]) -> Vec<f64> {
    let first = whole.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    whole.iter().zip(part).map(|(whole, part)| whole - first + 1e-9 * part).collect()
}

/// Whether values count rows: each is one more than that before it.
fn counts_rows(values: &[f64]) -> bool {
    steps(values).next().is_some() && steps(values).all(|step| step == 1.0)
}

/// Whether a column is called as what counts captures or axes.
fn counts_captures(name: &str) -> bool {
    const CAPTURE: &[&str] = &[
        "capture", "run", "shot", "cycle", "test", "segment", "block", "record", "trial",
        "episode", "axis", "axe", "achse", "joint", "versuch", "messung", "zyklus", "essai",
    ];
    has_word(name, CAPTURE)
}

/// Whether a column is called as what has the name of a signal in each row.
fn names_signals(name: &str) -> bool {
    has_word(name, &["topic", "signal", "variable", "channel", "kanal", "tag", "series"])
}

fn has_word(name: &str, known: &[&str]) -> bool {
    let name = name.to_lowercase();
    name.split(|c: char| !c.is_alphabetic()).any(|word| known.contains(&word))
}

/// Rows per second given by a settings line, and whether the line mentions samples: it has one
/// number, and a word for a rate or for a sampling interval.
fn rate_in(line: &str, decimal_comma: bool) -> Option<(f64, bool)> {
    const RATE: &[&str] = &[
        "rate",
        "samplerate",
        "frequency",
        "frequenz",
        "abtastrate",
        "fs",
        "abtastfrequenz",
        "frequence",
        "frecuencia",
    ];
    const INTERVAL: &[&str] = &[
        "interval",
        "increment",
        "period",
        "intervall",
        "periode",
        "abtastzeit",
        "dt",
        "deltax",
        "deltat",
        "sampletime",
        "samplingtime",
        "timestep",
        "schrittweite",
        "zykluszeit",
        "cycletime",
    ];
    let line = line.to_lowercase();
    let line = if decimal_comma { line.replace(',', ".") } else { line };
    let fields: Vec<&str> =
        line.split(|c: char| ",;\t:= []()\"|#%_".contains(c)).filter(|f| !f.is_empty()).collect();
    let pairs: Vec<String> = fields.windows(2).map(<[&str]>::concat).collect();
    let says = |known: &[&str]| {
        fields.iter().copied().chain(pairs.iter().map(String::as_str)).any(|f| known.contains(&f))
    };
    let is_interval = says(INTERVAL);
    if !is_interval && !says(RATE) {
        return None;
    }
    // One for each column says the same.
    let mut numbers: Vec<f64> = fields.iter().filter_map(|field| field.parse().ok()).collect();
    numbers.dedup();
    let [number] = numbers.as_slice() else { return None };
    let unit = fields.iter().find_map(|field| {
        Some(match *field {
            "hz" | "sa/s" | "s/s" | "1/s" => 1.0,
            "khz" | "ks/s" | "ksa/s" => 1e3,
            "mhz" | "ms/s" => 1e6,
            other => Unit::named(other).filter(|unit| unit.dimension == Dimension::Time)?.size,
        })
    });
    let size = unit.unwrap_or(1.0) * number;
    let rate = if is_interval { 1.0 / size } else { size };
    // Assumed: no motion is recorded outside of these.
    let of_samples = ["sampl", "abtast", "scan", "delta", "increment"];
    let is_of_samples = of_samples.iter().any(|word| line.contains(word));
    (1.0..1e7).contains(&rate).then_some((rate, is_of_samples))
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
    roughness(values) < 0.1
}

/// How much the steps from row to row change, as part of how large they are, of squares.
fn roughness(values: &[f64]) -> f64 {
    let steps: Vec<f64> = steps(values).collect();
    let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
    let changes = size(&mut steps.windows(2).map(|pair| pair[1] - pair[0]));
    let moves = size(&mut steps.iter().copied());
    changes / moves
}
