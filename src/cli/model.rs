//! `friction-stage model`: a model file checked, and what follows from it.

use std::io::Write;

use clap::Args;

use super::Outcome;
use friction_stage_core::plant::model_named;
use friction_stage_report::model::ModelFacts;
use friction_stage_report::words::model_text;

/// Check a model file and show the stage with its units and what follows from it.
///
/// What follows: moving mass, stiffness of the guides, Dahl resonance, break-away force, and the
/// force that the paper's move of 50 mm in 100 ms needs. What the file does not say and is
/// assumed is a note, and so is a guide that is not passive.
///
/// Exit code: 0 done, 1 the file is refused.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage model my_stage.yaml\n  friction-stage model \
                        guide_2                  # 40 kg on four guides of the catalogue\n  \
                        friction-stage model my_stage.yaml --json | jq .derived\n\nA model of \
                        one's own:\n  mass: 12.0                 # kg\n  guides: [guide_2, \
                        guide_2]\n  motor: {force_limit: 500}  # N\n  effects:\n    - cogging: \
                        {amplitude: 2.0, period: 0.024}")]
pub struct ModelArgs {
    /// Model file, a guide of the catalogue, or rig:GUIDE
    #[arg(value_name = "FILE")]
    pub model: String,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the answer goes to `out`.
pub fn run(args: &ModelArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let facts = ModelFacts::new(&model_named(&args.model)?)?;
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&facts)?)?;
    } else {
        write!(out, "{}", model_text(&facts))?;
    }
    Ok(Outcome::Done)
}
