//! `friction-stage play`: a motion from a file, on a stage and its controller over ROS 2.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;

use super::progress::Progress;
use super::sync::SyncArgs;
use super::{Outcome, WrongArguments};
use crate::cpu;
use crate::directory::{SetAside, set_aside};
use crate::interrupt::{self, Patience};
use crate::made_by;
use crate::node::controller_settings;
use crate::node::driver::{Driver, LockstepRun};
use friction_stage_core::control::{ControllerSettings, Follower, Gains, Point, Trajectory};
use friction_stage_core::model::{JointType, StageModel};
use friction_stage_core::plant::{Rates, model_named};
use friction_stage_data::bag::{BagReader, LOCKSTEP_EPOCH, topics};
use friction_stage_data::message::{ControllerState, JointState};
use friction_stage_data::motion_file;
use friction_stage_lab::{
    Cell, Column, ColumnKind, FollowedSample, MotionQuality, Move, TableFormat, motion_quality,
    moves_along, write_table,
};
use friction_stage_report::played::{
    PlayedMove, PlayedSample, played_figure, played_moves, played_text,
};
use friction_stage_report::words::printable;

/// Play a motion on a stage over ROS 2, record it, and say how well it was followed.
///
/// The motion is a trajectory_msgs/JointTrajectory in YAML, such as `identify --next-experiment`
/// writes: the file that `ros2 topic pub /stage/setpoint trajectory_msgs/msg/JointTrajectory` takes
/// for a stage that runs already. Here the stage node and the controller node are started as two
/// processes in lockstep on loopback, the stage at position 0 on the model that is given.
///
/// The controller follows the model: the rule of thumb for --bandwidth and the mass that moves,
/// mass feedforward, the force limit of the motor. --gains gives its PID, --controller all of it.
///
/// Of each move: peak and rms error, force, and the time from the arrival of the reference to the
/// last sample outside of 10 µm, 1 µm and 0.1 µm. The figure and the samples (time, reference,
/// position, velocity, error, force, force cell) are written next to the bag.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage play next_experiment.yaml --model stage.yaml \
                  --record second\n  friction-stage play next_experiment.yaml --model stage.yaml \
                  --record third --stretch 1.25 --seed 2\n  friction-stage play move.yaml --model \
                  stage.yaml --controller tune/controller.yaml --record tuned --samples \
                  tuned.parquet")]
pub struct PlayArgs {
    /// The motion
    #[arg(value_name = "MOTION")]
    pub motion: PathBuf,
    /// Model file or catalogue guide of the stage
    #[arg(long, value_name = "MODEL", default_value = "guide_1")]
    pub model: String,
    /// Bandwidth for which the controller's gains are worked out, Hz
    #[arg(long, value_name = "HZ", default_value_t = ControllerSettings::PAPER_BANDWIDTH)]
    pub bandwidth: f64,
    /// Gains of the PID in N/m, N/(m s) and N s/m; the lowpass is that of --bandwidth
    #[arg(long, value_name = "P,I,D", value_parser = pid_gains)]
    pub gains: Option<[f64; 3]>,
    /// Parameter file of a controller_node, such as `tune` writes
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bandwidth", "gains"])]
    pub controller: Option<PathBuf>,
    /// Bag directory to record into; it must not exist, unless --force replaces it
    #[arg(long, value_name = "BAG")]
    pub record: PathBuf,
    /// File for the samples, .csv or .parquet [default: the name of the bag with .csv]
    #[arg(long, value_name = "FILE")]
    pub samples: Option<PathBuf>,
    /// Replace bag, figure and samples of an earlier run
    #[arg(long)]
    pub force: bool,
    /// Samples per second of stage and controller, Hz [default: that of --controller, or 4000]
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
    /// Play it in this many times its time: the same way at other speeds
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = stretch)]
    pub stretch: f64,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    pub seed: u32,
    #[command(flatten)]
    pub sync: SyncArgs,
    /// ROS domain of the run [default: one that no other process here uses]
    #[arg(long, value_name = "ID", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Samples per second where nothing is given, Hz.
const RATE: f64 = 4000.0;

fn pid_gains(text: &str) -> Result<[f64; 3], String> {
    let gains: Result<Vec<f64>, _> = text.split(',').map(|gain| gain.trim().parse()).collect();
    let gains = gains.map_err(|_| "must be three numbers, such as 8e5,1.6e7,6e3".to_owned())?;
    gains.try_into().map_err(|_| "must be three numbers, such as 8e5,1.6e7,6e3".to_owned())
}

fn stretch(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    motion_file::check_stretch(value).map_err(|error| error.to_string())?;
    Ok(value)
}

/// Longest motion, ns: times on the clock of the samples must not overflow.
const LONGEST: i64 = i64::MAX / 4;

/// Refuses what the controller would refuse, before anything is started.
fn check_motion(points: &[Point], model: &StageModel) -> anyhow::Result<()> {
    let trajectory = Trajectory::new(0, points.to_vec())?;
    anyhow::ensure!(
        trajectory.end() <= LONGEST,
        "the motion takes {:.3e} s, must take less than {:.3e} s",
        trajectory.end() as f64 * 1e-9,
        LONGEST as f64 * 1e-9
    );
    let (low, high) = stroke(model);
    // A jump at the start is for the node to judge, which knows where the stage is.
    Follower::new(f64::INFINITY).within(low, high).follow(0, trajectory)?;
    Ok(())
}

/// Lowest and highest position of a model, m.
fn stroke(model: &StageModel) -> (f64, f64) {
    model.stroke.map_or((-1e6, 1e6), |stroke| (stroke.low, stroke.high))
}

/// What was played.
#[derive(Debug, Serialize)]
struct PlayReport {
    bag: PathBuf,
    figure: PathBuf,
    samples: PathBuf,
    controller: ControllerReport,
    /// s
    duration: f64,
    points: usize,
    cycles: u64,
    cycles_per_second: f64,
    /// Every sample of every topic is in the bag.
    complete: bool,
    moves: Vec<PlayedMove>,
    /// Over all moves; null where the motion has none.
    all_moves: Option<MotionQuality>,
}

/// The controller of a run, SI units.
#[derive(Debug, Serialize)]
struct ControllerReport {
    /// Where its gains come from.
    gains: String,
    rate: f64,
    p: f64,
    i: f64,
    d: f64,
    lowpass_frequency: f64,
    mass_feedforward: f64,
    force_limit: f64,
    /// What the stage moves.
    moving_mass: f64,
}

/// The settings of the controller for a model, in words where they come from, and whether they are
/// for another mass.
fn controller_of(
    args: &PlayArgs,
    model: &StageModel,
) -> anyhow::Result<(ControllerSettings, String, Option<String>)> {
    let mass = model.moving_mass();
    if let Some(path) = &args.controller {
        let settings = controller_settings::from_file(path)?;
        if let Some(rate) = args.rate.filter(|rate| *rate != settings.rate) {
            return Err(WrongArguments(format!(
                "--rate is {rate} Hz and {} samples at {} Hz: leave --rate out, or give both the \
                 same",
                path.display(),
                settings.rate
            ))
            .into());
        }
        let other = (settings.mass_feedforward / mass - 1.0).abs() > 0.01;
        let warning = other.then(|| {
            format!(
                "{} feeds {} kg forward and the stage moves {mass} kg: the error contains the \
                 difference",
                path.display(),
                settings.mass_feedforward
            )
        });
        return Ok((settings, path.display().to_string(), warning));
    }
    let rate = args.rate.unwrap_or(RATE);
    let mut settings = ControllerSettings::of_model(model, args.bandwidth, rate);
    let mut words = format!("the rule of thumb for {} Hz and {mass} kg", args.bandwidth);
    if let Some([p, i, d]) = args.gains {
        settings.gains = Gains { p, i, d, ..settings.gains };
        words = format!("--gains, with the lowpass for {} Hz", args.bandwidth);
    }
    settings.check().map_err(|error| WrongArguments(format!("{words}: {error}")))?;
    Ok((settings, words, None))
}

/// The parameters of the controller node.
fn controller_parameters(
    args: &PlayArgs,
    model: &StageModel,
    settings: &ControllerSettings,
    cpu: String,
) -> Vec<String> {
    let (low, high) = stroke(model);
    let mut all = vec![format!("stroke_min:={low:?}"), format!("stroke_max:={high:?}"), cpu];
    if args.controller.is_some() {
        // The file is that of a node elsewhere.
        all.extend(["stage:=/stage", "joint:=stage", "enabled:=true"].map(str::to_owned));
        return all;
    }
    all.extend([
        format!("rate:={:?}", settings.rate),
        format!("mass:={:?}", model.moving_mass()),
        format!("bandwidth:={:?}", args.bandwidth),
        format!("feedforward.mass:={:?}", settings.mass_feedforward),
        format!("gains.stage.u_clamp_max:={:?}", settings.limits.1),
        format!("gains.stage.u_clamp_min:={:?}", settings.limits.0),
    ]);
    if args.gains.is_some() {
        let gains = &settings.gains;
        all.extend([
            "tuning:=gains".to_owned(),
            format!("gains.stage.p:={:?}", gains.p),
            format!("gains.stage.i:={:?}", gains.i),
            format!("gains.stage.d:={:?}", gains.d),
            format!("lowpass.frequency:={:?}", gains.lowpass_frequency),
            format!("lowpass.damping:={:?}", gains.lowpass_damping),
        ]);
    }
    all
}

/// The name of the bag with something after it, next to the bag.
fn next_to(bag: &Path, suffix: &str) -> PathBuf {
    let mut name = bag.file_name().unwrap_or_default().to_owned();
    name.push(suffix);
    bag.with_file_name(name)
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &PlayArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let points = motion_file::stretched(&motion_file::load(&args.motion)?, args.stretch);
    // Reported here, not from the log of a node.
    let model = model_named(&args.model)?;
    check_motion(&points, &model).with_context(|| args.motion.display().to_string())?;
    let (settings, gains, warning) = controller_of(args, &model)?;
    let figure = next_to(&args.record, ".svg");
    let samples_file = args.samples.clone().unwrap_or_else(|| next_to(&args.record, ".csv"));
    TableFormat::of(&samples_file).map_err(|error| WrongArguments(error.to_string()))?;
    let patience = Patience::begin();
    let earlier = [&args.record, &figure, &samples_file]
        .map(|place| set_aside(place, args.force, "--record"))
        .into_iter()
        .collect::<anyhow::Result<Vec<_>>>()?;
    if let Some(parent) = args.record.parent() {
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot create {}", parent.display()))?;
    }
    interrupt::writes(&args.record);
    let seconds = points.last().map_or(0.0, |point| point.time as f64 * 1e-9);
    let progress = Progress::of((1000.0 * seconds) as u64, "starting");
    let parameters = |given: &[String]| -> Vec<String> {
        given.iter().flat_map(|parameter| ["-p".to_owned(), parameter.clone()]).collect()
    };
    let cpu = format!("cpu:={}", cpu::online() - 1);
    let file = args
        .controller
        .iter()
        .flat_map(|path| ["--params-file".to_owned(), path.display().to_string()]);
    let run = LockstepRun {
        stage_arguments: parameters(&[
            format!("model:={}", args.model),
            format!("seed:={}", args.seed),
            format!("control_rate:={:?}", settings.rate),
            format!("physics_rate:={:?}", Rates::of_control(settings.rate)?.physics()),
            format!("record:={}", args.record.display()),
            args.sync.parameter(),
            cpu.clone(),
        ]),
        controller_arguments: file
            .chain(parameters(&controller_parameters(args, &model, &settings, cpu)))
            .collect(),
        points,
        log_stem: args.record.clone(),
    };
    let moves = moves_along(&run.points);
    let count = run.points.len();
    let done =
        Driver::on_loopback(&std::env::current_exe()?, args.domain)?.run(&run, &mut |time| {
            progress.say(format!("{:.1}/{seconds:.1} s", time.min(seconds)));
            progress.reach((1000.0 * time.min(seconds)) as u64);
        })?;
    drop(patience);
    interrupt::check()?;
    progress.say("reading the bag");
    let samples = played_samples(&args.record)?;
    let followed: Vec<FollowedSample> = samples
        .iter()
        .map(|sample| FollowedSample {
            time: sample.time,
            error: sample.error,
            force: sample.force,
            saturated: sample.saturated,
        })
        .collect();
    let quality = |moves: &[Move]| {
        motion_quality(moves, &followed).with_context(|| {
            format!(
                "{} has no sample of a move that begins at {} s: the recording lacks it, or the \
                 move is shorter than the time between two samples",
                args.record.display(),
                moves.first().map_or(f64::NAN, |one| one.start as f64 * 1e-9)
            )
        })
    };
    let each: Vec<MotionQuality> = moves
        .iter()
        .map(|one| quality(std::slice::from_ref(one)))
        .collect::<anyhow::Result<_>>()?;
    let title = format!("{} on {}", args.motion.display(), model.name);
    let drawing = played_figure(&title, &samples, &moves, settings.limits, model.joint)?;
    std::fs::write(&figure, made_by::signed("played.svg", &drawing))
        .with_context(|| format!("cannot write {}", figure.display()))?;
    let rows = samples.iter().map(sample_row);
    write_table(&samples_file, &made_by::record(), sample_columns(), rows)?;
    earlier.into_iter().try_for_each(SetAside::discard)?;
    drop(progress);
    let report = PlayReport {
        bag: args.record.clone(),
        figure,
        samples: samples_file,
        controller: ControllerReport {
            gains,
            rate: settings.rate,
            p: settings.gains.p,
            i: settings.gains.i,
            d: settings.gains.d,
            lowpass_frequency: settings.gains.lowpass_frequency,
            mass_feedforward: settings.mass_feedforward,
            force_limit: settings.limits.1,
            moving_mass: model.moving_mass(),
        },
        duration: seconds,
        points: count,
        cycles: done.cycles,
        cycles_per_second: done.rate,
        complete: !done.incomplete,
        moves: played_moves(&moves, &each, &samples),
        all_moves: (!moves.is_empty()).then(|| quality(&moves)).transpose()?,
    };
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        print(&report, model.joint, out)?;
    }
    if let Some(warning) = &warning {
        eprintln!("warning: {}", printable(warning));
    }
    if done.incomplete {
        eprintln!("warning: {} lacks samples; its log says how many", report.bag.display());
    }
    Ok(Outcome::warned(done.incomplete || warning.is_some()))
}

fn print(report: &PlayReport, joint: JointType, out: &mut dyn Write) -> std::io::Result<()> {
    let ControllerReport { gains, p, i, d, mass_feedforward, .. } = &report.controller;
    let [unit_p, unit_i, unit_d, kg] =
        ["N/m", "N/(m s)", "N s/m", "kg"].map(|unit| joint.unit(unit));
    writeln!(
        out,
        "controller: {gains}: p {p:.4e} {unit_p}, i {i:.4e} {unit_i}, d {d:.4e} {unit_d}, {} \
         feedforward {mass_feedforward} {kg}\n",
        joint.quantity("mass")
    )?;
    write!(out, "{}", played_text(&report.moves, report.all_moves.as_ref(), joint))?;
    writeln!(
        out,
        "\n{}: {:.1} s of motion, {} samples at {:.0} per second\nfigure {}, samples {}",
        report.bag.display(),
        report.duration,
        report.cycles,
        report.cycles_per_second,
        report.figure.display(),
        report.samples.display()
    )
}

/// The samples of a run from its bag: the controller's view, with what the encoder adds to it.
fn played_samples(bag: &Path) -> anyhow::Result<Vec<PlayedSample>> {
    let reader = BagReader::open(bag)?;
    let mut samples = Vec::new();
    // Stamp, velocity and force cell.
    let mut sensors: Vec<(i64, f64, f64)> = Vec::new();
    for message in reader.messages() {
        let message = message?;
        if message.topic.name == topics::CONTROLLER_STATE {
            let state: ControllerState = message.decode()?;
            if state.enabled && state.sample > 0 {
                samples.push(PlayedSample {
                    time: state.header.stamp.to_nanos() - LOCKSTEP_EPOCH,
                    reference: state.reference_position,
                    position: state.position,
                    velocity: f64::NAN,
                    error: state.error,
                    force: state.output,
                    force_cell: f64::NAN,
                    saturated: state.saturated,
                });
            }
        } else if message.topic.name == topics::ENCODER {
            let state: JointState = message.decode()?;
            let first = |values: &[f64]| values.first().copied().unwrap_or(f64::NAN);
            sensors.push((
                state.header.stamp.to_nanos() - LOCKSTEP_EPOCH,
                first(&state.velocity),
                first(&state.effort),
            ));
        }
    }
    anyhow::ensure!(!samples.is_empty(), "{} holds no state of the controller", bag.display());
    samples.sort_by_key(|sample| sample.time);
    sensors.sort_by_key(|(time, ..)| *time);
    for sample in &mut samples {
        if let Ok(place) = sensors.binary_search_by_key(&sample.time, |(time, ..)| *time) {
            (_, sample.velocity, sample.force_cell) = sensors[place];
        }
    }
    Ok(samples)
}

/// The columns of the file with the samples.
fn sample_columns() -> Vec<Column> {
    let numbers = [
        "time_s",
        "reference_m",
        "position_m",
        "velocity_m_s",
        "error_m",
        "force_n",
        "force_cell_n",
    ];
    let numbers = numbers.map(|name| Column::new(name, ColumnKind::Number));
    numbers.into_iter().chain([Column::new("saturated", ColumnKind::Flag)]).collect()
}

fn sample_row(sample: &PlayedSample) -> Vec<Cell> {
    let numbers = [
        sample.time as f64 * 1e-9,
        sample.reference,
        sample.position,
        sample.velocity,
        sample.error,
        sample.force,
        sample.force_cell,
    ];
    numbers.map(Cell::Number).into_iter().chain([Cell::Flag(sample.saturated)]).collect()
}

#[cfg(test)]
mod tests {
    use friction_stage_data::motion_file::{from_yaml, stretched};
    use friction_stage_identify::next_experiment::trajectory_yaml;

    use super::*;

    #[test]
    fn a_motion_that_no_controller_takes_is_refused_before_anything_starts() {
        let model = StageModel::on_guides("guide_1");
        let check = |points: &[Point]| check_motion(points, &model).unwrap_err().to_string();
        let fast = |velocity| Point { velocity: Some(velocity), ..Point::at_rest(1_000_000, 1e-3) };
        // Finite points, between which the motion is not.
        let error = check(&[fast(1e308), Point::at_rest(2_000_000, 0.0)]);
        assert!(error.contains("velocity") || error.contains("position"), "{error}");
        let error = check(&[Point::at_rest(1_000_000_000, 0.5)]);
        assert!(error.contains("must stay between -0.4 and 0.4 m"), "{error}");
        let error = check(&[Point::at_rest(i64::MAX / 2, 0.1)]);
        assert!(error.contains("must take less than"), "{error}");
        check_motion(&[Point::at_rest(1_000_000_000, 0.1)], &model).unwrap();
    }

    #[test]
    fn what_identify_writes_is_a_motion_that_can_be_played() {
        let point = |time, position| Point {
            time,
            position,
            velocity: Some(-0.25),
            acceleration: Some(1.5),
            effort: 0.0,
        };
        let given = [point(1_500_000_000, -1e-6), point(2_000_000_001, 0.02)];
        let text = trajectory_yaml(&given, topics::JOINT, &["a comment".to_owned()]);
        assert_eq!(from_yaml(&text, "next.yaml").unwrap(), given);
        let slower = stretched(&given, 2.0);
        assert_eq!(
            (slower[0].time, slower[0].velocity, slower[0].acceleration),
            (3_000_000_000, Some(-0.125), Some(0.375))
        );
    }
}
