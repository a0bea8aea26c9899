//! `friction-stage merge`: the shards of a selection or a sweep put together, bit for bit what one
//! run gives.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::progress::Progress;
use super::{Outcome, selection_output, sweep};
use crate::interrupt;
use crate::made_by;
use friction_stage_lab::{NumberedPlan, Rows, SelectionPlan, SweepPlan, kind_of, merge_shards};

/// Put the shards of a selection or a sweep together: the same rows and results, bit for
/// bit, as one run without --shard.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:\n  friction-stage merge part_* --out whole")]
pub struct MergeArgs {
    /// Directories that `select --shard i/n` or `sweep --shard i/n` wrote, in any order
    #[arg(value_name = "DIR", required = true)]
    pub shards: Vec<PathBuf>,
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace the results that the directory holds
    #[arg(long)]
    pub force: bool,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; results go to `out`.
pub fn run(args: &MergeArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    interrupt::writes(&args.out);
    let is_sweep = match args.shards.first() {
        Some(first) => kind_of(first)? == SweepPlan::KIND,
        None => false,
    };
    if is_sweep {
        let rows = merged::<SweepPlan>(args)?;
        return sweep::finish(&args.out, &rows, args.json, out);
    }
    selection_output::finish(&args.out, &merged::<SelectionPlan>(args)?, args.json, out)
}

fn merged<P: NumberedPlan>(args: &MergeArgs) -> anyhow::Result<Rows<P>> {
    anyhow::ensure!(
        !args.shards.contains(&args.out),
        "{} is one of the shards: choose another --out",
        args.out.display()
    );
    if args.force {
        Rows::<P>::discard(&args.out)?;
    }
    let progress = Progress::endless("merging");
    let rows = merge_shards(&args.shards, &args.out)?;
    drop(progress);
    made_by::write(&args.out)?;
    Ok(rows)
}
