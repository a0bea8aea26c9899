//! `friction-stage check`: what a recording holds, what is wrong with it, and what can be
//! identified from it.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::progress::Progress;
use super::{Outcome, PartArgs};
use friction_stage_core::plant::model_named;
use friction_stage_data::quality::RecordingCheck;
use friction_stage_data::signals::Mapping;
use friction_stage_report::recording::recording_json;
use friction_stage_report::words::recording_text;

/// Show what a recording holds, whether anything is wrong with it, and what can be identified from
/// it.
///
/// Lists per topic how many messages there are, their rate, jitter and gaps, stamps that repeat or
/// go back, values that are not finite and messages that do not decode; says whether the recording
/// is complete and what made it; and, if there is an encoder, which stroke and velocities the
/// motion covers and how often it turns round. Then it says what the data can identify and what
/// not: speeds, amplitudes, rests, the noise that is in them, and signals that are clipped,
/// constant, of the wrong sign or in the wrong unit. Takes rosbag2 directories and their
/// files (MCAP or sqlite3, compressed or not), also those of other programs, and tables (CSV, .mat,
/// .npz, .npy); a mapping says which topic and field, or which column, is which signal.
///
/// Exit code: 0 nothing wrong, 3 with warnings, 1 nothing of it can be read. What stands in the way
/// of identification counts as a warning if --model or --mapping asks for it. Notes, such as that
/// there is no force cell, are no warnings.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage check run_1\n  friction-stage check run_1 --model \
                  guide_1\n  friction-stage check drive.csv --mapping drive.yaml --json | jq \
                  .identification.problems"
)]
pub struct CheckArgs {
    /// rosbag2 directory or one of its files, or a table
    #[arg(value_name = "BAG")]
    pub bag: PathBuf,
    /// Model file or catalogue guide that declares mass, friction and noise
    /// [default: the model in the bag]
    #[arg(long, value_name = "MODEL")]
    pub model: Option<String>,
    /// YAML file that says which topic and field, or column, is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    #[command(flatten)]
    pub part: PartArgs,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the report goes to `out`.
pub fn run(args: &CheckArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let part = args.part.window()?;
    let mapping = args.mapping.as_deref().map(Mapping::load).transpose()?;
    let model = args.model.as_deref().map(model_named).transpose()?;
    super::tell_assumptions(model.as_ref());
    let progress = Progress::endless("reading");
    let mut reported =
        |count: u64| progress.say(format!("{:.1} million read", count as f64 * 1e-6));
    let check = RecordingCheck::new(&args.bag, mapping.as_ref(), part, model, &mut reported)?;
    drop(progress);
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&recording_json(&check)?)?)?;
    } else {
        write!(out, "{}", recording_text(&check))?;
    }
    Ok(Outcome::warned(check.has_warnings()))
}
