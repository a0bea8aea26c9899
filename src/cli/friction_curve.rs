//! `friction-stage friction-curve`: friction over velocity from runs at held speeds.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use serde_json::json;

use super::progress::Progress;
use super::{Outcome, PartArgs};
use crate::directory::may_replace;
use crate::made_by;
use friction_stage_data::quality::held_speeds;
use friction_stage_data::signals::{self, Mapping};
use friction_stage_lab::{CurvePoint, friction_curve};
use friction_stage_report::friction_curve::{
    CurveOfRuns, MixedJoints, Run, curve_figure, curve_text,
};

/// Fit a friction curve to runs at constant velocity.
///
/// Every stretch of a recording at a held speed becomes a point: mean velocity, and mean force of
/// the cell, or of the command where there is no cell. The transient at its start is left out, and
/// so is a stretch whose force drifts up to its end. Through the points goes Coulomb and viscous
/// friction, with a Stribeck curve where friction falls with velocity by more than chance, and a
/// force that does not turn round with the motion. Intervals are of 95 % and hold what the runs
/// scatter among each other. Takes rosbag2 directories and their files and tables, as `check` does.
///
/// Exit code: 0 done; 3 recordings without a held speed were left out, or the curve drives the
/// motion instead of resisting it; 1 failed.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage friction-curve speeds/*.csv --mapping drive.yaml\n  \
                  friction-stage friction-curve runs/capture_* --figure curve.svg"
)]
pub struct FrictionCurveArgs {
    /// rosbag2 directories or their files, or tables
    #[arg(value_name = "RECORDING", num_args = 1.., required = true)]
    pub recordings: Vec<PathBuf>,
    /// YAML file that says which topic and field, or column, is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// The recorded force is a magnitude without a sign: it counts along the motion
    #[arg(long)]
    pub magnitude: bool,
    #[command(flatten)]
    pub part: PartArgs,
    /// Draw the points and the curve into this SVG file
    #[arg(long, value_name = "FILE")]
    pub figure: Option<PathBuf>,
    /// Replace the file of --figure
    #[arg(long)]
    pub force: bool,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; the result goes to `out`.
pub fn run(args: &FrictionCurveArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    may_replace(args.figure.as_deref(), args.force, "--figure")?;
    let mapping = args.mapping.as_deref().map(Mapping::load).transpose()?;
    let window = args.part.window()?;
    let progress = Progress::of(args.recordings.len() as u64, "reading");
    let (mut runs, mut left_out, mut joints) = (Vec::new(), Vec::new(), Vec::new());
    let mut drifting = 0;
    for path in &args.recordings {
        let recording = signals::load_part(path, mapping.as_ref(), window)?;
        joints.extend(recording.joint.map(|joint| (path.clone(), joint)));
        let held = held_speeds(&recording);
        if held.steady.is_empty() && held.drifting == 0 {
            left_out.push(path.clone());
        }
        drifting += held.drifting;
        runs.extend(held.steady.into_iter().map(|held| {
            let force = match args.magnitude {
                true => held.force.abs() * held.velocity.signum(),
                false => held.force,
            };
            let point = CurvePoint { velocity: held.velocity, force, deviation: held.deviation };
            Run { recording: path.clone(), duration_s: held.duration_s, point }
        }));
        progress.step();
    }
    drop(progress);
    let joint = MixedJoints::one_of(&joints)?;
    let points: Vec<CurvePoint> = runs.iter().map(|run| run.point).collect();
    let curve = friction_curve(&points).with_context(|| {
        format!(
            "{} runs at held speeds with a steady force in {} recordings ({} hold no speed; in \
             {drifting} stretches the force drifts up to the end)",
            runs.len(),
            args.recordings.len(),
            left_out.len()
        )
    })?;
    let found = CurveOfRuns { joint, runs, left_out, drifting, curve };
    if let Some(path) = &args.figure {
        std::fs::write(path, made_by::signed("curve.svg", &curve_figure(&found)?))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        let json = json!({
            "schema_version": 1,
            "joint_type": found.joint.name(),
            "curve": found.curve,
            "runs": found.runs,
            "without_held_speed": found.left_out,
            "drifting_stretches": found.drifting,
        });
        writeln!(out, "{}", serde_json::to_string_pretty(&json)?)?;
    } else {
        write!(out, "{}", curve_text(&found))?;
        if let Some(path) = &args.figure {
            writeln!(out, "figure: {}", path.display())?;
        }
    }
    Ok(Outcome::warned(!found.left_out.is_empty() || !found.curve.resists()))
}
