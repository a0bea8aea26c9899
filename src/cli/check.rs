//! `friction-stage check`: what a recording holds and what is wrong with it.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::Outcome;
use crate::bag;

/// Show what a recording holds and whether anything is wrong with it.
///
/// Lists per topic how many messages there are, their rate, jitter and gaps, stamps that repeat or go back, values that are
/// not finite and messages that do not decode; says whether the recording is complete and what made it; and, if there is
/// an encoder, which stroke and velocities the motion covers and how often it turns round. Takes rosbag2 directories and MCAP
/// files, also those of other programs.
///
/// Exit code: 0 nothing wrong, 3 with warnings, 1 nothing of it can be read.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage check run_1\n  friction-stage check run_1 --json | jq .coverage")]
pub struct CheckArgs {
    /// rosbag2 directory or MCAP file
    #[arg(value_name = "BAG")]
    pub bag: PathBuf,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the report goes to `out`.
pub fn run(args: &CheckArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let report = bag::check(&args.bag)?;
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        write!(out, "{report}")?;
    }
    Ok(if report.warnings.is_empty() { Outcome::Done } else { Outcome::Warnings })
}
