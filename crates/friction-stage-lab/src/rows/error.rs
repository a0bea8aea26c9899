//! Why rows of a plan could not be read, written or merged.

use std::io;
use std::path::{Path, PathBuf};

use crate::selection::Shard;

/// Why rows of a plan could not be read, written or merged.
#[derive(Debug, thiserror::Error)]
pub enum RowsError {
    /// A directory without a plan.
    #[error(
        "{} holds no selection and no sweep: its {} cannot be read: {source}",
        directory.display(),
        path.file_name().unwrap_or_default().display()
    )]
    NoPlan {
        /// The directory.
        directory: PathBuf,
        /// Where the plan would be.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A plan that cannot be read.
    #[error("{}: {reason}", path.display())]
    Plan {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A plan that cannot be written.
    #[error("cannot write the plan: {0}")]
    PlanText(String),
    /// A directory that holds rows.
    #[error(
        "{} holds a {kind} already: go on with it by --resume, begin again with --force, or choose \
         another --out",
        directory.display()
    )]
    Exists {
        /// What is to be begun.
        kind: &'static str,
        /// The directory.
        directory: PathBuf,
    },
    /// Rows that were begun with other arguments.
    #[error(
        "{} was begun with other arguments, {before} where it is now {now}: resume with the \
         same, or choose another --out",
        directory.display()
    )]
    OtherArguments {
        /// The directory.
        directory: PathBuf,
        /// A line of its plan.
        before: String,
        /// The line that it would be now.
        now: String,
    },
    /// A part that was cut off within a row.
    #[error(
        "shard {shard} in {} was cut off within a row: go on with it by --resume first",
        directory.display()
    )]
    Torn {
        /// The part.
        shard: Shard,
        /// Its directory.
        directory: PathBuf,
    },
    /// A part with fewer rows than planned.
    #[error(
        "shard {shard} in {} has {done} of its {wanted} {rows}: go on with it by --resume first",
        directory.display()
    )]
    Incomplete {
        /// The part.
        shard: Shard,
        /// Its directory.
        directory: PathBuf,
        /// Rows that there are.
        done: u64,
        /// Rows that are planned.
        wanted: u64,
        /// What a row is called.
        rows: &'static str,
    },
    /// A row that the plan does not have.
    #[error("{} line {line}: a row beyond the plan's", path.display())]
    Beyond {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
    },
    /// A row of another job than planned.
    #[error("{} line {line}: is {found}, the plan has {planned} there", path.display())]
    OtherRow {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// What the row is of.
        found: String,
        /// What the plan has there.
        planned: String,
    },
    /// A file whose columns are others than those of the plan.
    #[error("{}: the columns are not those of the {kind}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// What the plan is for.
        kind: &'static str,
    },
    /// A cell that is not what its column holds.
    #[error("{} line {line}: {column} is `{text}`, must be {wanted}", path.display())]
    Cell {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// Name of the column.
        column: String,
        /// What stands there.
        text: String,
        /// What would be right.
        wanted: &'static str,
    },
    /// A file that cannot be created, read or written.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was to be done.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A line of the rows that cannot be read or written.
    #[error("{}: {source}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the line.
        source: csv::Error,
    },
    /// A Parquet file that cannot be written.
    #[cfg(feature = "parquet")]
    #[error("cannot write {}: {source}", path.display())]
    Parquet {
        /// The file.
        path: PathBuf,
        /// What the library says.
        source: ::parquet::errors::ParquetError,
    },
    /// A file whose name does not say what it is.
    #[error("{}: must end in .csv or .parquet", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// No part was given.
    #[error("no shard was given")]
    NoParts,
    /// Two parts of different plans.
    #[error(
        "{} and {} are not of one plan: `{one}` and `{other}`",
        first.display(), second.display()
    )]
    OtherPlan {
        /// One of them.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// A line of the plan of the one.
        one: String,
        /// The same line of the other.
        other: String,
    },
    /// Two parts of different divisions.
    #[error(
        "{} is shard {one} and {} is shard {other}: not of one division",
        first.display(), second.display()
    )]
    OtherDivision {
        /// One of them.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// Part of the one.
        one: Shard,
        /// Part of the other.
        other: Shard,
    },
    /// One part twice.
    #[error("{} and {} are both shard {shard}", first.display(), second.display())]
    SameShard {
        /// One of them.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// The part.
        shard: Shard,
    },
    /// Parts that are missing.
    #[error("{missing} of {count} shards missing: {named}; compute them by --shard")]
    Missing {
        /// How many are missing.
        missing: u64,
        /// How many there are.
        count: u64,
        /// The first of those that are missing.
        named: String,
    },
}

impl RowsError {
    pub(super) fn io(action: &'static str, path: &Path) -> impl Fn(io::Error) -> RowsError {
        let path = path.to_owned();
        move |source| RowsError::Io { action, path: path.clone(), source }
    }
}
