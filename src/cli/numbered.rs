//! Plans of numbered jobs: rows in chunks, resume, shards and Ctrl-C, for a selection and a sweep.

use std::io::Write;
use std::ops::Range;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;

use super::Interrupted;
use super::progress::Progress;
use crate::interrupt::{self, Patience};
use crate::made_by;
use friction_stage_lab::{NumberedPlan, Rows, Shard, Sheet};

/// Where the rows are and which part of them is computed.
#[derive(Debug, Clone, Args)]
pub struct RowsArgs {
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Go on with what is in --out
    #[arg(long, conflicts_with = "force")]
    pub resume: bool,
    /// Replace the results that the directory holds
    #[arg(long)]
    pub force: bool,
    /// Compute part i of n only; `friction-stage merge` puts the parts together
    #[arg(long, value_name = "I/N", default_value_t = Shard::WHOLE)]
    pub shard: Shard,
}

/// Most jobs between two writes.
const CHUNK: u64 = 1024;
/// Time between two writes that is aimed at: what a killed run loses, and how long Ctrl-C takes.
const BETWEEN_WRITES: Duration = Duration::from_millis(100);

impl RowsArgs {
    /// Opens the rows of a plan and computes those that are missing.
    pub fn compute<P: NumberedPlan>(
        &self,
        plan: P,
        run: impl Fn(&P, Range<u64>) -> anyhow::Result<Vec<P::Outcome>>,
    ) -> anyhow::Result<Rows<P>> {
        interrupt::writes(&self.out);
        if self.force {
            Rows::<P>::discard(&self.out)?;
        }
        if self.resume && !self.out.exists() {
            eprintln!("note: nothing to resume in {}: from the beginning", self.out.display());
        }
        let (rows, done) = Rows::open(&self.out, Sheet::new(plan, self.shard), self.resume)?;
        let (plan, jobs) = (&rows.sheet().plan, rows.sheet().jobs());
        let count = jobs.end - jobs.start;
        let _patience = Patience::begin();
        let progress = Progress::of(count, format!("{count} {}", P::ROWS));
        progress.reach(done);
        let mut next = jobs.start + done;
        let mut size = rayon::current_num_threads() as u64;
        while next < jobs.end {
            if interrupt::seen() {
                return Err(Interrupted(format!(
                    "stopped after {} of {count} {}, which are kept in {}: continue with --resume",
                    next - jobs.start,
                    P::ROWS,
                    self.out.display()
                ))
                .into());
            }
            let began = Instant::now();
            let chunk = next..(next + size).min(jobs.end);
            next = chunk.end;
            rows.append(chunk.start, &run(plan, chunk)?)?;
            progress.reach(next - jobs.start);
            if began.elapsed() < BETWEEN_WRITES {
                size = (2 * size).min(CHUNK);
            }
        }
        made_by::write(&self.out)?;
        Ok(rows)
    }

    /// Whether the rows are a part only, which is said then.
    pub fn is_part<P: NumberedPlan>(
        &self,
        rows: &Rows<P>,
        out: &mut dyn Write,
    ) -> anyhow::Result<bool> {
        if self.shard == Shard::WHOLE {
            return Ok(false);
        }
        let jobs = rows.sheet().jobs();
        writeln!(
            out,
            "shard {} of {}: {} {} in {}",
            self.shard,
            rows.sheet().plan.count(),
            jobs.end - jobs.start,
            P::ROWS,
            rows.path().display()
        )?;
        Ok(true)
    }
}
