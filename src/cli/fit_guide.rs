//! `friction-stage fit-guide`: from recordings of the measuring rig to an entry of the catalogue.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;

use super::Outcome;
use super::progress::Progress;
use crate::directory::may_replace;
use crate::made_by;
use friction_stage_core::model::JointType;
use friction_stage_data::quality::Severity;
use friction_stage_data::signals::Trace;
use friction_stage_lab::{
    Fitted, GuideConstruction, GuideFit, GuideFitFinding, RigRecord, fit_guide,
};
use friction_stage_report::words::{Worded, all_words};

/// Fit a guide to recordings of the measuring rig and write it as an entry of a catalogue.
///
/// The Stribeck recording holds runs at constant velocity in both directions, the Dahl recording
/// slow loops of which the largest breaks away. First the static curve is fitted, then the bristle,
/// then both together; every parameter comes with its 95 % interval. Needed of the bags are the
/// encoder and the force cell; it does not matter how the rig was driven.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage fit-guide --stribeck stribeck_bag --dahl \
                        dahl_bag --name my_guide --out my_guide.yaml\n  friction-stage select \
                        --application A.yaml --catalogue my_guide.yaml --out choice")]
pub struct FitGuideArgs {
    /// rosbag2 directory or one of its files, with runs at constant velocity
    #[arg(long, value_name = "BAG")]
    pub stribeck: PathBuf,
    /// rosbag2 directory or one of its files, with slow loops
    #[arg(long, value_name = "BAG")]
    pub dahl: PathBuf,
    /// Catalogue file to write
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace the file of --out
    #[arg(long)]
    pub force: bool,
    /// Name of the entry [default: that of the file]
    #[arg(long)]
    pub name: Option<String>,
    /// What moves behind the force cell: carriage with adapter, kg
    /// [default: what the bag's model says]
    #[arg(long, value_name = "KG")]
    pub mass: Option<f64>,
    /// What the guide is, for people
    #[arg(long, default_value = "fitted to recordings")]
    pub description: String,
    /// The guide has seals; without this it is never chosen where sealing is required
    #[arg(long)]
    pub seals: bool,
    /// The guide has a cage
    #[arg(long)]
    pub cage: bool,
    /// Lubricant of the guide
    #[arg(long, default_value = "unknown")]
    pub lubricant: String,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Serialize)]
struct Report<'a> {
    schema_version: u32,
    name: String,
    parameters: Vec<Parameter>,
    runs: usize,
    rows: usize,
    force_rms_n: f64,
    noise_rms_n: f64,
    catalogue: PathBuf,
    findings: Vec<Worded<'a, GuideFitFinding>>,
    warnings: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Parameter {
    name: &'static str,
    value: f64,
    unit: &'static str,
    ci95: [f64; 2],
}

/// Runs the command; the result goes to `out`.
pub fn run(args: &FitGuideArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    may_replace(Some(&args.out), args.force, "--out")?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => {
            args.out.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
        }
    };
    anyhow::ensure!(!name.is_empty(), "--name is empty: the entry needs one");
    let read = |path: &Path| -> anyhow::Result<_> {
        let (trace, model) = Trace::with_force_cell(path)?;
        let Trace { time, position, force_cell: force, .. } = trace;
        Ok((RigRecord { time, position, force }, model.map(|model| model.mass)))
    };
    let progress = Progress::endless("reading");
    let (stribeck, said) = read(&args.stribeck)?;
    let (dahl, _) = read(&args.dahl)?;
    progress.say("fitting");
    let mass = args.mass.or(said).with_context(|| {
        format!(
            "{} does not say what mass moves behind the force cell: give it by --mass",
            args.stribeck.display()
        )
    })?;
    anyhow::ensure!(
        mass.is_finite() && mass > 0.0,
        "--mass is {mass} kg, must be finite and greater than 0"
    );
    let fit = fit_guide(&stribeck, &dahl, mass).with_context(|| {
        format!("no guide from {} and {}", args.stribeck.display(), args.dahl.display())
    })?;
    drop(progress);
    let catalogue = fit
        .catalogue(
            &name,
            &GuideConstruction {
                description: args.description.clone(),
                seals: args.seals,
                cage: args.cage,
                lubricant: args.lubricant.clone(),
            },
            &format!(
                "{} runs of {}, {} rows of {}",
                fit.windows,
                args.stribeck.display(),
                fit.rows,
                args.dahl.display()
            ),
        )?
        .to_yaml()?;
    std::fs::write(&args.out, made_by::signed("catalogue.yaml", &catalogue))
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    let report = Report {
        schema_version: 1,
        name,
        parameters: fit
            .parameters()
            .into_iter()
            .map(|(name, Fitted { value, ci95 })| Parameter {
                name,
                value,
                unit: GuideFit::unit(name),
                ci95,
            })
            .collect(),
        runs: fit.windows,
        rows: fit.rows,
        force_rms_n: fit.force_rms,
        noise_rms_n: fit.noise_rms,
        catalogue: args.out.clone(),
        findings: fit.findings.iter().map(worded).collect(),
        warnings: all_words(&fit.findings, JointType::Prismatic),
    };
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        print(out, &report)?;
    }
    Ok(if report.warnings.is_empty() { Outcome::Done } else { Outcome::Warnings })
}

fn worded(finding: &GuideFitFinding) -> Worded<'_, GuideFitFinding> {
    Worded::new(finding.code(), Severity::Warning, finding, JointType::Prismatic)
}

fn print(out: &mut dyn Write, report: &Report<'_>) -> std::io::Result<()> {
    writeln!(
        out,
        "{}: from {} runs at constant velocity and {} rows of loops",
        report.name, report.runs, report.rows
    )?;
    writeln!(out)?;
    writeln!(out, "parameter               value  unit   95 % interval")?;
    for Parameter { name, value, unit, ci95: [low, high] } in &report.parameters {
        writeln!(out, "{name:18} {value:>10.5e}  {unit:6} {low:.5e} to {high:.5e}")?;
    }
    writeln!(out)?;
    writeln!(
        out,
        "left of the force: {:.4} N rms; noise of the force cell: {:.4} N rms",
        report.force_rms_n, report.noise_rms_n
    )?;
    for warning in &report.warnings {
        writeln!(out, "warning: {warning}")?;
    }
    writeln!(out, "catalogue: {}", report.catalogue.display())
}
