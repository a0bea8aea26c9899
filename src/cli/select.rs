//! `friction-stage select`: which guide for an application.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;

use super::Outcome;
use super::numbered::RowsArgs;
use super::selection_output::finish;
use friction_stage_core::model::Catalogue;
use friction_stage_core::text_file;
use friction_stage_lab::{Application, SelectionPlan, VariantExperiment};

/// Choose a guide for an application: rank every guide of the catalogue by what it reaches over its
/// tolerances.
///
/// Each variant is the stage of the application on guides drawn from their tolerances, moved once
/// as the application says. Ctrl-C keeps what is done. Writes variants.csv, variants.parquet,
/// summary.json and trade_off.svg.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage select --application \
                        launch_config/application_fine_step_clean.yaml --out choice\n  \
                        friction-stage select --application A.yaml --catalogue own.yaml --variants \
                        100000 --shard 2/8 --out part_2\n  friction-stage merge part_* --out \
                        whole")]
pub struct SelectArgs {
    /// What the stage is to do and to reach (YAML)
    #[arg(long, value_name = "FILE")]
    pub application: PathBuf,
    /// Catalogues of one's own, beside the built-in one
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub catalogue: Vec<PathBuf>,
    /// Choose among these guides only
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub guides: Vec<String>,
    /// Variants over all guides, dealt to them in turn
    #[arg(
        long,
        value_name = "N",
        default_value_t = 3000,
        value_parser = clap::value_parser!(u64).range(1..),
    )]
    pub variants: u64,
    /// Seed of tolerances and noise; a variant depends on seed, guide and its number only
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub rows: RowsArgs,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &SelectArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let origin = args.application.display().to_string();
    let text =
        text_file::read(&args.application).with_context(|| format!("cannot read {origin}"))?;
    let application = Application::from_yaml(&text, &origin)?;
    let database = database(args)?;
    let experiment = VariantExperiment::new(&application)?;
    let plan = SelectionPlan::new(application, &database, args.seed, args.variants)?;
    let rows = args.rows.compute(plan, |plan, jobs| Ok(plan.run(&experiment, jobs)?))?;
    if args.rows.is_part(&rows, out)? {
        return Ok(Outcome::Done);
    }
    finish(&args.rows.out, &rows, args.json, out)
}

/// The built-in guides and the user's, or those of them that were asked for.
fn database(args: &SelectArgs) -> anyhow::Result<Catalogue> {
    let mut all = Catalogue::builtin();
    for path in &args.catalogue {
        all.add(Catalogue::load(path)?, &path.display().to_string())?;
    }
    if args.guides.is_empty() {
        return Ok(all);
    }
    all.only(&args.guides).context("--guides")
}
