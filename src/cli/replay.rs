//! `friction-stage replay`: the recorded forces on a stage in this process, compared with what was
//! recorded.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;

use super::progress::Progress;
use super::{Outcome, WrongArguments};
use crate::directory::may_replace;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::{Rates, Stage, model_named};
use friction_stage_data::bag::{BagReader, LOCKSTEP_EPOCH, Provenance};
use friction_stage_data::quality::{FileFinding, contradictions};
use friction_stage_data::signals::{Mapping, Recording, SignalError, Trace, is_table, load};
use friction_stage_identify::ModelComparison;
use friction_stage_report::words::{all_words, comparison_notes, in_prefix};

/// Play recorded forces on a stage and compare its encoder with the recorded one.
///
/// Without options the stage is the one that the bag was recorded from: model, seed and rates stand
/// in the bag, and a lockstep recording is reproduced bit for bit. With --model another model gets
/// the same forces.
///
/// A recording of another machine, a table for example, needs --model, and --mapping where its
/// signals have other names. The stage then starts with the recorded position and velocity, its
/// bristles unloaded: the free simulation of the model under the recorded forces.
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
                  demo/guide_1 --model guide_2 --csv out.csv\n  friction-stage replay drive.csv \
                  --mapping drive.yaml --model stage.yaml")]
pub struct ReplayArgs {
    /// rosbag2 directory or one of its files, or a table
    #[arg(value_name = "RECORDING")]
    pub bag: PathBuf,
    /// YAML file that says which topic and field, or column, is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
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
    let mapping = args.mapping.as_deref().map(Mapping::load).transpose()?;
    let progress = Progress::endless("reading");
    let Played { model, provenance, seed, rates, trace, recording, start, is_damaged } =
        match &mapping {
            None if !is_table(&args.bag, None) => Played::of_bag(args)?,
            _ => Played::of_recording(args, mapping.as_ref())?,
        };
    let mut stage = Stage::new(&model, rates, seed)?;
    if let Some((position, velocity)) = start {
        stage.set_state(position, velocity, &[]);
    }
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
    if is_damaged {
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
    let mut compared = 0usize;
    for (((position, force_cell), force), time) in columns {
        let sample = stage.sample();
        let difference = sample.position - position;
        report.identical += usize::from(sample.position.to_bits() == position.to_bits());
        // In a gap of a recording there is no position.
        if position.is_finite() {
            compared += 1;
            report.position_rms_m += difference * difference;
            report.position_max_m = report.position_max_m.max(difference.abs());
        }
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
    let place = args.bag.display();
    anyhow::ensure!(compared > 0, "{place} has no position to compare with");
    report.position_rms_m = (report.position_rms_m / compared as f64).sqrt();
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

/// What is replayed, and on what.
struct Played {
    model: StageModel,
    provenance: Option<Provenance>,
    seed: u64,
    rates: Rates,
    trace: Trace,
    recording: Result<Recording, SignalError>,
    /// Position (m) and velocity (m/s) that the stage starts with; none: those of a new stage.
    start: Option<(f64, f64)>,
    /// The data do not have the checksums that were written with them.
    is_damaged: bool,
}

impl Played {
    /// A bag of our own layout, which may say from which stage it is.
    fn of_bag(args: &ReplayArgs) -> anyhow::Result<Played> {
        let reader = BagReader::open(&args.bag)?;
        let provenance = reader.provenance().cloned();
        let model = match &args.model {
            Some(name) => model_named(name)?,
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
                let steps = trace.time.windows(2).map(|pair| pair[1] - pair[0]);
                let step = steps.fold(f64::INFINITY, f64::min);
                anyhow::ensure!(
                    step.is_finite() && step > 0.0,
                    "{} holds less than two samples",
                    args.bag.display()
                );
                Rates::of_control(step.recip().round())?
            }
        };
        Ok(Played {
            recording,
            is_damaged: !reader.verify_checksums()?.is_empty(),
            // Of a stage of ours it is that of a new one.
            start: provenance.is_none().then(|| start(&trace)).flatten(),
            model,
            provenance,
            seed,
            rates,
            trace,
        })
    }

    /// A recording of any machine, on its uniform grid.
    fn of_recording(args: &ReplayArgs, mapping: Option<&Mapping>) -> anyhow::Result<Played> {
        let place = args.bag.display();
        let name = args.model.as_deref().ok_or_else(|| {
            WrongArguments(match mapping {
                Some(_) => format!("{place} is read with --mapping: give a model with --model"),
                None => format!("{place} holds no model: give one with --model"),
            })
        })?;
        let model = model_named(name)?;
        let recording = load(&args.bag, mapping)?;
        let trace = recording.trace.clone();
        anyhow::ensure!(
            trace.force.iter().any(|force| force.is_finite()),
            "{place} has no command or force of the motor to play"
        );
        let start = start(&trace)
            .with_context(|| format!("{place} has no two positions in its first {START} s"))?;
        Ok(Played {
            model,
            provenance: None,
            seed: args.seed.unwrap_or(1),
            rates: Rates::of_control(recording.rate)?,
            trace,
            recording: Ok(recording),
            start: Some(start),
            is_damaged: false,
        })
    }
}

/// Time at the beginning of a recording in which its velocity is looked at, s. Assumed: the
/// acceleration does not show within it.
const START: f64 = 0.01;
/// Rows that are looked at however long they take.
const START_ROWS: usize = 5;

/// Position (m) and velocity (m/s) at the first row: those of a line through the first rows.
fn start(trace: &Trace) -> Option<(f64, f64)> {
    let first = *trace.time.first()?;
    let rows = trace.time.iter().zip(&trace.position).enumerate();
    let rows: Vec<_> = rows
        .take_while(|(row, (time, _))| *row < START_ROWS || *time - first <= START)
        .map(|(_, row)| row)
        .filter(|(_, position)| position.is_finite())
        .collect();
    let count = rows.len() as f64;
    let mean = |part: fn(&(&f64, &f64)) -> f64| rows.iter().map(part).sum::<f64>() / count;
    let (middle, height) = (mean(|row| *row.0), mean(|row| *row.1));
    let moment = |of: fn(f64, f64) -> f64| {
        rows.iter().map(|(time, position)| of(**time - middle, **position - height)).sum::<f64>()
    };
    let (spread, joint) = (moment(|time, _| time * time), moment(|time, position| time * position));
    let velocity = (spread > 0.0).then(|| joint / spread)?;
    Some((height + velocity * (first - middle), velocity))
}

fn cannot_write(path: &Path) -> String {
    format!("cannot write {}", path.display())
}
