//! `friction-stage replay`: the recorded forces on a stage in this process, beside what was
//! recorded.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;

use super::Outcome;
use super::identify::instant_in_words;
use crate::node::stage_settings;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::effects::RecordSpecific;
use friction_stage_core::plant::{Rates, Stage};
use friction_stage_data::bag::BagReader;
use friction_stage_data::quality::{self, DataProblem, Severity};
use friction_stage_data::signals::{self, Trace};
use friction_stage_identify::{
    ClosedLoopError, Hypothesis, IdentifyError, Measured, Part, Sides, Tolerances, closed_loop,
};

/// Play the recorded forces of a bag on a stage and compare its encoder with the recorded one.
///
/// Without options the stage is the one that the bag was recorded from: model, seed and rates stand
/// in the bag, and a lockstep recording is reproduced bit for bit. With --model another model gets
/// the same forces.
///
/// Forces that were recorded with one stage leave another one somewhere else soon, however good its
/// model. Two more figures say how good it is: the force that the model misses along the recorded
/// motion, and the position error in closed loop, with the recorded setpoint and the controller
/// that the recording shows.
///
/// Exit code: 0 done, 3 done on data that contradict themselves or the model, so that the figures
/// say nothing of it, 1 failed, 2 wrong arguments.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage replay demo/guide_1\n  friction-stage replay \
                  demo/guide_1 --model guide_2 --csv out.csv")]
pub struct ReplayArgs {
    /// rosbag2 directory or MCAP file
    #[arg(value_name = "BAG")]
    pub bag: PathBuf,
    /// Model file or catalogue guide in place of the bag's own model
    #[arg(long, value_name = "MODEL")]
    pub model: Option<String>,
    /// Seed of the sensor noise in place of the bag's
    #[arg(long)]
    pub seed: Option<u64>,
    /// Write recorded and replayed samples here
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// How the replay compares.
#[derive(Debug, Serialize)]
struct ReplayReport {
    samples: usize,
    /// Samples without a force, played as zero.
    unforced: usize,
    /// Encoder positions that are the same bits.
    identical: usize,
    position_rms_m: f64,
    position_max_m: f64,
    force_cell_rms_n: f64,
    /// Force that the model misses along the recorded motion; null where the recording does not
    /// show it.
    missing_force_rms_n: Option<f64>,
    /// Encoder of the closed loop less the recorded one; null where the loop cannot be simulated.
    closed_loop_position_rms_m: Option<f64>,
    /// What these figures take for granted, and why one of them is not there.
    notes: Vec<String>,
    /// What is wrong with the data: figures on them say nothing of the model.
    warnings: Vec<String>,
}

/// Runs the command; the report goes to `out`.
pub fn run(args: &ReplayArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let reader = BagReader::open(&args.bag)?;
    let provenance = reader.provenance().cloned();
    let model = match &args.model {
        Some(name) => stage_settings::model(name)?,
        None => reader.model()?.with_context(|| {
            format!("{} holds no model: give one with --model", args.bag.display())
        })?,
    };
    let seed = match (args.seed, &provenance) {
        (Some(seed), _) => seed,
        (None, Some(provenance)) => {
            provenance.seed.parse().context("the seed in the bag is no number")?
        }
        (None, None) => 1,
    };
    let trace = Trace::from_reader(&reader)?;
    let rates = match &provenance {
        Some(provenance) => {
            let rate = |key: &str| -> anyhow::Result<f64> {
                let text = provenance
                    .extra
                    .get(key)
                    .with_context(|| format!("the bag does not say its {key}"))?;
                text.parse()
                    .with_context(|| format!("{key} in the bag is `{text}`, must be a number"))
            };
            Rates::new(rate("control_rate")?, rate("physics_rate")?)?
        }
        None => {
            let step =
                trace.time.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
            anyhow::ensure!(
                step.is_finite() && step > 0.0,
                "{} holds less than two samples",
                args.bag.display()
            );
            let control = step.recip().round();
            Rates::new(control, control * (Rates::DEFAULT.physics() / control).ceil())?
        }
    };
    let mut stage = Stage::new(&model, rates, seed)?;
    let mut report = ReplayReport {
        samples: trace.len(),
        unforced: 0,
        identical: 0,
        position_rms_m: 0.0,
        position_max_m: 0.0,
        force_cell_rms_n: 0.0,
        missing_force_rms_n: None,
        closed_loop_position_rms_m: None,
        notes: Vec::new(),
        warnings: contradictions(&args.bag, &model),
    };
    let mut table = args
        .csv
        .as_ref()
        .map(|path| {
            std::fs::File::create(path).with_context(|| cannot_write(path)).map(|file| (path, file))
        })
        .transpose()?
        .map(|(path, file)| (path, std::io::BufWriter::new(file)));
    if let Some((path, table)) = &mut table {
        writeln!(
            table,
            "time,force,recorded_position,replayed_position,recorded_force_cell,replayed_force_cell"
        )
        .with_context(|| cannot_write(path))?;
    }
    let columns = trace.position.iter().zip(&trace.force_cell).zip(&trace.force).zip(&trace.time);
    for (((position, force_cell), force), time) in columns {
        let sample = stage.sample();
        let difference = sample.position - position;
        report.identical += usize::from(sample.position.to_bits() == position.to_bits());
        report.position_rms_m += difference * difference;
        report.position_max_m = report.position_max_m.max(difference.abs());
        report.force_cell_rms_n += (sample.force_cell - force_cell).powi(2);
        report.unforced += usize::from(!force.is_finite());
        if let Some((path, table)) = &mut table {
            let (replayed, cell) = (sample.position, sample.force_cell);
            writeln!(table, "{time:.9},{force},{position},{replayed},{force_cell},{cell}")
                .with_context(|| cannot_write(path))?;
        }
        stage.advance(if force.is_finite() { *force } else { 0.0 });
    }
    if let Some((path, mut table)) = table {
        table.flush().with_context(|| cannot_write(path))?;
    }
    let count = report.samples.max(1) as f64;
    report.position_rms_m = (report.position_rms_m / count).sqrt();
    report.force_cell_rms_n = (report.force_cell_rms_n / count).sqrt();
    let mut in_record = model.clone();
    match missing_force(&model, &trace) {
        Ok((rms, here, own)) => {
            report.missing_force_rms_n = Some(rms);
            if here.effects.iter().any(Part::slips) {
                report.notes.push(
                    "balls that slip have the amplitude and phase here that fit this record best, \
                     and no part in the closed loop"
                        .to_owned(),
                );
            }
            if !own.is_empty() {
                in_record = here.model();
            }
            let has_own_phase =
                |part: &&Part| matches!(part.descriptor.record_specific, RecordSpecific::Phase);
            if let Some(part) = own.iter().find(|part| has_own_phase(part)) {
                report.notes.push(format!(
                    "{} has the phase here that fits this record best",
                    part.descriptor.name
                ));
            }
            for at in own.iter().filter_map(|part| Some(part.curve()?.jump?.at)) {
                let instant = instant_in_words(
                    at,
                    trace.time.last().unwrap_or(&0.0) - trace.time.first().unwrap_or(&0.0),
                );
                report.notes.push(format!(
                    "the map jumps here where that fits this record best, {instant}"
                ));
            }
        }
        Err(error) => report.notes.push(format!("no missing force: {error}")),
    }
    match closed_loop_error(&in_record, &trace) {
        Ok(rms) => report.closed_loop_position_rms_m = Some(rms),
        Err(error) => report.notes.push(format!("no closed loop: {error}")),
    }
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        writeln!(
            out,
            "{} samples, {} without a force; encoder: {} bit for bit, rms {:.3} nm, largest {:.3} \
             nm; force cell: rms {:.4} N",
            report.samples,
            report.unforced,
            report.identical,
            report.position_rms_m * 1e9,
            report.position_max_m * 1e9,
            report.force_cell_rms_n
        )?;
        if let Some(rms) = report.missing_force_rms_n {
            writeln!(out, "along the recorded motion the model misses a force of {rms:.4} N rms")?;
        }
        if let Some(rms) = report.closed_loop_position_rms_m {
            writeln!(
                out,
                "in closed loop, with the recorded setpoint and controller: encoder rms {:.3} nm",
                rms * 1e9
            )?;
        }
        for note in &report.notes {
            writeln!(out, "{note}")?;
        }
        for warning in &report.warnings {
            writeln!(out, "warning: {warning}")?;
        }
    }
    Ok(if report.warnings.is_empty() { Outcome::Done } else { Outcome::Warnings })
}

fn cannot_write(path: &Path) -> String {
    format!("cannot write {}", path.display())
}

/// Where a recording contradicts itself or the model so that no figure of a replay says anything: a
/// wrong sign or unit, another machine, samples that no machine made.
fn contradictions(path: &Path, model: &StageModel) -> Vec<String> {
    let found = match signals::load(path, None) {
        Ok(recording) => quality::examine(&recording, Some(model)),
        Err(error) => return vec![error.to_string()],
    };
    let spoils = |problem: &&DataProblem| match problem {
        DataProblem::TooShort { .. } | DataProblem::NoMotion { .. } | DataProblem::NoForce => false,
        DataProblem::Outliers { .. } | DataProblem::NotFinite { .. } => true,
        other => other.severity() == Severity::Fatal,
    };
    found.problems.iter().filter(spoils).map(ToString::to_string).collect()
}

/// Share of what a model misses that the phase or the instant which fits this record best has to
/// leave out for the one of the model to be another record's. Assumed.
const ANOTHER_RECORD: f64 = 0.05;

/// Rms of the force that the model misses along the recorded motion, both sides of the cell
/// together, N, with the phases that a record has for itself; what stands for the model in this
/// record, and of that the effects which this record has for itself.
fn missing_force(
    model: &StageModel,
    trace: &Trace,
) -> Result<(f64, Hypothesis, Vec<Part>), IdentifyError> {
    let measured = Measured::new(trace, model, "the recording")?;
    let declared = Hypothesis::new(model, Tolerances::default())?;
    let here = declared.in_record(&measured)?;
    let missing = |hypothesis: &Hypothesis| {
        hypothesis.missing(&measured, Sides::BOTH).map(|missing| missing.rms())
    };
    let (as_declared, in_record) = (missing(&declared)?, missing(&here)?);
    if in_record < (1.0 - ANOTHER_RECORD) * as_declared {
        let own = declared.own_of(&here).into_iter().cloned().collect();
        return Ok((in_record, here, own));
    }
    Ok((as_declared, declared, Vec::new()))
}

/// Rms of the closed loop's encoder less the recorded one, m.
fn closed_loop_error(model: &StageModel, trace: &Trace) -> Result<f64, ClosedLoopError> {
    let controller = closed_loop::controller_of(trace, &[trace])?;
    Ok(closed_loop::rms(&closed_loop::position_error(model, trace, &controller)?))
}
