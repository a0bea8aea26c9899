//! `friction-stage guides`: the guides of the catalogue, with where each value comes from.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::{Outcome, WrongArguments};
use friction_stage_core::model::{Catalogue, StageModel, nearest};
use friction_stage_report::model::guide_json;
use friction_stage_report::words::{guide_text, guides_text};

/// List the guides of the catalogue, or show one of them.
///
/// Every value says where it comes from: stated in the paper, derived from what it states,
/// assumed, or measured.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage guides\n  friction-stage guides guide_2\n  \
                        friction-stage guides --catalogue launch_config/own_guide_catalogue.yaml \
                        my_guide\n  friction-stage guides --json | jq '.[].stiffness.value'")]
pub struct GuidesArgs {
    /// Show this guide
    #[arg(value_name = "NAME")]
    pub name: Option<String>,
    /// Guides of your own, in addition to the built-in ones
    #[arg(long, value_name = "FILE")]
    pub catalogue: Option<PathBuf>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// What is wrong with a name that no guide of the catalogue has.
fn unknown(name: &str, catalogue: &Catalogue) -> WrongArguments {
    let known: Vec<&str> = catalogue.names().collect();
    let hint = match StageModel::named(name) {
        Ok(_) => format!("; it is a model, which `friction-stage model {name}` shows"),
        Err(_) => nearest(name, known.iter().copied()),
    };
    WrongArguments(format!("no guide `{name}`: the catalogue has {}{hint}", known.join(", ")))
}

/// Runs the command; the answer goes to `out`.
pub fn run(args: &GuidesArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let mut catalogue = Catalogue::builtin();
    if let Some(path) = &args.catalogue {
        catalogue.add(Catalogue::load(path)?, &path.display().to_string())?;
    }
    let json = match &args.name {
        Some(name) => {
            let entry = catalogue.entry(name).ok_or_else(|| unknown(name, &catalogue))?;
            if !args.json {
                write!(out, "{}", guide_text(name, entry))?;
            }
            guide_json(name, entry)?
        }
        None => {
            if !args.json {
                write!(out, "{}", guides_text(catalogue.entries()))?;
            }
            let all: Result<Vec<Value>, _> =
                catalogue.entries().map(|(name, entry)| guide_json(name, entry)).collect();
            json!(all?)
        }
    };
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&json)?)?;
    }
    Ok(Outcome::Done)
}
