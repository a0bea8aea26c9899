//! `friction-stage import`: a CSV file as a bag of our own layout.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;

use super::Outcome;
use friction_stage_data::signals::{self, Mapping};
use friction_stage_report::words::import_text;

/// Make a bag of our own layout from a CSV file.
///
/// The mapping says which column is which signal, in which unit. Every row becomes one sample with
/// its own time; values are brought to SI, nothing is resampled. The bag plays with `ros2 bag play`
/// and goes into check, replay and identify.
///
/// Exit code: 0 done, 3 rows without a usable time were left out or times go back, 1 failed.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:\n  friction-stage import drive.csv --mapping drive.yaml --out \
                  drive\n\nA mapping:\n  csv: {delimiter: \";\"}\n  signals:\n    time: {column: \
                  t_ms, unit: ms}\n    position: {column: x, unit: mm}\n    force: {column: u, \
                  scale: 35.15}   # N per V")]
pub struct ImportArgs {
    /// CSV file
    #[arg(value_name = "CSV")]
    pub csv: PathBuf,
    /// YAML file that says which column is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: PathBuf,
    /// Directory to make; it must not exist
    #[arg(long, value_name = "BAG")]
    pub out: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the report goes to `out`.
pub fn run(args: &ImportArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let text = std::fs::read_to_string(&args.mapping)
        .with_context(|| format!("cannot read {}", args.mapping.display()))?;
    let mapping = Mapping::from_yaml(&text, &args.mapping.display().to_string())?;
    let report = signals::import(&args.csv, &mapping, &text, &args.out)?;
    anyhow::ensure!(
        report.rows > 0,
        "{} has a header and no rows: {} is empty",
        args.csv.display(),
        args.out.display()
    );
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        write!(out, "{}", import_text(&report, &args.out))?;
    }
    Ok(Outcome::warned(report.without_time + report.not_later > 0))
}
