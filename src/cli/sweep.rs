//! `friction-stage sweep`: a stage over the values of its keys.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;

use super::numbered::RowsArgs;
use super::{Outcome, WrongArguments, tell_assumptions};
use crate::node::controller_settings;
use friction_stage_core::plant::model_named;
use friction_stage_data::motion_file;
use friction_stage_lab::{
    Axis, NumberedPlan as _, RowsError, SweepError, SweepMotion, SweepPlan, SweepRows,
    SweepSummary, given_by,
};
use friction_stage_report::figure::FigureError;
use friction_stage_report::sweep::{sweep_figure, sweep_text};

/// Move a stage over the values of keys of its model, controller and motion.
///
/// A key is a dotted path: model.mass, model.guides.stiffness (of all guides),
/// model.guides.0.stiffness (of one), model.guides (names of the catalogue),
/// model.effects.cogging.amplitude; controller.bandwidth, controller.gains.stage.p and the other
/// parameters of controller_node; motion.distance, motion.duration, motion.settle, or
/// motion.stretch of a motion file. Its values are a list (20,40), a range (20:60:5, or
/// 1e-6:1e-3:7:log) or a distribution, of which --samples values are drawn: uniform(20,60),
/// loguniform(1e-6,1e-3), normal(40,2), lognormal(450e3,0.1) with a median and a relative
/// deviation. Several keys make a grid; distributions are drawn at each of its places. The
/// controller follows the mass of the model unless --controller gives its gains.
///
/// Ctrl-C keeps what is done. Writes points.csv, points.parquet, summary.json and sweep.svg.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage sweep controller.bandwidth=30:90:7 --model guide_2 \
                  --out bandwidth\n  friction-stage sweep model.mass=20,40,60 \
                  model.guides=guide_1,guide_2,guide_3 --motion fast-move --out masses\n  \
                  friction-stage sweep 'model.guides.stiffness=lognormal(450e3,0.1)' \
                  'model.guides.static_force=normal(17,0.5)' --samples 1000 --out tolerances\n  \
                  friction-stage sweep model.mass=20:60:100 --shard 2/4 --out part_2\n  \
                  friction-stage merge part_* --out whole"
)]
pub struct SweepArgs {
    /// A key with its values
    #[arg(value_name = "KEY=VALUES", required = true)]
    pub axes: Vec<String>,
    /// Model file or catalogue guide of the stage
    #[arg(long, value_name = "MODEL", default_value = "guide_1")]
    pub model: String,
    /// Parameter file of a controller_node [default: the rule of thumb for 60 Hz and the mass of
    /// each point]
    #[arg(long, value_name = "FILE")]
    pub controller: Option<PathBuf>,
    /// fine-step, fast-move, or a motion file (trajectory_msgs/JointTrajectory in YAML)
    #[arg(long, value_name = "MOTION", default_value = "fine-step")]
    pub motion: String,
    /// Values that are drawn of the distributions at each place of the grid, each with a noise of
    /// its own
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub samples: Option<u64>,
    /// Seed of draws and noise; a point depends on seed and its number only
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub rows: RowsArgs,
    /// Print summary.json instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &SweepArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let wrong = |error: SweepError| WrongArguments(error.to_string());
    let axes: Vec<Axis> =
        args.axes.iter().map(|axis| axis.parse()).collect::<Result<_, _>>().map_err(wrong)?;
    let model = model_named(&args.model)?;
    tell_assumptions(Some(&model));
    let given = match &args.controller {
        Some(path) => given_by(&controller_settings::from_file(path)?),
        None => Default::default(),
    };
    let motion = match SweepMotion::named(&args.motion) {
        Some(motion) => motion,
        None if Path::new(&args.motion).extension().is_none() => {
            return Err(WrongArguments(format!(
                "--motion {}: must be {} or a motion file",
                args.motion,
                SweepMotion::NAMES.join(", ")
            ))
            .into());
        }
        None => SweepMotion::of_points(&motion_file::load(Path::new(&args.motion))?, &[]),
    };
    let plan =
        SweepPlan::new(model, given, motion, axes, args.samples, args.seed).map_err(wrong)?;
    let rows = args.rows.compute(plan, |plan, points| Ok(plan.run(points)))?;
    if args.rows.is_part(&rows, out)? {
        return Ok(Outcome::Done);
    }
    finish(&args.rows.out, &rows, args.json, out)
}

/// A figure that cannot be drawn, or rows that cannot be read.
#[derive(Debug, thiserror::Error)]
enum FigureOfRowsError {
    #[error(transparent)]
    Figure(#[from] FigureError),
    #[error(transparent)]
    Rows(#[from] RowsError),
}

/// Sums up all rows of a directory, writes what belongs to them and prints the result on `out`.
pub fn finish(
    directory: &Path,
    rows: &SweepRows,
    json: bool,
    out: &mut dyn Write,
) -> anyhow::Result<Outcome> {
    let plan = &rows.sheet().plan;
    let summary = SweepSummary::of_rows(rows)?;
    let write = |name: &str, text: String| {
        let path = directory.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    let figure = sweep_figure::<FigureOfRowsError>(plan, |each| {
        rows.read(&mut |point, outcome| {
            each(point, outcome.ok());
            Ok(())
        })?;
        Ok(())
    })?;
    write("sweep.svg", figure)?;
    #[cfg(feature = "parquet")]
    rows.write_parquet(&directory.join("points.parquet"))?;
    let text = serde_json::to_string_pretty(&summary)?;
    write("summary.json", format!("{text}\n"))?;
    if json {
        writeln!(out, "{text}")?;
    } else {
        write!(out, "{}", sweep_text(plan, &summary))?;
        let parquet = if cfg!(feature = "parquet") { ", points.parquet" } else { "" };
        writeln!(out, "\n{}: points.csv{parquet}, summary.json, sweep.svg", directory.display())?;
    }
    if summary.failed == plan.count() {
        anyhow::bail!(
            "none of the {} points can be computed, the first: {}",
            summary.failed,
            summary.first_failure.unwrap_or_default()
        );
    }
    Ok(Outcome::warned(summary.failed > 0))
}
