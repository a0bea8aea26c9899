//! `friction-stage replay`: the recorded forces on a stage in this process, beside what was
//! recorded.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;

use super::Outcome;
use super::progress::Progress;
use crate::directory::may_replace;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::{Rates, Stage};
use friction_stage_data::bag::{BagReader, LOCKSTEP_EPOCH, Provenance};
use friction_stage_data::quality::{FileFinding, contradictions};
use friction_stage_data::signals::{Trace, load};
use friction_stage_identify::ModelComparison;
use friction_stage_report::words::{all_words, comparison_notes, in_prefix};

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
    /// rosbag2 directory or one of its files
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
    /// Replace the file of --csv
    #[arg(long)]
    pub force: bool,
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
    /// Force cell less the recorded one; null where none is recorded.
    force_cell_rms_n: Option<f64>,
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
    may_replace(args.csv.as_deref(), args.force, "--csv")?;
    let reader = BagReader::open(&args.bag)?;
    let provenance = reader.provenance().cloned();
    let model = match &args.model {
        Some(name) => StageModel::named(name)?,
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
    let progress = Progress::endless("reading");
    let trace = Trace::from_reader(&reader)?;
    let recording = load(&args.bag, None);
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
        force_cell_rms_n: None,
        missing_force_rms_n: None,
        closed_loop_position_rms_m: None,
        notes: Vec::new(),
        warnings: match &recording {
            Ok(recording) => all_words(&contradictions(recording, &model), model.joint),
            Err(error) => vec![error.to_string()],
        },
    };
    // What does not hold the data that were written cannot be compared with anything.
    let checksums = reader.verify_checksums()?;
    if !checksums.is_empty() {
        report.warnings.extend(all_words(&[FileFinding::Damaged], model.joint));
    }
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
    progress.say("replaying");
    let columns = trace.position.iter().zip(&trace.force_cell).zip(&trace.force).zip(&trace.time);
    // Sum of squares, and readings of the cell.
    let mut cell = (0.0, 0usize);
    for (((position, force_cell), force), time) in columns {
        let sample = stage.sample();
        let difference = sample.position - position;
        report.identical += usize::from(sample.position.to_bits() == position.to_bits());
        report.position_rms_m += difference * difference;
        report.position_max_m = report.position_max_m.max(difference.abs());
        if force_cell.is_finite() {
            cell = (cell.0 + (sample.force_cell - force_cell).powi(2), cell.1 + 1);
        }
        report.unforced += usize::from(!force.is_finite());
        if let Some((path, table)) = &mut table {
            let (replayed, read) = (sample.position, sample.force_cell);
            writeln!(table, "{time:.9},{force},{position},{replayed},{force_cell},{read}")
                .with_context(|| cannot_write(path))?;
        }
        stage.advance(if force.is_finite() { *force } else { 0.0 });
    }
    if let Some((path, mut table)) = table {
        table.flush().with_context(|| cannot_write(path))?;
    }
    let count = report.samples.max(1) as f64;
    report.position_rms_m = (report.position_rms_m / count).sqrt();
    anyhow::ensure!(
        report.position_rms_m.is_finite(),
        "the replayed positions are not finite: model and recorded forces do not go together"
    );
    report.force_cell_rms_n = (cell.1 > 0).then(|| (cell.0 / cell.1 as f64).sqrt());
    // The forces are played sample by sample as they stand in the bag; what is compared along the
    // motion is read as `identify` reads it.
    let repeats = args.model.is_none()
        && args.seed.is_none()
        && trace.origin_ns == LOCKSTEP_EPOCH
        && provenance.as_ref().is_some_and(Provenance::is_of_lockstep);
    if repeats && report.identical < report.samples {
        report.warnings.push(format!(
            "{} of {} samples are other than the stage in the bag gives them: model, seed, forces \
             or samples were changed, the stage was reset while it was recorded, or another \
             version of this program recorded it",
            report.samples - report.identical,
            report.samples
        ));
    }
    if let Ok(recording) = &recording {
        let comparison = ModelComparison::new(&model, &recording.trace);
        report.missing_force_rms_n = comparison.missing_force.as_ref().ok().copied();
        report.closed_loop_position_rms_m = comparison.closed_loop.as_ref().ok().copied();
        report.notes = comparison_notes(&comparison);
    }
    drop(progress);
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        let [m, n] = ["m", "N"].map(|unit| model.joint.unit(unit));
        for warning in &report.warnings {
            writeln!(out, "warning: {warning}")?;
        }
        let mut lines = Vec::new();
        if let Some(rms) = report.missing_force_rms_n {
            let rms = in_prefix(rms, &n);
            lines.push(format!("along the recorded motion the model misses a force of {rms} rms"));
        }
        if let Some(rms) = report.closed_loop_position_rms_m {
            lines.push(format!(
                "in closed loop, with the recorded setpoint and controller: encoder rms {}",
                in_prefix(rms, &m)
            ));
        }
        let forces_alone = format!(
            "forces alone: {} samples, {} without a force; encoder: {} bit for bit, rms {}, \
             largest {}; {}",
            report.samples,
            report.unforced,
            report.identical,
            in_prefix(report.position_rms_m, &m),
            in_prefix(report.position_max_m, &m),
            match report.force_cell_rms_n {
                Some(rms) => format!("force cell: rms {}", in_prefix(rms, &n)),
                None => "no force cell is recorded".to_owned(),
            }
        );
        // First what counts: that it is the recorded stage, or else how good the model is, since
        // forces alone lead another stage elsewhere soon.
        let place = if report.identical == report.samples { 0 } else { lines.len() };
        lines.insert(place, forces_alone);
        for line in lines {
            writeln!(out, "{line}")?;
        }
        for note in &report.notes {
            writeln!(out, "{note}")?;
        }
    }
    Ok(Outcome::warned(!report.warnings.is_empty()))
}

fn cannot_write(path: &Path) -> String {
    format!("cannot write {}", path.display())
}
