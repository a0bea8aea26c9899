//! The rows of a numbered plan on disk, of a selection or of a sweep: one per job, appended as they
//! come, read back to resume, to merge and to evaluate.
//!
//! A directory holds `plan.yaml` (everything that the rows follow from) and the rows as CSV
//! (`variants.csv`, `points.csv`) in the order of the jobs. A run that was cut off leaves whole
//! rows and at most one torn one at the end.

mod error;
mod merge;
#[cfg(feature = "parquet")]
mod parquet;
mod row;
mod table;

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Read as _, Seek as _, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use self::error::RowsError;
pub use self::merge::{kind_of, merge_shards};
#[cfg(feature = "parquet")]
pub use self::parquet::ParquetTable;
pub use self::row::{Cell, Column, ColumnKind, NumberedPlan, OtherJob};
pub use self::table::{TableFormat, write_table};
use crate::selection::{SelectionPlan, Shard};
use friction_stage_core::{text_file, yaml};

/// What a directory of rows was computed from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[serde(bound = "P: NumberedPlan")]
pub struct Sheet<P> {
    /// What the plan is for; that of a file without it is a selection.
    #[serde(default = "selection")]
    pub kind: String,
    /// Version of the file.
    pub schema_version: u32,
    /// Version of this program: another one may compute other bits.
    pub version: String,
    /// Which part of the jobs the rows are.
    pub shard: Shard,
    /// What is computed.
    pub plan: P,
}

/// A directory of rows.
#[derive(Debug)]
pub struct Rows<P> {
    directory: PathBuf,
    sheet: Sheet<P>,
}

/// The rows of a selection: one per variant.
pub type VariantRows = Rows<SelectionPlan>;

const PLAN: &str = "plan.yaml";

fn selection() -> String {
    SelectionPlan::KIND.to_owned()
}

impl<P: NumberedPlan> Sheet<P> {
    /// The sheet of a part of a plan, computed by this version.
    pub fn new(plan: P, shard: Shard) -> Sheet<P> {
        Sheet {
            kind: P::KIND.to_owned(),
            schema_version: 1,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            shard,
            plan,
        }
    }

    /// Jobs of this part.
    pub fn jobs(&self) -> Range<u64> {
        self.shard.jobs(self.plan.count())
    }

    /// The sheet of a directory.
    pub fn read(directory: &Path) -> Result<Sheet<P>, RowsError> {
        let path = directory.join(PLAN);
        let text = plan_text(directory)?;
        let sheet: Sheet<P> =
            yaml::read(&text).map_err(|reason| RowsError::Plan { path: path.clone(), reason })?;
        let reason = match sheet.plan.obstacle() {
            Some(reason) => reason,
            None if sheet.kind != P::KIND => format!("is of a {}", sheet.kind),
            None if !(1..=sheet.shard.count).contains(&sheet.shard.index) => {
                format!("shard {} cannot be", sheet.shard)
            }
            None => return Ok(sheet),
        };
        Err(RowsError::Plan { path, reason })
    }

    fn text(&self) -> Result<String, RowsError> {
        serde_saphyr::to_string(self).map_err(|error| RowsError::PlanText(error.to_string()))
    }

    /// The first line in which the two differ, if they do.
    pub fn difference(&self, other: &Sheet<P>) -> Result<Option<(String, String)>, RowsError> {
        let (own, other) = (self.text()?, other.text()?);
        let (mut own, mut other) = (own.lines(), other.lines());
        loop {
            match (own.next(), other.next()) {
                (None, None) => return Ok(None),
                (a, b) if a == b => {}
                (a, b) => {
                    let bare = |line: &str| line.trim().trim_end_matches(',').to_owned();
                    let reported = |line: Option<&str>| line.map_or("nothing".to_owned(), bare);
                    return Ok(Some((reported(a), reported(b))));
                }
            }
        }
    }
}

/// The text of the plan of a directory.
fn plan_text(directory: &Path) -> Result<String, RowsError> {
    let path = directory.join(PLAN);
    text_file::read(&path).map_err(|source| RowsError::NoPlan {
        directory: directory.to_owned(),
        path: path.clone(),
        source,
    })
}

impl<P: NumberedPlan> Rows<P> {
    /// Starts rows in a directory; with `resume`, goes on with those that are there. Returns how
    /// many are.
    pub fn open(
        directory: &Path,
        sheet: Sheet<P>,
        resume: bool,
    ) -> Result<(Rows<P>, u64), RowsError> {
        let there = directory.join(PLAN).exists();
        let rows = Rows { directory: directory.to_owned(), sheet };
        if !resume && (there || rows.path().exists()) {
            return Err(RowsError::Exists { kind: P::KIND, directory: directory.to_owned() });
        }
        std::fs::create_dir_all(directory).map_err(RowsError::io("create", directory))?;
        if !there {
            let path = directory.join(PLAN);
            std::fs::write(&path, rows.sheet.text()?).map_err(RowsError::io("write", &path))?;
            return Ok((rows, 0));
        }
        if let Some((before, now)) = Sheet::read(directory)?.difference(&rows.sheet)? {
            let directory = directory.to_owned();
            return Err(RowsError::OtherArguments { directory, before, now });
        }
        rows.cut_torn_row()?;
        let mut done = 0;
        rows.read(&mut |_, _| {
            done += 1;
            Ok(())
        })?;
        Ok((rows, done))
    }

    /// Removes the rows and what was made of them, if a directory holds any.
    pub fn discard(directory: &Path) -> Result<(), RowsError> {
        let names = [format!("{}.csv", P::ROWS), format!("{}.parquet", P::ROWS)];
        for name in [PLAN, "summary.json"].into_iter().chain(names.iter().map(String::as_str)) {
            let path = directory.join(name);
            match std::fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(RowsError::io("replace", &path)(error));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// The rows of a directory, which must all be there.
    pub fn whole(directory: &Path) -> Result<Rows<P>, RowsError> {
        let rows = Rows { directory: directory.to_owned(), sheet: Sheet::read(directory)? };
        let shard = rows.sheet.shard;
        if rows.has_torn_row()? {
            return Err(RowsError::Torn { shard, directory: directory.to_owned() });
        }
        let mut done = 0;
        rows.read(&mut |_, _| {
            done += 1;
            Ok(())
        })?;
        let jobs = rows.sheet.jobs();
        let wanted = jobs.end - jobs.start;
        if done != wanted {
            let directory = directory.to_owned();
            return Err(RowsError::Incomplete { shard, directory, done, wanted, rows: P::ROWS });
        }
        Ok(rows)
    }

    /// What the rows are computed from.
    pub fn sheet(&self) -> &Sheet<P> {
        &self.sheet
    }

    /// The file with the rows.
    pub fn path(&self) -> PathBuf {
        self.directory.join(format!("{}.csv", P::ROWS))
    }

    /// Whether the last row was not written to its end.
    fn has_torn_row(&self) -> Result<bool, RowsError> {
        let path = self.path();
        if !path.exists() {
            return Ok(false);
        }
        let mut file = File::open(&path).map_err(RowsError::io("read", &path))?;
        if file.metadata().map_err(RowsError::io("read", &path))?.len() == 0 {
            return Ok(false);
        }
        let mut last = [0];
        file.seek(SeekFrom::End(-1)).map_err(RowsError::io("read", &path))?;
        file.read_exact(&mut last).map_err(RowsError::io("read", &path))?;
        Ok(last != *b"\n")
    }

    /// Cuts what stands after the last line feed: a row that was being written when the run ended.
    fn cut_torn_row(&self) -> Result<(), RowsError> {
        let path = self.path();
        if !path.exists() {
            return Ok(());
        }
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .open(&path)
            .map_err(RowsError::io("mend", &path))?;
        let size = file.metadata().map_err(RowsError::io("mend", &path))?.len();
        // Longer than any row: a name of a guide may be long, numbers are not.
        let from = size.saturating_sub(65_536);
        file.seek(SeekFrom::Start(from)).map_err(RowsError::io("mend", &path))?;
        let mut tail = Vec::new();
        file.read_to_end(&mut tail).map_err(RowsError::io("mend", &path))?;
        let whole =
            tail.iter().rposition(|byte| *byte == b'\n').map_or(from, |at| from + at as u64 + 1);
        file.set_len(whole).map_err(RowsError::io("mend", &path))
    }

    /// Appends the outcomes of jobs in their order. What was appended is kept whatever comes after.
    pub fn append(&self, first_job: u64, outcomes: &[P::Outcome]) -> Result<(), RowsError> {
        let path = self.path();
        let file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(RowsError::io("write", &path))?;
        let begins = file.metadata().map_err(RowsError::io("write", &path))?.len() == 0;
        let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(file);
        let failed = |source| RowsError::Csv { path: path.clone(), source };
        let plan = &self.sheet.plan;
        if begins {
            let columns = plan.columns();
            writer.write_record(columns.iter().map(|column| &column.name)).map_err(failed)?;
        }
        for (job, outcome) in (first_job..).zip(outcomes) {
            writer.serialize(plan.row(job, outcome)).map_err(failed)?;
        }
        writer.flush().map_err(RowsError::io("write", &path))
    }

    /// Appends the rows of another directory as they are.
    pub fn append_rows_of(&self, other: &Rows<P>) -> Result<(), RowsError> {
        let (from, to) = (other.path(), self.path());
        let mut source = BufReader::new(File::open(&from).map_err(RowsError::io("read", &from))?);
        let mut target = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&to)
            .map_err(RowsError::io("write", &to))?;
        let mut header = Vec::new();
        source.read_until(b'\n', &mut header).map_err(RowsError::io("read", &from))?;
        if target.metadata().map_err(RowsError::io("write", &to))?.len() == 0 {
            target.write_all(&header).map_err(RowsError::io("write", &to))?;
        }
        std::io::copy(&mut source, &mut target).map_err(RowsError::io("write", &to))?;
        Ok(())
    }

    /// Reads the rows one after the other, with the number of their job; rows that the plan does
    /// not have are an error.
    pub fn read(
        &self,
        each: &mut dyn FnMut(u64, P::Outcome) -> Result<(), RowsError>,
    ) -> Result<(), RowsError> {
        let path = self.path();
        if !path.exists() {
            return Ok(());
        }
        let mut jobs = self.sheet.jobs();
        let (plan, columns) = (&self.sheet.plan, self.sheet.plan.columns());
        let failed = |source| RowsError::Csv { path: path.clone(), source };
        let mut reader = csv::Reader::from_path(&path).map_err(failed)?;
        let header = reader.headers().map_err(failed)?;
        if !header.iter().eq(columns.iter().map(|column| column.name.as_str())) {
            return Err(RowsError::Header { path, kind: P::KIND });
        }
        for (line, record) in (2u64..).zip(reader.records()) {
            let record = record.map_err(failed)?;
            let row = row::cells(&columns, &record, || (path.clone(), line))?;
            let Some(job) = jobs.next() else {
                return Err(RowsError::Beyond { path, line });
            };
            match plan.outcome(job, &row) {
                Ok(outcome) => each(job, outcome)?,
                Err(OtherJob { found, planned }) => {
                    return Err(RowsError::OtherRow { path, line, found, planned });
                }
            }
        }
        Ok(())
    }
}
