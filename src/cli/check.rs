//! `friction-stage check`: what a recording holds, what is wrong with it, and what can be
//! identified from it.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::Outcome;
use crate::node::stage_settings;
use friction_stage_data::bag::BagReader;
use friction_stage_data::quality::{self, CheckReport, Excitation};
use friction_stage_data::signals::{self, DataQuality, Mapping};

/// Show what a recording holds, whether anything is wrong with it, and what can be identified from
/// it.
///
/// Lists per topic how many messages there are, their rate, jitter and gaps, stamps that repeat or
/// go back, values that are not finite and messages that do not decode; says whether the recording
/// is complete and what made it; and, if there is an encoder, which stroke and velocities the
/// motion covers and how often it turns round. Then it says what the data can identify and what
/// not: speeds, amplitudes, rests, the noise that is in them, and signals that are clipped,
/// constant, of the wrong sign or in the wrong unit. Takes rosbag2 directories and MCAP files, also
/// those of other programs, and CSV files; a mapping says which topic and field, or which column,
/// is which signal.
///
/// Exit code: 0 nothing wrong, 3 with warnings, 1 nothing of it can be read. What stands in the way
/// of identification counts as a warning if --model or --mapping asks for it.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage check run_1\n  friction-stage check run_1 --model \
                  guide_1\n  friction-stage check drive.csv --mapping drive.yaml --json | jq \
                  .identification.problems"
)]
pub struct CheckArgs {
    /// rosbag2 directory, MCAP file or CSV file
    #[arg(value_name = "BAG")]
    pub bag: PathBuf,
    /// Model file or catalogue guide that declares mass, friction and noise
    /// [default: the model in the bag]
    #[arg(long, value_name = "MODEL")]
    pub model: Option<String>,
    /// YAML file that says which topic and field, or column, is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Everything that is told, as JSON.
#[derive(Debug, Serialize)]
struct FullReport {
    /// The messages, of a bag.
    #[serde(flatten)]
    messages: Option<CheckReport>,
    /// The signals on one grid.
    data: Option<DataQuality>,
    /// What they can identify.
    identification: Option<Excitation>,
    /// Why there are none.
    no_data: Option<String>,
}

/// Runs the command; the report goes to `out`.
pub fn run(args: &CheckArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let mapping = args.mapping.as_deref().map(Mapping::load).transpose()?;
    let mut model = args.model.as_deref().map(stage_settings::model).transpose()?;
    let asked = args.mapping.is_some() || args.model.is_some();
    let mut messages =
        if signals::is_csv(&args.bag) { None } else { Some(quality::check(&args.bag)?) };
    if let (None, Some(messages)) = (&model, &mut messages) {
        model = BagReader::open(&args.bag)?.model().unwrap_or_else(|error| {
            messages.warnings.push(format!("its model cannot be used: {error}"));
            None
        });
    }
    let (data, no_data) = match signals::load(&args.bag, mapping.as_ref()) {
        Ok(recording) => (Some(recording), None),
        // asked for the messages only, a bag need not be one of a stage
        Err(error) if messages.is_some() && !asked => (None, Some(error.to_string())),
        Err(error) => return Err(error.into()),
    };
    let identification = data.as_ref().map(|recording| quality::examine(recording, model.as_ref()));
    let report = FullReport {
        messages,
        data: data.map(|recording| recording.quality),
        identification,
        no_data,
    };
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        if let Some(messages) = &report.messages {
            write!(out, "{messages}")?;
        }
        if let (Some(data), Some(identification)) = (&report.data, &report.identification) {
            write!(out, "{data}{identification}")?;
        }
        if let Some(reason) = &report.no_data {
            writeln!(out, "nothing can be identified from it: {reason}")?;
        }
    }
    let warnings = report.messages.is_some_and(|messages| !messages.warnings.is_empty());
    let problems = report.identification.is_some_and(|found| found.severity().is_some());
    Ok(if warnings || (asked && problems) { Outcome::Warnings } else { Outcome::Done })
}
