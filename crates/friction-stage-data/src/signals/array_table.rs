//! A file of arrays as a table: its columns by their names, one row for each value.
//!
//! The columns that a mapping names are read at once; they must be of one length, since the arrays
//! of a file need not be.

use std::path::Path;

use friction_stage_core::model::nearest;

use super::arrays::{ArrayFile, Values, plain_name};
use super::data_quality::SignalNote;
use super::error::SignalError;
use super::mapping::{Column, Place, Signal, SignalSource};
use super::source::{NO_TIME, seconds_to_nanos};

/// Whether the name of a file says that it holds arrays.
pub(super) fn is_array_file(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    ending.is_some_and(|ending| ["mat", "npz", "npy"].contains(&ending.as_str()))
}

/// The columns of a file, for people.
pub(super) fn inventory(file: &ArrayFile) -> String {
    if file.columns.is_empty() {
        let others = file.others(0);
        let of = if others.is_empty() { "" } else { ", but " };
        return format!("no columns of numbers{of}{}", others.join(", "));
    }
    let words = file.columns.iter().map(|column| format!("{} ({})", column.name, column.length));
    words.collect::<Vec<_>>().join(", ")
}

/// Index of the column at a place.
pub(super) fn column(file: &ArrayFile, place: &Place) -> Result<usize, SignalError> {
    match place {
        Place::Column(column) => plain_column(file, column),
        place @ Place::Topic { .. } => Err(SignalError::Array {
            path: file.path.clone(),
            reason: format!("{place} is a topic, not a column"),
        }),
    }
}

fn plain_column(file: &ArrayFile, column: &Column) -> Result<usize, SignalError> {
    let missing = |reason: String| SignalError::Array { path: file.path.clone(), reason };
    match column {
        Column::Number(number) => Err(missing(format!(
            "column {number}: the columns of arrays have names; it has {}",
            inventory(file)
        ))),
        Column::Name(name) => {
            let wanted = plain_name(name);
            let names = || file.columns.iter().map(|column| column.name.as_str());
            names().position(|name| plain_name(name) == wanted).ok_or_else(|| {
                let hint = nearest(name, names());
                missing(format!("no column {name:?}; it has {}{hint}", inventory(file)))
            })
        }
    }
}

/// The columns of a mapping, read row by row.
pub(super) struct ArrayTable<'a> {
    file: &'a ArrayFile,
    /// Index of each column in the file.
    placed: Vec<usize>,
    columns: Vec<Values>,
    rows: usize,
    /// Rows that were read.
    at: usize,
    pub notes: Vec<SignalNote>,
}

impl<'a> ArrayTable<'a> {
    pub fn new(file: &'a ArrayFile) -> Self {
        let (placed, columns, notes) = (Vec::new(), Vec::new(), Vec::new());
        Self { file, placed, columns, rows: 0, at: 0, notes }
    }

    /// Index among the columns of the mapping.
    pub fn place(&mut self, _: Signal, source: &SignalSource) -> Result<usize, SignalError> {
        self.placed.push(column(self.file, &source.place)?);
        Ok(self.placed.len() - 1)
    }

    /// As [`place`](Self::place), for a column that is no signal.
    pub fn place_plain(&mut self, column: &Column) -> Result<usize, SignalError> {
        self.placed.push(plain_column(self.file, column)?);
        Ok(self.placed.len() - 1)
    }

    /// Reads the columns that were placed.
    pub fn read(&mut self) -> Result<(), SignalError> {
        let column = |index: usize| &self.file.columns[index];
        if let Some(first) = self.placed.first().copied().map(column) {
            let other = self.placed.iter().copied().map(column).find(|c| c.length != first.length);
            if let Some(other) = other {
                return Err(self.wrong(format!(
                    "{} has {} values and {} has {}: columns of one mapping are of one length",
                    first.name, first.length, other.name, other.length
                )));
            }
            self.rows = usize::try_from(first.length).unwrap_or(usize::MAX);
        }
        self.columns = self.file.read(&self.placed)?;
        Ok(())
    }

    /// Goes to the next row; false at the end.
    pub fn next(&mut self) -> bool {
        let is_there = self.at < self.rows;
        self.at += usize::from(is_there);
        is_there
    }

    /// Number of the row, from 1.
    pub fn row(&self) -> u64 {
        self.at as u64
    }

    pub fn wrong(&self, reason: String) -> SignalError {
        SignalError::Array { path: self.file.path.clone(), reason }
    }

    /// The number in a column of this row.
    pub fn number(&self, column: usize) -> Result<f64, SignalError> {
        let row = self.at.saturating_sub(1);
        match &self.columns[column] {
            Values::Numbers(values) => Ok(values[row]),
            Values::Whole(values) => Ok(values[row] as f64),
            Values::Times(_) => {
                let name = &self.file.columns[self.placed[column]].name;
                Err(self.wrong(format!("{name} holds times, not numbers")))
            }
        }
    }

    /// The time in a column of this row, ns; exact for whole numbers and for times.
    pub fn stamp(&self, column: usize, source: &SignalSource) -> i64 {
        let row = self.at.saturating_sub(1);
        match &self.columns[column] {
            Values::Times(values) => values[row],
            Values::Whole(values) => {
                let inexact = || seconds_to_nanos(source.to_si(values[row] as f64));
                source.whole_nanos(values[row]).unwrap_or_else(inexact)
            }
            Values::Numbers(values) if values[row].is_nan() => NO_TIME,
            Values::Numbers(values) => seconds_to_nanos(source.to_si(values[row])),
        }
    }
}

/// The values of columns for a look at them, as numbers; times in s since the first.
pub(super) fn samples(
    file: &ArrayFile,
    columns: &[usize],
    most: usize,
) -> Result<Vec<(Vec<f64>, bool)>, SignalError> {
    let since = |values: Vec<i64>| {
        let begin = values.iter().copied().find(|value| *value != NO_TIME).unwrap_or(0);
        let time = |value: &i64| match *value {
            NO_TIME => f64::NAN,
            value => value.saturating_sub(begin) as f64 * 1e-9,
        };
        values.iter().map(time).collect()
    };
    let numbers = |values: Values| match values {
        Values::Numbers(values) => (values, false),
        Values::Whole(values) => (values.into_iter().map(|v| v as f64).collect(), false),
        Values::Times(values) => (since(values), true),
    };
    Ok(file.read_first(columns, most)?.into_iter().map(numbers).collect())
}
