//! `friction-stage merge`: the shards of a selection put together, bit for bit what one run gives.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::Outcome;
use super::selection_output::finish;
use friction_stage_lab::merge_shards;

/// Put the shards of a selection together: the same files, bit for bit, as one run without --shard.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:\n  friction-stage merge part_* --out whole")]
pub struct MergeArgs {
    /// Directories that `friction-stage select --shard i/n` wrote, in any order
    #[arg(value_name = "DIR", required = true)]
    pub shards: Vec<PathBuf>,
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; results go to `out`.
pub fn run(args: &MergeArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let rows = merge_shards(&args.shards, &args.out)?;
    finish(&args.out, &rows, args.json, out)
}
