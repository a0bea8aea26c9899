//! `friction-stage effects`: the effects that a stage may have beyond its guides.

use std::io::Write;

use clap::Args;
use serde_json::{Value, json};

use super::Outcome;
use friction_stage_core::plant::EffectDescriptor;
use friction_stage_core::plant::effects::ALL;
use friction_stage_report::model::effect_json;
use friction_stage_report::words::{effect_text, effects_text};

/// List the effects that a model file may add to its guides, or show one of them.
///
/// Of one effect it shows the law, what it acts on, its source, what gives it away in a residual,
/// its parameters with units and bounds, and an example for a model file.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage effects\n  friction-stage effects cogging\n  \
                  friction-stage effects --json | jq '.[].name'")]
pub struct EffectsArgs {
    /// Show this effect
    #[arg(value_name = "NAME")]
    pub name: Option<String>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the answer goes to `out`.
pub fn run(args: &EffectsArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let one = args.name.as_deref().map(EffectDescriptor::find).transpose()?;
    match (one, args.json) {
        (Some(effect), false) => write!(out, "{}", effect_text(effect))?,
        (None, false) => write!(out, "{}", effects_text(ALL))?,
        (one, true) => {
            let value = match one {
                Some(effect) => effect_json(effect),
                None => json!(ALL.iter().map(|effect| effect_json(effect)).collect::<Vec<Value>>()),
            };
            writeln!(out, "{}", serde_json::to_string_pretty(&value)?)?;
        }
    }
    Ok(Outcome::Done)
}
