//! The rows of a selection on disk: one per variant, appended as they come, read back to go on, to
//! merge and to rank.
//!
//! A directory holds `plan.yaml` (everything that the rows follow from) and `variants.csv` (rows in
//! the order of the jobs). A run that was cut off leaves whole rows and at most one torn one at the
//! end.

mod error;
mod merge;
#[cfg(feature = "parquet")]
mod parquet;

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Read as _, Seek as _, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use self::error::RowsError;
pub use self::merge::merge_shards;
use crate::selection::{GuideSelection, SelectionPlan, Shard, Tally};
use crate::variant::{VariantResult, variant_seed};
use friction_stage_core::model::Guide;
use friction_stage_core::text_file;

/// What a directory of rows was computed from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sheet {
    /// Version of the file.
    pub schema_version: u32,
    /// Version of this program: another one may compute other bits.
    pub version: String,
    /// Which part of the jobs the rows are.
    pub shard: Shard,
    /// What is computed.
    pub plan: SelectionPlan,
}

/// One line of `variants.csv`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Row {
    guide: String,
    variant: u64,
    seed: u64,
    peak_error_m: f64,
    settling_time_s: Option<f64>,
    saturated: bool,
    stiffness: f64,
    bristle_damping: f64,
    viscous_friction: f64,
    coulomb_force: f64,
    static_force: f64,
    stribeck_velocity: f64,
}

/// A directory of rows.
#[derive(Debug)]
pub struct VariantRows {
    directory: PathBuf,
    sheet: Sheet,
}

const PLAN: &str = "plan.yaml";
const ROWS: &str = "variants.csv";
impl Sheet {
    /// The sheet of a part of a plan, computed by this version.
    pub fn new(plan: SelectionPlan, shard: Shard) -> Sheet {
        Sheet { schema_version: 1, version: env!("CARGO_PKG_VERSION").to_owned(), shard, plan }
    }

    /// Jobs of this part.
    pub fn jobs(&self) -> Range<u64> {
        self.shard.jobs(self.plan.variants)
    }

    /// The sheet of a directory.
    pub fn read(directory: &Path) -> Result<Sheet, RowsError> {
        let path = directory.join(PLAN);
        let text = text_file::read(&path).map_err(|source| RowsError::NoSelection {
            directory: directory.to_owned(),
            path: path.clone(),
            source,
        })?;
        let sheet: Sheet = serde_saphyr::from_str(&text).map_err(|error| {
            let reason = error.without_snippet().to_string();
            RowsError::Plan { path: path.clone(), reason }
        })?;
        let guides = sheet.plan.candidates.len();
        if !(1..=sheet.shard.count).contains(&sheet.shard.index) || guides == 0 {
            return Err(RowsError::ImpossibleShard { path, shard: sheet.shard, guides });
        }
        Ok(sheet)
    }

    fn text(&self) -> Result<String, RowsError> {
        serde_saphyr::to_string(self).map_err(|error| RowsError::PlanText(error.to_string()))
    }

    /// The first line in which the two differ, if they do.
    pub fn difference(&self, other: &Sheet) -> Result<Option<(String, String)>, RowsError> {
        let (own, other) = (self.text()?, other.text()?);
        let (mut own, mut other) = (own.lines(), other.lines());
        loop {
            match (own.next(), other.next()) {
                (None, None) => return Ok(None),
                (a, b) if a == b => {}
                (a, b) => {
                    let told = |line: Option<&str>| line.map_or("nothing", str::trim).to_owned();
                    return Ok(Some((told(a), told(b))));
                }
            }
        }
    }
}

impl VariantRows {
    /// Starts rows in a directory; with `resume`, goes on with those that are there. Returns how
    /// many are.
    pub fn open(
        directory: &Path,
        sheet: Sheet,
        resume: bool,
    ) -> Result<(VariantRows, u64), RowsError> {
        let there = directory.join(PLAN).exists();
        if !resume && (there || directory.join(ROWS).exists()) {
            return Err(RowsError::Exists { directory: directory.to_owned() });
        }
        std::fs::create_dir_all(directory).map_err(RowsError::io("create", directory))?;
        let rows = VariantRows { directory: directory.to_owned(), sheet };
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

    /// The rows of a directory, which must all be there.
    pub fn whole(directory: &Path) -> Result<VariantRows, RowsError> {
        let rows = VariantRows { directory: directory.to_owned(), sheet: Sheet::read(directory)? };
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
            return Err(RowsError::Incomplete { shard, directory, done, wanted });
        }
        Ok(rows)
    }

    /// What the rows are computed from.
    pub fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    /// The file with the rows.
    pub fn path(&self) -> PathBuf {
        self.directory.join(ROWS)
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

    /// Appends the results of jobs in their order. What was appended stays whatever comes after.
    pub fn append(&self, first_job: u64, results: &[VariantResult]) -> Result<(), RowsError> {
        let path = self.path();
        let file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(RowsError::io("write", &path))?;
        let headers = file.metadata().map_err(RowsError::io("write", &path))?.len() == 0;
        let mut writer = csv::WriterBuilder::new().has_headers(headers).from_writer(file);
        let plan = &self.sheet.plan;
        for (job, result) in (first_job..).zip(results) {
            let (index, variant) = plan.job(job);
            let name = &plan.candidates[index].name;
            let VariantResult { guide, .. } = result;
            let row = Row {
                guide: name.clone(),
                variant,
                seed: variant_seed(plan.seed, name, variant),
                peak_error_m: result.peak_error,
                settling_time_s: result.settling_time,
                saturated: result.saturated,
                stiffness: guide.stiffness,
                bristle_damping: guide.bristle_damping,
                viscous_friction: guide.viscous_friction,
                coulomb_force: guide.coulomb_force,
                static_force: guide.static_force,
                stribeck_velocity: guide.stribeck_velocity,
            };
            writer
                .serialize(row)
                .map_err(|source| RowsError::Csv { path: path.clone(), source })?;
        }
        writer.flush().map_err(RowsError::io("write", &path))
    }

    /// Appends the rows of another directory as they are.
    pub fn append_rows_of(&self, other: &VariantRows) -> Result<(), RowsError> {
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

    /// Reads the rows one after the other, with the index of their guide; rows that the plan does
    /// not have are an error.
    pub fn read(
        &self,
        each: &mut dyn FnMut(usize, VariantResult) -> Result<(), RowsError>,
    ) -> Result<(), RowsError> {
        let path = self.path();
        if !path.exists() {
            return Ok(());
        }
        let mut jobs = self.sheet.jobs();
        let failed = |source| RowsError::Csv { path: path.clone(), source };
        let mut reader = csv::Reader::from_path(&path).map_err(failed)?;
        for (line, row) in (2u64..).zip(reader.deserialize::<Row>()) {
            let row = row.map_err(failed)?;
            let Some(job) = jobs.next() else {
                return Err(RowsError::Beyond { path, line });
            };
            let (index, variant) = self.sheet.plan.job(job);
            let name = &self.sheet.plan.candidates[index].name;
            if row.guide != *name || row.variant != variant {
                return Err(RowsError::OtherRow {
                    path,
                    line,
                    found: (row.guide, row.variant),
                    planned: (name.clone(), variant),
                });
            }
            let guide = Guide {
                stiffness: row.stiffness,
                bristle_damping: row.bristle_damping,
                viscous_friction: row.viscous_friction,
                coulomb_force: row.coulomb_force,
                static_force: row.static_force,
                stribeck_velocity: row.stribeck_velocity,
                damping_velocity: None,
            };
            let result = VariantResult {
                variant,
                peak_error: row.peak_error_m,
                settling_time: row.settling_time_s,
                saturated: row.saturated,
                guide,
            };
            each(index, result)?;
        }
        Ok(())
    }

    /// Per guide what its variants reach, and all guides ranked by that.
    pub fn ranked(&self) -> Result<(Vec<Tally>, GuideSelection), RowsError> {
        let plan = &self.sheet.plan;
        let mut tallies = vec![Tally::default(); plan.candidates.len()];
        self.read(&mut |index, result| {
            tallies[index].add(&result, &plan.application);
            Ok(())
        })?;
        let selection = plan.rank(&tallies);
        Ok((tallies, selection))
    }
}
