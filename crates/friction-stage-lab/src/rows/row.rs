//! What the rows of a plan look like: columns by name and kind, and the cells of a row.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::RowsError;

/// Work whose jobs are numbered and of which each gives one row. A job depends on its number alone,
/// so that any part of them can be computed anywhere in any order.
pub trait NumberedPlan: Clone + PartialEq + Serialize + DeserializeOwned {
    /// What a job gives.
    type Outcome;
    /// What the plan is for, in words: `selection`.
    const KIND: &'static str;
    /// Name of the files with the rows, and what a row is called: `variants`.
    const ROWS: &'static str;
    /// Number of jobs.
    fn count(&self) -> u64;
    /// Why a plan that was read from a file cannot be.
    fn obstacle(&self) -> Option<String>;
    /// The columns of a row.
    fn columns(&self) -> Vec<Column>;
    /// The cells of a job's row, one for each column.
    fn row(&self, job: u64, outcome: &Self::Outcome) -> Vec<Cell>;
    /// What a row says, or what it has and what the plan has in its place.
    fn outcome(&self, job: u64, row: &[Cell]) -> Result<Self::Outcome, OtherJob>;
}

/// A row of another job than planned.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherJob {
    /// What the row is of.
    pub found: String,
    /// What the plan has there.
    pub planned: String,
}

/// A column.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Its name, with the unit as the last part.
    pub name: String,
    /// What its cells are.
    pub kind: ColumnKind,
}

/// What the cells of a column are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    /// Text; an empty one is none.
    Text,
    /// A whole number.
    Count,
    /// A number.
    Number,
    /// A number or none.
    Optional,
    /// Yes or no.
    Flag,
}

/// A cell.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Cell {
    /// Of a column of texts.
    Text(String),
    /// Of a column of whole numbers.
    Count(u64),
    /// Of a column of numbers.
    Number(f64),
    /// Of a column of numbers that may be missing.
    Optional(Option<f64>),
    /// Of a column of yes or no.
    Flag(bool),
}

impl Column {
    /// A column of this name and kind.
    pub fn new(name: impl Into<String>, kind: ColumnKind) -> Column {
        Column { name: name.into(), kind }
    }

    /// The cell that a text of this column is.
    pub(super) fn cell(&self, text: &str) -> Option<Cell> {
        let number = || text.parse::<f64>().ok();
        Some(match self.kind {
            ColumnKind::Text => Cell::Text(text.to_owned()),
            ColumnKind::Count => Cell::Count(text.parse().ok()?),
            ColumnKind::Number => Cell::Number(number()?),
            ColumnKind::Optional if text.is_empty() => Cell::Optional(None),
            ColumnKind::Optional => Cell::Optional(Some(number()?)),
            ColumnKind::Flag => Cell::Flag(text.parse().ok()?),
        })
    }

    /// What its cells are, in words.
    pub(super) fn words(&self) -> &'static str {
        match self.kind {
            ColumnKind::Text => "a text",
            ColumnKind::Count => "a whole number",
            ColumnKind::Number => "a number",
            ColumnKind::Optional => "a number or nothing",
            ColumnKind::Flag => "true or false",
        }
    }
}

impl Cell {
    /// The number of a cell, where it has one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Cell::Number(number) => Some(*number),
            Cell::Optional(number) => *number,
            _ => None,
        }
    }

    /// Whether a cell says yes.
    pub fn flag(&self) -> bool {
        matches!(self, Cell::Flag(true))
    }

    /// The whole number of a cell; 0 where it has none.
    pub fn count(&self) -> u64 {
        if let Cell::Count(count) = self { *count } else { 0 }
    }

    /// The text of a cell; empty where it has none.
    pub fn text(&self) -> &str {
        if let Cell::Text(text) = self { text } else { "" }
    }
}

/// The cells of a record of the file.
pub(super) fn cells(
    columns: &[Column],
    record: &csv::StringRecord,
    place: impl Fn() -> (std::path::PathBuf, u64),
) -> Result<Vec<Cell>, RowsError> {
    columns
        .iter()
        .zip(record)
        .map(|(column, text)| {
            column.cell(text).ok_or_else(|| {
                let (path, line) = place();
                RowsError::Cell {
                    path,
                    line,
                    column: column.name.clone(),
                    text: text.to_owned(),
                    wanted: column.words(),
                }
            })
        })
        .collect()
}
