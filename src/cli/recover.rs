//! `friction-stage recover`: a whole recording from one that was cut off.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::Outcome;
use super::progress::Progress;
use crate::interrupt;
use friction_stage_data::bag;
use friction_stage_report::words::recover_text;

/// Make a recording that was cut off, lost its index or is damaged whole again.
///
/// Copies every message that can be read into a new recording, with its times, together with model,
/// seed, version and arguments. The original is only read, never changed. Says how many messages of
/// each topic were kept, which bytes could not be used, and how much time is missing, as far as
/// that can be known. The new recording is MCAP; with --out it is made of a whole one, too, so that
/// a bag of sqlite3 or one that is compressed becomes MCAP.
///
/// Exit code: 0 the recording is whole already, 3 a new one was made, 1 nothing of it can be read.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage recover run_1            makes run_1_recovered\n  \
                  friction-stage recover run_1 --out run_1_whole"
)]
pub struct RecoverArgs {
    /// rosbag2 directory or one of its files: MCAP or sqlite3, compressed or not
    #[arg(value_name = "BAG")]
    pub bag: PathBuf,
    /// Directory to make; it must not exist; without this, the name of the bag with `_recovered`
    /// after it
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the report goes to `out`.
pub fn run(args: &RecoverArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    interrupt::writes(&bag::recovered(&args.bag, args.out.as_deref())?);
    let progress = Progress::endless("reading");
    let report = bag::recover(&args.bag, args.out.as_deref())?;
    drop(progress);
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        writeln!(out, "{}", recover_text(&report))?;
    }
    Ok(if report.damage.is_empty() && report.output.is_none() {
        Outcome::Done
    } else {
        Outcome::Warnings
    })
}
