//! Proposes a mapping for a table, of text or of arrays.
//!
//! In goes a file; out comes a [`Proposal`]: what it looks like, and which column is likely which
//! signal, by its unit, its name, or the way it moves. What the file does not say is marked, for a
//! person to check.

mod choice;
mod questions;
mod series;
mod table;
mod time;
mod yaml;

use std::path::Path;

use serde::Serialize;

use self::table::{Samples, Table, samples};
use self::yaml::EITHER_DECIMAL;
use super::array_table::{self, is_array_file};
use super::arrays::ArrayFile;
use super::column_name::{ColumnName, Quantity};
use super::error::SignalError;
use super::mapping::{CsvLayout, Signal};
use super::text_layout::TextLayout;
use super::text_value::Decimal;
use super::unit::Unit;
use crate::bag::{BagError, is_recording};
use friction_stage_core::model::JointType;

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

/// Characters of a line that are quoted.
const QUOTED: usize = 60;

/// A column for a person: its name, or its number.
fn shown(column: &TableColumn) -> String {
    match column.name.as_str() {
        "" => format!("column {}", column.number),
        name => format!("`{name}`"),
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

fn has_motion(signals: &[ProposedSignal]) -> bool {
    let motion = [Signal::Position, Signal::Velocity];
    signals.iter().any(|found| motion.contains(&found.signal))
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

    /// The signals but for the time.
    pub fn recorded(&self) -> impl Iterator<Item = Signal> {
        let others = self.own_clocks.iter().flat_map(|other| &other.signals);
        let all = self.signals.iter().chain(others).map(|found| found.signal);
        all.filter(|signal| *signal != Signal::Time)
    }

    fn column(&self, number: usize) -> Option<&TableColumn> {
        self.columns.iter().find(|column| column.number == number)
    }

    /// Whether its times are dates or times of day, which are of the same clock in every file.
    pub fn has_dates(&self) -> bool {
        let time = self.signals.iter().find(|found| found.signal == Signal::Time);
        let column = time.and_then(|time| self.column(time.column));
        column.is_some_and(|column| column.smallest.is_none())
    }
}

/// The joint type that the units of the signals up to here speak of.
fn joint_of(signals: &[ProposedSignal]) -> JointType {
    let units = signals.iter().filter_map(|found| Unit::named(found.unit.as_deref()?));
    units.filter_map(Unit::joint).next().unwrap_or_default()
}
