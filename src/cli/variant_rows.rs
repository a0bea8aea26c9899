//! The rows of a selection on disk: one per variant, appended as they come, read back to go on, to
//! merge and to rank.
//!
//! A directory holds `plan.yaml` (everything that the rows follow from) and `variants.csv` (rows in
//! the order of the jobs). A run that was cut off leaves whole rows and at most one torn one at the
//! end.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Read as _, Seek as _, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use parquet::basic::Compression;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use serde::{Deserialize, Serialize};

use friction_stage_core::model::Guide;
use friction_stage_lab::{Plan, Shard, VariantResult, variant_seed};

/// What a directory of rows was computed from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sheet {
    pub schema_version: u32,
    /// Version of this program: another one may compute other bits.
    pub version: String,
    pub shard: Shard,
    pub plan: Plan,
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
/// Rows per group of the Parquet file: what is in memory at once.
const GROUP: usize = 65_536;
/// Columns of the Parquet file, as those of the CSV.
const SCHEMA: &str = "message variants {
    REQUIRED BYTE_ARRAY guide (UTF8);
    REQUIRED INT64 variant (INTEGER(64,false));
    REQUIRED INT64 seed (INTEGER(64,false));
    REQUIRED DOUBLE peak_error_m;
    OPTIONAL DOUBLE settling_time_s;
    REQUIRED BOOLEAN saturated;
    REQUIRED DOUBLE stiffness;
    REQUIRED DOUBLE bristle_damping;
    REQUIRED DOUBLE viscous_friction;
    REQUIRED DOUBLE coulomb_force;
    REQUIRED DOUBLE static_force;
    REQUIRED DOUBLE stribeck_velocity;
}";

impl Sheet {
    pub fn new(plan: Plan, shard: Shard) -> Sheet {
        Sheet { schema_version: 1, version: env!("CARGO_PKG_VERSION").to_owned(), shard, plan }
    }

    pub fn jobs(&self) -> Range<u64> {
        self.shard.jobs(self.plan.variants)
    }

    /// The sheet of a directory.
    pub fn read(directory: &Path) -> anyhow::Result<Sheet> {
        let path = directory.join(PLAN);
        let text = std::fs::read_to_string(&path).with_context(|| {
            format!("{} holds no selection: cannot read {}", directory.display(), path.display())
        })?;
        let sheet: Sheet = serde_saphyr::from_str(&text)
            .map_err(|error| anyhow::anyhow!("{}: {}", path.display(), error.without_snippet()))?;
        anyhow::ensure!(
            (1..=sheet.shard.count).contains(&sheet.shard.index)
                && !sheet.plan.candidates.is_empty(),
            "{}: shard {} of {} guides cannot be",
            path.display(),
            sheet.shard,
            sheet.plan.candidates.len()
        );
        Ok(sheet)
    }

    fn text(&self) -> anyhow::Result<String> {
        serde_saphyr::to_string(self).context("cannot write the plan")
    }

    /// The first line in which the two differ, if they do.
    pub fn difference(&self, other: &Sheet) -> anyhow::Result<Option<(String, String)>> {
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
    ) -> anyhow::Result<(VariantRows, u64)> {
        let there = directory.join(PLAN).exists();
        anyhow::ensure!(
            resume || !there && !directory.join(ROWS).exists(),
            "{} holds a selection already: go on with it by --resume, or choose another --out",
            directory.display()
        );
        std::fs::create_dir_all(directory)
            .with_context(|| format!("cannot create {}", directory.display()))?;
        let rows = VariantRows { directory: directory.to_owned(), sheet };
        if !there {
            let path = directory.join(PLAN);
            std::fs::write(&path, rows.sheet.text()?)
                .with_context(|| format!("cannot write {}", path.display()))?;
            return Ok((rows, 0));
        }
        if let Some((before, now)) = Sheet::read(directory)?.difference(&rows.sheet)? {
            anyhow::bail!(
                "{} was begun with other arguments, `{before}` where it is now `{now}`: resume \
                 with the same, or choose another --out",
                directory.display()
            );
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
    pub fn whole(directory: &Path) -> anyhow::Result<VariantRows> {
        let rows = VariantRows { directory: directory.to_owned(), sheet: Sheet::read(directory)? };
        anyhow::ensure!(
            !rows.has_torn_row()?,
            "shard {} in {} was cut off within a row: go on with it by --resume first",
            rows.sheet.shard,
            directory.display()
        );
        let mut done = 0;
        rows.read(&mut |_, _| {
            done += 1;
            Ok(())
        })?;
        let jobs = rows.sheet.jobs();
        let wanted = jobs.end - jobs.start;
        anyhow::ensure!(
            done == wanted,
            "shard {} in {} has {done} of its {wanted} variants: go on with it by --resume first",
            rows.sheet.shard,
            directory.display()
        );
        Ok(rows)
    }

    pub fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    pub fn path(&self) -> PathBuf {
        self.directory.join(ROWS)
    }

    /// Whether the last row was not written to its end.
    fn has_torn_row(&self) -> anyhow::Result<bool> {
        let path = self.path();
        let context = || format!("cannot read {}", path.display());
        if !path.exists() {
            return Ok(false);
        }
        let mut file = File::open(&path).with_context(context)?;
        if file.metadata().with_context(context)?.len() == 0 {
            return Ok(false);
        }
        let mut last = [0];
        file.seek(SeekFrom::End(-1)).with_context(context)?;
        file.read_exact(&mut last).with_context(context)?;
        Ok(last != *b"\n")
    }

    /// Cuts what stands after the last line feed: a row that was being written when the run ended.
    fn cut_torn_row(&self) -> anyhow::Result<()> {
        let path = self.path();
        if !path.exists() {
            return Ok(());
        }
        let context = || format!("cannot mend {}", path.display());
        let mut file =
            OpenOptions::new().read(true).write(true).open(&path).with_context(context)?;
        let size = file.metadata().with_context(context)?.len();
        // Longer than any row: a name of a guide may be long, numbers are not.
        let from = size.saturating_sub(65_536);
        file.seek(SeekFrom::Start(from)).with_context(context)?;
        let mut tail = Vec::new();
        file.read_to_end(&mut tail).with_context(context)?;
        let whole =
            tail.iter().rposition(|byte| *byte == b'\n').map_or(from, |at| from + at as u64 + 1);
        file.set_len(whole).with_context(context)
    }

    /// Appends the results of jobs in their order. What was appended stays whatever comes after.
    pub fn append(&self, first_job: u64, results: &[VariantResult]) -> anyhow::Result<()> {
        let path = self.path();
        let context = || format!("cannot write {}", path.display());
        let file =
            OpenOptions::new().create(true).append(true).open(&path).with_context(context)?;
        let headers = file.metadata().with_context(context)?.len() == 0;
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
            writer.serialize(row).with_context(context)?;
        }
        writer.flush().with_context(context)
    }

    /// Appends the rows of another directory as they are.
    pub fn append_rows_of(&self, other: &VariantRows) -> anyhow::Result<()> {
        let (from, to) = (other.path(), self.path());
        let context = || format!("cannot copy {} to {}", from.display(), to.display());
        let mut source = BufReader::new(File::open(&from).with_context(context)?);
        let mut target =
            OpenOptions::new().create(true).append(true).open(&to).with_context(context)?;
        let mut header = Vec::new();
        source.read_until(b'\n', &mut header).with_context(context)?;
        if target.metadata().with_context(context)?.len() == 0 {
            target.write_all(&header).with_context(context)?;
        }
        std::io::copy(&mut source, &mut target).with_context(context)?;
        Ok(())
    }

    /// Reads the rows one after the other, with the index of their guide; rows that the plan does
    /// not have are an error.
    pub fn read(
        &self,
        each: &mut dyn FnMut(usize, VariantResult) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let path = self.path();
        if !path.exists() {
            return Ok(());
        }
        let mut jobs = self.sheet.jobs();
        let mut reader = csv::Reader::from_path(&path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        for (line, row) in (2u64..).zip(reader.deserialize::<Row>()) {
            let row = row.with_context(|| format!("{} line {line}", path.display()))?;
            let Some(job) = jobs.next() else {
                anyhow::bail!("{} line {line}: a row beyond the plan's", path.display());
            };
            let (index, variant) = self.sheet.plan.job(job);
            let name = &self.sheet.plan.candidates[index].name;
            anyhow::ensure!(
                row.guide == *name && row.variant == variant,
                "{} line {line}: is variant {} of {}, the plan has variant {variant} of {name} \
                 there",
                path.display(),
                row.variant,
                row.guide
            );
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

    /// Writes the rows once more as Parquet, in groups, uncompressed columns of plain types that
    /// every reader takes.
    pub fn write_parquet(&self, path: &Path) -> anyhow::Result<()> {
        let context = || format!("cannot write {}", path.display());
        let schema = Arc::new(parse_message_type(SCHEMA).with_context(context)?);
        let properties = WriterProperties::builder()
            .set_compression(Compression::UNCOMPRESSED)
            .set_created_by(format!("friction-stage {}", env!("CARGO_PKG_VERSION")))
            .build();
        let file = File::create(path).with_context(context)?;
        let mut writer =
            SerializedFileWriter::new(file, schema, Arc::new(properties)).with_context(context)?;
        let mut group: Vec<(usize, VariantResult)> = Vec::new();
        self.read(&mut |index, result| {
            group.push((index, result));
            if group.len() == GROUP {
                self.write_group(&mut writer, &group).with_context(context)?;
                group.clear();
            }
            Ok(())
        })?;
        if !group.is_empty() {
            self.write_group(&mut writer, &group).with_context(context)?;
        }
        writer.close().with_context(context)?;
        Ok(())
    }

    fn write_group(
        &self,
        writer: &mut SerializedFileWriter<File>,
        rows: &[(usize, VariantResult)],
    ) -> Result<(), parquet::errors::ParquetError> {
        let plan = &self.sheet.plan;
        let name = |index: usize| plan.candidates[index].name.as_str();
        let numbers = |value: &dyn Fn(&VariantResult) -> f64| -> Vec<f64> {
            rows.iter().map(|(_, result)| value(result)).collect()
        };
        let of_guide = |value: fn(&Guide) -> f64| numbers(&|result| value(&result.guide));
        // Unsigned numbers keep their bits in the signed physical type, as the format has it.
        let words = |value: &dyn Fn(usize, u64) -> u64| -> Vec<i64> {
            rows.iter().map(|(index, result)| value(*index, result.variant) as i64).collect()
        };
        let mut group = writer.next_row_group()?;
        let mut column = 0;
        while let Some(mut target) = group.next_column()? {
            match column {
                0 => {
                    let names: Vec<ByteArray> =
                        rows.iter().map(|(index, _)| ByteArray::from(name(*index))).collect();
                    target.typed::<ByteArrayType>().write_batch(&names, None, None)?;
                }
                1 => {
                    target.typed::<Int64Type>().write_batch(
                        &words(&|_, variant| variant),
                        None,
                        None,
                    )?;
                }
                2 => {
                    let seeds =
                        words(&|index, variant| variant_seed(plan.seed, name(index), variant));
                    target.typed::<Int64Type>().write_batch(&seeds, None, None)?;
                }
                4 => {
                    let settled: Vec<f64> =
                        rows.iter().filter_map(|(_, result)| result.settling_time).collect();
                    let defined: Vec<i16> = rows
                        .iter()
                        .map(|(_, result)| i16::from(result.settling_time.is_some()))
                        .collect();
                    target.typed::<DoubleType>().write_batch(&settled, Some(&defined), None)?;
                }
                5 => {
                    let saturated: Vec<bool> =
                        rows.iter().map(|(_, result)| result.saturated).collect();
                    target.typed::<BoolType>().write_batch(&saturated, None, None)?;
                }
                _ => {
                    let values = match column {
                        3 => numbers(&|result| result.peak_error),
                        6 => of_guide(|guide| guide.stiffness),
                        7 => of_guide(|guide| guide.bristle_damping),
                        8 => of_guide(|guide| guide.viscous_friction),
                        9 => of_guide(|guide| guide.coulomb_force),
                        10 => of_guide(|guide| guide.static_force),
                        _ => of_guide(|guide| guide.stribeck_velocity),
                    };
                    target.typed::<DoubleType>().write_batch(&values, None, None)?;
                }
            }
            target.close()?;
            column += 1;
        }
        group.close()?;
        Ok(())
    }
}
